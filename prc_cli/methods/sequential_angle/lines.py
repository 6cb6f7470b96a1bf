"""Vertical scan lines, beams from low to high: the input of all stages.

Stamos et al. (2012), sec. 3.

A line of a static scanner is one vertical line. A line of a profiler with a full circle is split at
nadir and zenith into two half-lines, one per side. Rows are half-lines: ``row = line * n_sides +
side``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.profile import stage
from prc_cli.core.types import F32, F64, I32
from prc_cli.methods.sequential_angle.labels_loops import arrange_lines, arrange_plane


@dataclass(frozen=True, slots=True, eq=False)
class Sides:
    """Columns of a scan line that make up its half-lines, from low to high."""

    columns: I32
    """(n_sides, n) int32, column of every beam; -1 = fill of the shorter side."""
    n_beams: I32
    """(n_sides,) int32, beams of every side."""
    beam_rad: F64
    """(n_sides, n) float64, angle of every beam from straight down [rad], rising; NaN = fill."""

    @property
    def n_sides(self) -> int:
        """1 or 2."""
        return len(self.n_beams)


@dataclass(frozen=True, slots=True, eq=False)
class VerticalLines:
    """Half-lines of consecutive scan lines, their beams from low to high; R rows of n beams."""

    range_m: F32
    """(R, n) float32, slant range [m]; NaN = missing, also beyond the scanner's reach."""
    xyz_m: F32
    """(R, n, 3) float32, relative to the scanner, z up [m]; NaN = missing."""
    horizontal_m: F32
    """(R, n) float32, horizontal distance from the scanner [m]; NaN = missing."""
    n_beams: I32
    """(R,) int32, beams of every row; entries after them are fill, not missing shots."""
    beam_rad: F64
    """(n_sides, n) float64, angle of every beam from straight down [rad], rising; NaN = fill."""

    @property
    def n_sides(self) -> int:
        """Half-lines of a scan line, 1 or 2."""
        return len(self.beam_rad)


def split_sides(beam_rad: F64) -> Sides:
    """Split the columns of a scan line at nadir and zenith.

    ``beam_rad`` (M,) float64.

    >>> split_sides(np.deg2rad([-100.0, -50.0, 0.0, 50.0, 100.0])).columns
    array([[ 2,  3,  4],
           [ 1,  0, -1]], dtype=int32)
    """
    grows = np.sign(np.diff(np.unwrap(beam_rad))).sum() >= 0
    # columns in the direction of growing angles, so that equal angles keep their order
    turning = np.arange(len(beam_rad)) if grows else np.arange(len(beam_rad))[::-1]
    angle = beam_rad[turning]
    halves = (turning[angle >= 0], turning[angle < 0][::-1])
    sides = [
        half[np.argsort(np.abs(beam_rad[half]), kind="stable")] for half in halves if len(half)
    ]
    n = max(len(columns) for columns in sides)
    order = np.full((len(sides), n), -1, np.int32)
    angles = np.full((len(sides), n), np.nan)
    for side, columns in enumerate(sides):
        order[side, : len(columns)] = columns
        angles[side, : len(columns)] = np.abs(beam_rad[columns])
    return Sides(order, np.array([len(columns) for columns in sides], np.int32), angles)


@stage("vertical lines")
def vertical_lines(
    range_m: F32,
    xyz_m: F32 | None,
    beam_rad: F64,
    sides: Sides,
    max_range_m: float,
) -> VerticalLines:
    """Arrange a block of scan lines as half-lines.

    ``range_m`` (lines, M) float32; ``xyz_m`` (lines, M, 3) float32 or None; ``beam_rad`` (M,)
    float64.
    """
    if xyz_m is None:
        across = np.sin(beam_rad)
        up = -np.cos(beam_rad)
        ranges, xyz, horizontal = arrange_plane(range_m, across, up, sides.columns, max_range_m)
    else:
        ranges, xyz, horizontal = arrange_lines(range_m, xyz_m, sides.columns, max_range_m)
    return VerticalLines(
        ranges, xyz, horizontal, np.tile(sides.n_beams, len(range_m)), sides.beam_rad
    )


def to_columns(rows: NDArray[Any], sides: Sides, points_per_line: int) -> NDArray[Any]:
    """Map values per beam back to the columns of the scan lines.

    ``rows`` (R, n) array; returns (lines, M) array of the same dtype.
    """
    n_lines = len(rows) // sides.n_sides
    image = np.zeros((n_lines, points_per_line), rows.dtype)
    by_side = rows.reshape(n_lines, sides.n_sides, -1)
    for side in range(sides.n_sides):
        n = int(sides.n_beams[side])
        columns = sides.columns[side, :n]
        step = int(columns[1] - columns[0]) if n > 1 else 1
        # contiguous columns: a slice is many times faster
        if abs(step) == 1 and (np.diff(columns) == step).all():
            low, high = sorted((int(columns[0]), int(columns[-1])))
            image[:, low : high + 1] = by_side[:, side, :n][:, ::step]
        else:
            image[:, columns] = by_side[:, side, :n]
    return image
