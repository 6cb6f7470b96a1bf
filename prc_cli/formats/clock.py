"""Clocks of records and of trajectories: units other than seconds, and clocks that restart.

GPS receivers count the seconds of the week, some scanners the seconds of the day or of the hour. In
a drive across the end of such a period the times fall by the whole period. prc adds the period to
all later times.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from prc_cli.core.facts import SourceFacts
from prc_cli.core.types import F64
from prc_cli.formats.options import FACTORS
from prc_cli.formats.records import RecordChunk, Source, filtered

PERIODS_S = {3600.0: "hour", 86400.0: "day", 604800.0: "GPS week"}
"""Times after which clocks restart [s]."""
NEAR_S = 60.0
"""The last time of a period and the first time of the next are this close to its end [s]."""
LATEST_S = 1e10
"""Largest time in seconds: 300 years since any epoch [s]."""
SLOWEST_SHOT_S = 0.01
"""Longest time between shots of a scanner [s]."""
LEAST_COUNT = 5.0
"""Whole numbers that rise by less from record to record may be record numbers."""
_STEPS = 1000
"""Records over which the mean step is measured."""
_UNITS = ("ms", "us", "ns")


def unit_of(time: F64) -> str:
    """Return the unit of times by their size and their steps; ``s`` if they can be seconds.

    >>> unit_of(np.arange(1.7e18, 1.7e18 + 5e9, 1e6)), unit_of(np.arange(0.0, 2.0, 1e-4))
    ('ns', 's')
    """
    known = time[np.isfinite(time)]
    if len(known) < 2:
        return "s"
    size = float(np.median(np.abs(known)))
    n = min(_STEPS, len(known) - 1)
    step = float(np.median(np.abs(known[n:] - known[:-n]))) / n
    is_whole = bool((known == np.rint(known)).all())
    if size <= LATEST_S and step <= SLOWEST_SHOT_S:
        return "s"
    for unit in _UNITS:
        factor = FACTORS[unit]
        if size * factor <= LATEST_S and step * factor <= SLOWEST_SHOT_S:
            is_count = step > LEAST_COUNT and is_whole
            return unit if size > LATEST_S or is_count else "s"
    return "s"


def unit_of_positions(time: F64) -> str:
    """Return the unit of the times of a trajectory by their size: its steps have any length.

    >>> unit_of_positions(np.array([1.7e15, 1.7e15 + 1e4]))
    'us'
    """
    size = float(np.median(np.abs(time))) if len(time) else 0.0
    return next((unit for unit in ("s", *_UNITS) if size * FACTORS[unit] <= LATEST_S), "s")


@dataclass(slots=True)
class Unwrapped:
    """Adds a period to all times after a restart of the clock."""

    added_s: float = 0.0
    """Whole periods since the start [s]."""
    n: int = 0
    """Number of restarts."""
    name: str = ""
    """The period."""
    _last: float = np.nan

    def put(self, time_s: F64) -> F64:
        """Return the next times with all periods added, (n,) float64 [s].

        >>> Unwrapped().put(np.array([3599.5, 3599.9, 0.2])).tolist()
        [3599.5, 3599.9, 3600.2]
        """
        before = np.concatenate([[self._last], time_s[:-1]])
        with np.errstate(invalid="ignore"):
            steps = time_s - before
            jumps = np.flatnonzero(np.abs(steps) > min(PERIODS_S) - 2 * NEAR_S)
        if len(time_s):
            self._last = float(time_s[-1])
        turns: F64 = np.zeros(len(time_s))
        for jump in jumps:
            turns[jump] = self._turn(float(before[jump]), float(time_s[jump]))
        if not self.added_s and not turns.any():
            return time_s
        added = self.added_s + np.cumsum(turns)
        self.added_s = float(added[-1])
        counted: F64 = time_s + added
        return counted

    def _turn(self, before_s: float, after_s: float) -> float:
        """Return the period to add after a jump [s]; negative to take one back, else 0."""
        for period_s, name in PERIODS_S.items():
            if period_s - NEAR_S < before_s <= period_s and 0 <= after_s < NEAR_S:
                self.n += 1
                self.name = name
                return period_s
            # neighbours that were swapped at the end of a period
            if self.n and period_s - NEAR_S < after_s <= period_s and 0 <= before_s < NEAR_S:
                self.n -= 1
                return -period_s
        return 0.0


def with_clock(source: Source, time_unit: str = "auto") -> Source:
    """Return a source whose times are seconds and do not restart; as it is without times.

    A note on a restart is in its facts once the restart was read.
    """
    if "time" not in source.dimensions:
        return source
    unit = time_unit
    if unit not in FACTORS:
        first = next(iter(source.chunks(("time",))), None)
        unit = "s" if first is None else unit_of(np.asarray(first.values["time"], np.float64))
    factor = FACTORS[unit]
    last_clock = Unwrapped()

    def chunks(names: tuple[str, ...], stored: Source) -> Iterator[RecordChunk]:
        nonlocal last_clock
        if "time" not in names:
            yield from stored.chunks(names)
            return
        last_clock = clock = Unwrapped()
        for chunk in stored.chunks(names):
            time_s = np.asarray(chunk.values["time"], np.float64)
            counted = clock.put(time_s * factor if factor != 1.0 else time_s)
            if counted is time_s:
                yield chunk
            else:
                yield replace(chunk, values={**chunk.values, "time": counted})

    def facts_of(facts: SourceFacts) -> SourceFacts:
        notes = list(facts.notes)
        if unit != "s":
            notes.append(f"the times are in {unit} (input.time_unit)")
        if last_clock.n:
            end = f"the end of the {last_clock.name}"
            notes.append(f"the clock starts again at {end}: prc continues the times")
        return replace(facts, notes=tuple(notes))

    return filtered(source, chunks, facts_of=facts_of)
