"""``prc info``: the contents of a file, and whether it can be classified."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from prc_cli.cli.next_step import given_words, output_for
from prc_cli.cli.options import config_from, output_options, stream_options
from prc_cli.cli.report import results, tally_rows
from prc_cli.cli.safe import printable
from prc_cli.cli.sections import Sectioned
from prc_cli.config import LoadedConfig, load_config
from prc_cli.core.errors import PrcError
from prc_cli.core.findings import LABEL_CHECKS, Finding, Verdict
from prc_cli.formats.contents import Contents
from prc_cli.formats.las.crs import short_crs
from prc_cli.jobs.draft import draft as write_draft
from prc_cli.jobs.info import Inspection, inspect


@click.command(cls=Sectioned)
@click.argument("files", nargs=-1, required=True, metavar="FILE...", type=click.Path(path_type=Path))
@click.option("--deep", is_flag=True, help="Decode every layer of LAZ, also those that no classifier needs.")
@stream_options
@click.option(
    "--draft",
    type=click.Path(path_type=Path),
    metavar="FILE.toml",
    help="Write a layout that reads FILE, from its header, its first records or the period of its bytes.",
)
@click.option("--overwrite", is_flag=True, help="Replace an existing draft.")
@output_options
def info(
    files: tuple[Path, ...], deep: bool, draft: Path | None, overwrite: bool, as_json: bool, quiet: bool,
    verbose: bool, **options: Any,
) -> None:  # fmt: skip
    """Say what FILE holds, what would be taken for granted, and whether it can be classified.

    The same options as for classify say how lines, columns and ranges are found.

    \b
    Example: prc info drive.laz --lines time:200 --columns time:1000000
    """
    loaded = config_from(options)
    if draft is not None:
        loaded = _drafted(files, draft, loaded, overwrite=overwrite)
        options = {**options, "config_file": draft}
    found: list[dict[str, Any]] = []
    code = 0
    for path in files:
        try:
            inspection = inspect(path, loaded, deep=deep)
        except PrcError as error:
            click.echo(f"error: {printable(str(error))}", err=True)
            found.append({"path": str(path), "error": str(error), "classifiable": False})
            code = max(code, error.exit_code)
            continue
        command = _command(inspection, options)
        found.append(inspection.as_dict() | {"command": command})
        if not as_json and not quiet:
            _print(inspection, command, verbose=verbose)
    if as_json:
        click.echo(json.dumps(found[0] if len(files) == 1 else found, indent=2))
    if code:
        raise SystemExit(code)


def _drafted(files: tuple[Path, ...], output: Path, loaded: LoadedConfig, *, overwrite: bool) -> LoadedConfig:
    """Write the draft of one file; return the configuration with it."""
    if len(files) != 1 or loaded.files:
        message = "--draft takes one file, and no --config or --layout"
        raise click.UsageError(message)
    write_draft(files[0], output, loaded, overwrite=overwrite)
    return load_config(output)


def _print(inspection: Inspection, command: str, *, verbose: bool) -> None:
    table = Table(title=inspection.path, show_header=False)
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    for key, value in _rows(inspection, verbose=verbose):
        table.add_row(key, value)
    results().print(table)
    if command:
        results().print(f"type: {printable(command)}", soft_wrap=True)


LISTED = ("bag", "packets")
"""Formats whose topics or scanners are always shown."""
ASPRS = {
    0: "never classified", 1: "unclassified", 2: "ground", 3: "low vegetation", 4: "medium vegetation",
    5: "high vegetation", 6: "building", 7: "low noise", 8: "model key point", 9: "water", 10: "rail",
    11: "road surface", 12: "overlap", 13: "wire guard", 14: "wire", 15: "tower", 16: "wire connector",
    17: "bridge deck", 18: "high noise", 19: "overhead structure", 20: "ignored ground", 21: "snow",
    22: "temporal exclusion",
}  # fmt: skip
"""Names of the standard codes (ASPRS, LAS 1.4 R15, table 17); codes from 64 on mean what the file's maker says."""
MOST_SHOWN = 12
"""Classes, returns and point sources that are printed; ``--json`` has them all."""


def _command(inspection: Inspection, options: dict[str, Any]) -> str:
    """Return the command that classifies the file: the options given, and those that mend what was found.

    Empty where no option is known that would do.
    """
    doubts = inspection.doubts
    mends = [one.option for one in doubts if one.option]
    if inspection.mend:
        mends = [inspection.mend]
    elif inspection.missing:
        mends = list(inspection.missing)
    elif inspection.problem:
        against = [one for one in doubts if one.verdict is Verdict.AGAINST]
        if not all(one.option for one in against) or inspection.problem not in {one.problem for one in against}:
            return ""
    path = Path(inspection.path)
    words = ["prc", "classify", str(path), str(output_for(path))]
    if inspection.choice is not None and not inspection.missing:  # with all of it another method may be chosen
        words += ["--preset", inspection.choice.preset]
    mended = {mend.partition(" ")[0] for mend in mends} - {"--set"}
    return shlex.join([*words, *given_words(options, mended)]) + "".join(f" {mend}" for mend in mends)


def _rows(inspection: Inspection, *, verbose: bool) -> list[tuple[str, str]]:
    rows = [("format", f"{inspection.format}, {inspection.size:,} bytes")]
    head = inspection.header
    if "point_format" in head:
        rows[0] = (rows[0][0], f"{rows[0][1]}, LAS {head['version']}, point format {head['point_format']}")
        rows.append(("CRS", short_crs(head["crs"]) if head.get("crs") else "none in the file"))
    if inspection.format in LISTED:
        rows.extend((key, str(value)) for key, value in head.items())
    if inspection.n_records is not None:
        rows.append(("records", f"{inspection.n_records:,}"))
    if inspection.dimensions:
        rows.append(("dimensions", ", ".join(inspection.dimensions)))
    if inspection.contents is not None:
        rows.extend(_contents_rows(inspection.contents))
    rows.extend(_stream_rows(inspection))
    if inspection.order is not None:
        rows.append(("time order", inspection.order.sentence()))
    rows.extend((f"taken: {item.key}", f"{item.value} ({item.why})") for item in inspection.assumptions)
    rows.extend(("note", note) for note in inspection.notes)
    if inspection.facts is not None:
        tally = tally_rows(inspection.facts.tally, everything=verbose)
        rows.extend((name, f"{count:,}") for name, count in tally)
    if verbose and inspection.header and inspection.format not in LISTED:
        rows.extend((f"header: {key}", str(value)) for key, value in inspection.header.items())
    rows.extend((f"check: {one.check}", _said(one)) for one in inspection.findings)
    if inspection.findings and not inspection.problem:
        if inspection.not_asked:
            rows.append(
                ("checks not asked", f"they need more lines, times or scan angles: {', '.join(inspection.not_asked)}")
            )
        rows.append(("checks of the labels", f"asked by prc classify, when they are there: {', '.join(LABEL_CHECKS)}"))
    hint = f"; {inspection.hint}" if inspection.hint else ""
    names = ", ".join(one.check for one in inspection.doubts)
    verdict = f"yes, but look at: {names}" if names else "yes, as it is"
    if inspection.problem:
        verdict = f"no: {inspection.problem}{hint}"
    name = {"prc": "PRC"}.get(inspection.method, inspection.method)
    rows.append((f"{name} can classify it", verdict))
    return rows


def _contents_rows(contents: Contents) -> Iterator[tuple[str, str]]:
    """Tell what the records hold, as surveyors know it from lasinfo."""
    if contents.bounds_m:
        spans = ", ".join(f"{axis} {low:,.2f} to {high:,.2f}" for axis, (low, high) in contents.bounds_m.items())
        where = {True: ": registered", False: ": may be relative to the scanner", None: ""}[contents.is_registered]
        yield "bounds", f"{spans} m{where}"
    if contents.time_s is not None:
        first, last = contents.time_s
        yield "times", f"{first:,.6f} to {last:,.6f} s: {last - first:,.3f} s"
    names = ASPRS | contents.class_names
    for name, counts in (
        ("classes", {f"{code} {names.get(code, '')}".strip(): n for code, n in sorted(contents.classes.items())}),
        ("returns", dict(sorted(contents.returns.items(), key=lambda item: [float(n) for n in item[0].split(" of ")]))),
        ("point sources", {str(code): n for code, n in sorted(contents.sources.items())}),
    ):
        if counts:
            shown = [f"{what}: {n:,}" for what, n in list(counts.items())[:MOST_SHOWN]]
            more = [f"and {len(counts) - MOST_SHOWN} more"] if len(counts) > MOST_SHOWN else []
            yield name, ", ".join(shown + more)


def _said(finding: Finding) -> str:
    """Return a finding as a cell of the table."""
    verdict = "accepted" if finding.is_accepted else finding.verdict.name.lower()
    if finding.verdict is Verdict.FINE:
        return f"{verdict}: {finding.problem}"
    return f"{verdict}: {finding.problem}; {finding.hint}"


def _stream_rows(inspection: Inspection) -> list[tuple[str, str]]:
    rows = []
    facts, period = inspection.facts, inspection.period
    if facts is not None:
        rows.append(("scan lines", f"{facts.n_lines:,} of {inspection.points_per_line:,} shots"))
        if len(facts.scanners) > 1:
            rows.append(("scanners", ", ".join(map(str, facts.scanners))))
        rows.append(
            ("missing", f"{facts.n_missing:,} of {facts.n_shots:,} shots ({_share(facts.n_missing, facts.n_shots)})")
        )
        if facts.line_hz is not None:
            rows.append(("line frequency", f"{facts.line_hz:.6g} Hz"))
        if facts.range_m is not None:
            low, median, high = facts.range_m
            rows.append(("ranges", f"{low:.3f} to {high:.3f} m, median {median:.3f} m"))
        if facts.correlation is not None:
            rows.append(("spatial correlation", facts.correlation.verdict))
    if period is not None:
        estimate = "none" if period.points_per_line is None else f"{period.points_per_line:,}"
        rows.append(("M estimated", f"{estimate} ({period.reason})"))
    if inspection.rates is not None:
        rates = inspection.rates
        rows.append(("shots a second", f"{rates.shot_hz:.8g}, from the times ({rates.share:.0%} return)"))
        rows.append(("lines a second", f"{rates.line_hz:.6g}, of M = {rates.points_per_line:,} shots"))
        rows.append(("a line begins", f"{rates.time_origin_s!r} s, in the middle of what rarely returns"))
    return rows


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.1%}" if whole else "-"
