"""Counts by group, against one matrix per group."""

from __future__ import annotations

import math

import numpy as np
import pytest

from prc_cli.core.errors import ConfigError
from prc_cli.evaluation.confusion import (
    UNKNOWN,
    ConfusionMatrix,
    GroupedCounts,
    accumulate,
    cells_of,
    check_edges,
    range_bounds,
    range_groups,
)
from prc_cli.evaluation.mapping import ClassMapping

MAPPING = ClassMapping(
    ignore=[0], predicted={"ground": [2], "building": [6]}, reference={"ground": [2], "building": [6], "car": [65]}
)


@pytest.mark.parametrize("spread", [3, 1_000_000_007])
def test_groups_are_counted_as_if_alone(spread: int) -> None:
    random = np.random.default_rng(0)
    n = 5000
    group = random.integers(-1, 40, n) * spread
    predicted, reference = random.choice([0, 2, 6], n), random.choice([2, 6, 65], n)
    counts, half = GroupedCounts(MAPPING, "test"), GroupedCounts(MAPPING, "test")
    cells = cells_of(MAPPING, predicted, MAPPING.class_indices(reference, "reference"))
    for at in np.array_split(np.arange(n), 7):
        (counts if at[0] < n // 2 else half).add(group[at], cells[at])
    counts.merge(half)
    assert counts.groups == tuple(np.unique(group).tolist())
    blocks = []
    for name in counts.groups:
        here = group == name
        expected = accumulate(ConfusionMatrix.empty(MAPPING), predicted[here], reference[here], MAPPING)
        np.testing.assert_array_equal(counts.matrix(name).counts, expected.counts)
        assert counts.matrix(name).n_ignored == expected.n_ignored
        blocks.append(expected.counts)
    np.testing.assert_array_equal(counts.scored(), blocks)
    assert counts.matrix(123_456).n_scored == 0
    empty = GroupedCounts(MAPPING, "test")
    empty.add(np.empty(0, np.int64), np.empty(0, np.int64))
    counts.merge(empty)
    assert empty.scored().shape == (0, 3, 2)


def test_blocks_without_scored_pairs_do_not_count() -> None:
    counts = GroupedCounts(MAPPING, "test")
    counts.add(np.array([0, 1]), cells_of(MAPPING, np.array([0, 2]), np.array([0, 0])))
    assert counts.groups == (0, 1)
    assert len(counts.scored()) == 1


def test_ranges() -> None:
    edges = check_edges((0.0, 10.0, 20.0))
    groups = range_groups(np.array([0.0, 9.99, 10.0, 20.0, 1e9, np.nan]), edges)
    assert groups.tolist() == [1, 1, 2, 3, 3, UNKNOWN]
    assert range_bounds(1, edges) == ("0-10 m", 0.0, 10.0)
    assert range_bounds(3, edges) == ("from 20 m", 20.0, math.inf)


@pytest.mark.parametrize("edges", [(1.0, 1.0), (2.0, 1.0), (-1.0,), (math.nan,), (math.inf,)])
def test_bad_edges(edges: tuple[float, ...]) -> None:
    with pytest.raises(ConfigError, match="expected ascending ranges"):
        check_edges(edges)
