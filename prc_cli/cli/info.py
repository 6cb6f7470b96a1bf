"""``prc info``: whether a file can be classified, the command to type, and its contents."""

from __future__ import annotations

import math
import re
import shlex
import shutil
import textwrap
from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import click

from prc_cli.cli.next_step import output_for, typed
from prc_cli.cli.options import Sectioned, config_from, given_words, output_options, stream_options
from prc_cli.cli.output import print_json, print_result, print_text
from prc_cli.cli.paths import WRITTEN, ScanPath
from prc_cli.cli.report import print_doubts
from prc_cli.config import LoadedConfig
from prc_cli.core.errors import ExitCode, InputError, PrcError, printable
from prc_cli.core.findings import LABEL_CHECKS, Finding, Verdict
from prc_cli.formats.las.vlrs import short_crs
from prc_cli.formats.records import Contents
from prc_cli.jobs.info import Inspection, inspect
from prc_cli.jobs.path import prepare_path, save_path, sentence
from prc_cli.streams.evidence.table import check_table


@click.command(cls=Sectioned)
@click.argument("files", nargs=-1, required=True, metavar="FILE...", type=ScanPath())
@click.option(
    "--deep", is_flag=True, help="Decode all layers of LAZ, also those that no method needs."
)
@stream_options
@click.option(
    "--path",
    "path_output",
    type=WRITTEN,
    metavar="OUTPUT",
    help="Write the path of the scanner that --range points computes: .csv with uncertainties, "
    ".sbet, .out.",
)
@click.option(
    "--check-path",
    is_flag=True,
    help="Compare --range trajectory:FILE with the path computed from the points: clock, "
    "lever arm, "
    "coordinates.",
)
@click.option("--overwrite", is_flag=True, help="Replace an existing path.")
@click.option("--checks", is_flag=True, help="List every check with its result and its limit.")
@output_options
def info(
    files: tuple[Path, ...],
    deep: bool,
    path_output: Path | None,
    check_path: bool,
    overwrite: bool,
    checks: bool,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    **options: Any,
) -> None:
    """Check whether FILE can be classified, print the command to type, and describe FILE.

    The options for lines, columns and ranges are the same as for prc classify. --verbose prints
    everything. If FILE can be read, the exit code is 0 also if the answer is no: scripts read
    "classifiable" of --json.

    If several files continue each other, prc prints one command for all of them.

    \b
    Examples:
      prc info drive.laz
      prc info drive.laz --lines time:200 --columns time:1000000
      prc info tile.laz --range points --path path.csv
      prc info drive_01.laz drive_02.laz drive_03.laz
    """
    loaded = config_from(options)
    if path_output is not None:
        _prepare_path(files, path_output, loaded, is_checked=check_path, overwrite=overwrite)
    is_drive = len(files) > 1 and _is_one_recording(files, loaded)
    needed: list[str | None] = []
    reports: list[dict[str, Any]] = []
    code = ExitCode.DONE
    for path in files:
        written: tuple[Path, ...] = ()
        try:
            inspection = inspect(path, loaded, deep=deep, checks_path=check_path)
            if path_output is not None:
                written, doubted = _written_path(
                    inspection, path_output, loaded, overwrite=overwrite
                )
                code = max(code, print_doubts(doubted))
        except PrcError as error:
            click.echo(error.message(), err=True)
            reports.append({"path": str(path), "error": str(error), "classifiable": False})
            needed.append(None)
            code = max(code, error.exit_code)
            continue
        needed.append(_needed_options(inspection, options))
        command = _command(path, needed[-1])
        files_written = {"written": [str(name) for name in written]} if written else {}
        reports.append(inspection.as_dict() | {"command": command} | files_written)
        if not as_json and not quiet:
            _print(inspection, "" if is_drive else command, checks=checks, verbose=verbose)
            for name in written:
                print_result(f"{name}: path of the scanner")
    if is_drive:
        command = _drive_command(files, needed)
        reports = [report | {"drive_command": command} for report in reports]
        if not as_json and not quiet:
            _print_drive(files, needed, command)
    if as_json:
        print_json(reports[0] if len(files) == 1 else reports)
    if code:
        raise SystemExit(code)


def _prepare_path(
    files: tuple[Path, ...],
    output: Path,
    loaded: LoadedConfig,
    *,
    is_checked: bool,
    overwrite: bool,
) -> None:
    if len(files) != 1:
        message = "--path works with one file"
        raise click.UsageError(message)
    if not is_checked and loaded.config.input.range != "points":
        message = "--path needs --range points, or --check-path with --range trajectory:FILE"
        raise click.UsageError(message)
    prepare_path(output, loaded, files[0], overwrite=overwrite)


def _written_path(
    inspection: Inspection,
    output: Path,
    loaded: LoadedConfig,
    *,
    overwrite: bool,
) -> tuple[tuple[Path, ...], tuple[Finding, ...]]:
    if inspection.drive is None:
        raise InputError(
            inspection.path, inspection.problem or "no path was found", inspection.hint
        )
    return save_path(output, inspection.drive, loaded, Path(inspection.path), overwrite=overwrite)


def _print(
    inspection: Inspection,
    command: str,
    *,
    checks: bool,
    verbose: bool,
) -> None:
    """Print whether a file can be classified, what to type, warnings, facts and checks."""
    warnings = [finding for finding in inspection.doubts if finding.problem != inspection.problem]
    print_result(f"{inspection.path}: {_verdict(inspection, warnings)}")
    if inspection.problem and inspection.hint:
        print_result(f"what to do: {inspection.hint}")
    if command:
        print_result(f"type: {command}")
    for finding in warnings:
        print_result(f"warning: {finding.sentence()}")
    rows = [*_rows(inspection, verbose=verbose), *_check_rows(inspection, listed=checks or verbose)]
    wide = min(max(len(name) for name, _ in rows), MOST_NAME) + 2
    width = max(shutil.get_terminal_size((100, 24)).columns, wide + LEAST_WIDTH)
    for name, value in rows:
        head = f"{name:{wide - 2}}  "
        text = textwrap.fill(printable(head + value), width, subsequent_indent=" " * wide)
        print_text(text)


def _verdict(inspection: Inspection, warnings: Sequence[Finding]) -> str:
    if inspection.problem:
        return f"{'not yet' if inspection.missing else 'no'}: {inspection.problem}"
    method = {"prc": "PRC"}.get(inspection.method, inspection.method)
    if warnings:
        names = ", ".join(finding.check for finding in warnings)
        return f"yes, {method} can classify it, with a warning: {names}"
    return f"yes, {method} can classify it"


LISTED = ("bag", "packets")
"""Formats whose topics or scanners are always shown."""
ASPRS = {
    0: "never classified",
    1: "unclassified",
    2: "ground",
    3: "low vegetation",
    4: "medium vegetation",
    5: "high vegetation",
    6: "building",
    7: "low noise",
    8: "model key point",
    9: "water",
    10: "rail",
    11: "road surface",
    12: "overlap",
    13: "wire guard",
    14: "wire",
    15: "tower",
    16: "wire connector",
    17: "bridge deck",
    18: "high noise",
    19: "overhead structure",
    20: "ignored ground",
    21: "snow",
    22: "temporal exclusion",
}
"""Names of the standard codes (ASPRS, LAS 1.4 R15, table 17).

Codes from 64 on mean what the file's maker says.
"""
MOST_SHOWN = 8
"""Classes, returns and point sources that are printed.

``--verbose`` and ``--json`` have them all.
"""
FLAGS = (
    "synthetic",
    "key_point",
    "withheld",
    "overlap",
    "scan_direction_flag",
    "edge_of_flight_line",
)
"""Dimensions of every LAS file that say nothing about the scan."""
SAID_BEFORE = ("method", "input.points_per_line")
"""Assumptions that the verdict and the scan lines state already."""
MOST_NAME = 24
LEAST_WIDTH = 40
"""Width of the names of facts at most, and of the facts at least [characters]."""
LIST_THEM = " (--checks lists them)"
VERDICTS = {Verdict.FINE: "fine", Verdict.DOUBTFUL: "warning", Verdict.AGAINST: "refused"}
"""Words for the results of checks."""


def _needed_options(inspection: Inspection, options: dict[str, Any]) -> str | None:
    """Return all options that the file needs to be classified; None = no options help."""
    doubts = inspection.doubts
    mends = [inspection.mend] if inspection.mend else list(inspection.missing)
    if not mends and inspection.problem:
        against = [finding for finding in doubts if finding.verdict is Verdict.AGAINST]
        if not all(finding.option for finding in against) or inspection.problem not in {
            finding.problem for finding in against
        }:
            return None
    mends = mends or list(dict.fromkeys(finding.option for finding in doubts if finding.option))
    mended = {mend.partition(" ")[0] for mend in mends} - {"--set"}
    words = [shlex.join(given_words(options, mended)), *mends]
    return "".join(f" {word}" for word in words if word)


def _command(path: Path, needed: str | None) -> str:
    """Return the command that classifies a file; empty if there is none."""
    if needed is None:
        return ""
    return shlex.join(["prc", "classify", typed(path), typed(output_for(path))]) + needed


def _is_one_recording(files: Sequence[Path], loaded: LoadedConfig) -> bool:
    from prc_cli.jobs.drive import is_one_recording  # few need it

    return is_one_recording(files, loaded)


def _drive_command(files: Sequence[Path], needed: Sequence[str | None]) -> str:
    """Return the command that classifies files as one drive; empty if their options differ."""
    # a drive has the origin of its first file
    alike = {
        None if words is None else re.sub(r" --set input\.time_origin=\S+", "", words)
        for words in needed
    }
    is_same_name = len({path.name for path in files}) < len(files)
    if len(alike) > 1 or needed[0] is None or is_same_name:
        return ""
    output = typed(files[0].with_name("classified"))
    return shlex.join(["prc", "classify", *map(typed, files), f"{output}/"]) + needed[0]


def _print_drive(files: Sequence[Path], needed: Sequence[str | None], command: str) -> None:
    """Print what to type for files that continue each other."""
    print_result(f"the {len(files)} files continue each other: they are one drive")
    commands = [command] if command else map(_command, files, needed)
    for line in filter(None, commands):
        print_result(f"type: {line}")


def _rows(inspection: Inspection, *, verbose: bool) -> Iterator[tuple[str, str]]:
    head = inspection.header
    las = ""
    if "point_format" in head:
        las = f", LAS {head['version']}, point format {head['point_format']}, "
        las += f"CRS {short_crs(head['crs'])}" if head.get("crs") else "no CRS"
    counted = "" if inspection.n_records is None else f", {inspection.n_records:,} records"
    yield "format", f"{inspection.format}, {inspection.size:,} bytes{counted}{las}"
    if inspection.format in LISTED:
        yield from ((key, str(value)) for key, value in head.items())
    if shown := [name for name in inspection.dimensions if verbose or name not in FLAGS]:
        yield "dimensions", ", ".join(shown)
    if inspection.contents is not None:
        yield from _contents_rows(inspection.contents, verbose=verbose)
    if inspection.order is not None and inspection.order.sentence() not in inspection.problem:
        yield "time order", inspection.order.sentence()
    yield from _stream_rows(inspection, verbose=verbose)
    yield from _path_rows(inspection, verbose=verbose)
    hidden = () if verbose else SAID_BEFORE
    assumptions = [item for item in inspection.assumptions if item.key not in hidden]
    for why, alike in groupby(assumptions, lambda item: item.why):
        values = (f"{item.key.removeprefix('input.')} {item.value}" for item in alike)
        yield "used", f"{', '.join(values)} ({why})"
    yield from (("note", note) for note in inspection.notes)
    if inspection.facts is not None:
        for name, count in inspection.facts.tally.counts(everything=verbose):
            yield name, f"{count:,}"
    if verbose and inspection.format not in LISTED:
        yield from ((f"header: {key}", str(value)) for key, value in head.items())


def _path_rows(inspection: Inspection, *, verbose: bool) -> Iterator[tuple[str, str]]:
    drive = inspection.drive
    if drive is None:
        return
    for number, figures in enumerate(drive.figures if verbose else drive.figures[:MOST_SHOWN]):
        name = f"pass {number}" if len(drive.figures) > 1 else "path"
        head = f"scanner {figures.scanner}, " if drive.n_scanners > 1 else ""
        height = (
            "" if math.isnan(figures.height_m) else f", {figures.height_m:.2f} m above the ground"
        )
        yield (
            name,
            f"{head}{figures.length_m:.1f} m in {figures.duration_s:.1f} s, "
            f"{figures.speed_m_s:.2f} m/s (median){height}",
        )
        turns = "" if figures.turns_hz == figures.lines_hz else f"{figures.turns_hz:.6g} turns and "
        rates = (
            f"{turns}{figures.lines_hz:.6g} lines a second, {figures.shots_hz:,.0f} shots a second"
        )
        yield (
            "rotation",
            f"{rates}, M = {figures.points_per_line:,}; the scan plane leans by "
            f"{figures.tilt_deg:.1f} deg",
        )
        fit = f"points are {1e3 * figures.residual_m:.1f} mm from their beams (median)"
        fit += f", {figures.share_on_beam:.0%} are on a beam"
        certain = f"standard deviation of the path {1e3 * figures.sigma_m:.1f} mm (median)"
        bridged = f"{figures.share_bridged:.0%} of the lines are interpolated"
        yield (
            "fit",
            f"{fit}; {certain}, {bridged}; {figures.share_holes:.1%} of the cells on surfaces are "
            "empty",
        )
    left = len(drive.figures) - MOST_SHOWN
    if left > 0 and not verbose:
        yield "passes", f"and {left} more"
    if drive.n_unplaced:
        yield "no path", f"prc found no path for {drive.n_unplaced:,} points"
    for comparison in inspection.comparisons:
        head = f"scanner {comparison.scanner}: " if len(inspection.comparisons) > 1 else ""
        yield "trajectory", head + sentence(comparison)


def _check_rows(inspection: Inspection, *, listed: bool) -> Iterator[tuple[str, str]]:
    findings = {finding.check: finding for finding in inspection.findings}
    if not listed:
        fine = sum(finding.verdict is Verdict.FINE for finding in findings.values())
        accepted = [finding.check for finding in findings.values() if finding.is_accepted]
        if findings:
            yield (
                "checks",
                f"{fine} fine"
                + (f", accepted: {', '.join(accepted)}" if accepted else "")
                + LIST_THEM,
            )
        return
    for check in check_table():
        finding = findings.get(check.name)
        if finding is None:
            when = "not for this file"
            if check.name in LABEL_CHECKS:
                when = "after prc classify"
            yield f"check: {check.name}", f"{when}. {check.limit}"
            continue
        verdict = "accepted" if finding.is_accepted else VERDICTS[finding.verdict]
        hint = f"; {finding.hint}" if finding.hint and finding.verdict is not Verdict.FINE else ""
        yield f"check: {finding.check}", f"{verdict}: {finding.problem}{hint}"


def _contents_rows(contents: Contents, *, verbose: bool) -> Iterator[tuple[str, str]]:
    if contents.bounds_m:
        spans = ", ".join(
            f"{axis} {low:,.2f} to {high:,.2f}" for axis, (low, high) in contents.bounds_m.items()
        )
        frames = {True: ": registered", False: ": may be relative to the scanner", None: ""}
        yield "bounds", f"{spans} m{frames[contents.is_registered]}"
    if contents.time_s is not None:
        first, last = contents.time_s
        yield "times", f"{first:,.6f} to {last:,.6f} s: {last - first:,.3f} s"
    names = ASPRS | contents.class_names
    classes = [
        f"{code} {names.get(code, '')}".strip() + f": {n:,}"
        for code, n in sorted(contents.classes.items())
    ]
    if classes:
        yield "classes", _first_of(classes, verbose=verbose)
    # one return a shot, and one source, are what everybody expects
    by_number = sorted(contents.returns, key=lambda name: [float(n) for n in name.split(" of ")])
    returns = [f"{name}: {contents.returns[name]:,}" for name in by_number]
    if returns and (verbose or len(returns) > 1):
        yield "returns", _first_of(returns, verbose=verbose)
    sources = [f"{code}: {n:,}" for code, n in sorted(contents.sources.items())]
    if sources and (verbose or len(sources) > 1):
        yield "point sources", _first_of(sources, verbose=verbose)


def _first_of(words: Sequence[str], *, verbose: bool) -> str:
    shown = list(words)
    if not verbose and len(words) > MOST_SHOWN:
        shown = [*words[:MOST_SHOWN], f"and {len(words) - MOST_SHOWN} more"]
    return ", ".join(shown)


def _stream_rows(inspection: Inspection, *, verbose: bool) -> Iterator[tuple[str, str]]:
    facts = inspection.facts
    period = inspection.period
    rates = inspection.rates
    if facts is not None:
        rate = "" if facts.line_hz is None else f", {facts.line_hz:.6g} lines a second"
        share = f"{facts.n_missing / facts.n_shots:.1%}" if facts.n_shots else "-"
        missing = f"{facts.n_missing:,} of {facts.n_shots:,} missing ({share})"
        yield (
            "scan lines",
            f"{facts.n_lines:,} of {inspection.points_per_line:,} shots{rate}; {missing}",
        )
        if len(facts.scanners) > 1:
            yield "scanners", ", ".join(map(str, facts.scanners))
        if facts.range_m is not None:
            low, median, high = facts.range_m
            yield "ranges", f"{low:.3f} to {high:.3f} m, median {median:.3f} m"
        if facts.correlation is not None and verbose:
            yield "spatial correlation", facts.correlation.verdict
    # if M is known, the check line-length tests it
    if period is not None and (verbose or facts is None):
        estimate = "none" if period.points_per_line is None else f"{period.points_per_line:,}"
        is_used = facts is None or period.points_per_line == inspection.points_per_line
        used = "" if is_used else f"; not used: the lines have {inspection.points_per_line:,} shots"
        yield "M estimated", f"{estimate} ({period.reason}){used}"
    # if lines were given, a note says which rates differ
    if rates is not None and (verbose or facts is None):
        measured = f"{rates.shot_hz:.8g} shots and {rates.line_hz:.6g} lines a second"
        text = f"{measured}, M = {rates.points_per_line:,}, from the times"
        if verbose:
            text += f"; {rates.share:.0%} of the shots return"
            text += "; scan lines start where the scanner points into the sky"
        yield "rates", text
