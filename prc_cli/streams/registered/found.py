"""The path of a scanner as it was found, with its uncertainty: for users, and to hold a trajectory against it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F64, I64
from prc_cli.streams.registered.drive import Drive
from prc_cli.streams.registered.path import SPEED_CHANGE_M_S2
from prc_cli.streams.registered.scan import Scan, down_bearings, slow_part

SPEED_S = 0.1
"""Beyond the first and last knot the speed of this time goes on [s]."""


@dataclass(frozen=True, slots=True)
class FoundPath:
    """Where one scanner was, and how it stood, at ``k`` times of all its passes; straight lines in between."""

    scanner: int
    time_s: F64
    """(k,) float64, rising [s]."""
    xyz_m: F64
    """(k, 3) float64 [m]."""
    sigma_m: F64
    """(k, 3) float64, standard deviations [m]."""
    frame: F64
    """(k, 3, 3) float64, columns: axis of the turn (on the side of the drive), left, up in the plane."""
    number: I64
    """(k,) int64, number of the pass."""
    points_s: tuple[float, float]
    """First and last time of the points of all its passes [s]."""


def found_paths(drive: Drive) -> tuple[FoundPath, ...]:
    """Return the path of every scanner of a drive.

    Every pass reaches from its first to its last point, so that a trajectory of it holds all points.
    """
    by_scanner: dict[int, list[FoundPath]] = {}
    for number, figures in enumerate(drive.figures):
        by_scanner.setdefault(figures.scanner, []).append(_path_of_pass(drive, number))
    return tuple(_joined(paths) for paths in by_scanner.values())


def _joined(paths: list[FoundPath]) -> FoundPath:
    first, last = paths[0], paths[-1]
    return FoundPath(
        first.scanner,
        np.concatenate([path.time_s for path in paths]),
        np.concatenate([path.xyz_m for path in paths]),
        np.concatenate([path.sigma_m for path in paths]),
        np.concatenate([path.frame for path in paths]),
        np.concatenate([path.number for path in paths]),
        (first.points_s[0], last.points_s[1]),
    )


def _path_of_pass(drive: Drive, number: int) -> FoundPath:
    scan, track, figures = drive.scans[number], drive.tracks[number], drive.figures[number]
    knots = scan.knots
    first_s, last_s = figures.points_s
    inside = (knots.time_s > first_s) & (knots.time_s < last_s)
    time_s = np.concatenate([[first_s], knots.time_s[inside], [last_s]])
    place = np.clip(np.searchsorted(knots.time_s, time_s), 0, len(knots.time_s) - 1)
    beyond = np.maximum(np.maximum(knots.time_s[0] - time_s, time_s - knots.time_s[-1]), 0.0)
    # where no line told the place, the speed may have changed as it usually does
    sigma = track.sigma_m[place] + 0.5 * SPEED_CHANGE_M_S2 * beyond[:, None] ** 2
    xyz = _positions(knots.time_s, knots.position_m, time_s)
    frame = _level_frames(scan)[place]
    return FoundPath(figures.scanner, time_s, xyz, sigma, frame, np.full(len(time_s), number), figures.points_s)


def _positions(knots_s: F64, position_m: F64, time_s: F64) -> F64:
    xyz = np.stack([np.interp(time_s, knots_s, position_m[:, axis]) for axis in range(3)], axis=1)
    n = len(knots_s)
    hop = min(max(round(SPEED_S / float(np.median(np.diff(knots_s)))), 1), n - 1)
    for end, inner in ((0, hop), (n - 1, n - 1 - hop)):
        speed = (position_m[end] - position_m[inner]) / (knots_s[end] - knots_s[inner])
        since = time_s - knots_s[end]
        beyond = since < 0 if end == 0 else since > 0
        xyz[beyond] = position_m[end] + since[beyond, None] * speed
    return xyz


def _level_frames(scan: Scan) -> F64:
    """Return the axes of the scanner at its knots, (k, 3, 3): they stay while its mirror wanders."""
    knots = scan.knots
    down, _ = down_bearings(knots)
    since = knots.time_s - knots.time_s[0]
    # the platform is level on average: what grows is the rate of the mirror, known to a thousandth
    steady = np.polyval(np.polyfit(since, down, 1), since)
    up = steady + slow_part(knots.time_s, down - steady) + math.pi
    above = np.cos(up)[:, None] * knots.frame[:, :, 0] + np.sin(up)[:, None] * knots.frame[:, :, 1]
    axis = knots.frame[:, :, 2]
    steps = np.gradient(knots.position_m, axis=0)
    if float((axis * steps).sum()) < 0.0:
        axis = -axis
    return np.stack([axis, np.cross(above, axis), above], axis=2)
