"""Rows of numbers behind a header of another format (PLY and PCD as text)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.formats.options import LayoutField
from prc_cli.formats.text.columns import TextColumn
from prc_cli.formats.text.dialect import BLANKS, TextFormat, shorten
from prc_cli.formats.text.lines import BLOCK_BYTES, Lines
from prc_cli.formats.text.read import TextSource


class TextBody(TextSource):
    """A given number of rows of blank-separated numbers."""

    def __init__(
        self, path: Path, names: tuple[str, ...], first_line: int, n_records: int, block_bytes: int = BLOCK_BYTES
    ) -> None:
        self._path = path
        self._block_bytes = block_bytes
        self._text = TextFormat(BLANKS, b"", first_line - 1, first_line, names, False)
        self._columns = {
            name: TextColumn(index, repr(shorten(name)), LayoutField.model_construct(name=f"stored {name}"))
            for index, name in enumerate(names)
        }
        self._comments = None
        self._n_records = n_records

    @property
    def n_records(self) -> int:  # type: ignore[override]
        """Number of rows, from the header."""
        return self._n_records

    def _rows(self) -> Iterator[Lines]:
        """Yield the rows of the points alone."""
        left = self._n_records
        for lines in super()._rows():
            n = lines.data.count(b"\n") + (not lines.data.endswith(b"\n"))
            if n >= left:
                rows = lines.data.split(b"\n", left)[:left]
                yield Lines(lines.first, b"\n".join(rows) + b"\n")
                return
            left -= n
            yield lines

    def chunks(self, names: tuple[str, ...]) -> Iterator[tuple[int, dict[str, NDArray[Any]], int]]:  # type: ignore[override]
        """Yield index of the first record, float64 values by column, and number of records."""
        n_found = 0
        for chunk in super().chunks(names):
            yield chunk.first_record, chunk.values, chunk.n
            n_found += chunk.n
        if n_found < self._n_records:
            problem = f"the file ends after {n_found} points, the header says {self._n_records}"
            raise InputError(str(self._path), problem, "copy it from the archive again")
