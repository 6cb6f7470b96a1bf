"""Rays of whole scan lines between the poses of a moving platform."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F64
from prc_cli.kernels.cache import kernel


@kernel("Tuple((float64[:, :, ::1], float64[:, :, ::1]))(float64[:, :, ::1], float64[:, :, :, ::1], float64[:, ::1])")
def aim_shots(position: F64, turn: F64, columns: F64) -> tuple[F64, F64]:
    """Place and turn every shot of every line, straight between the poses around it.

    ``position`` (lines, k + 1, 3) float64, metres; ``turn`` (lines, k + 1, 3, 3) float64; ``columns`` (M, 3) float64;
    returns ``origin`` (lines, M, 3) float64, ``direction`` (lines, M, 3) float64.
    """
    n_lines, n_knots = position.shape[0], position.shape[1] - 1
    m = columns.shape[0]
    origin = np.empty((n_lines, m, 3))
    direction = np.empty((n_lines, m, 3))
    for line in range(n_lines):
        for column in range(m):
            place = column * n_knots / m
            k = int(place)
            late = place - k
            x, y, z = columns[column, 0], columns[column, 1], columns[column, 2]
            square = 0.0
            for i in range(3):
                before = position[line, k, i]
                origin[line, column, i] = before + late * (position[line, k + 1, i] - before)
                here = turn[line, k, i, 0] * x + turn[line, k, i, 1] * y + turn[line, k, i, 2] * z
                after = turn[line, k + 1, i, 0] * x + turn[line, k + 1, i, 1] * y + turn[line, k + 1, i, 2] * z
                along = here + late * (after - here)
                direction[line, column, i] = along
                square += along * along
            length = np.sqrt(square)
            for i in range(3):
                direction[line, column, i] /= length
    return origin, direction
