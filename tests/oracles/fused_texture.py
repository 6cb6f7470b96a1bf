"""Slow and simple twin of :mod:`prc_cli.methods.fused.texture_loops`."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.thresholds import DepthThresholds


def mean_smoothness(
    range_m: F32,
    near: U8,
    smooth: U8,
    step: np.float32,
    least_near: np.float32,
    half_m: np.float32,
    thresholds: DepthThresholds,
) -> F32:
    """Average smoothness; see :func:`prc_cli.methods.fused.texture_loops.mean_smoothness`."""
    rough, depth_m, least_pairs = thresholds
    mean = np.zeros((len(range_m) - 4, range_m.shape[1]), np.float32)
    pairs = np.minimum(smooth, 8).astype(int)
    for line, i in zip(*np.nonzero(~np.isnan(range_m[2:-2])), strict=True):
        columns = int(min(max(int(half_m / (range_m[line + 2, i] * step)), 3), 60))
        place = slice(line, line + 5), slice(max(i - columns, 0), i + columns + 1)
        counts = near[place] >= least_near
        if counts.any():
            mean[line, i] = np.float32(pairs[place][counts].sum()) / (
                np.float32(8) * np.float32(counts.sum())
            )
        if mean[line, i] < rough and smooth[line + 2, i] >= least_pairs:
            stride = max(-(-columns // 4), 1)
            beside = [
                j
                for j in range(range_m.shape[1])
                if abs(j - i) <= columns and (j - i) % stride == 0
            ]
            place = np.ix_(range(line, line + 5), beside)
            every = near[place] >= least_near
            counts = every & (np.abs(range_m[place] - range_m[line + 2, i]) < depth_m)
            if counts.any():
                seen = max(np.float32(counts.sum()) / np.float32(every.sum()), np.float32(0.85))
                share = np.float32(pairs[place][counts].sum()) / (
                    np.float32(8) * np.float32(counts.sum()) * seen
                )
                mean[line, i] = max(mean[line, i], share)
    return mean
