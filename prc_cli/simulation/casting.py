"""The nearest surface of every shot of a simulated scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli import kernels
from prc_cli.core.types import F64, I32, I64
from prc_cli.simulation.world import Bodies, Shape

_QUANTILES: F64 = -np.log1p(-(np.arange(4096) + 0.5) / 4096)
_QUANTILES /= _QUANTILES.mean()
"""Exponential numbers of mean 1, equally likely; made once, so that every way through leaves is drawn from the same."""


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

    Parameters
    ----------
    bodies : Bodies
        What is in sight.
    origin_m : (lines, M, 3) float64
        Where every shot begins, world coordinates [m].
    direction : (lines, M, 3) float64
        Where it goes, unit vectors. Any will do; it is quick where the shots of a line lie nearly in one plane and
        turn one way.
    time_s : (lines, M) or (lines,) float64
        When it is shot [s]; moving bodies are where they are at that time.
    first_shot : int
        Number of the first shot since the beginning of the scan (first line times M).
    t_min_m : (lines, M) float64, optional
        Only what lies behind this range is met [m]: a second cast that begins behind the first hit finds what is seen
        through glass, or a further return. Infinite: the shot is not cast. Default: 0.

    Returns
    -------
    Hits
        Range, body and cosine of incidence of every shot.
    """
    shape = origin_m.shape[:2]
    times = np.asarray(time_s, dtype=np.float64)
    times = np.broadcast_to(times[:, None] if times.ndim == 1 else times, shape)
    t_min = np.zeros(shape) if t_min_m is None else t_min_m
    yaw = np.where(bodies.shape >= Shape.ELLIPSOID, bodies.numbers[:, 6], 0.0)
    return Hits(
        *kernels.cast_shots(
            *(_plain(numbers) for numbers in (origin_m, direction, times, t_min)),
            first_shot,
            np.require(bodies.shape, np.uint8, "CW"),
            _plain(bodies.numbers),
            np.stack([np.cos(yaw), np.sin(yaw)], axis=1),
            *(_plain(numbers) for numbers in (bodies.density, bodies.velocity, bodies.number)),
            search_order(bodies),
            _QUANTILES,
        )
    )


def _plain(numbers: F64) -> F64:
    """Return numbers as the kernel takes them, without a copy where they are so already."""
    return np.require(numbers, np.float64, "CW")


def search_order(bodies: Bodies) -> I64:
    """Put neighbours of about one size beside each other, so that they can be left out together.

    Parameters
    ----------
    bodies : Bodies
        Any.

    Returns
    -------
    (n,) int64
        Row of every body, moving ones last, small ones first, then along a curve through space (Morton 1966).
    """
    if not len(bodies):
        return np.empty(0, np.int64)
    points = bodies.numbers.reshape(-1, 3, 3)
    ends = np.where((bodies.shape == Shape.TRIANGLE)[:, None], 3, np.where(bodies.shape == Shape.CONE, 2, 1)[:, None])
    used = np.arange(3) < ends
    low = np.where(used[:, :, None], points, np.inf).min(axis=1)
    high = np.where(used[:, :, None], points, -np.inf).max(axis=1)
    size = np.where(bodies.shape >= Shape.ELLIPSOID, 2 * points[:, 1].max(axis=1), (high - low).max(axis=1))
    cell = np.floor((low + high - (low + high).min(axis=0)) * 0.5).astype(np.uint64)
    code = np.zeros(len(bodies), np.uint64)
    for bit in range(12):
        for axis in range(3):
            code |= ((cell[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    moves = bodies.velocity.any(axis=1)
    return np.lexsort((code, np.floor(np.log2(np.maximum(size, 0.5)) / 2), moves)).astype(np.int64)
