"""Labels of further returns: each gets the label of the neighbouring shot nearest in range."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, I32, U8

IN_SLICE = tuple((0, column) for column in range(-4, 5))
"""Cells compared in the line of the shot, as (line, column) offsets."""
ADJACENT = tuple((line, column) for line in (-1, 1) for column in (-1, 0, 1))
"""Cells compared in the lines before and after."""
BESIDE = 4
"""Greatest distance of these cells, in columns."""


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

    A further return gets the label of the shot with the smallest range difference around its own
    cell, if the difference is below the support thresholds of Lehtola et al. (2019), eqs. 5 and 6.
    If there is no such shot, it gets ``alone``. Only cells of the block are compared.

    Parameters
    ----------
    range_m : (lines, M) float32
        First returns [m]; NaN = no return.
    labels : (lines, M) uint8
        Their labels.
    line, column : (n,) int32
        Cells of the further returns.
    range_m_extra : (n,) float32
        Ranges of the further returns [m].
    zeta_p, zeta_s : float
        Largest difference in the line of the shot and in adjacent lines [m].
    alone : Label
        Label of a further return without such a neighbour.

    Returns
    -------
    (n,) uint8

    Examples
    --------
    A second return behind a leaf agrees with the wall beside it:

    >>> image = np.array([[20.0, 20.0, 6.0, 20.0, 20.0]], dtype=np.float32)
    >>> labels = np.array([[4, 4, 5, 4, 4]], dtype=np.uint8)
    >>> line, column = np.array([0]), np.array([2])
    >>> range_m_extra = np.array([20.1], np.float32)
    >>> label_extra_returns(image, labels, line, column, range_m_extra, 1.0, 1.0)
    array([4], dtype=uint8)
    """
    labels_extra = np.where(np.isnan(range_m_extra), np.uint8(Label.MISSING), np.uint8(alone))
    if not len(labels_extra):
        return labels_extra
    n_lines, n_columns = range_m.shape
    # with empty cells around, all neighbours of a cell are as far from it in memory
    width = n_columns + 2 * BESIDE
    cells_m = np.full((n_lines + 2, width), np.nan, np.float32)
    cells_m[1:-1, BESIDE:-BESIDE] = range_m
    cells = cells_m.ravel()
    cell_of_shot = (line.astype(np.int64) + 1) * width + column + BESIDE
    least_m = np.full(len(line), np.inf)
    nearest_cell = np.full(len(line), -1)
    for around, zeta in ((IN_SLICE, zeta_p), (ADJACENT, zeta_s)):
        least_m = np.minimum(np.where(nearest_cell >= 0, least_m, np.inf), zeta)
        for lines_away, columns_away in around:
            cell = cell_of_shot + (lines_away * width + columns_away)
            difference_m = np.abs(range_m_extra - cells[cell])
            is_nearer = difference_m < least_m
            np.copyto(least_m, difference_m, where=is_nearer)
            np.copyto(nearest_cell, cell, where=is_nearer)
    agrees = nearest_cell >= 0
    padded_line, padded_column = np.divmod(nearest_cell[agrees], width)
    labels_extra[agrees] = labels[padded_line - 1, padded_column - BESIDE]
    return labels_extra
