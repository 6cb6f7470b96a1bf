"""The curvature of inverse ranges, window by window.

The twin of :func:`prc_cli.streams.angle_step.curvatures`.
"""

from __future__ import annotations

import math

import numpy as np


def curvature_of(piece: list[float], bent: float) -> tuple[float, float] | None:
    """Return -u''/u amid a window and its standard error; None where a quadratic does not fit."""
    x = np.arange(len(piece)) - (len(piece) - 1) / 2
    parabola, covariance = np.polyfit(x, piece, 2, cov="unscaled")
    off = math.sqrt(
        sum((u - np.polyval(parabola, step)) ** 2 for u, step in zip(piece, x, strict=True))
        / (len(piece) - 3)
    )
    if not off < bent * parabola[2]:
        return None
    return -2 * parabola[0] / parabola[2], 2 * off * math.sqrt(covariance[0, 0]) / parabola[2]
