"""Loops of the coarse classification: vegetation, horizontal, vertical.

Stamos et al. (2012), sec. 4.
"""

from __future__ import annotations

import math
from typing import NamedTuple, cast

import numpy as np

from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import F32_2, F64, I32_1, I64, U8, U8_2, U32, Mask_2
from prc_cli.methods.sequential_angle.thresholds import MarkovThresholds, SurfaceThresholds

_SMALL = 2.0**-500
_LARGE = 2.0**500
"""Likelihoods that become small are scaled by a power of two, which rounds nothing."""

ZERO = cast("int", np.int64(0))
"""An integer that numba does not treat as a literal, for which it would compile helpers again."""

_PerState = tuple[float, float, float]
"""One number for each of the three states of a model."""
_Transition = tuple[_PerState, _PerState, _PerState]
"""Probabilities, row = from."""


class _Model(NamedTuple):
    """A hidden Markov model of three states."""

    transition: _Transition
    initial: _PerState
    """Probabilities of the states at the first sample after a restart."""


class _Bounds(NamedTuple):
    """Bounds of the ratio of likelihoods: the exponentials of the thresholds."""

    upper: float
    """A region starts above this."""
    accept: float
    """A region is confirmed above this ..."""
    reject: float
    """... and rejected below this."""
    backdate: bool
    """Whether a change is dated to the onset of the alarm rather than to the alarm."""


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
"""Polynomial for exp(r), equal to it at Chebyshev's nodes of r up to ln(2) / 2.

The difference is below the last bit.
"""
_TERMS = len(_EXPONENTIAL)
_LN2_HIGH = 2.0**-32 * round(2.0**32 * math.log(2.0))
_LN2_LOW = -4.2009150726810846e-11
"""ln(2) as a number of few bits, whose multiples are exact, and the remainder."""
_LEAST = -708.0
"""Below this the exponential is zero: doubles end there."""


@helper
def _densities(
    values: F64,
    m: int,
    means: _PerState,
    half_precision: F64,
    log_sigma: F64,
    density: F64,
    power: I64,
    top: I64,
) -> None:
    """Compute the densities of m values in the three states, divided by the largest of the three.

    That keeps the ratio of likelihoods. ``density`` (3, n) gets them. The exponential is computed
    here for many values at a time, unlike in the library. The largest density is 1, so only the
    other two are computed, in the first two rows.
    """
    mean_0 = means[0]
    mean_1 = means[1]
    mean_2 = means[2]
    half_0 = half_precision[0]
    half_1 = half_precision[1]
    half_2 = half_precision[2]
    log_0 = log_sigma[0]
    log_1 = log_sigma[1]
    log_2 = log_sigma[2]
    for i in range(m):
        d_0 = values[i] - mean_0
        d_1 = values[i] - mean_1
        d_2 = values[i] - mean_2
        a = -(d_0 * d_0) * half_0 - log_0
        b = -(d_1 * d_1) * half_1 - log_1
        c = -(d_2 * d_2) * half_2 - log_2
        largest = max(a, b, c)
        first = a == largest
        last = b != largest and a != largest
        density[0, i] = (b if first else a) - largest
        density[1, i] = (b if last else c) - largest
        if first:
            top[i] = 0
        else:
            top[i] = 2 if last else 1
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
        first_density = density[0, i]
        second_density = density[1, i]
        density[0, i] = 1.0 if top[i] == 0 else first_density
        if top[i] == 0:
            density[1, i] = first_density
        else:
            density[1, i] = 1.0 if top[i] == 1 else second_density
        density[2, i] = 1.0 if top[i] == 2 else second_density


@helper
def _forward(state: _PerState, transition: _Transition, density: _PerState) -> _PerState:
    """One step of the forward recursion, unscaled."""
    a, b, c = state
    return (
        (a * transition[0][0] + b * transition[1][0] + c * transition[2][0]) * density[0],
        (a * transition[0][1] + b * transition[1][1] + c * transition[2][1]) * density[1],
        (a * transition[0][2] + b * transition[1][2] + c * transition[2][2]) * density[2],
    )


@helper
def _first(initial: _PerState, density: _PerState) -> _PerState:
    """Start the forward recursion."""
    return initial[0] * density[0], initial[1] * density[1], initial[2] * density[2]


@helper
def _sequential_test(
    density: F64,
    begin: int,
    end: int,
    h0: _Model,
    h1: _Model,
    lower: float,
    upper: float,
    restart: bool,
) -> tuple[int, int, int]:
    """Follow the ratio of likelihoods of model 1 to model 0 until it leaves its bounds.

    The log-likelihood ratio S is kept as the two likelihoods themselves: S > h is L1 > exp(h) L0.
    Between two restarts their ratio stays in bounds, so only their common size has to be scaled,
    without logarithm and division.

    With ``restart`` (CUSUM) a ratio below the lower bound, or a sample that neither model can
    explain, restarts the test at the next sample; without it (SPRT) it ends the test.

    Returns the verdict (1 = above the upper bound, -1 = below the lower, 0 = the samples ended),
    the last sample, and the sample after the last restart.
    """
    p = (0.0, 0.0, 0.0)
    q = (0.0, 0.0, 0.0)
    onset = begin
    for t in range(begin, end):
        d = (density[0, t], density[1, t], density[2, t])
        if t == onset:
            p = _first(h1.initial, d)
            q = _first(h0.initial, d)
        else:
            p = _forward(p, h1.transition, d)
            q = _forward(q, h0.transition, d)
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
    density: F64,
    samples: F64,
    begin: int,
    m: int,
    h0: _Model,
    h1: _Model,
    bounds: _Bounds,
) -> tuple[int, int, int]:
    """Find the next region, confirmed and ended by tests of two bounds.

    Returns its first and last sample (an empty stretch = no more region), and the sample to
    continue with.
    """
    restart = bool(np.bool_(True))  # not a literal, for which the test would be compiled again
    no_restart = bool(np.bool_(False))
    verdict, alarm, onset = _sequential_test(density, begin, m, h0, h1, 1.0, bounds.upper, restart)
    if verdict == 0:
        return 0, -1, m
    first = onset if bounds.backdate else alarm
    # the region has to be confirmed once before it may end
    verdict, t, _ = _sequential_test(
        density, alarm + 1, m, h0, h1, bounds.reject, bounds.accept, no_restart
    )
    if verdict == 0:
        return 0, -1, m
    if verdict < 0:
        return 0, -1, t + 1
    while verdict > 0:
        verdict, t, _ = _sequential_test(
            density, t + 1, m, h0, h1, bounds.reject, bounds.accept, no_restart
        )
    last = min(t, m - 1)
    for back in range(last, alarm, -1):
        if samples[back] < 0.0:
            last = min(back + 1, m - 1)
            break
    return first, last, last + 1


@loop("prc_cli.reference.sequential_angle.coarse")
def hmm_cusum(values: F32_2, thresholds: MarkovThresholds) -> Mask_2:
    """Mark the samples of every row that belong to model 1.

    ``values`` (R, n) float32; returns (R, n) bool.
    """
    h0 = _Model(thresholds.h0, thresholds.initial_h0)
    h1 = _Model(thresholds.h1, thresholds.initial_h1)
    sigmas = np.array(thresholds.sigmas_deg)
    n_rows, n = values.shape
    marked = np.zeros((n_rows, n), np.bool_)
    half_precision = 0.5 / (sigmas * sigmas)
    log_sigma = np.log(sigmas)
    bounds = _Bounds(
        math.exp(thresholds.threshold),
        math.exp(thresholds.accept),
        math.exp(thresholds.reject),
        thresholds.backdate,
    )
    density = np.empty((3, n), np.float64)
    samples = np.empty(n, np.float64)
    power = np.empty(n, np.int64)
    top = np.empty(n, np.int64)
    beam = np.empty(n, np.int64)
    for row in range(n_rows):
        m = begin = ZERO
        for k in range(n):
            value = np.float64(values[row, k])
            if not math.isnan(value):
                samples[m] = value
                beam[m] = k
                m += 1
        _densities(samples, m, thresholds.means_deg, half_precision, log_sigma, density, power, top)
        previous = -1
        while begin < m:
            first, last, begin = _next_region(density, samples, begin, m, h0, h1, bounds)
            if previous >= 0 and first - previous - 1 < thresholds.merge_gap:
                first = min(first, previous + 1)
            previous = max(last, previous)
            for i in range(first, last + 1):
                marked[row, beam[i]] = True
    return marked


_MISSING = 0
_VEGETATION = 1
_HORIZONTAL = 2
_VERTICAL = 3
_UNDECIDED = 4
"""As :class:`prc_cli.core.classes.Surface` numbers them."""


@inlined
def _label_run(
    tilt: F64,
    beam: U32,
    begin: np.uint64,
    end: np.uint64,
    labels: U8,
    thresholds: SurfaceThresholds,
) -> None:
    """Label the samples of a run by the CUSUM test for a change of their mean; first horizontal."""
    horizontal = True
    total = 0.0
    for i in range(begin, end):
        if horizontal:
            total += thresholds.drift_vertical_deg - tilt[i]
            limit = thresholds.threshold_vertical_deg
        else:
            total += tilt[i] - thresholds.drift_horizontal_deg
            limit = thresholds.threshold_horizontal_deg
        if total > limit:
            horizontal = not horizontal
            total = 0.0
        total = max(total, 0.0)
        labels[beam[i]] = _HORIZONTAL if horizontal else _VERTICAL


@loop("prc_cli.reference.sequential_angle.coarse")
def surface_image(
    signed_deg: F32_2,
    vegetation: Mask_2,
    range_m: F32_2,
    n_beams: I32_1,
    thresholds: SurfaceThresholds,
) -> U8_2:
    """Label every shot of every row: missing, vegetation, horizontal, vertical, undecided.

    ``signed_deg`` (R, n) float32, degrees; ``vegetation`` (R, n) bool; ``range_m`` (R, n) float32,
    metres; ``n_beams`` (R,) int32; returns (R, n) uint8.
    """
    n_rows, n = signed_deg.shape
    image = np.zeros((n_rows, n), np.uint8)
    beam = np.empty(n, np.uint32)  # without a sign, for which every access would look
    tilt = np.empty(n, np.float64)
    grown = np.empty(n, np.bool_)
    for row in range(n_rows):
        width = min(np.int64(n_beams[row]), n)
        labels = image[row]
        m = np.uint64(0)
        for k in range(width):
            beam[m] = k
            tilt[m] = abs(np.float64(signed_deg[row, k]))
            grown[m] = vegetation[row, k]
            m += np.uint64(not math.isnan(signed_deg[row, k]))
        begin = np.uint64(0)
        while begin < m:
            if grown[begin]:
                labels[beam[begin]] = _VEGETATION
                begin += np.uint64(1)
                continue
            end = begin
            while end < m and not grown[end]:
                end += np.uint64(1)
            _label_run(tilt, beam, begin, end, labels, thresholds)
            begin = end
        # shots without an angle get the label of the shot before them, the first shots that of the
        # first one with an angle
        label = _UNDECIDED if m == 0 else int(labels[beam[0]])
        for k in range(width):
            code = int(labels[k])
            label = label if code == _MISSING else code
            labels[k] = _MISSING if code == _MISSING and math.isnan(range_m[row, k]) else label
    return image
