"""Confusion matrices, scores, gates, intervals and splits."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from prc_cli.core.errors import InputError
from prc_cli.evaluation.confusion import ConfusionMatrix, GroupedCounts, accumulate, cells_of
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.evaluation.scores import (
    block_intervals,
    gate_value,
    scores,
)

FOREST = ("noise", "ground", "stem")
TABLE_II = np.array(
    [[15285576, 336704, 232019], [14741263, 6934955, 429704], [515205, 326183, 914452]]
)


@pytest.mark.parametrize("seed", range(4))
def test_scikit_learn_says_the_same(seed):
    metrics = pytest.importorskip("sklearn.metrics")
    rng = np.random.default_rng(seed)
    names = ("a", "b", "c", "d")
    reference = rng.choice(4, 3000, p=[0.6, 0.25, 0.1, 0.05])
    predicted = np.where(rng.random(3000) < 0.7, reference, rng.integers(0, 4, 3000))
    mapping = ClassMapping(
        predicted={name: (i,) for i, name in enumerate(names)},
        reference={name: (i,) for i, name in enumerate(names)},
    )
    matrix = accumulate(ConfusionMatrix.empty(mapping), predicted, reference, mapping)
    matrix_scores = scores(matrix)
    assert np.array_equal(matrix.counts, metrics.confusion_matrix(reference, predicted))
    precision, recall, f1, support = metrics.precision_recall_fscore_support(reference, predicted)
    iou = metrics.jaccard_score(reference, predicted, average=None)
    for i, item in enumerate(matrix_scores.classes):
        assert (item.recall, item.precision) == pytest.approx((recall[i], precision[i]))
        assert (item.f1, item.iou, item.n_reference) == pytest.approx((f1[i], iou[i], support[i]))
        assert item.accuracy == pytest.approx(
            metrics.accuracy_score(reference == i, predicted == i)
        )
    assert matrix_scores.accuracy == pytest.approx(metrics.accuracy_score(reference, predicted))
    assert matrix_scores.balanced_accuracy == pytest.approx(
        metrics.balanced_accuracy_score(reference, predicted)
    )
    assert matrix_scores.kappa == pytest.approx(metrics.cohen_kappa_score(reference, predicted))


def test_good_points_called_noise_are_a_share_of_the_reference():
    """Noise is no good point; every other class counts, those without counterpart too."""
    rows = ("noise", "ground", "wire")
    counts = np.array([[50, 5, 0], [10, 90, 0], [30, 10, 0]])
    columns = ("noise", "ground", "stem")
    table = scores(ConfusionMatrix(rows, columns, counts))
    by_name = {name: row.called_noise for name, row in table.by_name.items()}
    expected = {"noise": np.nan, "ground": 0.1, "wire": 0.75, "stem": np.nan}
    assert by_name == pytest.approx(expected, nan_ok=True)
    assert table.called_noise == 40 / 140
    # without noise among the predicted classes it is not defined
    table = scores(ConfusionMatrix(rows, ("a", "ground", "stem"), counts))
    assert np.isnan([table.called_noise, *(row.called_noise for row in table.classes)]).all()
    blocks = np.array([counts, counts, [[9, 1, 0], [2, 9, 0], [1, 1, 0]]])
    intervals = block_intervals(blocks, rows, columns)
    assert intervals["called_noise.ground"].low < 0.1 < intervals["called_noise.ground"].high


MAPPING = ClassMapping(
    ignore=(0,),
    predicted={"noise": (7,), "ground": (2,), "unclassified": (1,)},
    reference={"ground": (2, 66), "noise": (7,), "other": (65,)},
)


@given(
    pairs=st.lists(
        st.tuples(st.sampled_from([0, 1, 2, 7]), st.sampled_from([0, 2, 7, 65, 66])), max_size=60
    ),
    cut=st.integers(0, 60),
)
def test_any_cut_gives_the_same_counts(pairs, cut):
    codes = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    whole = accumulate(ConfusionMatrix.empty(MAPPING), codes[:, 0], codes[:, 1], MAPPING)
    state = ConfusionMatrix.empty(MAPPING)
    for part in (codes[:cut], codes[cut:]):
        state = accumulate(state, part[:, 0], part[:, 1], MAPPING)
    assert np.array_equal(whole.counts, state.counts)
    assert whole.n_ignored == state.n_ignored
    assert whole.n_scored + whole.n_ignored == len(pairs)


ROWS = ("ground", "stem", "other")
COLUMNS = ("noise", "ground", "stem")
NAMES = ROWS, COLUMNS


def blocks_of(n: int, seed: int = 0, size: int = 400) -> np.ndarray:
    """Blocks of equal size whose share of agreement differs."""
    random = np.random.default_rng(seed)
    blocks = []
    for _ in range(n):
        share = random.dirichlet([0.5, 8, 1, 0.5, 1, 6, 0.2, 0.5, 0.5])
        blocks.append(random.multinomial(size, share).reshape(3, 3))
    return np.array(blocks)


@pytest.mark.parametrize("name", ["recall.stem", "iou.ground", "kappa", "balanced_accuracy"])
def test_jackknife_by_hand(name):
    blocks = blocks_of(9)
    left_out = [
        gate_value(scores(ConfusionMatrix(*NAMES, np.delete(blocks, k, axis=0).sum(axis=0))), name)
        for k in range(9)
    ]
    error = np.sqrt(8 / 9 * np.sum((np.array(left_out) - np.mean(left_out)) ** 2))
    value = gate_value(scores(ConfusionMatrix(*NAMES, blocks.sum(axis=0))), name)
    interval = block_intervals(blocks, *NAMES)[name]
    half = stats.t.ppf(0.975, 8) * error
    assert (interval.low, interval.high) == pytest.approx((value - half, value + half))


TWO_CLASSES = ClassMapping(
    ignore=[0],
    predicted={"ground": [2], "building": [6]},
    reference={"ground": [2], "building": [6], "car": [65]},
)


@pytest.mark.parametrize("spread", [3, 1_000_000_007])
def test_groups_are_counted_as_if_alone(spread):
    random = np.random.default_rng(0)
    n = 5000
    group = random.integers(-1, 40, n) * spread
    predicted = random.choice([0, 2, 6], n)
    reference = random.choice([2, 6, 65], n)
    counts = GroupedCounts(TWO_CLASSES, "test")
    half = GroupedCounts(TWO_CLASSES, "test")
    cells = cells_of(TWO_CLASSES, predicted, TWO_CLASSES.class_indices(reference, "reference"))
    for part in np.array_split(np.arange(n), 7):
        (counts if part[0] < n // 2 else half).add(group[part], cells[part])
    counts.merge(half)
    assert counts.groups == tuple(np.unique(group).tolist())
    blocks = []
    for name in counts.groups:
        here = group == name
        expected = accumulate(
            ConfusionMatrix.empty(TWO_CLASSES), predicted[here], reference[here], TWO_CLASSES
        )
        np.testing.assert_array_equal(counts.matrix(name).counts, expected.counts)
        assert counts.matrix(name).n_ignored == expected.n_ignored
        blocks.append(expected.counts)
    np.testing.assert_array_equal(counts.scored(), blocks)


def test_kappa_may_lie_below_that_of_chance():
    """Two classes that are mistaken for each other."""
    blocks = np.array([[[k, 30], [30, k]] for k in range(6)])
    intervals = block_intervals(blocks, ("a", "b"), ("a", "b"))
    assert -1.0 <= intervals["kappa"].low < intervals["kappa"].high < 0.0
    assert intervals["accuracy"].low >= 0.0


def test_one_block_has_no_interval():
    with pytest.raises(InputError, match="at least 2 blocks with scored pairs, found 1"):
        block_intervals(TABLE_II[None], FOREST, FOREST)
