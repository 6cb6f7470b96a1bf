"""Loops that arrange scan lines as half-lines (Stamos et al. 2012, sec. 3)."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F32, F64, I32
from prc_cli.kernels.cache import kernel


@kernel(
    "Tuple((float32[:, ::1], float32[:, :, ::1], float32[:, ::1]))"
    "(float32[:, ::1], float32[:, :, ::1], int32[:, ::1], float64)"
)
def arrange_lines(range_m: F32, xyz_m: F32, columns: I32, max_range_m: float) -> tuple[F32, F32, F32]:
    """Pick the beams of half-lines out of scan lines with coordinates.

    ``range_m`` (lines, M) float32; ``xyz_m`` (lines, M, 3) float32; ``columns`` (n_sides, n) int32; returns (lines *
    n_sides, n) float32, (lines * n_sides, n, 3) float32, (lines * n_sides, n) float32.
    """
    n_lines = range_m.shape[0]
    n_sides, n = columns.shape
    ranges = np.empty((n_lines * n_sides, n), np.float32)
    xyz = np.empty((n_lines * n_sides, n, 3), np.float32)
    horizontal = np.empty((n_lines * n_sides, n), np.float32)
    nan = np.float32(np.nan)
    for line in range(n_lines):
        for side in range(n_sides):
            row = line * n_sides + side
            for k in range(n):
                column = max(columns[side, k], 0)
                r = range_m[line, column]
                x, y, z = xyz_m[line, column, 0], xyz_m[line, column, 1], xyz_m[line, column, 2]
                seen = np.float64(r) <= max_range_m and not np.isnan(x + y + z) and columns[side, k] >= 0
                ranges[row, k] = r if seen else nan
                xyz[row, k, 0] = x if seen else nan
                xyz[row, k, 1] = y if seen else nan
                xyz[row, k, 2] = z if seen else nan
            for k in range(n):  # by itself, for vector instructions; NaN where the shot is missing
                x_here, y_here = np.float64(xyz[row, k, 0]), np.float64(xyz[row, k, 1])
                horizontal[row, k] = np.float32(np.sqrt(x_here * x_here + y_here * y_here))
    return ranges, xyz, horizontal


@kernel(
    "Tuple((float32[:, ::1], float32[:, :, ::1], float32[:, ::1]))"
    "(float32[:, ::1], float64[::1], float64[::1], int32[:, ::1], float64)"
)
def arrange_plane(range_m: F32, across: F64, up: F64, columns: I32, max_range_m: float) -> tuple[F32, F32, F32]:
    """Pick the beams of half-lines out of scan lines of ranges; coordinates are those in the scan plane.

    ``range_m`` (lines, M) float32; ``across, up`` (M,) float64; ``columns`` (n_sides, n) int32; returns (lines *
    n_sides, n) float32, (lines * n_sides, n, 3) float32, (lines * n_sides, n) float32.
    """
    n_lines = range_m.shape[0]
    n_sides, n = columns.shape
    ranges = np.full((n_lines * n_sides, n), np.nan, np.float32)
    xyz = np.full((n_lines * n_sides, n, 3), np.nan, np.float32)
    horizontal = np.full((n_lines * n_sides, n), np.nan, np.float32)
    for line in range(n_lines):
        for side in range(n_sides):
            row = line * n_sides + side
            for k in range(n):
                column = columns[side, k]
                if column < 0:
                    continue
                r = np.float64(range_m[line, column])
                if r <= max_range_m:
                    x = r * across[column]
                    ranges[row, k] = range_m[line, column]
                    xyz[row, k, 0] = np.float32(x)
                    xyz[row, k, 1] = np.float32(0.0)
                    xyz[row, k, 2] = np.float32(r * up[column])
                    horizontal[row, k] = np.float32(abs(x))
    return ranges, xyz, horizontal
