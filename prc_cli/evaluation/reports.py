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
    CALLED_NOISE,
    CALLED_NOISE_TITLE,
    CLASS_SCORES,
    GOOD_CALLED_NOISE_TITLE,
    OVERALL_SCORES,
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

Comparison: TypeAlias = ConfusionMatrix | Evaluation

NOT_SPLIT = "unknown"
"""Name of the part for pairs whose split value is unknown."""
NO_INTERVALS: Mapping[str, Interval] = {}

_CHANCE = 0.05
"""Kappa below which the two sides may be unrelated."""
_ENOUGH = 1000
_SCORE_COLUMNS = tuple(dict.fromkeys((*CLASS_SCORES, *OVERALL_SCORES, CALLED_NOISE)))
"""Score columns of a CSV table; the accuracy of classes and of the whole share one."""
_TOTALS = ("n_reference", "n_predicted", "n_agreed")
_SPECIAL = re.compile(r"([\\`*_\[\]<>|#~])")


def as_dict(comparison: Comparison, gates: Iterable[GateResult] = ()) -> dict[str, Any]:
    """Return counts and scores with names; undefined scores are None."""
    table = _matrix_dict(matrix_of(comparison))
    if isinstance(comparison, Evaluation):
        table |= {
            "files": {
                "predicted": list(comparison.predicted),
                "reference": list(comparison.reference),
            },
            "mapping": comparison.mapping,
            "match": asdict(comparison.match) | {"notes": list(comparison.match.notes)},
            "intervals": {
                name: {"low": _defined(interval.low), "high": _defined(interval.high)}
                for name, interval in comparison.intervals.items()
            },
            "interval_method": comparison.interval_method,
            "doubts": list(doubts(comparison)),
            "splits": {
                name: [
                    {"name": part.name, "low": _defined(part.low), "high": _defined(part.high)}
                    | _matrix_dict(part.matrix)
                    for part in parts
                ]
                for name, parts in comparison.splits.items()
            },
            "gates": gate_dicts(gates),
        }
        if comparison.three is not None:
            table["three"] = _three_dict(comparison.three)
    return table


def as_json(comparison: Comparison, gates: Iterable[GateResult] = ()) -> str:
    """Return :func:`as_dict` as JSON text; undefined scores and open ends are ``null``."""
    return json.dumps(as_dict(comparison, gates), indent=2, allow_nan=False)


def as_csv(comparison: Comparison) -> str:
    """Return one row per class: name, counts, scores, and its row of the matrix.

    Undefined scores are empty. A last row, ``(overall)``, has the number of scored records and the
    overall scores. Intervals are columns ``recall_low``, ``recall_high`` and so on. If the
    evaluation is split, the same rows follow for every part, and the first two columns are
    ``split`` and ``part``, empty for the whole.
    """
    matrix = matrix_of(comparison)
    intervals, splits = (
        (comparison.intervals, comparison.splits)
        if isinstance(comparison, Evaluation)
        else (NO_INTERVALS, {})
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


def as_markdown(comparison: Comparison, gates: Iterable[GateResult] = ()) -> str:
    """Return the matrix with row shares, the scores, splits, gates and match as Markdown.

    Empty classes are left out.
    """
    shown = matrix_of(comparison).trimmed()
    intervals = comparison.intervals if isinstance(comparison, Evaluation) else NO_INTERVALS
    matrix_scores = scores(shown)
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
        markdown_table(["reference", *shown.predicted_names, "sum"], matrix_rows),
        markdown_table(*score_table(matrix_scores, intervals)),
        f"Scored {matrix_scores.n_scored} records, ignored {matrix_scores.n_ignored}: "
        f"{overall_line(matrix_scores, intervals)}.",
    ]
    if isinstance(comparison, Evaluation):
        parts += _evaluation_blocks(comparison, shown)
    if gate_results := list(gates):
        rows = [[*gate_cells(gate), "passed" if gate.passed else "failed"] for gate in gate_results]
        parts.append(markdown_table(["gate", "expected at least", "found", ""], rows))
    return "\n\n".join(parts) + "\n"


def matrix_of(comparison: Comparison) -> ConfusionMatrix:
    """Return the confusion matrix."""
    return comparison.matrix if isinstance(comparison, Evaluation) else comparison


def overall_line(
    matrix_scores: Scores, intervals: Mapping[str, Interval] = NO_INTERVALS, dash: str = "-"
) -> str:
    """Return the overall scores as part of a sentence.

    >>> import numpy as np
    >>> overall_line(scores(ConfusionMatrix(("a", "b"), ("a", "b"), np.array([[4, 1], [1, 4]]))))
    'accuracy 0.800, balanced accuracy 0.800, kappa 0.600'
    """
    titles = {name: name.replace("_", " ") for name in OVERALL_SCORES}
    if not math.isnan(matrix_scores.called_noise):
        titles[CALLED_NOISE] = GOOD_CALLED_NOISE_TITLE
    return ", ".join(
        f"{title} {with_interval(getattr(matrix_scores, name), intervals.get(name), dash)}"
        for name, title in titles.items()
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


def doubts(evaluation: Evaluation) -> tuple[str, ...]:
    """Return reasons to doubt the evaluation itself, such as agreement no better than chance."""
    matrix_scores = scores(evaluation.matrix)
    if matrix_scores.n_scored < _ENOUGH:
        return ()
    classes = matrix_scores.classes
    in_reference = [row for row in classes if row.n_reference]
    in_predicted = [row for row in classes if row.n_predicted]
    if len(in_reference) == 1 < len(in_predicted):
        (only,) = in_reference
        doubt = f"All {only.n_reference:,} scored records of the reference are {only.name}"
        return (f"{doubt}: check that its codes are those of the class mapping.",)
    n_with_scores = sum(row.recall + row.precision >= 0 for row in classes)
    if n_with_scores < 2 or not matrix_scores.kappa < _CHANCE:
        return ()
    doubt = f"The agreement is about that of chance (kappa {figure(matrix_scores.kappa)})"
    return (f"{doubt}: check that both sides are in the same order, and the class mapping.",)


def split_table(
    parts: Sequence[SplitPart], shown: ConfusionMatrix
) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of the table of a split.

    Columns: part, scored records, accuracy, recall and precision of every class.
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
        part_scores = scores(part.matrix)
        by_name = part_scores.by_name
        cells = [
            figure(value)
            for name in names
            for value in (by_name[name].recall, by_name[name].precision)
        ]
        rows.append([part.name, str(part_scores.n_scored), figure(part_scores.accuracy), *cells])
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


def gate_line(gate: GateResult) -> str:
    """Return a gate and the score found as a line."""
    name, limit, value = gate_cells(gate)
    outcome = "passed" if gate.passed else "failed"
    return f"{name}: found {value}, expected at least {limit}: {outcome}"


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
    matrix_scores = scores(matrix)
    classes = {}
    for class_scores in matrix_scores.classes:
        table = asdict(class_scores)
        classes[table.pop("name")] = {key: _defined(value) for key, value in table.items()}
    return {
        "n_scored": matrix_scores.n_scored,
        "n_ignored": matrix_scores.n_ignored,
        "overall": {
            name: _defined(getattr(matrix_scores, name)) for name in (*OVERALL_SCORES, CALLED_NOISE)
        },
        "classes": classes,
        "confusion": {
            "reference": list(matrix.reference_names),
            "predicted": list(matrix.predicted_names),
            "counts": matrix.counts.tolist(),
        },
    }


def _three_dict(three: ThreeWay) -> dict[str, Any]:
    matrices = {
        "predicted": three.predicted,
        "third": three.third_matrix,
        "predicted_against_third": three.between,
    }
    return {
        "file": three.third,
        "states": three.states(),
        "both_wrong_alike": [
            {"records": n, "reference": name, "both": predicted}
            for n, name, predicted in three.largest_errors(most=100)
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
    cells = []
    for name in names:
        interval = intervals.get(name, undefined)
        cells += [_cell(interval.low), _cell(interval.high)]
    return cells


def _evaluation_blocks(evaluation: Evaluation, shown: ConfusionMatrix) -> Iterator[str]:
    if evaluation.intervals:
        yield f"Intervals: {plain(evaluation.interval_method)}."
    for split, parts in evaluation.splits.items():
        yield f"By {plain(split)}:"
        header, rows = split_table(parts, shown)
        yield markdown_table(header, rows)
    if evaluation.three is not None:
        yield "Three labellings:"
        yield markdown_table(*evaluation.three.table())
        yield from map(plain, evaluation.three.sentences())
    yield match_line(evaluation.match).replace(
        evaluation.match.method, plain(evaluation.match.method)
    )
    yield from (plain(note) for note in (*evaluation.match.notes, *doubts(evaluation)))
    predicted = ", ".join(map(plain, evaluation.predicted))
    reference = ", ".join(map(plain, evaluation.reference))
    yield (
        f"Files: predicted {predicted}; reference {reference}. "
        f"Class mapping: {plain(evaluation.mapping)}."
    )


def score_titles(matrix_scores: Scores) -> dict[str, str]:
    """Return the columns of a table of classes: scores and their titles.

    The good points called noise are among them if the predicted classes have noise.
    """
    titles = {name: name for name in CLASS_SCORES}
    if not math.isnan(matrix_scores.called_noise):
        titles[CALLED_NOISE] = CALLED_NOISE_TITLE
    return titles


def score_table(
    matrix_scores: Scores, intervals: Mapping[str, Interval] = NO_INTERVALS
) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of the table of classes: scores with their intervals, as text."""
    titles = score_titles(matrix_scores)
    rows = []
    for item in matrix_scores.classes:
        cells = [
            with_interval(getattr(item, name), intervals.get(f"{name}.{item.name}"))
            for name in titles
        ]
        rows.append([item.name, *cells])
    return ["class", *titles.values()], rows


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]], n_words: int = 1) -> str:
    """Return a Markdown table, ``n_words`` columns left-aligned, padded like plain text."""
    header = [plain(cell) for cell in header]
    rows = [[plain(cell) for cell in row] for row in rows]
    widths = [max(4, *(len(row[i]) for row in (header, *rows))) for i in range(len(header))]
    pad = [(cell_width, "<" if i < n_words else ">") for i, cell_width in enumerate(widths)]
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


def plain(text: str) -> str:
    r"""Return text of users so that Markdown shows it as it is, on one line.

    >>> plain("a_b|c\n.npy")
    'a\\_b\\|c .npy'
    """
    return _SPECIAL.sub(
        r"\\\1", "".join(character if character.isprintable() else " " for character in text)
    )


def _defined(value: float) -> float | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _cell(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.6f}"
