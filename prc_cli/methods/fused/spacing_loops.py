"""Loop of the fused classifier that measures how far lines are apart.

Close lines meet the same leaves again.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.loops import helper, loop
from prc_cli.core.types import F32, F32_2, I32, I32_3, U8
from prc_cli.methods.fused.thresholds import SpacingThresholds

LAGS = (1, 2, 4, 8, 16)
"""Distances of the lines that are compared, in lines."""
MOST_LAG = LAGS[-1]
BESIDE = 2
"""Columns to the shot of the line itself that is compared too."""
ROWS = len(LAGS) + 1
"""Counts of a line: at every lag, and beside."""
EVERY_LINE = 4
"""Every fourth line of the stream is compared."""


@helper
def _mark_leaves(
    ranges: F32,
    thresholds: SpacingThresholds,
    limits: F32,
    leaves: U8,
) -> int:
    """Mark, and count, the shots of a line with neighbours that are near but not on one surface.

    Write into ``limits`` by how much another shot on the same leaf may differ in range [m].
    """
    m = len(ranges)
    base = thresholds.tolerance_m
    per_m = thresholds.tolerance_per_m
    near = thresholds.near_m
    for i in range(m):
        limits[i] = base + per_m * ranges[i]
    leaves[0] = leaves[m - 1] = np.uint8(0)
    before = ranges[: m - 2]
    middle = ranges[1 : m - 1]
    after = ranges[2:]
    limit = limits[1 : m - 1]
    marks = leaves[1 : m - 1]
    for i in range(m - 2):
        rise_m = middle[i] - before[i]
        next_m = after[i] - middle[i]
        steps = (abs(rise_m) > limit[i]) & (abs(next_m) > limit[i])
        steps &= abs(next_m - rise_m) > limit[i]
        marks[i] = np.uint8(steps & (abs(rise_m) < near) & (abs(next_m) < near))
    # a ledge or a window's frame is one such shot, leaves are several
    n = np.int32(0)
    mark_before = np.uint8(0)
    for i in range(m - 1):
        mark = leaves[i]
        leaves[i] = mark_before & mark & leaves[i + 1]
        mark_before = mark
        n += np.int32(leaves[i])
    return int(n)


@helper
def _count_again(
    ranges: F32,
    earlier: F32,
    limits: F32,
    leaves: U8,
    row: I32,
) -> None:
    """Count the leaves of a line for which an earlier line has a return, and a return as far."""
    both = np.int32(0)
    same = np.int32(0)
    for i in range(len(ranges)):
        off = abs(ranges[i] - earlier[i])
        both += np.int32(leaves[i] & np.uint8(off == off))
        same += np.int32(leaves[i] & np.uint8(off < limits[i]))
    row[0] = both
    row[1] = same


@loop()
def leaf_repeats(range_m: F32_2, first: int, thresholds: SpacingThresholds) -> I32_3:
    """Count the leaves of a line that earlier lines meet again, at every lag.

    ``range_m`` (lines + MOST_LAG, M) float32, metres; returns (lines, 6, 2) int32.
    """
    n_lines = range_m.shape[0] - MOST_LAG
    m = range_m.shape[1]
    counts = np.empty((n_lines, ROWS, 2), np.int32)
    for line in range(n_lines):
        for k in range(ROWS):
            counts[line, k, 0] = counts[line, k, 1] = np.int32(0)
    if m < 3:
        return counts
    limits = np.empty(m, np.float32)
    leaves = np.empty(m, np.uint8)
    for line in range(first, n_lines, EVERY_LINE):
        ranges = range_m[line + MOST_LAG]
        if _mark_leaves(ranges, thresholds, limits, leaves) == 0:
            continue
        for k in range(len(LAGS)):
            _count_again(
                ranges, range_m[line + MOST_LAG - LAGS[k]], limits, leaves, counts[line, k]
            )
        last = m - BESIDE
        _count_again(
            ranges[:last], ranges[BESIDE:], limits[:last], leaves[:last], counts[line, ROWS - 1]
        )
    return counts
