"""Columns of values by record index on disk."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import DTypeLike, NDArray

from prc_cli.core.bytewise import count_bytes
from prc_cli.core.types import I64, U8

PAGE_BYTES = 1 << 20
BUFFER_ITEMS = 1 << 20
WRITE_BYTES = 1 << 16
"""Bytes per write: for more, Linux searches large blocks of free memory, which takes up to ten times as long as the
copy."""


class Spool:
    """One value per record in a temporary file; records never written read as ``fill``.

    >>> import tempfile
    >>> spool = Spool(Path(tempfile.mkdtemp()) / "s", np.uint8, 1, n_records=6)
    >>> spool.put(np.array([4, 2]), np.array([9, 7], np.uint8))
    >>> np.concatenate(list(spool.chunks(4)))
    array([1, 1, 7, 1, 9, 1], dtype=uint8)
    >>> spool.close()
    """

    def __init__(self, path: Path, dtype: DTypeLike, fill: Any, *, n_records: int | None = None) -> None:
        self._dtype = np.dtype(dtype)
        self._bits = np.dtype(f"u{self._dtype.itemsize}")
        # stored as value XOR fill: holes in the file read as zero, so as the fill value
        self._mask = np.array([fill], self._dtype).view(self._bits)[0]
        self._page_items = PAGE_BYTES // self._dtype.itemsize
        self._n_fixed = n_records
        self._n_seen = 0
        self._pending: list[tuple[I64 | int, NDArray[Any]]] = []
        """Buffered records and values; only the first index of consecutive records."""
        self._n_pending = 0
        self._file: BinaryIO = path.open("w+b", buffering=0)

    def __len__(self) -> int:
        """Return the length of the column so far."""
        return self._n_seen if self._n_fixed is None else self._n_fixed

    def put(self, record: I64, values: NDArray[Any]) -> None:
        """Set values by record index; a later value replaces an earlier one."""
        if not len(record):
            return
        low, high = int(record[0]), int(record[-1])
        is_run = high - low == len(record) - 1 and bool(np.all(record[1:] > record[:-1]))
        if not is_run:
            low, high = int(record.min()), int(record.max())
        if low < 0 or (self._n_fixed is not None and high >= self._n_fixed):
            message = f"record {low if low < 0 else high} outside 0..{self._n_fixed}"
            raise IndexError(message)
        self._keep(low if is_run else np.array(record, np.int64), values, high)

    def put_run(self, first: int, values: NDArray[Any]) -> None:
        """Set the values of consecutive records, as :meth:`put` does."""
        last = first + len(values) - 1
        if first < 0 or (self._n_fixed is not None and last >= self._n_fixed):
            message = f"record {first if first < 0 else last} outside 0..{self._n_fixed}"
            raise IndexError(message)
        if len(values):
            self._keep(first, values, last)

    def _keep(self, record: I64 | int, values: NDArray[Any], last: int) -> None:
        self._n_seen = max(self._n_seen, last + 1)
        bits = np.ascontiguousarray(values, self._dtype).view(self._bits) ^ self._mask
        self._pending.append((record, bits))
        self._n_pending += len(bits)
        if self._n_pending >= BUFFER_ITEMS:
            self._flush()

    def chunks(self, n: int, *, first: int = 0, stop: int | None = None) -> Iterator[NDArray[Any]]:
        """Read the column in arrays of up to ``n`` values, records ``first`` to ``stop`` (default: all).

        ``stop`` may lie beyond the last record written: what follows reads as the fill value.
        """
        self._flush()
        stop = len(self) if stop is None else stop
        for start in range(first, stop, n):
            bits = self._read(start, min(n, stop - start))
            yield (bits ^ self._mask).view(self._dtype)

    def span(self, first: int, stop: int) -> NDArray[Any]:
        """Return the values of records ``first`` to ``stop`` (exclusive), at least one."""
        return next(self.chunks(stop - first, first=first, stop=stop))

    def close(self) -> None:
        """Close the temporary file."""
        self._pending.clear()
        self._file.close()

    def _flush(self) -> None:
        scattered: list[tuple[I64, NDArray[Any]]] = []
        # in order of arrival: a later value replaces an earlier one
        for record, bits in self._pending:
            if isinstance(record, int):
                self._scatter(scattered)
                self._write_run(record, bits)
            else:
                scattered.append((record, bits))
        self._scatter(scattered)
        self._pending.clear()
        self._n_pending = 0

    def _write_run(self, first: int, bits: NDArray[Any]) -> None:
        """Write values of consecutive records."""
        self._file.seek(first * self._bits.itemsize)
        write_all(self._file, np.ascontiguousarray(bits).view(np.uint8).data)

    def _scatter(self, items: list[tuple[I64, NDArray[Any]]]) -> None:
        """Write values of records in any order, page by page; the list is emptied."""
        if not items:
            return
        record = np.concatenate([item[0] for item in items])
        bits = np.concatenate([item[1] for item in items])
        items.clear()
        if np.any(record[1:] < record[:-1]):
            order = np.argsort(record, kind="stable")
            record, bits = record[order], bits[order]
        page = record // self._page_items
        starts = np.flatnonzero(np.concatenate(([True], page[1:] != page[:-1])))
        for start, stop in zip(starts, [*starts[1:], len(record)], strict=True):
            self._write(record[start:stop], bits[start:stop])

    def _write(self, record: I64, bits: NDArray[Any]) -> None:
        """Write sorted records of one page; read it first unless they leave no gap."""
        first, n = int(record[0]), int(record[-1]) - int(record[0]) + 1
        if n == len(record) and bool(np.all(np.diff(record) == 1)):
            span = bits
        else:
            span = self._read(first, n)
            span[record - first] = bits
        self._write_run(first, span)

    def _read(self, first: int, n: int) -> NDArray[Any]:
        span = np.zeros(n, self._bits)
        view = span.view(np.uint8).data
        self._file.seek(first * self._bits.itemsize)
        done = 0
        while done < len(view):
            got = self._file.readinto(view[done:])  # type: ignore[attr-defined]
            if not got:  # beyond the end of the file: fill value
                break
            done += got
        return span


def write_all(handle: BinaryIO, data: memoryview) -> None:
    """Write to an unbuffered file until nothing is left (a single write may be short)."""
    done = 0
    while done < len(data):
        done += handle.write(data[done : done + WRITE_BYTES])


PAGE_RECORDS = 1 << 16
"""Records per page, where the requested ones lie far apart."""


class RecordValues:
    """Records in a temporary file.

    >>> import tempfile
    >>> values = RecordValues(Path(tempfile.mkdtemp()) / "v", np.dtype("i4"), -5)
    >>> values.append(np.arange(100, 110, dtype=np.int32))
    >>> values.get(np.array([[3, -1], [9, 12]]))
    array([[103,  -5],
           [109,  -5]], dtype=int32)
    >>> values.close()
    """

    def __init__(self, path: Path, dtype: np.dtype[Any], fill: Any) -> None:
        self._dtype = dtype
        self._fill = fill
        self._n = 0
        self._file: BinaryIO = path.open("w+b", buffering=0)

    def __len__(self) -> int:
        """Return the number of records held."""
        return self._n

    def append(self, values: NDArray[Any]) -> None:
        """Add the values of the next records."""
        self._file.seek(0, 2)
        write_all(self._file, np.ascontiguousarray(values, self._dtype).view(np.uint8).reshape(-1).data)
        self._n += len(values)

    def get(self, record: I64) -> NDArray[Any]:
        """Return the values of records, in the shape of ``record``; unknown indices give the fill value."""
        flat = record.ravel()
        result = np.full(flat.shape, np.array(self._fill, self._dtype), self._dtype)
        held = np.flatnonzero((flat >= 0) & (flat < self._n))
        if not len(held):
            return result.reshape(record.shape)
        wanted = flat[held]
        low, high = int(wanted.min()), int(wanted.max()) + 1
        if high - low <= 4 * max(len(held), PAGE_RECORDS):
            result[held] = self._read(low, high - low)[wanted - low]
            return result.reshape(record.shape)
        order = np.argsort(wanted, kind="stable")
        held, wanted = held[order], wanted[order]
        page = wanted // PAGE_RECORDS
        starts = np.flatnonzero(np.concatenate(([True], page[1:] != page[:-1])))
        for start, stop in zip(starts, [*starts[1:], len(wanted)], strict=True):
            first = int(wanted[start])
            span = self._read(first, int(wanted[stop - 1]) + 1 - first)
            result[held[start:stop]] = span[wanted[start:stop] - first]
        return result.reshape(record.shape)

    def close(self) -> None:
        """Close the temporary file."""
        self._file.close()

    def _read(self, first: int, n: int) -> NDArray[Any]:
        self._file.seek(first * self._dtype.itemsize)
        return np.fromfile(self._file, self._dtype, n)


class StraightCodes:
    """A ``.npy`` file of class codes to append to.

    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "codes.npy"
    >>> straight = StraightCodes(path)
    >>> straight.append(np.array([2, 2, 7], np.uint8))
    >>> straight.finish()
    >>> np.load(path), straight.counts[2]
    (array([2, 2, 7], dtype=uint8), np.int64(2))
    """

    def __init__(self, path: Path) -> None:
        self.n = 0
        """Codes so far."""
        self.counts: I64 = np.zeros(256, np.int64)
        """(256,) int64, records by code."""
        self._file: BinaryIO = path.open("w+b", buffering=0)
        self._start = len(npy_header("|u1", (0,)))
        self._file.write(bytes(self._start))

    def append(self, codes: U8) -> None:
        """Write the codes of the next records, (n,) uint8."""
        self._file.seek(self._start + self.n)
        write_all(self._file, np.ascontiguousarray(codes).data)
        self.counts += count_bytes(codes)
        self.n += len(codes)

    def chunks(self, n: int) -> Iterator[U8]:
        """Read the codes again, up to ``n`` at a time."""
        self._file.seek(self._start)
        for first in range(0, self.n, n):
            yield np.fromfile(self._file, np.uint8, min(n, self.n - first))

    def finish(self) -> None:
        """Write the header and close the file."""
        header = npy_header("|u1", (self.n,))
        assert len(header) == self._start, "numpy leaves room for any length of an array"
        self._file.seek(0)
        write_all(self._file, memoryview(header))
        self._file.close()

    def close(self) -> None:
        """Close the file without completing it."""
        self._file.close()


def npy_header(dtype: str, shape: tuple[int, ...]) -> bytes:
    """Return the header of a ``.npy`` file."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": dtype, "fortran_order": False, "shape": shape})
    return header.getvalue()
