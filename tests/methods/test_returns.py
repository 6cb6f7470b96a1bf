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


def label(image: list[list[float]], labels: list[list[int]], cell: tuple[int, int], range_m: float) -> int:
    found = label_extra_returns(
        np.array(image, np.float32),
        np.array(labels, np.uint8),
        np.array([cell[0]], np.int32),
        np.array([cell[1]], np.int32),
        np.array([range_m], np.float32),
        zeta_p=1.0,
        zeta_s=1.0,
    )
    return int(found[0])


def test_nothing_in_reach_is_noise() -> None:
    assert label([[20, 20, 20]], [[3, 3, 3]], (0, 1), 21.0) == Label.NOISE
    assert label([[20, 20, 20]], [[3, 3, 3]], (0, 1), 20.99) == Label.GROUND
    assert label([[np.nan] * 3], [[0] * 3], (0, 1), 20.0) == Label.NOISE


def test_five_columns_away_is_out_of_reach() -> None:
    assert label([[9, 9, 9, 9, 9, 20]], [[5, 5, 5, 5, 5, 3]], (0, 0), 20.0) == Label.NOISE
    assert label([[9, 9, 9, 9, 20]], [[5, 5, 5, 5, 3]], (0, 0), 20.0) == Label.GROUND


def test_of_equal_differences_the_line_goes_first_then_the_order_of_the_stream() -> None:
    assert label([[8, 20, 8], [8, 20.5, 8]], [[1, 4, 1], [1, 3, 1]], (1, 1), 20.25) == Label.GROUND
    assert label([[20, 8, 20.5]], [[4, 1, 3]], (0, 1), 20.25) == Label.BUILDING
    assert label([[8, 20, 8], [8, 8, 8], [8, 20, 8]], [[1, 4, 1], [1, 1, 1], [1, 3, 1]], (1, 1), 20.0) == Label.BUILDING


def test_lines_do_not_wrap() -> None:
    assert label([[9, 9, 20], [9, 9, 9]], [[5, 5, 3], [5, 5, 5]], (1, 0), 20.0) == Label.NOISE


def test_return_without_range_is_missing() -> None:
    assert label([[20, 20, 20]], [[3, 3, 3]], (0, 1), np.nan) == Label.MISSING


def test_no_further_returns() -> None:
    none = np.empty(0, np.int32)
    image, labels = np.ones((2, 2), np.float32), np.full((2, 2), 3, np.uint8)
    found = label_extra_returns(image, labels, none, none, np.empty(0, np.float32), 1.0, 1.0)
    assert found.shape == (0,)
    assert found.dtype == np.uint8
