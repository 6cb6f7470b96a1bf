"""Scores of a stratified sample: a published example, hand-made ones, and whether intervals hold.

The intervals are tried on made-up drives whose scores are known.
"""

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from prc_cli.core.types import F64, I64
from prc_cli.evaluation import stratified
from prc_cli.evaluation.stratified import (
    StratifiedSample,
    allocate,
    area_shares,
    collapse,
    estimate,
    estimates,
)

OLOFSSON = StratifiedSample(
    ("deforestation", "gain", "forest", "other land"),
    np.array([200_000, 150_000, 3_200_000, 6_450_000]),
    ("deforestation", "gain", "forest", "other land"),
    np.array([[66, 0, 5, 4], [0, 55, 8, 12], [1, 0, 153, 11], [2, 1, 9, 313]]),
    np.zeros(4, np.int64),
)
"""The example of Olofsson et al. (2014), section 5: 640 pixels of 30 m."""


def sample(
    predicted: str, n_shots: list[int], counts: list[list[int]], n_unsure: list[int] | None = None
) -> StratifiedSample:
    """Strata that are named by a letter each, and answers by class a, b, ..."""
    classes = tuple("abcdefgh"[: len(counts[0])])
    unsure = [0] * len(n_shots) if n_unsure is None else n_unsure
    return StratifiedSample(
        tuple(predicted), np.array(n_shots), classes, np.array(counts), np.array(unsure)
    )


def test_the_example_of_olofsson():
    scores = estimates(OLOFSSON)
    assert scores["accuracy"].value == pytest.approx(0.95, abs=0.005)
    assert 1.96 * scores["accuracy"].standard_error == pytest.approx(0.02, abs=0.005)
    users = {"deforestation": 0.88, "gain": 0.73, "forest": 0.93, "other land": 0.96}
    for name, value in users.items():
        assert scores[f"precision.{name}"].value == pytest.approx(value, abs=0.005)
    assert scores["recall.deforestation"].value == pytest.approx(0.75, abs=0.005)
    assert 1.96 * scores["recall.deforestation"].standard_error == pytest.approx(0.21, abs=0.005)
    hectares = area_shares(OLOFSSON).sum(axis=0) * 10_000_000 * 0.09
    assert hectares[0] == pytest.approx(21_158, abs=0.5)


def test_one_stratum_by_hand():
    """80 of 100 answers are right: a plain proportion, and the interval of its beta mixture."""
    score = estimate(sample("ab", [10**9, 1], [[80, 20], [0, 1]]), "precision.a")
    assert score.value == 0.8
    assert score.standard_error == pytest.approx(math.sqrt(0.8 * 0.2 / 99))
    # Clopper and Pearson: 0.7082 to 0.8733
    assert score.low == pytest.approx(0.7082, abs=0.004)
    assert score.high == pytest.approx(0.8733, abs=0.004)
    assert score.n_answers == 100
    # a quarter of the width needs sixteen times the answers
    assert score.n_more == pytest.approx(100 * ((score.high - score.low) ** 2 / 0.04**2 - 1), abs=1)


def test_weights_count_not_answers():
    """Both strata have ten answers, but the second one has nine tenths of the shots."""
    scores = estimates(sample("ab", [100_000, 900_000], [[10, 0], [5, 5]]))
    assert scores["accuracy"].value == pytest.approx(0.1 + 0.9 / 2)
    assert scores["precision.a"].value == 1
    assert scores["recall.a"].value == pytest.approx(0.1 / (0.1 + 0.45))
    assert scores["f1.a"].value == pytest.approx(2 * 0.1 / (0.1 + 0.55))
    assert scores["recall.b"].value == 1


def test_an_error_nobody_saw_is_in_the_interval():
    """Ten million shots of b with no error among 100 may hide more of a than there is."""
    score = estimate(sample("ab", [10_000, 10_000_000], [[50, 0], [0, 100]]), "recall.a")
    assert score.value == 1
    assert score.high == 1
    assert score.low < 0.1


@given(
    st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=3, max_size=3),
    st.lists(st.integers(10, 10**6), min_size=3, max_size=3),
)
def test_every_interval_contains_its_estimate(answers, n_shots):
    """Also with two answers that are all right or all wrong."""
    few, _ = collapse(sample("aab", n_shots, [list(row) for row in answers]))
    for score in estimates(few).values() if few.predicted else ():
        if not math.isnan(score.value):
            assert 0 <= score.low <= score.value <= score.high <= 1


def test_one_wrong_answer_says_little():
    score = estimate(sample("ab", [1_000, 1_000], [[0, 1], [0, 9]]), "precision.a")
    assert score.value == score.low == 0
    assert score.high > 0.9


def test_a_stratum_that_was_answered_whole_is_known():
    score = estimate(sample("ab", [10, 20], [[9, 1], [0, 20]]), "accuracy")
    assert score.low == pytest.approx(score.value)
    assert score.high == pytest.approx(score.value)


def test_strata_of_confidence_count_by_their_shots():
    """Two strata of a: 90 % of its shots are right, 10 % are half right."""
    scores = estimates(sample("aab", [9_000, 1_000, 5_000], [[20, 0], [10, 10], [0, 20]]))
    assert scores["precision.a"].value == pytest.approx(0.95)
    assert scores["recall.b"].value == pytest.approx(5_000 / 5_500)


def test_cannot_tell_gives_bounds():
    score = estimate(sample("ab", [500, 500], [[8, 0], [0, 10]], [2, 0]), "accuracy")
    assert score.value == 1
    assert score.worst == pytest.approx(0.5 * 0.8 + 0.5)
    assert score.best == 1


def test_strata_with_few_answers_are_joined():
    few = sample("aabc", [90, 10, 50, 7], [[10, 0, 0], [1, 0, 0], [0, 5, 0], [0, 0, 0]])
    joined, unanswered = collapse(few)
    assert joined.predicted == ("a", "b")
    assert joined.n_shots.tolist() == [100, 50]
    assert joined.counts.tolist() == [[11, 0, 0], [0, 5, 0]]
    assert unanswered == ("c",)


@given(st.lists(st.integers(1, 10**8), min_size=1, max_size=20), st.integers(10, 2_000))
def test_allocation_gives_what_was_asked_for(n_shots, n):
    drawn = allocate(n_shots, n)
    assert all(min(2, count) <= k <= count for count, k in zip(n_shots, drawn, strict=True))
    least = sum(min(2, count) for count in n_shots)
    assert sum(drawn) == pytest.approx(max(min(n, sum(n_shots)), least), abs=len(n_shots) * 2)


class Drive(NamedTuple):
    """Strata of a made-up drive."""

    predicted: str
    n_shots: I64
    shares: F64
    """(strata, classes): true classes of the shots of a stratum."""

    def truth(self) -> dict[str, float]:
        """Return all scores by their definition."""
        classes = sorted(set(self.predicted))
        matrix = np.zeros((len(classes), len(classes)))
        for name, n, shares in zip(self.predicted, self.n_shots, self.shares, strict=True):
            matrix[classes.index(name)] += n * shares
        right = np.diagonal(matrix)
        truth = {"accuracy": right.sum() / matrix.sum()}
        for k, name in enumerate(classes):
            predicted, true = matrix[k].sum(), matrix[:, k].sum()
            truth[f"precision.{name}"] = right[k] / predicted
            truth[f"recall.{name}"] = right[k] / true
            truth[f"f1.{name}"] = 2 * right[k] / (predicted + true)
        return truth


def drive(shares: list[float], errors: list[float], *, divided: bool = False) -> Drive:
    """A drive with classes of these shares; divided: a fifth of each has most of the errors."""
    random = np.random.default_rng(7)
    predicted, n_shots, rows = "", [], []
    for k, (share, error) in enumerate(zip(shares, errors, strict=True)):
        for part, factor in ((0.8, 0.4), (0.2, 3.4)) if divided else ((1.0, 1.0),):
            others = random.dirichlet(np.full(len(shares) - 1, 0.5)) * error * factor
            predicted += "abcdefgh"[k]
            n_shots.append(int(share * part * 1e7))
            rows.append(np.insert(others, k, 1 - error * factor))
    return Drive(predicted, np.array(n_shots), np.array(rows))


DRIVES = {
    "usual": drive([0.45, 0.3, 0.15, 0.08, 0.02], [0.03, 0.05, 0.08, 0.15, 0.25]),
    "divided": drive([0.5, 0.3, 0.15, 0.05], [0.02, 0.05, 0.1, 0.25], divided=True),
    "rare": drive([0.6, 0.25, 0.1, 0.04, 0.008, 0.002], [0.01, 0.02, 0.05, 0.1, 0.2, 0.5]),
    "nearly right": drive([0.6, 0.3, 0.08, 0.02], [0.002, 0.003, 0.01, 0.02]),
    "right": drive([0.6, 0.3, 0.1], [0, 0, 0]),
    "poor": drive([0.45, 0.3, 0.15, 0.1], [0.4, 0.5, 0.6, 0.7]),
}


def coverage(made: Drive, n: int, n_draws: int) -> dict[str, float]:
    """Return the share of samples whose interval contains the truth, by score."""
    random = np.random.default_rng(11)
    truth = made.truth()
    inside = dict.fromkeys(truth, 0)
    answers = allocate(made.n_shots.tolist(), n)
    classes = tuple(sorted(set(made.predicted)))
    for _ in range(n_draws):
        counts = [random.multinomial(k, row) for k, row in zip(answers, made.shares, strict=True)]
        none = np.zeros(len(answers), np.int64)
        drawn = StratifiedSample(
            tuple(made.predicted), made.n_shots, classes, np.array(counts), none
        )
        for name, score in estimates(drawn).items():
            is_inside = score.low - 1e-9 <= truth[name] <= score.high + 1e-9
            inside[name] += math.isnan(score.value) or is_inside
    return {name: count / n_draws for name, count in inside.items()}


@pytest.mark.parametrize("name", ["usual", "rare"])
def test_intervals_contain_the_truth(name, monkeypatch):
    """A quick look; the slow test below looks at every kind of drive."""
    monkeypatch.setattr(stratified, "N_DRAWS", 400)
    covered = coverage(DRIVES[name], 300, 100)
    assert min(covered.values()) >= 0.88
    assert np.mean(list(covered.values())) >= 0.93
