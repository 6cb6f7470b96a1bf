"""Starts of lines and columns by every rule."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.options import InputConfig
from prc_cli.streams.angles import WrapState, find_sweep, lines_by_wrap
from prc_cli.streams.columns import (
    StampState,
    spread_stamps,
)
from prc_cli.streams.lines import (
    LineState,
    lines_by_dimension,
)
from prc_cli.streams.rules import _said

NAN = np.nan
WHERE = "drive.laz: scan_line"


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


NAN_COLUMNS, INF = np.nan, np.inf


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


@pytest.mark.parametrize(("origin", "is_told"), [(None, True), (0.5, False)])
def test_the_first_record_begins_the_lines_by_time_unless_told(origin: float | None, is_told: bool) -> None:
    config = InputConfig(lines="time:10", columns="time:100", points_per_line=10, time_origin=origin)
    told = {one.key for one in _said(config, "time:10", "time:100", ())}
    assert ("input.time_origin" in told) == is_told
