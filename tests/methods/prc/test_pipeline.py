"""The production pipeline, by blocks and threads, against the whole method as the paper has it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.core.classes import Label
from prc_cli.core.config import build
from prc_cli.core.types import F32
from prc_cli.methods.prc.pipeline import PrcParams
from prc_cli.methods.prc.support import (
    SupportParams,
    critical_zetas,
    stream_window,
    support,
    window_reach,
)
from tests.loops.twins import assert_equal_bits
from tests.methods.prc import paper
from tests.methods.prc.streams import random_params, random_stream, run_stream, to_settings
from tests.simulated import drive_arrays


def assert_equals_oracle(seed: int) -> set[int]:
    rng = np.random.default_rng(seed)
    params = random_params(rng)
    stream = random_stream(rng)
    labels, segments = run_stream(stream, params, int(rng.choice([1, 2, 5])))
    expected = paper.classify_stream(stream, to_settings(params, stream.shape[1]))
    assert_equal_bits((labels, segments), expected)
    assert_equal_bits(run_stream(stream, params, segments=False)[0], labels)
    return set(labels.ravel().tolist())


def test_pipeline_equals_the_oracle_for_any_block_length():
    seen: set[int] = set()
    for seed in range(200):
        seen |= assert_equals_oracle(seed)
    assert seen == {
        *(Label.MISSING, Label.NOISE, Label.GROUND, Label.BUILDING, Label.VEGETATION, Label.STEM)
    }, "the data does not show every class"


@given(st.integers(1000, 2**40))
def test_pipeline_equals_the_oracle_on_any_seed(seed):
    assert_equals_oracle(seed)


def test_pipeline_equals_the_oracle_at_the_published_parameters():
    image = drive_arrays(230, 400, 5)[0].range_m
    for params in (
        PrcParams(),
        build(
            PrcParams,
            {
                "lines_per_block": 70,
                "environment": "forest",
                "surfaces": {"area": "auto"},
                "forest": {"density": 0.9},
            },
            "test",
        ),
    ):
        labels = run_stream(image, params)
        assert_equal_bits(labels, paper.classify_stream(image, to_settings(params, 400)))
        assert len(np.unique(labels[0])) >= 4


def random_window(rng: np.random.Generator, n_lines: int, m: int) -> F32:
    """Ranges on a coarse grid, so that differences equal thresholds now and then.

    Every tenth is missing.
    """
    ranges = (rng.integers(40, 60, (n_lines, m)) * 0.125).astype(np.float32)
    ranges[rng.random(ranges.shape) < 0.1] = np.nan
    tail = rng.choice([5.0, 6.0, np.nan], window_reach(m)).astype(np.float32)
    return stream_window(tail, ranges, ranges[:1] if rng.random() < 0.5 else None)


@pytest.mark.parametrize("m", [1, 3, 40])
@pytest.mark.parametrize("rho_c", [1 / 3, 1.0])
@pytest.mark.parametrize("rounding", ["ceil", "floor"])
def test_they_say_what_any_thresholds_support(m, rho_c, rounding):
    rng = np.random.default_rng(m)
    for _ in range(10):
        window = random_window(rng, 6, m)
        for zeta_p, zeta_s in rng.choice([0.125, 0.2, 0.25, 0.3, 1.0, 1e9], (4, 2)):
            params = SupportParams(zeta_p=zeta_p, zeta_s=zeta_s, rho_c=rho_c, rounding=rounding)
            zetas = critical_zetas(window, m, params)
            below = (zetas.in_line_m.astype(float) < zeta_p) & (
                zetas.adjacent_m.astype(float) < zeta_s
            )
            np.testing.assert_array_equal(below, support(window, m, params))
            reach = window_reach(m)
            missing = np.isnan(window[reach : len(window) - reach]).reshape(below.shape)
            np.testing.assert_array_equal(np.isnan(zetas.in_line_m), missing)
            np.testing.assert_array_equal(np.isnan(zetas.adjacent_m), missing)


def test_too_few_neighbours_never_support():
    window = stream_window(
        np.full(6, np.nan, np.float32), np.array([[5, 5, 5, np.nan, 5]], np.float32), None
    )
    zetas = critical_zetas(window, 5, SupportParams())
    assert zetas.in_line_m[0].tolist()[:3] == [0.0, 0.0, 0.0]
    assert np.isinf(zetas.adjacent_m[0, [0, 1, 2, 4]]).all()
