"""Vertical lines of a made-up street: ground, curb, bush, trunk, crown, wall, sky; the surface of every shot is
known."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from prc_cli.core.classes import Surface
from prc_cli.core.types import F64, U8
from prc_cli.methods.sequential_angle.lines import VerticalLines, split_sides, vertical_lines

HEIGHT = 1.8
"""Scanner above the road [m]."""


def lines_of(beam_rad: F64, range_m: NDArray[Any], max_range_m: float = 300.0) -> VerticalLines:
    """Half-lines of ranges in the plane of the scan; beams from 0 to pi, rising, are one side."""
    ranges = np.atleast_2d(range_m).astype(np.float32)
    return vertical_lines(ranges, None, beam_rad, split_sides(beam_rad), max_range_m)


def lines_through(points: Any) -> VerticalLines:
    """Lines through given points, (R, n, 2): horizontal distance and height [m]; NaN = missing."""
    xz = np.asarray(points, np.float64)
    xz = xz[None] if xz.ndim == 2 else xz
    xyz = np.stack([xz[..., 0], 0 * xz[..., 0], xz[..., 1]], axis=-1).astype(np.float32)
    n_rows, n = xz.shape[:2]
    ranges = np.linalg.norm(xyz, axis=-1).astype(np.float32)
    return VerticalLines(ranges, xyz, xyz[..., 0].copy(), np.full(n_rows, n, np.int32), np.linspace(0.1, 3, n)[None])


def street_lines(
    rng: Generator, n_lines: int, step_deg: float = 0.115, noise_m: float = 0.005
) -> tuple[VerticalLines, U8]:
    """Scan a street, each line another place.

    Returns
    -------
    lines : VerticalLines
    truth : (n_lines, n) uint8
        :class:`Surface` of what was hit.
    """
    beam_rad = np.deg2rad(np.arange(20.0, 150.0, step_deg))
    across, up = np.sin(beam_rad), -np.cos(beam_rad)
    n = len(beam_rad)
    ranges = np.full((n_lines, n), np.inf)
    truth = np.zeros((n_lines, n), np.uint8)

    def hit(line: int, distance: F64, there: NDArray[np.bool_], surface: Surface) -> None:
        nearer = there & (distance > 0) & (distance < ranges[line])
        ranges[line, nearer] = distance[nearer]
        truth[line, nearer] = surface

    def face(line: int, x: float, low: float, high: float) -> None:
        distance = x / across
        hit(line, distance, (distance * up >= low) & (distance * up < high), Surface.VERTICAL)

    def floor(line: int, z: float, near: float, far: float) -> None:
        with np.errstate(divide="ignore"):
            distance = z / up
        hit(line, distance, (distance * across >= near) & (distance * across < far), Surface.HORIZONTAL)

    def foliage(line: int, centre: tuple[float, float], radii: tuple[float, float], free_path: float) -> None:
        # the way of a beam through an ellipse, and how far it gets along it before it meets a leaf
        a = (across / radii[0]) ** 2 + (up / radii[1]) ** 2
        b = centre[0] * across / radii[0] ** 2 + centre[1] * up / radii[1] ** 2
        c = (centre[0] / radii[0]) ** 2 + (centre[1] / radii[1]) ** 2 - 1
        root = np.sqrt(np.maximum(b * b - a * c, 0))
        distance = (b - root) / a + rng.exponential(free_path, n)
        hit(line, distance, (b * b > a * c) & (distance < (b + root) / a), Surface.VEGETATION)

    for line in range(n_lines):
        curb, wall = rng.uniform(4, 8), rng.uniform(16, 22)
        walk = -HEIGHT + 0.15
        floor(line, -HEIGHT, 0, curb)
        face(line, curb, -HEIGHT, walk)
        floor(line, walk, curb, wall)
        if rng.random() < 0.8:
            face(line, wall, walk, rng.uniform(8, 14))
        bush, trunk = rng.uniform(9, 10.5), rng.uniform(12, 14)
        if rng.random() < 0.7:
            foliage(line, (bush, walk + 0.5), (rng.uniform(0.5, 0.9), rng.uniform(0.5, 0.8)), 0.25)
        if rng.random() < 0.8:
            crown = rng.uniform(3.5, 5.0)
            foliage(line, (trunk, crown), (rng.uniform(1.5, 2.5), rng.uniform(1.5, 2.5)), 0.8)
            face(line, trunk, walk, crown)
    noisy = ranges + rng.normal(0, noise_m, ranges.shape)
    noisy[np.isinf(ranges)] = np.nan
    return lines_of(beam_rad, noisy), truth
