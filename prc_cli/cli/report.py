"""Tables and progress bars, on stderr; results for machines go to stdout elsewhere."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import cache
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from prc_cli.cli.safe import printable, printable_lines
from prc_cli.core.classes import ClassCodes, Label

if TYPE_CHECKING:
    from prc_cli.core.stream import Assumption, ReadTally
    from prc_cli.jobs.classify import Progress, RunSummary


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
