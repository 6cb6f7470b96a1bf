"""Tests recorded scan angles against themselves and against x, y, z.

Mends angles that were cut off.

The distance between two points of a line follows from both ranges and the angle between the shots,
wherever the scanner stood and however it was turned. So registered coordinates tell whether ranges
and angles are those of the shots.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64, I64, Mask

ANGLES = "input.angles"
CONTINUED = "continued"
NOT_USED = "measured from the ranges"
CONTRADICTED = "contradicted"
"""Values of the assumption on recorded angles that are not those of the shots."""

LEAST_STUCK = 8
"""Fewer columns at one extreme angle may be rounded."""
STUCK_RUNS = 3.0
"""Columns at one extreme angle are this many times more than usually share an angle."""
EVEN_RAD = math.radians(2.0)
"""Angles of the other columns lie this near to a straight line."""
APART = 60
"""Shots are compared with those a 60th of a line later.

Rounding of angles and coordinates is small beside that.
"""
LEAST_APART_M = 0.1
"""Nearer points are rounded too coarsely."""
ALONG = 0.7
"""Pairs measure the angle if their ranges differ by less than this share of their distance."""
OFF = 0.2
OFF_M = 0.03
"""Tolerance of the distance between two points, as a share and in metres."""
LEAST_PAIRS = 4
"""Fewer pairs of a column tell nothing."""
LEAST_COLUMNS = 16
"""Fewer columns tell nothing."""
MOST_BACK = 0.1
"""Largest share of columns whose angles run against the others."""
MOST_OFF = 0.1
"""Largest share of columns whose points are at other distances than range and angle say."""


def stuck_columns(angle_rad: F64) -> Mask:
    """Mark the columns, (M,) bool, whose angles are cut off at the least or the greatest one.

    >>> angles = np.deg2rad(np.clip(np.linspace(-160, 159, 320), -90, 90))
    >>> int(np.count_nonzero(stuck_columns(angles)))
    141
    """
    is_stuck = np.zeros(len(angle_rad), np.bool_)
    if len(angle_rad) < LEAST_COLUMNS:
        return is_stuck
    borders = np.flatnonzero(np.diff(angle_rad) != 0)
    usual = float(np.median(np.diff(borders))) if len(borders) > 1 else 1.0
    for extreme in (angle_rad.min(), angle_rad.max()):
        at_extreme = np.isclose(angle_rad, extreme, rtol=0.0, atol=1e-6)
        if np.count_nonzero(at_extreme) >= max(LEAST_STUCK, STUCK_RUNS * usual):
            is_stuck |= at_extreme
    return is_stuck


def continued(angle_rad: F64, is_stuck: Mask) -> F64 | None:
    """Return angles with those that are cut off on the line of the others.

    None if these are not even.

    >>> true = np.deg2rad(np.linspace(-160, 159, 320))
    >>> cut = np.clip(true, -1.5, 1.5)
    >>> bool(np.allclose(continued(cut, stuck_columns(cut)), true))
    True
    """
    column = np.arange(len(angle_rad), dtype=np.float64)
    free = np.flatnonzero(~is_stuck)
    if len(free) < LEAST_COLUMNS:
        return None
    slope, start = np.polyfit(column[free], angle_rad[free], 1)
    line = start + slope * column
    is_even = float(np.abs(line - angle_rad)[free].max()) < EVEN_RAD
    turn = abs(slope) * (len(column) - 1)
    return np.where(is_stuck, line, angle_rad) if is_even and turn < 2 * math.pi else None


def turns_back(angle_rad: F64) -> bool:
    """Return whether angles run back within the line, as those without their sign do.

    >>> turns_back(np.abs(np.linspace(-2, 2, 300))), turns_back(np.linspace(-2, 6, 300) % 6.28)
    (True, False)
    """
    lag = max(len(angle_rad) // APART, 1)
    along = np.unwrap(angle_rad)
    turned = along[lag:] - along[:-lag]
    least = min(np.count_nonzero(turned > 0), np.count_nonzero(turned < 0))
    return bool(len(angle_rad) >= LEAST_COLUMNS and least > MOST_BACK * len(turned))


def contradicted_share(
    range_m: F64,
    xyz_m: F64,
    line: I64,
    column: I64,
    angle_rad: F64,
) -> float | None:
    """Return the share of columns whose points contradict range and angle.

    None if there are too few.

    Parameters
    ----------
    range_m : (n,) float64 [m]
    xyz_m : (n, 3) float64 [m]
        In any frame that moves little in a 60th of a line.
    line, column : (n,) int64
    angle_rad : (M,) float64 [rad]
        Scan angle of every column.
    """
    m = len(angle_rad)
    lag = max(m // APART, 1)
    is_cell: Mask = (column >= 0) & (column < m) & np.isfinite(range_m) & (range_m > 0)
    is_cell &= np.isfinite(xyz_m).all(axis=1)
    cell = (line * m + column)[is_cell]
    order = np.argsort(cell, kind="stable")
    cell = cell[order]
    range_m = range_m[is_cell][order]
    xyz_m = xyz_m[is_cell][order]
    # the first shot of a cell whose column is not the last
    later = np.searchsorted(cell, cell + lag)
    later = np.minimum(later, len(cell) - 1) if len(cell) else later
    is_pair = (
        (cell[later] == cell + lag) & (cell % m + lag < m) if len(cell) else np.zeros(0, np.bool_)
    )
    first = np.flatnonzero(is_pair)
    second = later[is_pair]
    start = cell[first] % m
    return _share_off(
        range_m, xyz_m, first, second, start, angle_rad[start + lag] - angle_rad[start], m
    )


def _share_off(
    range_m: F64,
    xyz_m: F64,
    first: I64,
    second: I64,
    column: I64,
    turned: NDArray[np.float64],
    m: int,
) -> float | None:
    near = range_m[first]
    far = range_m[second]
    with np.errstate(over="ignore", invalid="ignore"):
        apart = np.sqrt(((xyz_m[first] - xyz_m[second]) ** 2).sum(axis=1))
        expected = np.sqrt(
            np.maximum(near * near + far * far - 2 * near * far * np.cos(turned), 0.0)
        )
        tells = (apart > LEAST_APART_M) & (np.abs(near - far) < ALONG * apart)
        is_off = np.abs(expected - apart) > OFF * apart + OFF_M
    n_pairs = np.bincount(column[tells], minlength=m)
    n_off = np.bincount(column[tells & is_off], minlength=m)
    known = n_pairs >= LEAST_PAIRS
    if np.count_nonzero(known) < LEAST_COLUMNS:
        return None
    return float(np.mean(2 * n_off[known] > n_pairs[known]))
