"""Unwraps GPS seconds of the week, which restart on Saturday at midnight, where the order is trusted."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from prc_cli.core.types import F64, Mask
from prc_cli.formats.records import DerivedSource, RecordChunk

WEEK_S = 604_800.0
TOLERANCE = 0.01
"""Tolerance of the step back as a share of a week, for pauses and clock errors."""
ADDED, STEPS = "week added", "week steps"
"""Additional columns of chunks: where a week was added (n,), and the number of week ends (1,)."""


@dataclass(frozen=True, slots=True)
class WeekState:
    """State of the times across chunks."""

    last_s: float = math.nan
    """Last known time, as stored [s]."""
    end_s: float | None = None
    """Time as stored at which the week ended [s]; None = not yet."""


def unwrap_week(time_s: F64, state: WeekState) -> tuple[F64, Mask, WeekState]:
    """Add a week to the times after the first step back of about a week.

    From there on, each time is assumed within half a week of the end of the week, so that scanners of one file stay
    together even if they change week at different records.

    >>> unwrap_week(np.array([604799.5, 0.5, 1.5]), WeekState())[0]
    array([604799.5, 604800.5, 604801.5])
    """
    position = np.flatnonzero(np.isfinite(time_s))
    added: Mask = np.zeros(len(time_s), np.bool_)
    if not len(position):
        return time_s, added, state
    seen = time_s[position]
    begin = 0
    if state.end_s is None:
        before = np.concatenate(([state.last_s], seen[:-1]))
        with np.errstate(over="ignore"):
            ends = np.abs(before - seen - WEEK_S) <= TOLERANCE * WEEK_S
        if not ends.any():
            return time_s, added, replace(state, last_s=float(seen[-1]))
        begin = int(np.argmax(ends))
        state = replace(state, end_s=float(before[begin]))
    end_s = math.inf if state.end_s is None else state.end_s
    added[position[begin:]] = seen[begin:] < end_s - WEEK_S / 2
    return np.where(added, time_s + WEEK_S, time_s), added, replace(state, last_s=float(seen[-1]))


class WeekSource(DerivedSource):
    """A source with unwrapped GPS times; see :func:`unwrap_week`."""

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode; chunks from the end of the week on also have :data:`ADDED` and :data:`STEPS`."""
        state = WeekState()
        for chunk in self.source.chunks(names):
            if "time" not in names:
                yield chunk
                continue
            had_ended = state.end_s is not None
            time_s, added, state = unwrap_week(np.asarray(chunk.values["time"], np.float64), state)
            if state.end_s is None:
                yield chunk
                continue
            values = {**chunk.values, "time": time_s, ADDED: added, STEPS: np.array([0 if had_ended else 1])}
            yield replace(chunk, values=values)


def times_of_trajectory(chunk: RecordChunk, first_s: float) -> F64:
    """Return the times to look up in a trajectory, (n,) [s]."""
    time_s = np.asarray(chunk.values["time"], np.float64)
    added = chunk.values.get(ADDED)
    if added is None:
        return time_s
    stored = np.where(added, time_s - WEEK_S, time_s)
    return np.where(stored >= first_s, stored, time_s)


def week_steps(chunk: RecordChunk) -> int:
    """Return the number of steps back by a week removed from a chunk."""
    return int(chunk.values[STEPS][0]) if STEPS in chunk.values else 0
