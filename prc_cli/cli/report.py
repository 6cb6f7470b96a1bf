"""Tables and progress bars, on stderr; results for machines go to stdout elsewhere."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import cache
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from prc_cli.cli.safe import printable, printable_lines
from prc_cli.core.classes import ClassCodes, Label
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
from prc_cli.evaluation.scores import CLASS_SCORES, scores

if TYPE_CHECKING:
    from prc_cli.core.stream import Assumption, ReadTally
    from prc_cli.evaluation.confusion import ConfusionMatrix
    from prc_cli.evaluation.gates import GateResult
    from prc_cli.evaluation.result import Evaluation, Interval
    from prc_cli.evaluation.scores import Scores
    from prc_cli.pipeline import Progress, RunSummary

MAX_PARTS = 40
"""Parts of a split that are shown on a terminal."""


class SafeConsole(Console):
    """A console whose terminal obeys nobody else: names in files, and of files, may hold control characters."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Take what is to be printed; cells, headings and titles of tables come this way too."""
        return super().render_str(printable_lines(text), **options)


@cache
def console() -> Console:
    """Return the console on stderr; stdout is kept for results."""
    return SafeConsole(stderr=True, markup=False, highlight=False, emoji=False)


@cache
def results() -> Console:
    """Return the console on stdout, for the tables that are the result of a command."""
    # a pipe or a file gets the whole table, not one cut to 80 columns
    return SafeConsole(width=None if sys.stdout.isatty() else 160, markup=False, highlight=False, emoji=False)


COMPILING_S = 2.0
"""Loading compiled loops takes less than this from the cache [s]."""


@contextlib.contextmanager
def compiling_note(*, quiet: bool, what: str = "classifier") -> Iterator[None]:
    """Say why nothing happens yet when loading the classifier, or the simulator, takes long."""
    text = f"loading the {what}; after installation it is compiled, once, which takes up to a minute"
    timer = threading.Timer(COMPILING_S, lambda: console().print(text, soft_wrap=True))
    timer.daemon = True
    if not quiet:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()


@contextlib.contextmanager
def line_progress(name: str, *, quiet: bool) -> Iterator[Progress | None]:
    """Show a progress bar of scan lines on a terminal; nothing elsewhere."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from tqdm import tqdm

    with tqdm(desc=printable(name), unit=" lines", unit_scale=True, leave=False) as bar:
        yield bar.update


def print_classes(summary: RunSummary) -> None:
    """Print how many records of the run have which class."""
    table = Table(title=f"{summary.record.input.name}: classes")
    for heading in ("class", "code", "shots", "share"):
        table.add_column(heading, justify="left" if heading == "class" else "right")
    codes = ClassCodes.model_validate(summary.record.config["classes"])
    counts = summary.counts.labels.tolist()
    returned = sum(counts) - counts[Label.MISSING]
    for label in Label:
        if counts[label]:
            share = "" if label is Label.MISSING else f"{counts[label] / returned:.1%}"
            table.add_row(label.name.lower(), str(codes.code(label)), f"{counts[label]:,}", share)
    console().print(table)


def print_evaluation(matrix: ConfusionMatrix, found: Scores, intervals: Mapping[str, Interval] = NO_INTERVALS) -> None:
    """Print a confusion matrix with row shares, and the scores, on stdout."""
    shown = matrix.trimmed()
    table = Table(title="reference in rows, predicted in columns: records (share of the row)")
    table.add_column("reference")
    for name in shown.predicted_names:
        table.add_column(name, justify="right")
    for name, counts, shares in zip(shown.reference_names, shown.counts, shown.row_shares(), strict=True):
        cells = (f"{count:,} ({percent(share)})" for count, share in zip(counts, shares, strict=True))
        table.add_row(name, *cells)
    results().print(table)
    table = Table(title="scores")
    table.add_column("class")
    for score in CLASS_SCORES:
        table.add_column(score, justify="right")
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
            table.add_column(heading, justify="left" if heading == "part" else "right")
        for row in rows[:MAX_PARTS]:
            table.add_row(*row)
        results().print(table)
        if len(rows) > MAX_PARTS:
            results().print(f"and {len(rows) - MAX_PARTS} more; --output and --format have all of them")
    for gate in gates:
        name, limit, value = gate_cells(gate)
        results().print(f"{name}: found {value}, demanded {limit}: {'passed' if gate.passed else 'failed'}")
    results().print(match_line(found.match))
    for note in (*found.match.notes, *doubts(found)):
        results().print(note)


def print_assumptions(assumptions: Sequence[Assumption], tally: ReadTally) -> None:
    """Print what the reader took for granted and what it met."""
    if assumptions:
        table = Table(title="taken for granted")
        for heading in ("key", "value", "why"):
            table.add_column(heading)
        for item in assumptions:
            table.add_row(item.key, item.value, item.why)
        console().print(table)
    for name, count in tally_rows(tally):
        console().print(f"{name}: {count:,} records")


def tally_rows(tally: ReadTally, *, everything: bool = False) -> Iterator[tuple[str, int]]:
    """Yield what a reader met, in words; what it did not meet only if ``everything`` is asked for."""
    for name, count in asdict(tally).items():
        # the number of records is told elsewhere
        if name != "n_records" and (count or everything):
            yield name.removeprefix("n_").replace("_", " "), count
