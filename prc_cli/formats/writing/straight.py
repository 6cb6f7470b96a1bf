"""Writes class codes that arrive in record order, as from range images, directly to the output."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from prc_cli.core.bytewise import count_bytes
from prc_cli.core.types import I64, U8
from prc_cli.formats.writing.spool import write_all


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
