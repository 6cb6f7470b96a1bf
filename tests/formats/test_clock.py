"""Times in other units than seconds, and clocks that begin anew at the end of an hour, a day or a
week."""

import numpy as np
import pytest

from prc_cli.formats.clock import PERIODS_S, with_clock
from prc_cli.formats.records import Contents, watched_contents
from tests.streams.record_lists import MemorySource


def read_times(time: np.ndarray, unit: str = "auto") -> tuple[np.ndarray, tuple[str, ...]]:
    clock = with_clock(MemorySource({"time": time}), unit)
    times = np.concatenate([chunk.values["time"] for chunk in clock.chunks(("time",))])
    return times, clock.facts.notes


@pytest.mark.parametrize("period_s", PERIODS_S)
def test_a_clock_that_begins_anew_counts_on(period_s):
    wanted = period_s - 0.2 + np.arange(4000) * 1e-4
    swapped = wanted % period_s
    swapped[[1999, 2000]] = swapped[[2000, 1999]]
    times, notes = read_times(swapped)
    wanted[[1999, 2000]] = wanted[[2000, 1999]]
    np.testing.assert_allclose(times, wanted, atol=1e-6)
    assert "starts again" in notes[0]


@pytest.mark.parametrize("unit, factor", [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_large_times_are_in_the_unit_that_makes_them_seconds(unit, factor):
    seconds = 1.7e9 + np.arange(4000) * 1.25e-5
    detected, notes = read_times(np.rint(seconds * factor))
    np.testing.assert_allclose(detected, seconds, atol=6e-4)
    assert notes == (f"the times are in {unit} (input.time_unit)",)
    converted, _ = read_times(seconds * factor, unit)
    np.testing.assert_allclose(converted, seconds, atol=1e-3)


def test_the_bounds_of_records_are_those_of_all_chunks():
    values = {name: np.array([3.0, np.nan, 1.0, 2.0]) + k for k, name in enumerate("xyz")}
    contents = Contents()
    values |= {"time": np.arange(5.0, 9.0), "classification": np.array([2, 6, 2, 2])}
    source = MemorySource(values, chunk_records=2)
    for _ in watched_contents(source, contents):
        pass
    assert contents.bounds_m == {"x": (1.0, 3.0), "y": (2.0, 4.0), "z": (3.0, 5.0)}
    assert contents.time_s == (5.0, 8.0)
    assert contents.classes == {2: 3, 6: 1}
