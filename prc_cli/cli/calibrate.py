"""``prc calibrate``: parameters from the measured scanner."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import click

from prc_cli.cli.options import (
    JSON,
    QUIET,
    Sectioned,
    add_options,
    config_from,
    form_of_output,
    stream_options,
    window_options,
)
from prc_cli.cli.output import print_line, print_result, print_table, print_text
from prc_cli.cli.paths import WRITTEN, ScanPath
from prc_cli.cli.report import end_with, line_progress
from prc_cli.core.files import atomic_output, prepare_outputs, whole_set
from prc_cli.jobs.calibrate import Calibration
from prc_cli.jobs.calibrate import calibrate as calibrate_file
from prc_cli.jobs.calibrate.reports import (
    CURVE_HEADER,
    advice_rows,
    as_markdown,
    as_svg,
    as_toml,
    curve_rows,
    sensor_rows,
)
from prc_cli.jobs.calibrate.reports import as_json as calibration_json

_OPTIONS = [
    click.option(
        "-o",
        "--output",
        "outputs",
        multiple=True,
        type=WRITTEN,
        metavar="FILE",
        help="Write the configuration, with a reason for every value (.toml), the shares of "
        "supported shots and of background over the thresholds (.svg), or all that was measured "
        "(.md, .json). Can be repeated.",
    ),
    click.option("--overwrite", is_flag=True, help="Replace existing outputs."),
]

_WRITERS = {".toml": as_toml, ".svg": as_svg, ".md": as_markdown, ".json": calibration_json}
"""What is written, by the suffix of an output."""


@click.command(cls=Sectioned)
@click.argument("source", metavar="IN", type=ScanPath())
@add_options(*_OPTIONS)
@stream_options
@window_options
@JSON
@QUIET
def calibrate(
    source: Path,
    outputs: tuple[Path, ...],
    overwrite: bool,
    as_json: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Measure the scanner on the stream of IN, and derive the parameters of PRC.

    prc measures noise, angular step, rounding and missing shots. If IN gives a warning, the
    parameters may be wrong (exit code 4).

    Only PRC needs this. fused measures the scanner itself. If you name no method and prc chooses
    fused, there is nothing to calibrate, and the configuration changes nothing.

    \b
    Examples:
      prc calibrate drive.laz --method prc -o drive.toml -o drive.svg
      prc classify drive.laz out.laz --config drive.toml
    """
    writers = [form_of_output(path, _WRITERS) for path in outputs]
    loaded = config_from(options)
    inputs = (source, *loaded.files)
    prepare_outputs(*outputs, overwrite=overwrite, inputs=inputs)
    with line_progress(source.name, quiet=quiet) as progress:
        calibration = calibrate_file(source, loaded, progress=progress)
    with whole_set():
        for path, writer in zip(outputs, writers, strict=True):
            text = writer(calibration)
            with atomic_output(path, overwrite=overwrite) as temporary:
                temporary.write_text(text, encoding="utf-8")
    if as_json:
        print_text(calibration_json(calibration))
    elif not quiet:
        _print(calibration)
    if not quiet:
        for path in outputs:
            print_line(f"wrote {path}")
    end_with(calibration.doubts)


def _print(calibration: Calibration) -> None:
    _print_table("measured on the stream", ("", ""), sensor_rows(calibration.sensor))
    if calibration.advice:
        _print_table("share of the returns", CURVE_HEADER, curve_rows(calibration))
        headings = ("key", "before", "value", "reason")
        _print_table("parameters", headings, advice_rows(calibration))
    for note in calibration.notes:
        print_result(f"note: {note}")


def _print_table(title: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    print_table(title, headings, rows, n_words=len(headings))
