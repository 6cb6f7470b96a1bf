"""Where trees stand and how thick, tall and crooked they are."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields
from enum import IntEnum

import numpy as np

from prc_cli.core.types import F64, U8, Mask
from prc_cli.simulation.forest.chance import CELL_M, Purpose, generator
from prc_cli.simulation.forest.params import ForestSceneParams
from prc_cli.simulation.forest.path import Rows
from prc_cli.simulation.forest.terrain import Terrain

BREAST_HEIGHT_M = 1.3
_PACKING = 0.5
"""Share of the plane under the circles that hold no second stem."""
_THICKEST_M = 0.8


class Species(IntEnum):
    """Kinds of trees."""

    PINE = 0
    SPRUCE = 1
    BIRCH = 2


@dataclass(frozen=True, slots=True, eq=False)
class Stems:
    """Trees as a forester measures them."""

    base: F64
    """(n, 3) float64, centre of the stem at the ground [m]."""
    dbh: F64
    """(n,) float64, diameter at breast height, 1.3 m above the ground [m]."""
    height: F64
    """(n,) float64, of the tree [m]."""
    lean: F64
    """(n, 2) float64, what the stem moves along x and y per metre of height."""
    sweep: F64
    """(n, 2) float64, how far it bows out halfway up [m]."""
    species: U8
    """(n,) uint8, :class:`Species`."""

    @classmethod
    def join(cls, parts: list[Stems]) -> Stems:
        """Return the trees of several places as one."""
        none = cls(
            np.empty((0, 3)), np.empty(0), np.empty(0), np.empty((0, 2)), np.empty((0, 2)), np.empty(0, np.uint8)
        )
        return cls(*(np.concatenate([getattr(part, f.name) for part in [none, *parts]]) for f in fields(cls)))

    def take(self, which: Mask) -> Stems:
        """Return some of the trees; (n,) bool."""
        return Stems(*(getattr(self, f.name)[which] for f in fields(self)))

    def axis(self, above: F64) -> F64:
        """Return the centre of every stem at a height above its base."""
        bow = np.sin(np.pi * np.clip(above / self.height, 0.0, 1.0))
        xy = self.base[:, :2] + self.lean * above[:, None] + self.sweep * bow[:, None]
        return np.column_stack([xy, self.base[:, 2] + above])

    @property
    def breast(self) -> F64:
        """(n, 3) float64, where the diameter is measured [m]."""
        return self.axis(np.full(len(self), BREAST_HEIGHT_M))

    def rows(self) -> Iterator[str]:
        """Yield the trees as lines of CSV, the names of the columns first; x, y, z are those at breast height."""
        yield "species,x_m,y_m,z_m,dbh_m,height_m,lean_deg,lean_azimuth_deg"
        lean = np.degrees(np.arctan(np.hypot(*self.lean.T)))
        azimuth = np.degrees(np.arctan2(self.lean[:, 1], self.lean[:, 0]))
        for kind, (x, y, z), *rest in zip(self.species, self.breast, self.dbh, self.height, lean, azimuth, strict=True):
            dbh, height, leans, towards = rest
            yield (
                f"{Species(kind).name.lower()},{x:.3f},{y:.3f},{z:.3f},{dbh:.3f},{height:.2f},{leans:.2f},{towards:.1f}"
            )

    def __len__(self) -> int:
        return len(self.dbh)


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Places of a cell where a tree would stand if no neighbour were before it."""

    xy: F64
    """(n, 2) float64 [m]."""
    rank: F64
    """(n,) float64, 0 to 1; of two that are too close the lower one stands."""
    chance: F64
    """(n, 8) float64, uniform numbers for what the tree is like."""


class Stand:
    """Knows the trees of every cell.

    Stems keep apart as in Matérn's second hard-core process (Matérn 1960, ch. 3): of random places that are too close
    to each other, only the one of lowest rank is taken. That needs no order in which the forest is made.
    """

    def __init__(self, params: ForestSceneParams, seed: int, terrain: Terrain, rows: Rows) -> None:
        self._params, self._seed, self._terrain, self._rows = params, seed, terrain, rows
        wanted = params.stems_per_ha / 10_000
        self.apart_m = min(math.sqrt(_PACKING / (math.pi * wanted)), CELL_M / 2) if wanted else 0.0
        """No two stems are closer than this [m]."""
        circle = math.pi * self.apart_m**2
        self._tried = -math.log(1 - wanted * circle) / circle if wanted else 0.0
        shares = np.array([params.pine_share, params.spruce_share, params.birch_share])
        self._species_below = np.cumsum(shares / shares.sum())

    def candidates(self, i: int, j: int) -> Candidates:
        """Return the places of a cell, without those on the path."""
        chance = generator(self._seed, Purpose.CANDIDATES, i, j)
        n = chance.poisson(self._tried * CELL_M**2)
        numbers = chance.random((n, 11))
        xy = (numbers[:, :2] + (i, j)) * CELL_M
        return Candidates(xy, numbers[:, 2], numbers[:, 3:])

    def stems(self, own: Candidates, around: list[Candidates]) -> Stems:
        """Return the trees of a cell."""
        near = np.concatenate([c.xy for c in around])
        rank = np.concatenate([c.rank for c in around])
        close = np.hypot(*np.moveaxis(own.xy[:, None] - near, -1, 0)) < self.apart_m
        stands = ~(close & (rank < own.rank[:, None])).any(axis=1)
        trees = self._measure(own.xy[stands], own.chance[stands])
        # the widest part of the foot and the stem at the walker's height stay off the path
        clear = np.full(len(trees), np.inf)
        for above in (0.0, 1.0, 2.0):
            at = trees.axis(np.full(len(trees), above))
            clear = np.minimum(clear, self._rows.distance(at[:, 0], at[:, 1]))
        return trees.take(clear > self._params.clearance_m + 0.75 * trees.dbh)

    def _measure(self, xy: F64, chance: F64) -> Stems:
        params = self._params
        species = np.searchsorted(self._species_below, chance[:, 0], side="right").clip(max=2).astype(np.uint8)
        scale = (params.dbh_mean_m - params.dbh_min_m) / math.gamma(1 + 1 / params.dbh_shape)
        above_least = scale * (-np.log1p(-chance[:, 1])) ** (1 / params.dbh_shape)
        dbh = np.minimum(params.dbh_min_m + above_least, _THICKEST_M)
        # heights by Näslund's curve, h = 1.3 + d² / (a + b d)² (d in centimetres), give or take a tenth
        a = np.array([1.2, 1.7, 1.0])[species]
        b = np.array([0.195, 0.185, 0.185])[species]
        height = 1.3 + (100 * dbh / (a + b * 100 * dbh)) ** 2 * (0.9 + 0.2 * chance[:, 2])
        lean = math.tan(math.radians(params.lean_deg)) * _two_normals(chance[:, 3:5])
        sweep = params.sweep_m * _two_normals(chance[:, 5:7])
        base = np.column_stack([xy, self._terrain.height(xy[:, 0], xy[:, 1])])
        return Stems(base, dbh, height, lean, sweep, species)


def _two_normals(chance: F64) -> F64:
    """Turn pairs of uniform numbers into vectors whose length has the mean square 1 (Box and Muller 1958)."""
    length, angle = np.sqrt(-np.log1p(-chance[:, 0])), 2 * np.pi * chance[:, 1]
    vectors: F64 = length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return vectors
