"""Slow and obvious twins of :mod:`prc_cli.methods.fused.stems_loops`, in NumPy and SciPy."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from prc_cli.core.classes import Reason
from prc_cli.core.types import F32, F64, I32, U8, Mask
from prc_cli.methods.fused.thresholds import (
    ForestThresholds,
    RunThresholds,
    StemThresholds,
    TerrainThresholds,
)


def ground_profiles(
    range_m: F32,
    sine: F64,
    cosine: F64,
    lines_together: int,
    n_bins: int,
    thresholds: TerrainThresholds,
) -> F64:
    """Find the height of the ground.

    See :func:`prc_cli.methods.fused.stems_loops.ground_profiles`.
    """
    bin_m = thresholds.bin_m
    profiles = []
    for start in range(0, len(range_m), lines_together):
        heights: list[list[float]] = [[] for _ in range(n_bins)]
        for ranges in range_m[start : start + lines_together].astype(np.float64):
            columns = np.flatnonzero(~np.isnan(ranges))
            for column, next_column in pairwise(columns):
                r = ranges[next_column]
                place = r * sine[next_column] * (1.0 / bin_m) + n_bins // 2
                if (
                    abs(r - ranges[column]) <= thresholds.near_m + thresholds.near_share * r
                    and 0 <= place < n_bins
                ):
                    heights[int(place)].append(-r * cosine[next_column])
        third = np.array([sorted(values)[2] if len(values) > 2 else np.inf for values in heights])
        profiles.append(_bridged(third, thresholds.slope * bin_m))
    return np.array(profiles)


def _bridged(third: F64, rise: float) -> F64:
    """Return a profile through the bins that are not too high above any other, straight between
    them."""
    allowed = third.copy()
    # rises are added one by one, as rounding has it
    for _ in third:
        allowed[1:] = np.minimum(allowed[1:], allowed[:-1] + rise)
        allowed[:-1] = np.minimum(allowed[:-1], allowed[1:] + rise)
    kept = np.flatnonzero(np.isfinite(third) & (third <= allowed))
    if not len(kept):
        return np.full(len(third), -1e9)
    profile = np.empty(len(third))
    for b in range(len(third)):
        before = kept[kept < b]
        after = kept[kept >= b]
        if not len(after):
            profile[b] = third[kept[-1]]
        elif after[0] == b or not len(before):
            profile[b] = third[after[0]]
        else:
            low = before[-1]
            high = after[0]
            profile[b] = third[high] + (high - b) / (high - low) * (third[low] - third[high])
    return profile


def ground_heights(
    range_m: F32,
    sine: F64,
    cosine: F64,
    profiles: F64,
    lines_together: int,
    bin_m: float,
) -> F32:
    """Return heights over the ground.

    See :func:`prc_cli.methods.fused.stems_loops.ground_heights`.
    """
    n_bins = profiles.shape[1]
    r = range_m.astype(np.float64)
    place = np.clip(r * sine * (1.0 / bin_m) + n_bins // 2 - 0.5, 0.0, n_bins - 1.0)
    left = np.minimum(np.nan_to_num(place).astype(np.int64), n_bins - 2)
    group = (np.arange(len(range_m)) // lines_together)[:, None]
    low = profiles[group, left]
    high = profiles[group, left + 1]
    heights: F32 = (-r * cosine - (low + (place - left) * (high - low))).astype(np.float32)
    return heights


@dataclass
class _Run:
    """Shots of a line that go up or down."""

    columns: list[int] = field(default_factory=list)
    y: list[float] = field(default_factory=list)
    z: list[float] = field(default_factory=list)
    r: list[float] = field(default_factory=list)
    passed: int = 0
    waiting: int = 0


def upright_runs(
    range_m: F32,
    height_m: F32,
    sine: F64,
    cosine: F64,
    thresholds: RunThresholds,
) -> tuple[I32, F64]:
    """Find upright runs; see :func:`prc_cli.methods.fused.stems_loops.upright_runs`."""
    runs = np.zeros(range_m.shape, np.int32)
    table = [(0.0, 0.0, 0.0, 0.0)]
    for line, row in enumerate(runs):
        for run in _runs_of_line(
            range_m[line].astype(np.float64), height_m[line], sine, cosine, thresholds
        ):
            up = abs(run.z[-1] - run.z[0])
            aside = abs(run.y[-1] - run.y[0])
            n = len(run.columns)
            if (
                n >= 3
                and up >= thresholds.short_m
                and aside <= thresholds.lean * up
                and run.passed <= n / 2
            ):
                row[run.columns] = len(table)
                table.append(
                    (
                        float(n),
                        float(run.passed),
                        min(run.z[0], run.z[-1]),
                        max(run.z[0], run.z[-1]),
                    )
                )
    return runs, np.array(table)


def _runs_of_line(
    ranges: F64,
    heights: F32,
    sine: F64,
    cosine: F64,
    thresholds: RunThresholds,
) -> list[_Run]:
    runs: list[_Run] = []
    recent: deque[_Run] = deque(maxlen=3)
    for column in np.flatnonzero(heights.astype(np.float64) >= thresholds.above_m).tolist():
        r = float(ranges[column])
        y = r * float(sine[column])
        z = -r * float(cosine[column])
        spacing = 3.0 * thresholds.step_rad * r * r / max(abs(y), 0.3)

        def follows(
            run: _Run,
            y: float = y,
            z: float = z,
            r: float = r,
            spacing: float = spacing,
        ) -> bool:
            up = abs(z - run.z[-1])
            tolerance = thresholds.tolerance_m + thresholds.tolerance_share * r
            beside = tolerance + thresholds.steep * up
            if up > spacing:
                beside = (
                    tolerance + thresholds.steep * spacing + thresholds.gap_steep * (up - spacing)
                )
            return bool(up <= thresholds.gap_m and abs(y - run.y[-1]) <= beside)

        run = next((candidate for candidate in recent if follows(candidate)), None)
        if run is None:
            run = _Run()
            runs.append(run)
        else:
            recent.remove(run)
        run.passed = run.passed + run.waiting
        run.waiting = 0
        run.columns.append(column)
        for values, value in ((run.y, y), (run.z, z), (run.r, r)):
            values.append(value)
        recent.appendleft(run)
        for merged in list(recent)[1:]:
            merged.waiting += r > merged.r[-1] + thresholds.behind_m
    return runs


def stem_shots(
    range_m: F32,
    runs: I32,
    table: F64,
    thresholds: StemThresholds,
) -> Mask:
    """Mark the shots of stems; see :func:`prc_cli.methods.fused.stems_loops.stem_shots`."""
    r = range_m.astype(np.float64)
    close = np.abs(r[1:] - r[:-1]) < thresholds.near_m + thresholds.near_share * r[1:]
    linked = close & (runs[1:] > 0) & (runs[:-1] > 0)
    size = len(table)
    pairs = (np.ones(int(linked.sum())), (runs[1:][linked], runs[:-1][linked]))
    _, body = connected_components(coo_array(pairs, shape=(size, size)), directed=False)
    is_stem = np.zeros(size, bool)
    for number in np.unique(body[1:]):
        members = np.flatnonzero(body == number)
        members = members[members > 0]
        n, passed, low, high = (table[members, column] for column in range(4))
        length = 0.0
        for run in members:  # in this order, as rounding has it
            length += table[run, 3] - table[run, 2]
        is_stem[members] = (
            n.sum() >= thresholds.shots
            and len(members) >= thresholds.runs
            and high.max() - low.min() >= thresholds.extent_m
            and length >= thresholds.total_m
            and length >= thresholds.mean_m * len(members)
            and passed.sum() <= thresholds.through_share * n.sum()
        )
    mask: Mask = is_stem[runs]
    return mask


def forest_labels(
    range_m: F32,
    height_m: F32,
    stems: Mask,
    columns_around: int,
    thresholds: ForestThresholds,
) -> U8:
    """Label a block of forest; see :func:`prc_cli.methods.fused.stems_loops.forest_labels`."""
    top = thresholds.top_m
    r = range_m.astype(np.float64)
    height = height_m.astype(np.float64)
    steps = np.abs(np.diff(height, axis=1)) < thresholds.flat_m
    level = np.zeros(r.shape, bool)
    level[:, 1:-1] = steps[:, :-1] & steps[:, 1:]
    touching = np.zeros(r.shape, bool)
    has_near = np.full(r.shape, thresholds.near_m < 0)
    lines, columns = r.shape
    for line, column in np.argwhere(~np.isnan(r)):
        around = np.s_[max(line - 1, 0) : line + 2, max(column - 1, 0) : column + 2]
        touching[line, column] = bool(
            (stems[around] & (np.abs(r[around] - r[line, column]) <= thresholds.beside_m)).any()
        )
        for i in range(max(line - 2, 0), min(line + 3, lines)):
            for k in range(
                max(column - columns_around, 0), min(column + columns_around + 1, columns)
            ):
                if (i, k) != (line, column) and abs(r[i, k] - r[line, column]) <= thresholds.near_m:
                    has_near[line, column] = True
    # the rules from the last to the first, each over those after it
    rules = np.where(has_near, Reason.PLANT, Reason.ALONE)
    rules[touching & (height <= top)] = Reason.BESIDE_STEM
    rules[level & (height <= thresholds.cover_m)] = Reason.FLAT
    rules[height <= thresholds.soil_m] = Reason.SOIL
    rules[stems & (height <= top)] = Reason.ON_STEM
    rules[stems & (height > top)] = Reason.ABOVE_TOP
    rules[height < -thresholds.below_m] = Reason.FAR_BELOW
    rules[np.isnan(height)] = Reason.MISSING
    return rules.astype(np.uint8)
