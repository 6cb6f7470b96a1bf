"""Trajectories as SBET; golden rows show what is refused of them and of tables."""

import builtins
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.errors import ConfigError
from prc_cli.streams.trajectory import Trajectory, load_trajectory

UTM35 = "EPSG:32635"


def load(path: Path, crs: str | None = None, wkt: str | None = None) -> Trajectory:
    return load_trajectory(path, crs=crs, source_crs_wkt=wkt, time_offset=0.0, max_gap=None)


def write_sbet(path: Path, rows: list[tuple[float, float, float, float]]) -> Path:
    values = np.zeros((len(rows), 17))
    values[:, :4] = rows
    path.write_bytes(values.astype("<f8").tobytes())
    return path


def test_sbet_is_projected_and_keeps_altitudes(tmp_path):
    pyproj = pytest.importorskip("pyproj")
    path = write_sbet(
        tmp_path / "drive.sbet",
        [
            (1.0, math.radians(60.1), math.radians(24.9), 31.5),
            (2.0, math.radians(60.2), math.radians(25.0), 32.5),
        ],
    )
    track = load(path, crs=UTM35)
    to_utm = pyproj.Transformer.from_crs("EPSG:4326", UTM35)  # its own axis order: latitude first
    np.testing.assert_allclose(track.xyz_m[0, :2], to_utm.transform(60.1, 24.9), atol=1e-6)
    np.testing.assert_allclose(track.xyz_m[1, :2], to_utm.transform(60.2, 25.0), atol=1e-6)
    np.testing.assert_array_equal(track.xyz_m[:, 2], [31.5, 32.5])
    from_wkt = load(path, wkt=pyproj.CRS(UTM35).to_wkt())
    np.testing.assert_array_equal(from_wkt.xyz_m, track.xyz_m)
    of_3d = load(path.rename(tmp_path / "drive.out"), wkt=pyproj.CRS(UTM35).to_3d().to_wkt())
    np.testing.assert_array_equal(of_3d.xyz_m, track.xyz_m)


@pytest.mark.parametrize("version", ["WKT1_GDAL", "WKT2_2019"])
def test_heights_of_another_kind_never_pass_in_silence(tmp_path, version):
    pyproj = pytest.importorskip("pyproj")
    path = write_sbet(tmp_path / "drive.sbet", SOUND)
    wkt = pyproj.CRS("EPSG:3067+5717").to_wkt(version)
    with pytest.raises(ConfigError, match="heights of its own") as caught:
        load(path, wkt=wkt)
    assert "set trajectory_crs = EPSG:3067 if" in caught.value.hint
    # what the hint says is enough, although the points' file still says the other
    np.testing.assert_array_equal(load(path, crs="EPSG:3067", wkt=wkt).xyz_m[:, 2], [3.0, 3.0])


SOUND = [(0.0, 1.0, 0.4, 3.0), (1.0, 1.0, 0.4, 3.0)]


def test_a_coordinate_system_that_nobody_knows(tmp_path):
    pytest.importorskip("pyproj")
    with pytest.raises(ConfigError, match="'nonsense' cannot be used"):
        load(write_sbet(tmp_path / "drive.sbet", SOUND), crs="nonsense")


def test_sbet_without_pyproj_names_the_remedy(tmp_path, monkeypatch):
    plain_import = builtins.__import__

    def no_pyproj(name: str, *args: Any) -> Any:
        if name.startswith("pyproj"):
            raise ModuleNotFoundError(name)
        return plain_import(name, *args)

    monkeypatch.setattr(builtins, "__import__", no_pyproj)
    with pytest.raises(ConfigError, match=r"pip install .\.\[crs\]."):
        load(write_sbet(tmp_path / "drive.sbet", SOUND), crs=UTM35)
