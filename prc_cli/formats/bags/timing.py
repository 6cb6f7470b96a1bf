"""Finds firing columns from times: the lasers of a scanner fire in turn, with one period."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F64, I64

_LEAST_PERIOD_S = 1e-6
MOST_WAITING = 1 << 20
"""Limit of points that wait until their columns are known."""
_MOST_COLUMNS = 1e9
"""Most columns of a message."""
FITS = 0.1
"""Largest distance of a later point from the columns of the clock, as a share of the period."""


@dataclass(frozen=True, slots=True)
class Timing:
    """Firing columns of points."""

    period_s: float
    start_s: float
    """Time of column 0 [s]."""
    column: I64
    """(n,) int64, column of every point, from 0."""
    late_s: F64
    """(rings,) float64, delay of the laser of a ring after the first of its column [s]."""
    is_together: bool = False
    """Whether all lasers of a column fire at one time."""
    fired_s: F64 | None = None
    """(columns,) float64, time of every column [s]; None = the period gives it."""

    @property
    def n_columns(self) -> int:
        """Number of columns."""
        return int(self.column.max()) + 1

    def starts_s(self, n: int) -> F64:
        """Return the firing times of the first columns, (n,) float64 [s]."""
        if self.fired_s is not None:
            return self.fired_s[:n]
        starts: F64 = self.start_s + np.arange(n, dtype=np.float64) * self.period_s
        return starts

    def follow(
        self,
        ring: I64,
        time_s: F64,
        n_first: int,
        fits: float = FITS,
    ) -> Timing | None:
        """Return the columns of later points; None if their times do not fit the clock.

        The first ``n_first`` points are one column.
        """
        if self.is_together or not n_first or ring.max() >= len(self.late_s):
            return None
        after_s = time_s - self.late_s[ring]
        start = float(np.median(after_s[:n_first]))
        exact = (after_s - start) / self.period_s
        number = np.rint(exact)
        if not (
            number.min() == 0
            and number.max() < MOST_WAITING
            and np.abs(exact - number).max() < fits
        ):
            return None
        return Timing(self.period_s, start, number.astype(np.int64), self.late_s)


def find_columns(ring: I64, time_s: F64) -> Timing | None:
    """Find the firing column of every point from its time; None if the times show no columns.

    Lasers that fire together have few times: each is a column, and the period may vary with the
    motor. Lasers that fire in turn follow a clock: the times of a ring are multiples of the period
    apart.

    >>> time_s = np.array([0.0, 0.1, 0.3, 0.02, 0.12, 0.22, 0.04, 0.14, 0.34])
    >>> find_columns(np.repeat([0, 1, 2], 3), time_s).column.tolist()
    [0, 1, 3, 0, 1, 2, 0, 1, 3]
    """
    start = float(time_s.min())
    every, which = _unique_times(time_s - start)
    if len(every) <= 2 * int(np.bincount(ring).max()):
        steps = np.diff(every) * _LEAST_PERIOD_S
        period = _usual(steps[steps > _LEAST_PERIOD_S])
        if not period or not every[-1] * _LEAST_PERIOD_S < _MOST_COLUMNS * period:
            return None
        number = np.cumsum(
            np.rint(np.diff(every, prepend=0.0) * (_LEAST_PERIOD_S / period))
        ).astype(np.int64)
        # between columns that returned; a period in whole microseconds would run away from them
        known_s = start + every * _LEAST_PERIOD_S
        fired_s: F64 = np.interp(np.arange(int(number[-1]) + 1), number, known_s)
        period = float(every[-1]) * _LEAST_PERIOD_S / max(int(number[-1]), 1)
        late_s = np.zeros(int(ring.max()) + 1)
        return Timing(period, start, number[which], late_s, is_together=True, fired_s=fired_s)
    order = np.lexsort((time_s, ring))
    sorted_rings = ring[order]
    sorted_s = time_s[order]
    steps = np.diff(sorted_s)
    period = _usual(steps[(np.diff(sorted_rings) == 0) & (steps > _LEAST_PERIOD_S)])
    if not period or not float(time_s.max()) - start < _MOST_COLUMNS * period:
        return None
    present, first, counts = np.unique(sorted_rings, return_index=True, return_counts=True)
    # exact from the first to the last shot of the ring with the most points
    fullest = slice(first[counts.argmax()], first[counts.argmax()] + counts.max())
    n_steps = int(np.rint(np.diff(sorted_s[fullest]) / period).sum())
    period = float(np.ptp(sorted_s[fullest])) / n_steps if n_steps else period
    turned = np.exp(1j * math.tau * ((sorted_s - start) / period))
    of_ring = np.angle(np.add.reduceat(turned, first)) / math.tau % 1.0
    # the lasers begin to fire after the longest pause
    ordered = np.sort(of_ring)
    gaps = np.diff(np.append(ordered, ordered[0] + 1.0))
    begin = float(ordered[(int(gaps.argmax()) + 1) % len(ordered)])
    late: F64 = np.zeros(int(ring.max()) + 1)
    late[present] = (of_ring - begin + 1e-9) % 1.0 - 1e-9
    column = np.rint((time_s - start) / period - begin - late[ring]).astype(np.int64)
    least = int(column.min())
    return Timing(period, start + (begin + least) * period, column - least, late * period)


def _unique_times(after_s: F64) -> tuple[F64, I64]:
    """Return the different times in steps of ``_LEAST_PERIOD_S``, and the index of every time."""
    ticks = np.rint(after_s / _LEAST_PERIOD_S)
    span = float(ticks.max()) + 1
    if not span <= MOST_WAITING:
        every, which = np.unique(ticks, return_inverse=True)
        return every, which.ravel()
    whole = ticks.astype(np.int64)
    seen = np.zeros(int(span), np.int64)
    seen[whole] = 1
    return np.flatnonzero(seen).astype(np.float64), (np.cumsum(seen) - 1)[whole]


def _usual(steps: F64) -> float:
    """Return the median of the short steps; 0 without steps.

    >>> _usual(np.array([2.0, 2.0, 9.0, 9.0, 9.0]))
    2.0
    """
    return (
        float(np.median(steps[steps < 1.5 * float(np.percentile(steps, 10))]))
        if len(steps)
        else 0.0
    )
