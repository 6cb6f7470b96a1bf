"""Ground in forest: the lowest returns to the left and right of the scanner, a few lines at a time."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import F32
from prc_cli.methods.fused.plane import Plane
from prc_cli.methods.fused.thresholds import TerrainThresholds, typed


class TerrainParams(Params):
    """How the height of the ground is found (``[fused.forest.terrain]``)."""

    lines_together: int = Field(4, ge=1, le=1000, description="successive lines that share a profile of the ground")
    bin_m: float = Field(0.25, gt=0, le=10, description="width of a bin of the profile [m]")
    reach_m: float = Field(80.0, gt=0, le=1000, description="how far to either side the profile goes [m]")
    slope: float = Field(0.5, ge=0, le=10, description="greatest slope of the ground; higher bins are plants")
    near_m: float = Field(
        0.1,
        ge=0,
        le=10,
        description="ground returns differ from the previous return in the line by at most this [m] ...",
    )
    near_share: float = Field(0.05, ge=0, le=1, description="... plus this share of the range; the rest may be noise")

    def thresholds(self) -> TerrainThresholds:
        """Return the thresholds of the loop."""
        return typed(
            TerrainThresholds, bin_m=self.bin_m, slope=self.slope, near_m=self.near_m, near_share=self.near_share
        )


@stage("ground")
def heights_over_ground(range_m: F32, plane: Plane, params: TerrainParams) -> F32:
    """Return the height of every return above the ground.

    The ground height of a bin is its third-lowest return. Where plants hide the ground, the bin rises above its
    neighbours by more than the terrain slope allows; such bins are interpolated.

    ``range_m`` (lines, M) float32, metres; returns (lines, M) float32, metres.

    Flat ground 2 m below the scanner, and an object 1 m high on it:

    >>> beam = np.deg2rad(np.linspace(-60, 60, 241))
    >>> lines = np.tile(2 / np.cos(beam), (4, 1)).astype(np.float32)
    >>> lines[:, 120] = 1.0
    >>> heights = heights_over_ground(lines, Plane.of(beam), TerrainParams())
    >>> heights[0, [0, 120]].round(2) + 0.0
    array([0., 1.], dtype=float32)
    """
    n_bins = 2 * max(int(np.ceil(params.reach_m / params.bin_m)), 1)
    profiles = kernels.ground_profiles(
        range_m, plane.sine, plane.cosine, params.lines_together, n_bins, params.thresholds()
    )
    return kernels.ground_heights(range_m, plane.sine, plane.cosine, profiles, params.lines_together, params.bin_m)
