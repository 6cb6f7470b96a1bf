"""Slow and obvious twin of :mod:`prc_cli.kernels.sequential_angle.verticals`, from NumPy alone."""

from __future__ import annotations

from itertools import groupby

import numpy as np

from prc_cli.core.types import F32, I32, U8, Mask


def first_high_verticals(surface: U8, xyz_m: F32, n_beams: I32, ground_m: F32, height_m: float) -> tuple[Mask, I32]:
    """Find the first high vertical run; see :func:`prc_cli.kernels.sequential_angle.verticals.first_high_verticals`."""
    beam = np.full(len(n_beams), -1, np.int32)
    for row, n in enumerate(n_beams):
        runs = [(code, list(run)) for code, run in groupby(range(n), key=lambda k: int(surface[row, k]))]
        for code, run in runs:
            above = float(xyz_m[row, run[-1], 2]) > float(ground_m[row]) + height_m
            if code == 3 and above and beam[row] < 0:
                beam[row] = run[-1]
    return beam >= 0, beam
