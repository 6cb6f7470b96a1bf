"""The path of a spinning head: station and frame of every window of a piece of a drive."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64, I64, Mask
from prc_cli.streams.registered.spinning_rate import Locked, TurnRate, full_windows, lock, wrapped
from prc_cli.streams.registered.spinning_rings import (
    RING_SCALES_M,
    WIDEST_RAD,
    Rings,
    ring_numbers,
    sharpest_height,
    with_climb,
)
from prc_cli.streams.registered.turning import (
    Poses,
    Windows,
    cut_windows,
    in_cloud,
    medians,
    refine,
    rotations,
    turn_by,
)

STEER_SCALES_M = np.geomspace(0.3, 0.01, 12)
"""Residuals at which the weight of a point halves, from a pose that is a little off [m]."""
N_WINDOW = 1500
"""Points of a window of the path."""
MIN_ON_RINGS = 0.7
"""Least share of points near their beams in a trusted window; streets have 0.95 and more."""
BEAM_M = 0.05
"""Points up to here are near their beams [m]."""
REACH_M = 0.3
HEIGHT_GUESS_M = np.arange(-REACH_M, REACH_M + 0.01, 0.02)
"""Heights around the one that the window before predicts [m]."""
LONGEST_STEP_S = 1.0
"""A window does not predict the place of one farther away [s]."""
FULL = 0.1
"""A window without points for more of its length is moved."""
REPAIRS = 12
"""Rounds in which windows that do not fit restart from their neighbours."""
N_HEIGHT = 500
"""Points of a window for its height."""
MIN_HEIGHT_SCORE = 0.6
"""Least mean nearness of points to rings, 1 = on them, 0 = a quarter of their spacing off."""


@dataclass(frozen=True, slots=True)
class HeadPath:
    """Station and frame of the head at ``w`` times."""

    time_s: F64
    """(w,) float64, rising [s]."""
    poses: Poses
    """Poses at these times, in the coordinates of the cloud."""
    beside_m: F64
    """(w,) float64, median distance of the points from the half planes of their shots [m]."""
    cone_m: F64
    """(w,) float64, median distance from the cones of their rings [m]."""
    on_rings: F64
    """(w,) float64, share of the points near the beam of a ring."""
    is_trusted: Mask
    """(w,) bool; the other poses continue the nearest trusted window."""

    def where(self, keep: Mask) -> HeadPath:
        """Return some of the windows."""
        return HeadPath(
            self.time_s[keep],
            self.poses.where(keep),
            self.beside_m[keep],
            self.cone_m[keep],
            self.on_rings[keep],
            self.is_trusted[keep],
        )

    def local(self, time_s: F64, xyz_m: F64) -> F64:
        """Return points in the frame of the head that does not spin, (n, 3) float64 [m]."""
        middle = 0.5 * (self.time_s[1:] + self.time_s[:-1])
        local = np.empty((len(time_s), 3))
        border = np.searchsorted(time_s, middle)
        for i, (begin, end) in enumerate(zip([0, *border], [*border, len(time_s)], strict=True)):
            since = (time_s[begin:end] - self.time_s[i])[:, None]
            moved = self.poses.station_m[i] + since * self.poses.velocity_m_s[i]
            still = (xyz_m[begin:end] - moved) @ self.poses.frame[i]
            local[begin:end] = turn_by(still, -since * self.poses.rate_rad_s[i])
        return local


def fit_windows(
    time_s: F64,
    xyz_m: F64,
    rate: TurnRate,
    rings: Rings,
) -> HeadPath:
    """Fit the poses of all windows of a piece of a drive.

    Windows lie a turn apart at multiples of the turn from the rate's origin, wherever pieces begin.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s].
    xyz_m
        (n, 3) float64, registered points [m].
    rate, rings
        As found in a sample of the drive.

    Returns
    -------
    HeadPath
        Poses of the windows with enough points; empty without any.
    """
    step = 1.0 / rate.hz
    first, last = (math.floor((edge - rate.origin_s) / step) for edge in (time_s[0], time_s[-1]))
    middle = rate.origin_s + (np.arange(first, last + 1) + 0.5) * step
    middle = _filled_middles(time_s, middle, step)
    windows = full_windows(cut_windows(time_s, xyz_m, middle, step, N_WINDOW))
    azimuth = windows.azimuth(rate.hz, rate.origin_s)
    fit = lock(windows, azimuth, rings.groups_rad())
    fit = replace(fit, poses=with_climb(fit.poses, rings.climb))
    poses = _predicted_heights(fit, windows, rings)
    path = _onto_rings(windows, azimuth, poses, rings)
    for _ in range(REPAIRS):
        # a window that fits worse than the others restarts from the nearest one that fits
        good = path.on_rings >= _good_share(path)
        if good.all() or not good.any():
            break
        moved = _continued(replace(path, is_trusted=good), windows).where(~good)
        moved = _restarted(windows.where(~good), azimuth[~good], moved, rings)
        again = _onto_rings(windows.where(~good), azimuth[~good], moved, rings)
        is_better = again.on_rings > path.on_rings[~good] + 0.01
        if not is_better.any():
            break
        path = _with_windows(path, np.flatnonzero(~good)[is_better], again.where(is_better))
    path = replace(path, poses=_continued(path, windows))
    return replace(path, poses=in_cloud(path.poses, windows))


def _filled_middles(time_s: F64, middle: F64, length_s: float) -> F64:
    """Move windows that reach into gaps or beyond the ends to where they are full."""
    begin = np.searchsorted(time_s, middle - 0.5 * length_s)
    end = np.searchsorted(time_s, middle + 0.5 * length_s)
    middle, begin, end = middle[end > begin], begin[end > begin], end[end > begin]
    first = time_s[begin]
    last = time_s[end - 1]
    early = first - (middle - 0.5 * length_s)
    late = middle + 0.5 * length_s - last
    moved = np.where(early > late, first + 0.5 * length_s, last - 0.5 * length_s)
    middle = np.where(np.maximum(early, late) > FULL * length_s, moved, middle)
    ordered = np.sort(middle)
    return ordered[np.diff(ordered, prepend=-np.inf) > FULL * length_s]


def _predicted_heights(fit: Locked, windows: Windows, rings: Rings) -> Poses:
    """Move stations along their axes onto the rings, near the predicted height."""
    poses = fit.poses
    local = poses.local(windows)
    level = np.hypot(local[:, :, 0], local[:, :, 1])
    station = poses.station_m.copy()
    before = -1
    for i in np.flatnonzero(fit.is_locked).tolist():
        axis = poses.frame[i, :, 2]
        z = local[i, windows.use[i], 2]
        far = level[i, windows.use[i]]
        height: float | None = None
        if before >= 0 and (since := windows.time_s[i] - windows.time_s[before]) < LONGEST_STEP_S:
            predicted = (
                station[before] + windows.centre_m[before] + since * poses.velocity_m_s[before]
            )
            guess = float(axis @ (predicted - windows.centre_m[i] - station[i]))
            height = _ring_height(z[:N_HEIGHT], far[:N_HEIGHT], guess, rings)
        if height is None:
            height, _ = sharpest_height(z, far)
        station[i] += height * axis
        before = i
    return replace(poses, station_m=station)


def _ring_height(
    z_m: F64,
    level_m: F64,
    guess_m: float,
    rings: Rings,
) -> float | None:
    """Return the height near a guess with most points on rings [m]; None if they are few."""
    known = rings.elevation_rad
    elevation = np.arctan2(z_m - (guess_m + HEIGHT_GUESS_M)[:, None], level_m)
    border = 0.5 * (known[1:] + known[:-1])
    distance = np.abs(elevation - known[np.searchsorted(border, elevation)])
    reach = min(0.25 * float(np.median(np.diff(known))), WIDEST_RAD)
    score = np.maximum(0.0, 1.0 - distance / reach).mean(axis=1)
    best = int(np.argmax(score))
    is_clear = score[best] > MIN_HEIGHT_SCORE and 0 < best < len(score) - 1
    return guess_m + float(HEIGHT_GUESS_M[best]) if is_clear else None


def _restarted(
    windows: Windows,
    azimuth: F64,
    poses: Poses,
    rings: Rings,
) -> Poses:
    """Refine poses that are a little off by half planes, then their heights by the rings.

    A tilt of half the step from ring to ring shifts points to the next ring, but not to another
    half plane.
    """
    number = np.where(windows.use, ring_numbers(poses.local(windows), rings), -1)
    fitted = replace(windows, use=number >= 0)
    poses = refine(fitted, azimuth + rings.ahead_rad[number], poses, STEER_SCALES_M).poses
    local = poses.local(windows)
    level = np.hypot(local[:, :, 0], local[:, :, 1])
    station = poses.station_m.copy()
    for i in range(len(station)):
        z = local[i, windows.use[i], 2]
        far = level[i, windows.use[i]]
        height = _ring_height(z[:N_HEIGHT], far[:N_HEIGHT], 0.0, rings)
        station[i] += (0.0 if height is None else height) * poses.frame[i, :, 2]
    return replace(poses, station_m=station)


def _onto_rings(
    windows: Windows,
    azimuth: F64,
    poses: Poses,
    rings: Rings,
) -> HeadPath:
    """Refine poses by the rings of their points, and mark the trusted ones."""
    for scales_m in (RING_SCALES_M, RING_SCALES_M[2:]):
        local = poses.local(windows)
        number = np.where(windows.use, ring_numbers(local, rings), -1)
        known = number >= 0
        ahead = rings.ahead_rad[number]
        beside = wrapped(np.arctan2(local[:, :, 1], local[:, :, 0]) - azimuth - ahead)
        about = np.zeros((len(azimuth), 3))
        if scales_m is RING_SCALES_M:
            # a window may have followed rings that look ahead of the others
            about[:, 2] = np.where(known.any(axis=1), medians(beside, known), 0.0)
        poses = replace(poses, frame=poses.frame @ rotations(about))
        slope = np.where(known, rings.tangent[number], np.nan)
        poses = refine(replace(windows, use=known), azimuth + ahead, poses, scales_m, slope).poses
    local = poses.local(windows)
    number = np.where(windows.use, ring_numbers(local, rings), -1)
    known = number >= 0
    level = np.hypot(local[:, :, 0], local[:, :, 1])
    beam = azimuth + rings.ahead_rad[number]
    beside = np.abs(np.cos(beam) * local[:, :, 1] - np.sin(beam) * local[:, :, 0])
    tangent = rings.tangent[number]
    cone = np.abs(local[:, :, 2] - tangent * level) / np.sqrt(1.0 + tangent**2)
    near = known & (beside < BEAM_M) & (cone < BEAM_M)
    share = near.sum(axis=1) / windows.use.sum(axis=1)
    is_trusted = share >= MIN_ON_RINGS
    return HeadPath(
        windows.time_s, poses, medians(beside, known), medians(cone, known), share, is_trusted
    )


def _good_share(path: HeadPath) -> float:
    usual = float(np.median(path.on_rings[path.is_trusted])) if path.is_trusted.any() else 1.0
    return max(MIN_ON_RINGS, 0.95 * usual)


def _with_windows(path: HeadPath, index: I64, part: HeadPath) -> HeadPath:
    """Return a path with other windows at some places."""

    def put(values: NDArray[Any], new: NDArray[Any]) -> NDArray[Any]:
        values = values.copy()
        values[index] = new
        return values

    old = path.poses
    new = part.poses
    poses = Poses(
        put(old.station_m, new.station_m),
        put(old.velocity_m_s, new.velocity_m_s),
        put(old.frame, new.frame),
        put(old.rate_rad_s, new.rate_rad_s),
    )
    return HeadPath(
        path.time_s,
        poses,
        put(path.beside_m, part.beside_m),
        put(path.cone_m, part.cone_m),
        put(path.on_rings, part.on_rings),
        put(path.is_trusted, part.is_trusted),
    )


def _continued(path: HeadPath, windows: Windows) -> Poses:
    """Return poses; windows that are not trusted continue the nearest trusted one."""
    trusted = np.flatnonzero(path.is_trusted)
    if not len(trusted):
        return path.poses
    behind = np.searchsorted(path.time_s[trusted], path.time_s)
    left = trusted[np.maximum(behind - 1, 0)]
    right = trusted[np.minimum(behind, len(trusted) - 1)]
    is_left = path.time_s - path.time_s[left] < path.time_s[right] - path.time_s
    source = np.where(path.is_trusted, np.arange(len(path.time_s)), np.where(is_left, left, right))
    since = (path.time_s - path.time_s[source])[:, None]
    poses = path.poses
    velocity = poses.velocity_m_s[source]
    turning = poses.rate_rad_s[source]
    centre = windows.centre_m
    station = poses.station_m[source] + centre[source] - centre + since * velocity
    return Poses(station, velocity, poses.frame[source] @ rotations(since * turning), turning)
