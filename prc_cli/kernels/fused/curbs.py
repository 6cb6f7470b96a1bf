"""Loop of the fused classifier that finds the faces of curbs: steep steps between two pieces of ground."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.thresholds.fused import CurbThresholds
from prc_cli.core.types import F32, F64, I32, U8
from prc_cli.kernels.cache import helper, kernel

_MISSING, _NOISE, _GROUND, _CURB = int(Label.MISSING), int(Label.NOISE), int(Label.GROUND), int(Label.CURB)


@helper
def _list_low(
    columns: I32,
    ranges: F32,
    above: F32,
    labels: U8,
    beams: tuple[F32, F32],
    most: np.float32,
    places: tuple[F32, F32],
    sums: tuple[F64, I32],
    shots: I32,
) -> int:
    """List the shots near the ground on one side, outwards, return how many there are.

    Writes how far out they are, at least as far as those before them; their heights; and the sums of the heights, and
    the number, of the shots of the ground before each.
    """
    sine, cosine = beams
    out, height = places
    heights, count = sums
    n, farthest = 0, np.float32(0.0)
    heights[0], count[0] = 0.0, 0
    for k in range(len(columns)):
        i = columns[k]
        label = labels[i]
        if (abs(above[i]) < most) & (label != _MISSING) & (label != _NOISE):
            farthest = max(farthest, abs(ranges[i] * sine[i]))
            z = -(ranges[i] * cosine[i])
            is_ground = label == _GROUND
            shots[n], out[n], height[n] = i, farthest, z
            heights[n + 1] = heights[n] + (np.float64(z) if is_ground else 0.0)
            count[n + 1] = count[n] + np.int32(is_ground)
            n += 1
    return n


@helper
def _mark_faces(
    n: int, places: tuple[F32, F32], sums: tuple[F64, I32], shots: I32, thresholds: CurbThresholds, labels: U8
) -> None:
    """Label those of the listed shots that are on the face of a curb."""
    out, height = places
    heights, count = sums
    reach, half, share, margin = thresholds.reach_m, thresholds.half_m, thresholds.share, thresholds.margin
    first = before = after = last = 0
    for k in range(n):
        y, z = out[k], height[k]
        while out[first] < y - reach:
            first += 1
        while out[before] < y - half:
            before += 1
        while after < n and out[after] <= y + half:
            after += 1
        while last < n and out[last] <= y + reach:
            last += 1
        n_foot, n_top = count[before] - count[first], count[last] - count[after]
        if n_foot <= 0 or n_top <= 0:
            continue
        foot = np.float32((heights[before] - heights[first]) / n_foot)
        rise = np.float32((heights[last] - heights[after]) / n_top) - foot
        if rise < thresholds.least_m or rise > thresholds.most_m:
            continue
        is_between = (z > foot + margin * rise) & (z < foot + rise - margin * rise)
        if is_between & (height[after] - height[before - 1] >= share * rise):
            labels[shots[k]] = np.uint8(_CURB)


@kernel(
    "uint8[:, ::1](uint8[:, ::1], float32[:, ::1], float32[:, ::1], UniTuple(float32[::1], 2), "
    "UniTuple(int32[::1], 2), CurbThresholds)",
    tuples=[CurbThresholds],
)
def curb_labels(
    labels: U8,
    range_m: F32,
    above_m: F32,
    beams: tuple[F32, F32],
    sides: tuple[I32, I32],
    thresholds: CurbThresholds,
) -> U8:
    """Label the faces of curbs.

    A shot near the ground is on a face if the ground is higher beyond it than before it, most of that within the width
    of the face, and the shot is between both heights.

    Parameters
    ----------
    labels : (lines, M) uint8
        :class:`prc_cli.core.classes.Label`.
    range_m, above_m : (lines, M) float32, metres
        Range and height above the ground; NaN = missing.
    beams : tuple of (M,) float32
        Sine and cosine of every column's beam from straight down.
    sides : tuple of (n,) int32
        Columns of positive and negative side, from straight down to straight up.
    thresholds : CurbThresholds of float32

    Returns
    -------
    (lines, M) uint8
        The labels, with curbs.
    """
    n_lines, m = labels.shape
    found = np.empty((n_lines, m), np.uint8)
    places = np.empty(m, np.float32), np.empty(m, np.float32)
    sums = np.empty(m + 1, np.float64), np.empty(m + 1, np.int32)
    shots = np.empty(m, np.int32)
    for line in range(n_lines):
        row = found[line]
        for i in range(m):
            row[i] = labels[line, i]
        for s in range(2):
            columns = sides[0] if s == 0 else sides[1]
            n = _list_low(
                columns, range_m[line], above_m[line], labels[line], beams, thresholds.most_m, places, sums, shots
            )
            _mark_faces(n, places, sums, shots, thresholds, row)
    return found
