"""Loop of the fused classifier that finds the faces of curbs.

Steep steps between two pieces of ground.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import F32, F32_2, I32, U8, U8_2
from prc_cli.methods.fused.lists_loops import list_few
from prc_cli.methods.fused.records import Beams
from prc_cli.methods.fused.thresholds import CurbThresholds

APART = 2
"""A face climbs from the shot so many columns before to that so many columns after."""
MOST_COLUMNS = 200
"""Columns to either side in which the ground beside a face is looked for."""
MOST_GAP = 8
"""Adjacent columns without a shot near the ground at which it ends, as at a wall."""
CHUNK = 8
"""Shots that are compared at once, and empty columns beside a line."""
_MISSING = int(Label.MISSING)
_NOISE = int(Label.NOISE)
_GROUND = int(Label.GROUND)
_CURB = int(Label.CURB)


@helper
def _mark_climbing(
    ranges: F32,
    above: F32,
    labels: U8,
    beams: Beams,
    outwards: F32,
    most_m: np.float32,
    climb: np.float32,
    side: F32,
    height: F32,
    low: U8,
    climbs: U8,
) -> None:
    """Write the points of a line; mark the shots near the ground, and those where the line climbs.

    ``side`` is NaN unless the shot is near the ground. Without branches, so that the compiler can
    use vector instructions.
    """
    m = len(ranges)
    for i in range(m):
        height[i] = -(ranges[i] * beams.cosine[i])
    for i in range(m):
        low[i] = np.uint8(
            (abs(above[i]) < most_m) & (labels[i] != _MISSING) & (labels[i] != _NOISE)
        )
    for i in range(m):
        side[CHUNK + i] = ranges[i] * beams.sine[i] if low[i] != 0 else np.float32(np.nan)
    for i in range(m):
        climbs[i] = np.uint8(0)
    inner = m - 2 * APART
    before = height[:inner]
    after = height[2 * APART :]
    inner_m = ranges[APART : m - APART]
    marks = climbs[APART : m - APART]
    for i in range(inner):
        marks[i] = np.uint8((after[i] - before[i]) * outwards[i] >= climb * inner_m[i])
    for i in range(m):
        climbs[i] &= low[i]


@helper
def _ends_of_ground(i: int, low: U8) -> tuple[int, int]:
    """Return the first and last column of the ground around a shot, up to wide gaps."""
    first = last = i
    j = i - 1
    while j >= 0 and first - j <= MOST_GAP + 1:
        first = j if low[j] != 0 else first
        j -= 1
    j = i + 1
    while j < len(low) and j - last <= MOST_GAP + 1:
        last = j if low[j] != 0 else last
        j += 1
    return first, last


@inlined
def _is_beyond(
    side: F32,
    first: int,
    y: np.float32,
    half_m: np.float32,
) -> bool:
    """Whether any of CHUNK shots is beyond the face at ``y``; without branches, to be fast."""
    beyond = np.uint8(0)
    for j in range(first, first + CHUNK):
        beyond |= np.uint8(abs(side[j] - y) > half_m)
    return bool(beyond != 0)


@inlined
def _mean_height(
    i: int,
    way: int,
    first: int,
    side: F32,
    height: F32,
    low: U8,
    labels: U8,
    thresholds: CurbThresholds,
) -> tuple[np.float32, int]:
    """Return the mean height of the ground beside a face, and its number of shots."""
    y = side[CHUNK + i]
    total = np.float32(0.0)
    n = 0
    j = first
    gap = 0
    last = i + way * MOST_COLUMNS
    while 0 <= j < len(height) and (last - j) * way >= 0 and gap <= MOST_GAP:
        gap += 1
        if low[j] != 0:
            gap = 0
            away = abs(side[CHUNK + j] - y)
            if away > thresholds.reach_m:
                break
            if away > thresholds.half_m and labels[j] == _GROUND:
                total += height[j]
                n += 1
        j += way
    return (total / np.float32(n) if n > 0 else total), n


@loop()
def curb_labels(
    labels: U8_2,
    range_m: F32_2,
    above_m: F32_2,
    beams: Beams,
    step: np.float32,
    thresholds: CurbThresholds,
) -> U8_2:
    """Label the faces of curbs.

    A shot near the ground is on a face if the line climbs there, the ground is higher beyond the
    face than before it, most of this rise is within the width of the face, and the shot is between
    both heights.

    ``labels`` (lines, M) uint8; ``range_m, above_m`` (lines, M) float32, metres; ``beams`` (M,)
    float32; returns (lines, M) uint8.
    """
    n_lines, m = labels.shape
    curbs = np.empty((n_lines, m), np.uint8)
    height = np.empty(m, np.float32)
    low = np.empty(m, np.uint8)
    climbs = np.empty(m, np.uint8)
    side: F32 = np.empty(m + 2 * CHUNK, np.float32)
    for i in range(CHUNK):
        side[i] = side[CHUNK + m + i] = np.float32(np.nan)
    shots: I32 = np.empty(m + 1, np.int32)
    cosine = beams.cosine
    # whether columns run outwards, 1, or inwards, -1
    ways = np.ones(max(m - 2 * APART, 0), np.float32)
    for i in range(len(ways)):
        if not cosine[i + 2 * APART] < cosine[i]:
            ways[i] = np.float32(-1.0)
    climb = thresholds.steep * step
    for line in range(n_lines):
        before_curbs = labels[line]
        row = curbs[line]
        ranges = range_m[line]
        for i in range(m):
            row[i] = before_curbs[i]
        if m <= 2 * APART:
            continue
        _mark_climbing(
            ranges,
            above_m[line],
            before_curbs,
            beams,
            ways,
            thresholds.most_m,
            climb,
            side,
            height,
            low,
            climbs,
        )
        first = last = -1
        for k in range(list_few(climbs, shots)):
            i = int(shots[k])
            if i > last:
                first, last = _ends_of_ground(i, low)
            outwards = int(ways[i - APART])
            y = side[CHUNK + i]
            z = height[i]
            # nearest columns before and after the face with ground beside it, -1 = none
            before = i - 1
            lowest = max(first, i - MOST_COLUMNS)
            while before >= lowest and not _is_beyond(side, before + 1, y, thresholds.half_m):
                before -= CHUNK
            while before >= lowest and not abs(side[CHUNK + before] - y) > thresholds.half_m:
                before -= 1
            if before < lowest or not abs(side[CHUNK + before] - y) <= thresholds.reach_m:
                before = -1
            after = i + 1
            highest = min(last, i + MOST_COLUMNS)
            while after <= highest and not _is_beyond(side, CHUNK + after, y, thresholds.half_m):
                after += CHUNK
            while after <= highest and not abs(side[CHUNK + after] - y) > thresholds.half_m:
                after += 1
            if after > highest or not abs(side[CHUNK + after] - y) <= thresholds.reach_m:
                after = -1
            inner, outer = (before, after) if outwards > 0 else (after, before)
            # most shots end here
            if (
                inner < 0
                or outer < 0
                or height[outer] - height[inner] < thresholds.share * thresholds.least_m
            ):
                continue
            foot, n_foot = _mean_height(
                i, -outwards, inner, side, height, low, before_curbs, thresholds
            )
            top, n_top = _mean_height(
                i, outwards, outer, side, height, low, before_curbs, thresholds
            )
            rise = top - foot
            if n_foot == 0 or n_top == 0 or rise < thresholds.least_m or rise > thresholds.most_m:
                continue
            is_between = (z > foot + thresholds.margin * rise) & (
                z < top - thresholds.margin * rise
            )
            if is_between & (height[outer] - height[inner] >= thresholds.share * rise):
                row[i] = np.uint8(_CURB)
    return curbs
