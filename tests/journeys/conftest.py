"""Drives that the journeys begin with, simulated through the command line.

Nothing else uses their seeds.
"""

import laspy
import numpy as np
import pytest

from tests.journeys.shell import Shell

STREET = "--scene boulevard --lines 200 --seed 8801"
M = 2154


@pytest.fixture(scope="session")
def drives(tmp_path_factory):
    """A street (``drive.npz``, its ranges alone ``drive.bin``), a forest and a static scan, with
    reference classes."""
    shell = Shell(tmp_path_factory.mktemp("drives"))
    shell(f"prc simulate street drive.npz -q {STREET}")
    shell("prc simulate forest forest.npz -q --lines 160 --seed 8802")
    shell("prc simulate street-scan scan.npz -q --seed 8804 --set scanner.azimuth_step_deg=0.6")
    with np.load(shell.here / "drive.npz") as drive:
        drive["range_m"].astype("<f4").tofile(shell.here / "drive.bin")
    # the street as an office has it: coordinates, times and classes, and the way of the scanner
    # beside them
    shell(
        "prc simulate street registered.laz -q --trajectory path.csv --set "
        f"frame.crs=EPSG:32635 {STREET}"
    )
    cloud = laspy.read(shell.here / "registered.laz")
    cloud.remove_extra_dims(list(cloud.point_format.extra_dimension_names))
    cloud.scan_angle[:] = 0
    cloud.write(shell.here / "registered.laz")
    return shell.here


@pytest.fixture
def prc(drives, tmp_path):
    """A folder with the drives, and what is typed there."""
    for path in drives.iterdir():
        if path.is_file():
            (tmp_path / path.name).hardlink_to(path)
    return Shell(tmp_path)
