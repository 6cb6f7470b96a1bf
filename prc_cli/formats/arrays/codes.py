"""Class codes in arrays."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.formats.arrays.rows import ArrayFile
from prc_cli.formats.labels import CODES_AT_ONCE, dimension_of_codes
from prc_cli.formats.organised.scans import MAX_POINTS_PER_LINE
from prc_cli.formats.records import CodeSource


def open_array_codes(path: Path, dimension: str | None) -> CodeSource:
    """Open an array of class codes, (records,) or (lines, M), in a file or an archive."""
    file = ArrayFile(path)
    if file.is_archive:
        name = dimension_of_codes(path, list(file.headers), dimension)
    elif dimension is not None:
        raise ConfigError(str(path), f"no dimension {dimension!r} in a .npy file", "leave it out")
    else:
        name = ""
    header = file.headers[name]
    header.check_numbers(expected="class codes, whole numbers")
    shape = header.shape
    if len(shape) not in (1, 2) or 0 in shape or max(shape[1:], default=1) > MAX_POINTS_PER_LINE:
        problem = f"found shape {shape}, expected (records,) or (lines, points per line)"
        raise InputError(header.where, problem, "save one class code a record, in record order")
    row = shape[1] if len(shape) == 2 else 1

    def read() -> Iterator[NDArray[Any]]:
        n_lines = max(1, CODES_AT_ONCE // row)
        with file.open(name) as (rows,):
            for first in range(0, shape[0], n_lines):
                yield rows.read(min(n_lines, shape[0] - first)).ravel()
            rows.finish()

    return CodeSource(path, shape[0] * row, read, name=name)
