"""Houses, leaves, slabs and railings of the static street scan, and how shots meet them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.types import F64, U8
from prc_cli.simulation.furniture import Body
from prc_cli.simulation.rays import Bounds, Interval, Rays, lattice, through_ellipsoid, through_planes

STOREY_M = 3.2
"""From floor to floor [m]."""
_SOLE_M = 1e-6
"""Points this near to a face lie on it [m]."""


def through_box(rays: Rays, bounds: Bounds) -> Interval:
    """Cut rays with an axis-aligned box."""
    sides = (bounds.x, bounds.y, bounds.z)
    normals = np.vstack([np.eye(3), -np.eye(3)])
    return through_planes(rays, normals, np.array([high for _, high in sides] + [-low for low, _ in sides]))


@dataclass(frozen=True, slots=True)
class Slab:
    """Box whose upright faces are vertical surfaces, its top and bottom horizontal ones: steps, ledges, bins."""

    bounds: Bounds

    def cast(self, rays: Rays, chance: F64, depth: F64) -> tuple[F64, U8 | int]:
        """See :meth:`prc_cli.simulation.furniture.Body.cast`."""
        t = through_box(rays, self.bounds).enter
        z = rays.z + np.where(np.isfinite(t), t, 0.0) * rays.dz
        level = (z > self.bounds.z[1] - _SOLE_M) | (z < self.bounds.z[0] + _SOLE_M)
        return t, np.where(level, Label.HORIZONTAL, Label.VERTICAL).astype(np.uint8)


@dataclass(frozen=True, slots=True)
class Railing:
    """Upright bars with gaps: every shot meets a bar or passes, by chance."""

    bounds: Bounds
    share: float
    """Of the shots that meet a bar."""

    def cast(self, rays: Rays, chance: F64, depth: F64) -> tuple[F64, U8 | int]:
        """See :meth:`prc_cli.simulation.furniture.Body.cast`."""
        t = through_box(rays, self.bounds).enter
        return np.where(chance < self.share, t, np.inf), Label.VERTICAL


@dataclass(frozen=True, slots=True)
class Painted:
    """Body of which some shots never come back: dark paint, mirrors, chrome; patch by patch."""

    body: Body
    lost: float
    """Mean share of the shots that are lost."""

    @property
    def bounds(self) -> Bounds:
        """See :attr:`prc_cli.simulation.furniture.Body.bounds`."""
        return self.body.bounds

    def cast(self, rays: Rays, chance: F64, depth: F64) -> tuple[F64, U8 | int]:
        """See :meth:`prc_cli.simulation.furniture.Body.cast`; patches are a decimetre wide, most lose little."""
        t, label = self.body.cast(rays, chance, depth)
        met = np.flatnonzero(np.isfinite(t))
        way = t.ravel()[met]
        cells = [
            np.floor(10.0 * (np.broadcast_to(origin, t.shape).ravel()[met] + way * step.ravel()[met])).astype(np.int64)
            for origin, step in ((rays.x, rays.dx), (np.float64(rays.y), rays.dy), (np.float64(rays.z), rays.dz))
        ]
        share = np.minimum(3.0 * self.lost * lattice(3, *cells) ** 2, 1.0)
        labels = np.broadcast_to(np.asarray(label, dtype=np.uint8), t.shape).copy()
        # an exponential number gives a uniform one that the glass has not used yet
        labels.ravel()[met[np.exp(-depth.ravel()[met]) < share]] = Label.MISSING
        return t, labels


@dataclass(frozen=True, slots=True)
class Foliage:
    """Ellipsoid or box filled with leaves: a shot gets in as far as chance lets it, or through.

    Chance is drawn once for every leaf, so that neighbouring shots meet the same leaf where they are close enough.
    """

    bounds: Bounds
    free_path: float
    """Mean way through the leaves, 1 / (leaf area density x 0.5) [m]."""
    leaf_m: float
    """Width of a leaf [m]; 0 = chance is drawn for every shot."""
    seed: int
    box: bool = False

    def cast(self, rays: Rays, chance: F64, depth: F64) -> tuple[F64, U8 | int]:
        """See :meth:`prc_cli.simulation.furniture.Body.cast`; leaves stand in clumps of half a metre."""
        way = self._cut(rays)
        t = np.full(rays.x.shape, np.inf)
        met = np.flatnonzero(np.isfinite(way.enter))
        enter = way.enter.ravel()[met]
        place = [
            np.broadcast_to(origin, t.shape).ravel()[met] + enter * step.ravel()[met]
            for origin, step in ((rays.x, rays.dx), (np.float64(rays.y), rays.dy), (np.float64(rays.z), rays.dz))
        ]
        clump = 0.3 + 2.1 * lattice(self.seed, 5, *(np.floor(2.0 * p).astype(np.int64) for p in place)) ** 2
        if self.leaf_m:
            cells = [np.floor(p / self.leaf_m).astype(np.int64) for p in place]
            u = lattice(self.seed, 6, *cells)
            # leaves face every way: the low bits of the number tilt them by up to 63 degrees
            tilt = np.tan(2.2 * ((u * 2.0**20) % 1.0 - 0.5))
            deep = -np.log1p(-u) * self.free_path * clump + tilt * (place[2] - (cells[2] + 0.5) * self.leaf_m)
        else:
            deep = depth.ravel()[met] * self.free_path * clump
        hit = enter + np.maximum(deep, 0.0)
        t.ravel()[met] = np.where(hit < way.leave.ravel()[met], hit, np.inf)
        return t, Label.VEGETATION

    def _cut(self, rays: Rays) -> Interval:
        if self.box:
            return through_box(rays, self.bounds)
        sides = (self.bounds.x, self.bounds.y, self.bounds.z)
        (x, y, z) = ((low + high) / 2 for low, high in sides)
        (rx, ry, rz) = ((high - low) / 2 for low, high in sides)
        return through_ellipsoid(rays, (x, y, z), (rx, ry, rz))


@dataclass(frozen=True, slots=True)
class House:
    """Block with a door and rows of recessed windows in the face towards the street."""

    bounds: Bounds
    side: int
    """1 = left of the street, -1 = right."""
    storeys: int
    floor_z: float
    """Ground floor [m]."""
    pitch_m: float
    """From window to window [m]."""
    recess_m: float
    """Depth of window openings [m]."""
    shop: bool
    """Large panes on the ground floor."""
    seed: int

    @property
    def face_y(self) -> float:
        """Where the front is, across the street [m]."""
        return self.bounds.y[0] if self.side > 0 else self.bounds.y[1]

    @property
    def columns(self) -> int:
        """Windows side by side."""
        return int((self.bounds.x[1] - self.bounds.x[0] - 0.6) / self.pitch_m)

    @property
    def first_x(self) -> float:
        """Where the first window's part of the front begins [m]."""
        return 0.5 * (self.bounds.x[0] + self.bounds.x[1] - self.columns * self.pitch_m)

    @property
    def door(self) -> int:
        """Column with the door; it stands where the ground floor has no window."""
        return (self.seed * 7 + self.storeys) % max(self.columns, 1)

    def cast(self, rays: Rays, chance: F64, depth: F64) -> tuple[F64, U8 | int]:
        """See :meth:`prc_cli.simulation.furniture.Body.cast`."""
        t = through_box(rays, self.bounds).enter
        known = np.where(np.isfinite(t), t, 0.0)
        z = rays.z + known * rays.dz
        label = np.where(z > self.bounds.z[1] - _SOLE_M, Label.HORIZONTAL, Label.VERTICAL).astype(np.uint8)
        front = np.isfinite(t) & (np.abs(rays.y + known * rays.dy - self.face_y) < _SOLE_M)
        x = (rays.x + known * rays.dx)[front]
        slopes = np.stack([rays.dx[front], np.abs(rays.dy[front]), rays.dz[front]])
        more, label[front] = self._openings(x, z[front], slopes, chance[front])
        t[front] += more
        return t, label

    def _openings(self, x: F64, z: F64, slopes: F64, chance: F64) -> tuple[F64, U8]:
        """How much farther shots at the front get, and what they meet.

        Parameters
        ----------
        x, z, chance : (n,) float64
            Place on the front [m]; a uniform random number.
        slopes : (3, n) float64
            Direction along the street, into the house, up.

        Returns
        -------
        (n,) float64, (n,) uint8
            Way into the opening [m], 0 beside the openings; label, MISSING = swallowed.
        """
        dx, into, dz = slopes
        into = np.maximum(into, 1e-9)
        storey = np.floor((z - self.floor_z) / STOREY_M).astype(np.int64)
        v = z - self.floor_z - storey * STOREY_M
        column = np.floor((x - self.first_x) / self.pitch_m).astype(np.int64)
        u = x - self.first_x - (column + 0.5) * self.pitch_m
        ground = storey == 0
        door = ground & (column == self.door)
        low = np.where(door, 0.0, np.where(ground & self.shop, 0.5, 0.95))
        high = np.where(door, 2.2, np.where(ground & self.shop, 2.6, 2.5))
        half = np.where(door, 0.55, np.where(ground & self.shop, 0.42 * self.pitch_m, 0.6))
        inside = (v > low) & (v < high) & (np.abs(u) < half) & (column >= 0) & (column < self.columns)
        inside &= (storey >= 0) & (storey < self.storeys)
        # ways to the jamb, to lintel or sill, and to the pane
        to_jamb = np.where(dx > 0, half - u, half + u) / np.maximum(np.abs(dx), 1e-9)
        to_level = np.where(dz > 0, high - v, v - low) / np.maximum(np.abs(dz), 1e-9)
        to_pane = self.recess_m / into
        way = np.minimum(np.minimum(to_jamb, to_level), to_pane)
        label = np.where(to_level < np.minimum(to_jamb, to_pane), Label.HORIZONTAL, Label.VERTICAL).astype(np.uint8)
        pane = inside & (to_pane <= np.minimum(to_jamb, to_level)) & ~door
        # half of the panes swallow shots or mirror them away, a third hides a curtain, the others show the room
        state = lattice(self.seed, 7, storey, column)
        glass, room = pane & (state < 0.5), pane & (state >= 0.8)
        label[glass & (chance > 0.12)] = Label.MISSING
        curtain = pane & ~glass & ~room
        way = way + np.where(curtain, 0.08 / into, 0.0)
        label[curtain & (chance > 0.9)] = Label.MISSING
        to_wall = (self.recess_m + 1.0 + 15.0 * (state - 0.8)) / into
        to_ceiling = np.where(dz > 0, 2.7 - v, v) / np.maximum(np.abs(dz), 1e-9)
        way = np.where(room, np.minimum(to_wall, to_ceiling), way)
        label[room & (to_ceiling < to_wall)] = Label.HORIZONTAL
        label[room & (chance > 0.5)] = Label.MISSING
        return np.where(inside, way, 0.0), np.where(inside, label, Label.VERTICAL).astype(np.uint8)
