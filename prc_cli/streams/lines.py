"""Reads records into whole scan lines: finds where lines start, and keeps back open lines.

One pure function per rule takes the shots (the first record of each) of one scanner in input order;
state across chunks is passed in and returned. Whole lines are sorted by line; all later steps
(columns, returns, cells) depend only on them, so that chunks do not matter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError, OrderError
from prc_cli.core.stream import ReadTally
from prc_cli.core.types import F64, I64, Mask
from prc_cli.formats.options import InputConfig
from prc_cli.formats.ranges import continues_run, mark_shots
from prc_cli.formats.records import RecordChunk, Source
from prc_cli.streams.angles import Sweep, WrapState, lines_by_wrap
from prc_cli.streams.columns import (
    LINE,
    ORDINAL,
    RECORD,
    SPREAD,
    START,
    StampState,
    Table,
    check_scanners,
    columns_by_dimension,
    join,
    n_rows,
    split_scanners,
    spread_stamps,
    table_of,
    take,
)
from prc_cli.streams.evidence.periods import WEAK_PERIOD, estimate_points_per_line
from prc_cli.streams.head import first_ranges
from prc_cli.streams.order import OrderWatch, RingOrderWatch, fire_in_turns
from prc_cli.streams.rules import GridRules
from prc_cli.streams.steps import ONE, Step

MAX_FILL = 1.05
"""Longest duration of a line in periods: with more, the column number or the rate is wrong."""


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
    wrap: WrapState = field(default_factory=WrapState)
    """Angle wrap: the sweeps so far."""
    origin_s: float | None = None
    """Time: begin of line 0 [s]."""


Found: TypeAlias = tuple[I64, Mask, LineState]
"""Line of every shot, whether it is known, and the state behind them."""


@dataclass(frozen=True, slots=True)
class LineRules:
    """How the lines of one scanner are found.

    They follow a number, a time or an angle if one is set, else a fixed length.
    """

    where: str
    """File and rule, for messages."""
    path: str = ""
    """The file alone."""
    dimension: str | None = None
    """Dimension with the number of the line."""
    line_hz: float | None = None
    """Lines a second."""
    half_shot_s: float = 0.0
    """Half the time between shots [s], 0 if unknown."""
    origin_s: float | None = None
    """Time of line 0, column 0 [s]; None = that of the first shot."""
    column_dimension: str | None = None
    """Column dimension, if it gives the time of a shot within its line."""
    column_s: float = 0.0
    """Time from column to column of that dimension [s]."""
    sweep: Sweep | None = None
    points_per_line: int | None = None
    same_shot: tuple[str, ...] | None = None
    """Dimensions that the returns of a shot share; None = every record is a shot."""
    shot_hz: float | None = None
    """Shots a second, if shots with equal time stamps are to be spread."""
    spent: tuple[str, ...] = ()
    """Dimensions not needed once a record has its line."""
    max_gap_lines: int = 0
    """Most lines that may be missing in a row."""
    refuse_back: bool = False
    """Whether lines that go back by more than the slack are an error, else only counted."""
    slack: int = 0
    """Number of lines before the last that are still open."""
    n_known: int = 0
    """Records of the whole input if known, else 0."""
    n_spare: int | None = None
    """Cells allowed in addition to those for the records; None = any number of lines."""
    step: Step = ONE
    """Step of the line numbers of the dimension."""

    @property
    def begins_with_first(self) -> bool:
        """Whether line 0 is the line of the first shot.

        If not, shots before line 0 are expected, not late.
        """
        return self.origin_s is None or self.dimension is not None


def find_lines(
    shots: Table,
    time_s: F64 | None,
    n_shots: int,
    state: LineState,
    rules: LineRules,
) -> Found:
    """Find the line of the next shots."""
    if rules.dimension is not None:
        return lines_by_dimension(shots[rules.dimension], state, rules.where, rules.step)
    if rules.line_hz is None:
        if rules.sweep is not None:
            line, wrap = lines_by_wrap(shots["angle"], rules.sweep, state.wrap)
            return line, np.ones(len(line), np.bool_), replace(state, wrap=wrap)
        stop = state.n_shots + n_shots
        line = np.arange(state.n_shots, stop, dtype=np.int64) // (rules.points_per_line or 1)
        return line, np.ones(n_shots, np.bool_), replace(state, n_shots=stop)
    time_s = time_s if time_s is not None else np.asarray(shots["time"], np.float64)
    since = None
    if rules.column_dimension is not None:
        column = columns_by_dimension(shots[rules.column_dimension])
        since = column.astype(np.float64) * rules.column_s
        since = np.where((column >= 0) & (since < MAX_FILL * (1 / rules.line_hz)), since, np.nan)
    return lines_by_time(time_s, rules.line_hz, rules.half_shot_s, rules.origin_s, state, since)


def lines_by_dimension(
    number: NDArray[Any],
    state: LineState,
    where: str,
    step: Step = ONE,
) -> Found:
    """Take line numbers from the input; the first one is line 0, skipped numbers are missing lines.

    Numbers are divided by their ``step``; those that are not on it have no line.
    """
    if step.size == 1 and number.dtype.kind in "iu" and number.dtype.itemsize <= 4:
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
        raise InputError(
            where, problem, "name the dimension that counts lines: --lines dimension:NAME"
        )
    line, is_on_step = step.ordinal(value.astype(np.int64))
    known &= is_on_step
    if state.offset is None and known.any():
        state = replace(state, offset=int(line[int(np.argmax(known))]))
    return line - (state.offset or 0), known, state


def lines_by_time(
    time_s: F64,
    line_hz: float,
    half_shot_s: float,
    origin_s: float | None,
    state: LineState,
    since_s: F64 | None = None,
) -> Found:
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
    guard_s = np.maximum(
        half_shot_s, 2 * np.spacing(np.maximum(np.abs(time_s), abs(state.origin_s)))
    )
    with np.errstate(over="ignore"):  # misread times may be any number
        turns = np.floor((time_s - state.origin_s + guard_s) * line_hz)
    if since_s is not None:
        turns = np.where(
            np.isnan(since_s), turns, np.rint((time_s - since_s - state.origin_s) * line_hz)
        )
    return np.clip(turns, -MAX_NUMBER, MAX_NUMBER).astype(np.int64), known, state


MAX_CELLS_PER_RECORD = 1000
"""Most cells per record; emptier images have a wrong line or column number."""
MIN_CELLS = 1_000_000
"""Number of cells always allowed."""
USUAL_GAP_LINES: int = InputConfig.model_fields["max_gap_lines"].default
"""Default of ``max_gap_lines``; a larger value allows empty cells on purpose."""


def most_lines(n_seen: I64, rules: LineRules) -> I64:
    """Return the most lines for these numbers of shots, at least 1, (n,) int64."""
    cells: I64 = (rules.n_spare or 0) + MAX_CELLS_PER_RECORD * np.maximum(n_seen, rules.n_known)
    return np.maximum(cells // (rules.points_per_line or 1), 1)


def admit_lines(
    line: I64,
    known: Mask,
    record: I64,
    state: LineState,
    rules: LineRules,
) -> tuple[Mask, LineState]:
    """Mark the shots whose line is still open."""
    steady = (
        bool(known.all())
        and (not len(line) or line[0] >= max(state.top, 0))
        and not np.any(line[1:] < line[:-1])
    )
    if steady and len(line) and _all_admitted(int(line[-1]), state, rules):
        return known, replace(state, n_seen=state.n_seen + len(line), top=int(line[-1]))
    seen = line if steady else np.where(known, line, np.iinfo(np.int64).min)
    highest = np.concatenate(([state.top], seen))
    if not steady:
        highest = np.maximum.accumulate(highest)
    before = highest[:-1]
    late = (
        np.zeros(len(line), np.bool_)
        if steady
        else known & (seen < np.maximum(before - rules.slack, 0))
    )
    if rules.refuse_back and late.any():
        i = int(np.argmax(late))
        offset = state.offset or 0
        problem = f"goes back from {before[i] + offset} to {line[i] + offset} at record {record[i]}"
        hint = (
            "split the file there, or give --lines angle-wrap, or --lines time:HZ, "
            "or --sort-by-time; --trust-order leaves such records unclassified"
        )
        raise OrderError(
            rules.where, f"{problem}; expected lines in the order they were scanned", hint
        )
    ahead = known & (seen - before > rules.max_gap_lines + 1)
    first_ahead = int(np.argmax(ahead)) if ahead.any() else len(ahead)
    if rules.n_spare is not None:
        _check_cells(highest[1 : first_ahead + 1], known, record, state, rules)
    if first_ahead < len(ahead):
        i = first_ahead
        missing = int(line[i] - before[i] - 1)
        problem = (
            f"{missing} lines are missing before record {record[i]}, "
            f"expected at most {rules.max_gap_lines}"
        )
        hint = "check the line numbers or times there, or raise max_gap_lines"
        raise InputError(rules.where, problem, hint)
    n_late = int(np.count_nonzero(late & ((line >= 0) | rules.begins_with_first)))
    state = replace(
        state, n_seen=state.n_seen + int(np.count_nonzero(known)), n_late=state.n_late + n_late
    )
    return known & ~late, replace(state, top=int(highest[-1]))


def _all_admitted(last: int, state: LineState, rules: LineRules) -> bool:
    """Whether rising lines up to ``last`` need no further check, as in nearly every chunk."""
    if last - state.top > rules.max_gap_lines + 1:
        return False
    return rules.n_spare is None or last < most_lines(np.array([state.n_seen]), rules)[0]


def _check_cells(
    top: I64,
    known: Mask,
    record: I64,
    state: LineState,
    rules: LineRules,
) -> None:
    """Refuse lines that are nearly all empty, whose cells could take unlimited time."""
    # both lines and limits only rise: compare the last line with the first limit
    if len(top) and top[-1] < most_lines(np.array([state.n_seen]), rules)[0]:
        return
    n_seen = state.n_seen + np.cumsum(known[: len(top)])
    empty = top >= most_lines(n_seen, rules)
    if empty.any():
        i = int(np.argmax(empty))
        m = rules.points_per_line
        most = most_lines(n_seen, rules)[i]
        problem = (
            f"{n_seen[i]} shots lie in {top[i] + 1} lines of {m} columns at record {record[i]}"
        )
        hint = (
            "check the line numbers or times there; "
            f"gaps that are meant: max_gap_lines above {USUAL_GAP_LINES}"
        )
        raise InputError(rules.where, f"{problem}, expected at most {most} lines", hint)


MAX_OPEN_RECORDS = 1 << 22
"""Most records of open lines, unless M is larger."""


def max_open(rules: LineRules) -> int:
    """Return the most records of open lines."""
    return max(MAX_OPEN_RECORDS, 4 * (rules.points_per_line or 0))


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
    scanner: int,
    records: Table,
    state: ScanState,
    rules: LineRules,
    *,
    final: bool,
) -> tuple[WholeLines | None, ScanState]:
    """Add the next records of a scanner; return the lines that are complete now."""
    records, starts, state = whole_shots(join([state.tail, records]), state, rules, final=final)
    if n_rows(records):
        records, state = _find_lines(records, starts, state, rules)
        records = {name: column for name, column in records.items() if name not in rules.spent}
    held = (*state.held, records) if n_rows(records) else state.held
    n_held = state.n_held + n_rows(records)
    if n_held > max_open(rules) and not final:
        _check_open(held, state, rules)
    stop = state.lines.top + 1 - (0 if final else 1 + rules.slack)
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
    lines = WholeLines(
        scanner,
        state.n_done,
        stop,
        take(everything, slice(0, cut)),
        state.lines.origin_s,
        state.tally,
    )
    held = (rest,) if n_rows(rest) else ()
    return lines, replace(state, held=held, n_held=n_rows(rest), n_done=stop, tally=ReadTally())


def _check_open(held: tuple[Table, ...], state: ScanState, rules: LineRules) -> None:
    open_from = state.lines.top - rules.slack
    n_open = sum(int(np.count_nonzero(table[LINE] >= open_from)) for table in held)
    if n_open > max_open(rules):
        problem = (
            f"line {state.lines.top} has more than {max_open(rules)} "
            "records and no end, expected scan lines"
        )
        hint = "check the rule that finds the lines: --lines"
        raise InputError(rules.path, problem, hint)


def whole_shots(
    records: Table,
    state: ScanState,
    rules: LineRules,
    *,
    final: bool,
) -> tuple[Table, Mask, ScanState]:
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
        records = take(records, slice(0, last_run))
        starts = starts[:last_run]
        if n_rows(tail) > max_open(rules):
            time_s = tail.get("time", [0])[0]
            problem = (
                f"more than {max_open(rules)} records of several returns share the time {time_s}"
            )
            raise InputError(rules.path, problem, "check time and number_of_returns with prc info")
    return records, starts, replace(state, tail=tail)


def _find_lines(
    records: Table,
    starts: Mask,
    state: ScanState,
    rules: LineRules,
) -> tuple[Table, ScanState]:
    single = bool(starts.all())
    shots = records if single else take(records, starts)
    spread: F64 | None = None
    columns: Table = {}
    if rules.shot_hz is not None:
        stamp = np.asarray(shots["time"], np.float64)
        spread, ordinal, stamps = spread_stamps(stamp, rules.shot_hz, state.stamps)
        state = replace(state, stamps=stamps)
        columns = {SPREAD: spread, ORDINAL: ordinal}
    line, known, line_state = find_lines(shots, spread, n_rows(shots), state.lines, rules)
    admitted, line_state = admit_lines(line, known, shots[RECORD], line_state, rules)
    columns[LINE] = line
    if single:
        records = {**records, **columns, START: starts}
        keep = admitted
    else:
        shot = np.cumsum(starts) - 1
        records = {
            **records,
            **{name: column[shot] for name, column in columns.items()},
            START: starts,
        }
        keep = admitted[shot]
    n_lost = len(keep) - int(np.count_nonzero(keep))
    if n_lost:
        records = take(records, keep)
        state = replace(state, tally=state.tally + ReadTally(n_unplaced=n_lost))
    return records, replace(state, lines=line_state)


MAX_LATE = 0.01
"""Largest share of shots that come after their line is complete."""

LineRulesOf: TypeAlias = Callable[[int], LineRules]
"""Returns the line rules of a scanner."""
Prepare: TypeAlias = Callable[[RecordChunk, Table], tuple[Table, ReadTally]]
"""Adds columns to the table of a chunk."""


def whole_lines(
    source: Source,
    rules: GridRules,
    line_rules: LineRulesOf,
    in_turns: frozenset[int],
    prepare: Prepare | None = None,
) -> Iterator[WholeLines]:
    """Read a source from start to end as whole lines, chronological for each scanner.

    ``in_turns`` are the scanners of :func:`scanners_in_turns`.
    """
    states: dict[int, ScanState] = {}
    watches: dict[int, OrderWatch | RingOrderWatch] = {}
    waiting = ReadTally()
    names = rules.names if prepare is None else tuple(dict.fromkeys((*rules.names, *rules.carried)))
    for chunk in source.chunks(names):
        table = table_of(chunk, rules.names)
        if prepare is not None:
            table, tally = prepare(chunk, table)
            waiting += tally
        for scanner, records in split_scanners(table, rules.scanner, source.path):
            state = states.get(scanner, ScanState())
            if rules.has("time"):
                if scanner not in watches:
                    kind = RingOrderWatch if scanner in in_turns else OrderWatch.of
                    watches[scanner] = kind(source, rules.config.order)
                watch = watches[scanner]
                if isinstance(watch, OrderWatch):
                    waiting += watch.count(records["time"], records[RECORD])
                else:
                    waiting += watch.count(
                        records["time"], records[RECORD], _columns_of(records, rules)
                    )
            tally = state.tally + waiting + ReadTally(n_records=n_rows(records))
            state = replace(state, tally=tally)
            waiting = ReadTally()
            try:
                whole, states[scanner] = advance(
                    scanner, records, state, line_rules(scanner), final=False
                )
            except InputError:
                # jumping lines are often due to records out of order: then report the order
                for watch in watches.values():
                    watch.finish()
                raise
            if whole is not None:
                yield whole
        check_scanners(len(states), source.path, rules.scanner)
    for watch in watches.values():
        watch.finish()
    yield from _last_lines(source, rules, line_rules, states)


TURN_RECORDS = 1 << 16
"""First records that show whether rings fire in turns, for any chunks of the reader."""


def scanners_in_turns(source: Source, rules: GridRules) -> frozenset[int]:
    """Return the scanners whose rings fire in another order than they lie, by the first records."""
    if not rules.has("time") or not (rules.column_dimension or _has_all_shots(rules)):
        return frozenset()
    wanted = ("time", rules.column_dimension, rules.scanner)
    names = tuple(dict.fromkeys(name for name in wanted if name is not None))
    tables: list[Table] = []
    n_records = 0
    for chunk in source.chunks(names):
        tables.append(table_of(chunk, names))
        n_records += chunk.n
        if n_records >= TURN_RECORDS:
            break
    if not n_records:
        return frozenset()
    first = take(join(tables), slice(0, TURN_RECORDS))
    in_turns = []
    for scanner, records in split_scanners(first, rules.scanner, source.path):
        time_s = np.asarray(records["time"], np.float64)
        column = np.asarray(_columns_of(records, rules), np.float64)
        if fire_in_turns(time_s, column):
            in_turns.append(scanner)
    return frozenset(in_turns)


def _has_all_shots(rules: GridRules) -> bool:
    """Return whether records are shots of lines of one length, in the order of their columns."""
    is_plain = (rules.lines, rules.columns) == ("fixed", "order")
    return is_plain and rules.points_per_line is not None and rules.scanner is None


def _columns_of(records: Table, rules: GridRules) -> NDArray[Any]:
    if rules.column_dimension is not None:
        return records[rules.column_dimension]
    return records[RECORD] % (rules.points_per_line or 1)


def _last_lines(
    source: Source,
    rules: GridRules,
    line_rules: LineRulesOf,
    states: dict[int, ScanState],
) -> Iterator[WholeLines]:
    closed: list[WholeLines] = []
    leftover = ReadTally()
    for scanner in sorted(states):
        mine = line_rules(scanner)
        whole, state = advance(scanner, {}, states[scanner], mine, final=True)
        if rules.config.order == "require":
            _check_late(source.path, state)
        if (mine.dimension, mine.line_hz, mine.sweep) == (
            None,
            None,
            None,
        ) and not rules.pads_last_line:
            what = "records" if mine.same_shot is None else "shots"
            check_partial_line(source.path, state.lines.n_shots, mine.points_per_line or 1, what)
        # counts of a scanner without a single line
        leftover += state.tally
        if whole is not None:
            closed.append(whole)
    if not closed:
        raise nothing_placed(source.path)
    closed[0] = replace(closed[0], tally=closed[0].tally + leftover)
    yield from closed


def _check_late(path: str, state: ScanState) -> None:
    """Refuse too many shots of complete lines, as in an earlier drive after a later one."""
    n_late = state.lines.n_late
    n_seen = state.lines.n_seen
    if n_late > MAX_LATE * n_seen:
        problem = f"{n_late} of {n_seen} shots go back to lines before those that they follow"
        hint = "sort with --sort-by-time, or leave them unclassified with --trust-order"
        raise OrderError(path, f"{problem}; expected lines in the order they were scanned", hint)


def check_partial_line(
    path: str,
    n_shots: int,
    points_per_line: int,
    what: str = "records",
    source: Source | None = None,
) -> None:
    """Refuse a last line that is cut short.

    The hint names another M if the ranges of a source repeat with it.
    """
    n_over = n_shots % points_per_line
    if not n_over:
        return
    problem = (
        f"{n_shots} {what} are not a multiple of points_per_line = "
        f"{points_per_line} ({n_over} left over)"
    )
    hint = (
        "check points_per_line (prc info estimates it), or pad the last line: --set "
        'input.partial_line="pad"'
    )
    if source is not None and "range" in source.dimensions:
        period = estimate_points_per_line(first_ranges(source))
        if period.strength >= WEAK_PERIOD and period.points_per_line != points_per_line:
            hint = (
                f"the ranges repeat after {period.points_per_line} shots: "
                f"give -M {period.points_per_line}"
            )
    raise InputError(path, problem, hint)


def nothing_placed(path: str) -> InputError:
    """Return the error of an input without a single line."""
    problem = "no record has a scan line, expected at least one"
    return InputError(
        path, problem, "look at the dimensions with prc info and name the one that counts lines"
    )
