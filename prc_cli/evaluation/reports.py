"""An evaluation as a dictionary, JSON, CSV or Markdown.

Each function takes an :class:`~prc_cli.evaluation.scores.Evaluation`, or a confusion matrix, which
has no matching, parts and intervals.
"""

from __future__ import annotations

import csv
import io
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any, TypeAlias

from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.scores import (
    CLASS_SCORES,
    OVERALL_SCORES,
    ClassScores,
    Evaluation,
    GateResult,
    Interval,
    MatchReport,
    Scores,
    SplitPart,
    ThreeWay,
    figure,
    scores,
)

Found: TypeAlias = ConfusionMatrix | Evaluation

NOT_SPLIT = "unknown"
"""Name of the part for pairs whose split value is unknown."""
NO_INTERVALS: Mapping[str, Interval] = {}

_CHANCE = 0.05
"""Kappa below which the two sides may be unrelated."""
_ENOUGH = 1000
_SCORE_COLUMNS = tuple(dict.fromkeys((*CLASS_SCORES, *OVERALL_SCORES)))
"""Score columns of a CSV table; the accuracy of classes and of the whole share one."""
_TOTALS = ("n_reference", "n_predicted", "n_agreed")
_SPECIAL = re.compile(r"([\\`*_\[\]<>|#~])")


def as_dict(found: Found, gates: Iterable[GateResult] = ()) -> dict[str, Any]:
    """Return counts and scores with names; undefined scores are None."""
    table = _matrix_dict(matrix_of(found))
    if isinstance(found, Evaluation):
        table |= {
            "files": {"predicted": list(found.predicted), "reference": list(found.reference)},
            "mapping": found.mapping,
            "match": asdict(found.match) | {"notes": list(found.match.notes)},
            "intervals": {
                name: {"low": _defined(item.low), "high": _defined(item.high)}
                for name, item in found.intervals.items()
            },
            "interval_method": found.interval_method,
            "doubts": list(doubts(found)),
            "splits": {
                name: [
                    {"name": part.name, "low": _defined(part.low), "high": _defined(part.high)}
                    | _matrix_dict(part.matrix)
                    for part in parts
                ]
                for name, parts in found.splits.items()
            },
            "gates": gate_dicts(gates),
        }
        if found.three is not None:
            table["three"] = _three_dict(found.three)
    return table


def as_json(found: Found, gates: Iterable[GateResult] = ()) -> str:
    """Return :func:`as_dict` as JSON text; undefined scores and open ends are ``null``."""
    return json.dumps(as_dict(found, gates), indent=2, allow_nan=False)


def as_csv(found: Found) -> str:
    """Return one row per class: name, counts, scores, and its row of the matrix.

    Undefined scores are empty.

    A last row, ``(overall)``, holds the number of scored records and the overall accuracy, balanced
    accuracy and kappa in columns of their own. Intervals come as columns ``recall_low``,
    ``recall_high`` and so on. Parts follow as the same rows again; then the first two columns are
    ``split`` and ``part``, empty for the whole.
    """
    matrix = matrix_of(found)
    intervals, splits = (
        (found.intervals, found.splits) if isinstance(found, Evaluation) else (NO_INTERVALS, {})
    )
    bounds = _SCORE_COLUMNS if intervals else ()
    columns = [f"predicted {name}" for name in matrix.predicted_names]
    limits = [f"{name}_{end}" for name in bounds for end in ("low", "high")]
    header = ["class", *_TOTALS, *_SCORE_COLUMNS, "n_ignored", *limits, *columns]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    if not splits:
        writer.writerow(header)
        writer.writerows(_csv_rows(matrix, intervals, bounds))
        return text.getvalue()
    writer.writerow(["split", "part", *header])
    writer.writerows(["", "", *row] for row in _csv_rows(matrix, intervals, bounds))
    for split, parts in splits.items():
        for part in parts:
            writer.writerows(
                [split, part.name, *row] for row in _csv_rows(part.matrix, NO_INTERVALS, bounds)
            )
    return text.getvalue()


def as_markdown(found: Found, gates: Iterable[GateResult] = ()) -> str:
    """Return the matrix with row shares, the scores, and splits, gates and match.

    Without empty classes.
    """
    shown = matrix_of(found).trimmed()
    intervals = found.intervals if isinstance(found, Evaluation) else NO_INTERVALS
    result = scores(shown)
    matrix_rows = [
        [
            name,
            *(f"{count} ({percent(share)})" for count, share in zip(counts, shares, strict=True)),
            str(sum(counts)),
        ]
        for name, counts, shares in zip(
            shown.reference_names, shown.counts.tolist(), shown.row_shares().tolist(), strict=True
        )
    ]
    parts = [
        "Reference in rows, predicted in columns: records (share of the row).",
        _table(["reference", *shown.predicted_names, "sum"], matrix_rows),
        _table(["class", *CLASS_SCORES], [score_row(item, intervals) for item in result.classes]),
        f"Scored {result.n_scored} records, ignored {result.n_ignored}: {overall_line(result, intervals)}.",
    ]
    if isinstance(found, Evaluation):
        parts += _evaluation_blocks(found, shown)
    if results := list(gates):
        rows = [[*gate_cells(item), "passed" if item.passed else "failed"] for item in results]
        parts.append(_table(["gate", "demanded", "found", ""], rows))
    return "\n\n".join(parts) + "\n"


def matrix_of(found: Found) -> ConfusionMatrix:
    """Return the confusion matrix."""
    return found.matrix if isinstance(found, Evaluation) else found


def overall_line(
    found: Scores, intervals: Mapping[str, Interval] = NO_INTERVALS, dash: str = "-"
) -> str:
    """Return the overall scores as part of a sentence.

    >>> import numpy as np
    >>> overall_line(scores(ConfusionMatrix(("a", "b"), ("a", "b"), np.array([[4, 1], [1, 4]]))))
    'accuracy 0.800, balanced accuracy 0.800, kappa 0.600'
    """
    return ", ".join(
        f"{name.replace('_', ' ')} {with_interval(getattr(found, name), intervals.get(name), dash)}"
        for name in OVERALL_SCORES
    )


def match_line(match: MatchReport) -> str:
    """Return how the records were matched, and how many of each side, as a sentence.

    >>> match_line(MatchReport("time", 1000, 900, 880, tolerance=1e-6))
    'Matched by time within 1e-06 s: 880 pairs of 1,000 predicted and 900 reference records.'
    """
    unit = {"time": " s", "nearest": " m"}.get(match.method, "")
    within = "" if match.tolerance is None else f" within {match.tolerance:g}{unit}"
    counts = f"{match.n_predicted:,} predicted and {match.n_reference:,} reference records"
    again = match.n_reference_matched
    several = (
        "" if again in (None, match.n_matched) else f"; {again:,} reference records are in pairs"
    )
    return f"Matched by {match.method}{within}: {match.n_matched:,} pairs of {counts}{several}."


def doubts(found: Evaluation) -> tuple[str, ...]:
    """Return reasons to doubt the evaluation itself, such as agreement that is only that of chance."""
    result = scores(found.matrix)
    seen = [item for item in result.classes if item.n_reference]
    predicted = [item for item in result.classes if item.n_predicted]
    if len(seen) == 1 < len(predicted) and result.n_scored >= _ENOUGH:
        only = f"All {seen[0].n_reference:,} scored records of the reference are {seen[0].name}"
        return (f"{only}: check that its codes are those of the class mapping.",)
    names = [item for item in result.classes if item.recall + item.precision >= 0]
    if len(names) < 2 or result.n_scored < _ENOUGH or not result.kappa < _CHANCE:
        return ()
    told = f"The agreement is about that of chance (kappa {figure(result.kappa)})"
    return (f"{told}: check that both sides are in the same order, and the class mapping.",)


def split_table(
    parts: Sequence[SplitPart], shown: ConfusionMatrix
) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of a split.

    Part, scored records, accuracy, recall and precision of every class.
    """
    names = shown.scored_names
    header = [
        "part",
        "records",
        "accuracy",
        *(f"{score} {name}" for name in names for score in ("recall", "precision")),
    ]
    rows = []
    for part in parts:
        found = scores(part.matrix)
        by_name = {item.name: item for item in found.classes}
        cells = [
            figure(value)
            for name in names
            for value in (by_name[name].recall, by_name[name].precision)
        ]
        rows.append([part.name, str(found.n_scored), figure(found.accuracy), *cells])
    return header, rows


def gate_dicts(gates: Iterable[GateResult]) -> list[dict[str, Any]]:
    """Return gates as plain values; an undefined score is None."""
    return [
        {
            "name": gate.name,
            "limit": gate.limit,
            "value": _defined(gate.value),
            "passed": gate.passed,
        }
        for gate in gates
    ]


def gate_cells(gate: GateResult) -> tuple[str, str, str]:
    """Return name, limit and value of a gate as text."""
    value = "undefined (no such records)" if math.isnan(gate.value) else f"{gate.value:.4f}"
    return gate.name, f"{gate.limit:g}", value


def percent(value: float) -> str:
    """Return a share in per cent, ``-`` if it is undefined."""
    return "-" if math.isnan(value) else f"{value:.1%}"


def with_interval(value: float, interval: Interval | None, dash: str = "-") -> str:
    """Return a score and its interval; a dash if the score is undefined.

    >>> with_interval(0.5, Interval(0.41, 0.6))
    '0.500 (0.410-0.600)'
    """
    if math.isnan(value):
        return dash
    if interval is None or math.isnan(interval.low) or math.isnan(interval.high):
        return figure(value)
    return f"{figure(value)} ({figure(interval.low)}{dash}{figure(interval.high)})"


def _matrix_dict(matrix: ConfusionMatrix) -> dict[str, Any]:
    found = scores(matrix)
    classes = {}
    for item in found.classes:
        table = asdict(item)
        classes[table.pop("name")] = {key: _defined(value) for key, value in table.items()}
    return {
        "n_scored": found.n_scored,
        "n_ignored": found.n_ignored,
        "overall": {name: _defined(getattr(found, name)) for name in OVERALL_SCORES},
        "classes": classes,
        "confusion": {
            "reference": list(matrix.reference_names),
            "predicted": list(matrix.predicted_names),
            "counts": matrix.counts.tolist(),
        },
    }


def _three_dict(found: ThreeWay) -> dict[str, Any]:
    matrices = {
        "predicted": found.predicted,
        "third": found.other,
        "predicted_against_third": found.between,
    }
    return {
        "file": found.third,
        "states": found.states(),
        "both_wrong_alike": [
            {"records": n, "reference": name, "both": other}
            for n, name, other in found.largest_errors(most=100)
        ],
        **{name: _matrix_dict(matrix) for name, matrix in matrices.items()},
    }


def _csv_rows(
    matrix: ConfusionMatrix, intervals: Mapping[str, Interval], bounds: Sequence[str]
) -> Iterator[list[str | int]]:
    matrix_scores = scores(matrix)
    rows = dict(zip(matrix.reference_names, matrix.counts.tolist(), strict=True))
    for class_scores in matrix_scores.classes:
        name = class_scores.name
        yield [
            name,
            *(getattr(class_scores, total) for total in _TOTALS),
            *(_cell(getattr(class_scores, score, math.nan)) for score in _SCORE_COLUMNS),
            "",
            *_limits(intervals, [f"{score}.{name}" for score in bounds]),
            *rows.get(name, [""] * len(matrix.predicted_names)),
        ]
    n_agreed = sum(class_scores.n_agreed for class_scores in matrix_scores.classes)
    yield [
        "(overall)",
        matrix_scores.n_scored,
        matrix_scores.n_scored,
        n_agreed,
        *(_cell(getattr(matrix_scores, score, math.nan)) for score in _SCORE_COLUMNS),
        matrix_scores.n_ignored,
        *_limits(intervals, bounds),
        *matrix.counts.sum(axis=0).tolist(),
    ]


def _limits(intervals: Mapping[str, Interval], names: Iterable[str]) -> list[str]:
    """Return low and high of every name; empty where there is no interval."""
    undefined = Interval(math.nan, math.nan)
    return [
        _cell(end)
        for name in names
        for item in (intervals.get(name, undefined),)
        for end in (item.low, item.high)
    ]


def _evaluation_blocks(found: Evaluation, shown: ConfusionMatrix) -> Iterator[str]:
    if found.intervals:
        yield f"Intervals: {_plain(found.interval_method)}."
    for split, parts in found.splits.items():
        yield f"By {_plain(split)}:"
        header, rows = split_table(parts, shown)
        yield _table(header, rows)
    if found.three is not None:
        yield "Three labellings:"
        yield _table(*found.three.table())
        yield from map(_plain, found.three.sentences())
    yield match_line(found.match).replace(found.match.method, _plain(found.match.method))
    yield from (_plain(note) for note in (*found.match.notes, *doubts(found)))
    files = [f"{side} {', '.join(map(_plain, names))}" for side, names in _sides(found)]
    yield f"Files: {'; '.join(files)}. Class mapping: {_plain(found.mapping)}."


def _sides(found: Evaluation) -> tuple[tuple[str, tuple[str, ...]], ...]:
    return ("predicted", found.predicted), ("reference", found.reference)


def score_row(item: ClassScores, intervals: Mapping[str, Interval], dash: str = "-") -> list[str]:
    """Return the name of a class and its scores with their intervals, as text."""
    values = ((getattr(item, name), intervals.get(f"{name}.{item.name}")) for name in CLASS_SCORES)
    return [item.name, *(with_interval(value, interval, dash) for value, interval in values)]


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table, first column left-aligned, numbers right-aligned, padded for reading as plain text."""
    header = [_plain(cell) for cell in header]
    rows = [[_plain(cell) for cell in row] for row in rows]
    widths = [max(4, *(len(row[i]) for row in (header, *rows))) for i in range(len(header))]
    pad = [(cell_width, "<" if i == 0 else ">") for i, cell_width in enumerate(widths)]
    lines = [
        " | ".join(f"{cell:{side}{width}}" for cell, (width, side) in zip(r, pad, strict=True))
        for r in rows
    ]
    head = " | ".join(
        f"{cell:{side}{width}}" for cell, (width, side) in zip(header, pad, strict=True)
    )
    rule = " | ".join(
        "-" * width if side == "<" else "-" * (width - 1) + ":" for width, side in pad
    )
    return "\n".join(f"| {line} |" for line in (head, rule, *lines))


def _plain(text: str) -> str:
    r"""Return text of users so that Markdown shows it as it is, on one line.

    >>> _plain("a_b|c\n.npy")
    'a\\_b\\|c .npy'
    """
    return _SPECIAL.sub(
        r"\\\1", "".join(character if character.isprintable() else " " for character in text)
    )


def _defined(value: float) -> float | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _cell(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.6f}"
