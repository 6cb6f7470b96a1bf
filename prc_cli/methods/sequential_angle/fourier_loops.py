"""The spectrum of the signed angles in an interval, as far as its test needs it (Stamos et al. 2012, sec. 7.5)."""

from __future__ import annotations

import math

import numpy as np

from prc_cli.core.types import F32, F64, I32, Mask
from prc_cli.kernels.cache import boolean, float32, int32, kernel, record
from prc_cli.methods.sequential_angle.thresholds import FourierThresholds

_CHUNK = 64
"""Frequencies computed at once: enough for vector instructions, few enough to stop early."""

_TIE = 1e-9
"""Relative difference between two frequencies that counts as none: a spectrum is not computed more exactly."""


@kernel("void(float64[::1], int64, int64, float64[::1])")
def _powers(values: F64, first: int, n_frequencies: int, power: F64) -> None:
    """Compute the power of successive frequencies by Goertzel's recursion, all of them sample after sample.

    The loop over frequencies is the inner one because it is the one that vector instructions can take.
    """
    n = len(values)
    turn = np.empty(n_frequencies, np.float64)
    one = np.zeros(n_frequencies, np.float64)
    two = np.zeros(n_frequencies, np.float64)
    for k in range(n_frequencies):
        turn[k] = 2.0 * math.cos(2.0 * math.pi * (first + k) / n)
    odd = n % 2
    if odd:
        one[:] = values[0]
    for i in range(odd, n, 2):  # two samples a round, so that nothing has to be moved
        x, y = values[i], values[i + 1]
        for k in range(n_frequencies):
            newer = x + turn[k] * one[k] - two[k]
            one[k] = y + turn[k] * newer - one[k]
            two[k] = newer
    for k in range(n_frequencies):
        power[k] = max(0.0, one[k] * one[k] + two[k] * two[k] - turn[k] * one[k] * two[k])


@kernel("boolean(float64[::1], float64, float64)")
def _is_stable(values: F64, band: float, ratio: float) -> bool:
    """Tell whether no frequency from ``band * N`` up exceeds ``ratio`` times the largest one.

    With a ratio below 1 some frequency of the band exceeds that share of the largest of all if and only if one exceeds
    that share of the largest below the band. Hence first the few frequencies below the band, then those of the
    band until one exceeds; and none of them when all their energy together, which Parseval's theorem gives for
    nothing, would not do.
    """
    n = len(values)
    n_low = min(math.ceil(band * n), n // 2 + 1)
    power = np.empty(max(n_low, _CHUNK), np.float64)
    energy = 0.0
    for x in values:
        energy += x * x
    energy *= n
    rest = energy
    largest = 0.0
    for first in range(0, n_low, _CHUNK):
        size = min(_CHUNK, n_low - first)
        _powers(values, first, size, power)
        for k in range(size):
            largest = max(largest, power[k])
            rest -= power[k] if first + k == 0 or 2 * (first + k) == n else 2.0 * power[k]
    share = (ratio * (1.0 + _TIE)) ** 2
    # every frequency but the one of N/2 has its energy twice, at k and at N - k; all of it is taken for that one
    if rest + 1e-12 * energy <= share * largest:
        return True
    for first in range(n_low, n // 2 + 1, _CHUNK):
        size = min(_CHUNK, n // 2 + 1 - first)
        _powers(values, first, size, power)
        for k in range(size):
            if power[k] > share * largest:
                return False
    return True


@kernel(boolean[::1](float32[:, ::1], int32[:, ::1], record(FourierThresholds)))
def stable_intervals(signed_deg: F32, intervals: I32, thresholds: FourierThresholds) -> Mask:
    """Mark intervals whose signed angles hold no high frequency.

    Long intervals are cut into the least number of windows of nearly equal size; at least half of them must be without
    high frequencies.

    ``signed_deg`` (R, n) float32, degrees; ``intervals`` (K, 3) int32; returns (K,) bool.
    """
    stable = np.zeros(len(intervals), np.bool_)
    values = np.empty(signed_deg.shape[1], np.float64)
    for i in range(len(intervals)):
        row = signed_deg[intervals[i, 0]]
        n = 0
        for k in range(intervals[i, 1], intervals[i, 2] + 1):
            value = row[k]
            if value == value:
                values[n] = value
                n += 1
        if n < thresholds.min_points or n == 0:
            continue
        if thresholds.longest > 0 and n > thresholds.longest:
            stable[i] = True
            continue
        n_windows = (n + thresholds.window_points - 1) // thresholds.window_points
        n_stable = 0
        for window in range(n_windows):
            part = values[window * n // n_windows : (window + 1) * n // n_windows]
            n_stable += _is_stable(part, thresholds.band, thresholds.ratio)
        stable[i] = 2 * n_stable >= n_windows
    return stable
