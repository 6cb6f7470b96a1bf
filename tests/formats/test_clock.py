"""Times in other units than seconds, and clocks that begin anew at the end of an hour, a day or a
week."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pytest

from prc_cli.core.facts import SourceFacts
from prc_cli.formats.clock import PERIODS_S, with_clock
from prc_cli.formats.records import Reading, RecordChunk


@dataclass
class Times:
    """Records with nothing but times, in chunks."""

    time: np.ndarray
    path: str = "a.las"
    format: str = "LAS"
    dimensions: tuple[str, ...] = ("time",)
    facts: SourceFacts = field(default_factory=SourceFacts)

    @property
    def n_records(self) -> int:
        return len(self.time)

    def with_reading(self, reading: Reading) -> Times:
        return self

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        for first in range(0, len(self.time), 1000):
            part = self.time[first : first + 1000]
            yield RecordChunk(first, {"time": part}, len(part))


def read_times(source: Times, unit: str = "auto") -> tuple[np.ndarray, tuple[str, ...]]:
    clock = with_clock(source, unit)
    times = np.concatenate([chunk.values["time"] for chunk in clock.chunks(("time",))])
    return times, clock.facts.notes


@pytest.mark.parametrize("period_s", PERIODS_S)
def test_a_clock_that_begins_anew_counts_on(period_s: float) -> None:
    wanted = period_s - 0.2 + np.arange(4000) * 1e-4
    swapped = wanted % period_s
    swapped[[1999, 2000]] = swapped[[2000, 1999]]
    times, notes = read_times(Times(swapped))
    wanted[[1999, 2000]] = wanted[[2000, 1999]]
    np.testing.assert_allclose(times, wanted, atol=1e-6)
    assert "starts again" in notes[0]


@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_large_times_are_in_the_unit_that_makes_them_seconds(unit: str, factor: float) -> None:
    seconds = 1.7e9 + np.arange(4000) * 1.25e-5
    detected, notes = read_times(Times(np.rint(seconds * factor)))
    np.testing.assert_allclose(detected, seconds, atol=6e-4)
    assert notes == (f"the times are in {unit} (input.time_unit)",)
    converted, _ = read_times(Times(seconds * factor), unit)
    np.testing.assert_allclose(converted, seconds, atol=1e-3)
