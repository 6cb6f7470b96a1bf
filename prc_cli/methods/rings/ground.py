"""The ground around a spinning scanner: a smooth surface that the lowest returns lie on.

Cells are sectors of azimuth by bins of distance, as in Patchwork++ (Lee et al. 2022). A plane
through the lowest heights near the scanner gives its height, its lean, and whether it hangs upside
down. From there the surface is followed outwards, smoothed, and corrected by the shots near it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.frame import SensorFrame, turning
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, F64
from prc_cli.methods.rings.ground_loops import (
    heights_above,
    lowest_heights,
    smooth_surface,
    walk_outwards,
)
from prc_cli.methods.rings.thresholds import BINS_PER_ROOT_M, N_BINS, GroundThresholds

USUAL_STEP_RAD = math.radians(0.2)
"""Angle between lines if it cannot be measured [rad]: ten turns a second of most scanners."""
WHOLE_TURN = 0.97
"""Share of a turn from which on the last sector of a block is beside the first."""
NEAR_M = 25.0
"""The plane is fitted up to this distance [m]."""
HIGHEST_M = -0.3
LOWEST_M = -6.0
BIN_M = 0.1
"""Heights of the ground below a scanner, and the width of a bin of them [m]."""
TRIMS_M = (0.6, 0.35, 0.2, 0.2)
"""Heights this near to the plane fit the next one [m]."""
EASE = 1e-6
"""Added to the squares of places, so that those on one line have a plane, too [m2]."""
FEWEST = 20
"""Lowest heights that make a plane."""
UPSIDE_DOWN = 1.5
"""A scanner is upside down if this many times more heights agree with a plane above it ..."""
BOTH = 0.2
"""... and those below are less than this share of them.

Else both are level, a floor and a ceiling.
"""
LEANS_RAD = math.radians(12.0)
"""Axes are levelled before a plane that leans more is used [rad] ..."""
LEVEL = 0.4
"""... and so is a plane that less than this share of the lowest heights agrees with."""
TRIED_RAD = np.radians([12.0, 24.0, 36.0, 48.0])
N_WAYS = 12
"""Leans that are tried, each to so many sides [rad]."""
CLEAR = 1.3
"""So many times more heights agree with a plane that leans."""
MOST_LEAN_RAD = math.radians(50.0)
"""Planes that lean more are walls [rad]."""

Matrix = tuple[tuple[float, float, float], ...]
ROUNDS = 8
CORRECTIONS = 2
"""Rounds of smoothing, and how often the surface is corrected."""


@dataclass(frozen=True, slots=True)
class GroundPlane:
    """A plane through the lowest heights near the scanner."""

    slope_x: float = 0.0
    slope_y: float = 0.0
    height_m: float = 0.0
    """Height at the scanner: minus the scanner's height above the ground [m]."""
    up: float = 1.0
    """-1 if the scanner is upside down."""
    n_cells: int = 0
    """Cells that agree; 0 = nothing is known."""
    turn: Matrix | None = None
    """Axes, one a row, on which the plane is level; None = those of the scanner."""
    is_both: bool = False
    """Whether there is a plane above as well; z is then assumed to point up."""

    def heights_at(self, x_m: F64, y_m: F64) -> F64:
        """Return heights, of the shape of ``x_m`` [m]."""
        heights: F64 = self.slope_x * x_m + self.slope_y * y_m + self.height_m
        return heights


@dataclass(frozen=True, slots=True, eq=False)
class Polar:
    """The shots of a block in sectors of azimuth and bins of distance."""

    xyz_m: F32
    place: F32
    """(lines, M) float32, bin of distance of every shot, and the place in it; NaN = missing."""
    azimuth_rad: F64
    """(lines,) float64, of every line, without jumps."""
    step_rad: float
    """Angle between lines [rad]."""
    sector_lines: int
    is_round: bool
    """Whether the lines are a whole turn."""

    @classmethod
    def of(cls, xyz_m: F32, thresholds: GroundThresholds) -> Polar:
        """Return the places of shots, (lines, M, 3) float32 [m]."""
        x = xyz_m[..., 0]
        y = xyz_m[..., 1]
        place = np.sqrt(np.sqrt(x * x + y * y)) * np.float32(BINS_PER_ROOT_M)
        # a line looks where its shots lie
        along_x, along_y = (np.nansum(axis, axis=1, dtype=np.float64) for axis in (x, y))
        azimuth = _without_gaps(
            np.arctan2(along_y, along_x), np.asarray(np.isfinite(place).any(axis=1))
        )
        steps = np.abs(np.diff(azimuth))
        step = float(np.median(steps)) if len(steps) else 0.0
        step = step if step > 0 else USUAL_STEP_RAD
        is_round = len(place) * step > WHOLE_TURN * 2 * math.pi
        return cls(
            xyz_m, place, azimuth, step, max(round(thresholds.sector_rad / step), 1), is_round
        )

    def without(self, shots: NDArray[np.bool_]) -> Polar:
        """Return the places with some shots left out, (lines, M) bool."""
        return (
            replace(self, place=np.where(shots, np.float32(np.nan), self.place))
            if shots.any()
            else self
        )

    @property
    def middle_m(self) -> F64:
        """Distance of the middle of every bin, (bins,) float64 [m]."""
        root: F64 = (np.arange(N_BINS, dtype=np.float64) + 0.5) / BINS_PER_ROOT_M
        return root * root

    def centres(self) -> tuple[F64, F64]:
        """Return where the cells lie, twice (sectors, bins) float64 [m]."""
        n_lines = len(self.place)
        lines = np.arange(0, n_lines, self.sector_lines) + self.sector_lines // 2
        azimuth = self.azimuth_rad[np.minimum(lines, n_lines - 1), None]
        return np.cos(azimuth) * self.middle_m, np.sin(azimuth) * self.middle_m


def _without_gaps(azimuth: F64, known: NDArray[np.bool_]) -> F64:
    """Return azimuths without jumps; those of lines without return lie between their neighbours."""
    if not known.any():
        return np.zeros(len(azimuth))
    lines = np.arange(len(azimuth))
    azimuths: F64 = np.interp(lines, lines[known], np.unwrap(azimuth[known]))
    return azimuths


@dataclass(frozen=True, slots=True, eq=False)
class Lowest:
    """The lowest heights of the cells, and a plane through them."""

    height_m: F32
    """(sectors, bins) float32; NaN = none [m]."""
    plane: GroundPlane

    @property
    def is_sure(self) -> bool:
        """Whether the plane is about level, and many of the lowest heights agree with it."""
        near = self.height_m[:, : int(np.sqrt(NEAR_M) * BINS_PER_ROOT_M)]
        lean_rad = math.atan(math.hypot(self.plane.slope_x, self.plane.slope_y))
        return lean_rad < LEANS_RAD and self.plane.n_cells > LEVEL * int(
            np.count_nonzero(np.isfinite(near))
        )

    @classmethod
    def of(cls, polar: Polar, up: float, thresholds: GroundThresholds) -> Lowest:
        """Fit a plane to the lowest heights near the scanner, from the most frequent one."""
        low: F32 = lowest_heights(
            polar.xyz_m, polar.place, up, polar.sector_lines, N_BINS, thresholds.pair_m
        )
        x_m, y_m = polar.centres()
        use = np.isfinite(low) & (polar.middle_m < NEAR_M)
        heights = low[use].astype(np.float64)
        counts, edges = np.histogram(heights, bins=np.arange(LOWEST_M, HIGHEST_M + BIN_M, BIN_M))
        around = np.convolve(counts, np.ones(3, np.int64), "same")
        plane = np.array([0.0, 0.0, float(edges[int(np.argmax(around))]) + BIN_M / 2])
        places = np.stack([x_m[use], y_m[use], np.ones(len(heights))], axis=1)
        for trim_m in TRIMS_M:
            near = np.abs(places @ plane - heights) < trim_m
            if np.count_nonzero(near) < FEWEST:
                return cls(low, GroundPlane(0.0, 0.0, float(plane[2]), up, 0))
            near_places = places[near]
            plane = np.linalg.solve(
                near_places.T @ near_places + EASE * np.eye(3), near_places.T @ heights[near]
            )
        n_cells = int(np.count_nonzero(np.abs(places @ plane - heights) < thresholds.plane_m))
        return cls(low, GroundPlane(float(plane[0]), float(plane[1]), float(plane[2]), up, n_cells))


@stage("plane")
def find_plane(
    xyz_m: F32,
    known: GroundPlane,
    thresholds: GroundThresholds,
    up: float | None = None,
) -> tuple[Polar, Lowest]:
    """Return the places of shots, (lines, M, 3) float32 [m], the lowest heights and their plane.

    If the block shows too little of the plane, it is the plane of the blocks before. ``up`` is -1
    if z points down, 1 if it points up; None = it is to be found.
    """
    if known.n_cells:
        polar = Polar.of(turned(xyz_m, known.turn), thresholds)
        lowest = Lowest.of(polar, known.up, thresholds)
        plane = replace(lowest.plane, turn=known.turn, is_both=known.is_both)
        return polar, Lowest(lowest.height_m, plane if plane.n_cells >= FEWEST else known)
    polar = Polar.of(xyz_m, thresholds)
    level = _up_or_down(polar, thresholds, up)
    if level.is_sure:
        return polar, level
    return _levelled(xyz_m, polar, level, thresholds, up)


def _up_or_down(polar: Polar, thresholds: GroundThresholds, up: float | None) -> Lowest:
    """Return the plane below, or the one above if z points down."""
    if up is not None:
        return Lowest.of(polar, up, thresholds)
    below = Lowest.of(polar, 1.0, thresholds)
    above = Lowest.of(polar, -1.0, thresholds)
    n_below = below.plane.n_cells
    n_above = above.plane.n_cells
    if n_above <= max(UPSIDE_DOWN * n_below, FEWEST):
        return below
    if n_below < max(BOTH * n_above, FEWEST):
        return above
    return Lowest(below.height_m, replace(below.plane, is_both=True))


def _levelled(
    xyz_m: F32,
    polar: Polar,
    level: Lowest,
    thresholds: GroundThresholds,
    up: float | None,
) -> tuple[Polar, Lowest]:
    """Return the places of shots on axes on which leaning ground is level, and the ground."""
    best = level
    best_turn: Matrix | None = None
    for lean in TRIED_RAD.tolist():
        for way in np.arange(N_WAYS) * (2 * math.pi / N_WAYS):
            turn = _matrix(turning(lean * np.array([math.cos(way), math.sin(way), 0.0])))
            tried = _up_or_down(Polar.of(turned(xyz_m, turn), thresholds), thresholds, up)
            if tried.plane.n_cells > best.plane.n_cells:
                best = tried
                best_turn = turn
    is_clear = best.plane.n_cells > CLEAR * level.plane.n_cells
    plane = best.plane if is_clear else level.plane
    # from the axes that were tried to those of the plane, in two steps
    first = _onto(plane, best_turn if is_clear else None)
    plane = Lowest.of(Polar.of(turned(xyz_m, first), thresholds), plane.up, thresholds).plane
    last = _onto(plane, first)
    level_polar = Polar.of(turned(xyz_m, last), thresholds)
    lowest = Lowest.of(level_polar, plane.up, thresholds)
    lean = math.acos(min(max(last[2][2], -1.0), 1.0))
    if (
        lowest.plane.n_cells < max(FEWEST, level.plane.n_cells)
        or not LEANS_RAD < lean < MOST_LEAN_RAD
    ):
        return polar, level
    return level_polar, Lowest(
        lowest.height_m, replace(lowest.plane, turn=last, is_both=best.plane.is_both)
    )


def _onto(plane: GroundPlane, turn: Matrix | None) -> Matrix:
    """Return axes on which a plane, known on some axes, is level."""
    slope = plane.up * np.array([plane.slope_x, plane.slope_y])
    steep = float(np.hypot(*slope))
    if not steep:
        return turn or _matrix(np.eye(3))
    # the plane falls against the slope: turn about the level line in it
    axis = np.array([-slope[1], slope[0], 0.0]) / steep
    onto = turning(math.atan(steep) * axis)
    return _matrix(onto if turn is None else onto @ np.array(turn))


def _matrix(values: F64) -> Matrix:
    """Return a matrix whose last bits do not differ between machines."""
    x, y, z = ((round(float(a), 9), round(float(b), 9), round(float(c), 9)) for a, b, c in values)
    return x, y, z


def turned(xyz_m: F32, turn: Matrix | None) -> F32:
    """Return coordinates, (..., 3) float32 [m], on other axes."""
    return xyz_m if turn is None else SensorFrame(turn).own(xyz_m)


@stage("ground")
def above_ground(polar: Polar, low: Lowest, thresholds: GroundThresholds) -> F32:
    """Return the height of every shot above the ground, (lines, M) float32 [m]; NaN = missing."""
    base = low.plane.heights_at(*polar.centres())
    start, seen = walk_outwards(
        (low.height_m - base).astype(np.float32), polar.middle_m, thresholds
    )
    surface = smooth_surface(
        start, seen.astype(np.float64), start, thresholds.stiff, ROUNDS, polar.is_round
    )
    for _ in range(CORRECTIONS):
        _, total, number = _heights(polar, low.plane, base + surface, thresholds)
        better = surface + np.where(number > 0, total / np.maximum(number, 1.0), 0.0)
        weight = np.where(
            number >= thresholds.shots, np.minimum(number / thresholds.shots, thresholds.most), 0.0
        )
        surface = smooth_surface(better, weight, surface, thresholds.stiff, ROUNDS, polar.is_round)
    return _heights(polar, low.plane, base + surface, thresholds)[0]


def _heights(
    polar: Polar,
    plane: GroundPlane,
    surface_m: F64,
    thresholds: GroundThresholds,
) -> tuple[F32, F64, F64]:
    heights: tuple[F32, F64, F64] = heights_above(
        polar.xyz_m,
        polar.place,
        plane.up,
        surface_m,
        polar.sector_lines,
        BINS_PER_ROOT_M,
        thresholds,
    )
    return heights
