"""Ranges within bounds; apart from the stages because it is asked for wherever a file is read."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F32


def clean_ranges(ranges: F32, low: np.float32, high: np.float32) -> tuple[F32, int, int, int]:
    """Make ranges out of bounds missing; see :func:`support_loops.clean_ranges`."""
    kept = (ranges > low) & (ranges <= high)
    lost = ranges[~kept & ~np.isnan(ranges)]
    n_infinite = int(np.count_nonzero(np.isinf(lost)))
    finite = lost[np.isfinite(lost)]
    n_refused = int(np.count_nonzero(finite <= 0))
    n_positive = int(np.count_nonzero(finite > 0))
    cleaned: F32 = np.where(kept, ranges, np.float32(np.nan))
    return cleaned, n_infinite, n_refused, n_positive
