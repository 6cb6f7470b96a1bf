"""Random arguments for the ground and curb loops, with many ties and edge cases."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator

from prc_cli.methods.sequential_angle.curb import CurbState
from prc_cli.methods.sequential_angle.thresholds import (
    CurbThresholds,
    GroundState,
    GroundThresholds,
)
from prc_cli.reference.sequential_angle import curb as oracle_curb
from prc_cli.reference.sequential_angle.ground import histogram_of, potential_heights, to_bin


def heights(rng: Generator, n: int) -> Any:
    """Heights of a road, of car roofs, at the ends of the histogram, and on the edges of its coarse
    bins."""
    level = rng.choice([-1.8, -1.8, -100.0, -0.01, 0.3])
    return (
        level
        + rng.choice([0.0, 0.0, 1.5, 0.15, 70.0, -400.0], n) * (rng.random(n) < 0.4)
        + rng.integers(-30, 31, n) / 1e3
    )


def height_case(rng: Generator) -> tuple[Any, ...]:
    return heights(rng, int(rng.choice([0, 1, 2, 7, 60]))), float(rng.choice([0.05, 0.0, 0.5]))


def rows(rng: Generator) -> tuple[Any, ...]:
    """Rows with roads at several heights and slopes, line angles in groups, runs broken by other
    surfaces."""
    n_rows = int(rng.integers(1, 4))
    n = int(rng.choice([1, 5, 14, 30, 70]))
    shape = (n_rows, n)
    kinds = rng.choice([0, 2, 3, 1, 4], p=[0.1, 0.75, 0.1, 0.03, 0.02], size=shape)
    step = int(rng.choice([1, 8]))
    surface = np.where(
        rng.random() < 0.3, 2, np.repeat(kinds[:, ::step], step, axis=1)[:, :n]
    ).astype(np.uint8)
    surface[rng.random(shape) < rng.choice([0.0, 0.1])] = 0
    x = np.cumsum(rng.choice([0.02, 0.05, 0.5], shape), axis=1) + 1.0
    level = np.repeat(rng.choice([-1.8, -1.8, -1.75, -1.6, -0.3], shape)[:, ::15], 15, axis=1)[
        :, :n
    ]
    z = level + rng.integers(-5, 6, shape) / 1000 + rng.choice([0.0, 0.05, -0.05]) * x
    xyz = np.stack([x, np.zeros(shape), z], axis=-1).astype(np.float32)
    xyz[surface == 0] = np.nan
    far = float(rng.choice([0.0, 5.0, 10.3125, 20.0]))
    groups = np.repeat(rng.choice([90.0, 90.0, 90.0 + far], shape)[:, ::7], 7, axis=1)[:, :n]
    phihat = (groups + rng.integers(-8, 9, shape) / 8 * rng.choice([0.0, 2.5, 5.0])).astype(
        np.float32
    )
    ahead = np.full(shape, -1, np.int32)
    for row in range(n_rows):
        valid = np.flatnonzero(surface[row] != 0)
        ahead[row, valid[:-1]] = valid[1:]
    phihat[(surface != 2) | (ahead < 0) | (rng.random(shape) < rng.choice([0.0, 0.3]))] = np.nan
    n_beams = rng.integers(max(n - 3, 1), n + 1, n_rows).astype(np.int32)
    thresholds = GroundThresholds()._replace(
        range_noise_m=float(rng.choice([0.0, 0.001, 0.005])),
        first_run=int(rng.choice([3, 4, 10])),
        lowest_points=int(rng.choice([1, 5])),
        height_points=int(rng.choice([0, 5, 12])),
        mode_samples=int(rng.choice([2, 3])),
        bandwidth_deg=float(rng.choice([5.0, 2.0])),
        growth_points=int(rng.choice([2, 10])),
        growth_height_m=float(rng.choice([0.1, 0.01])),
        start_heights=int(rng.choice([0, 5, 50])),
        height_tolerance=float(rng.choice([0.1, 0.05])),
    )
    horizontal = np.hypot(xyz[..., 0], xyz[..., 1])
    return surface, xyz, horizontal, phihat, ahead, n_beams, thresholds


def ground_case(rng: Generator) -> tuple[Any, ...]:
    *row, thresholds = rows(rng)
    known = [to_bin(z) for z in heights(rng, int(rng.choice([0, 3, 20])))]
    z_g = float(rng.choice([-1.8, -1.8, np.nan, -1.62, 0.0]))
    state = GroundState(histogram_of(known), z_g, int(rng.integers(0, 3)))
    return *row, potential_heights(*row, thresholds), state, thresholds


def possible_case(rng: Generator) -> tuple[Any, ...]:
    shape = (int(rng.integers(1, 4)), int(rng.choice([1, 4, 20, 60])))
    surface = rng.choice([0, 1, 2, 3, 4], p=[0.2, 0.1, 0.2, 0.45, 0.05], size=shape).astype(
        np.uint8
    )
    range_m = (
        5.0
        + rng.integers(-2, 3, shape) * rng.choice([0.0, 0.0078125, 0.5])
        - np.arange(shape[1]) / 64
    ).astype(np.float32)
    z = np.where(rng.random(shape) < 0.05, 0.5, -1.8 + np.arange(shape[1]) * 0.05)
    xyz = np.stack([range_m, range_m, z], axis=-1).astype(np.float32)
    range_m[surface == 0] = np.nan
    xyz[surface == 0] = np.nan
    ground = (surface == 2) & (np.arange(shape[1]) < rng.integers(0, shape[1] + 1, (shape[0], 1)))
    z_g = np.full(shape[0], rng.choice([-1.8, -2.5]), np.float32)
    thresholds = CurbThresholds()._replace(
        under_points=int(rng.choice([1, 5, 30])),
        under_m=float(rng.choice([0.01, 0.0078125])),
        search_height_m=2.0,
    )
    return surface, range_m, xyz, ground, z_g, thresholds


def lines_of_verticals(
    rng: Generator,
    n_lines: int,
    n_sides: int,
    n: int,
) -> tuple[Any, ...]:
    """Low steps, walls and single points on a grid of 0.1 m or 0.25 m, so that distances and
    heights tie."""
    shape = (n_lines * n_sides, n)
    surface = np.where(
        rng.random(shape) < rng.choice([0.2, 0.5, 0.8]), 3, rng.choice([0, 2], shape)
    ).astype(np.uint8)
    step = rng.choice([0.0625, 0.125, 0.25])
    z = rng.integers(0, 3, shape) * rng.choice([0.0625, 0.125]) - 1.75
    lines = np.repeat(np.arange(n_lines), n_sides)[:, None]
    xyz = np.stack(
        [5 + np.arange(n) * step + 0 * lines, lines * step + np.zeros(n), z], axis=-1
    ).astype(np.float32)
    xyz[surface == 0] = np.nan
    signed = rng.choice([0.0, 10.0, 20.0, 40.0, np.nan], shape, p=[0.3, 0.3, 0.2, 0.1, 0.1]).astype(
        np.float32
    )
    possible = rng.integers(-n, n, shape[0]).clip(-1).astype(np.int32)
    return surface, xyz, signed, possible


def connect_case(rng: Generator) -> tuple[Any, ...]:
    """A call in the middle of a stream: what came before is what the twin itself carried over."""
    n_sides = int(rng.integers(1, 3))
    n = int(rng.choice([1, 3, 8, 16]))
    thresholds = CurbThresholds()._replace(
        min_lines=int(rng.choice([1, 2, 3, 5])),
        grouping_m=float(rng.choice([0.3, 0.25, 0.125])),
        max_height_m=float(rng.choice([0.2, 0.125])),
        min_height_m=float(rng.choice([0.0, 0.0, 0.125])),
        max_lines=int(rng.choice([1, 2, 4, 200])),
    )
    regions = CurbState.start(n_sides, n, CurbThresholds()).regions
    above = np.full((n_sides, n, 3), np.nan, np.float32)
    angles = np.full(((thresholds.min_lines - 1) * n_sides, n), np.nan, np.float32)
    for _ in range(rng.integers(0, 3)):
        surface, xyz, signed, possible = lines_of_verticals(
            rng, int(rng.integers(1, 4)), n_sides, n
        )
        _, regions = oracle_curb.connect_verticals(
            surface, xyz, signed, possible, n_sides, above, angles, regions, thresholds, False
        )
        above = xyz[-n_sides:].copy()
        angles = np.concatenate([angles, signed])[len(signed) :]
    new = lines_of_verticals(rng, int(rng.integers(0, 6)), n_sides, n)
    return *new, n_sides, above, angles, regions, thresholds, bool(rng.random() < 0.3)


CASES: dict[str, Callable[[Generator], tuple[Any, ...]]] = {
    "connect_verticals": connect_case,
    "ground_rows": ground_case,
    "main_height": height_case,
    "possible_curbs": possible_case,
    "potential_heights": rows,
}

TOLERANCES: dict[str, float] = {}
"""Kernels whose floats may differ from the twin's by this much, absolute.

All others are equal bit for bit.
"""
