"""The scan plane: beam directions, and coordinates of the shots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.profile import stage
from prc_cli.core.types import F32, F64, I32
from prc_cli.methods.fused.neighbours_loops import plane_points
from prc_cli.methods.fused.records import Beams, Sides
from prc_cli.methods.plane import Plane

AROUND_LINES = 5
"""Lines before and after a block that its labels depend on."""
INNER_LINES = 2
"""Outermost of these lines, whose neighbours are unknown."""
WIDE_LINES = 2
"""Lines before and after a line whose strips and smoothness are combined with its own."""
VOTE_LINES = 1
"""Lines before and after a block whose labels take part in the vote."""


@dataclass(frozen=True, slots=True, eq=False)
class ScanPlane:
    """Beam directions in float32, for the loops."""

    sine: F32
    """(M,) float32, metres to the side per metre of range; the sign is the side."""
    cosine: F32
    """(M,) float32, metres down per metre of range."""
    step_rad: np.float32
    """Angle between neighbouring columns, in the middle [rad]."""
    left: I32
    """(n,) int32, columns of the positive side, from straight down to straight up."""
    right: I32
    """(n,) int32, columns of the negative side."""

    @property
    def beams(self) -> Beams:
        """Directions of the beams."""
        return Beams(self.sine, self.cosine)

    @property
    def sides(self) -> Sides:
        """Columns on either side."""
        return Sides(self.left, self.right)

    @classmethod
    def of(cls, beam_rad: F64) -> ScanPlane:
        """Return the plane of beams (M,) float64, angles from straight down in (-pi, pi] [rad].

        >>> ScanPlane.of(np.deg2rad([-10.0, 0.0, 10.0, 20.0])).left.tolist()
        [1, 2, 3]
        """
        plane = Plane.of(beam_rad)
        outwards = np.argsort(np.abs(beam_rad), kind="stable").astype(np.int32)
        positive = beam_rad[outwards] >= 0
        return cls(
            plane.sine.astype(np.float32),
            plane.cosine.astype(np.float32),
            np.float32(max(plane.step_rad, 1e-6)),
            np.ascontiguousarray(outwards[positive]),
            np.ascontiguousarray(outwards[~positive]),
        )


@stage("scan plane")
def points_of(range_m: F32, plane: ScanPlane) -> tuple[F32, F32]:
    """Return the coordinates of shots in the scan plane: to the side, and above the scanner.

    ``range_m`` (lines, M) float32, metres; returns side_m, height_m : (lines, M) float32, metres.
    """
    side, height = plane_points(range_m, plane.sine, plane.cosine)
    return side, height
