"""Coarse classes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.random import Generator
from scipy.stats import norm

from prc_cli.core.classes import Surface
from prc_cli.core.types import F32, F64, I32, U8, Mask
from prc_cli.methods.sequential_angle.angles import angle_differences, signed_angles
from prc_cli.methods.sequential_angle.car import fourier
from prc_cli.methods.sequential_angle.coarse import car_surface, coarse, dense_vegetation
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import (
    ChordThresholds,
    CoarseThresholds,
    FourierThresholds,
    MarkovThresholds,
    SequentialAngleThresholds,
    SurfaceThresholds,
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
    angles = made(
        ChordThresholds, range_noise_m=noise_m, min_chord_sigmas=sigmas, least_chord_m=0.0
    ).at_noise()
    return coarse(signed_angles(lines, angles).signed_deg, lines, params)


@pytest.mark.parametrize(
    ("step_deg", "noise_m", "model", "least"),
    [
        # measured on 300 lines: .948 .949 .943 .947 .929, .905, .930; the bounds leave room for
        # another seed
        (0.06, 0.005, MarkovThresholds(), 0.92),
        (0.115, 0.005, MarkovThresholds(), 0.92),
        (0.20, 0.005, MarkovThresholds(), 0.91),
        (0.115, 0.010, MarkovThresholds(), 0.92),
        (0.29, 0.010, MarkovThresholds(), 0.90),
        (0.115, 0.005, made(MarkovThresholds, h0=SLOW, sigmas_deg=(20, 20, 20)), 0.88),
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
    return made(FourierThresholds, **{"longest": 0, **values}).at_noise()


WHOLE = plain(window=0)


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


FOLIAGE = SequentialAngleThresholds().dense_vegetation


@pytest.fixture
def foliage_rng() -> Generator:
    return np.random.default_rng(71)


def increment(differences: F64, sigma_deg: float = 30.0) -> F64:
    """Log-likelihood ratio of one sample: mixtures without memory."""
    phi = norm.pdf(np.asarray(differences)[:, None], [-150, 0, 150], sigma_deg)
    return np.asarray(np.log(phi.mean(axis=1)) - np.log(phi @ [0.1, 0.8, 0.1]))


def page(g: F64, begin: int, threshold: float) -> tuple[int, int]:
    """Alarm and onset of Page's test, both len(g) if there is no alarm."""
    total = 0.0
    onset = begin
    for t in range(begin, len(g)):
        total += g[t]
        if total > threshold:
            return t, onset
        if total < 0:
            total = 0.0
            onset = t + 1
    return len(g), len(g)


def closed_form(differences: F64) -> Mask:
    g = increment(differences)
    marked = np.zeros(len(g), bool)
    alarm, onset = page(g, 0, 10)
    while alarm < len(g):
        back, end = page(-g, alarm + 1, 10)
        marked[onset:end] = True
        alarm, onset = page(g, back + 1, 10)
    return marked


def test_equals_page_on_a_mixture(foliage_rng: Generator) -> None:
    n_marked = []
    for _ in range(200):
        share = np.repeat(foliage_rng.choice([0.05, 0.3, 0.5, 0.8], 6), 60)
        jump = foliage_rng.random(360) < share
        values = np.where(jump, foliage_rng.choice([-150.0, 150.0], 360), 0) + foliage_rng.normal(
            0, 30, 360
        )
        values = values.astype(np.float32)
        marked = dense_vegetation(values[None], FOLIAGE)[0]
        np.testing.assert_array_equal(marked, closed_form(values.astype(np.float64)))
        n_marked.append(marked.mean())
    assert min(n_marked) < 0.2
    assert max(n_marked) > 0.5


def test_foliage_of_a_street(foliage_rng: Generator) -> None:
    lines, truth = street_lines(foliage_rng, 40)
    signed = signed_angles(lines, ChordThresholds().at_noise()).signed_deg
    dense = dense_vegetation(angle_differences(signed), FOLIAGE)
    image = car_surface(signed, dense, lines, SurfaceThresholds())
    is_foliage = image == Surface.VEGETATION
    vegetation = truth == Surface.VEGETATION
    # measured on 100 lines: precision .93, recall .74, false positives 1.1 %
    assert (is_foliage & vegetation).sum() / is_foliage.sum() > 0.88
    assert 0.55 < (is_foliage & vegetation).sum() / vegetation.sum() < 0.85
    assert is_foliage[~vegetation].mean() < 0.03
    sensitive = coarse(signed, lines, CoarseThresholds()) == Surface.VEGETATION
    assert (sensitive & vegetation).sum() > (is_foliage & vegetation).sum()
    # every valid shot has a label, those of T outside T' one of their own
    np.testing.assert_array_equal(image == Surface.MISSING, np.isnan(lines.range_m))
    missed = image[sensitive & ~is_foliage]
    assert len(missed)
    assert set(missed.tolist()) <= {Surface.HORIZONTAL, Surface.VERTICAL}
