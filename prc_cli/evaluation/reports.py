"""A confusion matrix and its scores as a dictionary, JSON, CSV or Markdown; plain strings, nothing printed."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.scores import CLASS_SCORES, OVERALL_SCORES, ClassScores, scores


def as_dict(matrix: ConfusionMatrix) -> dict[str, Any]:
    """Return counts and scores with names; undefined scores are None.

    Returns
    -------
    dict
        ``n_scored``, ``n_ignored``, ``overall`` (score by name), ``classes`` (scores by class name) and
        ``confusion`` (``reference`` row names, ``predicted`` column names, ``counts``).
    """
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


def as_json(matrix: ConfusionMatrix) -> str:
    """Return :func:`as_dict` as JSON text; undefined scores are ``null``."""
    return json.dumps(as_dict(matrix), indent=2, allow_nan=False)


def as_csv(matrix: ConfusionMatrix) -> str:
    """Return one row a class: name, counts, scores, and its row of the matrix; undefined scores are empty.

    A last row, ``(overall)``, holds the number of scored records and the overall accuracy, balanced accuracy
    and kappa in columns of their own.
    """
    found = scores(matrix)
    rows = dict(zip(matrix.reference_names, matrix.counts.tolist(), strict=True))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    totals = ("n_reference", "n_predicted", "n_agreed")
    columns = [f"predicted {name}" for name in matrix.predicted_names]
    writer.writerow(["class", *totals, *CLASS_SCORES, "balanced_accuracy", "kappa", "n_ignored", *columns])
    for item in found.classes:
        counts = [getattr(item, name) for name in totals]
        values = [_cell(getattr(item, name)) for name in CLASS_SCORES]
        writer.writerow([item.name, *counts, *values, "", "", "", *rows.get(item.name, [""] * len(columns))])
    agreed = sum(item.n_agreed for item in found.classes)
    overall = [_cell(getattr(found, name)) for name in OVERALL_SCORES]
    sums = matrix.counts.sum(axis=0).tolist()
    writer.writerow(["(overall)", found.n_scored, found.n_scored, agreed, *[""] * 4, *overall, found.n_ignored, *sums])
    return text.getvalue()


def as_markdown(matrix: ConfusionMatrix) -> str:
    """Return two Markdown tables (the matrix with row shares, the scores) and a line of overall scores.

    Classes that no record has on either side are left out.
    """
    shown = matrix.trimmed()
    found = scores(shown)
    matrix_rows = [
        [name, *(f"{count} ({_percent(share)})" for count, share in zip(counts, shares, strict=True)), str(sum(counts))]
        for name, counts, shares in zip(
            shown.reference_names, shown.counts.tolist(), shown.row_shares().tolist(), strict=True
        )
    ]
    overall = ", ".join(f"{name.replace('_', ' ')} {_text(getattr(found, name))}" for name in OVERALL_SCORES)
    parts = [
        "Reference in rows, predicted in columns: records (share of the row).",
        _table(["reference", *shown.predicted_names, "sum"], matrix_rows),
        _table(["class", *CLASS_SCORES], [_score_row(item) for item in found.classes]),
        f"Scored {found.n_scored} records, ignored {found.n_ignored}: {overall}.",
    ]
    return "\n\n".join(parts) + "\n"


def _score_row(item: ClassScores) -> list[str]:
    return [item.name, *(_text(getattr(item, name)) for name in CLASS_SCORES)]


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Markdown table, first column to the left, numbers to the right, padded so that it reads as plain text."""
    widths = [max(4, *(len(row[i]) for row in (header, *rows))) for i in range(len(header))]
    pad = [(cell_width, "<" if i == 0 else ">") for i, cell_width in enumerate(widths)]
    lines = [" | ".join(f"{cell:{side}{width}}" for cell, (width, side) in zip(r, pad, strict=True)) for r in rows]
    head = " | ".join(f"{cell:{side}{width}}" for cell, (width, side) in zip(header, pad, strict=True))
    rule = " | ".join("-" * width if side == "<" else "-" * (width - 1) + ":" for width, side in pad)
    return "\n".join(f"| {line} |" for line in (head, rule, *lines))


def _defined(value: float) -> float | None:
    return None if isinstance(value, float) and math.isnan(value) else value


def _cell(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.6f}"


def _text(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.3f}"


def _percent(value: float) -> str:
    return "-" if math.isnan(value) else f"{value:.1%}"
