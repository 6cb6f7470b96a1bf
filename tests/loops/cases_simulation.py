"""Random arguments for the loops of rays and of the sensor, with edge cases, glass, leaves and
limits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.random import Generator

from prc_cli.core.types import F64, U8
from prc_cli.simulation.thresholds import Hits, SensorModel

SHAPES = [(0, 5), (1, 1), (1, 2), (3, 1), (2, 7), (4, 30), (2, 90)]
N_BODIES = 9


def aim_case(rng: Generator) -> tuple[Any, ...]:
    n_lines, m = SHAPES[rng.integers(len(SHAPES))]
    knots = int(rng.integers(2, 6))
    return (
        rng.normal(0, 100, (n_lines, knots, 3)),
        rng.normal(size=(n_lines, knots, 3, 3)),
        rng.normal(size=(m, 3)),
    )


def hits(rng: Generator, n_lines: int, m: int) -> Hits:
    """Runs of the same body, at a few ranges, so that neighbours step by all amounts."""
    run = np.maximum.accumulate(np.where(rng.random((n_lines, m)) < 0.3, np.arange(m), 0), axis=1)
    body = np.take_along_axis(rng.integers(-1, N_BODIES, (n_lines, m)), run, axis=1).astype(
        np.int32
    )
    t = np.take_along_axis(
        rng.choice([0.4, 4.0, 4.04, 4.5, 20.0, 77.0, 160.0], (n_lines, m)), run, axis=1
    )
    t = t + rng.choice([0.0, 0.06, 1.0], (n_lines, m), p=[0.6, 0.2, 0.2]) * rng.random((n_lines, m))
    facing = rng.choice([1.0, 0.7, 0.1, 0.0, -0.5, 0.9986], (n_lines, m))
    return Hits(np.where(body >= 0, t, np.inf), body, facing)


def bodies(rng: Generator) -> tuple[F64, U8]:
    surface = np.stack([rng.choice([0.05, 0.3, 0.9], N_BODIES), rng.random(N_BODIES)], axis=1)
    kind = np.stack([rng.integers(1, 9, N_BODIES), rng.choice([0, 1, 2, 4, 6], N_BODIES)], axis=1)
    return surface, kind.astype(np.uint8)


def model(rng: Generator) -> SensorModel:
    """Numbers of a sensor; drawn in the order of the fields, but for these two."""
    is_cw = bool(rng.integers(2))
    ambiguity_m = float(rng.choice([0.0, 150.0]))
    return SensorModel(
        step_rad=float(rng.choice([0.0005, 0.003])),
        exit_m=0.004,
        divergence=float(rng.choice([0.0002, 0.01])),
        ambiguity_m=ambiguity_m,
        pulse_m=0.45,
        min_range_m=0.5,
        max_range_m=float(rng.choice([76.0, 300.0])),
        half_power=float(rng.choice([1e-6, 1e-4])),
        resolution_m=float(rng.choice([1e-4, 0.01])),
        noise_m=0.001,
        noise_per_m=0.0001,
        noise_spread=0.05,
        lost_share=float(rng.choice([0.0, 0.1])),
        edge_m=0.05,
        background_share=0.1,
        sky_share=0.2,
        bright_sky_share=float(rng.choice([0.0, 0.8])),
        cluster_share=0.1,
        cluster_m=0.3,
        pane_share=0.3,
        ghost_share=0.3,
        leaves_share=0.5,
        is_cw=is_cw,
        max_returns=int(rng.integers(1, 5)),
    )


def sense_case(rng: Generator) -> tuple[Any, ...]:
    n_lines, m = SHAPES[rng.integers(len(SHAPES))]
    first = hits(rng, n_lines, m)
    second = hits(rng, n_lines, m)
    with np.errstate(invalid="ignore"):
        second = second._replace(t=np.where(np.isinf(second.t), np.inf, second.t + 5.0))
    if rng.random() < 0.3:
        second = Hits(np.empty((0, 0)), np.empty((0, 0), np.int32), np.empty((0, 0)))
    quantiles = np.sort(rng.normal(size=17))
    seed = int(rng.choice([0, 1, 2**63 - 1]))
    return (
        first,
        second,
        *bodies(rng),
        model(rng),
        quantiles,
        int(rng.choice([0, 99, 10**9])),
        seed,
    )


def behind_case(rng: Generator) -> tuple[Any, ...]:
    first, _, _, kind, numbers, _, first_line, seed = sense_case(rng)
    return first, kind, numbers, first_line, seed


CASES: dict[str, Callable[[Generator], tuple[Any, ...]]] = {
    "aim_shots": aim_case,
    "goes_behind": behind_case,
    "sense": sense_case,
}
