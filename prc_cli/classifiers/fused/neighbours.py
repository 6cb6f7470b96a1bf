"""Neighbourhood of a shot: number of near neighbours, smoothness, and direction of the surface."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import Field

from prc_cli import kernels
from prc_cli.classifiers.fused.plane import ScanPlane
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.thresholds_fused import ChordThresholds, NearThresholds, SmoothThresholds, single
from prc_cli.core.types import F32, U8


class CompanyParams(Params):
    """When a neighbour is near (``[fused.company]``)."""

    near_m: float = Field(0.4, ge=0, le=100, description="near to the side and in height, each, is within this [m] ...")
    near_steps: float = Field(3.0, ge=0, le=1000, description="... or so many distances of two columns")
    thin_m: float = Field(
        0.1, ge=0, le=100, description="on one level, or upright above each other, is within this [m] ..."
    )
    along_m: float = Field(1.0, ge=0, le=100, description="... and within this in the other direction [m] ...")
    along_steps: float = Field(8.0, ge=0, le=1000, description="... or so many distances of two columns")
    least: int = Field(
        3, ge=0, le=28, description="shots with fewer near neighbours, of 28, are alone; 0 = none is alone"
    )

    def thresholds(self) -> NearThresholds:
        """Return what the loop is given."""
        return single(
            NearThresholds,
            near_m=self.near_m,
            near_steps=self.near_steps,
            thin_m=self.thin_m,
            along_m=self.along_m,
            along_steps=self.along_steps,
        )


class SmoothnessParams(Params):
    """When shots lie on a smooth surface (``[fused.smoothness]``)."""

    noise_sigmas: float = Field(2.25, ge=0, le=100, description="tolerance, in standard deviations of the range noise")
    least_m: float = Field(0.006, ge=0, le=10, description="least tolerance [m]")
    per_metre: float = Field(0.0006, ge=0, le=1, description="what is added to it for every metre of range [m]")
    per_step: float = Field(0.1, ge=0, le=10, description="and the share of the distance of two columns")
    gap_m: float = Field(0.4, gt=0, le=100, description="pairs in a line are less apart than this [m] ...")
    gap_steps: float = Field(16.0, gt=0, le=1000, description="... or so many distances of two columns")

    def thresholds(self, noise_m: float, step_rad: float) -> SmoothThresholds:
        """Return what the loop is given, for a range noise [m] and an angle between columns [rad]."""
        return single(
            SmoothThresholds,
            tolerance_m=max(self.least_m, self.noise_sigmas * noise_m),
            tolerance_per_m=self.per_metre + self.per_step * step_rad,
            gap_m=self.gap_m,
            gap_steps=self.gap_steps,
        )


class DirectionParams(Params):
    """Which way a surface goes (``[fused.directions]``)."""

    chord_m: float = Field(0.15, gt=0, le=100, description="reach of a chord to either side [m]")
    slope: float = Field(0.4, ge=0, le=1, description="an upright chord leans less than this, a level one rises less")
    slack_m: float = Field(0.02, ge=0, le=10, description="and by no more than this beside [m]")
    longest_m: float = Field(2.0, gt=0, le=1000, description="longer chords say nothing [m]")

    def thresholds(self) -> ChordThresholds:
        """Return what the loop is given."""
        return single(
            ChordThresholds, chord_m=self.chord_m, slope=self.slope, slack_m=self.slack_m, longest_m=self.longest_m
        )


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """Neighbourhood counts of every shot, for the inner lines of a window."""

    near: U8
    """(lines, M) uint8, near neighbours, of 28."""
    smooth: U8
    """(lines, M) uint8, pairs of neighbours that lie on a smooth surface with the shot, of 10."""
    upright: U8
    """(lines, M) uint8, upright chords through the shot, of 3."""
    level: U8
    """(lines, M) uint8, level chords through the shot, of 3."""

    @property
    def counts(self) -> tuple[U8, U8, U8, U8]:
        """Return all four."""
        return self.near, self.smooth, self.upright, self.level


@stage("company")
def near_neighbours(window_m: F32, plane: ScanPlane, params: CompanyParams) -> U8:
    """Count the near neighbours of every shot, in its own line and two lines before and after.

    Nearness is measured in the scan plane, not in range: at grazing incidence the ranges on one surface differ by
    metres from shot to shot.
    """
    counts: U8 = kernels.near_counts(window_m, plane.sine, plane.cosine, plane.step_rad, params.thresholds())
    return counts


@stage("smoothness")
def smooth_pairs(window_m: F32, plane: ScanPlane, noise_m: float, params: SmoothnessParams) -> U8:
    """Count, for every shot, the pairs of neighbours on a smooth surface with it, within its line and across lines."""
    thresholds = params.thresholds(noise_m, float(plane.step_rad))
    counts: U8 = kernels.smooth_counts(window_m, plane.sine, plane.cosine, plane.step_rad, thresholds)
    return counts


@stage("directions")
def chords(range_m: F32, smooth: U8, plane: ScanPlane, params: DirectionParams) -> tuple[U8, U8]:
    """Count the upright and the level chords through every shot."""
    upright, level = kernels.directions(range_m, smooth, plane.sine, plane.cosine, plane.step_rad, params.thresholds())
    return upright, level
