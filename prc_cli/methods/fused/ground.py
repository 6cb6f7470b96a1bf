"""Ground: followed outwards along every line, from level shot to level shot, with heights kept from earlier lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, I32, Mask
from prc_cli.methods.fused.neighbours import Neighbours
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.thresholds import WalkThresholds, typed

BINS = 320
"""Number of 0.25 m bins on either side for which a ground height is kept."""
NEVER = 1 << 20
"""Age of a bin that was never seen [lines]."""
DEPTHS = 1000
"""Depths below the scanner, 0.1 m apart, at which the ground is searched where none is known."""


class GroundParams(Params):
    """How the ground is followed (``[fused.ground]``)."""

    step_m: float = Field(
        0.14,
        ge=0,
        le=10,
        description="greatest step in height from one shot of the ground to the next, as at a curb [m]",
    )
    slope: float = Field(0.3, ge=0, le=10, description="added to the step per metre between the two shots ...")
    slope_reach_m: float = Field(0.5, ge=0, le=100, description="... up to this distance [m]")
    gap_slope: float = Field(0.08, ge=0, le=10, description="added to the step per metre of a gap, at any distance")
    known_m: float = Field(
        0.15, ge=0, le=10, description="shots this near to the ground height of earlier lines are ground too [m]"
    )
    memory_lines: int = Field(
        60, ge=0, le=100_000, description="lines for which the height of a place is kept; 0 = none"
    )
    follow: float = Field(0.4, gt=0, le=1, description="weight of a new height in the kept height of a place")
    walked_m: float = Field(
        0.3, ge=0, le=10, description="shots followed as ground are ground if this near to the ground profile [m]"
    )
    level_m: float = Field(
        0.12, ge=0, le=10, description="other shots, more level than upright, are ground if this near to it [m]"
    )
    soil_m: float = Field(
        0.06, ge=0, le=10, description="all shots that are not upright are ground if this near to it [m]"
    )
    below_m: float = Field(0.3, ge=0, le=1e9, description="rough shots farther below the ground are noise [m]")
    start_reach_m: float = Field(
        4.0,
        gt=0,
        le=100,
        description="without heights of earlier lines, start from the ground within this distance [m]",
    )

    def thresholds(self, least_near: int) -> WalkThresholds:
        """Return the thresholds of the loop; shots with fewer than ``least_near`` near neighbours do not count."""
        return typed(
            WalkThresholds,
            least_near=least_near,
            step_m=self.step_m,
            slope=self.slope,
            slope_reach_m=self.slope_reach_m,
            gap_slope=self.gap_slope,
            known_m=self.known_m,
            memory_lines=self.memory_lines,
            follow=self.follow,
            start_reach_m=self.start_reach_m,
        )


@dataclass(frozen=True, slots=True, eq=False)
class GroundMemory:
    """Ground heights from earlier lines."""

    height_m: F32
    """(2, BINS) float32, ground height by bin, left and right [m]."""
    age: I32
    """(2, BINS) int32, lines since the bin was last seen."""
    level_shots: F32
    """(2, DEPTHS) float32, level shots near the scanner and all, of the lines since any bin was known."""
    level_m: F32
    """(2, DEPTHS) float32, sums of their heights [m]."""
    start_m: np.float32
    """Height of the nearest known bins of earlier lines [m]: a walk starts there where its side is not known.

    Where the ground was hidden for long (by a lorry, or a gap in the stream), a walk from the scanner's height would
    not reach it in small steps."""
    lost: int
    """Lines with level shots since any bin was known; below 0 = none ever was."""

    @classmethod
    def none(cls) -> GroundMemory:
        """Return the memory before the first line."""
        return cls(
            np.zeros((2, BINS), np.float32), np.full((2, BINS), NEVER, np.int32),
            np.zeros((2, DEPTHS), np.float32), np.zeros((2, DEPTHS), np.float32), np.float32(0.0), -1,
        )  # fmt: skip


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
    seen: Neighbours,
    plane: ScanPlane,
    memory: GroundMemory,
    least_near: int,
    keep: int,
    params: GroundParams,
) -> tuple[Ground, GroundMemory]:
    """Find the ground of consecutive lines; see :func:`ground_loops.walk_ground`.

    ``range_m`` (lines, M) float32, metres.
    """
    above, walked, kept, start_m, lost = kernels.walk_ground(
        range_m, plane.beams, seen.counts, (plane.left, plane.right),
        (memory.height_m, memory.age, memory.level_shots, memory.level_m), np.float32(memory.start_m), memory.lost,
        keep, params.thresholds(least_near),
    )  # fmt: skip
    return Ground(above, walked), GroundMemory(*kept, np.float32(start_m), lost)
