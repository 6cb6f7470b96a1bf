"""Loops of the fused classifier that compute how smooth the surroundings of every shot are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.loops import helper, loop
from prc_cli.core.types import F32, F32_2, I32, U8, U8_2
from prc_cli.methods.fused.lists_loops import list_few
from prc_cli.methods.fused.records import FiveLines
from prc_cli.methods.fused.thresholds import DepthThresholds

Pairs = NDArray[np.uint32]

LINES = 2
"""Lines before and after a line that its texture is computed from."""
MOST_SMOOTH = 8
"""A shot with so many smooth pairs is as smooth as one with more."""
MOST_COLUMNS = 60
LEAST_COLUMNS = 3
"""Limits of the half width of a place, in columns."""
LEAST_SEEN = np.float32(0.85)
"""Lower limit of the share of a place that is not hidden, by which its smoothness is divided."""
DEPTH_SHOTS = 4
"""Shots of a line on either side that are read where a place is looked at again."""


@helper
def write_pairs(
    near: U8,
    smooth: U8,
    least_near: np.float32,
    pairs: Pairs,
) -> None:
    """Write a word for every shot of a line: one shot in its upper half, smooth pairs in its lower.

    A place has at most 605 shots and 4840 pairs, so neither half of their sum overflows.
    """
    for i in range(len(near)):
        n_smooth = np.uint32(min(smooth[i], np.uint8(MOST_SMOOTH)))
        is_counted = np.float32(near[i]) >= least_near
        pairs[i] = n_smooth | np.uint32(1 << 16) if is_counted else np.uint32(0)


@helper
def _sum_up(lines: FiveLines, sums_before: Pairs, sums: Pairs) -> None:
    """Write the sums of the first 0, 1, ... columns of five lines.

    They may overflow, their differences are still right.
    """
    a, b, c, d, e = lines
    for i in range(len(sums)):
        sums[i] = a[i] + b[i] + c[i] + d[i] + e[i]
    total = np.uint32(0)
    sums_before[0] = total
    for i in range(len(sums)):
        total = np.uint32(total + sums[i])
        sums_before[i + 1] = total


@helper
def _write_shares(
    ranges: F32,
    step: np.float32,
    half_m: np.float32,
    sums_before: Pairs,
    columns: I32,
    sums: Pairs,
    shares: F32,
) -> None:
    """Write the share of smooth pairs in every shot's place, and its half width in columns.

    Step by step, because only a loop that reads memory in order uses vector instructions.
    """
    m = len(ranges)
    fewest = np.float32(LEAST_COLUMNS)
    most = np.float32(MOST_COLUMNS)
    for i in range(m):
        r = ranges[i] if ranges[i] == ranges[i] else np.float32(1.0)
        columns[i] = np.int32(min(max(half_m / (r * step), fewest), most))
    for i in range(m):
        half = columns[i]
        first = max(i - int(half), 0)
        last = min(i + int(half) + 1, m)
        sums[i] = sums_before[np.uint64(last)] - sums_before[np.uint64(first)]
    for i in range(m):
        shots = np.int32(sums[i] >> np.uint32(16))
        pairs = np.int32(sums[i] & np.uint32(0xFFFF))
        share = np.float32(pairs) / (np.float32(MOST_SMOOTH) * np.float32(max(shots, np.int32(1))))
        shares[i] = share if (ranges[i] == ranges[i]) & (shots > 0) else np.float32(0.0)


@helper
def _share_at_depth(
    ranges: FiveLines,
    pairs: FiveLines,
    i: int,
    half: int,
    depth_m: np.float32,
) -> np.float32:
    """Return the share of smooth pairs among the shots of a place about as far as its middle.

    If nearer things hide part of the place, fewer pairs can be smooth.
    """
    range_m = ranges.middle[i]
    m = len(ranges.middle)
    stride = max((half + DEPTH_SHOTS - 1) // DEPTH_SHOTS, 1)
    place = max(i - half // stride * stride, i % stride)
    last = min(i + half + 1, m)
    pairs_a, pairs_b, pairs_c, pairs_d, pairs_e = pairs
    a, b, c, d, e = ranges
    total = np.uint32(0)
    every = np.uint32(0)
    nothing = np.uint32(0)
    while place < last:
        # every word is read, near or not, to avoid a branch
        j = np.uint64(place)
        total += pairs_a[j] if abs(a[j] - range_m) < depth_m else nothing
        total += pairs_b[j] if abs(b[j] - range_m) < depth_m else nothing
        total += pairs_c[j] if abs(c[j] - range_m) < depth_m else nothing
        total += pairs_d[j] if abs(d[j] - range_m) < depth_m else nothing
        total += pairs_e[j] if abs(e[j] - range_m) < depth_m else nothing
        every += pairs_a[j] + pairs_b[j] + pairs_c[j] + pairs_d[j] + pairs_e[j]
        place += stride
    n_shots = np.int32(total >> np.uint32(16))
    n_pairs = np.int32(total & np.uint32(0xFFFF))
    seen = np.float32(n_shots) / np.float32(max(np.int32(every >> np.uint32(16)), np.int32(1)))
    possible = (
        np.float32(MOST_SMOOTH) * np.float32(max(n_shots, np.int32(1))) * max(seen, LEAST_SEEN)
    )
    return np.float32(n_pairs) / possible


@helper
def _raise_shares(
    ranges: FiveLines,
    pairs: FiveLines,
    columns: I32,
    smooth: U8,
    thresholds: DepthThresholds,
    shares: F32,
    marks: U8,
    shots: I32,
) -> None:
    """Raise the share of a rough place around a smooth shot to the share at the shot's distance."""
    range_m = ranges.middle
    for i in range(len(shares)):
        is_smooth = np.float32(smooth[i]) >= thresholds.pairs
        is_rough = (shares[i] < thresholds.share) & (range_m[i] == range_m[i])
        marks[i] = np.uint8(is_smooth & is_rough)
    for k in range(list_few(marks, shots)):
        i = shots[k]
        at_depth = _share_at_depth(ranges, pairs, int(i), int(columns[i]), thresholds.depth_m)
        shares[i] = max(shares[i], at_depth)


@loop()
def mean_smoothness(
    range_m: F32_2,
    near: U8_2,
    smooth: U8_2,
    step: np.float32,
    least_near: np.float32,
    half_m: np.float32,
    thresholds: DepthThresholds,
) -> F32_2:
    """Compute the share of smooth pairs around every shot: in five lines, over a width in metres.

    A place with few is looked at again without what is nearer or farther: leaves before a wall do
    not make it rough. Then at most nine columns of it are read.

    ``range_m`` (lines + 4, M) float32, metres; ``near, smooth`` (lines + 4, M) uint8; returns
    (lines, M) float32.
    """
    n_lines = range_m.shape[0] - 2 * LINES
    m = range_m.shape[1]
    mean = np.empty((n_lines, m), np.float32)
    room = 2 * LINES + 1
    # ring buffer of lines
    words = np.empty((room, m), np.uint32)
    together = np.empty(m, np.uint32)
    sums_before = np.empty(m + 1, np.uint32)
    columns = np.empty(m, np.int32)
    marks = np.empty(m, np.uint8)
    shots = np.empty(m + 1, np.int32)
    for k in range(n_lines + 2 * LINES):
        write_pairs(near[k], smooth[k], least_near, words[k % room])
        if k < 2 * LINES:
            continue
        line = k - 2 * LINES
        lines = FiveLines(words[0], words[1], words[2], words[3], words[4])
        _sum_up(lines, sums_before, together)
        _write_shares(
            range_m[line + LINES], step, half_m, sums_before, columns, together, mean[line]
        )
        ranges = FiveLines(
            range_m[line],
            range_m[line + 1],
            range_m[line + 2],
            range_m[line + 3],
            range_m[line + 4],
        )
        a = line % room
        b = (line + 1) % room
        c = (line + 2) % room
        d = (line + 3) % room
        e = (line + 4) % room
        pairs = FiveLines(words[a], words[b], words[c], words[d], words[e])
        smooth_of_line = smooth[line + LINES]
        _raise_shares(ranges, pairs, columns, smooth_of_line, thresholds, mean[line], marks, shots)
    return mean
