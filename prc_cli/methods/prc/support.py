"""Support and background: shots that enough neighbours agree with, and edges.

Lehtola et al. (2019), II-B and II-C.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
from pydantic import Field

from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.stream import CriticalZetas
from prc_cli.core.types import F32, Mask
from prc_cli.methods.prc.support_loops import (
    ABS,
    CENTRED,
    GUARD,
    LITERAL,
    background_mask,
    support_mask,
)

N_IN_SLICE = 8
"""Neighbours in the line: i - 4 .. i + 4 without i (eq. 8)."""
N_ADJACENT = 6
"""Neighbours in the lines before and after: i ± (M - 1), i ± M, i ± (M + 1) (eq. 7)."""


class SupportParams(Params):
    """Which neighbours agree with a shot, and how many have to (``[prc.support]``)."""

    zeta_s: float = Field(
        1.0,
        ge=0,
        le=1e9,
        description=(
            "neighbours in adjacent lines agree when their range differs by less than this [m]"
        ),
    )
    zeta_p: float = Field(
        1.0,
        ge=0,
        le=1e9,
        description=(
            "neighbours in the same line agree when their range differs by less than this [m]"
        ),
    )
    rho_c: float = Field(
        1 / 3,
        gt=0,
        le=1,
        description=(
            "share of the 8 neighbours in the line, and of the 6 in adjacent lines, that must agree"
        ),
    )
    rounding: Literal["ceil", "floor"] = Field(
        "ceil",
        description=(
            "how rho_c times 8 and times 6 become counts: "
            '"ceil" compares real numbers (3 and 2 for 1/3), '
            '"floor" rounds down (2 and 2, which is what the printed probabilities belong to)'
        ),
    )


def required_counts(params: SupportParams) -> tuple[int, int]:
    """Return how many neighbours must agree, in the line and in adjacent lines (eq. 4).

    >>> required_counts(SupportParams()), required_counts(SupportParams(rounding="floor"))
    ((3, 2), (2, 2))
    """
    rounded = math.ceil if params.rounding == "ceil" else math.floor
    return rounded(params.rho_c * N_IN_SLICE), rounded(params.rho_c * N_ADJACENT)


def unusual(params: SupportParams) -> str | None:
    """Return a notice if the paper advises against these thresholds (II-B).

    >>> unusual(SupportParams()), unusual(SupportParams(zeta_s=0.1, zeta_p=0.1))
    (None, None)
    >>> unusual(SupportParams(zeta_s=0.1))
    'prc.support.zeta_s = 0.1 m is below zeta_p = 1 m; shots of adjacent lines are farther apart
    than shots of one line'
    """
    if params.zeta_s >= params.zeta_p:
        return None
    return (
        f"prc.support.zeta_s = {params.zeta_s:g} m is below zeta_p = {params.zeta_p:g} m; "
        "shots of adjacent lines are farther apart than shots of one line"
    )


def window_reach(points_per_line: int) -> int:
    """Return how many shots before and after a block affect it: max(M + 1, 4)."""
    return max(points_per_line + 1, 4)


def stream_window(tail: F32, range_m: F32, next_m: F32 | None) -> F32:
    """Return a block with the shots before and after it, as one flat array.

    ``tail`` (reach,) float32, metres; ``range_m`` (lines, M) float32, metres; ``next_m`` (any
    number of lines, M) float32, metres; returns (reach + lines * M + reach,) float32, metres.
    """
    reach = len(tail)
    window = np.full(reach + range_m.size + reach, np.nan, dtype=np.float32)
    window[:reach] = tail
    window[reach : reach + range_m.size] = range_m.ravel()
    if next_m is not None:
        following = next_m.ravel()[:reach]
        window[reach + range_m.size : reach + range_m.size + len(following)] = following
    return window


def tail_after(tail: F32, range_m: F32) -> F32:
    """Return the tail for the next block: the last ``reach`` shots, (reach,) float32 [m]."""
    reach = len(tail)
    lines = -(-reach // range_m.shape[1])
    return np.concatenate([tail, range_m[-lines:].ravel()])[-reach:].copy()


@stage("support")
def support(window: F32, points_per_line: int, params: SupportParams) -> Mask:
    """Mark supported shots (eqs. 4 to 8).

    Neighbours are taken by flat index, so the first shots of a line are neighbours of the last ones
    of the line before. Missing and absent neighbours never agree, and do not lower the required
    counts.

    ``window`` (reach + lines * M + reach,) float32, metres; returns (lines, M) bool.

    An isolated shot at 9 m in front of a wall at 20 m is noise, the wall is not:

    >>> image = np.full((3, 6), 20.0, dtype=np.float32)
    >>> image[1, 2] = 9.0
    >>> window = stream_window(np.full(7, np.nan, dtype=np.float32), image, None)
    >>> support(window, 6, SupportParams()).astype(int)
    array([[1, 1, 1, 1, 1, 1],
           [1, 1, 0, 1, 1, 1],
           [1, 1, 1, 1, 1, 1]])
    """
    n_lines = (len(window) - 2 * window_reach(points_per_line)) // points_per_line
    min_in_slice, min_adjacent = required_counts(params)
    return support_mask(
        window, n_lines, points_per_line, params.zeta_p, params.zeta_s, min_in_slice, min_adjacent
    )


FORMS = {"centred": CENTRED, "literal": LITERAL, "abs": ABS, "guard": GUARD}
"""Interpretations of eq. 9, and their numbers in the loop."""


class BackgroundParams(Params):
    """Where a range changes too abruptly for one surface (``[prc.background]``)."""

    form: Literal["centred", "literal", "abs", "guard"] = Field(
        "centred",
        description=(
            "reading of eq. 9: "
            '"centred" measures how far a shot lies off the middle of its two neighbours, '
            '"literal" is the printed formula (flags every descending ramp and every flat), '
            '"abs" takes both differences in absolute value, '
            '"guard" is "centred" only where the neighbours differ by d_c or more'
        ),
    )
    alpha: float = Field(0.3, gt=0, lt=0.5, description="tolerance ratio")
    d_c: float = Field(
        0.05,
        gt=0,
        le=1e9,
        description=(
            "smallest characteristic length of things [m]; "
            "for a range noise above 3 mm take 17 times the noise or more"
        ),
    )


@stage("background")
def background(window: F32, supported: Mask, params: BackgroundParams) -> Mask:
    """Mark supported shots that become background for the segmentation (eq. 9).

    The default reads eq. 9 as centred: with neighbours a and b, a shot r is marked when
    ``|r - (a + b) / 2| >= (1/2 - alpha) * max(|b - a|, d_c)``. For |b - a| >= d_c this is eq. 9
    itself, in both directions; below d_c, flat surfaces stay unmarked. Computed in float64. A shot
    beside a missing or absent one is not marked: it borders on background already. Ranges of
    unsupported neighbours are used.

    ``window`` (reach + lines * M + reach,) float32, metres; ``supported`` (lines, M) bool; returns
    (lines, M) bool.

    The two shots of a step are marked, the flats beside it are not:

    >>> import numpy as np
    >>> line = np.array([[20, 20, 20, 5, 5, 5]], dtype=np.float32)
    >>> window = np.pad(line.ravel(), 7, constant_values=np.nan)
    >>> background(window, np.ones((1, 6), dtype=bool), BackgroundParams()).astype(int)
    array([[0, 0, 1, 1, 0, 0]])
    """
    return background_mask(window, supported, FORMS[params.form], params.alpha, params.d_c)


_IN_LINE = (-4, -3, -2, -1, 1, 2, 3, 4)


@stage("critical zeta")
def critical_zetas(window: F32, points_per_line: int, params: SupportParams) -> CriticalZetas:
    """Find the range differences from which on the shots of a block are supported (eqs. 4 to 8).

    ``window`` (reach + lines * M + reach,) float32, metres.

    A shot half a metre in front of a wall needs half a metre, the wall nothing:

    >>> image = np.full((3, 7), 20.0, dtype=np.float32)
    >>> image[1, 3] = 19.5
    >>> window = stream_window(np.full(8, np.nan, dtype=np.float32), image, None)
    >>> critical_zetas(window, 7, SupportParams()).in_line_m[1]
    array([0. , 0. , 0. , 0.5, 0. , 0. , 0. ], dtype=float32)
    """
    m = points_per_line
    reach = window_reach(m)
    shape = ((len(window) - 2 * reach) // m, m)
    # with one shot a line, i + M - 1 is i itself: a shot does not support itself
    beside = tuple(shift for shift in (-m - 1, -m, -m + 1, m - 1, m, m + 1) if shift)
    min_in_slice, min_adjacent = required_counts(params)
    missing = np.isnan(window[reach : len(window) - reach])
    zetas = []
    for shifts, k in ((_IN_LINE, min_in_slice), (beside, min_adjacent)):
        value = _kth_difference(window, reach, shifts, k)
        value[missing] = np.nan
        zetas.append(value.reshape(shape))
    return CriticalZetas(*zetas)


def _kth_difference(
    window: F32,
    reach: int,
    shifts: tuple[int, ...],
    k: int,
) -> F32:
    """Return the k-th smallest range difference of every shot to some neighbours [m].

    (shots,) float32, infinite for shots with fewer than k neighbours.
    """
    ranges = window[reach : len(window) - reach]
    smallest = np.full((max(k, 1), ranges.size), np.inf, np.float32)
    for shift in shifts:
        start = reach + shift
        new = np.abs(ranges - window[start : start + ranges.size])
        new[np.isnan(new)] = np.inf
        for row in smallest:  # as many values as are needed, in order
            larger = np.maximum(row, new)
            np.minimum(row, new, out=row)
            new = larger
    return smallest[k - 1] if k else np.zeros(ranges.size, np.float32)
