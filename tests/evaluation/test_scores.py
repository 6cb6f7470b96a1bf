"""Scores against the figures of Lehtola et al. (2019) and against scikit-learn."""

from __future__ import annotations

import math

import numpy as np
import pytest

from prc_cli.core.errors import ConfigError
from prc_cli.evaluation.confusion import ConfusionMatrix, accumulate
from prc_cli.evaluation.mapping import ClassMapping, load_mapping
from prc_cli.evaluation.scores import gate_value, scores

FOREST = ("noise", "ground", "stem")
TABLE_II = np.array([[15285576, 336704, 232019], [14741263, 6934955, 429704], [515205, 326183, 914452]])
TABLE_I = {
    "noise": (0.541, 0.286, 0.095, 0.077),
    "ground": (0.003, 0.964, 0.010, 0.023),
    "vegetation": (0.113, 0.084, 0.665, 0.137),
    "building": (0.042, 0.222, 0.125, 0.611),
    "other": (0.165, 0.592, 0.120, 0.123),
}


@pytest.mark.parametrize(
    ("gate", "printed"),
    [
        ("precision.stem", 0.580),
        ("precision.ground", 0.913),
        ("accuracy.stem", 0.962),  # the text rounds it to 96.1 %
        ("accuracy.ground", 0.601),  # the text says 60.0 %
        ("recall.ground", 0.314),
        ("recall.stem", 0.521),  # the counts give .521, the printed .50 does not follow from them
        ("recall.noise", 0.964),  # likewise .964 against .93
        ("accuracy", 0.583),
    ],
)
def test_table_ii_of_the_paper(gate: str, printed: float) -> None:
    found = scores(ConfusionMatrix(FOREST, FOREST, TABLE_II))
    assert gate_value(found, gate) == pytest.approx(printed, abs=0.0006)
    assert found.n_scored == 39_716_061


def test_table_ii_from_codes_in_chunks() -> None:
    mapping = load_mapping("lehtola_forest")
    reference_codes, predicted_codes = [7, 2, 64], [5, 2, 64]
    state = ConfusionMatrix.empty(mapping)
    for i, j in np.ndindex(3, 3):
        n = int(TABLE_II[i, j]) // 1000
        state = accumulate(state, np.full(n, predicted_codes[j]), np.full(n, reference_codes[i]), mapping)
    assert scores(state).accuracy == pytest.approx(0.583, abs=0.0006)


def test_table_i_of_the_paper_as_row_shares() -> None:
    mapping = load_mapping("lehtola_urban")
    matrix = ConfusionMatrix.empty(mapping)
    reference_codes = dict(zip(TABLE_I, (7, 2, 5, 6, 65), strict=True))
    for name, row in TABLE_I.items():
        for code, share in zip((7, 2, 5, 6), row, strict=True):
            n = round(1000 * share)
            matrix = accumulate(matrix, np.full(n, code), np.full(n, reference_codes[name]), mapping)
    shown = matrix.trimmed()
    assert shown.reference_names == tuple(TABLE_I)
    assert shown.predicted_names == ("noise", "ground", "vegetation", "building")
    assert np.allclose(shown.row_shares(), list(TABLE_I.values()), atol=0.001)
    found = scores(shown)
    assert gate_value(found, "recall.ground") == pytest.approx(0.964, abs=0.001)
    assert math.isnan(gate_value(found, "recall.other"))


@pytest.mark.parametrize("seed", range(5))
def test_scikit_learn_says_the_same(seed: int) -> None:
    metrics = pytest.importorskip("sklearn.metrics")
    rng = np.random.default_rng(seed)
    names = ("a", "b", "c", "d")
    reference = rng.choice(4, 3000, p=[0.6, 0.25, 0.1, 0.05])
    predicted = np.where(rng.random(3000) < 0.7, reference, rng.integers(0, 4, 3000))
    mapping = ClassMapping(
        predicted={name: (i,) for i, name in enumerate(names)}, reference={name: (i,) for i, name in enumerate(names)}
    )
    matrix = accumulate(ConfusionMatrix.empty(mapping), predicted, reference, mapping)
    found = scores(matrix)
    assert np.array_equal(matrix.counts, metrics.confusion_matrix(reference, predicted))
    precision, recall, f1, support = metrics.precision_recall_fscore_support(reference, predicted)
    iou = metrics.jaccard_score(reference, predicted, average=None)
    for i, item in enumerate(found.classes):
        assert (item.recall, item.precision) == pytest.approx((recall[i], precision[i]))
        assert (item.f1, item.iou, item.n_reference) == pytest.approx((f1[i], iou[i], support[i]))
        assert item.accuracy == pytest.approx(metrics.accuracy_score(reference == i, predicted == i))
    assert found.accuracy == pytest.approx(metrics.accuracy_score(reference, predicted))
    assert found.balanced_accuracy == pytest.approx(metrics.balanced_accuracy_score(reference, predicted))
    assert found.kappa == pytest.approx(metrics.cohen_kappa_score(reference, predicted))


def test_kappa_with_classes_of_one_side_only() -> None:
    metrics = pytest.importorskip("sklearn.metrics")
    mapping = ClassMapping(predicted={"a": (0,), "b": (1,), "p": (2,)}, reference={"b": (1,), "a": (0,), "r": (3,)})
    rng = np.random.default_rng(9)
    predicted, reference = rng.choice([0, 1, 2], 500), rng.choice([0, 1, 3], 500)
    found = scores(accumulate(ConfusionMatrix.empty(mapping), predicted, reference, mapping))
    assert found.kappa == pytest.approx(metrics.cohen_kappa_score(reference, predicted))
    assert found.accuracy == pytest.approx(metrics.accuracy_score(reference, predicted))
    assert [item.name for item in found.classes] == ["b", "a", "r", "p"]


def test_undefined_is_nan_and_zero_is_zero() -> None:
    # no b in the reference, c never predicted, d in neither
    names = ("a", "b", "c", "d")
    counts = np.array([[5, 2, 0, 0], [0, 0, 0, 0], [4, 0, 0, 0], [0, 0, 0, 0]])
    a, b, c, d = scores(ConfusionMatrix(names, names, counts)).classes
    assert math.isnan(b.recall)
    assert (b.precision, b.f1, b.iou) == (0.0, 0.0, 0.0)
    assert math.isnan(c.precision)
    assert (c.recall, c.f1, c.iou) == (0.0, 0.0, 0.0)
    assert all(math.isnan(value) for value in (d.recall, d.precision, d.f1, d.iou))
    assert d.accuracy == 1.0  # nobody put anything there
    assert scores(ConfusionMatrix(names, names, counts)).balanced_accuracy == pytest.approx((a.recall + c.recall) / 2)


def test_nothing_scored_is_undefined_everywhere() -> None:
    found = scores(ConfusionMatrix(("a",), ("a",), np.zeros((1, 1), np.int64)))
    values = (found.accuracy, found.balanced_accuracy, found.kappa, found.classes[0].accuracy)
    assert all(math.isnan(value) for value in values)


def test_kappa_of_a_single_class_is_undefined() -> None:
    assert math.isnan(scores(ConfusionMatrix(("a",), ("a",), np.array([[7]]))).kappa)


def test_kappa_does_not_overflow() -> None:
    counts = np.array([[4, 1], [1, 4]]) * 10**10
    assert scores(ConfusionMatrix(("a", "b"), ("a", "b"), counts)).kappa == pytest.approx(0.6)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("recall.road", "score: found class 'road', expected one of: noise, ground, stem"),
        ("recal.ground", "score: found score 'recal.ground', expected one of: accuracy, balanced_accuracy, kappa"),
        ("recall", "recall.CLASS"),
        ("kappa.ground", "found score 'kappa.ground'"),
        ("", "found score ''"),
    ],
)
def test_unknown_gates_name_those_there_are(name: str, expected: str) -> None:
    found = scores(ConfusionMatrix(FOREST, FOREST, TABLE_II))
    with pytest.raises(ConfigError) as caught:
        gate_value(found, name)
    assert expected in str(caught.value)
