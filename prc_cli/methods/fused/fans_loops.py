"""Find cars by the profile of single lines, for scanners whose shots are far apart."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.loops import helper, loop
from prc_cli.core.types import F32, F32_1, F32_2, I32, U8, U8_2
from prc_cli.methods.fused.records import Sides
from prc_cli.methods.fused.thresholds import FanThresholds

LINES = 12
"""Lines before and after a line that a car is looked for in."""
BIN_M = np.float32(0.25)
BINS = 200
"""Width of a bin to the side [m], and bins on either side."""
REACH_M = np.float32(0.5)
"""A car reaches this far beyond the shots of a line, to either side [m]."""
JUMP_M = np.float32(1.0)
"""Shots farther apart to the side belong to different objects [m]."""
FOOT_M = np.float32(0.6)
"""Lowest shot on a car in a line across its roof, at most [m]."""
LEAST_DEEP_M = np.float32(0.3)
MOST_DEEP_M = np.float32(3.0)
"""Depth of what is seen of it in such a line: walls and fences have less, hedges more [m]."""
LEAST_SHOTS = 6
"""Fewest shots of it in such a line."""
LOW_M = np.float32(2.0)
HIGH_FOOT_M = np.float32(1.0)
"""In other lines a car is lower than this, and its lowest shot below this [m]."""
_SEED = np.uint8(1)
_THING = np.uint8(2)
_MISSING = int(Label.MISSING)
_NOISE = int(Label.NOISE)
_GROUND = int(Label.GROUND)
_CURB = int(Label.CURB)
_CAR = int(Label.CAR)
_POLE = int(Label.POLE)
_FAR = np.float32(1e6)


@helper
def _is_thing(label: np.uint8) -> bool:
    """Whether a label is of something above the ground."""
    return bool((label != _MISSING) & (label != _NOISE) & (label != _GROUND) & (label != _CURB))


@helper
def _mark_side(
    shots: I32,
    labels: U8,
    side: F32,
    above: F32,
    texture: F32,
    thresholds: FanThresholds,
    marks: U8,
    low_things: I32,
) -> int:
    """Mark the bins of the things on one side of a line: profiles across a roof, and others.

    ``shots`` are the columns with a return, outwards. Write the first and last shot and bin of the
    things that are low enough for a car, each last one exclusive; return how many there are.
    """
    first = n_low = 0
    while first < len(shots):
        if not _is_thing(labels[shots[first]]):
            first += 1
            continue
        end = first + 1
        while end < len(shots) and _is_thing(labels[shots[end]]):
            if not abs(abs(side[shots[end]]) - abs(side[shots[end - 1]])) < JUMP_M:
                break
            end += 1
        low = near = _FAR
        high = far = -_FAR
        smooth = np.float32(0.0)
        n_cars = 0
        for k in range(first, end):
            i = shots[k]
            low = min(low, above[i])
            high = max(high, above[i])
            near = min(near, abs(side[i]))
            far = max(far, abs(side[i]))
            smooth += texture[i]
            n_cars += labels[i] == np.uint8(_CAR)
        smooth = smooth / np.float32(end - first)
        is_roof = (high >= thresholds.least_m) & (high <= thresholds.most_m) & (low < FOOT_M)
        is_roof &= (far - near >= LEAST_DEEP_M) & (far - near <= MOST_DEEP_M)
        is_roof &= (smooth >= thresholds.smooth) & (end - first >= LEAST_SHOTS)
        is_roof &= (first > 0) & (end < len(shots))
        if is_roof:
            # it stands on the ground, and the line sees far beyond it
            before = labels[shots[first - 1]]
            is_roof = (before == _GROUND) | (before == _CURB)
            is_roof &= abs(side[shots[end]]) > abs(side[shots[end - 1]]) + JUMP_M
        is_roof |= 2 * n_cars >= end - first
        first_bin = max(int(np.floor(min((near - REACH_M) / BIN_M, _FAR))), 0)
        first_bin = min(first_bin, BINS)
        last_bin = min(int(np.floor(min((far + REACH_M) / BIN_M, _FAR))) + 1, BINS)
        for q in range(first_bin, last_bin):
            marks[q] |= _SEED if is_roof else _THING
        if not (high > LOW_M or low >= HIGH_FOOT_M):
            low_things[n_low, 0] = first
            low_things[n_low, 1] = end
            low_things[n_low, 2] = first_bin
            low_things[n_low, 3] = last_bin
            n_low += 1
        first = end
    return n_low


@helper
def _sum_up(marks: U8, bit: np.uint8, sums: I32) -> None:
    """Write, for one bin, how many of the first 0, 1, ... lines have a mark."""
    total = np.int32(0)
    sums[0] = total
    for k in range(len(marks)):
        total += np.int32((marks[k] & bit) != np.uint8(0))
        sums[k + 1] = total


@helper
def _is_car(
    seeds: I32,
    things: I32,
    first: int,
    last: int,
    line: int,
    thresholds: FanThresholds,
) -> bool:
    """Whether enough lines around a thing cross a roof, in that of its bins in which most do."""
    low = max(line - LINES, 0)
    high = min(line + LINES + 1, seeds.shape[1] - 1)
    most = 0
    most_bin = -1
    for q in range(first, last):
        n = seeds[q, high] - seeds[q, low]
        if n > most:
            most = n
            most_bin = q
    if most < 2:
        return False
    others = things[most_bin, high] - things[most_bin, low]
    return bool(np.float32(most) >= thresholds.share * np.float32(most + others))


@loop()
def fan_cars(
    labels: U8_2,
    range_m: F32_2,
    above_m: F32_2,
    texture: F32_2,
    sine: F32_1,
    sides: Sides,
    before: U8_2,
    n_labelled: int,
    thresholds: FanThresholds,
) -> tuple[U8_2, U8_2]:
    """Label cars where shots are far apart, as in fans of rings.

    A line across a car climbs from the ground over flank and panes to the roof, and then sees far
    beyond. Walls and hedges are higher, fences have no depth, plants are rougher. Where enough
    lines around are so, or see a thing that is half a car already, low things other than poles are
    cars.

    ``labels`` (lines, M) uint8; ``range_m, above_m`` (lines, M) float32, metres; ``texture``
    (lines, M) float32; ``sine`` (M,) float32; ``sides`` (n,) int32; ``before`` (LINES, 2
    BINS) uint8; returns ``labels`` (n_labelled, M) uint8, ``marks`` (LINES, 2 BINS) uint8.
    """
    n_lines, m = labels.shape
    with_cars = np.empty((n_labelled, m), np.uint8)
    n = n_lines + LINES
    marks = np.zeros((2 * BINS, n), np.uint8)
    side = np.empty(m, np.float32)
    # shots of both sides of every line, and the low things among them
    shots = np.empty((2 * n_lines, m), np.int32)
    n_things = np.empty(2 * n_lines, np.int32)
    low_things = np.empty((2 * n_lines, m, 4), np.int32)
    for line in range(LINES):
        for q in range(2 * BINS):
            marks[q, line] = before[line, q]
    for k in range(n_lines):
        for i in range(m):
            side[i] = range_m[k, i] * sine[i]
        for way in range(2):
            row = 2 * k + way
            # columns with a return, from straight down to straight up
            outwards = sides[way]
            n_present = 0
            for q in range(len(outwards)):
                i = outwards[q]
                if range_m[k, i] == range_m[k, i]:
                    shots[row, n_present] = i
                    n_present += 1
            marks_of_line = marks[way * BINS : (way + 1) * BINS, k + LINES]
            n_things[row] = _mark_side(
                shots[row, :n_present],
                labels[k],
                side,
                above_m[k],
                texture[k],
                thresholds,
                marks_of_line,
                low_things[row],
            )
    seeds = np.empty((2 * BINS, n + 1), np.int32)
    things = np.empty((2 * BINS, n + 1), np.int32)
    for q in range(2 * BINS):
        _sum_up(marks[q], _SEED, seeds[q])
        _sum_up(marks[q], _THING, things[q])
    car = np.uint8(_CAR)
    pole = np.uint8(_POLE)
    for k in range(n_labelled):
        for i in range(m):
            with_cars[k, i] = labels[k, i]
        for way in range(2):
            row = 2 * k + way
            for thing in range(n_things[row]):
                first = low_things[row, thing, 0]
                end = low_things[row, thing, 1]
                low_bin = way * BINS + low_things[row, thing, 2]
                high_bin = way * BINS + low_things[row, thing, 3]
                if _is_car(seeds, things, low_bin, high_bin, k + LINES, thresholds):
                    for j in range(first, end):
                        i = shots[row, j]
                        with_cars[k, i] = pole if labels[k, i] == pole else car
    after = np.empty((LINES, 2 * BINS), np.uint8)
    for line in range(LINES):
        for q in range(2 * BINS):
            after[line, q] = marks[q, n_labelled + line]
    return with_cars, after
