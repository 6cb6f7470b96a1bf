"""The street of the static scan: what stands where, laid out once from a seed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.simulation.furniture import Body, Post
from prc_cli.simulation.rays import TINY, Bounds, Hits, Rays
from prc_cli.simulation.static_bodies import STOREY_M, Foliage, House, Railing, Slab
from prc_cli.simulation.static_cars import car
from prc_cli.simulation.static_params import StaticScanParams

ROAD_HALF_M = 5.5
"""Crown of the road to the curb [m]: a lane of 3.3 m and 2.2 m for parking."""
SIDEWALK_M = 3.6
"""Curb to the building line [m]."""
BUILDING_LINE_M = ROAD_HALF_M + SIDEWALK_M
_SIDEWALK_FALL = 0.02
_AHEAD_M = 1000.0
"""The ground goes on this far to the sides [m]."""


@dataclass(frozen=True, slots=True)
class Ground:
    """Profile across the street, the same along all of it."""

    crossfall: float
    """Of the road, down from the crown [m/m]."""
    curb_m: float
    """Height of the curbs [m]."""

    @property
    def gutter_z(self) -> float:
        """Road at the foot of the curb [m]."""
        return -self.crossfall * ROAD_HALF_M

    def z(self, y: float) -> float:
        """Height of road or sidewalk at a place across the street [m]."""
        if abs(y) <= ROAD_HALF_M:
            return -self.crossfall * abs(y)
        return self.gutter_z + self.curb_m + _SIDEWALK_FALL * (abs(y) - ROAD_HALF_M)

    def cast(self, rays: Rays, hits: Hits) -> None:
        """Let rays meet road, curbs and sidewalks.

        Parameters
        ----------
        rays : Rays
            Shots of (lines, M).
        hits : Hits
            Nearest surfaces; filled in place.
        """
        top = self.gutter_z + self.curb_m
        for side in (1.0, -1.0):
            # upright face of the curb: seen from its road side only
            t = (side * ROAD_HALF_M - rays.y) / np.where(np.abs(rays.dy) < TINY, TINY, rays.dy)
            z = rays.z + t * rays.dz
            on_curb = (t > 0) & (z > self.gutter_z) & (z < top) & (side * rays.y < ROAD_HALF_M)
            hits.take_nearer(np.where(on_curb, t, np.inf), Label.CURB)
            for low, high, slope, label in (
                (0.0, ROAD_HALF_M, -self.crossfall, Label.GROUND),
                (ROAD_HALF_M, _AHEAD_M, _SIDEWALK_FALL, Label.HORIZONTAL),
            ):
                # z = at the inner end + slope * (distance from the crown - inner end)
                start = self.z(low) if label is Label.GROUND else top
                facing = (side * slope * rays.dy - rays.dz) / np.hypot(1.0, slope)
                drop = rays.z - (start + slope * (side * rays.y - low))
                t = drop / np.hypot(1.0, slope) / np.where(facing > 0, facing, np.nan)
                y = side * (rays.y + t * rays.dy)
                hits.take_nearer(np.where((y >= low) & (y <= high), t, np.inf), label, facing)


@dataclass(frozen=True, slots=True)
class Street:
    """Ground and bodies of one street."""

    ground: Ground
    bodies: tuple[Body, ...]
    passing: tuple[tuple[float, Body], ...]
    """Speed along the street [m/s] and body where it is at time 0."""


def lay_out(params: StaticScanParams) -> Street:
    """Lay out a street from a seed.

    Parameters
    ----------
    params : StaticScanParams
        Seed, length, where the scanner stands (nothing else stands within a metre of it), leaves, passing cars.
    """
    rng = np.random.Generator(np.random.Philox(key=params.seed, counter=[1, 0, 0, 0]))
    ground = Ground(rng.uniform(0.02, 0.03), rng.uniform(0.12, 0.15))
    maker = _Maker(rng, ground, params)
    bodies = [body for side in (1, -1) for body in maker.side(side)]
    near = [body for body in bodies if _clear(body.bounds, params.across_m)]
    return Street(ground, tuple(near), tuple(maker.passing()))


@dataclass(frozen=True, slots=True)
class _Maker:
    """Makes bodies from one stream of random numbers, always in the same order."""

    rng: np.random.Generator
    ground: Ground
    params: StaticScanParams

    def side(self, side: int) -> Iterator[Body]:
        half = self.params.length_m / 2
        x = -half
        terrace = self.rng.random() < 0.7
        while x < half:
            if self.rng.random() < 0.12:
                width = self.rng.uniform(8.0, 16.0)
                yield from self.gap(side, x, width)
            else:
                width = self.rng.uniform(7.0, 20.0)
                yield from self.house(side, x, width, setback=0.0 if terrace else self.rng.choice([0.0, 1.5, 3.0]))
            x += width
        yield from self.parked(side, -half, half)
        yield from self.kerbside(side, -half, half)

    def parked(self, side: int, low: float, high: float) -> Iterator[Body]:
        """Cars along the curb, bumper to bumper, with bays left free."""
        x = low + self.rng.uniform(0.0, 4.0)
        while x < high - 6.0:
            half = self.rng.uniform(2.45, 2.6) if self.rng.random() < 0.12 else self.rng.uniform(1.85, 2.4)
            y = ROAD_HALF_M - self.rng.uniform(0.15, 0.4) - (0.97 if half >= 2.45 else 0.88)
            heading = side if self.rng.random() < 0.1 else -side
            if self.rng.random() < 0.78:
                yield from car(self.rng, (x + half, side * y, self.ground.z(y)), heading, half)
            x += 2 * half + self.rng.uniform(0.6, 1.4)

    def kerbside(self, side: int, low: float, high: float) -> Iterator[Body]:
        """Trees, lamps, signs, bins and planters on the sidewalk."""
        x = low + self.rng.uniform(0.0, 8.0)
        place = side * (ROAD_HALF_M + 0.7)
        leafy = self.rng.uniform(0.4, 0.9)
        number = 0
        while x < high:
            z = self.ground.z(place)
            if self.rng.random() < leafy:
                yield from self.tree(x, place, z)
            if number % 3 == 0:
                lamp = x + 3.5
                yield Post(lamp, place, 0.08, (z, z + 7.0), Label.VERTICAL)
                arm = sorted((place, place - side * 1.2))
                yield _upright((lamp - 0.05, lamp + 0.05), (arm[0], arm[1]), (z + 6.9, z + 7.0))
            else:
                yield Post(x + 3.5, place, 0.03, (z, z + 2.9), Label.VERTICAL)
                yield _upright((x + 3.48, x + 3.5), (place - 0.3, place + 0.3), (z + 2.2, z + 2.8))
            if self.rng.random() < 0.3:
                yield Post(x + 5.0, place, 0.25, (z, z + 0.95), Label.VERTICAL)
            if self.rng.random() < 0.35:
                yield self.bush(x + 2.0, side * (BUILDING_LINE_M - 0.7), self.rng.uniform(0.4, 0.8))
            x += self.rng.uniform(7.5, 10.5)
            number += 1

    def tree(self, x: float, y: float, z: float) -> Iterator[Body]:
        """Trunk, and a crown of one large and four smaller overlapping balls of leaves."""
        base = z + self.rng.uniform(2.8, 4.0)
        radius, tall = self.rng.uniform(1.7, 3.0), self.rng.uniform(2.0, 3.4)
        thick = self.rng.uniform(0.09, 0.24)
        yield Post(x, y, thick, (z, base + 0.3), Label.VERTICAL)
        yield Post(x, y, 0.7 * thick, (base + 0.3, base + tall), Label.VEGETATION)
        # leaf area density 1.1 to 2 m2/m3, leaves facing every way
        free_path = 1.0 / (0.5 * self.rng.uniform(1.1, 2.0))
        yield self.leaves((x, y, base + tall), (0.85 * radius, 0.85 * radius, tall), free_path)
        turn = self.rng.uniform(0.0, 2.0 * np.pi)
        for i in range(4):
            around = turn + i * np.pi / 2
            place = (
                x + 0.6 * radius * np.cos(around),
                y + 0.6 * radius * np.sin(around),
                base + tall * (0.7 + 0.2 * i),
            )
            yield self.leaves(place, (0.6 * radius, 0.6 * radius, 0.55 * tall), free_path)

    def bush(self, x: float, y: float, radius: float) -> Body:
        """Round bush in a planter or bed; leaf area density about 8 m2/m3."""
        z = self.ground.z(y) + 0.8 * radius
        return self.leaves((x, y, z), (radius * 1.2, min(radius, 0.6), radius), 0.25)

    def leaves(self, centre: tuple[float, float, float], radii: tuple[float, float, float], path: float) -> Foliage:
        (x, y, z), (rx, ry, rz) = centre, radii
        bounds = Bounds((x - rx, x + rx), (y - ry, y + ry), (z - rz, z + rz))
        return Foliage(bounds, path, self.params.leaf_m, self.params.seed)

    def house(self, side: int, x: float, width: float, *, setback: float) -> Iterator[Body]:
        """House with ledges, perhaps a step at the door, balconies, or a hedge in front."""
        rng = self.rng
        storeys = int(rng.integers(3, 7))
        face = BUILDING_LINE_M + setback + (rng.choice([0.0, 0.0, 0.15, 0.3]) if not setback else 0.0)
        floor = self.ground.z(face) + rng.choice([0.0, 0.15, 0.45])
        top = floor + STOREY_M * storeys + rng.uniform(0.6, 1.2)
        deep = sorted((side * face, side * (face + 12.0)))
        house = House(
            Bounds((x, x + width), (deep[0], deep[1]), (-2.0, top)),
            side,
            storeys,
            floor,
            rng.uniform(2.2, 3.2),
            rng.uniform(0.1, 0.25),
            bool(rng.random() < 0.35 and not setback),
            int(rng.integers(2**31)),
        )
        yield house

        def out(along: tuple[float, float], by: float, z: tuple[float, float]) -> Bounds:
            y = sorted((side * face, side * (face - by)))
            return Bounds(along, (y[0], y[1]), z)

        yield Slab(out((x, x + width), rng.uniform(0.2, 0.5), (top - 0.35, top - 0.1)))
        if rng.random() < 0.6:
            line = floor + STOREY_M - 0.35
            yield Slab(out((x, x + width), 0.1, (line, line + 0.15)))
        if floor > self.ground.z(face) + 0.05:
            middle = house.first_x + (house.door + 0.5) * house.pitch_m
            yield Slab(out((middle - 0.8, middle + 0.8), 0.5, (-1.0, floor)))
        if rng.random() < 0.4:
            for storey in range(1, storeys):
                for column in range(int(rng.integers(2)), house.columns, 2):
                    middle = house.first_x + (column + 0.5) * house.pitch_m
                    z = floor + storey * STOREY_M
                    along = (middle - 1.0, middle + 1.0)
                    yield Slab(out(along, 1.1, (z - 0.12, z + 0.04)))
                    y = side * (face - 1.1)
                    yield Railing(Bounds(along, (y - 0.02, y + 0.02), (z + 0.04, z + 1.0)), 0.35)
        if setback:
            yield self.hedge(side, (x, x + width * 0.7))

    def gap(self, side: int, x: float, width: float) -> Iterator[Body]:
        """Yard between houses: hedge or wall in front, trees and bushes, perhaps a house behind."""
        if self.rng.random() < 0.6:
            yield self.hedge(side, (x, x + width))
        else:
            y = sorted((side * BUILDING_LINE_M, side * (BUILDING_LINE_M + 0.25)))
            yield Slab(Bounds((x, x + width * 0.6), (y[0], y[1]), (-1.0, self.rng.uniform(0.8, 2.0))))
        y0 = side * (BUILDING_LINE_M + 5.0)
        yield from self.tree(x + width * self.rng.uniform(0.3, 0.7), y0, self.ground.z(y0))
        yield self.bush(x + 2.0, side * (BUILDING_LINE_M + 2.5), self.rng.uniform(0.6, 1.2))
        if self.rng.random() < 0.6:
            far = self.rng.uniform(18.0, 30.0)
            y = sorted((side * (BUILDING_LINE_M + far), side * (BUILDING_LINE_M + far + 10.0)))
            yield _upright((x - 6.0, x + width + 6.0), (y[0], y[1]), (-2.0, self.rng.uniform(6.0, 14.0)))

    def hedge(self, side: int, along: tuple[float, float]) -> Body:
        """Clipped hedge behind the sidewalk; leaf area density about 10 m2/m3."""
        y = sorted((side * (BUILDING_LINE_M + 0.1), side * (BUILDING_LINE_M + 0.8)))
        high = self.ground.z(BUILDING_LINE_M) + self.rng.uniform(0.9, 1.9)
        return Foliage(Bounds(along, (y[0], y[1]), (-0.2, high)), 0.2, self.params.leaf_m, self.params.seed, box=True)

    def passing(self) -> Iterator[tuple[float, Body]]:
        """Cars in the lane that the scanner does not stand in; they are in the street while the head turns."""
        params = self.params
        side = -1.0 if params.across_m > 0 else 1.0
        duration = params.n_lines * params.points_per_line / params.shots_hz
        for _ in range(params.moving_cars):
            speed = side * -self.rng.uniform(6.0, 10.0)
            when = self.rng.uniform(0.0, duration)
            y = side * 1.7
            for body in car(self.rng, (-speed * when, y, self.ground.z(y)), -int(side), self.rng.uniform(1.9, 2.4)):
                yield speed, body


def _upright(x: tuple[float, float], y: tuple[float, float], z: tuple[float, float]) -> Slab:
    return Slab(Bounds(x, y, z))


def _clear(bounds: Bounds, across_m: float) -> bool:
    """Whether a body leaves the scanner its metre, and room overhead."""
    away_x = max(bounds.x[0], -bounds.x[1], 0.0)
    away_y = max(bounds.y[0] - across_m, across_m - bounds.y[1], 0.0)
    return bool(np.hypot(away_x, away_y) > 1.0 or bounds.z[0] > 2.6)
