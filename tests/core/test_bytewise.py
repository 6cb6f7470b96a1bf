from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.bytewise import count_bytes, recode


@pytest.mark.parametrize("top", [1, 5, 15, 16, 17, 255])
@pytest.mark.parametrize("shape", [(0,), (7,), (4095,), (4096,), (100, 99)])
def test_counts_are_those_of_bincount(shape: tuple[int, ...], top: int) -> None:
    values = np.random.default_rng(top).integers(0, top, shape, endpoint=True).astype(np.uint8)
    for given in (values, np.full(shape, top, np.uint8), values[::2]):
        np.testing.assert_array_equal(count_bytes(given), np.bincount(given.ravel(), minlength=256))


@pytest.mark.parametrize("shape", [(0,), (0, 5), (1,), (30, 40)])
def test_values_are_looked_up(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(1)
    values, table = rng.integers(0, 256, shape).astype(np.uint8), rng.integers(0, 256, 256).astype(np.uint8)
    for given in (values, values[::-1], np.asfortranarray(values)):
        found = recode(given, table)
        np.testing.assert_array_equal(found, table[given])
        assert found.flags.writeable
        assert not np.shares_memory(found, given)
