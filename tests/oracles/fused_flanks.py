"""Slow and obvious twin of :mod:`prc_cli.methods.fused.flanks_loops`."""

from __future__ import annotations

from math import floor

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32, I32, U8, Mask
from prc_cli.methods.fused.records import Beams, StripSums
from prc_cli.methods.fused.thresholds import FlankThresholds
from tests.oracles.fused_strips import sum_around

Slots = NDArray[np.uint64]
N = 320
WIDTH = np.float32(0.5)
BIN = np.float32(0.125)
LEVEL_BIN = np.float32(0.25)


def find_flanks(
    range_m: F32,
    above_m: F32,
    upright: U8,
    beams: Beams,
    sums: StripSums,
    slots: Slots,
    levels: U8,
    thresholds: FlankThresholds,
) -> tuple[U8, U8]:
    """Find flanks of vehicles; see :func:`prc_cli.methods.fused.flanks_loops.find_flanks`."""
    flanks = np.zeros((len(levels), N), np.uint8)
    widened = levels.copy()
    side_m = range_m * beams[0]
    is_ground = (np.abs(above_m) < thresholds.soil_m) & (upright < 2)
    counts, depths = ground_of(side_m, range_m * beams[1], is_ground)
    for line in range(len(levels)):
        lines = slice(line, line + 5)
        length, wall, place = (sum_around(values[lines]) for values in sums[:3])
        least = thresholds.least_m * np.float32(5)
        most = thresholds.most_m * np.float32(5)
        for b in np.flatnonzero(
            (wall > 0) & (wall >= least) & (wall <= most) & (wall >= thresholds.share * length)
        ):
            seen = lines.start + np.flatnonzero(
                (sums[1][lines, max(b - 1, 0) : b + 2] > 0).any(axis=1)
            )
            away = abs(place[b] / wall[b])
            way = slice(2 * N, None) if b >= N // 2 else slice(2 * N - 1, None, -1)
            middle = (np.arange(2 * N, dtype=np.float32) + np.float32(0.5)) * BIN
            beneath = beyond = 0
            for k in seen:
                first = int(away / BIN)
                bin_number = np.arange(2 * N)
                ground = (counts[k, way] > 0) & (bin_number >= first) & (bin_number < 2 * first)
                passes = depths[k, way] * (np.float32(1) - away / middle)
                # behind ground that is seen above the body nothing counts
                high = np.flatnonzero(ground & (passes > thresholds.body_m))
                ground[high[0] if len(high) else 2 * N :] = False
                beneath += counts[k, way][
                    ground & (passes >= thresholds.low_m) & (passes <= thresholds.sill_m)
                ].sum()
                beyond += counts[k, way][ground & (passes > thresholds.sill_m)].sum()
            is_low = beneath >= thresholds.shots and beyond * 4 <= beneath
            hangs = wall[b] >= thresholds.large_m * np.float32(5)
            hangs = hangs and _hangs(
                counts[seen, way], depths[seen, way], slots[seen], b, away, thresholds
            )
            if is_low or hangs:
                flanks[line, b] = 1
                bin_number = int(away / LEVEL_BIN)
                for j in range(bin_number, min(bin_number + 6, N)):
                    widened[line, N + j if b >= N // 2 else N - 1 - j] |= 17 if hangs else 1
    return flanks, widened


def _hangs(
    counts: I32,
    depths: F32,
    every: Slots,
    b: int,
    away: np.float32,
    thresholds: FlankThresholds,
) -> bool:
    """Return whether lines see ground below a body as high as a lorry's, and none through it."""
    middle = (np.arange(2 * N, dtype=np.float32) + np.float32(0.5)) * BIN
    bins = np.arange(2 * N)
    first = int(away / BIN)
    shot_bin = min(int(away / WIDTH), N // 2 - 1)
    strips = [shot_bin, max(shot_bin - 1, 0)]
    bottoms = []
    below = 0
    through = 0
    for n_shots, depth, slots in zip(counts, depths, every, strict=True):
        word = 0
        for j in strips:
            word |= int(slots[N // 2 + j if b >= N // 2 else N // 2 - 1 - j])
        bottom = np.float32(next((k for k in range(12) if word >> k & 1), 12)) * np.float32(0.25)
        if not thresholds.body_m <= bottom <= thresholds.high_m:
            continue
        bottoms.append(bottom)
        ground = (n_shots > 0) & (bins >= first) & (bins < 2 * first)
        passes = depth * (np.float32(1) - away / middle)
        below += n_shots[ground & (passes >= np.float32(0.5) * bottom) & (passes <= bottom)].sum()
        through += n_shots[ground & (passes > bottom + np.float32(0.25))].sum()
    is_even = not bottoms or max(bottoms) - min(bottoms) <= 0.25
    return bool(is_even and below >= thresholds.shots and through * 4 <= below)


def ground_of(side_m: F32, depth_m: F32, is_ground: Mask) -> tuple[I32, F32]:
    """Return the shots of the ground in every bin of every line, and how deep the last of them
    lies, (lines, 4 N)."""
    counts = np.zeros((len(side_m), 4 * N), np.int32)
    depths = np.zeros((len(side_m), 4 * N), np.float32)
    for k, i in zip(*np.nonzero(is_ground), strict=True):
        q = floor(side_m[k, i] / BIN) + 2 * N
        if 0 <= q < 4 * N:
            counts[k, q] += 1
            depths[k, q] = depth_m[k, i]
    return counts, depths
