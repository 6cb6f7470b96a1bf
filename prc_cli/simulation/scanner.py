"""What a scanner makes of the true ranges: noise, lost shots, background light, mixed pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.types import F32, F64, U8, Mask
from prc_cli.simulation.params import StreetParams
from prc_cli.simulation.rays import Hits, lattice


@dataclass(frozen=True, slots=True)
class Draws:
    """Random numbers of a block of lines, each array (lines, M) float64."""

    depth: F64
    """Exponential, mean 1: way into leaves."""
    normal: F64
    """Standard normal: range noise."""
    glass: F64
    """Uniform, as all below: what glass does."""
    lost: F64
    background: F64
    background_range: F64
    mixed: F64
    mixed_weight: F64


def draw(seed: int, first_line: int, n_lines: int, points_per_line: int) -> Draws:
    """Draw the random numbers of consecutive lines.

    Every line has a counter-based generator of its own, so that its numbers do not depend on how many lines are
    drawn together.
    """
    depth, normal = np.empty((2, n_lines, points_per_line))
    uniform = np.empty((6, n_lines, points_per_line))
    for i in range(n_lines):
        rng = np.random.Generator(np.random.Philox(key=seed, counter=[0, 0, 0, first_line + i]))
        rng.standard_exponential(out=depth[i])
        rng.standard_normal(out=normal[i])
        for numbers in uniform:
            rng.random(out=numbers[i])
    return Draws(depth, normal, *uniform)


def scan(hits: Hits, draws: Draws, first_line: int, params: StreetParams) -> tuple[F32, U8]:
    """Turn what the rays met into what the scanner says.

    Parameters
    ----------
    hits : Hits
        Nearest surface of every shot, (lines, M).
    draws : Draws
        Random numbers of the same shots.
    first_line : int
        Number of the first line.
    params : StreetParams
        Noise levels.

    Returns
    -------
    range_m : (lines, M) float32
        Range [m], NaN = missing.
    label : (lines, M) uint8
        :class:`prc_cli.core.classes.Label` of what was hit; NOISE where the range has nothing to do with it.
    """
    swallowed = (hits.label == Label.MISSING) | (hits.t > params.max_range_m)
    true_range = np.where(swallowed, np.nan, hits.t)
    label = np.where(swallowed, Label.MISSING, hits.label).astype(np.uint8)
    _mix_edges(true_range, label, draws, params.mixed_share)
    noisy = true_range + draws.normal * (params.noise_m + params.noise_per_m * true_range)
    lost = draws.lost < _lost_share(true_range, hits.facing)
    strays = draws.background < _background_share(np.isinf(hits.t), first_line, params)
    anywhere = 0.5 + draws.background_range * (params.max_range_m - 0.5)
    noisy = np.where(strays, anywhere, np.where(lost, np.nan, noisy))
    label[strays] = Label.NOISE
    # noise can push a range past what the scanner gives, or a very near one below zero
    given = (noisy > 0.0) & (noisy <= params.max_range_m)
    label[~given] = Label.MISSING
    return np.where(given, noisy, np.nan).astype(np.float32), label


def _mix_edges(true_range: F64, label: U8, draws: Draws, share: float) -> None:
    """Let some shots beside a step in range hit both of its sides; in place."""
    near, far = true_range[:, :-1], true_range[:, 1:]
    leaves = (label[:, :-1] == Label.VEGETATION) & (label[:, 1:] == Label.VEGETATION)
    step = far - near
    # leaves are all steps, and their ranges random already; wider steps give two returns rather than a mixture
    with np.errstate(invalid="ignore"):
        edge = (np.abs(step) > 0.3) & (np.abs(step) < 6.0) & ~leaves & (draws.mixed[:, :-1] < share)
    mixture = near + draws.mixed_weight[:, :-1] * step
    true_range[:, :-1][edge] = mixture[edge]
    label[:, :-1][edge] = Label.NOISE


def _lost_share(true_range: F64, facing: F64) -> F64:
    """Probability that a shot gets no answer: far away, or nearly along the surface."""
    far = (true_range / 110.0) ** 2
    grazing = 0.8 * np.clip(1.0 - np.abs(facing) / 0.1, 0.0, 1.0)
    return 0.003 + far + grazing


def _background_share(sky: Mask, first_line: int, params: StreetParams) -> F64:
    """Probability of a range from nowhere; higher in patches of the sky, where bright clouds are."""
    cloud = np.clip(4.0 * _clouds(params.seed, first_line, *sky.shape) - 2.2, 0.0, 1.0)
    return params.background_share * np.where(sky, 1.0 + 13.0 * cloud, 1.0)


def _clouds(seed: int, first_line: int, n_lines: int, points_per_line: int) -> F64:
    """Smooth random field in 0..1, (lines, M) float64: lattice values, blended in between."""
    line = np.arange(first_line, first_line + n_lines)[:, None] / 80.0
    column = np.arange(points_per_line)[None, :] * (18.0 / points_per_line)
    i, j = np.floor(line).astype(np.int64), np.floor(column).astype(np.int64)
    u, v = line - i, column - j
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    before = lattice(seed, 17, i, j) * (1.0 - v) + lattice(seed, 17, i, j + 1) * v
    after = lattice(seed, 17, i + 1, j) * (1.0 - v) + lattice(seed, 17, i + 1, j + 1) * v
    field: F64 = before * (1.0 - u) + after * u
    return field
