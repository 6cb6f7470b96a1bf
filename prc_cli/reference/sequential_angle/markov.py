"""The test between two hidden Markov models that finds vegetation (Stamos et al. 2012, sec. 4).

The paper takes it from Chen and Willett (2000, eqs. 23 to 28); likelihoods are logarithms here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp
from scipy.stats import norm

from prc_cli.core.types import F32, F64, Mask
from prc_cli.methods.sequential_angle.thresholds import MarkovModel, MarkovThresholds


def hmm_cusum(
    values: F32, means: F64, sigmas: F64, h0: MarkovModel, h1: MarkovModel, thresholds: MarkovThresholds
) -> Mask:
    """Mark the samples of model 1; see :func:`markov_loops.hmm_cusum`."""
    marked = np.zeros(values.shape, dtype=bool)
    for row, line in enumerate(values):
        there = np.flatnonzero(~np.isnan(line))
        samples = line[there].astype(np.float64)
        test = Test(norm.logpdf(samples[:, None], means, sigmas), h0, h1, thresholds)
        regions = confirmed_regions(samples, test) if thresholds.sprt else regions_both_ways(test)
        for i, (start, stop) in enumerate(regions):
            marked[row, there[start : stop + 1]] = True
            gap = there[regions[i - 1][1] + 1 : start] if i else there[:0]
            if thresholds.sprt and len(gap) < thresholds.merge_gap:
                marked[row, gap] = True
    return marked


class Test(NamedTuple):
    """One row, two models and the thresholds between them."""

    log_density: F64
    """(n, 3) float64, logarithm of the density of every sample in every state."""
    h0: MarkovModel
    h1: MarkovModel
    thresholds: MarkovThresholds


def regions_both_ways(test: Test) -> list[tuple[int, int]]:
    """Return the regions of model 1: from a change to it until a change back, both found by Page's test."""
    log_density, h0, h1, thresholds = test
    regions: list[tuple[int, int]] = []
    now = 0
    while (change := page_test(log_density, h0, h1, now, thresholds.threshold)) is not None:
        alarm, onset = change
        start = onset if thresholds.backdate else alarm
        change = page_test(log_density, h1, h0, alarm + 1, thresholds.threshold_back)
        if change is None:
            return [*regions, (start, len(log_density) - 1)]
        regions.append((start, (change[1] if thresholds.backdate else change[0]) - 1))
        now = change[0] + 1
    return regions


def confirmed_regions(samples: F64, test: Test) -> list[tuple[int, int]]:
    """Return the regions of model 1 that Wald's test confirms after the alarm, until it rejects one."""
    log_density, h0, h1, thresholds = test
    bounds = (thresholds.reject, thresholds.accept)
    regions: list[tuple[int, int]] = []
    now = 0
    while (change := page_test(log_density, h0, h1, now, thresholds.threshold)) is not None:
        alarm, onset = change
        verdict, now = wald_test(log_density, h0, h1, alarm + 1, *bounds)
        if verdict is None:
            break
        if not verdict:
            continue
        while verdict:
            verdict, now = wald_test(log_density, h0, h1, now, *bounds)
        stop = now - 1
        negative = [i for i in range(alarm + 1, stop + 1) if samples[i] < 0]
        if negative:
            stop = min(negative[-1] + 1, len(samples) - 1)
        now = stop + 1
        regions.append((onset if thresholds.backdate else alarm, stop))
    return regions


def page_test(
    log_density: F64, zero: MarkovModel, one: MarkovModel, begin: int, threshold: float
) -> tuple[int, int] | None:
    """Return alarm and onset of the first change from model 0 to model 1, None if there is none."""
    s, onset = 0.0, begin
    state_0: F64 | None = None
    state_1: F64 | None = None
    for t in range(begin, len(log_density)):
        state_0 = step(state_0, *zero, log_density[t])
        state_1 = step(state_1, *one, log_density[t])
        s += logsumexp(state_1) - logsumexp(state_0)
        if s > threshold:
            return t, onset
        if s < 0:
            s, onset, state_0, state_1 = 0.0, t + 1, None, None
    return None


def wald_test(
    log_density: F64, zero: MarkovModel, one: MarkovModel, begin: int, reject: float, accept: float
) -> tuple[bool | None, int]:
    """Return the decision for model 1 and the sample after it; None if the samples run out before."""
    s = 0.0
    state_0: F64 | None = None
    state_1: F64 | None = None
    for t in range(begin, len(log_density)):
        state_0 = step(state_0, *zero, log_density[t])
        state_1 = step(state_1, *one, log_density[t])
        s += logsumexp(state_1) - logsumexp(state_0)
        if s > accept:
            return True, t + 1
        if s < reject:
            return False, t + 1
    return None, len(log_density)


def step(before: F64 | None, transition: F64, initial: F64, log_density: F64) -> F64:
    """Return the scaled forward variable of one sample as logarithms (eqs. 24 to 26); ``before`` None = restart."""
    share = initial if before is None else np.exp(before - logsumexp(before)) @ transition
    with np.errstate(divide="ignore"):
        after: F64 = np.log(share) + log_density
    return after
