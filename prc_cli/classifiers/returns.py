"""Labels of further returns: each takes the label of the neighbouring shot that is nearest in range."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, I32, U8

IN_SLICE = tuple((0, column) for column in range(-4, 5))
"""Cells compared in the line of the shot, as (line, column) offsets."""
ADJACENT = tuple((line, column) for line in (-1, 1) for column in (-1, 0, 1))
"""Cells compared in the lines before and after."""


@stage("further returns")
def label_extra_returns(
    range_m: F32,
    labels: U8,
    line: I32,
    column: I32,
    range_m_extra: F32,
    zeta_p: float,
    zeta_s: float,
    *,
    alone: Label = Label.NOISE,
) -> U8:
    """Label the returns of shots that are not in the range image.

    A further return takes the label of the shot with the smallest range difference around its own cell, if the
    difference is below the support thresholds of Lehtola et al. (2019), eqs. 5 and 6. Only cells of the block are
    compared.

    Parameters
    ----------
    range_m : (lines, M) float32, metres
        The block; NaN = missing, never agrees.
    labels : (lines, M) uint8
        Its labels.
    line, column : (n,) int32
        Cell of every further return.
    range_m_extra : (n,) float32, metres
        Its range.
    zeta_p, zeta_s : float, metres
        Differences must be below these, in the line and in the lines before and after.
    alone : Label
        Label of a further return that agrees with no shot.

    Returns
    -------
    (n,) uint8
        ``alone`` where no shot agrees, MISSING where the further return has no range (NaN). On ties, cells of the
        same line come first, then the order of the stream.

    Examples
    --------
    A second return behind a leaf agrees with the wall beside it:

    >>> image = np.array([[20.0, 20.0, 6.0, 20.0, 20.0]], dtype=np.float32)
    >>> labels = np.array([[4, 4, 5, 4, 4]], dtype=np.uint8)
    >>> label_extra_returns(image, labels, np.array([0]), np.array([2]), np.array([20.1], np.float32), 1.0, 1.0)
    array([4], dtype=uint8)
    """
    found = np.where(np.isnan(range_m_extra), np.uint8(Label.MISSING), np.uint8(alone))
    if not len(found):
        return found
    nearest = np.full(len(line), np.inf)
    n_lines, n_columns = range_m.shape
    for cells, zeta in ((IN_SLICE, zeta_p), (ADJACENT, zeta_s)):
        for lines_away, columns_away in cells:
            y, x = line + lines_away, column + columns_away
            exists = (y >= 0) & (y < n_lines) & (x >= 0) & (x < n_columns)
            y, x = np.where(exists, y, 0), np.where(exists, x, 0)
            difference = np.abs(range_m_extra - range_m[y, x]).astype(np.float64)
            better = exists & (difference < zeta) & (difference < nearest)
            nearest[better] = difference[better]
            found[better] = labels[y, x][better]
    return found
