"""The stream of a cloud with a given path: rate and frames from the directions of points.

A tile is cut and sorted in space, so neither its first records nor whole lines show the rate. The
directions of short pieces do: they turn evenly in a plane through the scanner.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from prc_cli.core.types import F64
from prc_cli.streams.registered.fit import (
    LEAST_TRUSTED,
    PassPieces,
    Track,
    knot_times,
    whole_lines,
    window_spacing,
)
from prc_cli.streams.registered.path import Knots
from prc_cli.streams.registered.resection import Stations, masked_median
from prc_cli.streams.registered.rotation import (
    FASTEST_HZ,
    SLOWEST_HZ,
    Pieces,
    Turning,
    pieces_between,
)
from prc_cli.streams.registered.start import (
    WINDOW_POINTS,
    Windows,
    drift_hz,
    join_along,
    knots_between,
    lines_between,
    trusted_windows,
    turned_back,
)

Places: TypeAlias = Callable[[F64], F64]
"""Times (n,) [s] to the places of the scanner, (n, 3) [m]."""
PIECE_POINTS = 100
"""Consecutive points of a piece."""
MOST_PIECES = 400
MOST_STEP_RAD = 0.1
"""Neighbouring points farther apart in direction are not used for the rate [rad]."""


@dataclass(frozen=True, slots=True)
class Directions:
    """Directions of the points of pieces, in the plane of each."""

    frame: F64
    """(p, 3, 3) float64, columns: main direction, second direction, normal."""
    angle_rad: F64
    """(p, n) float64, angle of every point in the plane [rad]."""
    across_m: F64
    """(p, n) float64, distance of every point from the plane [m]."""


def directions_in_planes(offset_m: F64, weight: F64) -> Directions:
    """Fit a plane through the scanner to the points of every piece.

    Parameters
    ----------
    offset_m
        (p, n, 3) float64, points less the place of the scanner [m].
    weight
        (p, n) float64, 0 = no point.
    """
    length = np.maximum(np.linalg.norm(offset_m, axis=2), 1e-9)
    unit = offset_m / length[:, :, None]
    scatter = np.einsum("pn,pni,pnj->pij", weight, unit, unit)
    _, axes = np.linalg.eigh(scatter)
    frame = np.stack([axes[:, :, 2], axes[:, :, 1], np.cross(axes[:, :, 2], axes[:, :, 1])], axis=2)
    local = offset_m @ frame
    return Directions(frame, np.arctan2(local[:, :, 1], local[:, :, 0]), local[:, :, 2])


def rate_of_directions(time_s: F64, offset_m: F64) -> float | None:
    """Return the turns a second of the directions to points; None if they do not turn.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s].
    offset_m
        (n, 3) float64, points less the place of the scanner [m].
    """
    begin = np.linspace(0, max(len(time_s) - PIECE_POINTS, 0), MOST_PIECES).astype(np.int64)
    begin = np.unique(begin)
    end = np.minimum(begin + PIECE_POINTS, len(time_s))
    # without pieces that have a gap
    duration = time_s[end - 1] - time_s[begin]
    usable = duration < 4.0 * float(np.percentile(duration, 20))
    pieces = pieces_between(time_s, offset_m, begin[usable], end[usable], PIECE_POINTS)
    directions = directions_in_planes(_offsets(pieces), pieces.weight)
    step = np.diff(directions.angle_rad, axis=1)
    step = np.remainder(step + math.pi, 2.0 * math.pi) - math.pi
    since = np.diff(pieces.time_s, axis=1)
    both = (pieces.weight[:, 1:] > 0) & (since > 0) & (np.abs(step) < MOST_STEP_RAD)
    if np.count_nonzero(both) < PIECE_POINTS:
        return None
    # the normal of a plane points to either side
    way = np.sign(np.median(np.where(both, step, 0.0), axis=1))
    rates = (way[:, None] * step)[both] / since[both]
    return float(np.median(rates)) / (2.0 * math.pi)


def windows_along(
    time_s: F64,
    xyz_m: F64,
    station_m: F64,
    turning: Turning,
    spacing_s: float,
) -> Windows:
    """Return the frames of single lines with given stations, as :func:`.start.stations_of_lines`.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s].
    xyz_m
        (n, 3) float64 [m].
    station_m
        (n, 3) float64, place of the scanner at every point [m].
    turning
        The bearing of the beam over time.
    spacing_s
        Time from window to window [s].
    """
    begin, end = lines_between(time_s, turning, spacing_s)
    pieces = pieces_between(time_s, xyz_m - station_m, begin, end, WINDOW_POINTS)
    offset = _offsets(pieces)
    frame, residual = _with_bearings(
        directions_in_planes(offset, pieces.weight), pieces, turning, offset
    )
    n = len(begin)
    stations = Stations(
        position_m=station_m[(begin + end) // 2],
        frame=turned_back(frame, turning.bearing(pieces.middle_s)),
        residual_m=residual,
        in_front=np.ones(n),
        spread_m=np.full(n, np.inf),
    )
    # the path is given: there is no mirror image
    return Windows(pieces.middle_s, stations, stations, trusted_windows(pieces.middle_s, stations))


def _offsets(pieces: Pieces) -> F64:
    return pieces.xyz_m + pieces.first_m[:, None, :]


def _with_bearings(
    directions: Directions,
    pieces: Pieces,
    turning: Turning,
    offset_m: F64,
) -> tuple[F64, F64]:
    """Turn frames to fit bearings to angles, for the better sense of turning; return residuals."""
    bearing = 2.0 * math.pi * turning.hz * pieces.time_s
    length = np.linalg.norm(offset_m, axis=2)
    frames: list[F64] = []
    residuals: list[F64] = []
    for sense in (1.0, -1.0):
        away = sense * directions.angle_rad - bearing
        turn = np.angle((pieces.weight * np.exp(1j * away)).sum(axis=1))
        off = np.remainder(away - turn[:, None] + math.pi, 2.0 * math.pi) - math.pi
        residuals.append(masked_median(np.hypot(length * off, directions.across_m), pieces.weight))
        cosine = np.cos(turn)[:, None]
        sine = np.sin(turn)[:, None]
        main = directions.frame[:, :, 0]
        second = sense * directions.frame[:, :, 1]
        frames.append(
            np.stack(
                [
                    cosine * main + sine * second,
                    -sine * main + cosine * second,
                    sense * directions.frame[:, :, 2],
                ],
                axis=2,
            )
        )
    left = residuals[0] <= residuals[1]
    return np.where(left[:, None, None], frames[0], frames[1]), np.where(
        left, residuals[0], residuals[1]
    )


def turning_along(time_s: F64, xyz_m: F64, places: Places) -> Turning | None:
    """Find the rate of turns of a scanner with a given path; None if directions do not turn.

    Parameters
    ----------
    time_s
        (n,) float64, rising, of a contiguous part of the drive [s].
    xyz_m
        (n, 3) float64 [m].
    places
        The path.
    """
    station = places(time_s)
    hz = rate_of_directions(time_s, xyz_m - station)
    if hz is None or not SLOWEST_HZ < hz < FASTEST_HZ:
        return None
    turning = Turning(hz, hz, float(time_s[0]))
    spacing_s = window_spacing(float(time_s[-1] - time_s[0]))
    for _ in range(6):
        drift = drift_hz(windows_along(time_s, xyz_m, station, turning, spacing_s))
        turning = turning.faster(drift)
        if abs(drift) < 1e-7 * turning.hz:
            break
    return turning


def track_along(
    pieces: PassPieces,
    turning: Turning,
    duration_s: float,
    places: Places,
) -> Track | None:
    """Return the track of a pass with a given path; see :func:`.fit.fit_track`."""
    spacing_s = window_spacing(duration_s)
    parts: list[Windows] = []
    for time_s, xyz_m in whole_lines(pieces(), turning):
        part = windows_along(time_s, xyz_m, places(time_s), turning, spacing_s)
        if len(part.time_s):
            parts.append(part)
    if not parts:
        return None
    windows = join_along(parts)
    if np.count_nonzero(windows.trusted) < LEAST_TRUSTED:
        return None
    knots = knots_between(windows, knot_times(windows, turning))
    inside = np.clip(knots.time_s, windows.time_s[0], windows.time_s[-1])
    trusted = windows.trusted
    return Track(
        knots=Knots(knots.time_s, places(inside), knots.frame),
        sigma_m=np.zeros_like(knots.position_m),
        slope=0.0,
        residual_m=float(np.median(windows.stations.residual_m[trusted])),
        share_on_beam=1.0,
        share_in_front=1.0,
        share_trusted=float(trusted.mean()),
    )
