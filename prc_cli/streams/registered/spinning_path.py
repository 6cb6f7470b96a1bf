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
        between_s = 0.5 * (self.time_s[1:] + self.time_s[:-1])
        border = [0, *np.searchsorted(time_s, between_s), len(time_s)]
        local = np.empty((len(time_s), 3))
        for i in range(len(self.time_s)):
            part = slice(border[i], border[i + 1])
            since = (time_s[part] - self.time_s[i])[:, None]
            station = self.poses.station_m[i] + since * self.poses.velocity_m_s[i]
            in_frame = (xyz_m[part] - station) @ self.poses.frame[i]
            local[part] = turn_by(in_frame, -since * self.poses.rate_rad_s[i])
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
    turn_s = 1.0 / rate.hz
    first = math.floor((time_s[0] - rate.origin_s) / turn_s)
    last = math.floor((time_s[-1] - rate.origin_s) / turn_s)
    middle_s = rate.origin_s + (np.arange(first, last + 1) + 0.5) * turn_s
    middle_s = _filled_middles(time_s, middle_s, turn_s)
    windows = full_windows(cut_windows(time_s, xyz_m, middle_s, turn_s, N_WINDOW))
    azimuth = windows.azimuth(rate.hz, rate.origin_s)
    fit = lock(windows, azimuth, rings.groups_rad())
    fit = replace(fit, poses=with_climb(fit.poses, rings.climb))
    poses = _predicted_heights(fit, windows, rings)
    path = _onto_rings(windows, azimuth, poses, rings)
    for _ in range(REPAIRS):
        # a window that fits worse than the others restarts from the nearest one that fits
        usual_share = 1.0
        if path.is_trusted.any():
            usual_share = float(np.median(path.on_rings[path.is_trusted]))
        is_good = path.on_rings >= max(MIN_ON_RINGS, 0.95 * usual_share)
        if is_good.all() or not is_good.any():
            break
        bad_windows = windows.where(~is_good)
        bad_azimuth = azimuth[~is_good]
        continued = _continued(replace(path, is_trusted=is_good), windows).where(~is_good)
        restarted = _restarted(bad_windows, bad_azimuth, continued, rings)
        repaired = _onto_rings(bad_windows, bad_azimuth, restarted, rings)
        is_better = repaired.on_rings > path.on_rings[~is_good] + 0.01
        if not is_better.any():
            break
        places = np.flatnonzero(~is_good)[is_better]
        path = _with_windows(path, places, repaired.where(is_better))
    path = replace(path, poses=_continued(path, windows))
    return replace(path, poses=in_cloud(path.poses, windows))


def _filled_middles(time_s: F64, middle_s: F64, length_s: float) -> F64:
    """Move windows that reach into gaps or beyond the ends to where they are full."""
    half_s = 0.5 * length_s
    begin = np.searchsorted(time_s, middle_s - half_s)
    end = np.searchsorted(time_s, middle_s + half_s)
    has_points = end > begin
    middle_s = middle_s[has_points]
    first_s = time_s[begin[has_points]]
    last_s = time_s[end[has_points] - 1]
    empty_before_s = first_s - (middle_s - half_s)
    empty_after_s = middle_s + half_s - last_s
    moved_s = np.where(empty_before_s > empty_after_s, first_s + half_s, last_s - half_s)
    is_full = np.maximum(empty_before_s, empty_after_s) <= FULL * length_s
    ordered_s = np.sort(np.where(is_full, middle_s, moved_s))
    is_apart = np.diff(ordered_s, prepend=-np.inf) > FULL * length_s
    return ordered_s[is_apart]


def _predicted_heights(fit: Locked, windows: Windows, rings: Rings) -> Poses:
    """Move stations along their axes onto the rings, near the predicted height."""
    poses = fit.poses
    local = poses.local(windows)
    level = np.hypot(local[:, :, 0], local[:, :, 1])
    station = poses.station_m.copy()
    before: int | None = None
    for i in np.flatnonzero(fit.is_locked).tolist():
        axis = poses.frame[i, :, 2]
        z = local[i, windows.use[i], 2]
        far = level[i, windows.use[i]]
        height: float | None = None
        if before is not None:
            since_s = windows.time_s[i] - windows.time_s[before]
            if since_s < LONGEST_STEP_S:
                place = station[before] + windows.centre_m[before]
                predicted = place + since_s * poses.velocity_m_s[before]
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
    heights_m = (guess_m + HEIGHT_GUESS_M)[:, None]
    elevation = np.arctan2(z_m - heights_m, level_m)
    off = np.abs(elevation - known[rings.nearest(elevation)])
    reach = min(0.25 * float(np.median(np.diff(known))), WIDEST_RAD)
    score = np.maximum(0.0, 1.0 - off / reach).mean(axis=1)
    best = int(np.argmax(score))
    is_inside = 0 < best < len(score) - 1
    if not is_inside or score[best] <= MIN_HEIGHT_SCORE:
        return None
    return guess_m + float(HEIGHT_GUESS_M[best])


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
    beams = azimuth + rings.ahead_rad[number]
    poses = refine(fitted, beams, poses, STEER_SCALES_M).poses
    local = poses.local(windows)
    level = np.hypot(local[:, :, 0], local[:, :, 1])
    station = poses.station_m.copy()
    for i in range(len(station)):
        z = local[i, windows.use[i], 2]
        far = level[i, windows.use[i]]
        height = _ring_height(z[:N_HEIGHT], far[:N_HEIGHT], 0.0, rings)
        station[i] += (height or 0.0) * poses.frame[i, :, 2]
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
        beams = azimuth + rings.ahead_rad[number]
        turn = np.zeros((len(azimuth), 3))
        if scales_m is RING_SCALES_M:
            # a window may have followed rings that look ahead of the others
            measured = np.arctan2(local[:, :, 1], local[:, :, 0])
            beside = wrapped(measured - azimuth - rings.ahead_rad[number])
            turn[:, 2] = np.where(known.any(axis=1), medians(beside, known), 0.0)
        poses = replace(poses, frame=poses.frame @ rotations(turn))
        slope = np.where(known, rings.tangent[number], np.nan)
        poses = refine(replace(windows, use=known), beams, poses, scales_m, slope).poses

    local = poses.local(windows)
    number = np.where(windows.use, ring_numbers(local, rings), -1)
    known = number >= 0
    level = np.hypot(local[:, :, 0], local[:, :, 1])
    beams = azimuth + rings.ahead_rad[number]
    beside = np.abs(np.cos(beams) * local[:, :, 1] - np.sin(beams) * local[:, :, 0])
    tangent = rings.tangent[number]
    cone = np.abs(local[:, :, 2] - tangent * level) / np.sqrt(1.0 + tangent**2)
    is_near = known & (beside < BEAM_M) & (cone < BEAM_M)
    on_rings = is_near.sum(axis=1) / windows.use.sum(axis=1)
    return HeadPath(
        time_s=windows.time_s,
        poses=poses,
        beside_m=medians(beside, known),
        cone_m=medians(cone, known),
        on_rings=on_rings,
        is_trusted=on_rings >= MIN_ON_RINGS,
    )


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
    time_s = path.time_s
    after = np.searchsorted(time_s[trusted], time_s)
    left = trusted[np.maximum(after - 1, 0)]
    right = trusted[np.minimum(after, len(trusted) - 1)]
    is_left = time_s - time_s[left] < time_s[right] - time_s
    nearest = np.where(is_left, left, right)
    source = np.where(path.is_trusted, np.arange(len(time_s)), nearest)
    since_s = (time_s - time_s[source])[:, None]
    velocity = path.poses.velocity_m_s[source]
    rate = path.poses.rate_rad_s[source]
    centre = windows.centre_m
    return Poses(
        station_m=path.poses.station_m[source] + centre[source] - centre + since_s * velocity,
        velocity_m_s=velocity,
        frame=path.poses.frame[source] @ rotations(since_s * rate),
        rate_rad_s=rate,
    )
