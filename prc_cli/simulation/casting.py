"""The nearest surface of every shot of a simulated scan."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from prc_cli import kernels
from prc_cli.core.types import F64, I32, I64
from prc_cli.simulation.thresholds import CastBodies
from prc_cli.simulation.world import Bodies, Shape

_QUANTILES: F64 = -np.log1p(-(np.arange(4096) + 0.5) / 4096)
_QUANTILES /= _QUANTILES.mean()
"""Exponential numbers of mean 1, equally likely; made once, so that every way through leaves is drawn from the same."""


_CURVE_M = 4096.0
"""What lies farther along an axis is not sorted any more [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
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
    """Find the nearest surface of every shot.

    Results do not depend on how lines are cut into blocks, nor on bodies that no shot can meet; of surfaces at the
    very same range, that of the first body is met. The work is done with the lock of the interpreter released.
    """
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
    return Hits(*kernels.cast_shots(*rays, first_shot, given, search_order(bodies), _QUANTILES))


def _plain(numbers: F64) -> F64:
    """Return numbers as the kernel takes them, without a copy where they are so already."""
    return np.require(numbers, np.float64, ["C", "W"])


@lru_cache(maxsize=8)  # by identity: the blocks of a scan often see the same bodies
def search_order(bodies: Bodies) -> I64:
    """Put neighbours of about one size beside each other, so that they can be left out together."""
    if not len(bodies):
        return np.empty(0, np.int64)
    x, y, z, a, b, c, e, f, g = bodies.numbers.T
    low, high = np.empty((2, 3, len(bodies)))
    for k, ends in enumerate(((x, a, e), (y, b, f), (z, c, g))):
        second = np.where(bodies.shape <= Shape.CONE, ends[1], ends[0])
        third = np.where(bodies.shape == Shape.TRIANGLE, ends[2], ends[0])
        low[k] = np.minimum(np.minimum(ends[0], second), third)
        high[k] = np.maximum(np.maximum(ends[0], second), third)
    size = (high - low).max(axis=0)
    np.maximum(size, 2.0 * np.maximum(np.maximum(a, b), c), where=bodies.shape >= Shape.ELLIPSOID, out=size)
    middle = 0.5 * (low + high)
    cells = np.minimum(middle - middle.min(axis=1, keepdims=True), _CURVE_M - 1.0).astype(np.int64)
    code = _spread(cells[0]) | _spread(cells[1]) << 1 | _spread(cells[2]) << 2
    level = np.minimum(np.log2(np.maximum(size, 0.5)) / 2.0 + 0.5, 15.0).astype(np.int64)
    code |= level << 40
    code |= bodies.velocity.any(axis=1).astype(np.int64) << 45
    return np.argsort(code)


def _spread(numbers: I64) -> I64:
    """Put two zeros between the bits of numbers below 4096."""
    for shift, bits in ((16, 0xFF0000FF), (8, 0x0F00F00F), (4, 0xC30C30C3), (2, 0x249249249)):
        numbers = (numbers | numbers << shift) & bits
    return numbers
