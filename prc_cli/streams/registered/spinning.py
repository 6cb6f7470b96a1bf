"""The scan of a spinning head, from registered points and their times alone.

Three steps, each of arrays in the order of time:

1. :mod:`.spinning_rate` finds the rate of the head from a sample of windows.
2. :mod:`.spinning_rings` finds the elevation of every ring and how far it looks ahead.
3. :mod:`.spinning_path` finds station and frame of the head for every window of a piece of the
   drive. Then every point gets its ring, and :mod:`.firings` finds its firing.

Only the results of the windows are kept, so a drive of any length can pass in pieces.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from prc_cli.core.types import F64, I64
from prc_cli.streams.registered.firings import (
    Firings,
    find_firings,
    firing_numbers,
    line_numbers,
    starting,
)
from prc_cli.streams.registered.spinning_path import HeadPath, fit_windows
from prc_cli.streams.registered.spinning_rate import NoScan, TurnRate, find_turn_hz, wrapped
from prc_cli.streams.registered.spinning_rings import Rings, find_rings, ring_numbers

SAMPLE_POINTS = 300_000
"""Points in a row in which the firings are sought."""
MOST_SHARED = 0.02
"""Share of shots with the time of the shot before in their ring; more = times are coarse."""
SAME_SHOT_RAD = math.radians(0.05)
"""Points of one ring and time that lie closer are returns of one shot."""
N_TRIES = 3
MIN_TRUSTED = 0.5
"""Least share of the windows of a sample that must lie on the rings."""


@dataclass(frozen=True, slots=True)
class SpinningHead:
    """Rate, rings and firings of a spinning scanner, the same along a drive."""

    rate: TurnRate
    rings: Rings
    firings: Firings
    by_azimuth: bool = False
    """Whether firings follow from measured azimuths, because times are coarser than firings."""


@dataclass(frozen=True, slots=True)
class SpinningScan:
    """The scan of a piece of a drive; see :func:`scan_piece`."""

    path: HeadPath
    line: I64
    """(n,) int64, line of every point, rising with time; its shots look one way; -1 = no ring."""
    firing: I64
    """(n,) int64, number of the firing; -1 = off every ring."""
    ring: I64
    """(n,) int64, rank of the ring along the axis; -1 = off every ring."""
    column: I64
    """(n,) int64, rank of the ring from low to high; -1 = off every ring."""
    local_m: F64
    """(n, 3) float64, points in the frame of the head that does not spin [m]."""

    @property
    def range_m(self) -> F64:
        """Distance of every point from the head, (n,) float64 [m]."""
        distance: F64 = np.linalg.norm(self.local_m, axis=1)
        return distance

    @property
    def residual_m(self) -> float:
        """Median distance of the points from the cones and half planes of their shots [m]."""
        return float(np.median(np.hypot(self.path.beside_m, self.path.cone_m)))

    @property
    def on_rings(self) -> float:
        """Share of the points on a ring."""
        return float(np.mean(self.ring >= 0))

    @property
    def trusted(self) -> float:
        """Share of the windows that can be trusted."""
        return float(np.mean(self.path.is_trusted))


def find_head(time_s: F64, xyz_m: F64) -> SpinningHead | NoScan:
    """Find the rate, the rings and the firings of a spinning scanner.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s]. Gaps are allowed: some seconds from all over a drive are enough.
    xyz_m
        (n, 3) float64, registered points [m].

    Returns
    -------
    SpinningHead or NoScan
        The head, or why the points are not from a spinning head.
    """
    rate = find_turn_hz(time_s, xyz_m)
    if isinstance(rate, NoScan):
        return rate
    rings_and_rate = find_rings(time_s, xyz_m, rate)
    if isinstance(rings_and_rate, NoScan):
        return rings_and_rate
    rings, rate = rings_and_rate
    reason = "no window lies on the rings"
    for share in (np.arange(N_TRIES) + 0.5) / N_TRIES:
        begin = max(int(share * len(time_s)) - SAMPLE_POINTS // 2, 0)
        piece = slice(begin, begin + SAMPLE_POINTS)
        path = fit_windows(time_s[piece], xyz_m[piece], rate, rings)
        if not len(path.time_s) or path.is_trusted.mean() < MIN_TRUSTED:
            continue
        local = path.local(time_s[piece], xyz_m[piece])
        ring = ring_numbers(local, rings)
        shot = shot_times(time_s[piece], local, ring, rate, rings)
        is_coarse = share_one_time(time_s[piece], shot, ring, rate) > MOST_SHARED
        fired = shot if is_coarse else time_s[piece]
        firings = find_firings(fired, ring, rings.ahead_rad, rate.hz)
        if firings is not None:
            # counted from the start of the drive, not of the piece
            return SpinningHead(rate, rings, starting(firings, float(time_s[0])), is_coarse)
        reason = "rings do not fire evenly: times are too coarse, or several scanners are mixed"
    return NoScan(reason)


def shot_times(
    time_s: F64,
    local_m: F64,
    ring: I64,
    rate: TurnRate,
    rings: Rings,
) -> F64:
    """Return the time at which the head looked at every point, by azimuth, (n,) [s]."""
    azimuth = rate.azimuth(time_s) + rings.ahead_rad[ring]
    late = wrapped(np.arctan2(local_m[:, 1], local_m[:, 0]) - azimuth)
    shot: F64 = np.where(ring >= 0, time_s + late / (2.0 * np.pi * rate.hz), time_s)
    return shot


def share_one_time(
    time_s: F64,
    shot_s: F64,
    ring: I64,
    rate: TurnRate,
) -> float:
    """Return the share of shots with the time of the shot before in their ring."""
    known = np.flatnonzero(ring >= 0)
    order = known[np.argsort(ring[known], kind="stable")]
    same = (np.diff(ring[order]) == 0) & (np.diff(time_s[order]) == 0)
    apart = np.abs(np.diff(shot_s[order])) * 2.0 * np.pi * rate.hz > SAME_SHOT_RAD
    return float(np.count_nonzero(same & apart)) / max(len(order), 1)


def scan_piece(time_s: F64, xyz_m: F64, head: SpinningHead) -> tuple[SpinningScan, SpinningHead]:
    """Find line, ring and range of the points of a piece, and the head for the next piece.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s]; a turn or more.
    xyz_m
        (n, 3) float64, registered points [m].
    head
        As found, or as returned with the piece before.
    """
    path = fit_windows(time_s, xyz_m, head.rate, head.rings)
    if not len(path.time_s):
        nothing = np.full(len(time_s), -1, np.int64)
        nowhere = np.full((len(time_s), 3), np.nan)
        return SpinningScan(path, nothing, nothing, nothing, nothing, nowhere), head
    local = path.local(time_s, xyz_m)
    ring = ring_numbers(local, head.rings)
    shot = shot_times(time_s, local, ring, head.rate, head.rings) if head.by_azimuth else None
    firing, firings = firing_numbers(time_s, ring, head.firings, shot)
    line = line_numbers(firing, ring, firings)
    column = ring if head.rings.is_up else np.where(ring >= 0, head.rings.n_rings - 1 - ring, -1)
    return SpinningScan(path, line, firing, ring, column, local), replace(head, firings=firings)
