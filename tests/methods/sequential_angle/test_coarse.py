"""Coarse classes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.random import Generator

from prc_cli.core.classes import Surface
from prc_cli.core.types import U8
from prc_cli.methods.sequential_angle.angles import signed_angles
from prc_cli.methods.sequential_angle.coarse import coarse
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import (
    ChordThresholds,
    CoarseThresholds,
)
from tests.methods.sequential_angle.scenes import lines_through, made

M, T, H, V, U = (int(surface) for surface in Surface)


@pytest.fixture
def rng() -> Generator:
    return np.random.default_rng(4)


def classified(
    lines: VerticalLines,
    noise_m: float,
    sigmas: float,
    params: CoarseThresholds,
) -> U8:
    angles = made(ChordThresholds, range_noise_m=noise_m, min_chord_sigmas=sigmas).at_noise()
    return coarse(signed_angles(lines, angles).signed_deg, lines, params)


@pytest.mark.parametrize("spacing_sigmas", [1.0, 2.0, 4.0, 8.0])
def test_a_wall_hit_head_on_is_not_vegetation(rng: Generator, spacing_sigmas: float) -> None:
    noise = 0.005
    n = 600
    up = (np.arange(n) - n / 2) * spacing_sigmas * noise
    points = np.stack([10 + rng.normal(0, noise, (20, n)), np.tile(up, (20, 1))], axis=-1)
    image = classified(lines_through(points), noise, 4, CoarseThresholds())
    assert (image == T).mean() < 0.01
    assert (image == V).mean() > 0.95
