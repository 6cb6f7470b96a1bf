"""Finds the frame of a spinning scanner from its rings: cones around one axis with one apex.

Drivers and data sets give clouds on the axes of a vehicle, levelled, or with z counted from the
ground. The elevation of a ring then changes with azimuth and range. The axis and the apex with the
least spread of elevation within rings are found by Gauss-Newton steps. Tukey weights leave out
shots that fit badly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prc_cli.core.frame import SensorFrame, turning
from prc_cli.core.types import F32, F64, I64

MOST_SHOTS = 12_000
FEW_SHOTS = 3_000
"""Shots of a fit, and of a fit that only compares two cuts of a frame into rings."""
FEWEST_SHOTS = 500
FEWEST_RINGS = 4
WIDEST_GAP = 0.75
"""Widest sector without shots [turns]: a narrow view cannot separate axis and apex."""
NARROW_RAD = math.radians(0.1)
"""Rings that spread less are cones [rad]; angles of scanners and frames spread up to 0.15 deg."""
BETTER = 0.6
"""The spread after a fit is less than this share of the spread before."""
LEAST_LEAN_RAD = math.radians(0.3)
"""Axes that lean less are upright: 0.1 deg in frames of KITTI and of Argoverse [rad]."""
LEAST_OFF_M = 0.25
"""An apex that is nearer to the origin is at it.

Lasers of one scanner lie up to 0.2 m apart [m].
"""
MOST_LEAN_RAD = math.radians(60.0)
"""Axes that lean more may be fitted to other surfaces [rad]."""
FARTHEST_M = 5.0
"""A scanner is not farther from the origin of coordinates, unless they are map coordinates [m]."""
ROUNDS = 30
CLOSE = 3e-5
"""Most steps of a fit; smaller ones end it [rad, m]."""
UPRIGHT_ROUNDS = 3
MILD_ROUNDS = 9
"""The first steps only turn the axis; steps before this one leave out few shots."""
TUKEY = 3.0
"""Shots that deviate by more spreads have no weight."""
MOST = 80.0
"""Percentile of deviations that is the spread: most shots may see level ground at one range."""
DEVIATION = 1.4826
"""Standard deviations in one median absolute deviation."""
DECIMALS_RAD = 6
DECIMALS_M = 3
"""Decimals of a frame: the last bits of a fit differ between machines."""
MOST_IN_ORDER = 0.9
"""Least share of the rings above the ring before."""
NEAR_RING = 0.4
"""Shots are nearer to their ring than this share of the distance to the next ring."""
_SPIN_RAD = math.radians(45.0)
"""Shots of a line of a spinning scanner deviate less from its azimuth [rad]."""
_TURNED_RAD = math.radians(2.0)
"""Lines of a spinning scanner turn by more [rad]."""


def is_spinning(xyz_m: F32) -> bool:
    """Whether lines, (lines, M, 3) float32 [m], turn like the lines of a spinning scanner.

    >>> azimuth = np.linspace(0, 1, 50)[:, None] + np.zeros(8)
    >>> xyz_m = np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=-1)
    >>> is_spinning(xyz_m.astype(np.float32))
    True
    """
    direction = np.nansum(xyz_m[..., :2].astype(np.float64), axis=1)
    azimuth = np.arctan2(direction[:, 1], direction[:, 0])
    is_finite = np.isfinite(xyz_m[..., 0])
    enough = is_finite.sum(axis=1) >= FEWEST_RINGS - 1
    if np.count_nonzero(enough) < 2:
        return False
    with np.errstate(invalid="ignore"):
        off = np.arctan2(xyz_m[..., 1], xyz_m[..., 0]).astype(np.float64) - azimuth[:, None]
    off = (off + math.pi) % (2 * math.pi) - math.pi
    one_way = np.mean(np.abs(off[enough][is_finite[enough]]) < _SPIN_RAD)
    turned = np.ptp(np.unwrap(azimuth[enough]))
    return bool(one_way > 0.9 and turned > _TURNED_RAD)


def are_rings(xyz_m: F32) -> bool:
    """Whether columns of turning lines, (lines, M, 3) float32 [m], are rings of one elevation.

    With a wrong number of shots in a line, elevations repeat in a line or change from line to line.
    """
    with np.errstate(invalid="ignore"):
        elevation = np.arctan2(xyz_m[..., 2], np.hypot(xyz_m[..., 0], xyz_m[..., 1])).astype(
            np.float64
        )
    enough = np.isfinite(elevation).sum(axis=0) >= FEWEST_RINGS
    if np.count_nonzero(enough) < FEWEST_RINGS:
        return False
    middle = np.nanmedian(elevation[:, enough], axis=0)
    gaps = np.diff(middle)
    gaps *= math.copysign(1.0, float(gaps.sum()))
    off = np.nanmedian(np.abs(elevation[:, enough] - middle))
    # rings of several scanners, or of a worn one, may cross here and there
    return bool(
        np.mean(gaps > 0) > MOST_IN_ORDER and off < NEAR_RING * float(np.median(np.abs(gaps)))
    )


def find_frame(xyz: F32, rings: I64) -> SensorFrame | None:
    """Return the frame of a scanner from the coordinates of its shots.

    Parameters
    ----------
    xyz : (n, 3) float32
        Coordinates, finite [m].
    rings : (n,) int64
        Ring of every shot, from 0.

    Returns
    -------
    SensorFrame or None
        None where the coordinates are in the frame of the scanner, or no other frame explains them
        better.
    """
    xyz_m, ring = _sample(xyz, rings, MOST_SHOTS)
    n_rings = len(np.unique(ring))
    if len(ring) < FEWEST_SHOTS or n_rings < FEWEST_RINGS:
        return None
    azimuth = np.sort(np.arctan2(xyz_m[:, 1], xyz_m[:, 0]))
    widest_rad = float(np.diff(azimuth, append=azimuth[0] + 2 * math.pi).max())
    if widest_rad / (2 * math.pi) > WIDEST_GAP:
        return None
    fit = _Fit(xyz_m, ring)
    before = fit.spread()
    if before < NARROW_RAD or not fit.run():
        return None
    lean = math.acos(min(max(float(fit.turn[2, 2]), -1.0), 1.0))
    aside_m = float(np.hypot(fit.apex_m[0], fit.apex_m[1]))
    above_m = abs(float(fit.apex_m[2]))
    after = fit.spread()
    if after > BETTER * before or lean > MOST_LEAN_RAD or max(aside_m, above_m) > FARTHEST_M:
        return None
    # small leans and offsets are errors of the scanner's own angles
    turn = fit.turn if lean >= LEAST_LEAN_RAD else np.eye(3)
    apex = fit.apex_m * np.array([aside_m >= LEAST_OFF_M] * 2 + [above_m >= LEAST_OFF_M])
    if turn is not fit.turn and not apex.any():
        return None
    rows = tuple(tuple(round(float(value), DECIMALS_RAD) for value in row) for row in turn)
    place = tuple(round(float(value), DECIMALS_M) for value in apex)
    return SensorFrame(rows, place, (math.degrees(before), math.degrees(after)))  # type: ignore[arg-type]


def spread_of_cones(xyz_m: F32, ring: I64, *, is_fitted: bool) -> float:
    """Return the spread of elevation within rings [rad], in the best frame if ``is_fitted``."""
    fit = _Fit(*_sample(xyz_m, ring, FEW_SHOTS))
    if is_fitted:
        fit.run()
    return fit.spread()


def _sample(xyz_m: F32, ring: I64, most: int) -> tuple[F64, I64]:
    shots = np.linspace(0, len(ring) - 1, min(len(ring), most)).astype(np.int64)
    return xyz_m[shots].astype(np.float64), ring[shots]


@dataclass(slots=True)
class _Fit:
    """Axis and apex of the cones, improved step by step."""

    xyz_m: F64
    ring: I64
    turn: F64
    apex_m: F64
    n_rings: int

    def __init__(self, xyz_m: F64, ring: I64) -> None:
        self.xyz_m = xyz_m
        self.ring = ring
        self.n_rings = int(ring.max()) + 1
        self.turn = np.eye(3)
        self.apex_m = np.zeros(3)

    def run(self) -> bool:
        for step in range(ROUNDS):
            moved = self._step(with_apex=step >= UPRIGHT_ROUNDS, is_mild=step < MILD_ROUNDS)
            if step > MILD_ROUNDS and moved < CLOSE:
                return True
        return moved < LEAST_OFF_M / 10

    def spread(self) -> float:
        off = self._off(self._places()[1])
        return float(np.percentile(np.abs(off), MOST))

    def _places(self) -> tuple[F64, F64, F64]:
        xyz = (self.xyz_m - self.apex_m) @ self.turn.T
        flat = np.hypot(xyz[:, 0], xyz[:, 1])
        return (
            np.hypot(flat, xyz[:, 2]).clip(0.1),
            np.arctan2(xyz[:, 2], flat),
            np.arctan2(xyz[:, 1], xyz[:, 0]),
        )

    def _off(self, elevation: F64) -> F64:
        """Return the deviation of shots from the median elevation of their ring [rad]."""
        order = np.lexsort((elevation, self.ring))
        n = np.bincount(self.ring, minlength=self.n_rings)
        middle = np.zeros(self.n_rings)
        has = n > 0
        middle[has] = elevation[order][(np.cumsum(n) - n + n // 2)[has]]
        off: F64 = elevation - middle[self.ring]
        return off

    def _step(self, *, with_apex: bool, is_mild: bool) -> float:
        """Turn the axis, and move the apex, by a step; return its length [rad, m]."""
        distance, elevation, azimuth = self._places()
        off = self._off(elevation)
        weight = np.ones(len(off))
        if with_apex:
            # level ground alone, all around at one range, is on cones of any apex
            scale = (
                float(np.percentile(np.abs(off), MOST))
                if is_mild
                else DEVIATION * float(np.median(np.abs(off)))
            )
            share = off / max(TUKEY * scale, 1e-5)
            weight = np.where(np.abs(share) < 1, (1 - share * share) ** 2, 0.0)
        rise = np.sin(elevation) / distance
        flat = np.cos(elevation) / distance
        slopes = [np.sin(azimuth), -np.cos(azimuth)]
        if with_apex:
            slopes += [rise * np.cos(azimuth), rise * np.sin(azimuth), -flat]
        total = np.maximum(np.bincount(self.ring, weight, self.n_rings), 1e-12)

        def centred(values: F64) -> F64:
            middle = np.bincount(self.ring, weight * values, self.n_rings) / total
            apart: F64 = values - middle[self.ring]
            return apart

        matrix = np.stack([centred(slope) for slope in slopes], axis=1)
        missing = centred(elevation)
        weighted = matrix * weight[:, None]
        normal = weighted.T @ matrix + 1e-9 * len(off) * np.eye(len(slopes))
        step = np.linalg.solve(normal, -(weighted.T @ missing))
        turned = np.array([step[0], step[1], 0.0])
        turned *= min(1.0, 0.5 / max(float(np.abs(turned).max()), 1e-12))
        self.turn = turning(turned) @ self.turn
        if with_apex:
            self.apex_m = self.apex_m + self.turn.T @ np.clip(step[2:], -1.0, 1.0)
        return float(np.abs(step).max())
