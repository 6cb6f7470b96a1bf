"""Places where two labellings differ: groups of neighbouring records of one pair of classes.

Records that differ are counted in small cells, of space or of the range image. Cells that touch
are one place if both have enough records. So memory depends on the size of the places, not on the
number of records.
"""

from __future__ import annotations

import csv
import io
import itertools
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64, I64

EDGE_M = 0.5
"""Edge of a cell of space [m]."""
LINES = 2
COLUMNS = 4
"""Scan lines and shots of a cell of the range image."""
MIN_LINKED = 3
"""Cells with fewer records that differ are no part of a larger place."""
MIN_RECORDS = 10
"""Smaller places are counted, not listed."""
MAX_PLACES = 10_000
"""Places kept."""
MAX_CELLS = 1 << 17
"""Cells kept in memory; beyond it, the cells of the smallest places are left out."""
_MAX_UNMERGED = 1 << 16
_AT_ONCE = 1 << 16
_BIAS = 1 << 20
_AXIS_BITS = 21
_COLUMN_BITS = 24
_REASON_BITS = 8
_PAIR_BITS = 16
_NO_REASON = 0
_SURE = 0.5
"""A place with this mean confidence, or less, is as good as a guess."""

_COLUMNS_OF_FILE = (
    *("rank", "reference", "predicted", "records", "length_m", "confidence", "reason", "rule"),
    *("x", "y", "z", "first_time_s", "last_time_s", "first_line", "last_line"),
    *("line", "column", "record", "file", "explain"),
)
RECORD_FIELDS = ("file", "row", "line", "column")
PLACE_FIELDS = ("x", "y", "z", "time")


@dataclass(frozen=True, slots=True)
class Place:
    """Neighbouring records that differ in one way."""

    reference: str
    """Class in the reference."""
    predicted: str
    """Predicted class."""
    n_records: int
    confidence: float | None
    """Mean confidence of the predictions [per cent]; None = not known."""
    reason: int
    """The most frequent rule of the predictions, by its number; 0 = not known."""
    x: float
    y: float
    z: float
    """A record in the densest part [m]; NaN = not known."""
    length_m: float
    """Diagonal of the bounds [m]; NaN = not known."""
    first_time_s: float
    last_time_s: float
    """NaN = not known."""
    first_line: int
    last_line: int
    """Scan lines; -1 = not known."""
    line: int
    column: int
    """Scan line and column of the record in the densest part; -1 = not known."""
    first_column: int
    last_column: int
    file: int
    """Index of the predicted file."""
    record: int
    """Index of that record in the file."""
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    """Bounds [m]."""

    @property
    def weight(self) -> float:
        """Number of records, times how sure the predictions are (0 to 1)."""
        if self.confidence is None:
            return float(self.n_records)
        sure = max(self.confidence / 100.0 - _SURE, 0.0) / (1.0 - _SURE)
        return self.n_records * sure


@dataclass(frozen=True, slots=True)
class Differing:
    """Records that differ, in arrays (n,)."""

    pair: I64
    """Index of the reference class times the number of predicted classes, and the other index."""
    confidence: I64
    """[per cent]; -1 = not known."""
    reason: I64
    records: dict[str, I64]
    """:data:`RECORD_FIELDS`; -1 = not known."""
    places: dict[str, F64]
    """:data:`PLACE_FIELDS`; NaN = not known."""

    def part(self, chosen: slice) -> Differing:
        """Return some of the records."""
        return Differing(
            self.pair[chosen],
            self.confidence[chosen],
            self.reason[chosen],
            {name: values[chosen] for name, values in self.records.items()},
            {name: values[chosen] for name, values in self.places.items()},
        )


_CELL = np.dtype(
    [
        ("group", np.int64),
        ("cell", np.int64),
        ("n", np.int64),
        ("n_known", np.int64),
        ("confidence", np.float64),
        *((f"{end}_{name}", np.float64) for name in PLACE_FIELDS for end in ("low", "high")),
        *((f"{end}_{name}", np.int64) for name in ("line", "column") for end in ("low", "high")),
        *((name, np.int64) for name in RECORD_FIELDS),
        *((name, np.float64) for name in PLACE_FIELDS),
    ]
)


class PlaceFinder:
    """Collects records that differ, chunk by chunk, in any order."""

    def __init__(self, *, in_space: bool) -> None:
        self._in_space = in_space
        self._tables = [np.empty(0, _CELL)]
        """Merged cells, then those of single chunks."""
        self._origin: I64 | None = None
        self.n_differ = 0
        """All records."""

    def add(self, records: Differing) -> None:
        """Count records in their cells."""
        self.n_differ += len(records.pair)
        for first in range(0, len(records.pair), _AT_ONCE):
            part = records.part(slice(first, first + _AT_ONCE))
            self._tables.append(_merged(self._cells_of(part)))
            merged, *more = self._tables
            if sum(map(len, more)) > max(len(merged), _MAX_UNMERGED):
                self._merge()

    def _merge(self) -> None:
        table = _merged(np.concatenate(self._tables))
        if len(table) > MAX_CELLS:
            table = self._without_smallest(table)
        self._tables = [table]

    def _without_smallest(self, table: NDArray[Any]) -> NDArray[Any]:
        place_of = self._places_of(table)
        n_of_place = np.bincount(place_of, table["n"])
        size = n_of_place[place_of]
        limit = np.partition(size, len(size) // 2)[len(size) // 2]
        keep = size > limit
        kept: NDArray[Any] = table[keep]
        return kept

    def _cells_of(self, records: Differing) -> NDArray[Any]:
        n = len(records.pair)
        cells = np.empty(n, _CELL)
        group = (records.pair << _REASON_BITS) + records.reason
        if not self._in_space:
            group = group + (records.records["file"] << (_REASON_BITS + _PAIR_BITS))
        cells["group"] = group
        cells["cell"] = self._numbers_of_cells(records)
        cells["n"] = 1
        is_known = records.confidence >= 0
        cells["n_known"] = is_known
        cells["confidence"] = np.where(is_known, records.confidence, 0)
        for name in PLACE_FIELDS:
            for column in (f"low_{name}", f"high_{name}", name):
                cells[column] = records.places[name]
        for name in ("line", "column"):
            for end in ("low", "high"):
                cells[f"{end}_{name}"] = records.records[name]
        for name in RECORD_FIELDS:
            cells[name] = records.records[name]
        return cells

    def _numbers_of_cells(self, records: Differing) -> I64:
        if not self._in_space:
            line = records.records["line"] // LINES
            column = records.records["column"] // COLUMNS
            pixels: I64 = ((line + 1) << _COLUMN_BITS) + column + 1
            return pixels
        axes = np.stack([records.places[axis] for axis in "xyz"])
        voxels = np.floor(axes / EDGE_M).astype(np.int64)
        if self._origin is None:
            self._origin = voxels[:, :1].copy()
        x, y, z = np.clip(voxels - self._origin + _BIAS, 1, 2 * _BIAS - 2)
        numbers: I64 = (x << (2 * _AXIS_BITS)) + (y << _AXIS_BITS) + z
        return numbers

    def _steps(self) -> list[int]:
        """Return the differences of a cell's number to the later half of its neighbours."""
        shifts = (2 * _AXIS_BITS, _AXIS_BITS, 0) if self._in_space else (_COLUMN_BITS, 0)
        ways = itertools.product((-1, 0, 1), repeat=len(shifts))
        steps = (
            sum(way << shift for way, shift in zip(step, shifts, strict=True)) for step in ways
        )
        return sorted(step for step in steps if step > 0)

    def _places_of(self, table: NDArray[Any]) -> I64:
        """Return the number of the place of every row, by connected cells."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        # rows of one cell with other reasons are one node
        group = table["group"] >> _REASON_BITS
        order = np.lexsort((table["cell"], group))
        group = group[order]
        cell = table["cell"][order]
        is_first = np.append(True, (group[1:] != group[:-1]) | (cell[1:] != cell[:-1]))
        node_of_row = np.cumsum(is_first) - 1
        n_nodes = int(node_of_row[-1]) + 1
        is_linked = np.bincount(node_of_row, table["n"][order]) >= MIN_LINKED
        node_group = group[is_first]
        node_cell = cell[is_first]
        ends = np.append(np.flatnonzero(np.diff(node_group)) + 1, n_nodes)
        links: list[tuple[I64, I64]] = []
        start = 0
        for end in ends.tolist():
            links += self._links(node_cell, is_linked, start, end)
            start = end
        left = np.concatenate([np.empty(0, np.int64), *(pair[0] for pair in links)])
        right = np.concatenate([np.empty(0, np.int64), *(pair[1] for pair in links)])
        graph = coo_array((np.ones(len(left), np.bool_), (left, right)), (n_nodes, n_nodes))
        place_of_node = connected_components(graph, directed=False)[1]
        place = np.empty(len(table), np.int64)
        place[order] = place_of_node[node_of_row]
        return place

    def _links(
        self, cell: I64, is_linked: NDArray[np.bool_], start: int, end: int
    ) -> Iterable[tuple[I64, I64]]:
        nodes = start + np.flatnonzero(is_linked[start:end])
        cells = cell[nodes]
        for step in self._steps():
            index = np.searchsorted(cells, cells + step)
            index[index == len(cells)] = 0
            is_filled = cells[index] == cells + step
            yield nodes[is_filled], nodes[index[is_filled]]

    def places(self, reference: Sequence[str], predicted: Sequence[str]) -> list[Place]:
        """Return all places with enough records, by the names of the classes."""
        self._merge()
        (table,) = self._tables
        if not len(table):
            return []
        place_of = self._places_of(table)
        n_of_place = np.bincount(place_of, table["n"])
        rows = np.flatnonzero(n_of_place[place_of] >= MIN_RECORDS)
        rows = rows[np.argsort(place_of[rows], kind="stable")]
        ends = np.flatnonzero(np.diff(place_of[rows])) + 1
        return [
            _place_of(table[part], reference, predicted)
            for part in np.split(rows, ends)
            if len(part)
        ]


def _merged(cells: NDArray[Any]) -> NDArray[Any]:
    """Return one row for each cell and reason."""
    order = np.lexsort((cells["cell"], cells["group"]))
    cells = cells[order]
    differs = (np.diff(cells["group"]) != 0) | (np.diff(cells["cell"]) != 0)
    starts = np.append(0, np.flatnonzero(differs) + 1)[: len(cells)]
    merged: NDArray[Any] = cells[starts]
    for name in ("n", "n_known", "confidence"):
        merged[name] = np.add.reduceat(cells[name], starts) if len(cells) else 0
    for name in (*PLACE_FIELDS, "line", "column"):
        if len(cells):
            merged[f"low_{name}"] = np.fmin.reduceat(cells[f"low_{name}"], starts)
            merged[f"high_{name}"] = np.fmax.reduceat(cells[f"high_{name}"], starts)
    return merged


def _place_of(rows: NDArray[Any], reference: Sequence[str], predicted: Sequence[str]) -> Place:
    """Return a place from the rows of its cells."""
    cells, index = np.unique(rows["cell"], return_inverse=True)
    n_of_cell = np.bincount(index, rows["n"], len(cells))
    middle = rows[int(np.argmax(n_of_cell[index]))]
    reasons = rows["group"] & ((1 << _REASON_BITS) - 1)
    n_of_reason = np.bincount(reasons, rows["n"])
    n_of_reason[_NO_REASON] = 0
    pair = int(rows["group"][0] >> _REASON_BITS) & ((1 << _PAIR_BITS) - 1)
    row, column = divmod(pair, len(predicted))
    n_known = int(rows["n_known"].sum())
    low = {name: float(np.fmin.reduce(rows[f"low_{name}"])) for name in PLACE_FIELDS}
    high = {name: float(np.fmax.reduce(rows[f"high_{name}"])) for name in PLACE_FIELDS}
    return Place(
        reference=reference[row],
        predicted=predicted[column],
        n_records=int(rows["n"].sum()),
        confidence=float(rows["confidence"].sum()) / n_known if n_known else None,
        reason=int(np.argmax(n_of_reason)) if n_of_reason.any() else _NO_REASON,
        x=float(middle["x"]),
        y=float(middle["y"]),
        z=float(middle["z"]),
        length_m=math.dist([low[axis] for axis in "xyz"], [high[axis] for axis in "xyz"]),
        first_time_s=low["time"],
        last_time_s=high["time"],
        first_line=int(rows["low_line"].min()),
        last_line=int(rows["high_line"].max()),
        line=int(middle["line"]),
        column=int(middle["column"]),
        first_column=int(rows["low_column"].min()),
        last_column=int(rows["high_column"].max()),
        file=int(middle["file"]),
        record=int(middle["row"]),
        low=(low["x"], low["y"], low["z"]),
        high=(high["x"], high["y"], high["z"]),
    )


@dataclass(frozen=True, slots=True)
class ListedPlace:
    """A place as files and pages show it."""

    place: Place
    file: str
    """Predicted file."""
    rule: str
    """Why prc gave the class; empty = not known."""
    command: str
    """The command that explains the record in the densest part; empty without line and column."""


@dataclass(frozen=True, slots=True)
class Places:
    """Places where two labellings differ, the largest and surest first."""

    places: tuple[ListedPlace, ...]
    n_differ: int
    """All records that differ in classes of both sides."""
    crs: str | None = None
    """EPSG code of the coordinate system, such as ``EPSG:25832``; None = not known."""
    pictures: tuple[bytes, ...] = ()
    """PNG pictures of the first places: range, predicted, reference."""

    @property
    def n_listed(self) -> int:
        """Records in the listed places."""
        return sum(item.place.n_records for item in self.places)


def best_first(places: Iterable[Place], most: int = MAX_PLACES) -> list[Place]:
    """Return places by their number of records times how sure they are."""
    order = sorted(places, key=lambda place: (-place.weight, -place.n_records, place.record))
    return order[:most]


def place_rows(places: Places) -> list[dict[str, Any]]:
    """Return a dictionary for each place; None = not known."""
    rows = []
    for rank, item in enumerate(places.places, 1):
        values = asdict(item.place)
        row: dict[str, Any] = {
            "rank": rank,
            "reference": item.place.reference,
            "predicted": item.place.predicted,
            "records": item.place.n_records,
            "length_m": _rounded(item.place.length_m, 2),
            "confidence": _rounded(item.place.confidence, 1),
            "reason": item.place.reason or None,
            "rule": item.rule or None,
        }
        row |= {axis: _rounded(values[axis], 3) for axis in "xyz"}
        row |= {name: _rounded(values[name], 6) for name in ("first_time_s", "last_time_s")}
        row |= {
            name: None if values[name] < 0 else values[name]
            for name in ("first_line", "last_line", "line", "column", "record")
        }
        rows.append({**row, "file": item.file, "explain": item.command or None})
    return rows


def places_csv(places: Places) -> str:
    """Return the places as CSV; unknown values are empty."""
    text = io.StringIO()
    writer = csv.DictWriter(text, _COLUMNS_OF_FILE, lineterminator="\n")
    writer.writeheader()
    writer.writerows(place_rows(places))
    return text.getvalue()


def places_geojson(places: Places) -> str:
    """Return the places as points in GeoJSON, in the coordinate system of the files.

    An EPSG code stands in a member ``crs`` (GeoJSON 2008), which QGIS and GDAL read. Places without
    coordinates have no geometry.
    """
    features = []
    for row in place_rows(places):
        position = [row["x"], row["y"], row["z"]]
        geometry = None if None in position else {"type": "Point", "coordinates": position}
        features.append({"type": "Feature", "geometry": geometry, "properties": row})
    table: dict[str, Any] = {"type": "FeatureCollection", "name": "places"}
    if places.crs is not None and places.crs.startswith("EPSG:"):
        code = places.crs.removeprefix("EPSG:")
        name = f"urn:ogc:def:crs:EPSG::{code}"
        table["crs"] = {"type": "name", "properties": {"name": name}}
    return json.dumps(table | {"features": features}, indent=1, allow_nan=False) + "\n"


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None or not math.isfinite(value) else round(value, digits)
