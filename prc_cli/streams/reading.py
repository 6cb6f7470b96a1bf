"""The reading loop: splits chunks by scanner, checks their order, yields whole lines."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from prc_cli.core.errors import InputError, OrderError
from prc_cli.core.stream import ReadTally
from prc_cli.core.types import F32
from prc_cli.formats.records import RecordChunk, RecordSource
from prc_cli.streams.evidence.periods import MAX_SHOTS, WEAK_PERIOD, estimate_points_per_line
from prc_cli.streams.lines import FixedLines
from prc_cli.streams.order import OrderWatch, Policy
from prc_cli.streams.rules import GridRules
from prc_cli.streams.table import RECORD, Table, n_rows, take
from prc_cli.streams.whole_lines import LineRules, ScanState, WholeLines, advance, split_scanners

MAX_SCANNERS = 256
"""Most scanners in one input; dimensions of more values are not scanner ids."""
MAX_LATE = 0.01
"""Largest share of shots that come after their line is complete."""

LineRulesOf: TypeAlias = Callable[[int], LineRules]
"""Returns the line rules of a scanner."""
Prepare: TypeAlias = Callable[[RecordChunk, Table], tuple[Table, ReadTally]]
"""Adds columns to the table of a chunk."""


def whole_lines(
    source: RecordSource,
    rules: GridRules,
    line_rules: LineRulesOf,
    names: tuple[str, ...] = (),
    prepare: Prepare | None = None,
) -> Iterator[WholeLines]:
    """Read a source from start to end as whole lines, chronological for each scanner."""
    states: dict[int, ScanState] = {}
    watches: dict[int, OrderWatch] = {}
    waiting = ReadTally()
    for chunk in source.chunks(tuple(dict.fromkeys((*rules.names, *names)))):
        table = table_of(chunk, rules.names)
        if prepare is not None:
            table, tally = prepare(chunk, table)
            waiting += tally
        for scanner, records in split_scanners(table, rules.scanner, source.path):
            state = states.get(scanner, ScanState())
            if rules.has_time:
                watch = watches.setdefault(scanner, open_watch(source, rules.order))
                waiting += see_times(watch, records)
            tally = state.tally + waiting + ReadTally(n_records=n_rows(records))
            state, waiting = replace(state, tally=tally), ReadTally()
            try:
                whole, states[scanner] = advance(scanner, records, state, line_rules(scanner), final=False)
            except InputError:
                # jumping lines are often due to records out of order: then report the order
                finish(watches)
                raise
            if whole is not None:
                yield whole
        check_scanners(len(states), source.path, rules.scanner)
    finish(watches)
    yield from _last_lines(source, rules, line_rules, states)


def _last_lines(
    source: RecordSource, rules: GridRules, line_rules: LineRulesOf, states: dict[int, ScanState]
) -> Iterator[WholeLines]:
    """Close the open lines of every scanner; if one is refused, yield nothing."""
    closed: list[WholeLines] = []
    leftover = ReadTally()
    for scanner in sorted(states):
        mine = line_rules(scanner)
        whole, state = advance(scanner, {}, states[scanner], mine, final=True)
        if rules.order == "require":
            _check_late(source.path, state)
        if isinstance(mine.line, FixedLines) and not rules.pads_last_line:
            what = "records" if mine.same_shot is None else "shots"
            check_partial_line(source.path, state.lines.n_shots, mine.line.points_per_line, what)
        # counts of a scanner without a single line
        leftover += state.tally
        if whole is not None:
            closed.append(whole)
    if not closed:
        raise nothing_placed(source.path)
    closed[0] = replace(closed[0], tally=closed[0].tally + leftover)
    yield from closed


def _check_late(path: str, state: ScanState) -> None:
    """Refuse an input in which too many shots belong to lines already complete.

    An earlier drive appended to a later one has a single step back in time, which the share of steps does not show.
    """
    n_late, n_seen = state.lines.n_late, state.lines.n_seen
    if n_late > MAX_LATE * n_seen:
        problem = f"{n_late} of {n_seen} shots go back to lines before those that they follow"
        hint = "sort with --sort-by-time, or leave them unclassified with --trust-order"
        raise OrderError(path, f"{problem}; expected lines in the order they were scanned", hint)


def table_of(chunk: RecordChunk, names: tuple[str, ...]) -> Table:
    """Return a chunk as a table, with the index of every record."""
    record = chunk.record
    if record is None:
        record = np.arange(chunk.first_record, chunk.first_record + chunk.n, dtype=np.int64)
    return {**{name: chunk.values[name] for name in names}, RECORD: record}


def first_records(
    source: RecordSource, scanner: str | None, names: tuple[str, ...], limit: int, *, to_end: bool
) -> dict[int, Table]:
    """Return the first ``limit`` records of every scanner, independent of chunks.

    Unless ``to_end``, reading stops after ``limit`` records of the input, which may miss later scanners.
    """
    parts: dict[int, Table] = {}
    n_seen = 0
    for chunk in source.chunks(names):
        table = table_of(chunk, names)
        if not to_end:
            table = take(table, slice(0, limit - n_seen))
        n_seen += n_rows(table)
        for one, records in split_scanners(table, scanner, source.path):
            have = parts.get(one, {})
            left = limit - n_rows(have)
            if left > 0:
                more = take(records, slice(0, left))
                parts[one] = {name: np.concatenate([have[name], more[name]]) for name in more} if have else more
        check_scanners(len(parts), source.path, scanner)
        if not to_end and n_seen >= limit:
            break
    return dict(sorted(parts.items()))


def open_watch(source: RecordSource, order: Policy) -> OrderWatch:
    """Return an order check for the times of a source."""
    return OrderWatch(source.path, order, source.facts.time_name)


def see_times(watch: OrderWatch, records: Table) -> ReadTally:
    """Pass the times of records to the order check; count the steps back."""
    before = watch.n_back
    watch.see(np.asarray(records["time"], np.float64), records[RECORD])
    return ReadTally(n_time_steps_back=watch.n_back - before)


def finish(watches: dict[int, OrderWatch]) -> None:
    """Check the order of every scanner."""
    for watch in watches.values():
        watch.finish()


def judge_first_records(source: RecordSource) -> None:
    """Refuse a source whose first chunk is not chronological."""
    if "time" not in source.dimensions:
        return
    watch = open_watch(source, "require")
    for chunk in source.chunks(("time",)):
        see_times(watch, table_of(chunk, ("time",)))
        break
    watch.finish()


def check_scanners(n_scanners: int, path: str, scanner: str | None) -> None:
    """Refuse a scanner dimension of too many values."""
    if n_scanners > MAX_SCANNERS:
        problem = f"{scanner} has more than {MAX_SCANNERS} values, expected one a scanner"
        raise InputError(path, problem, "choose another dimension for --scanner, or none")


def check_partial_line(
    path: str, n_shots: int, points_per_line: int, what: str = "records", source: RecordSource | None = None
) -> None:
    """Refuse a last line that is cut short; the hint names another M where the ranges of a source repeat with it."""
    n_over = n_shots % points_per_line
    if not n_over:
        return
    problem = f"{n_shots} {what} are not a multiple of points_per_line = {points_per_line} ({n_over} left over)"
    hint = 'check points_per_line (prc info estimates it), or pad the last line: --set input.partial_line="pad"'
    if source is not None and "range" in source.dimensions:
        period = estimate_points_per_line(first_ranges(source))
        if period.strength >= WEAK_PERIOD and period.points_per_line != points_per_line:
            hint = f"the ranges repeat after {period.points_per_line} shots: give -M {period.points_per_line}"
    raise InputError(path, problem, hint)


def first_ranges(source: RecordSource) -> F32:
    """Return ranges at the start of a source, missing ones as NaN, (n,) float32, in the units of the source."""
    parts: list[F32] = []
    kept = 0
    for chunk in source.chunks(("range",)):
        parts.append(np.asarray(chunk.values["range"], np.float32)[: MAX_SHOTS - kept])
        kept += parts[-1].size
        if kept >= MAX_SHOTS:
            break
    flat = np.concatenate(parts)
    return np.where(np.isfinite(flat) & (flat > 0), flat, np.float32(np.nan))


def nothing_placed(path: str) -> InputError:
    """Return the error of an input without a single line."""
    problem = "no record has a scan line, expected at least one"
    return InputError(path, problem, "look at the dimensions with prc info and name the one that counts lines")
