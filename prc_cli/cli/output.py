"""Results on stdout as JSON, CSV or tables, and lines on stderr."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import Any

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from prc_cli.core.errors import printable, printable_lines


class SafeConsole(Console):
    """A console that escapes control characters, which names of files and in files may contain."""

    def render_str(self, text: str, **options: Any) -> Text:
        """Escape text to print; rich also calls this for cells, headings and titles of tables."""
        return super().render_str(printable_lines(text), **options)


@cache
def console() -> Console:
    """Return the console on stderr; stdout is kept for results."""
    return SafeConsole(stderr=True, markup=False, highlight=False, emoji=False)


@cache
def results() -> Console:
    """Return the console on stdout, for tables that are the result of a command."""
    # in a pipe or a file rich would cut tables at 80 columns
    is_known = sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdigit()
    return SafeConsole(width=None if is_known else 160, markup=False, highlight=False, emoji=False)


def print_json(value: Any, **form: Any) -> None:
    """Print a result as JSON on stdout; ``form`` goes to :func:`json.dumps`."""
    click.echo(json.dumps(value, **{"indent": 2, **form}))


def print_event(values: Mapping[str, Any]) -> None:
    """Print a line of JSON on stderr, for commands whose stdout is data."""
    click.echo(json.dumps(values, sort_keys=True), err=True)


def print_csv_row(values: Iterable[Any]) -> None:
    """Print a row on stdout; None becomes an empty cell."""
    click.echo(",".join("" if value is None else str(value) for value in values))


def print_text(text: str) -> None:
    """Print a finished text on stdout: CSV, Markdown, TOML, a page."""
    click.echo(printable_lines(text.rstrip("\n")))


def table_of(
    title: str, *headings: str, rows: Iterable[Sequence[str]] = (), n_words: int = 1, **column: Any
) -> Table:
    """Return a table with ``n_words`` columns of words, then columns of numbers."""
    table = Table(title=title)
    column.setdefault("overflow", "fold")
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="left" if i < n_words else "right", **column)
    for row in rows:
        table.add_row(*row)
    return table


def print_table(
    title: str, headings: Sequence[str], rows: Iterable[Sequence[str]], *, n_words: int = 1
) -> None:
    """Print a table on stdout, as :func:`table_of` makes it; empty headings are not shown."""
    table = table_of(title, *headings, rows=rows, n_words=n_words)
    table.show_header = any(headings)
    results().print(table)


def print_facts(rows: Iterable[tuple[str, str]]) -> None:
    """Print names and values on stdout, without a frame."""
    table = Table(show_header=False, box=None, pad_edge=False)
    for _ in range(2):
        table.add_column(overflow="fold")
    for row in rows:
        table.add_row(*row)
    results().print(table)


def print_result(text: str) -> None:
    """Print a line on stdout, however long."""
    click.echo(printable(text))


def print_line(text: str) -> None:
    """Print a line on stderr, however long."""
    console().print(text, soft_wrap=True)
