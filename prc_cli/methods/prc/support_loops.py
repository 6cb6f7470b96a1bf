"""Loops over shots and their neighbours: support and background (Lehtola et al. 2019, II-B, II-C).

Both read a *window* of the stream: the ranges of the block with ``reach`` shots before and after
it, NaN where there is nothing, so that neighbours by flat index are plain shifts. Neighbours are
slices of the window, one a shift, because the compiler turns loops over slices into vector
instructions but not loops over offsets.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.loops import loop
from prc_cli.core.types import F32_1, Mask_2

CENTRED = 0
LITERAL = 1
ABS = 2
GUARD = 3
"""Readings of eq. 9, as numbers."""


@loop("prc_cli.reference.prc.stages")
def support_mask(
    window: F32_1,
    n_lines: int,
    n_columns: int,
    zeta_p: float,
    zeta_s: float,
    min_in_slice: int,
    min_adjacent: int,
) -> Mask_2:
    """Mark shots that enough neighbours in their line and in adjacent lines agree with (eqs. 4-8).

    ``window`` (reach + n_lines * n_columns + reach,) float32, metres; returns (n_lines, n_columns)
    bool.
    """
    # differences are float32: below zeta means below the smallest float32 that is not below zeta
    limit_p = np.float32(zeta_p)
    if np.float64(limit_p) < zeta_p:
        limit_p = np.nextafter(limit_p, np.float32(np.inf))
    limit_s = np.float32(zeta_s)
    if np.float64(limit_s) < zeta_s:
        limit_s = np.nextafter(limit_s, np.float32(np.inf))
    reach = max(n_columns + 1, 4)
    # with one shot a line, i + M - 1 is i itself: a shot does not support itself
    has_neighbours = n_columns > 1
    size = n_columns
    supported = np.empty((n_lines, n_columns), np.bool_)
    for line in range(n_lines):
        i = reach + line * n_columns
        ranges = window[i : i + size]
        before_4 = window[i - 4 : i - 4 + size]
        before_3 = window[i - 3 : i - 3 + size]
        before_2 = window[i - 2 : i - 2 + size]
        before_1 = window[i - 1 : i - 1 + size]
        after_1 = window[i + 1 : i + 1 + size]
        after_2 = window[i + 2 : i + 2 + size]
        after_3 = window[i + 3 : i + 3 + size]
        after_4 = window[i + 4 : i + 4 + size]
        last_1 = window[i - size - 1 : i - 1]
        last_2 = window[i - size : i]
        last_3 = window[i - size + 1 : i + 1]
        next_1 = window[i + size - 1 : i + 2 * size - 1]
        next_2 = window[i + size : i + 2 * size]
        next_3 = window[i + size + 1 : i + 2 * size + 1]
        row = supported[line]
        for h in range(size):
            r = ranges[h]
            in_slice = (
                # numba counts added booleans, NumPy joins them: with an integer both count
                0
                + (abs(r - before_4[h]) < limit_p)
                + (abs(r - before_3[h]) < limit_p)
                + (abs(r - before_2[h]) < limit_p)
                + (abs(r - before_1[h]) < limit_p)
                + (abs(r - after_1[h]) < limit_p)
                + (abs(r - after_2[h]) < limit_p)
                + (abs(r - after_3[h]) < limit_p)
                + (abs(r - after_4[h]) < limit_p)
            )
            adjacent = (
                0
                + (abs(r - last_1[h]) < limit_s)
                + (abs(r - last_2[h]) < limit_s)
                + ((abs(r - last_3[h]) < limit_s) & has_neighbours)
                + ((abs(r - next_1[h]) < limit_s) & has_neighbours)
                + (abs(r - next_2[h]) < limit_s)
                + (abs(r - next_3[h]) < limit_s)
            )
            row[h] = (in_slice >= min_in_slice) & (adjacent >= min_adjacent) & (r == r)
    return supported


@loop("prc_cli.reference.prc.stages")
def background_mask(
    window: F32_1,
    supported: Mask_2,
    form: int,
    alpha: float,
    d_c: float,
) -> Mask_2:
    """Mark supported shots where the range changes too abruptly for one smooth surface (eq. 9).

    ``window`` (reach + n_lines * n_columns + reach,) float32, metres; ``supported`` (n_lines,
    n_columns) bool; returns (n_lines, n_columns) bool.
    """
    n_lines, size = supported.shape
    reach = max(size + 1, 4)
    slack = 0.5 - alpha
    upper = 1.0 - alpha
    marked = np.empty((n_lines, size), np.bool_)
    for line in range(n_lines):
        i = reach + line * size
        ranges = window[i : i + size]
        before = window[i - 1 : i - 1 + size]
        after = window[i + 1 : i + 1 + size]
        inside = supported[line]
        row = marked[line]
        # comparisons with NaN are false, which leaves shots beside a missing one unmarked, ...
        if form in (CENTRED, GUARD):
            least = d_c if form == GUARD else 0.0
            for h in range(size):
                r = np.float64(ranges[h])
                a = np.float64(before[h])
                b = np.float64(after[h])
                rise = abs(b - a)
                bend = abs(r - (a + b) / 2.0)
                row[h] = (bend >= slack * max(rise, d_c)) & (rise >= least) & inside[h]
        else:
            for h in range(size):
                r = np.float64(ranges[h])
                a = np.float64(before[h])
                b = np.float64(after[h])
                step = r - a
                rise = b - a
                if form == ABS:
                    step = abs(step)
                    rise = abs(rise)
                share = step / max(rise, d_c)
                # ... except in a negation: there NaN needs a test of its own
                row[h] = (not (alpha < share < upper)) & (a == a) & (b == b) & inside[h]
    return marked
