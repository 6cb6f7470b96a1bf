"""Drift alarms for files unlike the earlier ones, and none for others."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.jobs.batch.report import MIN_EARLIER, drift

NAMES = ("NOISE", "GROUND", "OBJECT", "CAR")


def street(rng: np.random.Generator, n: int, concentration: float = 300.0) -> list[dict[str, int]]:
    """Histograms of streets that differ as streets do."""
    shares = rng.dirichlet(np.array([0.05, 0.55, 0.35, 0.05]) * concentration, n)
    return [dict(zip(NAMES, map(int, row * rng.integers(10_000, 5_000_000)), strict=True)) for row in shares]


def moved(histogram: dict[str, int], share: float, source: str = "GROUND", to: str = "NOISE") -> dict[str, int]:
    """The same file with a part of its records in another class."""
    n = int(sum(histogram.values()) * share)
    assert histogram[source] >= n
    return {**histogram, source: histogram[source] - n, to: histogram[to] + n}


def test_ordinary_files_raise_no_alarm() -> None:
    rng = np.random.default_rng(7)
    alarms = sum(drift(one, street(rng, 40)) is not None for one in street(rng, 1000))
    assert alarms <= 2


@pytest.mark.parametrize("n_earlier", [MIN_EARLIER, 30, 300])
def test_a_quarter_of_the_records_in_another_class_is_an_alarm(n_earlier: int) -> None:
    rng = np.random.default_rng(8)
    found = [drift(moved(one, 0.25), street(rng, n_earlier)) for one in street(rng, 100)]
    assert sum(text is not None for text in found) >= 99 - 10 * (n_earlier == MIN_EARLIER)


@pytest.mark.parametrize("n_earlier", [0, 1, MIN_EARLIER - 1])
def test_few_earlier_files_say_nothing(n_earlier: int) -> None:
    assert drift({"NOISE": 1}, [{"GROUND": 100}] * n_earlier) is None


def test_a_smaller_kind_of_drive_is_known_after_some() -> None:
    rng = np.random.default_rng(10)
    forest = [{"NOISE": 2, "GROUND": 20 + i % 3, "OBJECT": 78 - i % 3, "CAR": 0} for i in range(10)]
    town = street(rng, 50)
    assert drift(forest[0], town) is not None
    assert drift(forest[5], town + forest[:5]) is None
