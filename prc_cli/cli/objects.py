"""``prc objects``: stems, poles, cars and curbs, one row each."""

from __future__ import annotations

import json
from itertools import count
from pathlib import Path
from typing import Any

import click

from prc_cli.cli.options import (
    Sectioned,
    config_from,
    output_options,
    stream_options,
    window_options,
)
from prc_cli.cli.paths import WRITTEN, ScanPath
from prc_cli.cli.report import (
    compiling_note,
    end_with,
    line_progress,
    print_line,
    print_notices,
    print_taken,
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
    type=click.Choice(KINDS),
    help="Only these; repeat for several.",
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
    """List the stems, poles, cars and curbs of IN as they pass.

    Where IN has such classes and no method is named, they are taken; else IN is classified on the
    way. Shots of such a class that lie near each other in a line and across lines are one object.
    Without OUT the list is CSV on stdout, a line as soon as an object has passed. x, y, z are there
    where IN has registered coordinates. With --json the list on stdout is JSON, a line an object.

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
        # after what may be refused
        if is_table and next(rows) == 1:
            click.echo(",".join(COLUMNS))

    def show(scan_object: ScanObject) -> None:
        head()
        values = {name: plain(getattr(scan_object, name)) for name in COLUMNS}
        if as_json:
            click.echo(json.dumps(values))
        elif is_table:
            click.echo(",".join("" if value is None else str(value) for value in values.values()))

    with line_progress(source.name, quiet=quiet) as progress:
        summary = find_objects(
            source, output, loaded, kinds=kinds, each=show, overwrite=overwrite, progress=progress
        )
    head()
    if not quiet:
        print_taken(summary.record, verbose=verbose)
        print_notices(summary.record.notices)
        found = ", ".join(f"{n:,} {kind}{'s' * (n != 1)}" for kind, n in summary.n_objects.items())
        print_line(f"{source.name}: {found} in {summary.counts.n_lines:,} lines")
    end_with(summary.doubts)
