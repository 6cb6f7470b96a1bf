"""Trees as bodies: stems of truncated cones, branches, crowns of leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F64
from prc_cli.simulation.forest.parts import cones, ellipsoids
from prc_cli.simulation.forest.stems import BREAST_HEIGHT_M, Species, Stems
from prc_cli.simulation.world import Bodies, Material

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


def tree_bodies(stems: Stems, to_path: F64, leaf_density: float, chance: np.random.Generator) -> Bodies:
    """Return trees: stems, branches dead and alive, and the leaves of their crowns."""
    parts = [_stem_bodies(stems)]
    for species, habit in _HABITS.items():
        of_it = stems.species == species
        parts.append(_crowns(stems.take(of_it), to_path[of_it], habit, leaf_density, chance))
    return Bodies.join(parts)


def _stem_bodies(stems: Stems) -> Bodies:
    """Return the stems: five truncated cones each, from below the ground to the top."""
    h = stems.height
    above = [np.full(len(stems), -0.3), np.full(len(stems), _FOOT_M), np.full(len(stems), BREAST_HEIGHT_M)]
    above += [np.maximum(0.35 * h, 2.0), np.maximum(0.7 * h, 3.0), h]
    radius = stems.dbh / 2
    # the foot swells; above breast height the stem tapers slowly, in the crown fast
    widths = [1.5 * radius, 1.12 * radius, radius]
    widths += [radius * ((h - up) / (h - BREAST_HEIGHT_M)).clip(0.0) ** 0.75 for up in above[3:5]]
    widths.append(np.full(len(stems), 0.01))
    axis = np.stack([stems.axis(up) for up in above], axis=1)
    width = np.stack(widths, axis=1)
    return cones(axis[:, :-1], axis[:, 1:], width[:, :-1], width[:, 1:], Material.STEM)


def _crowns(stems: Stems, to_path: F64, habit: _Habit, leaf_density: float, chance: np.random.Generator) -> Bodies:
    """Return branches and leaves of the trees of one species."""
    n = len(stems)
    radius = habit.crown_radius[0] + habit.crown_radius[1] * stems.dbh
    base = chance.uniform(*habit.crown_base, n) * stems.height
    over_path = to_path < radius * (1 + habit.scatter) + 0.5
    base = np.where(over_path, np.maximum(base, np.minimum(_HEADROOM_M, 0.8 * stems.height)), base)

    # tufts one above the other, the crown narrowing from one to the next
    length = stems.height - base
    level = (np.arange(habit.tufts) + 0.5) / habit.tufts
    # the lowest one is a little higher, so that it is not cut flat where the crown begins
    level[0] += 0.2 / habit.tufts
    narrowing = 1 - (1 - habit.tip) * level
    width = habit.tuft_radius * radius[:, None] * narrowing * chance.uniform(0.7, 1.0, (n, habit.tufts))
    centre = _on_axis(stems, base[:, None] + length[:, None] * level)
    aside = chance.uniform(-habit.scatter, habit.scatter, (n, habit.tufts, 2))
    centre[..., :2] += aside * radius[:, None, None] * narrowing[:, None]
    tall = np.broadcast_to(length[:, None] / habit.tufts * habit.tuft_height, width.shape)
    half = np.stack([width, width * chance.uniform(0.7, 1.0, width.shape), tall], axis=-1)
    # above the top is no leaf, and below the headroom none bars the path
    low, high = base[:, None] + stems.base[:, 2:], (stems.base[:, 2] + stems.height)[:, None] + 0.3
    half[..., 2] = np.minimum(half[..., 2], np.minimum(high - centre[..., 2], centre[..., 2] - low).clip(0.15))
    density = habit.leaf_density * leaf_density * chance.uniform(0.6, 1.4, (n, habit.tufts))
    leaves = ellipsoids(centre, half, chance.uniform(0, np.pi, (n, habit.tufts)), Material.LEAVES, density)

    live = _branches(
        stems, base[:, None] + length[:, None] * 0.7 * chance.random((n, habit.live)), radius, habit, chance
    )
    dead_from = np.where(to_path < 2.5, np.maximum(_HEADROOM_M, 0.9), 0.9)
    dead_to = np.maximum(base + 0.2 * length, dead_from + 1.0)
    heights = dead_from[:, None] + (dead_to - dead_from)[:, None] * chance.random((n, habit.dead))
    dead = _branches(stems, heights, None, habit, chance)
    return Bodies.join([leaves, live, dead])


def _branches(stems: Stems, above: F64, reach: F64 | None, habit: _Habit, chance: np.random.Generator) -> Bodies:
    """Return thin cones that leave the stems at some heights."""
    start = _on_axis(stems, above)
    azimuth = chance.uniform(0, 2 * np.pi, above.shape)
    rise = chance.uniform(*habit.rise, above.shape)
    if reach is None:
        length = chance.uniform(*habit.dead_length_m, above.shape)
    else:
        length = reach[:, None] * chance.uniform(0.5, 0.9, above.shape)
    towards = np.stack([np.cos(azimuth) * np.cos(rise), np.sin(azimuth) * np.cos(rise), np.sin(rise)], axis=-1)
    thick = 0.006 + 0.006 * length
    return cones(start, start + towards * length[..., None], thick, 0.4 * thick, Material.BRANCH)


def _on_axis(stems: Stems, above: F64) -> F64:
    """Return points of the stems at (n, k) heights as (n, k, 3)."""
    if above.shape[1] == 0:
        return np.empty((*above.shape, 3))
    return np.stack([stems.axis(column) for column in above.T], axis=1)
