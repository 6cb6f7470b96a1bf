"""Refuses lines that go back, long gaps, and images that are nearly empty.

So a few wrong numbers cannot cost gigabytes or hours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from prc_cli.core.errors import InputError, OrderError
from prc_cli.core.types import I64, Mask
from prc_cli.formats.options import InputConfig
from prc_cli.streams.columns import MAX_COLUMN
from prc_cli.streams.lines import LineState

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
