"""Trees and bushes of streets and gardens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.simulation.street.pile import Frame, Pile, Span
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
    """Add a tree."""
    bole, radius, crown, trunk, density = (
        float(rng.uniform(*span))
        for span in (kind.bole, kind.radius, kind.crown, kind.trunk, kind.density)
    )
    radius = min(radius, widest)
    lean = rng.uniform(-0.03, 0.03, 2).tolist()
    top = bole + 0.75 * crown
    middle = bole + 0.5 * crown
    foot = frame.point(0.0, 0.0, -0.2)
    fork = frame.point(lean[0] * bole, lean[1] * bole, bole)
    tip = frame.point(lean[0] * top, lean[1] * top, top)
    pile.cone((foot, fork), (1.15 * trunk, 0.8 * trunk), Material.TRUNK)
    pile.cone((fork, tip), (0.8 * trunk, 0.15 * trunk), Material.BRANCH)
    centre = frame.point(lean[0] * middle, lean[1] * middle, middle)
    pile.ellipsoid(
        centre, (0.68 * radius, 0.68 * radius, 0.5 * crown), 0.0, Material.LEAVES, density
    )
    turn = rng.uniform(0.0, 2.0 * np.pi)
    for i in range(kind.balls):
        around = turn + i * 2.0 * np.pi / kind.balls + rng.uniform(-0.3, 0.3)
        # balls climb around the trunk: the lower ones are wider
        up = bole + crown * (0.28 + 0.42 * ((i * 2) % kind.balls) / max(kind.balls - 1, 1))
        size = radius * rng.uniform(0.42, 0.56)
        away = radius - size
        u = away * np.cos(around)
        v = away * np.sin(around)
        ball = frame.point(u, v, up)
        tall = max(min(size * rng.uniform(0.8, 1.2), up - bole + 0.3), 0.4)
        pile.ellipsoid(ball, (size, size, tall), 0.0, Material.LEAVES, density)
        if i < 4:
            low = frame.point(0.0, 0.0, bole + 0.15 * i * (up - bole))
            pile.cone(
                (low, frame.point(0.9 * u, 0.9 * v, up)),
                (0.35 * trunk, 0.1 * trunk),
                Material.BRANCH,
            )


def bush(
    pile: Pile,
    frame: Frame,
    radius: float,
    rng: np.random.Generator,
) -> None:
    """Add a round bush; leaf area density about 4 m²/m³."""
    tall = radius * rng.uniform(0.7, 1.1)
    half = (radius, radius * rng.uniform(0.7, 1.0), tall)
    pile.ellipsoid(
        frame.point(0.0, 0.0, 0.7 * tall),
        half,
        rng.uniform(0, np.pi),
        Material.LEAVES,
        rng.uniform(3.0, 5.0),
    )
