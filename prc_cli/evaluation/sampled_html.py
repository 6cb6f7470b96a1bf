"""The result of a check by hand as a page, in the style of an evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from prc_cli.evaluation.answers import CANNOT_TELL
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.html import evaluation_page, gates_line, matrix_view, page_data
from prc_cli.evaluation.sampled import (
    SampledEvaluation,
    agreement_line,
    as_dict,
    score_rows,
    summary_line,
)
from prc_cli.evaluation.scores import GateResult
from prc_cli.evaluation.stratified import SAMPLE_SCORES, WANTED, StratifiedSample


def sampled_html(evaluation: SampledEvaluation, gates: Sequence[GateResult] = ()) -> str:
    """Return a page without scripts: scores with intervals, and the answers by class."""
    sample = evaluation.pooled.sample
    matrix = answer_matrix(sample)
    shares_and_more = [(row[0], row[1:4], row[-1]) for row in score_rows(evaluation)]
    values: dict[str, Any] = {
        "title": "Classes checked by hand",
        "evaluation": evaluation,
        "pooled": evaluation.pooled,
        "accuracy": evaluation.scores["accuracy"],
        "n_shots": int(sample.n_shots.sum()),
        "n_answers": int(sample.n_answers.sum()),
        "n_unsure": int(sample.n_unsure.sum()),
        "unsure": [
            int(sample.n_unsure[sample.called(name)].sum()) for name in matrix.predicted_names
        ],
        "cannot_tell": CANNOT_TELL,
        "summary": summary_line(evaluation),
        "agreement": agreement_line(evaluation),
        "rows": shares_and_more,
        "score_names": SAMPLE_SCORES,
        "wanted": WANTED,
        "matrix": matrix,
        "cells": matrix_view(matrix, "columns", "", "")["rows"],
        "column_sums": matrix.counts.sum(axis=0).tolist(),
        "gates": gates,
        "gates_line": gates_line(gates),
        "data": page_data(as_dict(evaluation, gates)),
    }
    return evaluation_page("sampled.html", values)


def answer_matrix(sample: StratifiedSample) -> ConfusionMatrix:
    """Return the answers by class (rows) and predicted class (columns)."""
    names = tuple(dict.fromkeys(sample.predicted))
    counts = np.stack([sample.counts[sample.called(name)].sum(axis=0) for name in names], axis=1)
    used = counts.any(axis=1) | np.isin(sample.classes, names)
    answers = tuple(np.array(sample.classes)[used].tolist())
    return ConfusionMatrix(answers, names, counts[used])
