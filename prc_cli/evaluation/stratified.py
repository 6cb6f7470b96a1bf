"""Scores and their intervals from a stratified random sample of shots.

Strata are predicted classes, or parts of them, so the share of a stratum is known exactly and
weights its answers (Olofsson et al. 2014, "Good practices for estimating area and assessing
accuracy of land change", Remote Sensing of Environment 148). Every score is a ratio of two totals
(Stehman 2014, "Estimating area and map accuracy for stratified random sampling when the strata are
different from the map classes", International Journal of Remote Sensing 35).

Intervals do not come from the standard error, which is 0 if no error was seen. For a score, an
answer is right or wrong, and the score falls with the share of wrong shots in every stratum. The
share in a stratum has a confidence distribution, a beta distribution. One of the rarer answers more
is added in the stratum where it changes the score most, with a chance of one half. This is the
mid-p form of the interval for a weighted sum by Fay and Feuer (1997, Statistics in Medicine 16; Fay
and Kim 2017, Biometrical Journal 59).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.brief import Brief
from prc_cli.core.types import F64, I64, Mask

SAMPLE_SCORES = ("recall", "precision", "f1")
"""Scores of every class."""
TAIL = 0.02
"""Chance that the score is beyond an end of its interval.

With 0.025 the chance of both is more than 7 % for some scores, because answers are whole numbers.
"""
WANTED = 0.02
"""Half width of an interval that is good enough."""
N_DRAWS = 20_000
"""Draws of an interval; its ends then vary by less than 0.001."""
_SEED = 2014


@dataclass(frozen=True, slots=True, repr=False)
class StratifiedSample(Brief):
    """Answers to a random sample, counted by stratum."""

    predicted: tuple[str, ...]
    """Predicted class of every stratum, (strata,)."""
    n_shots: I64
    """Shots in every stratum, (strata,) int64."""
    classes: tuple[str, ...]
    """True classes that may be answered, (classes,)."""
    counts: I64
    """Answers by stratum and true class, (strata, classes) int64."""
    n_unsure: I64
    """Answers "cannot tell" by stratum, (strata,) int64; in no other count."""

    @property
    def n_answers(self) -> I64:
        """Answers with a class by stratum, (strata,) int64."""
        return np.asarray(self.counts.sum(axis=1), np.int64)

    def called(self, name: str) -> Mask:
        """Return the strata that were predicted as a class, (strata,) bool."""
        return np.array([predicted == name for predicted in self.predicted], np.bool_)

    def of_class(self, name: str) -> I64:
        """Return the answers that name a class, (strata,) int64."""
        if name not in self.classes:
            return np.zeros(len(self.predicted), np.int64)
        return np.asarray(self.counts[:, self.classes.index(name)], np.int64)


@dataclass(frozen=True, slots=True)
class Estimate:
    """A score of all shots, estimated from a sample."""

    value: float
    """NaN without answers that it needs."""
    standard_error: float
    """Of the ratio estimator (Stehman 2014, equation 28)."""
    low: float
    high: float
    """Ends of the 95 % interval."""
    worst: float
    best: float
    """The value if all shots that nobody could tell were wrong, and if all were right."""
    n_answers: int
    """Answers that it depends on."""
    n_more: int | None
    """Further answers, spread alike, until the interval is within 0.02; None = not known."""


class Ratio(NamedTuple):
    """A score as a ratio of totals: what a right and a wrong shot of each stratum add to them."""

    above_right: F64
    above_wrong: F64
    """(strata,) float64, added to the numerator."""
    below_right: F64
    below_wrong: F64
    """(strata,) float64, added to the denominator."""
    n_wrong: I64
    """Wrong answers by stratum, (strata,) int64."""

    def value(self, n_shots: I64, wrong: F64) -> F64:
        """Return the score for shares of wrong shots, (..., strata) to (...); NaN = undefined."""
        above = (self.above_right + (self.above_wrong - self.above_right) * wrong) @ n_shots
        below = (self.below_right + (self.below_wrong - self.below_right) * wrong) @ n_shots
        score = np.full(np.shape(above), np.nan)
        np.divide(above, below, out=score, where=np.asarray(below) > 0)
        return score

    @property
    def matters(self) -> Mask:
        """Strata whose answers change the score, (strata,) bool."""
        above = self.above_right != self.above_wrong
        return np.asarray(above | (self.below_right != self.below_wrong), np.bool_)


def ratio_of(sample: StratifiedSample, score: str) -> Ratio:
    """Return a score as a ratio of totals.

    Parameters
    ----------
    sample : StratifiedSample
    score : str
        ``accuracy``, or ``recall.ground``, ``precision.ground``, ``f1.ground``.
    """
    kind, _, name = score.partition(".")
    n_answers = sample.n_answers
    none = np.zeros(len(n_answers))
    every = np.ones(len(n_answers))
    if kind == "accuracy":
        right = sum(
            (sample.of_class(name) * sample.called(name) for name in set(sample.predicted)),
            start=np.zeros(len(n_answers), np.int64),
        )
        return Ratio(every, none, every, every, n_answers - right)
    is_called = sample.called(name)
    n_called = is_called.astype(np.float64)
    # in its own strata a shot of another class is wrong, in the others a shot of this class
    n_wrong = np.where(is_called, n_answers - sample.of_class(name), sample.of_class(name))
    if kind == "precision":
        return Ratio(n_called, none, n_called, n_called, n_wrong)
    if kind == "recall":
        return Ratio(n_called, none, n_called, 1 - n_called, n_wrong)
    # F1 = 2 agreed / (predicted + true)
    return Ratio(2 * n_called, none, 2 * n_called, every, n_wrong)


def estimate(sample: StratifiedSample, score: str) -> Estimate:
    """Estimate a score of all shots.

    Parameters
    ----------
    sample : StratifiedSample
        Every stratum has at least one answer; see :func:`collapse`.
    score : str
        As for :func:`ratio_of`.

    Returns
    -------
    Estimate
        Its value is NaN if the sample has no shot of the class.
    """
    ratio = ratio_of(sample, score)
    n_answers = sample.n_answers
    wrong = ratio.n_wrong / n_answers
    value = float(ratio.value(sample.n_shots, wrong))
    low, high = _interval(sample, ratio)
    # the bounds put the unsure answers to the wrong or the right ones
    n_all = n_answers + sample.n_unsure
    worst = float(ratio.value(sample.n_shots, (ratio.n_wrong + sample.n_unsure) / n_all))
    best = float(ratio.value(sample.n_shots, ratio.n_wrong / n_all))
    matters = ratio.matters
    n_used = int(n_answers[matters].sum())
    half = (high - low) / 2
    n_more = None
    if not math.isnan(half):
        n_more = max(0, math.ceil(n_used * ((half / WANTED) ** 2 - 1)))
    return Estimate(
        value, _standard_error(sample, ratio, value), low, high, worst, best, n_used, n_more
    )


def estimates(sample: StratifiedSample) -> dict[str, Estimate]:
    """Estimate all scores, by name as in ``--fail-under``: ``accuracy``, ``recall.ground``, ..."""
    names = [f"{score}.{name}" for name in sample.classes for score in SAMPLE_SCORES]
    return {name: estimate(sample, name) for name in ("accuracy", *names)}


def area_shares(sample: StratifiedSample) -> F64:
    """Return the estimated share of all shots by predicted and true class.

    Returns
    -------
    (predicted classes, true classes) float64
        Predicted classes in the order of their first strata; the sum is 1 (Olofsson et al. 2014,
        equation 4).
    """
    weights = sample.n_shots / sample.n_shots.sum()
    by_stratum = weights[:, None] * sample.counts / sample.n_answers[:, None]
    names = tuple(dict.fromkeys(sample.predicted))
    return np.array([by_stratum[sample.called(name)].sum(axis=0) for name in names])


def collapse(sample: StratifiedSample) -> tuple[StratifiedSample, tuple[str, ...]]:
    """Join strata with fewer than two answers to the other strata of their class.

    Returns
    -------
    sample : StratifiedSample
    unanswered : tuple of str
        Predicted classes without any answer; they are left out of the sample.
    """
    n_answers = sample.n_answers
    groups: list[list[int]] = []
    unanswered = []
    for name in dict.fromkeys(sample.predicted):
        strata = [int(place) for place in np.flatnonzero(sample.called(name))]
        if not n_answers[strata].sum():
            unanswered.append(name)
        elif (n_answers[strata] < 2).any():
            groups.append(strata)
        else:
            groups += [[stratum] for stratum in strata]

    def joined(values: I64) -> I64:
        return np.array([values[group].sum(axis=0) for group in groups], np.int64)

    kept = StratifiedSample(
        tuple(sample.predicted[group[0]] for group in groups),
        joined(sample.n_shots),
        sample.classes,
        joined(sample.counts).reshape(len(groups), len(sample.classes)),
        joined(sample.n_unsure),
    )
    return kept, tuple(unanswered)


def allocate(n_shots: Sequence[int], n: int) -> list[int]:
    """Return how many shots to draw from every stratum.

    One half is spread evenly, which serves the rare classes, and one half by the number of shots,
    which serves the accuracy. No stratum gives more than it has, at least 2 of each are drawn.

    >>> allocate([900_000, 90_000, 10_000, 3], 300)
    [183, 63, 51, 3]
    >>> allocate([5, 2], 100)
    [5, 2]
    """
    counts = np.asarray(n_shots, np.float64)
    wanted = min(float(n), counts.sum())
    chosen = np.minimum(counts, 2.0)
    is_open = counts > chosen
    # a stratum that is used up leaves its part to the others
    while is_open.any():
        rest = wanted - chosen[~is_open].sum()
        part = 0.5 / is_open.sum() + 0.5 * counts / counts[is_open].sum()
        chosen[is_open] = np.maximum(part[is_open] * rest, 2.0)
        is_used_up = is_open & (chosen >= counts)
        if not is_used_up.any():
            break
        chosen[is_used_up] = counts[is_used_up]
        is_open &= ~is_used_up
    # rounded so that the sum stays
    return [int(value) for value in np.diff(np.rint(np.cumsum(chosen)), prepend=0)]


def kappa(counts: NDArray[np.integer]) -> float:
    """Return Cohen's kappa of two persons from their answers, (classes, classes) integers.

    NaN if all answers are of one class.

    >>> round(kappa(np.array([[20, 5], [10, 15]])), 3)
    0.4
    """
    total = counts.sum()
    if not total:
        return math.nan
    agreed = np.trace(counts) / total
    by_chance = float(counts.sum(axis=0) @ counts.sum(axis=1)) / total**2
    return math.nan if by_chance == 1 else float((agreed - by_chance) / (1 - by_chance))


def _standard_error(sample: StratifiedSample, ratio: Ratio, value: float) -> float:
    # of the residual, above - value * below, by stratum
    n_answers = sample.n_answers
    if math.isnan(value) or (n_answers[ratio.matters] < 2).any():
        return math.nan
    right = ratio.above_right - value * ratio.below_right
    wrong = ratio.above_wrong - value * ratio.below_wrong
    share = ratio.n_wrong / n_answers
    variance = (right - wrong) ** 2 * share * (1 - share) / np.maximum(n_answers - 1, 1)
    unseen = 1 - n_answers / sample.n_shots
    below = ratio.below_right * (1 - share) + ratio.below_wrong * share
    total = float(below @ sample.n_shots)
    return float(np.sqrt((sample.n_shots**2.0 * unseen * variance).sum()) / total)


def _interval(sample: StratifiedSample, ratio: Ratio) -> tuple[float, float]:
    n_answers = sample.n_answers
    n_wrong = ratio.n_wrong
    value = float(ratio.value(sample.n_shots, n_wrong / n_answers))
    if math.isnan(value):
        return math.nan, math.nan
    random = np.random.default_rng(_SEED)
    in_doubt = _strata_in_doubt(sample, ratio)
    wrong = np.empty((N_DRAWS, len(n_answers)))
    for stratum, (k, n) in enumerate(zip(n_wrong.tolist(), n_answers.tolist(), strict=True)):
        mostly_wrong = 2 * k > n
        # the rarer answer is not counted once more, but for one stratum and half of the draws
        wrong[:, stratum] = _draw(random, k + mostly_wrong, n)
        if stratum in in_doubt:
            once_more = random.random(N_DRAWS) < 0.5
            wrong[once_more, stratum] = _draw(random, k + (not mostly_wrong), n)[once_more]
    # only the shots that were not drawn are unknown
    seen = n_answers / sample.n_shots
    wrong = seen * (n_wrong / n_answers) + (1 - seen) * wrong
    scores = ratio.value(sample.n_shots, wrong)
    low, high = np.nanquantile(scores, (TAIL, 1 - TAIL))
    # with few answers that are all wrong, no draw reaches the estimate
    return min(float(low), value), max(float(high), value)


def _draw(random: np.random.Generator, k: int, n: int) -> F64:
    """Draw shares whose chance of k or more wrong answers among n is uniform."""
    if k == 0:
        return np.zeros(N_DRAWS)
    if k > n:
        return np.ones(N_DRAWS)
    return random.beta(k, n - k + 1, N_DRAWS)


def _strata_in_doubt(sample: StratifiedSample, ratio: Ratio) -> set[int]:
    """Return the strata where one more of the rarer answers changes the score most.

    At most two: one where a wrong answer more lowers the score, and one where most answers are
    wrong and a right one more raises it.
    """
    n_answers = sample.n_answers
    wrong = ratio.n_wrong / n_answers
    lowest: tuple[float, int] | None = None
    highest: tuple[float, int] | None = None
    for stratum in np.flatnonzero(ratio.matters).tolist():
        changed = wrong.copy()
        step = 1 / (n_answers[stratum] + 1)
        if wrong[stratum] > 0.5:
            changed[stratum] -= step
            bound = (float(ratio.value(sample.n_shots, changed)), stratum)
            highest = bound if highest is None else max(highest, bound)
        else:
            changed[stratum] += step
            bound = (float(ratio.value(sample.n_shots, changed)), stratum)
            lowest = bound if lowest is None else min(lowest, bound)
    return {stratum for _, stratum in filter(None, (lowest, highest))}
