"""Random arguments for the loops of the forest.

Small forests of stems, ground and leaves, missing shots and ties.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator

from prc_cli.core.types import F32, F64
from prc_cli.methods.forest import stems_loops as stems
from prc_cli.methods.forest.thresholds import (
    ForestThresholds,
    RunThresholds,
    StemThresholds,
    TerrainThresholds,
)
from tests.loops.twins import typed

RUNS = typed(
    RunThresholds,
    step_rad=0.02,
    above_m=0.05,
    tolerance_m=0.004,
    tolerance_share=0.0003,
    steep=1.0,
    gap_m=0.3,
    gap_steep=0.1,
    behind_m=0.15,
    lean=0.7,
    short_m=0.03,
)


def forest(rng: Generator) -> tuple[F32, F64, F64]:
    """Ranges of a few lines over flat ground with upright bodies, and sine and cosine of the
    beams."""
    n_lines = int(rng.integers(1, 7))
    n_columns = int(rng.integers(1, 26))
    first, last = (-2.6, 2.6) if rng.random() < 0.5 else (3.0, 0.05)
    angle = np.linspace(first, last, n_columns) if n_columns > 1 else np.array([first])
    sine = np.sin(angle)
    cosine = np.cos(angle)
    with np.errstate(divide="ignore"):
        ranges = np.where(cosine > 0, 1.8 / cosine, np.inf)
        for place in rng.choice([-6.0, -3.0, -1.5, 1.0, 2.0, 5.0], int(rng.integers(0, 4))):
            ranges = np.minimum(ranges, np.where(sine * place > 0, place / sine, np.inf))
    ranges = np.tile(np.where(ranges < 40, ranges, np.nan), (n_lines, 1))
    spread = rng.choice([0.0, 0.002, 0.5])
    odd = rng.random(ranges.shape) < rng.choice([0.0, 0.1, 0.4])
    ranges = ranges + rng.normal(0, spread, ranges.shape) * (rng.random(ranges.shape) < 0.5)
    ranges = np.where(odd, rng.choice([2.0, 4.0, 4.25, 9.0], ranges.shape), ranges)
    ranges[rng.random(ranges.shape) < rng.choice([0.0, 0.1, 0.7, 1.0])] = np.nan
    return np.maximum(ranges, 0.3).astype(np.float32), sine, cosine


def profile_case(rng: Generator) -> tuple[Any, ...]:
    chosen = typed(
        TerrainThresholds,
        bin_m=rng.choice([0.25, 1.0, 0.3]),
        slope=rng.choice([0.0, 0.5]),
        near_m=0.1,
        near_share=rng.choice([0.0, 0.05]),
    )
    ranges, sine, cosine = forest(rng)
    level = cosine * (rng.random() < 0.9)
    return ranges, sine, level, int(rng.integers(1, 6)), 2 * int(rng.integers(1, 16)), chosen


def height_case(rng: Generator) -> tuple[Any, ...]:
    ranges, sine, cosine = forest(rng)
    together = int(rng.integers(1, 5))
    profiles = rng.normal(-1.8, 0.5, (-(-len(ranges) // together), 2 * int(rng.integers(1, 30))))
    profiles[rng.random(len(profiles)) < 0.2] = stems.NO_GROUND
    return ranges, sine, cosine, profiles, together, float(rng.choice([0.25, 0.7]))


def heights_of(rng: Generator, ranges: F32, cosine: F64) -> F32:
    heights: F32 = (-ranges * cosine + rng.choice([1.8, 2.5, 1e9])).astype(np.float32)
    return heights


def runs_case(rng: Generator) -> tuple[Any, ...]:
    ranges, sine, cosine = forest(rng)
    chosen = RUNS._replace(
        step_rad=rng.choice([0.02, 0.1]),
        behind_m=rng.choice([0.15, np.inf]),
        gap_m=rng.choice([0.3, 2.0]),
        gap_steep=rng.choice([0.1, -np.inf]),
    )
    return ranges, heights_of(rng, ranges, cosine), sine, cosine, chosen


def stems_case(rng: Generator) -> tuple[Any, ...]:
    ranges, heights, sine, cosine, chosen = runs_case(rng)
    runs_and_table = stems.upright_runs(ranges, heights, sine, cosine, chosen)
    least = typed(
        StemThresholds,
        near_m=rng.choice([0.05, -1.0, 1.0]),
        near_share=0.005,
        shots=rng.choice([3, 12]),
        runs=rng.integers(1, 4),
        extent_m=0.5,
        total_m=1.0,
        mean_m=0.12,
        through_share=0.1,
    )
    if rng.random() < 0.5:
        least = least._replace(extent_m=0.0, total_m=0.0, mean_m=0.0, through_share=1.0)
    return ranges, *runs_and_table, least


def labels_case(rng: Generator) -> tuple[Any, ...]:
    ranges, _, cosine = forest(rng)
    is_stem = (rng.random(ranges.shape) < rng.choice([0.0, 0.1, 0.6])) & ~np.isnan(ranges)
    top = rng.choice([1e9, 1.0, 3.0])
    company = rng.choice([-1.0, 0.0, 0.25])
    chosen = typed(
        ForestThresholds,
        below_m=0.2,
        soil_m=0.04,
        cover_m=rng.choice([0.04, 0.15, 1.0]),
        flat_m=0.04,
        top_m=top,
        beside_m=rng.choice([-1.0, 0.0, 0.05]),
        near_m=company,
    )
    return ranges, heights_of(rng, ranges, cosine), is_stem, int(rng.integers(1, 4)), chosen


CASES: dict[str, Callable[[Generator], tuple[Any, ...]]] = {
    "forest_labels": labels_case,
    "ground_heights": height_case,
    "ground_profiles": profile_case,
    "stem_shots": stems_case,
    "upright_runs": runs_case,
}
