"""The scan of a spinning head, from registered points and their times alone.

Three steps, each of arrays in the order of time:

1. :func:`find_turn_hz`: how fast the head spins, from a sample of windows.
2. :func:`find_rings`: the elevation of every ring and how far it looks ahead, from another sample.
3. :func:`fit_windows`: station and frame of the head for every window of a piece of the drive. Then
   :func:`ring_numbers` names the ring of every point, in a frame from any path, and :func:`find_firings` with
   :func:`firing_numbers` the firing.

Nothing is kept of a drive but the results of its windows, so a drive of any length can pass in
pieces.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64, I64, Mask
from prc_cli.streams.registered.firings import (
    Firings,
    find_firings,
    firing_numbers,
    line_numbers,
    starting,
)
from prc_cli.streams.registered.turning import (
    LinearFit,
    Poses,
    Windows,
    cut_windows,
    fit_linear,
    medians,
    placed,
    refine,
    rotations,
    turn_by,
    turned,
)

SLOWEST_HZ = 3.0
FASTEST_HZ = 40.0
N_RATES = 90
"""Rates of the first search: steps of 3 %, over which a head turns 5 degrees amiss at the ends of a turn."""
N_CLOSER = 17
CLOSER = 0.02
"""Half the span of the second search, as a share of the rate."""
N_SAMPLES = 8
"""Windows in the search of the rate."""
N_LOCKED = 24
"""Windows in which it is measured."""
N_SCANNED = 500
"""Points of a window in the search of the rate."""
N_FITTED = 3000
"""Points of a window where rings are sought."""
MIN_POINTS = 200
"""Fewest points of a turn."""
MIN_ROUNDNESS = 0.5
"""Least ratio of the axes of the frame.

0.86 and more for spinning heads, 0.003 and less for scanners of one plane.
"""
SCALES_M = np.geomspace(1.0, 0.01, 25)
"""Residuals at which the weight of a point halves, for a fit that chooses among rings [m]."""
FOLLOW_SCALES_M = (np.geomspace(1.0, 0.1, 6),) * 4 + (np.geomspace(0.1, 0.01, 5),) * 2
"""The same for rings that look ahead by different, known angles.

Every point follows the nearest of them [m].
"""
NEAR_M = 0.03
WIDE_M = 0.3
MIN_CONTRAST = 6.0
"""Points near their half plane, for each expected from those around, if a window is to count.

1 = chance, at most 10;
windows of a VLP-32C that follow a fifth of its rings reach 9, others 4."""
MAX_RESIDUAL_M = 0.06
"""Median distance from the half planes that always counts.

Clouds with 5 cm of noise reach 0.035 [m].
"""
SHARP_M = 0.002
"""Residuals up to here are sharp in any cloud [m]."""
RATE_ROUNDS = 5
SAME_RATE = 1e-4
"""Changes of the rate below this share end the rounds."""
MIN_LOCKED = 3
"""Fewest windows that must count. More evidence comes with the rings."""
MIN_SPEED_M_S = 1.0
"""Slower platforms do not tell their heading by their path."""
MIN_COHERENCE = 0.98
"""Least agreement of path and heading, 0 to 1, if they are to tell the rate."""
MAX_RATE_ERROR = 1e-3
"""Largest error of the rate by the windows alone, as a share: what platforms turn by themselves."""


@dataclass(frozen=True, slots=True)
class NoScan:
    """Why points are not those of a spinning head."""

    reason: str


@dataclass(frozen=True, slots=True)
class TurnRate:
    """How fast a head spins."""

    hz: float
    """Turns a second, positive; the sense is that of the frame's third axis [Hz]."""
    origin_s: float
    """Time at which the azimuth of the head is 0 in its frame [s]."""
    residual_m: float
    """Median distance of the points from the half planes of their shots, in windows that count [m]."""
    locked: float
    """Share of the sampled windows that count."""

    def azimuth(self, time_s: F64) -> F64:
        """Return the azimuth of the head, (n,) float64 in [0, 2 pi) [rad]."""
        return turned(self.hz, time_s - self.origin_s)


def sample_middles(time_s: F64, n_windows: int) -> F64:
    """Return middles of windows, spread over the points unevenly, so that no period of the drive is met again."""
    place = np.modf((np.arange(n_windows) + 0.5) * 0.6180339887498949)[0]
    return np.unique(time_s[(place * len(time_s)).astype(np.int64)])


def find_turn_hz(time_s: F64, xyz_m: F64) -> TurnRate | NoScan:
    """Find how fast the head spins.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s]. Gaps are allowed: some seconds from all over a long drive will do.
    xyz_m
        (n, 3) float64, registered points [m].

    Returns
    -------
    TurnRate or NoScan
        The rate, or why there is none.
    """
    if len(time_s) < MIN_POINTS:
        return NoScan(f"{len(time_s)} points, fewer than a turn needs ({MIN_POINTS})")
    middle = sample_middles(time_s, N_SAMPLES)
    hz = _coarse_rate(time_s, xyz_m, middle)
    if isinstance(hz, NoScan):
        return hz
    origin_s = float(time_s[0])
    middle = sample_middles(time_s, N_LOCKED)
    for _ in range(RATE_ROUNDS):
        windows = _full(cut_windows(time_s, xyz_m, middle, 1.0 / hz, N_FITTED))
        fit = lock(windows, windows.azimuth(hz, origin_s))
        n_locked = int(fit.is_locked.sum())
        if n_locked < min(MIN_LOCKED, len(fit.is_locked)):
            n_windows = len(fit.is_locked)
            return NoScan(f"{n_locked} of {n_windows} windows fit {hz:.4g} turns a second")
        rate = fit.poses.rate_rad_s[fit.is_locked, 2]
        change = float(np.median(rate)) / (2.0 * np.pi)
        if abs(change) < SAME_RATE * hz:
            break
        hz += change
    hz += _drift_hz(windows.where(fit.is_locked), fit.poses.where(fit.is_locked), hz)
    residual = float(np.median(fit.residual_m[fit.is_locked]))
    return TurnRate(hz, origin_s, residual, float(np.mean(fit.is_locked)))


def _full(windows: Windows) -> Windows:
    """Return the windows that have points enough."""
    return windows.where(windows.use.sum(axis=1) >= MIN_POINTS)


def _coarse_rate(time_s: F64, xyz_m: F64, middle: F64) -> float | NoScan:
    best = math.inf
    hz = 0.0
    n_full = 0
    for rate in np.geomspace(SLOWEST_HZ, FASTEST_HZ, N_RATES):
        score, n_windows = _misfit(time_s, xyz_m, middle, float(rate))
        n_full = max(n_full, n_windows)
        if score < best:
            best = score
            hz = float(rate)
    if n_full < 2:
        return NoScan(f"turns have fewer than {MIN_POINTS} points")
    if not math.isfinite(best):
        return NoScan(f"no head that spins {SLOWEST_HZ:g} to {FASTEST_HZ:g} times a second fits")
    rates = hz * (1.0 + np.linspace(-CLOSER, CLOSER, N_CLOSER))
    scores = [_misfit(time_s, xyz_m, middle, float(rate), 2 * N_SCANNED)[0] for rate in rates]
    return float(rates[int(np.argmin(scores))])


def _misfit(
    time_s: F64,
    xyz_m: F64,
    middle: F64,
    hz: float,
    n_points: int = N_SCANNED,
) -> tuple[float, int]:
    """Return how badly a rate fits [m], infinite where the fit is degenerate, and the number of windows."""
    windows = _full(cut_windows(time_s, xyz_m, middle, 1.0 / hz, n_points))
    n_windows = len(windows.time_s)
    if n_windows < 2:
        return math.inf, n_windows
    fit = fit_linear(windows, windows.azimuth(hz, float(middle[0])), 5)
    roundness = float(np.median(fit.roundness))
    misfit = float(np.median(fit.residual_m / np.maximum(fit.roundness, 1e-9)))
    return (misfit if roundness > MIN_ROUNDNESS else math.inf), n_windows


@dataclass(frozen=True, slots=True)
class Locked:
    """Poses of windows, and which of them follow their points closely."""

    poses: Poses
    residual_m: F64
    """(w,) float64, median distance of points from the half planes of their shots, among those within 0.2 m [m]."""
    is_locked: Mask
    """(w,) bool."""


def lock(windows: Windows, azimuth: F64, ahead_rad: F64 | None = None) -> Locked:
    """Fit windows of which no pose is known.

    Parameters
    ----------
    windows, azimuth
        Points, and the azimuth of their shots (w, n) [rad].
    ahead_rad
        (a,) float64, the angles by which rings look ahead, about 0 [rad]. Without them, windows
        follow rings that all look ahead alike, or a group of them.
    """
    linear: LinearFit = fit_linear(windows, azimuth)
    poses = linear.poses
    if ahead_rad is None or len(ahead_rad) == 1:
        fit = refine(windows, azimuth, poses, SCALES_M)
    else:
        for scales_m in FOLLOW_SCALES_M:
            local = poses.local(windows)
            beside = _wrapped(np.arctan2(local[:, :, 1], local[:, :, 0]) - azimuth)
            nearest = np.searchsorted(0.5 * (ahead_rad[1:] + ahead_rad[:-1]), beside)
            fit = refine(windows, azimuth + ahead_rad[nearest], poses, scales_m)
            poses = fit.poses
    distance = np.abs(fit.beside_m)
    near = ((distance < NEAR_M) & windows.use).sum(axis=1)
    wide = ((distance < WIDE_M) & windows.use).sum(axis=1)
    contrast = near * (WIDE_M / NEAR_M) / np.maximum(wide, 1)
    close = medians(distance, windows.use) < MAX_RESIDUAL_M
    is_round = linear.roundness > MIN_ROUNDNESS
    residual = medians(distance, (distance < WIDE_M) & windows.use)
    is_locked = is_round & (close | (contrast > MIN_CONTRAST))
    if is_locked.any():
        # windows that follow no ring, but parts of some, are much less sharp
        usual = float(np.percentile(residual[is_locked], 25.0))
        is_locked &= residual <= 4.0 * usual + SHARP_M
    return Locked(fit.poses, residual, is_locked)


def _wrapped(angle: F64) -> F64:
    return np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi


def _drift_hz(windows: Windows, poses: Poses, hz: float) -> float:
    """Return by how much the rate is off.

    Vehicles move along their heading, so velocity stands still in the frame.
    """
    velocity = (poses.velocity_m_s[:, None, :] @ poses.frame)[:, 0, :2]
    moving = np.hypot(velocity[:, 0], velocity[:, 1]) > MIN_SPEED_M_S
    if moving.sum() < 4:
        return 0.0
    bearing = np.exp(1j * np.arctan2(velocity[moving, 1], velocity[moving, 0]))
    since = windows.time_s[moving] - windows.time_s[moving].mean()
    # rings that look ahead by different angles: a window may follow any of them
    most = MAX_RATE_ERROR * hz
    step = 0.1 / max(float(np.ptp(since)), 1.0)
    drift = 0.0
    for _ in range(3):
        grid = drift + np.arange(-most, most + step, step)
        agreement = np.abs((bearing * np.exp(2j * np.pi * grid[:, None] * since)).mean(axis=1))
        drift = float(grid[int(np.argmax(agreement))])
        most = 2.0 * step
        step = step / 10.0
    return drift if agreement.max() > MIN_COHERENCE else 0.0


N_RING_WINDOWS = 24
STEER_SCALES_M = np.geomspace(0.3, 0.01, 12)
"""The same from a pose that is a little off [m]."""
RING_SCALES_M = np.array([0.05, 0.03, 0.02, 0.02, 0.01, 0.01])
"""Residuals at which the weight of a point halves once rings are known [m]."""
MIN_UPRIGHT = 0.2
"""Axes nearer to level than this do not tell their speed by that of a level platform."""
SLOW_M_S = 0.3
"""Speeds along the axis below this are of no account in a turn [m/s]."""
HEIGHT_STEP_M = 0.02
N_HEIGHTS = 24
"""Heights of the grid that are looked at more closely."""
HEIGHT_BIN_RAD = math.radians(0.1)
BLOCK_RAD = math.radians(2.0)
RING_BIN_RAD = math.radians(0.01)
RING_ROUNDS = 4
MIN_APART_RAD = math.radians(0.3)
"""Rings that look ahead by angles nearer than this count as one group."""
NEAR_HEAD_M = 2.0
"""Points nearer than this do not tell the angles of a ring, unless most are as near [m]."""
MIN_RING_POINTS = 8
MAX_VALLEY = 0.6
"""Largest density between two rings, as a share of the lower one's."""
VALLEY_SIGMA = 2.5
"""Least depth of the valley between two rings, in standard deviations of the count of points."""
MAX_RING_SHARE = 0.45
"""Points belong to a ring up to this share of the way to the next one."""
WIDEST_RAD = math.radians(0.3)
"""Points belong to no ring farther away than this [rad]."""


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
    """(k,) int64, points seen of every ring."""
    climb: float
    """Speed of the head along its axis as a share of that square to it, usually.

    0 for an axis square to the road.
    """
    is_up: bool
    """Whether the axis points up.

    It points down if the head turns to the right, seen from above.
    """

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
        """Return the angles by which rings look ahead, each once, about their mean, rising [rad]."""
        order = np.argsort(self.ahead_rad)
        ahead = self.ahead_rad[order]
        weight = np.maximum(self.n_points[order], 1)
        group = np.cumsum(np.diff(ahead, prepend=ahead[0]) > MIN_APART_RAD)
        total = np.bincount(group, weight)
        groups: F64 = np.bincount(group, weight * ahead) / total
        return groups - float((total * groups).sum() / total.sum())


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
    level = np.hypot(local_m[..., 0], local_m[..., 1])
    elevation = np.arctan2(local_m[..., 2], level)
    known = rings.elevation_rad
    middle = 0.5 * (known[1:] + known[:-1])
    ring = np.searchsorted(middle, elevation)
    gap = np.diff(known, prepend=-np.inf, append=np.inf)
    reach = np.minimum(MAX_RING_SHARE * np.minimum(gap[:-1], gap[1:]), WIDEST_RAD)
    numbers: I64 = np.where(np.abs(elevation - known[ring]) <= reach[ring], ring, -1)
    return numbers


def are_clear(local_m: F64, ring: I64, rings: Rings) -> Mask:
    """Mark points nearer to their ring than a quarter of the way to the next one, (n,) bool."""
    known = rings.elevation_rad
    gap = np.diff(known, prepend=-np.inf, append=np.inf)
    quarter = 0.25 * np.minimum(gap[:-1], gap[1:])
    elevation = np.arctan2(local_m[:, 2], np.hypot(local_m[:, 0], local_m[:, 1]))
    clear: Mask = (ring >= 0) & (np.abs(elevation - known[ring]) <= quarter[ring])
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
    windows = _full(cut_windows(time_s, xyz_m, middle, 1.0 / rate.hz, N_FITTED))
    azimuth = windows.azimuth(rate.hz, rate.origin_s)
    fit = lock(windows, azimuth)
    windows = windows.where(fit.is_locked)
    azimuth = azimuth[fit.is_locked]
    if len(azimuth) < 2:
        return NoScan("no windows fit")
    poses = _with_heights(fit.poses.where(fit.is_locked), windows)
    is_up = float(np.median(poses.frame[:, 2, 2])) > 0.0
    rings = Rings(*(np.empty(0),) * 3, np.empty(0, np.int64), 0.0, is_up)
    for round_ in range(RING_ROUNDS):
        local = poses.local(windows)
        elevation = np.arctan2(local[:, :, 2], np.hypot(local[:, :, 0], local[:, :, 1]))
        width_rad = math.radians(0.04 if round_ == 0 else 0.02)
        distance = np.linalg.norm(local, axis=2)
        nearest = min(NEAR_HEAD_M, 0.5 * float(np.median(distance[windows.use])))
        use = windows.use & (distance > nearest)
        if round_ == 0:
            agree = _agreeing(elevation, use, width_rad)
            windows = windows.where(agree)
            poses = poses.where(agree)
            azimuth = azimuth[agree]
            local = local[agree]
            elevation = elevation[agree]
            use = use[agree]
        peaks = _ring_elevations(elevation[use], width_rad)
        if len(peaks) < 2:
            return NoScan(f"{len(peaks)} rings, expected 2 or more: points of one plane")
        nothing = np.zeros(len(peaks))
        rings = Rings(np.tan(peaks), nothing, nothing, nothing.astype(np.int64), 0.0, is_up)
        number = np.where(use, ring_numbers(local, rings), -1)
        ahead, turn = _ring_azimuths(local, azimuth, number, len(peaks))
        about = np.zeros((len(turn), 3))
        about[:, 2] = turn
        poses = replace(poses, frame=poses.frame @ rotations(about))
        rings = measure_rings(
            poses.local(windows)[use], number[use], replace(rings, ahead_rad=ahead)
        )
        slope = np.where(number >= 0, rings.tangent[number], np.nan)
        beams = azimuth + rings.ahead_rad[number]
        fitted = replace(windows, use=windows.use & (number >= 0))
        poses = refine(fitted, beams, poses, RING_SCALES_M, slope).poses
    hz = rate.hz + _drift_hz(windows, poses, rate.hz)
    return replace(rings, climb=_climb(poses)), replace(rate, hz=hz)


def measure_rings(local_m: F64, number: I64, rings: Rings) -> Rings:
    """Measure the elevation of every ring anew from points whose rings are known."""
    elevation = np.arctan2(local_m[:, 2], np.hypot(local_m[:, 0], local_m[:, 1]))
    tangent = rings.tangent.copy()
    spread = rings.spread_rad.copy()
    order = np.argsort(number, kind="stable")
    border = np.searchsorted(number[order], np.arange(rings.n_rings + 1))
    for ring in range(rings.n_rings):
        of_ring = elevation[order[border[ring] : border[ring + 1]]]
        if len(of_ring) >= MIN_RING_POINTS:
            middle = float(np.median(of_ring))
            tangent[ring] = math.tan(middle)
            spread[ring] = float(np.median(np.abs(of_ring - middle)))
    return replace(rings, tangent=tangent, spread_rad=spread, n_points=np.diff(border))


def _ring_azimuths(
    local: F64,
    azimuth: F64,
    number: I64,
    n_rings: int,
) -> tuple[F64, F64]:
    """Return how far rings look ahead, and how far the frame of every window turned with the rings it followed."""
    beside = _wrapped(np.arctan2(local[:, :, 1], local[:, :, 0]) - azimuth)
    n_windows = len(local)
    table = np.full((n_windows, n_rings), np.nan)
    cell = np.where(number >= 0, np.arange(n_windows)[:, None] * n_rings + number, -1).ravel()
    order = np.argsort(cell, kind="stable")
    border = np.searchsorted(cell[order], np.arange(n_windows * n_rings + 1))
    flat = beside.ravel()[order]
    for place in np.flatnonzero(np.diff(border) >= 3):
        table.ravel()[place] = np.median(flat[border[place] : border[place + 1]])
    # one window after the other joins those before: medians of differences of rings that both have
    turn = np.zeros(n_windows)
    ahead = table[np.argmax(np.isfinite(table).sum(axis=1))]
    for _ in range(3):
        for i in range(n_windows):
            apart = table[i] - ahead
            turn[i] = np.nanmedian(apart) if np.isfinite(apart).any() else 0.0
        with np.errstate(all="ignore"):
            ahead = _nan_medians((table - turn[:, None]).T)
    ahead = np.where(np.isfinite(ahead), ahead, 0.0)
    middle = float(np.median(ahead))
    return ahead - middle, turn + middle


def _nan_medians(values: F64) -> F64:
    known = np.isfinite(values)
    middle = medians(np.where(known, values, 0.0), known)
    return np.where(known.any(axis=1), middle, np.nan)


def _with_heights(poses: Poses, windows: Windows) -> Poses:
    """Move stations along their axes to where elevations are sharpest.

    Half planes do not tell the speed along the axis either. An axis that is square to the road has
    none; a tilted one has that of a platform that moves level.
    """
    axis = poses.frame[:, :, 2]
    upright = np.where(np.abs(axis[:, 2]) > MIN_UPRIGHT, axis[:, 2], np.inf)
    level_m_s = -poses.velocity_m_s[:, 2] / upright
    best = -math.inf
    chosen = poses
    for speed in (np.zeros(len(axis)), level_m_s):
        moving = replace(poses, velocity_m_s=poses.velocity_m_s + speed[:, None] * axis)
        local = moving.local(windows)
        level = np.hypot(local[:, :, 0], local[:, :, 1])
        heights = [
            sharpest_height(z[u], far[u])
            for z, far, u in zip(local[:, :, 2], level, windows.use, strict=True)
        ]
        sharpness = float(np.median([sharp for _, sharp in heights]))
        if sharpness > best:
            height = np.array([height for height, _ in heights])[:, None]
            best = sharpness
            chosen = replace(moving, station_m=moving.station_m + height * axis)
        if np.median(np.abs(level_m_s)) < SLOW_M_S:
            break
    return chosen


def _climb(poses: Poses) -> float:
    """Return the speed along the axis as a share of that square to it, which stays where the mount does."""
    velocity = (poses.velocity_m_s[:, None, :] @ poses.frame)[:, 0, :]
    across = np.hypot(velocity[:, 0], velocity[:, 1])
    moving = across > MIN_SPEED_M_S
    return float(np.median(velocity[moving, 2] / across[moving])) if moving.any() else 0.0


def _climbing(poses: Poses, climb: float) -> Poses:
    """Return poses of no speed along the axis with the usual one."""
    axis = poses.frame[:, :, 2]
    along = (poses.velocity_m_s * axis).sum(axis=1, keepdims=True)
    across = poses.velocity_m_s - along * axis
    speed = climb * np.linalg.norm(across, axis=1, keepdims=True)
    return replace(poses, velocity_m_s=across + speed * axis)


def sharpest_height(z_m: F64, level_m: F64) -> tuple[float, float]:
    """Return the height from which points lie on the sharpest elevations [m], and how sharp they are."""
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
    """Return how likely two points of a block of elevations share a bin, beyond chance, summed over blocks.

    A block counts by the root of its points: else the ground, seen from its own height, would be
    sharper than all rings.
    """
    n_blocks = math.ceil(np.pi / BLOCK_RAD) + 1
    n_bins = round(BLOCK_RAD / bin_rad)
    sharpness = np.empty(len(heights))
    for i, height in enumerate(heights):
        place = ((np.arctan2(z_m - height, level_m) + 0.5 * np.pi) / bin_rad).astype(np.int64)
        count = np.bincount(place, minlength=n_blocks * n_bins)[: n_blocks * n_bins].reshape(
            -1, n_bins
        )
        total = count.sum(axis=1)
        pairs = (count * (count - 1)).sum(axis=1) / np.maximum(total * (total - 1), 1)
        sharpness[i] = (np.sqrt(total) * (pairs - (total > 1) / n_bins)).sum()
    return sharpness


def _ring_density(elevation: F64, width_rad: float) -> F64:
    """Return how many points lie about every bin of elevation, from straight down to straight up."""
    count = np.bincount(_ring_bins(elevation), minlength=int(np.pi / RING_BIN_RAD) + 2).astype(
        np.float64
    )
    reach = math.ceil(4.0 * width_rad / RING_BIN_RAD)
    shape = np.exp(-0.5 * (np.arange(-reach, reach + 1) * RING_BIN_RAD / width_rad) ** 2)
    return np.convolve(count, shape, mode="same")


def _ring_bins(elevation: F64) -> I64:
    place: I64 = ((elevation + 0.5 * np.pi) / RING_BIN_RAD).astype(np.int64)
    return place


def _agreeing(elevation: F64, use: Mask, width_rad: float) -> Mask:
    """Mark the windows whose points lie where those of the other windows crowd.

    The height of others is wrong.
    """
    every = [
        _ring_density(angle[known], width_rad) for angle, known in zip(elevation, use, strict=True)
    ]
    total = np.sum(every, axis=0)
    around = math.ceil(2.0 * BLOCK_RAD / RING_BIN_RAD)
    crowd = np.zeros(len(every))
    for i, density in enumerate(every):
        others = total - density
        usual = np.convolve(others, np.full(around, 1.0 / around), mode="same")
        place = _ring_bins(elevation[i][use[i]])
        if len(place):
            crowd[i] = np.median(others[place] / np.maximum(usual[place], 1e-9))
    return crowd > 0.5 * float(np.median(crowd))


def _ring_elevations(elevation: F64, width_rad: float) -> F64:
    """Return the elevations where points crowd, rising."""
    density = _ring_density(elevation, width_rad)
    inner = density[1:-1]
    peaks = 1 + np.flatnonzero(
        (inner > density[:-2]) & (inner >= density[2:]) & (inner >= MIN_RING_POINTS)
    )
    kept: list[int] = []
    for peak in peaks.tolist():
        while kept:
            valley = float(density[kept[-1] : peak].min())
            lower = float(min(density[kept[-1]], density[peak]))
            if valley <= MAX_VALLEY * lower and lower - valley > VALLEY_SIGMA * math.sqrt(lower):
                break
            if density[kept[-1]] > density[peak]:
                peak = kept[-1]
            kept.pop()
        kept.append(peak)
    return (np.array(kept, np.float64) + 0.5) * RING_BIN_RAD - 0.5 * np.pi


N_WINDOW = 1500
"""Points of a window of the path."""
MIN_ON_RINGS = 0.7
"""Least share of a window's points near their beams, if it is to be trusted.

0.95 and more in streets.
"""
BEAM_M = 0.05
"""Points up to here are near their beams [m]."""
REACH_M = 0.3
HEIGHT_GUESS_M = np.arange(-REACH_M, REACH_M + 0.01, 0.02)
"""Heights tried around one that the window before foretells [m]."""
LONGEST_STEP_S = 1.0
"""A window does not tell the place of another one farther away [s]."""
FULL = 0.1
"""A window may lack points for this share of its length before it is moved."""
REPAIRS = 12
"""Rounds in which windows that do not fit start again from their neighbours."""
N_HEIGHT = 500
"""Points of a window that tell the height."""
MIN_HEIGHT_SCORE = 0.6
"""Least mean nearness of points to rings, 1 = on them, 0 = a quarter of their spacing off."""


@dataclass(frozen=True, slots=True)
class HeadPath:
    """Station and frame of the head at ``w`` times: knots for a smoother, or a path by itself."""

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
    """(w,) bool; the other poses are those of the nearest trusted window, moved on."""

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
        """Return points in the frame of the head that does not spin, by the nearest window, (n, 3) float64 [m]."""
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
        Poses of the windows that have points enough; none for a piece without.
    """
    step = 1.0 / rate.hz
    first, last = (math.floor((edge - rate.origin_s) / step) for edge in (time_s[0], time_s[-1]))
    middle = rate.origin_s + (np.arange(first, last + 1) + 0.5) * step
    middle = _filled_middles(time_s, middle, step)
    windows = _full(cut_windows(time_s, xyz_m, middle, step, N_WINDOW))
    azimuth = windows.azimuth(rate.hz, rate.origin_s)
    fit = lock(windows, azimuth, rings.groups_rad())
    fit = replace(fit, poses=_climbing(fit.poses, rings.climb))
    poses = _foretold_heights(fit, windows, rings)
    path = _onto_rings(windows, azimuth, poses, rings)
    for _ in range(REPAIRS):
        # a window that fits worse than the others starts again from the nearest one that fits
        good = path.on_rings >= _good_share(path)
        if good.all() or not good.any():
            break
        moved = _moved_on(replace(path, is_trusted=good), windows).where(~good)
        moved = _steered(windows.where(~good), azimuth[~good], moved, rings)
        again = _onto_rings(windows.where(~good), azimuth[~good], moved, rings)
        is_better = again.on_rings > path.on_rings[~good] + 0.01
        if not is_better.any():
            break
        path = _exchanged(path, np.flatnonzero(~good)[is_better], again.where(is_better))
    path = replace(path, poses=_moved_on(path, windows))
    return replace(path, poses=placed(path.poses, windows))


def _filled_middles(time_s: F64, middle: F64, length_s: float) -> F64:
    """Move windows that reach beyond the points, at gaps and at both ends, to where they are full."""
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


def _foretold_heights(fit: Locked, windows: Windows, rings: Rings) -> Poses:
    """Move stations along their axes to where their points lie on the rings, near where the window before foretells."""
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
            foretold = (
                station[before] + windows.centre_m[before] + since * poses.velocity_m_s[before]
            )
            guess = float(axis @ (foretold - windows.centre_m[i] - station[i]))
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
    """Return the height near a guess from which most points lie on rings; none if they are few."""
    known = rings.elevation_rad
    elevation = np.arctan2(z_m - (guess_m + HEIGHT_GUESS_M)[:, None], level_m)
    border = 0.5 * (known[1:] + known[:-1])
    distance = np.abs(elevation - known[np.searchsorted(border, elevation)])
    reach = min(0.25 * float(np.median(np.diff(known))), WIDEST_RAD)
    score = np.maximum(0.0, 1.0 - distance / reach).mean(axis=1)
    best = int(np.argmax(score))
    is_clear = score[best] > MIN_HEIGHT_SCORE and 0 < best < len(score) - 1
    return guess_m + float(HEIGHT_GUESS_M[best]) if is_clear else None


def _steered(
    windows: Windows,
    azimuth: F64,
    poses: Poses,
    rings: Rings,
) -> Poses:
    """Refine poses that are a little off by the half planes of the shots, then their heights by the rings.

    A tilt of half the step from ring to ring takes points for those of the next ring. The half
    planes do not mind.
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
    """Refine poses by the rings of their points, and judge them."""
    for scales_m in (RING_SCALES_M, RING_SCALES_M[2:]):
        local = poses.local(windows)
        number = np.where(windows.use, ring_numbers(local, rings), -1)
        known = number >= 0
        ahead = rings.ahead_rad[number]
        beside = _wrapped(np.arctan2(local[:, :, 1], local[:, :, 0]) - azimuth - ahead)
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


def _exchanged(path: HeadPath, index: I64, part: HeadPath) -> HeadPath:
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


def _moved_on(path: HeadPath, windows: Windows) -> Poses:
    """Return poses in which windows that are not trusted have the pose of the nearest trusted one, moved on."""
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


SAMPLE_POINTS = 300_000
"""Points in a row in which the firings are sought."""
MOST_SHARED = 0.02
"""Most shots of a ring that may share their time with the one before.

More, and times are coarser than firings.
"""
SAME_SHOT_RAD = math.radians(0.05)
"""Points of one ring and time that lie closer are returns of one shot."""
N_TRIES = 3
MIN_TRUSTED = 0.5
"""Least share of the windows of a sample that must lie on the rings."""


@dataclass(frozen=True, slots=True)
class SpinningHead:
    """What does not change along a drive of a spinning scanner."""

    rate: TurnRate
    rings: Rings
    firings: Firings
    by_azimuth: bool = False
    """Whether firings are found by the measured azimuths, since the times are coarser than the firings."""


@dataclass(frozen=True, slots=True)
class SpinningScan:
    """The scan of a piece of a drive; see :func:`scan_piece`."""

    path: HeadPath
    line: I64
    """(n,) int64, the line of every point, rising with time.

    Its shots look one way; -1 = off every ring.
    """
    firing: I64
    """(n,) int64, number of the firing; -1 = off every ring."""
    ring: I64
    """(n,) int64, rank of the ring along the axis; -1 = off every ring."""
    column: I64
    """(n,) int64, rank of the ring from low to high; -1 = off every ring."""
    local_m: F64
    """(n, 3) float64, points in the frame of the head that does not spin [m]."""

    @property
    def range_m(self) -> F64:
        """Distance of every point from the head, (n,) float64 [m]."""
        distance: F64 = np.linalg.norm(self.local_m, axis=1)
        return distance

    @property
    def residual_m(self) -> float:
        """Median distance of the points from the cones of their rings and from their half planes [m]."""
        return float(np.median(np.hypot(self.path.beside_m, self.path.cone_m)))

    @property
    def on_rings(self) -> float:
        """Share of the points on a ring."""
        return float(np.mean(self.ring >= 0))

    @property
    def trusted(self) -> float:
        """Share of the windows that can be trusted."""
        return float(np.mean(self.path.is_trusted))


def find_head(time_s: F64, xyz_m: F64) -> SpinningHead | NoScan:
    """Find the rate, the rings and the firings of a spinning scanner.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s]. Gaps are allowed: some seconds from all over a long drive will do.
    xyz_m
        (n, 3) float64, registered points [m].

    Returns
    -------
    SpinningHead or NoScan
        What was found, or why the points are not those of a spinning head.
    """
    rate = find_turn_hz(time_s, xyz_m)
    if isinstance(rate, NoScan):
        return rate
    rings_and_rate = find_rings(time_s, xyz_m, rate)
    if isinstance(rings_and_rate, NoScan):
        return rings_and_rate
    rings, rate = rings_and_rate
    reason = "no window lies on the rings"
    for share in (np.arange(N_TRIES) + 0.5) / N_TRIES:
        begin = max(int(share * len(time_s)) - SAMPLE_POINTS // 2, 0)
        piece = slice(begin, begin + SAMPLE_POINTS)
        path = fit_windows(time_s[piece], xyz_m[piece], rate, rings)
        if not len(path.time_s) or path.is_trusted.mean() < MIN_TRUSTED:
            continue
        local = path.local(time_s[piece], xyz_m[piece])
        ring = ring_numbers(local, rings)
        shot = shot_times(time_s[piece], local, ring, rate, rings)
        is_coarse = share_one_time(time_s[piece], shot, ring, rate) > MOST_SHARED
        fired = shot if is_coarse else time_s[piece]
        firings = find_firings(fired, ring, rings.ahead_rad, rate.hz)
        if firings is not None:
            # counted from the start of the drive, not of the piece
            return SpinningHead(rate, rings, starting(firings, float(time_s[0])), is_coarse)
        reason = "rings do not fire evenly: times are too coarse, or several scanners are mixed"
    return NoScan(reason)


def shot_times(
    time_s: F64,
    local_m: F64,
    ring: I64,
    rate: TurnRate,
    rings: Rings,
) -> F64:
    """Return when the head looked at every point, by its azimuth, near the point's own time, (n,) [s]."""
    azimuth = rate.azimuth(time_s) + rings.ahead_rad[ring]
    late = _wrapped(np.arctan2(local_m[:, 1], local_m[:, 0]) - azimuth)
    shot: F64 = np.where(ring >= 0, time_s + late / (2.0 * np.pi * rate.hz), time_s)
    return shot


def share_one_time(
    time_s: F64,
    shot_s: F64,
    ring: I64,
    rate: TurnRate,
) -> float:
    """Return the share of points that have the time of the one before in their ring, but another azimuth."""
    known = np.flatnonzero(ring >= 0)
    order = known[np.argsort(ring[known], kind="stable")]
    same = (np.diff(ring[order]) == 0) & (np.diff(time_s[order]) == 0)
    apart = np.abs(np.diff(shot_s[order])) * 2.0 * np.pi * rate.hz > SAME_SHOT_RAD
    return float(np.count_nonzero(same & apart)) / max(len(order), 1)


def scan_piece(time_s: F64, xyz_m: F64, head: SpinningHead) -> tuple[SpinningScan, SpinningHead]:
    """Find line, ring and range of the points of a piece of a drive, and the head for the next piece.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s]; a turn or more.
    xyz_m
        (n, 3) float64, registered points [m].
    head
        As found, or as returned with the piece before.
    """
    path = fit_windows(time_s, xyz_m, head.rate, head.rings)
    if not len(path.time_s):
        nothing = np.full(len(time_s), -1, np.int64)
        nowhere = np.full((len(time_s), 3), np.nan)
        return SpinningScan(path, nothing, nothing, nothing, nothing, nowhere), head
    local = path.local(time_s, xyz_m)
    ring = ring_numbers(local, head.rings)
    shot = shot_times(time_s, local, ring, head.rate, head.rings) if head.by_azimuth else None
    firing, firings = firing_numbers(time_s, ring, head.firings, shot)
    line = line_numbers(firing, ring, firings)
    column = ring if head.rings.is_up else np.where(ring >= 0, head.rings.n_rings - 1 - ring, -1)
    return SpinningScan(path, line, firing, ring, column, local), replace(head, firings=firings)
