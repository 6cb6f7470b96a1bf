"""Slow and obvious twin of :mod:`prc_cli.methods.fused.curbs_loops`."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F32, U8, Mask
from prc_cli.methods.fused.records import Beams
from prc_cli.methods.fused.thresholds import CurbThresholds

NO_SURFACE = (0, 2)
GROUND = 3
CURB = 8


def curb_labels(
    labels: U8,
    range_m: F32,
    above_m: F32,
    beams: Beams,
    step: np.float32,
    thresholds: CurbThresholds,
) -> U8:
    """Label curbs; see :func:`prc_cli.methods.fused.curbs_loops.curb_labels`."""
    curbs = labels.copy()
    side_m = range_m * beams[0]
    height_m = -(range_m * beams[1])
    low = (np.abs(above_m) < thresholds.most_m) & ~np.isin(labels, NO_SURFACE)
    m = labels.shape[1]
    for line, i in zip(*np.nonzero(low), strict=True):
        if not 2 <= i < m - 2:
            continue
        outwards = 1 if beams[1][i + 2] < beams[1][i - 2] else -1
        climb = height_m[line, i + 2 * outwards] - height_m[line, i - 2 * outwards]
        if not climb >= thresholds.steep * step * range_m[line, i]:
            continue
        beside = []
        for way in (-outwards, outwards):
            columns = [i + way * k for k in range(1, 201) if 0 <= i + way * k < m]
            shots = _until_gap(columns, low[line])
            away = [abs(side_m[line, j] - side_m[line, i]) for j in shots]
            end = next(
                (k for k, distance in enumerate(away) if distance > thresholds.reach_m), len(shots)
            )
            beside.append(
                [
                    j
                    for j, distance in zip(shots[:end], away, strict=False)
                    if distance > thresholds.half_m
                ]
            )
        if _is_face(height_m[line], labels[line] == GROUND, height_m[line, i], beside, thresholds):
            curbs[line, i] = CURB
    return curbs


def _until_gap(columns: list[int], low: Mask) -> list[int]:
    """Return the columns near the ground, up to nine in a row that are not."""
    reached = []
    gap = 0
    for j in columns:
        gap = 0 if low[j] else gap + 1
        if gap > 8:
            break
        if low[j]:
            reached.append(j)
    return reached


def _is_face(
    height: F32,
    is_ground: Mask,
    shot_height: np.float32,
    beside: list[list[int]],
    thresholds: CurbThresholds,
) -> bool:
    """Return whether a shot is on a face between the ground before and beyond it."""
    means = []
    for shots in beside:
        heights = [height[j] for j in shots if is_ground[j]]
        if not heights:
            return False
        total = np.float32(0)
        for level in heights:
            total = np.float32(total + level)
        means.append(total / np.float32(len(heights)))
    foot, top = means
    rise = top - foot
    if rise < thresholds.least_m or rise > thresholds.most_m:
        return False
    margin = thresholds.margin * rise
    step = height[beside[1][0]] - height[beside[0][0]]
    return bool(foot + margin < shot_height < top - margin and step >= thresholds.share * rise)
