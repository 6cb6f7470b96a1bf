"""Slow and obvious twin of :mod:`prc_cli.methods.fused.fans_loops`."""

from __future__ import annotations

from collections.abc import Iterator
from math import floor

import numpy as np

from prc_cli.core.types import F32, I32, U8
from prc_cli.methods.fused.records import Sides
from prc_cli.methods.fused.thresholds import FanThresholds

LINES = 12
BINS = 200
BIN = np.float32(0.25)
REACH = np.float32(0.5)
JUMP = np.float32(1.0)
NO_THING = (0, 2, 3, 8)
SOIL = (3, 8)
CAR = 7
POLE = 11
SEED = 1
THING = 2

Run = tuple[list[int], bool, tuple[int, int], float, float]


def fan_cars(
    labels: U8,
    range_m: F32,
    above_m: F32,
    texture: F32,
    sine: F32,
    sides: Sides,
    before: U8,
    n_labelled: int,
    thresholds: FanThresholds,
) -> tuple[U8, U8]:
    """Label cars in fans; see :func:`prc_cli.methods.fused.fans_loops.fan_cars`."""
    cars = labels.copy()
    runs = [
        (line, way, run)
        for line in range(len(labels))
        for way in range(2)
        for run in runs_of(
            labels[line],
            abs(range_m[line] * sine),
            above_m[line],
            texture[line],
            sides[way],
            thresholds,
        )
    ]
    marks = np.concatenate([before, np.zeros((len(labels), 2 * BINS), np.uint8)])
    for line, way, (_, is_roof, (first, last), _, _) in runs:
        marks[LINES + line, way * BINS + first : way * BINS + last] |= np.uint8(
            SEED if is_roof else THING
        )
    for line, way, (columns, _, (first, last), low, high) in runs:
        around = marks[line : line + 2 * LINES + 1, way * BINS + first : way * BINS + last]
        seeds = ((around & SEED) > 0).sum(axis=0)
        if high > 2 or low >= 1 or seeds.max(initial=0) < 2:
            continue
        things = ((around & THING) > 0).sum(axis=0)[seeds.argmax()]
        if np.float32(seeds.max()) >= thresholds.share * np.float32(seeds.max() + things):
            cars[line, [i for i in columns if labels[line, i] != POLE]] = CAR
    return cars[:n_labelled], marks[n_labelled : n_labelled + LINES]


def runs_of(
    labels: U8,
    side: F32,
    above: F32,
    texture: F32,
    outwards: I32,
    thresholds: FanThresholds,
) -> Iterator[Run]:
    """Yield the things of a line and side.

    Columns, whether across a roof, bins, lowest and highest shot.
    """
    there = [int(i) for i in outwards if not np.isnan(side[i])]
    groups: list[list[int]] = []
    for place, i in enumerate(there):
        if labels[i] in NO_THING:
            continue
        last = there[place - 1]
        if place > 0 and labels[last] not in NO_THING and abs(side[i] - side[last]) < JUMP:
            groups[-1].append(i)
        else:
            groups.append([i])
    for run in groups:
        low = above[run].min()
        high = above[run].max()
        near = side[run].min()
        far = side[run].max()
        smooth = np.float32(0)
        for i in run:
            smooth += texture[i]
        smooth /= np.float32(len(run))
        is_roof = thresholds.least_m <= high <= thresholds.most_m and low < np.float32(0.6)
        is_roof &= (
            np.float32(0.3) <= far - near <= 3 and smooth >= thresholds.smooth and len(run) >= 6
        )
        first = there.index(run[0])
        end = there.index(run[-1]) + 1
        is_roof = is_roof and first > 0 and end < len(there)
        is_roof = (
            is_roof and labels[there[first - 1]] in SOIL and side[there[end]] > side[run[-1]] + JUMP
        )
        is_roof = is_roof or 2 * (labels[run] == CAR).sum() >= len(run)
        lowest = min(max(floor((near - REACH) / BIN), 0), BINS)
        yield run, bool(is_roof), (lowest, min(floor((far + REACH) / BIN) + 1, BINS)), low, high
