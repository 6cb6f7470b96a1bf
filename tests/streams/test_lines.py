"""Starts of scan lines: each rule by hand, across chunks, and errors."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.errors import InputError, OrderError
from prc_cli.core.types import I64, Mask
from prc_cli.streams.angles import WrapState, find_sweep, lines_by_wrap
from prc_cli.streams.lines import (
    LineRules,
    LineState,
    admit_lines,
    lines_by_dimension,
    lines_by_time,
)

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


def test_time_of_absurd_size_is_a_gap() -> None:
    line, known, state = lines_by_time(np.array([0.0, 1e300]), 50.0, 0.0, None, LineState())
    with pytest.raises(InputError, match="lines are missing before record 1, expected at most 5; .*max_gap_lines"):
        admit_lines(line, known, np.arange(2), state, RULE)


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


def test_trusted_lines_that_come_late_are_left_out() -> None:
    trusted = LineRules(WHERE, max_gap_lines=5, refuse_back=False, slack=1)
    assert admit([0, 1, 2, 0, 3, -1, 2], trusted) == [True, True, True, False, True, False, True]
    assert admit([0, -1], trusted) == [True, False]
