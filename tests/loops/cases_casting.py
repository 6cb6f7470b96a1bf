"""Random worlds and scan lines for the caster, with many ties, edge cases, and hard cases for
windows of columns."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator

from prc_cli.core.types import F64
from prc_cli.simulation.thresholds import CastBodies

N_QUANTILES = 64
QUANTILES: F64 = -np.log1p(-(np.arange(N_QUANTILES) + 0.5) / N_QUANTILES)


def rounded(rng: Generator, shape: tuple[int, ...], scale: float = 8.0) -> F64:
    """Coordinates on a coarse grid, so that faces, corners and planes coincide.

    Now and then anywhere.
    """
    numbers = rng.uniform(-scale, scale, shape)
    return numbers if rng.random() < 0.3 else np.round(numbers * 2) / 2


def one_body(rng: Generator) -> tuple[int, F64]:
    shape = int(rng.integers(4))
    numbers = rounded(rng, (9,))
    kind = rng.random()
    if shape == 0:
        if (
            kind < 0.2
        ):  # a degenerate triangle: two corners or all three in one place or on one line
            numbers[6:] = (
                numbers[:3] if kind < 0.1 else numbers[:3] + 2.0 * (numbers[3:6] - numbers[:3])
            )
        elif kind < 0.4:  # a long one
            numbers[3:6] += rng.choice([-500.0, 500.0], 3) * (rng.random(3) < 0.5)
        elif kind < 0.6:  # level
            numbers[[2, 5, 8]] = -2.0
    elif shape == 1:
        numbers[6:] = [*rng.choice([0.0, 0.01, 0.5, 2.0], 2), 0.0]
        if kind < 0.3:
            numbers[3:5] = numbers[:2]
    else:
        numbers[3:6] = rng.choice([0.01, 0.5, 1.0, 4.0, 12.0], 3)
        numbers[6:] = [rng.choice([0.0, 0.5 * np.pi, rng.uniform(-4, 4)]), 0.0, 0.0]
        if kind < 0.2:  # around the scanner
            numbers[:3] = 0.0
    return shape, numbers


def lines(rng: Generator) -> tuple[F64, F64, F64]:
    """Origins, directions and times of some lines of one of several scanners."""
    n_lines = int(rng.integers(1, 4))
    m = int(rng.choice([1, 2, 7, 60]))
    time = rng.choice([0.0, 1000.0]) + np.sort(
        rng.uniform(0, rng.choice([0.5, 5.0]), n_lines * m)
    ).reshape(n_lines, m)
    kind = rng.integers(5)
    if kind == 0:  # any directions whatever
        d = rng.normal(0, 1, (n_lines, m, 3))
    elif kind == 1:  # a static scanner: half planes, from low to high
        phi = rng.uniform(-4, 4, (n_lines, 1))
        el = np.linspace(-1.0, 0.5 * np.pi, m)
        d = np.stack(
            [np.cos(phi) * np.cos(el), np.sin(phi) * np.cos(el), np.sin(el) + 0 * phi], axis=2
        )
    else:
        # a profiler across the drive, maybe slanted, maybe with an attitude that changes within the
        # line
        span = rng.choice([0.5, 1.0, 1.02]) * 2 * np.pi * rng.choice([-1, 1])
        a = rng.choice([-np.pi, 0.0, 1.0]) + np.linspace(0, span, m, endpoint=False)
        d = np.stack([0 * a, np.sin(a), -np.cos(a)], axis=1)[None].repeat(n_lines, axis=0)
        slant = rng.choice([0.0, 0.25 * np.pi])
        if kind > 2:
            slant = slant + np.linspace(0.0, rng.choice([1e-3, 0.1]), m)
        x = d[:, :, 0].copy()
        z = d[:, :, 2].copy()
        d[:, :, 0] = np.cos(slant) * x + np.sin(slant) * z
        d[:, :, 2] = np.cos(slant) * z - np.sin(slant) * x
    o = np.zeros((n_lines, m, 3))
    if rng.random() < 0.7:
        o[:, :, 0] = rng.choice([0.1, 10.0]) * (time - time[0, 0])
        o[:, :, 1] = rng.choice([0.0, 0.5]) * np.sin(7 * time)
    with np.errstate(invalid="ignore"):
        unit = d / np.sqrt((d * d).sum(axis=2, keepdims=True))
    if rng.random() < 0.02:  # no line at all
        return o[:0], unit[:0], time[:0]
    return o, unit, time


def cast_case(rng: Generator) -> tuple[Any, ...]:
    origin, direction, time = lines(rng)
    start = time.min(initial=1000.0)
    n = int(rng.choice([0, 1, 2, 10, 10, 50]))
    bodies = [one_body(rng) for _ in range(n)]
    if n > 1 and rng.random() < 0.5:
        bodies[n // 2] = bodies[0]  # a tie of everything
    shape = np.array([one for one, _ in bodies], dtype=np.uint8)
    numbers = np.array([one for _, one in bodies]).reshape(n, 9)
    moves = rng.random(n) < rng.choice([0.0, 0.2, 1.0])
    velocity = moves[:, None] * rounded(rng, (n, 2), 15.0)
    numbers[:, :2] -= start * velocity  # near the scanner while it scans, not at time 0
    numbers[:, 3:5] -= np.where(shape[:, None] < 2, start, 0.0) * velocity
    numbers[:, 6:8] -= np.where(shape[:, None] < 1, start, 0.0) * velocity
    far = rng.choice([0.0, 1e6]) * np.array([1.0, -1.0, 0.0])  # national coordinates
    origin += far
    numbers[:, :3] += far
    numbers[shape < 2, 3:6] += far
    numbers[shape < 1, 6:9] += far
    yaw = np.where(shape >= 2, numbers[:, 6], 0.0)
    t_min = np.zeros(time.shape)
    if rng.random() < 0.5:
        t_min = rng.choice([0.0, 1.5, 6.0, 1e9, np.inf], time.shape)
    return (
        origin,
        direction,
        time,
        t_min,
        int(rng.choice([0, 2**40])),
        CastBodies(
            shape=shape,
            numbers=numbers,
            turn=np.stack([np.cos(yaw), np.sin(yaw)], axis=1),
            density=rng.choice([0.0, 0.5, 5.0], n),
            velocity=velocity,
            number=rng.integers(0, 2**53, n).astype(np.float64),
        ),
        QUANTILES,
    )


CASES: dict[str, Callable[[Generator], tuple[Any, ...]]] = {"cast_shots": cast_case}
