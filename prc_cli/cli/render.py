"""``prc render``: pictures of a scan, of its classification, of a cloud."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from prc_cli.cli.options import MAPPING, QUIET, Sectioned, Word, config_from, stream_options
from prc_cli.cli.output import print_json, print_line
from prc_cli.cli.paths import READ, WRITTEN, ScanPath, in_folder
from prc_cli.cli.report import line_progress
from prc_cli.core.errors import ConfigError
from prc_cli.jobs.render import COLOURS, VIEWS, RenderOptions
from prc_cli.jobs.render import render as render_file


@click.command(
    cls=Sectioned,
    brief=(
        "--html",
        "--steps",
        "--only",
        "--labels",
        "--reference",
        "--view",
        "--colour",
        "--preset",
        "--config",
        "--overwrite",
    ),
)
@click.argument("source", metavar="IN", type=ScanPath())
@click.argument("output", metavar="[OUT]", type=WRITTEN, required=False)
@click.option(
    "--html",
    type=WRITTEN,
    metavar="FILE.html",
    help="Instead of OUT: a page with the cloud and the range image, to turn, zoom and click.",
)
@click.option(
    "--steps",
    metavar="A,B,...",
    help="Pictures to draw, e.g. range,support,classes. Default: prc chooses.",
)
# no part of the stream, as in other commands: the stream is read whole
@click.option(
    "--only", "drawn_lines", metavar="A:B", help="Draw only lines A to B - 1, counted from 0."
)
@click.option(
    "--figure1",
    is_flag=True,
    help="Draw the steps of one block as in Lehtola et al. (2019), Fig. 1.",
)
@click.option(
    "--station",
    type=int,
    metavar="N",
    help="Number of the scanner or of the scan.  [default: the first]",
)
@click.option("--labels", type=READ, metavar="FILE", help="Draw these classes, do not classify IN.")
@click.option(
    "--dimension", "labels_dimension", metavar="NAME", help="Column or dimension of --labels."
)
@click.option(
    "--reference", type=READ, metavar="FILE", help="Draw the differences to these classes."
)
@click.option("--reference-dimension", metavar="NAME", help="Column or dimension of --reference.")
@MAPPING
@click.option(
    "--view",
    type=Word(VIEWS),
    default="scan",
    show_default=True,
    help="Draw lines and columns, or the points from above.",
)
@click.option("--hide", metavar="CLASS,...", help="Do not draw these classes, e.g. noise.")
@click.option("--colour", type=Word(COLOURS), help="Colours of the points.")
@click.option(
    "--width",
    type=click.IntRange(200, 20_000),
    default=2200,
    show_default=True,
    help="Largest width of a picture [pixels].",
)
@stream_options
@click.option("--overwrite", is_flag=True, help="Replace existing outputs.")
@click.option("--json", "as_json", is_flag=True, help="Print what was drawn as JSON on stdout.")
@QUIET
def render(
    source: Path,
    output: Path | None,
    *,
    html: Path | None,
    overwrite: bool,
    as_json: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Draw IN into OUT.png, or into a page to turn, zoom and click (--html).

    prc draws ranges, the steps of PRC, classes and differences to a reference, or the points from
    above.

    \b
    Examples:
      prc render drive.laz drive.png
      prc render out.laz --html out.html
      prc render drive.laz figure1.png --preset prc-2019-urban --figure1
      prc render drive.laz differences.png --labels out.laz --reference car.laz \\
        --steps classes,reference,difference
      prc render out.laz cloud.png --view top
    """
    chosen = _render_options(options)
    if (output is None) == (html is None):
        problem = "there is no output" if html is None else "prc draws either OUT or --html"
        raise ConfigError(
            "OUT" if html is None else "--html",
            problem,
            "give OUT.png or --html PAGE.html",
        )
    loaded = config_from(options)
    with line_progress(source.name, quiet=quiet) as progress:
        if output is not None:
            output = in_folder(output, f"{source.stem}.png")
            result = render_file(
                source, output, loaded, chosen, overwrite=overwrite, progress=progress
            )
        elif html is not None:
            # loaded where it is needed, which keeps the start of pictures short
            from prc_cli.jobs.render.viewer import render_viewer

            result = render_viewer(
                source, html, loaded, chosen, overwrite=overwrite, progress=progress
            )
    if as_json:
        print_json({**asdict(result), "files": [str(path) for path in result.files]})
    if not quiet:
        print_line(result.drawn)
        for note in result.notes:
            print_line(f"note: {note}")
        for path in result.files:
            print_line(f"{path} ({path.stat().st_size:,} bytes)")


_AS_GIVEN = (
    "view",
    "figure1",
    "station",
    "labels",
    "labels_dimension",
    "reference",
    "reference_dimension",
    "mapping",
    "colour",
    "width",
)
"""Options of the command that :class:`RenderOptions` has under the same name."""


def _render_options(options: dict[str, Any]) -> RenderOptions:
    steps = options["steps"]
    lines = options["drawn_lines"]
    return RenderOptions(
        steps=None if steps is None else _names(steps),
        hide=_names(options["hide"] or ""),
        lines=None if lines is None else _span(lines),
        **{name: options[name] for name in _AS_GIVEN},
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
