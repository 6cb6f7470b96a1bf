"""``prc thin``: drops noise and thins chosen classes."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from prc_cli.cli import report
from prc_cli.cli.options import Sectioned, config_from, output_options, stream_options
from prc_cli.cli.output import console, print_json, print_line, results, table_of
from prc_cli.cli.paths import READ, WRITTEN, ScanPath, in_folder
from prc_cli.cli.report import line_progress, print_assumptions, print_notices
from prc_cli.jobs.thin import CLASSIFY, ThinningSummary, parse_rules
from prc_cli.jobs.thin import thin as thin_file


@click.command(cls=Sectioned)
@click.argument("source", metavar="IN", type=ScanPath())
@click.argument("output", metavar="OUT", type=WRITTEN)
@click.option(
    "--keep",
    multiple=True,
    metavar="CLASS=FRACTION,...",
    help="Keep this share of a class, by line and column: ground=1/4. 0 removes the class. prc "
    "always removes noise, unless you name it here.",
)
@click.option(
    "--spacing",
    multiple=True,
    metavar="CLASS=METRES,...",
    help="Keep shots of a class at this distance in a line: ground=0.1.",
)
@click.option("--keep-only", multiple=True, metavar="CLASS,...", help="Keep only these classes.")
@click.option(
    "--labels",
    type=READ,
    metavar="FILE",
    help="Classes of IN, one code per record. For a folder of frames: the folder of their labels.",
)
@click.option(
    "--min-confidence",
    type=click.IntRange(0, 100),
    metavar="PERCENT",
    help="Also remove returns whose label has less confidence.",
)
@click.option(
    "--keep-empty",
    is_flag=True,
    help="In .ply, .pcd, .bin: write empty cells too, not only the returns.",
)
@click.option(
    "--every-frame",
    is_flag=True,
    help="For folders: number the frames 000000, 000001, ... instead of keeping their names.",
)
@stream_options
@click.option("--overwrite", is_flag=True, help="Replace an existing output.")
@output_options
def thin(
    source: Path,
    output: Path,
    labels: Path | None,
    min_confidence: int | None,
    keep_empty: bool,
    every_frame: bool,
    overwrite: bool,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    **options: Any,
) -> None:
    """Remove noise from IN and thin out the classes that you name.

    The classes are in IN or in --labels. If IN has none, or with --preset, --method or --config,
    prc classifies IN first.

    OUT is any format that prc convert writes, or a bag if IN is a bag. From .las or .laz to .las or
    .laz only records are removed, and everything else stays. The same holds for points of bags, and
    for frames of spinning scanners from .ply to .ply and from .pcd to .pcd. A .bin of a frame
    contains x, y, z and intensity, as in KITTI. A folder of frames becomes a folder of frames.

    \b
    Examples:
      prc thin drive_classified.laz drive_thin.laz --keep ground=1/4
      prc thin drive.laz drive_thin.laz --spacing ground=0.1 --keep vegetation=0
      prc thin drive.csv.gz drive_thin.npz --labels labels.npy --keep building=0.5
      prc thin velodyne/ still/ --keep-only ground,building,pole
    """
    keep, spacing, keep_only = (options.pop(name) for name in ("keep", "spacing", "keep_only"))
    loaded = config_from(options)
    rules = parse_rules(keep, spacing, loaded.config.classes, keep_only=keep_only)
    classify = any(options[name] is not None for name in ("preset", "method", "config_file"))
    chosen: Path | str | None = labels
    if labels is None and classify:
        chosen = CLASSIFY
    if source.is_file():
        output = in_folder(output, source.name)
    start = time.perf_counter()
    with line_progress(source.name, quiet=quiet) as progress:
        summary = thin_file(
            source,
            output,
            rules,
            loaded,
            labels=chosen,
            min_confidence=min_confidence,
            keep_empty=keep_empty,
            every_frame=every_frame,
            overwrite=overwrite,
            progress=progress,
        )
    if as_json:
        print_json(summary.as_dict(), sort_keys=True)
    if not quiet:
        _print_summary(summary, time.perf_counter() - start, verbose=verbose, as_json=as_json)
    if code := report.print_doubts(summary.doubts):
        raise SystemExit(code)


def _print_summary(
    summary: ThinningSummary,
    seconds: float,
    *,
    verbose: bool,
    as_json: bool,
) -> None:
    headings = ("class", "code", "input", "kept", "dropped", "bytes saved")
    table = table_of(f"{summary.record.input.name}: returns kept", *headings)
    for item in summary.classes:
        figures = (item.n_input, item.n_kept, item.n_dropped, item.n_bytes)
        table.add_row(item.name, str(item.code), *(f"{figure:,}" for figure in figures))
    (console() if as_json else results()).print(table)
    record = summary.record
    if verbose:
        print_assumptions(record.assumptions, record.tally)
    print_notices(record.notices)
    share = f" ({summary.bytes_output / summary.bytes_input:.1%})" if summary.bytes_input else ""
    sizes = f"{summary.bytes_input:,} bytes to {summary.bytes_output:,}{share}"
    print_line(f"{summary.output}: {sizes} in {seconds:.1f} s")
