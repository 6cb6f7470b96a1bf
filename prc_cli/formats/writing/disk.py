"""Values by record index on disk, written and read in any order; arrays that grow; temporary files.

The orders of writing and reading differ if several scanners share a file or a file was sorted. Then
values are scattered and gathered page by page. Memory is a page and a buffer for any size of file.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, Self, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from prc_cli.core.errors import OutputError
from prc_cli.core.files import temporary_name
from prc_cli.core.types import I64, U8

PAGE_BYTES = 1 << 20
BUFFER_ITEMS = 1 << 20
WRITE_BYTES = 1 << 16
"""Bytes per write.

For more, Linux searches large blocks of free memory, which takes up to ten times the copy.
"""


class DiskColumn:
    """One value, or one row, per record in a file beside an output; others are ``fill``."""

    def __init__(
        self,
        output: Path,
        dtype: DTypeLike,
        fill: Any,
        *,
        n_records: int | None = None,
    ) -> None:
        self._dtype = np.dtype(dtype)
        self._size = self._dtype.itemsize
        # stored as value XOR fill: holes in the file read as zero, so as the fill value
        self._mask: U8 = np.array([fill], self._dtype).view(np.uint8)
        self._page_items = max(1, PAGE_BYTES // self._size)
        self._n_fixed = n_records
        self._n_seen = 0
        self._pending: list[tuple[I64, U8]] = []
        """Records that are not written yet, in any order, and their bytes, (n, bytes) uint8."""
        self._n_pending = 0
        self._path = temporary_name(output)
        self._file: BinaryIO = self._path.open("w+b", buffering=0)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        """Return the length of the column so far."""
        return self._n_seen if self._n_fixed is None else self._n_fixed

    def put(self, record: I64, values: NDArray[Any]) -> None:
        """Set values by record index; a later value replaces an earlier one."""
        if not len(record):
            return
        if np.all(np.diff(record) == 1):
            self.put_run(int(record[0]), values)
            return
        self._see(int(record.min()), int(record.max()))
        self._pending.append((np.array(record, np.int64), self._stored(values)))
        self._n_pending += len(record)
        if self._n_pending >= BUFFER_ITEMS:
            self._flush()

    def put_run(self, first: int, values: NDArray[Any]) -> None:
        """Set the values of consecutive records, as :meth:`put` does."""
        if len(values):
            self._see(first, first + len(values) - 1)
            self._flush()  # a later value replaces an earlier one
            self._write(first, self._stored(values))

    def append(self, values: NDArray[Any]) -> None:
        """Set the values of the next records."""
        self.put_run(self._n_seen, values)

    def _see(self, low: int, high: int) -> None:
        if low < 0 or (self._n_fixed is not None and high >= self._n_fixed):
            message = f"record {low if low < 0 else high} outside 0..{self._n_fixed}"
            raise IndexError(message)
        self._n_seen = max(self._n_seen, high + 1)

    def get(self, record: I64) -> NDArray[Any]:
        """Return values in the shape of ``record``; the fill value for unknown records."""
        self._flush()
        flat = record.ravel()
        rows: U8 = np.zeros((len(flat), self._size), np.uint8)
        inside = np.flatnonzero((flat >= 0) & (flat < len(self)))
        inside = inside[np.argsort(flat[inside], kind="stable")]
        for page in self._pages(flat[inside]):
            wanted = flat[inside[page]]
            rows[inside[page]] = self._read(int(wanted[0]), int(wanted[-1]) + 1)[wanted - wanted[0]]
        return self._values(rows).reshape(record.shape)

    def chunks(self, n: int, *, first: int = 0, stop: int | None = None) -> Iterator[NDArray[Any]]:
        """Yield arrays of up to ``n`` values, records ``first`` to ``stop`` (exclusive)."""
        stop = len(self) if stop is None else stop
        for start in range(first, stop, n):
            yield self.span(start, min(start + n, stop))

    def span(self, first: int, stop: int) -> NDArray[Any]:
        """Return the values of records ``first`` to ``stop`` (exclusive)."""
        self._flush()
        return self._values(self._read(first, stop))

    def close(self) -> None:
        """Close and remove the temporary file; a full disk may refuse it quietly."""
        self._pending.clear()
        with contextlib.suppress(OSError):
            self._file.close()
        with contextlib.suppress(OSError):
            self._path.unlink(missing_ok=True)

    def _stored(self, values: NDArray[Any]) -> U8:
        """Return the stored bytes of values, (n, bytes) uint8."""
        rows: U8 = (
            np.ascontiguousarray(values, self._dtype).view(np.uint8).reshape(-1, self._size)
            ^ self._mask
        )
        return rows

    def _values(self, rows: U8) -> NDArray[Any]:
        return (rows ^ self._mask).view(self._dtype)[:, 0]

    def _flush(self) -> None:
        if not self._pending:
            return
        record, rows = (np.concatenate(parts) for parts in zip(*self._pending, strict=True))
        self._pending.clear()
        self._n_pending = 0
        order = np.argsort(record, kind="stable")
        record = record[order]
        rows = rows[order]
        for page in self._pages(record):
            in_page = record[page]
            span = self._read(int(in_page[0]), int(in_page[-1]) + 1)
            span[in_page - in_page[0]] = rows[page]
            self._write(int(in_page[0]), span)

    def _pages(self, record: I64) -> Iterator[slice]:
        """Yield slices of sorted records, one per page."""
        bounds = np.flatnonzero(np.diff(record // self._page_items)) + 1
        for start, stop in pairwise([0, *bounds.tolist(), len(record)]):
            if stop > start:
                yield slice(start, stop)

    def _write(self, first: int, rows: U8) -> None:
        self._file.seek(first * self._size)
        data = rows.reshape(-1).data
        done = 0
        while done < len(data):  # a single write of an unbuffered file may be short
            done += self._file.write(data[done : done + WRITE_BYTES])

    def _read(self, first: int, stop: int) -> U8:
        """Return stored bytes, (n, bytes) uint8; zero beyond the end of the file."""
        span: U8 = np.zeros(((stop - first), self._size), np.uint8)
        self._file.seek(first * self._size)
        data = span.reshape(-1).data
        done = 0
        while got := self._file.readinto(data[done:]):  # type: ignore[attr-defined]
            done += got
        return span


class NpyFile:
    """A ``.npy`` file that grows; its header has room for any length."""

    def __init__(self, handle: BinaryIO, dtype: str, row: tuple[int, ...] = ()) -> None:
        self.handle = handle
        self._dtype = dtype
        self._row = row
        self._n = 0
        handle.write(self._header())

    def append(self, values: NDArray[Any]) -> None:
        """Write the next rows."""
        self.handle.write(np.ascontiguousarray(values, self._dtype).data)
        self._n += len(values)

    def finish(self) -> None:
        """Write the header again, now with the number of rows."""
        self.handle.seek(0)
        self.handle.write(self._header())
        self.handle.seek(0)

    def _header(self) -> bytes:
        return npy_header(self._dtype, (self._n, *self._row))


def npy_header(dtype: str, shape: tuple[int, ...]) -> bytes:
    """Return the header of a ``.npy`` file."""
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        header, {"descr": dtype, "fortran_order": False, "shape": shape}
    )
    return header.getvalue()


@contextlib.contextmanager
def scratch_file(what: str) -> Iterator[BinaryIO]:
    """Return an unnamed temporary file, which the system removes when the process ends."""
    with scratch_errors(what):
        handle = tempfile.TemporaryFile(prefix="prc-")  # noqa: SIM115 - closed below
    try:
        yield cast("BinaryIO", handle)
    finally:
        # close flushes: on a full disk it fails again and would hide the first error
        with contextlib.suppress(OSError):
            handle.close()


@contextlib.contextmanager
def scratch_errors(what: str) -> Iterator[None]:
    """Turn errors of an unnamed temporary file into output errors."""
    try:
        yield
    except OSError as error:
        problem = f"the temporary file for {what} failed ({error.strerror or error})"
        hint = "free space there or point TMPDIR to a larger disk"
        raise OutputError(tempfile.gettempdir(), problem, hint) from error
