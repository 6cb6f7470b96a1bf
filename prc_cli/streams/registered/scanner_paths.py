"""The path of every scanner with its uncertainty, for users and to check a trajectory."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from prc_cli.core.types import F64
from prc_cli.streams.registered.drive import Drive
from prc_cli.streams.registered.path import SPEED_CHANGE_M_S2, ScannerPath, positions_at
from prc_cli.streams.registered.scan import Scan, down_bearings, slow_part
from prc_cli.streams.registered.spinning_drive import SpinningDrive


def scanner_paths(drive: Drive | SpinningDrive) -> tuple[ScannerPath, ...]:
    """Return the path of every scanner, from the first to the last point of each pass."""
    if isinstance(drive, SpinningDrive):
        passes = drive.paths
    else:
        passes = tuple(_path_of_pass(drive, number) for number in range(len(drive.figures)))
    by_scanner: dict[int, list[ScannerPath]] = {}
    for path in passes:
        by_scanner.setdefault(path.scanner, []).append(path)
    joined = []
    for paths in by_scanner.values():
        path = replace(
            paths[0],
            time_s=np.concatenate([path.time_s for path in paths]),
            xyz_m=np.concatenate([path.xyz_m for path in paths]),
            sigma_m=np.concatenate([path.sigma_m for path in paths]),
            frame=np.concatenate([path.frame for path in paths]),
            axis=np.concatenate([path.axis for path in paths]),
            number=np.concatenate([path.number for path in paths]),
        )
        joined.append(path)
    return tuple(joined)


def _path_of_pass(drive: Drive, number: int) -> ScannerPath:
    scan = drive.scans[number]
    figures = drive.figures[number]
    knots = scan.knots
    first_s, last_s = figures.points_s
    inside = (knots.time_s > first_s) & (knots.time_s < last_s)
    time_s = np.concatenate([[first_s], knots.time_s[inside], [last_s]])
    nearest = np.clip(np.searchsorted(knots.time_s, time_s), 0, len(knots.time_s) - 1)
    # beyond the last line the speed may change as usual
    before_s = knots.time_s[0] - time_s
    after_s = time_s - knots.time_s[-1]
    beyond_s = np.maximum(np.maximum(before_s, after_s), 0.0)[:, None]
    sigma = drive.tracks[number].sigma_m[nearest] + 0.5 * SPEED_CHANGE_M_S2 * beyond_s**2
    frame = _level_frames(scan)[nearest]
    return ScannerPath(
        scanner=figures.scanner,
        time_s=time_s,
        xyz_m=positions_at(knots.time_s, knots.position_m, time_s),
        sigma_m=sigma,
        frame=frame,
        axis=frame[:, :, 0],
        number=np.full(len(time_s), number),
    )


def _level_frames(scan: Scan) -> F64:
    """Return axes of the scanner, steady while its mirror wanders, (k, 3, 3)."""
    knots = scan.knots
    down, _ = down_bearings(knots)
    since = knots.time_s - knots.time_s[0]
    # the platform is level on average; only the rate of the mirror, known to a thousandth, drifts
    steady = np.polyval(np.polyfit(since, down, 1), since)
    up = steady + slow_part(knots.time_s, down - steady) + math.pi
    first_part = np.cos(up)[:, None] * knots.frame[:, :, 0]
    second_part = np.sin(up)[:, None] * knots.frame[:, :, 1]
    above = first_part + second_part
    axis = knots.frame[:, :, 2]
    steps = np.gradient(knots.position_m, axis=0)
    is_backward = float((axis * steps).sum()) < 0.0
    if is_backward:
        axis = -axis
    return np.stack([axis, np.cross(above, axis), above], axis=2)
