"""High vertical surfaces, which no car lies behind (Stamos et al. 2012, sec. 7.4)."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Surface
from prc_cli.core.types import F32, I32, U8, Mask


def first_high_verticals(surface: U8, xyz_m: F32, n_beams: I32, ground_m: F32, height_m: float) -> tuple[Mask, I32]:
    """Find the first high vertical run; see :func:`verticals_loops.first_high_verticals`."""
    beam = np.full(len(n_beams), -1, np.int32)
    for row, n in enumerate(n_beams):
        vertical = surface[row, :n] == Surface.VERTICAL
        ends = np.flatnonzero(vertical & ~np.append(vertical[1:], False))
        high = ends[xyz_m[row, ends, 2].astype(np.float64) > float(ground_m[row]) + height_m]
        if len(high):
            beam[row] = high[0]
    return beam >= 0, beam
