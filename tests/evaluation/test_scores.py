"""Scores against scikit-learn; for the figures of the papers see test_paper_tables."""

from __future__ import annotations

import math

import numpy as np
import pytest

from prc_cli.core.errors import ConfigError
from prc_cli.evaluation.confusion import ConfusionMatrix, accumulate
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.evaluation.scores import gate_value, scores

FOREST = ("noise", "ground", "stem")
TABLE_II = np.array([[15285576, 336704, 232019], [14741263, 6934955, 429704], [515205, 326183, 914452]])


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
