"""Slow and obvious twin of :mod:`prc_cli.kernels.fused.flanks`."""

from __future__ import annotations

from math import floor

import numpy as np

from prc_cli.core.thresholds.fused import FlankThresholds
from prc_cli.core.types import F32, U8
from tests.oracles.fused_strips import sum_around

N, BIN = 320, np.float32(0.25)


def find_flanks(
    range_m: F32,
    above_m: F32,
    upright: U8,
    beams: tuple[F32, F32],
    sums: tuple[F32, F32],
    levels: U8,
    thresholds: FlankThresholds,
) -> tuple[U8, U8]:
    """Find flanks of vehicles; see :func:`prc_cli.kernels.fused.flanks.find_flanks`."""
    flanks, found = np.zeros((len(levels), N), np.uint8), levels.copy()
    side_m = range_m * beams[0]
    is_ground = (np.abs(above_m) < thresholds.soil_m) & (upright < 2)
    for line in range(len(levels)):
        lines = slice(line, line + 5)
        wall, place = (sum_around(values[lines]) for values in sums)
        least, most = thresholds.least_m * np.float32(5), thresholds.most_m * np.float32(5)
        for b in np.flatnonzero((wall > 0) & (wall >= least) & (wall <= most)):
            beside = sums[0][lines, max(b - 1, 0) : b + 2]
            has_ground = is_ground[lines] & (beside > 0).any(axis=1)[:, None]
            places = [floor(y / BIN) for y in side_m[lines][has_ground]]
            out = [q if b >= N // 2 else -1 - q for q in places]
            away = abs(place[b] / wall[b])
            first = int((away + thresholds.behind_m) / BIN) + 1
            beneath = sum(first <= q < min(first + 3, N) for q in out)
            beyond = sum(first + 4 <= q < min(first + 8, N) for q in out)
            if beneath >= thresholds.shots and beyond * 4 <= beneath:
                flanks[line, b] = 1
                at = int(away / BIN)
                for j in range(at, min(at + 6, N)):
                    found[line, N + j if b >= N // 2 else N - 1 - j] = 1
    return flanks, found
