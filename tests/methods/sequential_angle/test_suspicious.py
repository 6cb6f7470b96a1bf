"""The chain of H, V and M against brute-force likelihood ratios, and its triggers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.random import Generator

from prc_cli.core.config import build
from prc_cli.core.errors import ConfigError
from prc_cli.methods.keys import table_of
from prc_cli.methods.sequential_angle.car import suspicious
from prc_cli.methods.sequential_angle.thresholds import SuspiciousThresholds
from tests.methods.sequential_angle.made import made

CODES = {"M": 0, "T": 1, "H": 2, "V": 3, "U": 4}
PARAMS = made(SuspiciousThresholds, enabled=True)


def trigger(states: str, params: SuspiciousThresholds = PARAMS) -> int:
    codes = np.array([[CODES[state] for state in states]], np.uint8)
    return int(suspicious(codes, np.array([len(states)], np.int32), params)[0])


@pytest.mark.parametrize("start", ["", "MMM"])
@pytest.mark.parametrize(
    ("states", "beam"),
    [
        ("VH", 1),
        ("HHHHVVVVH", 8),
        ("VM", 1),
        ("HHHHVVVVVVM", 10),
        ("HHMM", 3),
        ("HHHHHHHH", -1),
        ("HHHMHHHH", -1),
        ("HMH", -1),
        ("HHHVVVVVVVV", -1),
        ("HVVVVVVV", -1),
        ("VVVV", -1),
        ("H", -1),
    ],
)
def test_what_fires(start: str, states: str, beam: int) -> None:
    assert trigger(start + states) == (beam if beam < 0 else beam + len(start))


@pytest.mark.parametrize("end", ["T", "U"])
def test_dense_vegetation_and_points_without_an_angle_end_it(end: str) -> None:
    assert trigger("HH" + end + "VHVHMM") == -1
    assert trigger("HVH" + end) == 2


def test_sky_fires() -> None:
    assert trigger("HHHVVVMMMM") == 6


def chain(rng: Generator, matrix: tuple[tuple[float, float, float], ...], n: int) -> str:
    states = [0]
    for _ in range(n - 1):
        states.append(int(rng.choice(3, p=matrix[states[-1]])))
    return "".join("HVM"[state] for state in states)


def test_sum_is_the_largest_log_likelihood_ratio_of_any_end_of_the_chain() -> None:
    """S at beam k is max(0, max over j < k of ln P1(j+1..k | j) / P0(j+1..k | j)), product by product."""
    rng = np.random.default_rng(7)
    h0, h1 = np.array(PARAMS.h0), np.array(PARAMS.h1)
    for _ in range(200):
        states = chain(rng, PARAMS.h1 if rng.random() < 0.5 else PARAMS.h0, 14)
        numbers = ["HVM".index(state) for state in states]
        steps = list(pairwise(numbers))
        best = [
            max(np.prod([h1[s] for s in steps[j:k]]) / np.prod([h0[s] for s in steps[j:k]]) for j in range(k))
            for k in range(1, len(numbers))
        ]
        above = [k for k, ratio in enumerate(best, start=1) if ratio > np.e]
        assert trigger(states) == (above[0] if above else -1)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"h0": [[0.8, 0.1, 0.2], [0.09, 0.9, 0.01], [0.6, 0.3, 0.1]]}, "add up to 1, found a sum of 1.1"),
        ({"h1": [[1.0, 0.0, 0.0], [0.25, 0.5, 0.25], [0.25, 0.25, 0.5]]}, "less than 1"),
        ({"threshold": -1}, "threshold"),
    ],
)
def test_matrices_hold_probabilities(table: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build(table_of(SuspiciousThresholds(), "suspicious"), table, "test")
