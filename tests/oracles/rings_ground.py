"""Slow twins of the loops that find the ground around a spinning scanner."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np

from prc_cli.core.types import F32_2, F32_3, F64_1, F64_2, Mask_2
from prc_cli.methods.rings.thresholds import GroundThresholds


def lowest_heights(
    xyz_m: F32_3,
    place: F32_2,
    up: float,
    sector_lines: int,
    n_bins: int,
    pair_m: float,
) -> F32_2:
    sector = np.arange(len(place))[:, None] // sector_lines + np.zeros(place.shape, np.int64)
    lowest = np.full((-(-len(place) // sector_lines), n_bins), np.nan, np.float32)
    for s, b in np.ndindex(*lowest.shape):
        is_own = (sector == s) & (place >= b) & (place < b + 1)
        low = sorted(up * float(z) for z in xyz_m[..., 2][is_own])[:3]
        pairs = [0.5 * (lower + upper) for lower, upper in pairwise(low) if upper - lower < pair_m]
        if pairs or len(low) == 1:
            lowest[s, b] = pairs[0] if pairs else low[0]
    return lowest


def walk_outwards(
    off_m: F32_2, middle_m: F64_1, thresholds: GroundThresholds
) -> tuple[F64_2, Mask_2]:
    n_sectors, n_bins = off_m.shape
    height = np.empty(off_m.shape)
    seen = np.zeros(off_m.shape, np.bool_)
    last_seen = [(0.0, float(middle_m[0]), 0.0)] * n_sectors  # last height, where, slope
    for b in range(n_bins):
        before = list(last_seen)
        for s in range(n_sectors):
            expected = weight = 0.0
            for beside, share in ((-1, 1.0), (0, 2.0), (1, 1.0)):
                last, where, slope = before[(s + beside) % n_sectors]
                gap = middle_m[b] - where
                side_share = share / (1.0 + 0.2 * gap)
                expected += side_share * (last + slope * min(gap, thresholds.far_m))
                weight += side_share
            expected /= weight
            height[s, b] = expected
            last, where, slope = last_seen[s]
            own_m = float(off_m[s, b])
            gap = middle_m[b] - where
            reach = min(gap, thresholds.gap_m)
            high = thresholds.step_m + thresholds.rise * reach
            deep = -thresholds.step_m - thresholds.fall * reach
            if not deep <= own_m - expected <= high:
                continue
            height[s, b] = own_m
            seen[s, b] = True
            if gap > 0:
                steep = min(max((own_m - last) / gap, -thresholds.slope), thresholds.slope)
                slope += min(gap / (gap + thresholds.follow_m), thresholds.follow) * (steep - slope)
            last_seen[s] = own_m, float(middle_m[b]), slope
    return height, seen


def smooth_surface(
    height_m: F64_2,
    weight: F64_2,
    start_m: F64_2,
    stiff: float,
    rounds: int,
    is_round: bool,
) -> F64_2:
    surface = start_m.copy()
    (n_sectors, n_bins) = start_m.shape
    for _ in range(rounds):
        for s, b in np.ndindex(n_sectors, n_bins):
            around = [(s, b + way) for way in (-1, 1) if 0 <= b + way < n_bins]
            around += [
                ((s + way) % n_sectors, b)
                for way in (-1, 1)
                if is_round or 0 <= s + way < n_sectors
            ]
            total = weight[s, b] * height_m[s, b]
            sum_of = weight[s, b]
            for beside in around:
                total = total + stiff * surface[beside]
                sum_of = sum_of + stiff
            if sum_of > 0:
                surface[s, b] = total / sum_of
    return surface


def heights_above(
    xyz_m: F32_3,
    place: F32_2,
    up: float,
    surface_m: F64_2,
    sector_lines: int,
    root: float,
    thresholds: GroundThresholds,
) -> tuple[F32_2, F64_2, F64_2]:
    n_sectors, n_bins = surface_m.shape
    above = np.full(place.shape, np.nan, np.float32)
    total = np.zeros(surface_m.shape)
    number = np.zeros(surface_m.shape)

    def between(low: float, high: float, share: float) -> float:
        return low + share * (high - low)

    for line, i in np.argwhere(~np.isnan(place)):
        along = (line + 0.5) / sector_lines - 0.5
        first = math.floor(along)
        low = surface_m[max(first, 0)]
        high = surface_m[min(first + 1, n_sectors - 1)]
        bin_place = min(max(float(place[line, i]) - 0.5, 0.0), n_bins - 1.001)
        b = int(bin_place)
        near, far = (between(low[k], high[k], along - first) for k in (b, b + 1))
        off = up * float(xyz_m[line, i, 2]) - between(near, far, bin_place - b)
        above[line, i] = off
        distance = float(place[line, i]) / root
        limit = thresholds.near_m + thresholds.near_per_m * distance * distance
        if place[line, i] < n_bins and abs(off) < limit:
            cell = line // sector_lines, int(place[line, i])
            total[cell] = total[cell] + off
            number[cell] = number[cell] + 1
    return above, total, number
