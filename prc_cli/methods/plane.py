"""The scan plane: beam directions in double precision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F64

_TURN = 2 * np.pi
MANY_RINGS = 48
"""Scanners with fewer beams have few rings."""


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """Beam directions within the scan plane."""

    sine: F64
    """(M,) float64, metres to the side per metre of range."""
    cosine: F64
    """(M,) float64, metres down per metre of range."""
    step_rad: float
    """Angle between neighbouring columns, in the middle [rad]."""

    @classmethod
    def of(cls, beam_rad: F64) -> Plane:
        """Return the plane of beams, (M,) float64, given by their angles from straight down [rad].

        >>> Plane.of(np.deg2rad([179.0, -179.0, -177.0])).step_rad.__round__(4)
        0.0349
        """
        step = np.abs(np.diff(beam_rad))
        step = np.minimum(step, np.abs(_TURN - step))
        return cls(np.sin(beam_rad), np.cos(beam_rad), float(np.median(step)) if len(step) else 0.0)
