"""Loops that grow the non-smooth surfaces (Lehtola et al. 2019, II-E)."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import Mask
from prc_cli.kernels.cache import kernel


@kernel("boolean[:, ::1](boolean[:, ::1], int64)")
def dilate(image: Mask, iterations: int) -> Mask:
    """Dilate a binary image with the 4-neighbour cross; outside the image is background.

    Parameters
    ----------
    image : (n_lines, n_columns) bool
    iterations : int
        Times to dilate; 0 gives a copy.

    Returns
    -------
    (n_lines, n_columns) bool
    """
    n_lines, n_columns = image.shape
    last = n_columns - 1
    grown = image.copy()
    before = np.empty_like(image)
    for _ in range(iterations):
        grown, before = before, grown
        for line in range(n_lines):
            row = grown[line]
            own = before[line]
            up = before[max(line - 1, 0)]
            down = before[min(line + 1, n_lines - 1)]
            for h in range(n_columns):
                row[h] = own[h] | up[h] | down[h]
            for h in range(last):
                row[h] |= own[h + 1]
            for h in range(last):
                row[h + 1] |= own[h]
    return grown
