"""Critical thresholds of every shot (Lehtola et al. 2019, V-A): from which zeta on it is supported."""

from __future__ import annotations

import numpy as np

from prc_cli.core.profile import stage
from prc_cli.core.stream import CriticalZetas
from prc_cli.core.types import F32
from prc_cli.methods.prc.support import SupportParams, required_counts, window_reach

_IN_LINE = (-4, -3, -2, -1, 1, 2, 3, 4)


@stage("critical zeta")
def critical_zetas(window: F32, points_per_line: int, params: SupportParams) -> CriticalZetas:
    """Find the range differences from which on the shots of a block are supported (eqs. 4 to 8).

    ``window`` (reach + lines * M + reach,) float32, metres.

    A shot half a metre in front of a wall needs half a metre, the wall nothing:

    >>> from prc_cli.methods.prc.support import stream_window
    >>> image = np.full((3, 7), 20.0, dtype=np.float32)
    >>> image[1, 3] = 19.5
    >>> window = stream_window(np.full(8, np.nan, dtype=np.float32), image, None)
    >>> critical_zetas(window, 7, SupportParams()).in_line_m[1]
    array([0. , 0. , 0. , 0.5, 0. , 0. , 0. ], dtype=float32)
    """
    m = points_per_line
    reach = window_reach(m)
    shape = ((len(window) - 2 * reach) // m, m)
    # with one shot a line, i + M - 1 is i itself: a shot does not support itself
    beside = tuple(shift for shift in (-m - 1, -m, -m + 1, m - 1, m, m + 1) if shift)
    min_in_slice, min_adjacent = required_counts(params)
    missing = np.isnan(window[reach : len(window) - reach])
    found = []
    for shifts, k in ((_IN_LINE, min_in_slice), (beside, min_adjacent)):
        value = _kth_difference(window, reach, shifts, k)
        value[missing] = np.nan
        found.append(value.reshape(shape))
    return CriticalZetas(*found)


def _kth_difference(window: F32, reach: int, shifts: tuple[int, ...], k: int) -> F32:
    """Return the k-th smallest range difference of every shot to some neighbours, infinite where there are fewer."""
    own = window[reach : len(window) - reach]
    smallest = np.full((max(k, 1), own.size), np.inf, np.float32)
    for shift in shifts:
        start = reach + shift
        new = np.abs(own - window[start : start + own.size])
        new[np.isnan(new)] = np.inf
        for row in smallest:  # as many values as are needed, in order
            larger = np.maximum(row, new)
            np.minimum(row, new, out=row)
            new = larger
    return smallest[k - 1] if k else np.zeros(own.size, np.float32)
