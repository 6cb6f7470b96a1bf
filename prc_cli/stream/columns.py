"""Which column of its line a shot is: one pure function a rule.

All work on shots (the first record of each) of one scanner. A column outside 0 to M - 1 is returned as it is
found: the caller counts it. :data:`NO_COLUMN` stands for shots without one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64, I64, Mask

NO_COLUMN = -1
MAX_COLUMN = 10_000_000
"""Columns beyond are taken for none; as many as ``points_per_line`` may be."""


@dataclass(frozen=True, slots=True)
class StampState:
    """What the next chunk must know of the time stamps before it."""

    last_s: float = math.nan
    """Last time stamp [s]."""
    n_equal: int = 0
    """Shots so far that have it."""


def spread_stamps(time_s: F64, shot_hz: float, state: StampState) -> tuple[F64, I64, StampState]:
    """Spread shots that share a time stamp over the shots that follow it.

    Many files round times more coarsely than the scanner fires; shots of equal stamps were fired one after
    another from there on.

    Parameters
    ----------
    time_s : (n,) float64
        Time stamps of the shots [s].
    shot_hz : float
        Shots a second.
    state : StampState

    Returns
    -------
    spread_s : (n,) float64
        Estimated times [s].
    ordinal : (n,) int64
        Shots before this one with the same stamp.
    state : StampState

    Examples
    --------
    >>> spread_stamps(np.array([1.0, 1.0, 2.0]), 10.0, StampState())[0]
    array([1. , 1.1, 2. ])
    """
    n = len(time_s)
    if not n:
        return time_s, np.empty(0, np.int64), state
    new = np.ones(n, np.bool_)
    new[1:] = time_s[1:] != time_s[:-1]
    carried = state.n_equal if time_s[0] == state.last_s else 0
    position = np.arange(n, dtype=np.int64)
    ordinal = position - np.maximum.accumulate(np.where(new, position, 0))
    if carried:
        first_run = int(np.argmax(new[1:])) + 1 if new[1:].any() else n
        ordinal[:first_run] += carried
    state = replace(state, last_s=float(time_s[-1]), n_equal=int(ordinal[-1]) + 1)
    return time_s + ordinal / shot_hz, ordinal, state


def columns_by_dimension(number: NDArray[Any]) -> I64:
    """Take columns from the input; what is no whole number from 0 on is none."""
    if number.dtype.kind in "iu" and number.dtype.itemsize <= 4:
        column = number.astype(np.int64)
        if not is_within(column, MAX_COLUMN):
            column[(column < 0) | (column >= MAX_COLUMN)] = NO_COLUMN
        return column
    value = np.asarray(number, np.float64)
    with np.errstate(invalid="ignore"):
        whole = (value >= 0) & (value < MAX_COLUMN) & (value == np.floor(value))
    return np.where(whole, value, NO_COLUMN).astype(np.int64)


def is_within(number: I64, stop: int) -> bool:
    """Tell whether all numbers are 0 or more and below ``stop``; faster than to look for those that are not.

    >>> is_within(np.array([0, 4]), 5), is_within(np.array([0, 5]), 5), is_within(np.array([-1, 0]), 5)
    (True, False, False)
    """
    return not len(number) or bool(number.min() >= 0 and number.max() < stop)


def columns_by_order(line: I64) -> I64:
    """Count the shots of every line.

    >>> columns_by_order(np.array([4, 4, 4, 7, 7]))
    array([0, 1, 2, 0, 1])
    """
    position = np.arange(len(line), dtype=np.int64)
    return position - np.maximum.accumulate(np.where(begins_line(line), position, 0))


def columns_by_time(spread_s: F64, stamp_s: F64, ordinal: I64, line: I64, shot_hz: float, line_start_s: F64) -> I64:
    """Round the time since the line began to shots; shots with equal stamps stay in strictly rising columns.

    Parameters
    ----------
    spread_s, stamp_s : (n,) float64
        Estimated times and stamps as stored [s].
    ordinal : (n,) int64
        From :func:`spread_stamps`.
    line : (n,) int64
        Line of every shot, not decreasing.
    shot_hz : float
        Shots a second.
    line_start_s : (n,) float64
        Time of column 0 of every shot's line [s].

    Returns
    -------
    (n,) int64
    """
    limit = float(1 << 31)
    with np.errstate(invalid="ignore", over="ignore"):
        column = np.rint((spread_s - line_start_s) * shot_hz)
    column = np.clip(np.where(np.isfinite(column), column, -limit), -limit, limit).astype(np.int64)
    if not ordinal.any():
        return column
    # Rounding may give the last shot of a stamp and the first of the next one the same column: the later moves
    # on. Only there: shots with stamps of their own that meet in a column are a collision.
    head = begins_line(line)
    head[1:] |= (ordinal[1:] == 0) & (ordinal[:-1] == 0)
    head[1:] |= stamp_s[1:] < stamp_s[:-1]
    position = np.arange(len(column), dtype=np.int64)
    apart = np.cumsum(head) << 34
    rising: I64 = np.maximum.accumulate(column - position + apart) - apart + position
    return rising


def line_starts(time_s: F64, line: I64) -> F64:
    """Time of the first shot of every shot's line, (n,) [s]."""
    first = np.maximum.accumulate(np.where(begins_line(line), np.arange(len(line)), 0))
    return time_s[first]


def begins_line(line: I64) -> Mask:
    """Mark the first shot of every line."""
    begins: Mask = np.ones(len(line), np.bool_)
    begins[1:] = line[1:] != line[:-1]
    return begins
