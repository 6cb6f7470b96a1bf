"""Hand-made evaluations for the tests of reports."""

import math

import numpy as np

from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.scores import (
    CLASS_SCORES,
    OVERALL_SCORES,
    Evaluation,
    Interval,
    MatchReport,
    SplitPart,
    scores,
)

ROWS = ("ground", "building", "stem", "other")
COLUMNS = ("ground", "building", "stem", "unclassified")
NEAR = ConfusionMatrix(
    ROWS, COLUMNS, np.array([[61, 7, 0, 0], [10, 50, 0, 0], [0, 0, 0, 0], [2, 0, 0, 0]]), 4
)
FAR = ConfusionMatrix(
    ROWS, COLUMNS, np.array([[1029, 3, 0, 0], [20, 2023, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0]]), 1
)
MATRIX = NEAR + FAR
EMPTY = ConfusionMatrix(ROWS, COLUMNS, np.zeros((4, 4), np.int64))


def evaluation(
    *,
    predicted: str = "labels.npy",
    mapping: str = "oakland",
    note: str = "Times were rounded.",
    part: str = "0-5 m",
) -> Evaluation:
    """An evaluation with parts, an empty part, intervals and a poor match."""
    matrix_scores = scores(MATRIX)
    intervals = {
        name: Interval(getattr(matrix_scores, name) - 0.0213, getattr(matrix_scores, name) + 0.0127)
        for name in OVERALL_SCORES
    }
    for item in scores(MATRIX.trimmed()).classes:
        for name in CLASS_SCORES:
            value = getattr(item, name)
            if not math.isnan(value):
                intervals[f"{name}.{item.name}"] = Interval(
                    max(value - 0.0311, 0.0), min(value + 0.0111, 1.0)
                )
    ranges = (
        SplitPart(part, 0.0, 5.0, NEAR),
        SplitPart("5-10 m", 5.0, 10.0, EMPTY),
        SplitPart("from 10 m", 10.0, math.inf, FAR),
        SplitPart("unknown", math.nan, math.nan, EMPTY),
    )
    return Evaluation(
        (predicted,),
        ("reference.csv.gz",),
        mapping,
        MatchReport("time", 4000, 3500, 3212, 1e-6, (note,)),
        MATRIX,
        {
            "range": ranges,
            "lines": (SplitPart("0-98", 0, 99, NEAR), SplitPart("99-197", 99, 198, FAR)),
        },
        intervals,
        "block jackknife, 31 blocks of 99 lines, 95 %",
    )
