"""Slow and obvious twins of :mod:`prc_cli.methods.fused.strips_loops`."""

from __future__ import annotations

from math import floor

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.thresholds import StripThresholds, WallThresholds

N, WIDTH, HALF_WIDTH, SLOT = 320, np.float32(0.5), np.float32(0.25), np.float32(0.25)
NOTHING = np.float32(-1e9)

Slots = NDArray[np.uint64]


def fill_strips(
    range_m: F32,
    above_m: F32,
    counts: tuple[U8, U8, U8, U8],
    beams: tuple[F32, F32],
    step: np.float32,
    thresholds: StripThresholds,
) -> tuple[Slots, Slots, F32, F32, F32, F32, U8]:
    """Sort shots into strips; see :func:`prc_cli.methods.fused.strips_loops.fill_strips`."""
    ranges, above = range_m, above_m
    side, height = ranges * beams[0], -(ranges * beams[1])
    near, smooth, upright, level = counts
    shape = (len(ranges), N)
    every, rough = np.zeros(shape, np.uint64), np.zeros(shape, np.uint64)
    length, wall, place = (np.zeros(shape, np.float32) for _ in range(3))
    top, levels = np.full(shape, NOTHING), np.zeros((len(ranges), 2 * N), np.uint8)
    for k, i in zip(*np.nonzero((above >= thresholds.foot_m) & (near >= thresholds.least_near)), strict=True):
        y, strip = side[k, i], floor(side[k, i] / WIDTH) + N // 2
        if not 0 <= strip < N:
            continue
        bit = np.uint64(1 << min(int(above[k, i] / SLOT), 63))
        every[k, strip] |= bit
        beside = smooth[k, i - 1 : i + 2] if 0 < i < ranges.shape[1] - 1 else smooth[k, i]
        if np.all(beside <= thresholds.rough):
            rough[k, strip] |= bit
        stands_for = ranges[k, i] * step / max(abs(y) / ranges[k, i], np.float32(0.3))
        length[k, strip] += stands_for
        if smooth[k, i] >= thresholds.smooth and upright[k, i] >= 2:
            wall[k, strip] += stands_for
            place[k, strip] += stands_for * y
            top[k, strip] = max(top[k, strip], height[k, i])
        is_level = smooth[k, i] >= thresholds.level_smooth and level[k, i] > upright[k, i]
        if is_level and above[k, i] < thresholds.level_top_m and height[k, i] < 0:
            adjacent = [side[k, j] for j in (i - 1, i + 1) if 0 <= j < side.shape[1]]
            beside = [other for other in adjacent if abs(other - y) < thresholds.jump_m]
            low, high = (floor(end / HALF_WIDTH) + N for end in (min([y, *beside]), max([y, *beside])))
            levels[k, max(low, 0) : max(min(high, 2 * N - 1) + 1, 0)] = 1
    return every, rough, length, wall, place, top, levels


def widen_slots(slots: Slots) -> Slots:
    """Widen slots; see :func:`prc_cli.methods.fused.strips_loops.widen_slots`."""
    padded = np.pad(slots, ((0, 0), (1, 1)))
    n_lines = len(slots) - 4
    wide = np.zeros((n_lines, N), np.uint64)
    for k in range(5):
        for b in range(3):
            wide |= padded[k : k + n_lines, b : b + N]
    return wide


def widen_levels(levels: U8) -> U8:
    """Widen level surfaces; see :func:`prc_cli.methods.fused.strips_loops.widen_levels`."""
    return np.stack([levels[k : k + 5].max(axis=0) for k in range(len(levels) - 4)])


def find_walls(sums: tuple[F32, F32, F32, F32], flanks: U8, thresholds: WallThresholds) -> tuple[F32, F32, F32]:
    """Find walls; see :func:`prc_cli.methods.fused.strips_loops.find_walls`."""
    n_lines = len(sums[0]) - 4
    at, top, ahead = (np.zeros((n_lines, N), np.float32) for _ in range(3))
    for line in range(n_lines):
        length, wall, place = (sum_around(values[line : line + 5]) for values in sums[:3])
        highest = np.pad(sums[3][line : line + 5].max(axis=0), 1, constant_values=NOTHING)
        is_wall = (wall >= thresholds.height_m * np.float32(5)) & (wall >= thresholds.share * length) & (wall > 0)
        there = np.pad(sums[1][line : line + 5] > 0, ((0, 0), (1, 1)))
        seen_by = (there[:, :-2] | there[:, 1:-1] | there[:, 2:]).sum(axis=0)
        is_wall &= (flanks[line] == 0) & (seen_by >= thresholds.lines)
        for side in (np.arange(N // 2, N), np.arange(N // 2 - 1, -1, -1)):
            number = np.arange(N // 2)
            inwards = np.maximum.accumulate(np.where(is_wall[side], number, -1))
            outwards = np.minimum.accumulate(np.where(is_wall[side], number, N)[::-1])[::-1]
            for k in np.flatnonzero(inwards >= 0):
                w = side[inwards[k]]
                at[line, side[k]], top[line, side[k]] = place[w] / wall[w], highest[w : w + 3].max()
            for k in np.flatnonzero(outwards < N):
                w = side[outwards[k]]
                where = place[w] / wall[w]
                if abs(where) - np.float32(k) * WIDTH <= thresholds.before_m + WIDTH:
                    ahead[line, side[k]] = where
    return at, top, ahead


def sum_around(values: F32) -> F32:
    """Add up five lines, and three strips."""
    lines = values[0].copy()
    for k in range(1, 5):
        lines = lines + values[k]
    padded = np.pad(lines, 1)
    total: F32 = (padded[:-2] + padded[1:-1]) + padded[2:]
    return total
