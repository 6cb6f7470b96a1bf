"""Straight down, from the ground alone: the direction in which the lines of a scanner see one level plane.

A plane at distance d whose normal points to the angle a is seen at ``r = d / cos(angle - a)``. Ground is the nearest
such plane that fills a large part of the line. A road slopes by a degree or two to its sides, so that is how well it
tells.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32, F64
from prc_cli.stream.down import wrap

SEARCH_STEP_RAD = math.radians(0.5)
REACH_RAD = math.radians(65.0)
"""Ground is looked for up to so far from straight down."""
LEAST_RAD = math.radians(25.0)
"""And must fill so much of that."""
BIN_M = 0.1
"""Heights within this are one plane [m]."""
LEAST_LINES = 4


def down_of_ground(angle_rad: F64, range_m: F32) -> float | None:
    """Find the scan angle that points straight down.

    Parameters
    ----------
    angle_rad : (M,) float64
        Scan angle of every column, turning one way [rad].
    range_m : (lines, M) float32, metres
        Lines with returns; NaN = missing.

    Returns
    -------
    float or None
        Scan angle [rad], None where no plane fills enough of the lines.

    Examples
    --------
    >>> angle = np.deg2rad(np.linspace(0, 180, 361))
    >>> down = np.cos(angle - np.deg2rad(100))
    >>> lines = np.tile(np.where(down > 0.2, 2.0 / np.maximum(down, 0.2), np.nan), (10, 1)).astype(np.float32)
    >>> round(math.degrees(down_of_ground(angle, lines)), 1)
    100.0
    """
    middle = _middle_of_lines(range_m)
    held = np.flatnonzero(np.isfinite(middle))
    if len(range_m) < LEAST_LINES or len(held) < 3:
        return None
    step = float(np.median(np.abs(wrap(np.diff(angle_rad)))))
    best, inside = 0.0, held[:0]
    for nadir in np.arange(-math.pi, math.pi, SEARCH_STEP_RAD):
        score, columns = _fill(angle_rad, middle, held, float(nadir), step)
        if score > best:
            best, inside = score, columns
    if len(inside) * step < LEAST_RAD:
        return None
    # 1 / r = cos(angle - nadir) / d, a straight line in cosine and sine of the angle
    waves = np.stack([np.cos(angle_rad[inside]), np.sin(angle_rad[inside])], axis=1)
    a, b = np.linalg.lstsq(waves, 1.0 / middle[inside], rcond=None)[0]
    return math.atan2(b, a)


def _middle_of_lines(range_m: F32) -> F64:
    """Return the median range of every column, NaN where less than half of the lines have one."""
    n_held = np.count_nonzero(np.isfinite(range_m), axis=0)
    ordered = np.sort(range_m.astype(np.float64), axis=0)  # NaN goes last
    middle: F64 = ordered[n_held // 2, np.arange(range_m.shape[1])] if len(range_m) else np.empty(0)
    return np.where(2 * n_held > len(range_m), middle, np.nan)


def _fill(
    angle_rad: F64, middle_m: F64, held: NDArray[np.intp], down_rad: float, step_rad: float
) -> tuple[float, NDArray[np.intp]]:
    """Return how well a plane straight below fills the lines, nearer ones better, and the columns that see it."""
    off = np.abs(wrap(angle_rad[held] - down_rad))
    near = held[off < REACH_RAD]
    if not len(near):
        return 0.0, near
    depth = middle_m[near] * np.cos(angle_rad[near] - down_rad)
    counts = np.bincount(np.minimum(depth / BIN_M, 1000).astype(np.int64))
    fullest = int(np.argmax(counts))
    inside = near[np.abs(depth - (fullest + 0.5) * BIN_M) < BIN_M]
    return len(inside) * step_rad / math.sqrt((fullest + 0.5) * BIN_M), inside
