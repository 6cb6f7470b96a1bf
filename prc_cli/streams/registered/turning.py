"""Station, frame and speed of a spinning scanner for short windows of registered points.

A head that spins evenly looks at azimuth ``phi = 2 pi f t`` in its own frame ``F = [e1 e2 n]``,
``n`` the spin axis. So every point lies in a known half plane through the axis: ``m . (p - o - v t)
= 0`` with ``m = -sin(phi) e1 + cos(phi) e2``. That is linear in ten unknowns (:func:`fit_linear`).
The frame of a platform that turns by itself and the cones of the rings need a few steps of
Gauss-Newton (:func:`refine`). All functions work on many windows at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from prc_cli.core.types import F64, I64, Mask

LINEAR_ROUNDS = 8
LEAST_SCALE_M = 0.02
"""Smallest residual at which the weight of a point halves in the linear fit [m]."""
SPIN_RAD_S = 1.0
"""Usual rate at which a platform turns [rad/s]."""
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True, slots=True)
class Windows:
    """Points of ``w`` windows, ``n`` each."""

    time_s: F64
    """(w,) float64, middle of every window [s]."""
    centre_m: F64
    """(w, 3) float64, median of the points of every window [m]."""
    since_s: F64
    """(w, n) float64, time of every point after the middle [s]."""
    xyz_m: F64
    """(w, n, 3) float64, points relative to the centre [m]."""
    use: Mask
    """(w, n) bool, false = filler."""
    index: I64
    """(w, n) int64, number of every point in the cloud; 0 for filler."""

    def azimuth(self, hz: float, origin_s: float) -> F64:
        """Return the azimuth of the head at every point, (w, n) [rad]."""
        since_s = (self.time_s - origin_s)[:, None] + self.since_s
        return turned(hz, since_s)

    def where(self, keep: Mask) -> Windows:
        """Return some of the windows."""
        return Windows(
            self.time_s[keep],
            self.centre_m[keep],
            self.since_s[keep],
            self.xyz_m[keep],
            self.use[keep],
            self.index[keep],
        )


@dataclass(frozen=True, slots=True)
class Poses:
    """Station, frame and their rates at the middle of ``w`` windows, relative to the centres."""

    station_m: F64
    """(w, 3) float64 [m]."""
    velocity_m_s: F64
    """(w, 3) float64 [m/s]."""
    frame: F64
    """(w, 3, 3) float64, columns e1, e2, n: azimuth 0, azimuth 90 degrees, spin axis."""
    rate_rad_s: F64
    """(w, 3) float64, how fast the frame turns, along its own axes [rad/s]."""

    def where(self, keep: Mask) -> Poses:
        """Return the poses of some of the windows."""
        return Poses(
            self.station_m[keep], self.velocity_m_s[keep], self.frame[keep], self.rate_rad_s[keep]
        )

    def local(self, windows: Windows) -> F64:
        """Return points in the frame of the head that does not spin, (w, n, 3) [m]."""
        since_s = windows.since_s[:, :, None]
        station = self.station_m[:, None, :] + since_s * self.velocity_m_s[:, None, :]
        in_frame = (windows.xyz_m - station) @ self.frame
        turned_since = -since_s * self.rate_rad_s[:, None, :]
        return turn_by(in_frame, turned_since)

    def velocity_in_frame(self) -> F64:
        """Return the velocity along the axes of the frame, (w, 3) [m/s]."""
        velocity: F64 = (self.velocity_m_s[:, None, :] @ self.frame)[:, 0, :]
        return velocity


def turned(hz: float, since_s: F64) -> F64:
    """Return the azimuth after a time [rad], without whole turns: all digits are kept."""
    turns = hz * since_s
    azimuth: F64 = 2.0 * np.pi * (turns - np.floor(turns))
    return azimuth


def turn_by(vectors: F64, angles: F64) -> F64:
    """Turn vectors by small rotation vectors, to the second order."""
    half_turned = vectors + 0.5 * _cross(angles, vectors)
    turned_vectors: F64 = vectors + _cross(angles, half_turned)
    return turned_vectors


def rotations(vectors: F64) -> F64:
    """Return the matrices of rotation vectors (w, 3), (w, 3, 3)."""
    angle = np.linalg.norm(vectors, axis=1)
    axis = vectors / np.maximum(angle, 1e-15)[:, None]
    cross = np.zeros((len(vectors), 3, 3))
    cross[:, 0, 1] = -axis[:, 2]
    cross[:, 0, 2] = axis[:, 1]
    cross[:, 1, 2] = -axis[:, 0]
    cross -= np.swapaxes(cross, 1, 2)
    sine = np.sin(angle)[:, None, None]
    versine = (1.0 - np.cos(angle))[:, None, None]
    matrices: F64 = np.eye(3) + sine * cross + versine * (cross @ cross)
    return matrices


def _cross(first: F64, second: F64) -> F64:
    # np.cross takes several times as long
    x = first[..., 0]
    y = first[..., 1]
    z = first[..., 2]
    u = second[..., 0]
    v = second[..., 1]
    w = second[..., 2]
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def cut_windows(
    time_s: F64,
    xyz_m: F64,
    middle_s: F64,
    length_s: float,
    n_points: int,
) -> Windows:
    """Choose points of windows.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s].
    xyz_m
        (n, 3) float64 [m].
    middle_s
        (w,) float64, middle of every window [s].
    length_s
        Length of a window [s].
    n_points
        Points of a window at most. They are spread by the golden ratio: even steps would meet the
        same rings again.
    """
    begin = np.searchsorted(time_s, middle_s - 0.5 * length_s)
    end = np.searchsorted(time_s, middle_s + 0.5 * length_s)
    count = (end - begin)[:, None]
    place = np.arange(n_points)[None, :]
    spread_place = np.floor(np.modf(place * _GOLDEN)[0] * count).astype(np.int64)
    in_window = np.where(count > n_points, spread_place, place)
    use = place < count
    index = np.where(use, begin[:, None] + in_window, 0)
    points = xyz_m[index]
    centre = np.zeros((len(points), 3))
    for i, used in enumerate(use):
        if used.any():
            centre[i] = np.median(points[i][used], axis=0)
    return Windows(
        time_s=middle_s,
        centre_m=centre,
        since_s=np.where(use, time_s[index] - middle_s[:, None], 0.0),
        xyz_m=np.where(use[:, :, None], points - centre[:, None, :], 0.0),
        use=use,
        index=index,
    )


def medians(values: F64, use: Mask) -> F64:
    """Return the median of the used values of every window, (w,); inf = none."""
    ordered = np.sort(np.where(use, values, np.inf), axis=1)
    middle = np.maximum(use.sum(axis=1) - 1, 0) // 2
    median: F64 = ordered[np.arange(len(values)), middle]
    return median


@dataclass(frozen=True, slots=True)
class LinearFit:
    """Poses by the linear fit, and their quality."""

    poses: Poses
    residual_m: F64
    """(w,) float64, median distance of the points from their half planes [m]."""
    roundness: F64
    """(w,) float64, shorter over longer axis of the frame; 1 = a turn that fits."""
    in_front: F64
    """(w,) float64, share of the points in front of the head."""


def fit_linear(windows: Windows, azimuth: F64, n_rounds: int = LINEAR_ROUNDS) -> LinearFit:
    """Fit poses in closed form, with weights from the residuals of the round before.

    Half planes through the axis do not show station and velocity along it: these stay 0.
    """
    cosine = np.cos(azimuth)[:, :, None]
    sine = np.sin(azimuth)[:, :, None]
    since = windows.since_s[:, :, None]
    points = windows.xyz_m
    # the six unknowns of the axes e1 and e2, then the two of the station and of the velocity
    of_axes = [-sine * points, cosine * points]
    of_moves = [sine, -cosine, since * sine, -since * cosine]
    rows = np.concatenate(of_axes + of_moves, axis=2)
    weight = windows.use.astype(np.float64)
    for _ in range(n_rounds):
        normal = np.swapaxes(rows, 1, 2) @ (rows * weight[:, :, None])
        # station and velocity are eliminated: the axes are the smallest eigenvector of the rest
        corner = normal[:, 6:, 6:] + 1e-9 * np.eye(4)
        inner = np.linalg.solve(corner, normal[:, 6:, :6])
        _, vectors = np.linalg.eigh(normal[:, :6, :6] - normal[:, :6, 6:] @ inner)
        axes = vectors[:, :, 0] * np.sqrt(2.0)
        moves = -(inner @ axes[:, :, None])[:, :, 0]
        unknowns = np.concatenate([axes, moves], axis=1)
        residual = np.abs(rows @ unknowns[:, :, None])[:, :, 0]
        median = medians(residual, windows.use)
        scale = np.maximum(1.5 * median, LEAST_SCALE_M)[:, None]
        weight = windows.use / (1.0 + (residual / scale) ** 2)

    # the nearest frame of right angles, and station and velocity in the cloud
    axes = axes.reshape(-1, 2, 3)
    left, size, right = np.linalg.svd(axes, full_matrices=False)
    plane = left @ right
    first = plane[:, 0]
    second = plane[:, 1]
    frame = np.stack([first, second, _cross(first, second)], axis=2)
    inverse = np.linalg.pinv(axes)
    station = (inverse @ moves[:, :2, None])[:, :, 0]
    velocity = (inverse @ moves[:, 2:, None])[:, :, 0]
    poses = Poses(station, velocity, frame, rate_rad_s=np.zeros_like(station))

    local = poses.local(windows)
    ahead = np.cos(azimuth) * local[:, :, 0] + np.sin(azimuth) * local[:, :, 1]
    n_ahead = ((ahead > 0) & windows.use).sum(axis=1)
    share = n_ahead / np.maximum(windows.use.sum(axis=1), 1)
    # a frame whose points lie behind the head is turned to the opposite half planes
    frame[:, :, :2] *= np.where(share < 0.5, -1.0, 1.0)[:, None, None]
    return LinearFit(
        poses=poses,
        residual_m=median,
        roundness=size[:, 1] / np.maximum(size[:, 0], 1e-12),
        in_front=np.maximum(share, 1.0 - share),
    )


@dataclass(frozen=True, slots=True)
class Refined:
    """Poses after Gauss-Newton, with the residuals of the last step but one."""

    poses: Poses
    beside_m: F64
    """(w, n) float64, distance of every point from the half plane of its shot [m]."""
    cone_m: F64
    """(w, n) float64, distance from the cone of its ring; 0 for points of no ring [m]."""


def refine(
    windows: Windows,
    azimuth: F64,
    poses: Poses,
    scales_m: F64,
    slope: F64 | None = None,
) -> Refined:
    """Refine poses by Gauss-Newton with Cauchy weights.

    Parameters
    ----------
    windows, azimuth, poses
        Points, azimuth of their shots (w, n) [rad], first guess.
    scales_m
        (rounds,) float64, residual at which the weight of a point halves, round by round [m].
        Scales that fall let the fit choose among rings that look ahead by different angles: it
        follows those of one angle.
    slope
        (w, n) float64, tangent of the elevation of every point's ring; NaN = none. Without it,
        the height along the axis is unknown and stays.
    """
    cosine = np.cos(azimuth)
    sine = np.sin(azimuth)
    zero = np.zeros_like(cosine)
    since = windows.since_s[:, :, None]
    out_of_plane = np.stack([-sine, cosine, zero], axis=2)
    cone = zero
    # unknowns: turn, move, change of the rate, change of the velocity, three each
    prior = np.zeros(12)
    prior[6:9] = 1.0 / SPIN_RAD_S**2
    if slope is None:
        prior[5] = 1e4
        prior[11] = 1e2
    for scale in scales_m:
        frame = poses.frame
        station = poses.station_m[:, None, :] + since * poses.velocity_m_s[:, None, :]
        in_frame = (windows.xyz_m - station) @ frame
        angle = since * poses.rate_rad_s[:, None, :]
        local = turn_by(in_frame, -angle)
        x = local[:, :, 0]
        y = local[:, :, 1]
        z = local[:, :, 2]

        # every point lies in the half plane of its shot
        beside = cosine * y - sine * x
        weight = windows.use / (scale**2 + beside**2)
        direction = turn_by(out_of_plane, angle)
        equations = _equations(in_frame, direction, since, beside, weight)
        normal = equations.normal
        gradient = equations.gradient
        if slope is not None:
            # and on the cone of its ring
            known = windows.use & np.isfinite(slope)
            rise = np.where(known, slope, 0.0)
            level = np.maximum(np.hypot(x, y), 1e-9)
            upright = np.where(known, 1.0 / np.sqrt(1.0 + rise**2), 0.0)
            cone = upright * (z - rise * level)
            outward = -rise * upright / level
            off_cone = np.stack([outward * x, outward * y, upright], axis=2)
            weight = known / (scale**2 + cone**2)
            equations = _equations(in_frame, turn_by(off_cone, angle), since, cone, weight)
            normal = normal + equations.normal
            gradient = gradient + equations.gradient

        no_prior = np.zeros((len(frame), 6))
        velocity = poses.velocity_in_frame()
        unknowns = np.concatenate([no_prior, poses.rate_rad_s, velocity], axis=1)
        gradient = gradient + prior * unknowns
        damped = normal + np.diag(prior + 1e-9)
        step = -np.linalg.solve(damped, gradient[:, :, None])[:, :, 0]
        poses = Poses(
            station_m=poses.station_m + (frame @ step[:, 3:6, None])[:, :, 0],
            velocity_m_s=poses.velocity_m_s + (frame @ step[:, 9:12, None])[:, :, 0],
            frame=frame @ rotations(step[:, :3]),
            rate_rad_s=poses.rate_rad_s + step[:, 6:9],
        )
    return Refined(poses, beside, cone)


class _Equations(NamedTuple):
    """Normal equations of turn, move, rate and velocity."""

    normal: F64
    """(w, 12, 12) float64."""
    gradient: F64
    """(w, 12) float64."""


def _equations(
    in_frame: F64,
    direction: F64,
    since: F64,
    residual: F64,
    weight: F64,
) -> _Equations:
    """Return the equations of residuals (w, n) along directions (w, n, 3) at points in frames."""
    of_pose = np.concatenate([-_cross(in_frame, direction), -direction], axis=2)
    rows = np.concatenate([of_pose, since * of_pose], axis=2)
    weighted = np.swapaxes(rows * weight[:, :, None], 1, 2)
    gradient = (weighted @ residual[:, :, None])[:, :, 0]
    return _Equations(weighted @ rows, gradient)


def in_cloud(poses: Poses, windows: Windows) -> Poses:
    """Return poses in the coordinates of the cloud."""
    return replace(poses, station_m=poses.station_m + windows.centre_m)
