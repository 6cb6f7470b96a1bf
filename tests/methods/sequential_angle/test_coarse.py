"""Coarse classes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.random import Generator

from prc_cli.core.classes import Surface
from prc_cli.core.types import F32, I32, U8, Mask
from prc_cli.methods.sequential_angle.angles import signed_angles
from prc_cli.methods.sequential_angle.car import fourier
from prc_cli.methods.sequential_angle.coarse import coarse
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import (
    ChordThresholds,
    CoarseThresholds,
    FourierThresholds,
    MarkovThresholds,
)
from tests.methods.sequential_angle.scenes import lines_through, made, street_lines
from tests.methods.sequential_angle.test_markov import SCRIPT, SLOW

M, T, H, V, U = (int(surface) for surface in Surface)


@pytest.fixture
def rng() -> Generator:
    return np.random.default_rng(4)


def f1(marked: Mask, truth: Mask) -> float:
    return float(2 * (marked & truth).sum() / (marked.sum() + truth.sum()))


def classified(
    lines: VerticalLines,
    noise_m: float,
    sigmas: float,
    params: CoarseThresholds,
) -> U8:
    angles = made(ChordThresholds, range_noise_m=noise_m, min_chord_sigmas=sigmas).at_noise()
    return coarse(signed_angles(lines, angles).signed_deg, lines, params)


@pytest.mark.parametrize(
    ("step_deg", "noise_m", "model", "least"),
    [
        # measured on 180 lines: .944 .944 .929 .941 .825, .879, .928; the bounds leave room for
        # another seed
        (0.06, 0.005, MarkovThresholds(), 0.92),
        (0.115, 0.005, MarkovThresholds(), 0.92),
        (0.20, 0.005, MarkovThresholds(), 0.91),
        (0.115, 0.010, MarkovThresholds(), 0.92),
        (0.29, 0.010, MarkovThresholds(), 0.78),
        (0.115, 0.005, made(MarkovThresholds, h0=SLOW, sigmas_deg=(20, 20, 20)), 0.85),
        (0.115, 0.005, SCRIPT, 0.90),
    ],
)
def test_street(
    rng: Generator,
    step_deg: float,
    noise_m: float,
    model: MarkovThresholds,
    least: float,
) -> None:
    lines, truth = street_lines(rng, 30, step_deg, noise_m)
    image = classified(lines, noise_m, 4, made(CoarseThresholds, vegetation=model))
    np.testing.assert_array_equal(image == M, np.isnan(lines.range_m))
    assert f1(image == T, truth == T) > least
    solid = np.isin(truth, (H, V)) & (image != M)
    assert (image == T)[solid].mean() < 0.05
    classified_solid = solid & (image != T)
    assert (image == truth)[classified_solid].mean() > 0.98


@pytest.mark.parametrize("spacing_sigmas", [1.0, 2.0, 4.0, 8.0])
def test_a_wall_hit_head_on_is_not_vegetation(rng: Generator, spacing_sigmas: float) -> None:
    noise = 0.005
    n = 600
    up = (np.arange(n) - n / 2) * spacing_sigmas * noise
    points = np.stack([10 + rng.normal(0, noise, (20, n)), np.tile(up, (20, 1))], axis=-1)
    image = classified(lines_through(points), noise, 4, CoarseThresholds())
    assert (image == T).mean() < 0.01
    assert (image == V).mean() > 0.95


def plain(**values: int) -> FourierThresholds:
    """Without the readings that are ours, so that every rule is tested by itself."""
    return made(FourierThresholds, **{"longest": 0, **values})


WHOLE = plain()


def foliage(rng: Generator, rows: int, n: int) -> F32:
    """Independent ranges, neighbouring beams much closer than leaves are deep.

    Nearly along the beam, either way.
    """
    signs = np.where(rng.random((rows, n)) < 2 / 3, -1, 1)
    return (signs * np.abs(90 + rng.normal(0, 20, (rows, n)))).astype(np.float32)


def whole(rows: F32) -> I32:
    return np.array([(row, 0, rows.shape[1] - 1) for row in range(len(rows))], np.int32)


@pytest.mark.parametrize(
    ("n", "share"), [(32, 0.92), (64, 0.85), (128, 0.65), (256, 0.20), (512, 0.0)]
)
def test_share_of_foliage_that_is_told(n: int, share: float) -> None:
    rows = foliage(np.random.default_rng(n), 600, n)
    recall = 1 - fourier(rows, whole(rows), WHOLE).mean()
    assert abs(recall - share) < 0.08
