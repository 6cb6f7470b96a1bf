"""Detects delimiter, comments and header of a text file, and splits a line into cells."""

from __future__ import annotations

import csv
import re
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.formats.options import Layout
from prc_cli.formats.records import shorten
from prc_cli.formats.text.head import Head, has_mark, read_head, separator_of, without_mark
from prc_cli.formats.text.lines import MAX_LINE_BYTES, iter_lines, too_long

MAX_COLUMNS = 10_000
"""Most cells in a row."""
SNIFFED_ROWS = 20
"""Rows read to find the delimiter."""
HEAD_BYTES = 1 << 16
"""Bytes read at a time for the first rows."""

QUOTED_DECIMALS = r"""sed -E 's/"([+-]?[0-9]+),([0-9]+)"/\1.\2/g' IN > OUT"""
"""Command that writes the decimals of quoted cells with a point."""
_LAST_ROWS = 8
_SWAPPED = str.maketrans(",.", ".,")
BLANKS = " "
"""Delimiter that means any number of blanks and tabs."""
_DELIMITERS = (";", "\t", ",")
# no backtracking: a cell may hold a million digits
_NUMBER = re.compile(
    r"[+-]?(?:(?:\d++\.?\d*+|\.\d++)(?:e[+-]?\d++)?+|nan|inf|infinity)", re.ASCII | re.IGNORECASE
)


@dataclass(frozen=True, slots=True)
class TextFormat:
    """Dialect of a text file, from its first rows."""

    delimiter: str
    """One character; a space means any number of blanks and tabs."""
    comment: bytes
    """Lines that begin with this are skipped; empty = none."""
    header_line: int | None
    """Number of the line with the names, None if there is none."""
    first_row: int
    """Number of the first row, names or numbers."""
    names: tuple[str, ...]
    """Names of the columns, empty strings without a header."""
    found_delimiter: bool
    """Whether the delimiter was detected, not given."""
    decimal: str = "."
    """Character before the decimals."""
    last_head: int = 0
    """Number of the last line before the rows, if there are more than the line of names."""

    @property
    def n_columns(self) -> int:
        """Cells in a row."""
        return len(self.names)

    def stripped(self, line: bytes) -> bytes:
        """Return a line without surrounding blanks; tabs between empty cells stay."""
        return line.strip(b" \r\n" if self.delimiter == "\t" else None)

    def is_row(self, line: bytes) -> bool:
        """Whether a line is neither blank nor a comment."""
        text = self.stripped(line)
        return bool(text) and not (self.comment and text.startswith(self.comment))


def find_format(path: Path, layout: Layout | None) -> TextFormat:
    """Detect the dialect from the first rows of a text file."""
    options = layout if layout is not None else Layout()
    if not options.delimiter.isascii() or options.delimiter in '"\r\n':
        raise ConfigError(
            "layout.delimiter", f"found {options.delimiter!r}, expected , ; a tab or a space"
        )
    draft = TextFormat(options.delimiter, options.comment.encode(), None, 0, (), layout is None)
    rows = _first_rows(path, draft)
    if not rows:
        is_empty = next(iter_lines(path, HEAD_BYTES), None) is None
        problem = "the file is empty" if is_empty else "only comments and blank lines"
        raise InputError(
            str(path), f"{problem}, expected a record a row", "copy it from the archive again"
        )
    skipped = None
    if (separator := separator_of(rows[0][1])) is not None and len(rows) > 1:
        skipped = rows[0][0]
        rows = rows[1:]
    is_found = layout is None or not {"delimiter", "fields"} & layout.model_fields_set
    texts = [text for _, text in rows]
    # a line with only the number of rows has no delimiter
    texts = [text for text in texts if not text.strip().isdecimal()] or texts
    delimiter = (
        (separator or _find_delimiter(texts, options.decimal)) if is_found else options.delimiter
    )
    decimal = options.decimal or _find_decimal(texts, delimiter)
    if decimal == delimiter:
        problem = "found ',' for both the decimals and the cells"
        raise ConfigError(
            "layout.decimal",
            problem,
            f'if the cells are separated by ;, --set layout.delimiter=";"; else {QUOTED_DECIMALS}',
        )
    if options.header is not False and decimal != delimiter:
        head = _find_head(_head_lines(path, draft), delimiter, decimal)
        if head is not None:
            names = head.names
            return TextFormat(
                delimiter,
                draft.comment,
                head.names_line,
                head.last_line,
                names,
                is_found,
                decimal,
                head.last_line,
            )
    number, text = rows[0]
    cells = split(path, number, text, delimiter)
    if len(cells) > MAX_COLUMNS:
        problem = f"{len(cells)} cells, expected at most {MAX_COLUMNS}"
        raise InputError(
            f"{path}: line {number}",
            problem,
            "check the delimiter, or that every row is one record",
        )
    has_header = options.header
    if has_header is None:
        has_header = any(not is_number(cell, decimal) for cell in cells)
    if has_header and len(rows) == 1:
        problem = f"no row follows the header in line {number}, expected a record a row"
        raise InputError(str(path), problem, "copy it from the archive again")
    names = tuple(cell.strip() for cell in cells) if has_header else ("",) * len(cells)
    if has_header:
        names = (without_mark(names[0]), *names[1:])
    return TextFormat(
        delimiter,
        draft.comment,
        number if has_header else skipped,
        number,
        names,
        is_found,
        decimal,
    )


def _head_lines(path: Path, draft: TextFormat) -> list[tuple[int, str]]:
    lines: list[tuple[int, str]] = []
    for block in iter_lines(path, HEAD_BYTES):
        for number, line in enumerate(block.data.split(b"\n"), block.first):
            if draft.stripped(line):
                lines.append((number, line.decode("utf-8", errors="replace").rstrip("\r")))
            if len(lines) == SNIFFED_ROWS:
                return lines
    return lines


def _find_head(lines: list[tuple[int, str]], delimiter: str, decimal: str) -> Head | None:
    rows: list[tuple[int, str, list[str]]] = []
    if lines and separator_of(lines[0][1]) is not None:
        lines = lines[1:]
    for number, text in lines:
        plain = without_mark(text)
        cells = try_split(plain, delimiter) or [plain]
        rows.append((number, text, cells))
    is_row = [
        not has_mark(text) and all(is_number(cell, decimal) for cell in cells)
        for _, text, cells in rows
    ]
    # all rows have as many cells as the last one; row names of R may be quoted numbers
    n_columns = len(rows[-1][2]) if rows and is_row[-1] else 0
    first = next(
        (i for i, (_, _, cells) in enumerate(rows) if is_row[i] and len(cells) == n_columns), 0
    )
    is_plain = first == 0 or (
        first == 1 and len(rows[0][2]) == n_columns and not has_mark(rows[0][1])
    )
    is_even = all(is_row[first:]) and all(len(cells) == n_columns for _, _, cells in rows[first:])
    # rows with fewer or more cells are damage
    is_damaged = any(is_row[i] and len(rows[i][2]) > 1 for i in range(first))
    if is_plain or n_columns < 2 or is_damaged or not is_even:
        return None
    head = read_head(rows[:first], n_columns)
    return replace(head, names=("",) * n_columns) if head is not None and not head.names else head


def _first_rows(path: Path, draft: TextFormat) -> list[tuple[int, str]]:
    decoded: list[tuple[int, str]] = []
    blocks = (
        enumerate(block.data.split(b"\n"), block.first) for block in iter_lines(path, HEAD_BYTES)
    )
    rows = ((number, line) for block in blocks for number, line in block if draft.is_row(line))
    for number, line in islice(rows, SNIFFED_ROWS):
        try:
            decoded.append((number, line.decode("utf-8").rstrip("\r")))
        except UnicodeDecodeError as error:
            problem = f"byte {error.start + 1} of the line ({line[error.start]:#04x}) is not UTF-8"
            # only the first row must be UTF-8: it may hold the names
            if not decoded:
                raise InputError(f"{path}: line {number}", problem, _RECODE) from error
            decoded.append((number, line.decode("latin-1").rstrip("\r")))
    return decoded


_RECODE = "convert it: iconv -f ISO-8859-1 -t UTF-8 IN > OUT"


def _find_decimal(rows: list[str], delimiter: str) -> str:
    """Return the comma if cells of the last rows are numbers with a comma, none with a point."""
    cells = [
        cell.strip()
        for row in rows[-_LAST_ROWS:]
        for cell in row.split(None if delimiter == BLANKS else delimiter)
    ]
    has_comma = delimiter != "," and any("," in cell and is_number(cell, ",") for cell in cells)
    return "," if has_comma and not any("." in cell and is_number(cell) for cell in cells) else "."


def _has_inner_comma(cell: str) -> bool:
    return is_number(cell, ",") and not cell.startswith(",") and not cell.endswith(",")


def _find_delimiter(rows: list[str], decimal: str | None) -> str:
    """Return the first of ``;``, tab and comma with equal counts in all rows, else blanks."""
    last = [row.split() for row in rows[-_LAST_ROWS:]]
    if all(len(cells) > 1 and all(map(_has_inner_comma, cells)) for cells in last) and any(
        "," in row for row in rows
    ):
        return BLANKS
    # text before the header is of another kind than the rows
    for sample in (rows, rows[-_LAST_ROWS:] if len(rows) > _LAST_ROWS else rows):
        for delimiter in (mark for mark in _DELIMITERS if mark != decimal):
            counts = {row.count(delimiter) for row in sample}
            if counts != {0} and len(counts) == 1:
                return delimiter
    # if rows differ, use the delimiter of the first row, so that the error names the wrong row
    for delimiter in (mark for mark in _DELIMITERS if mark != decimal):
        if delimiter in rows[0]:
            return delimiter
    return BLANKS if all(len(row.split()) > 1 for row in rows) else ","


def split(
    path: Path,
    number: int,
    text: str,
    delimiter: str,
) -> list[str]:
    """Return the cells of a line."""
    where = f"{path}: line {number}"
    if len(text) > MAX_LINE_BYTES:
        raise too_long(path, number)
    if "\r" in text:
        problem = "a carriage return inside the line, expected lines that end in LF or CR LF"
        raise InputError(where, problem, "convert it: tr '\\r' '\\n' < IN > OUT")
    cells = try_split(text, delimiter)
    if cells is None:
        problem = f"found {shorten(text)!r}, expected cells with closed quotes"
        raise InputError(where, problem, "close the quote or leave the quotes out")
    return cells


def try_split(text: str, delimiter: str) -> list[str] | None:
    """Return the cells of a line, None if a quote is not closed.

    >>> try_split('1,"a, b",5"', ","), try_split('1,"a', ",")
    (['1', 'a, b', '5"'], None)
    """
    if delimiter == BLANKS:
        text = " ".join(text.split())
    if '"' not in text:
        return text.split(delimiter)
    try:
        return next(csv.reader([text], delimiter=delimiter, strict=True))
    except csv.Error as error:
        if "end of data" in str(error) or "field limit" in str(error):
            return None
    with suppress(csv.Error):  # a lone line end
        # text behind a closed quote is part of the cell, as in pyarrow
        return next(csv.reader([text], delimiter=delimiter))
    return None


MISSING_WORDS = ("NA", "N/A", "NULL", "null", "None", "#N/A")
"""Cells without a value, as R, SQL, pandas and spreadsheets write them."""


def is_number(cell: str, decimal: str = ".") -> bool:
    """Whether a cell is empty, a decimal number, ``nan`` or ``inf`` in any case.

    >>> [is_number(cell) for cell in ("", " 1.5e3 ", "NaN", "-inf", "1,5", "0x10", "1_000")]
    [True, True, True, True, False, False, False]
    """
    if cell.strip(' \t"') in MISSING_WORDS:
        return True
    text = with_point(cell.strip(" \t"), decimal)
    return not text or _NUMBER.fullmatch(text) is not None


def with_point(cell: str, decimal: str) -> str:
    """Return a cell with a point before its decimals; one with a point already is no number then.

    >>> with_point("1,5", ","), with_point("1.5", ",")
    ('1.5', '1,5')
    """
    return cell if decimal == "." else cell.translate(_SWAPPED)


def to_number(cell: str) -> float | None:
    """Return the number in a cell, NaN if it is empty, None if it is neither."""
    text = cell.strip(" \t")
    if not text or text in MISSING_WORDS:
        return float("nan")
    return float(text) if _NUMBER.fullmatch(text) else None
