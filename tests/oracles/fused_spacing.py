"""Slow and obvious twin of :mod:`prc_cli.methods.fused.spacing_loops`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32
from prc_cli.methods.fused.thresholds import SpacingThresholds

LAGS = (1, 2, 4, 8, 16)


def _sticks_out(ranges: F32, column: int, thresholds: SpacingThresholds) -> bool:
    """Return whether a shot is near to both neighbours in range, and on no surface with them."""
    if not 1 <= column < len(ranges) - 1:
        return False
    previous, middle, following = ranges[column - 1 : column + 2]
    limit = thresholds.tolerance_m + thresholds.tolerance_per_m * middle
    before = middle - previous
    after = following - middle
    if not (abs(before) < thresholds.near_m and abs(after) < thresholds.near_m):
        return False
    return bool(abs(before) > limit and abs(after) > limit and abs(after - before) > limit)


def leaf_repeats(range_m: F32, first: int, thresholds: SpacingThresholds) -> NDArray[np.int32]:
    """Count repeated leaves; see :func:`prc_cli.methods.fused.spacing_loops.leaf_repeats`."""
    n_lines = range_m.shape[0] - 16
    m = range_m.shape[1]
    counts = np.zeros((n_lines, len(LAGS) + 1, 2), np.int32)
    for line in range(first, n_lines, 4):
        ranges = range_m[line + 16]
        for column in range(m):
            if not all(
                _sticks_out(ranges, near, thresholds) for near in range(column - 1, column + 2)
            ):
                continue
            middle = ranges[column]
            limit = thresholds.tolerance_m + thresholds.tolerance_per_m * middle
            others = [range_m[line + 16 - lag, column] for lag in LAGS]
            others.append(ranges[column + 2] if column + 2 < m else np.float32(np.nan))
            for k, shifted in enumerate(others):
                if not np.isnan(shifted):
                    counts[line, k] += 1, abs(middle - shifted) < limit
    return counts
