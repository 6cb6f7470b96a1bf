"""Range noise of the scanner, from the smoothest runs of shots."""

from __future__ import annotations

import numpy as np

from prc_cli.core.profile import stage
from prc_cli.core.types import F32

RUN_SHOTS = 9
"""Second differences of ranges in a run."""
SMOOTHEST = 0.1
"""This share of the runs lies on stems and bare ground in every forest."""
OF_SMOOTHEST = 1.4
"""Range noise in units of what the smoothest tenth of the runs shows.

That tenth is smooth partly by chance, so it shows less than the noise.
"""
SECOND_DIFFERENCE = 6.0
"""Variance of a second difference, in variances of one range."""
EVERY_LINE = 4
LEAST_RUNS = 100
EDGE_M = 1.0
"""Larger second differences are edges, and no run goes across one [m]."""


@stage("range noise")
def forest_noise(range_m: F32) -> float | None:
    """Return the standard deviation of ranges on the smoothest surfaces [m].

    None with too few runs of shots.

    ``range_m`` (lines, M) float32, metres.

    >>> rng = np.random.default_rng(1)
    >>> lines = 5 + rng.normal(0, 0.01, (400, 200)).astype(np.float32)
    >>> lines[:, 60:] += rng.exponential(0.5, (400, 140)).astype(np.float32)
    >>> round(forest_noise(lines), 3)
    0.009
    """
    ranges = range_m[::EVERY_LINE].astype(np.float64)
    if ranges.shape[1] < RUN_SHOTS + 2:
        return None
    with np.errstate(invalid="ignore"):  # ranges may be missing
        bends = ranges[:, 2:] - 2.0 * ranges[:, 1:-1] + ranges[:, :-2]
    n_runs = bends.shape[1] // RUN_SHOTS
    runs = bends[:, : n_runs * RUN_SHOTS].reshape(-1, RUN_SHOTS)
    runs = runs[(np.abs(runs) < EDGE_M).all(axis=1)]
    if len(runs) < LEAST_RUNS:
        return None
    squares = np.square(runs).mean(axis=1)
    place = int(SMOOTHEST * len(squares))
    squares.partition(place)
    return OF_SMOOTHEST * float(np.sqrt(squares[place] / SECOND_DIFFERENCE))
