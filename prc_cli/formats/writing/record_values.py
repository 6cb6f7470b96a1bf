"""Values by record index on disk: written in input order, read in stream order.

The opposite of :mod:`~prc_cli.formats.writing.spool`. Where both orders agree, a query is one read; where they differ
(several scanners in a file, sorted records) it is read page by page.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import I64
from prc_cli.formats.writing.spool import write_all

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
