"""Records in the order of their times, kept in an unnamed temporary file and read in pieces."""

from __future__ import annotations

import contextlib
import tempfile
import weakref
from collections.abc import Iterator
from typing import BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from prc_cli.formats.writing.disk import scratch_errors

CHUNK_RECORDS = 1 << 18
"""Records that are read at a time."""
_WHAT = "sorting"


class Spool:
    """Records of one type on disk; memory holds only the records being read or written."""

    def __init__(self, dtype: np.dtype[np.void]) -> None:
        with scratch_errors(_WHAT):
            handle = tempfile.TemporaryFile(prefix="prc-")  # noqa: SIM115 - closed when the spool is no longer used
        self._file = cast("BinaryIO", handle)
        self.dtype = dtype
        self._n = 0
        # a full disk refuses the last write once more
        weakref.finalize(self, _close, self._file)

    def __len__(self) -> int:
        """Return the number of records."""
        return self._n

    def append(self, records: NDArray[np.void]) -> None:
        """Write the next records."""
        with scratch_errors(_WHAT):
            self._file.seek(self._n * self.dtype.itemsize)
            self._file.write(np.ascontiguousarray(records).view(np.uint8).data)
        self._n += len(records)

    def read(self, start: int, stop: int) -> NDArray[np.void]:
        """Return the records from ``start`` to ``stop`` (exclusive)."""
        records = np.empty(min(stop, self._n) - start, self.dtype)
        with scratch_errors(_WHAT):
            self._file.seek(start * self.dtype.itemsize)
            raw = self._file.read(records.nbytes)
        records.view(np.uint8)[:] = np.frombuffer(raw, np.uint8)
        return records

    def chunks(
        self, start: int = 0, stop: int | None = None, n: int = CHUNK_RECORDS
    ) -> Iterator[NDArray[np.void]]:
        """Read the records from ``start`` to ``stop`` in pieces of ``n``."""
        stop = self._n if stop is None else stop
        for first in range(start, stop, n):
            yield self.read(first, min(first + n, stop))


def _close(handle: BinaryIO) -> None:
    with contextlib.suppress(OSError):
        handle.close()
