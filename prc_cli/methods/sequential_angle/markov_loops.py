"""CUSUM test between two hidden Markov models (Chen and Willett 2000, eqs. 23 to 28)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from prc_cli.core.types import F32, F64, I64, Mask
from prc_cli.kernels.cache import boolean, float32, float64, helper, kernel, record
from prc_cli.methods.sequential_angle.thresholds import MarkovModel, MarkovThresholds

_SMALL = 2.0**-500
_LARGE = 2.0**500
"""Likelihoods that become small are scaled by a power of two, which rounds nothing."""

_Three = tuple[float, float, float]


class _Bounds(NamedTuple):
    """Bounds of the ratio of likelihoods, the exponentials of the thresholds, and where changes are dated to."""

    upper: float
    upper_back: float
    accept: float
    reject: float
    backdate: bool


_EXPONENTIAL = np.array(
    (
        1.0,
        1.0,
        0.5000000000000019,
        0.1666666666666668,
        0.04166666666648799,
        0.008333333333319592,
        0.0013888888952343797,
        0.00019841269890069431,
        2.4801485451264055e-05,
        2.7557240894691074e-06,
        2.76326511328741e-07,
        2.5110046444457486e-08,
    )
)
"""Polynomial for exp(r), equal to it at Chebyshev's nodes of r up to ln(2) / 2: what it differs by is below the last
bit."""
_TERMS = len(_EXPONENTIAL)
_LN2_HIGH = 2.0**-32 * round(2.0**32 * math.log(2.0))
_LN2_LOW = -4.2009150726810846e-11
"""ln(2) as a number of few bits, whose multiples are exact, and the rest."""
_LEAST = -708.0
"""Below this the exponential is zero: doubles end there."""


@helper
def _densities(
    values: F64, m: int, means: F64, half_precision: F64, log_sigma: F64, density: F64, power: I64, top: I64
) -> None:
    """Densities of m values in the three states, divided by the largest: the ratio of likelihoods stays the same.

    ``density`` (3, n) takes them. The exponential is computed here for many values at a time: the library's one takes
    one by one. That of the largest is 1, so the other two go into the first two rows for it.
    """
    mean_0, mean_1, mean_2 = means[0], means[1], means[2]
    half_0, half_1, half_2 = half_precision[0], half_precision[1], half_precision[2]
    log_0, log_1, log_2 = log_sigma[0], log_sigma[1], log_sigma[2]
    for i in range(m):
        d_0, d_1, d_2 = values[i] - mean_0, values[i] - mean_1, values[i] - mean_2
        a, b, c = -(d_0 * d_0) * half_0 - log_0, -(d_1 * d_1) * half_1 - log_1, -(d_2 * d_2) * half_2 - log_2
        largest = max(a, b, c)
        first, last = a == largest, b != largest and a != largest
        density[0, i] = (b if first else a) - largest
        density[1, i] = (b if last else c) - largest
        top[i] = 0 if first else 2 if last else 1
    scale = power.view(np.float64)
    for state in range(2):
        for i in range(m):
            x = max(density[state, i], _LEAST)
            halvings = math.floor(x * 1.4426950408889634 + 0.5)
            r = (x - halvings * _LN2_HIGH) - halvings * _LN2_LOW
            series = _EXPONENTIAL[_TERMS - 1]
            for term in range(_TERMS - 2, -1, -1):
                series = series * r + _EXPONENTIAL[term]
            power[i] = (halvings + 1023) << 52  # bits of the power of two
            density[state, i] = series if density[state, i] >= _LEAST else 0.0
        for i in range(m):
            density[state, i] *= scale[i]
    for i in range(m):
        one, other = density[0, i], density[1, i]
        density[0, i] = 1.0 if top[i] == 0 else one
        density[1, i] = one if top[i] == 0 else 1.0 if top[i] == 1 else other
        density[2, i] = 1.0 if top[i] == 2 else other


@helper
def _forward(state: _Three, transition: F64, density: _Three) -> _Three:
    """One step of the forward recursion, unscaled."""
    a, b, c = state
    return (
        (a * transition[0, 0] + b * transition[1, 0] + c * transition[2, 0]) * density[0],
        (a * transition[0, 1] + b * transition[1, 1] + c * transition[2, 1]) * density[1],
        (a * transition[0, 2] + b * transition[1, 2] + c * transition[2, 2]) * density[2],
    )


@helper
def _first(initial: F64, density: _Three) -> _Three:
    """Begin the forward recursion."""
    return initial[0] * density[0], initial[1] * density[1], initial[2] * density[2]


@helper
def _sequential_test(
    density: F64,
    begin: int,
    end: int,
    h0: MarkovModel,
    h1: MarkovModel,
    lower: float,
    upper: float,
    restart: bool,
) -> tuple[int, int, int]:
    """Follow the ratio of likelihoods of model 1 to model 0 until it leaves its bounds.

    The log-likelihood ratio S is kept as the two likelihoods themselves: S > h is L1 > exp(h) L0. Between two
    restarts their ratio stays in bounds, so that only their common size has to be looked after, and no logarithm and
    no division is needed.

    With ``restart`` (CUSUM) falling below the lower bound, or a sample that neither model can explain, forgets all
    and begins anew at the next sample; without it (SPRT) it ends the test.
    """
    transition_0, initial_0 = (
        h0.transition,
        h0.initial,
    )  # here, not in the loop: every time an array is taken is counted
    transition_1, initial_1 = h1.transition, h1.initial
    p = (0.0, 0.0, 0.0)
    q = (0.0, 0.0, 0.0)
    onset = begin
    for t in range(begin, end):
        d = (density[0, t], density[1, t], density[2, t])
        if t == onset:
            p = _first(initial_1, d)
            q = _first(initial_0, d)
        else:
            p = _forward(p, transition_1, d)
            q = _forward(q, transition_0, d)
        l1 = p[0] + p[1] + p[2]
        l0 = q[0] + q[1] + q[2]
        if l1 > upper * l0:
            return 1, t, onset
        if l1 < lower * l0 or l1 == 0.0:
            if not restart:
                return -1, t, onset
            onset = t + 1
        elif l0 < _SMALL:
            p = (p[0] * _LARGE, p[1] * _LARGE, p[2] * _LARGE)
            q = (q[0] * _LARGE, q[1] * _LARGE, q[2] * _LARGE)
    return 0, end, onset


@helper
def _next_region(
    density: F64, begin: int, m: int, h0: MarkovModel, h1: MarkovModel, bounds: _Bounds
) -> tuple[int, int, int]:
    """Find the next region from a sample on that ends where the test with the models exchanged raises an alarm.

    Returns its first and last sample, none between them where there is no more region, and where to go on.
    """
    anew = bool(np.bool_(True))  # not a literal, for each of which the test is compiled again
    verdict, alarm, onset = _sequential_test(density, begin, m, h0, h1, 1.0, bounds.upper, anew)
    if verdict == 0:
        return 0, -1, m
    first = onset if bounds.backdate else alarm
    verdict, alarm, onset = _sequential_test(density, alarm + 1, m, h1, h0, 1.0, bounds.upper_back, anew)
    last = m - 1
    if verdict != 0:
        last = (onset if bounds.backdate else alarm) - 1
    return first, last, alarm + 1


@helper
def _next_confirmed(
    density: F64, samples: F64, begin: int, m: int, h0: MarkovModel, h1: MarkovModel, bounds: _Bounds
) -> tuple[int, int, int]:
    """Find the next region from a sample on that tests between two bounds confirm, and end; as :func:`_next_region`."""
    anew, once = bool(np.bool_(True)), bool(np.bool_(False))
    verdict, alarm, onset = _sequential_test(density, begin, m, h0, h1, 1.0, bounds.upper, anew)
    if verdict == 0:
        return 0, -1, m
    first = onset if bounds.backdate else alarm
    # the region has to be confirmed once before it may end
    verdict, t, _ = _sequential_test(density, alarm + 1, m, h0, h1, bounds.reject, bounds.accept, once)
    if verdict == 0:
        return 0, -1, m
    if verdict < 0:
        return 0, -1, t + 1
    while verdict > 0:
        verdict, t, _ = _sequential_test(density, t + 1, m, h0, h1, bounds.reject, bounds.accept, once)
    last = min(t, m - 1)
    for back in range(last, alarm, -1):
        if samples[back] < 0.0:
            last = min(back + 1, m - 1)
            break
    return first, last, last + 1


@kernel(
    boolean[:, ::1](
        float32[:, ::1], float64[::1], float64[::1], record(MarkovModel), record(MarkovModel), record(MarkovThresholds)
    )
)
def hmm_cusum(
    values: F32, means: F64, sigmas: F64, h0: MarkovModel, h1: MarkovModel, thresholds: MarkovThresholds
) -> Mask:
    """Mark the samples of every row that belong to model 1.

    ``values`` (R, n) float32; ``means, sigmas`` (3,) float64; returns (R, n) bool.
    """
    n_rows, n = values.shape
    marked = np.zeros((n_rows, n), np.bool_)
    half_precision = 0.5 / (sigmas * sigmas)
    log_sigma = np.log(sigmas)
    bounds = _Bounds(
        math.exp(thresholds.threshold), math.exp(thresholds.threshold_back), math.exp(thresholds.accept),
        math.exp(thresholds.reject), thresholds.backdate,
    )  # fmt: skip
    density = np.empty((3, n), np.float64)
    samples, power, top = np.empty(n, np.float64), np.empty(n, np.int64), np.empty(n, np.int64)
    beam = np.empty(n, np.int64)
    for row in range(n_rows):
        m = begin = int(np.int64(0))
        for k in range(n):
            value = np.float64(values[row, k])
            if not math.isnan(value):
                samples[m] = value
                beam[m] = k
                m += 1
        _densities(samples, m, means, half_precision, log_sigma, density, power, top)
        previous = -1
        while begin < m:
            if thresholds.sprt:
                first, last, begin = _next_confirmed(density, samples, begin, m, h0, h1, bounds)
                if previous >= 0 and first - previous - 1 < thresholds.merge_gap:
                    first = min(first, previous + 1)
                previous = max(last, previous)
            else:
                first, last, begin = _next_region(density, begin, m, h0, h1, bounds)
            for i in range(first, last + 1):
                marked[row, beam[i]] = True
    return marked
