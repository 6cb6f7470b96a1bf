"""Inputs of the loops of angles, lines and calibration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator

from prc_cli.core.types import F32, F64, I32
from prc_cli.methods.sequential_angle.thresholds import (
    ChordThresholds,
    MarkovThresholds,
    SurfaceThresholds,
)

SHAPES = [(0, 5), (1, 1), (1, 2), (3, 1), (2, 7), (4, 30), (2, 90)]


def shape(rng: Generator) -> tuple[int, int]:
    return SHAPES[rng.integers(len(SHAPES))]


def lengths(rng: Generator, n_rows: int, n: int) -> I32:
    """Beams of every row: all, none, or some."""
    some = rng.integers(0, n + 1, n_rows)
    return np.where(rng.random(n_rows) < 0.6, n, some).astype(np.int32)


def points(rng: Generator, n_rows: int, n: int) -> tuple[F32, F32]:
    """Shots on a grid of 1/8 m, so that chords are exactly as long as the shortest allowed, or turn
    by 90 deg."""
    kind = rng.integers(3)
    if kind == 0:
        xyz = rng.integers(-3, 4, (n_rows, n, 3)) / 8 + [4.0, 0.0, 0.0]
    elif kind == 1:  # a walk that stands still now and then
        xyz = np.cumsum(rng.integers(-1, 2, (n_rows, n, 3)), axis=1) / 8 + [4.0, 0.0, 0.0]
    else:
        xyz = rng.normal([5.0, 0.0, -1.0], [1.0, 0.01, 1.0], (n_rows, n, 3))
    xyz[rng.random((n_rows, n)) < rng.choice([0.0, 0.1, 0.6, 1.0], p=[0.5, 0.2, 0.2, 0.1])] = np.nan
    found = xyz.astype(np.float32)
    return np.linalg.norm(found, axis=-1).astype(np.float32), found


def chord_case(rng: Generator) -> tuple[Any, ...]:
    n_rows, n = shape(rng)
    ranges, xyz = points(rng, n_rows, n)
    thresholds = ChordThresholds(
        least_chord_m=float(rng.choice([0.0, 0.125, 0.25, 0.3, 1.0])),
        max_shots=int(rng.choice([1, 2, 5, 256])),
    )
    return ranges, xyz, lengths(rng, n_rows, n), thresholds


def signed(rng: Generator, n_rows: int, n: int) -> F32:
    """Signed angles that wander between surfaces and foliage, some of them missing, some exactly
    half way."""
    changes = np.cumsum(rng.random((n_rows, n)) < rng.choice([0.02, 0.1, 0.5]), axis=1)
    kinds = rng.integers(0, 4, (n_rows, n + 1))
    kind = np.take_along_axis(kinds, changes, axis=1)
    foliage = rng.choice([-150.0, -90.0, -45.0, 0.0, 45.0, 90.0, 150.0], (n_rows, n))
    values = np.choose(
        kind,
        [np.full((n_rows, n), 90.0), np.zeros((n_rows, n)), foliage, np.full((n_rows, n), 45.0)],
    )
    if rng.random() < 0.5:
        values = np.clip(values + rng.normal(0, 15, (n_rows, n)), -180, 180)
    else:
        values = values + rng.choice([-15.0, 0.0, 15.0], (n_rows, n))
    values[rng.random((n_rows, n)) < rng.choice([0.0, 0.1, 0.7, 1.0], p=[0.5, 0.2, 0.2, 0.1])] = (
        np.nan
    )
    return values.astype(np.float32)


def difference_case(rng: Generator) -> tuple[Any, ...]:
    return (signed(rng, *shape(rng)),)


def line_angle_case(rng: Generator) -> tuple[Any, ...]:
    n_sides = int(rng.integers(1, 3))
    n_rows, n = shape(rng)
    n_rows *= n_sides
    ranges = rng.choice([1.0, 1.5, 2.0, 40.0], (n_rows, n)).astype(np.float32)
    ahead = np.arange(n) + rng.integers(1, 4, (n_rows, n))
    ahead[(ahead >= n) | (rng.random((n_rows, n)) < 0.2)] = -1
    surface = rng.choice([0, 1, 2, 3, 4], p=[0.05, 0.1, 0.7, 0.1, 0.05], size=(n_rows, n)).astype(
        np.uint8
    )
    surface[rng.random(n_rows) < 0.2] = 3
    steps = rng.choice([0.0, 0.002, 0.1], (n_sides, n))
    return ranges, ahead.astype(np.int32), surface, np.minimum(np.cumsum(steps, axis=1), np.pi)


MODELS = [
    (
        [-90, 0, 90],
        [30, 30, 30],
        [[0.05, 0.475, 0.475], [0.05, 0.875, 0.075], [0.05, 0.075, 0.875]],
    ),
    ([-150, 0, 150], [30, 30, 30], [[0.1, 0.8, 0.1]] * 3),
    ([90, 15, -90], [12, 2, 2], [[0.9, 0.1, 0], [0.1, 0.9, 0], [0, 0, 1]]),
    ([-90, 0, 90], [20, 25, 30], [[0.9, 0.05, 0.05], [0.05, 0.9, 0.05], [0.05, 0.05, 0.9]]),
]


def hmm_case(rng: Generator) -> tuple[Any, ...]:
    means, sigmas, h0 = MODELS[rng.integers(len(MODELS))]
    starts = [[1 / 3, 1 / 3, 1 / 3], [0.2, 0.3, 0.5], [0.05, 0.475, 0.475]]
    initial_h0, initial_h1 = (starts[i] for i in rng.integers(3, size=2))
    values = signed(rng, *shape(rng))
    return values, MarkovThresholds(
        means_deg=tuple(map(float, means)),  # type: ignore[arg-type]
        sigmas_deg=tuple(map(float, sigmas)),  # type: ignore[arg-type]
        h0=tuple(tuple(map(float, row)) for row in h0),  # type: ignore[arg-type]
        initial_h0=tuple(initial_h0),  # type: ignore[arg-type]
        initial_h1=tuple(initial_h1),  # type: ignore[arg-type]
        threshold=float(rng.choice([0.5, 2.5, 10.0])),
        backdate=bool(rng.random() < 0.5),
        accept=float(rng.choice([1.0, 3.0, 10.0])),
        reject=float(rng.choice([-1.0, -2.5, -5.0])),
        merge_gap=int(rng.choice([0, 1, 5, 20])),
    )


def surface_case(rng: Generator) -> tuple[Any, ...]:
    n_rows, n = shape(rng)
    angles = signed(rng, n_rows, n)
    vegetation = np.cumsum(rng.random((n_rows, n)) < 0.1, axis=1) % 2 == 1
    ranges = np.where(np.isnan(angles) & (rng.random((n_rows, n)) < 0.5), np.nan, 5.0).astype(
        np.float32
    )
    drifts = rng.choice([30.0, 45.0, 60.0], 2)
    thresholds = rng.choice([0.0, 15.0, 30.0, 45.0, 90.0], 2)
    cusum = SurfaceThresholds(
        float(drifts[0]), float(thresholds[0]), float(drifts[1]), float(thresholds[1])
    )
    return angles, vegetation, ranges, lengths(rng, n_rows, n), cusum


CASES: dict[str, Callable[[Generator], tuple[Any, ...]]] = {
    "angle_differences": difference_case,
    "hmm_cusum": hmm_case,
    "line_angles": line_angle_case,
    "signed_angles": chord_case,
    "surface_image": surface_case,
}

TOLERANCES: dict[str, float] = {
    "line_angles": 2e-5,  # one step of float32 at 180 deg
    "signed_angles": 2e-5,
}
"""Kernels whose floats may differ from the twin's by this much, absolute.

All others are equal bit for bit.
"""


SHAPES_OF_CALIBRATION = [(1, 1), (1, 2), (2, 1), (7, 1), (3, 2), (4, 3), (5, 5), (2, 17)]
VALUES = [1e-45, 0.001, 0.1, float(np.float32(0.1)), 0.0625, 0.5, 1.0, 1e9]


def _window(rng: Generator, n_lines: int, n_columns: int) -> F32:
    reach = max(n_columns + 1, 4)
    size = n_lines * n_columns + 2 * reach
    ranges = rng.choice([5.0, 5.1, 6.0, 6.1], size) + rng.integers(-3, 4, size) * rng.choice(
        [0.001, 0.0625]
    )
    ranges[rng.random(size) < rng.choice([0.0, 0.1, 0.6, 1.0])] = np.nan
    ranges[: rng.integers(0, reach + 1)] = np.nan
    return ranges.astype(np.float32)


def _thresholds(rng: Generator) -> F64:
    return np.sort(rng.choice(VALUES, rng.integers(1, 6), replace=False))


def support_case(rng: Generator) -> tuple[Any, ...]:
    n_lines, n_columns = SHAPES_OF_CALIBRATION[rng.integers(len(SHAPES_OF_CALIBRATION))]
    counts = (int(rng.integers(0, 9)), int(rng.integers(0, 7)))
    return (
        _window(rng, n_lines, n_columns),
        n_lines,
        n_columns,
        _thresholds(rng),
        _thresholds(rng),
        *counts,
    )


def bend_case(rng: Generator) -> tuple[Any, ...]:
    n_lines, n_columns = SHAPES_OF_CALIBRATION[rng.integers(len(SHAPES_OF_CALIBRATION))]
    alpha = float(rng.choice([0.25, 0.3, 0.125]))
    supported = rng.random((n_lines, n_columns)) < 0.8
    return _window(rng, n_lines, n_columns), supported, _thresholds(rng), alpha


CASES_OF_CALIBRATION: dict[str, Callable[[Generator], tuple[Any, ...]]] = {
    "bend_histogram": bend_case,
    "support_histogram": support_case,
}


def image(rng: Generator) -> F32:
    shape = (int(rng.integers(1, 5)), int(rng.integers(1, 9)))
    ranges = rng.choice([1.0, 299.5, 300.0, 300.5, 7.25], shape) * rng.choice([1.0, rng.random()])
    ranges[rng.random(shape) < rng.choice([0.0, 0.3, 1.0])] = np.nan
    return ranges.astype(np.float32)


def beams(rng: Generator, n_columns: int) -> I32:
    """Columns shared out to one or two sides, the shorter one filled up."""
    columns = rng.permutation(n_columns)
    n_first = n_columns if rng.random() < 0.4 else int(rng.integers(1, n_columns + 1))
    sides = [part for part in (columns[:n_first], columns[n_first:]) if len(part)]
    order = np.full((len(sides), max(len(part) for part in sides)), -1, np.int32)
    for side, part in zip(order, sides, strict=True):
        side[: len(part)] = part
    return order


def lines_case(rng: Generator) -> tuple[Any, ...]:
    ranges = image(rng)
    xyz = rng.normal(0, 50, (*ranges.shape, 3)).astype(np.float32)
    xyz[np.isnan(ranges)] = np.nan
    xyz[rng.random(xyz.shape) < 0.02] = np.nan
    return ranges, xyz, beams(rng, ranges.shape[1]), 300.0


def plane_case(rng: Generator) -> tuple[Any, ...]:
    ranges = image(rng)
    angle = rng.uniform(-np.pi, np.pi, ranges.shape[1])
    return ranges, np.sin(angle), -np.cos(angle), beams(rng, ranges.shape[1]), 300.0


CASES_OF_LINES: dict[str, Callable[[Generator], tuple[Any, ...]]] = {
    "arrange_lines": lines_case,
    "arrange_plane": plane_case,
}
