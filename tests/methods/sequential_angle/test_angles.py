"""Signed angles and line angles of known geometry."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.random import Generator

from prc_cli.core.classes import Surface
from prc_cli.core.types import F64
from prc_cli.methods.sequential_angle import angles_loops as kernel_module
from prc_cli.methods.sequential_angle.angles import line_angles, signed_angles
from prc_cli.methods.sequential_angle.thresholds import ChordThresholds
from prc_cli.reference.sequential_angle import angles as oracle_angles
from tests.methods.sequential_angle.made import made
from tests.methods.sequential_angle.scenes import lines_of, lines_through

HELPERS: Any = kernel_module
"""Their plain functions are called: compiled, helpers have no way in from outside."""


def plain(**values: float) -> ChordThresholds:
    """Without the readings that are ours, so that every rule is tested by itself."""
    return made(ChordThresholds, **{"least_chord_m": 0.0, **values}).at_noise()


LITERAL = plain(min_chord_sigmas=0)
STEP = np.deg2rad(0.1)


@pytest.fixture
def rng() -> Generator:
    return np.random.default_rng(2012)


def test_angles_of_ground_wall_overhang_and_return() -> None:
    points = [(4, -2), (5, -2), (6, -2), (6, -1), (5, -1), (5, 0), (7, 2), (7, 1), (7, 1.5)]
    found = signed_angles(lines_through(points), LITERAL)
    expected = [90, 90, 0, 90, 0, 45, -180, -0.0, np.nan]
    np.testing.assert_allclose(found.signed_deg[0], expected, atol=1e-5)
    assert np.signbit(found.signed_deg[0, 7]), "up after down is against the chord before: minus zero"
    assert found.ahead[0].tolist() == [1, 2, 3, 4, 5, 6, 7, 8, -1]


def test_chords_bridge_missing_shots_and_short_steps() -> None:
    gap = (np.nan, np.nan)
    points = [(4, -2), gap, gap, (4.5, -2), (4.51, -2), (4.519, -2), gap, (4.52, -2), (4.6, -1.9)]
    found = signed_angles(lines_through(points), plain())
    assert found.ahead[0].tolist() == [3, -1, -1, 8, 8, 8, -1, 8, -1]
    assert np.isnan(found.signed_deg[0]).tolist() == [False, True, True, False, False, False, True, False, True]
    # a chord is as long as the shortest allowed or longer
    whole = plain(range_noise_m=0.0625, chord_depth_sigmas=0)
    found = signed_angles(lines_through([(4, -2), (4.25, -2), (4.5, -2)]), whole)
    assert found.ahead[0].tolist() == [1, 2, -1]


@pytest.mark.parametrize(
    ("spacing", "negative", "rms_deg"),
    [(1, 0.34, 46), (2, 0.086, 31), (3, 0.012, 23), (4, 0.001, 18), (6, 0.0, 13)],
)
def test_noise_turns_short_chords_round(rng: Generator, spacing: int, negative: float, rms_deg: float) -> None:
    noise, n = 0.005, 100_000
    up = np.arange(n) * spacing * noise
    points = np.stack([10 + rng.normal(0, noise, n), up - up.mean()], axis=-1)
    literal = signed_angles(lines_through(points), LITERAL).signed_deg[0, :-1]
    assert (literal < 0).mean() == pytest.approx(negative, abs=0.005)
    assert np.sqrt((np.abs(literal.astype(np.float64)) ** 2).mean()) == pytest.approx(rms_deg, abs=1)
    lengthened = signed_angles(lines_through(points), plain(range_noise_m=noise)).signed_deg[0, :-4]
    # measured .032, .013, .010, .001, 0: chords that noise makes long enough are still turned round now and then
    assert (lengthened < 0).mean() < min(0.05, 0.4 * negative + 0.01)


def straight_line(rng: Generator) -> tuple[F64, F64, float]:
    """Beams and ranges of shots on one straight line with gaps, and the line's angle from straight down."""
    while True:
        beam = np.arange(300) * STEP + rng.uniform(0, np.pi - 300 * STEP)
        point, direction = rng.uniform(-20, 20, 2), rng.uniform(0, np.pi)
        normal = np.array([-np.sin(direction), np.cos(direction)])
        across = np.stack([np.cos(beam), np.sin(beam)], axis=-1) @ normal
        ranges = (point @ normal) / across
        if (ranges > 0.3).all() and (ranges < 300).all():
            there = np.sort(rng.choice(300, 40, replace=False))
            return beam[there], ranges[there], direction


def test_line_angle_is_the_angle_of_chord_and_beam(rng: Generator) -> None:
    """Geometry, across gaps and beyond 90 deg; constant along a line; the bare arc tangent has no quadrant."""
    n_blunt = 0
    for _ in range(200):
        beam, ranges, direction = straight_line(rng)
        pairs = list(zip(beam, beam[1:], ranges, ranges[1:], strict=False))
        phi, along_beam = np.sin(np.diff(beam)), np.cos(np.diff(beam)) - ranges[:-1] / ranges[1:]
        HELPERS._directions.py_func(phi, along_beam, len(phi))
        geometric = [oracle_angles.angle_at_first(*pair) for pair in pairs]
        np.testing.assert_allclose(phi, geometric, rtol=0, atol=4e-13)
        along = phi + beam[:-1]
        np.testing.assert_allclose(along, along[0], rtol=0, atol=1e-9)
        assert min(abs(along[0] - direction), abs(abs(along[0] - direction) - np.pi)) < 1e-9
        n_blunt += bool((phi > np.pi / 2).any())
        blunt = phi > np.pi / 2
        step, ratio = np.diff(beam), ranges[:-1] / ranges[1:]
        bare = np.arctan(np.sin(step) / (np.cos(step) - ratio))
        assert (np.abs(bare - phi)[blunt] > 1).all()
        np.testing.assert_allclose(bare[~blunt], phi[~blunt], atol=1e-9)
    assert 50 < n_blunt < 150


@pytest.mark.parametrize("height", [1.0, 1.65, 1.8])
@pytest.mark.parametrize("slope_deg", [0.0, 3.0, -3.0])
def test_line_angles_see_slope_not_height(height: float, slope_deg: float) -> None:
    beam = np.arange(np.deg2rad(30), np.deg2rad(80), STEP)
    ranges = height / (np.cos(beam) + np.sin(beam) * np.tan(np.deg2rad(slope_deg)))
    lines = lines_of(beam, ranges)
    ahead = signed_angles(lines, plain()).ahead
    surface = np.full(ahead.shape, Surface.HORIZONTAL, np.uint8)
    found = line_angles(lines, ahead, surface)
    np.testing.assert_array_equal(np.isnan(found), ahead < 0)
    # ranges are float32: at the shortest chord of 2 cm half a step of it turns the chord by some 0.001 deg
    np.testing.assert_allclose(found[ahead >= 0], 90 + slope_deg, atol=0.005)


@pytest.mark.parametrize("spacing", [1.0, 0.3, 0.1, 0.05])
def test_a_wall_with_shots_closer_than_the_noise_stands_upright(spacing: float) -> None:
    """Among many shots at one place noise alone makes some a chord apart: that must not choose the ends."""
    noise = 0.005
    beam = np.arange(np.pi / 2 - 0.05, np.pi / 2 + 0.05, spacing * noise / 5.0)
    ranges = 5.0 / np.sin(beam) + np.random.default_rng(5).normal(0, noise, (3, len(beam)))
    lines = lines_of(beam, ranges.astype(np.float32))
    for depth, least, most in ((3.0, 0.0, 25.0), (0.0, 25.0, 90.0)):
        params = plain(chord_depth_sigmas=depth, max_shots=1000)
        angle = np.abs(signed_angles(lines, params).signed_deg)
        spread = float(np.sqrt(np.nanmean(np.minimum(angle, 180 - angle) ** 2)))
        assert spread < most
        assert spread > (least if spacing < 0.2 else 0.0)
