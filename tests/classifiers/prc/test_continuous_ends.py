"""Continuous processing where segments end: the line before a block has segments that the block lacks."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.classifiers.prc.pipeline import PrcParams
from prc_cli.core.classes import Label
from prc_cli.core.types import F32
from tests.classifiers.prc.test_continuous import continuously

M = 24


def two_walls(n_lines: int, *, second_ends: int) -> F32:
    """A near wall that goes on, and a far one, younger in the order of segments, that ends."""
    image = np.full((n_lines, M), 5.0, np.float32)
    image[:, M // 2 :] = np.nan
    image[:second_ends, M // 2 + 2 : -2] = 20.0
    return image


@pytest.mark.parametrize("hop", [1, 2, 3])
@pytest.mark.parametrize("ground", ["running-total", "block"])
def test_the_youngest_segment_ends_at_the_line_before_a_block(hop: int, ground: str) -> None:
    params = PrcParams.model_validate(
        {"lines_per_block": 3, "surfaces": {"area": 3.0, "gamma": 0}, "urban": {"ground": ground}}
    )
    labels = continuously(two_walls(12, second_ends=6), params, hop)
    assert (labels[7:, 1 : M // 2 - 1] == Label.GROUND).all()
    assert (labels[7:, M // 2 :] == Label.MISSING).all()


@pytest.mark.parametrize("seed", range(6))
def test_random_stretches_of_clean_walls(seed: int) -> None:
    rng = np.random.default_rng(seed)
    width, k = int(rng.choice([1, 2, 3, 9, 40])), int(rng.choice([1, 2, 5, 8]))
    # whole lines of few ranges, each of some length: segments begin and end, often all at once
    image = np.repeat(rng.choice([5.0, 20.0, np.nan], (30, -(-width // 4))), 4, axis=1)[:, :width].astype(np.float32)
    image = np.repeat(image, rng.integers(1, 5, len(image)), axis=0)
    params = PrcParams.model_validate({"lines_per_block": k, "surfaces": {"area": 1.0}})
    for hop in range(1, k + 1):
        labels = continuously(image, params, hop)
        np.testing.assert_array_equal(labels == Label.MISSING, np.isnan(image))
