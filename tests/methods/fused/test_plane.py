from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.types import F32
from prc_cli.methods.fused.range_noise import _middle, off_lines, range_noise


@pytest.mark.parametrize("n", [1, 2, 3, 8, 9, 200, 201])
def test_the_middle_is_the_median(n: int) -> None:
    values = np.random.default_rng(n).choice(np.array([0.5, 1.0, 2.5, 7.0], np.float32), n)
    assert _middle(values.copy()) == np.median(values)


@pytest.mark.parametrize(("n", "is_known"), [(100, True), (99, False)])
def test_noise_takes_a_hundred_triples_of_shots(n: int, is_known: bool) -> None:
    side: F32 = np.linspace(1, 9, n + 2, dtype=np.float32)[None]
    height = np.random.default_rng(2).normal(-2, 0.01, side.shape).astype(np.float32)
    assert (range_noise(off_lines(side, height)) is not None) is is_known
