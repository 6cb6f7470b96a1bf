"""Random arguments for the loops of the method for rings.

a few lines over ground with walls, strays and gaps.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator

from prc_cli.core.types import F32
from prc_cli.methods.rings import cells_loops as cells
from prc_cli.methods.rings.thresholds import (
    CellThresholds,
    GroundThresholds,
    LonelyThresholds,
    MarkThresholds,
    SoilThresholds,
)

ROOT = 2.0
CELLS = CellThresholds(half_m=8.0)


def scene(rng: Generator) -> F32:
    """Coordinates of rings on level ground, before walls and stray shots, (lines, M, 3) float32."""
    n_lines = int(rng.integers(1, 12))
    m = int(rng.integers(1, 9))
    step = rng.choice([0.05, 0.5])
    azimuth = step * np.arange(n_lines)[:, None]
    down = np.linspace(0.6, -0.1, m)
    with np.errstate(divide="ignore"):
        ranges = np.where(down > 0, 1.5 / np.sin(down), np.inf)
    ranges = np.minimum(np.tile(ranges, (n_lines, 1)), rng.choice([2.5, 4.0, 9.0, 1e3]))
    stray = rng.random(ranges.shape) < rng.choice([0.0, 0.1, 0.5])
    ranges = np.where(stray, rng.choice([1.0, 2.0, 2.125], ranges.shape), ranges)
    ranges += rng.integers(-2, 3, ranges.shape) * rng.choice([0.0, 0.015625])
    xyz = ranges[..., None] * np.stack(
        [
            np.cos(down) * np.cos(azimuth),
            np.cos(down) * np.sin(azimuth),
            -np.sin(down) + 0 * azimuth,
        ],
        axis=-1,
    )
    xyz[
        (ranges > 100) | (rng.random(ranges.shape) < rng.choice([0.0, 0.2, 1.0], p=[0.5, 0.4, 0.1]))
    ] = np.nan
    return xyz.astype(np.float32)


def placed(rng: Generator) -> tuple[F32, F32]:
    xyz = scene(rng)
    return xyz, np.sqrt(np.hypot(xyz[..., 0], xyz[..., 1])) * np.float32(ROOT)


def above(xyz: F32, rng: Generator) -> F32:
    return (xyz[..., 2] + rng.choice([1.5, 1.25, 2.0])).astype(np.float32)


def lowest_case(rng: Generator) -> tuple[Any, ...]:
    up = rng.choice([1.0, -1.0])
    return (
        *placed(rng),
        up,
        int(rng.integers(1, 5)),
        int(rng.integers(2, 9)),
        rng.choice([0.05, 0.5]),
    )


def walk_case(rng: Generator) -> tuple[Any, ...]:
    shape = int(rng.integers(1, 6)), int(rng.integers(1, 12))
    off = rng.choice([0.0, 0.1, 0.25, 1.0, -1.0], shape) + rng.choice([0.0, 0.125]) * np.arange(
        shape[1]
    )
    off[rng.random(shape) < rng.choice([0.0, 0.3, 1.0])] = np.nan
    return off.astype(np.float32), ((np.arange(shape[1]) + 0.5) / ROOT) ** 2, GroundThresholds()


def smooth_case(rng: Generator) -> tuple[Any, ...]:
    shape = int(rng.integers(1, 5)), int(rng.integers(1, 6))
    height, start = (
        rng.integers(-4, 5, shape) / 4 * rng.choice([0, 1], p=[0.1, 0.9]) for _ in range(2)
    )
    weight = rng.choice([0.0, 1.0, 3.0], shape)
    return (
        height,
        weight,
        start,
        rng.choice([0.0, 0.5]),
        int(rng.integers(0, 4)),
        bool(rng.random() < 0.5),
    )


def above_case(rng: Generator) -> tuple[Any, ...]:
    xyz, place = placed(rng)
    sector = int(rng.integers(1, 5))
    surface = -1.5 + rng.integers(-1, 2, (-(-len(xyz) // sector), int(rng.integers(2, 7)))) / 8
    return xyz, place, rng.choice([1.0, -1.0]), surface, sector, ROOT, GroundThresholds()


def mark_case(rng: Generator) -> tuple[Any, ...]:
    xyz, place = placed(rng)
    chosen = MarkThresholds(
        most_lines=2, smooth_m=rng.choice([0.02, 0.2]), base_m=rng.choice([0.2, 2.0])
    )
    return xyz, place, above(xyz, rng), 0.25, ROOT, rng.choice([0.05, 0.5]), chosen


def lonely_case(rng: Generator) -> tuple[Any, ...]:
    xyz = scene(rng)
    ranges = np.sqrt((xyz**2).sum(axis=-1)).astype(np.float32)
    light = rng.choice([0.0, 1.0, 10.0, 11.0], ranges.shape).astype(np.float32)
    is_lit = bool(rng.random() < 0.5)
    return (
        ranges,
        light if is_lit else light[:1, :1].copy(),
        is_lit,
        LonelyThresholds(reach_m=rng.choice([3.0, 25.0])),
    )


def fill_case(rng: Generator) -> tuple[Any, ...]:
    xyz = scene(rng)
    marks = rng.integers(0, 16, xyz.shape[:2]).astype(np.uint8)
    return xyz, above(xyz, rng), marks, rng.random(xyz.shape[:2]) < 0.2, CELLS


def filled(rng: Generator) -> tuple[Any, ...]:
    return cells.fill_cells(*fill_case(rng))


def measure_case(rng: Generator) -> tuple[Any, ...]:
    levels, sums, where, grid, _ = filled(rng)
    # sums of Python's loops differ in their last digits
    return grid, where, np.round(sums * 4096) / 4096, levels, CELLS


def mean_case(rng: Generator) -> tuple[Any, ...]:
    _, sums, where, grid, _ = filled(rng)
    return grid, where, rng.integers(-2, 3, len(where)) / 2, sums[:, 0].copy()


def join_case(rng: Generator) -> tuple[Any, ...]:
    _, _, where, grid, _ = filled(rng)
    return grid, where, rng.random(len(where)) < rng.choice([0.0, 0.5, 1.0])


def plant_case(rng: Generator) -> tuple[Any, ...]:
    xyz, heights, marks, _, _ = fill_case(rng)
    return (
        xyz,
        heights,
        marks,
        SoilThresholds(half_m=rng.choice([3.0, 8.0]), bias=rng.choice([-2.0, 0.0, 3.0])),
    )


CASES: dict[str, Callable[[Generator], tuple[Any, ...]]] = {
    "lowest_heights": lowest_case,
    "walk_outwards": walk_case,
    "smooth_surface": smooth_case,
    "heights_above": above_case,
    "mark_shots": mark_case,
    "lonely_shots": lonely_case,
    "fill_cells": fill_case,
    "measure_cells": measure_case,
    "mean_around": mean_case,
    "join_cells": join_case,
    "low_plants": plant_case,
}
