"""Follow the ground outwards along every line, with heights kept from earlier lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.profile import stage
from prc_cli.core.types import F32, I32, Mask
from prc_cli.methods.fused.ground_loops import BINS, DEPTHS, walk_ground
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.records import Neighbours, WalkMemory
from prc_cli.methods.fused.thresholds import WalkThresholds

NEVER = 1 << 20
"""Age of a bin that was never seen [lines]."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundMemory:
    """Ground heights from earlier lines."""

    height_m: F32
    """(2, BINS) float32, ground height by bin, left and right [m]."""
    age: I32
    """(2, BINS) int32, lines since the bin was last seen."""
    level_shots: F32
    """(2, DEPTHS) float32, level shots near the scanner, and all, since a bin was known."""
    level_m: F32
    """(2, DEPTHS) float32, sums of their heights [m]."""
    start_m: np.float32
    """Height of the nearest known bins of earlier lines [m].

    a walk starts there where its side is not known.

    Where the ground was hidden for long (by a lorry, or a gap in the stream), a walk from the
    scanner's height would not reach it in small steps."""
    lost: int
    """Lines with level shots since any bin was known; below 0 = none ever was."""
    missed: int
    """Lines in a row in which level shots near the scanner lie below the known ground."""

    @classmethod
    def none(cls) -> GroundMemory:
        """Return the memory before the first line."""
        return cls(
            np.zeros((2, BINS), np.float32),
            np.full((2, BINS), NEVER, np.int32),
            np.zeros((2, DEPTHS), np.float32),
            np.zeros((2, DEPTHS), np.float32),
            np.float32(0.0),
            -1,
            0,
        )


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
    above, walked, kept, start_m, lost, missed = walk_ground(
        range_m,
        plane.beams,
        neighbours,
        plane.sides,
        WalkMemory(memory.height_m, memory.age, memory.level_shots, memory.level_m),
        np.float32(memory.start_m),
        memory.lost,
        memory.missed,
        keep,
        limits,
    )
    return Ground(above, walked), GroundMemory(*kept, np.float32(start_m), lost, missed)
