"""Columns of shots: each rule by hand, and estimates against known scanners."""

from __future__ import annotations

import math

import numpy as np
import pytest

from prc_cli.core.types import F64, I64
from prc_cli.streams.angles import column_angles, find_angle_grid
from prc_cli.streams.columns import (
    NO_COLUMN,
    AngleGrid,
    StampState,
    columns_by_angle,
    columns_by_dimension,
    columns_by_time,
    spread_stamps,
)

NAN, INF = np.nan, np.inf


def scanner(n_lines: int, m: int, start: float, step: float, missing: float, seed: int = 0) -> tuple[F64, I64, I64]:
    """Return angle, line and column of the shots that are there."""
    rng = np.random.default_rng(seed)
    line, column = np.divmod(np.arange(n_lines * m), m)
    keep = rng.random(len(line)) >= missing
    return (start + step * column)[keep], line[keep], column[keep]


def test_dimension_takes_whole_numbers_from_zero() -> None:
    given = np.array([0, 3, 2.5, NAN, INF, -INF, -1, 1e300, 9_999_999, 1e7])
    n = NO_COLUMN
    assert columns_by_dimension(given).tolist() == [0, 3, n, n, n, n, n, n, 9_999_999, n]
    assert columns_by_dimension(np.array([65_535], np.uint16)).tolist() == [65_535]


def test_angles_are_equal_modulo_a_turn() -> None:
    grid = AngleGrid(math.radians(-90), math.radians(1), 360, whole_turn=True)
    degrees = np.array([-90, 270, -450, -90.4, 269.4, 0, 180, NAN, INF])
    assert columns_by_angle(np.deg2rad(degrees), grid).tolist() == [0, 0, 0, 0, 359, 90, 270, NO_COLUMN, NO_COLUMN]


@pytest.mark.parametrize("size", [1, 2, 3, 1000])
def test_equal_stamps_are_spread(size: int) -> None:
    stamps = np.array([1.0, 1.0, 1.0, 2.0, 3.0, 3.0, NAN, NAN, 1.0])
    state, spread, ordinals = StampState(), [], []
    for start in range(0, len(stamps), size):
        part, ordinal, state = spread_stamps(stamps[start : start + size], 4.0, state)
        spread.extend(part.tolist())
        ordinals.extend(ordinal.tolist())
    assert ordinals == [0, 1, 2, 0, 0, 1, 0, 0, 0]
    np.testing.assert_array_equal(spread, [1.0, 1.25, 1.5, 2.0, 3.0, 3.25, NAN, NAN, 1.0])


def test_rounded_stamps_give_the_columns_back() -> None:
    """A clock of 3.8 µs behind shots 0.98 µs apart, as in real files: up to 4 shots share a stamp."""
    m, shot_hz, clock = 5000, 1.017e6, 2.0**-18
    line, column = np.divmod(np.arange(3 * m), m)
    true = line * m / shot_hz + column / shot_hz
    stamp = np.floor(true / clock) * clock
    spread, ordinal, _ = spread_stamps(stamp, shot_hz, StampState())
    found = columns_by_time(spread, stamp, ordinal, line, shot_hz, line * m / shot_hz)
    assert ordinal.max() == 3
    # constant but for the phase of the clock
    assert np.ptp(found[line == 1] - column[line == 1]) <= 1
    for one in range(3):
        assert np.all(np.diff(found[line == one]) > 0)


def test_stamps_of_their_own_may_collide() -> None:
    """Only shots of one stamp are known to follow each other; two stamps in a column are left to be counted."""
    stamp = np.array([0.0, 0.101, 0.102, 0.2])
    spread, ordinal, _ = spread_stamps(stamp, 10.0, StampState())
    assert columns_by_time(spread, stamp, ordinal, np.zeros(4, np.int64), 10.0, np.zeros(4)).tolist() == [0, 1, 1, 2]
    stamp = np.array([0.0, 0.0, 0.09, 0.5])
    spread, ordinal, _ = spread_stamps(stamp, 10.0, StampState())
    assert columns_by_time(spread, stamp, ordinal, np.zeros(4, np.int64), 10.0, np.zeros(4)).tolist() == [0, 1, 2, 5]

    stamp = np.array([0.0, 0.0, 0.5, 0.51])
    spread, ordinal, _ = spread_stamps(stamp, 10.0, StampState())
    assert columns_by_time(spread, stamp, ordinal, np.zeros(4, np.int64), 10.0, np.zeros(4)).tolist() == [0, 1, 5, 5]


def test_a_time_that_goes_back_is_not_pushed_ahead() -> None:
    stamp = np.array([0.5, 0.5, 0.2, 0.2])
    spread, ordinal, _ = spread_stamps(stamp, 10.0, StampState())
    assert columns_by_time(spread, stamp, ordinal, np.zeros(4, np.int64), 10.0, np.zeros(4)).tolist() == [5, 6, 2, 3]


@pytest.mark.parametrize("missing", [0.0, 0.3, 0.6])
@pytest.mark.parametrize(
    ("m", "start", "step"),
    [(360, 0.0, 1.0), (5099, -180.0, 360 / 5099), (720, 180.0, -0.5), (229, 12.5, 0.5), (827, 31.0, -0.075)],
)
def test_estimated_angles(m: int, start: float, step: float, missing: float) -> None:
    angle, line, column = scanner(40, m, math.radians(start), math.radians(step), missing)
    grid = find_angle_grid(angle, line, "drive.laz")
    assert math.degrees(grid.step_rad) == pytest.approx(step, rel=1e-6)
    assert grid.whole_turn == (m * abs(step) > 350)
    assert grid.n_columns == m
    assert np.array_equal(columns_by_angle(angle, grid), column)
    np.testing.assert_allclose(grid.angles(m), math.radians(start) + math.radians(step) * np.arange(m), atol=1e-6)


def test_column_angles() -> None:
    angle, _, column = scanner(9, 90, math.radians(170), math.radians(4), 0.5)
    wrapped = np.remainder(angle + math.pi, 2 * math.pi) - math.pi
    unseen = ~np.isin(column, [0, 1, 40, 89])
    found = column_angles(wrapped[unseen], column[unseen], 90)
    assert found is not None
    np.testing.assert_allclose(np.diff(found), math.radians(4))
    assert math.cos(found[0] - math.radians(170)) == pytest.approx(1.0)
