"""``prc info``: the contents of a file, and whether it can be classified."""

from __future__ import annotations

import json
import math
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
from prc_cli.cli.paths import WRITTEN, ScanPath
from prc_cli.cli.report import print_doubts
from prc_cli.config import LoadedConfig, load_config
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
    "--deep", is_flag=True, help="Decode every layer of LAZ, also those that no classifier needs."
)
@stream_options
@click.option(
    "--draft",
    type=WRITTEN,
    metavar="FILE.toml",
    help="Write a layout that reads FILE, from its header, its first records or the period of its bytes.",
)
@click.option(
    "--path",
    "path_output",
    type=WRITTEN,
    metavar="OUTPUT",
    help="Write the path of the scanner that --range points finds: .csv with its uncertainty, or .sbet, .out.",
)
@click.option(
    "--check-path",
    is_flag=True,
    help="Hold --range trajectory:FILE against the path found from the points: clock, lever arm, coordinates.",
)
@click.option("--overwrite", is_flag=True, help="Replace an existing draft or path.")
@click.option(
    "--checks", is_flag=True, help="List every check, with what it found and what it expects."
)
@output_options
def info(
    files: tuple[Path, ...],
    deep: bool,
    draft: Path | None,
    path_output: Path | None,
    check_path: bool,
    overwrite: bool,
    checks: bool,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    **options: Any,
) -> None:
    """Say whether FILE can be classified, what to type, and what it holds.

    The same options as for classify say how lines, columns and ranges are found. --verbose tells
    all that is known. The exit code is 0 for a file that can be read, also where the answer is no:
    ask "classifiable" of --json.

    \b
    Examples: prc info drive.laz --lines time:200 --columns time:1000000
              prc info tile.laz --range points --path path.csv
    """
    loaded = config_from(options)
    if draft is not None:
        loaded = _drafted(files, draft, loaded, overwrite=overwrite)
        options = {**options, "config_file": draft}
    if path_output is not None:
        _prepare_path(files, path_output, loaded, is_checked=check_path, overwrite=overwrite)
    found: list[dict[str, Any]] = []
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
            click.echo(f"error: {printable(str(error))}", err=True)
            found.append({"path": str(path), "error": str(error), "classifiable": False})
            code = max(code, error.exit_code)
            continue
        command = _command(inspection, options)
        files_written = {"written": [str(name) for name in written]} if written else {}
        found.append(inspection.as_dict() | {"command": command} | files_written)
        if not as_json and not quiet:
            _print(inspection, command, checks=checks, verbose=verbose)
            for name in written:
                click.echo(printable(f"{name}: the path of the scanner"))
    if as_json:
        click.echo(json.dumps(found[0] if len(files) == 1 else found, indent=2))
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
        message = "--path takes one file"
        raise click.UsageError(message)
    if not is_checked and loaded.config.input.range != "points":
        message = "--path needs the path of the scanner: give --range points, or --check-path with a trajectory"
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


def _drafted(
    files: tuple[Path, ...],
    output: Path,
    loaded: LoadedConfig,
    *,
    overwrite: bool,
) -> LoadedConfig:
    """Write the draft of one file; return the configuration with it."""
    if len(files) != 1 or loaded.files:
        message = "--draft takes one file, and no --config or --layout"
        raise click.UsageError(message)
    from prc_cli.jobs.draft import draft as write_draft  # the only one that needs it

    write_draft(files[0], output, loaded, overwrite=overwrite)
    return load_config(output)


def _print(
    inspection: Inspection,
    command: str,
    *,
    checks: bool,
    verbose: bool,
) -> None:
    """Print a file on one screen.

    The verdict, what to type, doubts, facts, and how many checks are fine.
    """
    method = {"prc": "PRC"}.get(inspection.method, inspection.method)
    doubted = [one for one in inspection.doubts if one.problem != inspection.problem]
    verdict = f"yes, {method} can classify it" + (
        f", but look at {', '.join(one.check for one in doubted)}" if doubted else " as it is"
    )
    if inspection.problem:
        verdict = f"no, {method} cannot classify it: {inspection.problem}"
        if inspection.missing:
            verdict = f"not yet: {inspection.problem}"
        verdict += f"; {inspection.hint}" if inspection.hint else ""
    click.echo(printable(f"{inspection.path}: {verdict}"))
    if command:
        click.echo(printable(f"type: {command}"))
    for one in doubted:
        click.echo(printable(f"look at {one.sentence()}"))
    rows = [*_rows(inspection, verbose=verbose), *_check_rows(inspection, listed=checks or verbose)]
    wide = min(max(len(name) for name, _ in rows), MOST_NAME) + 2
    width = max(shutil.get_terminal_size((100, 24)).columns, wide + LEAST_WIDTH)
    for name, value in rows:
        head = f"{name:{wide - 2}}  "
        click.echo(textwrap.fill(printable(head + value), width, subsequent_indent=" " * wide))


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
"""Dimensions of every LAS file that tell nothing of a scan."""
MOST_NAME = 24
LEAST_WIDTH = 40
"""Columns of the screen for the name of a fact, at most, and for the fact, at least."""
LIST_THEM = " (--checks lists them)"


def _command(inspection: Inspection, options: dict[str, Any]) -> str:
    """Return the command that classifies the file.

    The options given and those that mend it; may be empty.
    """
    doubts = inspection.doubts
    mends = [inspection.mend] if inspection.mend else list(inspection.missing)
    if not mends and inspection.problem:
        against = [one for one in doubts if one.verdict is Verdict.AGAINST]
        if not all(one.option for one in against) or inspection.problem not in {
            one.problem for one in against
        }:
            return ""
    mends = mends or list(dict.fromkeys(one.option for one in doubts if one.option))
    words = ["prc", "classify", typed(inspection.path), typed(output_for(Path(inspection.path)))]
    mended = {mend.partition(" ")[0] for mend in mends} - {"--set"}
    return shlex.join([*words, *given_words(options, mended)]) + "".join(
        f" {mend}" for mend in mends
    )


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
    # how many shots a line has is said with the lines
    taken = [one for one in inspection.assumptions if verbose or one.key != "input.points_per_line"]
    for why, alike in groupby(taken, lambda one: one.why):
        values = (f"{one.key.removeprefix('input.')} {one.value}" for one in alike)
        yield "taken", f"{', '.join(values)} ({why})"
    yield from (("note", note) for note in inspection.notes)
    if inspection.facts is not None:
        for name, count in inspection.facts.tally.counts(everything=verbose):
            yield name, f"{count:,}"
    if verbose and inspection.format not in LISTED:
        yield from ((f"header: {key}", str(value)) for key, value in head.items())


def _path_rows(inspection: Inspection, *, verbose: bool) -> Iterator[tuple[str, str]]:
    """Tell what was found from the points of a registered cloud, and how a trajectory fits it."""
    drive = inspection.drive
    if drive is None:
        return
    for number, one in enumerate(drive.figures if verbose else drive.figures[:MOST_SHOWN]):
        name = f"pass {number}" if len(drive.figures) > 1 else "path"
        head = f"scanner {one.scanner}, " if len(drive.heads) > 1 else ""
        height = "" if math.isnan(one.height_m) else f", {one.height_m:.2f} m above the ground"
        yield (
            name,
            f"{head}{one.length_m:.1f} m in {one.duration_s:.1f} s, {one.speed_m_s:.2f} m/s (median){height}",
        )
        turns = "" if one.turns_hz == one.lines_hz else f"{one.turns_hz:.6g} turns and "
        rates = f"{turns}{one.lines_hz:.6g} lines a second, {one.shots_hz:,.0f} shots a second"
        yield (
            "rotation",
            f"{rates}, M = {one.points_per_line:,}; the scan plane leans by {one.tilt_deg:.1f} deg",
        )
        fit = f"points lie {1e3 * one.residual_m:.1f} mm off their beams (median), {one.share_on_beam:.0%} on a beam"
        certain = f"stations are certain to {1e3 * one.sigma_m:.1f} mm (median)"
        bridged = f"{one.share_bridged:.0%} of the lines stand on their neighbours"
        yield (
            "fit",
            f"{fit}; {certain}, {bridged}; {one.share_holes:.1%} of the cells amid surfaces are empty",
        )
    left = len(drive.figures) - MOST_SHOWN
    if left > 0 and not verbose:
        yield "passes", f"and {left} more"
    if drive.n_unplaced:
        yield "no path", f"{drive.n_unplaced:,} points belong to passes that no path fits"
    for comparison in inspection.comparisons:
        head = f"scanner {comparison.scanner}: " if len(inspection.comparisons) > 1 else ""
        yield "trajectory", head + sentence(comparison)


def _check_rows(inspection: Inspection, *, listed: bool) -> Iterator[tuple[str, str]]:
    """Tell how many checks are fine.

    Or what each found and expected, and the limit of those that found nothing.
    """
    found = {one.check: one for one in inspection.findings}
    if not listed:
        fine = sum(one.verdict is Verdict.FINE for one in found.values())
        accepted = [one.check for one in found.values() if one.is_accepted]
        if found:
            yield (
                "checks",
                f"{fine} fine"
                + (f", accepted: {', '.join(accepted)}" if accepted else "")
                + LIST_THEM,
            )
        return
    for check in check_table():
        one = found.get(check.name)
        if one is None:
            asked = (
                "asked of the labels, by prc classify"
                if check.name in LABEL_CHECKS
                else "not asked of this input"
            )
            yield f"check: {check.name}", f"{asked}. {check.limit}"
            continue
        verdict = "accepted" if one.is_accepted else one.verdict.name.lower()
        hint = f"; {one.hint}" if one.hint and one.verdict is not Verdict.FINE else ""
        yield f"check: {one.check}", f"{verdict}: {one.problem}{hint}"


def _some(words: Sequence[str], *, verbose: bool) -> list[str]:
    """Return words, so many as are printed."""
    if verbose or len(words) <= MOST_SHOWN:
        return list(words)
    return [*words[:MOST_SHOWN], f"and {len(words) - MOST_SHOWN} more"]


def _contents_rows(contents: Contents, *, verbose: bool) -> Iterator[tuple[str, str]]:
    """Tell what the records hold, as surveyors know it from lasinfo."""
    if contents.bounds_m:
        spans = ", ".join(
            f"{axis} {low:,.2f} to {high:,.2f}" for axis, (low, high) in contents.bounds_m.items()
        )
        where = {True: ": registered", False: ": may be relative to the scanner", None: ""}[
            contents.is_registered
        ]
        yield "bounds", f"{spans} m{where}"
    if contents.time_s is not None:
        first, last = contents.time_s
        yield "times", f"{first:,.6f} to {last:,.6f} s: {last - first:,.3f} s"
    names = ASPRS | contents.class_names
    for name, counts in (
        (
            "classes",
            {
                f"{code} {names.get(code, '')}".strip(): n
                for code, n in sorted(contents.classes.items())
            },
        ),
        (
            "returns",
            dict(
                sorted(
                    contents.returns.items(),
                    key=lambda item: [float(n) for n in item[0].split(" of ")],
                )
            ),
        ),
        ("point sources", {str(code): n for code, n in sorted(contents.sources.items())}),
    ):
        # one return a shot, and one source, are what everybody expects
        if counts and (verbose or name == "classes" or len(counts) > 1):
            yield (
                name,
                ", ".join(_some([f"{what}: {n:,}" for what, n in counts.items()], verbose=verbose)),
            )


def _stream_rows(inspection: Inspection, *, verbose: bool) -> Iterator[tuple[str, str]]:
    facts = inspection.facts
    period = inspection.period
    rates = inspection.rates
    if facts is not None:
        rate = "" if facts.line_hz is None else f", {facts.line_hz:.6g} lines a second"
        missing = f"{facts.n_missing:,} of {facts.n_shots:,} missing ({_share(facts.n_missing, facts.n_shots)})"
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
    # where M is known, the check line-length judges it
    if period is not None and (verbose or facts is None):
        estimate = "none" if period.points_per_line is None else f"{period.points_per_line:,}"
        is_used = facts is None or period.points_per_line == inspection.points_per_line
        used = "" if is_used else f"; not used: the lines have {inspection.points_per_line:,} shots"
        yield "M estimated", f"{estimate} ({period.reason}){used}"
    if rates is not None and (
        verbose or facts is None
    ):  # where lines were told, a note says what does not fit them
        found = f"{rates.shot_hz:.8g} shots and {rates.line_hz:.6g} lines a second, M = {rates.points_per_line:,}"
        begins = f"a line begins at {rates.time_origin_s!r} s, in the middle of what rarely returns"
        yield "rates", f"{found}, from the times ({rates.share:.0%} return); {begins}"


def _share(part: int, whole: int) -> str:
    return f"{part / whole:.1%}" if whole else "-"
