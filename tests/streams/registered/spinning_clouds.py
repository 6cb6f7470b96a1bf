"""Clouds of a spinning scanner in a yard with pillars, by closed forms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F64, I64
from tests.clouds import seen

TURN_HZ = 10.0
FIRING_HZ = 3000.0
DUTY = 0.6
"""Share of a firing in which the rings fire, one after the other."""
WALLS_M = (30.0, 14.0)
PILLARS = np.array(
    [
        [x, y, 0.4 + 0.05 * i]
        for i, (x, y) in enumerate(
            [
                (-22, 7),
                (-15, -9),
                (-9, 5),
                (-4, -6),
                (3, 8),
                (9, -8),
                (14, 6),
                (20, -5),
                (26, 9),
                (6, 4),
                (-18, -4),
                (17, -10),
            ]
        )
    ]
)


@dataclass(frozen=True)
class Cloud:
    """Points in the order of their times, and the truth."""

    time_s: F64
    xyz_m: F64
    ring: I64
    line: I64
    range_m: F64

    def part(self, keep: slice | F64) -> Cloud:
        """Return some of the points."""
        return Cloud(
            self.time_s[keep],
            self.xyz_m[keep],
            self.ring[keep],
            self.line[keep],
            self.range_m[keep],
        )


def station(time_s: F64) -> F64:
    """Return where the head is at times (n,), (n, 3) [m]."""
    return np.stack(
        [-4.0 + 8.0 * time_s, 0.3 * np.sin(2.0 * time_s), 1.9 + 0.03 * np.sin(5.0 * time_s)], axis=1
    )


def frame(time_s: F64, tilt_rad: float) -> F64:
    """Return the axes of the head at times (n,), (n, 3, 3), columns forward, left, up."""
    yaw = np.arctan2(0.6 * np.cos(2.0 * time_s), 8.0)
    pitch = tilt_rad + 0.01 * np.sin(4.0 * time_s)
    zero = np.zeros_like(yaw)
    ones = np.ones_like(yaw)
    turn = np.stack(
        [np.cos(yaw), -np.sin(yaw), zero, np.sin(yaw), np.cos(yaw), zero, zero, zero, ones], axis=1
    )
    nod = np.stack(
        [np.cos(pitch), zero, np.sin(pitch), zero, ones, zero, -np.sin(pitch), zero, np.cos(pitch)],
        axis=1,
    )
    return turn.reshape(-1, 3, 3) @ nod.reshape(-1, 3, 3)


def spinning_cloud(
    elevation_deg: F64,
    ahead_deg: F64,
    duration_s: float = 1.0,
    tilt_deg: float = 0.0,
    sense: float = 1.0,
) -> Cloud:
    """Scan the yard.

    Parameters
    ----------
    elevation_deg, ahead_deg
        (k,) float64, elevation of every ring, rising, and how far it looks ahead [degrees].
    duration_s
        Length of the drive [s].
    tilt_deg
        Tilt of the mount [degrees].
    sense
        1 = the head turns to the left, -1 = to the right.
    """
    n_rings = len(elevation_deg)
    firing = np.repeat(np.arange(round(duration_s * FIRING_HZ)), n_rings)
    ring = np.tile(np.arange(n_rings), round(duration_s * FIRING_HZ))
    time_s = (firing + DUTY * ring / n_rings) / FIRING_HZ
    azimuth = sense * (2.0 * np.pi * TURN_HZ * time_s + np.radians(ahead_deg)[ring])
    elevation = np.radians(elevation_deg)[ring]
    beam = seen(1.0, azimuth, elevation)
    direction = (frame(time_s, np.radians(tilt_deg)) @ beam[:, :, None])[:, :, 0]
    origin = station(time_s)
    range_m = _nearest(origin, direction)
    known = range_m < 80.0
    steps = np.rint(ahead_deg / (360.0 * TURN_HZ / FIRING_HZ)).astype(np.int64)
    line = firing - (steps.max() - steps)[ring]
    xyz = np.round(origin + range_m[:, None] * direction, 3)
    return Cloud(time_s, xyz, ring, line, range_m).part(known)


def _nearest(origin: F64, direction: F64) -> F64:
    """Return the distance to the ground, the walls or a pillar; they are 9 m high."""
    with np.errstate(divide="ignore", invalid="ignore"):
        candidates = [np.where(direction[:, 2] < 0, -origin[:, 2] / direction[:, 2], np.inf)]
        for axis, half in enumerate(WALLS_M):
            to_wall = (np.sign(direction[:, axis]) * half - origin[:, axis]) / direction[:, axis]
            candidates.append(_below_top(to_wall, origin, direction))
        for x, y, radius in PILLARS:
            level = direction[:, 0] ** 2 + direction[:, 1] ** 2
            along = direction[:, 0] * (origin[:, 0] - x) + direction[:, 1] * (origin[:, 1] - y)
            apart = (origin[:, 0] - x) ** 2 + (origin[:, 1] - y) ** 2 - radius**2
            to_pillar = (-along - np.sqrt(along**2 - level * apart)) / level
            candidates.append(
                _below_top(np.where(to_pillar > 0, to_pillar, np.inf), origin, direction)
            )
    return np.nanmin(np.stack(candidates), axis=0)


def _below_top(distance: F64, origin: F64, direction: F64) -> F64:
    height = origin[:, 2] + distance * direction[:, 2]
    return np.where((height > 0.0) & (height < 9.0), distance, np.inf)
