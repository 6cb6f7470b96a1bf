"""Slow and obvious twin of the test between two hidden Markov models, written from Chen and Willett (2000)."""

from __future__ import annotations

import numpy as np
from scipy.special import logsumexp
from scipy.stats import norm

from prc_cli.core.types import F32, F64, Mask

Model = tuple[F64, F64]
"""Transition probabilities (3, 3), row = from, and initial probabilities (3,)."""


def hmm_cusum(
    values: F32,
    means: F64,
    sigmas: F64,
    h0: F64,
    h1: F64,
    initial_h0: F64,
    initial_h1: F64,
    threshold: float,
    threshold_back: float,
    backdate: bool,
    sprt: bool,
    accept: float,
    reject: float,
    merge_gap: int,
) -> Mask:
    """Mark the samples of model 1; see :func:`prc_cli.kernels.sequential_angle.markov.hmm_cusum`."""
    marked = np.zeros(values.shape, dtype=bool)
    for row, line in enumerate(values):
        there = np.flatnonzero(~np.isnan(line))
        samples = line[there].astype(np.float64)
        log_density = norm.logpdf(samples[:, None], means, sigmas)
        forward = (log_density, (h0, initial_h0), (h1, initial_h1))
        backward = (log_density, (h1, initial_h1), (h0, initial_h0))
        regions: list[tuple[int, int]] = []
        now = 0
        while (change := page_test(*forward, now, threshold)) is not None:
            alarm, onset = change
            start = onset if backdate else alarm
            if sprt:
                confirmed, now = wald_test(*forward, alarm + 1, reject, accept)
                if confirmed is None:
                    break
                if not confirmed:
                    continue
                verdict: bool | None = True
                while verdict:
                    verdict, now = wald_test(*forward, now, reject, accept)
                stop = now - 1
                negative = [i for i in range(alarm + 1, stop + 1) if samples[i] < 0]
                if negative:
                    stop = min(negative[-1] + 1, len(samples) - 1)
                now = stop + 1
            else:
                change = page_test(*backward, alarm + 1, threshold_back)
                if change is None:
                    now, stop = len(samples), len(samples) - 1
                else:
                    now, stop = change[0] + 1, (change[1] if backdate else change[0]) - 1
            regions.append((start, stop))
        for i, (start, stop) in enumerate(regions):
            marked[row, there[start : stop + 1]] = True
            gap = there[regions[i - 1][1] + 1 : start] if i else there[:0]
            if sprt and len(gap) < merge_gap:
                marked[row, gap] = True
    return marked


def page_test(log_density: F64, zero: Model, one: Model, begin: int, threshold: float) -> tuple[int, int] | None:
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
    log_density: F64, zero: Model, one: Model, begin: int, reject: float, accept: float
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
