"""Curbs: possible curb points in a row, and verification across lines (Stamos et al. 2012, sec. 6).

A possible curb point is the first vertical point after the ground with nothing under it. Vertical points that are
neighbours on the grid of lines and beams and close in space form regions. A complete, low region with a possible curb
point is a curb if it spans three lines, or if it is straight.

Interpretations where the text is silent or ambiguous:

- Neighbours are the eight around a point, closer than 0.3 m.
- A region is complete when the next line of its side adds nothing to it. A region of very many lines is decided and
  closed early, which bounds the memory; points that follow begin a new region.
- "Vertical curvature" is the change of the signed angle between neighbouring points of the region in a line. A region
  without such a pair does not count as straight.
- "Behind a curb" is decided by horizontal distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field, model_validator

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.types import F32, I32, U8, Mask
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import CurbThresholds, OpenRegions


class CurbParams(Params):
    """How curbs are found and verified (``[sequential_angle.curb]``)."""

    enabled: bool = Field(True, description="look for curbs at all; false = nor is any car behind one")
    under_points: int = Field(
        30, ge=1, le=100_000, description="points before a point that are looked at for something under it (published)"
    )
    under_m: float = Field(
        0.01,
        ge=0,
        le=100,
        description="a point before that is farther away by more than this, ... (published) [m]",
    )
    under_sigmas: float = Field(
        6.0,
        ge=0,
        le=1000,
        description="... and by more than this many times the range noise, lies under the point, which then is no "
        "curb; published: 0, the distance alone",
    )
    search_height_m: float = Field(
        2.0, ge=0, le=1000, description="height above the ground where the search for a curb ends (published) [m]"
    )
    grouping_m: float = Field(
        0.3, gt=0, le=100, description="neighbouring vertical points closer than this belong to one region [m]"
    )
    max_height_m: float = Field(0.2, gt=0, le=100, description="a higher region is not a curb (published) [m]")
    min_height_m: float = Field(
        0.08,
        ge=0,
        le=100,
        description="nor is a lower one, such as a lowered kerb or the edge of a verge: cars stand behind them; "
        "published: 0 [m]",
    )
    height: Literal["region", "line"] = Field(
        "region",
        description='the height of a region is that of the whole "region", or the largest within one "line", which '
        "does not grow along a street that is not level",
    )
    stands_below_m: float = Field(
        0.05,
        ge=0,
        le=1e6,
        description="a car whose foot, or the ground before it, is this much lower than the top of a curb stands on a "
        "road and not behind the curb; published: so large that it is off [m]",
    )
    min_lines: int = Field(
        3, ge=1, le=1000, description="lines that make a curb of a region with a possible curb point (published)"
    )
    curvature_deg: float = Field(
        20.0, ge=0, le=360, description="with fewer lines, the median change of angle must be less than this [deg]"
    )
    max_lines: int = Field(
        200, ge=1, le=100_000, description="a region of so many lines is decided as it is: bounds memory and delay"
    )

    def thresholds(self, range_noise_m: float = 0.0) -> CurbThresholds:
        """Return the thresholds of the kernels, for a standard deviation of the range [m]."""
        return CurbThresholds(
            under_points=self.under_points,
            under_m=max(self.under_m, self.under_sigmas * range_noise_m),
            search_height_m=self.search_height_m,
            grouping_m=self.grouping_m,
            max_height_m=self.max_height_m,
            min_height_m=self.min_height_m,
            by_line=self.height == "line",
            min_lines=self.min_lines,
            curvature_deg=self.curvature_deg,
            max_lines=self.max_lines,
        )

    @model_validator(mode="after")
    def _check(self) -> CurbParams:
        if self.max_lines < self.min_lines:
            message = f"max_lines ({self.max_lines}) not below min_lines ({self.min_lines})"
            raise ValueError(message)
        return self


@dataclass(frozen=True, slots=True, eq=False)
class CurbState:
    """Undecided regions between two calls; P lines, at most ``max_lines``."""

    regions: OpenRegions
    """Regions in the lines that are not final, at least the last line."""
    xyz_m: F32
    """(n_sides, n, 3) float32, points of the last line [m]."""
    signed_deg: F32
    """((min_lines - 1) * n_sides, n) float32, signed angles of the last lines [deg]."""

    @classmethod
    def start(cls, n_sides: int, n: int, params: CurbParams) -> CurbState:
        """Return the state before the first line."""
        return cls(
            regions=OpenRegions(
                labels=np.zeros((n_sides, n), np.int32),
                n_given=1,
                side=np.empty(0, np.int32),
                first=np.empty(0, np.int32),
                last=np.empty(0, np.int32),
                possible=np.empty(0, np.bool_),
                low_m=np.empty(0, np.float32),
                high_m=np.empty(0, np.float32),
            ),
            xyz_m=np.full((n_sides, n, 3), np.nan, np.float32),
            signed_deg=np.full(((params.min_lines - 1) * n_sides, n), np.nan, np.float32),
        )

    @property
    def n_waiting(self) -> int:
        """Lines taken but not yet returned."""
        return len(self.regions.labels) // len(self.xyz_m) - self.regions.n_given


def possible_curbs(
    lines: VerticalLines, surface: U8, ground: Mask, z_g: F32, params: CurbParams, *, range_noise_m: float
) -> I32:
    """Find the possible curb point of every row.

    This is the first vertical point after the last ground point with nothing under it: none of the points before it
    is farther from the scanner, as the road under a car would be. The search ends at the first point 2 m above the
    ground.

    ``surface`` (R, n) uint8; ``ground`` (R, n) bool; ``z_g`` (R,) float32; returns (R,) int32.
    """
    if not params.enabled:
        return np.full(len(surface), -1, np.int32)
    beams: I32
    _, beams = kernels.possible_curbs(
        surface, lines.range_m, lines.xyz_m, ground, z_g, params.thresholds(range_noise_m)
    )
    return beams


def curbs(
    lines: VerticalLines,
    surface: U8,
    signed_deg: F32,
    possible: I32,
    state: CurbState,
    params: CurbParams,
    *,
    last: bool,
) -> tuple[Mask, CurbState]:
    """Connect vertical points into regions, and return the rows whose regions are all decided.

    ``surface`` (R, n) uint8; ``signed_deg`` (R, n) float32; ``possible`` (R,) int32; returns ``curb`` (F, n) bool.
    """
    curb, regions = kernels.connect_verticals(
        surface, lines.xyz_m, signed_deg, possible, lines.n_sides, state.xyz_m, state.signed_deg, state.regions,
        params.thresholds(), last,
    )  # fmt: skip
    return curb, CurbState(regions, _tail(state.xyz_m, lines.xyz_m), _tail(state.signed_deg, signed_deg))


def _tail(before: F32, new: F32) -> F32:
    """Return the last rows of both, as many as there were before; a copy."""
    n = len(before)
    return np.concatenate([before[min(len(new), n) :], new[max(len(new) - n, 0) :]])
