"""Registered clouds of simulated drives, read with ``range = "points"``, beside the streams they
were made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.errors import PrcError
from prc_cli.core.types import F64, I64, Mask
from prc_cli.simulation.settings import load_settings, open_simulation
from tests.formats.builders import of_points, write_csv, write_las
from tests.profiler import placed

N_LINES = 160
POINTS_PER_LINE = 720
LINE_HZ = 48.0
SEED = 5201
PLACE_M = np.array([650_000.0, 6_860_000.0, 40.0])
CLOCK_S = 3.0e8


@dataclass(frozen=True)
class Cloud:
    """Points and the cells that they were measured in."""

    xyz_m: F64
    time_s: F64
    line: I64
    column: I64
    range_m: F64

    def take(self, index: I64 | Mask) -> Cloud:
        return Cloud(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


@cache
def drive(speed_m_s: float = 8.0) -> Cloud:
    """A drive down a street, in the order of the shots."""
    scanner = {"points_per_line": POINTS_PER_LINE, "line_hz": LINE_HZ}
    options = {
        "seed": SEED,
        "lines": N_LINES,
        "scanner": scanner,
        "trajectory": {"speed_m_s": speed_m_s},
    }
    settings = load_settings("street", options=options)
    items = list(open_simulation("street", settings, threads=1, with_world=True).scan.simulated())
    blocks = [item.labelled.block for item in items]
    range_m = np.concatenate([block.range_m for block in blocks])
    world_m = np.concatenate([item.world_m for item in items if item.world_m is not None])
    time_s = np.concatenate([block.time_s for block in blocks if block.time_s is not None])
    line, column = np.nonzero(np.isfinite(range_m))
    xyz_m = np.round(world_m[line, column] + PLACE_M, 3)
    return Cloud(
        xyz_m,
        time_s[line, column] + CLOCK_S,
        line,
        column,
        range_m[line, column].astype(np.float64),
    )


def shuffled(cloud: Cloud) -> Cloud:
    return cloud.take(np.random.default_rng(1).permutation(len(cloud.time_s)))


def later(cloud: Cloud, seconds: float) -> Cloud:
    return replace(cloud, time_s=cloud.time_s + seconds)


def both(first: Cloud, second: Cloud) -> Cloud:
    names = Cloud.__dataclass_fields__
    return Cloud(*(np.concatenate([getattr(first, name), getattr(second, name)]) for name in names))


def write(path: Path, cloud: Cloud) -> Path:
    """Write coordinates and times alone."""
    return write_las(path, of_points(cloud.xyz_m, time=cloud.time_s))


def from_points() -> LoadedConfig:
    return load_config(options={"input": {"range": "points"}})


def cells(path: Path, cloud: Cloud) -> tuple[I64, I64, F64]:
    """Line, column and range of every point as they are found."""
    line, column, range_m, _ = placed(write(path, cloud), from_points(), len(cloud.time_s))
    return line, column, range_m


def assert_like_raw(measured: tuple[I64, I64, F64], cloud: Cloud, *, share: float = 0.98) -> None:
    """Ranges to millimetres, and shots of one line in one line, as far from each other as they were
    fired."""
    line, column, range_m = measured
    has_cell = line >= 0
    assert has_cell.mean() > share
    assert np.median(np.abs(range_m - cloud.range_m)[has_cell]) < 0.005
    shift = line[has_cell] - cloud.line[has_cell]
    steps = np.diff(column[has_cell]) - np.diff(cloud.column[has_cell])
    in_line = (np.diff(line[has_cell]) == 0) & (np.diff(cloud.line[has_cell]) == 0)
    # a line may start at another angle: points before it then belong to the line before
    assert np.ptp(shift) <= 1
    assert np.mean(steps[in_line] == 0) > share


def test_cells_are_those_of_the_raw_stream(tmp_path: Path) -> None:
    cloud = drive()
    assert_like_raw(cells(tmp_path / "drive.laz", cloud), cloud)


def test_two_passes_are_two_streams(tmp_path: Path) -> None:
    passes = drive(), later(drive(5.0), 600.0)
    cloud = shuffled(both(*passes))
    line, column, range_m = cells(tmp_path / "passes.laz", cloud)
    is_first = cloud.time_s < CLOCK_S + 300.0
    for of_pass in (is_first, ~is_first):
        by_time = np.flatnonzero(of_pass)[np.argsort(cloud.time_s[of_pass])]
        assert_like_raw((line[by_time], column[by_time], range_m[by_time]), cloud.take(by_time))


def one_plane(cloud: Cloud) -> Cloud:
    """All points on a level plane."""
    flat = cloud.xyz_m.copy()
    flat[:, 2] = PLACE_M[2]
    return replace(cloud, xyz_m=flat)


def anywhere(cloud: Cloud) -> Cloud:
    """Points that no scanner measured."""
    random = np.random.default_rng(2)
    return replace(cloud, xyz_m=PLACE_M + random.uniform(-20.0, 20.0, cloud.xyz_m.shape))


def coarse_times(cloud: Cloud) -> Cloud:
    """Times in steps of a hundredth of a second: half a turn."""
    return replace(cloud, time_s=np.floor(cloud.time_s * 100.0) / 100.0)


def centimetres(cloud: Cloud) -> Cloud:
    return replace(cloud, xyz_m=cloud.xyz_m * 100.0)


def times_of_rows(cloud: Cloud) -> Cloud:
    """Times that are the numbers of the records after a sort in space."""
    part = cloud.take(np.lexsort((cloud.xyz_m[:, 1], np.floor(cloud.xyz_m[:, 0]))))
    return replace(part, time_s=CLOCK_S + np.arange(len(part.time_s)) * 1e-5)


SLOW = [
    pytest.param(spoil, marks=pytest.mark.slow) for spoil in (times_of_rows, one_plane, centimetres)
]


@pytest.mark.parametrize("spoil", [anywhere, coarse_times, *SLOW])
def test_what_cannot_be_right_is_refused_or_doubted(
    tmp_path: Path, spoil: Callable[[Cloud], Cloud]
) -> None:
    path = write(tmp_path / "cloud.laz", spoil(drive()))
    with pytest.raises(PrcError):
        placed(path, from_points(), len(drive().time_s))


def test_a_cloud_without_times_is_refused(tmp_path: Path) -> None:
    cloud = drive()
    path = write_csv(tmp_path / "cloud.csv", of_points(cloud.xyz_m))
    with pytest.raises(PrcError, match="time"):
        placed(path, from_points(), len(cloud.time_s))
