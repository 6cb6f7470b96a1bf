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
