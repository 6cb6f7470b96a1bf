from __future__ import annotations

import csv
import gzip
from pathlib import Path

import numpy as np
import pytest

from prc_cli.streams.evidence.periods import (
    WEAK,
    RangeCorrelation,
    estimate_line_frequency,
    estimate_points_per_line,
    range_correlation,
)


def street(m: int, n_lines: int, seed: int = 0) -> np.ndarray:
    """Lines of a rough profile that changes slowly along the way, 15 % missing at random."""
    rng = np.random.default_rng(seed)
    profile = 8 + 3 * np.sin(np.linspace(0, 2 * np.pi, m)) + np.cumsum(rng.normal(scale=0.3, size=m)).clip(-4, 4)
    drift = np.cumsum(rng.normal(scale=0.02, size=(n_lines, 1)), axis=0)
    image = profile + drift + rng.normal(scale=0.02, size=(n_lines, m))
    image[rng.random(image.shape) < 0.15] = np.nan
    ranges: np.ndarray = np.abs(image).astype(np.float32)
    return ranges


@pytest.mark.parametrize(("m", "n_lines"), [(10, 60), (97, 30), (97, 17), (1000, 40), (5099, 20)])
def test_period_of_a_street(m: int, n_lines: int) -> None:
    estimate = estimate_points_per_line(street(m, n_lines))
    assert estimate.points_per_line == m
    assert estimate.strength > 0.5
    assert estimate.n_shots_used == m * n_lines


def test_start_within_a_line_and_shape_make_no_difference() -> None:
    image = street(210, 40)
    assert estimate_points_per_line(image.ravel()[77:]).points_per_line == 210
    assert estimate_points_per_line(image) == estimate_points_per_line(image.ravel())


def test_two_like_halves_of_a_line_are_not_taken_for_two_lines() -> None:
    left = street(180, 40, seed=1)
    right = left[:, ::-1] * np.float32(1.4)
    estimate = estimate_points_per_line(np.hstack([left, right]))
    assert estimate.points_per_line == 360


def test_a_scene_that_shifts_along_still_gives_m() -> None:
    # the profile moves by a column every fourth line: the first peak alone would be off where noise helps
    line = street(300, 1)[0]
    line[np.isnan(line)] = 9
    image = np.array([np.roll(line, k // 4) for k in range(60)])
    assert estimate_points_per_line(image).points_per_line == 300


def test_zero_negative_and_infinite_ranges_take_no_part() -> None:
    image = street(150, 40)
    bad = np.random.default_rng(4).random(image.shape) < 0.05
    image[bad] = np.resize(np.array([0, -1, np.inf], np.float32), int(bad.sum()))
    assert estimate_points_per_line(image).points_per_line == 150


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("kind", ["random", "walk"])
def test_no_period_is_seen_where_there_is_none(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.choice([1000, 5000, 40_000]))
    noise = rng.normal(size=n)
    ranges = np.exp(0.3 * noise if kind == "random" else 0.02 * np.cumsum(noise)) * 10
    estimate = estimate_points_per_line(ranges.astype(np.float32))
    assert estimate.points_per_line is None
    assert estimate.strength < WEAK
    assert "no period in the ranges" in estimate.reason


def test_a_stream_without_missing_shots_is_taken_with_caution() -> None:
    flat = street(230, 300).ravel()
    caution = "no shot is missing"
    assert caution not in estimate_points_per_line(flat).reason
    assert caution in estimate_points_per_line(np.where(np.isfinite(flat), flat, np.float32(9))).reason


def test_too_few_lines() -> None:
    assert estimate_points_per_line(street(500, 12)).points_per_line is None


def test_max_m_bounds_the_search() -> None:
    assert estimate_points_per_line(street(300, 40), max_m=200).points_per_line is None


@pytest.mark.parametrize(
    ("flat", "reason"),
    [
        (np.empty(0, np.float32), "too few ranges: 0 of 0 shots"),
        (np.full(5000, np.nan, np.float32), "too few ranges: 0 of 5000 shots"),
        (np.full(5000, 7.5, np.float32), "all ranges are equal"),
    ],
)
def test_nothing_to_go_by(flat: np.ndarray, reason: str) -> None:
    estimate = estimate_points_per_line(flat)
    assert (estimate.points_per_line, estimate.strength, estimate.reason) == (None, 0.0, reason)


def test_line_frequency() -> None:
    rng = np.random.default_rng(1)
    times = 5e5 + np.delete(np.arange(200) / 48.0, [3, 4, 90]) + rng.normal(scale=1e-5, size=197)
    estimate = estimate_line_frequency(times)
    assert estimate == pytest.approx(48.0, rel=1e-4)


@pytest.mark.parametrize("times", [[], [1.0], [1.0, 1.5], [1.0, np.nan, 1.5], [3.0, 3.0, 3.0]])
def test_line_frequency_of_too_little(times: list[float]) -> None:
    assert estimate_line_frequency(np.array(times)) is None


def test_line_frequency_without_a_beat() -> None:
    assert estimate_line_frequency(np.cumsum(np.random.default_rng(0).exponential(size=500))) is None


@pytest.mark.data
@pytest.mark.parametrize(("number", "m"), [(1, 229), (2, 226), (3, 240)])
def test_oakland(real_data: Path, number: int, m: int) -> None:
    with gzip.open(real_data / "oakland" / f"oakland_{number}.csv.gz", "rt") as handle:
        ranges = np.array([float(row["range_m"] or "nan") for row in csv.DictReader(handle)], np.float32)
    estimate = estimate_points_per_line(ranges)
    assert estimate.points_per_line == m
    assert estimate.strength > 1.5
    assert estimate_points_per_line(ranges[np.isfinite(ranges)]).points_per_line is None
    assert estimate_points_per_line(np.random.default_rng(0).permutation(ranges)).points_per_line is None


@pytest.mark.data
def test_tls_park(real_data: Path) -> None:
    # static scan: the scene leans, so the first peak stands at 2090; its multiples put that right
    ranges = np.load(real_data / "forest" / "tls_park.npz")["range_m"]
    assert ranges.shape[1] == 2089
    assert estimate_points_per_line(ranges).points_per_line == 2089


@pytest.mark.data
def test_jakarto_is_too_short(real_data: Path) -> None:
    recovered = np.load(real_data / "profiler" / "jakarto_0.02s_recovered.npz")
    image = np.full((4, 5099), np.nan, np.float32)
    image[recovered["line"], recovered["column"]] = recovered["range_m"]
    estimate = estimate_points_per_line(image)
    assert estimate.points_per_line is None
    assert "too few lines" in estimate.reason


def test_range_correlation_tells_a_walk_from_its_shuffle() -> None:
    rng = np.random.default_rng(5)
    walk = (20 + np.cumsum(rng.normal(scale=0.01, size=20_000))).astype(np.float32)
    walk[rng.random(walk.size) < 0.2] = np.nan
    assert range_correlation(walk).ratio < 0.05
    shuffled = range_correlation(rng.permutation(walk))
    assert 0.95 < shuffled.ratio < 1.05
    assert "no spatial correlation" in shuffled.verdict
    assert range_correlation(walk) == range_correlation(walk.reshape(100, 200))


def test_range_correlation_of_too_little() -> None:
    for flat in (np.full(500, np.nan, np.float32), np.full(500, 3.0, np.float32), np.ones(4, np.float32)):
        assert "too few, or too alike" in range_correlation(flat).verdict
    assert "loosely" in RangeCorrelation(0.5, 1000).verdict
