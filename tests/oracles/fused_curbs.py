"""Slow and obvious twin of :mod:`prc_cli.kernels.fused.curbs`."""

from __future__ import annotations

import numpy as np

from prc_cli.core.thresholds.fused import CurbThresholds
from prc_cli.core.types import F32, I32, U8

NO_SURFACE, GROUND, CURB = (0, 2), 3, 8


def curb_labels(
    labels: U8,
    range_m: F32,
    above_m: F32,
    beams: tuple[F32, F32],
    sides: tuple[I32, I32],
    thresholds: CurbThresholds,
) -> U8:
    """Label curbs; see :func:`prc_cli.kernels.fused.curbs.curb_labels`."""
    found = labels.copy()
    out_m, height_m = np.abs(range_m * beams[0]), -(range_m * beams[1])
    low = (np.abs(above_m) < thresholds.most_m) & ~np.isin(labels, NO_SURFACE)
    for line in range(len(labels)):
        for columns in sides:
            shots = columns[low[line, columns]]
            if len(shots):
                out = np.maximum.accumulate(out_m[line, shots])
                faces = _faces(out, height_m[line, shots], labels[line, shots] == GROUND, thresholds)
                found[line, shots[faces]] = CURB
    return found


def _faces(out: F32, height: F32, is_ground: np.ndarray, thresholds: CurbThresholds) -> list[int]:
    """Return which shots of one side, outwards, are on the face of a curb."""
    sums = np.append(0.0, np.cumsum(np.where(is_ground, height.astype(np.float64), 0.0)))
    reach, half = thresholds.reach_m, thresholds.half_m
    faces = []
    for k, (y, z) in enumerate(zip(out, height, strict=True)):
        before = np.flatnonzero((out >= y - reach) & (out < y - half))
        after = np.flatnonzero((out > y + half) & (out <= y + reach))
        if not is_ground[before].any() or not is_ground[after].any():
            continue
        foot, top = (
            np.float32((sums[one[-1] + 1] - sums[one[0]]) / int(is_ground[one].sum())) for one in (before, after)
        )
        rise = top - foot
        margin = thresholds.margin * rise
        if not thresholds.least_m <= rise <= thresholds.most_m or not foot + margin < z < foot + rise - margin:
            continue
        if height[after[0]] - height[before[-1]] >= thresholds.share * rise:
            faces.append(k)
    return faces
