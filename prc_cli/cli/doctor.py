"""``prc doctor``: checks the installation and, optionally, an output folder."""

from __future__ import annotations

from pathlib import Path

import click

from prc_cli.cli.output import print_json, print_line, print_result
from prc_cli.cli.paths import WRITTEN
from prc_cli.core.errors import ExitCode


@click.command()
@click.argument("out", metavar="[FOLDER]", type=WRITTEN, required=False)
@click.option("--no-run", is_flag=True, help="Skip the two small test runs.")
@click.option("--json", "as_json", is_flag=True, help="Print the checks as JSON on stdout.")
@click.option("-q", "--quiet", is_flag=True, help="Print only warnings and faults.")
def doctor(
    out: Path | None,
    no_run: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Check the installation: packages, LAZ, compiled loops, memory and disks.

    Then prc classifies a small simulated street, and compares the compiled loops with prc classify
    --engine reference.

    If you name a FOLDER, prc also checks it for the outputs of prc batch.

    Each check prints ok, warn or bad, and what to do. warn: prc works, but slowly or not with every
    file. If a check is bad, the exit code is 1.

    \b
    Examples:
      prc doctor
      prc doctor /archive/classified
      prc doctor --json --no-run
    """
    from prc_cli.jobs.doctor import examine

    done = []
    width = 0
    for check in examine(out, run=not no_run):
        done.append(check)
        if as_json or (quiet and check.status == "ok"):
            continue
        width = max(width, len(check.name), 16)
        print_result(f"{check.status:<4}  {check.name:<{width}}  {check.text}")
        if check.hint:
            print_result(f"      {'':<{width}}  -> {check.hint}")
    counts = {
        status: sum(check.status == status for check in done) for status in ("ok", "warn", "bad")
    }
    if as_json:
        checks = [
            {
                "name": c.name,
                "status": c.status,
                "found": c.text,
                "hint": c.hint,
                "details": dict(c.details),
            }
            for c in done
        ]
        print_json({"counts": counts, "checks": checks})
    elif not quiet:
        print_line(f"{counts['ok']} ok, {counts['warn']} warn, {counts['bad']} bad")
    if counts["bad"]:
        click.get_current_context().exit(ExitCode.FAILED)
