"""``prc doctor``: checks the installation and, optionally, an output folder."""

from __future__ import annotations

import json
from pathlib import Path

import click

from prc_cli.cli.paths import WRITTEN
from prc_cli.cli.report import console, results
from prc_cli.core.errors import ExitCode, printable


@click.command()
@click.option(
    "--out",
    type=WRITTEN,
    metavar="FOLDER",
    help="Also ask a folder for outputs for what prc batch needs of it.",
)
@click.option(
    "--no-run", is_flag=True, help="Without the small runs from end to end and by both engines."
)
@click.option("--json", "as_json", is_flag=True, help="Print the checks as JSON on stdout.")
@click.option("-q", "--quiet", is_flag=True, help="Print only what is not as it should be.")
def doctor(
    out: Path | None,
    no_run: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Check the installation: packages, LAZ, compiled loops, memory, disks, and a small run from end to end.

    The compiled loops must give the same labels as --engine reference of prc classify.

    Every check is ok, warn (slower, or not for everything) or bad, and says what to do. Exit code 1
    if one is bad.

    \b
    Examples:
      prc doctor
      prc doctor --out /archive/classified
      prc doctor --json --no-run
    """
    from prc_cli.jobs.doctor import examine

    found = []
    width = 0
    for check in examine(out, run=not no_run):
        found.append(check)
        if as_json or (quiet and check.status == "ok"):
            continue
        width = max(width, len(check.name), 16)
        console_text = (
            f"{check.status:<4}  {printable(check.name):<{width}}  {printable(check.found)}"
        )
        results().print(console_text, soft_wrap=True)
        if check.hint:
            results().print(f"      {'':<{width}}  -> {printable(check.hint)}", soft_wrap=True)
    counts = {
        status: sum(check.status == status for check in found) for status in ("ok", "warn", "bad")
    }
    if as_json:
        checks = [
            {
                "name": c.name,
                "status": c.status,
                "found": c.found,
                "hint": c.hint,
                "details": dict(c.details),
            }
            for c in found
        ]
        click.echo(json.dumps({"counts": counts, "checks": checks}, indent=2))
    elif not quiet:
        console().print(f"{counts['ok']} ok, {counts['warn']} to know, {counts['bad']} bad")
    if counts["bad"]:
        click.get_current_context().exit(ExitCode.FAILED)
