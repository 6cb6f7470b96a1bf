"""Finds the frame of a spinning scanner from its rings.

Each is a cone around the axis, all with one apex.

Drivers and data sets give clouds on the axes of a vehicle, levelled, or with z counted from the
ground. The elevation of a ring then changes with azimuth and range. The axis and the apex are those
with the least spread of elevation within rings, found by Gauss-Newton steps with weights that leave
out what fits badly (Tukey).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prc_cli.core.frame import SensorFrame, turning
from prc_cli.core.types import F32, F64, I64

MOST_SHOTS = 12_000
FEW_SHOTS = 3_000
"""Shots that are fitted, and that are fitted to compare ways to cut a frame into rings."""
FEWEST_SHOTS = 500
FEWEST_RINGS = 4
WIDEST_GAP = 0.75
"""Share of a turn: a sector that is narrower than the rest of it does not tell an axis from an apex."""
NARROW_RAD = math.radians(0.1)
"""Rings that spread less are cones.

Scanners' own angles, and those of frames, spread up to 0.15 deg [rad].
"""
BETTER = 0.6
"""The spread that is left is less than this share of what it was."""
LEAST_LEAN_RAD = math.radians(0.3)
"""Axes that lean less are upright: 0.1 deg in frames of KITTI and of Argoverse [rad]."""
LEAST_OFF_M = 0.25
"""An apex that is nearer to the origin is at it.

Lasers of one scanner lie up to 0.2 m apart [m].
"""
MOST_LEAN_RAD = math.radians(60.0)
"""Axes that lean more are not told apart from other surfaces [rad]."""
FARTHEST_M = 5.0
"""A scanner is not farther from the point that coordinates are counted from, unless they are those of a map [m]."""
ROUNDS = 30
CLOSE = 3e-5
"""Most steps of a fit; smaller ones end it [rad, m]."""
UPRIGHT_ROUNDS = 3
MILD_ROUNDS = 9
"""The first steps turn the axis alone, and those up to here leave out little."""
TUKEY = 3.0
"""What is off by so many times the spread has no weight."""
MOST = 80.0
"""Per cent of the shots that a spread is of.

Most shots may see level ground, all around at one range.
"""
DEVIATION = 1.4826
"""Standard deviation in median absolute deviations."""
DECIMALS_RAD = 6
DECIMALS_M = 3
"""Decimals of a frame: the last bits of a fit differ between machines."""
MOST_IN_ORDER = 0.9
"""Share of the rings that lie above the one before."""
NEAR_RING = 0.4
"""Shots are nearer to their ring than this share of the distance to the next."""
_SPIN_RAD = math.radians(45.0)
"""The shots of a line of a spinning scanner lie within this of its azimuth [rad] ..."""
_TURNED_RAD = math.radians(2.0)
"""... and its lines turn by more than this [rad]."""


def is_spinning(xyz_m: F32) -> bool:
    """Return whether lines, (lines, M, 3) float32 [m], turn as those of a spinning scanner do.

    >>> azimuth = np.linspace(0, 1, 50)[:, None] + np.zeros(8)
    >>> is_spinning(np.stack([np.cos(azimuth), np.sin(azimuth), 0 * azimuth], axis=-1).astype(np.float32))
    True
    """
    along = np.nansum(xyz_m[..., :2].astype(np.float64), axis=1)
    azimuth = np.arctan2(along[:, 1], along[:, 0])
    there = np.isfinite(xyz_m[..., 0])
    enough = there.sum(axis=1) >= FEWEST_RINGS - 1
    if np.count_nonzero(enough) < 2:
        return False
    with np.errstate(invalid="ignore"):
        off = _wrap(np.arctan2(xyz_m[..., 1], xyz_m[..., 0]).astype(np.float64) - azimuth[:, None])
    one_way = np.mean(np.abs(off[enough][there[enough]]) < _SPIN_RAD)
    turned = np.ptp(np.unwrap(azimuth[enough]))
    return bool(one_way > 0.9 and turned > _TURNED_RAD)


def are_rings(xyz_m: F32) -> bool:
    """Return whether columns of lines that turn, (lines, M, 3) float32 [m], are rings, each at its elevation.

    With a wrong number of shots in a line elevations come again in a line, or change from line to
    line.
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
    xyz_m, ring = _some(xyz, rings, MOST_SHOTS)
    n_rings = len(np.unique(ring))
    if len(ring) < FEWEST_SHOTS or n_rings < FEWEST_RINGS or _gap(xyz_m) > WIDEST_GAP:
        return None
    fit = _Fit(xyz_m, ring)
    before = fit.spread()
    if before < NARROW_RAD or not fit.run():
        return None
    lean = math.acos(min(max(float(fit.turn[2, 2]), -1.0), 1.0))
    off_m = float(np.hypot(fit.apex_m[0], fit.apex_m[1])), abs(float(fit.apex_m[2]))
    after = fit.spread()
    if after > BETTER * before or lean > MOST_LEAN_RAD or max(off_m) > FARTHEST_M:
        return None
    # what is small is a matter of the scanner's own angles
    turn = fit.turn if lean >= LEAST_LEAN_RAD else np.eye(3)
    apex = fit.apex_m * np.array([off_m[0] >= LEAST_OFF_M] * 2 + [off_m[1] >= LEAST_OFF_M])
    if turn is not fit.turn and not apex.any():
        return None
    rows = tuple(tuple(round(float(value), DECIMALS_RAD) for value in row) for row in turn)
    place = tuple(round(float(value), DECIMALS_M) for value in apex)
    return SensorFrame(rows, place, (math.degrees(before), math.degrees(after)))  # type: ignore[arg-type]


def spread_of_cones(xyz_m: F32, ring: I64, *, is_fitted: bool) -> float:
    """Return the spread of elevation within rings [rad], in the frame that suits them best where it is fitted."""
    fit = _Fit(*_some(xyz_m, ring, FEW_SHOTS))
    if is_fitted:
        fit.run()
    return fit.spread()


def _some(xyz_m: F32, ring: I64, most: int) -> tuple[F64, I64]:
    shots = np.linspace(0, len(ring) - 1, min(len(ring), most)).astype(np.int64)
    return xyz_m[shots].astype(np.float64), ring[shots]


def _gap(xyz_m: F64) -> float:
    """Return the widest sector without a shot, as a share of a turn."""
    azimuth = np.sort(np.arctan2(xyz_m[:, 1], xyz_m[:, 0]))
    return float(np.diff(azimuth, append=azimuth[0] + 2 * math.pi).max()) / (2 * math.pi)


@dataclass(slots=True)
class _Fit:
    """Axis and apex, as far as they are known."""

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
        """Fit; return whether it came to an end."""
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
        """Return how far shots lie from the middle of their ring [rad]."""
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


def _wrap(angle: F64) -> F64:
    wrapped: F64 = (angle + math.pi) % (2 * math.pi) - math.pi
    return wrapped
