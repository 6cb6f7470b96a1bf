"""The rate of a spinning head, from a sample of windows of registered points."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F64, Mask
from prc_cli.streams.registered.turning import (
    LinearFit,
    Poses,
    Windows,
    cut_windows,
    fit_linear,
    medians,
    refine,
    turned,
)

SLOWEST_HZ = 3.0
FASTEST_HZ = 40.0
N_RATES = 90
"""Rates of the first search: in a step of 3 % a head is 5 degrees off at the ends of a turn."""
N_CLOSER = 17
CLOSER = 0.02
"""Half the span of the second search, as a share of the rate."""
N_SAMPLES = 8
"""Windows in the search of the rate."""
N_LOCKED = 24
"""Windows in which the rate is measured."""
N_SCANNED = 500
"""Points of a window in the search of the rate."""
N_FITTED = 3000
"""Points of a window where rings are sought."""
MIN_POINTS = 200
"""Fewest points of a turn."""
MIN_ROUNDNESS = 0.5
"""Least ratio of the axes of the frame: heads have 0.86 and more, scanners of one plane 0.003."""
SCALES_M = np.geomspace(1.0, 0.01, 25)
"""Residuals at which the weight of a point halves, for a fit that chooses among rings [m]."""
FOLLOW_SCALES_M = (np.geomspace(1.0, 0.1, 6),) * 4 + (np.geomspace(0.1, 0.01, 5),) * 2
"""Residuals for rings that look ahead by different, known angles, of which every point follows the
nearest [m]."""
NEAR_M = 0.03
WIDE_M = 0.3
MIN_CONTRAST = 6.0
"""Least density of points near their half plane, over that around it, of a window that counts.

1 = chance, at most 10; windows of a VLP-32C that follow a fifth of its rings reach 9, others 4."""
MAX_RESIDUAL_M = 0.06
"""A window with a smaller median distance always counts; 5 cm of noise give 0.035 [m]."""
SHARP_M = 0.002
"""Residuals up to here are sharp in any cloud [m]."""
RATE_ROUNDS = 5
SAME_RATE = 1e-4
"""Changes of the rate below this share end the rounds."""
MIN_LOCKED = 3
"""Fewest windows that must count; the rings check more."""
MIN_SPEED_M_S = 1.0
"""The path of a slower platform does not show its heading."""
MIN_COHERENCE = 0.98
"""Least agreement of path and heading, 0 to 1, for a correction of the rate."""
MAX_RATE_ERROR = 1e-3
"""Largest relative error of the rate from windows: platforms turn by themselves."""


@dataclass(frozen=True, slots=True)
class NoScan:
    """The reason why points are not from a spinning head."""

    reason: str


@dataclass(frozen=True, slots=True)
class TurnRate:
    """The rate of a head."""

    hz: float
    """Turns a second, positive, around the third axis of the frame [Hz]."""
    origin_s: float
    """Time of azimuth 0 of the head in its frame [s]."""
    residual_m: float
    """Median distance of the points from the half planes of their shots, in windows that count
    [m]."""
    locked: float
    """Share of the sampled windows that count."""

    def azimuth(self, time_s: F64) -> F64:
        """Return the azimuth of the head, (n,) float64 in [0, 2 pi) [rad]."""
        return turned(self.hz, time_s - self.origin_s)


def sample_middles(time_s: F64, n_windows: int) -> F64:
    """Return middles of windows, spread unevenly over the points [s]."""
    place = np.modf((np.arange(n_windows) + 0.5) * 0.6180339887498949)[0]
    return np.unique(time_s[(place * len(time_s)).astype(np.int64)])


def find_turn_hz(time_s: F64, xyz_m: F64) -> TurnRate | NoScan:
    """Find the rate of the head.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s]. Gaps are allowed: some seconds from all over a drive are enough.
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
        windows = full_windows(cut_windows(time_s, xyz_m, middle, 1.0 / hz, N_FITTED))
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
    hz += drift_hz(windows.where(fit.is_locked), fit.poses.where(fit.is_locked), hz)
    residual = float(np.median(fit.residual_m[fit.is_locked]))
    return TurnRate(hz, origin_s, residual, float(np.mean(fit.is_locked)))


def full_windows(windows: Windows) -> Windows:
    """Return the windows with enough points."""
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
    """Return the misfit of a rate [m], inf = degenerate, and the number of windows."""
    windows = full_windows(cut_windows(time_s, xyz_m, middle, 1.0 / hz, n_points))
    n_windows = len(windows.time_s)
    if n_windows < 2:
        return math.inf, n_windows
    fit = fit_linear(windows, windows.azimuth(hz, float(middle[0])), 5)
    roundness = float(np.median(fit.roundness))
    misfit = float(np.median(fit.residual_m / np.maximum(fit.roundness, 1e-9)))
    return (misfit if roundness > MIN_ROUNDNESS else math.inf), n_windows


@dataclass(frozen=True, slots=True)
class Locked:
    """Poses of windows, and a mark for those that follow their points closely."""

    poses: Poses
    residual_m: F64
    """(w,) float64, median distance from the half planes, of points within 0.3 m [m]."""
    is_locked: Mask
    """(w,) bool."""


def lock(windows: Windows, azimuth: F64, ahead_rad: F64 | None = None) -> Locked:
    """Fit windows without a known pose.

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
            beside = wrapped(np.arctan2(local[:, :, 1], local[:, :, 0]) - azimuth)
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
        # windows that follow parts of several rings are much less sharp
        usual = float(np.percentile(residual[is_locked], 25.0))
        is_locked &= residual <= 4.0 * usual + SHARP_M
    return Locked(fit.poses, residual, is_locked)


def wrapped(angle: F64) -> F64:
    """Return angles in [-pi, pi) [rad]."""
    return np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi


def drift_hz(windows: Windows, poses: Poses, hz: float) -> float:
    """Return the error of a rate: the velocity of a vehicle rests in the true frame [Hz]."""
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
