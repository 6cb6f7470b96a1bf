"""Loops of the calibration: thresholds from which on a shot is supported, or background (Lehtola et al. 2019)."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F32, F64, I64
from prc_cli.kernels.cache import helper, kernel


@helper
def _kth_smallest(values: F32, n: int, k: int) -> np.float32:
    """Return the k-th smallest of the first n values, which it sorts; -1 for k = 0, infinity where there are fewer."""
    if k == 0:
        return np.float32(-1.0)
    if n < k:
        return np.float32(np.inf)
    for i in range(1, n):
        value = values[i]
        j = i - 1
        while j >= 0 and values[j] > value:
            values[j + 1] = values[j]
            j -= 1
        values[j + 1] = value
    return np.float32(values[k - 1])


@helper
def _first_above(limits: F64, value: float) -> int:
    """Return the place of the first limit above a value, the number of limits if there is none."""
    low, high = 0, len(limits)
    while low < high:
        middle = (low + high) // 2
        if value < limits[middle]:
            high = middle
        else:
            low = middle + 1
    return low


@kernel("int64[:, ::1](float32[::1], int64, int64, float64[::1], float64[::1], int64, int64)")
def support_histogram(
    window: F32, n_lines: int, n_columns: int, zetas_p: F64, zetas_s: F64, min_in_slice: int, min_adjacent: int
) -> I64:
    """Count returns by the first pair of thresholds that supports them.

    A shot is supported when its k-th smallest range difference in the line is below zeta_p and that to adjacent lines
    below zeta_s (eqs. 4 to 8): two numbers a shot answer for all thresholds.

    Parameters
    ----------
    window : (reach + n_lines * n_columns + reach,) float32, metres
        As in :func:`prc_cli.kernels.support.support_mask`.
    n_lines, n_columns : int
        Shape of the block.
    zetas_p, zetas_s : (P,), (Q,) float64, metres
        Ascending thresholds.
    min_in_slice, min_adjacent : int
        Neighbours that must agree, of 8 and of 6.

    Returns
    -------
    (P + 1, Q + 1) int64
        Cell (p, q): returns for which ``zetas_p[p]`` and ``zetas_s[q]`` are the first thresholds that are wide enough;
        the last row and column hold those that no threshold supports.
    """
    reach = max(n_columns + 1, 4)
    counts = np.zeros((len(zetas_p) + 1, len(zetas_s) + 1), np.int64)
    near = np.empty(8, np.float32)
    shifts = np.array([-n_columns - 1, -n_columns, -n_columns + 1, n_columns - 1, n_columns, n_columns + 1])
    for i in range(reach, reach + n_lines * n_columns):
        r = window[i]
        if np.isnan(r):
            continue
        n = 0
        for shift in range(-4, 5):
            difference = abs(r - window[i + shift])
            if shift != 0 and not np.isnan(difference):
                near[n] = difference
                n += 1
        in_slice = _kth_smallest(near, n, min_in_slice)
        n = 0
        for shift in shifts:
            # with one shot a line, i + M - 1 is i itself: a shot does not support itself
            difference = abs(r - window[i + shift])
            if shift != 0 and not np.isnan(difference):
                near[n] = difference
                n += 1
        adjacent = _kth_smallest(near, n, min_adjacent)
        counts[_first_above(zetas_p, np.float64(in_slice)), _first_above(zetas_s, np.float64(adjacent))] += 1
    return counts


@kernel("int64[::1](float32[::1], int64, int64, float64[::1], float64)")
def bend_histogram(window: F32, n_lines: int, n_columns: int, lengths: F64, alpha: float) -> I64:
    """Count returns by the first length d_c at which they are no longer extended background (eq. 9, centred).

    A shot between neighbours a and b is marked when its bend ``|r - (a + b) / 2|`` is at least
    ``(1/2 - alpha) * max(|b - a|, d_c)``: never when the first of the two asks for more, else up to one d_c.

    Parameters
    ----------
    window : (reach + n_lines * n_columns + reach,) float32, metres
        As in :func:`prc_cli.kernels.support.support_mask`.
    n_lines, n_columns : int
        Shape of the block.
    lengths : (D,) float64, metres
        Ascending values of d_c.
    alpha : float
        Tolerance ratio.

    Returns
    -------
    (D + 1,) int64
        Cell d: returns between two returns that are marked at ``lengths[:d]`` and not from ``lengths[d]`` on.
    """
    reach = max(n_columns + 1, 4)
    slack = 0.5 - alpha
    limits = slack * lengths
    counts = np.zeros(len(lengths) + 1, np.int64)
    for i in range(reach, reach + n_lines * n_columns):
        r, a, b = np.float64(window[i]), np.float64(window[i - 1]), np.float64(window[i + 1])
        bend = abs(r - (a + b) / 2.0)
        if np.isnan(bend):
            continue
        counts[_first_above(limits, bend) if bend >= slack * abs(b - a) else 0] += 1
    return counts
