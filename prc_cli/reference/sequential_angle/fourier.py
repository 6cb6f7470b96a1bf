"""The Fourier transform that tells cars from vegetation (Stamos et al. 2012, sec. 7.5)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from prc_cli.core.types import F32, F64, I32, Mask
from prc_cli.methods.sequential_angle.thresholds import FourierThresholds


def high_frequencies(angles: F64, band: float, ratio: float) -> list[int]:
    """Return S: the frequencies of the band that exceed a share of the largest one, equal within rounding not."""
    n = len(angles)
    spectrum = np.abs(np.fft.rfft(angles))
    largest = spectrum.max()
    return [k for k in range(len(spectrum)) if k >= band * n and spectrum[k] > ratio * (1 + 1e-9) * largest]


def stable_intervals(signed_deg: F32, intervals: I32, thresholds: FourierThresholds) -> Mask:
    """Mark intervals with an empty S; see :func:`fourier_loops.stable_intervals`."""
    decisions = []
    for row, first, last in intervals:
        angles = signed_deg[row, first : last + 1].astype(np.float64)
        angles = angles[~np.isnan(angles)]
        n = len(angles)
        if n < max(thresholds.min_points, 1):
            decisions.append(False)
            continue
        if 0 < thresholds.longest < n:
            decisions.append(True)
            continue
        n_windows = -(-n // thresholds.window_points)
        edges = [window * n // n_windows for window in range(n_windows + 1)]
        empty = [not high_frequencies(angles[a:b], thresholds.band, thresholds.ratio) for a, b in pairwise(edges)]
        decisions.append(sum(empty) >= n_windows / 2)
    return np.array(decisions, dtype=np.bool_)
