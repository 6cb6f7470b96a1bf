"""Random arguments for the car loops, with many ties and edge cases."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator

from prc_cli.core.types import F32, F64, I32, U8
from prc_cli.methods.sequential_angle.thresholds import (
    DividerThresholds,
    FourierThresholds,
)

MISSING, DENSE, H, V, UNDECIDED = range(5)


def surfaces(rng: Generator, n_rows: int, n: int) -> tuple[U8, I32]:
    """Labels that stay for a while, and the beams of every row; what comes after them is fill."""
    codes = rng.choice(
        [MISSING, DENSE, H, V, UNDECIDED], (n_rows, n), p=rng.dirichlet([2, 0.2, 4, 4, 0.1])
    )
    stay = rng.random((n_rows, n)) < rng.choice([0.0, 0.5, 0.8])
    for k in range(1, n):
        codes[:, k] = np.where(stay[:, k], codes[:, k - 1], codes[:, k])
    n_beams = rng.integers(0, n + 1, n_rows) if rng.random() < 0.3 else np.full(n_rows, n)
    codes[np.arange(n) >= n_beams[:, None]] = MISSING
    return codes.astype(np.uint8), n_beams.astype(np.int32)


def size(rng: Generator) -> tuple[int, int]:
    return int(rng.integers(1, 4)), int(rng.choice([1, 2, 5, 20, 60]))


def trigger_case(rng: Generator) -> tuple[Any, ...]:
    surface, n_beams = surfaces(rng, *size(rng))
    increments = (
        rng.integers(-8, 9, (3, 3)) / 4.0 if rng.random() < 0.5 else rng.normal(0, 1, (3, 3))
    )
    return surface, n_beams, increments, float(rng.choice([0.0, 1.0, 2.5]))


def geometry(rng: Generator, surface: U8) -> tuple[F32, F32, F32]:
    """Ranges, coordinates and horizontal distances on a 1/4 m grid, so that lengths meet their
    thresholds exactly."""
    n_rows, n = surface.shape
    flat = rng.random() < 0.4
    steps = rng.choice([0.0, 0.25, 0.25, 0.5, 1.0, -0.25, 3.0, 4.0, 4.25, -4.25], (n_rows, n))
    climbs = (
        np.where(rng.random((n_rows, n)) < 0.1, 0.25, 0.0)
        if flat
        else rng.integers(-2, 4, (n_rows, n)) / 4.0
    )
    h = np.maximum(0.25, 2.0 + np.cumsum(np.abs(steps) if flat else steps, axis=1))
    z = -2.0 + np.minimum(np.cumsum(climbs, axis=1), rng.choice([2.0, 6.0]))
    turned = rng.integers(2, size=(n_rows, 1)) == 1
    xyz = np.stack([np.where(turned, 0.0, h), np.where(turned, -h, 0.0), z], axis=-1).astype(
        np.float32
    )
    gone = surface == MISSING
    xyz[gone] = np.nan
    horizontal = np.hypot(xyz[..., 0], xyz[..., 1])
    return np.sqrt(horizontal**2 + xyz[..., 2] ** 2), xyz, horizontal


def angles(rng: Generator, shape: tuple[int, int]) -> F32:
    found = rng.choice([-5.0, 20.0, 0.0, 90.0, -90.0, 45.0, -20.0], shape)
    found[rng.random(shape) < 0.2] = np.nan
    return found.astype(np.float32)


def heights(rng: Generator, n_rows: int) -> F32:
    return rng.choice([-2.0, -2.0, -1.0, np.nan], n_rows).astype(np.float32)


def interval_case(rng: Generator) -> tuple[Any, ...]:
    surface, n_beams = surfaces(rng, *size(rng))
    ranges, xyz, horizontal = geometry(rng, surface)
    return (
        surface,
        ranges,
        xyz,
        horizontal,
        angles(rng, surface.shape),
        n_beams,
        rng.random(len(surface)) < 0.8,
        heights(rng, len(surface)),
        divider_thresholds(rng),
    )


def divider_thresholds(rng: Generator) -> DividerThresholds:
    return DividerThresholds(
        height_m=float(rng.choice([0.5, 2.0, 100.0])),
        tall_m=float(rng.choice([0.0, 1.0, 2.5, 101.0])),
        sudden_from_deg=-5.0,
        sudden_to_deg=20.0,
        change_chord_m=float(rng.choice([0.0, 0.08, 0.25, 0.75])),
        change_reach=int(rng.choice([1, 4, 200])),
        under_points=int(rng.choice([0, 1, 30])),
        under_m=float(rng.choice([0.0, 0.01])),
        separation_m=4.0,
        return_points=int(rng.choice([0, 1, 5])),
        from_start=bool(rng.integers(2)),
        flat_length_m=float(rng.choice([0.5, 1.5, 3.0])),
        flat_residual_m=0.0503,
        flat_slope=float(np.tan(np.deg2rad(rng.choice([10.0, 25.0])))),
        flat_step_m=float(rng.choice([0.25, np.inf])),
        vertical_extent_m=float(rng.choice([0.0, 0.25, 1.25])),
        vertical_top_m=float(rng.choice([-np.inf, 1.0, 2.0])),
        vertical_slope=float(np.tan(np.deg2rad(rng.choice([3.0, 30.0])))),
        straight_points=int(rng.choice([1, 3, 6])),
        straight_extent_m=float(rng.choice([0.0, 0.25, 1.0, np.inf])),
        straight_m=float(rng.choice([0.0301, 0.1303])),
        straight_slope=float(np.tan(np.deg2rad(rng.choice([2.0, 30.0])))),
        lean_noise_m=float(rng.choice([0.0, 0.0503])),
    )


def intervals(rng: Generator, surface: U8) -> I32:
    """Stretches of rows from return to return, as the dividers make them."""
    found = []
    for row, codes in enumerate(surface):
        returns = np.flatnonzero(codes != MISSING)
        edges = np.sort(
            rng.choice(returns, min(len(returns), 2 * int(rng.integers(4))) // 2 * 2, replace=False)
        )
        found += [(row, first, last) for first, last in edges.reshape(-1, 2)]
    return np.array(found, np.int32).reshape(-1, 3)


def cut_case(rng: Generator) -> tuple[Any, ...]:
    surface, n_beams = surfaces(rng, *size(rng))
    _, xyz, horizontal = geometry(rng, surface)
    cuts = intervals(rng, surface)
    return (
        surface,
        xyz,
        horizontal,
        n_beams,
        cuts,
        heights(rng, len(surface)),
        divider_thresholds(rng),
    )


def firm_case(rng: Generator) -> tuple[Any, ...]:
    surface, _ = surfaces(rng, *size(rng))
    return (
        surface,
        intervals(rng, surface),
        float(rng.choice([0.0, 0.25, 0.5, 1.0])),
    )


def high_case(rng: Generator) -> tuple[Any, ...]:
    surface, n_beams = surfaces(rng, *size(rng))
    return (
        surface,
        geometry(rng, surface)[1],
        n_beams,
        heights(rng, len(surface)),
        float(rng.choice([0.5, 2.5])),
    )


def spectrum_case(rng: Generator) -> tuple[Any, ...]:
    n = int(rng.choice([8, 20, 33, 64, 200, 600]))
    signal: F64 = rng.choice([0.0, 45.0, 90.0], (2, 1)) + np.zeros((2, n))
    period = int(rng.choice([2, 4, 8, n]))
    signal += rng.choice([0.0, 15.0, 45.0, 90.0]) * (np.arange(n) % period < period / 2)
    signal += rng.choice([0.0, 10.0, 60.0]) * rng.standard_normal((2, n))
    signal *= np.where(rng.random((2, n)) < rng.choice([0.0, 0.1, 0.5]), -1, 1)
    signal[rng.random((2, n)) < rng.choice([0.0, 0.3])] = np.nan
    edges = (
        np.sort(rng.integers(0, n, (5, 2)), axis=1)
        if rng.random() < 0.7
        else np.array([[0, n - 1]])
    )
    rows = rng.integers(0, 2, (len(edges), 1))
    found = np.hstack([rows, edges]).astype(np.int32)
    thresholds = FourierThresholds(
        band=float(rng.choice([0.125, 0.25, 0.01, 0.45])),
        ratio=float(rng.choice([0.5, 0.25, 0.9])),
        window=int(rng.choice([8, 64, 2048])),
        longest=int(rng.choice([0, 20, 33])),
    )
    return signal.astype(np.float32), found, thresholds


def shares(rng: Generator) -> float:
    return float(rng.choice([0.0, 0.05, 0.5]))


def car_case(rng: Generator) -> tuple[Any, ...]:
    surface, _ = surfaces(rng, *size(rng))
    _, xyz, horizontal = geometry(rng, surface)
    limit = rng.choice([1.0, 3.0, np.inf], len(surface)).astype(np.float32)
    low = rng.choice([-2.0, -1.0, np.nan, -np.inf], len(surface)).astype(np.float32)
    return intervals(rng, surface), horizontal, xyz, surface, limit, low


def class_case(rng: Generator) -> tuple[Any, ...]:
    surface, _ = surfaces(rng, *size(rng))
    _, _, horizontal = geometry(rng, surface)
    ground, car, curb = (rng.random(surface.shape) < shares(rng) for _ in range(3))
    car &= surface != MISSING
    codes = np.array([0, 5, 7, 8, 1], np.uint8)
    return surface, ground, car, horizontal, curb & (surface != MISSING), codes


def beyond_case(rng: Generator) -> tuple[Any, ...]:
    labels = rng.choice([0, 0, 7, 8], size(rng)).astype(np.uint8) * np.uint8(rng.random() < 0.5)
    ranges = np.where(rng.random(labels.shape) < shares(rng), 301.0, np.nan).astype(np.float32)
    return np.where(labels == 0, ranges, np.float32(5.0)), labels


CASES: dict[str, Callable[[Generator], tuple[Any, ...]]] = {
    "car_intervals": interval_case,
    "combine_classes": class_case,
    "cut_verticals": cut_case,
    "firm_intervals": firm_case,
    "first_high_verticals": high_case,
    "first_triggers": trigger_case,
    "mark_beyond": beyond_case,
    "mark_cars": car_case,
    "stable_intervals": spectrum_case,
}

TOLERANCES: dict[str, float] = {}
"""Kernels whose floats may differ from the twin's by this much, absolute.

All others are equal bit for bit.
"""
