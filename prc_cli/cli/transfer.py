"""``prc transfer``: copies the classes of a raw run to the registered points of the same drive."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import click

from prc_cli.cli.options import POSES, Sectioned, add_options, layout_in, numbers, output_options
from prc_cli.cli.output import console, print_json, print_line, table_of
from prc_cli.cli.paths import READ, WRITTEN
from prc_cli.cli.report import line_progress, print_assumptions
from prc_cli.config import load_config
from prc_cli.core.stream import ReadTally
from prc_cli.jobs.transfer import TransferSummary
from prc_cli.jobs.transfer import transfer as transfer_files
from prc_cli.jobs.transfer.options import TransferOptions

_NO_RETURN = "no-return"
"""Part of ``--match`` that leaves the return numbers out."""

_OPTIONS = [
    click.option(
        "--points",
        type=READ,
        metavar="RAW",
        help="Raw input of LABELS, if LABELS has no times.",
    ),
    click.option(
        "--layout", "layout_file", type=READ, metavar="FILE.toml", help="Record layout of RAW."
    ),
    *POSES,
    click.option(
        "--match",
        default="time",
        show_default=True,
        metavar="HOW",
        help="How points are matched: time (and return number), order (the same in both), "
        "record:NAME (dimension of REGISTERED with the index of the raw record), "
        "dimension:NAME (integer dimension of both), or nearest (in space). +NAME adds an integer "
        "dimension that must also be equal, as in time+scanner_channel. +no-return ignores the "
        "return numbers.",
    ),
    click.option(
        "--tolerance",
        "--max-distance",
        "tolerance_s",
        type=float,
        default=0.0,
        metavar="NUMBER",
        help="Largest difference: seconds (time), metres (nearest).  [default: "
        "rounding of the times; for "
        "nearest, from the spacing and the distance of both clouds]",
    ),
    click.option(
        "--time-offset",
        "time_offset_s",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="Add this to the times of LABELS, e.g. from seconds of week to adjusted standard GPS "
        "time.",
    ),
    click.option(
        "--dimension", metavar="NAME", help="Column or dimension of LABELS with the class codes."
    ),
    click.option(
        "--carry",
        multiple=True,
        metavar="NAME",
        help="Also copy this extra dimension of LABELS: segment_id, surface, ...",
    ),
    click.option(
        "--min-confidence",
        type=click.IntRange(0, 100),
        metavar="PERCENT",
        help="Do not copy labels with less confidence. Their points keep their class.",
    ),
    click.option(
        "--min-matched",
        type=float,
        default=0.5,
        show_default=True,
        metavar="SHARE",
        help="Smallest share of records with a partner, of the smaller side.",
    ),
    click.option("--overwrite", is_flag=True, help="Replace an existing output."),
]


@click.command(cls=Sectioned)
@click.argument("labels", type=READ)
@click.argument("registered", type=READ)
@click.argument("output", metavar="OUT", type=WRITTEN)
@add_options(*_OPTIONS)
@output_options
def transfer(
    labels: Path,
    registered: Path,
    output: Path,
    points: Path | None,
    layout_file: Path | None,
    overwrite: bool,
    as_json: bool,
    quiet: bool,
    verbose: bool,
    **matching: Any,
) -> None:
    """Copy the classes of LABELS to the points of REGISTERED, and write OUT.

    LABELS is a classified .las or .laz, or only labels (.npy, .csv, .parquet) with --points RAW.
    REGISTERED and OUT are .las or .laz files of the same drive. Points without partner keep their
    class. Everything else in REGISTERED stays the same.

    \b
    Examples:
      prc transfer drive_classified.laz registered.laz registered_classified.laz
      prc transfer labels.npy registered.laz out.laz --points drive.csv --tolerance 1e-6
    """
    match, *more = matching["match"].split("+")
    matching |= {
        "match": match,
        "same": tuple(name for name in more if name != _NO_RETURN),
        "ignore_return": _NO_RETURN in more,
        "mount": numbers(matching["mount"], "--mount"),
    }
    options = TransferOptions(**matching)
    start = time.perf_counter()
    layout = (
        None if layout_file is None else load_config(options=layout_in(layout_file)).config.layout
    )
    with line_progress(registered.name, quiet=quiet, unit="points") as progress:
        summary = transfer_files(
            labels,
            registered,
            output,
            options,
            points=points,
            layout=layout,
            overwrite=overwrite,
            progress=progress,
        )
    if as_json:
        print_json(summary.record.as_dict(), sort_keys=True)
    if not quiet:
        _print_summary(summary, time.perf_counter() - start, verbose=verbose)


def _print_summary(summary: TransferSummary, seconds: float, *, verbose: bool) -> None:
    counts = summary.counts
    record = summary.record
    rows = [
        (item.name, str(item.code), f"{item.count:,}", f"{item.count / counts.n_points:.1%}")
        for item in record.classes
    ]
    console().print(
        table_of(f"{summary.output.name}: classes", "class", "code", "points", "share", rows=rows)
    )
    matched = _share(counts.n_matched, counts.n_points)
    print_line(f"points matched: {matched}, {counts.n_changed:,} with a new class")
    print_line(f"points not matched, class kept: {counts.n_points - counts.n_matched:,}")
    print_line(f"labels matched: {_share(counts.n_labels_matched, counts.n_labels)}")
    if verbose:
        print_assumptions(record.assumptions, ReadTally())
    for notice in record.notices:
        print_line(f"note: {notice}")
    rate = counts.n_points / seconds / 1e6 if seconds else 0.0
    print_line(
        f"{summary.output}: {counts.n_points:,} points in {seconds:.1f} s ({rate:.2g} million "
        "points a second)"
    )


def _share(part: int, whole: int) -> str:
    return f"{part:,} of {whole:,} ({part / whole:.1%})" if whole else "0 of 0"
