"""The coarse classification: vegetation, horizontal, vertical (Stamos et al. 2012, sec. 4)."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp
from scipy.stats import norm

from prc_cli.core.classes import Surface
from prc_cli.core.types import F32, F64, I32, U8, Mask
from prc_cli.methods.sequential_angle.thresholds import (
    MarkovThresholds,
    Matrix,
    SurfaceThresholds,
    Three,
)


def hmm_cusum(values: F32, thresholds: MarkovThresholds) -> Mask:
    """Mark the samples of model 1; see :func:`coarse_loops.hmm_cusum`."""
    marked = np.zeros(values.shape, dtype=bool)
    for row, line in enumerate(values):
        columns = np.flatnonzero(~np.isnan(line))
        samples = line[columns].astype(np.float64)
        densities = norm.logpdf(samples[:, None], thresholds.means_deg, thresholds.sigmas_deg)
        h0 = Model(thresholds.h0, thresholds.initial_h0)
        h1 = Model(thresholds.h1, thresholds.initial_h1)
        test = Test(densities, h0, h1, thresholds)
        regions = confirmed_regions(samples, test)
        for start, stop in regions:
            marked[row, columns[start : stop + 1]] = True
        for (_, stop), (start, _) in pairwise(regions):
            gap = columns[stop + 1 : start]
            if len(gap) < thresholds.merge_gap:
                marked[row, gap] = True
    return marked


class Model(NamedTuple):
    """A Markov chain."""

    transition: Matrix
    """Probabilities of the states after every state."""
    initial: Three
    """Probabilities of the states at the first sample."""


class Change(NamedTuple):
    """A change of the model, as samples."""

    alarm: int
    """Where it is noticed."""
    onset: int
    """Where it begins."""


class Test(NamedTuple):
    """One row, two models and the thresholds between them."""

    log_density: F64
    """(n, 3) float64, logarithm of the density of every sample in every state."""
    h0: Model
    h1: Model
    thresholds: MarkovThresholds


def confirmed_regions(samples: F64, test: Test) -> list[tuple[int, int]]:
    """Return the regions of model 1 that Wald's test confirms, until it rejects one."""
    log_density, h0, h1, thresholds = test
    bounds = (thresholds.reject, thresholds.accept)
    regions: list[tuple[int, int]] = []
    now = 0
    while (change := page_test(log_density, h0, h1, now, thresholds.threshold)) is not None:
        verdict, now = wald_test(log_density, h0, h1, change.alarm + 1, *bounds)
        if verdict is None:
            break
        if not verdict:
            continue
        while verdict:
            verdict, now = wald_test(log_density, h0, h1, now, *bounds)
        stop = now - 1
        # the region ends behind its last negative sample
        negative = np.flatnonzero(samples[change.alarm + 1 : stop + 1] < 0)
        if len(negative):
            last_negative = change.alarm + 1 + int(negative[-1])
            stop = min(last_negative + 1, len(samples) - 1)
        now = stop + 1
        regions.append((change.onset if thresholds.backdate else change.alarm, stop))
    return regions


def page_test(
    log_density: F64,
    zero: Model,
    model: Model,
    begin: int,
    threshold: float,
) -> Change | None:
    """Return the first change from model 0 to model 1, None if there is none."""
    s = 0.0
    onset = begin
    state_0: F64 | None = None
    state_1: F64 | None = None
    for t in range(begin, len(log_density)):
        state_0 = step(state_0, zero, log_density[t])
        state_1 = step(state_1, model, log_density[t])
        s += logsumexp(state_1) - logsumexp(state_0)
        if s > threshold:
            return Change(alarm=t, onset=onset)
        if s < 0:
            s = 0.0
            onset = t + 1
            state_0 = None
            state_1 = None
    return None


def wald_test(
    log_density: F64,
    zero: Model,
    model: Model,
    begin: int,
    reject: float,
    accept: float,
) -> tuple[bool | None, int]:
    """Return the decision for model 1 and the sample after it; None if the samples end before."""
    s = 0.0
    state_0: F64 | None = None
    state_1: F64 | None = None
    for t in range(begin, len(log_density)):
        state_0 = step(state_0, zero, log_density[t])
        state_1 = step(state_1, model, log_density[t])
        s += logsumexp(state_1) - logsumexp(state_0)
        if s > accept:
            return True, t + 1
        if s < reject:
            return False, t + 1
    return None, len(log_density)


def step(before: F64 | None, model: Model, log_density: F64) -> F64:
    """Return the scaled forward variable of one sample as logarithms (eqs. 24 to 26).

    ``before`` None = restart.
    """
    if before is None:
        share = np.asarray(model.initial)
    else:
        share = np.exp(before - logsumexp(before)) @ model.transition
    with np.errstate(divide="ignore"):
        after: F64 = np.log(share) + log_density
    return after


def surface_image(
    signed_deg: F32,
    vegetation: Mask,
    range_m: F32,
    n_beams: I32,
    thresholds: SurfaceThresholds,
) -> U8:
    """Label surfaces; see :func:`coarse_loops.surface_image`."""
    image = np.full(signed_deg.shape, Surface.MISSING, np.uint8)
    for row, line in enumerate(signed_deg):
        beams = [k for k in range(n_beams[row]) if not np.isnan(line[k])]
        labels: dict[int, Surface] = {}
        for run in runs(beams, vegetation[row]):
            if vegetation[row, run[0]]:
                labels.update(dict.fromkeys(run, Surface.VEGETATION))
                continue
            tilt = np.abs(line[run].astype(np.float64))
            labels.update(zip(run, horizontal_or_vertical(tilt, thresholds), strict=True))
        # shots without an angle have the label before them
        label = labels[beams[0]] if beams else Surface.UNDECIDED
        for k in range(n_beams[row]):
            if not np.isnan(range_m[row, k]):
                label = labels.get(k, label)
                image[row, k] = label
    return image


def horizontal_or_vertical(tilt: F64, thresholds: SurfaceThresholds) -> list[Surface]:
    """Label the samples of a run by CUSUM tests for a change of their mean, one a direction."""
    is_vertical = False
    labels: list[Surface] = []
    s = 0.0
    for y in tilt:
        if is_vertical:
            s += y - thresholds.drift_horizontal_deg
            has_changed = s > thresholds.threshold_horizontal_deg
        else:
            s += thresholds.drift_vertical_deg - y
            has_changed = s > thresholds.threshold_vertical_deg
        if has_changed:
            is_vertical = not is_vertical
            s = 0.0
        s = max(s, 0.0)
        labels.append(Surface.VERTICAL if is_vertical else Surface.HORIZONTAL)
    return labels


def runs(beams: list[int], vegetation: Mask) -> list[list[int]]:
    """Cut beams where vegetation begins or ends."""
    cuts = np.flatnonzero(np.diff(vegetation[beams].astype(int))) + 1
    return [list(run) for run in np.split(np.array(beams, int), cuts) if len(run)]
