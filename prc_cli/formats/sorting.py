"""Sorts records by time, in bounded memory.

An external merge sort: runs of the input are sorted in memory and written to an unnamed temporary
file; then all runs are merged at once. Equal times keep input order, so that the result depends
neither on chunks nor on the length of runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.formats.records import RecordChunk, Source, filtered
from prc_cli.formats.writing.disk import scratch_errors, scratch_file

RUN_RECORDS = 1 << 19
"""Records sorted in memory at a time."""
MERGE_RECORDS = 1 << 20
"""Records of all runs held in memory while merging."""
_TIME = "sort time"
_RECORD = "input record"
"""Fields added to the records; the blanks avoid clashes with dimensions."""


def sorted_by_time(
    source: Source, *, run_records: int = RUN_RECORDS, merge_records: int = MERGE_RECORDS
) -> Source:
    """Return a source with the same records sorted by time."""
    if "time" not in source.dimensions:
        problem = f"no time to sort by, found the dimensions {', '.join(source.dimensions)}"
        raise InputError(source.path, problem, "without times the order cannot be restored")
    run_records = max(run_records, 1)
    merge_records = max(merge_records, 1)

    def chunks(names: tuple[str, ...], stored: Source) -> Iterator[RecordChunk]:
        with scratch_file("sorting") as handle:
            runs: list[_SortedRun] = []
            position = 0
            pending: NDArray[np.void] | None = None
            for records in _sorted_runs(stored, names, run_records):
                # the last run stays in memory: an input of one run needs no disk
                if pending is not None:
                    with scratch_errors("sorting"):
                        handle.write(pending.view(np.uint8).data)
                    runs.append(_SortedRun(handle, position, len(pending), pending.dtype))
                    position += pending.nbytes
                pending = records
            if pending is None:
                return
            runs.append(_SortedRun(None, 0, len(pending), pending.dtype, pending))
            del records, pending
            first = 0
            for merged in _merge(runs, merge_records):
                for start in range(0, len(merged), run_records):
                    part = merged[start : start + run_records]
                    values = {name: np.array(part[name]) for name in names}
                    yield RecordChunk(first, values, len(part), np.array(part[_RECORD]))
                    first += len(part)

    return filtered(source, chunks)


def _sorted_runs(
    source: Source, names: tuple[str, ...], run_records: int
) -> Iterator[NDArray[np.void]]:
    parts: list[NDArray[np.void]] = []
    n_records = 0
    for chunk in source.chunks(tuple(dict.fromkeys((*names, "time")))):
        records = _pack(source.path, chunk, names)
        for start in range(0, len(records), run_records):
            part = records[start : start + run_records]
            if n_records + len(part) > run_records:
                yield _sort(parts)
                parts = []
                n_records = 0
            parts.append(part)
            n_records += len(part)
    if parts:
        yield _sort(parts)


def _pack(path: str, chunk: RecordChunk, names: tuple[str, ...]) -> NDArray[np.void]:
    """Return the records with their times and numbers; a time that is not finite is refused."""
    time_s = np.asarray(chunk.values["time"], np.float64)
    record = chunk.records()
    finite = np.isfinite(time_s)
    if not finite.all():
        i = int(np.argmin(finite))
        problem = f"record {record[i]} has time {time_s[i]}, expected a finite time to sort by"
        hint = "drop such records, or take the order as it is with --trust-order"
        raise InputError(path, problem, hint)
    fields = [(name, chunk.values[name].dtype) for name in names]
    packed = np.empty(chunk.n, dtype=[(_TIME, np.float64), (_RECORD, np.int64), *fields])
    packed[_TIME] = time_s
    packed[_RECORD] = record
    for name in names:
        packed[name] = chunk.values[name]
    return packed


def _sort(parts: list[NDArray[np.void]]) -> NDArray[np.void]:
    records = np.concatenate(parts)
    return records[np.argsort(records[_TIME], kind="stable")]


class _SortedRun:
    """Records in order: a window in memory, the following ones on disk."""

    def __init__(
        self,
        handle: BinaryIO | None,
        position: int,
        n_records: int,
        dtype: np.dtype[np.void],
        window: NDArray[np.void] | None = None,
    ) -> None:
        self._handle = handle
        self._position = position
        self._n_on_disk = n_records if window is None else 0
        self.window: NDArray[np.void] = np.empty(0, dtype) if window is None else window

    @property
    def is_in_memory(self) -> bool:
        return self._n_on_disk == 0

    def fill(self, n_records: int) -> None:
        """Read records into the window, up to ``n_records``, if it is half empty."""
        wanted = min(n_records - len(self.window), self._n_on_disk)
        if self._handle is None or len(self.window) > n_records // 2 or wanted <= 0:
            return
        records = np.empty(wanted, self.window.dtype)
        with scratch_errors("sorting"):
            self._handle.seek(self._position)
            raw = self._handle.read(records.nbytes)
        records.view(np.uint8)[:] = np.frombuffer(raw, np.uint8)
        self._position += records.nbytes
        self._n_on_disk -= wanted
        self.window = np.concatenate([self.window, records])

    def take(self, limit: float, *, with_equal: bool) -> NDArray[np.void]:
        """Remove and return records below ``limit``, or also equal to it."""
        count = int(
            np.searchsorted(self.window[_TIME], limit, side="right" if with_equal else "left")
        )
        records = self.window[:count]
        self.window = self.window[count:]
        return records


def _merge(runs: list[_SortedRun], merge_records: int) -> Iterator[NDArray[np.void]]:
    """Yield the records of all runs in order; of equal times, those of earlier runs first."""
    share = max(merge_records // len(runs), 2)
    while runs:
        for run in runs:
            run.fill(share)
        # the window that ends first limits the times that can be merged; of records with this
        # very time, only earlier runs may give theirs
        open_runs = [k for k, run in enumerate(runs) if not run.is_in_memory]
        if open_runs:
            first_to_end = min(open_runs, key=lambda k: float(runs[k].window[_TIME][-1]))
            limit = float(runs[first_to_end].window[_TIME][-1])
            parts = [run.take(limit, with_equal=k <= first_to_end) for k, run in enumerate(runs)]
        else:
            parts = [run.take(np.inf, with_equal=True) for run in runs]
        runs = [run for run in runs if len(run.window) or not run.is_in_memory]
        yield _sort(parts)
