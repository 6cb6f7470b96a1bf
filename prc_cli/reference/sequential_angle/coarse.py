"""The coarse classification: vegetation, horizontal, vertical (Stamos et al. 2012, sec. 4)."""

from __future__ import annotations

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
    WindowThresholds,
)


def hmm_cusum(values: F32, thresholds: MarkovThresholds) -> Mask:
    """Mark the samples of model 1; see :func:`coarse_loops.hmm_cusum`."""
    marked = np.zeros(values.shape, dtype=bool)
    for row, line in enumerate(values):
        there = np.flatnonzero(~np.isnan(line))
        samples = line[there].astype(np.float64)
        densities = norm.logpdf(samples[:, None], thresholds.means_deg, thresholds.sigmas_deg)
        test = Test(
            densities,
            (thresholds.h0, thresholds.initial_h0),
            (thresholds.h1, thresholds.initial_h1),
            thresholds,
        )
        regions = confirmed_regions(samples, test) if thresholds.sprt else regions_both_ways(test)
        for i, (start, stop) in enumerate(regions):
            marked[row, there[start : stop + 1]] = True
            gap = there[regions[i - 1][1] + 1 : start] if i else there[:0]
            if thresholds.sprt and len(gap) < thresholds.merge_gap:
                marked[row, gap] = True
    return marked


Model = tuple[Matrix, Three]
"""Transition probabilities, and those of the states at the first sample."""


class Test(NamedTuple):
    """One row, two models and the thresholds between them."""

    log_density: F64
    """(n, 3) float64, logarithm of the density of every sample in every state."""
    h0: Model
    h1: Model
    thresholds: MarkovThresholds


def regions_both_ways(test: Test) -> list[tuple[int, int]]:
    """Return the regions of model 1.

    From a change to it until a change back, both found by Page's test.
    """
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
    """Return the regions of model 1 that Wald's test confirms, until it rejects one."""
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
    log_density: F64,
    zero: Model,
    model: Model,
    begin: int,
    threshold: float,
) -> tuple[int, int] | None:
    """Return alarm and onset of the first change from model 0 to model 1, None if there is none."""
    s = 0.0
    onset = begin
    state_0: F64 | None = None
    state_1: F64 | None = None
    for t in range(begin, len(log_density)):
        state_0 = step(state_0, *zero, log_density[t])
        state_1 = step(state_1, *model, log_density[t])
        s += logsumexp(state_1) - logsumexp(state_0)
        if s > threshold:
            return t, onset
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
        state_0 = step(state_0, *zero, log_density[t])
        state_1 = step(state_1, *model, log_density[t])
        s += logsumexp(state_1) - logsumexp(state_0)
        if s > accept:
            return True, t + 1
        if s < reject:
            return False, t + 1
    return None, len(log_density)


def step(
    before: F64 | None,
    transition: Matrix,
    initial: Three,
    log_density: F64,
) -> F64:
    """Return the scaled forward variable of one sample as logarithms (eqs. 24 to 26).

    ``before`` None = restart.
    """
    share = initial if before is None else np.exp(before - logsumexp(before)) @ transition
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
            if thresholds.fold:
                tilt = np.minimum(tilt, 180.0 - tilt)
            labels.update(zip(run, horizontal_or_vertical(tilt, thresholds), strict=True))
        valid = [k for k in range(n_beams[row]) if not np.isnan(range_m[row, k])]
        label = labels[beams[0]] if beams else Surface.UNDECIDED
        for k in valid:
            label = labels.get(k, label)
            image[row, k] = label
    return image


def horizontal_or_vertical(tilt: F64, thresholds: SurfaceThresholds) -> list[Surface]:
    """Label the samples of a run by CUSUM tests for a change of their mean, one a direction."""
    drifts = {
        Surface.HORIZONTAL: thresholds.drift_vertical_deg,
        Surface.VERTICAL: thresholds.drift_horizontal_deg,
    }
    limits = {
        Surface.HORIZONTAL: thresholds.threshold_vertical_deg,
        Surface.VERTICAL: thresholds.threshold_horizontal_deg,
    }
    vertical = not thresholds.start_horizontal and np.median(tilt[:5]) < 45.0
    label = Surface.VERTICAL if vertical else Surface.HORIZONTAL
    labels: list[Surface] = []
    s = 0.0
    n_since_reset = 0
    for y in tilt:
        s += drifts[label] - y if label is Surface.HORIZONTAL else y - drifts[label]
        if s > limits[label]:
            label = Surface.HORIZONTAL if label is Surface.VERTICAL else Surface.VERTICAL
            if thresholds.backdate:
                labels[len(labels) - n_since_reset :] = [label] * n_since_reset
            s = 0.0
        labels.append(label)
        s, n_since_reset = (0.0, 0) if s <= 0 else (s, n_since_reset + 1)
    return labels


def runs(beams: list[int], vegetation: Mask) -> list[list[int]]:
    """Cut beams where vegetation begins or ends."""
    cuts = np.flatnonzero(np.diff(vegetation[beams].astype(int))) + 1
    return [list(run) for run in np.split(np.array(beams, int), cuts) if len(run)]


def upright_layers(
    surface: U8,
    horizontal_m: F32,
    n_beams: I32,
    thresholds: WindowThresholds,
) -> U8:
    """Find facades behind glass; see :func:`coarse_loops.upright_layers`."""
    image = surface.copy()
    for row, codes in enumerate(surface):
        returns = [k for k in range(n_beams[row]) if codes[k] != Surface.MISSING]
        green = codes == Surface.VEGETATION
        for run in runs(returns, green):
            if not green[run[0]] or len(run) < thresholds.min_points:
                continue
            distances = np.sort(horizontal_m[row, run].astype(np.float64))
            first, after = fullest(distances, thresholds.width_m)
            beside = [
                fullest(part, thresholds.width_m) for part in (distances[:first], distances[after:])
            ]
            inside = after - first + max(b - a for a, b in beside)
            if inside > thresholds.share * len(run):
                image[row, run] = Surface.VERTICAL
    return image


def fullest(distances: F64, width_m: float) -> tuple[int, int]:
    """Return where the fullest layer of sorted distances begins and ends.

    The first one of several.
    """
    counts = [
        int(np.count_nonzero((distances >= d) & (distances - d <= width_m)))
        for d in distances.tolist()
    ]
    # equal distances begin the same layer, of which the first holds them all
    counts = [n if i == 0 or distances[i - 1] != distances[i] else 0 for i, n in enumerate(counts)]
    first = int(np.argmax(counts)) if counts else 0
    return first, first + (int(counts[first]) if counts else 0)


def behind_walls(
    surface: U8,
    xyz_m: F32,
    horizontal_m: F32,
    n_beams: I32,
    thresholds: WindowThresholds,
) -> U8:
    """Find walls among leaves; see :func:`coarse_loops.behind_walls`."""
    image = surface.copy()
    for row, codes in enumerate(surface):
        beams = [k for k in range(n_beams[row]) if codes[k] != Surface.MISSING]
        distance = horizontal_m[row, beams].astype(np.float64)
        height = xyz_m[row, beams, 2].astype(np.float64)
        vertical = codes[beams] == Surface.VERTICAL
        ends = (
            np.flatnonzero(
                ~vertical[1:] | ~vertical[:-1] | (np.abs(np.diff(distance)) > thresholds.break_m)
            )
            + 1
        )
        parts = [
            part
            for part in np.split(np.arange(len(beams)), ends)
            if len(part) and vertical[part[0]]
        ]
        walls = [part for part in parts if is_wall(distance[part], height[part], thresholds)]
        for i in np.flatnonzero(codes[beams] == Surface.VEGETATION).tolist():
            away = [
                (wall[0] > i, distance[i] - 0.5 * (distance[wall].min() + distance[wall].max()))
                for wall in walls
            ]
            on_wall = any(abs(far) <= thresholds.wall_m for _, far in away)
            if on_wall or any(above and far >= -thresholds.front_m for above, far in away):
                image[row, beams[i]] = Surface.VERTICAL
    return image


def is_wall(distance: F64, height: F64, thresholds: WindowThresholds) -> bool:
    """Tell whether a vertical run is high, straight and upright."""
    if np.ptp(height) < thresholds.wall_extent_m or np.ptp(height) == 0:
        return False
    lean, offset = np.polyfit(height - height[0], distance - distance[0], 1)
    residual = distance - distance[0] - lean * (height - height[0]) - offset
    return bool(
        abs(lean) <= thresholds.slope and np.sqrt(np.mean(residual**2)) <= thresholds.straight_m
    )
