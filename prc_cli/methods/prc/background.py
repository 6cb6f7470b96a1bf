"""Extension of the background (Lehtola et al. 2019, II-C): supported shots where two surfaces meet."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, Mask

FORMS = {"centred": 0, "literal": 1, "abs": 2, "guard": 3}
"""Interpretations of eq. 9, and their numbers in the kernel."""


class BackgroundParams(Params):
    """Where a range changes too abruptly for one surface (``[prc.background]``)."""

    form: Literal["centred", "literal", "abs", "guard"] = Field(
        "centred",
        description='reading of eq. 9: "centred" measures how far a shot lies off the middle of its two neighbours, '
        '"literal" is the printed formula (flags every descending ramp and every flat), "abs" takes both differences '
        'in absolute value, "guard" is "centred" only where the neighbours differ by d_c or more',
    )
    alpha: float = Field(0.3, gt=0, lt=0.5, description="tolerance ratio")
    d_c: float = Field(
        0.05,
        gt=0,
        le=1e9,
        description="smallest characteristic length of things [m]; for a range noise above 3 mm take 17 times the "
        "noise or more",
    )


@stage("background")
def background(window: F32, supported: Mask, params: BackgroundParams) -> Mask:
    """Mark supported shots that become background for the segmentation (eq. 9).

    The default reads eq. 9 as centred: with neighbours a and b, a shot r is marked when
    ``|r - (a + b) / 2| >= (1/2 - alpha) * max(|b - a|, d_c)``. For |b - a| >= d_c this is eq. 9 itself, in both
    directions; below d_c, flat surfaces stay unmarked. Computed in float64. A shot beside a missing or absent one is
    not marked: it borders on background already. Ranges of unsupported neighbours are used.

    ``window`` (reach + lines * M + reach,) float32, metres; ``supported`` (lines, M) bool; returns (lines, M) bool.

    The two shots of a step are marked, the flats beside it are not:

    >>> import numpy as np
    >>> line = np.array([[20, 20, 20, 5, 5, 5]], dtype=np.float32)
    >>> window = np.pad(line.ravel(), 7, constant_values=np.nan)
    >>> background(window, np.ones((1, 6), dtype=bool), BackgroundParams()).astype(int)
    array([[0, 0, 1, 1, 0, 0]])
    """
    return kernels.background_mask(window, supported, FORMS[params.form], params.alpha, params.d_c)
