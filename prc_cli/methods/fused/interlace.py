"""Align interlaced scanners, which measure every other column half a line later.

Some scanners halve their angular step by scanning twice, the second time between the beams of the
first (SICK LMS 2xx at 0.5 degrees). In between the platform moves by half the distance of two
lines, so that a wall that recedes is a zigzag, as rough as a hedge.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.profile import stage
from prc_cli.core.types import F32, F64, I64
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.thresholds import Limits

REACH_LINES = 12
"""Lines before and after a line that show whether its columns are interlaced.

Lines farther away may begin with the other half of the columns."""
LEAST_SHOTS = 4
"""Fewest shots that show it."""
HALF = 0.5
SLACK = 0.15
"""How much later the other columns are, and by how much a shot may differ from that [lines]."""
STEEP = 4.0
"""A surface must recede by so many tolerances a line to show when it was measured."""


@stage("interlace")
def align_columns(
    range_m: F32,
    plane: ScanPlane,
    noise_m: F64,
    limits: Limits,
) -> F32:
    """Return ranges as if all columns of a line had been measured together.

    Where a surface recedes evenly from line to line, the odd columns are moved by half a line.
    Nothing is changed where lines show no interlaced surface.

    ``range_m`` (lines, M) float32, metres; ``noise_m`` (lines,) float64; returns (lines, M)
    float32, metres.

    A wall that recedes by 0.4 m a line, odd columns half a line later:

    >>> plane = ScanPlane.of(np.deg2rad(np.linspace(60, 70, 21)))
    >>> late = np.where(np.arange(21) % 2 == 1, 0.5, 0.0)
    >>> lines = (5 + 0.4 * (np.arange(9)[:, None] + late)).astype(np.float32)
    >>> align_columns(lines, plane, np.full(9, 0.005), Limits())[4, :4].round(3).tolist()
    [6.599999904632568, 6.599999904632568, 6.599999904632568, 6.599999904632568]
    """
    if float(plane.step_rad) < limits.interlace_rad or len(range_m) < 3:
        return range_m
    before = range_m[:-2]
    middle = range_m[1:-1]
    after = range_m[2:]
    values, of_line = np.unique(noise_m[1:-1], return_inverse=True)
    smooth = [limits.smoothness.thresholds(float(value), float(plane.step_rad)) for value in values]
    least_m = np.array([limit.tolerance_m for limit in smooth], np.float32)[of_line]
    tolerance_m = least_m[:, None] + smooth[0].tolerance_per_m * middle
    half = np.float32(0.5)
    with np.errstate(all="ignore"):  # ranges may be anything
        is_even = np.abs((before + after) * half - middle) < np.float32(2.0) * tolerance_m
        recedes_m = (after - before) * half
    later = _later(_count_shots(middle, recedes_m, tolerance_m, is_even))
    if not later.any():
        return range_m
    moved = range_m.copy()
    odd = slice(1, None, 2)
    by_m = np.where(is_even, recedes_m, np.float32(0.0))[:, odd] * (later[:, None] * half).astype(
        np.float32
    )
    moved[1:-1, odd] -= by_m
    return moved


def _count_shots(
    range_m: F32,
    recedes_m: F32,
    tolerance_m: F32,
    is_even: NDArray[np.bool_],
) -> I64:
    """Count the shots of every line whose columns are half a line later, earlier, or neither.

    Only shots count on surfaces that recede by much, evenly and like the columns beside. Returns
    (lines, 3) int64.
    """
    left = slice(0, -2)
    middle = slice(1, -1)
    right = slice(2, None)
    with np.errstate(all="ignore"):
        is_steep = is_even & (np.abs(recedes_m) > np.float32(STEEP) * tolerance_m)
        is_counted = is_steep[:, left] & is_steep[:, middle] & is_steep[:, right]
        signs = np.sign(recedes_m)
        is_counted &= (signs[:, left] == signs[:, middle]) & (signs[:, right] == signs[:, middle])
        is_counted &= np.abs(range_m[:, right] - range_m[:, left]) < np.abs(recedes_m[:, middle])
        off = range_m[:, middle] - (range_m[:, left] + range_m[:, right]) * np.float32(0.5)
        late = off / recedes_m[:, middle]
    late[:, 1::2] *= np.float32(-1.0)  # of the odd columns against the even ones
    is_later = is_counted & (np.abs(late - np.float32(HALF)) < np.float32(SLACK))
    is_earlier = is_counted & (np.abs(late + np.float32(HALF)) < np.float32(SLACK))
    counts = np.stack([is_later.sum(axis=1), is_earlier.sum(axis=1)], axis=1)
    n_neither = is_counted.sum(axis=1) - counts.sum(axis=1)
    by_line: I64 = np.column_stack([counts, n_neither]).astype(np.int64)
    return by_line


def _later(counts: I64) -> I64:
    """Return 1 if the odd columns of a line are later, -1 if earlier, by the lines around.

    >>> _later(np.array([[0, 0, 9], [4, 0, 0], [8, 1, 0]])).tolist()
    [0, 0, 0]
    >>> _later(np.array([[0, 9, 1]])).tolist()
    [-1]
    """
    sums = np.concatenate([np.zeros((1, 3), np.int64), np.cumsum(counts, axis=0)])
    lines = np.arange(len(counts))
    last = np.minimum(lines + REACH_LINES + 1, len(counts))
    around = sums[last] - sums[np.maximum(lines - REACH_LINES, 0)]
    others = around.sum(axis=1)[:, None] - around
    is_clear = (around >= LEAST_SHOTS) & (around > 2 * others)
    later: I64 = is_clear[:, 0].astype(np.int64) - is_clear[:, 1]
    return later
