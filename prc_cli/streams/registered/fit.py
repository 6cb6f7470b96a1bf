"""Finds the motion of a scanner from its points in three steps: rate, first guess, smooth path."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from prc_cli.core.types import F64
from prc_cli.streams.evidence.periods import measure_rates, shot_period
from prc_cli.streams.registered.path import Knots, observe, smooth
from prc_cli.streams.registered.rotation import Rotation, Turning
from prc_cli.streams.registered.scan import Scan
from prc_cli.streams.registered.start import (
    Windows,
    drift_hz,
    join_windows,
    knots_between,
    stations_of_lines,
)

KNOT_S = 0.01
"""Least time between knots [s], or a line."""
WINDOW_SPACING_S = 0.02
"""Time between single lines with a station [s]."""
LEAST_WINDOWS = 20
"""Fewest single lines with a station, in short passes."""
POINTS_BETWEEN_KNOTS = 120
"""Points between two knots."""
MOST_WHOLE_M = 0.08
"""Lines are tried as arcs if whole lines have a larger median residual [m]."""
ARC_GAIN = 0.3
"""Lines are arcs if that lowers the residual of whole lines to this share."""
LEAST_TRUSTED = 3
"""Trusted windows that a path needs."""
SEGMENT_KNOTS = 800
OVERLAP_KNOTS = 200
"""Knots of a segment, and knots that neighbouring segments share."""
ON_BEAM = 5.0
"""A point is on its beam within this many median residuals."""
LEAST_GROUPS = 50
"""Fewest times that several points share, for the check."""
OF_SEVERAL_SHOTS = 0.25
"""Points of one time are several shots if they differ by more than this share of a column."""


@dataclass(frozen=True, slots=True)
class Track:
    """The path of one pass, and its fit to the points."""

    knots: Knots
    sigma_m: F64
    """(k, 3) float64, standard deviation of the stations [m]."""
    slope: float
    """Tangent of the cone angle of the beam."""
    residual_m: float
    """Median distance of the points from their beams [m]."""
    share_on_beam: float
    """Share of the points on their beams, within :data:`ON_BEAM` residuals."""
    share_in_front: float
    """Share of the points in front of the scanner."""
    share_trusted: float
    """Share of the single lines that fit and agree with their neighbours."""


def window_spacing(duration_s: float) -> float:
    """Return the time between single lines with a station [s], less in short passes."""
    return min(WINDOW_SPACING_S, duration_s / LEAST_WINDOWS)


def find_turning(time_s: F64, xyz_m: F64, rotation: Rotation) -> Turning:
    """Find the rate of turns and of lines, the same unless lines are arcs that begin anew.

    Parameters
    ----------
    time_s
        (n,) float64, rising, of a contiguous part of the drive [s].
    xyz_m
        (n, 3) float64 [m].
    rotation
        The rate of short pieces.
    """
    spacing_s = window_spacing(float(time_s[-1] - time_s[0]))
    turning = Turning(rotation.hz, rotation.hz, float(time_s[0]))
    windows = stations_of_lines(time_s, xyz_m, turning, spacing_s)
    residual = _median_residual(windows)
    # whole turns that fit are not arcs
    arcs = _arcs(time_s, rotation) if residual > MOST_WHOLE_M else None
    if arcs is not None:
        arc_windows = stations_of_lines(time_s, xyz_m, arcs, spacing_s)
        if _median_residual(arc_windows) < ARC_GAIN * residual:
            turning = arcs
            windows = arc_windows
    for _ in range(3):
        drift = drift_hz(windows)
        turning = turning.faster(drift)
        if abs(drift) < 1e-7 * turning.hz:
            break
        windows = stations_of_lines(time_s, xyz_m, turning, spacing_s)
    return turning


def _median_residual(windows: Windows) -> float:
    if not len(windows.time_s):
        return math.inf
    return float(np.median(windows.stations.residual_m))


def _arcs(time_s: F64, rotation: Rotation) -> Turning | None:
    """Return the turning of arcs: lines by the times, of another rate than the turns."""
    rates = measure_rates(distinct_times(time_s))
    if rates is None or abs(rotation.hz / rates.line_hz - 1.0) < 0.01:
        return None
    return Turning(rotation.hz, rates.line_hz, rates.time_origin_s)


PassPieces: TypeAlias = Callable[[], Iterator[tuple[F64, F64]]]
"""Yields times (n,) [s] and points (n, 3) [m] of a pass in pieces, each time from the start."""


def fit_track(pieces: PassPieces, turning: Turning, duration_s: float) -> Track | None:
    """Fit the path of one pass; None if too few lines have a station.

    Parameters
    ----------
    pieces
        Points of the pass, thinned; read twice.
    turning
        The bearing of the beam over time.
    duration_s
        Duration of the pass [s].
    """
    spacing_s = window_spacing(duration_s)
    parts: list[Windows] = []
    for time_s, xyz_m in whole_lines(pieces(), turning):
        part = stations_of_lines(time_s, xyz_m, turning, spacing_s)
        if len(part.time_s):
            parts.append(part)
    if not parts:
        return None
    windows = join_windows(parts)
    if np.count_nonzero(windows.trusted) < LEAST_TRUSTED:
        return None
    knots = knots_between(windows, knot_times(windows, turning))
    return _smooth_all(pieces, turning, knots, float(windows.trusted.mean()))


def knot_times(windows: Windows, turning: Turning) -> F64:
    """Return even times, a line before the first window to a line after the last, (k,) [s]."""
    line_s = 1.0 / turning.line_hz
    step = max(line_s, KNOT_S)
    first_s = windows.time_s[0] - line_s
    last_s = windows.time_s[-1] + line_s
    n_knots = max(math.ceil((last_s - first_s) / step) + 1, 4)
    times: F64 = first_s + step * np.arange(n_knots)
    return times


def whole_lines(pieces: Iterator[tuple[F64, F64]], turning: Turning) -> Iterator[tuple[F64, F64]]:
    """Cut pieces at the beginnings of scan lines."""
    left_s = np.empty(0)
    left_m = np.empty((0, 3))
    for time_s, xyz_m in pieces:
        time_s = np.concatenate([left_s, time_s])
        xyz_m = np.concatenate([left_m, xyz_m])
        line_s = 1.0 / turning.line_hz
        begin_s = turning.origin_s + math.floor((time_s[-1] - turning.origin_s) / line_s) * line_s
        cut = int(np.searchsorted(time_s, begin_s))
        if cut:
            yield time_s[:cut], xyz_m[:cut]
        left_s = time_s[cut:]
        left_m = xyz_m[cut:]
    if len(left_s):
        yield left_s, left_m


def _smooth_all(
    pieces: PassPieces,
    turning: Turning,
    knots: Knots,
    share_trusted: float,
) -> Track:
    # segments overlap; each gives half of the shared knots
    n = len(knots.time_s)
    sigma = np.zeros((n, 3))
    slope = 0.0
    residuals: list[float] = []
    on_beam: list[float] = []
    in_front: list[float] = []
    n_points: list[int] = []
    done = 0
    for first, last, time_s, xyz_m in segments(pieces, knots.time_s):
        span = slice(first, last + 1)
        start = Knots(knots.time_s[span], knots.position_m[span], knots.frame[span])
        bearing = turning.bearing(time_s)
        observed = observe(start.time_s, time_s, xyz_m, bearing, POINTS_BETWEEN_KNOTS)
        fit = smooth(start, observed, slope)
        slope = fit.slope
        begin = done
        done = last + 1 if last == n - 1 else last - OVERLAP_KNOTS // 2
        kept = slice(begin, done)
        local = slice(begin - first, done - first)
        knots.position_m[kept] = fit.knots.position_m[local]
        knots.frame[kept] = fit.knots.frame[local]
        sigma[kept] = fit.sigma_m[local]
        is_point = observed.weight > 0
        off_m = np.hypot(fit.in_plane_m, fit.across_m)[is_point]
        residual_m = float(np.median(off_m))
        most_off_m = ON_BEAM * max(residual_m, fit.scale_m / ON_BEAM)
        residuals.append(residual_m)
        on_beam.append(float(np.mean(off_m < most_off_m)))
        in_front.append(float(np.mean(fit.range_m[is_point] > 0)))
        n_points.append(len(off_m))
    weight = np.array(n_points, np.float64)
    return Track(
        knots,
        sigma,
        slope,
        residual_m=float(np.average(residuals, weights=weight)),
        share_on_beam=float(np.average(on_beam, weights=weight)),
        share_in_front=float(np.average(in_front, weights=weight)),
        share_trusted=share_trusted,
    )


def segments(pieces: PassPieces, knots_s: F64) -> Iterator[tuple[int, int, F64, F64]]:
    """Yield first and last knot of every segment, and the times and points between them."""
    n = len(knots_s)
    first = 0
    last = min(SEGMENT_KNOTS, n - 1)
    held_s = np.empty(0)
    held_m = np.empty((0, 3))
    for time_s, xyz_m in pieces():
        held_s = np.concatenate([held_s, time_s])
        held_m = np.concatenate([held_m, xyz_m])
        while last < n - 1 and held_s[-1] > knots_s[last]:
            stop = int(np.searchsorted(held_s, knots_s[last]))
            yield first, last, held_s[:stop], held_m[:stop]
            first = last - OVERLAP_KNOTS
            last = min(first + SEGMENT_KNOTS, n - 1)
            if n - 1 - last < OVERLAP_KNOTS:
                last = n - 1
            begin = int(np.searchsorted(held_s, knots_s[first]))
            held_s = held_s[begin:]
            held_m = held_m[begin:]
    yield first, n - 1, held_s, held_m


def distinct_times(time_s: F64) -> F64:
    """Return rising times (n,) without repeats."""
    return time_s[np.diff(time_s, prepend=-np.inf) > 0]


@dataclass(frozen=True, slots=True)
class Clock:
    """Rates of the shots by the times."""

    distinct_hz: float
    """Shots a second if points of one time are returns of one shot."""
    shared_hz: float
    """Shots a second if times are rounded and several shots share one."""

    def shots_per_turn(self, turning: Turning, *, coarse: bool) -> float:
        """Return the shots in a whole turn."""
        return (self.shared_hz if coarse else self.distinct_hz) / turning.hz


def read_clock(time_s: F64) -> Clock | None:
    """Return the rates of shots by the times of consecutive points; None without steps.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s].
    """
    distinct_s = shot_period(distinct_times(time_s))
    shared_s = shot_period(time_s)
    if distinct_s <= 0 or shared_s <= 0:
        return None
    return Clock(1.0 / distinct_s, 1.0 / shared_s)


def are_shots_of_one_time(scan: Scan, time_s: F64, xyz_m: F64) -> bool:
    """Return whether points of one time are several shots, not returns of one shot.

    Parameters
    ----------
    scan
        The scan of the points, with a shot for every time.
    time_s
        (n,) float64, rising [s].
    xyz_m
        (n, 3) float64 [m].
    """
    is_first = np.diff(time_s, prepend=-np.inf) > 0
    begin = np.flatnonzero(is_first)
    is_several = np.diff(begin, append=len(time_s)) > 1
    if np.count_nonzero(is_several) < LEAST_GROUPS:
        return False
    bearing = scan.bearings(time_s, xyz_m - scan.stations(time_s))
    shot = np.cumsum(is_first) - 1
    from_first = bearing - bearing[begin][shot]
    away = np.remainder(from_first + math.pi, 2.0 * math.pi) - math.pi
    spread = np.maximum.reduceat(away, begin) - np.minimum.reduceat(away, begin)
    return float(np.median(spread[is_several])) > OF_SEVERAL_SHOTS * scan.step_rad
