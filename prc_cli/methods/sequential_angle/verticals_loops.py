"""The loop over beams that finds what no car lies behind (Stamos et al. 2012, sec. 7.4)."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Surface
from prc_cli.core.types import F32, I32, U8, Mask
from prc_cli.kernels.cache import kernel

_VERTICAL = int(Surface.VERTICAL)


@kernel("Tuple((boolean[::1], int32[::1]))(uint8[:, ::1], float32[:, :, ::1], int32[::1], float32[::1], float64)")
def first_high_verticals(surface: U8, xyz_m: F32, n_beams: I32, ground_m: F32, height_m: float) -> tuple[Mask, I32]:
    """Find the last beam of the first vertical run of every row that ends high above the ground.

    ``surface`` (R, n) uint8; ``xyz_m`` (R, n, 3) float32, metres; ``n_beams`` (R,) int32; ``ground_m`` (R,) float32,
    metres; returns ``found`` (R,) bool, ``beam`` (R,) int32.
    """
    n_rows = len(n_beams)
    found = np.zeros(n_rows, np.bool_)
    beam = np.full(n_rows, -1, np.int32)
    for row in range(n_rows):
        limit = np.float64(ground_m[row]) + height_m
        codes = surface[row]
        points = xyz_m[row]
        n = n_beams[row]
        for k in range(n):
            if codes[k] == _VERTICAL and (k + 1 == n or codes[k + 1] != _VERTICAL) and points[k, 2] > limit:
                found[row] = True
                beam[row] = k
                break
    return found, beam
