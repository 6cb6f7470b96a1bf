"""Find leaves among what was taken for noise."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import F32, F32_2, U8, U8_2
from prc_cli.methods.fused.lists_loops import list_few
from prc_cli.methods.fused.thresholds import LateLeafThresholds

COLUMNS = 16
BESIDE_LINES = 1
"""Greatest distance of the shots around, in columns and lines."""
_NOISE = int(Label.NOISE)
_LEAVES = int(Label.VEGETATION)


@helper
def _mark_noise(
    labels: U8, ranges: F32, above: F32, far_m: np.float32, foot_m: np.float32, marks: U8
) -> None:
    """Mark the noise of a line that is far and above the ground."""
    for i in range(len(labels)):
        marks[i] = np.uint8((labels[i] == _NOISE) & (ranges[i] >= far_m) & (above[i] > foot_m))


@inlined
def _is_leaf(range_m: F32, labels: U8, line: int, i: int, thresholds: LateLeafThresholds) -> bool:
    """Whether enough leaves around a shot are about as far."""
    leaves = np.int32(0)
    for k in range(line - BESIDE_LINES, line + BESIDE_LINES + 1):
        for j in range(max(i - COLUMNS, 0), min(i + COLUMNS + 1, range_m.shape[1])):
            place = np.uint64(j)
            is_near = abs(range_m[k, place] - range_m[line, i]) < thresholds.range_m
            leaves += np.int32(is_near & (labels[k, place] == np.uint8(_LEAVES)))
    return bool(np.float32(leaves) >= thresholds.leaves)


@loop()
def leaves_amid_noise(
    labels: U8_2,
    voted: U8_2,
    range_m: F32_2,
    above_m: F32_2,
    step: np.float32,
    thresholds: LateLeafThresholds,
) -> U8_2:
    """Find the leaves among the noise: leaves in other lines are as far.

    ``labels`` (lines + 2, M) uint8, before votes; ``voted`` (lines, M) uint8; ``range_m`` (lines +
    2, M) float32, metres; ``above_m`` (lines, M) float32, metres; returns (lines, M) uint8,
    labels.
    """
    n_lines, m = voted.shape
    later = voted.copy()
    marks = np.empty(m, np.uint8)
    shots = np.empty(m + 1, np.int32)
    far_m = thresholds.apart_m / step
    foot_m = thresholds.foot_m
    for line in range(n_lines):
        ranges = range_m[line + BESIDE_LINES]
        _mark_noise(voted[line], ranges, above_m[line], far_m, foot_m, marks)
        for n in range(list_few(marks, shots)):
            i = int(shots[n])
            if _is_leaf(range_m, labels, line + BESIDE_LINES, i, thresholds):
                later[line, i] = _LEAVES
    return later
