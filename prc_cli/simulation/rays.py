"""Rays of whole scan lines, and where they enter and leave simple bodies.

Coordinates [m]: x along the street in driving direction, y to the left, z up from the crown of the road.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64, I64, U8

U64: TypeAlias = NDArray[np.uint64]

TINY = 1e-12
"""Slopes are never smaller, so that nothing is divided by zero."""


@dataclass(frozen=True, slots=True)
class Rays:
    """Shots of consecutive lines; only the place along the street differs from line to line."""

    x: F64
    """(lines, M) float64, where the scanner is along the street at every shot [m]."""
    y: float
    """Scanner to the left of the crown [m]."""
    z: float
    """Scanner above the crown [m]."""
    dx: F64
    """(M,) float64, direction along the street, unit length with dy and dz."""
    dy: F64
    """(M,) float64."""
    dz: F64
    """(M,) float64."""

    def part(self, lines: slice, columns: slice) -> Rays:
        """Return the rays of a window of the range image (views, no copies)."""
        return Rays(self.x[lines, columns], self.y, self.z, self.dx[columns], self.dy[columns], self.dz[columns])


@dataclass(frozen=True, slots=True)
class Hits:
    """The nearest surface of every shot so far; its arrays are filled in place while a block is cast."""

    t: F64
    """(lines, M) float64, range [m], inf = nothing yet."""
    label: U8
    """(lines, M) uint8, :class:`prc_cli.core.classes.Label`; MISSING behind a finite t = swallowed, as by glass."""
    facing: F64
    """(lines, M) float64, cosine of the angle of incidence."""

    @classmethod
    def none(cls, shape: tuple[int, int]) -> Hits:
        """Nothing hit yet."""
        return cls(np.full(shape, np.inf), np.zeros(shape, dtype=np.uint8), np.ones(shape))

    def part(self, lines: slice, columns: slice) -> Hits:
        """Return a window of the range image (views: filling it fills the whole)."""
        return Hits(self.t[lines, columns], self.label[lines, columns], self.facing[lines, columns])

    def take_nearer(self, t: F64, label: U8 | int, facing: F64 | float = 1.0) -> None:
        """Replace what lies behind the given surface.

        Parameters
        ----------
        t : (lines, M) float64
            Range [m]; inf or NaN = not hit. Ranges of zero or below lie behind the scanner.
        label : (lines, M) uint8, or one label
        facing : (lines, M) or (M,) float64, or one number
            Cosine of the angle of incidence.
        """
        nearer = (t > 0) & (t < self.t)
        np.copyto(self.t, t, where=nearer)
        np.copyto(self.label, np.asarray(label, dtype=np.uint8), where=nearer)
        np.copyto(self.facing, facing, where=nearer)


@dataclass(frozen=True, slots=True)
class Bounds:
    """Axis-aligned box around a body [m]."""

    x: tuple[float, float]
    y: tuple[float, float]
    z: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Interval:
    """Where rays enter and leave a convex body."""

    enter: F64
    """(lines, M) float64 [m]; inf where the body is missed."""
    leave: F64
    """(lines, M) float64 [m]."""


def through_planes(rays: Rays, normals: F64, offsets: F64) -> Interval:
    """Cut rays with a convex polyhedron (slab method).

    Parameters
    ----------
    rays : Rays
        Shots of (lines, M).
    normals : (planes, 3) float64
        Outward normals.
    offsets : (planes,) float64
        The body is where ``normal . point <= offset`` for every plane.
    """
    enter = np.full(rays.x.shape, -np.inf)
    leave = np.full(rays.x.shape, np.inf)
    for (nx, ny, nz), offset in zip(normals.tolist(), offsets.tolist(), strict=True):
        slope = nx * rays.dx + ny * rays.dy + nz * rays.dz
        slope = np.where(np.abs(slope) < TINY, TINY, slope)
        t = (offset - ny * rays.y - nz * rays.z - nx * rays.x) / slope
        np.maximum(enter, np.where(slope < 0, t, -np.inf), out=enter)
        np.minimum(leave, np.where(slope > 0, t, np.inf), out=leave)
    return _where_hit(enter, leave)


def through_ellipsoid(rays: Rays, centre: tuple[float, float, float], radii: tuple[float, float, float]) -> Interval:
    """Cut rays with an axis-aligned ellipsoid.

    Parameters
    ----------
    rays : Rays
        Shots of (lines, M).
    centre, radii : three numbers [m]
        An infinite vertical radius makes it a vertical cylinder.
    """
    sx, sy, sz = (1.0 / radius for radius in radii)
    ox, oy, oz = (rays.x - centre[0]) * sx, (rays.y - centre[1]) * sy, (rays.z - centre[2]) * sz
    dx, dy, dz = rays.dx * sx, rays.dy * sy, rays.dz * sz
    a = np.maximum(dx * dx + dy * dy + dz * dz, TINY)
    b = ox * dx + oy * dy + oz * dz
    c = ox * ox + oy * oy + oz * oz - 1.0
    square = b * b - a * c
    root = np.sqrt(np.maximum(square, 0.0))
    enter = np.where(square > 0, (-b - root) / a, np.inf)
    return _where_hit(enter, (-b + root) / a)


def window(rays: Rays, angle_rad: F64, bounds: Bounds) -> tuple[slice, slice] | None:
    """Lines and columns whose rays can meet a box, one too many rather than one too few.

    All rays of a scan lie in one slanted plane that moves along the street, so the height of a point alone says how
    far ahead of the scanner the plane meets it, and its place across the street says under which angle.

    Parameters
    ----------
    rays : Rays
        Shots of (lines, M).
    angle_rad : (M,) float64
        Scan angle, 0 = down, positive to the left [rad], rising.
    bounds : Bounds
        The box.

    Returns
    -------
    lines, columns : slice
        None if no ray can meet the box.
    """
    zenith = int(np.argmax(rays.dz))
    ahead = rays.dx[zenith] / rays.dz[zenith]
    shifts = [(z - rays.z) * ahead for z in bounds.z]
    first = np.searchsorted(rays.x[:, -1], bounds.x[0] - max(shifts))
    last = np.searchsorted(rays.x[:, 0], bounds.x[1] - min(shifts), side="right")
    if first >= last:
        return None
    lines = slice(int(first), int(last))
    if bounds.y[0] <= rays.y <= bounds.y[1]:
        return lines, slice(0, len(angle_rad))  # below or above the scanner: the angles may go round
    stretch = np.hypot(1.0, ahead)
    corners = [np.arctan2(y - rays.y, (rays.z - z) * stretch) for y in bounds.y for z in bounds.z]
    start = np.searchsorted(angle_rad, min(corners)) - 1
    stop = np.searchsorted(angle_rad, max(corners), side="right") + 1
    return lines, slice(max(int(start), 0), int(stop))


def lattice(seed: int, *keys: I64 | int) -> F64:
    """Reproducible random numbers on a lattice of integers: no state, no order, any place at any time.

    Parameters
    ----------
    seed : int
        Which lattice.
    *keys : (...) int64
        Coordinates, broadcast against each other.

    Returns
    -------
    (...) float64
        Uniform in [0, 1).

    Examples
    --------
    >>> lattice(1, np.arange(3)).round(3)
    array([0.894, 0.591, 0.567])
    """
    state: U64 = np.full(1, seed % 2**64, dtype=np.uint64)
    for key in keys:
        state = _scramble(state ^ (np.atleast_1d(np.asarray(key, dtype=np.int64)).astype(np.uint64) + _GOLDEN))
    numbers: F64 = (state >> np.uint64(11)).astype(np.float64) * 2.0**-53
    return numbers


_GOLDEN = np.uint64(0x9E3779B97F4A7C15)


def _scramble(x: U64) -> U64:
    """Mix the bits of 64-bit numbers (the finaliser of SplitMix64, Steele et al. 2014)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


def _where_hit(enter: F64, leave: F64) -> Interval:
    missed = (enter >= leave) | (enter <= 0)
    return Interval(np.where(missed, np.inf, enter), leave)
