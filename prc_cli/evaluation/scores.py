"""Scores of a confusion matrix, their intervals and gates, and the result of an evaluation.

Undefined scores are NaN, never 0. The last part compares three labellings of the same shots:
predicted and third against the reference, and against each other.

To add a score of the whole matrix: a line in :data:`OVERALL_SCORES`, a field of :class:`Scores`,
its formula in :func:`_values_of`. All reports show it then.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.brief import Brief
from prc_cli.core.errors import ConfigError, GateError, InputError
from prc_cli.core.types import F64, I64, U8
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.mapping import ClassMapping, scored_names
from prc_cli.evaluation.places import Places

CLASS_SCORES: tuple[str, ...] = ("recall", "precision", "f1", "iou", "accuracy")
"""Scores that every class has, in the order of the reports."""

OVERALL_SCORES: Mapping[str, str] = {
    "accuracy": "share of the scored records whose classes are equal",
    "balanced_accuracy": "mean recall: every class counts the same",
    "kappa": "1: all equal, 0: as by chance",
}
"""Scores of the whole matrix, in the order of the reports, and what each means."""
CALLED_NOISE = "called_noise"
"""Share of good points called noise, per class and of all classes but noise: the lower the better.

It is reported beside the scores, and no gate asks for it.
"""
CALLED_NOISE_TITLE = "called noise"
"""Title of the share of a class."""
GOOD_CALLED_NOISE_TITLE = f"good points {CALLED_NOISE_TITLE}"
"""Title of the share of all classes but noise."""
NOISE = "noise"
"""Name of the class whose points are no good points."""


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
    """One against the rest: share of scored records where both sides say this class, or neither."""
    called_noise: float
    """Share of the reference records that are predicted as noise; NaN for noise itself."""


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
    """Share of all scored records that agree.

    Records of classes without counterpart are in the denominator.
    """
    balanced_accuracy: float
    """Mean recall of the classes of both sides that have reference records."""
    kappa: float
    """Cohen's kappa: agreement beyond that of independent labels with the same totals."""
    called_noise: float
    """Share of the good points called noise, of all reference classes but noise together.

    NaN if the predicted classes have no noise.
    """

    @property
    def by_name(self) -> dict[str, ClassScores]:
        """The classes by their name."""
        return {row.name: row for row in self.classes}


def scores(matrix: ConfusionMatrix) -> Scores:
    """Compute all scores of a confusion matrix.

    Classes of one side only have counts and no scores.
    """
    counts = matrix.counts
    values = _values_of(counts[None], matrix.reference_names, matrix.predicted_names)
    n_reference = dict(zip(matrix.reference_names, counts.sum(axis=1).tolist(), strict=True))
    n_predicted = dict(zip(matrix.predicted_names, counts.sum(axis=0).tolist(), strict=True))
    shared = matrix.scored_names
    classes = []
    for name in dict.fromkeys((*n_reference, *n_predicted)):
        n_agreed = 0
        class_scores = dict.fromkeys(CLASS_SCORES, math.nan)
        if name in shared:
            row = matrix.reference_names.index(name)
            column = matrix.predicted_names.index(name)
            n_agreed = int(counts[row, column])
            class_scores = {score: float(values[f"{score}.{name}"][0]) for score in CLASS_SCORES}
        classes.append(
            ClassScores(
                name,
                n_reference.get(name, 0),
                n_predicted.get(name, 0),
                n_agreed,
                **class_scores,
                called_noise=float(values.get(f"{CALLED_NOISE}.{name}", [math.nan])[0]),
            )
        )
    return Scores(
        classes=tuple(classes),
        scored=shared,
        n_scored=matrix.n_scored,
        n_ignored=matrix.n_ignored,
        **{score: float(values[score][0]) for score in (*OVERALL_SCORES, CALLED_NOISE)},
    )


def _values_of(
    counts: NDArray[np.integer], reference_names: tuple[str, ...], predicted_names: tuple[str, ...]
) -> dict[str, F64]:
    """Compute every score of many confusion matrices at once.

    Parameters
    ----------
    counts : (n, rows, columns) integers
        Matrices with the same classes.
    reference_names, predicted_names : tuple of str
        Classes of the rows and of the columns.

    Returns
    -------
    dict of (n,) float64
        By name as in ``--fail-under``: ``recall.ground``, ..., ``accuracy``; NaN if undefined. And
        the good points called noise.
    """
    names = scored_names(reference_names, predicted_names)
    rows = [reference_names.index(name) for name in names]
    columns = [predicted_names.index(name) for name in names]
    # float64: the product of two sums of 1e10 does not fit 64 bits
    n_agreed = counts[:, rows, columns].astype(np.float64)
    n_reference = counts.sum(axis=2, dtype=np.float64)[:, rows]
    n_predicted = counts.sum(axis=1, dtype=np.float64)[:, columns]
    n_scored = counts.sum(axis=(1, 2), dtype=np.float64)
    n_either = n_reference + n_predicted - n_agreed
    class_scores = {
        "recall": _shares(n_agreed, n_reference),
        "precision": _shares(n_agreed, n_predicted),
        "f1": _shares(2 * n_agreed, n_reference + n_predicted),
        "iou": _shares(n_agreed, n_either),
        "accuracy": _shares(n_scored[:, None] - n_either + n_agreed, n_scored[:, None]),
    }
    observed = _shares(n_agreed.sum(axis=1), n_scored)
    by_chance = _shares((n_reference * n_predicted).sum(axis=1), n_scored * n_scored)
    values = {
        f"{score}.{name}": class_scores[score][:, column]
        for column, name in enumerate(names)
        for score in CLASS_SCORES
    }
    values["accuracy"] = observed
    # classes are summed in their order, so that no bit depends on the number of matrices
    recall = class_scores["recall"]
    is_defined = ~np.isnan(recall)
    total_recall = sum(np.where(is_defined, recall, 0.0).T, np.zeros(len(recall)))
    n_defined = is_defined.sum(axis=1).astype(np.float64)
    values["balanced_accuracy"] = _shares(total_recall, n_defined)
    values["kappa"] = _shares(observed - by_chance, 1.0 - by_chance)
    return values | _good_points_called_noise(counts, reference_names, predicted_names)


def _good_points_called_noise(
    counts: NDArray[np.integer], reference_names: tuple[str, ...], predicted_names: tuple[str, ...]
) -> dict[str, F64]:
    """Return the share of the good points that is predicted as noise, by class and of all."""
    good = [name for name in reference_names if name != NOISE]
    rows = [reference_names.index(name) for name in good]
    n_good = counts.sum(axis=2, dtype=np.float64)[:, rows]
    n_noise = np.full(n_good.shape, np.nan)
    if NOISE in predicted_names:
        n_noise = counts[:, rows, predicted_names.index(NOISE)].astype(np.float64)
    by_class = _shares(n_noise, n_good)
    return {
        CALLED_NOISE: _shares(n_noise.sum(axis=1), n_good.sum(axis=1)),
        **{f"{CALLED_NOISE}.{name}": by_class[:, k] for k, name in enumerate(good)},
    }


def _shares(part: F64, total: F64) -> F64:
    shares = np.full(part.shape, np.nan)
    np.divide(part, total, out=shares, where=(total != 0) & ~np.isnan(total))
    return shares


def gate_value(matrix_scores: Scores, name: str) -> float:
    """Look up one score by its name as in ``--fail-under``."""
    score, dot, class_name = name.partition(".")
    if not dot and score in OVERALL_SCORES:
        return float(getattr(matrix_scores, score))
    by_name = matrix_scores.by_name
    scored = matrix_scores.scored
    if score in CLASS_SCORES and class_name in scored:
        return float(getattr(by_name[class_name], score))
    if dot and score in CLASS_SCORES:
        why = ", which the mapping does not have on both sides" if class_name in by_name else ""
        problem = f"found class {class_name!r}{why}, expected one of: {', '.join(scored)}"
    else:
        per_class = ", ".join(f"{class_score}.CLASS" for class_score in CLASS_SCORES)
        problem = f"found score {name!r}, expected one of: {', '.join(OVERALL_SCORES)}, {per_class}"
    where = "score"
    raise ConfigError(where, problem)


LEVEL = 0.95
"""Confidence level."""
FEW_BLOCKS = 20
"""With fewer blocks, intervals are unreliable."""
_AT_ONCE = 1 << 22


def block_intervals(
    blocks: I64, reference_names: tuple[str, ...], predicted_names: tuple[str, ...]
) -> dict[str, Interval]:
    """Compute intervals of all scores by block jackknife (Kuensch 1989).

    Neighbouring shots err together, so whole blocks are left out.

    Parameters
    ----------
    blocks : (n, rows, columns) int64
        Confusion counts of every block.
    reference_names, predicted_names : tuple of str
        Classes of the rows and of the columns.

    Returns
    -------
    dict of Interval
        By name as in ``--fail-under``, without undefined ones.
    """
    from scipy.special import stdtrit

    n = len(blocks)
    if n < 2:
        problem = f"intervals need at least 2 blocks with scored pairs, found {n}"
        raise InputError("intervals", problem, "give -M, or compare more lines")
    names = (reference_names, predicted_names)
    total = blocks.sum(axis=0)
    n_at_once = max(1, _AT_ONCE // total.size)
    starts = range(0, n, n_at_once)
    parts = [_values_of(total - blocks[k : k + n_at_once], *names) for k in starts]
    intervals = {}
    for name, values in _values_of(total[None], *names).items():
        centre = float(values[0])
        left_out = np.concatenate([part[name] for part in parts])
        error = float(np.sqrt((n - 1) / n * np.sum((left_out - left_out.mean()) ** 2)))
        half = float(stdtrit(n - 1, (1 + LEVEL) / 2)) * error
        # a score that depends on a single block is undefined without it: no interval
        if not math.isnan(centre + half):
            least = -1.0 if name == "kappa" else 0.0
            intervals[name] = Interval(max(centre - half, least), min(centre + half, 1.0))
    return intervals


@dataclass(frozen=True, slots=True)
class Gate:
    """A minimum for a score."""

    name: str
    """``accuracy``, ``recall.ground``, ..."""
    limit: float


@dataclass(frozen=True, slots=True)
class GateResult:
    """A gate and the score found."""

    name: str
    limit: float
    value: float
    """NaN if the score is undefined; the gate then fails."""

    @property
    def passed(self) -> bool:
        """Whether the score reached the limit."""
        return self.value >= self.limit


def parse_gate(text: str, mapping: ClassMapping) -> Gate:
    """Parse a gate; refuse a score that an evaluation with this mapping cannot have."""
    name, _, value = text.partition("=")
    try:
        limit = float(value)
    except ValueError:
        limit = math.nan
    if not -1 <= limit <= 1:
        problem = (
            f"found {text!r}, expected SCORE.CLASS=VALUE with a value up to 1, "
            "such as recall.ground=0.95"
        )
        raise ConfigError("--fail-under", problem)
    gate_value(scores(ConfusionMatrix.empty(mapping)), name.strip())
    return Gate(name.strip(), limit)


def check_gates(matrix_scores: Scores, gates: Iterable[Gate]) -> tuple[GateResult, ...]:
    """Compare scores with gates."""
    return tuple(
        GateResult(gate.name, gate.limit, gate_value(matrix_scores, gate.name)) for gate in gates
    )


def refuse_failed(results: Iterable[GateResult]) -> None:
    """Raise if any gate failed, naming all failed ones."""
    failed = [gate for gate in results if not gate.passed]
    if failed:
        problems = [
            f"found {_found(gate.value)}, expected at least {gate.limit:.4f}" for gate in failed
        ]
        more = "; ".join(
            f"{gate.name}: {text}" for gate, text in zip(failed[1:], problems[1:], strict=True)
        )
        raise GateError(failed[0].name, problems[0], more)


def figure(value: float) -> str:
    """Return a score with three decimals, ``-`` if it is undefined."""
    return "-" if math.isnan(value) else f"{value:.3f}"


def _found(value: float) -> str:
    return "undefined (no such records)" if math.isnan(value) else f"{value:.4f}"


@dataclass(frozen=True, slots=True, repr=False)
class MatchReport(Brief):
    """How the records of both sides were matched, and how many."""

    method: str
    """``order``, ``cell`` (scan line and column), ``time``, ``dimension:NAME`` or ``nearest``."""
    n_predicted: int
    n_reference: int
    n_matched: int
    """Pairs. Every record is in at most one.

    Only ``nearest`` may give reference records several partners.
    """
    tolerance: float | None = None
    """Largest difference of a pair: seconds for ``time``, metres for ``nearest``."""
    notes: tuple[str, ...] = ()
    """Remarks for the reader, one sentence each."""
    n_reference_matched: int | None = None
    """Reference records in at least one pair; None = ``n_matched``, as each is in one."""


@dataclass(frozen=True, slots=True)
class SplitPart:
    """The pairs of one part of a split, for example ranges of 10 to 20 m."""

    name: str
    """Displayed name, such as ``10-20 m``."""
    low: float
    """Lower bound: range [m], first scan line, scanner id."""
    high: float
    """Upper bound, exclusive; inf = open."""
    matrix: ConfusionMatrix


@dataclass(frozen=True, slots=True)
class Interval:
    """A confidence interval of a score."""

    low: float
    high: float


@dataclass(frozen=True, slots=True, repr=False)
class Evaluation(Brief):
    """Result of ``prc evaluate``."""

    predicted: tuple[str, ...]
    """Files."""
    reference: tuple[str, ...]
    """Files."""
    mapping: str
    """Name or file of the class mapping."""
    match: MatchReport
    matrix: ConfusionMatrix
    splits: dict[str, tuple[SplitPart, ...]]
    """Parts by what was split by: ``range``, ``lines``, ``scanner``; pairs whose range, line
    or scanner is not known are a part of their own named ``unknown``. The counts add up to those of
    ``matrix``; parts without scored records are left out, and the ignored records with them."""
    intervals: dict[str, Interval]
    """Intervals by the score's name as in ``--fail-under``, such as ``recall.ground``.

    Empty unless requested.
    """
    interval_method: str = ""
    """For example ``block jackknife, 120 blocks of 99 lines, 95 %``."""
    three: ThreeWay | None = None
    """Counts with a third labelling, if there is one."""
    plan: bytes | None = None
    """PNG picture from above of where predicted and third are right and wrong."""
    places: Places | None = None
    """Places where both sides differ, if they were asked for."""


STATES = (
    "both right",
    "only predicted right",
    "only third right",
    "both wrong, alike",
    "both wrong, differently",
)
"""What two labellings of a shot can be beside the reference."""
NO_STATE = len(STATES)
LOST = -2
"""Code of a shot that the third labelling lacks, where that makes it noise."""
TABLE_SCORES = ("recall", "precision", "f1")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ThreeWay(Brief):
    """Counts of shots by the class that each of three labellings gives them."""

    third: str
    """File or folder of the third labelling."""
    reference_names: tuple[str, ...]
    predicted_names: tuple[str, ...]
    third_names: tuple[str, ...]
    counts: I64
    """(reference, predicted, third) int64, shots that all three classify."""

    @property
    def predicted(self) -> ConfusionMatrix:
        """Predicted against reference, over the shots that all three classify."""
        return ConfusionMatrix(self.reference_names, self.predicted_names, self.counts.sum(axis=2))

    @property
    def third_matrix(self) -> ConfusionMatrix:
        """Third against reference."""
        return ConfusionMatrix(self.reference_names, self.third_names, self.counts.sum(axis=1))

    @property
    def between(self) -> ConfusionMatrix:
        """Predicted against third, as if this were the reference."""
        return ConfusionMatrix(self.third_names, self.predicted_names, self.counts.sum(axis=0).T)

    def states(self) -> dict[str, int]:
        """Return the number of shots in every one of :data:`STATES`."""
        table = state_table(self.reference_names, self.predicted_names, self.third_names)
        n = np.bincount(table.ravel(), self.counts.ravel(), NO_STATE + 1)
        return {name: int(n[k]) for k, name in enumerate(STATES)}

    def sentences(self) -> tuple[str, ...]:
        """Return how often either is right, and where both agree and are wrong."""
        n = max(int(self.counts.sum()), 1)
        states = self.states()
        shares = ", ".join(f"{name} {count:,} ({count / n:.1%})" for name, count in states.items())
        errors = [
            f"{count:,} of {name} called {predicted}"
            for count, name, predicted in self.largest_errors()
        ]
        more = (f"Where both agree and are wrong: {'; '.join(errors)}.",) if errors else ()
        return (
            f"Third labelling {self.third}, {n:,} shots that all three classify: {shares}.",
            *more,
        )

    def largest_errors(self, most: int = 6) -> list[tuple[int, str, str]]:
        """Return the largest common errors: shots, reference class, the class that both give."""
        errors = []
        for i, reference in enumerate(self.reference_names):
            for j, name in enumerate(self.predicted_names):
                if name in self.third_names and name != reference:
                    n = int(self.counts[i, j, self.third_names.index(name)])
                    errors.append((n, reference, name))
        return sorted((error for error in errors if error[0]), reverse=True)[:most]

    def table(self) -> tuple[list[str], list[list[str]]]:
        """Return header and one row a class.

        Scores of predicted and of third against the reference, and their agreement.
        """
        predicted = scores(self.predicted).by_name
        third = scores(self.third_matrix).by_name
        between = scores(self.between).by_name
        header = ["class", "shots"]
        header += [f"predicted {score}" for score in TABLE_SCORES]
        header += [f"third {score}" for score in TABLE_SCORES]
        header.append("predicted and third f1")
        rows = []
        n_shots = self.counts.sum(axis=(1, 2)).tolist()
        for name, n in zip(self.reference_names, n_shots, strict=True):
            if n or predicted[name].n_predicted or third[name].n_predicted:
                values = [getattr(predicted[name], score) for score in TABLE_SCORES]
                values += [getattr(third[name], score) for score in TABLE_SCORES]
                values.append(between[name].f1 if name in between else math.nan)
                rows.append([name, f"{n:,}", *map(figure, values)])
        return header, rows


def state_table(
    reference: tuple[str, ...], predicted: tuple[str, ...], third: tuple[str, ...]
) -> U8:
    """Return the index in :data:`STATES` of every triple of class names.

    (reference, predicted, third) uint8.
    """
    by_reference = np.array(reference)[:, None, None]
    by_predicted = np.array(predicted)[None, :, None]
    by_third = np.array(third)[None, None, :]
    predicted_right = by_predicted == by_reference
    third_right = by_third == by_reference
    states = (
        predicted_right & third_right,
        predicted_right & ~third_right,
        ~predicted_right & third_right,
        by_predicted == by_third,
    )
    return np.select(states, [0, 1, 2, 3], 4).astype(np.uint8)


class ThreeCounts:
    """Counts of a :class:`ThreeWay`, filled chunk by chunk.

    The third is read with the codes of a reference.
    """

    def __init__(self, mapping: ClassMapping, third: ClassMapping) -> None:
        self._mapping = mapping
        self._third = third
        self._names = (
            mapping.names("reference"),
            mapping.names("predicted"),
            third.names("reference"),
        )
        self._counts = np.zeros([len(names) for names in self._names], np.int64)
        self._states = state_table(*self._names)

    def add(self, predicted: I64, rows: I64, third: I64) -> U8:
        """Count shots by predicted code, reference class and third code; return their states."""
        columns = self._mapping.class_indices(predicted, "predicted")
        depths = np.full(len(third), -1)
        depths[third >= 0] = self._third.class_indices(third[third >= 0], "reference")
        if NOISE in self._names[2]:
            depths[third == LOST] = self._names[2].index(NOISE)
        known = (rows >= 0) & (columns >= 0) & (depths >= 0)
        index = rows[known], columns[known], depths[known]
        cells = np.ravel_multi_index(index, self._counts.shape)
        self._counts += np.bincount(cells, minlength=self._counts.size).reshape(self._counts.shape)
        states = np.full(len(rows), NO_STATE, np.uint8)
        states[known] = self._states[index]
        return states

    def fold(self, into: Mapping[str, str]) -> None:
        """Add predicted classes to others, by name."""
        names = self._names[1]
        for name, to in into.items():
            self._counts[:, names.index(to)] += self._counts[:, names.index(name)]
            self._counts[:, names.index(name)] = 0

    def result(self, third: str) -> ThreeWay:
        """Return the counts."""
        return ThreeWay(third, *self._names, self._counts)
