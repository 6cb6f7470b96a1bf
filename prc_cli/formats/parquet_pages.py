"""Reads columns of numbers of Parquet files, and checks page headers before pyarrow believes them.

pyarrow makes room for what a page says it holds and fills it before it finds that the page is shorter: one changed byte
in a file of 11 kB costs 2 GB and seconds. A column of numbers cannot need that much.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO

import pyarrow
import pyarrow.parquet

from prc_cli.core.files import open_to_read

BUFFER_BYTES = 1 << 20
"""Bytes of a column read at a time."""
MOST_VALUE_BYTES = 16
"""A value of a column of numbers takes fewer, with its levels."""
SPARE_BYTES = 1 << 16
"""Of a page beside its values."""
MOST_HEADER_BYTES = 4096
"""A header of a page of numbers takes some 100, statistics included."""
_PAGE_SIZE, _STORED_SIZE = 2, 3
"""Fields of a page header: uncompressed and compressed size (Apache Parquet, parquet.thrift, PageHeader)."""
_STOP, _TRUE, _FALSE, _BYTE, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT = 0, 1, 2, 3, 7, 8, 9, 10, 11, 12
"""Types of the Thrift compact protocol; all others are variable-length integers."""
_DEEPEST = 8


def read_batches(path: Path, columns: Sequence[str], n_rows: int) -> Iterator[pyarrow.RecordBatch]:
    """Read some columns of numbers in bounded memory.

    Parameters
    ----------
    path : Path
        Parquet file.
    columns : sequence of str
        Top-level columns of whole or floating-point numbers.
    n_rows : int
        Most rows of a batch.

    Yields
    ------
    pyarrow.RecordBatch
        The next rows.

    Raises
    ------
    ValueError, OSError, pyarrow.ArrowException
        When the file is damaged.
    """
    # a row group can be as large as the file: read it through a small buffer
    with pyarrow.parquet.ParquetFile(path, pre_buffer=False, buffer_size=BUFFER_BYTES) as file:
        check_pages(path, file.metadata, columns)
        yield from file.iter_batches(batch_size=n_rows, columns=list(columns))


def check_pages(path: Path, metadata: pyarrow.parquet.FileMetaData, columns: Sequence[str]) -> None:
    """Look at the headers of all pages of some columns of numbers.

    Parameters
    ----------
    path : Path
        Parquet file.
    metadata : pyarrow.parquet.FileMetaData
        Of it.
    columns : sequence of str
        Top-level columns of whole or floating-point numbers.

    Raises
    ------
    ValueError
        When a page says that it holds more than its column can, or its header has no end.
    """
    with open_to_read(path) as handle:
        n_bytes = handle.seek(0, os.SEEK_END)
        for number in range(metadata.num_row_groups):
            group = metadata.row_group(number)
            most = MOST_VALUE_BYTES * group.num_rows + SPARE_BYTES
            for index in range(group.num_columns):
                chunk = group.column(index)
                if chunk.path_in_schema in columns:
                    starts = [start for start in (chunk.dictionary_page_offset, chunk.data_page_offset) if start]
                    begin = min(starts, default=0)
                    end = min(begin + chunk.total_compressed_size, n_bytes)
                    _check_chunk(handle, begin, end, most, chunk.path_in_schema)


def _check_chunk(handle: IO[bytes], place: int, end: int, most: int, name: str) -> None:
    while 0 < place < end:
        handle.seek(place)
        header = handle.read(min(MOST_HEADER_BYTES, end - place))
        try:
            length, sizes = _read_header(header)
        except (IndexError, RecursionError):
            raise ValueError(f"column {name!r}: the page header at byte {place} has no end") from None
        held, stored = sizes.get(_PAGE_SIZE, 0), sizes.get(_STORED_SIZE, 0)
        if not 0 <= held <= most or stored < 0:
            raise ValueError(
                f"column {name!r}: the page at byte {place} says it holds {held} bytes, expected 0 to {most}"
            )
        place += length + stored


def _read_header(header: bytes) -> tuple[int, dict[int, int]]:
    """Return the length of a page header, and its fields that are whole numbers.

    >>> _read_header(bytes([0x15, 0, 0x15, 20, 0x15, 8, 0x2C, 0x15, 6, 0, 0]))
    (11, {1: 0, 2: 10, 3: 4})
    """
    fields: dict[int, int] = {}
    return _skip_struct(header, 0, fields, 0), fields


def _skip_struct(data: bytes, at: int, fields: dict[int, int] | None, depth: int) -> int:
    """Return where a struct ends; whole numbers go into ``fields``."""
    if depth > _DEEPEST:
        raise RecursionError
    field = 0
    while True:
        step, kind = divmod(data[at], 16)
        at += 1
        if kind == _STOP:
            return at
        if step:
            field += step
        else:
            field, at = _signed(data, at)
        if kind in (_TRUE, _FALSE):  # the value is the type
            continue
        if fields is not None and kind not in (_BYTE, _DOUBLE, _BINARY, _LIST, _SET, _MAP, _STRUCT):
            fields[field], at = _signed(data, at)
        else:
            at = _skip(data, at, kind, depth)


def _skip(data: bytes, at: int, kind: int, depth: int) -> int:
    """Return where a value ends."""
    if kind == _STRUCT:
        return _skip_struct(data, at, None, depth + 1)
    if kind in (_LIST, _SET):
        n, inner = divmod(data[at], 16)
        at += 1
        if n == 15:
            n, at = _unsigned(data, at)
        for _ in range(n):
            at = at + 1 if inner in (_TRUE, _FALSE) else _skip(data, at, inner, depth + 1)
        return at
    if kind == _MAP:  # page headers have none
        raise IndexError
    if kind == _BINARY:
        n, at = _unsigned(data, at)
        at += n
        data[at]  # what follows must be there
        return at
    return at + {_BYTE: 1, _DOUBLE: 8}[kind] if kind in (_BYTE, _DOUBLE) else _unsigned(data, at)[1]


def _unsigned(data: bytes, at: int) -> tuple[int, int]:
    """Return a variable-length whole number, and where it ends."""
    value = shift = 0
    while True:
        value |= (data[at] & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if data[at - 1] < 0x80:
            return value, at


def _signed(data: bytes, at: int) -> tuple[int, int]:
    value, at = _unsigned(data, at)
    return (value >> 1) ^ -(value & 1), at
