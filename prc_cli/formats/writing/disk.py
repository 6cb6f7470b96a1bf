"""Values by record index on disk, in any order in and in any order out; arrays that grow; temporary files.

The order of writing and that of reading differ when several scanners share a file or a file was sorted: then values are
scattered and gathered page by page. Memory is a page and a buffer, whatever the size of the file.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Self, cast

import numpy as np
from numpy.typing import DTypeLike, NDArray

from prc_cli.core.errors import OutputError
from prc_cli.core.files import temporary_name
from prc_cli.core.types import I64

PAGE_BYTES = 1 << 20
BUFFER_ITEMS = 1 << 20
WRITE_BYTES = 1 << 16
"""Bytes per write: for more, Linux searches large blocks of free memory, which takes up to ten times as long as the
copy."""


class DiskColumn:
    """One value, or one row of several, per record, in a temporary file beside an output; others read as ``fill``.

    >>> with DiskColumn(Path(tempfile.mkdtemp()) / "s", np.uint8, 1, n_records=6) as column:
    ...     column.put(np.array([4, 2]), np.array([9, 7], np.uint8))
    ...     np.concatenate(list(column.chunks(4))), column.get(np.array([[2, -1], [9, 4]]))
    (array([1, 1, 7, 1, 9, 1], dtype=uint8), array([[7, 1],
           [1, 9]], dtype=uint8))
    """

    def __init__(self, output: Path, dtype: DTypeLike, fill: Any, *, n_records: int | None = None) -> None:
        self._dtype = np.dtype(dtype)
        size = self._dtype.itemsize
        self._bits = np.dtype(f"u{size}" if size in (1, 2, 4, 8) else f"V{size}")
        # stored as value XOR fill: holes in the file read as zero, so as the fill value
        self._mask = np.array([fill], self._dtype).view(self._bits)
        self._page_items = max(1, PAGE_BYTES // size)
        self._n_fixed = n_records
        self._n_seen = 0
        self._pending: list[tuple[I64 | int, NDArray[Any]]] = []
        """Buffered records and values; only the first index of consecutive records."""
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
        low, high = int(record[0]), int(record[-1])
        if high - low == len(record) - 1 and bool(np.all(record[1:] > record[:-1])):
            self.put_run(low, values)
        else:
            self._keep(np.array(record, np.int64), values, int(record.min()), int(record.max()))

    def put_run(self, first: int, values: NDArray[Any]) -> None:
        """Set the values of consecutive records, as :meth:`put` does."""
        if len(values):
            self._keep(first, values, first, first + len(values) - 1)

    def append(self, values: NDArray[Any]) -> None:
        """Set the values of the next records."""
        self.put_run(self._n_seen, values)

    def _keep(self, record: I64 | int, values: NDArray[Any], low: int, high: int) -> None:
        if low < 0 or (self._n_fixed is not None and high >= self._n_fixed):
            message = f"record {low if low < 0 else high} outside 0..{self._n_fixed}"
            raise IndexError(message)
        self._n_seen = max(self._n_seen, high + 1)
        self._pending.append((record, self._masked(np.ascontiguousarray(values, self._dtype).view(self._bits))))
        self._n_pending += len(values)
        if self._n_pending >= BUFFER_ITEMS:
            self._flush()

    def get(self, record: I64) -> NDArray[Any]:
        """Return the values of records, in the shape of ``record``; unknown indices give the fill value."""
        self._flush()
        flat = record.ravel()
        result = np.zeros(flat.shape, self._bits)
        held = np.flatnonzero((flat >= 0) & (flat < len(self)))
        wanted = flat[held]
        # where the records lie close together, one read has them all
        if len(held) and int(wanted.max()) - int(wanted.min()) >= 4 * max(len(held), self._page_items):
            order = np.argsort(wanted, kind="stable")
            held, wanted = held[order], wanted[order]
            page = wanted // self._page_items
            starts = np.flatnonzero(np.concatenate(([True], page[1:] != page[:-1]))).tolist()
        else:
            starts = [0] if len(held) else []
        for start, stop in zip(starts, [*starts[1:], len(wanted)], strict=True) if starts else ():
            first, last = int(wanted[start:stop].min()), int(wanted[start:stop].max())
            result[held[start:stop]] = self._read(first, last + 1 - first)[wanted[start:stop] - first]
        return self._masked(result).view(self._dtype).reshape(record.shape)

    def chunks(self, n: int, *, first: int = 0, stop: int | None = None) -> Iterator[NDArray[Any]]:
        """Read the column in arrays of up to ``n`` values, records ``first`` to ``stop`` (default: all).

        ``stop`` may lie beyond the last record written: what follows reads as the fill value.
        """
        self._flush()
        stop = len(self) if stop is None else stop
        for start in range(first, stop, n):
            yield self._masked(self._read(start, min(n, stop - start))).view(self._dtype)

    def span(self, first: int, stop: int) -> NDArray[Any]:
        """Return the values of records ``first`` to ``stop`` (exclusive), at least one."""
        return next(self.chunks(stop - first, first=first, stop=stop))

    def close(self) -> None:
        """Close and remove the temporary file; a full disk may refuse it quietly."""
        self._pending.clear()
        with contextlib.suppress(OSError):
            self._file.close()
        with contextlib.suppress(OSError):
            self._path.unlink(missing_ok=True)

    def _masked(self, bits: NDArray[Any]) -> NDArray[Any]:
        """Return values as they are stored, or stored ones as values."""
        masked: NDArray[Any]
        if self._bits.kind == "u":
            masked = bits ^ self._mask
        else:
            rows = np.frombuffer(bits.tobytes(), np.uint8).reshape(len(bits), self._bits.itemsize)
            masked = (rows ^ self._mask.view(np.uint8)).view(self._bits)[:, 0]
        return masked

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
            own, first = record[start:stop], int(record[start])
            n = int(own[-1]) - first + 1
            if n == len(own) and bool(np.all(np.diff(own) == 1)):
                self._write_run(first, bits[start:stop])
            else:
                span = self._read(first, n)
                span[own - first] = bits[start:stop]
                self._write_run(first, span)

    def _read(self, first: int, n: int) -> NDArray[Any]:
        """Return what is stored; zero beyond the end of the file."""
        span = np.zeros(n * self._bits.itemsize, np.uint8)
        self._file.seek(first * self._bits.itemsize)
        done = 0
        while got := self._file.readinto(span.data[done:]):  # type: ignore[attr-defined]
            done += got
        return span.view(self._bits)


class NpyFile:
    """A ``.npy`` file that grows; numpy leaves room in the header for any length.

    >>> path = Path(tempfile.mkdtemp()) / "codes.npy"
    >>> with path.open("w+b") as handle:
    ...     codes = NpyFile(handle, "|u1")
    ...     codes.append(np.array([2, 2, 7], np.uint8))
    ...     codes.finish()
    >>> np.load(path)
    array([2, 2, 7], dtype=uint8)
    """

    def __init__(self, handle: BinaryIO, dtype: str, row: tuple[int, ...] = ()) -> None:
        self.handle = handle
        self._dtype, self._row = dtype, row
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
    np.lib.format.write_array_header_1_0(header, {"descr": dtype, "fortran_order": False, "shape": shape})
    return header.getvalue()


def write_all(handle: BinaryIO, data: memoryview) -> None:
    """Write to an unbuffered file until nothing is left (a single write may be short)."""
    done = 0
    while done < len(data):
        done += handle.write(data[done : done + WRITE_BYTES])


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
    """Turn what the system says of an unnamed temporary file into one line."""
    try:
        yield
    except OSError as error:
        problem = f"the temporary file for {what} failed ({error.strerror or error})"
        hint = "free space there or point TMPDIR to a larger disk"
        raise OutputError(tempfile.gettempdir(), problem, hint) from error
