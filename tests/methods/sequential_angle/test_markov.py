"""Sequential tests."""

from __future__ import annotations

from itertools import pairwise, product
from typing import Any

import numpy as np
import pytest
from numpy.random import Generator
from scipy.special import logsumexp
from scipy.stats import norm

from prc_cli.core.config import build
from prc_cli.core.errors import ConfigError
from prc_cli.core.types import F64
from prc_cli.methods.keys import table_of
from prc_cli.methods.sequential_angle import coarse_loops as kernel_module
from prc_cli.methods.sequential_angle.car import suspicious
from prc_cli.methods.sequential_angle.thresholds import (
    MarkovThresholds,
    Matrix,
    Row,
    SuspiciousThresholds,
)
from tests.methods.sequential_angle.scenes import made

HELPERS: Any = kernel_module
"""Their plain functions are called: compiled, helpers have no way in from outside."""

SLOW = ((0.9, 0.05, 0.05), (0.05, 0.9, 0.05), (0.05, 0.05, 0.9))
SCRIPT = made(
    MarkovThresholds,
    means_deg=(90, 15, -90),
    sigmas_deg=(12, 2, 2),
    h0=((0.9, 0.1, 0), (0.1, 0.9, 0), (0, 0, 1)),
    backdate=False,
)
"""Published program text of the same group: matrices, spreads, end of a region."""


@pytest.fixture
def rng() -> Generator:
    return np.random.default_rng(2000)


def log_ratios(values: F64, params: MarkovThresholds) -> F64:
    """Logarithm of the ratio of likelihoods after every value, from the recursion of the test."""
    means, sigmas, h0, h1 = (
        np.array(t) for t in (params.means_deg, params.sigmas_deg, params.h0, params.h1)
    )
    ratios = np.empty(n := len(values))
    in_states = np.empty((3, n))
    power = np.empty(n, np.int64)
    HELPERS._densities.py_func(
        values, n, means, 0.5 / sigmas**2, np.log(sigmas), in_states, power, np.empty(n, np.int64)
    )
    densities = np.ascontiguousarray(in_states.T)
    for t in range(n):
        density = densities[t]
        if t == 0:
            first, zero = (
                tuple(initial * density) for initial in (params.initial_h1, params.initial_h0)
            )
        else:
            first, zero = (
                HELPERS._forward.py_func(s, h, density) for s, h in ((first, h1), (zero, h0))
            )
        ratios[t] = np.log(sum(first)) - np.log(sum(zero))
    return ratios


def log_likelihood(
    values: F64,
    params: MarkovThresholds,
    h: Matrix,
    initial: Row,
) -> float:
    """Logarithm of the likelihood of a model: the sum over all paths of states."""
    density = norm.logpdf(values[:, None], params.means_deg, params.sigmas_deg)
    with np.errstate(divide="ignore"):
        log_h = np.log(h)
        log_initial = np.log(initial)
    paths = []
    for path in product(range(3), repeat=len(values)):
        steps = sum(log_h[i, j] for i, j in pairwise(path))
        paths.append(log_initial[path[0]] + steps + sum(density[t, j] for t, j in enumerate(path)))
    return float(logsumexp(paths))


@pytest.mark.parametrize(
    "params",
    [
        MarkovThresholds(),
        made(MarkovThresholds, h0=SLOW, sigmas_deg=(20, 25, 30)),
        made(MarkovThresholds, initial_h1=(0.2, 0.3, 0.5)),
        SCRIPT,
    ],
)
def test_recursion_equals_the_sum_over_all_paths(rng: Generator, params: MarkovThresholds) -> None:
    for _ in range(5):
        values = rng.choice([-90.0, 10.0, 90.0], 6) + rng.normal(0, 5, 6)
        expected = [
            log_likelihood(values[: t + 1], params, params.h1, params.initial_h1)
            - log_likelihood(values[: t + 1], params, params.h0, params.initial_h0)
            for t in range(6)
        ]
        np.testing.assert_allclose(log_ratios(values, params), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            {"h0": [[0.9, 0.1, 0.1], [0.1, 0.9, 0.0], [0.0, 0.0, 1.0]]},
            "h0.*add up to 1, found a sum of 1.1",
        ),
        ({"h0": [[1.0, 0.0], [0.5, 0.5]]}, "h0"),
        ({"sigmas_deg": [30, 0, 30]}, "greater than 0"),
        ({"treshold": 1}, "did you mean 'threshold'"),
    ],
)
def test_wrong_parameters_are_told(table: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build(table_of(MarkovThresholds(), "vegetation"), table, "street.toml")


CODES = {"M": 0, "T": 1, "H": 2, "V": 3, "U": 4}
PARAMS = SuspiciousThresholds()


def trigger(states: str, params: SuspiciousThresholds = PARAMS) -> int:
    codes = np.array([[CODES[state] for state in states]], np.uint8)
    return int(suspicious(codes, np.array([len(states)], np.int32), params)[0])


def test_sky_fires() -> None:
    assert trigger("HHHVVVMMMM") == 6
