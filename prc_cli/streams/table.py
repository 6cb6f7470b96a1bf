"""Tables of records: a dict of arrays of equal length by name."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import I64, Mask

Table: TypeAlias = dict[str, NDArray[Any]]

RECORD, LINE, START, SPREAD, ORDINAL = "record index", "line index", "shot start", "spread time", "stamp ordinal"
RANGE, XYZ, INTENSITY = "slant range", "sensor xyz", "intensity"
"""Computed columns beside the dimensions; the blanks avoid clashes with their names."""


def take(table: Table, index: slice | Mask | I64) -> Table:
    """Return the rows of a table."""
    return {name: column[index] for name, column in table.items()}


def join(tables: list[Table]) -> Table:
    """Return tables of the same columns as one."""
    full = [table for table in tables if table]
    if len(full) <= 1:
        return full[0] if full else {}
    return {name: np.concatenate([table[name] for table in full]) for name in full[0]}


def n_rows(table: Table) -> int:
    """Return the number of rows of a table."""
    return len(table[RECORD]) if table else 0
