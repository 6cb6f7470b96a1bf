"""Continuous processing: a few new lines at a time, classified in the last k lines."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.classifiers.prc import continuous
from prc_cli.classifiers.prc.continuous import ContinuousPrc
from prc_cli.classifiers.prc.pipeline import PrcParams
from prc_cli.classifiers.run import run_blocks
from prc_cli.core.classes import Label
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, U8
from tests.classifiers.prc.streams import random_stream, run_stream
from tests.street import street


def continuously(image: F32, params: PrcParams, hop: int) -> U8:
    state, labels = continuous.initial_state(image.shape[1]), []
    for first in range(0, len(image), hop):
        new, state = continuous.classify_lines(
            image[first : first + hop], image[first + hop : first + hop + 4], state, params
        )
        assert len(state.range_m) <= params.lines_per_block
        labels.append(new)
    return np.concatenate(labels)


def whole_blocks(image: F32, k: int) -> F32:
    """Cut a stream such that its last block is as long as the others."""
    return np.concatenate([image] * k)[: max(len(image) // k, 1) * k]


def published(environment: str, k: int) -> PrcParams:
    return PrcParams.model_validate(
        {"environment": environment, "lines_per_block": k, "surfaces": {"area": 6.0, "gamma": 1}}
    )


@pytest.mark.parametrize("environment", ["urban", "forest"])
@pytest.mark.parametrize("seed", range(12))
def test_a_hop_of_a_block_is_algorithm_1(environment: str, seed: int) -> None:
    params = published(environment, 7)
    image = whole_blocks(random_stream(np.random.default_rng(seed)), 7)
    np.testing.assert_array_equal(continuously(image, params, 7), run_stream(image, params)[0])


@pytest.mark.parametrize("environment", ["urban", "forest"])
@pytest.mark.parametrize("hop", [1, 2, 3, 5])
@pytest.mark.parametrize("seed", range(4))
def test_whatever_the_hop_the_first_block_ends_the_same_and_noise_never_differs(
    environment: str, hop: int, seed: int
) -> None:
    params = published(environment, 6)
    image = random_stream(np.random.default_rng(100 + seed))
    whole, found = run_stream(image, params)[0], continuously(image, params, hop)
    assert found.shape == image.shape
    if environment == "urban":
        np.testing.assert_array_equal(found == Label.NOISE, whole == Label.NOISE)
    np.testing.assert_array_equal(found == Label.MISSING, np.isnan(image))
    if 6 % hop == 0:
        # the block that is full for the first time is the first block of Algorithm 1: nothing lies before it
        np.testing.assert_array_equal(found[6 - hop : 6], whole[6 - hop : 6])


def test_the_ground_keeps_its_label_while_the_block_moves_on() -> None:
    """A facade fills the block for a while; the road before it had more shots, and goes on below the facade."""
    image = np.full((60, 40), 5.0, dtype=np.float32)
    image[12:, 18:] = 30.0  # more of the block than what is left of the road
    image[12, 18:] = np.nan
    params = PrcParams(lines_per_block=10)
    labels = continuously(image, params, 1)
    assert (labels[:12] == Label.GROUND).all()
    assert (labels[16:40, 2:15] == Label.GROUND).all()
    assert (labels[16:40, 22:-2] == Label.BUILDING).all()


def test_further_returns_have_no_labels() -> None:
    image = street()[:12]
    blocks = [ScanBlock(first, image[first : first + 3]) for first in range(0, 12, 3)]
    found = list(run_blocks(iter(blocks), ContinuousPrc(PrcParams(lines_per_block=6), 3)))
    assert sum(item.labels.size for item in found) == image.size
    assert [len(item.extra_labels) for item in found] == [0] * len(found)
