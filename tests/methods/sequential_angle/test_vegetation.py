"""The less sensitive test for vegetation against its closed form, and the labels for the car algorithm."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.random import Generator
from scipy.stats import norm

from prc_cli.core.classes import Surface
from prc_cli.core.types import F64, Mask
from prc_cli.methods.sequential_angle.angles import angle_differences, signed_angles
from prc_cli.methods.sequential_angle.coarse import car_surface, coarse, dense_vegetation
from prc_cli.methods.sequential_angle.thresholds import (
    ChordThresholds,
    CoarseThresholds,
    SequentialAngleThresholds,
    SurfaceThresholds,
)
from tests.methods.sequential_angle.scenes import street_lines

PARAMS = SequentialAngleThresholds().dense_vegetation


@pytest.fixture
def rng() -> Generator:
    return np.random.default_rng(71)


def increment(differences: F64, sigma_deg: float = 30.0) -> F64:
    """Log-likelihood ratio of one sample: mixtures without memory."""
    phi = norm.pdf(np.asarray(differences)[:, None], [-150, 0, 150], sigma_deg)
    return np.asarray(np.log(phi.mean(axis=1)) - np.log(phi @ [0.1, 0.8, 0.1]))


def page(g: F64, begin: int, threshold: float) -> tuple[int, int]:
    """Alarm and onset of Page's test, both len(g) if there is no alarm."""
    total, onset = 0.0, begin
    for t in range(begin, len(g)):
        total += g[t]
        if total > threshold:
            return t, onset
        if total < 0:
            total, onset = 0.0, t + 1
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


def test_increments() -> None:
    large, small = increment(np.array([150.0, -300.0])), increment(np.array([0.0, 20.0]))
    np.testing.assert_allclose(large, 1.204, atol=0.001)
    np.testing.assert_allclose(small, -0.875, atol=0.001)
    assert increment(np.array([74.0]))[0] < increment(np.array([76.0]))[0]
    share = 0.875 / (0.875 + 1.204)
    assert share == pytest.approx(0.421, abs=0.0005), "share of large jumps that balances"


def test_equals_page_on_a_mixture(rng: Generator) -> None:
    n_marked = []
    for _ in range(200):
        share = np.repeat(rng.choice([0.05, 0.3, 0.5, 0.8], 6), 60)
        jump = rng.random(360) < share
        values = np.where(jump, rng.choice([-150.0, 150.0], 360), 0) + rng.normal(0, 30, 360)
        values = values.astype(np.float32)
        found = dense_vegetation(values[None], PARAMS)[0]
        np.testing.assert_array_equal(found, closed_form(values.astype(np.float64)))
        n_marked.append(found.mean())
    assert min(n_marked) < 0.2
    assert max(n_marked) > 0.5


def test_nine_large_jumps_in_a_row_are_needed() -> None:
    jumps = [150.0, -150.0] * 5
    for n_jumps in range(1, 11):
        values = np.array([[0.0] * 20 + jumps[:n_jumps] + [0.0] * 20], np.float32)
        found = np.flatnonzero(dense_vegetation(values, PARAMS)[0])
        assert found.tolist() == (list(range(20, 20 + n_jumps)) if n_jumps >= 9 else [])


def test_street(rng: Generator) -> None:
    lines, truth = street_lines(rng, 40)
    signed = signed_angles(lines, ChordThresholds().at_noise()).signed_deg
    dense = dense_vegetation(angle_differences(signed), PARAMS)
    image = car_surface(signed, dense, lines, SurfaceThresholds())
    found, vegetation = image == Surface.VEGETATION, truth == Surface.VEGETATION
    # measured on 100 lines: precision .93, recall .74, false positives 1.1 %
    assert (found & vegetation).sum() / found.sum() > 0.88
    assert 0.55 < (found & vegetation).sum() / vegetation.sum() < 0.85
    assert found[~vegetation].mean() < 0.03
    sensitive = coarse(signed, lines, CoarseThresholds()) == Surface.VEGETATION
    assert (sensitive & vegetation).sum() > (found & vegetation).sum()
    # every valid shot has a label, those of T outside T' one of their own
    np.testing.assert_array_equal(image == Surface.MISSING, np.isnan(lines.range_m))
    own = image[sensitive & ~found]
    assert len(own)
    assert set(own.tolist()) <= {Surface.HORIZONTAL, Surface.VERTICAL}


def test_shots_without_an_angle_inherit_it(rng: Generator) -> None:
    lines, _ = street_lines(rng, 10)
    signed = signed_angles(lines, ChordThresholds().at_noise()).signed_deg
    dense = np.ones(signed.shape, bool)
    image = car_surface(signed, dense, lines, SurfaceThresholds())
    valid = ~np.isnan(lines.range_m)
    assert (valid & np.isnan(signed)).any()
    assert (image[valid] == Surface.VEGETATION).all()


def test_published_thresholds_are_the_defaults() -> None:
    assert PARAMS.threshold == 10
    assert PARAMS.means_deg == (-150, 0, 150)
    assert PARAMS.h0 == ((0.1, 0.8, 0.1),) * 3
