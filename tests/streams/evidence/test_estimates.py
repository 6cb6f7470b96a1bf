from __future__ import annotations

import csv
import gzip
from pathlib import Path

import numpy as np
import pytest

from prc_cli.streams.evidence.periods import (
    WEAK,
    estimate_line_frequency,
    estimate_points_per_line,
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


def test_line_frequency() -> None:
    rng = np.random.default_rng(1)
    times = 5e5 + np.delete(np.arange(200) / 48.0, [3, 4, 90]) + rng.normal(scale=1e-5, size=197)
    estimate = estimate_line_frequency(times)
    assert estimate == pytest.approx(48.0, rel=1e-4)


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
