"""The production pipeline, block by block, against the whole method written from the paper."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from prc_cli.core.classes import Label
from prc_cli.core.config import build
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.stream import ScanBlock
from prc_cli.methods.base import LABELS_ALONE, OneByOne
from prc_cli.methods.prc.pipeline import Prc, PrcParams, initial_state
from tests.methods.prc.streams import random_params, random_stream, run_blocks, run_stream, to_settings, trace_block
from tests.oracles import prc_method as oracle_prc


def assert_equals_oracle(seed: int) -> set[int]:
    rng = np.random.default_rng(seed)
    params, stream = random_params(rng), random_stream(rng)
    labels, segments = run_stream(stream, params)
    expected_labels, expected_segments = oracle_prc.classify_stream(stream, to_settings(params, stream.shape[1]))
    np.testing.assert_array_equal(labels, expected_labels)
    np.testing.assert_array_equal(segments, expected_segments)
    assert labels.dtype == np.uint8
    assert segments.dtype == np.int64
    return set(labels.ravel().tolist())


def test_pipeline_equals_the_oracle_for_any_block_length() -> None:
    seen: set[int] = set()
    for seed in range(700):
        seen |= assert_equals_oracle(seed)
    assert seen == {
        *(Label.MISSING, Label.NOISE, Label.GROUND, Label.BUILDING, Label.VEGETATION, Label.STEM),
    }, "the data does not show every class"


@settings(deadline=None, max_examples=60)
@given(st.integers(1000, 2**40))
def test_pipeline_equals_the_oracle_on_any_seed(seed: int) -> None:
    assert_equals_oracle(seed)


def test_pipeline_equals_the_oracle_at_the_published_parameters() -> None:
    rng = np.random.default_rng(5)
    h = np.arange(400)
    street = np.where(np.abs(h - 100) < 90, 2 + np.abs(h - 100) / 8, np.where(h > 300, 14 - (h - 300) / 70, 9.0))
    stream = np.repeat(street[None], 230, axis=0)
    stream[120:140, 150:200] = 4.0  # a car
    foliage = (slice(60, 110), slice(220, 280))
    stream[foliage] += rng.uniform(-2, 2, (50, 60))
    stream += rng.integers(-3, 4, stream.shape) * 0.001
    noise = rng.random(stream.shape) < 0.03
    stream[noise] = rng.uniform(1, 80, np.count_nonzero(noise))
    stream[rng.random(stream.shape) < 0.05] = np.nan
    image = stream.astype(np.float32)
    for params in (
        PrcParams(),
        build(
            PrcParams,
            {"lines_per_block": 70, "environment": "forest", "surfaces": {"area": "auto"}, "forest": {"density": 0.9}},
            "test",
        ),
    ):
        labels, segments = run_stream(image, params)
        expected = oracle_prc.classify_stream(image, to_settings(params, 400))
        np.testing.assert_array_equal(labels, expected[0])
        np.testing.assert_array_equal(segments, expected[1])
        assert len(np.unique(labels)) >= 4


@pytest.mark.parametrize("seed", range(12))
def test_support_and_background_do_not_depend_on_block_length(seed: int) -> None:
    rng = np.random.default_rng(seed)
    stream, params = random_stream(rng), random_params(rng)
    expected_s = oracle_prc.support(stream, to_settings(params, stream.shape[1]))
    expected_g = oracle_prc.extended_background(stream, expected_s, to_settings(params, stream.shape[1]))
    for k in (1, 2, 3, 7, len(stream), 1000):
        traces = [trace for trace, _ in run_blocks(stream, params.model_copy(update={"lines_per_block": k}))]
        np.testing.assert_array_equal(np.concatenate([t.supported for t in traces]), expected_s)
        np.testing.assert_array_equal(np.concatenate([t.background for t in traces]), expected_g)


def test_state_can_be_stored_and_taken_up_again() -> None:
    stream = np.tile(np.linspace(5, 6, 40, dtype=np.float32), (30, 1))
    params = PrcParams(lines_per_block=10)
    state = initial_state(40)
    parts = []
    for first in (0, 10, 20):
        trace, state = trace_block(stream[first : first + 10], stream[first + 10 : first + 12], state, params)
        state = pickle.loads(pickle.dumps(state))
        parts.append(trace.labels)
    np.testing.assert_array_equal(np.concatenate(parts), run_stream(stream, params)[0])


def test_every_shot_is_labelled_once_and_segments_go_with_it() -> None:
    for seed in range(40):
        rng = np.random.default_rng(7000 + seed)
        stream, params = random_stream(rng), random_params(rng)
        labels, segments = run_stream(stream, params)
        np.testing.assert_array_equal(labels == Label.MISSING, np.isnan(stream))
        in_segment = np.isin(labels, [Label.BUILDING, Label.VEGETATION, Label.STEM])
        assert (segments[in_segment] > 0).all()
        assert (segments[(labels == Label.NOISE) | (labels == Label.MISSING)] == 0).all()


def test_trace_shows_the_images_on_the_way() -> None:
    image = np.full((9, 40), 20.0, dtype=np.float32)
    image[:, 20:] = 8.0
    image[4, 5] = 3.0
    trace, _ = trace_block(image, None, initial_state(40), PrcParams())
    assert not trace.supported[4, 5]
    assert trace.background[:, 19:21].all()
    assert not (trace.background & ~trace.supported).any()
    h = trace.components.to_segments()
    assert h[0, 0] != h[0, 30]
    assert (trace.surfaces.to_patches() == 0).all()
    np.testing.assert_array_equal(trace.segments, h)


@pytest.mark.parametrize("filling", [np.nan, 5.0])
@pytest.mark.parametrize("width", [1, 2, 3, 5])
def test_narrow_streams_of_one_kind(width: int, filling: float) -> None:
    stream = np.full((7, width), filling, dtype=np.float32)
    params = build(PrcParams, {"lines_per_block": 3, "surfaces": {"area": "auto"}}, "test")
    labels, _ = run_stream(stream, params)
    if np.isnan(filling):
        assert (labels == Label.MISSING).all()
    else:
        assert (labels[2:-2] == Label.GROUND).all()


@pytest.mark.parametrize(
    ("range_shape", "next_shape", "message"),
    [
        ((0, 5), (0, 5), "found 0 lines, expected 1 to 99"),
        ((100, 5), (0, 5), "found 100 lines, expected 1 to 99; cut the stream into blocks of prc.lines_per_block"),
        ((3, 4), (0, 5), r"found an array of shape \(3, 4\), expected \(lines, 5\) as the stream began"),
        ((3, 5), (1, 4), r"found an array of shape \(1, 4\), expected \(lines, 5\)"),
        ((5,), (0, 5), r"found an array of shape \(5,\)"),
    ],
)
def test_blocks_that_do_not_fit_are_refused(
    range_shape: tuple[int, ...], next_shape: tuple[int, ...], message: str
) -> None:
    block = ScanBlock(0, np.ones(range_shape, np.float32), next_m=np.ones(next_shape, np.float32))
    with pytest.raises(InputError, match=message):
        Prc(PrcParams()).label(block, 5, OneByOne(initial_state(5)), LABELS_ALONE)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"support": {"zeta_s": -1}}, "support.zeta_s: found -1, expected: .*greater than or equal to 0"),
        ({"support": {"zeta_p": float("nan")}}, "support.zeta_p"),
        ({"support": {"rho_c": 0}}, "support.rho_c: found 0, expected: .*greater than 0"),
        ({"support": {"rounding": "up"}}, "support.rounding: found 'up', expected: .*'ceil' or 'floor'"),
        ({"background": {"alpha": 0.5}}, "background.alpha: found 0.5, expected: .*less than 0.5"),
        ({"background": {"d_c": 0}}, "background.d_c: found 0"),
        ({"components": {"min_votes": 0}}, "components.min_votes: found 0"),
        ({"surfaces": {"area": 0}}, 'surfaces.area: expected: a positive number of pixels or "auto", found 0'),
        ({"surfaces": {"area": "large"}}, "surfaces.area: .* found 'large'"),
        ({"surfaces": {"area": True}}, "surfaces.area: .* found True"),
        ({"surfaces": {"area": float("inf")}}, "surfaces.area: .* found inf"),
        ({"surfaces": {"area": float("nan")}}, "surfaces.area: .* found nan"),
        ({"surfaces": {"gamma": 1.5}}, "surfaces.gamma: found 1.5"),
        ({"urban": {"ground": "largest"}}, "urban.ground: found 'largest'"),
        ({"forest": {"column_step": 0}}, "forest.column_step: found 0"),
        ({"lines_per_block": 0}, "lines_per_block: found 0"),
        ({"environment": "desert"}, "environment: found 'desert', expected: .*'urban' or 'forest'"),
        ({"surface": {}}, "unknown key 'surface'; did you mean 'surfaces'"),
        ({"support": {"zeta": 1}}, "unknown key 'support.zeta'; did you mean 'zeta_"),
    ],
)
def test_parameters_out_of_bounds_name_key_found_and_expected(table: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build(PrcParams, table, "drive.toml")
