"""Lines before the rows of a text file: names, units, number of rows, text of its program."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from prc_cli.formats.names import UNIT_WORDS, usual_names
from prc_cli.formats.options import FACTORS

MOST_HEAD = 12
"""Most lines before the rows."""
MARKS = ("//", "%", "#")
"""Marks of lines of names in exports of CloudCompare, MATLAB and NumPy."""
_SEPARATOR = re.compile(r'"?sep=(.|\\t)"?', re.IGNORECASE)
_UNIT = re.compile(r"[\[(]?\s*([^\[\]()]*?)\s*[\])]?")
_NO_UNIT = ("", "-", "--", "1", "none", "#", "n/a")


@dataclass(frozen=True, slots=True)
class Head:
    """The lines before the rows."""

    names: tuple[str, ...] = ()
    """Names of the columns; empty = none."""
    names_line: int | None = None
    """Number of the line with the names."""
    last_line: int = 0
    """Number of the last line before the rows."""


def separator_of(text: str) -> str | None:
    r"""Return the delimiter in the first line of a file for Excel; None for other lines.

    >>> separator_of("sep=;"), separator_of("sep=\\t"), separator_of("a;b")
    (';', '\t', None)
    """
    match = _SEPARATOR.fullmatch(text.strip())
    return None if match is None else match[1].replace("\\t", "\t")


def without_mark(text: str) -> str:
    """Return a line without the mark of a comment.

    >>> without_mark("// X Y Z"), without_mark("% a,b"), without_mark("#a b"), without_mark("a b")
    ('X Y Z', 'a,b', 'a b', 'a b')
    """
    plain = text.strip()
    for mark in MARKS:
        if plain.startswith(mark):
            return plain.removeprefix(mark).strip()
    return plain


def has_mark(text: str) -> bool:
    """Whether a line starts with a mark of a comment."""
    return text.strip().startswith(MARKS)


def read_head(lines: Sequence[tuple[int, str, list[str]]], n_columns: int) -> Head | None:
    """Find the names among the lines before the rows; None if a line is not understood.

    Parameters
    ----------
    lines : sequence of (number, text, cells)
    n_columns : int
        Cells of a row.
    """
    if len(lines) > MOST_HEAD or not lines:
        return None
    names: tuple[str, ...] = ()
    names_line = None
    is_sure = False
    for number, text, cells in lines:
        stripped = [cell.strip() for cell in cells]
        if names and _are_units(stripped, n_columns):
            names = tuple(
                _with_unit(name, unit) for name, unit in zip(names, stripped, strict=True)
            )
            continue
        is_usual = bool(usual_names(stripped))
        has_letters = any(letter.isalpha() for cell in stripped for letter in cell)
        fits = len(stripped) in (n_columns, n_columns - 1) and has_letters
        if fits and (is_usual or (not has_mark(text) and not is_sure)):
            # write.table of R leaves out the name of the row names
            names = ("",) * (n_columns - len(stripped)) + tuple(stripped)
            names_line = number
            is_sure = is_usual
    # a line may be the number of rows
    if not names and any(
        not has_mark(text) and not (len(cells) == 1 and cells[0].strip().isdecimal())
        for _, text, cells in lines
    ):
        return None
    return Head(names, names_line, lines[-1][0])


def _unit(cell: str) -> str:
    match = _UNIT.fullmatch(cell.strip())
    word = cell if match is None else match[1]
    return UNIT_WORDS.get(word.lower(), word.lower())


def _are_units(cells: list[str], n_columns: int) -> bool:
    units = [_unit(cell) for cell in cells]
    return (
        len(cells) == n_columns
        and all(unit in FACTORS or unit in _NO_UNIT for unit in units)
        and any(units)
    )


def _with_unit(name: str, cell: str) -> str:
    unit = _unit(cell)
    return f"{name} [{unit}]" if unit in FACTORS else name
