"""Slow and obvious twins of :mod:`prc_cli.methods.fused.neighbours_loops`.

One shot after the other, in float32.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.thresholds import ChordThresholds, NearThresholds, SmoothThresholds

PAIRS_IN_LINE = ((-1, 1), (-2, 2), (-2, -1), (1, 2), (-1, 2), (-2, 1))
PAIRS_ACROSS = (((-1, 0), (1, 0)), ((-1, 1), (1, -1)), ((-1, -1), (1, 1)), ((-2, 0), (2, 0)))
"""Lines and columns away of the two shots of a pair."""


def plane_points(range_m: F32, sine: F32, cosine: F32) -> tuple[F32, F32]:
    """Turn ranges into points; see :func:`prc_cli.methods.fused.neighbours_loops.plane_points`."""
    return range_m * sine[None, :], -(range_m * cosine[None, :])


def _with_margins(points: tuple[F32, F32]) -> tuple[F32, F32]:
    side, height = (np.pad(array, ((0, 0), (4, 4)), constant_values=np.nan) for array in points)
    return side, height


def near_counts(
    range_m: F32,
    sine: F32,
    cosine: F32,
    step: np.float32,
    thresholds: NearThresholds,
) -> U8:
    """Count near neighbours; see :func:`prc_cli.methods.fused.neighbours_loops.near_counts`."""
    limits = thresholds
    side_m, height_m = _with_margins(plane_points(range_m, sine, cosine))
    around = [
        (a, b)
        for a, b in product(range(-2, 3), range(-4, 5))
        if (a, b) != (0, 0) and (a == 0 or abs(b) <= 2)
    ]
    counts = np.zeros((range_m.shape[0] - 4, range_m.shape[1]), np.uint8)
    for line, column in zip(*np.nonzero(~np.isnan(range_m[2:-2])), strict=True):
        y = line + 2
        x = column + 4
        apart = range_m[y, column] * step
        near = max(limits.near_m, limits.near_steps * apart)
        along = max(limits.along_m, limits.along_steps * apart)
        for a, b in around:
            to_side = abs(side_m[y + a, x + b] - side_m[y, x])
            up = abs(height_m[y + a, x + b] - height_m[y, x])
            close = to_side < near and up < near
            level = up < limits.thin_m and to_side < along
            upright = to_side < limits.thin_m and up < along
            counts[line, column] += bool(close or level or upright)
    return counts


def smooth_counts(
    range_m: F32,
    sine: F32,
    cosine: F32,
    step: np.float32,
    thresholds: SmoothThresholds,
) -> U8:
    """Count smooth pairs; see :func:`prc_cli.methods.fused.neighbours_loops.smooth_counts`."""
    points = np.stack(_with_margins(plane_points(range_m, sine, cosine)), axis=-1)
    counts = np.zeros((range_m.shape[0] - 4, range_m.shape[1]), np.uint8)
    for line, column in zip(*np.nonzero(~np.isnan(range_m[2:-2])), strict=True):
        y = line + 2
        x = column + 4
        r = range_m[y, column]
        point = points[y, x]
        tolerance = thresholds.tolerance_m + thresholds.tolerance_per_m * r
        gap = max(thresholds.gap_m, thresholds.gap_steps * (r * step))
        to_edge = min(column, range_m.shape[1] - 1 - column)
        wanted = min(
            max(thresholds.apart_m / (r * step), 1 + (2 * r * step <= thresholds.leaf_m)),
            np.float32(8),
        )
        stride = max(min(int(wanted), to_edge // 2), 1)
        for b, c in PAIRS_IN_LINE:
            first = points[y, x + stride * b]
            second = points[y, x + stride * c]
            along = second - first
            off = point - first
            square = along[0] * along[0] + along[1] * along[1]
            cross = along[0] * off[1] - along[1] * off[0]
            counts[line, column] += bool(
                square < gap * gap and cross * cross < tolerance * tolerance * square
            )
        for (a, b), (c, d) in PAIRS_ACROSS:
            off = (points[y + a, x + b] + points[y + c, x + d]) * np.float32(0.5) - point
            square = off[0] * off[0] + off[1] * off[1]
            counts[line, column] += bool(square < np.float32(4) * (tolerance * tolerance))
    return counts


def directions(
    range_m: F32,
    smooth: U8,
    sine: F32,
    cosine: F32,
    step: np.float32,
    thresholds: ChordThresholds,
) -> tuple[U8, U8]:
    """Count upright and level chords.

    See :func:`prc_cli.methods.fused.neighbours_loops.directions`.
    """
    slope = thresholds.slope
    slack = thresholds.slack_m
    longest = thresholds.longest_m
    side_m, height_m = plane_points(range_m, sine, cosine)
    m = range_m.shape[1]
    upright = np.zeros(range_m.shape, np.uint8)
    level = np.zeros(range_m.shape, np.uint8)
    for line, i in zip(*np.nonzero(~np.isnan(range_m)), strict=True):
        away = int(min(max(thresholds.chord_m / (range_m[line, i] * step), 1), 60))
        tries = [away, away + 1, *([away - 1] if away > 1 else [])]
        ends = []
        for way in (-1, 1):
            held = [
                i + way * k for k in tries if 0 <= i + way * k < m and smooth[line, i + way * k] > 0
            ]
            ends.append(held[0] if held else None)
        point = np.array([side_m[line, i], height_m[line, i]])
        to = [
            None if j is None else np.array([side_m[line, j], height_m[line, j]]) - point
            for j in ends
        ]
        chords = [chord for chord in to if chord is not None]
        if len(chords) == 2:
            chords.append(chords[0] - chords[1])
        for dy, dz in chords:
            if dy * dy + dz * dz <= longest * longest:
                upright[line, i] += bool(abs(dy) <= slope * abs(dz) + slack)
                level[line, i] += bool(abs(dz) <= slope * abs(dy) + slack)
    return upright, level
