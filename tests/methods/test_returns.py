"""Further returns get the label of the shot with a similar range."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.types import F32, U8
from prc_cli.methods.returns import label_extra_returns


def label_one(image: F32, labels: U8, cell: tuple[int, int], range_m: float, zeta_p: float, zeta_s: float) -> int:
    """What the rule says, one return and one cell at a time."""
    line, column = cell
    candidates = []
    for order, (y, x, zeta) in enumerate(
        [(line, column + dx, zeta_p) for dx in range(-4, 5)]
        + [(line + dy, column + dx, zeta_s) for dy in (-1, 1) for dx in (-1, 0, 1)]
    ):
        if 0 <= y < image.shape[0] and 0 <= x < image.shape[1] and not np.isnan(image[y, x]):
            difference = abs(float(np.float32(range_m) - image[y, x]))
            if difference < zeta:
                candidates.append((difference, order, int(labels[y, x])))
    return min(candidates)[2] if candidates else Label.NOISE


@pytest.mark.parametrize(("zeta_p", "zeta_s"), [(1.0, 1.0), (0.25, 1.0), (1.0, 0.1), (0.0, 0.5)])
def test_rule_one_return_at_a_time(zeta_p: float, zeta_s: float) -> None:
    rng = np.random.default_rng(11)
    for n_lines, width in [(1, 1), (1, 12), (2, 3), (9, 15)]:
        image = (rng.integers(16, 40, (n_lines, width)) / 8).astype(np.float32)
        image[rng.random(image.shape) < 0.2] = np.nan
        labels = rng.integers(1, 7, image.shape).astype(np.uint8)
        line, column = rng.integers(n_lines, size=200), rng.integers(width, size=200)
        ranges = (rng.integers(16, 48, 200) / 8).astype(np.float32)
        found = label_extra_returns(
            image, labels, line.astype(np.int32), column.astype(np.int32), ranges, zeta_p, zeta_s
        )
        expected = [
            label_one(image, labels, (y, x), r, zeta_p, zeta_s) for y, x, r in zip(line, column, ranges, strict=True)
        ]
        assert found.dtype == np.uint8
        np.testing.assert_array_equal(found, expected)
