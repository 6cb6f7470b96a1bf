"""Follow the ground outwards along every line, with heights kept from earlier lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.profile import stage
from prc_cli.core.types import F32, Mask
from prc_cli.methods.fused.ground_loops import BINS, DEPTHS, walk_ground
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.records import GroundMemory, Neighbours, WalkMemory, WalkStart
from prc_cli.methods.fused.thresholds import WalkThresholds

NEVER = 1 << 20
"""Age of a bin that was never seen [lines]."""


def no_memory() -> GroundMemory:
    """Return the memory before the first line."""
    bins = WalkMemory(
        np.zeros((2, BINS), np.float32),
        np.full((2, BINS), NEVER, np.int32),
        np.zeros((2, DEPTHS), np.float32),
        np.zeros((2, DEPTHS), np.float32),
    )
    return GroundMemory(bins, WalkStart(0.0, -1, 0))


@dataclass(frozen=True, slots=True, eq=False)
class Ground:
    """Ground of the lines of a window."""

    above_m: F32
    """(lines, M) float32, height of every shot above it [m]; NaN = missing."""
    walked: Mask
    """(lines, M) bool, shots that were followed as ground."""


@stage("ground")
def follow_ground(
    range_m: F32,
    neighbours: Neighbours,
    plane: ScanPlane,
    memory: GroundMemory,
    keep: int,
    limits: WalkThresholds,
) -> tuple[Ground, GroundMemory]:
    """Find the ground of consecutive lines; see :func:`ground_loops.walk_ground`.

    ``range_m`` (lines, M) float32, metres.
    """
    above_m, walked, after = walk_ground(
        range_m, plane.beams, neighbours, plane.sides, memory, keep, limits
    )
    return Ground(above_m, walked), after
