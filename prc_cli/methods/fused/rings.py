"""Fans of rings: what is different where lines turn about the scanner instead of moving on with it.

A profiler's shots lie close together, and its lines see one place after the other. The rings of a spinning scanner lie
decimetres apart, its lines look another way each, and see a wall only as high as the highest ring.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from prc_cli.core.config import Params
from prc_cli.core.types import F64
from prc_cli.methods.fused.classes import NO_BINS, CarParams, LeavesParams
from prc_cli.methods.fused.ground import GroundParams
from prc_cli.methods.fused.neighbours import SmoothnessParams
from prc_cli.methods.fused.strips import FlankParams, WallParams

WIDEST_FAN_RAD = math.radians(60)
"""Angle between the outermost rings of a spinning scanner, at most; 27 to 45 degrees are usual, profilers see 125 and
more."""


class RingsParams(Params):
    """What takes the place of other parameters for spinning scanners (``[fused.rings]``)."""

    enabled: bool = Field(
        True, description="whether fans of rings, narrower than 60 degrees, have parameters of their own"
    )
    memory_lines: int = Field(
        1, ge=0, le=100_000, description="for fused.ground.memory_lines: the next line looks at other ground"
    )
    step_m: float = Field(0.1, ge=0, le=10, description="for fused.ground.step_m [m]")
    gap_slope: float = Field(
        0.05, ge=0, le=10, description="for fused.ground.gap_slope: far rings are metres apart on the ground"
    )
    noise_sigmas: float = Field(1.5, ge=0, le=100, description="for fused.smoothness.noise_sigmas")
    per_step: float = Field(
        0.0, ge=0, le=10, description="for fused.smoothness.per_step: walls are straight however far rings are apart"
    )
    wall_m: float = Field(0.5, gt=0, le=1000, description="for fused.walls.height_m: the highest ring hardly rises [m]")
    storey_m: float = Field(
        0.0, ge=0, le=100, description="for fused.walls.storey_m: no wall is seen higher than the highest ring [m]"
    )
    flanks: bool = Field(
        False, description="whether surfaces with a gap beneath are vehicles: between rings there is always one"
    )
    leaf_share: float = Field(
        0.7, ge=0, le=1, description="for fused.leaves.share: with so few shots hedges look smooth"
    )
    leaf_share_before_walls: float = Field(0.1, ge=0, le=1, description="for fused.leaves.share_before_walls")
    leaves_at_depth: bool = Field(
        False, description="for fused.leaves.at_depth: so few shots are left that hedges look smooth"
    )
    cars: bool = Field(
        True, description="whether cars are found by lines across their roofs, instead of by level surfaces"
    )
    car_smooth: float = Field(
        0.3, ge=0, le=1, description="for fused.cars.roof_smooth: with so few shots cars look rough"
    )
    car_share: float = Field(0.3, ge=0, le=1, description="for fused.cars.roof_share")

    def ground(self, params: GroundParams) -> GroundParams:
        """Return the parameters of the ground for rings."""
        own = {"memory_lines": self.memory_lines, "step_m": self.step_m, "gap_slope": self.gap_slope}
        return params.model_copy(update=own)

    def smoothness(self, params: SmoothnessParams) -> SmoothnessParams:
        """Return the parameters of smoothness for rings."""
        return params.model_copy(update={"noise_sigmas": self.noise_sigmas, "per_step": self.per_step})

    def walls(self, params: WallParams) -> WallParams:
        """Return the parameters of walls for rings."""
        return params.model_copy(update={"height_m": self.wall_m, "storey_m": self.storey_m})

    def flank(self, params: FlankParams) -> FlankParams:
        """Return the parameters of vehicles' flanks for rings."""
        return params.model_copy(update={"enabled": params.enabled and self.flanks})

    def leaves(self, params: LeavesParams) -> LeavesParams:
        """Return the parameters of foliage for rings."""
        own = {"share": self.leaf_share, "share_before_walls": self.leaf_share_before_walls}
        return params.model_copy(update={**own, "at_depth": params.at_depth and self.leaves_at_depth})

    def car(self, params: CarParams) -> CarParams:
        """Return the parameters of cars for rings, found by lines across their roofs alone."""
        own = {"roofs": self.cars, "roof_step_deg": 0.0, "roof_smooth": self.car_smooth, "roof_share": self.car_share}
        return params.model_copy(update={**own, "level_bins": NO_BINS, "level_bins_rough": NO_BINS})


def is_fan(beam_rad: F64) -> bool:
    """Return whether beams, (M,) float64 [rad], are a fan of rings.

    >>> is_fan(np.deg2rad([65.0, 90.0, 92.0])), is_fan(np.deg2rad([-90.0, 0.0, 90.0]))
    (True, False)
    """
    return len(beam_rad) > 0 and bool(np.ptp(beam_rad) < WIDEST_FAN_RAD)
