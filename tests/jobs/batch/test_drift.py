"""Drift alarms for files unlike the earlier ones, and none for others."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.jobs.batch.report import FLOOR, MIN_EARLIER, drift

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


def test_the_sentence_names_the_class_and_both_shares() -> None:
    earlier = [{"GROUND": 60 + i % 3, "OBJECT": 40 - i % 3} for i in range(12)]
    assert drift({"OBJECT": 100, "GROUND": 0}, earlier) == (
        "GROUND is 0.0 % of the records, in 12 earlier files 61.0 % (60.0 to 62.0 % in most)"
    )


def test_a_class_that_never_was_there_is_named() -> None:
    text = drift({"GROUND": 50, "CAR": 50}, [{"GROUND": 100}] * 10)
    assert text == "CAR is 50.0 % of the records, in 10 earlier files 0.0 % (0.0 to 0.0 % in most)"


@pytest.mark.parametrize("n_earlier", [0, 1, MIN_EARLIER - 1])
def test_few_earlier_files_say_nothing(n_earlier: int) -> None:
    assert drift({"NOISE": 1}, [{"GROUND": 100}] * n_earlier) is None


def test_tiny_differences_are_none_even_if_the_others_are_all_the_same() -> None:
    earlier = [{"GROUND": 1000, "OBJECT": 1000}] * 50
    within = int(2000 * FLOOR) - 1
    assert drift({"GROUND": 1000 - within, "OBJECT": 1000 + within}, earlier) is None
    assert drift({"GROUND": 700, "OBJECT": 1300}, earlier) is not None


def test_a_few_odd_earlier_files_neither_hide_nor_raise_an_alarm() -> None:
    rng = np.random.default_rng(9)
    odd = [moved(one, share) for one, share in zip(street(rng, 6), (0.3, 0.35, 0.4, 0.28, 0.45, 0.5), strict=True)]
    earlier = street(rng, 60) + odd
    assert all(drift(one, earlier) is None for one in street(rng, 100))
    assert drift({"NOISE": 95, "GROUND": 5, "OBJECT": 0, "CAR": 0}, earlier) is not None


def test_a_smaller_kind_of_drive_is_known_after_some() -> None:
    rng = np.random.default_rng(10)
    forest = [{"NOISE": 2, "GROUND": 20 + i % 3, "OBJECT": 78 - i % 3, "CAR": 0} for i in range(10)]
    town = street(rng, 50)
    assert drift(forest[0], town) is not None
    assert drift(forest[5], town + forest[:5]) is None


def test_files_without_records() -> None:
    earlier = [{"GROUND": 5}] * 10
    assert drift({}, earlier) == "there are no records, while 10 earlier files have some"
    assert drift({"GROUND": 0}, earlier) is not None
    assert drift({"GROUND": 5}, [{}] * 10 + [{"GROUND": 0}] * 10) is None
    assert drift({"GROUND": 5}, [{}] * 10 + earlier) is None


def test_it_does_not_depend_on_the_order_of_anything() -> None:
    rng = np.random.default_rng(11)
    earlier = street(rng, 30)
    odd = moved(street(rng, 1)[0], 0.4)
    turned = [dict(reversed(one.items())) for one in reversed(earlier)]
    assert drift(odd, earlier) == drift(dict(reversed(odd.items())), turned) is not None


def test_files_of_one_record_count_and_empty_ones_do_not() -> None:
    assert drift({"b": 5000}, [{"a": 1}] * 20) is not None
    assert drift({"b": 5000}, [{"a": 0}] * 20) is None
