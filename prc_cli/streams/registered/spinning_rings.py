"""The rings of a spinning head: their elevations and how far they look ahead."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64, I64, Mask
from prc_cli.streams.registered.spinning_rate import (
    MIN_SPEED_M_S,
    N_FITTED,
    NoScan,
    TurnRate,
    drift_hz,
    full_windows,
    lock,
    sample_middles,
    wrapped,
)
from prc_cli.streams.registered.turning import (
    Poses,
    Windows,
    cut_windows,
    medians,
    refine,
    rotations,
)

N_RING_WINDOWS = 24
RING_SCALES_M = np.array([0.05, 0.03, 0.02, 0.02, 0.01, 0.01])
"""Residuals at which the weight of a point halves once rings are known [m]."""
MIN_UPRIGHT = 0.2
"""The speed along an axis nearer to level does not follow from a level platform."""
SLOW_M_S = 0.3
"""Lower speeds along the axis do not matter within a turn [m/s]."""
HEIGHT_STEP_M = 0.02
N_HEIGHTS = 24
"""Best heights of the grid, around which a finer one is tried."""
HEIGHT_BIN_RAD = math.radians(0.1)
BLOCK_RAD = math.radians(2.0)
RING_BIN_RAD = math.radians(0.01)
RING_ROUNDS = 4
MIN_APART_RAD = math.radians(0.3)
"""Rings that look ahead by angles nearer than this count as one group."""
NEAR_HEAD_M = 2.0
"""Nearer points are not used for the angles of a ring, unless most are as near [m]."""
MIN_RING_POINTS = 8
MAX_VALLEY = 0.6
"""Largest density between two rings, as a share of the lower one's."""
VALLEY_SIGMA = 2.5
"""Least depth of the valley between two rings [standard deviations of the count]."""
MAX_RING_SHARE = 0.45
"""Points belong to a ring up to this share of the way to the next one."""
WIDEST_RAD = math.radians(0.3)
"""Points farther from every ring than this belong to none [rad]."""


@dataclass(frozen=True, slots=True)
class Rings:
    """The rings of a spinning head, from low to high along its axis."""

    tangent: F64
    """(k,) float64, rising, tangent of the elevation above the plane of the turn."""
    ahead_rad: F64
    """(k,) float64, how far every ring looks ahead of the head, in the sense of the turn [rad]."""
    spread_rad: F64
    """(k,) float64, median distance of a ring's points from its elevation [rad]."""
    n_points: I64
    """(k,) int64, number of points of every ring."""
    climb: float
    """Usual speed of the head along its axis over the speed across it; 0 = axis square to the
    road."""
    is_up: bool
    """Whether the axis points up; it points down if the head turns to the right from above."""

    @property
    def n_rings(self) -> int:
        """Number of rings."""
        return len(self.tangent)

    @property
    def elevation_rad(self) -> F64:
        """Elevation of every ring [rad]."""
        elevation: F64 = np.arctan(self.tangent)
        return elevation

    def groups_rad(self) -> F64:
        """Return the distinct angles by which rings look ahead, rising, about their mean [rad]."""
        order = np.argsort(self.ahead_rad)
        ahead = self.ahead_rad[order]
        weight = np.maximum(self.n_points[order], 1)
        is_new = np.diff(ahead, prepend=ahead[0]) > MIN_APART_RAD
        group = np.cumsum(is_new)
        total = np.bincount(group, weight)
        groups: F64 = np.bincount(group, weight * ahead) / total
        mean = float((total * groups).sum() / total.sum())
        return groups - mean

    def spacing_rad(self) -> F64:
        """Return the distance of every ring from the nearer of its neighbours, (k,) [rad]."""
        gap = np.diff(self.elevation_rad, prepend=-np.inf, append=np.inf)
        spacing: F64 = np.minimum(gap[:-1], gap[1:])
        return spacing

    def nearest(self, elevation_rad: F64) -> I64:
        """Return the ring with the nearest elevation, int64 of the shape of the elevations."""
        known = self.elevation_rad
        border = 0.5 * (known[1:] + known[:-1])
        ring: I64 = np.searchsorted(border, elevation_rad)
        return ring


def elevations(local_m: F64) -> F64:
    """Return the elevations of points (..., 3) above the plane of the turn, (...) [rad]."""
    level = np.hypot(local_m[..., 0], local_m[..., 1])
    elevation: F64 = np.arctan2(local_m[..., 2], level)
    return elevation


def ring_numbers(local_m: F64, rings: Rings) -> I64:
    """Return the ring of every point.

    Parameters
    ----------
    local_m
        (n, 3) float64, points in the frame of the head that does not spin [m].
    rings
        The rings.

    Returns
    -------
    (n,) int64
        Rank of the ring along the axis; -1 for points off every ring.
    """
    elevation = elevations(local_m)
    ring = rings.nearest(elevation)
    reach = np.minimum(MAX_RING_SHARE * rings.spacing_rad(), WIDEST_RAD)
    is_near = np.abs(elevation - rings.elevation_rad[ring]) <= reach[ring]
    numbers: I64 = np.where(is_near, ring, -1)
    return numbers


def are_clear(local_m: F64, ring: I64, rings: Rings) -> Mask:
    """Mark points nearer to their ring than a quarter of the way to the next one, (n,) bool."""
    quarter = 0.25 * rings.spacing_rad()
    off = np.abs(elevations(local_m) - rings.elevation_rad[ring])
    clear: Mask = (ring >= 0) & (off <= quarter[ring])
    return clear


def find_rings(time_s: F64, xyz_m: F64, rate: TurnRate) -> tuple[Rings, TurnRate] | NoScan:
    """Find the rings of a head, and its rate more closely.

    Parameters
    ----------
    time_s, xyz_m
        As in :func:`find_turn_hz`.
    rate
        Rate of the head.

    Returns
    -------
    (Rings, TurnRate) or NoScan
        The rings and the rate, or why there are none.
    """
    middle = sample_middles(time_s, N_RING_WINDOWS)
    windows = full_windows(cut_windows(time_s, xyz_m, middle, 1.0 / rate.hz, N_FITTED))
    azimuth = windows.azimuth(rate.hz, rate.origin_s)
    fit = lock(windows, azimuth)
    windows = windows.where(fit.is_locked)
    azimuth = azimuth[fit.is_locked]
    if len(azimuth) < 2:
        return NoScan("no windows fit")
    poses = _with_heights(fit.poses.where(fit.is_locked), windows)
    is_up = float(np.median(poses.frame[:, 2, 2])) > 0.0
    for round_ in range(RING_ROUNDS):
        local = poses.local(windows)
        elevation = elevations(local)
        width_rad = math.radians(0.04 if round_ == 0 else 0.02)
        distance = np.linalg.norm(local, axis=2)
        least_m = min(NEAR_HEAD_M, 0.5 * float(np.median(distance[windows.use])))
        use = windows.use & (distance > least_m)
        if round_ == 0:
            agree = _agreeing(elevation, use, width_rad)
            windows = windows.where(agree)
            poses = poses.where(agree)
            azimuth = azimuth[agree]
            local = local[agree]
            elevation = elevation[agree]
            use = use[agree]

        # rings where the points crowd
        peaks = _ring_elevations(elevation[use], width_rad)
        if len(peaks) < 2:
            return NoScan(f"{len(peaks)} rings, expected 2 or more: points of one plane")
        rings = _rings_at(peaks, is_up=is_up)
        number = np.where(use, ring_numbers(local, rings), -1)

        # how far they look ahead, and the poses by the rings
        azimuths = _ring_azimuths(local, azimuth, number, len(peaks))
        turn = np.zeros((len(azimuths.turn_rad), 3))
        turn[:, 2] = azimuths.turn_rad
        poses = replace(poses, frame=poses.frame @ rotations(turn))
        rings = replace(rings, ahead_rad=azimuths.ahead_rad)
        rings = measure_rings(poses.local(windows)[use], number[use], rings)
        slope = np.where(number >= 0, rings.tangent[number], np.nan)
        beams = azimuth + rings.ahead_rad[number]
        fitted = replace(windows, use=windows.use & (number >= 0))
        poses = refine(fitted, beams, poses, RING_SCALES_M, slope).poses
    hz = rate.hz + drift_hz(windows, poses, rate.hz)
    return replace(rings, climb=_climb(poses)), replace(rate, hz=hz)


def _rings_at(elevation_rad: F64, *, is_up: bool) -> Rings:
    """Return rings that look straight ahead, not measured yet."""
    zeros = np.zeros(len(elevation_rad))
    return Rings(
        tangent=np.tan(elevation_rad),
        ahead_rad=zeros,
        spread_rad=zeros,
        n_points=zeros.astype(np.int64),
        climb=0.0,
        is_up=is_up,
    )


def measure_rings(local_m: F64, number: I64, rings: Rings) -> Rings:
    """Measure the elevation of every ring from points with known rings."""
    order = np.argsort(number, kind="stable")
    elevation = elevations(local_m)[order]
    border = np.searchsorted(number[order], np.arange(rings.n_rings + 1))
    tangent = rings.tangent.copy()
    spread = rings.spread_rad.copy()
    for ring in range(rings.n_rings):
        of_ring = elevation[border[ring] : border[ring + 1]]
        if len(of_ring) >= MIN_RING_POINTS:
            middle = float(np.median(of_ring))
            tangent[ring] = math.tan(middle)
            spread[ring] = float(np.median(np.abs(of_ring - middle)))
    return replace(rings, tangent=tangent, spread_rad=spread, n_points=np.diff(border))


class _RingAzimuths(NamedTuple):
    ahead_rad: F64
    """(k,) float64, how far every ring looks ahead [rad]."""
    turn_rad: F64
    """(w,) float64, turn of every window by the rings it followed [rad]."""


def _ring_azimuths(
    local: F64,
    azimuth: F64,
    number: I64,
    n_rings: int,
) -> _RingAzimuths:
    # the median azimuth of every ring in every window, beside that of the shots
    beside = wrapped(np.arctan2(local[:, :, 1], local[:, :, 0]) - azimuth)
    n_windows = len(local)
    window = np.arange(n_windows)[:, None]
    cell = np.where(number >= 0, window * n_rings + number, -1).ravel()
    order = np.argsort(cell, kind="stable")
    border = np.searchsorted(cell[order], np.arange(n_windows * n_rings + 1))
    sorted_beside = beside.ravel()[order]
    table = np.full((n_windows, n_rings), np.nan)
    for place in np.flatnonzero(np.diff(border) >= 3):
        table.ravel()[place] = np.median(sorted_beside[border[place] : border[place + 1]])

    # windows are aligned one by one, by the median difference of common rings
    turn = np.zeros(n_windows)
    fullest = np.argmax(np.isfinite(table).sum(axis=1))
    ahead = table[fullest]
    for _ in range(3):
        for i in range(n_windows):
            apart = table[i] - ahead
            turn[i] = np.nanmedian(apart) if np.isfinite(apart).any() else 0.0
        with np.errstate(all="ignore"):
            by_ring = (table - turn[:, None]).T
        known = np.isfinite(by_ring)
        middle = medians(np.where(known, by_ring, 0.0), known)
        ahead = np.where(known.any(axis=1), middle, np.nan)
    ahead = np.where(np.isfinite(ahead), ahead, 0.0)
    mean_ahead = float(np.median(ahead))
    return _RingAzimuths(ahead - mean_ahead, turn + mean_ahead)


def _with_heights(poses: Poses, windows: Windows) -> Poses:
    """Move stations along their axes to the sharpest elevations.

    Half planes do not show the speed along the axis either. It is 0 for an axis square to the road,
    else the speed of a platform that moves level.
    """
    axis = poses.frame[:, :, 2]
    upright = np.where(np.abs(axis[:, 2]) > MIN_UPRIGHT, axis[:, 2], np.inf)
    level_m_s = -poses.velocity_m_s[:, 2] / upright
    best_sharpness = -math.inf
    best_poses = poses
    for speed in (np.zeros(len(axis)), level_m_s):
        moving = replace(poses, velocity_m_s=poses.velocity_m_s + speed[:, None] * axis)
        local = moving.local(windows)
        level = np.hypot(local[:, :, 0], local[:, :, 1])
        heights = []
        sharpness = []
        for z, far, use in zip(local[:, :, 2], level, windows.use, strict=True):
            height, sharp = sharpest_height(z[use], far[use])
            heights.append(height)
            sharpness.append(sharp)
        median_sharpness = float(np.median(sharpness))
        if median_sharpness > best_sharpness:
            best_sharpness = median_sharpness
            station = moving.station_m + np.array(heights)[:, None] * axis
            best_poses = replace(moving, station_m=station)
        if np.median(np.abs(level_m_s)) < SLOW_M_S:
            break
    return best_poses


def _climb(poses: Poses) -> float:
    """Return the speed along the axis over the speed across it, a constant of the mount."""
    velocity = poses.velocity_in_frame()
    across = np.hypot(velocity[:, 0], velocity[:, 1])
    is_moving = across > MIN_SPEED_M_S
    if not is_moving.any():
        return 0.0
    return float(np.median(velocity[is_moving, 2] / across[is_moving]))


def with_climb(poses: Poses, climb: float) -> Poses:
    """Return poses with the usual speed along the axis."""
    axis = poses.frame[:, :, 2]
    along = (poses.velocity_m_s * axis).sum(axis=1, keepdims=True)
    across = poses.velocity_m_s - along * axis
    speed = climb * np.linalg.norm(across, axis=1, keepdims=True)
    return replace(poses, velocity_m_s=across + speed * axis)


def sharpest_height(z_m: F64, level_m: F64) -> tuple[float, float]:
    """Return the height with the sharpest elevations of points [m], and the sharpness."""
    lowest, highest = np.percentile(z_m, [1.0, 99.0]).tolist()
    n_heights = math.ceil((highest - lowest + 2.0) / HEIGHT_STEP_M)
    coarse = lowest - 1.0 + HEIGHT_STEP_M * np.arange(n_heights)
    sharpness = _sharpness(z_m, level_m, coarse, HEIGHT_BIN_RAD)
    # the right height may lie between two of the grid, where near points are not sharp yet
    best = coarse[np.argsort(sharpness)[-N_HEIGHTS:]]
    fine = (best[:, None] + 0.2 * HEIGHT_STEP_M * np.arange(-4, 5)).ravel()
    sharpness = _sharpness(z_m, level_m, fine, 0.5 * HEIGHT_BIN_RAD)
    place = int(np.argmax(sharpness))
    return float(fine[place]), float(sharpness[place])


def _sharpness(
    z_m: F64,
    level_m: F64,
    heights: NDArray[Any],
    bin_rad: float,
) -> F64:
    """Return the chance that two points of a block of elevations share a bin, summed over blocks.

    A block counts by the root of its points: else the ground, from its own height, would be sharper
    than all rings.
    """
    n_blocks = math.ceil(np.pi / BLOCK_RAD) + 1
    n_bins = round(BLOCK_RAD / bin_rad)
    n_all = n_blocks * n_bins
    sharpness = np.empty(len(heights))
    for i, height in enumerate(heights):
        elevation = np.arctan2(z_m - height, level_m)
        place = ((elevation + 0.5 * np.pi) / bin_rad).astype(np.int64)
        count = np.bincount(place, minlength=n_all)[:n_all].reshape(-1, n_bins)
        total = count.sum(axis=1)
        n_pairs = np.maximum(total * (total - 1), 1)
        share_in_bin = (count * (count - 1)).sum(axis=1) / n_pairs
        by_chance = (total > 1) / n_bins
        sharpness[i] = (np.sqrt(total) * (share_in_bin - by_chance)).sum()
    return sharpness


def _ring_density(elevation: F64, width_rad: float) -> F64:
    """Return the density of points about every bin of elevation, from down to up."""
    n_bins = int(np.pi / RING_BIN_RAD) + 2
    count = np.bincount(_ring_bins(elevation), minlength=n_bins).astype(np.float64)
    reach = math.ceil(4.0 * width_rad / RING_BIN_RAD)
    widths_off = np.arange(-reach, reach + 1) * RING_BIN_RAD / width_rad
    return np.convolve(count, np.exp(-0.5 * widths_off**2), mode="same")


def _ring_bins(elevation: F64) -> I64:
    place: I64 = ((elevation + 0.5 * np.pi) / RING_BIN_RAD).astype(np.int64)
    return place


def _agreeing(elevation: F64, use: Mask, width_rad: float) -> Mask:
    """Mark windows with the crowded elevations of other windows: their height is right."""
    densities = []
    for angle, used in zip(elevation, use, strict=True):
        densities.append(_ring_density(angle[used], width_rad))
    total = np.sum(densities, axis=0)
    n_around = math.ceil(2.0 * BLOCK_RAD / RING_BIN_RAD)
    even = np.full(n_around, 1.0 / n_around)
    crowd = np.zeros(len(densities))
    for i, density in enumerate(densities):
        others = total - density
        usual = np.convolve(others, even, mode="same")
        place = _ring_bins(elevation[i][use[i]])
        if len(place):
            crowd[i] = np.median(others[place] / np.maximum(usual[place], 1e-9))
    return crowd > 0.5 * float(np.median(crowd))


def _ring_elevations(elevation: F64, width_rad: float) -> F64:
    """Return the elevations of crowded points, rising."""
    density = _ring_density(elevation, width_rad)
    inner = density[1:-1]
    is_peak = (inner > density[:-2]) & (inner >= density[2:]) & (inner >= MIN_RING_POINTS)
    kept: list[int] = []
    for peak in (1 + np.flatnonzero(is_peak)).tolist():
        # without a deep valley between them, only the higher of two peaks is a ring
        while kept:
            before = kept[-1]
            valley = float(density[before:peak].min())
            lower = float(min(density[before], density[peak]))
            if valley <= MAX_VALLEY * lower and lower - valley > VALLEY_SIGMA * math.sqrt(lower):
                break
            if density[before] > density[peak]:
                peak = before
            kept.pop()
        kept.append(peak)
    return (np.array(kept, np.float64) + 0.5) * RING_BIN_RAD - 0.5 * np.pi
