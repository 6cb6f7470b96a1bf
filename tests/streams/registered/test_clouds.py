"""Registered clouds read with ``range = "points"``: their cells, or a refusal."""

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.errors import PrcError
from prc_cli.core.types import F64
from tests.formats.builders import of_points, write_csv, write_las
from tests.profiler import placed
from tests.streams.registered.corridor import LINES_HZ, SHOTS_HZ, make_corridor

CLOUD = make_corridor()
POINTS = load_config(options={"input": {"range": "points"}})


def test_cells_are_those_of_the_raw_stream(tmp_path):
    """Ranges to millimetres, and shots as far from each other as they were fired."""
    order = np.random.default_rng(1).permutation(len(CLOUD.time_s))
    columns = of_points(CLOUD.xyz_m[order], time=CLOUD.time_s[order])
    path = write_las(tmp_path / "drive.laz", columns)
    line, column, range_m, _ = placed(path, POINTS, len(order))
    has_cell = line >= 0
    assert has_cell.mean() > 0.98
    assert np.median(np.abs(range_m - CLOUD.range_m[order])[has_cell]) < 0.005
    cell = line * round(SHOTS_HZ / LINES_HZ) + column
    by_time = np.argsort(order)[has_cell[np.argsort(order)]]
    steps = np.diff(cell[by_time]) - np.diff(CLOUD.shot[order][by_time])
    assert np.mean(steps == 0) > 0.98


def one_plane(time_s: F64, xyz_m: F64) -> tuple[F64, F64]:
    return time_s, xyz_m * [1, 1, 0]


def anywhere(time_s: F64, xyz_m: F64) -> tuple[F64, F64]:
    """Points that no scanner measured."""
    return time_s, np.random.default_rng(2).uniform(-20.0, 20.0, xyz_m.shape)


def coarse_times(time_s: F64, xyz_m: F64) -> tuple[F64, F64]:
    """Times in steps of a hundredth of a second: half a turn."""
    return np.floor(time_s * 100.0) / 100.0, xyz_m


def centimetres(time_s: F64, xyz_m: F64) -> tuple[F64, F64]:
    return time_s, xyz_m * 100.0


def times_of_rows(time_s: F64, xyz_m: F64) -> tuple[F64, F64]:
    """Times that are the numbers of the records after a sort in space."""
    rows = np.lexsort((xyz_m[:, 1], np.floor(xyz_m[:, 0])))
    return np.arange(len(rows)) * 1e-5, xyz_m[rows]


SLOW = [
    pytest.param(spoil, marks=pytest.mark.slow)
    for spoil in (anywhere, times_of_rows, one_plane, centimetres)
]


@pytest.mark.parametrize("spoil", [coarse_times, *SLOW])
def test_what_cannot_be_right_is_refused(tmp_path, spoil):
    time_s, xyz_m = spoil(CLOUD.time_s, CLOUD.xyz_m)
    path = write_las(tmp_path / "cloud.laz", of_points(xyz_m, time=time_s))
    with pytest.raises(PrcError):
        placed(path, POINTS, len(time_s))


def test_a_cloud_without_times_is_refused(tmp_path):
    path = write_csv(tmp_path / "cloud.csv", of_points(CLOUD.xyz_m))
    with pytest.raises(PrcError, match="time"):
        placed(path, POINTS, len(CLOUD.time_s))
