"""Collects chunks of records into whole scan lines; open lines are held back, so that chunks do not matter.

Whole lines are sorted by line; all later steps (columns, returns, cells) depend only on whole lines.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ReadTally
from prc_cli.core.types import F64, Mask
from prc_cli.formats.ranges import continues_run, mark_shots
from prc_cli.streams.columns import StampState, spread_stamps
from prc_cli.streams.limits import Admission, admit_lines
from prc_cli.streams.lines import LineRule, LineState, find_lines
from prc_cli.streams.table import LINE, ORDINAL, RECORD, SPREAD, START, Table, join, n_rows, take

MAX_OPEN_RECORDS = 1 << 22
"""Most records of open lines, unless M is larger."""


@dataclass(frozen=True, slots=True)
class LineRules:
    """Parameters of the lines of one scanner."""

    path: str
    """For messages."""
    line: LineRule
    admission: Admission
    same_shot: tuple[str, ...] | None = None
    """Dimensions that the returns of a shot share; None = every record is a shot."""
    shot_hz: float | None = None
    """Shots per second, if shots with equal time stamps are to be spread."""
    points_per_line: int | None = None
    spent: tuple[str, ...] = ()
    """Dimensions not needed once a record has its line."""

    @property
    def max_open(self) -> int:
        """Most records of open lines."""
        return max(MAX_OPEN_RECORDS, 4 * (self.points_per_line or 0))


@dataclass(frozen=True, slots=True)
class ScanState:
    """State of one scanner across chunks."""

    lines: LineState = field(default_factory=LineState)
    stamps: StampState = field(default_factory=StampState)
    tail: Table = field(default_factory=dict)
    """Records of the last shot: its further returns may follow. Empty or a table."""
    held: tuple[Table, ...] = ()
    """Records of open lines."""
    n_held: int = 0
    n_done: int = 0
    """Number of lines already yielded."""
    tally: ReadTally = field(default_factory=ReadTally)
    """Counts for the next lines."""


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


def advance(
    scanner: int, records: Table, state: ScanState, rules: LineRules, *, final: bool
) -> tuple[WholeLines | None, ScanState]:
    """Add the next records of a scanner; return the lines that are complete now."""
    records, starts, state = whole_shots(join([state.tail, records]), state, rules, final=final)
    if n_rows(records):
        records, state = _find_lines(records, starts, state, rules)
        records = {name: column for name, column in records.items() if name not in rules.spent}
    held = (*state.held, records) if n_rows(records) else state.held
    n_held = state.n_held + n_rows(records)
    if n_held > rules.max_open and not final:
        _check_open(held, n_held, state, rules)
    stop = state.lines.top + 1 - (0 if final else 1 + rules.admission.slack)
    if stop <= state.n_done:
        return None, replace(state, held=held, n_held=n_held)
    everything = join(list(held))
    line = everything[LINE]
    if np.any(line[1:] < line[:-1]):
        everything = take(everything, np.argsort(line, kind="stable"))
        line = everything[LINE]
    cut = int(np.searchsorted(line, stop))
    # copies: views would keep whole chunks in memory
    rest = {name: column[cut:].copy() for name, column in everything.items()}
    lines = WholeLines(scanner, state.n_done, stop, take(everything, slice(0, cut)), state.lines.origin_s, state.tally)
    held = (rest,) if n_rows(rest) else ()
    return lines, replace(state, held=held, n_held=n_rows(rest), n_done=stop, tally=ReadTally())


def _check_open(held: tuple[Table, ...], n_held: int, state: ScanState, rules: LineRules) -> None:
    """Refuse lines that are too long to hold in memory."""
    open_from = state.lines.top - rules.admission.slack
    n_open = sum(int(np.count_nonzero(table[LINE] >= open_from)) for table in held)
    if n_open > rules.max_open:
        problem = f"line {state.lines.top} has more than {rules.max_open} records and no end, expected scan lines"
        hint = "check the rule that finds the lines: --lines"
        raise InputError(rules.path, problem, hint)


def whole_shots(records: Table, state: ScanState, rules: LineRules, *, final: bool) -> tuple[Table, Mask, ScanState]:
    """Mark the shots; hold back the last ones if returns may follow."""
    n = n_rows(records)
    if rules.same_shot is None or not n:
        return records, np.ones(n, np.bool_), replace(state, tail={})
    n_returns = records["number_of_returns"]
    continues = continues_run(tuple(records[name] for name in rules.same_shot), n_returns)
    starts = mark_shots(continues, records.get("return_number"))
    tail: Table = {}
    if not final and n_returns[-1] > 1:
        last_run = int(np.flatnonzero(~continues)[-1])
        tail = {name: column[last_run:].copy() for name, column in records.items()}
        records, starts = take(records, slice(0, last_run)), starts[:last_run]
        if n_rows(tail) > rules.max_open:
            problem = f"more than {rules.max_open} records of several returns share the time {tail.get('time', [0])[0]}"
            raise InputError(rules.path, problem, "check time and number_of_returns with prc info")
    return records, starts, replace(state, tail=tail)


def _find_lines(records: Table, starts: Mask, state: ScanState, rules: LineRules) -> tuple[Table, ScanState]:
    """Find the line of every record; drop and count those without."""
    single = bool(starts.all())
    shots = records if single else take(records, starts)
    spread: F64 | None = None
    found: Table = {}
    if rules.shot_hz is not None:
        stamp = np.asarray(shots["time"], np.float64)
        spread, ordinal, stamps = spread_stamps(stamp, rules.shot_hz, state.stamps)
        state = replace(state, stamps=stamps)
        found = {SPREAD: spread, ORDINAL: ordinal}
    line, known, line_state = find_lines(shots, spread, n_rows(shots), state.lines, rules.line)
    admitted, line_state = admit_lines(line, known, shots[RECORD], line_state, rules.admission)
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
    found = np.unique(ids)
    for value in found:
        yield int(value), records if len(found) == 1 else take(records, ids == value)
