"""Drives over the end of a GPS week."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.stream import ReadTally
from prc_cli.streams.order import WEEK_S, WeekState, unwrap_week
from tests.streams.record_lists import (
    LINE_HZ,
    SHOT_HZ,
    START_S,
    only,
    open_records,
    read,
    scene,
)

BY_TIME: dict[str, Any] = {"lines": f"time:{LINE_HZ}", "columns": f"time:{SHOT_HZ}"}
MIDDLE_S = 11.4 / LINE_HZ
"""From the begin of the scene to the end of the week [s]."""


def wrapped() -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Return the scene, the week ending in its middle."""
    image, records = scene()
    time_s = records["time"] - START_S + WEEK_S - MIDDLE_S
    return image, {**records, "time": np.where(time_s >= WEEK_S, time_s - WEEK_S, time_s)}


@pytest.mark.parametrize("chunk_records", [1, 7, 1000])
@pytest.mark.parametrize("rule", ["time", "column", "angle", "line and time"])
def test_lines_go_on_over_the_end_of_the_week(rule: str, chunk_records: int) -> None:
    image, records = wrapped()
    names, options = {
        "time": ((), BY_TIME),
        "column": (("column",), {"lines": BY_TIME["lines"]}),
        "angle": (("angle",), {"lines": BY_TIME["lines"], "columns": "angle"}),
        "line and time": (("scan_line",), {"columns": BY_TIME["columns"], "points_per_line": image.shape[1]}),
    }[rule]
    stream = open_records(only(records, "range", "time", *names), chunk_records, order="trust", **options)
    whole = read(stream)
    assert whole.tally.n_time_steps_back == 1
    assert whole.tally.n_unplaced == 0
    if rule != "line and time":  # counts from the first return
        assert np.array_equal(whole.range_m, image, equal_nan=True)
        assert whole.tally == ReadTally(n_time_steps_back=1)
    times = np.concatenate([block.time_s[block.records() >= 0] for block in whole.blocks if block.time_s is not None])
    assert np.all(np.diff(times) > 0)


@pytest.mark.parametrize("goes_on", [False, True])
def test_the_trajectory_is_asked_by_the_times_that_it_has(goes_on: bool, tmp_path: Path) -> None:
    image, records = wrapped()
    begin = WEEK_S - MIDDLE_S - 1
    track = [begin, begin + 3] if goes_on else [0.0, 2.0, begin, begin + 1.5]
    rows = "".join(f"{time_s},0,0,0\n" for time_s in track)
    (tmp_path / "drive.csv").write_text("time,x,y,z\n" + rows)
    options = {**BY_TIME, "range": f"trajectory:{tmp_path / 'drive.csv'}", "order": "trust"}
    if not goes_on:
        options["trajectory_max_gap"] = WEEK_S
    whole = read(open_records(only(records, "x", "y", "z", "time"), 50, **options))
    np.testing.assert_allclose(whole.range_m, image, rtol=1e-6)


def test_scanners_that_change_week_a_little_later_stay_together() -> None:
    times = np.array([604_799.0, np.nan, 0.1, 604_799.9, 0.2, np.inf, 604_799.95, 5.0, 90_000.0])
    expected = np.where(times < 100_000, times + WEEK_S, times)
    for size in (1, 2, 9):
        state, found = WeekState(), []
        for first in range(0, len(times), size):
            unwrapped, added, state = unwrap_week(times[first : first + size], state)
            assert np.array_equal(added, unwrapped != times[first : first + size]) or np.isnan(unwrapped).any()
            found.append(unwrapped)
        assert np.array_equal(np.concatenate(found), expected, equal_nan=True)


@pytest.mark.parametrize("back_s", [1.0, 86_400.0, 0.98 * WEEK_S, 1.02 * WEEK_S, 1e300])
def test_other_steps_back_stay(back_s: float) -> None:
    times = np.array([1e6, 1e6 - back_s, 2e6])
    unwrapped, added, _ = unwrap_week(times, WeekState())
    assert unwrapped is times
    assert not added.any()
