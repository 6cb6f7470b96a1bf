"""``prc render``: pictures of a scan, of its classification, of a cloud."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from prc_cli.cli.options import MAPPING, QUIET, Sectioned, config_from, picture_options
from prc_cli.cli.output import print_json, print_line
from prc_cli.cli.paths import READ, WRITTEN, ScanPath, in_folder
from prc_cli.cli.report import line_progress
from prc_cli.config import RenderParams
from prc_cli.core.errors import ConfigError
from prc_cli.jobs.render import RenderOptions
from prc_cli.jobs.render import render as render_file


@click.command(
    cls=Sectioned,
    brief=(
        "--steps",
        "--only",
        "--labels",
        "--reference",
        "--mapping",
        "--preset",
        "--config",
        "--overwrite",
    ),
)
@click.argument("source", metavar="IN", type=ScanPath())
@click.argument("output", metavar="OUT", type=WRITTEN)
@click.option(
    "--steps",
    metavar="A,B,...",
    help="Pictures to draw, e.g. range,support,classes. figure1: the steps of one block as in "
    "Lehtola et al. (2019), Fig. 1. top: the points from above. Default: prc chooses.",
)
# no part of the stream, as in other commands: the stream is read whole
@click.option(
    "--only", "drawn_lines", metavar="A:B", help="Draw only lines A to B - 1, counted from 0."
)
@click.option("--labels", type=READ, metavar="FILE", help="Draw these classes, do not classify IN.")
@click.option(
    "--reference", type=READ, metavar="FILE", help="Draw the differences to these classes."
)
@MAPPING
@picture_options
@click.option("--overwrite", is_flag=True, help="Replace existing outputs.")
@click.option("--json", "as_json", is_flag=True, help="Print what was drawn as JSON on stdout.")
@QUIET
def render(
    source: Path,
    output: Path,
    *,
    overwrite: bool,
    as_json: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Draw IN into OUT.png, or into OUT.html, a page to turn, zoom and click.

    prc draws ranges, the steps of PRC, classes and differences to a reference, or the points from
    above.

    \b
    Examples:
      prc render drive.laz drive.png
      prc render out.laz out.html
      prc render drive.laz figure1.png --preset prc-2019-urban --steps figure1
      prc render drive.laz differences.png --labels out.laz --reference car.laz \\
        --steps classes,reference,difference
      prc render out.laz cloud.png --steps top
    """
    loaded = config_from(options)
    chosen = _render_options(options, loaded.commands.render)
    with line_progress(source.name, quiet=quiet) as progress:
        if output.suffix.lower() in PAGES:
            # loaded where it is needed, which keeps the start of pictures short
            from prc_cli.jobs.render.viewer import render_viewer

            result = render_viewer(
                source, output, loaded, chosen, overwrite=overwrite, progress=progress
            )
        else:
            output = in_folder(output, f"{source.stem}.png")
            result = render_file(
                source, output, loaded, chosen, overwrite=overwrite, progress=progress
            )
    if as_json:
        print_json({**asdict(result), "files": [str(path) for path in result.files]})
    if not quiet:
        print_line(result.drawn)
        for note in result.notes:
            print_line(f"note: {note}")
        for path in result.files:
            print_line(f"{path} ({path.stat().st_size:,} bytes)")


PAGES = (".html", ".htm")
"""Suffixes of a page."""


def _render_options(options: dict[str, Any], params: RenderParams) -> RenderOptions:
    lines = options["drawn_lines"]
    return RenderOptions(
        steps=None if options["steps"] is None else _names(options["steps"]),
        lines=None if lines is None else _span(lines),
        station=params.station,
        labels_dimension=params.dimension,
        **{name: options[name] for name in ("labels", "reference", "mapping")},
    )


def _names(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def _span(text: str) -> tuple[int, int]:
    first, _, stop = text.partition(":")
    if not (first.strip().isdecimal() and stop.strip().isdecimal()):
        raise ConfigError(
            "--only", f"found {text!r}, expected A:B, two line numbers such as 200:300"
        )
    return int(first), int(stop)
