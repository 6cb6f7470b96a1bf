"""Slow and obvious twin of :mod:`prc_cli.methods.fused.confidence_loops`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32, I32, I64, U8
from prc_cli.methods.fused.records import Beams, FilledSlots, Neighbours, Walls

Words = NDArray[np.uint64]
STRIPS = 320
NOISE = 5


def confidence_cells(
    labels: U8,
    range_m: F32,
    above_m: F32,
    texture: F32,
    neighbours: Neighbours,
    slots: FilledSlots,
    walls: Walls,
    beams: Beams,
    step: np.float32,
    groups: I64,
    questions: I64,
    limits: F32,
) -> I32:
    """Find the steps that are reached.

    See :func:`prc_cli.methods.fused.confidence_loops.confidence_cells`.
    """
    cells = np.zeros(labels.shape, np.int32)
    near, smooth, upright, level = neighbours
    for line, i in zip(*np.nonzero(labels), strict=True):
        r = range_m[line, i]
        y = range_m[line, i] * beams[0][i]
        rough, top, filled, behind, ahead = _place(y, line, slots, walls)
        values = [
            _agreement(labels, range_m, line, i, step, groups),
            smooth[line, i],
            texture[line, i],
            near[line, i],
            upright[line, i],
            level[line, i],
            abs(above_m[line, i]),
            beams[1][i],
            r,
            rough,
            top,
            filled,
            ahead,
            behind,
            _jump(range_m[line], i),
        ]
        digits = [
            sum(bool(values[row] >= limit) for limit in limits[row])
            for row in questions[labels[line, i]]
        ]
        cells[line, i] = sum(d * (limits.shape[1] + 1) ** k for k, d in enumerate(reversed(digits)))
    return cells


def _agreement(
    labels: U8,
    range_m: F32,
    line: int,
    i: int,
    step: np.float32,
    groups: I64,
) -> np.float32:
    shot_group = groups[labels[line, i]]
    if shot_group < 0 or np.isnan(range_m[line, i]):
        return np.float32(0)
    half = int(
        min(max(np.float32(0.25) / (range_m[line, i] * step), np.float32(2)), np.float32(60))
    )
    around = groups[labels[max(line - 2, 0) : line + 3, max(i - half, 0) : i + half + 1]]
    total = (
        (around >= 0).sum() if shot_group == NOISE else ((around >= 0) & (around != NOISE)).sum()
    )
    return np.float32((around == shot_group).sum()) / np.float32(total)


def _place(
    y: np.float32,
    line: int,
    slots: FilledSlots,
    walls: Walls,
) -> tuple[np.float32, np.float32, np.float32, np.float32, np.float32]:
    none = np.float32(0), np.float32(0), np.float32(0), np.float32(-50), np.float32(50)
    if np.isnan(y) or not -STRIPS / 4 <= y < STRIPS / 4:
        return none
    b = int(np.floor(y / np.float32(0.5))) + STRIPS // 2
    every, rough = (f"{int(words[line, b]):b}" for words in slots)
    n = every.count("1")
    distance = walls.side_m[line, b]
    before = walls.ahead_m[line, b]
    return (
        np.float32(rough.count("1")) / np.float32(max(n, 1)),
        np.float32(0 if n == 0 else len(every)) * np.float32(0.25),
        np.float32(n) * np.float32(0.25),
        abs(y) - abs(distance) if distance != 0 else none[3],
        abs(before) - abs(y) if before != 0 else none[4],
    )


def _jump(ranges: F32, i: int) -> np.float32:
    beside = [ranges[j] for j in (max(i - 1, 0), min(i + 1, len(ranges) - 1))]
    jumps = [
        min(abs(neighbour - ranges[i]), np.float32(6))
        if abs(neighbour - ranges[i]) < 6
        else np.float32(6)
        for neighbour in beside
    ]
    scale = (
        max(ranges[i] * np.float32(0.1), np.float32(1))
        if not np.isnan(ranges[i])
        else np.float32(1)
    )
    return np.float32(max(jumps) / scale)
