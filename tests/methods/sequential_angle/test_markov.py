"""The test between two hidden Markov models: against likelihoods summed over paths, and at the ends of data."""

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
from prc_cli.methods.sequential_angle.coarse import hmm_cusum
from prc_cli.methods.sequential_angle.thresholds import UNIFORM, MarkovThresholds, Matrix, Row
from tests.methods.sequential_angle.made import made

HELPERS: Any = kernel_module
"""Their plain functions are called: compiled, helpers have no way in from outside."""

SLOW = ((0.9, 0.05, 0.05), (0.05, 0.9, 0.05), (0.05, 0.05, 0.9))
SCRIPT = made(
    MarkovThresholds,
    means_deg=(90, 15, -90),
    sigmas_deg=(12, 2, 2),
    h0=((0.9, 0.1, 0), (0.1, 0.9, 0), (0, 0, 1)),
    initial_h0=UNIFORM,
    sprt=True,
    backdate=False,
)
"""Published program text of the same group: matrices, spreads, end of a region."""


@pytest.fixture
def rng() -> Generator:
    return np.random.default_rng(2000)


def log_ratios(values: F64, params: MarkovThresholds) -> F64:
    """Logarithm of the ratio of likelihoods after every value, from the recursion that the test runs on."""
    means, sigmas, h0, h1 = (np.array(t) for t in (params.means_deg, params.sigmas_deg, params.h0, params.h1))
    found, in_states, power = np.empty(n := len(values)), np.empty((3, n)), np.empty(n, np.int64)
    HELPERS._densities.py_func(
        values, n, means, 0.5 / sigmas**2, np.log(sigmas), in_states, power, np.empty(n, np.int64)
    )
    densities = np.ascontiguousarray(in_states.T)
    for t in range(n):
        density = densities[t]
        if t == 0:
            one, zero = (tuple(initial * density) for initial in (params.initial_h1, params.initial_h0))
        else:
            one, zero = (HELPERS._forward.py_func(s, h, density) for s, h in ((one, h1), (zero, h0)))
        found[t] = np.log(sum(one)) - np.log(sum(zero))
    return found


def log_likelihood(values: F64, params: MarkovThresholds, h: Matrix, initial: Row) -> float:
    """Logarithm of the likelihood of a model: the sum over all paths of states."""
    density = norm.logpdf(values[:, None], params.means_deg, params.sigmas_deg)
    with np.errstate(divide="ignore"):
        log_h, log_initial = np.log(h), np.log(initial)
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


def test_first_alarm_is_where_the_likelihoods_of_the_stretch_say(rng: Generator) -> None:
    """Restarts and onset found anew for every start, from whole stretches rather than step by step."""
    params = made(MarkovThresholds, backdate=False)
    onsets, alarms = [], []
    for _ in range(25):
        values = np.where(rng.random(200) < 0.3, -90, 90) + rng.normal(0, 20, 200)
        values[: rng.integers(0, 60)] = 90
        values = values.astype(np.float32).astype(np.float64)
        begin = 0
        while begin < 200:
            ratio = log_ratios(values[begin:], params)
            stop = np.flatnonzero((ratio < 0) | (ratio > params.threshold))
            if len(stop) == 0:
                begin = 200
            elif ratio[stop[0]] > 0:
                break
            else:
                begin += int(stop[0]) + 1
        found = np.flatnonzero(hmm_cusum(values[None].astype(np.float32), params)[0])
        dated = np.flatnonzero(hmm_cusum(values[None].astype(np.float32), MarkovThresholds())[0])
        if begin == 200:
            assert len(found) == 0
            continue
        assert dated[0] == begin
        assert found[0] == begin + stop[0]
        onsets.append(begin)
        alarms.append(int(stop[0]))
    assert len(set(onsets)) > 10
    assert len(set(alarms)) > 5


def test_regions_are_dated_back_to_the_onset_at_both_ends() -> None:
    values = np.array([[90.0] * 20 + [-90.0] * 30 + [0.0] * 30], np.float32)
    dated = np.flatnonzero(hmm_cusum(values, MarkovThresholds())[0])
    assert abs(dated[0] - 20) <= 1
    assert abs(dated[-1] - 49) <= 1
    assert len(dated) == dated[-1] - dated[0] + 1
    alarms = np.flatnonzero(hmm_cusum(values, made(MarkovThresholds, backdate=False))[0])
    assert alarms[0] == dated[0] + 5, "10 nats at 1.9 a sample"
    assert 49 + 10 <= alarms[-1] <= 49 + 12
    # thresholds each way
    quick = np.flatnonzero(hmm_cusum(values, made(MarkovThresholds, backdate=False, threshold=4, threshold_back=2))[0])
    assert quick[0] < alarms[0]
    assert quick[-1] < alarms[-1]


def test_extreme_values_and_long_sequences_stay_finite(rng: Generator) -> None:
    """Densities vanish with narrow states; likelihoods would long have vanished without their common scale."""
    values = rng.choice([-90.0, 15.0, 90.0], (2, 20_000)).astype(np.float32)
    values[1] = 50.0
    for params in (SCRIPT, MarkovThresholds()):
        found = hmm_cusum(values, params)
        assert found[0].mean() > 0.9
        assert not found[1].any()
    values[0] = rng.choice([-360.0, -180.0, 0.0, 180.0, 360.0], 20_000)
    locked = made(MarkovThresholds, sigmas_deg=(0.01, 0.01, 0.01), h1=((1, 0, 0), (0, 1, 0), (0, 0, 1)), h0=SLOW)
    assert hmm_cusum(values, locked).shape == values.shape
    # no state but the first, and values far from it: neither model can explain them
    nowhere = made(
        MarkovThresholds,
        sigmas_deg=(0.01, 0.01, 0.01),
        h0=((1, 0, 0),) * 3,
        h1=((1, 0, 0),) * 3,
        initial_h0=(1, 0, 0),
        initial_h1=(1, 0, 0),
    )
    assert not hmm_cusum(values, nowhere).any()


def test_false_alarms_are_rarer_than_the_bound(rng: Generator) -> None:
    """Wald: under model 0 itself at least exp(h) samples pass between two alarms on the mean."""
    params = made(MarkovThresholds, threshold=4, backdate=False)
    h0 = np.cumsum(params.h0, axis=1)
    state = np.full(2000, 1)
    values = np.empty((2000, 100), np.float32)
    for t in range(100):
        state = np.minimum((rng.random(2000)[:, None] > h0[state]).sum(axis=1), 2)
        values[:, t] = np.array(params.means_deg)[state] + rng.normal(0, 30, 2000)
    alarmed = hmm_cusum(values, params).any(axis=1).mean()
    assert 0 < alarmed < 100 / np.exp(4)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"h0": [[0.9, 0.1, 0.1], [0.1, 0.9, 0.0], [0.0, 0.0, 1.0]]}, "h0.*add up to 1, found a sum of 1.1"),
        ({"initial_h0": [0.5, 0.5, 0.5]}, "initial_h0.*add up to 1"),
        ({"h1": [[1.0, 0.0], [0.5, 0.5]]}, "h1"),
        ({"sigmas_deg": [30, 0, 30]}, "greater than 0"),
        ({"sprt": "never"}, "sprt"),
        ({"treshold": 1}, "did you mean 'threshold'"),
    ],
)
def test_wrong_parameters_are_told(table: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build(table_of(MarkovThresholds(), "vegetation"), table, "street.toml")
