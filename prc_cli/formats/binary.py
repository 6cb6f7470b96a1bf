"""Numbers and records of fixed size in a binary file, read in bounded memory."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.files import open_to_read

CHUNK_RECORDS = 1 << 18
"""Records decoded at a time."""
CHUNK_BYTES = 16 << 20
"""Most bytes decoded at a time: long records make shorter chunks."""


@dataclass(slots=True)
class BinaryBody:
    """Records of fixed size, one after the other."""

    path: Path
    dtype: np.dtype[np.void]
    start: int
    """First byte."""
    n_records: int
    chunk_records: int | None = None
    """Records read at a time; None = as many as the limits allow."""

    @property
    def n_at_once(self) -> int:
        """Records read at a time."""
        return max(1, min(self.chunk_records or CHUNK_RECORDS, CHUNK_BYTES // self.dtype.itemsize))

    def stored(self, keys: tuple[str, ...]) -> Iterator[tuple[int, NDArray[Any], int]]:
        """Yield index of the first record, records, and their number."""
        with open_to_read(self.path) as handle:
            handle.seek(self.start)
            n_at_once = self.n_at_once
            for first in range(0, self.n_records, n_at_once):
                wanted = min(n_at_once, self.n_records - first)
                records = read_numbers(self.path, handle, self.dtype, wanted, first)
                if len(records) < wanted:
                    n_read = first + len(records)
                    end_byte = self.start + n_read * self.dtype.itemsize
                    where = f"byte {end_byte} (record {n_read})"
                    problem = f"{where}: the file ends, expected {self.n_records} records"
                    hint = (
                        "the file became shorter while prc read it: wait until its writer is done"
                    )
                    raise InputError(str(self.path), f"{problem} as when opened", hint)
                yield first, records, wanted


def read_numbers(
    path: Path,
    handle: Any,
    dtype: np.dtype[Any],
    n: int,
    first: int,
) -> NDArray[Any]:
    """Return the next numbers or records of a file, fewer at its end."""
    try:
        return np.fromfile(handle, dtype, n)
    except OSError as error:
        problem = f"record {first} and on cannot be read ({error.strerror or error})"
        raise InputError(str(path), problem, "check the disk or copy the file again") from error


def binary_body(
    path: Path,
    dtype: np.dtype[np.void],
    start: int,
    n: int,
    hint: str,
) -> BinaryBody:
    """Return the records behind a header.

    Parameters
    ----------
    path
        The file.
    dtype
        Type of a record.
    start
        First byte behind the header.
    n
        Number of records by the header.
    hint
        Hint of the error.

    Raises
    ------
    InputError
        If the file has fewer bytes.
    """
    n_bytes = max(path.stat().st_size - start, 0)
    size = dtype.itemsize
    if n * size > n_bytes:
        problem = f"the file ends in point {n_bytes // size}, the header says {n} of {size} bytes"
        raise InputError(str(path), problem, hint)
    return BinaryBody(path, dtype, start, n)
