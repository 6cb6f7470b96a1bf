"""The rate of turns: the rate at which the points of short pieces fit a turning beam.

A wrong rate bends every plane: no station sees the points of a piece under bearings that grow by
it. So one rate has a clear minimum of the residual, without a gap in the times, a whole line or M.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from prc_cli.core.types import F64
from prc_cli.streams.registered.resection import Planes, Stations, fit_planes, resect

SLOWEST_HZ = 4.0
FASTEST_HZ = 450.0
"""Range of rates that are tried [turns a second]."""
GRID = 140
"""Rates on the first, geometric grid."""
PIECE_POINTS = 160
"""Points that are used of a piece."""
LEAST_PIECE_POINTS = 60
"""Fewer points are no piece."""
PIECE_LENGTHS_S = (0.004, 0.012, 0.03)
"""Lengths of pieces, the usual one first: a slow scanner needs longer ones."""
REFINEMENTS = (0.04, 0.01, 0.0025, 0.0006)
"""Half widths of the finer grids, as a share of the rate."""
CLEAR_CONTRAST = 10.0
CLEAR_RESIDUAL_M = 0.03
CLEAR_IN_FRONT = 0.98
"""A rotation is clear beyond these."""
LEAST_CONTRAST = 4.0
MOST_RESIDUAL_M = 0.15
LEAST_IN_FRONT = 0.9
"""A rotation must meet all of these.

The residual is 0.29 m in an airborne strip, 0.1 m with times in steps of 100 us.
"""
MOST_RATE_OFF = 1e-3
"""Rates of turns and of lines that differ by less are the same."""


@dataclass(frozen=True, slots=True)
class Pieces:
    """Short pieces of consecutive points."""

    time_s: F64
    """(p, n) float64, times less that of the middle [s]."""
    xyz_m: F64
    """(p, n, 3) float64, points less the first point of the piece [m]."""
    weight: F64
    """(p, n) float64, 1 = a point, 0 = filler."""
    middle_s: F64
    """(p,) float64, middle of every piece [s]."""
    first_m: F64
    """(p, 3) float64, the point that coordinates count from [m]."""

    def thinned(self) -> Pieces:
        """Return every second piece with every second point, for the coarse search."""
        return Pieces(
            self.time_s[::2, ::2],
            self.xyz_m[::2, ::2],
            self.weight[::2, ::2],
            self.middle_s[::2],
            self.first_m[::2],
        )


@dataclass(frozen=True, slots=True)
class Turning:
    """The bearing of the beam over time."""

    hz: float
    """Turns a second, while shots are fired."""
    line_hz: float
    """Scan lines a second: other than ``hz`` if every line is an arc."""
    origin_s: float
    """A time at which a line begins with bearing 0 [s]."""

    @property
    def is_arc(self) -> bool:
        """Whether lines are arcs, not whole turns."""
        return abs(self.hz / self.line_hz - 1.0) > MOST_RATE_OFF

    def bearing(self, time_s: F64) -> F64:
        """Return the bearing at times (n,), not wrapped [rad]."""
        since = time_s - self.origin_s
        if self.is_arc:
            since = since - np.floor(since * self.line_hz) / self.line_hz
        bearing: F64 = (2.0 * math.pi * self.hz) * since
        return bearing

    def faster(self, drift_hz: float) -> Turning:
        """Return the turning with a drift of the bearing taken out [turns a second]."""
        if self.is_arc:
            return replace(self, line_hz=self.line_hz * (1.0 + drift_hz / self.hz))
        return replace(self, hz=self.hz + drift_hz, line_hz=self.hz + drift_hz)


@dataclass(frozen=True, slots=True)
class Rotation:
    """A rate of turns, and how well it fits."""

    hz: float
    """Turns a second."""
    residual_m: float
    """Median residual of the pieces [m]."""
    contrast: float
    """Usual residual over that of the best rate; near 1 if no rate fits better."""
    in_front: float
    """Median share of points in front of the beam."""

    @property
    def is_possible(self) -> bool:
        """Whether a turning beam may have measured the points."""
        return (
            self.contrast > LEAST_CONTRAST
            and self.residual_m < MOST_RESIDUAL_M
            and self.in_front > LEAST_IN_FRONT
        )

    @property
    def is_clear(self) -> bool:
        """Whether the rate is beyond doubt."""
        return (
            self.contrast > CLEAR_CONTRAST
            and self.residual_m < CLEAR_RESIDUAL_M
            and self.in_front > CLEAR_IN_FRONT
        )


def cut_pieces(
    time_s: F64,
    xyz_m: F64,
    length_s: float,
    n_pieces: int,
) -> Pieces | None:
    """Choose pieces of consecutive points, spread evenly; None for too few points.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s].
    xyz_m
        (n, 3) float64 [m].
    length_s
        Length of a piece [s].
    n_pieces
        Pieces at most.
    """
    begin = np.linspace(0, len(time_s) - 1, 6 * n_pieces).astype(np.int64)
    end = np.searchsorted(time_s, time_s[begin] + length_s)
    last = np.maximum(end - 1, 0)
    has_points = end - begin >= LEAST_PIECE_POINTS
    usable = np.flatnonzero(has_points & (time_s[last] - time_s[begin] > 0))
    if len(usable) < 8:
        return None
    n_chosen = min(n_pieces, len(usable))
    chosen = usable[np.linspace(0, len(usable) - 1, n_chosen).astype(np.int64)]
    return pieces_between(time_s, xyz_m, begin[chosen], end[chosen], PIECE_POINTS)


def pieces_between(
    time_s: F64,
    xyz_m: F64,
    begin: np.ndarray,
    end: np.ndarray,
    n_points: int,
) -> Pieces:
    """Return evenly chosen points of the pieces from ``begin`` to ``end``, (p,) each."""
    count = (end - begin)[:, None]
    at_least_one = np.maximum(count, 1)
    step = at_least_one / np.minimum(n_points, at_least_one)
    place = np.arange(n_points)[None, :]
    in_piece = np.minimum((place + 0.5) * step, np.maximum(count - 1, 0)).astype(np.int64)
    index = np.clip(begin[:, None] + in_piece, 0, len(time_s) - 1)
    first = index[:, 0]
    last = np.clip(end - 1, 0, len(time_s) - 1)
    middle_s = 0.5 * (time_s[first] + time_s[last])
    return Pieces(
        time_s=time_s[index] - middle_s[:, None],
        xyz_m=xyz_m[index] - xyz_m[first][:, None, :],
        weight=(place < np.minimum(n_points, count)).astype(np.float64),
        middle_s=middle_s,
        first_m=xyz_m[first],
    )


def find_rotation(time_s: F64, xyz_m: F64, *, n_pieces: int = 48) -> Rotation | None:
    """Find the rate at which a beam turns.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s].
    xyz_m
        (n, 3) float64 [m].
    n_pieces
        Pieces at most.

    Returns
    -------
    Rotation or None
        The best rate, whatever its residual; None for too few points.
    """
    best: Rotation | None = None
    for length_s in PIECE_LENGTHS_S:
        pieces = cut_pieces(time_s, xyz_m, length_s, n_pieces)
        if pieces is None:
            continue
        rotation = _best_rate(pieces)
        if (
            best is None
            or rotation.residual_m * best.contrast < best.residual_m * rotation.contrast
        ):
            best = rotation
        if best.is_clear:
            break
    return best


def _best_rate(pieces: Pieces) -> Rotation:
    # a grid of rates with a part of the points, then ever finer ones with all
    coarse = pieces.thinned()
    planes = fit_planes(coarse.xyz_m, coarse.weight)
    rates = np.geomspace(SLOWEST_HZ, FASTEST_HZ, GRID)
    scores = np.array([_score(coarse, planes, rate) for rate in rates])
    usual = float(np.median(scores))
    rate = float(rates[int(np.argmin(scores))])
    planes = fit_planes(pieces.xyz_m, pieces.weight)
    for width in REFINEMENTS:
        rates = rate * (1.0 + np.linspace(-width, width, 9))
        scores = np.array([_score(pieces, planes, hz) for hz in rates])
        rate = float(rates[int(np.argmin(scores))])
    residual = _score(pieces, planes, rate)
    stations, _ = stations_both_ways(pieces, planes, rate)
    return Rotation(
        hz=rate,
        residual_m=residual,
        contrast=usual / max(residual, 1e-9),
        in_front=float(np.median(stations.in_front)),
    )


def _score(pieces: Pieces, planes: Planes, hz: float) -> float:
    stations, _ = stations_both_ways(pieces, planes, hz)
    return float(np.median(stations.misfit_m))


def stations_both_ways(pieces: Pieces, planes: Planes, hz: float) -> tuple[Stations, Stations]:
    """Return the stations of pieces for the better sense of turning, and for the other."""
    bearing = 2.0 * math.pi * hz * pieces.time_s
    left = resect(planes, pieces.xyz_m, bearing, pieces.weight, sense=1)
    right = resect(planes, pieces.xyz_m, bearing, pieces.weight, sense=-1)
    is_left = left.misfit_m <= right.misfit_m
    return left.where(is_left, right), right.where(is_left, left)
