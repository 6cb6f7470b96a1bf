"""Reader of text files, one record per row, plain or compressed, in bounded memory.

Blocks of whole lines go through pyarrow's CSV parser. Blocks that it refuses are read again by a slow exact parser,
which either names the line and cell or accepts what pyarrow was too strict for.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.threads import default_threads, ordered
from prc_cli.core.types import F64
from prc_cli.formats.names import angle_rules
from prc_cli.formats.options import Layout, check_fields, decode
from prc_cli.formats.records import STANDARD_NAMES, RecordChunk
from prc_cli.formats.text.columns import CLOUD_SUFFIXES, TextColumn, find_columns
from prc_cli.formats.text.dialect import (
    BLANKS,
    find_format,
    shorten,
    split,
    to_number,
    try_split,
    with_point,
)
from prc_cli.formats.text.lines import (
    BLOCK_BYTES,
    MAX_LINE_BYTES,
    Lines,
    count_line_ends,
    iter_lines,
)

_HEAD_BYTES = 256
PARSERS = 2
"""Blocks parsed at a time: more need memory and take cores from the classifier."""


class TextSource:
    """A text file as a :class:`prc_cli.formats.records.RecordSource`.

    All values are float64; empty cells and ``nan`` are NaN. Angles are converted from degrees to radians, unless the
    layout or the name of the column (``angle_rad``) gives another unit.
    """

    format = "text"
    """Reader name, for messages and ``prc info``."""
    n_records = None
    """Only reading can tell."""

    def __init__(self, path: Path, layout: Layout | None = None, block_bytes: int = BLOCK_BYTES) -> None:
        if layout is not None:
            check_fields(layout)
        self._path = path
        self._block_bytes = block_bytes
        self._is_cloud = path.suffix.lower() in CLOUD_SUFFIXES
        self._has_units = layout is None or not layout.fields
        self._text = find_format(path, layout)
        self._columns = find_columns(path, self._text, layout)
        comment = re.escape(self._text.comment)
        # possessive: a run of comments is one match without backtracking, which would take minutes
        run = rb"^(?:[ \t]*+" + comment + rb"[^\n]*+(?:\n|\Z))++"
        self._comments = re.compile(run, re.MULTILINE) if comment else None

    @property
    def path(self) -> str:
        """File name, for messages."""
        return str(self._path)

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names that :meth:`chunks` can deliver, standard names first; columns without a name are numbered."""
        return tuple(self._columns)

    @property
    def facts(self) -> SourceFacts:
        """Metadata of the file."""
        angle = self._columns.get("angle")
        rules = angle_rules(None if angle is None else self._text.names[angle.index])
        return SourceFacts(notes=self.notes, rules=rules, describe=self.describe)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was detected, one sentence each, for ``prc info``."""
        text = self._text
        notes = []
        if text.found_delimiter and text.n_columns > 1:
            shown = {BLANKS: "blanks", "\t": "tabs"}.get(text.delimiter, repr(text.delimiter))
            notes.append(f"cells are separated by {shown}, found by looking")
        if text.decimal == ",":
            notes.append("decimals stand behind a comma, found by looking")
        if text.header_line is not None and any(text.names):
            notes.append(f"line {text.header_line} holds the names of the columns")
        renamed = [
            f"{text.names[column.index]} as {name}"
            for name, column in self._columns.items()
            if text.names[column.index] not in ("", name)
        ]
        if "x" in self._columns and not any(text.names) and self._is_cloud:
            shown = "x, y, z and intensity" if "intensity" in self._columns else "x, y, z"
            notes.append(f"the first columns have no names: taken as {shown}")
        units = [
            f"{name} in {one.item.unit}" for name, one in self._columns.items() if one.item.unit not in ("", "rad")
        ]
        if units and self._has_units:
            notes.append(f"units from the names of the columns: {', '.join(units)}")
        if renamed:
            notes.append(f"columns taken under another name: {', '.join(renamed)}")
        angle = self._columns.get("angle")
        if (
            angle is not None
            and not angle.item.unit
            and text.names[angle.index]
            and "deg" not in text.names[angle.index].lower()
        ):
            notes.append("angles are taken as degrees")
        if text.header_line is None and "range" in self._columns and text.n_columns == 1:
            notes.append("a single column without a name: taken as the range [m]")
        return tuple(notes)

    def describe(self) -> dict[str, Any]:
        """Return the dialect as plain values for JSON, for ``prc info``."""
        text = self._text
        return {
            "delimiter": text.delimiter,
            "decimal": text.decimal,
            "header_line": text.header_line,
            "columns": list(text.names),
        }

    @property
    def known_columns(self) -> tuple[tuple[str, int, str], ...]:
        """Standard name, column number from 0 and unit of the columns whose names are known."""
        return tuple(
            (name, column.index, column.item.unit) for name, column in self._columns.items() if name in STANDARD_NAMES
        )

    def column_of(self, name: str) -> int:
        """Return the number of a column from 0."""
        return self._columns[name].index

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode the named columns from the start, in bounded memory, in the order of the file.

        Cells of other columns are ignored, but every row must have as many cells as the first.
        """
        unknown = [name for name in names if name not in self._columns]
        if unknown:
            known = ", ".join(shorten(name) for name in self.dimensions[:40])
            raise ConfigError(self.path, f"no dimension {unknown[0]!r} in the file", f"it has: {known}")
        columns = [self._columns[name] for name in names]
        # convert at least one column: pyarrow needs it to count rows
        read = columns or [next(iter(self._columns.values()))]
        first = 0
        blank = _BlankWatch(self._path, self._text.n_columns)
        for block in self._blocks(read):
            stored = self._judged(block, read, blank)
            n = len(stored[0])
            if n:
                values = {
                    name: decode(cells, column.item)
                    for name, cells, column in zip(names, stored, columns, strict=False)
                }
                yield RecordChunk(first, values, n)
            first += n

    def _blocks(self, columns: list[TextColumn]) -> Iterator[_Block]:
        """Parse the lines behind the header; from the second block on several at a time."""
        rows = self._rows()
        first = next(rows, None)
        if first is not None:
            yield self._parse(first, columns)
            yield from ordered(
                lambda lines: self._parse(lines, columns), rows, threads=min(PARSERS, default_threads()), ahead=PARSERS
            )

    def _rows(self) -> Iterator[Lines]:
        """Yield the lines behind the header."""
        header = self._text.header_line or 0
        for lines in iter_lines(self._path, self._block_bytes):
            skipped = max(0, header + 1 - lines.first)
            if skipped and skipped > lines.data.count(b"\n"):
                continue
            end = 0
            for _ in range(skipped):
                end = lines.data.find(b"\n", end) + 1
                if not end:
                    break
            if skipped and not end:
                continue
            yield Lines(lines.first + skipped, lines.data[end:])

    def _parse(self, lines: Lines, columns: list[TextColumn]) -> _Block:
        """Parse lines independently of earlier blocks."""
        data = self._plain(lines.data)
        # the first bytes of most blocks show that they are not blank
        blank_only = not self._text.stripped(data[:_HEAD_BYTES]) and not self._text.stripped(data)
        found = [np.empty(0)] * len(columns) if blank_only else self._parse_fast(data, columns)
        if self._text.n_columns == 1 and not blank_only and found is not None and len(found[0]) != _n_lines(data):
            found = None  # pyarrow skips blank lines
        return _Block(lines, found, blank_only)

    def _judged(self, block: _Block, columns: list[TextColumn], blank: _BlankWatch) -> list[F64]:
        """Return one array of stored numbers per column for the rows of a block, given the state of earlier blocks."""
        if block.is_blank and blank.first is not None:
            # the first blank line is known: do not go through a gigabyte of them line by line
            return [np.empty(0)] * len(columns)
        if block.found is None or (blank.watches and (blank.first is not None or block.is_blank)):
            return self._parse_exactly(block.lines, columns, blank)
        return block.found

    def _plain(self, data: bytes) -> bytes:
        """Return lines without comments and with single delimiters; fast where nothing is to be done."""
        if self._comments is not None and self._text.comment in data:
            data = self._comments.sub(b"", data)
        if self._text.delimiter == BLANKS:
            data = data.replace(b"\t", b" ").replace(b"\r\n", b"\n")
            while b"  " in data:
                data = data.replace(b"  ", b" ")
            data = data.replace(b"\n ", b"\n").replace(b" \n", b"\n").strip(b" ")
        return data

    def _parse_fast(self, data: bytes, columns: list[TextColumn]) -> list[F64] | None:
        """Parse the rows with pyarrow; None where it refuses or may count lines differently."""
        import pyarrow as pa
        from pyarrow import csv

        if b"\r" in data and data.count(b"\r") != data.count(b"\r\n"):
            return None  # pyarrow treats a lone carriage return as a line end
        keys = [str(index) for index in range(self._text.n_columns)]
        wanted = {keys[column.index]: pa.float64() for column in columns}
        try:
            table = csv.read_csv(
                pa.BufferReader(data),
                # several blocks are parsed in parallel already
                csv.ReadOptions(column_names=keys, block_size=MAX_LINE_BYTES, use_threads=False),
                csv.ParseOptions(delimiter=self._text.delimiter),
                csv.ConvertOptions(
                    column_types=wanted,
                    include_columns=list(wanted),
                    null_values=[""],
                    decimal_point=self._text.decimal,
                ),
                pa.system_memory_pool(),  # freed memory goes back to the system, not to pyarrow's own pool
            )
        except pa.ArrowInvalid:
            return None
        if b'"' in data and not self._quotes_are_closed(data, table.num_rows):
            return None
        return [table.column(keys[column.index]).to_numpy() for column in columns]

    def _quotes_are_closed(self, data: bytes, n_rows: int) -> bool:
        """Whether every line became a row: an unclosed quote swallows line ends."""
        rows = [line for line in data.split(b"\n") if self._text.stripped(line)]
        last = rows[-1].rstrip(b"\r").decode("utf-8", errors="replace")
        return n_rows == len(rows) and try_split(last, self._text.delimiter) is not None

    def _parse_exactly(self, lines: Lines, columns: list[TextColumn], blank: _BlankWatch) -> list[F64]:
        """Read the rows cell by cell; raise at the first error."""
        text = self._text
        found = [array("d") for _ in columns]
        all_lines = lines.data.split(b"\n")
        for number, line in enumerate(all_lines if all_lines[-1] else all_lines[:-1], lines.first):
            if not text.is_row(line):
                if not text.stripped(line):
                    blank.see(number)
                continue
            blank.check()
            row = line.rstrip(b"\r").decode("utf-8", errors="surrogateescape")
            cells = split(self._path, number, row, text.delimiter)
            if len(cells) != text.n_columns:
                problem = f"{len(cells)} cells, expected {text.n_columns} as in line {text.first_row}: {shorten(row)!r}"
                raise InputError(f"{self._path}: line {number}", problem, "correct the row; an empty cell is missing")
            for column, values in zip(columns, found, strict=True):
                value = to_number(with_point(cells[column.index], text.decimal))
                if value is None:
                    raise self._not_a_number(number, column, cells[column.index])
                values.append(value)
        return [np.array(values, dtype=np.float64) for values in found]

    def _not_a_number(self, number: int, column: TextColumn, cell: str) -> InputError:
        not_text = re.search("[\udc80-\udcff]", cell) is not None
        found = "bytes that are not UTF-8" if not_text else repr(shorten(cell.strip(" \t")))
        problem = f"column {column.label}: found {found}, expected a number"
        hint = "leave the cell empty or write nan where there is no value"
        if re.fullmatch(r"\s*[+-]?\d+,\d+\s*", cell):
            hint = "write decimals with a point, or give --set layout.decimal=,"
        return InputError(f"{self._path}: line {number}", problem, hint)


@dataclass(frozen=True, slots=True)
class _Block:
    """Lines parsed independently of earlier blocks."""

    lines: Lines
    found: list[F64] | None
    """One array of stored numbers per column; None where the slow parser must read them."""
    is_blank: bool
    """Whether all lines are blank or comments."""


def _n_lines(data: bytes) -> int:
    return count_line_ends(data) + (not data.endswith(b"\n"))


class _BlankWatch:
    """Blank lines in a file of one column: ignored at its end, refused between rows (missing values?)."""

    def __init__(self, path: Path, n_columns: int) -> None:
        self.watches = n_columns == 1
        self.first: int | None = None
        self._path = path

    def see(self, number: int) -> None:
        """Remember a blank line."""
        if self.watches and self.first is None:
            self.first = number

    def check(self) -> None:
        """Refuse a row behind a blank line."""
        if self.first is not None:
            problem = "a blank line between the rows of one column, which may be a missing shot or nothing"
            hint = "write nan for a missing shot: sed 's/^$/nan/' IN > OUT; or delete the line"
            raise InputError(f"{self._path}: line {self.first}", problem, hint)
