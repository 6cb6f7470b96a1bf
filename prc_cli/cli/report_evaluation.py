"""Tables of an evaluation on stdout; a separate module, since most commands do not evaluate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from prc_cli.cli.report import results, table_of
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.reports import (
    NO_INTERVALS,
    doubts,
    gate_cells,
    match_line,
    overall_line,
    percent,
    score_row,
    split_table,
)
from prc_cli.evaluation.scores import CLASS_SCORES, Evaluation, GateResult, Interval, Scores, scores

MAX_PARTS = 40
"""Most parts of a split shown on a terminal."""


def print_evaluation(matrix: ConfusionMatrix, found: Scores, intervals: Mapping[str, Interval] = NO_INTERVALS) -> None:
    """Print a confusion matrix with row shares, and the scores, on stdout."""
    shown = matrix.trimmed()
    rows = [
        (name, *(f"{count:,} ({percent(share)})" for count, share in zip(counts, shares, strict=True)))
        for name, counts, shares in zip(shown.reference_names, shown.counts, shown.row_shares(), strict=True)
    ]
    title = "reference in rows, predicted in columns: records (share of the row)"
    _print(title, ("reference", *shown.predicted_names), rows)
    _print("scores", ("class", *CLASS_SCORES), [score_row(item, intervals) for item in scores(shown).classes])
    counts = f"scored {found.n_scored:,} records, ignored {found.n_ignored:,}"
    results().print(f"{counts}: {overall_line(found, intervals)}")


def _print(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    results().print(table_of(title, *header, rows=rows, overflow="fold"))


def print_evaluation_details(found: Evaluation, gates: Sequence[GateResult]) -> None:
    """Print the parts of an evaluation, its gates and how the records were matched, on stdout."""
    if found.intervals:
        results().print(f"intervals: {found.interval_method}")
    for split, parts in found.splits.items():
        header, rows = split_table(parts, found.matrix.trimmed())
        _print(f"by {split}", header, rows[:MAX_PARTS])
        if len(rows) > MAX_PARTS:
            results().print(f"and {len(rows) - MAX_PARTS} more; --output and --format have all of them")
    if found.three is not None:
        _print("three labellings", *found.three.table())
        for sentence in found.three.sentences():
            results().print(sentence)
    for gate in gates:
        name, limit, value = gate_cells(gate)
        results().print(f"{name}: found {value}, demanded {limit}: {'passed' if gate.passed else 'failed'}")
    results().print(match_line(found.match))
    for note in (*found.match.notes, *doubts(found)):
        results().print(note)
