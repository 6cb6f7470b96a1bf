"""Slow twin of :mod:`prc_cli.simulation.casting_loops`, from NumPy alone.

Every body against every shot.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from math import floor, sqrt
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64, I32, Mask
from prc_cli.simulation.thresholds import CastBodies

U64: TypeAlias = NDArray[np.uint64]
Surfaces: TypeAlias = tuple[F64, F64, F64, F64]
"""Nearer and farther range, and the cosines of incidence there."""

INF = np.inf


def cast_shots(
    origin: F64,
    direction: F64,
    time_s: F64,
    t_min: F64,
    first_shot: int,
    bodies: CastBodies,
    quantiles: F64,
) -> tuple[F64, I32, F64]:
    """Find the nearest surface of every shot.

    See :func:`prc_cli.simulation.casting_loops.cast_shots`.
    """
    shape, numbers, turn, density, velocity, number = bodies
    t = np.full(time_s.shape, INF)
    body = np.full(time_s.shape, -1, dtype=np.int32)
    facing = np.zeros(time_s.shape)
    begin = np.where(t_min < 1e9, np.maximum(t_min, 0.0), INF)
    shot = (
        np.arange(first_shot, first_shot + time_s.size, dtype=np.int64)
        .reshape(time_s.shape)
        .astype(np.uint64)
    )
    for b in range(len(shape)):
        place = [
            origin[:, :, 0] - velocity[b, 0] * time_s,
            origin[:, :, 1] - velocity[b, 1] * time_s,
            origin[:, :, 2],
        ]
        rays = Rays(place, [direction[:, :, k] for k in range(3)], begin, shot)
        with np.errstate(all="ignore"):
            if shape[b] == 0:
                distance, cosine = triangle(rays, numbers[b])
            elif shape[b] == 1:
                distance, cosine = nearest(rays, cone(rays, numbers[b]))
            else:
                rays = rays.seen_from(numbers[b, :3], turn[b])
                surfaces = (ellipsoid if shape[b] == 2 else box)(rays, numbers[b, 3:6])
                if density[b] > 0.0:
                    distance, cosine = leaves(
                        rays, surfaces, 0.5 * density[b], number[b], quantiles
                    )
                else:
                    distance, cosine = nearest(rays, surfaces)
        nearer = distance < t
        t[nearer] = distance[nearer]
        body[nearer] = b
        facing[nearer] = cosine[nearer]
    return t, body, facing


@dataclass(frozen=True)
class Rays:
    """All shots: three arrays of coordinates, three of directions, where to begin, and numbers."""

    o: list[F64]
    d: list[F64]
    begin: F64
    shot: U64

    def seen_from(self, centre: F64, turn: F64) -> Rays:
        """Return the shots in the coordinates of a body that is turned about the vertical."""
        c, s = turn
        x, y, z = (o - m for o, m in zip(self.o, centre, strict=True))
        dx, dy, dz = self.d
        return Rays(
            [c * x + s * y, c * y - s * x, z],
            [c * dx + s * dy, c * dy - s * dx, dz],
            self.begin,
            self.shot,
        )


def dot(a: list[F64], b: list[F64]) -> F64:
    """Return the dot product, added up in the order x, y, z."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: list[F64], b: list[F64]) -> list[F64]:
    """Return the cross product."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def triangle(rays: Rays, numbers: F64) -> tuple[F64, F64]:
    """Intersect shots with a triangle: range and cosine of incidence."""
    a, b, c = (list(corner) for corner in numbers.reshape(3, 3))
    e1 = [p - q for p, q in zip(b, a, strict=True)]
    e2 = [p - q for p, q in zip(c, a, strict=True)]
    normal = cross(e1, e2)
    square = dot(normal, normal)
    missed = np.full(rays.begin.shape, INF)
    if not square > 1e-5 * 1e-5 * (dot(e1, e1) * dot(e2, e2)):
        return missed, missed
    length = np.sqrt(square)
    to_a = [p - o for p, o in zip(a, rays.o, strict=True)]
    slope = dot(rays.d, normal)
    t = dot(to_a, normal) / slope
    across = cross(to_a, rays.d)
    share1 = dot(e2, across) / slope
    share2 = -(dot(e1, across) / slope)
    inside = (share1 >= -1e-9) & (share2 >= -1e-9) & (share1 + share2 <= 1.0 + 1e-9)
    met = inside & (np.abs(slope) > 1e-5 * length) & (t > rays.begin)
    return np.where(met, t, missed), np.abs(slope) / length


def nearest(rays: Rays, surfaces: Surfaces) -> tuple[F64, F64]:
    """Take the first surface behind the beginning."""
    low, high, low_cosine, high_cosine = surfaces
    first = (low > rays.begin) & (low < INF)
    second = high > rays.begin
    t = np.where(first, low, np.where(second, high, INF))
    cosine = np.where(low == t, low_cosine, high_cosine)
    return t, np.where(cosine < 1.0, cosine, 1.0)


def roots(a: F64, b: F64, c: F64) -> tuple[F64, F64]:
    """Return the smaller and the larger root of a t^2 + 2 b t + c, NaN where there is none."""
    root = np.sqrt(b * b - a * c)
    q = np.where(b > 0.0, -(b + root), root - b)
    t = q / a
    two = c / q
    return np.where(t < two, t, two), np.where(t < two, two, t)


def cone(rays: Rays, numbers: F64) -> Surfaces:
    """Intersect shots with a truncated cone that is open at both ends."""
    axis = [numbers[3] - numbers[0], numbers[4] - numbers[1], numbers[5] - numbers[2]]
    height = np.sqrt(dot(axis, axis))
    axis = [k / height for k in axis]
    widening = (numbers[7] - numbers[6]) / height
    m = [o - p for o, p in zip(rays.o, numbers[:3], strict=True)]
    along = dot(m, axis)
    rise = dot(rays.d, axis)
    radius = numbers[6] + widening * along
    growth = widening * rise
    a = dot(rays.d, rays.d) - rise * rise - growth * growth
    b = dot(m, rays.d) - along * rise - growth * radius
    c = dot(m, m) - along * along - radius * radius
    ranges = roots(a, b, c)
    cosines = [
        np.abs(b + t * a) / ((radius + growth * t) * np.sqrt(1.0 + widening * widening))
        for t in ranges
    ]
    places = [along + t * rise for t in ranges]
    low, high = (
        np.where((p >= 0.0) & (p <= height), t, INF) for t, p in zip(ranges, places, strict=True)
    )
    return low, high, cosines[0], cosines[1]


def ellipsoid(rays: Rays, half: F64) -> Surfaces:
    """Intersect shots with an ellipsoid around the origin."""
    o, d = (
        [v * (1.0 / h) for v, h in zip(vector, half, strict=True)] for vector in (rays.o, rays.d)
    )
    a = dot(d, d)
    b = dot(o, d)
    c = dot(o, o) - 1.0
    low, high = roots(a, b, c)

    def cosine(t: F64) -> F64:
        normal = [(p + t * q) * (1.0 / h) for p, q, h in zip(o, d, half, strict=True)]
        return np.asarray(np.abs(b + t * a) / np.sqrt(dot(normal, normal)))

    return low, high, cosine(low), cosine(high)


def box(rays: Rays, half: F64) -> Surfaces:
    """Intersect shots with a box around the origin (slab method)."""
    low = np.full(rays.begin.shape, -INF)
    high = np.full(rays.begin.shape, INF)
    low_cosine = np.zeros(rays.begin.shape)
    high_cosine = np.zeros(rays.begin.shape)
    for o, d, h in zip(rays.o, rays.d, half, strict=True):
        ends = np.stack([(-h - o) / d, (h - o) / d])
        along = d == 0.0
        enter = np.where(along, np.where(np.abs(o) > h, INF, -INF), ends.min(axis=0))
        leave = np.where(along, np.where(np.abs(o) > h, -INF, INF), ends.max(axis=0))
        low_cosine = np.where(enter > low, np.abs(d), low_cosine)
        high_cosine = np.where(leave < high, np.abs(d), high_cosine)
        low = np.maximum(low, enter)
        high = np.minimum(high, leave)
    missed = low > high
    return np.where(missed, INF, low), np.where(missed, INF, high), low_cosine, high_cosine


def mix(x: U64) -> U64:
    """Mix bits (SplitMix64)."""
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        x = (x ^ (x >> np.uint64(shift))) * np.uint64(factor)
    return x ^ (x >> np.uint64(31))


def uniform(x: U64) -> F64:
    """Return numbers in [0, 1)."""
    numbers: F64 = (mix(x) >> np.uint64(11)).astype(np.float64) / 2.0**53
    return numbers


def leaves(
    rays: Rays,
    surfaces: Surfaces,
    rate: float,
    number: float,
    quantiles: F64,
) -> tuple[F64, F64]:
    """Send shots through clumps of leaves, all at once from cell to cell.

    Range and cosine of incidence.
    """
    add: Callable[[int], U64] = lambda k: np.array([k], dtype=np.uint64)  # noqa: E731
    body = mix(np.array([number]).astype(np.uint64) + add(0x9E3779B97F4A7C15))
    again = np.floor(np.where(rays.begin < 1e9, rays.begin, 0.0) * 1024.0).astype(np.uint64) * add(
        0x8CB92BA72F3D8DD7
    )
    key = mix(body ^ mix(rays.shot + add(0xD1B54A32D192ED03))) ^ again
    left = quantiles[
        (mix(key + add(0xABC98388FB8FAC03)) >> np.uint64(11)).astype(np.int64) % len(quantiles)
    ]
    enter, leave = surfaces[:2]
    now = np.maximum(enter, rays.begin)
    t = np.full(now.shape, INF)
    alive: Mask = (enter < leave) & (now < leave) & (rays.begin < 1e9)
    cell = [np.floor((o + now * d) / 0.25) for o, d in zip(rays.o, rays.d, strict=True)]
    while alive.any():
        ends = np.stack(
            [
                np.where(d == 0.0, INF, (np.where(d > 0.0, k + 1.0, k) * 0.25 - o) * (1.0 / d))
                for k, o, d in zip(cell, rays.o, rays.d, strict=True)
            ]
        )
        then = np.minimum(ends.min(axis=0), leave)
        x, y, z = (np.where(alive, k, 0.0).astype(np.int64).astype(np.uint64) for k in cell)
        mark = (
            x * add(0xD6E8FEB86659FD93) + y * add(0xA0761D6478BD642F) + z * add(0xE7037ED1A0B428DB)
        )
        u = uniform(body ^ mark)
        thickness = rate * (4.0 * u * u * u)
        gain = thickness * np.maximum(then - now, 0.0)
        met = alive & (gain >= left)
        t[met] = np.minimum(now + left / thickness, then)[met]
        alive &= ~met & (then < leave)
        left = np.where(alive, left - gain, left)
        now = np.maximum(now, then)
        side = np.argmax(ends == then, axis=0)
        cell = [
            np.where(alive & (side == k), cell[k] + np.where(rays.d[k] > 0.0, 1.0, -1.0), cell[k])
            for k in range(3)
        ]
    return t, np.sqrt(uniform(key + add(0x2545F4914F6CDD1D)))


def aim_shots(position: F64, turn: F64, columns: F64) -> tuple[F64, F64]:
    """Place and turn every shot; see :func:`prc_cli.simulation.casting_loops.aim_shots`."""
    n_lines = len(position)
    n_knots = position.shape[1] - 1
    m = len(columns)
    origin = np.empty((n_lines, m, 3))
    direction = np.empty((n_lines, m, 3))
    for line, column in np.ndindex(n_lines, m):
        share = float(Fraction(column * n_knots, m))
        k = floor(share)
        share -= k
        start = position[line, k]
        end = position[line, k + 1]
        origin[line, column] = start + (end - start) * share
        first, last = (
            [
                sum([float(a) * float(b) for a, b in zip(row, columns[column], strict=True)])
                for row in turn[line, knot]
            ]
            for knot in (k, k + 1)
        )
        way = np.array(first) + (np.array(last) - np.array(first)) * share
        direction[line, column] = way / sqrt(sum(float(part) * float(part) for part in way))
    return origin, direction
