"""Ground: followed outwards along every line, from level shot to level shot, with heights kept from earlier lines."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from prc_cli import kernels
from prc_cli.classifiers.fused.neighbours import Neighbours
from prc_cli.classifiers.fused.plane import ScanPlane, points_of
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.thresholds.fused import WalkThresholds, typed
from prc_cli.core.types import F32, I32, Mask

BINS = 320
"""Number of 0.25 m bins on either side for which a ground height is kept."""
NEVER = 1 << 20
"""Age of a bin that was never seen [lines]."""
DEEPEST_M = 100.0
"""Greatest height of a scanner above the ground [m]."""
HEIGHT_STEP_M = 0.1
"""Bin width of the histogram for the start height [m]."""


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
        )


@dataclass(frozen=True, slots=True, eq=False)
class GroundMemory:
    """Ground heights from earlier lines."""

    height_m: F32
    """(2, BINS) float32, ground height by bin, left and right [m]."""
    age: I32
    """(2, BINS) int32, lines since the bin was last seen."""

    @classmethod
    def none(cls) -> GroundMemory:
        """Return the memory before the first line."""
        return cls(np.zeros((2, BINS), np.float32), np.full((2, BINS), NEVER, np.int32))

    def nearest_m(self, lines: int) -> float | None:
        """Return the height of the bin nearest to the scanner that was seen within ``lines`` lines; None = no bin.

        On a side where the ground was hidden for longer (by a lorry, or a gap in the stream) the search starts at
        this height: starting at the scanner's height, it would not reach the ground in small steps.

        >>> GroundMemory.none().nearest_m(60) is None
        True
        """
        is_known = self.age < lines
        places, sides = np.nonzero(is_known.T)
        return float(self.height_m[sides[0], places[0]]) if len(places) else None


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
    """Find the ground of consecutive lines; see :func:`prc_cli.kernels.fused.ground.walk_ground`.

    Parameters
    ----------
    range_m : (lines, M) float32, metres
        NaN = missing.
    seen : Neighbours
    plane : ScanPlane
    memory : GroundMemory
        Before the first of these lines.
    least_near : int
        Shots with fewer near neighbours do not count.
    keep : int
        Line of the window before which the memory is returned, for the next block.
    params : GroundParams

    Returns
    -------
    Ground, GroundMemory
    """
    start_m = memory.nearest_m(params.memory_lines)
    if start_m is None:
        start_m = start_height(*points_of(range_m, plane), seen, params)
    above, walked, height_m, age = kernels.walk_ground(
        range_m, plane.beams, seen.counts, (plane.left, plane.right), memory.height_m, memory.age,
        np.float32(start_m), keep, params.thresholds(least_near),
    )  # fmt: skip
    return Ground(above, walked), GroundMemory(height_m, age)


def start_height(side_m: F32, height_m: F32, seen: Neighbours, params: GroundParams) -> float:
    """Return the ground height around the scanner: the lowest height with many smooth, level shots.

    "Many" is at least a quarter of the largest count at any height. Without smooth shots near and below the scanner,
    all shots below the scanner count; 0 without any.
    """
    low = (seen.smooth > 0) & (seen.level > seen.upright) & (height_m < 0) & (height_m > -DEEPEST_M)
    near = low & (np.abs(side_m) < params.start_reach_m)
    heights = height_m[near] if near.any() else height_m[low]
    if not len(heights):
        return 0.0
    counts = np.bincount((-heights / HEIGHT_STEP_M).astype(np.int64))
    steps = np.flatnonzero(counts >= counts.max() / 4)
    chosen = (-heights / HEIGHT_STEP_M).astype(np.int64) == steps[-1]
    return float(np.median(heights[chosen]))
