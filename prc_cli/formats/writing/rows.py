"""A stream as rows of a table: one per cell, missing shots included, and one per further return."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import I64
from prc_cli.formats.writing.base import StreamItem

ANGLE_DIGITS = 10
"""Decimals of scan angles [deg]: finer than any encoder, yet 12.5 is written as 12.5."""


def stream_rows(item: StreamItem, rows: slice) -> dict[str, NDArray[Any]]:
    """Return the columns of lines of a block, one row per return; the chosen return comes first."""
    block = item.block
    m = block.points_per_line
    n_lines = rows.stop - rows.start
    line = np.repeat(np.arange(rows.start, rows.stop), m)
    column = np.tile(np.arange(m), n_lines)
    values: dict[str, NDArray[Any]] = {
        "line": block.first_line + line,
        "column": column,
        "range_m": block.range_m[rows].ravel(),
        "point_source_id": np.full(len(line), block.scanner),
        "return_number": np.ones(len(line), np.int32),
        "number_of_returns": np.ones(len(line), np.int32),
        "intensity": np.full(len(line), np.nan, np.float32),
    }
    if block.angle_rad is not None:
        values["angle_deg"] = np.round(np.rad2deg(block.angle_rad), ANGLE_DIGITS)[column]
    for name, image in (
        ("time_s", block.time_s),
        ("intensity", block.intensity),
        ("class", item.codes),
    ):
        if image is not None:
            values[name] = image[rows].ravel()
    xyz = item.registered_m if item.registered_m is not None else block.xyz_m
    if xyz is not None:
        values |= {axis: xyz[rows, :, index].ravel() for index, axis in enumerate("xyz")}
    inside = np.flatnonzero((block.extra.line >= rows.start) & (block.extra.line < rows.stop))
    return _with_extra(values, item, rows, inside) if len(inside) else values


def _with_extra(
    values: dict[str, NDArray[Any]],
    item: StreamItem,
    rows: slice,
    inside: I64,
) -> dict[str, NDArray[Any]]:
    """Insert further returns behind the chosen return of their shot."""
    block = item.block
    extra = item.block.extra
    line = (extra.line[inside] - rows.start).astype(np.int64)
    cell = line * block.points_per_line + extra.column[inside]
    extra_rows = {name: column[cell] for name, column in values.items()}
    extra_rows["range_m"] = extra.range_m[inside]
    extra_rows["intensity"] = np.full(len(inside), np.nan, np.float32)
    if item.extra_codes is not None:
        extra_rows["class"] = item.extra_codes[inside]
    if item.extra_registered_m is not None:
        extra_rows |= {
            axis: item.extra_registered_m[inside, index] for index, axis in enumerate("xyz")
        }
    elif "x" in values:
        # all returns of a shot lie on the same beam
        with np.errstate(invalid="ignore"):
            ratio = (extra.range_m[inside] / values["range_m"][cell]).astype(np.float64)
        extra_rows |= {axis: (values[axis][cell] * ratio).astype(np.float32) for axis in "xyz"}
    owner = np.concatenate([np.arange(len(values["line"])), cell])
    all_values = {
        name: np.concatenate([column, extra_rows[name]]) for name, column in values.items()
    }
    number_returns(all_values, owner)
    order = np.argsort(owner, kind="stable")
    return {name: column[order] for name, column in all_values.items()}


def number_returns(values: dict[str, NDArray[Any]], owner: I64) -> None:
    """Set return numbers of rows by their range in the cell (``owner``), NaN last."""
    order = np.lexsort((values["range_m"], owner))
    sorted_owner = owner[order]
    first = np.flatnonzero(np.concatenate(([True], sorted_owner[1:] != sorted_owner[:-1])))
    size = np.diff(np.append(first, len(owner)))
    number = np.empty(len(owner), np.int32)
    number[order] = np.arange(len(owner)) - np.repeat(first, size) + 1
    count = np.empty(len(owner), np.int32)
    count[order] = np.repeat(size, size)
    values["return_number"] = number
    values["number_of_returns"] = count
