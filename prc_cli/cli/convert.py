"""``prc convert``: any readable input to any writable format."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from prc_cli.cli.options import (
    Sectioned,
    config_from,
    input_options,
    output_options,
    window_options,
)
from prc_cli.cli.output import print_json, print_line
from prc_cli.cli.paths import WRITTEN, ScanPath, in_folder
from prc_cli.cli.report import (
    NOT_KEPT,
    end_with,
    line_progress,
    lines_of_shots,
    print_assumptions,
    print_notices,
)
from prc_cli.jobs.convert import ConversionSummary
from prc_cli.jobs.convert import convert as convert_file


@click.command(cls=Sectioned)
@click.argument("source", metavar="IN", type=ScanPath())
@click.argument("output", metavar="OUT", type=WRITTEN)
@input_options
@window_options
@click.option("--overwrite", is_flag=True, help="Replace an existing output.")
@output_options
def convert(
    source: Path,
    output: Path,
    overwrite: bool,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    **options: Any,
) -> None:
    """Convert IN to the format of OUT, and report what is lost.

    OUT is .las, .laz, .csv (.csv.gz, .csv.zst), .parquet, .npz, .npy, .bin, .ply, .pcd or a
    bag (.bag, .mcap, .db3). From .las to .laz and back only the compression changes. prc reads all
    other files as prc classify does. Ranges and times keep every bit.

    prc prints what OUT cannot contain, and warnings about IN (exit code 4). Both are in
    OUT.prc.json.

    \b
    Examples:
      prc convert drive.las drive.laz
      prc convert drive.bin drive.npz --layout drive.toml
      prc convert station.e57 station.csv.gz
    """
    loaded = config_from(options)
    output = in_folder(output, source.name)
    start = time.perf_counter()
    with line_progress(source.name, quiet=quiet) as progress:
        summary = convert_file(source, output, loaded, overwrite=overwrite, progress=progress)
    if as_json:
        print_json(summary.as_dict(), sort_keys=True)
    if not quiet:
        _print_summary(summary, time.perf_counter() - start, verbose=verbose)
    end_with(summary.doubts)


def _print_summary(summary: ConversionSummary, seconds: float, *, verbose: bool) -> None:
    record = summary.record
    if verbose:
        print_assumptions(record.assumptions, record.tally)
    print_notices([f"{NOT_KEPT}{loss}" for loss in summary.losses])
    print_notices(notice for notice in record.notices if not notice.startswith(NOT_KEPT))
    rate = summary.n_shots / seconds / 1e6 if seconds else 0.0
    what = f"{summary.n_shots:,} records"
    if summary.n_lines:
        what = lines_of_shots(summary.n_lines, record.points_per_line)
    print_line(f"{summary.output}: {what} in {seconds:.1f} s ({rate:.2g} million a second)")
