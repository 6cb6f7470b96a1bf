"""Neighbourhood of a shot: number of near neighbours, smoothness, and direction of the surface."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.thresholds import ChordThresholds, NearThresholds, SmoothThresholds, typed


class NeighbourhoodParams(Params):
    """Distance limits for near neighbours (``[fused.company]``)."""

    near_m: float = Field(
        0.4, ge=0, le=100, description="greatest distance of near neighbours, to the side and in height [m] ..."
    )
    near_steps: float = Field(3.0, ge=0, le=1000, description="... or this many column spacings, if more")
    thin_m: float = Field(
        0.1, ge=0, le=100, description="on one level or upright surface: greatest distance across it [m] ..."
    )
    along_m: float = Field(1.0, ge=0, le=100, description="... and along it [m] ...")
    along_steps: float = Field(8.0, ge=0, le=1000, description="... or this many column spacings, if more")
    least: int = Field(
        3, ge=0, le=28, description="shots with fewer near neighbours, of 28, are isolated; 0 = none is isolated"
    )

    def thresholds(self) -> NearThresholds:
        """Return what the loop is given."""
        return typed(
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
    per_metre: float = Field(0.0006, ge=0, le=1, description="added to the tolerance per metre of range [m]")
    per_step: float = Field(0.1, ge=0, le=10, description="added to the tolerance, as a share of the column spacing")
    gap_m: float = Field(
        0.4, gt=0, le=100, description="greatest distance between the two of a pair within a line [m] ..."
    )
    gap_steps: float = Field(16.0, gt=0, le=1000, description="... or this many column spacings, if more")

    apart_m: float = Field(
        0.012,
        ge=0,
        le=1,
        description="where columns are nearer to each other, every second, third, ... one is compared: "
        "a single leaf is smooth [m]; 0 = always the next",
    )

    def thresholds(self, noise_m: float, step_rad: float) -> SmoothThresholds:
        """Return what the loop is given, for a range noise [m] and an angle between columns [rad]."""
        return typed(
            SmoothThresholds,
            tolerance_m=max(self.least_m, self.noise_sigmas * noise_m),
            tolerance_per_m=self.per_metre + self.per_step * step_rad,
            gap_m=self.gap_m,
            gap_steps=self.gap_steps,
            apart_m=self.apart_m,
        )


class DirectionParams(Params):
    """Direction of a surface, from chords (``[fused.directions]``)."""

    chord_m: float = Field(0.15, gt=0, le=100, description="half length of a chord [m]")
    slope: float = Field(0.4, ge=0, le=1, description="greatest slope of a level chord, and lean of an upright one")
    slack_m: float = Field(0.02, ge=0, le=10, description="added to that limit [m]")
    longest_m: float = Field(2.0, gt=0, le=1000, description="longer chords do not count [m]")

    def thresholds(self) -> ChordThresholds:
        """Return what the loop is given."""
        return typed(
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
def near_neighbours(window_m: F32, plane: ScanPlane, params: NeighbourhoodParams) -> U8:
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
