"""Classes in forest, in the scan plane: ground, stems, other vegetation, noise.

Needs the ranges, as PRC does (Lehtola et al. 2019), and the vertical direction in the scan plane; no pose. Blocks are
independent: the ground is estimated anew every few lines, and a few lines are enough to find a stem.
"""

from __future__ import annotations

import math

import numpy as np
from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8, Mask
from prc_cli.methods.fused.plane import Plane
from prc_cli.methods.fused.stems import StemsParams, find_stems
from prc_cli.methods.fused.terrain import TerrainParams, heights_over_ground
from prc_cli.methods.fused.thresholds import ForestThresholds, typed

LEAST_COLUMNS, MOST_COLUMNS = 2, 8
"""Limits of the columns searched for near shots on either side; more would be slow."""


class FlatParams(Params):
    """Flat places, where the ground may lie higher above its profile (``[fused.forest.flat]``)."""

    enabled: bool = Field(True, description="whether flat places are ground up to a greater height")
    cover_m: float = Field(0.15, ge=0, le=10, description="height over the ground up to which flat places are ground")
    step_m: float = Field(
        0.04, ge=0, le=10, description="greatest step in height to both neighbours of a shot on a flat place [m] ..."
    )
    noise_sigmas: float = Field(
        3.0, ge=0, le=100, description="... or so many standard deviations of the range noise, if more"
    )


class TouchingParams(Params):
    """Single shots of a stem between leaves and at its edges (``[fused.forest.touching]``)."""

    enabled: bool = Field(True, description="whether a shot beside a stem's is of the stem where it is as far")
    range_m: float = Field(0.05, ge=0, le=10, description="greatest difference in range to the stem shot [m]")


class IsolationParams(Params):
    """Isolated shots are noise (``[fused.forest.company]``)."""

    enabled: bool = Field(True, description="whether isolated shots are noise")
    range_m: float = Field(
        0.3, ge=0, le=100, description="a shot is isolated without another one within this range difference [m] ..."
    )
    angle_deg: float = Field(
        0.3, ge=0, le=90, description="... and this angle along the line on either side [degrees], 2 to 8 columns"
    )


class ForestParams(Params):
    """The forest, in the scan plane (``[fused.forest]``)."""

    soil_m: float = Field(
        0.04, ge=0, le=10, description="returns up to this height above the ground are ground [m] ..."
    )
    soil_sigmas: float = Field(
        2.0, ge=0, le=100, description="... or up to so many standard deviations of the range noise, if more"
    )
    below_m: float = Field(0.2, ge=0, le=100, description="what is farther below the ground is noise [m]")
    stem_top_m: float = Field(
        1000.0,
        ge=0,
        le=1000,
        description="height over the ground, in the scan plane, up to which stems are stems and from which on they are "
        "other vegetation [m]",
    )
    terrain: TerrainParams = TerrainParams()
    stems: StemsParams = StemsParams()
    flat: FlatParams = FlatParams()
    touching: TouchingParams = TouchingParams()
    company: IsolationParams = IsolationParams()

    def thresholds(self, noise_m: float) -> ForestThresholds:
        """Return the thresholds of the labelling loop; steps that are off get limits without effect."""
        flat, touching, company = self.flat, self.touching, self.company
        soil_m = max(self.soil_m, self.soil_sigmas * noise_m)
        return typed(
            ForestThresholds,
            below_m=self.below_m,
            soil_m=soil_m,
            cover_m=max(flat.cover_m, soil_m) if flat.enabled else soil_m,
            flat_m=max(flat.step_m, flat.noise_sigmas * noise_m),
            top_m=self.stem_top_m,
            # below any difference of ranges
            beside_m=touching.range_m if touching.enabled else -1.0,
            near_m=company.range_m if company.enabled else -1.0,
        )


def forest(range_m: F32, plane: Plane, noise_m: float, params: ForestParams) -> U8:
    """Label a block of forest.

    ``range_m`` (lines, M) float32, metres; returns (lines, M) uint8.

    Ground, a stem, and a stray shot in front of the sky:

    >>> from prc_cli.core.classes import Label
    >>> beam = np.deg2rad(np.linspace(45, 110, 651))
    >>> down = np.maximum(np.cos(beam), 1e-9)
    >>> lines = np.tile(np.minimum(4 / np.sin(beam), 2 / down), (8, 1)).astype(np.float32)
    >>> lines[:, 551:] = np.nan
    >>> lines[3, 600] = 30.0
    >>> labels = forest(lines, Plane.of(beam), 0.0, ForestParams())
    >>> [Label(labels[3, column]).name for column in (0, 500, 590, 600)]
    ['GROUND', 'STEM', 'MISSING', 'NOISE']
    """
    range_m = np.ascontiguousarray(range_m)
    heights = heights_over_ground(range_m, plane, params.terrain)
    stems = find_stems(range_m, heights, plane, noise_m, params.stems)
    return _draw(range_m, heights, stems, plane, params.thresholds(noise_m), params.company)


@stage("classes")
def _draw(
    range_m: F32, heights_m: F32, stems: Mask, plane: Plane, thresholds: ForestThresholds, company: IsolationParams
) -> U8:
    """Label ground and stems; other shots are vegetation, or noise if no shot is near."""
    columns = round(math.radians(company.angle_deg) / plane.step_rad) if plane.step_rad > 0 else LEAST_COLUMNS
    around = min(max(columns, LEAST_COLUMNS), MOST_COLUMNS)
    return kernels.forest_labels(range_m, heights_m, stems, around, thresholds)
