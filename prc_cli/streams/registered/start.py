"""A first guess of the path: stations of single turns that agree with their neighbours."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import numpy as np

from prc_cli.core.types import F64, I64, Mask
from prc_cli.streams.registered.path import Knots, rotation_matrices, rotation_vectors
from prc_cli.streams.registered.resection import Stations, fit_planes
from prc_cli.streams.registered.rotation import Turning, pieces_between, stations_both_ways

WINDOW_POINTS = 200
"""Points of a turn that are used."""
LEAST_WINDOW_POINTS = 40
NEIGHBOURS = 10
"""Windows on either side for the comparison."""
MOST_RESIDUAL_M = 0.25
LEAST_IN_FRONT = 0.9
LEAST_SPREAD_M = 0.3
CLEAR_MISFIT = 0.2
"""A sense of turning is clear if its misfit is below this share of the other."""
MOST_TURN_OFF_RAD = 0.2
"""A window with a frame turned farther from its neighbours is left out [rad]."""
MOST_MOVE_OFF_M = 1.5
"""A window with a station farther from its neighbours' line is left out [m]."""


@dataclass(frozen=True, slots=True)
class Windows:
    """Stations of single turns, in frames of one bearing: 2 pi hz (time - origin)."""

    time_s: F64
    """(w,) float64, middle of every window [s]."""
    stations: Stations
    mirrored: Stations
    """The same for a beam that turns the other way."""
    trusted: Mask
    """(w,) bool, window fits and agrees with its neighbours."""

    @classmethod
    def settled(cls, time_s: F64, stations: Stations, mirrored: Stations) -> Windows:
        """Choose between mirror images, and mark trusted windows.

        A line of open ground fits as well from its mirror image below the ground, by a beam that
        turns the other way. Lines beside it that see more decide; else the upper one is chosen.
        """
        clear = stations.misfit_m < CLEAR_MISFIT * mirrored.misfit_m
        keep = stations.position_m[:, 2] >= mirrored.position_m[:, 2]
        if clear.any():
            nearest = nearest_of(np.flatnonzero(clear), len(time_s))
            axis = stations.frame[:, :, 2]
            keep = np.einsum("wi,wi->w", axis, axis[nearest]) >= 0.0
        is_right = keep | clear
        chosen = stations.where(is_right, mirrored)
        rejected = mirrored.where(is_right, stations)
        return cls(time_s, chosen, rejected, trusted_windows(time_s, chosen))


def nearest_of(places: I64, n: int) -> I64:
    """Return the nearest of the places, rising and at least one, for 0 to n - 1.

    >>> nearest_of(np.array([1, 5]), 7).tolist()
    [1, 1, 1, 1, 5, 5, 5]
    """
    index = np.arange(n)
    after = np.minimum(np.searchsorted(places, index), len(places) - 1)
    before = np.maximum(after - 1, 0)
    is_before = index - places[before] <= np.abs(places[after] - index)
    nearest: I64 = np.where(is_before, places[before], places[after])
    return nearest


def stations_of_lines(
    time_s: F64,
    xyz_m: F64,
    turning: Turning,
    spacing_s: float,
) -> Windows:
    """Find the station of one scan line in every ``spacing_s``.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s].
    xyz_m
        (n, 3) float64 [m].
    turning
        The bearing of the beam over time.
    spacing_s
        Time from window to window, at least a line [s].
    """
    begin, end = lines_between(time_s, turning, spacing_s)
    pieces = pieces_between(time_s, xyz_m, begin, end, WINDOW_POINTS)
    planes = fit_planes(pieces.xyz_m, pieces.weight)
    back_rad = turning.bearing(pieces.middle_s)
    in_cloud: list[Stations] = []
    for stations in stations_both_ways(pieces, planes, turning.hz):
        position = stations.position_m + pieces.first_m
        frame = turned_back(stations.frame, back_rad)
        in_cloud.append(replace(stations, position_m=position, frame=frame))
    return Windows.settled(pieces.middle_s, *in_cloud)


def lines_between(time_s: F64, turning: Turning, spacing_s: float) -> tuple[I64, I64]:
    """Return first and last point (exclusive) of one scan line with enough points per spacing."""
    line_s = 1.0 / turning.line_hz
    every = max(round(spacing_s / line_s), 1)
    first_line = math.floor((time_s[0] - turning.origin_s) / line_s)
    n_lines = math.ceil((time_s[-1] - turning.origin_s) / line_s) - first_line
    starts = turning.origin_s + (first_line + np.arange(0, n_lines, every)) * line_s
    begin = np.searchsorted(time_s, starts)
    end = np.searchsorted(time_s, starts + line_s)
    enough = end - begin >= LEAST_WINDOW_POINTS
    return begin[enough], end[enough]


def join_windows(parts: list[Windows]) -> Windows:
    """Return the windows of consecutive parts of a pass as one."""
    time_s = np.concatenate([part.time_s for part in parts])
    return Windows.settled(
        time_s,
        _joined([part.stations for part in parts]),
        _joined([part.mirrored for part in parts]),
    )


def join_along(parts: list[Windows]) -> Windows:
    """Return the windows of consecutive parts of a pass with a given path as one."""
    time_s = np.concatenate([part.time_s for part in parts])
    stations = _joined([part.stations for part in parts])
    return Windows(time_s, stations, stations, trusted_windows(time_s, stations))


def _joined(parts: list[Stations]) -> Stations:
    columns = ([getattr(part, field.name) for part in parts] for field in fields(Stations))
    return Stations(*map(np.concatenate, columns))


def turned_back(frame: F64, back_rad: F64) -> F64:
    """Return frames (w, 3, 3) with bearings larger by angles (w,) [rad]."""
    cosine = np.cos(back_rad)[:, None]
    sine = np.sin(back_rad)[:, None]
    first = cosine * frame[:, :, 0] - sine * frame[:, :, 1]
    second = sine * frame[:, :, 0] + cosine * frame[:, :, 1]
    return np.stack([first, second, frame[:, :, 2]], axis=2)


def trusted_windows(time_s: F64, stations: Stations) -> Mask:
    """Return the windows that fit well and agree with most of their neighbours, (w,) bool."""
    fits = (stations.residual_m < MOST_RESIDUAL_M) & (stations.in_front >= LEAST_IN_FRONT)
    fits &= stations.spread_m >= LEAST_SPREAD_M
    places = np.flatnonzero(fits)
    n = len(places)
    if n < 3:
        return fits
    steps = np.arange(-NEIGHBOURS, NEIGHBOURS + 1)
    near = np.clip(np.arange(n)[:, None] + steps, 0, n - 1)

    # the turn from the usual frame: the rotation nearest to the median matrix
    frame = stations.frame[places]
    left, _, right = np.linalg.svd(np.median(frame[near], axis=1))
    is_mirrored = np.linalg.det(left @ right) < 0
    left[is_mirrored, :, 2] *= -1.0
    usual_frame = left @ right
    turn = rotation_vectors(np.swapaxes(usual_frame, 1, 2) @ frame)

    # the move from a straight, even path through the neighbours
    position = stations.position_m[places]
    when = time_s[places]
    since = when[near] - when[:, None]
    step_m = np.diff(position[near], axis=1)
    step_s = np.maximum(np.diff(since, axis=1), 1e-6)[:, :, None]
    velocity = np.median(step_m / step_s, axis=1)
    moved_back = position[near] - since[:, :, None] * velocity[:, None, :]
    move = position - np.median(moved_back, axis=1)

    agrees = np.linalg.norm(turn, axis=1) < MOST_TURN_OFF_RAD
    agrees &= np.linalg.norm(move, axis=1) < MOST_MOVE_OFF_M
    trusted = np.zeros_like(fits)
    trusted[places[agrees]] = True
    return trusted


def knots_between(windows: Windows, knots_s: F64) -> Knots:
    """Return knots on straight lines and even turns between trusted windows.

    Parameters
    ----------
    windows
        At least two of them are trusted.
    knots_s
        (k,) float64, times of the knots [s].
    """
    when = windows.time_s[windows.trusted]
    position = windows.stations.position_m[windows.trusted]
    frame = windows.stations.frame[windows.trusted]
    before = np.clip(np.searchsorted(when, knots_s) - 1, 0, len(when) - 2)
    after = before + 1
    share = (knots_s - when[before]) / (when[after] - when[before])
    # beyond the first and last window the path continues, but not far
    share = np.clip(share, -2.0, 3.0)[:, None]
    turn = rotation_vectors(np.swapaxes(frame[:-1], 1, 2) @ frame[1:])
    return Knots(
        time_s=knots_s,
        position_m=position[before] + share * (position[after] - position[before]),
        frame=frame[before] @ rotation_matrices(share * turn[before]),
    )


def drift_hz(windows: Windows) -> float:
    """Return how much the rate is too low [turns a second].

    A platform is level on average, so straight down rests in the frame of the beam at the right
    rate.
    """
    frame = windows.stations.frame[windows.trusted]
    when = windows.time_s[windows.trusted]
    if len(when) < 4:
        return 0.0
    down_rad = np.unwrap(np.arctan2(-frame[:, 2, 1], -frame[:, 2, 0]))
    n = len(when) // 2
    step_rad = down_rad[n : 2 * n] - down_rad[:n]
    step_s = when[n : 2 * n] - when[:n]
    return -float(np.median(step_rad / step_s)) / (2.0 * math.pi)
