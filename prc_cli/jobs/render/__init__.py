"""``prc render``: pictures of a scan or a point cloud."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from prc_cli.config import LoadedConfig, MethodChoice, refuse_window, resolve
from prc_cli.core.errors import ConfigError
from prc_cli.core.files import atomic_output, prepare_outputs, temporary_folder, whole_set
from prc_cli.core.version import __version__
from prc_cli.formats.input import Input
from prc_cli.imaging.sheet import Key, Panel, choose_columns, draw_sheet
from prc_cli.imaging.viewer import html_page
from prc_cli.jobs.choice import decide, decided_by
from prc_cli.jobs.render.options import (
    CAPTIONS,
    COLOURS,
    PRC_STEPS,
    SUFFIXES,
    VIEWS,
    RenderOptions,
    RenderResult,
)
from prc_cli.jobs.render.scan import NOT_LABELLED, Drawing, describe, draw_scan
from prc_cli.jobs.run import Progress


def render(
    source: Path | str,
    output: Path | str,
    config: LoadedConfig,
    options: RenderOptions | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> RenderResult:
    """Draw a file.

    Parameters
    ----------
    source : path
        Any readable input.
    output : path
        ``.png`` (further pages as ``NAME_2.png`` and so on) or ``.html`` (one file with all
        pictures).
    config : LoadedConfig
        How the input is read and classified.
    options : RenderOptions, optional
        What is drawn; default: ranges and classes of the whole drive.
    overwrite : bool
        Replace existing outputs.
    progress : callable, optional
        Called with the number of lines that were just read.

    Returns
    -------
    RenderResult

    Raises
    ------
    ConfigError
        Unknown step, view or suffix of the output; block or lines out of range.
    InputError
        Damaged input; labels of another length; no coordinates for a cloud.
    OutputError
        When it cannot be written; nothing is left behind.
    """
    scan, config = resolve(source, config)
    output = Path(output)
    chosen = RenderOptions() if options is None else options
    if output.suffix.lower() not in SUFFIXES:
        problem = f"found the suffix {output.suffix!r}, expected one of: {' '.join(SUFFIXES)}"
        raise ConfigError(str(output), problem, "rename the output")
    inputs = config.inputs(scan.path, chosen.labels, chosen.reference)
    prepare_outputs(output, overwrite=overwrite, inputs=inputs, beside=_further_pages(output))
    scan.check()
    refuse_window(config.config, "prc render")
    config = _decided(scan, config, chosen)
    with temporary_folder("prc-render-") as scratch:
        if chosen.view == "scan":
            drawing = draw_scan(scan, config, chosen, scratch, progress)
            result = RenderResult(
                (),
                (0, 0),
                describe(drawing, config, chosen, scan.name),
                drawing.steps,
                (drawing.part.first, drawing.part.stop),
                drawing.thinned_by,
                drawing.counts,
                drawing.n_compared,
                drawing.n_differing,
            )
            pages = _pages(drawing)
            key = drawing.key
        else:
            from prc_cli.jobs.render.cloud import draw_cloud

            panel, key, result = draw_cloud(scan, config, chosen, scratch, progress)
            pages = [("", [panel])]
    return _write(
        output,
        scan.name,
        result,
        pages,
        key,
        max_height=chosen.height,
        overwrite=overwrite,
        inputs=inputs,
    )


def _decided(scan: Input, config: LoadedConfig, options: RenderOptions) -> LoadedConfig:
    """Return a configuration that names a method.

    It names PRC if the options ask for its steps, or if no method is needed.
    """
    if config.config.is_decided or options.view != "scan":
        return config
    steps = set(options.steps or ())
    of_prc = options.figure1 or options.block is not None or steps & set(PRC_STEPS)
    if of_prc or options.labels is not None or (steps and not steps - NOT_LABELLED):
        return decided_by(MethodChoice("urban", "its steps are asked for"), config)
    return decide(scan, config)


def _pages(drawing: Drawing) -> list[tuple[str, list[Panel]]]:
    # headings and panels
    pages = []
    per_page = drawing.strips_per_page
    part = drawing.part
    for first in range(0, len(drawing.strips), per_page):
        strips = drawing.strips[first : first + per_page]
        lines = [
            axis for strip in strips for axis in (strip[0].x, strip[0].y) if axis.name == "line"
        ]
        heading = f"lines {lines[0].first:,.0f} to {min(lines[-1].stop, part.stop) - 1:,.0f}"
        panels = [panel for strip in strips for panel in strip]
        pages.append((heading if len(drawing.strips) > per_page else "", panels))
    return pages


def _further_pages(output: Path) -> tuple[Path, ...]:
    """Return the further pages beside an output, in order; a killed run may have left them."""
    number = re.compile(re.escape(output.stem) + r"_([0-9]{1,6})" + re.escape(output.suffix))
    known = [
        (int(match[1]), path)
        for path in output.parent.glob("*")
        if (match := number.fullmatch(path.name))
    ]
    return tuple(path for _, path in sorted(known))


def _write(
    output: Path,
    name: str,
    result: RenderResult,
    pages: Sequence[tuple[str, list[Panel]]],
    key: Key,
    *,
    max_height: int,
    overwrite: bool,
    inputs: tuple[Path, ...],
) -> RenderResult:
    # all pages or none
    if output.suffix.lower() == ".html":
        text = html_page(name, result.drawn, pages, key, f"prc {__version__}")
        with atomic_output(output, overwrite=overwrite) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
        width = max(panel.size[0] for _, panels in pages for panel in panels)
        return replace(
            result,
            files=(output,),
            size=(width, sum(p.size[1] for _, panels in pages for p in panels)),
        )
    paths = [
        output,
        *(output.with_stem(f"{output.stem}_{number}") for number in range(2, len(pages) + 1)),
    ]
    prepare_outputs(*paths, overwrite=overwrite, inputs=inputs)
    size = (0, 0)
    single = len({(panel.x, panel.y) for _, panels in pages for panel in panels}) == 1
    with whole_set():
        for path, (heading, panels) in zip(paths, pages, strict=True):
            head = result.drawn if not heading else f"{result.drawn} · this page: {heading}"
            image = draw_sheet(
                head, panels, key, columns=choose_columns(panels, max_height) if single else 1
            )
            size = image.size if path is output else size
            with atomic_output(path, overwrite=overwrite) as temporary:
                image.save(temporary, format="PNG")
    return replace(result, files=tuple(paths), size=size)


__all__ = ["CAPTIONS", "COLOURS", "VIEWS", "RenderOptions", "RenderResult", "render"]
