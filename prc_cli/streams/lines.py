"""Finds where scan lines begin: one pure function per rule; state across chunks is passed in and returned.

All take shots (the first record of each) of one scanner in input order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.types import F64, I64, Mask
from prc_cli.streams.angles import Sweep
from prc_cli.streams.columns import columns_by_dimension
from prc_cli.streams.table import Table

MAX_FILL = 1.05
"""Longest duration of a line in periods: with more, the column number or the rate is wrong."""
_MAX_AHEAD = 10
"""Neighbours more columns apart than this multiple of the typical step are ignored."""
_FEW_EQUAL = 0.995
"""Times count as finer than the time between shots from this share of neighbours with different times on."""


@dataclass(frozen=True, slots=True)
class ShotTiming:
    """Time between shots and between columns."""

    shot_s: float = 0.0
    """Time from shot to shot [s], 0 = unknown."""
    column_s: float = 0.0
    """Time from column to column if the input has column numbers [s], 0 = unknown."""


UNKNOWN = ShotTiming()


def find_timing(time_s: F64, column: I64 | None, line_hz: float, points_per_line: int | None) -> ShotTiming:
    """Find the timing from the first shots.

    >>> find_timing(np.arange(8) * 0.25, np.arange(8) % 4, 1.0, None)
    ShotTiming(shot_s=0.0, column_s=0.25)
    >>> find_timing(np.arange(8) * 0.25, None, 1.0, None)
    ShotTiming(shot_s=0.25, column_s=0.0)
    """
    given_s = 0.0 if points_per_line is None else 1 / (line_hz * points_per_line)
    if column is not None:
        return ShotTiming(given_s, _column_step(time_s, column, 1 / line_hz) or given_s)
    return ShotTiming(given_s or _shot_step(time_s, 1 / line_hz))


def _column_step(time_s: F64, column: I64, period_s: float) -> float:
    """Return the time from column to column, 0 if columns do not grow with time."""
    use = np.isfinite(time_s) & (column >= 0)
    step = np.diff(time_s[use])
    ahead = np.diff(column[use])
    # pairs less than a period apart with growing columns are in the same line
    near = (step >= 0) & (step < period_s)
    forward = near & (ahead > 0)
    if not forward.any() or np.count_nonzero(forward) < np.count_nonzero(near & (ahead < 0)):
        return 0.0
    forward &= ahead <= _MAX_AHEAD * np.median(ahead[forward])
    return float(step[forward].sum() / ahead[forward].sum())


def _shot_step(time_s: F64, period_s: float) -> float:
    """Return the typical time between neighbouring shots, 0 if unknown; rather an underestimate."""
    step = np.diff(time_s[np.isfinite(time_s)])
    step = step[(step >= 0) & (step < period_s)]
    ahead = step[step > 0]
    if not len(ahead):
        return 0.0
    if len(ahead) < _FEW_EQUAL * len(step):
        # shots share time stamps: use the mean
        return float(step[step < 2.5 * np.median(ahead)].mean())
    # shots may be missing between most neighbours: use the shortest fifth
    return float(np.median(ahead[ahead <= 1.5 * np.percentile(ahead, 20)]))


def time_in_line(column: I64, column_s: float, period_s: float) -> F64:
    """Return the time of shots since column 0 of their line."""
    since: F64 = column.astype(np.float64) * column_s
    return np.where((column >= 0) & (since < MAX_FILL * period_s), since, np.nan)


MAX_NUMBER = 2.0**53
"""Line numbers from here on are not exact in float64."""


@dataclass(frozen=True, slots=True)
class LineState:
    """State of a scanner's lines across chunks."""

    top: int = -1
    """Highest line so far; -1 = none."""
    n_seen: int = 0
    """Shots with a line so far."""
    n_late: int = 0
    """Shots whose line was already complete."""
    offset: int | None = None
    """Dimension: number of line 0."""
    n_shots: int = 0
    """Fixed: shots so far."""
    wraps: int = 0
    """Angle wrap: wraps so far."""
    last_angle: float = math.nan
    """Angle wrap: last known angle [rad]."""
    low: float = math.inf
    """Angle wrap: least angle of the line so far [rad]."""
    high: float = -math.inf
    """Angle wrap: greatest angle of the line so far [rad]."""
    last_span: float = 0.0
    """Angle wrap: span of the line before [rad]."""
    origin_s: float | None = None
    """Time: begin of line 0 [s]."""


@dataclass(frozen=True, slots=True)
class NumberedLines:
    """The input has line numbers."""

    dimension: str
    path: str
    """For messages."""


@dataclass(frozen=True, slots=True)
class FixedLines:
    """Every shot is in the input, missing ones too."""

    points_per_line: int


@dataclass(frozen=True, slots=True)
class SweptLines:
    """A line ends where the scan angle jumps back."""

    sweep: Sweep


@dataclass(frozen=True, slots=True)
class TimedLines:
    """Lines begin at a fixed frequency."""

    line_hz: float
    half_shot_s: float
    """Half the time between shots [s], 0 if unknown."""
    origin_s: float | None
    """Time of line 0, column 0 [s]; None = that of the first shot."""
    column_dimension: str | None = None
    """Column dimension, if it gives the time of a shot within its line."""
    column_s: float = 0.0
    """Time from column to column of that dimension [s]."""


LineRule: TypeAlias = NumberedLines | FixedLines | SweptLines | TimedLines


def find_lines(
    shots: Table, time_s: F64 | None, n_shots: int, state: LineState, rule: LineRule
) -> tuple[I64, Mask, LineState]:
    """Find the line of the next shots by a rule."""
    match rule:
        case NumberedLines(dimension, path):
            return lines_by_dimension(shots[dimension], state, f"{path}: {dimension}")
        case FixedLines(points_per_line):
            return lines_fixed(n_shots, points_per_line, state)
        case SweptLines(sweep):
            return lines_by_wrap(shots["angle"], sweep, state)
        case TimedLines():
            time_s = time_s if time_s is not None else np.asarray(shots["time"], np.float64)
            since = None
            if rule.column_dimension is not None:
                column = columns_by_dimension(shots[rule.column_dimension])
                since = time_in_line(column, rule.column_s, 1 / rule.line_hz)
            return lines_by_time(time_s, rule.line_hz, rule.half_shot_s, rule.origin_s, state, since)


def lines_by_dimension(number: NDArray[Any], state: LineState, where: str) -> tuple[I64, Mask, LineState]:
    """Take line numbers from the input; the first one is line 0, skipped numbers are missing lines."""
    if number.dtype.kind in "iu" and number.dtype.itemsize <= 4:
        if state.offset is None and len(number):
            state = replace(state, offset=int(number[0]))
        # fast path: nearly every file has 32-bit numbers
        line = np.subtract(number, np.int64(state.offset or 0), dtype=np.int64)
        return line, np.ones(len(number), np.bool_), state
    value = np.asarray(number, np.float64)
    known = np.isfinite(value)
    value = np.where(known, value, 0.0)
    odd = (value != np.floor(value)) | (np.abs(value) >= MAX_NUMBER)
    if odd.any():
        problem = f"found line number {value[int(np.argmax(odd))]:g}, expected whole numbers"
        raise InputError(where, problem, "name the dimension that counts lines: --lines dimension:NAME")
    line = value.astype(np.int64)
    if state.offset is None and known.any():
        state = replace(state, offset=int(line[int(np.argmax(known))]))
    return line - (state.offset or 0), known, state


def lines_fixed(n_shots: int, points_per_line: int, state: LineState) -> tuple[I64, Mask, LineState]:
    """Begin a line every ``points_per_line`` shots.

    >>> lines_fixed(5, 2, LineState(n_shots=1))[0]
    array([0, 1, 1, 2, 2])
    """
    line = np.arange(state.n_shots, state.n_shots + n_shots, dtype=np.int64) // points_per_line
    return line, np.ones(n_shots, np.bool_), replace(state, n_shots=state.n_shots + n_shots)


def lines_by_wrap(angle: NDArray[Any], sweep: Sweep, state: LineState) -> tuple[I64, Mask, LineState]:
    """Begin a line where the angle jumps back against the sweep by more than half the span.

    The span is the larger one of the ending line and the line before: at the edges of a flight or behind an obstacle,
    lines are much shorter than the longest.

    >>> lines_by_wrap(np.array([0.0, 0.5, 1.0, 0.1, 0.6]), Sweep(1, 1.0, 0.05), LineState())[0]
    array([0, 0, 0, 1, 1])
    """
    value = np.asarray(angle, np.float64)
    position = np.flatnonzero(np.isfinite(value))
    begins = np.zeros(len(value), np.int64)
    if len(position):
        seen = value[position]
        back = sweep.direction * (np.concatenate(([state.last_angle], seen[:-1])) - seen)
        # jumps larger than noise are few: check one by one whether a line ends
        jumps = np.flatnonzero(back > sweep.noise_rad)
        borders = np.concatenate(([0], jumps[jumps > 0]))
        lows, highs = np.minimum.reduceat(seen, borders), np.maximum.reduceat(seen, borders)
        pieces = iter(zip(lows.tolist(), highs.tolist(), strict=True))
        low, high, last_span = state.low, state.high, state.last_span
        if not len(jumps) or jumps[0] > 0:
            first_low, first_high = next(pieces)
            low, high = min(low, first_low), max(high, first_high)
        for jump, size, (piece_low, piece_high) in zip(jumps.tolist(), back[jumps].tolist(), pieces, strict=True):
            if size > 0.5 * max(high - low, last_span):
                begins[position[jump]] = 1
                low, high, last_span = piece_low, piece_high, high - low
            else:
                low, high = min(low, piece_low), max(high, piece_high)
        state = replace(state, last_angle=float(seen[-1]), low=low, high=high, last_span=last_span)
    line = state.wraps + np.cumsum(begins)
    if len(line):
        state = replace(state, wraps=int(line[-1]))
    return line, np.ones(len(value), np.bool_), state


def lines_by_time(
    time_s: F64,
    line_hz: float,
    half_shot_s: float,
    origin_s: float | None,
    state: LineState,
    since_s: F64 | None = None,
) -> tuple[I64, Mask, LineState]:
    """Count line periods from the origin: ``floor((t - t0) * HZ)``."""
    known: Mask = np.isfinite(time_s)
    if state.origin_s is None:
        if origin_s is None and known.any():
            i = int(np.argmax(known))
            origin_s = float(time_s[i])
            if since_s is not None and np.isfinite(since_s[i]):
                origin_s -= float(since_s[i])
        state = replace(state, origin_s=origin_s)
    if state.origin_s is None:
        return np.zeros(len(time_s), np.int64), known, state
    time_s = np.where(known, time_s, state.origin_s)
    # at least two steps of float64: 1.2e-7 s for times of 5e8 s
    guard_s = np.maximum(half_shot_s, 2 * np.spacing(np.maximum(np.abs(time_s), abs(state.origin_s))))
    with np.errstate(over="ignore"):  # misread times may be any number
        turns = np.floor((time_s - state.origin_s + guard_s) * line_hz)
    if since_s is not None:
        turns = np.where(np.isnan(since_s), turns, np.rint((time_s - since_s - state.origin_s) * line_hz))
    return np.clip(turns, -MAX_NUMBER, MAX_NUMBER).astype(np.int64), known, state
