"""The curvature of inverse ranges, window by window.

The twin of :func:`prc_cli.streams.angle_step.curvatures`.
"""

from __future__ import annotations

import math

import numpy as np


def curvature_of(piece: list[float], bent: float) -> tuple[float, float] | None:
    """Return -u''/u amid a window and its standard error; None where a quadratic does not fit."""
    x = np.arange(len(piece)) - (len(piece) - 1) / 2
    found, covariance = np.polyfit(x, piece, 2, cov="unscaled")
    off = math.sqrt(
        sum((u - np.polyval(found, at)) ** 2 for u, at in zip(piece, x, strict=True))
        / (len(piece) - 3)
    )
    if not off < bent * found[2]:
        return None
    return -2 * found[0] / found[2], 2 * off * math.sqrt(covariance[0, 0]) / found[2]
