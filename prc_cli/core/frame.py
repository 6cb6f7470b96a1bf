"""Position and axis of a spinning scanner in the frame of its coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F32, F64


@dataclass(frozen=True, slots=True)
class SensorFrame:
    """The frame of a scanner, whose rings are cones around z with their apex at the origin."""

    turn: tuple[tuple[float, float, float], ...] = (
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )
    """Its axes in the frame of the coordinates, one a row."""
    apex_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the scanner in the frame of the coordinates [m]."""
    spread_deg: tuple[float, float] = (0.0, 0.0)
    """Spread of the elevation within rings as the coordinates are, and in this frame [deg]."""

    @property
    def lean_deg(self) -> float:
        """Angle between the axis of the scanner and the z of the coordinates [deg]."""
        return math.degrees(math.acos(min(max(self.turn[2][2], -1.0), 1.0)))

    def own(self, xyz_m: F32) -> F32:
        """Return coordinates, (..., 3), in the frame of the scanner, float32 [m]."""
        moved = xyz_m.astype(np.float64) - np.array(self.apex_m)
        turned = np.empty(xyz_m.shape, np.float32)
        # no matrix product: its rounding depends on the number of points a call
        for axis, (a, b, c) in enumerate(self.turn):
            turned[..., axis] = moved[..., 0] * a + moved[..., 1] * b + moved[..., 2] * c
        return turned

    def shown(self) -> str:
        """Return a text for messages.

        >>> SensorFrame(apex_m=(0.0, 0.0, 1.7), spread_deg=(2.1, 0.1)).shown()
        'the scanner is at 0.00, 0.00, 1.70'
        """
        clauses: list[str] = []
        if any(self.apex_m):
            x, y, z = self.apex_m
            clauses.append(f"the scanner is at {x:.2f}, {y:.2f}, {z:.2f}")
        if self.lean_deg >= 0.05:
            owner = "its" if clauses else "the scanner's"
            clauses.append(f"{owner} axis leans by {self.lean_deg:.1f} deg")
        return " and ".join(clauses)


def turning(axis_rad: F64) -> F64:
    """Return the matrix that turns by a vector, (3,) float64 [rad], (3, 3) float64."""
    angle = float(np.sqrt((axis_rad * axis_rad).sum()))
    if not angle:
        return np.eye(3)
    x, y, z = axis_rad / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: F64 = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * (cross @ cross)
    return matrix
