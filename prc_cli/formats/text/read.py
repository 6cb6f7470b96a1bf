"""Reader of text files, one record per row, plain or compressed, in bounded memory.

Blocks of whole lines go through pyarrow's CSV parser. Blocks that it refuses are read again by a
slow exact parser, which names the wrong cell, or accepts cells that pyarrow does not.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.threads import default_threads, ordered
from prc_cli.core.types import F64
from prc_cli.formats.names import angle_rules, find_columns, is_horizontal, ring_rules
from prc_cli.formats.options import Layout, LayoutField
from prc_cli.formats.records import AXES, Column, FieldSource, shorten
from prc_cli.formats.text.dialect import (
    BLANKS,
    MISSING_WORDS,
    QUOTED_DECIMALS,
    TextFormat,
    find_format,
    split,
    to_number,
    try_split,
    with_point,
)
from prc_cli.formats.text.lines import BLOCK_BYTES, MAX_LINE_BYTES, Lines, iter_lines

PARSERS = 2
"""Blocks parsed at a time: more need memory and take cores from the classifier."""
CLOUD_SUFFIXES = (".xyz", ".asc", ".pts")
"""Files whose first columns are x, y, z where they have no names."""


class TextBody:
    """Rows of numbers; the key of a column is its number."""

    def __init__(
        self,
        path: Path,
        text: TextFormat,
        block_bytes: int = BLOCK_BYTES,
        n_records: int | None = None,
    ) -> None:
        self._path = path
        self.text = text
        self._block_bytes = block_bytes
        self.n_records = n_records
        """Number of rows by a header; later rows are not read. None = all."""
        # possessive: a run of comments is one match without backtracking, which would take minutes
        run = rb"^(?:[ \t]*+" + re.escape(text.comment) + rb"[^\n]*+(?:\n|\Z))++"
        self._comments = re.compile(run, re.MULTILINE) if text.comment else None

    def stored(self, keys: tuple[str, ...]) -> Iterator[tuple[int, dict[str, F64], int]]:
        """Yield first record, numbers by column, number of records.

        Every row needs as many cells as the first.
        """
        first = 0
        for columns in self._blocks([int(key) for key in keys]):
            n = len(columns[0])
            if n:
                yield first, dict(zip(keys, columns, strict=True)), n
            first += n
        if self.n_records is not None and first < self.n_records:
            problem = f"the file ends after {first} points, the header says {self.n_records}"
            raise InputError(str(self._path), problem, "copy it from the archive again")

    def _blocks(self, used: list[int]) -> Iterator[list[F64]]:
        """Parse the rows; from the second block on, several blocks at a time."""
        rows = self._rows()
        if self.n_records is not None:
            rows = _first_rows(rows, self.n_records)
        elif self.text.n_columns == 1:
            rows = self._without_gaps(rows)
        first = next(rows, None)
        if first is not None:
            yield self._parse(first, used)
            threads = min(PARSERS, default_threads())
            yield from ordered(
                lambda lines: self._parse(lines, used), rows, threads=threads, ahead=PARSERS
            )

    def _rows(self) -> Iterator[Lines]:
        header = max(self.text.header_line or 0, self.text.last_head)
        for lines in iter_lines(self._path, self._block_bytes):
            n_skipped = max(0, header + 1 - lines.first)
            parts = lines.data.split(b"\n", n_skipped)
            if len(parts) > n_skipped and parts[-1]:
                yield Lines(lines.first + n_skipped, parts[-1])

    def _without_gaps(self, blocks: Iterator[Lines]) -> Iterator[Lines]:
        """Raise an error for blank lines between rows of one column: they may be missing shots."""
        blank = None
        for lines in blocks:
            gap = _BLANK.search(lines.data) if blank is None else None
            if gap is not None:
                blank = lines.first + lines.data.count(b"\n", 0, gap.start())
            behind = lines.data[0 if gap is None else gap.end() :]
            if blank is not None and self._plain(behind).strip():
                problem = "a blank line between rows of one column, which may be a missing shot"
                hint = "write nan for a missing shot: sed 's/^$/nan/' IN > OUT; or delete the line"
                raise InputError(f"{self._path}: line {blank}", problem, hint)
            if blank is None or gap is not None:
                yield lines if gap is None else Lines(lines.first, lines.data[: gap.start()])

    def _parse(self, lines: Lines, used: list[int]) -> list[F64]:
        data = self._plain(lines.data)
        columns = parse_fast(
            data, self.text.n_columns, used, self.text.delimiter, self.text.decimal
        )
        if (
            columns is not None
            and b'"' in data
            and not self._quotes_are_closed(data, len(columns[0]))
        ):
            columns = None
        return self._parse_exactly(lines, used) if columns is None else columns

    def _plain(self, data: bytes) -> bytes:
        """Return lines without comments and with single blanks."""
        if self._comments is not None and self.text.comment in data:
            data = self._comments.sub(b"", data)
        return single_blanks(data) if self.text.delimiter == BLANKS else data

    def _quotes_are_closed(self, data: bytes, n_rows: int) -> bool:
        """Whether every line became a row: an unclosed quote swallows line ends."""
        rows = [line for line in data.split(b"\n") if self.text.stripped(line)]
        last = rows[-1].rstrip(b"\r").decode("utf-8", errors="replace")
        return n_rows == len(rows) and try_split(last, self.text.delimiter) is not None

    def _parse_exactly(self, lines: Lines, used: list[int]) -> list[F64]:
        """Read the rows cell by cell; raise at the first error."""
        text = self.text
        columns = [array("d") for _ in used]
        for number, line in enumerate(lines.data.split(b"\n"), lines.first):
            if not text.is_row(line):
                continue
            row = line.rstrip(b"\r").decode("utf-8", errors="surrogateescape")
            cells = self._split(number, row)
            for index, values in zip(used, columns, strict=True):
                value = to_number(with_point(cells[index], text.decimal))
                if value is None:
                    raise self._not_a_number(number, index, cells[index])
                values.append(value)
        return [np.array(values, dtype=np.float64) for values in columns]

    def cells(self, index: int) -> Iterator[list[tuple[int, str]]]:
        """Yield line numbers and texts of one column, some rows at a time."""
        text = self.text
        for lines in self._rows():
            numbered = enumerate(lines.data.split(b"\n"), lines.first)
            rows = [
                (number, line.rstrip(b"\r").decode(errors="replace"))
                for number, line in numbered
                if text.is_row(line)
            ]
            yield [(number, self._split(number, row)[index]) for number, row in rows]

    def _split(self, number: int, row: str) -> list[str]:
        text = self.text
        cells = split(self._path, number, row, text.delimiter)
        if len(cells) != text.n_columns:
            expected = f"expected {text.n_columns} as in line {text.first_row}"
            problem = f"{len(cells)} cells, {expected}: {shorten(row)!r}"
            raise InputError(
                f"{self._path}: line {number}", problem, "correct the row; an empty cell is missing"
            )
        return cells

    def _not_a_number(self, number: int, index: int, cell: str) -> InputError:
        name = self.text.names[index]
        is_text = re.search("[\udc80-\udcff]", cell) is None
        shown = repr(shorten(cell.strip(" \t"))) if is_text else "bytes that are not UTF-8"
        column = repr(shorten(name)) if name else f"{index} (from 0)"
        hint = _hint_of_cell(cell.strip(), name, self.text.delimiter, number)
        problem = f"column {column}: found {shown}, expected a number"
        return InputError(f"{self._path}: line {number}", problem, hint)


_MINUS = "\u2212\u2013"
"""Characters that look like a minus."""
_HINTS = (
    (
        r"[+-]?\d{1,3}(?:[,.' \u00a0\u202f\u2019]\d{3})+(?:[.,]\d+)?",
        "write numbers without thousands separators",
    ),
    (
        r"[+-]?\d*\.?\d+[dD][+-]?\d+",
        r"write exponents with E: sed -E 's/([0-9.])[dD]([+-]?[0-9])/\1E\2/g' IN > OUT",
    ),
    (rf"[{_MINUS}].*", "write the minus as -: sed 's/\u2212/-/g; s/\u2013/-/g' IN > OUT"),
    (
        r"\d{4}-\d\d-\d\d.*|\d{1,2}:\d\d(?::.*)?",
        "write times as seconds, such as GPS seconds of the week",
    ),
    (r"\x1a", "the end mark of an old program: tr -d '\\032' < IN > OUT"),
)
"""Patterns of cells that are no numbers, and hints."""


def _hint_of_cell(
    cell: str,
    name: str,
    delimiter: str,
    line: int,
) -> str:
    if name and cell == name:
        return f"the names come again: sed {line}d IN > OUT"
    if re.fullmatch(r"[+-]?\d+,\d+", cell):
        if delimiter == ",":
            return f"write decimals with a point: {QUOTED_DECIMALS}"
        return "write decimals with a point, or give --set layout.decimal=,"
    for pattern, hint in _HINTS:
        if re.fullmatch(pattern, cell):
            return hint
    return "leave the cell empty or write nan where there is no value"


_BLANK = re.compile(rb"^(?:[ \t\r]*+\n|[ \t\r]++\Z)", re.MULTILINE)


def _first_rows(blocks: Iterator[Lines], n: int) -> Iterator[Lines]:
    for lines in blocks:
        rows = lines.data.split(b"\n", n)
        if len(rows) > n:
            yield Lines(lines.first, b"\n".join(rows[:n]) + b"\n")
            return
        n -= len(rows) - (not rows[-1])
        yield lines


def single_blanks(data: bytes) -> bytes:
    """Return lines with single blanks between cells."""
    data = data.replace(b"\t", b" ").replace(b"\r\n", b"\n")
    while b"  " in data:
        data = data.replace(b"  ", b" ")
    return data.replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(b" ")


def parse_fast(
    data: bytes,
    n_columns: int,
    used: Sequence[int],
    delimiter: str = BLANKS,
    decimal: str = ".",
) -> list[F64] | None:
    """Parse columns of rows with pyarrow; None if it fails or may count lines differently.

    Parameters
    ----------
    data
        Whole lines.
    n_columns
        Cells of a row.
    used
        Columns to parse.
    delimiter, decimal
        See :class:`TextFormat`.

    Returns
    -------
    list of (n,) float64, or None
    """
    import pyarrow as pa
    from pyarrow import csv

    if b"\r" in data and data.count(b"\r") != data.count(b"\r\n"):
        return None  # pyarrow treats a lone carriage return as a line end
    keys = [str(index) for index in range(n_columns)]
    wanted = {keys[index]: pa.float64() for index in used}
    try:
        table = csv.read_csv(
            pa.BufferReader(data),
            # several blocks are parsed in parallel already
            csv.ReadOptions(column_names=keys, block_size=MAX_LINE_BYTES, use_threads=False),
            csv.ParseOptions(delimiter=delimiter),
            csv.ConvertOptions(
                column_types=wanted,
                include_columns=list(wanted),
                null_values=["", *MISSING_WORDS],
                decimal_point=decimal,
            ),
            # freed memory goes back to the system, not to pyarrow's own pool
            pa.system_memory_pool(),
        )
    except pa.ArrowInvalid:
        return None
    return [table.column(keys[index]).to_numpy() for index in used]


class TextSource(FieldSource):
    """A text file as a :class:`prc_cli.formats.records.Source`.

    All values are float64; empty cells and ``nan`` are NaN. Angles are converted from degrees to
    radians, unless the layout or the name of the column (``angle_rad``) gives another unit. A
    single column without a name is the range.
    """

    def __init__(
        self, path: Path, layout: Layout | None = None, block_bytes: int = BLOCK_BYTES
    ) -> None:
        self.text = find_format(path, layout)
        names = self.text.names
        n = self.text.n_columns
        self._has_layout = layout is not None and bool(layout.fields)
        self._is_cloud = path.suffix.lower() in CLOUD_SUFFIXES
        if not self._has_layout and not any(names):
            usual: tuple[str, ...] = ("range",) if n == 1 and self.text.header_line is None else ()
            if self._is_cloud and n >= len(AXES):
                usual = (*AXES, "intensity")[: n if path.suffix.lower() == ".pts" else len(AXES)]
            fields = tuple(LayoutField(name=name) for name in usual)
            layout = (layout or Layout()).model_copy(update={"fields": fields})
        where = f"{path}: line {self.text.header_line or self.text.first_row}"
        hint = f"; is {self.text.delimiter!r} the delimiter?" if n == 1 else ""
        columns = find_columns(where, names, layout, tuple(map(str, range(n))), hint)
        super().__init__(path, "text", columns, TextBody(path, self.text, block_bytes))
        rules = angle_rules(columns["angle"].name if "angle" in columns else None)
        # VeloView writes the azimuth of the head and the range beside the ring
        has_azimuth = "angle" in columns and is_horizontal(columns["angle"].name)
        of_lines = {"scan_line", "column"} | (set() if has_azimuth else {"range", "angle"})
        has_lines = bool(of_lines & set(columns))
        if {"ring", *AXES} <= set(columns) and not has_lines:
            rules += ring_rules()
        range_name = columns["range"].name if "range" in columns else "range"
        header = {
            "delimiter": self.text.delimiter,
            "decimal": self.text.decimal,
            "header_line": self.text.header_line,
            "columns": list(self.text.names),
        }
        self.facts = SourceFacts(
            notes=self.notes, range_name=range_name, rules=rules, header=header
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """What was detected, one sentence each, for ``prc info``."""
        text = self.text
        columns = self.columns
        shown = {BLANKS: "blanks", "\t": "tabs"}.get(text.delimiter, repr(text.delimiter))
        axes = "x, y, z and intensity" if "intensity" in columns else "x, y, z"
        renamed = [
            f"{column.name} as {name}"
            for name, column in columns.items()
            if column.name not in ("", name)
        ]
        units = [
            f"{name} in {column.item.unit}"
            for name, column in columns.items()
            if column.item.unit not in ("", "rad")
        ]
        angle = columns.get("angle", Column("", "", LayoutField(name="angle")))
        holds_by_note = {
            f"cells are separated by {shown}, found by looking": text.found_delimiter
            and text.n_columns > 1,
            "decimals stand behind a comma, found by looking": text.decimal == ",",
            f"line {text.header_line} holds the names of the columns": any(text.names),
            f"the first columns have no names: taken as {axes}": self._is_cloud
            and "x" in columns
            and not any(text.names),
            f"units from the names of the columns: {', '.join(units)}": units
            and not self._has_layout,
            f"columns taken under another name: {', '.join(renamed)}": renamed,
            "angles are taken as degrees": angle.name
            and not angle.item.unit
            and "deg" not in angle.name.lower(),
            "a single column without a name: taken as the range [m]": text.header_line is None
            and "range" in columns
            and text.n_columns == 1,
        }
        return tuple(note for note, holds in holds_by_note.items() if holds)
