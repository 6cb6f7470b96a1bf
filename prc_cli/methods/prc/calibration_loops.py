"""Loops of the calibration: the thresholds from which on a shot is supported, or background.

The rules are those of Lehtola et al. (2019).
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.loops import helper, loop
from prc_cli.core.types import F32, F32_1, F64, F64_1, I64_1, I64_2, Mask_2


@helper
def _keep_smallest(smallest: F32, differences: F32) -> None:
    """Sort differences (n,) into the k smallest of every shot, (k, n) ascending.

    Overwrites ``differences``. The inner loop is over shots, so that the compiler turns it into
    vector instructions.
    """
    for j in range(len(smallest)):
        row = smallest[j]
        for h in range(len(differences)):
            kept = row[h]
            new = differences[h]
            row[h] = kept if kept < new else new
            differences[h] = new if kept < new else kept


@helper
def _first_above(limits: F64, value: float) -> int:
    """Return the place of the first limit above a value, the number of limits if there is none."""
    # halves without a branch that the processor could mispredict
    low = 0
    left = len(limits)
    while left > 0:
        half = (left + 1) // 2
        low += half * (value >= limits[low + half - 1])
        left -= half
    return low


@loop()
def support_histogram(
    window: F32_1,
    n_lines: int,
    n_columns: int,
    zetas_p: F64_1,
    zetas_s: F64_1,
    min_in_slice: int,
    min_adjacent: int,
) -> I64_2:
    """Count returns by the first pair of thresholds that supports them.

    A shot is supported when its k-th smallest range difference in the line is below zeta_p and that
    to adjacent lines below zeta_s (eqs. 4 to 8): two numbers a shot answer for all thresholds.

    ``window`` (reach + n_lines * n_columns + reach,) float32, metres; ``zetas_p, zetas_s`` (P,),
    (Q,) float64, metres; returns (P + 1, Q + 1) int64.
    """
    reach = max(n_columns + 1, 4)
    counts = np.zeros((len(zetas_p) + 1, len(zetas_s) + 1), np.int64)
    nowhere = np.float32(np.inf)
    near = np.empty((min_in_slice, n_columns), np.float32)
    beside = np.empty((min_adjacent, n_columns), np.float32)
    differences = np.empty(n_columns, np.float32)
    in_slice = np.full(n_columns, -1.0, np.float32)
    adjacent = np.full(n_columns, -1.0, np.float32)
    shifts_adjacent = np.array(
        [-n_columns - 1, -n_columns, -n_columns + 1, n_columns - 1, n_columns, n_columns + 1]
    )
    for line in range(n_lines):
        i = reach + line * n_columns
        ranges = window[i : i + n_columns]
        near[:] = nowhere
        beside[:] = nowhere
        for place in range(-4, 5 + len(shifts_adjacent)):
            shift = place if place < 5 else shifts_adjacent[place - 5]
            # with one shot a line, i + M - 1 is i itself: a shot does not support itself
            if shift == 0:
                continue
            neighbour = window[i + shift : i + shift + n_columns]
            for h in range(n_columns):
                difference = abs(ranges[h] - neighbour[h])
                differences[h] = difference if difference < nowhere else nowhere
            _keep_smallest(near if place < 5 else beside, differences)
        if min_in_slice:
            in_slice[:] = near[min_in_slice - 1]
        if min_adjacent:
            adjacent[:] = beside[min_adjacent - 1]
        for h in range(n_columns):
            if not np.isnan(ranges[h]):
                p = _first_above(zetas_p, np.float64(in_slice[h]))
                counts[p, _first_above(zetas_s, np.float64(adjacent[h]))] += 1
    return counts


@loop()
def bend_histogram(
    window: F32_1,
    supported: Mask_2,
    lengths: F64_1,
    alpha: float,
) -> I64_1:
    """Count supported returns by the first d_c at which they are not background (eq. 9, centred).

    A shot between neighbours a and b is marked when its bend ``|r - (a + b) / 2|`` is at least
    ``(1/2 - alpha) * max(|b - a|, d_c)``: never when the first of the two asks for more, else up to
    one d_c.

    ``window`` (reach + n_lines * n_columns + reach,) float32, metres; ``supported`` (n_lines,
    n_columns) bool; ``lengths`` (D,) float64, metres; returns (D + 1,) int64.
    """
    n_lines, n_columns = supported.shape
    reach = max(n_columns + 1, 4)
    is_supported = supported.ravel()
    slack = 0.5 - alpha
    limits = slack * lengths
    counts = np.zeros(len(lengths) + 1, np.int64)
    for i in range(reach, reach + n_lines * n_columns):
        r = np.float64(window[i])
        a = np.float64(window[i - 1])
        b = np.float64(window[i + 1])
        bend = abs(r - (a + b) / 2.0)
        if np.isnan(bend) or not is_supported[i - reach]:
            continue
        counts[_first_above(limits, bend) if bend >= slack * abs(b - a) else 0] += 1
    return counts
