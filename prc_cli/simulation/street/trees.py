"""Trees and bushes of streets and gardens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.simulation.street.pile import Frame, Pile, Point, Span
from prc_cli.simulation.world import Material


@dataclass(frozen=True, slots=True)
class TreeKind:
    """A kind of tree, as ranges."""

    bole: Span
    """Height of the lowest branches [m]."""
    radius: Span
    """Of the crown [m]."""
    crown: Span
    """Height of the crown [m]."""
    trunk: Span
    """Radius of the trunk at its foot [m]."""
    density: Span
    """Leaf area density [m²/m³]; street and garden trees in leaf have 0.3 to 2."""
    balls: int
    """Parts of the crown around its middle."""


STREET = TreeKind((2.8, 4.0), (1.7, 2.6), (4.0, 7.0), (0.10, 0.22), (0.6, 1.4), 5)
AVENUE = TreeKind((4.0, 5.5), (2.4, 3.2), (6.0, 10.0), (0.18, 0.35), (0.5, 1.0), 6)
CANOPY = TreeKind((3.5, 5.0), (4.2, 5.5), (5.0, 8.0), (0.18, 0.35), (0.6, 1.2), 6)
GARDEN = TreeKind((1.2, 2.2), (1.2, 2.2), (2.5, 5.0), (0.06, 0.14), (0.7, 2.0), 4)
BIRCH = TreeKind((2.2, 3.2), (1.2, 1.7), (5.0, 8.0), (0.07, 0.13), (0.3, 0.6), 4)


def tree(
    pile: Pile,
    frame: Frame,
    kind: TreeKind,
    rng: np.random.Generator,
    widest: float = 9.0,
) -> None:
    """Add a tree, its crown no wider than ``widest`` in radius [m]."""
    bole = float(rng.uniform(*kind.bole))
    radius = min(float(rng.uniform(*kind.radius)), widest)
    crown = float(rng.uniform(*kind.crown))
    trunk = float(rng.uniform(*kind.trunk))
    density = float(rng.uniform(*kind.density))
    lean_u, lean_v = rng.uniform(-0.03, 0.03, 2).tolist()

    def on_axis(height: float) -> Point:
        return frame.point(lean_u * height, lean_v * height, height)

    foot = frame.point(0.0, 0.0, -0.2)
    fork = on_axis(bole)
    tip = on_axis(bole + 0.75 * crown)
    pile.cone(foot, fork, (1.15 * trunk, 0.8 * trunk), Material.TRUNK)
    pile.cone(fork, tip, (0.8 * trunk, 0.15 * trunk), Material.BRANCH)
    inner = (0.68 * radius, 0.68 * radius, 0.5 * crown)
    pile.ellipsoid(on_axis(bole + 0.5 * crown), inner, 0.0, Material.LEAVES, density)

    # balls around the trunk climb: the lower ones are wider
    turn = rng.uniform(0.0, 2.0 * np.pi)
    for i in range(kind.balls):
        around = turn + i * 2.0 * np.pi / kind.balls + rng.uniform(-0.3, 0.3)
        n_lower = (i * 2) % kind.balls
        up = bole + crown * (0.28 + 0.42 * n_lower / max(kind.balls - 1, 1))
        size = radius * rng.uniform(0.42, 0.56)
        away = radius - size
        u = away * np.cos(around)
        v = away * np.sin(around)
        tall = max(min(size * rng.uniform(0.8, 1.2), up - bole + 0.3), 0.4)
        pile.ellipsoid(frame.point(u, v, up), (size, size, tall), 0.0, Material.LEAVES, density)
        if i < 4:
            start = frame.point(0.0, 0.0, bole + 0.15 * i * (up - bole))
            end = frame.point(0.9 * u, 0.9 * v, up)
            pile.cone(start, end, (0.35 * trunk, 0.1 * trunk), Material.BRANCH)


def bush(
    pile: Pile,
    frame: Frame,
    radius: float,
    rng: np.random.Generator,
) -> None:
    """Add a round bush; leaf area density about 4 m²/m³."""
    tall = radius * rng.uniform(0.7, 1.1)
    half = (radius, radius * rng.uniform(0.7, 1.0), tall)
    yaw = rng.uniform(0, np.pi)
    density = rng.uniform(3.0, 5.0)
    pile.ellipsoid(frame.point(0.0, 0.0, 0.7 * tall), half, yaw, Material.LEAVES, density)
