"""Data for the kernels of the calibration."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator

from prc_cli.core.types import F32, F64

SHAPES = [(1, 1), (1, 2), (2, 1), (7, 1), (3, 2), (4, 3), (5, 5), (2, 17)]
VALUES = [1e-45, 0.001, 0.1, float(np.float32(0.1)), 0.0625, 0.5, 1.0, 1e9]


def _window(rng: Generator, n_lines: int, n_columns: int) -> F32:
    reach = max(n_columns + 1, 4)
    size = n_lines * n_columns + 2 * reach
    ranges = rng.choice([5.0, 5.1, 6.0, 6.1], size) + rng.integers(-3, 4, size) * rng.choice([0.001, 0.0625])
    ranges[rng.random(size) < rng.choice([0.0, 0.1, 0.6, 1.0])] = np.nan
    ranges[: rng.integers(0, reach + 1)] = np.nan
    return ranges.astype(np.float32)


def _thresholds(rng: Generator) -> F64:
    return np.sort(rng.choice(VALUES, rng.integers(1, 6), replace=False))


def support_case(rng: Generator) -> tuple[Any, ...]:
    n_lines, n_columns = SHAPES[rng.integers(len(SHAPES))]
    counts = (int(rng.integers(0, 9)), int(rng.integers(0, 7)))
    return (_window(rng, n_lines, n_columns), n_lines, n_columns, _thresholds(rng), _thresholds(rng), *counts)


def bend_case(rng: Generator) -> tuple[Any, ...]:
    n_lines, n_columns = SHAPES[rng.integers(len(SHAPES))]
    alpha = float(rng.choice([0.25, 0.3, 0.125]))
    return _window(rng, n_lines, n_columns), n_lines, n_columns, _thresholds(rng), alpha


CASES: dict[str, Callable[[Generator], tuple[Any, ...]]] = {
    "bend_histogram": bend_case,
    "support_histogram": support_case,
}
