"""Ground points and the height of the ground (Stamos et al. 2012, sec. 5).

Part a works within one row: potential ground is the first succession of horizontal points whose line angles have one
mode, so that they lie on one straight line. Part b works across rows: potential ground whose height agrees with the
dominant height so far is ground, and grows over the horizontal points that follow; otherwise the search goes on in the
row.

Interpretations where the text is silent or ambiguous:

- The line angles of ten or more points are taken as one set. A mode counts when it has two samples, so that a single
  outlier does not end the ground. Where the first ten points have several modes, the search moves on by one point
  instead of taking eight of them.
- The bandwidth of the line angles follows their noise, three standard deviations in the middle of the set, but at
  least 5 degrees: with a fixed bandwidth, noise near the scanner would split the ground. It is recomputed whenever the
  set has grown by a half, so that the work stays proportional to the number of points.
- "Almost collinear" has a limit in height as well as in angle, since the line angle measures slope and not height:
  without it, ground would climb a curb that is visible in one shot only. The local line is level where its points span
  less than that limit, because a fitted slope would be noise.
- For the same reason a jump in height ends potential ground: a hedge top or a car roof in front of the road has the
  line angle of the road, and only one angle at its edge differs.
- Near the scanner neighbouring shots are closer than their noise, and a few angles of ten points can end the set early.
  To keep the rest of the road, the search resumes within the same run of horizontal points.
- The height of a row is that of the points next to the scanner: on a slope the lowest points would be those at the far
  end, metres below.
- One or two noisy shots must not end the ground of a line. A few points that are neither horizontal nor missing are
  skipped where the next horizontal ones continue the local line within less than the height of a curb.
- For the same reason ground found later in a row is accepted by the local line, not by the height of its points.
- Where the ground leans, one height does not hold all around the scanner. Potential ground at the height of the last
  ground of its side is ground too. The dominant height itself stays one, since cars are told worse by the other.
- The dominant height is the main mode of the heights of all rows, accepted or not (an option), and is recomputed after
  each of them: with accepted rows only, a wrong first estimate would never be corrected. The oldest heights are
  dropped, so that it follows a long street.
- A row without accepted ground contributes the height of its first potential ground, the nearest to the scanner.
- The ground stays unknown while only a few of many rows have a height.
- If the first estimate was made from fewer heights than wanted, the next heights count as they come, and the dominant
  height follows at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.errors import PrcError
from prc_cli.core.types import F32, F64, I32, I64, U8, Mask
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import GroundState as GroundState
from prc_cli.methods.sequential_angle.thresholds import GroundThresholds
from prc_cli.methods.sequential_angle.thresholds import PotentialGround as PotentialGround

MOST_BANDWIDTHS = 1_000_000
"""Largest span of the samples [bandwidths]."""


@dataclass(frozen=True, slots=True, eq=False)
class Modes:
    """Modes of a set of samples, ascending."""

    places: F64
    """(m,) float64, maxima of the density, to an eighth of a bandwidth."""
    counts: I64
    """(m,) int64, number of samples of each mode."""

    def main(self) -> float:
        """Return the mode with most samples, on ties the lowest; NaN without samples."""
        return float(self.places[np.argmax(self.counts)]) if len(self.places) else float("nan")


def mean_shift(values: F64, bandwidth: float) -> Modes:
    """Find the modes of samples (Comaniciu and Meer 2002); modes closer than half a bandwidth are merged.

    ``values`` (n,) float64.

    >>> mean_shift(np.array([89.0, 90.0, 91.0, 130.0, 131.0]), 5.0).counts
    array([3, 2])
    """
    values = np.ascontiguousarray(values, dtype=np.float64)
    if not (np.isfinite(bandwidth) and bandwidth > 0):
        raise PrcError("mean shift", f"found a bandwidth of {bandwidth}, expected a positive number")
    if not np.isfinite(values).all():
        raise PrcError("mean shift", "found a sample that is no number, expected finite samples", "leave NaN out")
    if len(values) and np.ptp(values) / bandwidth > MOST_BANDWIDTHS:
        problem = f"found samples that span {np.ptp(values) / bandwidth:.3g} bandwidths, expected at most a million"
        raise PrcError("mean shift", problem, "widen the bandwidth")
    places, counts = kernels.find_modes(values, float(bandwidth))
    return Modes(places, counts)


class GroundParams(Params):
    """How ground is found and followed (``[sequential_angle.ground]``)."""

    enabled: bool = Field(True, description="look for the ground at all; false = nor for curbs and cars")
    first_run: int = Field(
        10, ge=3, le=1000, description="horizontal points in succession that potential ground begins with (published)"
    )
    lowest_points: int = Field(
        5, ge=1, le=1000, description="points, the lowest ones, whose mean z is the height of a line (published)"
    )
    start_heights: int = Field(
        200,
        ge=1,
        le=100_000,
        description="heights of lines that the first estimate of the ground needs; published: 50, which the bonnet of "
        "a car beside the scanner can fill",
    )
    height_tolerance: float = Field(
        0.10,
        gt=0,
        le=10,
        description="potential ground is ground when its height differs from the dominant height by less than this "
        "share of it (published); heights are counted from the scanner",
    )
    height_tolerance_m: float = Field(
        0.05, ge=0, le=100, description="the same at least, for scanners near the ground [m]; 0: the printed text"
    )
    follow_m: float = Field(
        0.10,
        ge=0,
        le=100,
        description="potential ground is ground, too, when its height differs by less than this from that of the last "
        "ground of the same side [m]; 0: the printed text",
    )
    height_points: int = Field(
        30,
        ge=0,
        le=100_000,
        description="points at the beginning of potential ground that its lowest points are taken from; 0 = all of "
        "it, the printed text",
    )
    least_heights: int = Field(
        10,
        ge=1,
        le=100_000,
        description="heights of lines, or those of half of all lines, without which the ground is unknown; 1: the "
        "printed text",
    )
    bandwidth_deg: float = Field(
        5.0, ge=0.5, le=90, description="smallest bandwidth of the mean shift over line angles [deg]"
    )
    bandwidth_sigmas: float = Field(
        3.0,
        ge=0,
        le=100,
        description="bandwidth of the mean shift over line angles, in standard deviations of a line angle; "
        "0 keeps it at its smallest",
    )
    mode_samples: int = Field(2, ge=2, le=1000, description="line angles that make a mode")
    height_bandwidth: float = Field(
        0.05,
        ge=0,
        le=1,
        description="bandwidth of the mean shift over heights, as a share of the median height; rounded up to a "
        "multiple of 16 mm",
    )
    roof_m: float = Field(
        0.6,
        ge=0,
        le=1e6,
        description="heights that much above a lower mode are those of bonnets and roofs, ... [m]; published: so large "
        "that it is off",
    )
    roof_share: float = Field(
        0.25, gt=0, le=1, description="... if the lower mode has at least this share of the heights of the main one"
    )
    heights: Literal["all", "accepted"] = Field(
        "all",
        description='heights that the dominant height comes from: those of "all" lines, or of lines whose height was '
        '"accepted" as that of ground',
    )
    renew: Literal["every", "accepted"] = Field(
        "every",
        description='lines after which the dominant height is computed anew: "every" one whose height counts, or those '
        'that have ground ("accepted", published)',
    )
    memory_heights: int = Field(
        2000,
        ge=0,
        le=1_000_000,
        description="heights that the dominant height comes from, the latest ones, never fewer than start_heights; "
        "0 = all (published)",
    )
    growth_points: int = Field(
        10, ge=2, le=1000, description="points before a point that the local line is laid through"
    )
    jump_m: float = Field(
        0.10,
        gt=0,
        le=1000,
        description="height above or below the last point and the local line that ends potential ground [m]; 1000 "
        "turns it off, as in the printed text",
    )
    growth_height_m: float = Field(
        0.10, gt=0, le=100, description="height above or below the local line up to which ground grows [m]"
    )
    resume: bool = Field(
        True,
        description="where growth ends within a run of horizontal points, more potential ground in the rest of the run "
        "that continues the local line is ground too; off: the printed text",
    )
    bridge: int = Field(
        4,
        ge=0,
        le=1000,
        description="points in succession, neither horizontal nor missing, that potential and growing ground pass over "
        "where the horizontal points behind continue the local line; 0: the printed text",
    )
    bridge_height_m: float = Field(
        0.05, gt=0, le=100, description="height above or below the local line up to which they continue it [m]"
    )

    @property
    def least(self) -> int:
        """Least number of heights; with fewer, the ground stays unknown."""
        return min(self.least_heights, self.start_heights)

    @property
    def memory(self) -> int:
        """Number of heights kept, 0 = all."""
        return max(self.memory_heights, self.start_heights) if self.memory_heights else 0

    def thresholds(self, range_noise_m: float) -> GroundThresholds:
        """Return the thresholds of the kernels, for a standard deviation of the range [m]."""
        return GroundThresholds(
            first_run=self.first_run,
            lowest_points=self.lowest_points,
            height_points=self.height_points,
            mode_samples=self.mode_samples,
            bandwidth_deg=self.bandwidth_deg,
            bandwidth_sigmas=self.bandwidth_sigmas,
            range_noise_m=range_noise_m,
            growth_points=self.growth_points,
            jump_m=self.jump_m,
            growth_height_m=self.growth_height_m,
            bridge=self.bridge,
            bridge_height_m=self.bridge_height_m,
            resume=self.resume,
            start_heights=self.start_heights,
            least_heights=self.least,
            memory_heights=self.memory,
            height_bandwidth=self.height_bandwidth,
            roof_m=self.roof_m,
            roof_share=self.roof_share,
            all_heights=self.heights == "all",
            renew_every=self.renew == "every",
            height_tolerance=self.height_tolerance,
            height_tolerance_m=self.height_tolerance_m,
            follow_m=self.follow_m,
        )


def potential_ground(
    lines: VerticalLines, surface: U8, phihat: F32, ahead: I32, params: GroundParams, *, range_noise_m: float
) -> PotentialGround:
    """Find the first potential ground of every row (part a).

    ``surface`` (R, n) uint8; ``phihat`` (R, n) float32; ``ahead`` (R, n) int32.
    """
    if not params.enabled:
        n = len(surface)
        nowhere = np.full(n, -1, np.int32)
        return PotentialGround(nowhere, nowhere, np.full(n, np.nan), np.full(n, np.nan))
    found: PotentialGround = kernels.potential_heights(
        surface, lines.xyz_m, lines.horizontal_m, phihat, ahead, lines.n_beams, params.thresholds(range_noise_m)
    )
    return found


def initial_ground(heights_m: F64, params: GroundParams, n_sides: int = 1) -> GroundState:
    """Estimate the height of the ground from the first rows of a stream (part b, first half).

    ``heights_m`` (R,) float64.

    >>> round(initial_ground(np.array([-1.80, -1.81, np.nan, -0.3, -1.79]), GroundParams()).z_g, 2)
    -1.8
    """
    rows = np.flatnonzero(~np.isnan(heights_m))[: params.start_heights]
    n_rows = int(rows[-1]) + 1 if len(rows) == params.start_heights else len(heights_m)
    _, z_g, bins, histogram = kernels.main_height(
        heights_m[rows], params.height_bandwidth, params.roof_m, params.roof_share
    )
    if len(rows) < min(params.least, (len(heights_m) + 1) // 2):
        z_g = float("nan")
    return GroundState(histogram, bins if params.memory else bins[:0], z_g, n_rows, np.full(n_sides, np.nan))


def ground(
    lines: VerticalLines,
    surface: U8,
    phihat: F32,
    ahead: I32,
    potential: PotentialGround,
    state: GroundState,
    params: GroundParams,
    *,
    range_noise_m: float,
) -> tuple[Mask, F32, GroundState]:
    """Find the ground of every row (part b).

    Returns ``ground`` (R, n) bool, ``z_g`` (R,) float32.
    """
    found: tuple[Mask, F32, GroundState] = kernels.ground_rows(
        surface, lines.xyz_m, lines.horizontal_m, phihat, ahead, lines.n_beams, potential, state,
        params.thresholds(range_noise_m),
    )  # fmt: skip
    return found
