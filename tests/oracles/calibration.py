"""Slow and simple twins of :mod:`prc_cli.methods.prc.calibration_loops`."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F32, F64, I64, Mask
from prc_cli.reference.prc.stages import is_intersection, support_mask


def support_histogram(
    window: F32,
    n_lines: int,
    n_columns: int,
    zetas_p: F64,
    zetas_s: F64,
    min_in_slice: int,
    min_adjacent: int,
) -> I64:
    """Run the support test at every pair of thresholds and take differences of the counts."""
    reach = max(n_columns + 1, 4)
    n_returns = int(np.count_nonzero(~np.isnan(window[reach : reach + n_lines * n_columns])))
    supported = np.zeros((len(zetas_p) + 2, len(zetas_s) + 2), dtype=np.int64)
    # beyond the last threshold one condition is dropped by asking for no neighbour
    rows = [*((zeta, min_in_slice) for zeta in zetas_p.tolist()), (0.0, 0)]
    columns = [*((zeta, min_adjacent) for zeta in zetas_s.tolist()), (0.0, 0)]
    for p, (zeta_p, in_slice) in enumerate(rows, start=1):
        for q, (zeta_s, adjacent) in enumerate(columns, start=1):
            mask = support_mask(window, n_lines, n_columns, zeta_p, zeta_s, in_slice, adjacent)
            supported[p, q] = np.count_nonzero(mask)
    assert supported[-1, -1] == n_returns
    counts: I64 = np.diff(np.diff(supported, axis=0), axis=1)
    return counts


def bend_histogram(
    window: F32,
    supported: Mask,
    lengths: F64,
    alpha: float,
) -> I64:
    """Test every supported shot at every length and count at how many of them it is marked."""
    reach = max(supported.shape[1] + 1, 4)
    counts = np.zeros(len(lengths) + 1, dtype=np.int64)
    for i in (reach + np.flatnonzero(supported)).tolist():
        before, here, after = (float(window[j]) for j in (i - 1, i, i + 1))
        if not np.isnan(before + here + after):
            marked = [
                is_intersection(before, here, after, "centred", alpha, d_c)
                for d_c in lengths.tolist()
            ]
            counts[sum(marked)] += 1
    return counts
