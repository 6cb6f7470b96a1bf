"""An evaluation as one HTML page that needs nothing else: no network, no script, light and dark, fit for print."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from importlib import resources
from itertools import pairwise

from prc_cli.core.errors import InputError
from prc_cli.core.types import F64
from prc_cli.evaluation.charts import Curve, class_colour, line_chart, mark
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.gates import GateResult
from prc_cli.evaluation.mapping import ClassMapping, Codes
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
from prc_cli.evaluation.result import Evaluation, Interval, SplitPart
from prc_cli.evaluation.scores import CLASS_SCORES, OVERALL_SCORES, ClassScores, Scores, scores

_DEEP = 0.76
"""Share of the colour in a cell beyond which white text reads better."""
_LARGEST = 6
_PNG = b"\x89PNG\r\n\x1a\n"
_AXES = {"range": "range [m]", "lines": "first scan line of the block", "scanner": "scanner"}
_TITLES = {"f1": "F1", "iou": "IoU", "accuracy": "one against rest"}
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:"


def as_html(
    found: Found,
    gates: Sequence[GateResult] = (),
    *,
    mapping: ClassMapping | None = None,
    pictures: Sequence[tuple[str, bytes]] = (),
    title: str = "Predicted against reference classes",
) -> str:
    """Return the page.

    Parameters
    ----------
    found : Evaluation or ConfusionMatrix
        What to show.
    gates : sequence of GateResult
        Demands, shown with what became of them.
    mapping : ClassMapping, optional
        The mapping of the evaluation; its codes are listed.
    pictures : sequence of (title, PNG)
        Pictures to put into the page, whole files as bytes.
    title : str
        Heading of the page.

    Raises
    ------
    InputError
        When a picture is no PNG.
    """
    shown = matrix_of(found).trimmed()
    result = scores(shown)
    evaluation = found if isinstance(found, Evaluation) else None
    intervals = NO_INTERVALS if evaluation is None else evaluation.intervals
    style = (resources.files("prc_cli.evaluation") / "page.css").read_text(encoding="utf-8")
    blocks = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{_text(title)}</title>",
        f"<style>\n{style}</style></head>",
        "<body><main>",
        *_header(title, evaluation, gates),
        *_tiles(result, intervals),
        *_gates(gates),
        *_matrix(shown),
        *_scores(result, evaluation),
    ]
    if evaluation is not None:
        for split, parts in evaluation.splits.items():
            blocks += _split(split, parts, shown)
    blocks += _pictures(pictures, shown)
    if evaluation is not None:
        blocks += _match(evaluation)
    if mapping is not None:
        blocks += _mapping(mapping, "" if evaluation is None else evaluation.mapping)
    blocks += ["<footer>Written by prc evaluate. The whole result stands in this page as JSON too.</footer>", "</main>"]
    # "<" as an escape: no text of users can end the element
    data = json.dumps(as_dict(found, gates), allow_nan=False).replace("<", "\\u003c")
    blocks += [f'<script type="application/json" id="evaluation">{data}</script>', "</body></html>"]
    return "\n".join(blocks) + "\n"


def check_picture(name: str, content: bytes) -> None:
    """Refuse what is no picture that the page can show.

    Raises
    ------
    InputError
        When the content is no PNG.
    """
    if not content.startswith(_PNG):
        raise InputError(name, "is no PNG picture", "give pictures as prc render writes them")


def _header(title: str, found: Evaluation | None, gates: Sequence[GateResult]) -> Iterator[str]:
    yield f"<header><h1>{_text(title)}</h1>"
    if found is not None:
        pair = f"{_files(found.predicted)} against {_files(found.reference)}"
        yield f'<p class="lead">{pair}, class mapping <code>{_text(found.mapping)}</code></p>'
    if gates:
        n_failed = sum(not gate.passed for gate in gates)
        word = f"{n_failed} of {len(gates)} gates failed" if n_failed else f"all {len(gates)} gates passed"
        word = word.replace("all 1 gates", "the gate").replace("1 of 1 gates failed", "the gate failed")
        yield f'<p><span class="badge {"failed" if n_failed else "passed"}">{word}</span></p>'
    if found is not None:
        yield from (f'<p class="doubt">{_text(doubt)}</p>' for doubt in doubts(found))
    yield "</header>"


def _files(names: Sequence[str]) -> str:
    return f"<code>{_text(names[0])}</code>" if len(names) == 1 else f"{len(names)} files"


def _tiles(found: Scores, intervals: Mapping[str, Interval]) -> Iterator[str]:
    yield '<div class="tiles">'
    for name in OVERALL_SCORES:
        words = "Cohen's kappa" if name == "kappa" else name.replace("_", " ")
        interval = intervals.get(name)
        limits = "" if interval is None else f"<small>{_range(interval)}</small>"
        yield _tile(figure(getattr(found, name)), words, limits)
    yield _tile(f"{found.n_scored:,}", "records scored", f"<small>{found.n_ignored:,} ignored</small>")
    yield "</div>"


def _tile(value: str, words: str, more: str) -> str:
    return f'<div class="tile"><b>{value}</b><span>{_text(words)}</span>{more}</div>'


def _gates(gates: Sequence[GateResult]) -> Iterator[str]:
    if not gates:
        return
    yield '<section><h2>Gates</h2><table class="lines gates"><thead><tr><th>score</th><th>demanded</th><th>found</th>'
    yield "<th></th></tr></thead><tbody>"
    for gate in gates:
        name, limit, value = gate_cells(gate)
        word = "passed" if gate.passed else "failed"
        yield f'<tr><td>{_text(name)}</td><td>≥ {limit}</td><td>{value}</td><td class="{word}">{word}</td></tr>'
    yield "</tbody></table></section>"


def _matrix(shown: ConfusionMatrix) -> Iterator[str]:
    yield "<section><h2>Confusion matrix</h2>"
    yield '<p class="note">Reference classes in rows, predicted classes in columns.</p><div class="beside"><fieldset>'
    views = (
        ("counts", "Counts", "records, coloured by their share of the row"),
        ("rows", "Share of reference", "what became of a reference class; recall where both agree"),
        ("columns", "Share of predicted", "what a predicted class is made of; precision where both agree"),
    )
    for key, name, _ in views:
        checked = " checked" if key == "counts" else ""
        yield f'<input type="radio" name="view" id="view-{key}"{checked}><label for="view-{key}">{name}</label>'
    rows, columns = shown.row_shares(), shown.column_shares()
    for key, name, words in views:
        yield f'<div class="view {key}"><h3>{name}</h3><p class="note">{name}: {words}.</p><div class="wide">'
        yield from _heat_table(shown, key, columns if key == "columns" else rows)
        yield "</div></div>"
    yield '<p class="note"><span class="key agree"></span>both sides agree'
    yield '<span class="key differ"></span>they differ, or the class has no counterpart</p></fieldset>'
    yield from _largest(shown)
    yield "</div></section>"


def _largest(shown: ConfusionMatrix) -> Iterator[str]:
    """List the cells with most records where both sides differ."""
    total = shown.n_scored
    cells = [
        (count, name, other)
        for name, counts in zip(shown.reference_names, shown.counts.tolist(), strict=True)
        for other, count in zip(shown.predicted_names, counts, strict=True)
        if count and not (name == other and name in shown.scored_names)
    ]
    if not cells:
        return
    yield '<div><h3>Largest differences</h3><table class="lines text"><thead><tr><th>reference</th><th>predicted</th>'
    yield '<th class="number">records</th><th class="number">of all</th></tr></thead><tbody>'
    for count, name, other in sorted(cells, key=lambda cell: -cell[0])[:_LARGEST]:
        numbers = f'<td class="number">{count:,}</td><td class="number">{percent(count / total)}</td>'
        yield f"<tr><td>{_class(name)}</td><td>{_class(other)}</td>{numbers}</tr>"
    yield "</tbody></table></div>"


def _heat_table(shown: ConfusionMatrix, key: str, shares: F64) -> Iterator[str]:
    width = len(shown.predicted_names)
    yield f'<table class="heat"><thead><tr><th></th><th colspan="{max(width, 1)}">predicted</th><th></th></tr>'
    heads = "".join(f"<th>{_class(name)}</th>" for name in shown.predicted_names)
    yield f"<tr><th>reference</th>{heads}<th>{'' if key == 'columns' else 'records'}</th></tr></thead><tbody>"
    agreeing = set(shown.scored_names)
    for name, counts, row in zip(shown.reference_names, shown.counts.tolist(), shares.tolist(), strict=True):
        cells = []
        for other, count, share in zip(shown.predicted_names, counts, row, strict=True):
            kind = "agree" if other == name and name in agreeing else "differ"
            seen = 0.0 if math.isnan(share) else share
            deep = " deep" if seen > _DEEP else ""
            main, small = (f"{count:,}", percent(share)) if key == "counts" else (percent(share), f"{count:,}")
            body = f"{main}<small>{small}</small>"
            cells.append(f'<td class="cell {kind}{deep}" style="--share:{seen:.4f}">{body}</td>')
        total = "" if key == "columns" else f"{sum(counts):,}"
        yield f'<tr><th>{_class(name)}</th>{"".join(cells)}<td class="sum">{total}</td></tr>'
    if key != "rows":
        sums = "".join(f'<td class="sum">{count:,}</td>' for count in shown.counts.sum(axis=0).tolist())
        yield f"<tr><th>records</th>{sums}<td></td></tr>"
    yield "</tbody></table>"


def _scores(found: Scores, evaluation: Evaluation | None) -> Iterator[str]:
    intervals = NO_INTERVALS if evaluation is None else evaluation.intervals
    yield "<section><h2>Scores</h2>"
    if evaluation is not None and intervals:
        yield f'<p class="note">Intervals: {_text(evaluation.interval_method)}.</p>'
    heads = "".join(f"<th>{_TITLES.get(name, name)}</th>" for name in CLASS_SCORES)
    yield '<div class="wide"><table class="lines scores"><thead><tr><th>class</th><th>reference</th><th>predicted</th>'
    yield f"<th>agreed</th>{heads}</tr></thead><tbody>"
    for item in found.classes:
        counts = "".join(f"<td>{count:,}</td>" for count in (item.n_reference, item.n_predicted, item.n_agreed))
        yield f"<tr><td>{_class(item.name)}</td>{counts}{_score_cells(item, intervals)}</tr>"
    yield '</tbody></table></div><p class="note">A dash: undefined, for a class of one side only, or without records.'
    yield "</p></section>"


def _score_cells(item: ClassScores, intervals: Mapping[str, Interval]) -> str:
    cells = []
    for name in CLASS_SCORES:
        value, interval = getattr(item, name), intervals.get(f"{name}.{item.name}")
        if math.isnan(value):
            cells.append("<td>-</td>")
            continue
        limits = "" if interval is None else f'<small class="range">{_range(interval)}</small>'
        cells.append(f"<td>{figure(value)}{_meter(value, interval)}{limits}</td>")
    return "".join(cells)


def _meter(value: float, interval: Interval | None) -> str:
    """Return a bar from 0 to 1 with its interval."""
    whisker = ""
    if interval is not None and not (math.isnan(interval.low) or math.isnan(interval.high)):
        low, high = (100 * min(max(end, 0.0), 1.0) for end in (interval.low, interval.high))
        ends = "".join(f'<line class="range" x1="{x:.1f}" x2="{x:.1f}" y1="1.5" y2="8.5"/>' for x in (low, high))
        whisker = f'<line class="range" x1="{low:.1f}" x2="{high:.1f}" y1="5" y2="5"/>{ends}'
    bar = f'<rect class="value" y="2" width="{100 * min(max(value, 0.0), 1.0):.1f}" height="6" rx="1.5"/>'
    whole = '<rect class="whole" y="2" width="100" height="6" rx="1.5"/>'
    frame = 'class="meter" viewBox="0 0 100 10" preserveAspectRatio="none" aria-hidden="true"'
    return f"<svg {frame}>{whole}{bar}{whisker}</svg>"


def _split(split: str, parts: Sequence[SplitPart], shown: ConfusionMatrix) -> Iterator[str]:
    drawn = [part for part in parts if part.name != NOT_SPLIT]
    found = [{item.name: item for item in scores(part.matrix).classes} for part in drawn]
    counts = [part.matrix.n_scored for part in drawn]
    names = shown.scored_names
    yield f"<section><h2>By {_text(split)}</h2>"
    if drawn:
        places = {name: (*shown.reference_names, *shown.predicted_names).index(name) for name in names}
        keys = (_legend_key(name, places[name]) for name in names)
        yield f'<div class="legend">{"".join(keys)}</div><div class="pair">'
        ticks = [_tick(split, part) for part in drawn]
        # the lines of every file begin at 0, and parts may have been left out
        breaks = {i + 1 for i, (part, after) in enumerate(pairwise(drawn)) if after.low != part.high}
        for score in ("recall", "precision"):
            curves = [Curve(name, tuple(getattr(part[name], score) for part in found), places[name]) for name in names]
            names_of = [part.name for part in drawn]
            axis = _AXES.get(split, split)
            chart = line_chart(f"{score} by {split}", axis, names_of, counts, curves, ticks, breaks)
            yield f"<div><h3>{score.capitalize()}</h3>{chart}</div>"
        broken = "where its score is undefined" + (
            ", and where parts are left out or the next file begins" if breaks else ""
        )
        yield f'</div><p class="note">n: scored records of a part. A curve is broken {broken}.</p>'
    _, rows = split_table(parts, shown)
    yield f'<details{" open" if len(parts) <= 12 else ""}><summary>Table</summary><div class="wide">'
    heads = "".join(f'<th colspan="2">{_class(name)}</th>' for name in names)
    yield f'<table class="lines"><thead><tr><th colspan="3"></th>{heads}</tr><tr><th>part</th><th>records</th>'
    yield f"<th>accuracy</th>{'<th>recall</th><th>precision</th>' * len(names)}</tr></thead><tbody>"
    for name, n, *cells in rows:
        numbers = "".join(f"<td>{cell}</td>" for cell in (f"{int(n):,}", *cells))
        yield f"<tr><td>{_text(name)}</td>{numbers}</tr>"
    yield "</tbody></table></div></details></section>"


def _tick(split: str, part: SplitPart) -> str:
    """Return the label of a part on the axis: short where the title of the axis says the rest."""
    return f"{part.low:g}" if split == "lines" else part.name.removesuffix(" m")


def _legend_key(name: str, place: int) -> str:
    line = '<line x1="1" x2="25" y1="7" y2="7" stroke="var(--class)" stroke-width="2.4"/>'
    drawing = f'<svg viewBox="0 0 26 14" aria-hidden="true"><g class="curve">{line}{mark(place, 13, 7)}</g></svg>'
    return f'<span style="--class:{class_colour(name)}">{drawing}{_text(name)}</span>'


def _pictures(pictures: Sequence[tuple[str, bytes]], shown: ConfusionMatrix) -> Iterator[str]:
    if not pictures:
        return
    names = dict.fromkeys((*shown.reference_names, *shown.predicted_names))
    keys = "".join(f"<span>{_class(name)}</span>" for name in names)
    yield f'<section><h2>Pictures</h2><div class="legend">{keys}</div>'
    for title, content in pictures:
        check_picture(title, content)
        data = base64.b64encode(content).decode("ascii")
        image = f'<img alt="{_text(title)}" src="data:image/png;base64,{data}">'
        yield f"<figure><figcaption>{_text(title)}</figcaption>{image}</figure>"
    yield "</section>"


def _match(found: Evaluation) -> Iterator[str]:
    match = found.match
    yield f"<section><h2>Matching and files</h2><p>{_text(match_line(match))}</p>"
    yield from (f'<p class="note">{_text(note)}</p>' for note in match.notes)
    yield '<div class="wide"><table class="lines"><thead><tr><th>side</th><th>records</th><th>in pairs</th>'
    yield "<th>share</th></tr></thead><tbody>"
    again = match.n_matched if match.n_reference_matched is None else match.n_reference_matched
    for side, n, paired in (("predicted", match.n_predicted, match.n_matched), ("reference", match.n_reference, again)):
        share = percent(paired / n) if n else "-"
        yield f"<tr><td>{side}</td><td>{n:,}</td><td>{paired:,}</td><td>{share}</td></tr>"
    yield "</tbody></table></div>"
    yield '<div class="wide"><table class="lines text"><thead><tr><th>predicted</th><th>reference</th></tr>'
    yield "</thead><tbody>"
    for i in range(max(len(found.predicted), len(found.reference))):
        cells = (names[i] if i < len(names) else "" for names in (found.predicted, found.reference))
        yield f"<tr>{''.join(f'<td><code>{_text(cell)}</code></td>' for cell in cells)}</tr>"
    yield "</tbody></table></div></section>"


def _mapping(mapping: ClassMapping, name: str) -> Iterator[str]:
    yield f"<section><h2>Class mapping {_text(name)}</h2>"
    yield '<div class="wide"><table class="lines text"><thead><tr><th>class</th><th>predicted codes</th>'
    yield "<th>reference codes</th></tr></thead><tbody>"
    names = [*mapping.reference, *(item for item in mapping.predicted if item not in mapping.reference)]
    for item in names:
        codes = (_codes(mapping.predicted.get(item, ())), _codes(mapping.reference.get(item, ())))
        yield f"<tr><td>{_class(item)}</td><td>{codes[0]}</td><td>{codes[1]}</td></tr>"
    yield f"<tr><td>not scored</td><td>{_codes(mapping.ignore)}</td>"
    yield f"<td>{_codes((*mapping.ignore, *mapping.ignore_reference))}</td></tr></tbody></table></div>"
    fate = {"error": "were refused", "other": "count as other", "ignore": "are not scored"}[mapping.unlisted]
    yield f'<p class="note">Codes that stand in no list {fate}.</p></section>'


def _codes(codes: Codes) -> str:
    return _text(", ".join(str(code) for code in codes)) or "-"


def _class(name: str) -> str:
    """Return a class name behind a chip of its colour."""
    return f'<span class="chip" style="--class:{class_colour(name)}"></span>{_text(name)}'


def _range(interval: Interval) -> str:
    return f"{figure(interval.low)} – {figure(interval.high)}"


def _text(text: str) -> str:
    """Return text of users as HTML shows it, control characters as blanks."""
    return escape("".join(character if character.isprintable() else " " for character in text))
