"""Turns whole lines into blocks: one return per cell, the rest as further returns or counted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from prc_cli.core.stream import ExtraReturns, ReadTally, ScanBlock
from prc_cli.core.types import F32, F64, I64
from prc_cli.formats.ranges import ReturnRule, choose_returns
from prc_cli.streams.columns import ColumnRule, find_columns, is_within
from prc_cli.streams.table import INTENSITY, LINE, RANGE, RECORD, START, XYZ, Table, n_rows, take
from prc_cli.streams.whole_lines import WholeLines

MAX_BLOCK_CELLS = 1 << 21
"""Most cells of a block (at least a line): long gaps are cut into several blocks."""


@dataclass(frozen=True, slots=True)
class CellRules:
    """Parameters of the range image of one scanner."""

    points_per_line: int
    """M."""
    columns: ColumnRule
    chosen_return: ReturnRule
    """Which return of a shot the image shows."""
    angle_rad: F64 | None
    """(M,) float64, scan angle of every column [rad]."""
    with_time: bool
    """Whether blocks hold times; likewise below."""
    with_intensity: bool
    with_xyz: bool
    pads_last_line: bool = False
    """Dense records: whether the last line may be padded."""


@dataclass(frozen=True, slots=True)
class _Cells:
    """Records with their cells, sorted by line."""

    records: Table
    line: I64
    column: I64
    stands: np.ndarray
    """(n,) bool, the chosen return of its shot."""


def blocks_of(whole: WholeLines, rules: CellRules) -> Iterator[ScanBlock]:
    """Yield whole lines as blocks of bounded size; the first has the tally."""
    m = rules.points_per_line
    cells, n_unplaced = _place(whole, rules)
    tally = whole.tally + ReadTally(n_unplaced=n_unplaced)
    n_lines = max(MAX_BLOCK_CELLS // m, 1)
    for first in range(whole.first_line, whole.stop_line, n_lines):
        stop = min(first + n_lines, whole.stop_line)
        low, high = np.searchsorted(cells.line, (first, stop))
        part = slice(int(low), int(high))
        piece = _Cells(take(cells.records, part), cells.line[part], cells.column[part], cells.stands[part])
        block = _fill(piece, first, stop - first, rules)
        yield replace(block, scanner=whole.scanner, tally=block.tally + tally)
        tally = ReadTally()


def _place(whole: WholeLines, rules: CellRules) -> tuple[_Cells, int]:
    """Find the cell of every record and choose the returns; records outside the image are dropped and counted."""
    records = whole.records
    if not n_rows(records):
        none = np.empty(0, np.int64)
        return _Cells(records, none, none, np.empty(0, np.bool_)), 0
    starts = records[START]
    column = find_columns(records, rules.columns, whole.origin_s)
    if not starts.all():
        column = column[np.cumsum(starts) - 1]
    stands = choose_returns(
        starts, records[RANGE], records.get(INTENSITY), records.get("return_number"), rules.chosen_return
    )
    n_unplaced = 0
    if not is_within(column, rules.points_per_line):
        inside = (column >= 0) & (column < rules.points_per_line)
        n_unplaced = len(inside) - int(np.count_nonzero(inside))
        records, column, stands = take(records, inside), column[inside], stands[inside]
    return _Cells(records, records[LINE], column, stands), n_unplaced


def _fill(cells: _Cells, first_line: int, n_lines: int, rules: CellRules) -> ScanBlock:
    """Make the block of lines ``first_line`` on; of several shots in a cell, the first with a range is kept."""
    m = rules.points_per_line
    records = cells.records
    range_m: F32 = np.full(n_lines * m, np.nan, np.float32)
    record: I64 = np.full(n_lines * m, -1, np.int64)
    time_s: F64 | None = np.full(n_lines * m, np.nan) if rules.with_time else None
    intensity: F32 | None = np.full(n_lines * m, np.nan, np.float32) if rules.with_intensity else None
    xyz: F32 | None = np.full((n_lines * m, 3), np.nan, np.float32) if rules.with_xyz else None
    extra, tally = ExtraReturns.none(), ReadTally()
    if n_rows(records):
        cell = cells.line - first_line
        cell *= m
        cell += cells.column
        # no choice needed where every record has its own cell
        alone = bool(cells.stands.all()) and bool(np.all(cell[1:] > cell[:-1]))
        own = slice(None) if alone else _winners(cell, cells.stands, records[RANGE], n_lines * m)
        at = cell[own]
        range_m[at], record[at] = records[RANGE][own], records[RECORD][own]
        if time_s is not None:
            time_s[at] = records["time"][own]
        if intensity is not None:
            intensity[at] = records[INTENSITY][own]
        if xyz is not None:
            xyz[at] = records[XYZ][own]
        if len(at) < len(cell):
            other = np.ones(len(cell), np.bool_)
            other[own] = False
            extra = ExtraReturns(
                (cells.line[other] - first_line).astype(np.int32),
                cells.column[other].astype(np.int32),
                records[RANGE][other],
                records[RECORD][other],
            )
            n_collisions = int(np.count_nonzero(other & cells.stands))
            tally = ReadTally(n_collisions=n_collisions, n_extra_returns=len(extra) - n_collisions)
    shape = (n_lines, m)
    return ScanBlock(
        first_line=first_line,
        range_m=range_m.reshape(shape),
        record=record.reshape(shape),
        time_s=None if time_s is None else time_s.reshape(shape),
        xyz_m=None if xyz is None else xyz.reshape(n_lines, m, 3),
        intensity=None if intensity is None else intensity.reshape(shape),
        angle_rad=rules.angle_rad,
        extra=extra,
        tally=tally,
    )


def _winners(cell: I64, stands: np.ndarray, range_m: F32, n_cells: int) -> np.ndarray:
    """Mark the record that every cell shows: the first chosen return with a range, else the first chosen return."""
    winner = np.full(n_cells, -1, np.int64)
    position = np.flatnonzero(stands)
    valid = ~np.isnan(range_m[position])
    for chosen in (position[~valid][::-1], position[valid][::-1]):
        # the last assignment to a cell wins, so assign backwards to keep the first record
        winner[cell[chosen]] = chosen
    own = np.zeros(len(cell), np.bool_)
    own[winner[winner >= 0]] = True
    return own


def dense_block(table: Table, first_line: int, rules: CellRules, tally: ReadTally) -> ScanBlock:
    """Make a block of dense records, one per cell in order, by reshaping."""
    shape = (-1, rules.points_per_line)
    time_s: F64 | None = np.asarray(table["time"], np.float64).reshape(shape) if rules.with_time else None
    intensity: F32 | None = table[INTENSITY].astype(np.float32).reshape(shape) if rules.with_intensity else None
    # padded cells have no record, so the short form would be wrong
    record: I64 | None = table[RECORD].reshape(shape) if rules.pads_last_line else None
    return ScanBlock(
        first_line=first_line,
        range_m=table[RANGE].reshape(shape),
        record=record,
        time_s=time_s,
        intensity=intensity,
        angle_rad=rules.angle_rad,
        tally=tally,
    )


def pad_line(rest: Table, m: int) -> Table:
    """Pad the last line with missing shots."""
    padded: Table = {}
    for name, column in rest.items():
        filler = np.full(m - len(column), -1 if name == RECORD else np.nan)
        padded[name] = np.concatenate([column, filler.astype(column.dtype if name == RECORD else np.float64)])
    padded[RANGE] = padded[RANGE].astype(np.float32)
    return padded
