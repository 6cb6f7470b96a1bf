"""``prc render``: pictures of a scan or a point cloud."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from prc_cli.config import LoadedConfig, MethodChoice, refuse_window, resolve
from prc_cli.core.errors import ConfigError
from prc_cli.core.files import atomic_output, prepare_outputs, temporary_folder
from prc_cli.formats.input import Input
from prc_cli.imaging.sheet import choose_columns, draw_sheet
from prc_cli.jobs.choice import decide, decided_by
from prc_cli.jobs.render.options import (
    PRC_STEPS,
    SUFFIX,
    RenderOptions,
    RenderResult,
)
from prc_cli.jobs.render.scan import NOT_LABELLED, describe, draw_scan
from prc_cli.jobs.run import Progress

MOST_HEIGHT = 6000
"""Highest page, if its pictures fit beside each other [pixels]."""


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
        ``.png``.
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
        Unknown step, view or suffix of the output; lines out of range.
    InputError
        Damaged input; labels of another length; no coordinates for a cloud.
    OutputError
        When it cannot be written; nothing is left behind.
    """
    scan, config = resolve(source, config)
    output = Path(output)
    chosen = RenderOptions() if options is None else options
    if output.suffix.lower() != SUFFIX:
        problem = f"found the suffix {output.suffix!r}, expected {SUFFIX}"
        raise ConfigError(str(output), problem, "for a page to look around in: OUT.html")
    inputs = config.inputs(scan.path, chosen.labels, chosen.reference)
    prepare_outputs(output, overwrite=overwrite, inputs=inputs)
    scan.check()
    refuse_window(config.config, "prc render")
    config = _decided(scan, config, chosen)
    with temporary_folder("prc-render-") as scratch:
        if not chosen.is_from_above:
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
            panels = drawing.panels
            image = draw_sheet(result.drawn, panels, columns=choose_columns(panels, MOST_HEIGHT))
        else:
            from prc_cli.jobs.render.cloud import draw_cloud

            panel, key, result = draw_cloud(scan, config, chosen, scratch, progress)
            image = draw_sheet(result.drawn, [panel], key)
    with atomic_output(output, overwrite=overwrite) as temporary:
        image.save(temporary, format="PNG")
    return replace(result, files=(output,), size=image.size)


def _decided(scan: Input, config: LoadedConfig, options: RenderOptions) -> LoadedConfig:
    """Return a configuration that names a method.

    It names PRC if the options ask for its steps, or if no method is needed.
    """
    if config.config.is_decided or options.is_from_above:
        return config
    steps = set(options.steps or ())
    of_prc = options.is_figure1 or steps & set(PRC_STEPS)
    if of_prc or options.labels is not None or (steps and not steps - NOT_LABELLED):
        return decided_by(MethodChoice("prc-2019-urban", "its steps are asked for"), config)
    return decide(scan, config)


__all__ = ["RenderOptions", "RenderResult", "render"]
