"""Turn firing columns of spinning scanners into scan lines, rings from low to high.

Packets and clouds in bags become columns in their rooms; from there on they are alike.

A scanner whose lasers point to different azimuths at a time sees a vertical line at different
times (staggering). A cell gets the shot that points along its line, with the time of the shot.
Columns that did not arrive are lines without returns.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ExtraReturns, ReadTally, ScanBlock
from prc_cli.core.types import F32, F64, I64
from prc_cli.formats.options import InputConfig
from prc_cli.formats.organised.scans import CHUNK_SHOTS
from prc_cli.formats.ranges import clean_ranges

MAX_EMPTY = 64
"""Most lost lines for one received line, over a file."""
SPARE_CELLS = 1 << 20
"""Number of cells always allowed."""
MAX_SHIFT = 512
"""Most columns by which a ring looks ahead of another."""
PAUSE_LINES = 1000
"""Lines without returns in place of a pause of the recording."""


class Columns(NamedTuple):
    """Consecutive firing columns, decoded; rings from low to high."""

    line: I64
    """(n,) int64, number of the column since the first; missing numbers did not arrive."""
    range_m: F32
    """(n, M) float32 [m]; NaN = no return."""
    record: I64
    """(n, M) int64; -1 = none."""
    time_s: F64
    """(n, M) float64 [s]."""
    xyz_m: F32
    """(n, M, 3) float32, sensor-centred, z up [m]."""
    intensity: F32
    """(n, M) float32."""
    further_m: F32 | None = None
    """(n, M) float32, the other of two returns [m]; NaN = none."""
    further_record: I64 | None = None
    """(n, M) int64, its record; -1 = none."""

    @property
    def n(self) -> int:
        """Number of columns."""
        return len(self.line)

    def part(self, where: slice | NDArray[Any]) -> Columns:
        """Return the columns of a slice or an index."""
        return Columns(*(None if values is None else values[where] for values in self))  # type: ignore[arg-type]

    def cells(self) -> list[NDArray[Any]]:
        """Return the arrays with a value a cell, always in the same order."""
        return [values for values in self[1:] if values is not None]


def columns_of(line: I64, time_s: F64, xyz_m: F32, shots: Shots) -> Columns:
    """Return columns with numbers (n,), times and coordinates (n, M, ...), and their shots."""
    return Columns(
        line,
        shots.range_m,
        shots.record,
        time_s,
        xyz_m,
        shots.intensity,
        shots.further_m,
        shots.further_record,
    )


class ColumnLines:
    """Puts columns of one scanner into lines."""

    def __init__(
        self,
        where: str,
        scanner: int,
        shift: I64,
        config: InputConfig,
    ) -> None:
        self._where = where
        self._scanner = scanner
        self._config = config
        shift = shift - shift.min()
        self._m = len(shift)
        self._span = int(shift.max())
        self._rings = {int(by): np.flatnonzero(shift == by) for by in np.unique(shift)}
        """Rings by the number of lines from their column to their line."""
        self._most = max(1, CHUNK_SHOTS // self._m)
        self._held: list[NDArray[Any]] = []
        """Cells of lines that wait for shots, from the first that was not yielded."""
        self._base = 0
        """First line that was not yielded."""
        self._n_before: int | None = None
        """Lines before the first shot, which are left out; None = no shot yet."""
        self._next = 0
        """Least column that may come."""
        self._n_shortened = 0
        """Lines by which pauses were shortened."""
        self._pauses: list[tuple[float, int]] = []
        """Time of the first shot after a pause [s], and its lines."""
        self._n_columns = self._n_lost = self._unplaced = self._not_fired = self._collisions = 0

    def count_not_fired(self, n: int) -> None:
        """Count records of columns that the scanner marks as empty."""
        self._not_fired += n

    def count_unplaced(self, n: int) -> None:
        """Count records without a ring, or with a time outside all columns."""
        self._unplaced += n

    def count_collisions(self, n: int) -> None:
        """Count records whose cell is full."""
        self._collisions += n

    def add(self, columns: Columns) -> Iterator[ScanBlock]:
        """Take columns; yield the lines that are complete."""
        columns = self._in_turn(columns)
        self._held = self._held or [values[:0] for values in columns.cells()]
        columns = self._with_further(columns)
        first = 0
        while first < columns.n:
            # a block at a time, however long the gap
            stop = first + int(np.searchsorted(columns.line[first:], self._base + self._most))
            if stop > first:
                self._put(columns.part(slice(first, stop)))
            # the last line stays, so that what comes late is counted with it
            yield from self._give(
                int(columns.line[stop - 1]) if stop == columns.n else self._base + self._most
            )
            first = stop

    def finish(self) -> Iterator[ScanBlock]:
        """Yield the lines that are left."""
        if not self._n_columns:
            return
        # rings that look ahead end later: lines behind the last shot are none
        used = np.flatnonzero((self._held[1] >= 0).any(axis=1))
        yield from self._give(self._base + int(used[-1]) + 1 if len(used) else self._next)

    def lost(self) -> str:
        """Return a sentence on lost columns and pauses; empty if there are none."""
        notes = []
        if self._n_lost:
            share = self._n_lost / (self._n_lost + self._n_columns)
            lost = f"{self._n_lost:,} columns did not arrive ({share:.2%})"
            notes.append(f"{lost}: they are lines of missing shots")
        if self._pauses:
            begin_s, n = self._pauses[0]
            more = f", the first of {len(self._pauses)}," if len(self._pauses) > 1 else ""
            notes.append(
                f"the recording has a pause{more} of {n:,} columns before {begin_s:.3f} s: "
                f"{PAUSE_LINES:,} lines without returns replace it (input.max_gap_lines)"
            )
        return "; ".join(notes)

    def _in_turn(self, columns: Columns) -> Columns:
        """Drop columns that come too late, and shorten pauses of the recording."""
        # packets may overtake each other
        if not (np.diff(columns.line) > 0).all():
            columns = columns.part(np.argsort(columns.line, kind="stable"))
        columns = self._after_pauses(columns)
        before = np.append(self._next - 1, columns.line)
        keep = columns.line > np.maximum.accumulate(before)[:-1]
        if not keep.all():
            late = columns.part(~keep)
            self._unplaced += sum(
                int(np.count_nonzero(records >= 0))
                for records in (late.record, late.further_record)
                if records is not None
            )
            columns = columns.part(keep)
        if not columns.n:
            return columns
        gaps = np.diff(np.append(self._next - 1, columns.line)) - 1
        self._n_columns += columns.n
        self._n_lost += int(gaps.sum())
        if self._n_lost > MAX_EMPTY * self._n_columns + SPARE_CELLS // self._m:
            problem = f"{self._n_lost} columns did not arrive, only {self._n_columns} did"
            hint = f"shorten the pauses: --set input.max_gap_lines={PAUSE_LINES}"
            raise InputError(self._where, problem, hint)
        self._next = int(columns.line[-1]) + 1
        return columns

    def _after_pauses(self, columns: Columns) -> Columns:
        """Shorten the gaps that are longer than ``max_gap_lines``, and note them."""
        columns = columns._replace(line=columns.line - self._n_shortened)
        gaps = np.diff(np.append(self._next - 1, columns.line)) - 1
        longest = self._config.max_gap_lines
        long = np.flatnonzero(gaps > longest)
        if not len(long):
            return columns
        surplus = np.zeros(columns.n, np.int64)
        surplus[long] = gaps[long] - min(PAUSE_LINES, longest)
        for index in long:
            known_s = columns.time_s[index][np.isfinite(columns.time_s[index])]
            begin_s = float(known_s.min()) if len(known_s) else math.nan
            self._pauses.append((begin_s, int(gaps[index])))
        self._n_shortened += int(surplus.sum())
        return columns._replace(line=columns.line - np.cumsum(surplus))

    def _with_further(self, columns: Columns) -> Columns:
        """Add empty further returns to held or new cells if only the others have some."""
        if columns.further_m is not None and len(self._held) == len(columns) - 3:
            self._held += [np.full_like(self._held[0], np.nan), np.full_like(self._held[1], -1)]
        elif columns.further_m is None and len(self._held) == len(columns) - 1:
            further = np.full_like(columns.range_m, np.nan), np.full_like(columns.record, -1)
            columns = columns._replace(further_m=further[0], further_record=further[1])
        return columns

    def _put(self, columns: Columns) -> None:
        row = columns.line - self._base
        self._held = self._longer(int(row[-1]) + 1 + self._span)
        # copying a slice is faster than an index
        is_whole = int(row[-1] - row[0]) == len(row) - 1
        for behind, rings in self._rings.items():
            rows: Any = slice(row[0] + behind, row[-1] + behind + 1) if is_whole else row + behind
            for held, values in zip(self._held, columns.cells(), strict=True):
                if len(self._rings) == 1:
                    held[rows] = values
                else:
                    held[(rows, rings) if is_whole else np.ix_(rows, rings)] = values[:, rings]

    def _longer(self, n: int) -> list[NDArray[Any]]:
        """Return the held cells, with empty cells up to line ``n``."""
        lacking = n - len(self._held[0])
        if lacking <= 0:
            return self._held
        return [
            np.concatenate(
                [
                    cells,
                    np.full(
                        (lacking, *cells.shape[1:]),
                        -1 if cells.dtype.kind == "i" else np.nan,
                        cells.dtype,
                    ),
                ]
            )
            for cells in self._held
        ]

    def _give(self, upto: int) -> Iterator[ScanBlock]:
        """Yield the lines before ``upto``, and keep the others."""
        n = upto - self._base
        if n <= 0:
            return
        held = self._longer(n)
        self._held = [values[n:] for values in held]
        lines = Columns(np.arange(self._base, upto), *(values[:n] for values in held))
        self._base = upto
        if self._n_before is None:
            # rings that look ahead begin later: lines before the first shot are none
            used = np.flatnonzero((lines.record >= 0).any(axis=1))
            if not len(used):
                return
            self._n_before = int(lines.line[used[0]])
            lines = lines.part(slice(used[0], None))
        yield self._block(lines)

    def _block(self, lines: Columns) -> ScanBlock:
        low = self._config.min_range
        high = self._config.max_range
        ranges, tally = clean_ranges(lines.range_m, low, high)
        missing = np.isnan(ranges)
        lines.xyz_m[missing] = np.nan
        lines.intensity[missing] = np.nan
        n_records = int(np.count_nonzero(lines.record >= 0))
        extra = ExtraReturns.none()
        if lines.further_m is not None and lines.further_record is not None:
            further, more = clean_ranges(lines.further_m, low, high)
            line, column = np.nonzero(np.isfinite(further))
            extra = ExtraReturns(
                line.astype(np.int32),
                column.astype(np.int32),
                further[line, column],
                lines.further_record[line, column],
            )
            n_records += int(np.count_nonzero(lines.further_record >= 0))
            tally = tally + replace(more, n_extra_returns=len(line))
        n_records += self._unplaced + self._not_fired + self._collisions
        unplaced = self._unplaced
        collisions = self._collisions
        self._unplaced = self._not_fired = self._collisions = 0
        return ScanBlock(
            first_line=int(lines.line[0]) - (self._n_before or 0),
            range_m=ranges,
            record=lines.record,
            scanner=self._scanner,
            time_s=lines.time_s,
            xyz_m=lines.xyz_m,
            intensity=lines.intensity,
            has_rings=True,
            extra=extra,
            tally=tally
            + ReadTally(n_records=n_records, n_unplaced=unplaced, n_collisions=collisions),
        )


class Shots(NamedTuple):
    """Main return of every shot, and the other of two returns."""

    range_m: F32
    """(...) float32 [m]; NaN = no return."""
    intensity: F32
    """(...) float32."""
    record: I64
    """(...) int64."""
    further_m: F32 | None = None
    """(...) float32, range of the other return [m]; None = one return a shot."""
    further_record: I64 | None = None
    """(...) int64, record of the other return."""


def choose(
    range_m: F32,
    intensity: F32,
    record: I64,
    rule: str,
) -> Shots:
    """Choose the main return of every shot.

    Parameters
    ----------
    range_m, intensity, record : (..., returns)
        One or two returns of every shot.
    rule : {"strongest", "first", "last"}
        The main return.
    """
    first = Shots(range_m[..., 0], intensity[..., 0], record[..., 0])
    if range_m.shape[-1] == 1:
        return first
    second = Shots(range_m[..., 1], intensity[..., 1], record[..., 1])
    with np.errstate(invalid="ignore"):
        wins = {
            "strongest": second.intensity > first.intensity,
            "first": second.range_m < first.range_m,
            "last": second.range_m > first.range_m,
        }[rule]
    swap = np.isfinite(second.range_m) & (wins | np.isnan(first.range_m))
    return Shots(
        range_m=np.where(swap, second.range_m, first.range_m),
        intensity=np.where(swap, second.intensity, first.intensity),
        record=np.where(swap, second.record, first.record),
        further_m=np.where(swap, first.range_m, second.range_m),
        further_record=np.where(swap, first.record, second.record),
    )
