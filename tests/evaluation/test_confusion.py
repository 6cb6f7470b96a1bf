from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from prc_cli.core.errors import InputError
from prc_cli.evaluation.confusion import ConfusionMatrix, accumulate, refuse_poor_match
from prc_cli.evaluation.mapping import ClassMapping

MAPPING = ClassMapping(
    ignore=(0,),
    predicted={"noise": (7,), "ground": (2,), "unclassified": (1,)},
    reference={"ground": (2, 66), "noise": (7,), "other": (65,)},
)


def test_counts_by_hand() -> None:
    predicted = np.array([2, 2, 7, 1, 2, 0, 2, 7])
    reference = np.array([2, 66, 2, 2, 65, 0, 0, 7])
    matrix = accumulate(ConfusionMatrix.empty(MAPPING), predicted, reference, MAPPING)
    assert matrix.reference_names == ("ground", "noise", "other")
    assert matrix.predicted_names == ("noise", "ground", "unclassified")
    assert matrix.counts.tolist() == [[1, 2, 1], [1, 0, 0], [0, 1, 0]]
    assert matrix.n_ignored == 2
    assert matrix.counts.dtype == np.int64
    assert matrix.scored_names == ("ground", "noise")


@settings(deadline=None, max_examples=60)
@given(
    pairs=st.lists(st.tuples(st.sampled_from([0, 1, 2, 7]), st.sampled_from([0, 2, 7, 65, 66])), max_size=60),
    cut=st.integers(0, 60),
)
def test_any_cut_gives_the_same_counts(pairs: list[tuple[int, int]], cut: int) -> None:
    codes = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    whole = accumulate(ConfusionMatrix.empty(MAPPING), codes[:, 0], codes[:, 1], MAPPING)
    state = ConfusionMatrix.empty(MAPPING)
    for part in (codes[:cut], codes[cut:]):
        state = accumulate(state, part[:, 0], part[:, 1], MAPPING)
    assert np.array_equal(whole.counts, state.counts)
    assert whole.n_ignored == state.n_ignored
    assert whole.n_scored + whole.n_ignored == len(pairs)


def test_different_lengths_are_refused_with_both_counts() -> None:
    with pytest.raises(InputError, match="3 records, but reference holds 2; matched by order needs equal counts"):
        accumulate(ConfusionMatrix.empty(MAPPING), np.array([2, 2, 2]), np.array([2, 2]), MAPPING)
    with pytest.raises(InputError, match=r"a\.npy: 5 records, but b\.las holds 4;"):
        refuse_poor_match(5, 4, "a.npy", "b.las")
    refuse_poor_match(4, 4)


def test_shares_of_empty_rows_and_columns_are_undefined() -> None:
    matrix = ConfusionMatrix(("a", "b"), ("a", "b", "c"), np.array([[3, 1, 0], [0, 0, 0]]))
    assert np.array_equal(matrix.row_shares(), [[0.75, 0.25, 0.0], [np.nan] * 3], equal_nan=True)
    assert np.array_equal(matrix.column_shares(), [[1.0, 1.0, np.nan], [0.0, 0.0, np.nan]], equal_nan=True)


def test_trimmed_keeps_a_class_that_one_side_uses() -> None:
    counts = np.array([[4, 0, 0, 0], [2, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]])
    matrix = ConfusionMatrix(("ground", "building", "stem", "other"), ("ground", "building", "stem", "lost"), counts, 3)
    shown = matrix.trimmed()
    assert shown.reference_names == ("ground", "building")
    assert shown.predicted_names == ("ground", "building")
    assert shown.counts.tolist() == [[4, 0], [2, 0]]
    assert shown.n_ignored == 3
