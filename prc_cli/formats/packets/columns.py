"""Firing columns of a spinning scanner become scan lines: rings from low to high, staggering undone in angle.

A scanner whose lasers point to different azimuths at a time sees a vertical line at different times. A cell takes the
shot that points along its line, and keeps the shot's own time. Columns that did not arrive are lines without returns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ExtraReturns, ReadTally, ScanBlock
from prc_cli.core.types import F32, F64, I64
from prc_cli.formats.options import InputConfig
from prc_cli.formats.organised.scans import CHUNK_SHOTS
from prc_cli.formats.ranges import clean_ranges

MAX_EMPTY = 64
"""Most lines that did not arrive for one that did, over a file."""
SPARE_CELLS = 1 << 20
"""Number of cells always allowed."""


@dataclass(frozen=True, slots=True)
class Columns:
    """Consecutive firing columns, decoded; rings from low to high."""

    line: I64
    """(n,) int64, number of the column since the first; numbers that are left out did not arrive."""
    range_m: F32
    """(n, M) float32 [m]; NaN = no return."""
    record: I64
    """(n, M) int64."""
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

    def __len__(self) -> int:
        return len(self.line)

    def part(self, where: slice | NDArray[Any]) -> Columns:
        """Return some of the columns."""
        further = None if self.further_m is None else self.further_m[where]
        record = None if self.further_record is None else self.further_record[where]
        return Columns(
            self.line[where], self.range_m[where], self.record[where], self.time_s[where], self.xyz_m[where],
            self.intensity[where], further, record,
        )  # fmt: skip


class _Held:
    """Lines that wait for shots."""

    def __init__(self, n: int, m: int, *, with_further: bool) -> None:
        self.range_m: F32 = np.full((n, m), np.nan, np.float32)
        self.record: I64 = np.full((n, m), -1, np.int64)
        self.time_s: F64 = np.full((n, m), np.nan)
        self.xyz_m: F32 = np.full((n, m, 3), np.nan, np.float32)
        self.intensity: F32 = np.full((n, m), np.nan, np.float32)
        self.further_m: F32 | None = np.full((n, m), np.nan, np.float32) if with_further else None
        self.further_record: I64 | None = np.full((n, m), -1, np.int64) if with_further else None

    def arrays(self) -> list[NDArray[Any]]:
        """Return all arrays, always in the same order."""
        every = (self.range_m, self.record, self.time_s, self.xyz_m, self.intensity)
        return [*every, *(one for one in (self.further_m, self.further_record) if one is not None)]


class ColumnLines:
    """Puts columns of one scanner into lines."""

    def __init__(self, where: str, scanner: int, shift: I64, config: InputConfig) -> None:
        self._where, self._scanner, self._config = where, scanner, config
        self._shift = shift - shift.min()
        self._span = int(self._shift.max())
        self._most = max(1, CHUNK_SHOTS // len(shift))
        self._held: _Held | None = None
        self._base = 0
        """First line that was not given out."""
        self._next = 0
        """Least column that may come."""
        self.n_columns = 0
        self.n_lost = 0
        """Columns that did not arrive."""
        self._unplaced = self._not_fired = 0

    def count_not_fired(self, n: int) -> None:
        """Count records of columns that the scanner itself marks as empty; they have no place in a line."""
        self._not_fired += n

    def add(self, columns: Columns) -> Iterator[ScanBlock]:
        """Take columns; yield the lines that are complete."""
        columns = self._in_turn(columns)
        n, first = len(columns), 0
        while first < n:
            line = columns.line[first:]
            # a block at a time, however long the gap
            stop = first + int(np.searchsorted(line, self._base + self._most))
            if stop > first:
                self._put(columns.part(slice(first, stop)))
            # the last line stays, so that what comes late is counted with it
            upto = int(columns.line[stop - 1]) if stop == n else self._base + self._most
            yield from self._give(upto)
            first = stop

    def finish(self) -> Iterator[ScanBlock]:
        """Yield the lines that are left."""
        if self.n_columns:
            yield from self._give(self._next + self._span)

    def lost(self) -> str:
        """Return a sentence on columns that did not arrive, empty if all did."""
        if not self.n_lost:
            return ""
        share = self.n_lost / (self.n_lost + self.n_columns)
        return f"{self.n_lost:,} columns did not arrive ({share:.2%}): they are lines of missing shots"

    def _in_turn(self, columns: Columns) -> Columns:
        """Leave out columns that come too late, and check the gaps."""
        before = np.append(self._next - 1, columns.line)
        keep = columns.line > np.maximum.accumulate(before)[:-1]
        if not keep.all():
            every = [columns.record[~keep]]
            every += [] if columns.further_record is None else [columns.further_record[~keep]]
            self._unplaced += sum(int(np.count_nonzero(one >= 0)) for one in every)
            columns = columns.part(keep)
        if not len(columns):
            return columns
        gaps = np.diff(np.append(self._next - 1, columns.line)) - 1
        limit, worst = self._config.max_gap_lines, int(gaps.argmax())
        if gaps[worst] > limit:
            problem = (
                f"{int(gaps[worst])} columns did not arrive before the one of record {int(columns.record[worst].min())}"
                f", expected at most {limit}"
            )
            hint = "split the file there, or set input.max_gap_lines if the gap is real"
            raise InputError(self._where, problem, hint)
        self.n_columns += len(columns)
        self.n_lost += int(gaps.sum())
        if self.n_lost > MAX_EMPTY * self.n_columns + SPARE_CELLS // len(self._shift):
            problem = f"{self.n_lost} columns did not arrive, {self.n_columns} did, expected most of them"
            raise InputError(self._where, problem, "copy it from the archive again")
        self._next = int(columns.line[-1]) + 1
        return columns

    def _put(self, columns: Columns) -> None:
        m, span = len(self._shift), self._span
        with_further = columns.further_m is not None
        n = int(columns.line[-1]) + 1 + span - self._base
        held = _Held(n, m, with_further=with_further)
        if self._held is not None:
            for new, old in zip(held.arrays(), self._held.arrays(), strict=True):
                new[: len(old)] = old
        at = (columns.line - self._base)[:, None] + self._shift, np.arange(m)[None]
        every = [columns.range_m, columns.record, columns.time_s, columns.xyz_m, columns.intensity]
        if columns.further_m is not None and columns.further_record is not None:
            every += [columns.further_m, columns.further_record]
        for new, values in zip(held.arrays(), every, strict=True):
            new[at] = values
        self._held = held

    def _give(self, upto: int) -> Iterator[ScanBlock]:
        """Yield the lines before ``upto``, and keep the others."""
        n = upto - self._base
        if n <= 0:
            return
        held, self._held = self._held, None
        if held is None:
            held = _Held(n, len(self._shift), with_further=False)
        elif len(held.range_m) < n:
            longer = _Held(n, len(self._shift), with_further=held.further_m is not None)
            for new, old in zip(longer.arrays(), held.arrays(), strict=True):
                new[: len(old)] = old
            held = longer
        else:
            rest = _Held(len(held.range_m) - n, len(self._shift), with_further=held.further_m is not None)
            for new, old in zip(rest.arrays(), held.arrays(), strict=True):
                new[:] = old[n:]
            self._held = rest if len(rest.range_m) else None
        block = self._block(held, n)
        self._base = upto
        yield block

    def _block(self, held: _Held, n: int) -> ScanBlock:
        low, high = self._config.min_range, self._config.max_range
        ranges, tally = clean_ranges(held.range_m[:n], low, high)
        missing = np.isnan(ranges)
        xyz, intensity = held.xyz_m[:n], held.intensity[:n]
        xyz[missing], intensity[missing] = np.nan, np.nan
        record = held.record[:n]
        n_records = int(np.count_nonzero(record >= 0))
        extra = ExtraReturns.none()
        if held.further_m is not None and held.further_record is not None:
            further, more = clean_ranges(held.further_m[:n], low, high)
            line, column = np.nonzero(np.isfinite(further))
            extra = ExtraReturns(
                line.astype(np.int32), column.astype(np.int32), further[line, column],
                held.further_record[line, column],
            )  # fmt: skip
            n_records += int(np.count_nonzero(held.further_record[:n] >= 0))
            tally = tally + replace(more, n_extra_returns=len(line))
        n_records += self._unplaced + self._not_fired
        unplaced, self._unplaced, self._not_fired = self._unplaced, 0, 0
        return ScanBlock(
            first_line=self._base,
            range_m=ranges,
            record=record,
            scanner=self._scanner,
            time_s=held.time_s[:n],
            xyz_m=xyz,
            intensity=intensity,
            extra=extra,
            tally=tally + ReadTally(n_records=n_records, n_unplaced=unplaced),
        )


def place(range_m: NDArray[Any], azimuth_rad: F64, elevation_rad: F64) -> F32:
    """Return coordinates of shots, z up, azimuth from y towards x as the makers have it."""
    xyz: F32 = np.empty((*range_m.shape, 3), np.float32)
    flat = range_m * np.cos(elevation_rad)
    xyz[..., 0] = flat * np.sin(azimuth_rad)
    xyz[..., 1] = flat * np.cos(azimuth_rad)
    xyz[..., 2] = range_m * np.sin(elevation_rad)
    return xyz


def choose_of_two(first: F32, second: F32, lit: tuple[F32, F32], rule: str) -> NDArray[np.bool_]:
    """Return where the second of two returns stands for its shot."""
    with np.errstate(invalid="ignore"):
        wins = {"strongest": lit[1] > lit[0], "first": second < first, "last": second > first}[rule]
    return np.isfinite(second) & (wins | np.isnan(first))
