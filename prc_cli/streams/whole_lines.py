"""Collects chunks of records into whole scan lines; open lines are held back, so that chunks do not matter.

Whole lines are sorted by line; all later steps (columns, returns, cells) depend only on whole lines.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from prc_cli.core.errors import InputError, OrderError
from prc_cli.core.stream import ReadTally
from prc_cli.core.types import F64, I64, Mask
from prc_cli.formats.options import InputConfig
from prc_cli.formats.ranges import continues_run, mark_shots
from prc_cli.streams.columns import MAX_COLUMN, StampState, spread_stamps
from prc_cli.streams.lines import LineRule, LineState, find_lines
from prc_cli.streams.table import LINE, ORDINAL, RECORD, SPREAD, START, Table, join, n_rows, take

MAX_CELLS_PER_RECORD = 1000
"""Most cells per record; emptier images have a wrong line or column number."""
MIN_CELLS = 1_000_000
"""Number of cells always allowed."""
SPARE_CELLS = 20_000_000
"""The same while lines are read, when empty lines cost no memory and a second of time at most."""
USUAL_GAP_LINES: int = InputConfig.model_fields["max_gap_lines"].default
"""Default of ``max_gap_lines``; a larger value allows empty cells on purpose."""


def most_cells(n_records: int) -> int:
    """Return the most cells of an image of this many records.

    >>> most_cells(10)
    1010000
    """
    return MIN_CELLS + MAX_CELLS_PER_RECORD * n_records


@dataclass(frozen=True, slots=True)
class CellLimit:
    """Limit for the cells of one scanner while reading."""

    points_per_line: int
    """M."""
    n_known: int
    """Records of the whole input if known, else 0."""
    n_spare: int
    """Cells allowed in addition to those for the records."""

    def most_lines(self, n_seen: I64) -> I64:
        """Return the most lines for these numbers of shots, at least 1, (n,) int64."""
        cells: I64 = self.n_spare + MAX_CELLS_PER_RECORD * np.maximum(n_seen, self.n_known)
        return np.maximum(cells // self.points_per_line, 1)


def cell_limit(points_per_line: int, n_known: int, max_gap_lines: int, *, is_alone: bool) -> CellLimit:
    """Return the limit of one scanner; a larger ``max_gap_lines`` than the default raises it."""
    n_spare = SPARE_CELLS if is_alone else MIN_CELLS
    if max_gap_lines > USUAL_GAP_LINES:
        n_spare += max_gap_lines * points_per_line
    return CellLimit(points_per_line, n_known, n_spare)


@dataclass(frozen=True, slots=True)
class Admission:
    """Rules for lines that go back or jump ahead."""

    where: str
    """File and rule, for messages."""
    max_gap_lines: int
    refuse_back: bool
    """Whether lines that go back by more than the slack are an error (else they are dropped and counted)."""
    slack: int
    """Number of lines before the last that are still open."""
    begins_with_first: bool = True
    """Whether line 0 is the line of the first shot; else shots before line 0 are expected, not late."""
    cells: CellLimit | None = None
    """Limit for the number of lines; None = no limit."""


def admit_lines(line: I64, known: Mask, record: I64, state: LineState, rule: Admission) -> tuple[Mask, LineState]:
    """Mark the shots whose line is still open."""
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
        hint = (
            "split the file there, give --lines angle-wrap or --lines time:HZ, or, where its times go back as well, "
            "--sort-by-time; --trust-order leaves such records unclassified"
        )
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
    """Whether rising lines up to ``last`` need no further check, which holds for nearly every chunk."""
    if last - state.top > rule.max_gap_lines + 1:
        return False
    return rule.cells is None or last < rule.cells.most_lines(np.array([state.n_seen]))[0]


def _check_cells(top: I64, known: Mask, record: I64, state: LineState, limit: CellLimit, where: str) -> None:
    """Refuse lines that are nearly all empty, whose cells could take unlimited time."""
    # both lines and limits only rise: compare the last line with the first limit
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


def check_image(path: str, sizes: dict[int, tuple[int, int, int]], which: str = "") -> None:
    """Refuse an image that is absurdly empty."""
    n_cells = sum(n_lines * n_columns for n_lines, n_columns, _ in sizes.values())
    is_empty = n_cells > most_cells(sum(n_shots for _, _, n_shots in sizes.values()))
    # name the emptiest scanner
    for scanner in sorted(sizes, key=lambda one: -sizes[one][0] * sizes[one][1] + most_cells(sizes[one][2])):
        n_lines, n_columns, n_shots = sizes[scanner]
        if is_empty or n_columns > MAX_COLUMN:
            where = f"{path}: {which} {scanner}" if which else path
            problem = f"{n_lines} lines of {n_columns} columns for {n_shots} shots"
            cause, hint = "a column number is wrong", "give the shots in a scan line: -M NUMBER"
            if n_lines > max(n_shots, n_columns):
                cause, hint = "line numbers or times jump", f"check them, or {hint}"
            raise InputError(where, f"{problem}: {cause}, expected fewer cells", hint)


def check_found_columns(path: str, points_per_line: int, n_records: int | None) -> None:
    """Refuse an M, found or recorded in the file, that is too large for the number of records."""
    most = MAX_COLUMN if n_records is None else min(MAX_COLUMN, most_cells(n_records))
    if points_per_line > most:
        count = "" if n_records is None else f" for {n_records} records"
        problem = f"lines of {points_per_line} columns{count}, expected at most {most}"
        raise InputError(path, problem, "give the shots in a scan line: -M NUMBER")


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
