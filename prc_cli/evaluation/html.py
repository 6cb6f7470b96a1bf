"""An evaluation as one self-contained HTML page without scripts; for light, dark and print."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from itertools import pairwise, zip_longest
from typing import Any
from zlib import crc32

from prc_cli.core.classes import LABEL_COLOURS, LABEL_NAMES, Label
from prc_cli.core.errors import InputError
from prc_cli.core.pages import render_page
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.mapping import OTHER, ClassMapping
from prc_cli.evaluation.places import Places, place_rows
from prc_cli.evaluation.reports import (
    NO_INTERVALS,
    NOT_SPLIT,
    Comparison,
    as_dict,
    doubts,
    gate_cells,
    match_line,
    matrix_of,
    percent,
    score_titles,
    split_table,
)
from prc_cli.evaluation.scores import (
    CALLED_NOISE_TITLE,
    GOOD_CALLED_NOISE_TITLE,
    OVERALL_SCORES,
    Evaluation,
    GateResult,
    SplitPart,
    figure,
    scores,
)

_MORE_COLOURS = (
    (51, 34, 136),
    (136, 34, 85),
    (68, 170, 153),
    (153, 153, 51),
    (170, 68, 153),
    (221, 204, 119),
)
"""Colours of other classes (Paul Tol's muted scheme)."""
_OTHER_COLOUR = (108, 108, 108)

_WIDTH = 560
_LEFT = 40
_RIGHT = 12
_TOP = 12
_PLOT_HEIGHT = 210
_BAR_HEIGHT = 34
_GAP = 10
_LABEL_HEIGHT = 40
_HEIGHT = _TOP + _PLOT_HEIGHT + _GAP + _BAR_HEIGHT + _LABEL_HEIGHT
_LETTER = 6.4
"""Width of a letter of the labels [units of the drawing]."""
_MAX_MARKS = 80
"""Number of parts above which marks are omitted, because they would overlap."""


@dataclass(frozen=True, slots=True)
class Curve:
    """A score of one class."""

    name: str
    values: tuple[float, ...]
    """One value per part, 0 to 1; NaN = undefined, the curve is interrupted."""
    place: int
    """Index of the class among those shown; selects its mark."""


def class_colour(name: str) -> str:
    """Return the colour of a class for CSS; that of an unknown class depends only on its name."""
    if name == OTHER:
        rgb = _OTHER_COLOUR
    elif name in LABEL_NAMES:
        rgb = LABEL_COLOURS[Label(LABEL_NAMES.index(name))]
    else:
        rgb = _MORE_COLOURS[crc32(name.encode()) % len(_MORE_COLOURS)]
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def mark(
    place: int,
    x: float,
    y: float,
    size: float = 4.0,
) -> str:
    """Return the mark of a class as an SVG shape around a point."""
    s = size
    shapes = (
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{s:.1f}"/>',
        f'<rect x="{x - s:.1f}" y="{y - s:.1f}" width="{2 * s:.1f}" height="{2 * s:.1f}"/>',
        _polygon(x, y, ((0.0, -1.3 * s), (1.2 * s, s), (-1.2 * s, s))),
        _polygon(x, y, ((0.0, -1.4 * s), (1.4 * s, 0.0), (0.0, 1.4 * s), (-1.4 * s, 0.0))),
        _polygon(x, y, ((0.0, 1.3 * s), (1.2 * s, -s), (-1.2 * s, -s))),
    )
    return shapes[place % len(shapes)]


def line_chart(
    title: str,
    axis: str,
    names: Sequence[str],
    counts: Sequence[int],
    curves: Sequence[Curve],
    ticks: Sequence[str],
    breaks: Collection[int] = (),
) -> str:
    """Draw curves over the parts of a split, and bars for the number of records in each part."""
    n = len(names)
    parts = [
        f'<svg class="chart" viewBox="0 0 {_WIDTH} {_HEIGHT}" '
        f'role="img" aria-label="{escape(title)}">'
    ]
    right = _WIDTH - _RIGHT
    for tenths in range(0, 11, 2):
        y = _y(tenths / 10)
        label = f"{tenths / 10:.1f}"
        parts.append(f'<line class="grid" x1="{_LEFT}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text x="{_LEFT - 7}" y="{y + 4:.1f}" text-anchor="end">{label}</text>')
    parts += _bars(names, counts)
    parts += _tick_labels(ticks, axis)
    bottom = _TOP + _PLOT_HEIGHT + _GAP + _BAR_HEIGHT
    for i in sorted(breaks):
        x = (_x(i - 1, n) + _x(i, n)) / 2
        parts.append(f'<line class="break" x1="{x:.1f}" x2="{x:.1f}" y1="{_TOP}" y2="{bottom}"/>')
    for curve in curves:
        parts += _curve(curve, names, breaks)
    parts.append("</svg>")
    return "".join(parts)


def _curve(curve: Curve, names: Sequence[str], breaks: Collection[int]) -> Iterator[str]:
    """Yield lines between defined points, cut at breaks, and a mark at every point."""
    n = len(names)
    points = [(_x(i, n), _y(value)) for i, value in enumerate(curve.values)]
    runs: list[list[tuple[float, float]]] = [[]]
    for i, (x, y) in enumerate(points):
        if i in breaks or math.isnan(y):
            runs.append([])
        if not math.isnan(y):
            runs[-1].append((x, y))
    yield f'<g class="curve" style="--class:{class_colour(curve.name)}">'
    for run in runs:
        if len(run) > 1:
            path = " ".join(f"{x:.1f},{y:.1f}" for x, y in run)
            yield f'<polyline class="rim" points="{path}"/><polyline points="{path}"/>'
    alone = {run[0] for run in runs if len(run) == 1}
    size = 3.6 if n <= 30 else 2.2
    for (x, y), name, value in zip(points, names, curve.values, strict=True):
        if not math.isnan(y) and (n <= _MAX_MARKS or (x, y) in alone):
            tip = escape(f"{curve.name}, {name}: {value:.3f}")
            yield f"<g><title>{tip}</title>{mark(curve.place, x, y, size)}</g>"
    yield "</g>"


def _bars(names: Sequence[str], counts: Sequence[int]) -> list[str]:
    n = len(counts)
    most = max([*counts, 1])
    base = _TOP + _PLOT_HEIGHT + _GAP + _BAR_HEIGHT
    step = (_WIDTH - _LEFT - _RIGHT) / max(n, 1)
    width = max(step * 0.86, 0.5)
    bars = [f'<text x="{_LEFT - 7}" y="{base - 8}" text-anchor="end" class="small">n</text>']
    for i, (name, count) in enumerate(zip(names, counts, strict=True)):
        height = _BAR_HEIGHT * count / most
        shape = (
            f'x="{_x(i, n) - width / 2:.1f}" y="{base - height:.1f}" '
            f'width="{width:.1f}" height="{height:.1f}"'
        )
        bars.append(
            f'<rect class="bar" {shape}><title>{escape(name)}: {count:,} records</title></rect>'
        )
    bars.append(f'<line class="axis" x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{base}" y2="{base}"/>')
    return bars


def _tick_labels(ticks: Sequence[str], axis: str) -> list[str]:
    n = len(ticks)
    y = _HEIGHT - _LABEL_HEIGHT + 15
    step = (_WIDTH - _LEFT - _RIGHT) / max(n, 1)
    widest = max((len(tick) for tick in ticks), default=1) * _LETTER + 8
    n_apart = max(1, math.ceil(widest / step))
    # a round number of parts between labels reads better than 7
    round_numbers = (1, 2, 5, 10, 20, 50, 100, 200, 500)
    n_apart = next((number for number in round_numbers if number >= n_apart), n_apart)
    labels = [
        f'<text x="{_x(i, n):.1f}" y="{y}" text-anchor="middle">{escape(tick)}</text>'
        for i, tick in enumerate(ticks)
        if i % n_apart == 0
    ]
    middle = (_LEFT + _WIDTH - _RIGHT) / 2
    labels.append(
        f'<text class="small" x="{middle:.1f}" y="{_HEIGHT - 6}" '
        f'text-anchor="middle">{escape(axis)}</text>'
    )
    return labels


def _x(i: int, n: int) -> float:
    return _LEFT + (i + 0.5) * (_WIDTH - _LEFT - _RIGHT) / n


def _y(value: float) -> float:
    return _TOP + (1.0 - value) * _PLOT_HEIGHT


def _polygon(x: float, y: float, corners: Sequence[tuple[float, float]]) -> str:
    return f'<polygon points="{" ".join(f"{x + dx:.1f},{y + dy:.1f}" for dx, dy in corners)}"/>'


DEEP = 0.76
"""Share of the colour in a cell above which text is white."""
_LARGEST = 6
"""Rows of the table of the largest differences."""
_LISTED = 30
"""Rows of the table of places."""
_PNG = b"\x89PNG\r\n\x1a\n"
_AXES = {"range": "range [m]", "lines": "first scan line of the block", "scanner": "scanner"}
_TITLES = {"f1": "F1", "iou": "IoU", "accuracy": "one against rest"}
_VIEWS = (
    ("counts", "Counts", "records, coloured by their share of the row"),
    ("rows", "Share of reference", "what became of a reference class; recall where both agree"),
    (
        "columns",
        "Share of predicted",
        "what a predicted class is made of; precision where both agree",
    ),
)


def as_html(
    comparison: Comparison,
    gates: Sequence[GateResult] = (),
    *,
    mapping: ClassMapping | None = None,
    pictures: Sequence[tuple[str, bytes]] = (),
    title: str = "Predicted against reference classes",
    origin: Sequence[str] = (),
) -> str:
    """Return the page."""
    shown = matrix_of(comparison).trimmed()
    evaluation = comparison if isinstance(comparison, Evaluation) else None
    shown_scores = scores(shown)
    for name, content in pictures:
        check_picture(name, content)
    mapped_names: tuple[str, ...] = ()
    if mapping is not None:
        mapped_names = tuple(dict.fromkeys((*mapping.reference, *mapping.predicted)))
    values: dict[str, Any] = {
        "title": title,
        "origin": origin,
        "evaluation": evaluation,
        "matrix": shown,
        "scores": shown_scores,
        "intervals": NO_INTERVALS if evaluation is None else evaluation.intervals,
        "overall_scores": OVERALL_SCORES,
        "class_scores": [
            (name, _TITLES.get(name, title)) for name, title in score_titles(shown_scores).items()
        ],
        "called_noise_title": CALLED_NOISE_TITLE,
        "good_called_noise_title": GOOD_CALLED_NOISE_TITLE,
        "class_names": tuple(dict.fromkeys((*shown.reference_names, *shown.predicted_names))),
        "gates": gates,
        "gates_line": gates_line(gates),
        "views": [matrix_view(shown, *view) for view in _VIEWS],
        "column_sums": shown.counts.sum(axis=0).tolist(),
        "largest": _largest(shown),
        "pictures": [
            (name, base64.b64encode(content).decode("ascii")) for name, content in pictures
        ],
        "mapping": mapping,
        "mapped_names": mapped_names,
        "data": page_data(as_dict(comparison, gates)),
        "doubts": (),
        "splits": (),
        "three": None,
        "places": None,
    }
    if evaluation is not None:
        values |= _of_evaluation(evaluation, shown)
    return evaluation_page("evaluation.html", values)


def evaluation_page(template: str, values: dict[str, Any]) -> str:
    """Return a page in the style of an evaluation, from a template of this package."""
    style = (resources.files("prc_cli.evaluation") / "page.css").read_text(encoding="utf-8")
    filters: dict[str, Callable[..., Any]] = {
        "colour": class_colour,
        "figure": figure,
        "gate_cells": gate_cells,
        "percent": percent,
        "place": lambda score: f"{100 * min(max(score, 0.0), 1.0):.1f}",
        "thousands": "{:,}".format,
    }
    tests = {"known": lambda score: not math.isnan(score)}
    shared = {"style": style}
    return render_page("prc_cli.evaluation", template, values | shared, filters, tests)


def page_data(table: dict[str, Any]) -> str:
    """Return JSON for an element of a page."""
    # "<" is escaped, so that user text cannot end the element
    return json.dumps(table, allow_nan=False).replace("<", "\\u003c")


def check_picture(name: str, content: bytes) -> None:
    """Refuse pictures that are not PNG."""
    if not content.startswith(_PNG):
        raise InputError(name, "is no PNG picture", "give pictures as prc render writes them")


def gates_line(gates: Sequence[GateResult]) -> str:
    """Return how many gates failed."""
    n_failed = sum(not gate.passed for gate in gates)
    if len(gates) == 1:
        return "the gate failed" if n_failed else "the gate passed"
    return (
        f"{n_failed} of {len(gates)} gates failed" if n_failed else f"all {len(gates)} gates passed"
    )


def matrix_view(
    shown: ConfusionMatrix,
    key: str,
    name: str,
    words: str,
) -> dict[str, Any]:
    """Return the cells of a matrix for a page; ``key`` is counts, rows or columns."""
    shares = (shown.column_shares() if key == "columns" else shown.row_shares()).tolist()
    agreeing = set(shown.scored_names)
    rows = []
    for row_name, counts, row in zip(
        shown.reference_names, shown.counts.tolist(), shares, strict=True
    ):
        cells = []
        for column_name, count, share in zip(shown.predicted_names, counts, row, strict=True):
            colour = 0.0 if math.isnan(share) else share
            kind = "agree" if column_name == row_name and row_name in agreeing else "differ"
            texts = f"{count:,}", percent(share)
            main, small = texts if key == "counts" else texts[::-1]
            cells.append(
                {
                    "kind": f"{kind} deep" if colour > DEEP else kind,
                    "share": f"{colour:.4f}",
                    "main": main,
                    "small": small,
                }
            )
        rows.append({"name": row_name, "cells": cells, "total": sum(counts)})
    return {"key": key, "name": name, "words": words, "rows": rows}


def _largest(shown: ConfusionMatrix) -> list[tuple[int, str, str]]:
    """Return the largest off-diagonal cells: records, reference class, predicted class."""
    cells = [
        (count, row_name, column_name)
        for row_name, counts in zip(shown.reference_names, shown.counts.tolist(), strict=True)
        for column_name, count in zip(shown.predicted_names, counts, strict=True)
        if count and not (row_name == column_name and row_name in shown.scored_names)
    ]
    return sorted(cells, key=lambda cell: -cell[0])[:_LARGEST]


def _of_evaluation(evaluation: Evaluation, shown: ConfusionMatrix) -> dict[str, Any]:
    """Return the values that only an evaluation has, not a matrix alone."""
    match = evaluation.match
    n_reference_matched = (
        match.n_matched if match.n_reference_matched is None else match.n_reference_matched
    )
    return {
        "doubts": doubts(evaluation),
        "splits": [_split(split, parts, shown) for split, parts in evaluation.splits.items()],
        "match_line": match_line(match),
        "three": evaluation.three,
        "places": None if evaluation.places is None else _places(evaluation.places),
        "sides": (
            ("predicted", match.n_predicted, match.n_matched),
            ("reference", match.n_reference, n_reference_matched),
        ),
        "file_pairs": tuple(zip_longest(evaluation.predicted, evaluation.reference, fillvalue="")),
    }


def _places(places: Places) -> dict[str, Any]:
    """Return the places of the page: rows, each with its picture if there is one."""
    pictures = [base64.b64encode(content).decode("ascii") for content in places.pictures]
    rows = place_rows(places)[: len(pictures) or _LISTED]
    return {
        "rows": list(zip_longest(rows, pictures)),
        "n": len(places.places),
        "n_listed": places.n_listed,
        "n_differ": places.n_differ,
    }


def _split(split: str, parts: Sequence[SplitPart], shown: ConfusionMatrix) -> dict[str, Any]:

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
    split: str,
    parts: Sequence[SplitPart],
    places: dict[str, int],
    breaks: set[int],
) -> Iterator[tuple[str, str]]:
    """Yield scores and their charts, as SVG."""
    class_scores = [scores(part.matrix).by_name for part in parts]
    counts = [part.matrix.n_scored for part in parts]
    # short, since the axis title gives the unit
    ticks = [
        f"{part.low:g}" if split == "lines" else part.name.removesuffix(" m") for part in parts
    ]
    for score in ("recall", "precision"):
        curves = [
            Curve(name, tuple(getattr(part[name], score) for part in class_scores), place)
            for name, place in places.items()
        ]
        axis = _AXES.get(split, split)
        names = [part.name for part in parts]
        yield score, line_chart(f"{score} by {split}", axis, names, counts, curves, ticks, breaks)
