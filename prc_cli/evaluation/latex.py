r"""An evaluation as LaTeX tables (``booktabs``), to be read into a paper with ``\input``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.reports import (
    NO_INTERVALS,
    Comparison,
    match_line,
    matrix_of,
    overall_line,
    score_row,
    split_table,
)
from prc_cli.evaluation.scores import CLASS_SCORES, Evaluation, scores

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
}
_TITLES = {"f1": "F1", "iou": "IoU"}


def as_latex(comparison: Comparison) -> str:
    """Return LaTeX tables of counts, row shares, scores and splits.

    They need the package booktabs and UTF-8. Empty classes are left out.
    """
    shown = matrix_of(comparison).trimmed()
    evaluation = comparison if isinstance(comparison, Evaluation) else None
    source = ""
    if evaluation is not None:
        files = f"{_listed(evaluation.predicted)} against {_listed(evaluation.reference)}"
        mapping = escape(evaluation.mapping)
        match = escape(match_line(evaluation.match))
        source = f" {escape(files)}, class mapping {mapping}. {match}"
    blocks = [
        "% needs \\usepackage{booktabs} and \\usepackage[T1]{fontenc}",
        _counts(shown, source),
        _row_shares(shown),
        _scores(shown, evaluation),
    ]
    if evaluation is not None:
        blocks += _splits(evaluation, shown)
    return "\n\n".join(blocks) + "\n"


def escape(text: str) -> str:
    """Return text of users so that LaTeX prints it as it is, on one line."""
    return "".join(
        _SPECIAL.get(character, character if character.isprintable() else " ") for character in text
    )


def _counts(shown: ConfusionMatrix, source: str) -> str:
    caption = f"Confusion matrix, records; reference in rows, predicted in columns.{source}"
    header = ["", *(escape(name) for name in shown.predicted_names), "Sum"]
    rows = [
        [escape(name), *(_count(value) for value in counts), _count(sum(counts))]
        for name, counts in zip(shown.reference_names, shown.counts.tolist(), strict=True)
    ]
    sums = shown.counts.sum(axis=0).tolist()
    return _table(
        caption,
        "counts",
        header,
        rows,
        ["Sum", *(_count(value) for value in sums), _count(sum(sums))],
    )


def _row_shares(shown: ConfusionMatrix) -> str:
    caption = "Confusion matrix, shares of the reference class (recall on the diagonal)."
    header = ["", *(escape(name) for name in shown.predicted_names)]
    rows = []
    for name, shares in zip(shown.reference_names, shown.row_shares().tolist(), strict=True):
        cells = ["--" if math.isnan(share) else f"{share:.3f}" for share in shares]
        if name in shown.predicted_names and name in shown.scored_names:
            place = shown.predicted_names.index(name)
            cells[place] = rf"\textbf{{{cells[place]}}}"
        rows.append([escape(name), *cells])
    return _table(caption, "rows", header, rows)


def _scores(shown: ConfusionMatrix, evaluation: Evaluation | None) -> str:
    intervals = NO_INTERVALS if evaluation is None else evaluation.intervals
    matrix_scores = scores(shown)
    n_scored = _count(matrix_scores.n_scored)
    n_ignored = _count(matrix_scores.n_ignored)
    overall = overall_line(matrix_scores, intervals, "--")
    caption = f"Scores of {n_scored} records ({n_ignored} not scored): {overall}."
    if evaluation is not None and intervals:
        caption += f" Intervals: {escape(evaluation.interval_method)}."
    header = ["Class", *(_TITLES.get(name, name.capitalize()) for name in CLASS_SCORES)]
    rows = [
        list(map(escape, score_row(class_scores, intervals, "--")))
        for class_scores in matrix_scores.classes
    ]
    return _table(caption, "scores", header, rows)


def _splits(evaluation: Evaluation, shown: ConfusionMatrix) -> Iterator[str]:
    """Yield recall and precision as separate tables: side by side they are wider than a page."""
    for number, (split, parts) in enumerate(evaluation.splits.items()):
        header, rows = split_table(parts, shown)
        for score in ("recall", "precision"):
            places = [i for i, title in enumerate(header) if title.startswith(f"{score} ")]
            names = [escape(header[i].removeprefix(f"{score} ")) for i in places]
            lines = [
                [escape(row[0]), _count(int(row[1])), *(row[i] for i in places)] for row in rows
            ]
            caption = f"{score.capitalize()} by {escape(split)}."
            yield _table(caption, f"{score}-{number}", ["Part", "Records", *names], lines)


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{len(names)} files"


def _table(
    caption: str,
    label: str,
    header: Sequence[str],
    rows: Sequence[Sequence[str]],
    last: Sequence[str] = (),
) -> str:
    lines = [
        r"\begin{table}",
        r"\centering",
        rf"\caption{{{caption}}}",
        rf"\label{{tab:evaluation-{label}}}",
        rf"\begin{{tabular}}{{l{'r' * (len(header) - 1)}}}",
        r"\toprule",
        _line(header),
        r"\midrule",
        *(_line(row) for row in rows),
        *((r"\midrule", _line(last)) if last else ()),
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table}",
    ]
    return "\n".join(lines)


def _line(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


def _count(value: int) -> str:
    r"""Return a count in groups of three.

    >>> print(_count(1234567))
    1\,234\,567
    """
    return f"{value:,}".replace(",", r"\,")
