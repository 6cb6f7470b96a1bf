"""An evaluation as one self-contained HTML page without scripts; for light, dark and print."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Iterator, Sequence
from importlib import resources
from itertools import pairwise, zip_longest
from typing import Any

from prc_cli.core.errors import InputError
from prc_cli.core.pages import render_page
from prc_cli.evaluation.charts import Curve, class_colour, line_chart, mark
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.gates import GateResult
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.evaluation.reports import (
    NO_INTERVALS,
    NOT_SPLIT,
    Found,
    as_dict,
    doubts,
    figure,
    gate_cells,
    match_line,
    matrix_of,
    percent,
    split_table,
)
from prc_cli.evaluation.result import Evaluation, SplitPart
from prc_cli.evaluation.scores import CLASS_SCORES, OVERALL_SCORES, scores

_DEEP = 0.76
"""Share of the colour in a cell above which text is white."""
_LARGEST = 6
"""Rows of the table of the largest differences."""
_PNG = b"\x89PNG\r\n\x1a\n"
_AXES = {"range": "range [m]", "lines": "first scan line of the block", "scanner": "scanner"}
_TITLES = {"f1": "F1", "iou": "IoU", "accuracy": "one against rest"}
_WORDS = {
    "accuracy": "share of the scored records whose classes are equal",
    "balanced_accuracy": "mean recall: every class counts the same",
    "kappa": "1: all equal, 0: as by chance",
}
"""What the scores of the whole mean, in a word."""
_VIEWS = (
    ("counts", "Counts", "records, coloured by their share of the row"),
    ("rows", "Share of reference", "what became of a reference class; recall where both agree"),
    ("columns", "Share of predicted", "what a predicted class is made of; precision where both agree"),
)


def as_html(
    found: Found,
    gates: Sequence[GateResult] = (),
    *,
    mapping: ClassMapping | None = None,
    pictures: Sequence[tuple[str, bytes]] = (),
    title: str = "Predicted against reference classes",
    origin: Sequence[str] = (),
) -> str:
    """Return the page."""
    shown = matrix_of(found).trimmed()
    evaluation = found if isinstance(found, Evaluation) else None
    for name, content in pictures:
        check_picture(name, content)
    values = {
        "title": title,
        "origin": origin,
        "word_of": _WORDS,
        "style": (resources.files("prc_cli.evaluation") / "page.css").read_text(encoding="utf-8"),
        "evaluation": evaluation,
        "matrix": shown,
        "scores": scores(shown),
        "intervals": NO_INTERVALS if evaluation is None else evaluation.intervals,
        "overall_scores": OVERALL_SCORES,
        "class_scores": [(name, _TITLES.get(name, name)) for name in CLASS_SCORES],
        "class_names": tuple(dict.fromkeys((*shown.reference_names, *shown.predicted_names))),
        "gates": gates,
        "gates_line": _gates_line(gates),
        "views": [_view(shown, *view) for view in _VIEWS],
        "column_sums": shown.counts.sum(axis=0).tolist(),
        "largest": _largest(shown),
        "pictures": [(name, base64.b64encode(content).decode("ascii")) for name, content in pictures],
        "mapping": mapping,
        "mapped_names": () if mapping is None else tuple(dict.fromkeys((*mapping.reference, *mapping.predicted))),
        # "<" is escaped, so that user text cannot end the element
        "data": json.dumps(as_dict(found, gates), allow_nan=False).replace("<", "\\u003c"),
        **(_of_evaluation(evaluation, shown) if evaluation is not None else {"doubts": (), "splits": ()}),
    }
    filters: dict[str, Callable[..., Any]] = {
        "colour": class_colour,
        "figure": figure,
        "gate_cells": gate_cells,
        "percent": percent,
        "place": lambda score: f"{100 * min(max(score, 0.0), 1.0):.1f}",
        "thousands": "{:,}".format,
    }
    return render_page("prc_cli.evaluation", "evaluation.html", values, filters, {"known": _is_known})


def check_picture(name: str, content: bytes) -> None:
    """Refuse pictures that are not PNG."""
    if not content.startswith(_PNG):
        raise InputError(name, "is no PNG picture", "give pictures as prc render writes them")


def _is_known(score: float) -> bool:
    return not math.isnan(score)


def _gates_line(gates: Sequence[GateResult]) -> str:
    n_failed = sum(not gate.passed for gate in gates)
    if len(gates) == 1:
        return "the gate failed" if n_failed else "the gate passed"
    return f"{n_failed} of {len(gates)} gates failed" if n_failed else f"all {len(gates)} gates passed"


def _view(shown: ConfusionMatrix, key: str, name: str, words: str) -> dict[str, Any]:
    """Return one of the tables of the confusion matrix."""
    shares = (shown.column_shares() if key == "columns" else shown.row_shares()).tolist()
    agreeing = set(shown.scored_names)
    rows = []
    for row_name, counts, row in zip(shown.reference_names, shown.counts.tolist(), shares, strict=True):
        cells = []
        for other, count, share in zip(shown.predicted_names, counts, row, strict=True):
            colour = 0.0 if math.isnan(share) else share
            kind = "agree" if other == row_name and row_name in agreeing else "differ"
            texts = f"{count:,}", percent(share)
            main, small = texts if key == "counts" else texts[::-1]
            cells.append({
                "kind": f"{kind} deep" if colour > _DEEP else kind, "share": f"{colour:.4f}", "main": main,
                "small": small,
            })  # fmt: skip
        rows.append({"name": row_name, "cells": cells, "total": sum(counts)})
    return {"key": key, "name": name, "words": words, "rows": rows}


def _largest(shown: ConfusionMatrix) -> list[tuple[int, str, str]]:
    """Return the largest off-diagonal cells: records, reference class, predicted class."""
    cells = [
        (count, name, other)
        for name, counts in zip(shown.reference_names, shown.counts.tolist(), strict=True)
        for other, count in zip(shown.predicted_names, counts, strict=True)
        if count and not (name == other and name in shown.scored_names)
    ]
    return sorted(cells, key=lambda cell: -cell[0])[:_LARGEST]


def _of_evaluation(found: Evaluation, shown: ConfusionMatrix) -> dict[str, Any]:
    """Return the values that only an evaluation has, not a matrix alone."""
    match = found.match
    n_reference_matched = match.n_matched if match.n_reference_matched is None else match.n_reference_matched
    return {
        "doubts": doubts(found),
        "splits": [_split(split, parts, shown) for split, parts in found.splits.items()],
        "match_line": match_line(match),
        "sides": (
            ("predicted", match.n_predicted, match.n_matched),
            ("reference", match.n_reference, n_reference_matched),
        ),
        "file_pairs": tuple(zip_longest(found.predicted, found.reference, fillvalue="")),
    }


def _split(split: str, parts: Sequence[SplitPart], shown: ConfusionMatrix) -> dict[str, Any]:
    """Return the table of a split and the charts of its parts."""
    drawn = [part for part in parts if part.name != NOT_SPLIT]
    names = shown.scored_names
    # lines of every file begin at 0, and parts may be missing
    breaks = {i + 1 for i, (part, after) in enumerate(pairwise(drawn)) if after.low != part.high}
    places = {name: (*shown.reference_names, *shown.predicted_names).index(name) for name in names}
    return {
        "name": split,
        "rows": split_table(parts, shown)[1],
        "breaks": breaks,
        "legend": [(name, mark(places[name], 13, 7)) for name in names],
        "charts": list(_charts(split, drawn, places, breaks)) if drawn else [],
    }


def _charts(
    split: str, parts: Sequence[SplitPart], places: dict[str, int], breaks: set[int]
) -> Iterator[tuple[str, str]]:
    """Yield scores and their charts, as SVG."""
    found = [{item.name: item for item in scores(part.matrix).classes} for part in parts]
    counts = [part.matrix.n_scored for part in parts]
    # short, since the axis title gives the rest
    ticks = [f"{part.low:g}" if split == "lines" else part.name.removesuffix(" m") for part in parts]
    for score in ("recall", "precision"):
        curves = [
            Curve(name, tuple(getattr(part[name], score) for part in found), place) for name, place in places.items()
        ]
        axis = _AXES.get(split, split)
        names = [part.name for part in parts]
        yield score, line_chart(f"{score} by {split}", axis, names, counts, curves, ticks, breaks)
