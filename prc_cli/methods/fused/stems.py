"""Stems: upright, opaque, and continuous from line to line.

A tilted scan plane cuts a stem in a narrow upright ellipse, whose length is the stem's diameter over the sine of the
tilt; an upright plane cuts it from foot to crown. So every line has a run of returns one above the other. Crowns have
such runs by chance, but these are short, have returns from behind, and do not continue in the next line.
"""

from __future__ import annotations

import math

from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, Mask
from prc_cli.methods.fused.plane import Plane
from prc_cli.methods.fused.thresholds import RunThresholds, StemThresholds, typed


class GapParams(Params):
    """Stems partly hidden by leaves (``[fused.forest.stems.gaps]``)."""

    enabled: bool = Field(True, description="whether a run may continue behind leaves")
    longest_m: float = Field(0.3, ge=0, le=100, description="longest gap of a run [m]")
    steep: float = Field(0.1, ge=0, le=100, description="metres to the side, at most, for every metre of a gap")


class OpacityParams(Params):
    """Stems are opaque: few returns come from behind them (``[fused.forest.stems.opacity]``)."""

    enabled: bool = Field(True, description="whether returns from behind count against a stem")
    behind_m: float = Field(
        0.15, ge=0, le=100, description="such returns are farther than the stem by more than this [m]"
    )
    share: float = Field(0.1, ge=0, le=1, description="greatest share of such returns")


class JoiningParams(Params):
    """Stems continue from line to line (``[fused.forest.stems.joining]``)."""

    enabled: bool = Field(True, description="whether runs of successive lines are judged together")
    near_m: float = Field(
        0.05, ge=0, le=10, description="runs with shots of one column this near to each other belong together [m] ..."
    )
    near_share: float = Field(0.005, ge=0, le=1, description="... plus this share of the range")
    runs: int = Field(3, ge=1, le=1000, description="least number of runs of a stem")


class StemsParams(Params):
    """What a stem is (``[fused.forest.stems]``)."""

    above_m: float = Field(0.05, ge=0, le=10, description="height over the ground from which on there are stems [m]")
    tolerance_m: float = Field(
        0.004, ge=0, le=1, description="how far beside a run its next return may be in any case [m] ..."
    )
    noise_sigmas: float = Field(
        2.0, ge=0, le=100, description="... or so many standard deviations of the range noise, if more ..."
    )
    tolerance_share: float = Field(0.0003, ge=0, le=0.1, description="... plus this share of the range")
    steep: float = Field(1.0, gt=0, le=100, description="... plus so many metres for every metre up or down")
    lean: float = Field(0.7, gt=0, le=100, description="metres that a run goes to the side for every metre up, at most")
    short_m: float = Field(0.03, ge=0, le=10, description="shorter runs do not count [m]")
    shots: int = Field(12, ge=3, le=100_000, description="least number of shots of a stem")
    extent_m: float = Field(
        0.5, ge=0, le=100, description="least height from the lowest to the highest end of a stem [m]"
    )
    total_m: float = Field(1.0, ge=0, le=10_000, description="least total length of the runs of a stem [m]")
    mean_m: float = Field(0.12, ge=0, le=100, description="least mean length of the runs of a stem [m]")
    gaps: GapParams = GapParams()
    opacity: OpacityParams = OpacityParams()
    joining: JoiningParams = JoiningParams()

    def run_thresholds(self, step_rad: float, noise_m: float) -> RunThresholds:
        """Return the thresholds of the loop over the runs of a line; steps that are off get limits without effect."""
        gaps, opacity = self.gaps, self.opacity
        return typed(
            RunThresholds,
            step_rad=step_rad,
            above_m=self.above_m,
            tolerance_m=max(self.tolerance_m, self.noise_sigmas * noise_m),
            tolerance_share=self.tolerance_share,
            steep=self.steep,
            gap_m=gaps.longest_m if gaps.enabled else math.inf,
            # excludes every return farther than the shot spacing on a wall
            gap_steep=gaps.steep if gaps.enabled else -math.inf,
            behind_m=opacity.behind_m if opacity.enabled else math.inf,
            lean=self.lean,
            short_m=self.short_m,
        )

    def stem_thresholds(self) -> StemThresholds:
        """Return the thresholds of the loop over the runs of a block."""
        joining = self.joining
        return typed(
            StemThresholds,
            # below any difference of ranges
            near_m=joining.near_m if joining.enabled else -1.0,
            near_share=joining.near_share if joining.enabled else 0.0,
            shots=self.shots,
            runs=joining.runs if joining.enabled else 1,
            extent_m=self.extent_m,
            total_m=self.total_m,
            mean_m=self.mean_m,
            through_share=self.opacity.share,
        )


@stage("stems")
def find_stems(range_m: F32, heights_m: F32, plane: Plane, noise_m: float, params: StemsParams) -> Mask:
    """Mark the shots on stems.

    ``range_m`` (lines, M) float32, metres; ``heights_m`` (lines, M) float32, metres; returns (lines, M) bool.

    A stem 4 m to the side, and ground; the same line four times:

    >>> import numpy as np
    >>> beam = np.deg2rad(np.linspace(45, 100, 551))
    >>> down = np.maximum(np.cos(beam), 1e-9)
    >>> lines = np.tile(np.minimum(4 / np.sin(beam), 2 / down), (4, 1)).astype(np.float32)
    >>> heights = (2 - lines * np.cos(beam)).astype(np.float32)
    >>> stems = find_stems(lines, heights, Plane.of(beam), 0.0, StemsParams())
    >>> heights[stems].min().round(1), stems[:, -1].all()
    (np.float32(0.1), np.True_)
    """
    thresholds = params.run_thresholds(plane.step_rad, noise_m)
    runs, table = kernels.upright_runs(range_m, heights_m, plane.sine, plane.cosine, thresholds)
    return kernels.stem_shots(range_m, runs, table, params.stem_thresholds())
