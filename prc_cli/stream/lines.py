"""Where scan lines begin: one pure function a rule, what crosses chunks is passed in and returned.

All work on shots (the first record of each), in the order of the input, for one scanner.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError, OrderError
from prc_cli.core.types import F64, I64, Mask
from prc_cli.stream.limits import USUAL_GAP_LINES, CellLimit

MAX_NUMBER = 2.0**53
"""Line numbers at or beyond cannot be told apart as float64."""
MIN_AGREEMENT = 0.75
"""Share of steps of the scan angle that must go the same way."""


@dataclass(frozen=True, slots=True)
class LineState:
    """What the next chunk of a scanner must know of the shots before it."""

    top: int = -1
    """Highest line so far; -1 = none."""
    n_seen: int = 0
    """Shots with a line so far."""
    n_late: int = 0
    """Those of them whose line had left already."""
    offset: int | None = None
    """Dimension: line number that is line 0."""
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
class Sweep:
    """How the scan angle runs within a line."""

    direction: int
    """+1 = the angle grows from shot to shot, -1 = it falls."""
    span_rad: float
    """Angle between the ends of the longest lines [rad]."""
    noise_rad: float
    """Angles may go back by this much within a line [rad]."""


def lines_by_dimension(number: NDArray[Any], state: LineState, where: str) -> tuple[I64, Mask, LineState]:
    """Take line numbers from the input; the first one is line 0, skipped numbers are missing lines.

    Parameters
    ----------
    number : (n,) float or integer
        Line numbers as stored; NaN and infinite = none.
    state : LineState
    where : str
        File and dimension, for messages.

    Returns
    -------
    line : (n,) int64
        Line of every shot (may be below 0 where numbers go back).
    known : (n,) bool
        False where the shot has no line.
    state : LineState

    Raises
    ------
    InputError
        When a number is not whole or absurdly large.
    """
    if number.dtype.kind in "iu" and number.dtype.itemsize <= 4:
        if state.offset is None and len(number):
            state = replace(state, offset=int(number[0]))
        # in one pass: nearly every file numbers its lines so
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

    The span is that of the line that ends there or of the one before it, whichever is larger: at the edges of a
    flight or behind an obstacle lines are much shorter than the longest.

    Parameters
    ----------
    angle : (n,) float
        Scan angle [rad]; shots without one stay in the line they stand in.
    sweep : Sweep
        From :func:`find_sweep`.
    state : LineState

    Returns
    -------
    line, known, state
        As :func:`lines_by_dimension`; every shot has a line.

    Examples
    --------
    >>> lines_by_wrap(np.array([0.0, 0.5, 1.0, 0.1, 0.6]), Sweep(1, 1.0, 0.05), LineState())[0]
    array([0, 0, 0, 1, 1])
    """
    value = np.asarray(angle, np.float64)
    position = np.flatnonzero(np.isfinite(value))
    begins = np.zeros(len(value), np.int64)
    if len(position):
        seen = value[position]
        back = sweep.direction * (np.concatenate(([state.last_angle], seen[:-1])) - seen)
        # a jump that is larger than noise ends a line or not: few of them, looked at one by one
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


def find_sweep(angle: NDArray[Any], where: str) -> Sweep:
    """Find direction and span of the sweep from the first shots.

    Parameters
    ----------
    angle : (n,) float
        Scan angles in the order of the input [rad]; NaN is left out.
    where : str
        File, for messages.

    Raises
    ------
    InputError
        When angles do not vary, or run back and forth (an oscillating mirror has no wrap).

    Examples
    --------
    >>> find_sweep(np.tile(np.linspace(1.0, -1.0, 50), 20), "strip.laz")  # doctest: +ELLIPSIS
    Sweep(direction=-1, span_rad=2.0, noise_rad=0.081...)
    """
    value = np.asarray(angle, np.float64)
    value = value[np.isfinite(value)]
    hint = "find lines another way: --lines dimension:NAME, fixed or time:HZ"
    low, high = np.percentile(value, (0.1, 99.9)) if len(value) else (0.0, 0.0)
    span = float(high - low)
    if not span > 0:
        raise InputError(where, f"the scan angle does not vary in {len(value)} shots, expected sweeps", hint)
    step = np.diff(value)
    step = step[np.abs(step) <= 0.5 * span]
    n_up, n_down = int(np.count_nonzero(step > 0)), int(np.count_nonzero(step < 0))
    share = max(n_up, n_down) / max(n_up + n_down, 1)
    if share < MIN_AGREEMENT:
        problem = f"the scan angle grows in {n_up} steps and falls in {n_down}, expected sweeps of one direction"
        raise InputError(where, problem, hint)
    # angles are rounded: a few steps back and forth are no wrap
    noise = max(2 * float(np.median(np.abs(step[step != 0]))) if n_up + n_down else 0.0, 0.01 * span)
    return Sweep(1 if n_up >= n_down else -1, span, noise)


def lines_by_time(
    time_s: F64,
    line_hz: float,
    half_shot_s: float,
    origin_s: float | None,
    state: LineState,
    since_s: F64 | None = None,
) -> tuple[I64, Mask, LineState]:
    """Count line periods from the origin: ``floor((t - t0) * HZ)``.

    Parameters
    ----------
    time_s : (n,) float64
        Times of the shots [s]; NaN and infinite = no line.
    line_hz : float
        Lines a second.
    half_shot_s : float
        Half the time between shots [s], 0 if unknown: shots are on a beat, so one that seems to come just
        before its line (rounded times) is its column 0.
    origin_s : float or None
        Time of line 0, column 0 [s]; None = the first known time, less the time since its line began if known.
    state : LineState
    since_s : (n,) float64, optional
        Time since the line of the shot began where its column tells it, else NaN [s]. Then the line is
        ``rint((t - since - t0) * HZ)``: no rounding of times is near half a line.

    Returns
    -------
    line, known, state
        As :func:`lines_by_dimension`; below 0 before the origin.
    """
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
    # two steps of the stored number at least: 1.2e-7 s for times of 5e8 s
    guard_s = np.maximum(half_shot_s, 2 * np.spacing(np.maximum(np.abs(time_s), abs(state.origin_s))))
    turns = np.floor((time_s - state.origin_s + guard_s) * line_hz)
    if since_s is not None:
        turns = np.where(np.isnan(since_s), turns, np.rint((time_s - since_s - state.origin_s) * line_hz))
    return np.clip(turns, -MAX_NUMBER, MAX_NUMBER).astype(np.int64), known, state


@dataclass(frozen=True, slots=True)
class Admission:
    """What is done with lines that go back or jump ahead."""

    where: str
    """File and rule, for messages."""
    max_gap_lines: int
    refuse_back: bool
    """Whether lines that go back by more than the slack are an error (else they come too late, counted)."""
    slack: int
    """Lines beside the last that are still open."""
    begins_with_first: bool = True
    """Whether line 0 is that of the first shot; else shots before it are expected, not late."""
    cells: CellLimit | None = None
    """How many lines the shots so far may have; None = any number."""


def admit_lines(line: I64, known: Mask, record: I64, state: LineState, rule: Admission) -> tuple[Mask, LineState]:
    """Decide which shots still find their line open.

    Parameters
    ----------
    line : (n,) int64
        Line of every shot.
    known : (n,) bool
        False = the shot has no line.
    record : (n,) int64
        Record index of every shot, for messages.
    state : LineState
        ``top`` is used and updated.
    rule : Admission

    Returns
    -------
    admitted : (n,) bool
    state : LineState

    Raises
    ------
    OrderError
        When lines go back and that is refused.
    InputError
        When more lines are missing in a row than allowed, or nearly all cells so far.
    """
    steady = bool(known.all()) and (not len(line) or line[0] >= max(state.top, 0)) and not np.any(line[1:] < line[:-1])
    if steady and len(line) and _all_admitted(int(line[-1]), state, rule):
        return known, replace(state, n_seen=state.n_seen + len(line), top=int(line[-1]))
    seen = line if steady else np.where(known, line, np.iinfo(np.int64).min)
    highest = np.concatenate(([state.top], seen))
    if not steady:
        highest = np.maximum.accumulate(highest)
    before = highest[:-1]
    late = np.zeros(len(line), np.bool_) if steady else known & (seen < np.maximum(before - rule.slack, 0))
    if rule.refuse_back and late.any():
        i = int(np.argmax(late))
        offset = state.offset or 0
        problem = f"goes back from {before[i] + offset} to {line[i] + offset} at record {record[i]}"
        hint = "sort with --sort-by-time, or leave such records unclassified with --trust-order"
        raise OrderError(rule.where, f"{problem}; expected lines in the order they were scanned", hint)
    ahead = known & (seen - before > rule.max_gap_lines + 1)
    first_ahead = int(np.argmax(ahead)) if ahead.any() else len(ahead)
    if rule.cells is not None:
        _check_cells(highest[1 : first_ahead + 1], known, record, state, rule.cells, rule.where)
    if first_ahead < len(ahead):
        i = first_ahead
        missing = int(line[i] - before[i] - 1)
        problem = f"{missing} lines are missing before record {record[i]}, expected at most {rule.max_gap_lines}"
        hint = "check the line numbers or times there, or raise max_gap_lines"
        raise InputError(rule.where, problem, hint)
    n_late = int(np.count_nonzero(late & ((line >= 0) | rule.begins_with_first)))
    state = replace(state, n_seen=state.n_seen + int(np.count_nonzero(known)), n_late=state.n_late + n_late)
    return known & ~late, replace(state, top=int(highest[-1]))


def _all_admitted(last: int, state: LineState, rule: Admission) -> bool:
    """Tell whether lines that never go back, up to the last, cannot be refused: what nearly every chunk is like."""
    if last - state.top > rule.max_gap_lines + 1:
        return False
    return rule.cells is None or last < rule.cells.most_lines(np.array([state.n_seen]))[0]


def _check_cells(top: I64, known: Mask, record: I64, state: LineState, limit: CellLimit, where: str) -> None:
    """Refuse lines that are nearly all empty: their cells would cost any amount of time."""
    # neither lines nor their limit ever fall: the last line within the first limit settles it
    if len(top) and top[-1] < limit.most_lines(np.array([state.n_seen]))[0]:
        return
    n_seen = state.n_seen + np.cumsum(known[: len(top)])
    empty = top >= limit.most_lines(n_seen)
    if empty.any():
        i = int(np.argmax(empty))
        m, most = limit.points_per_line, limit.most_lines(n_seen)[i]
        problem = f"{n_seen[i]} shots lie in {top[i] + 1} lines of {m} columns at record {record[i]}"
        hint = f"check the line numbers or times there; gaps that are meant: max_gap_lines above {USUAL_GAP_LINES}"
        raise InputError(where, f"{problem}, expected at most {most} lines", hint)
