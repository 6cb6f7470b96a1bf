"""Objects above the ground in narrow strips beside the scanner: occupied heights, walls, low level surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.neighbours import Neighbours
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.thresholds import FlankThresholds, StripThresholds, WallThresholds, typed

NEVER_M = 1e9
"""Height that no wall reaches, for walls that are switched off [m]."""


class StripsParams(Params):
    """What counts in a strip (``[fused.strips]``)."""

    foot_m: float = Field(0.15, ge=0, le=10, description="lower shots above the ground are ignored [m]")
    rough: int = Field(2, ge=0, le=10, description="most smooth pairs, of 10, of a rough shot")
    smooth: int = Field(3, ge=0, le=11, description="fewest smooth pairs of a smooth shot")
    level_smooth: int = Field(
        6, ge=0, le=11, description="fewest smooth pairs on the level surface of a car; tops of hedges are rougher"
    )
    jump_m: float = Field(
        1.0, ge=0, le=100, description="a level surface continues to neighbouring shots within this distance [m]"
    )

    def thresholds(self, least_near: int, level_top_m: float) -> StripThresholds:
        """Return the thresholds of the loop; level surfaces above ``level_top_m`` [m] do not count."""
        return typed(
            StripThresholds,
            least_near=least_near,
            foot_m=self.foot_m,
            rough=self.rough,
            smooth=self.smooth,
            level_smooth=self.level_smooth,
            level_top_m=level_top_m,
            jump_m=self.jump_m,
        )


class WallParams(Params):
    """Walls, and returns from behind their windows (``[fused.walls]``)."""

    enabled: bool = Field(True, description="whether rough shots in walls and behind their windows are building")
    height_m: float = Field(
        1.5, gt=0, le=1000, description="least height of its smooth upright surface, mean of five lines [m]"
    )
    share: float = Field(0.3, ge=0, le=1, description="least share of that surface in everything in the strip")
    lines: int = Field(4, ge=0, le=5, description="lines, of five, that must see some of it; trunks are seen by fewer")
    front_m: float = Field(0.4, ge=0, le=10, description="shots up to this far in front of a wall are part of it [m]")
    behind_m: float = Field(1.0, ge=0, le=100, description="so are shots seen through it, up to this far behind [m]")
    over_m: float = Field(
        0.3, ge=0, le=10, description="lines of sight up to this far above its top count as through it [m]"
    )
    before_m: float = Field(
        2.0,
        ge=0,
        le=100,
        description="up to this far in front of a wall, foliage must be rougher, because of balconies [m]",
    )
    roofs: bool = Field(True, description="whether walls above the scanner go on upwards, with roofs behind")
    roof_m: float = Field(
        6.0, ge=0, le=100, description="foliage must be as rough up to this far behind a wall as before it [m] ..."
    )
    storey_m: float = Field(
        2.5, ge=0, le=100, description="... if the wall is this high; lower ones are garden walls [m]"
    )

    def thresholds(self) -> WallThresholds:
        """Return the thresholds of the loop."""
        return typed(
            WallThresholds,
            height_m=self.height_m if self.enabled else NEVER_M,
            share=self.share,
            lines=self.lines,
            before_m=self.before_m,
        )


class FlankParams(Params):
    """Flanks of vehicles, which are no walls: ground is seen beneath them (``[fused.flanks]``)."""

    enabled: bool = Field(True, description="whether upright surfaces with ground beneath them are cars")
    least_m: float = Field(
        0.1, gt=0, le=100, description="least height of their smooth upright surface, mean of five lines [m]"
    )
    most_m: float = Field(3.0, gt=0, le=100, description="greatest height of that [m]")
    share: float = Field(0.3, ge=0, le=1, description="least share of that surface in everything in the strip")
    low_m: float = Field(
        0.1,
        ge=0,
        le=10,
        description="ground is beneath where the line of sight to it passes the flank above this [m] ...",
    )
    sill_m: float = Field(0.5, ge=0, le=10, description="... and below this [m]")
    body_m: float = Field(
        0.7,
        ge=0,
        le=10,
        description="up to this [m] ground is seen through it, as through a fence, and it is no vehicle",
    )
    lorries: bool = Field(True, description="whether bodies may hang higher, where nothing at all is below them ...")
    large_m: float = Field(1.5, ge=0, le=100, description="... if they are this high themselves [m] ...")
    high_m: float = Field(1.5, ge=0, le=10, description="... up to this height of their bottom [m]")
    soil_m: float = Field(0.1, gt=0, le=10, description="shots this near to the ground are ground beneath [m]")
    shots: int = Field(3, ge=1, le=1000, description="least number of such shots in five lines")

    def thresholds(self) -> FlankThresholds:
        """Return the thresholds of the loop."""
        return typed(
            FlankThresholds,
            least_m=self.least_m,
            most_m=self.most_m,
            share=self.share,
            low_m=self.low_m,
            sill_m=self.sill_m,
            body_m=self.body_m,
            large_m=self.large_m,
            high_m=self.high_m if self.lorries else -1.0,
            soil_m=self.soil_m,
            shots=self.shots,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """Objects above the ground beside the lines of a block."""

    slots: tuple[NDArray[np.uint64], NDArray[np.uint64]]
    """(lines, strips) uint64, occupied heights by all shots and by rough shots, one bit per 0.25 m."""
    walls: tuple[F32, F32, F32]
    """(lines, strips) float32, distance and top of the wall in or before a strip; distance of the wall in or behind."""
    levels: U8
    """(lines, 2 strips) uint8, 1 = a low level surface."""


@stage("strips")
def stand(
    range_m: F32,
    above_m: F32,
    seen: Neighbours,
    plane: ScanPlane,
    strips: StripThresholds,
    walls: WallParams,
    flanks: FlankParams,
) -> Standing:
    """Sort shots above the ground into strips, and combine five lines.

    ``range_m, above_m`` (lines + 4, M) float32, metres.
    """
    every, rough, length, wall, place, top, levels = kernels.fill_strips(
        range_m, above_m, seen.counts, plane.beams, plane.step_rad, strips
    )
    wide = kernels.widen_levels(levels)
    vehicles = np.zeros((len(wide), every.shape[1]), np.uint8)
    if flanks.enabled:
        vehicles, wide = kernels.find_flanks(
            range_m, above_m, seen.upright, plane.beams, (length, wall, place), every, wide, flanks.thresholds()
        )
    found = kernels.find_walls((length, wall, place, top), vehicles, walls.thresholds())
    return Standing((kernels.widen_slots(every), kernels.widen_slots(rough)), found, wide)
