"""Scores of a confusion matrix, per class and overall; undefined scores are NaN, never 0."""

from __future__ import annotations

import math
from dataclasses import dataclass

from prc_cli.core.errors import ConfigError
from prc_cli.evaluation.confusion import ConfusionMatrix

CLASS_SCORES: tuple[str, ...] = ("recall", "precision", "f1", "iou", "accuracy")
"""Scores that every class has, in the order of the reports."""

OVERALL_SCORES: tuple[str, ...] = ("accuracy", "balanced_accuracy", "kappa")
"""Scores of the whole matrix."""


@dataclass(frozen=True, slots=True)
class ClassScores:
    """Scores of one class; all NaN for a class of one side only."""

    name: str
    n_reference: int
    """Scored records of this class in the reference."""
    n_predicted: int
    """Scored records that were predicted as this class."""
    n_agreed: int
    """Records where both sides say this class (true positives)."""
    recall: float
    """n_agreed / n_reference; NaN without reference records."""
    precision: float
    """n_agreed / n_predicted; NaN if nothing was predicted as this class."""
    f1: float
    """2 n_agreed / (n_reference + n_predicted)."""
    iou: float
    """n_agreed / (n_reference + n_predicted - n_agreed), intersection over union."""
    accuracy: float
    """One against the rest: share of scored records that both sides assign to this class, or both do not."""


@dataclass(frozen=True, slots=True)
class Scores:
    """Scores of a confusion matrix."""

    classes: tuple[ClassScores, ...]
    """Classes of either side: rows first, then columns that are not rows."""
    scored: tuple[str, ...]
    """Names of the classes on both sides, which have scores."""
    n_scored: int
    n_ignored: int
    accuracy: float
    """Share of all scored records that agree; records of classes without counterpart are in the denominator."""
    balanced_accuracy: float
    """Mean recall of the classes of both sides that have reference records."""
    kappa: float
    """Cohen's kappa: agreement beyond that of independent labels with the same totals."""


def scores(matrix: ConfusionMatrix) -> Scores:
    """Compute all scores of a confusion matrix.

    Ground and building, with two cars that have no predicted class:

    >>> import numpy as np
    >>> counts = np.array([[90, 10], [30, 70], [2, 0]])
    >>> found = scores(ConfusionMatrix(("ground", "building", "car"), ("ground", "building"), counts))
    >>> found.classes[0].recall, found.classes[1].precision, found.classes[2].recall
    (0.9, 0.875, nan)
    >>> round(found.accuracy, 4)
    0.7921
    """
    rows = dict(zip(matrix.reference_names, matrix.counts.sum(axis=1).tolist(), strict=True))
    columns = dict(zip(matrix.predicted_names, matrix.counts.sum(axis=0).tolist(), strict=True))
    names = (*rows, *(name for name in columns if name not in rows))
    shared = matrix.scored_names
    total = matrix.n_scored
    classes = tuple(
        _class_scores(name, rows.get(name, 0), columns.get(name, 0), _agreed(matrix, name), total)
        if name in shared
        else ClassScores(name, rows.get(name, 0), columns.get(name, 0), 0, *[math.nan] * len(CLASS_SCORES))
        for name in names
    )
    recalls = [item.recall for item in classes if not math.isnan(item.recall)]
    observed = _ratio(sum(item.n_agreed for item in classes), total)
    # Python integers: the products of two counts of 1e10 would not fit 64 bits
    expected = _ratio(sum(rows[name] * columns[name] for name in shared), total * total)
    return Scores(
        classes=classes,
        scored=shared,
        n_scored=total,
        n_ignored=matrix.n_ignored,
        accuracy=observed,
        balanced_accuracy=_ratio(sum(recalls), len(recalls)),
        kappa=_ratio(observed - expected, 1.0 - expected),
    )


def gate_value(found: Scores, name: str) -> float:
    """Look up one score by its name as in ``--fail-under``.

    >>> import numpy as np
    >>> matrix = ConfusionMatrix(("ground",), ("ground", "noise"), np.array([[3, 1]]))
    >>> gate_value(scores(matrix), "recall.ground")
    0.75
    """
    score, dot, class_name = name.partition(".")
    if not dot and score in OVERALL_SCORES:
        return float(getattr(found, score))
    by_name = {item.name: item for item in found.classes if item.name in found.scored}
    if score in CLASS_SCORES and class_name in by_name:
        return float(getattr(by_name[class_name], score))
    if dot and score in CLASS_SCORES:
        alone = class_name in (item.name for item in found.classes)
        why = ", which the mapping does not have on both sides" if alone else ""
        problem = f"found class {class_name!r}{why}, expected one of: {', '.join(by_name)}"
    else:
        per_class = ", ".join(f"{item}.CLASS" for item in CLASS_SCORES)
        problem = f"found score {name!r}, expected one of: {', '.join(OVERALL_SCORES)}, {per_class}"
    where = "score"
    raise ConfigError(where, problem)


def _class_scores(name: str, n_reference: int, n_predicted: int, n_agreed: int, total: int) -> ClassScores:
    either = n_reference + n_predicted - n_agreed
    return ClassScores(
        name,
        n_reference,
        n_predicted,
        n_agreed,
        recall=_ratio(n_agreed, n_reference),
        precision=_ratio(n_agreed, n_predicted),
        f1=_ratio(2 * n_agreed, n_reference + n_predicted),
        iou=_ratio(n_agreed, either),
        accuracy=_ratio(total - either + n_agreed, total),
    )


def _agreed(matrix: ConfusionMatrix, name: str) -> int:
    return int(matrix.counts[matrix.reference_names.index(name), matrix.predicted_names.index(name)])


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole else math.nan
