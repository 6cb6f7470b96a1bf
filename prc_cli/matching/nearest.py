"""Nearest points of two clouds of any order and size.

Both go to disk by cell and are joined tile by tile.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.threads import default_threads, ordered, read_ahead
from prc_cli.core.types import F64, I64, Mask
from prc_cli.formats.writing.disk import scratch_errors
from prc_cli.matching.join import Columns, JoinTally
from prc_cli.matching.keys import AXES

TIME = "seconds"
"""Column that decides between reference points as near, where both sides have it [s]."""
CELL_M = 16.0
"""Edge of a cell; a power of two, so that cells and tiles have exactly the same edges [m]."""
TILE_RECORDS = 1 << 18
"""Records of both sides in a tile, about: trees of more do not fit the processor's caches."""
LEAST_M = 0.002
"""Least tolerance by default: registered clouds are rounded to a millimetre or two."""
SPREADS = 3.0
_LEAST_SPREADS = 2.0
"""Bounds of the tolerance by default.

In median distances of the clouds or of the points of the right one."""
_WIDER = 1.2
_FEW_MORE = 0.03
_STEP = 1.05
_MARGIN = 1.07
"""The tolerance grows by ``_STEP`` until one ``_WIDER`` times as wide would find partners for less
than ``_FEW_MORE`` of the points without one. ``_MARGIN`` is for places outside the sample."""
_FARTHEST_M = 3.0
_SAMPLED_TILES = 12
_SAMPLED_RECORDS = 20_000
_TREE = {"balanced_tree": False, "compact_nodes": False}
"""Medians are slow where many points share a coordinate, as on a grid."""
_TIES = 4
_NEIGHBOURS = 5
"""The distance to this many points of the reference is the spacing around a point."""
_READ_AT_ONCE = 1 << 20
_MIDDLE = 1 << 30
_FINE_M = 1.0
"""Edge of the squares within a cell by which its points are ordered [m]."""
_SIDE = 4
_HALF = 1 << 26
"""Bits of these squares along a cell, and half the cells along the plan."""
SQUARE_M = 2.0
"""Edge of the squares in which points are counted [m]."""
_MOST_LOOSE = 1 << 17

Box: TypeAlias = tuple[float, float, float, float]
"""x and y of the lower corner, x and y of the upper one (exclusive) [m]."""


def keys_of(column: I64, row: I64) -> I64:
    """Return a number for every cell, by column and then by row."""
    return ((column + _MIDDLE) << 32) + row + _MIDDLE


def cell_keys(x: F64, y: F64, edge_m: float) -> I64:
    """Return a number for the cell of every point, by x and then by y."""
    return keys_of(np.floor(x / edge_m).astype(np.int64), np.floor(y / edge_m).astype(np.int64))


def cell_places(keys: I64) -> tuple[I64, I64]:
    """Return column and row of cells.

    >>> cell_places(cell_keys(np.array([-0.5]), np.array([33.0]), 16.0))
    (array([-1]), array([2]))
    """
    return (keys >> 32) - _MIDDLE, (keys & 0xFFFFFFFF) - _MIDDLE


def _nested_keys(x: F64, y: F64) -> I64:
    """Return a number for the square of every point, by cell and then by the square in it."""
    column, row = (np.floor(values / _FINE_M).astype(np.int64) for values in (x, y))
    cell = (((column >> _SIDE) + _HALF) * (2 * _HALF) + (row >> _SIDE) + _HALF) << 2 * _SIDE
    last = (1 << _SIDE) - 1
    key: I64 = cell + ((column & last) << _SIDE) + (row & last)
    return key


def _nested_places(keys: I64) -> tuple[I64, I64]:
    """Return column and row of squares.

    >>> _nested_places(_nested_keys(np.array([-0.5]), np.array([33.0])))
    (array([-1]), array([33]))
    """
    cell_column, cell_row = np.divmod(keys >> 2 * _SIDE, 2 * _HALF)
    last = (1 << _SIDE) - 1
    column = ((cell_column - _HALF) << _SIDE) + (keys >> _SIDE & last)
    row = ((cell_row - _HALF) << _SIDE) + (keys & last)
    return column, row


class Cloud:
    """The points of one side in a temporary file, ordered by cell and square within every chunk."""

    def __init__(self, chunks: Iterator[Columns], handle: BinaryIO) -> None:
        """Read all chunks; each has ``x``, ``y``, ``z`` (finite) and the same other columns."""
        self._handle = handle
        self._lock = threading.Lock()
        self._dtype = np.dtype([(axis, np.float64) for axis in AXES])
        self.n = 0
        self.low = np.full(3, np.inf)
        self.high = np.full(3, -np.inf)
        self._squares: list[tuple[I64, I64]] = [(np.empty(0, np.int64), np.empty(0, np.int64))]
        parts = [
            self._put(columns, n) for columns in read_ahead(chunks) if (n := len(columns["x"]))
        ]
        parts.append((np.empty(0, np.int64),) * 3)
        cells, first, count = (np.concatenate(part) for part in zip(*parts, strict=True))
        order = np.argsort(cells, kind="stable")
        self._cells = cells[order]
        self._first = first[order]
        self._count = count[order]

    def _put(self, columns: Columns, n: int) -> tuple[I64, I64, I64]:
        """Write a chunk; return the cells of its segments, their first record and their length."""
        if not self.n:
            self._dtype = np.dtype([(name, values.dtype) for name, values in columns.items()])
        key = _nested_keys(columns["x"], columns["y"])
        order = np.argsort(key, kind="stable")
        records = np.empty(n, self._dtype)
        for name, values in columns.items():
            records[name] = values[order]
        with scratch_errors("matching"):
            self._handle.write(records.view(np.uint8).data)
        for axis, name in enumerate(AXES):
            self.low[axis] = min(self.low[axis], columns[name].min())
            self.high[axis] = max(self.high[axis], columns[name].max())
        key = key[order]
        borders = np.flatnonzero(np.append(True, key[1:] != key[:-1]))
        column, row = _nested_places(key[borders])
        self._count_squares(keys_of(column >> 1, row >> 1), np.diff(borders, append=n))
        cell = keys_of(column >> _SIDE, row >> _SIDE)
        new = np.flatnonzero(np.append(True, cell[1:] != cell[:-1]))
        first = borders[new]
        segments = cell[new], first + self.n, np.diff(first, append=n)
        self.n += n
        return segments

    def _count_squares(self, keys: I64, n: I64) -> None:
        self._squares.append((keys, n))
        # few merges, and little memory
        if sum(len(keys) for keys, _ in self._squares[1:]) > max(
            len(self._squares[0][0]), _MOST_LOOSE
        ):
            self._squares = [self.squares()]

    def squares(self) -> tuple[I64, I64]:
        """Return the squares with points, as sorted :func:`cell_keys`, and their counts."""
        keys, n = (np.concatenate(parts) for parts in zip(*self._squares, strict=True))
        keys, place = np.unique(keys, return_inverse=True)
        return keys, np.bincount(place, n, len(keys)).astype(np.int64)

    def counts(self) -> tuple[I64, I64]:
        """Return the cells that hold points, and how many."""
        cells, index = np.unique(self._cells, return_inverse=True)
        return cells, np.bincount(index, self._count, len(cells)).astype(np.int64)

    def read(self, box: Box, margin: float = 0.0) -> Columns:
        """Return the points of a box and of a margin around it."""
        # a margin may be as wide as any number
        (x_low, y_low, _) = self.low - CELL_M
        (x_high, y_high, _) = self.high + CELL_M
        x0 = max(box[0] - margin, min(x_low, box[0]))
        y0 = max(box[1] - margin, min(y_low, box[1]))
        x1 = min(box[2] + margin, max(x_high, box[2]))
        y1 = min(box[3] + margin, max(y_high, box[3]))
        ends = cell_keys(np.array([x0, x1]), np.array([y0, y1]), CELL_M)
        (low, high), (bottom, top) = cell_places(ends)
        held = np.unique(self._cells >> 32)
        columns = held[(held >= low + _MIDDLE) & (held <= high + _MIDDLE)] << 32
        starts = np.searchsorted(self._cells, columns + bottom + _MIDDLE, side="left")
        stops = np.searchsorted(self._cells, columns + top + _MIDDLE, side="right")
        spans = [np.arange(a, b) for a, b in zip(starts, stops, strict=True)]
        chosen = np.concatenate([np.empty(0, np.int64), *spans])
        chosen = chosen[np.argsort(self._first[chosen])]
        parts = [np.empty(0, self._dtype)]
        for records in self._segments(chosen):
            x = records["x"]
            y = records["y"]
            inside = (x >= x0) & (x < x1) & (y >= y0) & (y < y1)
            parts.append(records if inside.all() else records[inside])
        records = np.concatenate(parts)
        # neighbours in memory are neighbours in space: queries of a tree are then twice as fast;
        # parts are in order
        order = np.argsort(cell_keys(records["x"], records["y"], _FINE_M), kind="stable")
        return {name: records[name][order] for name in self._dtype.names or ()}

    def _segments(self, chosen: I64) -> Iterator[NDArray[Any]]:
        first = self._first[chosen]
        count = self._count[chosen]
        groups = np.cumsum(count) // _READ_AT_ONCE
        for group in np.unique(groups).tolist():
            members = np.flatnonzero(groups == group)
            records = np.empty(int(count[members].sum()), self._dtype)
            buffer = records.view(np.uint8).data
            n_bytes = 0
            size = self._dtype.itemsize
            with scratch_errors("matching"), self._lock:
                for start, n in zip(first[members].tolist(), count[members].tolist(), strict=True):
                    self._handle.seek(start * size)
                    n_bytes += self._handle.readinto(buffer[n_bytes : n_bytes + n * size])  # type: ignore[attr-defined]
            yield records


def tiles_of(left: Cloud, right: Cloud, most: int = TILE_RECORDS) -> list[Box]:
    """Cut the plan into boxes of at most about ``most`` points of both clouds.

    No box is apart from the left cloud.
    """
    left_counts = left.counts()
    right_counts = right.counts()
    around = [left_counts[0] + (i << 32) + j for i in (-1, 0, 1) for j in (-1, 0, 1)]
    cells = np.union1d(left_counts[0], np.intersect1d(np.concatenate(around), right_counts[0]))
    n = np.zeros(len(cells), np.int64)
    for keys, counts in (left_counts, right_counts):
        held = np.isin(keys, cells)
        n[np.searchsorted(cells, keys[held])] += counts[held]
    column, row = cell_places(cells)
    tiles: list[Box] = []
    if not len(cells):
        return tiles
    span = max(int(np.ptp(column)), int(np.ptp(row))) + 1
    nodes = [
        (
            int(column.min()),
            int(row.min()),
            1 << max(span - 1, 0).bit_length(),
            np.arange(len(cells)),
        )
    ]
    while nodes:
        x, y, size, members = nodes.pop()
        total = int(n[members].sum())
        if total > most and size > 1:
            half = size // 2
            east = column[members] >= x + half
            north = row[members] >= y + half
            quarters = (
                (~east & ~north, x, y),
                (~east & north, x, y + half),
                (east & ~north, x + half, y),
                (east & north, x + half, y + half),
            )
            nodes += [
                (a, b, half, members[where]) for where, a, b in reversed(quarters) if where.any()
            ]
            continue
        # a cell of too many points is cut evenly
        parts = 1 << max(0, math.ceil(math.log2(max(total, 1) / most) / 2)) if size == 1 else 1
        edge = size * CELL_M / parts
        corners = [
            (x * CELL_M + i * edge, y * CELL_M + j * edge)
            for i in range(parts)
            for j in range(parts)
        ]
        tiles += [(a, b, a + edge, b + edge) for a, b in corners]
    return tiles


@dataclass(frozen=True, slots=True)
class Fit:
    """How two clouds lie on each other, from a sample of both [m]."""

    spread_m: float
    """Median distance of a left point to the nearest right one."""
    spacing_m: float
    """Median distance of a right point to the nearest other one."""
    tolerance_m: float
    """Largest distance of partners: most points beyond it have none."""
    sparse: float
    """Share of the left points beyond it that are as near as right points are to each other."""


def fit_of(left: Cloud, right: Cloud) -> Fit | None:
    """Measure two clouds in tiles spread over the left one; None if they do not overlap."""
    boxes = tiles_of(left, right)
    random = np.random.default_rng(0)
    parts: list[tuple[F64, F64, F64]] = []
    for box in random.permutation(np.array(boxes).reshape(-1, 4)).tolist():
        if len(parts) == _SAMPLED_TILES:
            break
        left_points = left.read(tuple(box))
        if not len(left_points["x"]):
            continue
        right_points, distance, nearest, tree = nearest_of(
            sample_of(left_points, random), right, tuple(box), _FARTHEST_M
        )
        if tree is not None and len(right_points["x"]) > _NEIGHBOURS:
            near = np.unique(nearest[np.isfinite(distance)])
            distances = np.full((len(right_points["x"]), 2), np.inf)
            distances[near] = tree.query(tree.data[near], k=[2, _NEIGHBOURS + 1])[0]
            around = np.append(distances, [[np.inf, 0.0]], axis=0)[nearest]
            parts.append((distance, around[:, 1], distances[near, 0]))
    if not parts:
        return None
    distances, around, spacing = (np.concatenate(part) for part in zip(*parts, strict=True))
    spread = float(np.median(distances))
    step = float(np.median(spacing))
    if not math.isfinite(spread):  # most points have no other near them
        return None
    tolerance = _tolerance(np.sort(distances), spread, step)
    beyond = distances > tolerance
    sparse = float(np.mean(distances[beyond] <= around[beyond])) if beyond.any() else 0.0
    return Fit(spread, step, tolerance, sparse)


def _tolerance(apart: F64, spread: float, step: float) -> float:
    """Return the least distance beyond which few partners are found; ``apart`` is sorted [m]."""
    most = max(SPREADS * max(spread, step), LEAST_M)
    tolerance = max(LEAST_M, _LEAST_SPREADS * spread)
    while tolerance < most:
        beyond, wider = len(apart) - np.searchsorted(
            apart, [tolerance, tolerance * _WIDER], side="right"
        )
        if beyond - wider <= _FEW_MORE * beyond:
            break
        tolerance *= _STEP
    return float(f"{min(_MARGIN * tolerance, most):.2g}")


def sample_of(
    columns: Columns, random: np.random.Generator, most: int = _SAMPLED_RECORDS
) -> Columns:
    """Return coordinates of some of the points, in their order."""
    n = len(columns["x"])
    chosen = np.sort(random.choice(n, most)) if n > most else np.arange(n)
    return {axis: columns[axis][chosen] for axis in AXES}


def xyz_of(columns: Columns) -> F64:
    """Return coordinates as (n, 3)."""
    return np.stack([columns[axis] for axis in AXES], axis=1)


def tree_of(xyz: F64) -> Any:
    """Return a tree of points (n, 3)."""
    from scipy.spatial import cKDTree

    return cKDTree(xyz, **_TREE)


@dataclass(frozen=True, slots=True)
class Nearest:
    """Left points of a tile with the nearest right ones."""

    box: Box
    left: Columns
    """Every left point comes once."""
    right: Columns
    to: I64
    """(n,) index in ``right``; -1 = none within the tolerance."""
    distance: F64
    """(n,) distance to the nearest right point, infinite beyond the reach [m]."""
    sparse: Mask
    """(n,) points without partner that the right cloud may have lost.

    They are no farther from it than its points there are from each other.
    """


def nearest_join(
    left: Cloud,
    right: Cloud,
    tolerance: float,
    tally: JoinTally,
    reach: float | None = None,
) -> Iterator[Nearest]:
    """Find the nearest right point of every left point, by tiles.

    Parameters
    ----------
    left, right : Cloud
    tolerance : float
        Largest distance of partners [m].
    tally : JoinTally
        Is filled.
    reach : float, optional
        Distance up to which the nearest point and its spacing are measured, if beyond the
        tolerance [m].
    """
    reach = max(tolerance, reach or 0.0)

    def join(box: Box) -> tuple[Nearest, int]:
        # right points of the tile can be partners of left points just outside
        left_points = left.read(box, tolerance)
        core = _inside(left_points, box)
        right_points, distance, nearest, tree = nearest_of(
            left_points, right, box, reach, tolerance
        )
        to = np.where(distance <= tolerance, nearest, -1)
        used = np.zeros(len(right_points["x"]), np.bool_)
        used[to[to >= 0]] = True
        n_used = int(np.count_nonzero(used & _inside(right_points, box)))
        left_points = {n: v[core] for n, v in left_points.items()}
        to = to[core]
        distance = distance[core]
        nearest = nearest[core]
        sparse = np.zeros(len(to), np.bool_)
        lone = np.flatnonzero(np.isfinite(distance) & (to < 0))
        if len(lone):
            around = tree.query(tree.data[nearest[lone]], k=_NEIGHBOURS + 1)[0][:, -1]
            sparse[lone] = distance[lone] <= around
        return Nearest(box, left_points, right_points, to, distance, sparse), n_used

    for tile, n_used in ordered(join, tiles_of(left, right), threads=default_threads()):
        tally.n_right += n_used
        tally.n_left += len(tile.to)
        tally.n_pairs += int(np.count_nonzero(tile.to >= 0))
        tally.add_distances(tile.distance, tile.to >= 0)
        if len(tile.to):
            yield tile


def nearest_of(
    points: Columns,
    cloud: Cloud,
    box: Box,
    bound: float,
    margin: float = 0.0,
) -> tuple[Columns, F64, I64, Any]:
    """Return the points of a cloud around a box, and the nearest of them to every point of ours.

    Returns
    -------
    tuple
        The points; distance (n,), infinite beyond ``bound``; index (n,) of the nearest; their tree.
    """
    cloud_points = cloud.read(box, margin + bound)
    n = len(points["x"])
    if not len(cloud_points["x"]):
        return cloud_points, np.full(n, np.inf), np.zeros(n, np.int64), None
    # coordinates of a projection are millions of metres: the tree works beside the origin
    origin = np.array([cloud_points[axis][0] for axis in AXES])
    tree = tree_of(xyz_of(cloud_points) - origin)
    timed = TIME in points and TIME in cloud_points
    k = min(_TIES, len(cloud_points["x"])) if timed else 1
    limit = float(np.nextafter(bound, math.inf))  # it is exclusive
    distance, neighbours = tree.query(
        xyz_of(points) - origin, [*range(1, k + 1)], distance_upper_bound=limit
    )
    best = np.zeros(n, np.int64)
    if timed:
        # of several as near, the one of the nearest time
        time_difference = np.abs(
            np.append(cloud_points[TIME], np.nan)[neighbours] - points[TIME][:, None]
        )
        equal = (distance == distance[:, :1]) & np.isfinite(time_difference)
        best = np.argmin(np.where(equal, time_difference, np.inf), axis=1)
    return cloud_points, distance[:, 0], neighbours[np.arange(n), best], tree


def _inside(columns: Columns, box: Box) -> Mask:
    x = columns["x"]
    y = columns["y"]
    inside: Mask = (x >= box[0]) & (x < box[2]) & (y >= box[1]) & (y < box[3])
    return inside
