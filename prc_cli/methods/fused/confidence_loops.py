"""Loop of the fused classifier that measures how clear every shot's label is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import Label
from prc_cli.core.loops import helper, loop
from prc_cli.core.types import F32, F32_2, I32_2, I64, I64_1, I64_2, U8, U8_2
from prc_cli.methods.fused.records import (
    SLOT_M,
    STRIP_M,
    STRIPS,
    Beams,
    FilledSlots,
    Neighbours,
    Walls,
)
from prc_cli.methods.fused.strips_loops import count_bits

Words = NDArray[np.uint64]

LINES = 2
"""Lines before and after a line in which labels are compared."""
(
    AGREE,
    SMOOTH,
    TEXTURE,
    NEAR,
    UPRIGHT,
    LEVEL,
    OFF,
    STEEP,
    RANGE,
    ROUGH,
    TOP,
    FILLED,
    AHEAD,
    BEHIND,
    JUMP,
) = range(15)
"""Rows of the measures."""
N_MEASURES = 15
PLACE_M = np.float32(0.25)
"""Half width of the place, in five lines, in which labels are compared [m]."""
LEAST_COLUMNS = np.float32(2)
MOST_COLUMNS = np.float32(60)
"""Limits of the half width of a place, in columns: five lines of 121 shots fit in ten bits."""
GROUP_BITS = 10
"""Bits of the count of a group of labels in a word."""
N_GROUPS = 6
NOISE_GROUP = 5
"""The group that does not count among the others."""
NO_WALL_M = np.float32(50.0)
"""Distance of a wall where there is none [m]."""
WIDEST_JUMP_M = np.float32(6.0)
"""Difference in range to a missing shot, and to one that is farther [m]."""
PER_METRE = np.float32(0.1)
"""Jumps are given at 10 m: farther, shots are farther apart."""


_MISSING = int(Label.MISSING)


@helper
def _count_groups(labels: U8, groups: I64, words: Words) -> None:
    """Write the group of every shot of a line as a word with one count, 0 without a group."""
    for i in range(len(labels)):
        group = groups[labels[i]]
        words[i] = (
            np.uint64(1) << np.uint64(GROUP_BITS * max(group, 0)) if group >= 0 else np.uint64(0)
        )


@helper
def _sum_up(
    lines: Words,
    first: int,
    last: int,
    sums_before: Words,
) -> None:
    """Write the sums of the first 0, 1, ... columns of some lines.

    They may overflow, their differences are still right.
    """
    room = lines.shape[0]
    total = np.uint64(0)
    sums_before[0] = total
    for i in range(lines.shape[1]):
        for line in range(first, last):
            total += lines[line % room, i]
        sums_before[i + 1] = total


@helper
def _measure_agreement(
    ranges: F32,
    labels: U8,
    groups: I64,
    sums_before: Words,
    step: np.float32,
    agrees: F32,
) -> None:
    """Write the share of the shots around that are of a shot's group.

    The noise around counts only if the shot is noise.
    """
    m = len(ranges)
    ones = np.uint64((1 << GROUP_BITS) - 1)
    for i in range(m):
        group = groups[labels[i]]
        if (group < 0) | (ranges[i] != ranges[i]):
            agrees[i] = np.float32(0.0)
            continue
        half = int(min(max(PLACE_M / (ranges[i] * step), LEAST_COLUMNS), MOST_COLUMNS))
        word = sums_before[min(i + half + 1, m)] - sums_before[max(i - half, 0)]
        total = np.uint64(0)
        same = np.uint64(0)
        for k in range(N_GROUPS):
            n = (word >> np.uint64(GROUP_BITS * k)) & ones
            same = n if k == group else same
            total += n if (k != NOISE_GROUP) | (group == NOISE_GROUP) else np.uint64(0)
        agrees[i] = np.float32(same) / np.float32(total)


@helper
def _measure_strips(slots_by_any: Words, slots_by_rough: Words, strips: F32) -> None:
    """Write, for every strip of a line, its rough share of slots, its top and its filled height."""
    for b in range(STRIPS):
        n_filled = count_bits(slots_by_any[b])
        n_slots = 0
        word = slots_by_any[b]
        while word != np.uint64(0):
            word >>= np.uint64(1)
            n_slots += 1
        strips[0, b] = np.float32(count_bits(slots_by_rough[b])) / np.float32(max(n_filled, 1))
        strips[1, b] = np.float32(n_slots) * SLOT_M
        strips[2, b] = np.float32(n_filled) * SLOT_M
    strips[0, STRIPS] = strips[1, STRIPS] = strips[2, STRIPS] = np.float32(0.0)


@helper
def _measure_around(
    ranges: F32,
    sine: F32,
    strips: F32,
    wall_m: F32,
    ahead_m: F32,
    measures: F32,
) -> None:
    """Write the measures of a line's shots that are those of their strips, and of its walls."""
    for i in range(len(ranges)):
        y = ranges[i] * sine[i]
        # limited before it becomes an integer: ranges may be any number
        limited = min(max(y / STRIP_M, np.float32(-STRIPS)), np.float32(STRIPS))
        place = limited if y == y else np.float32(STRIPS)
        b = int(np.floor(place)) + STRIPS // 2
        b = b if 0 <= b < STRIPS else STRIPS
        measures[ROUGH, i] = strips[0, b]
        measures[TOP, i] = strips[1, b]
        measures[FILLED, i] = strips[2, b]
        wall = wall_m[b] if b < STRIPS else np.float32(0.0)
        before = ahead_m[b] if b < STRIPS else np.float32(0.0)
        measures[BEHIND, i] = abs(y) - abs(wall) if wall != np.float32(0.0) else -NO_WALL_M
        measures[AHEAD, i] = abs(before) - abs(y) if before != np.float32(0.0) else NO_WALL_M


@helper
def _measure_shots(
    ranges: F32,
    above: F32,
    texture: F32,
    neighbours: Neighbours,
    cosine: F32,
    measures: F32,
) -> None:
    """Write the measures of a line's shots that need only the shot and the adjacent ones."""
    near, smooth, upright, level = neighbours
    m = len(ranges)
    for i in range(m):
        measures[SMOOTH, i] = np.float32(smooth[i])
        measures[NEAR, i] = np.float32(near[i])
        measures[UPRIGHT, i] = np.float32(upright[i])
        measures[LEVEL, i] = np.float32(level[i])
        measures[TEXTURE, i] = texture[i]
        measures[STEEP, i] = cosine[i]
        measures[RANGE, i] = ranges[i]
        measures[OFF, i] = abs(above[i])
        before = abs(ranges[max(i - 1, 0)] - ranges[i])
        after = abs(ranges[min(i + 1, m - 1)] - ranges[i])
        before = before if before < WIDEST_JUMP_M else WIDEST_JUMP_M
        after = after if after < WIDEST_JUMP_M else WIDEST_JUMP_M
        measures[JUMP, i] = max(before, after) / max(ranges[i] * PER_METRE, np.float32(1.0))


@loop()
def confidence_cells(
    labels: U8_2,
    range_m: F32_2,
    above_m: F32_2,
    texture: F32_2,
    neighbours: Neighbours,
    slots: FilledSlots,
    walls: Walls,
    beams: Beams,
    step: np.float32,
    groups: I64_1,
    questions: I64_2,
    limits: F32_2,
) -> I32_2:
    """Find which steps of its label's measures every shot reaches, as the number of a cell.

    ``labels`` (lines, M) uint8; ``range_m, above_m`` (lines, M) float32, metres; ``texture``
    (lines, M) float32; ``neighbours`` (lines, M) uint8; ``slots`` and ``walls`` (lines,
    STRIPS); ``beams`` (M,) float32;
    ``groups`` (number of labels,) int64; ``questions`` (number of labels, n) int64; ``limits``
    (measures, k) float32; returns (lines, M) int32.
    """
    n_lines, m = labels.shape
    cells = np.empty((n_lines, m), np.int32)
    room = 2 * LINES + 1
    # ring buffer of lines
    words = np.empty((room, m), np.uint64)
    sums_before = np.empty(m + 1, np.uint64)
    strips = np.empty((3, STRIPS + 1), np.float32)
    measures = np.empty((N_MEASURES, m), np.float32)
    near, smooth, upright, level = neighbours
    sine, cosine = beams
    for line in range(min(LINES, n_lines)):
        _count_groups(labels[line], groups, words[line % room])
    for line in range(n_lines):
        if line + LINES < n_lines:
            _count_groups(labels[line + LINES], groups, words[(line + LINES) % room])
        _sum_up(words, max(line - LINES, 0), min(line + LINES + 1, n_lines), sums_before)
        _measure_agreement(range_m[line], labels[line], groups, sums_before, step, measures[AGREE])
        counts = Neighbours(near[line], smooth[line], upright[line], level[line])
        _measure_shots(range_m[line], above_m[line], texture[line], counts, cosine, measures)
        _measure_strips(slots.by_any[line], slots.by_rough[line], strips)
        _measure_around(
            range_m[line], sine, strips, walls.side_m[line], walls.ahead_m[line], measures
        )
        # the steps that every measure reaches are the digits of the cell
        labels_of_line = labels[line]
        cells_of_line = cells[line]
        n_steps = limits.shape[1]
        n_questions = questions.shape[1]
        for i in range(m):
            cells_of_line[i] = 0
            if labels_of_line[i] == _MISSING:
                continue
            cell = 0
            for k in range(n_questions):
                row = questions[labels_of_line[i], k]
                n_reached = 0
                for j in range(n_steps):
                    n_reached += measures[row, i] >= limits[row, j]
                cell = cell * (n_steps + 1) + n_reached
            cells_of_line[i] = np.int32(cell)
    return cells
