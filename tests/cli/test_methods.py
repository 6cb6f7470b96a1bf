"""The fused presets and the sequential-angle classifier on the command line.

Every kind of input, and errors.
"""

import os
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.classes import ClassCodes
from tests.formats.organised_files import ptx_scan, write_text
from tests.simulated import static_arrays

Array = np.ndarray


@cache
def points() -> tuple[Array, Array, Array]:
    """Points x, y, z, intensity (lines, M, 4) of a scan, all zero where missing.

    Elevations [deg]; reference codes.
    """
    block, labels = static_arrays(0.5, 3.0, 2)
    assert block.beam_rad is not None
    assert block.xyz_m is not None
    xyz: Array = np.nan_to_num(block.xyz_m)
    # as text has them, so that every format holds the same scan
    grid: Array = np.concatenate([xyz, np.full((*labels.shape, 1), 0.5)], axis=2).round(4)
    return grid, np.rad2deg(block.beam_rad) - 90.0, ClassCodes().lookup()[labels]


def npz(folder: Path) -> Path:
    grid, _, _ = points()
    there = np.asarray(grid[..., :3].any(axis=2))
    xyz = np.where(there[..., None], grid[..., :3], np.nan)
    np.savez(folder / "scan.npz", xyz=xyz)
    return folder / "scan.npz"


def ptx(folder: Path) -> Path:
    return write_text(folder / "scan.ptx", ptx_scan(points()[0]))


def ranges_alone(folder: Path) -> Path:
    np.save(folder / "scan.npy", np.full((60, 40), 5.0, np.float32))
    return folder / "scan.npy"


def registered(folder: Path) -> Path:
    """Coordinates of a country's system beside ranges: no origin is known."""
    grid = points()[0][..., :3]
    ranges = np.linalg.norm(grid, axis=2)
    np.savez(
        folder / "scan.npz",
        range_m=np.where(ranges > 0, ranges, np.nan),
        xyz=grid + np.array([3.5e5, 5.7e6, 80]),
    )
    return folder / "scan.npz"


def wrong_shape(folder: Path) -> Path:
    np.savez(folder / "scan.npz", range_m=np.full((60, 40), 5.0), xyz=np.zeros((60, 41, 3)))
    return folder / "scan.npz"


def level(folder: Path) -> Path:
    """A scanner whose lines lie level."""
    angle = np.linspace(-2.0, 2.0, 300)
    xyz = np.stack([np.cos(angle), np.sin(angle), np.full(300, 0.001)], axis=1) * 8.0
    np.savez(folder / "scan.npz", xyz=np.repeat(xyz[None], 80, axis=0))
    return folder / "scan.npz"


REFUSED: list[tuple[Callable[[Path], Path], list[str]]] = [
    (ranges_alone, ["no vertical direction known", "input.nadir"]),
    (registered, ["xyz"]),
    (wrong_shape, ["xyz", "(60, 41, 3)"]),
    (level, ["scan.npz", "lines do not rise"]),
]


@pytest.mark.parametrize("make, words", REFUSED, ids=lambda value: getattr(value, "__name__", ""))
def test_one_clear_line_and_nothing_left(
    prc,
    tmp_path,
    make,
    words,
):
    source = make(tmp_path)
    before = sorted(os.listdir(tmp_path))
    result = prc(f"classify {source} {tmp_path}/labels.npy --preset street-scan")
    assert (result.code, result.out) == (1, ""), result.err
    (line,) = result.err.strip().splitlines()
    assert line.startswith("error: ")
    for word in words:
        assert word in line
    assert sorted(os.listdir(tmp_path)) == before


def two_scans(folder: Path, second: Array) -> Path:
    return write_text(folder / "two.ptx", ptx_scan(points()[0]) + ptx_scan(second))


@pytest.mark.slow
@pytest.mark.parametrize("n_points", [0, 1])
def test_a_scan_of_nothing_does_no_harm_to_the_others(prc, tmp_path, n_points):
    nothing = np.zeros((20, 30, 4))
    nothing[3, 4] = n_points * np.array([3.0, 4.0, 1.0, 0.5])
    source = two_scans(tmp_path, nothing)
    result = prc(f"classify {source} {tmp_path}/labels.npy --preset street-scan")
    assert result.code == 0, result.err
    assert "note: scan 1: no" in result.err
    prc(f"classify {ptx(tmp_path)} {tmp_path}/one.npy --preset street-scan")
    labels = np.load(tmp_path / "labels.npy")
    alone = np.load(tmp_path / "one.npy")
    np.testing.assert_array_equal(labels[: len(alone)], alone)
    assert np.count_nonzero(labels[len(alone) :]) == n_points
    result = prc(f"info {source} --preset street-scan")
    assert result.code == 0, result.err
    assert "scan 1: no" in " ".join(result.out.split())


@pytest.mark.data
def test_cars_of_a_real_street(prc, real_data, tmp_path):
    source = real_data / "oakland" / "oakland_1.csv.gz"
    out = tmp_path / "labels.npy"
    result = prc(f"classify {source} {out} --preset fused --set input.nadir=0")
    assert result.code == 0, result.err
    gates = [word for gate in ("f1.ground=0.99", "f1.car=0.85") for word in ("--fail-under", gate)]
    result = prc(f"evaluate {out} {source} --mapping street_oakland", *gates)
    assert result.code == 0, result.out + result.err
    # the mappings of the papers fold the codes back
    assert prc(f"evaluate {out} {source} --mapping oakland").code == 0


@pytest.mark.parametrize(
    "file, checks",
    [("ros/sick_lms1xx_ros1.bag", ("--set", "input.nadir=0")), ("organised/pumpA.e57", ())],
)
def test_rooms_are_doubted(
    prc,
    tmp_path,
    real_data,
    file,
    checks,
):
    """A laser that turns level in a room, and a pump."""
    output = tmp_path / "labels.npy"
    result = prc(f"classify {real_data}/{file} {output} --preset fused", *checks)
    assert result.code == 4
    assert "indoors" in result.err
    assert not (np.load(output) == 65).any()
