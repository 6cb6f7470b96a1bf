"""Bodies in bulk: arrays of corners and radii in, :class:`prc_cli.simulation.world.Bodies` out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from prc_cli.core.types import F64, Mask
from prc_cli.simulation.world import Bodies, Material, Shape


def triangles(corners: F64, material: Material) -> Bodies:
    """Return triangles."""
    return _bodies(Shape.TRIANGLE, corners.reshape(-1, 9), material)


def cones(low: F64, high: F64, low_radius: F64, high_radius: F64, material: Material) -> Bodies:
    """Return truncated cones."""
    radii = np.stack([low_radius, high_radius, np.zeros_like(low_radius)], axis=-1)
    return _bodies(Shape.CONE, np.concatenate([low, high, radii], axis=-1).reshape(-1, 9), material)


def ellipsoids(centre: F64, half: F64, yaw: F64, material: Material, density: F64 | float = 0.0) -> Bodies:
    """Return ellipsoids, solid or filled with leaves."""
    turn = np.stack([yaw, np.zeros_like(yaw), np.zeros_like(yaw)], axis=-1)
    bodies = _bodies(Shape.ELLIPSOID, np.concatenate([centre, half, turn], axis=-1).reshape(-1, 9), material)
    return replace(bodies, density=np.broadcast_to(density, yaw.shape).astype(np.float64).ravel())


def _bodies(shape: Shape, numbers: F64, material: Material) -> Bodies:
    n = len(numbers)
    return Bodies(
        shape=np.full(n, shape, dtype=np.uint8),
        numbers=np.ascontiguousarray(numbers),
        material=np.full(n, material, dtype=np.uint8),
        density=np.zeros(n),
        velocity=np.zeros((n, 2)),
        number=np.zeros(n),
    )


def take(bodies: Bodies, which: Mask) -> Bodies:
    """Return some of the bodies, in their order."""
    return Bodies(
        bodies.shape[which],
        bodies.numbers[which],
        bodies.material[which],
        bodies.density[which],
        bodies.velocity[which],
        bodies.number[which],
    )


def footprints(bodies: Bodies) -> tuple[F64, F64]:
    """Return a circle on the map around every body."""
    numbers = bodies.numbers
    corners = numbers.reshape(-1, 3, 3)[:, :, :2]
    centre = numbers[:, :2].copy()
    reach = numbers[:, 3:5].max(axis=1, initial=0.0)

    flat = bodies.shape == Shape.TRIANGLE
    centre[flat] = corners[flat].mean(axis=1)
    reach[flat] = np.hypot(*np.moveaxis(corners[flat] - centre[flat, None], -1, 0)).max(axis=1, initial=0.0)

    round_ = bodies.shape == Shape.CONE
    centre[round_] = corners[round_, :2].mean(axis=1)
    half_length = np.hypot(*(corners[round_, 1] - corners[round_, 0]).T) / 2
    reach[round_] = half_length + numbers[round_, 6:8].max(axis=1, initial=0.0)

    boxes = bodies.shape == Shape.BOX
    reach[boxes] = np.hypot(numbers[boxes, 3], numbers[boxes, 4])
    return centre, reach
