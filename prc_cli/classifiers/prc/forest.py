"""Classes in the forest (Lehtola et al. 2019, II-F): ground, stems, other vegetation, noise."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from prc_cli.core.classes import Label
from prc_cli.core.config import Params
from prc_cli.core.types import U8, Mask


class ForestParams(Params):
    """Which columns of a block look at the ground (``[prc.forest]``)."""

    column_step: int = Field(
        10, ge=1, le=1_000_000, description="columns that are ground, or not, together; the first one of them decides"
    )
    density: float = Field(
        1 / 3, ge=0, le=1, description="share of smooth shots in a column above which it is ground, of all k lines"
    )
    noise_in_ground_columns: bool = Field(
        True, description="noise in ground columns becomes ground, as printed; false keeps it noise"
    )


def forest(missing: Mask, supported: Mask, smooth: Mask, params: ForestParams) -> U8:
    """Label a block of forest.

    Parameters
    ----------
    missing : (lines, M) bool
        Shots without return.
    supported : (lines, M) bool
        S.
    smooth : (lines, M) bool
        Smooth shots.
    params : ForestParams

    Returns
    -------
    (lines, M) uint8
        In ground columns all returns GROUND; elsewhere smooth shots STEM, non-smooth ones VEGETATION, the rest NOISE.

    Examples
    --------
    Two of three shots of column 0 are smooth, so columns 0 and 1 are ground; column 2 decides for itself alone:

    >>> smooth = np.array([[1, 0, 0], [1, 1, 1], [0, 0, 0]], dtype=bool)
    >>> nothing = np.zeros((3, 3), dtype=bool)
    >>> forest(nothing, smooth, smooth, ForestParams(column_step=2))
    array([[3, 3, 2],
           [3, 3, 6],
           [3, 3, 2]], dtype=uint8)
    """
    labels = np.full(supported.shape, Label.NOISE, dtype=np.uint8)
    labels[supported] = Label.VEGETATION
    labels[smooth] = Label.STEM
    dense = is_dense(smooth, params)
    columns = np.repeat(dense, params.column_step)[: supported.shape[1]]
    overwritten = ~missing if params.noise_in_ground_columns else supported
    labels[overwritten & columns] = Label.GROUND
    return labels


def is_dense(smooth: Mask, params: ForestParams) -> Mask:
    """Tell for every group of columns whether its first one is smooth often enough (eq. 12).

    Noise and missing shots count in the denominator.

    Returns
    -------
    (ceil(M / column_step),) bool

    Examples
    --------
    >>> is_dense(np.zeros((255, 4270), dtype=bool), ForestParams()).shape
    (427,)
    """
    dense: Mask = np.count_nonzero(smooth[:, :: params.column_step], axis=0) / len(smooth) > params.density
    return dense
