"""Nearest points of two clouds of any order and size.

Both go to disk by cell and are joined tile by tile.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, BinaryIO, NamedTuple, TypeAlias

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
_MIN_SPREADS = 2.0
"""Least tolerance by default, in median distances between the clouds."""
_MAX_SPREADS = 3.0
"""Largest one, in median distances between the clouds, or in spacings of the right one."""
_GROWTH = 1.05
_WIDER = 1.2
_FEW_SHARE = 0.03
"""The tolerance grows by the factor ``_GROWTH`` while a tolerance ``_WIDER`` times as large would
give partners to more than ``_FEW_SHARE`` of the points that have none."""
_SAFETY = 1.07
"""Factor of the final tolerance: outside the sample, clouds may be farther apart."""
_FIT_REACH_M = 3.0
"""Points of the sample that are farther apart count as infinitely far [m]."""
_SAMPLED_TILES = 12
_SAMPLED_RECORDS = 20_000
"""Points of a sampled tile, at most."""
_TREE_OPTIONS = {"balanced_tree": False, "compact_nodes": False}
"""A balanced tree is slow to build if many points share a coordinate, as on a grid."""
_MAX_TIED = 4
"""Nearest points whose times are compared if they are equally near."""
_NEIGHBOURS = 5
"""The distance to this many points of the reference is the spacing around a point."""
_RECORDS_PER_READ = 1 << 20
_KEY_ORIGIN = 1 << 30
"""Added to columns and rows of cells, so that both halves of a key are positive."""
_FINE_M = 1.0
"""Edge of the fine squares within a cell, by which its points are ordered [m]."""
_FINE_BITS = 4
"""A cell is 2 to the power of this many fine squares wide: 16 of 1 m."""
_FINE_ORIGIN = 1 << 26
"""Added to columns and rows of cells in keys of fine squares, which have fewer bits for them."""
SQUARE_M = 2.0
"""Edge of the squares in which points are counted, two fine squares wide [m]."""
_MAX_UNMERGED = 1 << 17
"""Squares whose counts may wait to be added up."""

Box: TypeAlias = tuple[float, float, float, float]
"""x and y of the lower corner, x and y of the upper one (exclusive) [m]."""


def keys_of(column: I64, row: I64) -> I64:
    """Return a number for every cell, by column and then by row."""
    return ((column + _KEY_ORIGIN) << 32) + row + _KEY_ORIGIN


def cell_keys(x: F64, y: F64, edge_m: float) -> I64:
    """Return a number for the cell of every point, by x and then by y."""
    return keys_of(np.floor(x / edge_m).astype(np.int64), np.floor(y / edge_m).astype(np.int64))


def cell_places(keys: I64) -> tuple[I64, I64]:
    """Return column and row of cells.

    >>> cell_places(cell_keys(np.array([-0.5]), np.array([33.0]), 16.0))
    (array([-1]), array([2]))
    """
    return (keys >> 32) - _KEY_ORIGIN, (keys & 0xFFFFFFFF) - _KEY_ORIGIN


def _fine_keys(x: F64, y: F64) -> I64:
    """Return a number for the fine square of every point, by cell and then by the square in it."""
    column = np.floor(x / _FINE_M).astype(np.int64)
    row = np.floor(y / _FINE_M).astype(np.int64)
    cell_column = (column >> _FINE_BITS) + _FINE_ORIGIN
    cell_row = (row >> _FINE_BITS) + _FINE_ORIGIN
    cell = cell_column * (2 * _FINE_ORIGIN) + cell_row
    in_cell = (1 << _FINE_BITS) - 1
    square = ((column & in_cell) << _FINE_BITS) + (row & in_cell)
    key: I64 = (cell << (2 * _FINE_BITS)) + square
    return key


def _fine_places(keys: I64) -> tuple[I64, I64]:
    """Return column and row of fine squares.

    >>> _fine_places(_fine_keys(np.array([-0.5]), np.array([33.0])))
    (array([-1]), array([33]))
    """
    cell_column, cell_row = np.divmod(keys >> (2 * _FINE_BITS), 2 * _FINE_ORIGIN)
    in_cell = (1 << _FINE_BITS) - 1
    column = ((cell_column - _FINE_ORIGIN) << _FINE_BITS) + ((keys >> _FINE_BITS) & in_cell)
    row = ((cell_row - _FINE_ORIGIN) << _FINE_BITS) + (keys & in_cell)
    return column, row


class _Segments(NamedTuple):
    """Runs of records of one cell in the temporary file, (s,) int64 each."""

    cell: I64
    """:func:`keys_of` the cell."""
    first: I64
    """First record."""
    n_records: I64


_NO_SEGMENTS = _Segments(*(np.empty(0, np.int64) for _ in range(3)))


class Cloud:
    """The points of one side in a temporary file.

    Every chunk is sorted by cell and by fine square, so a cell has one segment in each chunk.
    """

    def __init__(self, chunks: Iterator[Columns], handle: BinaryIO) -> None:
        """Read all chunks; each has ``x``, ``y``, ``z`` (finite) and the same other columns."""
        self._handle = handle
        self._lock = threading.Lock()
        self._dtype = np.dtype([(axis, np.float64) for axis in AXES])
        self.n = 0
        self.low = np.full(3, np.inf)
        self.high = np.full(3, -np.inf)
        self._squares: list[tuple[I64, I64]] = [(np.empty(0, np.int64), np.empty(0, np.int64))]
        """Keys and counts of squares: first the merged ones, then those of single chunks."""
        segments = [_NO_SEGMENTS]
        segments.extend(
            self._write_chunk(columns) for columns in read_ahead(chunks) if len(columns["x"])
        )
        cell = np.concatenate([part.cell for part in segments])
        order = np.argsort(cell, kind="stable")
        self._segments = _Segments(
            cell[order],
            np.concatenate([part.first for part in segments])[order],
            np.concatenate([part.n_records for part in segments])[order],
        )

    def _write_chunk(self, columns: Columns) -> _Segments:
        n = len(columns["x"])
        if not self.n:
            self._dtype = np.dtype([(name, values.dtype) for name, values in columns.items()])
        keys = _fine_keys(columns["x"], columns["y"])
        order = np.argsort(keys, kind="stable")
        records = np.empty(n, self._dtype)
        for name, values in columns.items():
            records[name] = values[order]
        with scratch_errors("matching"):
            self._handle.write(records.view(np.uint8).data)
        for axis, name in enumerate(AXES):
            self.low[axis] = min(self.low[axis], columns[name].min())
            self.high[axis] = max(self.high[axis], columns[name].max())
        sorted_keys = keys[order]
        square_starts = _run_starts(sorted_keys)
        column, row = _fine_places(sorted_keys[square_starts])
        # a counted square is two fine squares wide
        self._count_squares(keys_of(column >> 1, row >> 1), np.diff(square_starts, append=n))
        cell = keys_of(column >> _FINE_BITS, row >> _FINE_BITS)
        cell_starts = _run_starts(cell)
        first = square_starts[cell_starts]
        segments = _Segments(cell[cell_starts], first + self.n, np.diff(first, append=n))
        self.n += n
        return segments

    def _count_squares(self, keys: I64, counts: I64) -> None:
        self._squares.append((keys, counts))
        merged, *unmerged = self._squares
        # a merge sorts all squares: it waits until the new ones are as many as the merged ones
        if sum(len(keys) for keys, _ in unmerged) > max(len(merged[0]), _MAX_UNMERGED):
            self._squares = [self.squares()]

    def squares(self) -> tuple[I64, I64]:
        """Return the squares with points, as sorted :func:`cell_keys`, and their counts."""
        counts = np.concatenate([counts for _, counts in self._squares])
        keys, index = np.unique(
            np.concatenate([keys for keys, _ in self._squares]), return_inverse=True
        )
        return keys, np.bincount(index, counts, len(keys)).astype(np.int64)

    def counts(self) -> tuple[I64, I64]:
        """Return the cells with points, as sorted :func:`cell_keys`, and their counts."""
        cells, index = np.unique(self._segments.cell, return_inverse=True)
        return cells, np.bincount(index, self._segments.n_records, len(cells)).astype(np.int64)

    def read(self, box: Box, margin: float = 0.0) -> Columns:
        """Return the points of a box and of a margin around it [m]."""
        # the margin may be infinite: it ends a cell outside the cloud, so that keys do not overflow
        (x_low, y_low, _) = self.low - CELL_M
        (x_high, y_high, _) = self.high + CELL_M
        x0 = max(box[0] - margin, min(x_low, box[0]))
        y0 = max(box[1] - margin, min(y_low, box[1]))
        x1 = min(box[2] + margin, max(x_high, box[2]))
        y1 = min(box[3] + margin, max(y_high, box[3]))
        ends = cell_keys(np.array([x0, x1]), np.array([y0, y1]), CELL_M)
        (west, east), (south, north) = cell_places(ends)
        cells = self._segments.cell
        columns = np.unique(cell_places(cells)[0])
        columns = columns[(columns >= west) & (columns <= east)]
        # segments are sorted by key: within a column from south to north
        starts = np.searchsorted(cells, keys_of(columns, south), side="left")
        stops = np.searchsorted(cells, keys_of(columns, north), side="right")
        spans = [np.arange(start, stop) for start, stop in zip(starts, stops, strict=True)]
        chosen = np.concatenate([np.empty(0, np.int64), *spans])
        # the file is read from its start to its end
        chosen = chosen[np.argsort(self._segments.first[chosen])]
        parts = [np.empty(0, self._dtype)]
        for records in self._read_segments(chosen):
            x = records["x"]
            y = records["y"]
            inside = (x >= x0) & (x < x1) & (y >= y0) & (y < y1)
            parts.append(records if inside.all() else records[inside])
        records = np.concatenate(parts)
        # with neighbours in space beside each other in memory, queries of a tree are twice as fast
        order = np.argsort(cell_keys(records["x"], records["y"], _FINE_M), kind="stable")
        return {name: records[name][order] for name in self._dtype.names or ()}

    def _read_segments(self, chosen: I64) -> Iterator[NDArray[Any]]:
        """Yield the records of segments, given by index, in arrays of limited size."""
        first = self._segments.first[chosen]
        count = self._segments.n_records[chosen]
        groups = np.cumsum(count) // _RECORDS_PER_READ
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


def _run_starts(keys: I64) -> I64:
    """Return the index of the first key of every run of equal keys."""
    return np.flatnonzero(np.append(True, keys[1:] != keys[:-1]))


class _Node(NamedTuple):
    """A square of the plan that may be quartered; lengths in cells."""

    column: int
    row: int
    size: int
    members: I64
    """Index of its cells."""


def tiles_of(left: Cloud, right: Cloud, most: int = TILE_RECORDS) -> list[Box]:
    """Cut the plan into boxes of at most about ``most`` points of both clouds.

    Right points count only in cells with left points and in the cells around these.
    """
    left_cells, left_counts = left.counts()
    right_cells, right_counts = right.counts()
    around_left = [left_cells + (i << 32) + j for i in (-1, 0, 1) for j in (-1, 0, 1)]
    cells = np.union1d(left_cells, np.intersect1d(np.concatenate(around_left), right_cells))
    if not len(cells):
        return []
    n_points = np.zeros(len(cells), np.int64)
    for keys, counts in ((left_cells, left_counts), (right_cells, right_counts)):
        is_counted = np.isin(keys, cells)
        n_points[np.searchsorted(cells, keys[is_counted])] += counts[is_counted]
    columns, rows = cell_places(cells)
    span = max(int(np.ptp(columns)), int(np.ptp(rows))) + 1
    power_of_two = 1 << (span - 1).bit_length()
    nodes = [_Node(int(columns.min()), int(rows.min()), power_of_two, np.arange(len(cells)))]
    tiles: list[Box] = []
    while nodes:
        column, row, size, members = nodes.pop()
        total = int(n_points[members].sum())
        if total > most and size > 1:
            half = size // 2
            east = columns[members] >= column + half
            north = rows[members] >= row + half
            quarters = (
                _Node(column, row, half, members[~east & ~north]),
                _Node(column, row + half, half, members[~east & north]),
                _Node(column + half, row, half, members[east & ~north]),
                _Node(column + half, row + half, half, members[east & north]),
            )
            # the last node is the next one
            nodes += [quarter for quarter in reversed(quarters) if len(quarter.members)]
            continue
        n_parts = 1
        if total > most:
            # a single cell of too many points: a halving of its edges quarters the points
            n_parts = 1 << math.ceil(math.log2(total / most) / 2)
        edge_m = size * CELL_M / n_parts
        for i in range(n_parts):
            for j in range(n_parts):
                x = column * CELL_M + i * edge_m
                y = row * CELL_M + j * edge_m
                tiles.append((x, y, x + edge_m, y + edge_m))
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


class _TileSample(NamedTuple):
    """Distances in one tile [m]."""

    distance: F64
    """(n,) from sampled left points to the nearest right point, infinite beyond the reach."""
    spacing_around: F64
    """(n,) from that right point to its fifth neighbour; 0 beyond the reach."""
    spacing: F64
    """(m,) from these right points, each once, to their nearest neighbour."""


def _sample_tile(left_points: Columns, right: Cloud, box: Box) -> _TileSample | None:
    """Measure the distances of left points to the right cloud; None if it has too few points."""
    right_points, distance, nearest, tree = nearest_of(left_points, right, box, _FIT_REACH_M)
    n_right = len(right_points["x"])
    if tree is None or n_right <= _NEIGHBOURS:
        return None
    used = np.unique(nearest[np.isfinite(distance)])
    # a point is its own first neighbour
    to_neighbours = tree.query(tree.data[used], k=[2, _NEIGHBOURS + 1])[0]
    # index n_right belongs to left points without a nearest right point
    spacing_around = np.zeros(n_right + 1)
    spacing_around[used] = to_neighbours[:, 1]
    return _TileSample(distance, spacing_around[nearest], to_neighbours[:, 0])


def fit_of(left: Cloud, right: Cloud) -> Fit | None:
    """Measure two clouds in tiles spread over the left one; None if they do not overlap."""
    boxes = tiles_of(left, right)
    random = np.random.default_rng(0)
    samples: list[_TileSample] = []
    for box in random.permutation(np.array(boxes).reshape(-1, 4)).tolist():
        if len(samples) == _SAMPLED_TILES:
            break
        left_points = left.read(tuple(box))
        if not len(left_points["x"]):
            continue
        sample = _sample_tile(sample_of(left_points, random), right, tuple(box))
        if sample is not None:
            samples.append(sample)
    if not samples:
        return None
    distance = np.concatenate([sample.distance for sample in samples])
    spacing_around = np.concatenate([sample.spacing_around for sample in samples])
    spread_m = float(np.median(distance))
    spacing_m = float(np.median(np.concatenate([sample.spacing for sample in samples])))
    if not math.isfinite(spread_m):  # most left points have no right point near them
        return None
    tolerance_m = _tolerance_of(np.sort(distance), spread_m, spacing_m)
    beyond = distance > tolerance_m
    sparse = float(np.mean(distance[beyond] <= spacing_around[beyond])) if beyond.any() else 0.0
    return Fit(spread_m, spacing_m, tolerance_m, sparse)


def _tolerance_of(sorted_distances: F64, spread: float, spacing: float) -> float:
    """Return the least distance beyond which few more partners are found [m]."""
    most = max(_MAX_SPREADS * max(spread, spacing), LEAST_M)
    tolerance = max(LEAST_M, _MIN_SPREADS * spread)
    while tolerance < most:
        n_beyond, n_beyond_wider = len(sorted_distances) - np.searchsorted(
            sorted_distances, [tolerance, tolerance * _WIDER], side="right"
        )
        if n_beyond - n_beyond_wider <= _FEW_SHARE * n_beyond:
            break
        tolerance *= _GROWTH
    return float(f"{min(_SAFETY * tolerance, most):.2g}")


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

    return cKDTree(xyz, **_TREE_OPTIONS)


@dataclass(frozen=True, slots=True)
class Nearest:
    """Left points of a tile with the nearest right ones."""

    box: Box
    left: Columns
    """Left points of the box: n. Every left point is in one tile."""
    right: Columns
    """Right points of the box and of a margin."""
    partner_index: I64
    """(n,) index in ``right``; -1 = none within the tolerance."""
    distance: F64
    """(n,) distance to the nearest right point, infinite beyond the reach [m]."""
    sparse: Mask
    """(n,) points without partner that are no farther from the nearest right point than right
    points there are from each other: the right cloud may have lost their partners."""


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
        The counts of every tile are added to it.
    reach : float, optional
        Distance up to which distances are measured [m]; default and least value: the tolerance.
    """
    reach = max(tolerance, reach or 0.0)

    def join(box: Box) -> tuple[Nearest, int]:
        # left points just outside are read, too: their partners may be right points of the box,
        # which are counted here
        left_points = left.read(box, tolerance)
        right_points, distance, nearest, tree = nearest_of(
            left_points, right, box, reach, tolerance
        )
        partner_index = np.where(distance <= tolerance, nearest, -1)
        is_partner = np.zeros(len(right_points["x"]), np.bool_)
        is_partner[partner_index[partner_index >= 0]] = True
        n_partners = int(np.count_nonzero(is_partner & _inside(right_points, box)))
        in_box = _inside(left_points, box)
        left_points = {name: values[in_box] for name, values in left_points.items()}
        partner_index = partner_index[in_box]
        distance = distance[in_box]
        nearest = nearest[in_box]
        sparse = np.zeros(len(partner_index), np.bool_)
        alone = np.flatnonzero(np.isfinite(distance) & (partner_index < 0))
        if len(alone):
            # a point is its own first neighbour
            spacing = tree.query(tree.data[nearest[alone]], k=_NEIGHBOURS + 1)[0][:, -1]
            sparse[alone] = distance[alone] <= spacing
        return Nearest(box, left_points, right_points, partner_index, distance, sparse), n_partners

    for tile, n_partners in ordered(join, tiles_of(left, right), threads=default_threads()):
        has_partner = tile.partner_index >= 0
        tally.n_right += n_partners
        tally.n_left += len(has_partner)
        tally.n_pairs += int(np.count_nonzero(has_partner))
        tally.add_distances(tile.distance, has_partner)
        if len(has_partner):
            yield tile


def nearest_of(
    points: Columns,
    cloud: Cloud,
    box: Box,
    bound: float,
    margin: float = 0.0,
) -> tuple[Columns, F64, I64, Any]:
    """Find the nearest point of a cloud for every one of n points.

    Parameters
    ----------
    points : dict of (n,) arrays
        At most ``margin`` outside the box.
    cloud : Cloud
    box : tuple
    bound : float
        Largest distance of a nearest point [m].
    margin : float
        [m].

    Returns
    -------
    tuple
        Points of the cloud around the box; distance (n,) [m], infinite beyond ``bound``; index (n,)
        of the nearest one, their number if there is none; their tree, None without points.
    """
    cloud_points = cloud.read(box, margin + bound)
    n = len(points["x"])
    if not len(cloud_points["x"]):
        return cloud_points, np.full(n, np.inf), np.zeros(n, np.int64), None
    # coordinates of a projection are millions of metres: the tree works beside the origin
    origin = np.array([cloud_points[axis][0] for axis in AXES])
    tree = tree_of(xyz_of(cloud_points) - origin)
    places = xyz_of(points) - origin
    exclusive_bound = float(np.nextafter(bound, math.inf))
    n_compared = 1
    if TIME in points and TIME in cloud_points:
        n_compared = min(2, len(cloud_points["x"]))
    distance, neighbours = tree.query(  # (n, 1 or 2) each
        places, [*range(1, n_compared + 1)], distance_upper_bound=exclusive_bound
    )
    nearest = neighbours[:, 0]
    is_tied = (distance[:, 0] == distance[:, -1]) & np.isfinite(distance[:, 0])
    if n_compared > 1 and is_tied.any():
        nearest[is_tied] = _nearest_in_time(
            tree, places[is_tied], points[TIME][is_tied], cloud_points[TIME], exclusive_bound
        )
    return cloud_points, distance[:, 0], nearest, tree


def _nearest_in_time(
    tree: Any, places: F64, time_s: F64, cloud_time_s: F64, exclusive_bound: float
) -> I64:
    """Return the index of the nearest point (n,); of equally near ones, the nearest in time."""
    n_compared = min(_MAX_TIED, len(cloud_time_s))
    distance, neighbours = tree.query(
        places, [*range(1, n_compared + 1)], distance_upper_bound=exclusive_bound
    )
    # the added NaN is for no neighbour
    difference_s = np.abs(np.append(cloud_time_s, np.nan)[neighbours] - time_s[:, None])
    is_tied = (distance == distance[:, :1]) & np.isfinite(difference_s)
    chosen = np.argmin(np.where(is_tied, difference_s, np.inf), axis=1)
    nearest: I64 = neighbours[np.arange(len(places)), chosen]
    return nearest


def _inside(columns: Columns, box: Box) -> Mask:
    x = columns["x"]
    y = columns["y"]
    inside: Mask = (x >= box[0]) & (x < box[2]) & (y >= box[1]) & (y < box[3])
    return inside
