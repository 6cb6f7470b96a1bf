"""The nearest surface of every shot of a simulated scan."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from prc_cli import kernels
from prc_cli.core.types import F64, I32
from prc_cli.simulation.thresholds import CastBodies
from prc_cli.simulation.world import Bodies, Shape

_QUANTILES: F64 = -np.log1p(-(np.arange(4096) + 0.5) / 4096)
_QUANTILES /= _QUANTILES.mean()
"""Exponential numbers of mean 1, equally likely; made once, so that every way through leaves is drawn from the same."""


class Hits(NamedTuple):
    """What the shots of a block of lines met first."""

    t: F64
    """(lines, M) float64, range [m]; inf = nothing."""
    body: I32
    """(lines, M) int32, row in the bodies that were given, -1 = none."""
    facing: F64
    """(lines, M) float64, cosine of the angle of incidence, 0 to 1; 0 where nothing was met."""


def cast(
    bodies: Bodies, origin_m: F64, direction: F64, time_s: F64, first_shot: int = 0, t_min_m: F64 | None = None
) -> Hits:
    """Find the nearest surface of every shot, of several the first body's; blocks make no difference."""
    shape = origin_m.shape[:2]
    times = np.asarray(time_s, dtype=np.float64)
    times = np.broadcast_to(times[:, None] if times.ndim == 1 else times, shape)
    t_min = np.zeros(shape) if t_min_m is None else t_min_m
    yaw = np.where(bodies.shape >= Shape.ELLIPSOID, bodies.numbers[:, 6], 0.0)
    given = CastBodies(
        shape=np.require(bodies.shape, np.uint8, ["C", "W"]),
        numbers=_plain(bodies.numbers),
        turn=np.stack([np.cos(yaw), np.sin(yaw)], axis=1),
        density=_plain(bodies.density),
        velocity=_plain(bodies.velocity),
        number=_plain(bodies.number),
    )
    rays = _plain(origin_m), _plain(direction), _plain(times), _plain(t_min)
    return Hits(*kernels.cast_shots(*rays, first_shot, given, _QUANTILES))


def _plain(numbers: F64) -> F64:
    """Return numbers as the kernel takes them, without a copy where they are so already."""
    return np.require(numbers, np.float64, ["C", "W"])
