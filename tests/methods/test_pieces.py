"""Pieces of the methods that blocks seldom reach, compared with plain ones."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from prc_cli.methods.prc.urban import Totals
from prc_cli.methods.sequential_angle.curb import CurbState, _tail
from prc_cli.methods.sequential_angle.lines import to_columns
from prc_cli.methods.sequential_angle.thresholds import CurbThresholds


@pytest.mark.parametrize("n", [0, 1, 3])
@pytest.mark.parametrize("n_new", [0, 1, 2, 3, 4, 9])
def test_the_last_rows_stay(n: int, n_new: int) -> None:
    before, new = np.arange(n, dtype=np.float32), 10 + np.arange(n_new, dtype=np.float32)
    assert _tail(before, new).tolist() == np.concatenate([before, new])[len(before) + n_new - n :].tolist()


def test_curbs_begin_without_regions() -> None:
    params = CurbThresholds()
    state = CurbState.start(2, 7, params)
    regions = state.regions
    assert regions.n_given == 1
    assert regions.labels.tolist() == [[0] * 7] * 2
    for values in (regions.side, regions.first, regions.last, regions.possible, regions.low_m, regions.high_m):
        assert values.shape == (0,)
    assert state.xyz_m.shape == (2, 7, 3)
    assert state.signed_deg.shape == (2 * (params.min_lines - 1), 7)
    assert np.isnan(state.xyz_m).all()
    assert np.isnan(state.signed_deg).all()


@pytest.mark.parametrize("seed", range(5))
def test_counts_of_segments_by_id(seed: int) -> None:
    rng = np.random.default_rng(seed)
    known = dict(zip(np.sort(rng.choice(30, 8, replace=False)).tolist(), rng.integers(1, 99, 8).tolist(), strict=True))
    totals = Totals(np.array(list(known)), np.array(list(known.values())))
    assert totals.of(np.arange(-2, 35)).tolist() == [known.get(one, 0) for one in range(-2, 35)]
    assert Totals.none().of(np.arange(3)).tolist() == [0, 0, 0]
    assert Totals.none().ids.shape == Totals.none().counts.shape == (0,)


@pytest.mark.parametrize(
    "columns",
    [[[3, 4, 5], [2, 1, 0]], [[0, 2, 4], [5, 3, 1]], [[4], [0]], [[5, 0, 1], [4, 3, 2]], [[0, 1, 3], [5, 4, 2]]],
)
def test_rows_of_sides_go_back_to_their_columns(columns: list[list[int]]) -> None:
    n = len(columns[0])
    sides: Any = SimpleNamespace(n_sides=2, n_beams=np.array([n, n]), columns=np.array([[*one, 0] for one in columns]))
    rows = np.arange(1, 2 * 2 * (n + 1) + 1).reshape(4, n + 1)
    expected = np.zeros((2, 6), np.int64)
    for row, values in enumerate(rows.tolist()):
        for k, column in enumerate(columns[row % 2]):
            expected[row // 2, column] = values[k]
    assert to_columns(rows, sides, 6).tolist() == expected.tolist()
