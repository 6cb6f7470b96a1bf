"""``prc explain``: why a shot has its class."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from prc_cli.cli.options import QUIET, Sectioned, config_from, stream_options
from prc_cli.cli.output import print_facts, print_json, print_result
from prc_cli.cli.paths import ScanPath
from prc_cli.cli.report import compiling_note, line_progress, short_reason
from prc_cli.core.errors import ConfigError
from prc_cli.jobs.explain import Explanation
from prc_cli.jobs.explain import explain as explain_shot


@click.command(cls=Sectioned)
@click.argument("source", metavar="IN", type=ScanPath())
@click.option(
    "--at",
    "place",
    required=True,
    metavar="LINE,COLUMN",
    help="Line and column of the shot, counted from 0.",
)
@click.option(
    "--station",
    type=int,
    metavar="N",
    help="Number of the scanner or of the scan.  [default: the first]",
)
@stream_options
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on stdout.")
@QUIET
def explain(
    source: Path, place: str, station: int | None, as_json: bool, quiet: bool, **options: Any
) -> None:
    """Explain why a shot of IN has its class.

    prc prints the rule that gave the class, the limits of the rule and the measured values. It
    classifies IN from the start to this shot, so the class is the one that prc classify writes.

    \b
    Examples:
      prc explain drive.laz --at 1200,537
      prc explain drive.laz --at 1200,537 --json
    """
    line, column = _place(place)
    loaded = config_from(options)
    with line_progress(source.name, quiet=quiet) as progress:
        explanation = explain_shot(
            source,
            line,
            column,
            loaded,
            scanner=station,
            progress=progress,
            loading=lambda: compiling_note(quiet=quiet),
        )
    if as_json:
        print_json(explanation.as_dict())
    elif not quiet:
        _print(explanation)


def _place(text: str) -> tuple[int, int]:
    line, _, column = text.partition(",")
    if not (line.strip().isdecimal() and column.strip().isdecimal()):
        raise ConfigError(
            "--at", f"found {text!r}, expected LINE,COLUMN, counted from 0, such as 1200,537"
        )
    return int(line), int(column)


def _print(explanation: Explanation) -> None:
    code = f"{explanation.label.name.lower()}, code {explanation.code}"
    place = f"line {explanation.line:,}, column {explanation.column:,}"
    print_result(f"{explanation.path}: {place}: {code}")
    rule = f"reason {explanation.reason}, {explanation.rule}"
    rows = [("because", f"{explanation.sentence} ({rule})")]
    for n, (key, value) in enumerate(explanation.limits.items()):
        rows.append(("" if n else "limits", f"{key} = {value}"))
    for name, value in explanation.measures.items():
        rows.append((name, _readable(value)))
    print_facts(rows)
    facts = [f"record {explanation.record:,}" if explanation.record >= 0 else "no record"]
    if explanation.range_m is not None:
        facts.append(f"range {explanation.range_m:.3f} m")
    if explanation.time_s is not None:
        facts.append(f"time {explanation.time_s:.6f} s")
    if explanation.beam_deg is not None:
        facts.append(f"{explanation.beam_deg:.2f} deg from straight down")
    if explanation.scanner:
        facts.append(f"scanner {explanation.scanner}")
    print_result(", ".join(facts))
    chosen = ""
    if explanation.chosen is not None:
        chosen = f" (--preset {explanation.chosen.preset}): {short_reason(explanation.chosen.why)}"
    print_result(f"method: {explanation.method}{chosen}")


def _readable(value: Any) -> str:
    if value is None:
        return "not known"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.3f}" if isinstance(value, float) else str(value)
