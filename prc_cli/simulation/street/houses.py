"""Houses."""

from __future__ import annotations

import numpy as np

from prc_cli.simulation.street.pile import Frame, Pile
from prc_cli.simulation.street.plan import BUILDING_LINE_M, Lot, Plan, Purpose, Side, generator
from prc_cli.simulation.street.road import Ground
from prc_cli.simulation.world import Material


def frame_at(ground: Ground, s: float, d: float, mirror: int = 1) -> Frame:
    """Return an upright frame on the ground with u along the street."""
    x, y = ground.line.place(np.array([s]), np.array([d]))[0].tolist()
    return Frame(x, y, ground.height(s, d), float(ground.line.heading(np.array([s]))[0]), mirror=mirror)


def build_houses(pile: Pile, ground: Ground, plan: Plan, seed: int) -> None:
    """Add the houses of a piece."""
    for side in plan.sides:
        rng = generator(seed, Purpose.HOUSES, plan.piece, side.side)
        for lot in side.lots:
            _build(pile, ground, side, lot, rng)


def _build(pile: Pile, ground: Ground, side: Side, lot: Lot, rng: np.random.Generator) -> None:
    if lot.kind == "yard":
        return
    width = lot.span[1] - lot.span[0]
    frame = frame_at(ground, sum(lot.span) / 2, side.side * (BUILDING_LINE_M + lot.setback), side.side)
    pile.box(frame, ((-width / 2, width / 2), (0, 11), (-1.5, 3.1 * rng.integers(2, 6))), Material.WALL)
