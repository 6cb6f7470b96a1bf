"""Reader of text trajectories: time and position, in columns that the first row names, or in this order alone."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import chain, islice
from pathlib import Path
from typing import TextIO

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.types import F64

_NAMES = {
    "time": ("time", "gps_time", "gpstime", "t"),
    "x": ("x", "easting", "e"),
    "y": ("y", "northing", "n"),
    "z": ("z", "height", "altitude", "alt", "h"),
}
_BATCH = 100_000
"""Rows read at a time."""
_MAX_ROW = 65_536


def read_text(path: Path) -> tuple[F64, F64]:
    """Read time and position from the columns of these names; other columns are ignored.

    Four columns without names are time, x, y and z.
    """
    with path.open("r", encoding="utf-8-sig", errors="replace", newline=None) as handle:
        rows = _rows(str(path), handle)
        number, first = next(rows, (1, ""))
        delimiter = next((mark for mark in ",;\t" if mark in first), None)
        cells = _cells(first.lstrip("#"), delimiter)
        parts = []
        if first.startswith("#") or len(cells) != len(_NAMES) or not all(_is_number(cell) for cell in cells):
            columns = _find_columns(f"{path}: line {number}", cells)
        else:
            columns = list(range(len(_NAMES)))
            rows = chain([(number, first)], rows)
        while batch := list(islice(rows, _BATCH)):
            parts.append(_parse(str(path), batch, delimiter, columns))
    values = np.concatenate(parts) if parts else np.empty((0, 4))
    return values[:, 0].copy(), values[:, 1:].copy()


def _rows(where: str, handle: TextIO) -> Iterator[tuple[int, str]]:
    """Yield line number and text of every row that is not blank; the first may begin with #."""
    number = 0
    first = True
    while row := handle.readline(_MAX_ROW + 1):
        number += 1
        if len(row) > _MAX_ROW:
            problem = f"row of more than {_MAX_ROW} characters, expected time and position"
            position = f"{where}: line {number}"
            raise InputError(position, problem, "give a CSV file, or an SBET file ending in .sbet or .out")
        text = row.strip()
        if text and (first or not text.startswith("#")):
            first = False
            yield number, text


def _cells(row: str, delimiter: str | None) -> list[str]:
    return [cell.strip().strip('"') for cell in row.split(delimiter)]


def _is_number(cell: str) -> bool:
    try:
        return math.isfinite(float(cell))
    except ValueError:
        return False


def _find_columns(where: str, cells: list[str]) -> list[int]:
    """Return the columns of time, x, y and z."""
    # ignore units in brackets: "x [m]", "time(s)"
    names = [cell.lower().partition("[")[0].partition("(")[0].strip() for cell in cells]
    columns = []
    for wanted, known in _NAMES.items():
        found = [names.index(name) for name in known if name in names]
        if not found:
            problem = f"no column for {wanted} (one of {', '.join(known)}), found {', '.join(cells)[:200]!r}"
            raise InputError(where, problem, "name the columns in the first row, for example time,x,y,z")
        columns.append(found[0])
    return columns


def _parse(where: str, batch: list[tuple[int, str]], delimiter: str | None, columns: list[int]) -> F64:
    """Return (n, 4) time and position, all finite."""
    try:
        cells = [row.split(delimiter) for _, row in batch]
        values = np.array([[float(row[column]) for column in columns] for row in cells], dtype=np.float64)
    except (ValueError, IndexError):
        values = np.empty((0, 4))
    if len(values) and np.isfinite(values).all():
        return values
    # something in this batch is wrong or quoted: parse row by row
    return np.array([_parse_row(f"{where}: line {number}", _cells(row, delimiter), columns) for number, row in batch])


def _parse_row(where: str, cells: list[str], columns: list[int]) -> list[float]:
    if len(cells) <= max(columns):
        problem = f"{len(cells)} cells, expected at least {max(columns) + 1}"
        raise InputError(where, problem, "every row needs time, x, y and z")
    values = []
    for column in columns:
        try:
            value = float(cells[column])
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            problem = f"cell {column + 1} is {cells[column][:40]!r}, expected a finite number"
            raise InputError(where, problem, "correct or drop the row")
        values.append(value)
    return values
