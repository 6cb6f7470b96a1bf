"""Starts of lines and columns by every rule."""

from __future__ import annotations

import math

import numpy as np
import pytest

from prc_cli.core.errors import InputError, OrderError
from prc_cli.core.types import F64, I64, Mask
from prc_cli.formats.options import InputConfig
from prc_cli.streams.angles import WrapState, find_angle_grid, find_sweep, lines_by_wrap
from prc_cli.streams.columns import (
    StampState,
    columns_by_angle,
    columns_by_time,
    spread_stamps,
)
from prc_cli.streams.lines import (
    LineRules,
    LineState,
    admit_lines,
    lines_by_dimension,
    lines_by_time,
)
from prc_cli.streams.rules import _said
from prc_cli.streams.setup import UNKNOWN, find_timing

NAN = np.nan
WHERE = "drive.laz: scan_line"
RULE = LineRules(WHERE, max_gap_lines=5, refuse_back=True, slack=1)


def admit(lines: list[int], rule: LineRules = RULE, state: LineState | None = None) -> list[bool]:
    line = np.array(lines, np.int64)
    known: Mask = np.ones(len(line), np.bool_)
    record: I64 = np.arange(100, 100 + len(line))
    return admit_lines(line, known, record, state or LineState(), rule)[0].tolist()  # type: ignore[no-any-return]


@pytest.mark.parametrize(("number", "shown"), [(3.5, "3.5"), (1e18, r"1e\+18"), (-1e300, r"-1e\+300")])
def test_dimension_refuses_what_is_no_line_number(number: float, shown: str) -> None:
    with pytest.raises(InputError, match=rf"scan_line: found line number {shown}, expected whole numbers; .*--lines"):
        lines_by_dimension(np.array([1.0, number]), LineState(), WHERE)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("size", [1, 2, 7, 1000])
def test_wrap_of_a_profiler_with_missing_shots(direction: int, size: int) -> None:
    rng = np.random.default_rng(5)
    line = np.repeat(np.arange(30), 36)
    angle = direction * np.tile(np.deg2rad(np.arange(0, 360, 10.0)), 30)
    keep = rng.random(len(line)) < 0.6
    line, angle = line[keep], angle[keep]
    angle[rng.random(len(angle)) < 0.05] = NAN
    sweep = find_sweep(angle, "drive.laz")
    assert sweep.direction == direction
    found, state = [], WrapState()
    for start in range(0, len(angle), size):
        part, state = lines_by_wrap(angle[start : start + size], sweep, state)
        found.extend(part.tolist())
    # a shot without angle at the end of a line cannot be told from one at its begin
    finite = np.isfinite(angle)
    assert np.array_equal(np.array(found)[finite], line[finite])


def test_wrap_follows_lines_that_become_short() -> None:
    """At the corner of a flight lines shrink from 60 to 1.2 degrees: each is a line."""
    lengths = np.linspace(100, 4, 60).astype(int)
    angle = np.concatenate([-np.arange(n) * 0.6 for n in lengths])
    line, _ = lines_by_wrap(angle, find_sweep(angle, "strip.laz"), WrapState())
    assert np.array_equal(line, np.repeat(np.arange(60), lengths))


def test_sweep_needs_angles_of_one_direction() -> None:
    with pytest.raises(
        InputError, match=r"drive.laz: the scan angle does not vary in 9 shots, expected sweeps; find l"
    ):
        find_sweep(np.zeros(9), "drive.laz")
    with pytest.raises(InputError, match="does not vary in 0 shots"):
        find_sweep(np.full(9, NAN), "drive.laz")
    there_and_back = np.tile(np.concatenate([np.arange(50), 50 - np.arange(50)]), 5)
    with pytest.raises(InputError, match="grows in 25[0-9] steps and falls in 24[0-9], expected sweeps of one direc"):
        find_sweep(there_and_back, "drive.laz")


def test_time_of_a_line_that_rounding_puts_just_before_it() -> None:
    """Times at which lines begin are no decimal fractions: floor alone would lose some to the line before."""
    line = np.arange(2_000_000, dtype=np.int64)[::7]
    start = 318_000.1
    times = start + line / 48.0
    assert np.any(np.floor((times - start) * 48.0) != line)
    for half_shot in (0.0, 0.5e-6):
        assert np.array_equal(lines_by_time(times, 48.0, half_shot, start, LineState())[0], line)


def test_lines_may_go_back_by_the_slack_alone() -> None:
    assert admit([0, 1, 0, 2, 1, 7, 6]) == [True] * 7
    with pytest.raises(OrderError) as caught:
        admit([0, 1, 2, 0], state=LineState(offset=40))
    assert str(caught.value) == (
        "drive.laz: scan_line: goes back from 42 to 40 at record 103; expected lines in the order they were scanned; "
        "split the file there, give --lines angle-wrap or --lines time:HZ, or, where its times go back as well, "
        "--sort-by-time; --trust-order leaves such records unclassified"
    )
    with pytest.raises(OrderError, match="goes back from 9 to 4 at record 100"):
        admit([4], state=LineState(top=9))


NAN_COLUMNS, INF = np.nan, np.inf


def scanner(n_lines: int, m: int, start: float, step: float, missing: float, seed: int = 0) -> tuple[F64, I64, I64]:
    """Return angle, line and column of the shots that are there."""
    rng = np.random.default_rng(seed)
    line, column = np.divmod(np.arange(n_lines * m), m)
    keep = rng.random(len(line)) >= missing
    return (start + step * column)[keep], line[keep], column[keep]


@pytest.mark.parametrize("size", [1, 2, 3, 1000])
def test_equal_stamps_are_spread(size: int) -> None:
    stamps = np.array([1.0, 1.0, 1.0, 2.0, 3.0, 3.0, NAN_COLUMNS, NAN_COLUMNS, 1.0])
    state, spread, ordinals = StampState(), [], []
    for start in range(0, len(stamps), size):
        part, ordinal, state = spread_stamps(stamps[start : start + size], 4.0, state)
        spread.extend(part.tolist())
        ordinals.extend(ordinal.tolist())
    assert ordinals == [0, 1, 2, 0, 0, 1, 0, 0, 0]
    np.testing.assert_array_equal(spread, [1.0, 1.25, 1.5, 2.0, 3.0, 3.25, NAN_COLUMNS, NAN_COLUMNS, 1.0])


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


HZ, M = 48.0, 120
LINE, COLUMN = np.divmod(np.arange(50 * M), M)
TIME = 100 + LINE / HZ + COLUMN / (HZ * M)
SHOT_S = 1 / (HZ * M)


@pytest.mark.parametrize("decimals", [3, 6, 12])
@pytest.mark.parametrize("share", [0.2, 1.0])
def test_columns_tell_their_step(decimals: int, share: float) -> None:
    keep = np.random.default_rng(2).random(len(TIME)) < share
    found = find_timing(np.round(TIME[keep], decimals), COLUMN[keep], HZ, None)
    assert found.shot_s == 0
    assert found.column_s == pytest.approx(SHOT_S, rel=0.02)


def test_shots_tell_their_step() -> None:
    assert find_timing(np.round(TIME, 6), None, HZ, None).shot_s == pytest.approx(SHOT_S, rel=0.01)
    # stamps of six shots and of three returns: the mean
    assert find_timing(np.round(TIME, 3), None, HZ, None).shot_s == pytest.approx(SHOT_S, rel=0.1)
    thin = np.random.default_rng(2).random(len(TIME)) < 0.6
    assert find_timing(TIME[thin], None, HZ, None).shot_s == pytest.approx(SHOT_S)
    assert find_timing(TIME, None, HZ, 60).shot_s == 1 / (HZ * 60)
    for nothing in (np.empty(0), np.full(3, np.nan), np.full(3, 7.0), np.array([0.0, 1.0])):
        assert find_timing(nothing, None, HZ, None) == UNKNOWN


@pytest.mark.parametrize(("origin", "is_told"), [(None, True), (0.5, False)])
def test_the_first_record_begins_the_lines_by_time_unless_told(origin: float | None, is_told: bool) -> None:
    config = InputConfig(lines="time:10", columns="time:100", points_per_line=10, time_origin=origin)
    told = {one.key for one in _said(config, "time:10", "time:100", ())}
    assert ("input.time_origin" in told) == is_told
