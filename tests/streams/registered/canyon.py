"""Clouds of a profiler in a street canyon with posts, by closed forms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F64, I64

LINE_HZ = 50.0
SHOTS = 900
SHOT_HZ = LINE_HZ * SHOTS
SLANT_RAD = np.deg2rad(20.0)
"""The lower part of the scan plane points back."""
LEFT_M = 9.0
RIGHT_M = -6.0
HEIGHT_M = 2.2
ROOF_M = 11.0


@dataclass(frozen=True)
class Cloud:
    """Points in the order of their times, and the truth."""

    time_s: F64
    xyz_m: F64
    line: I64
    column: I64
    range_m: F64

    def part(self, keep: slice | F64 | I64) -> Cloud:
        """Return some of the points."""
        return Cloud(
            self.time_s[keep],
            self.xyz_m[keep],
            self.line[keep],
            self.column[keep],
            self.range_m[keep],
        )


def station(time_s: F64) -> F64:
    """Return where the scanner is at times (n,), (n, 3) [m]."""
    return np.stack(
        [
            7.0 * time_s + 0.2 * np.sin(3.0 * time_s),
            0.3 * np.sin(1.3 * time_s),
            HEIGHT_M + 0.04 * np.sin(6.0 * time_s),
        ],
        axis=1,
    )


def frame(time_s: F64) -> F64:
    """Return bearing 0 (down), bearing 90 degrees (left) and the axis at times (n,), (n, 3, 3)."""
    yaw = 0.05 * np.sin(1.3 * time_s)
    roll = 0.02 * np.sin(5.0 * time_s)
    n = len(time_s)
    down = np.tile([-np.sin(SLANT_RAD), 0.0, -np.cos(SLANT_RAD)], (n, 1))
    left = np.tile([0.0, 1.0, 0.0], (n, 1))
    first = np.cos(roll)[:, None] * down - np.sin(roll)[:, None] * left
    second = np.sin(roll)[:, None] * down + np.cos(roll)[:, None] * left
    turned = [_yawed(axis, yaw) for axis in (first, second, np.cross(first, second))]
    return np.stack(turned, axis=2)


def _yawed(vector: F64, yaw: F64) -> F64:
    cosine = np.cos(yaw)
    sine = np.sin(yaw)
    x = vector[:, 0]
    y = vector[:, 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, vector[:, 2]], axis=1)


def canyon(
    duration_s: float = 1.5,
    *,
    start_s: float = 0.0,
    noise_m: float = 0.0,
    step_m: float = 0.0,
) -> Cloud:
    """Scan a street between two walls, open above; ledges and posts along it tell where one is.

    Parameters
    ----------
    duration_s
        Length of the drive [s].
    start_s
        Time of the first shot [s].
    noise_m
        Standard deviation of the ranges [m].
    step_m
        Coordinates are rounded to it [m]; 0 = not.
    """
    shot = np.arange(round(duration_s * SHOT_HZ))
    time_s = start_s + shot / SHOT_HZ
    bearing = 2.0 * np.pi * LINE_HZ * (shot / SHOT_HZ) + np.pi
    axes = frame(time_s)
    origin = station(time_s)
    direction = np.cos(bearing)[:, None] * axes[:, :, 0] + np.sin(bearing)[:, None] * axes[:, :, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = -origin[:, 2] / direction[:, 2]
        # the walls step back and forth every few metres along the street
        wall = np.full(len(shot), np.inf)
        for side_m in (LEFT_M, RIGHT_M):
            flat = (side_m - origin[:, 1]) / direction[:, 1]
            along = origin[:, 0] + flat * direction[:, 0]
            deep = side_m + np.sign(side_m) * np.where(np.floor(along / 3.0) % 2 == 0, 0.0, 0.8)
            reach = (deep - origin[:, 1]) / direction[:, 1]
            high = origin[:, 2] + reach * direction[:, 2]
            wall = np.where((reach > 0) & (high < ROOF_M), np.minimum(wall, reach), wall)
    range_m = np.minimum(np.where(floor > 0, floor, np.inf), wall)
    seen = np.flatnonzero(range_m < 80.0)
    if noise_m:
        range_m = range_m + np.random.default_rng(5).normal(0.0, noise_m, len(range_m))
    xyz = origin + range_m[:, None] * direction
    if step_m:
        xyz = np.round(xyz / step_m) * step_m
    return Cloud(time_s[seen], xyz[seen], seen // SHOTS, seen % SHOTS, range_m[seen])
