"""Trees: their places and measures, and the bodies of stems, branches and crowns."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from enum import IntEnum

import numpy as np

from prc_cli.core.types import F64, U8, Mask
from prc_cli.simulation.forest.params import ForestSceneParams
from prc_cli.simulation.forest.terrain import CELL_M, Purpose, Rows, Terrain, generator
from prc_cli.simulation.world import Bodies, Material, Shape


def triangles(corners: F64, material: Material) -> Bodies:
    """Return triangles."""
    return _bodies(Shape.TRIANGLE, corners.reshape(-1, 9), material)


def cones(
    low: F64,
    high: F64,
    low_radius: F64,
    high_radius: F64,
    material: Material,
) -> Bodies:
    """Return truncated cones."""
    radii = np.stack([low_radius, high_radius, np.zeros_like(low_radius)], axis=-1)
    return _bodies(Shape.CONE, np.concatenate([low, high, radii], axis=-1).reshape(-1, 9), material)


def ellipsoids(
    centre: F64,
    half: F64,
    yaw: F64,
    material: Material,
    density: F64 | float = 0.0,
) -> Bodies:
    """Return ellipsoids, solid or filled with leaves."""
    turn = np.stack([yaw, np.zeros_like(yaw), np.zeros_like(yaw)], axis=-1)
    bodies = _bodies(
        Shape.ELLIPSOID, np.concatenate([centre, half, turn], axis=-1).reshape(-1, 9), material
    )
    return replace(bodies, density=np.broadcast_to(density, yaw.shape).astype(np.float64).ravel())


def _bodies(shape: Shape, numbers: F64, material: Material) -> Bodies:
    n = len(numbers)
    return Bodies(
        shape=np.full(n, shape, dtype=np.uint8),
        numbers=np.ascontiguousarray(numbers),
        material=np.full(n, material, dtype=np.uint8),
        density=np.zeros(n),
        velocity=np.zeros((n, 2)),
        number=np.zeros(n),
    )


def footprints(bodies: Bodies) -> tuple[F64, F64]:
    """Return a circle on the map around every body: centres (n, 2) and radii (n,) [m]."""
    numbers = bodies.numbers
    corners = numbers.reshape(-1, 3, 3)[:, :, :2]
    centre = numbers[:, :2].copy()
    reach = numbers[:, 3:5].max(axis=1, initial=0.0)

    is_triangle = bodies.shape == Shape.TRIANGLE
    triangle = corners[is_triangle]
    centre[is_triangle] = triangle.mean(axis=1)
    from_centre = triangle - centre[is_triangle, None]
    away = np.hypot(from_centre[..., 0], from_centre[..., 1])
    reach[is_triangle] = away.max(axis=1, initial=0.0)

    is_cone = bodies.shape == Shape.CONE
    cone = corners[is_cone]
    centre[is_cone] = cone[:, :2].mean(axis=1)
    axis = cone[:, 1] - cone[:, 0]
    half_length = np.hypot(axis[:, 0], axis[:, 1]) / 2
    reach[is_cone] = half_length + numbers[is_cone, 6:8].max(axis=1, initial=0.0)

    is_box = bodies.shape == Shape.BOX
    reach[is_box] = np.hypot(numbers[is_box, 3], numbers[is_box, 4])
    return centre, reach


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
            np.empty((0, 3)),
            np.empty(0),
            np.empty(0),
            np.empty((0, 2)),
            np.empty((0, 2)),
            np.empty(0, np.uint8),
        )
        columns = ([getattr(part, field.name) for part in [none, *parts]] for field in fields(cls))
        return cls(*map(np.concatenate, columns))

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
        """Yield the trees as lines of CSV, names of columns first; x, y, z at breast height."""
        yield "species,x_m,y_m,z_m,dbh_m,height_m,lean_deg,lean_azimuth_deg"
        lean = np.degrees(np.arctan(np.hypot(*self.lean.T)))
        azimuth = np.degrees(np.arctan2(self.lean[:, 1], self.lean[:, 0]))
        breast = self.breast
        for i, species in enumerate(self.species):
            x, y, z = breast[i]
            yield (
                f"{Species(species).name.lower()},{x:.3f},{y:.3f},{z:.3f},{self.dbh[i]:.3f},"
                f"{self.height[i]:.2f},{lean[i]:.2f},{azimuth[i]:.1f}"
            )

    def __len__(self) -> int:
        return len(self.dbh)


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Places of a cell for trees, before the ones too close to a neighbour are dropped."""

    xy: F64
    """(n, 2) float64 [m]."""
    rank: F64
    """(n,) float64, 0 to 1; of two places that are too close the lower one is kept."""
    chance: F64
    """(n, 8) float64, uniform random numbers for the measures of the tree."""


class Stand:
    """Trees by cell; they keep apart by Matérn's second hard-core process (1960, ch. 3)."""

    def __init__(
        self,
        params: ForestSceneParams,
        seed: int,
        terrain: Terrain,
        rows: Rows,
    ) -> None:
        self._params = params
        self._seed = seed
        self._terrain = terrain
        self._rows = rows
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

    def stems(self, cell: Candidates, around: list[Candidates]) -> Stems:
        """Return the trees of a cell."""
        near = np.concatenate([c.xy for c in around])
        rank = np.concatenate([c.rank for c in around])
        close = np.hypot(*np.moveaxis(cell.xy[:, None] - near, -1, 0)) < self.apart_m
        is_kept = ~(close & (rank < cell.rank[:, None])).any(axis=1)
        trees = self._measure(cell.xy[is_kept], cell.chance[is_kept])
        # the widest part of the foot and the stem at the walker's height stay off the path
        to_path = np.full(len(trees), np.inf)
        for above in (0.0, 1.0, 2.0):
            axis = trees.axis(np.full(len(trees), above))
            to_path = np.minimum(to_path, self._rows.distance(axis[:, 0], axis[:, 1]))
        return trees.take(to_path > self._params.clearance_m + 0.75 * trees.dbh)

    def _measure(self, xy: F64, chance: F64) -> Stems:
        params = self._params
        kind = np.searchsorted(self._species_below, chance[:, 0], side="right")
        species = kind.clip(max=2).astype(np.uint8)
        # diameters by Weibull's distribution
        scale = (params.dbh_mean_m - params.dbh_min_m) / math.gamma(1 + 1 / params.dbh_shape)
        above_least = scale * (-np.log1p(-chance[:, 1])) ** (1 / params.dbh_shape)
        dbh = np.minimum(params.dbh_min_m + above_least, _THICKEST_M)
        # heights by Näslund's curve, h = 1.3 + d² / (a + b d)² (d in centimetres), give or take a
        # tenth
        a = np.array([1.2, 1.7, 1.0])[species]
        b = np.array([0.195, 0.185, 0.185])[species]
        above_breast = (100 * dbh / (a + b * 100 * dbh)) ** 2
        height = 1.3 + above_breast * (0.9 + 0.2 * chance[:, 2])
        return Stems(
            base=np.column_stack([xy, self._terrain.height(xy[:, 0], xy[:, 1])]),
            dbh=dbh,
            height=height,
            lean=math.tan(math.radians(params.lean_deg)) * _two_normals(chance[:, 3:5]),
            sweep=params.sweep_m * _two_normals(chance[:, 5:7]),
            species=species,
        )


def _two_normals(chance: F64) -> F64:
    """Return vectors of normal numbers, mean square length 1 (Box and Muller 1958), (n, 2)."""
    length = np.sqrt(-np.log1p(-chance[:, 0]))
    angle = 2 * np.pi * chance[:, 1]
    vectors: F64 = length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return vectors


_FOOT_M = 0.35
"""Height up to which roots widen a stem [m]."""
_HEADROOM_M = 3.3
"""Where a crown would hang over the path, it begins above this [m]."""


@dataclass(frozen=True, slots=True)
class _Habit:
    """How a species grows; pairs are the least and the most."""

    crown_base: tuple[float, float]
    """Where the crown begins, share of the height."""
    crown_radius: tuple[float, float]
    """Half width of the crown: at no diameter [m], growth per metre of diameter."""
    tufts: int
    """Ellipsoids of leaves, one above the other."""
    tuft_radius: float
    """Half width of a tuft over that of the crown."""
    tuft_height: float
    """Half height of a tuft over the distance to the next."""
    leaf_density: float
    """Leaf area per volume of the tufts [m²/m³]."""
    tip: float
    """Width of the crown's top, share of its foot."""
    scatter: float
    """How far tufts lie off the stem, share of the crown's radius."""
    dead: int
    """Dead branches below the crown."""
    dead_length_m: tuple[float, float]
    live: int
    """Branches in the crown."""
    rise: tuple[float, float]
    """Of branches towards their ends [rad]."""


_HABITS = {
    Species.PINE: _Habit(
        crown_base=(0.5, 0.7),
        crown_radius=(0.5, 6.0),
        tufts=6,
        tuft_radius=0.55,
        tuft_height=0.9,
        leaf_density=1.1,
        tip=0.7,
        scatter=0.6,
        dead=3,
        dead_length_m=(0.3, 1.2),
        live=4,
        rise=(-0.1, 0.6),
    ),
    Species.SPRUCE: _Habit(
        crown_base=(0.08, 0.3),
        crown_radius=(0.5, 5.0),
        tufts=5,
        tuft_radius=1.0,
        tuft_height=1.0,
        leaf_density=1.1,
        tip=0.12,
        scatter=0.05,
        dead=5,
        dead_length_m=(0.5, 1.6),
        live=3,
        rise=(-0.4, 0.0),
    ),
    Species.BIRCH: _Habit(
        crown_base=(0.3, 0.55),
        crown_radius=(0.5, 5.5),
        tufts=5,
        tuft_radius=0.65,
        tuft_height=0.9,
        leaf_density=0.7,
        tip=0.5,
        scatter=0.45,
        dead=1,
        dead_length_m=(0.3, 0.8),
        live=4,
        rise=(0.4, 1.0),
    ),
}


def tree_bodies(
    stems: Stems,
    to_path: F64,
    leaf_density: float,
    chance: np.random.Generator,
) -> Bodies:
    """Return trees: stems, branches dead and alive, and the leaves of their crowns."""
    parts = [_stem_bodies(stems)]
    for species, habit in _HABITS.items():
        of_it = stems.species == species
        parts.append(_crowns(stems.take(of_it), to_path[of_it], habit, leaf_density, chance))
    return Bodies.join(parts)


def _stem_bodies(stems: Stems) -> Bodies:
    """Return the stems: five truncated cones each, from below the ground to the top."""
    n = len(stems)
    height = stems.height
    radius = stems.dbh / 2

    def tapered(above: F64) -> F64:
        share = (height - above) / (height - BREAST_HEIGHT_M)
        width: F64 = radius * share.clip(0.0) ** 0.75
        return width

    # the foot swells; above breast height the stem tapers slowly, in the crown fast
    trunk_top = np.maximum(0.35 * height, 2.0)
    crown_middle = np.maximum(0.7 * height, 3.0)
    nodes = (
        (np.full(n, -0.3), 1.5 * radius),
        (np.full(n, _FOOT_M), 1.12 * radius),
        (np.full(n, BREAST_HEIGHT_M), radius),
        (trunk_top, tapered(trunk_top)),
        (crown_middle, tapered(crown_middle)),
        (height, np.full(n, 0.01)),
    )
    axis = np.stack([stems.axis(above) for above, _ in nodes], axis=1)
    width = np.stack([width for _, width in nodes], axis=1)
    return cones(axis[:, :-1], axis[:, 1:], width[:, :-1], width[:, 1:], Material.STEM)


def _crowns(
    stems: Stems,
    to_path: F64,
    habit: _Habit,
    leaf_density: float,
    chance: np.random.Generator,
) -> Bodies:
    """Return branches and leaves of the trees of one species."""
    n = len(stems)
    radius = habit.crown_radius[0] + habit.crown_radius[1] * stems.dbh
    base = chance.uniform(*habit.crown_base, n) * stems.height
    over_path = to_path < radius * (1 + habit.scatter) + 0.5
    headroom = np.minimum(_HEADROOM_M, 0.8 * stems.height)
    base = np.where(over_path, np.maximum(base, headroom), base)

    # tufts one above the other, the crown narrowing from one to the next
    length = stems.height - base
    level = (np.arange(habit.tufts) + 0.5) / habit.tufts
    # the lowest one is a little higher, so that it is not cut flat where the crown begins
    level[0] += 0.2 / habit.tufts
    narrowing = 1 - (1 - habit.tip) * level
    width = habit.tuft_radius * radius[:, None] * narrowing
    width = width * chance.uniform(0.7, 1.0, (n, habit.tufts))
    centre = _on_axis(stems, base[:, None] + length[:, None] * level)
    aside = chance.uniform(-habit.scatter, habit.scatter, (n, habit.tufts, 2))
    centre[..., :2] += aside * radius[:, None, None] * narrowing[:, None]
    depth = width * chance.uniform(0.7, 1.0, width.shape)
    # above the top is no leaf, and below the headroom none bars the path
    tall = np.broadcast_to(length[:, None] / habit.tufts * habit.tuft_height, width.shape)
    low = base[:, None] + stems.base[:, 2:]
    high = (stems.base[:, 2] + stems.height)[:, None] + 0.3
    room = np.minimum(high - centre[..., 2], centre[..., 2] - low).clip(0.15)
    half = np.stack([width, depth, np.minimum(tall, room)], axis=-1)
    density = habit.leaf_density * leaf_density * chance.uniform(0.6, 1.4, (n, habit.tufts))
    yaw = chance.uniform(0, np.pi, (n, habit.tufts))
    leaves = ellipsoids(centre, half, yaw, Material.LEAVES, density)

    live_heights = base[:, None] + length[:, None] * 0.7 * chance.random((n, habit.live))
    live = _branches(stems, live_heights, radius, habit, chance)
    dead_from = np.where(to_path < 2.5, np.maximum(_HEADROOM_M, 0.9), 0.9)
    dead_to = np.maximum(base + 0.2 * length, dead_from + 1.0)
    dead_span = (dead_to - dead_from)[:, None]
    dead_heights = dead_from[:, None] + dead_span * chance.random((n, habit.dead))
    dead = _branches(stems, dead_heights, None, habit, chance)
    return Bodies.join([leaves, live, dead])


def _branches(
    stems: Stems,
    above: F64,
    reach: F64 | None,
    habit: _Habit,
    chance: np.random.Generator,
) -> Bodies:
    """Return thin cones that leave the stems at heights (n, k) above their feet.

    ``reach``: how far the crown reaches (n,), None for dead branches [m].
    """
    start = _on_axis(stems, above)
    azimuth = chance.uniform(0, 2 * np.pi, above.shape)
    rise = chance.uniform(*habit.rise, above.shape)
    if reach is None:
        length = chance.uniform(*habit.dead_length_m, above.shape)
    else:
        length = reach[:, None] * chance.uniform(0.5, 0.9, above.shape)
    x = np.cos(azimuth) * np.cos(rise)
    y = np.sin(azimuth) * np.cos(rise)
    direction = np.stack([x, y, np.sin(rise)], axis=-1)
    end = start + direction * length[..., None]
    thick = 0.006 + 0.006 * length
    return cones(start, end, thick, 0.4 * thick, Material.BRANCH)


def _on_axis(stems: Stems, above: F64) -> F64:
    """Return points of the stems at (n, k) heights as (n, k, 3)."""
    if above.shape[1] == 0:
        return np.empty((*above.shape, 3))
    return np.stack([stems.axis(column) for column in above.T], axis=1)
