"""Tables of records, and the column of every shot: one pure function per rule.

All work on shots (the first record of each) of one scanner. Columns outside 0 to M - 1 are returned
unchanged, for the caller to count; :data:`NO_COLUMN` = none.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.types import F64, I64, Mask
from prc_cli.formats.records import RecordChunk
from prc_cli.streams.steps import ONE, Step

Table: TypeAlias = dict[str, NDArray[Any]]

RECORD = "record index"
LINE = "line index"
START = "shot start"
SPREAD = "spread time"
ORDINAL = "stamp ordinal"
RANGE = "slant range"
XYZ = "sensor xyz"
INTENSITY = "intensity"
"""Computed columns beside the dimensions; the blanks avoid clashes with their names."""


def take(table: Table, index: slice | Mask | I64) -> Table:
    """Return the rows of a table."""
    return {name: column[index] for name, column in table.items()}


def join(tables: list[Table]) -> Table:
    """Return tables of the same columns as one."""
    full = [table for table in tables if table]
    if len(full) <= 1:
        return full[0] if full else {}
    return {name: np.concatenate([table[name] for table in full]) for name in full[0]}


def n_rows(table: Table) -> int:
    """Return the number of rows of a table."""
    return len(table[RECORD]) if table else 0


def table_of(chunk: RecordChunk, names: tuple[str, ...]) -> Table:
    """Return a chunk as a table, with the index of every record."""
    return {**{name: chunk.values[name] for name in names}, RECORD: chunk.records()}


NO_COLUMN = -1
MAX_COLUMN = 10_000_000
"""Largest column; larger numbers mean none. The limit of ``points_per_line``."""
_TURN = 2 * math.pi
_SPREAD_STEPS = 3


@dataclass(frozen=True, slots=True)
class AngleGrid:
    """Columns as steps of the scan angle."""

    start_rad: float
    """Angle of column 0 [rad]."""
    step_rad: float
    """From column to column, signed [rad]."""
    n_columns: int
    """Number of columns in the sector of the lines, or in a whole turn."""
    whole_turn: bool
    is_spread: bool = False
    """Whether one of two neighbours in a column moves to a free column beside.

    Shots are uneven within a turn.
    """

    def angles(self, points_per_line: int) -> F64:
        """Return the scan angle of every column, (M,) [rad]."""
        return self.start_rad + self.step_rad * np.arange(points_per_line, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class ColumnRule:
    """How columns are found: the first of dimension, grid and shot frequency, else by order."""

    dimension: str | None = None
    """Dimension with the column number."""
    grid: AngleGrid | None = None
    """Steps of the scan angle."""
    shot_hz: float | None = None
    """Shots a second."""
    line_hz: float | None = None
    """Lines a second, where lines are found by time."""
    step: Step = ONE
    """Step of the column numbers."""


def find_columns(records: Table, rule: ColumnRule, origin_s: float | None) -> I64:
    """Return the column of every shot of whole lines."""
    starts = records[START]
    shots = records if starts.all() else take(records, starts)
    line: I64 = shots[LINE]
    if rule.dimension is not None:
        return columns_by_dimension(shots[rule.dimension], rule.step)
    if rule.grid is not None:
        column = columns_by_angle(shots["angle"], rule.grid)
        return spread_columns(column, line) if rule.grid.is_spread else column
    if rule.shot_hz is None:
        return np.arange(len(line), dtype=np.int64) - first_of_line(line)
    spread: F64 = shots[SPREAD]
    stamp = np.asarray(shots["time"], np.float64)
    if rule.line_hz is not None and origin_s is not None:
        # subtract the origin first: line / HZ then keeps full resolution in long drives
        spread = spread - origin_s
        start = line / rule.line_hz
    else:
        start = spread[first_of_line(line)]
    return columns_by_time(spread, stamp, shots[ORDINAL], line, rule.shot_hz, start)


@dataclass(frozen=True, slots=True)
class StampState:
    """State of the time stamps across chunks."""

    last_s: float = math.nan
    """Last time stamp [s]."""
    n_equal: int = 0
    """Shots so far with this stamp."""


def spread_stamps(time_s: F64, shot_hz: float, state: StampState) -> tuple[F64, I64, StampState]:
    """Spread shots with equal, coarse time stamps over the time until the next stamp."""
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
    with np.errstate(invalid="ignore"):  # a misread time may be a signalling NaN
        return time_s + ordinal / shot_hz, ordinal, state


def columns_by_dimension(number: NDArray[Any], step: Step = ONE) -> I64:
    """Take column numbers from the input.

    Values that are not whole numbers from 0 on, by steps, mean none.
    """
    if step.size > 1:
        column, is_on_step = step.ordinal(columns_by_dimension(number))
        return np.where(is_on_step & (column >= 0), column, NO_COLUMN)
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
    """Whether all numbers are in [0, ``stop``); faster than a search for exceptions."""
    return not len(number) or bool(number.min() >= 0 and number.max() < stop)


def columns_by_angle(angle: NDArray[Any], grid: AngleGrid) -> I64:
    """Round to the nearest step; angles are equal modulo a turn."""
    value = np.asarray(angle, np.float64)
    known = np.isfinite(value)
    sign = math.copysign(1.0, grid.step_rad)
    away = np.remainder(sign * (np.where(known, value, 0.0) - grid.start_rad), _TURN)
    column = np.rint(away / abs(grid.step_rad)).astype(np.int64)
    n_turn = round(_TURN / abs(grid.step_rad))
    if grid.whole_turn:
        column %= max(n_turn, 1)
    else:
        # split the rest of the turn between both ends: noise before column 0 is -1, not almost a
        # turn
        column = np.where(column > (grid.n_columns + n_turn) / 2, column - n_turn, column)
    return np.where(known, column, NO_COLUMN)


def spread_columns(column: I64, line: I64) -> I64:
    """Move one of two neighbouring shots in one column to the column beside, where that is free.

    >>> spread_columns(np.array([1, 2, 2, 4, 6, 6, 7, 9]), np.array([0, 0, 0, 0, 0, 0, 0, 1]))
    array([1, 2, 3, 4, 5, 6, 7, 9])
    """
    moved = column.copy()
    for _ in range(_SPREAD_STEPS):
        same = np.zeros(len(moved) + 1, np.bool_)
        same[1:-1] = (moved[1:] == moved[:-1]) & (line[1:] == line[:-1])
        if not same.any():
            break
        # the later one forward, where the next shot leaves room
        room = np.ones(len(moved), np.bool_)
        room[:-1] = (moved[1:] != moved[:-1] + 1) | (line[1:] != line[:-1])
        moved[same[:-1] & room & ~same[1:]] += 1
        # else the earlier one back, where the shot before leaves room
        same[1:-1] = (moved[1:] == moved[:-1]) & (line[1:] == line[:-1])
        room[1:] = (moved[:-1] != moved[1:] - 1) | (line[1:] != line[:-1])
        room[0] = True
        chain = same[1:] & room & (moved > 0)
        moved[chain] -= 1
    return moved


def columns_by_time(
    spread_s: F64,
    stamp_s: F64,
    ordinal: I64,
    line: I64,
    shot_hz: float,
    line_start_s: F64,
) -> I64:
    """Round the time since the start of the line to shots.

    Shots with equal stamps get strictly rising columns.
    """
    limit = float(1 << 31)
    with np.errstate(invalid="ignore", over="ignore"):
        column = np.rint((spread_s - line_start_s) * shot_hz)
    column = np.clip(np.where(np.isfinite(column), column, -limit), -limit, limit).astype(np.int64)
    if not ordinal.any():
        return column
    # Rounding may put the last shot of a stamp and the first of the next one into one column: move
    # the later on. Only these: other shots with different stamps in one column are a collision.
    head = begins_line(line)
    head[1:] |= (ordinal[1:] == 0) & (ordinal[:-1] == 0)
    head[1:] |= stamp_s[1:] < stamp_s[:-1]
    position = np.arange(len(column), dtype=np.int64)
    apart = np.cumsum(head) << 34
    rising: I64 = np.maximum.accumulate(column - position + apart) - apart + position
    return rising


def first_of_line(line: I64) -> I64:
    """Return the index of the first shot of the line of every shot, (n,)."""
    return np.maximum.accumulate(np.where(begins_line(line), np.arange(len(line)), 0))


def begins_line(line: I64) -> Mask:
    """Mark the first shot of every line."""
    begins: Mask = np.ones(len(line), np.bool_)
    begins[1:] = line[1:] != line[:-1]
    return begins


MAX_SCANNERS = 256
"""Most scanners in one input; dimensions of more values are not scanner ids."""


def split_scanners(records: Table, scanner: str | None, path: str) -> Iterator[tuple[int, Table]]:
    """Yield the records of every scanner in a chunk, by id, in their order."""
    if scanner is None:
        yield 0, records
        return
    ids = records[scanner]
    if ids.dtype.kind == "f" and not np.all(ids == np.floor(ids)):
        i = int(np.argmin(ids == np.floor(ids)))
        problem = f"record {records[RECORD][i]} has {scanner} {ids[i]}, expected a whole number"
        raise InputError(path, problem, "choose another dimension for --scanner")
    present = np.unique(ids)
    for value in present:
        yield int(value), records if len(present) == 1 else take(records, ids == value)


def check_scanners(n_scanners: int, path: str, scanner: str | None) -> None:
    """Refuse a scanner dimension of too many values."""
    if n_scanners > MAX_SCANNERS:
        problem = f"{scanner} has more than {MAX_SCANNERS} values, expected one a scanner"
        raise InputError(path, problem, "choose another dimension for --scanner, or none")
