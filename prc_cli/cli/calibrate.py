"""``prc calibrate``: parameters from the measured scanner, or from a reference."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import click
from click.core import ParameterSource

from prc_cli.cli.options import (
    QUIET_FORM,
    Sectioned,
    add_options,
    complete_mapping,
    config_from,
    form_of,
    form_options,
    stream_options,
    window_options,
)
from prc_cli.cli.output import print_line, print_result, print_table, print_text
from prc_cli.cli.paths import READ, READ_TEXT, WRITTEN, ScanPath
from prc_cli.cli.report import end_with, line_progress
from prc_cli.core.errors import ConfigError
from prc_cli.core.files import atomic_output, prepare_outputs, whole_set
from prc_cli.jobs.calibrate import Calibration, SearchOptions
from prc_cli.jobs.calibrate import calibrate as calibrate_file
from prc_cli.jobs.calibrate.reports import (
    CURVE_HEADER,
    advice_rows,
    as_json,
    as_markdown,
    as_svg,
    as_toml,
    curve_rows,
    judged_rows,
    sensor_rows,
)
from prc_cli.jobs.calibrate.search import MEAN_F1, Tried

_OPTIONS = [
    click.option(
        "-o",
        "--output",
        type=WRITTEN,
        metavar="CONFIG.toml",
        help="Write the calibrated configuration, with a reason for every value.",
    ),
    click.option(
        "--plot",
        type=WRITTEN,
        metavar="FILE.svg",
        help="Draw the shares of supported shots and of background over the thresholds.",
    ),
    click.option("--overwrite", is_flag=True, help="Replace existing outputs."),
    click.option(
        "--reference",
        type=READ,
        metavar="LABELS",
        help="Class codes of the records of IN: search the parameters that agree best.",
    ),
    click.option(
        "--mapping",
        type=READ_TEXT,
        default="prc",
        show_default=True,
        metavar="NAME|FILE.toml",
        shell_complete=complete_mapping,
        help="Classes of the codes.",
    ),
    click.option(
        "--reference-dimension",
        metavar="NAME",
        help="Column or dimension with the reference codes.",
    ),
    click.option(
        "--objective",
        default=MEAN_F1,
        show_default=True,
        metavar="SCORE",
        help="Score to maximise: mean_f1, balanced_accuracy, kappa, accuracy or e.g. f1.ground.",
    ),
    click.option(
        "--training-share",
        type=float,
        default=0.6,
        show_default=True,
        metavar="SHARE",
        help="Share of the line groups for the search. The others are held out for the scores.",
    ),
    click.option(
        "--budget",
        type=click.IntRange(2, 100_000),
        default=300,
        show_default=True,
        help="Largest number of parameter sets to try.",
    ),
    click.option(
        "--seed",
        type=click.IntRange(0, 2**63 - 1),
        default=0,
        show_default=True,
        help="Seed for the choice of training lines.",
    ),
    click.option(
        "--keep",
        multiple=True,
        metavar="KEY",
        help="Do not search this key, e.g. prc.support.zeta_p: derive it from the scanner.",
    ),
    click.option(
        "--max-shots",
        type=click.IntRange(min=1000),
        default=4_000_000,
        show_default=True,
        help="Shots in memory for the search. Longer inputs are sampled.",
    ),
]


@click.command(cls=Sectioned)
@click.argument("source", metavar="IN", type=ScanPath())
@add_options(*_OPTIONS)
@stream_options
@window_options
@add_options(*form_options("table", "json", "markdown"), QUIET_FORM)
def calibrate(
    source: Path,
    output: Path | None,
    plot: Path | None,
    overwrite: bool,
    reference: Path | None,
    quiet: bool,
    **options: Any,
) -> None:
    """Measure the scanner on the stream of IN, and derive the parameters of PRC.

    prc measures noise, angular step, rounding and missing shots. With --reference it also searches
    the best parameters on a part of the lines, and prints their scores on the other lines. If IN
    gives a warning, the parameters may be wrong (exit code 4).

    Only PRC needs this. fused measures the scanner itself. If you name no method and prc chooses
    fused, there is nothing to calibrate, and the configuration changes nothing.

    \b
    Examples:
      prc calibrate drive.laz --method prc -o drive.toml --plot drive.svg
      prc calibrate strip.csv.gz --method prc --reference strip.csv.gz --mapping oakland \\
        -o strip.toml
      prc classify drive.laz out.laz --config drive.toml
    """
    form = form_of(options)
    if plot is not None and plot.suffix.lower() != ".svg":
        where = "--plot"
        raise ConfigError(where, f"found {str(plot)!r}, expected a name that ends in .svg")
    loaded = config_from(options)
    inputs = (source, *loaded.files, *([] if reference is None else [reference]))
    wanted = [path for path in (output, plot) if path is not None]
    prepare_outputs(*wanted, overwrite=overwrite, inputs=inputs)
    search = _search_options(reference, options)
    with line_progress(source.name, quiet=quiet) as progress, _trials(quiet=quiet) as tried:
        calibration = calibrate_file(source, loaded, search, progress=progress, tried=tried)
    with whole_set():
        for target, text in ((output, as_toml), (plot, as_svg)):
            if target is not None:
                with atomic_output(target, overwrite=overwrite) as temporary:
                    temporary.write_text(text(calibration), encoding="utf-8")
    if form != "table":
        print_text(as_json(calibration) if form == "json" else as_markdown(calibration))
    elif not quiet:
        _print(calibration)
    if not quiet:
        for path in wanted:
            print_line(f"wrote {path}")
    end_with(calibration.doubts)


SEARCH_OPTIONS = (
    "mapping",
    "reference_dimension",
    "objective",
    "training_share",
    "budget",
    "seed",
    "keep",
    "max_shots",
)
"""Options that say how the search is done, which there is none of without a reference."""


def _search_options(reference: Path | None, options: dict[str, Any]) -> SearchOptions | None:
    if reference is None:
        context = click.get_current_context()
        for name in SEARCH_OPTIONS:
            if context.get_parameter_source(name) not in (ParameterSource.DEFAULT, None):
                message = f"--{name.replace('_', '-')} needs --reference"
                raise click.UsageError(message)
        return None
    chosen = {name: options[name] for name in SEARCH_OPTIONS}
    return SearchOptions(reference, dimension=chosen.pop("reference_dimension"), **chosen)


@contextlib.contextmanager
def _trials(*, quiet: bool) -> Iterator[Tried | None]:
    if quiet or not sys.stderr.isatty():
        yield None
        return

    def tell(n_trials: int, best: float) -> None:
        click.echo(f"\rtrial {n_trials}: best {best:.4f}   ", nl=False, err=True)

    yield tell
    click.echo("\r" + " " * 40 + "\r", nl=False, err=True)


def _print(calibration: Calibration) -> None:
    _print_table("measured on the stream", ("", ""), sensor_rows(calibration.sensor))
    if calibration.advice:
        _print_table("share of the returns", CURVE_HEADER, curve_rows(calibration))
        headings = ("key", "before", "value", "reason")
        _print_table("parameters", headings, advice_rows(calibration))
    if calibration.search is not None:
        title = f"{calibration.search.n_trials} trials; figures on training and on held-out lines"
        _print_table(title, *judged_rows(calibration))
    for note in calibration.notes:
        print_result(f"note: {note}")


def _print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    print_table(title, headings, rows, n_words=len(headings))
