"""The forest as a scene: bodies around a place, stems, and the way through it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from threading import RLock

import numpy as np

from prc_cli.core.types import F64
from prc_cli.simulation.forest.floor import Floor
from prc_cli.simulation.forest.params import ForestSceneParams
from prc_cli.simulation.forest.terrain import CELL_M, Purpose, Rows, Terrain, first_number, generator
from prc_cli.simulation.forest.trees import Stand, Stems, footprints, tree_bodies, triangles
from prc_cli.simulation.world import Bodies, Material

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
    """An endless forest of cells (:data:`prc_cli.simulation.world.BodiesNear`), each of own random numbers."""

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
        # threads ask for the same cells at the same time, and a cache alone would have each of them make its own
        self._lock = RLock()

    def bodies_near(self, x_m: float, y_m: float, radius_m: float, time_s: float = 0.0) -> Bodies:
        """Return the bodies whose circle on the map touches the one that is asked for; nothing moves in a forest."""
        # one thread makes all that are missing: taking turns at every cell costs more than waiting once
        with self._lock:
            cells = [self._cell(i, j) for i, j in _cells_near(x_m, y_m, radius_m + _OVERHANG_M)]
        parts = []
        for cell in cells:
            far = np.hypot(cell.centre[:, 0] - x_m, cell.centre[:, 1] - y_m)
            parts.append(cell.bodies.take(far <= radius_m + cell.reach))
        return Bodies.join(parts)

    def stems_near(self, x_m: float, y_m: float, radius_m: float) -> Stems:
        """Return the trees whose foot stands within a circle."""
        with self._lock:
            stems = Stems.join([self._stems(i, j) for i, j in _cells_near(x_m, y_m, radius_m)])
        return stems.take(np.hypot(stems.base[:, 0] - x_m, stems.base[:, 1] - y_m) <= radius_m)

    def path_point(self, s_m: F64) -> tuple[F64, F64]:
        """Return the ground under the walker and where he heads."""
        xy, heading = self.rows.point(np.asarray(s_m, dtype=np.float64))
        return np.column_stack([xy, self.terrain.level(xy[:, 0], xy[:, 1])]), heading

    def _make_stems(self, i: int, j: int) -> Stems:
        around = [self._candidates(i + di, j + dj) for di in (-1, 0, 1) for dj in (-1, 0, 1)]
        return self._stand.stems(around[4], around)

    def _make_cell(self, i: int, j: int) -> _Cell:
        stems = self._stems(i, j)
        to_path = self.rows.distance(stems.base[:, 0], stems.base[:, 1])
        bodies = Bodies.join(
            [
                triangles(self.terrain.triangles(i, j), Material.SOIL),
                tree_bodies(stems, to_path, self.params.leaf_density, generator(self._seed, Purpose.TREES, i, j)),
                self._floor.growth(i, j, generator(self._seed, Purpose.FLOOR, i, j)),
                self._floor.dead_wood(i, j, generator(self._seed, Purpose.DEAD_WOOD, i, j)),
            ]
        )
        numbers = first_number(self._seed, i, j) + np.arange(len(bodies), dtype=np.float64)
        bodies = replace(bodies, number=numbers)
        return _Cell(bodies, *footprints(bodies))


def _cells_near(x_m: float, y_m: float, radius_m: float) -> Iterator[tuple[int, int]]:
    """Yield the cells that a circle touches, in the order of their indices."""
    for i in range(math.floor((x_m - radius_m) / CELL_M), math.floor((x_m + radius_m) / CELL_M) + 1):
        for j in range(math.floor((y_m - radius_m) / CELL_M), math.floor((y_m + radius_m) / CELL_M) + 1):
            beside_x = max(i * CELL_M - x_m, x_m - (i + 1) * CELL_M, 0.0)
            beside_y = max(j * CELL_M - y_m, y_m - (j + 1) * CELL_M, 0.0)
            if math.hypot(beside_x, beside_y) <= radius_m:
                yield i, j
