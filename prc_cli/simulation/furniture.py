"""Parked cars, trees, hedges, lamp posts and signs: bodies that stand about in the street, and how shots meet them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.types import F64, U8
from prc_cli.simulation.houses import FACADE_M, PAVEMENT_Z_M, ROAD_HALF_M, Lots, lots_between
from prc_cli.simulation.rays import Bounds, Rays, lattice, through_ellipsoid, through_planes

CELL_M = 8.0
"""Length of street that holds at most one parked car, one tree and one post a side [m]."""


class Body(Protocol):
    """Anything that a ray may meet."""

    @property
    def bounds(self) -> Bounds:
        """Axis-aligned box around it [m]."""

    def cast(self, rays: Rays, chance: F64, depth: F64) -> tuple[F64, U8 | int]:
        """Find where rays meet the body.

        Parameters
        ----------
        rays : Rays
            Shots of (lines, M).
        chance : (lines, M) float64
            A uniform random number per shot.
        depth : (lines, M) float64
            An exponential random number of mean 1 per shot: how many mean free paths it gets into leaves.

        Returns
        -------
        (lines, M) float64, (lines, M) uint8 or one label
            Range [m], inf = missed; label, MISSING = swallowed.
        """


@dataclass(frozen=True, slots=True)
class Solid:
    """Convex body with flat faces, perhaps with a band of glass around it."""

    bounds: Bounds
    normals: F64
    offsets: F64
    label: Label
    glass_z: tuple[float, float] | None = None
    """Heights between which it is made of glass [m]."""

    def cast(self, rays: Rays, chance: F64, depth: F64) -> tuple[F64, U8 | int]:
        """See :meth:`Body.cast`; three of four shots at the glass are lost, the others end a little behind it."""
        way = through_planes(rays, self.normals, self.offsets)
        t = way.enter
        if self.glass_z is None:
            return t, self.label
        z = rays.z + np.where(np.isfinite(t), t, 0.0) * rays.dz
        glass = (z > self.glass_z[0]) & (z < self.glass_z[1])
        label = np.where(glass & (chance < 0.75), Label.MISSING, self.label).astype(np.uint8)
        inside = np.minimum(t + 2.0 * (chance - 0.75).clip(0.0), way.leave)
        return np.where(glass, inside, t), label


@dataclass(frozen=True, slots=True)
class Post:
    """Upright cylinder."""

    x: float
    y: float
    radius: float
    z: tuple[float, float]
    label: Label

    @property
    def bounds(self) -> Bounds:
        """See :attr:`Body.bounds`."""
        reach = self.radius
        return Bounds((self.x - reach, self.x + reach), (self.y - reach, self.y + reach), self.z)

    def cast(self, rays: Rays, chance: F64, depth: F64) -> tuple[F64, U8 | int]:
        """See :meth:`Body.cast`."""
        t = through_ellipsoid(rays, (self.x, self.y, 0.0), (self.radius, self.radius, np.inf)).enter
        z = rays.z + np.where(np.isfinite(t), t, 0.0) * rays.dz
        return np.where((z > self.z[0]) & (z < self.z[1]), t, np.inf), self.label


@dataclass(frozen=True, slots=True)
class Leaves:
    """Ellipsoid or box filled with leaves: a shot gets in as far as chance lets it, or through."""

    bounds: Bounds
    free_path: float
    """Mean way through the leaves [m]."""
    box: bool = False

    def cast(self, rays: Rays, chance: F64, depth: F64) -> tuple[F64, U8 | int]:
        """See :meth:`Body.cast`; leaves stand in clumps of half a metre with gaps between them."""
        sides = (self.bounds.x, self.bounds.y, self.bounds.z)
        if self.box:
            normals = np.vstack([np.eye(3), -np.eye(3)])
            offsets = np.array([high for _, high in sides] + [-low for low, _ in sides])
            way = through_planes(rays, normals, offsets)
        else:
            middle = [(low + high) / 2 for low, high in sides]
            radii = [(high - low) / 2 for low, high in sides]
            way = through_ellipsoid(rays, (middle[0], middle[1], middle[2]), (radii[0], radii[1], radii[2]))
        met = np.isfinite(way.enter)
        enter = np.where(met, way.enter, 0.0)
        cells = [
            np.floor(2.0 * (origin + enter * step)).astype(np.int64)
            for origin, step in ((rays.x, rays.dx), (rays.y, rays.dy), (rays.z, rays.dz))
        ]
        clump = 0.3 + 2.2 * lattice(5, *cells) ** 2
        t = enter + depth * self.free_path * clump
        return np.where(met & (t < way.leave), t, np.inf), Label.VEGETATION


def bodies_between(seed: int, x_low: float, x_high: float) -> Iterator[Body]:
    """Lay out everything that may stand in a stretch of street, always in the same order.

    Parameters
    ----------
    seed : int
        Of the street.
    x_low, x_high : float
        The stretch [m].
    """
    for side in (1, -1):
        for cell in range(int(x_low // CELL_M) - 1, int(x_high // CELL_M) + 2):
            yield from _cell(seed, side, cell)
        lots = lots_between(seed, side, x_low, x_high)
        for i in np.flatnonzero(lots.hedged & (np.diff(lots.edge) > 0.1)):
            yield from _garden(seed, side, lots, int(i))


def _cell(seed: int, side: int, cell: int) -> Iterator[Body]:
    u = lattice(seed, 11, side, cell, np.arange(16)).tolist()
    x = cell * CELL_M
    if u[0] < 0.6:
        yield from _car(x + 2.4 + 3.2 * u[1], side * (ROAD_HALF_M - 1.05 - 0.2 * u[2]), u[3], van=u[4] < 0.15)
    if u[5] < 0.55:
        yield from _tree(x + 8.0 * u[6], side * (ROAD_HALF_M + 1.0 + 0.2 * u[7]), u[8], u[9])
    elif u[5] < 0.85:
        y = side * (ROAD_HALF_M + 0.5)
        yield Post(x + 4.0, y, 0.07 if u[10] < 0.5 else 0.04, (PAVEMENT_Z_M, 7.5 if u[10] < 0.5 else 2.9), _OTHER)
        if u[10] >= 0.5:
            yield _cuboid((x + 3.94, x + 3.97), (y - 0.32, y + 0.32), (2.2, 2.85), _OTHER)
    if u[11] < 0.15:
        y, radius = side * (FACADE_M - 0.6), 0.35 + 0.3 * u[13]
        yield _ellipsoid((x + 8.0 * u[12], y, 0.5), (1.5 * radius, radius, 0.5 + radius), 0.12)


_OTHER = Label.UNCLASSIFIED
"""Posts and signs have no class of their own: evaluated as "other"."""


def _car(x: float, y: float, size: float, *, van: bool) -> Iterator[Body]:
    """Body, cabin with slanted glass, and four wheels."""
    half, width = (2.5, 0.95) if van else (1.95 + 0.35 * size, 0.86)
    waist, roof = (1.05, 2.05) if van else (0.85, 1.38 + 0.15 * size)
    yield _cuboid((x - half, x + half), (y - width, y + width), (0.2, waist), Label.CAR)
    back, front = (x - half + 0.05, x + half - 1.1) if van else (x - half + 0.5, x + half - 1.2)
    slant = np.array([0.75, 0.0, 0.66]) / np.hypot(0.75, 0.66)
    rear = np.array([-0.94, 0.0, 0.34]) / np.hypot(0.94, 0.34)
    inward = 0.12
    sides = [(0.0, sign / np.hypot(1, inward), inward / np.hypot(1, inward)) for sign in (1.0, -1.0)]
    normals = np.array([(0, 0, 1), (0, 0, -1), *sides, slant, rear], dtype=np.float64)
    points = [(x, y, roof), (x, y, waist), (x, y + width, waist), (x, y - width, waist)]
    points += [(front + 0.3, y, waist), (back, y, waist)]
    offsets = np.einsum("ij,ij->i", normals, np.array(points))
    bounds = Bounds((back, front + 0.3), (y - width, y + width), (waist, roof))
    yield Solid(bounds, normals, offsets, Label.CAR, glass_z=(waist + 0.06, roof - 0.09))
    for wheel_x in (x - 0.65 * half, x + 0.65 * half):
        for inner, outer in ((y - width + 0.02, y - width + 0.22), (y + width - 0.22, y + width - 0.02)):
            yield _cuboid((wheel_x - 0.3, wheel_x + 0.3), (inner, outer), (-0.1, 0.3), Label.CAR)


def _tree(x: float, y: float, size: float, shape: float) -> Iterator[Body]:
    """Trunk, and a crown of one large and three smaller overlapping balls of leaves."""
    radius, tall = 2.0 + 1.4 * size, 2.1 + 1.7 * shape
    base = 2.7 + 0.6 * size
    yield Post(x, y, 0.1 + 0.12 * size, (PAVEMENT_Z_M, base + 0.8 * tall), Label.VEGETATION)
    yield _ellipsoid((x, y, base + tall), (0.8 * radius, 0.8 * radius, tall), 0.9)
    for i in range(3):
        turn = 2.0 * np.pi * (size + shape + i / 3)
        place = (x + 0.6 * radius * np.cos(turn), y + 0.6 * radius * np.sin(turn), base + tall * (0.7 + 0.3 * i))
        yield _ellipsoid(place, (0.6 * radius, 0.6 * radius, 0.6 * tall), 0.7)


def _garden(seed: int, side: int, lots: Lots, i: int) -> Iterator[Body]:
    """Hedge along the pavement; where no house stands behind it, a tree and a bush."""
    u = lattice(seed, 13, side, lots.index[i], np.arange(6)).tolist()
    low, high = float(lots.edge[i]), float(lots.edge[i + 1])
    y = side * (FACADE_M + 0.5)
    yield Leaves(Bounds((low, high), (y - 0.45, y + 0.45), (PAVEMENT_Z_M, 1.3 + 0.6 * u[0])), 0.12, box=True)
    if not lots.built[i]:
        x = low + (high - low) * (0.35 + 0.3 * u[1])
        yield from _tree(x, side * (FACADE_M + 5.0 + 3.0 * u[2]), 0.5 * u[4], u[3])
        yield _ellipsoid((x, side * (FACADE_M + 3.0), 1.0), (1.6, 1.2, 1.0 + 0.5 * u[5]), 0.3)


def _cuboid(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float], label: Label) -> Solid:
    normals = np.vstack([np.eye(3), -np.eye(3)])
    return Solid(Bounds(x, y, z), normals, np.array([x[1], y[1], z[1], -x[0], -y[0], -z[0]]), label)


def _ellipsoid(centre: tuple[float, float, float], radii: tuple[float, float, float], free_path: float) -> Leaves:
    (x, y, z), (rx, ry, rz) = centre, radii
    return Leaves(Bounds((x - rx, x + rx), (y - ry, y + ry), (z - rz, z + rz)), free_path)
