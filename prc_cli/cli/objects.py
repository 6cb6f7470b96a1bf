"""``prc objects``: stems, poles, cars and curbs, one row each."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import Any

import click

from prc_cli.cli.options import (
    Sectioned,
    Word,
    config_from,
    output_options,
    stream_options,
    window_options,
)
from prc_cli.cli.output import print_csv_row, print_json, print_line
from prc_cli.cli.paths import WRITTEN, ScanPath
from prc_cli.cli.report import (
    compiling_note,
    end_with,
    line_progress,
    print_notices,
    print_run_assumptions,
)
from prc_cli.jobs.classify import load_classifier
from prc_cli.jobs.objects import COLUMNS, KINDS, ScanObject, find_objects, plain


@click.command(cls=Sectioned)
@click.argument("source", metavar="IN", type=ScanPath())
@click.option(
    "-o", "--output", type=WRITTEN, metavar="OUT", help="A .csv, .geojson or .parquet file."
)
@click.option(
    "--kind",
    "kinds",
    multiple=True,
    type=Word(KINDS),
    help="List only this kind. Can be repeated.",
)
@stream_options
@window_options
@click.option("--overwrite", is_flag=True, help="Replace an existing output.")
@output_options
def objects(
    source: Path,
    output: Path | None,
    kinds: tuple[str, ...],
    overwrite: bool,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    **options: Any,
) -> None:
    """List the stems, poles, cars and curbs of IN.

    If IN contains such classes and you name no method, prc uses them. Else prc classifies IN first.
    Neighbouring shots of such a class are one object. If IN has registered coordinates, the list
    contains x, y, z.

    Without OUT prc prints the list as CSV, each object as soon as it is complete. With --json it is
    one line of JSON per object.

    \b
    Examples:
      prc objects forest.laz -o stems.geojson --preset fused-forest
      prc objects drive.laz --kind pole --kind car > inventory.csv
    """
    loaded = config_from(options)
    with compiling_note(quiet=quiet):
        load_classifier(loaded)

    is_table = output is None and not as_json
    rows = count(1)

    def head() -> None:
        # not before the first object: the input may be refused
        if is_table and next(rows) == 1:
            print_csv_row(COLUMNS)

    def show(scan_object: ScanObject) -> None:
        head()
        values = {name: plain(getattr(scan_object, name)) for name in COLUMNS}
        if as_json:
            print_json(values, indent=None)
        elif is_table:
            print_csv_row(values.values())

    with line_progress(source.name, quiet=quiet) as progress:
        summary = find_objects(
            source, output, loaded, kinds=kinds, each=show, overwrite=overwrite, progress=progress
        )
    head()
    if not quiet:
        print_run_assumptions(summary.record, verbose=verbose)
        print_notices(summary.record.notices)
        counts = ", ".join(f"{n:,} {kind}{'s' * (n != 1)}" for kind, n in summary.n_objects.items())
        print_line(f"{source.name}: {counts} in {summary.counts.n_lines:,} lines")
    end_with(summary.doubts)
