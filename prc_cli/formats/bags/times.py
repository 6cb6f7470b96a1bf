"""Find the unit of the times of points from the turning of the scanner, and times out of place."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from prc_cli.core.types import F64, I64, Mask
from prc_cli.formats.bags.sweep import wrap

_TURN = 2 * math.pi

UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units of stored times [s]."""
SLOWEST_HZ = 2.0
FASTEST_HZ = 60.0
"""Turns a second of spinning scanners."""
_SAME_WAY = 0.8
"""Least share of steps in azimuth that go the way of the turn."""
_LATE_TURN = 0.9
"""Share of a turn behind which a point may belong to the beginning of the next turn."""
_ABOUT_TURN = 0.1
"""Tolerance of the turns of a message that is one turn."""
_NEAR_RAD = math.radians(60.0)
_PAUSE_STEPS = 100.0
"""Points of a ring with a larger step in azimuth [rad] or in time [usual steps] have a sector
without points between them."""
_LEAST_STEPS = 16
"""Fewer steps in azimuth do not show a turn."""
_WHOLE_TURN = 0.02
"""Tolerance of the turns in one stored unit if the unit is a turn."""
_SPARSE = 0.05
"""Stretches with a smaller share of the usual number of points are sparse."""
_STRETCHES = 16
"""Stretches in the time that half of the points take."""
_UNEVEN = 4.0
_EVEN = 1.3
"""A message has no odd times if its span is at most ``_EVEN`` times the span of the middle 90 %,
and the parts of that differ by less than a factor of ``_UNEVEN``."""

LONG_S = 1.0
"""No message takes longer [s]."""


class Turning(NamedTuple):
    """Turn of the scanner during a message."""

    per_unit: float
    """Turns in one unit of the stored times."""
    is_steady: bool
    """Whether the azimuth goes one way."""


def find_turning(ring: I64, time: F64, azimuth_rad: F64) -> Turning | None:
    """Find how far a scanner turns in one unit of the times of its points; None if points are few.

    Parameters
    ----------
    ring : (n,) int64
        Ring of every point.
    time : (n,) float64
        Stored time of every point, in any unit.
    azimuth_rad : (n,) float64
        Azimuth of every point [rad].

    Examples
    --------
    >>> time_us = np.arange(0.0, 50000.0, 500.0)
    >>> turning = find_turning(np.zeros(100, np.int64), time_us, time_us * 1e-5 * 2 * np.pi)
    >>> round(turning.per_unit * 1e6, 6)
    10.0
    """
    fullest = np.flatnonzero(ring == np.bincount(ring).argmax())
    fullest = fullest[np.argsort(time[fullest], kind="stable")]
    turned = wrap(np.diff(azimuth_rad[fullest]))
    after = np.diff(time[fullest])
    if not (after > 0).any():
        return None
    # a wide sector without points does not show the direction of turning
    is_near = (np.abs(turned) < _NEAR_RAD) & (
        after <= _PAUSE_STEPS * float(np.median(after[after > 0]))
    )
    span = float(after[is_near].sum())
    turned = turned[is_near & (turned != 0)]
    if len(turned) < _LEAST_STEPS or not span > 0:
        return None
    share = float(np.mean(turned > 0))
    return Turning(abs(float(turned.sum())) / _TURN / span, max(share, 1 - share) >= _SAME_WAY)


def find_unit(usual_s: float, turning: Turning) -> float:
    """Return the unit of stored times with a usual turn rate, the usual unit first [s].

    >>> find_unit(1.0, Turning(10.0, True)), find_unit(1.0, Turning(1e-5, True))
    (1.0, 1e-06)
    """

    def turns(unit_s: float) -> bool:
        return SLOWEST_HZ <= turning.per_unit / unit_s <= FASTEST_HZ

    if not turning.is_steady or turns(usual_s):
        return usual_s
    return next((unit_s for unit_s in UNITS_S.values() if turns(unit_s)), usual_s)


def unit_note(unit_s: float, usual_s: float) -> str:
    """Return a sentence on a unit of times that is not the usual one; else empty.

    >>> unit_note(1e-6, 1.0)
    'the times of the points are in us (input.time_unit)'
    """
    if unit_s == usual_s:
        return ""
    name = next(
        (name for name, value in UNITS_S.items() if value == unit_s), f"turns of {unit_s:.6g} s"
    )
    return f"the times of the points are in {name} (input.time_unit)"


def counts_turns(time: F64, turning: Turning) -> bool:
    """Whether stored times are parts of a turn: 0 to 1, or -1 to 0."""
    is_turn = turning.is_steady and abs(turning.per_unit - 1) < _WHOLE_TURN
    return is_turn and float(np.abs(time).max()) < 1 + _WHOLE_TURN


def turn_times(ring: I64, azimuth_rad: F64, between_s: float) -> F64:
    """Return times of points that have none, from their azimuths.

    Parameters
    ----------
    ring : (n,) int64
        Ring of every point; the points of a ring are in the order of firing.
    azimuth_rad : (n,) float64
        Azimuth [rad]; NaN = no return.
    between_s : float
        Time from this message to the next [s].

    Returns
    -------
    (n,) float64
        Time since the first point [s].

    Examples
    --------
    >>> azimuth = np.deg2rad(np.arange(20) * 18.0)
    >>> turn_times(np.zeros(20, np.int64), azimuth, 0.1)[:4].round(3).tolist()
    [0.0, 0.005, 0.01, 0.015]
    """
    times: F64 = np.full(len(ring), np.nan)
    returned = np.flatnonzero(np.isfinite(azimuth_rad))
    if not len(returned):
        return times
    order = returned[np.argsort(ring[returned], kind="stable")]
    azimuth = azimuth_rad[order]
    is_first = np.diff(ring[order], prepend=-2) != 0
    steps = wrap(np.diff(azimuth))[~is_first[1:]]
    way = math.copysign(1.0, float(np.median(steps[steps != 0]))) if (steps != 0).any() else 1.0
    starts = np.flatnonzero(is_first)
    counts = np.diff(np.append(starts, len(order)))
    begin = float(np.angle(np.exp(1j * azimuth[starts]).sum()))
    turned = way * (azimuth - begin) % _TURN
    # rings begin a little before or after the others
    rank = (np.arange(len(order)) - np.repeat(starts, counts)) / np.repeat(counts, counts)
    turned[(turned > _LATE_TURN * _TURN) & (rank < 0.5)] -= _TURN
    turned[(turned < (1 - _LATE_TURN) * _TURN) & (rank > _LATE_TURN)] += _TURN
    turned -= turned.min()
    n_turns = max(float(turned.max()) / _TURN, 1 / _TURN)
    # the message takes as long as the time to the next
    n_turns = 1.0 if abs(n_turns - 1) < _ABOUT_TURN else n_turns
    times[order] = turned / _TURN * (between_s / n_turns)
    return times


class Crowd(NamedTuple):
    """Time in which nearly all points of a message lie [s]."""

    begin_s: float
    """Earlier points do not belong to the message."""
    end_s: float
    """Later points belong to a later message, or to none."""


def find_crowd(time_s: F64) -> Crowd:
    """Find the time in which nearly all points lie.

    Times far from it, and times of few points, are outside.

    >>> find_crowd(np.append(np.linspace(5.0, 5.1, 1001), [0.0, 5.15]))
    Crowd(begin_s=4.0, end_s=5.1)
    """
    n = len(time_s)
    ranks = [n // 20, n // 4, n // 2, n - 1 - n // 4, n - 1 - n // 20]
    parts = np.diff(np.partition(time_s, ranks)[ranks])
    first = float(time_s.min())
    last = float(time_s.max())
    if last - first <= _EVEN * parts.sum() and parts.max() < _UNEVEN * parts.min():
        return Crowd(first - LONG_S, last)
    ordered = np.sort(time_s)
    half = n // 2
    widths = ordered[half:] - ordered[: n - half]
    middle = int(widths.argmin())
    width_s = float(widths[middle])
    if not width_s > 0:
        return Crowd(first - LONG_S, last)
    # the message is the run of points around the densest half, without longer pauses
    borders = np.flatnonzero(np.diff(ordered) > width_s) + 1
    start = int(np.max(borders[borders <= middle], initial=0))
    stop = int(np.min(borders[borders > middle], initial=n))
    crowd = ordered[start:stop]
    stretch_s = width_s / _STRETCHES
    number = ((crowd - crowd[0]) / stretch_s).astype(np.int64)
    is_dense: Mask = np.bincount(number) > _SPARSE * half / _STRETCHES
    end_s = float(crowd[number <= np.flatnonzero(is_dense)[-1]][-1])
    return Crowd(float(crowd[0]) - LONG_S, end_s)
