"""The result of a check by hand: scores with intervals, as a table, JSON, CSV and Markdown."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from prc_cli.core.brief import Brief
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.evaluation.answers import Pooled
from prc_cli.evaluation.mapping import OTHER
from prc_cli.evaluation.reports import gate_cells, gate_dicts, markdown_table, plain, with_interval
from prc_cli.evaluation.scores import GateResult, Interval, figure
from prc_cli.evaluation.stratified import (
    SAMPLE_SCORES,
    WANTED,
    Estimate,
    area_shares,
    collapse,
    estimates,
    kappa,
)

FEW_ANSWERS = 30
"""With fewer answers a score says little."""
MOST_MORE = 10_000
"""More missing answers than this are not written out: nobody gives them."""
HEADER = ("class", "predicted", "true", "answers", *SAMPLE_SCORES, f"more for ± {WANTED:g}")


@dataclass(frozen=True, slots=True, repr=False)
class SampledEvaluation(Brief):
    """Scores of all shots of a file, estimated from answers to a random sample."""

    classified: str
    answers: tuple[str, ...]
    """Names of the files."""
    pooled: Pooled
    scores: dict[str, Estimate]
    """By name as in ``--fail-under``, without those of ``other``."""
    predicted_shares: dict[str, float]
    """Share of all shots by predicted class."""
    true_shares: dict[str, float]
    """Estimated share of all shots by true class."""
    n_answers: dict[str, int]
    """Answers in the strata of a predicted class."""
    kappa: float | None
    """Of the first two persons; None = no shot has two answers."""
    notes: tuple[str, ...]

    @property
    def classes(self) -> tuple[str, ...]:
        """Classes with scores."""
        shown = (*self.true_shares, *self.predicted_shares)
        return tuple(name for name in dict.fromkeys(shown) if f"recall.{name}" in self.scores)


def evaluate_sample(classified: str, answers: tuple[str, ...], pooled: Pooled) -> SampledEvaluation:
    """Estimate the scores.

    Raises
    ------
    InputError
        If nothing was answered.
    """
    sample, unanswered = collapse(pooled.sample)
    if not sample.predicted:
        problem = "no place has an answer with a class, expected some"
        raise InputError(answers[0], problem, "open the page of prc check, answer, and save")
    n_all = int(pooled.sample.n_shots.sum())
    predicted_shares = {
        name: float(pooled.sample.n_shots[pooled.sample.called(name)].sum()) / n_all
        for name in dict.fromkeys(pooled.sample.predicted)
    }
    shares = area_shares(sample).sum(axis=0)
    scores = estimates(sample)
    return SampledEvaluation(
        classified=classified,
        answers=answers,
        pooled=pooled,
        scores={name: score for name, score in scores.items() if not name.endswith(f".{OTHER}")},
        predicted_shares=predicted_shares,
        true_shares=dict(zip(sample.classes, shares.tolist(), strict=True)),
        n_answers={
            name: int(pooled.sample.n_answers[pooled.sample.called(name)].sum())
            for name in predicted_shares
        },
        kappa=None if pooled.agreement is None else kappa(pooled.agreement),
        notes=tuple(_notes(pooled, scores, unanswered, predicted_shares)),
    )


def _notes(
    pooled: Pooled,
    scores: dict[str, Estimate],
    unanswered: tuple[str, ...],
    predicted_shares: dict[str, float],
) -> Iterable[str]:
    n_unsure = int(pooled.sample.n_unsure.sum())
    n_answers = int(pooled.sample.n_answers.sum())
    if pooled.n_open:
        yield f"{pooled.n_open:,} of {pooled.n_places:,} places are not answered yet."
    if n_unsure:
        accuracy = scores["accuracy"]
        yield (
            f'{n_unsure:,} answers are "cannot tell" and count in no score. The accuracy is '
            f"{figure(accuracy.worst)} if all of these shots are wrong, {figure(accuracy.best)} if "
            "all are right."
        )
    if pooled.n_other:
        yield f"{pooled.n_other:,} answers are {OTHER}: none of the classes, so the shot is wrong."
    for name in unanswered:
        share = predicted_shares[name]
        yield f"No answer is about {name} ({share:.1%} of the shots): it is left out of all scores."
    if n_answers < FEW_ANSWERS:
        yield f"{n_answers:,} answers are few: the intervals are wide."


def agreement_line(evaluation: SampledEvaluation) -> str:
    """Return how two persons agree, as a sentence; empty if no shot has two answers."""
    agreement = evaluation.pooled.agreement
    if agreement is None or evaluation.kappa is None:
        return ""
    n_both = int(agreement.sum())
    share = float(agreement.trace()) / n_both
    names = " and ".join(evaluation.pooled.persons[:2])
    return f"{names} agree on {share:.1%} of {n_both:,} places, kappa {figure(evaluation.kappa)}."


def summary_line(evaluation: SampledEvaluation) -> str:
    """Return the accuracy and its interval as a sentence."""
    accuracy = evaluation.scores["accuracy"]
    n_shots = int(evaluation.pooled.sample.n_shots.sum())
    more = f"{accuracy.n_more:,} more answers give ± {WANTED:g}" if accuracy.n_more else ""
    within = f"it is known to ± {WANTED:g}" if accuracy.n_more == 0 else more
    return (
        f"accuracy {_score(accuracy)} of {n_shots:,} shots, from {accuracy.n_answers:,} answers"
        f"{'; ' + within if within else ''}"
    )


def score_rows(evaluation: SampledEvaluation) -> list[list[str]]:
    """Return a row for every class: name, shares, answers, scores, answers that are missing."""
    rows = []
    for name in evaluation.classes:
        scores = [evaluation.scores[f"{score}.{name}"] for score in SAMPLE_SCORES]
        rows.append(
            [
                name,
                f"{evaluation.predicted_shares.get(name, 0):.1%}",
                f"{evaluation.true_shares.get(name, 0):.1%}",
                str(evaluation.n_answers.get(name, 0)),
                *(_score(score) for score in scores),
                _more(evaluation, name),
            ]
        )
    return rows


def _more(evaluation: SampledEvaluation, name: str) -> str:
    # answers to all strata for the recall, to those of the class for the precision
    recall = evaluation.scores[f"recall.{name}"].n_more
    precision = evaluation.scores[f"precision.{name}"].n_more
    texts = [
        f"{n:,} {where}" if n <= MOST_MORE else f"over {MOST_MORE:,} {where}"
        for n, where in ((precision, f"of {name}"), (recall, "in all"))
        if n is not None
    ]
    return ", ".join(texts) or "-"


def _score(estimate: Estimate) -> str:
    return with_interval(estimate.value, Interval(estimate.low, estimate.high))


def sample_gates(
    evaluation: SampledEvaluation, limits: Iterable[tuple[str, float]]
) -> tuple[GateResult, ...]:
    """Compare scores with limits by name; ``recall.ground`` and so on, or ``accuracy``."""
    results = []
    for name, limit in limits:
        if name not in evaluation.scores:
            problem = f"found score {name!r}, expected one of: {', '.join(evaluation.scores)}"
            raise ConfigError("--fail-under", problem)
        results.append(GateResult(name, limit, evaluation.scores[name].value))
    return tuple(results)


def as_dict(evaluation: SampledEvaluation, gates: Iterable[GateResult] = ()) -> dict[str, Any]:
    """Return counts and scores with names; undefined scores are None."""
    pooled = evaluation.pooled
    sample = pooled.sample
    return {
        "files": {"predicted": [evaluation.classified], "answers": list(evaluation.answers)},
        "n_shots": int(sample.n_shots.sum()),
        "n_places": pooled.n_places,
        "n_answers": int(sample.n_answers.sum()),
        "n_open": pooled.n_open,
        "n_unsure": int(sample.n_unsure.sum()),
        "n_other": pooled.n_other,
        "scores": {
            name: {key: _defined(value) for key, value in asdict(score).items()}
            for name, score in evaluation.scores.items()
        },
        "shares": {
            "predicted": evaluation.predicted_shares,
            "true": evaluation.true_shares,
        },
        "strata": [
            {
                "predicted": name,
                "n_shots": int(n_shots),
                "n_unsure": int(n_unsure),
                "answers": {
                    name: int(count)
                    for name, count in zip(sample.classes, counts, strict=True)
                    if count
                },
            }
            for name, n_shots, n_unsure, counts in zip(
                sample.predicted, sample.n_shots, sample.n_unsure, sample.counts, strict=True
            )
        ],
        "persons": list(pooled.persons),
        "kappa": None if evaluation.kappa is None else _defined(evaluation.kappa),
        "n_answered_twice": 0 if pooled.agreement is None else int(pooled.agreement.sum()),
        "differences": [difference._asdict() for difference in pooled.differences],
        "notes": list(evaluation.notes),
        "gates": gate_dicts(gates),
    }


def as_json(evaluation: SampledEvaluation, gates: Iterable[GateResult] = ()) -> str:
    """Return :func:`as_dict` as JSON text."""
    return json.dumps(as_dict(evaluation, gates), indent=2, allow_nan=False)


def as_csv(evaluation: SampledEvaluation) -> str:
    """Return one row per score: class (empty for all), score, value, interval, bounds, counts."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = tuple(Estimate.__dataclass_fields__)
    writer.writerow(["class", "score", *names])
    for name, score in evaluation.scores.items():
        kind, _, class_name = name.partition(".")
        writer.writerow([class_name, kind, *(_cell(value) for value in asdict(score).values())])
    return text.getvalue()


def as_markdown(evaluation: SampledEvaluation, gates: Iterable[GateResult] = ()) -> str:
    """Return the scores, gates and notes as Markdown."""
    parts = [
        "Estimated from a random sample, with 95 % intervals.",
        markdown_table(HEADER, score_rows(evaluation)),
        f"{plain(summary_line(evaluation))}.",
    ]
    if gate_results := list(gates):
        rows = [[*gate_cells(gate), "passed" if gate.passed else "failed"] for gate in gate_results]
        parts.append(markdown_table(["gate", "expected at least", "found", ""], rows))
    parts += [plain(note) for note in (agreement_line(evaluation), *evaluation.notes) if note]
    answers = ", ".join(plain(name) for name in evaluation.answers)
    parts.append(f"Files: predicted {plain(evaluation.classified)}; answers {answers}.")
    return "\n\n".join(parts) + "\n"


def _defined(value: float | int | None) -> float | int | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _cell(value: float | int | None) -> str:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return f"{value:.6f}" if isinstance(value, float) else str(value)
