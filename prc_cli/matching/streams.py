"""Streams of columns: sorted by their key, or several of the same records side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from prc_cli.formats.records import RecordSource
from prc_cli.matching.join import Columns
from prc_cli.streams.sorting import sorted_by_time

RECORD = "record"
"""Column of :func:`columns_of` with the index of the record in its source, int64."""
SORT_RECORDS = 1 << 18
"""Records of a side sorted in memory at a time; twice as many are held while merging."""


def columns_of(
    source: RecordSource, names: tuple[str, ...], *, sort: bool, with_record: bool = True
) -> Iterator[Columns]:
    """Yield dimensions of a source, and :data:`RECORD` if asked; by ascending ``time`` if asked, else as stored."""
    if sort:
        source = sorted_by_time(source, run_records=SORT_RECORDS, merge_records=2 * SORT_RECORDS)
    for chunk in source.chunks(names):
        values = {name: chunk.values[name] for name in names}
        if not with_record:
            yield values
            continue
        first = chunk.first_record
        record = np.arange(first, first + chunk.n, dtype=np.int64) if chunk.record is None else chunk.record
        yield {**values, RECORD: record}


def in_step(
    streams: Sequence[Iterator[Columns]], check_lengths: Callable[[Sequence[int]], None]
) -> Iterator[tuple[Columns, ...]]:
    """Walk streams of the same records in equal steps."""
    rest: list[Columns] = [{} for _ in streams]
    seen = [0] * len(streams)
    while True:
        for k, stream in enumerate(streams):
            while not _length(rest[k]):
                chunk = next(stream, None)
                if chunk is None:
                    break
                rest[k] = chunk
                seen[k] += _length(chunk)
        n = min(_length(columns) for columns in rest)
        if not n:
            break
        yield tuple({name: values[:n] for name, values in columns.items()} for columns in rest)
        rest = [{name: values[n:] for name, values in columns.items()} for columns in rest]
    check_lengths([n + sum(_length(chunk) for chunk in stream) for n, stream in zip(seen, streams, strict=True)])


def _length(columns: Columns) -> int:
    return len(next(iter(columns.values()))) if columns else 0
