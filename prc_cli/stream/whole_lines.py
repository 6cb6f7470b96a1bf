"""Chunks of records to whole scan lines: what is still open is held back, so chunking changes nothing.

A table is a dict of arrays of equal length by name. Whole lines leave sorted by line; everything after that
(columns, returns, cells) is a function of whole lines alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ReadTally
from prc_cli.core.types import F64, I64, Mask
from prc_cli.formats.returns import continues_run, mark_shots
from prc_cli.stream import lines as line_rules
from prc_cli.stream.columns import StampState, columns_by_dimension, spread_stamps
from prc_cli.stream.limits import CellLimit
from prc_cli.stream.lines import Admission, LineState, Sweep
from prc_cli.stream.rules import GridRules
from prc_cli.stream.shot_timing import UNKNOWN, Beat, time_in_line

Table: TypeAlias = dict[str, NDArray[Any]]

RECORD, LINE, START, SPREAD, ORDINAL = "record index", "line index", "shot start", "spread time", "stamp ordinal"
"""Columns that are added to the dimensions; the blanks keep them apart."""

MAX_OPEN_RECORDS = 1 << 22
"""Records of open lines held at most where M is not known to be larger."""
SLACK = 1
"""Lines by number or time stay open for one line more: pairs swapped at the border are met in real files."""


@dataclass(frozen=True, slots=True)
class LineRules:
    """What one scanner's lines depend on."""

    rules: GridRules
    points_per_line: int | None
    sweep: Sweep | None
    beat: Beat = UNKNOWN
    cells: CellLimit | None = None
    """None = where no cells are made."""
    spent: tuple[str, ...] = ()
    """Dimensions that nobody asks for once a record has its line."""

    @property
    def slack(self) -> int:
        """Lines beside the last that stay open."""
        return SLACK if self.rules.lines in ("dimension", "time") else 0

    @property
    def max_open(self) -> int:
        """Most records of open lines."""
        return max(MAX_OPEN_RECORDS, 4 * (self.points_per_line or 0))


@dataclass(frozen=True, slots=True)
class ScanState:
    """Everything of one scanner that crosses chunks."""

    lines: LineState = field(default_factory=LineState)
    stamps: StampState = field(default_factory=StampState)
    tail: Table = field(default_factory=dict)
    """Records of the last shot: its further returns may follow. Empty or a table."""
    held: tuple[Table, ...] = ()
    """Records of open lines."""
    n_held: int = 0
    n_done: int = 0
    """Lines that have left."""
    tally: ReadTally = field(default_factory=ReadTally)
    """Counts that no line has taken along yet."""


@dataclass(frozen=True, slots=True)
class WholeLines:
    """Lines ``first_line`` to ``stop_line`` (exclusive) of one scanner, with all their records."""

    scanner: int
    first_line: int
    stop_line: int
    records: Table
    """Sorted by line; with the columns :data:`RECORD`, :data:`LINE` and :data:`START`."""
    origin_s: float | None
    """Time of line 0 [s] where lines are found by time."""
    tally: ReadTally


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


def advance(
    scanner: int, records: Table, state: ScanState, rules: LineRules, *, final: bool
) -> tuple[WholeLines | None, ScanState]:
    """Take the next records of a scanner; return the lines that are whole by now.

    Parameters
    ----------
    scanner : int
        Its id.
    records : Table
        The dimensions of ``rules.rules.names`` and :data:`RECORD`, and anything that goes along.
    state : ScanState
    rules : LineRules
    final : bool
        Whether nothing follows.

    Raises
    ------
    OrderError, InputError
        See :mod:`prc_cli.stream.lines`; also when a line never ends.
    """
    records, starts, state = whole_shots(join([state.tail, records]), state, rules, final=final)
    if n_rows(records):
        records, state = _find_lines(records, starts, state, rules)
        records = {name: column for name, column in records.items() if name not in rules.spent}
    held = (*state.held, records) if n_rows(records) else state.held
    n_held = state.n_held + n_rows(records)
    if n_held > rules.max_open and not final:
        _check_open(held, n_held, state, rules)
    stop = state.lines.top + 1 - (0 if final else 1 + rules.slack)
    if stop <= state.n_done:
        return None, replace(state, held=held, n_held=n_held)
    everything = join(list(held))
    line = everything[LINE]
    if np.any(line[1:] < line[:-1]):
        everything = take(everything, np.argsort(line, kind="stable"))
        line = everything[LINE]
    cut = int(np.searchsorted(line, stop))
    # copies, or a few open records would keep whole chunks alive
    rest = {name: column[cut:].copy() for name, column in everything.items()}
    lines = WholeLines(scanner, state.n_done, stop, take(everything, slice(0, cut)), state.lines.origin_s, state.tally)
    held = (rest,) if n_rows(rest) else ()
    return lines, replace(state, held=held, n_held=n_rows(rest), n_done=stop, tally=ReadTally())


def _check_open(held: tuple[Table, ...], n_held: int, state: ScanState, rules: LineRules) -> None:
    """Refuse lines without end: they would have to be held in memory."""
    open_from = state.lines.top - rules.slack
    n_open = sum(int(np.count_nonzero(table[LINE] >= open_from)) for table in held)
    if n_open > rules.max_open:
        problem = f"line {state.lines.top} has more than {rules.max_open} records and no end, expected scan lines"
        hint = "check the rule that finds the lines: --lines"
        raise InputError(rules.rules.path, problem, hint)


def whole_shots(records: Table, state: ScanState, rules: LineRules, *, final: bool) -> tuple[Table, Mask, ScanState]:
    """Mark the shots; hold back the last ones if they may go on.

    Returns
    -------
    records : Table
    starts : (n,) bool
        First record of every shot.
    state : ScanState

    Raises
    ------
    InputError
        When the returns of a shot never end.
    """
    n = n_rows(records)
    if not rules.rules.has_returns or not n:
        return records, np.ones(n, np.bool_), replace(state, tail={})
    names = ["time"] if rules.rules.has_time else []
    names += [name for name in (rules.rules.line_dimension, rules.rules.column_dimension) if name is not None]
    n_returns = records["number_of_returns"]
    continues = continues_run(tuple(records[name] for name in names), n_returns)
    starts = mark_shots(continues, records.get("return_number"))
    tail: Table = {}
    if not final and n_returns[-1] > 1:
        last_run = int(np.flatnonzero(~continues)[-1])
        tail = {name: column[last_run:].copy() for name, column in records.items()}
        records, starts = take(records, slice(0, last_run)), starts[:last_run]
        if n_rows(tail) > rules.max_open:
            problem = f"more than {rules.max_open} records of several returns share the time {tail.get('time', [0])[0]}"
            raise InputError(rules.rules.path, problem, "check time and number_of_returns with prc info")
    return records, starts, replace(state, tail=tail)


def _find_lines(records: Table, starts: Mask, state: ScanState, rules: LineRules) -> tuple[Table, ScanState]:
    """Give every record its line; leave out and count those that have none."""
    single = bool(starts.all())
    shots = records if single else take(records, starts)
    n_shots = n_rows(shots)
    spread: F64 | None = None
    found: Table = {}
    if rules.rules.shot_hz is not None:
        stamp = np.asarray(shots["time"], np.float64)
        spread, ordinal, stamps = spread_stamps(stamp, rules.rules.shot_hz, state.stamps)
        state = replace(state, stamps=stamps)
        found = {SPREAD: spread, ORDINAL: ordinal}
    line, known, line_state = _lines_of(shots, n_shots, spread, state.lines, rules)
    path, policy = rules.rules.path, rules.rules.config.order
    dimension = rules.rules.line_dimension
    admission = Admission(
        where=f"{path}: {dimension or 'lines = ' + rules.rules.lines}",
        max_gap_lines=rules.rules.config.max_gap_lines,
        refuse_back=dimension is not None and policy == "require",
        slack=rules.slack,
        begins_with_first=rules.rules.config.time_origin is None or dimension is not None,
        cells=rules.cells,
    )
    admitted, line_state = line_rules.admit_lines(line, known, shots[RECORD], line_state, admission)
    found[LINE] = line
    if single:
        records = {**records, **found, START: starts}
        keep = admitted
    else:
        shot = np.cumsum(starts) - 1
        records = {**records, **{name: column[shot] for name, column in found.items()}, START: starts}
        keep = admitted[shot]
    n_lost = len(keep) - int(np.count_nonzero(keep))
    if n_lost:
        records = take(records, keep)
        state = replace(state, tally=state.tally + ReadTally(n_unplaced=n_lost))
    return records, replace(state, lines=line_state)


def _lines_of(
    shots: Table, n_shots: int, spread: F64 | None, state: LineState, rules: LineRules
) -> tuple[I64, Mask, LineState]:
    """Apply the rule that finds the lines."""
    grid = rules.rules
    if grid.line_dimension is not None:
        return line_rules.lines_by_dimension(shots[grid.line_dimension], state, f"{grid.path}: {grid.line_dimension}")
    if grid.line_hz is not None:
        time_s = spread if spread is not None else np.asarray(shots["time"], np.float64)
        shot_s, since = rules.beat.shot_s, None
        if grid.shot_hz is not None:
            shot_s = 1 / grid.shot_hz
        elif grid.column_dimension is not None and rules.beat.column_s > 0:
            column = columns_by_dimension(shots[grid.column_dimension])
            since = time_in_line(column, rules.beat.column_s, 1 / grid.line_hz)
        return line_rules.lines_by_time(time_s, grid.line_hz, shot_s / 2, grid.config.time_origin, state, since)
    if rules.sweep is not None:
        return line_rules.lines_by_wrap(shots["angle"], rules.sweep, state)
    return line_rules.lines_fixed(n_shots, rules.points_per_line or 1, state)


def split_scanners(records: Table, scanner: str | None, path: str) -> Iterator[tuple[int, Table]]:
    """Yield the records of every scanner in a chunk, by id, in their order.

    Raises
    ------
    InputError
        When an id is not a whole number.
    """
    if scanner is None:
        yield 0, records
        return
    ids = records[scanner]
    if ids.dtype.kind == "f" and not np.all(ids == np.floor(ids)):
        i = int(np.argmin(ids == np.floor(ids)))
        problem = f"record {records[RECORD][i]} has {scanner} {ids[i]}, expected a whole number"
        raise InputError(path, problem, "choose another dimension for --scanner")
    found = np.unique(ids)
    for value in found:
        yield int(value), records if len(found) == 1 else take(records, ids == value)
