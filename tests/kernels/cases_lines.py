"""Random arguments for the kernels that arrange half-lines, with gaps, fill and ranges near the reach."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator

from prc_cli.core.types import F32, I32


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


CASES: dict[str, Callable[[Generator], tuple[Any, ...]]] = {"arrange_lines": lines_case, "arrange_plane": plane_case}
