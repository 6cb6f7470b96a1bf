"""Find the firing columns of clouds whose points share times.

The times are the times of packets, or are cut to a part of a second. They give the turn and the
rate of turning. The azimuth gives the column: along every ring columns rise strictly and follow
the azimuth as closely as possible (isotonic regression), as in frames of rings.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from prc_cli.core.types import F32, F64, I64, Mask
from prc_cli.formats.firings import MAX_SHIFT

SAME_SHOT_RAD = 3e-4
"""Returns of one shot differ less in azimuth; columns are 0.05 deg apart and more [rad]."""
MANY = 0.01
"""Share of points with the ring and time of another column above which times are no columns."""
SAME_SHOT = 0.1
"""Returns of one shot differ less in azimuth [columns]."""
SLACK = 3
"""Columns that wait for the points of the next message."""
NEIGHBOUR = 1.5
"""Steps below this multiple of the median are between neighbours."""
DENSEST = 25.0
"""Percentile of steps for the step: cells must be fine enough where shots are densest."""
WINDOW = 16
"""Steps in a row that one is measured over."""
TOO_WIDE = 3.0
TOO_WIDE_RAD = math.radians(30.0)
"""Points of one time spread at most this multiple of the turn to the next time, plus this [rad].

The lasers of a column look that far apart. Points of a wider group do not have one time.
"""
_TURN = 2 * math.pi


def wrap(angle: F64) -> F64:
    """Bring angles into [-pi, pi)."""
    wrapped: F64 = (angle + math.pi) % _TURN - math.pi
    return wrapped


def share_times(ring: I64, time_s: F64, azimuth_rad: F64) -> bool:
    """Return whether many points have the ring and the time of a point of another column."""
    order = np.lexsort((azimuth_rad, time_s, ring))
    is_same = (np.diff(ring[order]) == 0) & (np.diff(time_s[order]) == 0)
    is_other = np.abs(wrap(np.diff(azimuth_rad[order]))) > SAME_SHOT_RAD
    return bool(np.count_nonzero(is_same & is_other) > MANY * len(ring))


@dataclass(frozen=True, slots=True)
class Placed:
    """Columns of points."""

    column: I64
    """(n,) int64, column of every point, from 0."""
    base: int
    """Number of column 0 since the first of the recording."""
    time_s: F64
    """(columns,) float64, when each was fired, about [s]."""


@dataclass(slots=True)
class Sweep:
    """Turning of a scanner, and its last position."""

    rate_rad_s: float
    """Rate of turning; positive = anticlockwise from above [rad/s]."""
    step_rad: float
    """From column to column [rad]."""
    shift: I64
    """(rings,) int64, columns that a ring looks ahead."""
    time_s: float
    """Time of a known position [s]."""
    azimuth_rad: float
    """Azimuth at that time, over all turns [rad]."""
    begin: float = math.nan
    """Place of the first column, in columns."""
    next: int = 0
    """First column that was not yielded."""
    last_s: float = -math.inf
    """Time of the last yielded column [s]."""

    @classmethod
    def of(
        cls,
        ring: I64,
        time_s: F64,
        azimuth_rad: F64,
        n_rings: int,
    ) -> Sweep | None:
        """Measure the turning from a first message; None if its times do not show it."""
        every, middle, spread = _groups(time_s, azimuth_rad)
        if len(every) < 3:
            return None
        steps = wrap(np.diff(middle))
        rate = float(steps.sum()) / float(every[-1] - every[0])
        usual = float(np.median(np.abs(steps)))
        if (
            not rate
            or usual > math.pi / 2
            or float(np.median(spread)) > TOO_WIDE * usual + TOO_WIDE_RAD
        ):
            return None
        sweep = cls(rate, 0.0, np.zeros(n_rings, np.int64), float(every[0]), float(middle[0]))
        along = sweep.along(time_s, azimuth_rad)
        sweep.step_rad = find_step(ring, along)
        if not sweep.step_rad:
            return None
        ahead = (along - abs(rate) * (time_s - every[0])) / sweep.step_rad
        columns_ahead = np.array([np.median(ahead[ring == number]) for number in np.unique(ring)])
        shift = (
            np.rint(columns_ahead - columns_ahead.mean())
            .astype(np.int64)
            .clip(-MAX_SHIFT, MAX_SHIFT)
        )
        # waiting columns absorb smaller shifts
        sweep.shift[np.unique(ring)] = np.where(np.abs(shift) < SLACK, 0, shift)
        return sweep

    def along(self, time_s: F64, azimuth_rad: F64) -> F64:
        """Return how far the scanner had turned at points, (n,) float64, in its direction [rad]."""
        way = math.copysign(1.0, self.rate_rad_s)
        expected = self.azimuth_rad + self.rate_rad_s * (time_s - self.time_s)
        turned: F64 = way * (azimuth_rad + _TURN * np.rint((expected - azimuth_rad) / _TURN))
        return turned

    def place(self, ring: I64, time_s: F64, azimuth_rad: F64) -> Placed:
        """Return the columns of the next points."""
        along = self.along(time_s, azimuth_rad)
        place = along / self.step_rad - self.shift[ring]
        if math.isnan(self.begin):
            self.begin = float(place.min())
        column = rising_columns(ring, place - self.begin)
        # points placed again with later ones may move a little back
        column = np.where(column >= self.next - SLACK, np.maximum(column, self.next), column)
        least = int(column.min())
        n = int(column.max()) - least + 1
        fired = np.array([np.median(time_s - place * (self.step_rad / abs(self.rate_rad_s)))])
        fired = fired + (self.begin + least + np.arange(n)) * (self.step_rad / abs(self.rate_rad_s))
        # times of columns rise even if the clock of packets jumps
        fired = np.maximum(fired, self.last_s)
        self.next = max(self.next, least + n - SLACK)
        self.last_s = max(self.last_s, float(fired[max(n - SLACK - 1, 0)]))
        newest = time_s == time_s.max()
        self.time_s, way = float(time_s.max()), math.copysign(1.0, self.rate_rad_s)
        self.azimuth_rad = way * float(np.median(along[newest]))
        return Placed(column - least, least, fired)


def _groups(time_s: F64, azimuth_rad: F64) -> tuple[F64, F64, F64]:
    """Return the different times, and mean and spread of the azimuth of each, (times,) float64."""
    every, which = np.unique(time_s, return_inverse=True)
    unit = [np.bincount(which.ravel(), wave(azimuth_rad)) for wave in (np.cos, np.sin)]
    middle: F64 = np.arctan2(unit[1], unit[0])
    off = np.abs(wrap(azimuth_rad - middle[which.ravel()]))
    return every, middle, 2 * np.bincount(which.ravel(), off) / np.bincount(which.ravel())


def find_step(ring: I64, along_rad: F64) -> float:
    """Return the angle from column to column where they are densest [rad]; 0 = unknown."""
    order = np.lexsort((along_rad, ring))
    steps = np.diff(along_rad[order])
    steps = steps[(np.diff(ring[order]) == 0) & (steps > SAME_SHOT_RAD)]
    if not len(steps):
        return 0.0
    # many shots may be missing: the usual step is a short one
    usual = float(np.percentile(steps, DENSEST))
    near = steps[steps < NEIGHBOUR * usual]
    n = len(near) // WINDOW * WINDOW
    means = near[:n].reshape(-1, WINDOW).mean(axis=1) if n else near
    return float(np.percentile(means, DENSEST))


def rising_columns(ring: I64, place: F64) -> I64:
    """Return the column of every point, which rises along a ring and follows the place.

    Returns of one shot have one place and one column:

    >>> rising_columns(np.zeros(5, np.int64), np.array([0.1, 0.9, 0.9, 1.2, 4.0])).tolist()
    [0, 1, 1, 2, 4]
    """
    from scipy.optimize import isotonic_regression  # imported here: loading takes time

    order = np.lexsort((place, ring))
    sorted_rings = ring[order]
    sorted_place = place[order]
    is_new: Mask = np.ones(len(sorted_place), np.bool_)
    is_new[1:] = (np.diff(sorted_rings) != 0) | (np.diff(sorted_place) > SAME_SHOT)
    shot = np.cumsum(is_new) - 1
    starts = np.flatnonzero(is_new)
    first = sorted_place[starts]
    ring_of = sorted_rings[starts]
    column = np.empty(len(first), np.int64)
    borders = [*np.flatnonzero(np.diff(ring_of, prepend=-1)).tolist(), len(first)]
    for begin, stop in pairwise(borders):
        # strictly rising = ordinal plus a function that does not fall
        ordinal = np.arange(stop - begin)
        column[begin:stop] = (
            np.rint(isotonic_regression(first[begin:stop] - ordinal).x).astype(np.int64) + ordinal
        )
    columns = np.empty(len(ring), np.int64)
    columns[order] = column[shot]
    return columns


def azimuths(xyz_m: F32) -> F64:
    """Return azimuths of points, (n, 3) float32, (n,) float64 [rad]."""
    azimuth: F64 = np.arctan2(xyz_m[:, 1].astype(np.float64), xyz_m[:, 0].astype(np.float64))
    return azimuth
