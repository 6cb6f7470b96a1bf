"""People: legs, trunk, arms and head of rounded bodies."""

from __future__ import annotations

import numpy as np

from prc_cli.simulation.street.pile import Frame, Pile
from prc_cli.simulation.world import Material


def person(pile: Pile, frame: Frame, rng: np.random.Generator, stride: float) -> None:
    """Add somebody."""
    tall = rng.uniform(1.55, 1.9)
    hip = 0.50 * tall
    for side in (-1.0, 1.0):
        foot = frame.at(0.5 * side * stride, 0.10 * side, 0.0)
        pile.cone((foot, frame.at(0.0, 0.09 * side, hip)), (0.06, 0.09), Material.PERSON)
        hand = frame.at(-0.4 * side * stride, 0.29 * side, hip - 0.05)
        pile.cone((hand, frame.at(0.0, 0.21 * side, 0.81 * tall)), (0.04, 0.055), Material.PERSON)
    pile.ellipsoid(frame.at(0.0, 0.0, 0.67 * tall), (0.14, 0.21, 0.20 * tall), frame.yaw, Material.PERSON)
    pile.ellipsoid(frame.at(0.02, 0.0, 0.935 * tall), (0.10, 0.085, 0.065 * tall), frame.yaw, Material.PERSON)
