"""``prc transfer``: copies the classes of a raw run to the registered points of the same drive."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from prc_cli.cli.options import POSES, Sectioned, add_options, numbers, output_options
from prc_cli.cli.report import LineBar, console, print_assumptions
from prc_cli.config import load_config
from prc_cli.core.config import read_toml
from prc_cli.core.stream import ReadTally
from prc_cli.formats.options import Layout
from prc_cli.jobs.transfer import TransferSummary
from prc_cli.jobs.transfer import transfer as transfer_files
from prc_cli.jobs.transfer.options import TransferOptions

_OPTIONS = [
    click.option("--points", type=click.Path(path_type=Path), metavar="RAW",
                 help="Input that LABELS belong to, record by record, where they have no times of their own."),
    click.option("--layout", "layout_file", type=click.Path(path_type=Path), metavar="FILE.toml",
                 help="Record layout of RAW."),
    *POSES,
    click.option("--match", default="time", show_default=True, metavar="HOW",
                 help="How points find their label: time (and return number), order (the same on both sides), "
                 "record:NAME (a dimension of REGISTERED with the index of the raw record), dimension:NAME (an integer "
                 "dimension of both), or nearest (in space)."),
    click.option("--tolerance", "--max-distance", "tolerance_s", type=float, default=0.0, metavar="NUMBER",
                 help="Largest difference: seconds (time), metres (nearest).  [default: what float64 rounds; metres "
                 "from the spacing and the distance of both clouds]"),
    click.option("--time-offset", "time_offset_s", type=float, default=0.0, metavar="SECONDS",
                 help="Added to the times of LABELS, e.g. from seconds of week to adjusted standard GPS time."),
    click.option("--ignore-return", is_flag=True, help="Match by the time alone, not by the return number."),
    click.option("--same", multiple=True, metavar="NAME",
                 help="Integer dimension that must be equal too, e.g. scanner_channel."),
    click.option("--dimension", metavar="NAME", help="Column or dimension of LABELS with the class codes."),
    click.option("--carry", multiple=True, metavar="NAME",
                 help="Extra dimension of LABELS that goes along: segment_id, surface, ..."),
    click.option("--min-confidence", type=click.IntRange(0, 100), metavar="PERCENT",
                 help="Transfer no label with less confidence; such points keep their class."),
    click.option("--min-matched", type=float, default=0.5, show_default=True, metavar="SHARE",
                 help="Refuse when a smaller share of the smaller side finds a partner."),
    click.option("--overwrite", is_flag=True, help="Replace an existing output."),
]  # fmt: skip


@click.command(cls=Sectioned)
@click.argument("labels", type=click.Path(path_type=Path))
@click.argument("registered", type=click.Path(path_type=Path))
@click.argument("output", metavar="OUT", type=click.Path(path_type=Path))
@add_options(*_OPTIONS)
@output_options
def transfer(
    labels: Path, registered: Path, output: Path, points: Path | None, layout_file: Path | None, overwrite: bool,
    as_json: bool, quiet: bool, verbose: bool, **matching: Any,
) -> None:  # fmt: skip
    """Write REGISTERED again as OUT, with the classes of LABELS.

    LABELS is a classified .las or .laz, or labels alone (.npy, .csv, .parquet) with the raw input they belong to
    (--points). REGISTERED and OUT are .las or .laz of the same drive. Points without partner keep their class;
    everything else stays as it is in REGISTERED.

    \b
    Examples:
      prc transfer drive_classified.laz registered.laz registered_classified.laz
      prc transfer labels.npy registered.laz out.laz --points drive.csv --tolerance 1e-6
    """
    options = TransferOptions(**{**matching, "mount": numbers(matching["mount"], "--mount")})
    start = time.perf_counter()
    layout = _layout(layout_file)
    with _progress(registered.name, quiet=quiet) as progress:
        summary = transfer_files(
            labels, registered, output, options, points=points, layout=layout, overwrite=overwrite, progress=progress
        )
    if as_json:
        click.echo(json.dumps(summary.record.as_dict(), indent=2, sort_keys=True))
    if not quiet:
        _print_summary(summary, time.perf_counter() - start, verbose=verbose)


@contextlib.contextmanager
def _progress(name: str, *, quiet: bool) -> Iterator[Callable[[int], object] | None]:
    """Show a progress bar of points on a terminal; nothing elsewhere."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from tqdm import tqdm

    with tqdm(desc=name, unit=" points", unit_scale=True, leave=False) as bar:
        yield LineBar(bar)


def _layout(path: Path | None) -> Layout | None:
    if path is None:
        return None
    content = read_toml(path)
    return load_config(None, None, {"layout": content.get("layout", content)}).config.layout


def _print_summary(summary: TransferSummary, seconds: float, *, verbose: bool) -> None:
    counts, record = summary.counts, summary.record
    lines = [
        f"points matched: {_share(counts.n_matched, counts.n_points)}, {counts.n_changed:,} changed their class",
        f"points not matched, class kept: {counts.n_points - counts.n_matched:,}",
        f"labels matched: {_share(counts.n_labels_matched, counts.n_labels)}",
    ]
    table = Table(title=f"{summary.output.name}: classes")
    for heading in ("class", "code", "points", "share"):
        table.add_column(heading, justify="left" if heading == "class" else "right")
    for item in record.classes:
        table.add_row(item.name, str(item.code), f"{item.count:,}", f"{item.count / counts.n_points:.1%}")
    console().print(table)
    for line in lines:
        console().print(line, soft_wrap=True)
    if verbose:
        print_assumptions(record.assumptions, ReadTally())
    for notice in record.notices:
        console().print(f"note: {notice}", soft_wrap=True)
    rate = counts.n_points / seconds / 1e6 if seconds else 0.0
    text = f"{summary.output}: {counts.n_points:,} points in {seconds:.1f} s ({rate:.2g} million points a second)"
    console().print(text, soft_wrap=True)


def _share(part: int, whole: int) -> str:
    return f"{part:,} of {whole:,} ({part / whole:.1%})" if whole else "0 of 0"
