"""The forest as a scene: bodies around a place, stems, and the way through it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from threading import RLock

import numpy as np

from prc_cli.core.types import F64, Mask
from prc_cli.simulation.forest.params import ForestSceneParams
from prc_cli.simulation.forest.terrain import (
    CELL_M,
    Purpose,
    Rows,
    Terrain,
    first_number,
    generator,
)
from prc_cli.simulation.forest.trees import (
    Stand,
    Stems,
    cones,
    ellipsoids,
    footprints,
    tree_bodies,
    triangles,
)
from prc_cli.simulation.world import Bodies, Material

_ELBOW_M = 0.35
"""What is higher than the knee stays this far off the path [m]."""


class Floor:
    """Makes the floor of a cell."""

    def __init__(self, params: ForestSceneParams, terrain: Terrain, rows: Rows) -> None:
        self._params = params
        self._terrain = terrain
        self._rows = rows

    def growth(self, i: int, j: int, chance: np.random.Generator) -> Bodies:
        """Return what grows in a cell."""
        parts = [self._mounds(i, j, chance)]
        parts.append(self._herbs(Material.GRASS, i, j, chance))
        parts.append(self._herbs(Material.UNDERGROWTH, i, j, chance))
        parts.append(self._shrubs(i, j, chance))
        parts.append(self._saplings(i, j, chance))
        return Bodies.join(parts)

    def dead_wood(self, i: int, j: int, chance: np.random.Generator) -> Bodies:
        """Return logs and stumps of a cell."""
        logs = self._logs(i, j, chance)
        return Bodies.join([logs, self._stumps(i, j, chance)])

    def _places(
        self,
        per_ha: float,
        i: int,
        j: int,
        chance: np.random.Generator,
    ) -> F64:
        """Return random points on the ground of a cell, (n, 3)."""
        n = chance.poisson(per_ha / 10_000 * CELL_M**2)
        return self._on_ground((chance.random((n, 2)) + np.array([i, j])) * CELL_M)

    def _on_ground(self, xy: F64) -> F64:
        """Return points on the ground (n, 3) at places (n, 2) [m]."""
        return np.column_stack([xy, self._terrain.height(xy[:, 0], xy[:, 1])])

    def _off_path(self, places: F64, reach: F64) -> Mask:
        """Return which places leave the path free with all that is around them; (n,) bool."""
        distance = self._rows.distance(places[:, 0], places[:, 1])
        return np.asarray(distance > reach + _ELBOW_M)

    def _mounds(self, i: int, j: int, chance: np.random.Generator) -> Bodies:
        """Return mounds and boulders, sunk into the ground."""
        centre = self._places(self._params.mounds_per_ha, i, j, chance)
        n = len(centre)
        half_x = chance.uniform(0.3, 1.3, n)
        half_y = chance.uniform(0.3, 1.0, n)
        half_z = chance.uniform(0.15, 0.5, n)
        centre[:, 2] -= 0.25 * half_z
        half = np.column_stack([half_x, half_y, half_z])
        return ellipsoids(centre, half, chance.uniform(0, np.pi, n), Material.SOIL)

    def _herbs(self, material: Material, i: int, j: int, chance: np.random.Generator) -> Bodies:
        """Return moss and grass, which are ground, or dwarf shrubs, which are not."""
        herbs_per_ha = self._params.herbs_per_ha
        if material == Material.GRASS:
            centre = self._places(0.35 * herbs_per_ha, i, j, chance)
            heights_m = (0.05, 0.15)
            density = 8.0
        else:
            centre = self._places(0.65 * herbs_per_ha, i, j, chance)
            heights_m = (0.12, 0.4)
            density = 3.5
        n = len(centre)
        half_xy = chance.uniform(0.4, 1.4, (n, 2))
        half = np.column_stack([half_xy, chance.uniform(*heights_m, n)])
        leaves = density * self._params.leaf_density * chance.uniform(0.6, 1.4, n)
        return ellipsoids(centre, half, chance.uniform(0, np.pi, n), material, leaves)

    def _shrubs(self, i: int, j: int, chance: np.random.Generator) -> Bodies:
        """Return shrubs of two tufts each."""
        place = self._places(self._params.shrubs_per_ha, i, j, chance)
        width, tall = chance.uniform(0.3, 1.0, (2, len(place)))
        tall = 0.4 + 1.6 * tall * width
        # a lower, wider tuft and a higher one, apart
        centre = np.repeat(place[:, None], 2, axis=1)
        apart = chance.uniform(-0.6, 0.6, centre[..., :2].shape)
        centre[..., :2] += apart * width[:, None, None]
        centre[..., 2] += tall[:, None] * (0.35, 0.65)
        half_x = width[:, None] * (1.0, 0.7)
        half_y = width[:, None] * (0.8, 0.6)
        half_z = tall[:, None] * (0.4, 0.35)
        half = np.stack([half_x, half_y, half_z], axis=-1)
        density = 1.6 * self._params.leaf_density * chance.uniform(0.5, 1.5, half.shape[:2])
        yaw = chance.uniform(0, np.pi, half.shape[:2])
        kept = self._off_path(place, 1.6 * width)
        return ellipsoids(centre[kept], half[kept], yaw[kept], Material.UNDERGROWTH, density[kept])

    def _saplings(self, i: int, j: int, chance: np.random.Generator) -> Bodies:
        """Return young spruces: a thin stem and three tufts, one narrower than the other."""
        place = self._places(self._params.saplings_per_ha, i, j, chance)
        n = len(place)
        tall = 0.6 + 4.4 * chance.random(n) ** 2
        width = 0.15 + tall * chance.uniform(0.12, 0.25, n)
        density = 2.0 * self._params.leaf_density * chance.uniform(0.6, 1.4, (n, 3))
        kept = self._off_path(place, width)
        place = place[kept]
        tall = tall[kept]
        width = width[kept]
        up = np.zeros_like(place)
        up[:, 2] = tall
        radius = 0.004 + 0.008 * tall
        stems = cones(place, place + up, radius, 0.2 * radius, Material.UNDERGROWTH)
        heights = np.array([0.25, 0.52, 0.8])[:, None]
        centre = place[:, None] + up[:, None] * heights
        half_xy = width[:, None] * (1.0, 0.7, 0.35)
        half_z = tall[:, None] * (0.2, 0.2, 0.2)
        half = np.stack([half_xy, half_xy, half_z], axis=-1)
        yaw = np.zeros(half.shape[:2])
        tufts = ellipsoids(centre, half, yaw, Material.UNDERGROWTH, density[kept])
        return Bodies.join([stems, tufts])

    def _logs(self, i: int, j: int, chance: np.random.Generator) -> Bodies:
        """Return dead stems and branches on the ground, in two pieces each that follow it."""
        middle = self._places(self._params.logs_per_ha, i, j, chance)
        n = len(middle)
        length = 1.0 + 5.0 * chance.random(n) ** 2
        thick = chance.uniform(0.02, 0.03, n) * length
        azimuth = chance.uniform(0, 2 * np.pi, n)
        half = length[:, None] / 2 * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
        start = self._on_ground(middle[:, :2] - half)
        end = self._on_ground(middle[:, :2] + half)
        # a log bridges a hollow
        middle[:, 2] = np.maximum(middle[:, 2], (start[:, 2] + end[:, 2]) / 2)
        for node in (start, middle, end):
            node[:, 2] += 0.8 * thick
        first = cones(start, middle, thick, 0.8 * thick, Material.DEAD_WOOD)
        second = cones(middle, end, 0.8 * thick, 0.6 * thick, Material.DEAD_WOOD)
        return Bodies.join([first, second])

    def _stumps(self, i: int, j: int, chance: np.random.Generator) -> Bodies:
        """Return stumps with their cut faces."""
        place = self._places(self._params.stumps_per_ha, i, j, chance)
        n = len(place)
        radius = chance.uniform(0.08, 0.22, n)
        tall = chance.uniform(0.15, 0.5, n)
        kept = self._off_path(place, radius)
        radius = radius[kept]
        foot = place[kept]
        top = place[kept]
        foot[:, 2] -= 0.15
        top[:, 2] += tall[kept]
        sides = cones(foot, top, 1.25 * radius, radius, Material.DEAD_WOOD)
        half = np.column_stack([radius, radius, np.full(len(radius), 0.02)])
        faces = ellipsoids(top, half, np.zeros(len(radius)), Material.DEAD_WOOD)
        return Bodies.join([sides, faces])


_OVERHANG_M = 6.0
"""No body reaches farther out of its cell than this [m]."""
_CELLS_KEPT = 400
_STEM_CELLS_KEPT = 4096
"""Stems are light, and stray points ask for those of all that a scanner reaches."""


@dataclass(frozen=True, slots=True, eq=False)
class _Cell:
    bodies: Bodies
    centre: F64
    """(n, 2) float64, of the circle on the map around every body [m]."""
    reach: F64
    """(n,) float64, its radius [m]."""


class ForestScene:
    """An endless forest of cells, see :data:`prc_cli.simulation.world.BodiesNear`."""

    def __init__(self, params: ForestSceneParams, seed: int) -> None:
        self.params = params
        self.terrain = Terrain(seed, params.slope_deg, params.incline_deg, params.ground_step_m)
        self.rows = Rows(params, seed)
        self._seed = seed
        self._stand = Stand(params, seed, self.terrain, self.rows)
        self._floor = Floor(params, self.terrain, self.rows)
        self._candidates = lru_cache(_STEM_CELLS_KEPT)(self._stand.candidates)
        self._stems = lru_cache(_STEM_CELLS_KEPT)(self._make_stems)
        self._cell = lru_cache(_CELLS_KEPT)(self._make_cell)
        # a cache alone would let every thread make the same cells
        self._lock = RLock()

    def bodies_near(
        self,
        x_m: float,
        y_m: float,
        radius_m: float,
        time_s: float = 0.0,
    ) -> Bodies:
        """Return the bodies whose circle on the map touches a circle; nothing moves in a forest."""
        # one thread makes all missing cells: turns at every cell cost more than one wait
        with self._lock:
            cells = [self._cell(i, j) for i, j in _cells_near(x_m, y_m, radius_m + _OVERHANG_M)]
        parts = []
        for cell in cells:
            far = np.hypot(cell.centre[:, 0] - x_m, cell.centre[:, 1] - y_m)
            parts.append(cell.bodies.take(far <= radius_m + cell.reach))
        return Bodies.join(parts)

    def stems_near(self, x_m: float, y_m: float, radius_m: float) -> Stems:
        """Return the trees with their foot within a circle."""
        with self._lock:
            stems = Stems.join([self._stems(i, j) for i, j in _cells_near(x_m, y_m, radius_m)])
        return stems.take(np.hypot(stems.base[:, 0] - x_m, stems.base[:, 1] - y_m) <= radius_m)

    def path_point(self, s_m: F64) -> tuple[F64, F64]:
        """Return the ground under the walker, (n, 3) [m], and the heading, (n,) [rad]."""
        xy, heading = self.rows.point(np.asarray(s_m, dtype=np.float64))
        return np.column_stack([xy, self.terrain.level(xy[:, 0], xy[:, 1])]), heading

    def _make_stems(self, i: int, j: int) -> Stems:
        around = [self._candidates(i + di, j + dj) for di in (-1, 0, 1) for dj in (-1, 0, 1)]
        return self._stand.stems(around[4], around)

    def _make_cell(self, i: int, j: int) -> _Cell:
        stems = self._stems(i, j)
        to_path = self.rows.distance(stems.base[:, 0], stems.base[:, 1])
        tree_chance = generator(self._seed, Purpose.TREES, i, j)
        floor_chance = generator(self._seed, Purpose.FLOOR, i, j)
        wood_chance = generator(self._seed, Purpose.DEAD_WOOD, i, j)
        bodies = Bodies.join(
            [
                triangles(self.terrain.triangles(i, j), Material.SOIL),
                tree_bodies(stems, to_path, self.params.leaf_density, tree_chance),
                self._floor.growth(i, j, floor_chance),
                self._floor.dead_wood(i, j, wood_chance),
            ]
        )
        numbers = first_number(self._seed, i, j) + np.arange(len(bodies), dtype=np.float64)
        return _Cell(replace(bodies, number=numbers), *footprints(bodies))


def _cells_near(x_m: float, y_m: float, radius_m: float) -> Iterator[tuple[int, int]]:
    """Yield the cells that a circle touches, in the order of their indices."""
    first_i = math.floor((x_m - radius_m) / CELL_M)
    last_i = math.floor((x_m + radius_m) / CELL_M)
    first_j = math.floor((y_m - radius_m) / CELL_M)
    last_j = math.floor((y_m + radius_m) / CELL_M)
    for i in range(first_i, last_i + 1):
        beside_x = max(i * CELL_M - x_m, x_m - (i + 1) * CELL_M, 0.0)
        for j in range(first_j, last_j + 1):
            beside_y = max(j * CELL_M - y_m, y_m - (j + 1) * CELL_M, 0.0)
            if math.hypot(beside_x, beside_y) <= radius_m:
                yield i, j
