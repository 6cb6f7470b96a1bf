"""How empty an image may be: a few wrong numbers must not cost gigabytes or hours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.types import I64
from prc_cli.formats.options import InputConfig
from prc_cli.stream.columns import MAX_COLUMN

MAX_CELLS_PER_RECORD = 1000
"""Cells for every record; an image that is emptier has a wrong line or column somewhere."""
MIN_CELLS = 1_000_000
"""Cells that any input may have."""
SPARE_CELLS = 20_000_000
"""The same while lines are read: empty lines cost no memory then, a second of time at most."""
USUAL_GAP_LINES: int = InputConfig.model_fields["max_gap_lines"].default
"""Who allows longer gaps than this means them."""


def most_cells(n_records: int) -> int:
    """Return how many cells an image of so many records may have.

    >>> most_cells(10)
    1010000
    """
    return MIN_CELLS + MAX_CELLS_PER_RECORD * n_records


@dataclass(frozen=True, slots=True)
class CellLimit:
    """Cells that one scanner's lines may have while they are read."""

    points_per_line: int
    """M."""
    n_known: int
    """Records of the whole input as far as known beforehand, else 0."""
    n_spare: int
    """Cells beside those that the number of records allows."""

    def most_lines(self, n_seen: I64) -> I64:
        """Return the lines that so many shots may have, at least one, (n,) int64."""
        cells: I64 = self.n_spare + MAX_CELLS_PER_RECORD * np.maximum(n_seen, self.n_known)
        return np.maximum(cells // self.points_per_line, 1)


def cell_limit(config: InputConfig, points_per_line: int, n_known: int) -> CellLimit:
    """Return the limit of one scanner; gaps that are longer than usual and allowed by name come on top."""
    n_spare = SPARE_CELLS if config.scanner == "none" else MIN_CELLS
    if config.max_gap_lines > USUAL_GAP_LINES:
        n_spare += config.max_gap_lines * points_per_line
    return CellLimit(points_per_line, n_known, n_spare)


def check_image(path: str, sizes: dict[int, tuple[int, int, int]], which: str = "") -> None:
    """Refuse an image that is absurdly empty.

    Parameters
    ----------
    path : str
        Input, for messages.
    sizes : dict by scanner
        Lines, columns and shots of every scanner.
    which : str
        Dimension that splits the scanners.

    Raises
    ------
    InputError
        When one scanner has too many columns, or all have together more cells than their shots allow.
    """
    n_cells = sum(n_lines * n_columns for n_lines, n_columns, _ in sizes.values())
    is_empty = n_cells > most_cells(sum(n_shots for _, _, n_shots in sizes.values()))
    # the one that is emptiest is named
    for scanner in sorted(sizes, key=lambda one: -sizes[one][0] * sizes[one][1] + most_cells(sizes[one][2])):
        n_lines, n_columns, n_shots = sizes[scanner]
        if is_empty or n_columns > MAX_COLUMN:
            where = f"{path}: {which} {scanner}" if which else path
            problem = f"{n_lines} lines of {n_columns} columns for {n_shots} shots"
            cause, hint = "a column number is wrong", "give the shots in a scan line: -M NUMBER"
            if n_lines > max(n_shots, n_columns):
                cause, hint = "line numbers or times jump", f"check them, or {hint}"
            raise InputError(where, f"{problem}: {cause}, expected fewer cells", hint)


def check_found_columns(path: str, points_per_line: int, n_records: int | None) -> None:
    """Refuse more columns than the records of the input can mean, where M was found or recorded, not given.

    Raises
    ------
    InputError
    """
    most = MAX_COLUMN if n_records is None else min(MAX_COLUMN, most_cells(n_records))
    if points_per_line > most:
        count = "" if n_records is None else f" for {n_records} records"
        problem = f"lines of {points_per_line} columns{count}, expected at most {most}"
        raise InputError(path, problem, "give the shots in a scan line: -M NUMBER")
