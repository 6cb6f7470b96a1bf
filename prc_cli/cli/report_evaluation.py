"""Tables of an evaluation on stdout; a separate module, since most commands do not evaluate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.table import Table

from prc_cli.cli.report import results
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.reports import (
    NO_INTERVALS,
    doubts,
    gate_cells,
    match_line,
    overall_line,
    percent,
    split_table,
    with_interval,
)
from prc_cli.evaluation.scores import CLASS_SCORES, Evaluation, GateResult, Interval, Scores, scores

MAX_PARTS = 40
"""Most parts of a split shown on a terminal."""


def print_evaluation(matrix: ConfusionMatrix, found: Scores, intervals: Mapping[str, Interval] = NO_INTERVALS) -> None:
    """Print a confusion matrix with row shares, and the scores, on stdout."""
    shown = matrix.trimmed()
    table = Table(title="reference in rows, predicted in columns: records (share of the row)")
    table.add_column("reference", overflow="fold")
    for name in shown.predicted_names:
        table.add_column(name, justify="right", overflow="fold")
    for name, counts, shares in zip(shown.reference_names, shown.counts, shown.row_shares(), strict=True):
        cells = (f"{count:,} ({percent(share)})" for count, share in zip(counts, shares, strict=True))
        table.add_row(name, *cells)
    results().print(table)
    table = Table(title="scores")
    table.add_column("class", overflow="fold")
    for score in CLASS_SCORES:
        table.add_column(score, justify="right", overflow="fold")
    for item in scores(shown).classes:
        values = ((getattr(item, score), intervals.get(f"{score}.{item.name}")) for score in CLASS_SCORES)
        table.add_row(item.name, *(with_interval(value, interval) for value, interval in values))
    results().print(table)
    counts = f"scored {found.n_scored:,} records, ignored {found.n_ignored:,}"
    results().print(f"{counts}: {overall_line(found, intervals)}")


def print_evaluation_details(found: Evaluation, gates: Sequence[GateResult]) -> None:
    """Print the parts of an evaluation, its gates and how the records were matched, on stdout."""
    if found.intervals:
        results().print(f"intervals: {found.interval_method}")
    for split, parts in found.splits.items():
        header, rows = split_table(parts, found.matrix.trimmed())
        table = Table(title=f"by {split}")
        for heading in header:
            table.add_column(heading, justify="left" if heading == "part" else "right", overflow="fold")
        for row in rows[:MAX_PARTS]:
            table.add_row(*row)
        results().print(table)
        if len(rows) > MAX_PARTS:
            results().print(f"and {len(rows) - MAX_PARTS} more; --output and --format have all of them")
    if found.three is not None:
        header, rows = found.three.table()
        table = Table(title="three labellings")
        for heading in header:
            table.add_column(heading, justify="left" if heading == "class" else "right", overflow="fold")
        for row in rows:
            table.add_row(*row)
        results().print(table)
        for sentence in found.three.sentences():
            results().print(sentence)
    for gate in gates:
        name, limit, value = gate_cells(gate)
        results().print(f"{name}: found {value}, demanded {limit}: {'passed' if gate.passed else 'failed'}")
    results().print(match_line(found.match))
    for note in (*found.match.notes, *doubts(found)):
        results().print(note)
