"""Numbers the returns of every shot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64, I64, Mask

MOST_RETURNS = 255
"""Largest number of a return; further ones have it, too."""


def count_returns(is_first: Mask) -> tuple[I64, I64]:
    """Return the number of every return and the number of returns of its shot, (n,) int64 each.

    Parameters
    ----------
    is_first
        (n,) bool, whether a record is the first return of its shot. The other returns of the shot
        follow it.

    Examples
    --------
    >>> number, count = count_returns(np.array([True, False, True]))
    >>> number.tolist(), count.tolist()
    ([1, 2, 1], [2, 2, 1])
    """
    begin = np.flatnonzero(is_first)
    shot = np.cumsum(is_first) - 1
    number = np.arange(len(is_first)) - begin[shot] + 1
    n_of_shot = np.diff(begin, append=len(is_first))
    count = n_of_shot[shot]
    return np.minimum(number, MOST_RETURNS), np.minimum(count, MOST_RETURNS)


def returns_of(records: NDArray[np.void], range_m: F64, *, by_time: bool) -> tuple[I64, I64]:
    """Return the number of every return and the number of returns of its shot, (n,) int64 each.

    Parameters
    ----------
    records
        (n,) points in the order of their times.
    range_m
        (n,) float64 [m].
    by_time
        Whether points of one time are returns of one shot, numbered from near to far. Else the
        cloud itself has their numbers, or every point is a shot.
    """
    if by_time:
        is_first = np.diff(records["time"], prepend=-np.inf) > 0
        number, count = count_returns(is_first)
        several = np.flatnonzero(count > 1)
        shot = np.cumsum(is_first) - 1
        order = np.lexsort((range_m[several], shot[several]))
        number[several[order]] = number[several]
        return number, count
    names = records.dtype.names or ()
    if "return_number" not in names or "number_of_returns" not in names:
        single = np.ones(len(records), np.int64)
        return single, single
    return records["return_number"].astype(np.int64), records["number_of_returns"].astype(np.int64)
