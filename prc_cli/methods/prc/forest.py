"""Classes in the forest (Lehtola et al. 2019, II-F): ground, stems, other vegetation, noise."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from prc_cli import kernels
from prc_cli.core.classes import Label
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8, Mask
from prc_cli.methods.prc.surfaces import Surfaces


class ForestParams(Params):
    """Which columns of a block are ground (``[prc.forest]``)."""

    column_step: int = Field(
        10, ge=1, le=1_000_000, description="columns that are ground, or not, together; the first one of them decides"
    )
    density: float = Field(
        1 / 3, ge=0, le=1, description="share of smooth shots in a column above which it is ground, of all k lines"
    )
    noise_in_ground_columns: bool = Field(
        True, description="noise in ground columns becomes ground, as printed; false keeps it noise"
    )


@stage("classes")
def forest(window: F32, surfaces: Surfaces, params: ForestParams) -> U8:
    """Label a block of forest.

    ``window`` (reach + lines * M + reach,) float32, metres; returns (lines, M) uint8.
    """
    dense = is_dense(surfaces.smooth, params)
    columns = np.repeat(dense, params.column_step)[: surfaces.supported.shape[1]]
    labels_of = np.array([Label.MISSING, Label.NOISE, Label.GROUND, Label.VEGETATION, Label.STEM], dtype=np.uint8)
    return kernels.draw_columns(
        window, surfaces.supported, surfaces.covered, columns, params.noise_in_ground_columns, labels_of
    )


def is_dense(smooth: Mask, params: ForestParams) -> Mask:
    """Return for every group of columns whether its first column is dense: smooth often enough (eq. 12).

    Noise and missing shots count in the denominator.

    >>> is_dense(np.zeros((255, 4270), dtype=bool), ForestParams()).shape
    (427,)
    """
    dense: Mask = np.count_nonzero(smooth[:, :: params.column_step], axis=0) / len(smooth) > params.density
    return dense
