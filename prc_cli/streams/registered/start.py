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
        chosen = stations.where(keep | clear, mirrored)
        return cls(
            time_s, chosen, mirrored.where(keep | clear, stations), trusted_windows(time_s, chosen)
        )


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
    both = stations_both_ways(pieces, fit_planes(pieces.xyz_m, pieces.weight), turning.hz)
    back_rad = turning.bearing(pieces.middle_s)
    stations, mirrored = (
        replace(
            stations,
            position_m=stations.position_m + pieces.first_m,
            frame=turned_back(stations.frame, back_rad),
        )
        for stations in both
    )
    return Windows.settled(pieces.middle_s, stations, mirrored)


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
    if len(places) < 3:
        return fits
    frame = stations.frame[places]
    position = stations.position_m[places]
    when = time_s[places]
    n = len(places)
    near = np.clip(np.arange(n)[:, None] + np.arange(-NEIGHBOURS, NEIGHBOURS + 1), 0, n - 1)
    usual = _nearest_rotations(np.median(frame[near], axis=1))
    turn = np.linalg.norm(rotation_vectors(np.swapaxes(usual, 1, 2) @ frame), axis=1)
    # a straight, even path through the neighbours
    since = when[near] - when[:, None]
    velocity = np.median(
        np.diff(position[near], axis=1) / np.maximum(np.diff(since, axis=1), 1e-6)[:, :, None],
        axis=1,
    )
    expected = np.median(position[near] - since[:, :, None] * velocity[:, None, :], axis=1)
    move = np.linalg.norm(position - expected, axis=1)
    trusted = np.zeros_like(fits)
    trusted[places[(turn < MOST_TURN_OFF_RAD) & (move < MOST_MOVE_OFF_M)]] = True
    return trusted


def _nearest_rotations(matrices: F64) -> F64:
    left, _, right = np.linalg.svd(matrices)
    rotations = left @ right
    flip = np.linalg.det(rotations) < 0
    left[flip, :, 2] *= -1.0
    nearest: F64 = left @ right
    return nearest


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
    place = np.clip(np.searchsorted(when, knots_s) - 1, 0, len(when) - 2)
    share = (knots_s - when[place]) / (when[place + 1] - when[place])
    # beyond the first and last window the path continues, but not far
    share = np.clip(share, -2.0, 3.0)
    turn = rotation_vectors(np.swapaxes(frame[:-1], 1, 2) @ frame[1:])
    return Knots(
        knots_s,
        position[place] + share[:, None] * (position[place + 1] - position[place]),
        frame[place] @ rotation_matrices(share[:, None] * turn[place]),
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
    down = np.unwrap(np.arctan2(-frame[:, 2, 1], -frame[:, 2, 0]))
    half = len(when) // 2
    slope = (down[half : 2 * half] - down[:half]) / (when[half : 2 * half] - when[:half])
    return -float(np.median(slope)) / (2.0 * math.pi)
