"""Loops of the method for rings that find the ground, a surface of sectors by bins of distance."""

from __future__ import annotations

import math

import numpy as np

from prc_cli.core.loops import helper, loop
from prc_cli.core.types import F32_2, F32_3, F64_1, F64_2, Mask_2
from prc_cli.methods.rings.thresholds import GroundThresholds

_FAR = 1e9
_SIDES = np.array([-1, 0, 1])
_SHARES = np.array([1.0, 2.0, 1.0])
"""Weights of the sectors beside a sector, and of itself."""


@loop()
def lowest_heights(
    xyz_m: F32_3,
    place: F32_2,
    up: float,
    sector_lines: int,
    n_bins: int,
    pair_m: float,
) -> F32_2:
    """Return the lowest height of every cell that another shot confirms, (sectors, bins) float32.

    NaN = none.

    ``xyz_m`` (lines, M, 3) float32, metres; ``place`` (lines, M) float32; ``up`` is -1 where z
    points down.
    """
    n_lines, m = place.shape
    n_sectors = (n_lines + sector_lines - 1) // sector_lines
    three = np.full((n_sectors, n_bins, 3), _FAR)
    for line in range(n_lines):
        for i in range(m):
            if not place[line, i] < n_bins:
                continue
            low = three[line // sector_lines, int(place[line, i])]
            z = up * float(xyz_m[line, i, 2])
            if z < low[0]:
                low[0], low[1], low[2] = z, low[0], low[1]
            elif z < low[1]:
                low[1], low[2] = z, low[1]
            elif z < low[2]:
                low[2] = z
    lowest = np.full((n_sectors, n_bins), np.nan, np.float32)
    for s in range(n_sectors):
        for b in range(n_bins):
            low = three[s, b]
            if low[1] == _FAR:
                if low[0] < _FAR:
                    lowest[s, b] = np.float32(low[0])
            elif low[1] - low[0] < pair_m:
                lowest[s, b] = np.float32(0.5 * (low[0] + low[1]))
            elif low[2] - low[1] < pair_m:
                lowest[s, b] = np.float32(0.5 * (low[1] + low[2]))
    return lowest


@loop()
def walk_outwards(
    off_m: F32_2, middle_m: F64_1, thresholds: GroundThresholds
) -> tuple[F64_2, Mask_2]:
    """Follow the ground from cell to cell away from the scanner, in all sectors at once.

    A height is ground where it is near what the sector and those beside it let expect. ``off_m``
    (sectors, bins) float32, lowest heights above a plane [m]; ``middle_m`` (bins,) float64; returns
    heights above it, (sectors, bins) float64, and whether they were seen, bool.
    """
    n_sectors, n_bins = off_m.shape
    height = np.empty((n_sectors, n_bins))
    seen = np.zeros((n_sectors, n_bins), np.bool_)
    last = np.zeros(n_sectors)
    last_seen_m = np.full(n_sectors, middle_m[0])
    slope = np.zeros(n_sectors)
    for b in range(n_bins):
        for s in range(n_sectors):
            total = weight = 0.0
            for k in range(3):
                q = (s + _SIDES[k]) % n_sectors
                gap = middle_m[b] - last_seen_m[q]
                share = _SHARES[k] / (1.0 + 0.2 * gap)
                total += share * (last[q] + slope[q] * min(gap, thresholds.far_m))
                weight += share
            height[s, b] = total / weight
        for s in range(n_sectors):
            if off_m[s, b] != off_m[s, b]:
                continue
            gap = middle_m[b] - last_seen_m[s]
            above = float(off_m[s, b]) - height[s, b]
            reach = min(gap, thresholds.gap_m)
            if above > thresholds.step_m + thresholds.rise * reach:
                continue
            if above < -thresholds.step_m - thresholds.fall * reach:
                continue
            height[s, b] = float(off_m[s, b])
            seen[s, b] = True
            if gap > 0:
                steep = min(
                    max((height[s, b] - last[s]) / gap, -thresholds.slope), thresholds.slope
                )
                share = min(gap / (gap + thresholds.follow_m), thresholds.follow)
                slope[s] += share * (steep - slope[s])
            last[s] = height[s, b]
            last_seen_m[s] = middle_m[b]
    return height, seen


@loop()
def smooth_surface(
    height_m: F64_2,
    weight: F64_2,
    start_m: F64_2,
    stiff: float,
    rounds: int,
    is_round: bool,
) -> F64_2:
    """Return a surface between heights of cells and of their neighbours, (sectors, bins) float64.

    ``height_m, weight, start_m`` (sectors, bins) float64; ``is_round``: the last sector is beside
    the first.
    """
    n_sectors, n_bins = height_m.shape
    surface = start_m.copy()
    for _ in range(rounds):
        for s in range(n_sectors):
            for b in range(n_bins):
                total = weight[s, b] * height_m[s, b]
                total_weight = weight[s, b]
                if b > 0:
                    total += stiff * surface[s, b - 1]
                    total_weight += stiff
                if b + 1 < n_bins:
                    total += stiff * surface[s, b + 1]
                    total_weight += stiff
                if s > 0 or is_round:
                    total += stiff * surface[(s - 1) % n_sectors, b]
                    total_weight += stiff
                if s + 1 < n_sectors or is_round:
                    total += stiff * surface[(s + 1) % n_sectors, b]
                    total_weight += stiff
                if total_weight > 0:
                    surface[s, b] = total / total_weight
    return surface


@helper
def _between(low: float, high: float, share: float) -> float:
    return low + share * (high - low)


@loop()
def heights_above(
    xyz_m: F32_3,
    place: F32_2,
    up: float,
    surface_m: F64_2,
    sector_lines: int,
    root: float,
    thresholds: GroundThresholds,
) -> tuple[F32_2, F64_2, F64_2]:
    """Return the height of every shot above a surface, and by cell sum and number of those near it.

    ``xyz_m`` (lines, M, 3) float32, metres; ``place`` (lines, M) float32; ``surface_m`` (sectors,
    bins) float64; ``root`` is the number of bins per square root of a metre; returns (lines, M)
    float32, NaN = missing, and twice (sectors, bins) float64.
    """
    n_lines, m = place.shape
    n_sectors, n_bins = surface_m.shape
    above = np.empty((n_lines, m), np.float32)
    total = np.zeros((n_sectors, n_bins))
    number = np.zeros((n_sectors, n_bins))
    row = np.empty(n_bins)
    for line in range(n_lines):
        # the surface in this line, between the middles of two sectors
        along = (line + 0.5) / sector_lines - 0.5
        first = math.floor(along)
        low = max(int(first), 0)
        high = min(int(first) + 1, n_sectors - 1)
        for b in range(n_bins):
            row[b] = _between(surface_m[low, b], surface_m[high, b], along - first)
        sector = line // sector_lines
        for i in range(m):
            if place[line, i] != place[line, i]:
                above[line, i] = np.float32(np.nan)
                continue
            bin_place = min(max(float(place[line, i]) - 0.5, 0.0), n_bins - 1.001)
            b = int(bin_place)
            off = up * float(xyz_m[line, i, 2]) - _between(row[b], row[b + 1], bin_place - b)
            above[line, i] = np.float32(off)
            distance = float(place[line, i]) / root
            limit = thresholds.near_m + thresholds.near_per_m * distance * distance
            if place[line, i] < n_bins and abs(off) < limit:
                b = int(place[line, i])
                total[sector, b] += off
                number[sector, b] += 1.0
    return above, total, number
