"""Ground points and the height of the ground (Stamos et al. 2012, sec. 5).

Part a works within one row: potential ground is the first succession of horizontal points whose
line angles have one mode, so that they lie on one straight line. Part b works across rows:
potential ground whose height agrees with the dominant height so far is ground, and grows over the
horizontal points that follow; otherwise the search continues in the row.

Interpretations of passages that are silent or ambiguous:

- The line angles of ten or more points are one set. A mode counts if it has two samples, so that a
  single outlier does not end the ground. If the first ten points have several modes, the search
  moves on by one point instead of using eight of them.
- The bandwidth of the line angles follows their noise, three standard deviations in the middle of
  the set, but at least 5 degrees: with a fixed bandwidth, noise near the scanner would split the
  ground. It is recomputed whenever the set has grown by a half, so that the work stays proportional
  to the number of points.
- "Almost collinear" has a limit in height as well as in angle, since the line angle measures slope
  and not height: without it, ground would climb a curb that is visible in one shot only. The local
  line is level if its points span less than that limit, because a fitted slope would be noise.
- The height of a row is the height of its points next to the scanner (``height_points``): on a
  slope the lowest points would be at the far end, metres below.
- The dominant height is the main mode of the heights of all rows. A row without accepted ground
  contributes the height of its first potential ground, the nearest to the scanner.
- If the first estimate was made from fewer heights than wanted, the next heights count as they
  come, and the dominant height follows at once.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F32, F64, I32, U8, Mask
from prc_cli.methods.sequential_angle.ground_loops import (
    ground_rows,
    main_height,
    potential_heights,
)
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import GroundState as GroundState
from prc_cli.methods.sequential_angle.thresholds import GroundThresholds
from prc_cli.methods.sequential_angle.thresholds import PotentialGround as PotentialGround


def potential_ground(
    lines: VerticalLines,
    surface: U8,
    phihat: F32,
    ahead: I32,
    thresholds: GroundThresholds,
) -> PotentialGround:
    """Find the first potential ground of every row (part a).

    ``surface`` (R, n) uint8; ``phihat`` (R, n) float32; ``ahead`` (R, n) int32.
    """
    return potential_heights(
        surface, lines.xyz_m, lines.horizontal_m, phihat, ahead, lines.n_beams, thresholds
    )


def initial_ground(heights_m: F64, thresholds: GroundThresholds) -> GroundState:
    """Estimate the height of the ground from the first rows of a stream (part b, first half).

    ``heights_m`` (R,) float64.

    >>> heights_m = np.array([-1.80, -1.81, np.nan, -0.3, -1.79])
    >>> round(initial_ground(heights_m, GroundThresholds()).z_g, 2)
    -1.8
    """
    rows = np.flatnonzero(~np.isnan(heights_m))[: thresholds.start_heights]
    n_rows = int(rows[-1]) + 1 if len(rows) == thresholds.start_heights else len(heights_m)
    z_g, histogram = main_height(heights_m[rows], thresholds.height_bandwidth)
    return GroundState(histogram, z_g, n_rows)


def ground(
    lines: VerticalLines,
    surface: U8,
    phihat: F32,
    ahead: I32,
    potential: PotentialGround,
    state: GroundState,
    thresholds: GroundThresholds,
) -> tuple[Mask, F32, GroundState]:
    """Find the ground of every row (part b).

    Returns ``ground`` (R, n) bool, ``z_g`` (R,) float32.
    """
    return ground_rows(
        surface,
        lines.xyz_m,
        lines.horizontal_m,
        phihat,
        ahead,
        lines.n_beams,
        potential,
        state,
        thresholds,
    )
