"""Several methods against one reference, in the layout of Lehtola et al. (2019), Table I.

Every method has the evaluation of a single run. The reports put them beside each other.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from prc_cli.core.brief import Brief
from prc_cli.evaluation.html import DEEP, evaluation_page, page_data
from prc_cli.evaluation.reports import (
    as_csv,
    as_dict,
    doubts,
    markdown_table,
    match_line,
    plain,
    with_interval,
)
from prc_cli.evaluation.scores import (
    CALLED_NOISE,
    CALLED_NOISE_TITLE,
    GOOD_CALLED_NOISE_TITLE,
    OVERALL_SCORES,
    TABLE_SCORES,
    Evaluation,
    GateResult,
    figure,
    scores,
)

_TITLES = {"f1": "F1", CALLED_NOISE: CALLED_NOISE_TITLE}
_OF_ALL = {CALLED_NOISE: GOOD_CALLED_NOISE_TITLE}


@dataclass(frozen=True, slots=True, repr=False)
class ComparedMethods(Brief):
    """The evaluations of several methods against one reference, with one class mapping."""

    evaluations: Mapping[str, Evaluation]
    """By the name of the method, in the order of the columns."""

    @property
    def classes(self) -> tuple[str, ...]:
        """Classes that the reference or a prediction has, those of the reference first."""
        matrices = [evaluation.matrix.trimmed() for evaluation in self.evaluations.values()]
        rows = dict.fromkeys(name for matrix in matrices for name in matrix.reference_names)
        columns = dict.fromkeys(name for matrix in matrices for name in matrix.predicted_names)
        return tuple(rows | columns)

    def table(self, dash: str = "-") -> tuple[list[str], list[list[str]]]:
        """Return header and rows: recall, precision, F1 of every class, a column a method.

        The share of every class called noise, the scores of the whole matrix and the number of
        scored records follow.
        """
        methods = self.evaluations.values()
        tables = [scores(evaluation.matrix) for evaluation in methods]
        rows = []
        for score in (*TABLE_SCORES, CALLED_NOISE):
            for name in self.classes:
                cells = []
                for evaluation, table in zip(methods, tables, strict=True):
                    value = getattr(table.by_name[name], score)
                    cells.append(
                        with_interval(value, evaluation.intervals.get(f"{score}.{name}"), dash)
                    )
                if set(cells) != {dash}:
                    rows.append([_TITLES.get(score, score), name, *cells])
        for score in (*OVERALL_SCORES, CALLED_NOISE):
            cells = [
                with_interval(getattr(table, score), evaluation.intervals.get(score), dash)
                for evaluation, table in zip(methods, tables, strict=True)
            ]
            if set(cells) != {dash}:
                title = _OF_ALL.get(score, score.replace("_", " "))
                rows.append([title, "all", *cells])
        rows.append(["records", "scored", *(f"{table.n_scored:,}" for table in tables)])
        return ["score", "class", *self.evaluations], rows

    def shares(self, method: str) -> tuple[list[str], list[list[str]]]:
        """Return header and rows of the confusion of one method: records, shares of the row."""
        matrix = self.evaluations[method].matrix.trimmed()
        rows = []
        for name, counts, shares in zip(
            matrix.reference_names,
            matrix.counts.tolist(),
            matrix.row_shares().tolist(),
            strict=True,
        ):
            rows.append([name, f"{sum(counts):,}", *map(figure, shares)])
        return ["reference", "records", *matrix.predicted_names], rows


def methods_dict(
    methods: ComparedMethods, gates: Mapping[str, Sequence[GateResult]] | None = None
) -> dict[str, Any]:
    """Return the result of every method as plain values; undefined scores are None."""
    return {
        "methods": {
            name: as_dict(evaluation, (gates or {}).get(name, ()))
            for name, evaluation in methods.evaluations.items()
        }
    }


def methods_csv(methods: ComparedMethods) -> str:
    """Return the rows of every method, with its name in the first column."""
    lines: list[str] = []
    for name, evaluation in methods.evaluations.items():
        header, *rows = as_csv(evaluation).splitlines()
        if not lines:
            lines.append(f"method,{header}")
        quoted = name.replace('"', '""')
        cell = f'"{quoted}"' if set(quoted) & set(',"\n') else quoted
        lines += [f"{cell},{row}" for row in rows]
    return "\n".join(lines) + "\n"


def methods_markdown(methods: ComparedMethods) -> str:
    """Return the table, and the confusion of every method, as Markdown."""
    parts = [markdown_table(*methods.table(), n_words=2)]
    parts += [f"Intervals: {plain(method)}." for method in _interval_methods(methods)]
    for name, evaluation in methods.evaluations.items():
        parts.append(f"{plain(name)}: share of the reference class, by predicted class.")
        parts.append(markdown_table(*methods.shares(name)))
        parts.append(plain(match_line(evaluation.match)))
        parts += [plain(note) for note in (*evaluation.match.notes, *doubts(evaluation))]
        parts.append(f"File: {', '.join(map(plain, evaluation.predicted))}.")
    first = next(iter(methods.evaluations.values()))
    parts.append(
        f"Reference: {', '.join(map(plain, first.reference))}. "
        f"Class mapping: {plain(first.mapping)}."
    )
    return "\n\n".join(parts) + "\n"


def methods_json(
    methods: ComparedMethods, gates: Mapping[str, Sequence[GateResult]] | None = None
) -> str:
    """Return :func:`methods_dict` as JSON text."""
    return json.dumps(methods_dict(methods, gates), indent=2, allow_nan=False)


def methods_html(
    methods: ComparedMethods,
    gates: Mapping[str, Sequence[GateResult]] | None = None,
    *,
    origin: Sequence[str] = (),
) -> str:
    """Return a page without scripts: the table, and the confusion of every method."""
    header, rows = methods.table()
    first = next(iter(methods.evaluations.values()))
    values: dict[str, Any] = {
        "origin": origin,
        "first": first,
        "header": header,
        "rows": _with_best(rows),
        "intervals": _interval_methods(methods),
        "methods": [_method_values(methods, name) for name in methods.evaluations],
        "gates": gates or {},
        "data": page_data(methods_dict(methods, gates)),
    }
    return evaluation_page("methods.html", values)


def _interval_methods(methods: ComparedMethods) -> list[str]:
    used = (
        evaluation.interval_method
        for evaluation in methods.evaluations.values()
        if evaluation.intervals
    )
    return list(dict.fromkeys(used))


def _method_values(methods: ComparedMethods, name: str) -> dict[str, Any]:
    evaluation = methods.evaluations[name]
    matrix = evaluation.matrix.trimmed()
    rows = []
    for row_name, counts, shares in zip(
        matrix.reference_names, matrix.counts.tolist(), matrix.row_shares().tolist(), strict=True
    ):
        cells = []
        for column_name, count, share in zip(matrix.predicted_names, counts, shares, strict=True):
            colour = 0.0 if math.isnan(share) else share
            kind = "agree" if column_name == row_name else "differ"
            kind = f"{kind} deep" if colour > DEEP else kind
            cells.append(
                {"kind": kind, "share": f"{colour:.4f}", "value": share, "count": f"{count:,}"}
            )
        rows.append((row_name, cells, f"{sum(counts):,}"))
    return {
        "name": name,
        "columns": matrix.predicted_names,
        "rows": rows,
        "files": evaluation.predicted,
        "match": match_line(evaluation.match),
        "notes": (*evaluation.match.notes, *doubts(evaluation)),
    }


def _with_best(rows: Sequence[Sequence[str]]) -> list[tuple[str, str, list[tuple[str, bool]]]]:
    """Return rows whose cells are marked if they have the best score of the row."""
    marked = []
    for score, name, *cells in rows:
        values = [cell.split()[0] for cell in cells]
        numbers = [value for value in values if value != "-"]
        best_of = min if score.endswith(CALLED_NOISE_TITLE) else max
        best = best_of(numbers, key=float, default="") if score != "records" else ""
        marked.append(
            (
                score,
                name,
                [(cell, value == best) for cell, value in zip(cells, values, strict=True)],
            )
        )
    return marked
