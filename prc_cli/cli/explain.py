"""``prc explain``: why a shot has its class."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from prc_cli.cli.options import QUIET, Sectioned, config_from, stream_options
from prc_cli.cli.paths import ScanPath
from prc_cli.cli.report import compiling_note, line_progress, results
from prc_cli.core.errors import ConfigError
from prc_cli.jobs.explain import Explanation
from prc_cli.jobs.explain import explain as explain_shot


@click.command(cls=Sectioned)
@click.argument("source", metavar="IN", type=ScanPath())
@click.option(
    "--at", "place", required=True, metavar="LINE,COLUMN", help="The shot, both counted from 0."
)
@click.option(
    "--station", type=int, metavar="N", help="Scanner, or scan of the file.  [default: the first]"
)
@stream_options
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout.")
@QUIET
def explain(
    source: Path, place: str, station: int | None, as_json: bool, quiet: bool, **options: Any
) -> None:
    """Say why a shot of IN has its class.

    The rule that decided, its limits, and what the stages measured.

    IN is classified from its start to the block of the shot, as prc classify does, so that the
    class is the one that
    prc classify writes.

    \b
    Examples:
      prc explain drive.laz --at 1200,537
      prc explain drive.laz --at 1200,537 --preset urban --json
    """
    line, column = _place(place)
    loaded = config_from(options)
    with line_progress(source.name, quiet=quiet) as progress:
        found = explain_shot(
            source,
            line,
            column,
            loaded,
            scanner=station,
            progress=progress,
            loading=lambda: compiling_note(quiet=quiet),
        )
    if as_json:
        click.echo(json.dumps(found.as_dict(), indent=2))
    elif not quiet:
        _print(found)


def _place(text: str) -> tuple[int, int]:
    line, _, column = text.partition(",")
    if not (line.strip().isdecimal() and column.strip().isdecimal()):
        raise ConfigError(
            "--at", f"found {text!r}, expected LINE,COLUMN, both from 0, such as 1200,537"
        )
    return int(line), int(column)


def _print(found: Explanation) -> None:
    code = f"{found.label.name.lower()}, code {found.code}"
    results().print(
        f"{found.path}: line {found.line:,}, column {found.column:,}: {code}", soft_wrap=True
    )
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(overflow="fold")
    table.add_column(overflow="fold")
    table.add_row("because", f"{found.sentence} (reason {found.reason}, {found.rule})")
    for n, (key, value) in enumerate(found.limits.items()):
        table.add_row("" if n else "decided by", f"{key} = {value}")
    for name, value in found.measures.items():
        table.add_row(name, _told(value))
    results().print(table)
    facts = [f"record {found.record:,}" if found.record >= 0 else "no record"]
    facts += [] if found.range_m is None else [f"range {found.range_m:.3f} m"]
    facts += [] if found.time_s is None else [f"time {found.time_s:.6f} s"]
    facts += [] if found.beam_deg is None else [f"{found.beam_deg:.2f} deg from straight down"]
    facts += [f"scanner {found.scanner}"] if found.scanner else []
    results().print(", ".join(facts), soft_wrap=True)
    chosen = (
        "" if found.chosen is None else f" (--preset {found.chosen.preset}): {found.chosen.why}"
    )
    results().print(f"method: {found.method}{chosen}", soft_wrap=True)


def _told(value: Any) -> str:
    """Return a measured value for people."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return (
        "not known" if value is None else f"{value:.3f}" if isinstance(value, float) else str(value)
    )
