"""``prc demo``: simulates, classifies, evaluates and draws a drive along a street.

``--all`` adds a scan for every method.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from prc_cli.config import load_config, to_toml
from prc_cli.core.errors import OutputError, OutputExistsError
from prc_cli.core.files import (
    atomic_output,
    discard,
    name_folder,
    remove_unfinished,
    temporary_name,
)
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.html import as_html
from prc_cli.evaluation.mapping import load_mapping
from prc_cli.jobs.classify import classify
from prc_cli.jobs.evaluate import evaluate_all
from prc_cli.jobs.evaluate.pictures import class_pictures
from prc_cli.jobs.render import RenderOptions, render
from prc_cli.jobs.render.colours import origin
from prc_cli.jobs.render.viewer import render_viewer
from prc_cli.jobs.run import Progress, RunSummary
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.simulation.settings import Kind, load_settings


@dataclass(frozen=True, slots=True)
class Part:
    """A scan of the demo, and how it is processed."""

    kind: Kind
    """Kind of simulation."""
    stem: str
    """Prefix of its file names."""
    preset: str | None
    """Parameters of the classifier; None = prc chooses the method."""
    mapping: str
    """Class mapping of the evaluation."""
    picture: RenderOptions
    options: Mapping[str, Any]
    """Options of the simulation, without the seed."""
    scan_of: str = ""
    """Name of an earlier part whose scan is used; empty = its own scan."""


_PICTURE = RenderOptions(steps=("range", "classes", "reference"))
PARTS: dict[str, Part] = {
    # houses with and without gardens
    "drive": Part(
        "street", "street", None, "street", _PICTURE, {"lines": 600, "scene": {"name": "suburb"}}
    ),
    # the same drive, for the comparison: the steps of one block, as the paper's Fig. 1 shows them
    # (Lehtola et al. 2019)
    "published": Part(
        "street",
        "urban",
        "prc-2019-urban",
        "prc",
        RenderOptions(steps=("figure1",)),
        {},
        scan_of="drive",
    ),
    # every third line, and as close along the line as curbs need
    "static": Part(
        "street-scan",
        "static_scan",
        "street-scan",
        "street_scan",
        _PICTURE,
        {"scanner": {"azimuth_step_deg": 0.46, "points_per_line": 544}},
    ),
    # as far as one sees in a wood
    "walk": Part("forest", "forest", None, "prc", _PICTURE, {"lines": 255, "sight_m": 40.0}),
}
"""Parts of the demo.

A drive with the default method and with PRC as published, a static scan with sequential-angle, and
a walk in a forest with the default method.
"""
MAIN = ("drive",)
"""Parts without ``--all``."""


@dataclass(frozen=True, slots=True)
class DemoPart:
    """Results of one part."""

    summary: RunSummary
    """The run that wrote the LAZ file, or the labels if there is no LAZ file."""
    matrix: ConfusionMatrix
    """Labels of the run against those of the simulator."""


@dataclass(frozen=True, slots=True)
class DemoResult:
    """Results of the demo."""

    parts: Mapping[str, DemoPart]
    """By the names of :data:`PARTS`."""
    files: tuple[Path, ...]
    """In the folder, without those of :data:`MORE`."""


MORE = "more"
"""Folder inside the demo's with labels and configurations, and the other scans and methods."""


def run_demo(
    folder: Path,
    *,
    parts: Iterable[str] = MAIN,
    seed: int = 1,
    lines: int | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> DemoResult:
    """Simulate, classify, evaluate and draw some of :data:`PARTS`.

    The files of the drive are in the folder, all others in :data:`MORE`.
    """
    with _prepared(folder, overwrite=overwrite) as place:
        (place / MORE).mkdir(exist_ok=True)
        results: dict[str, DemoPart] = {}
        for name in parts:
            part = PARTS[name]
            options = {**part.options, "seed": seed}
            if name == "drive" and lines is not None:
                options["lines"] = lines
            results[name] = _run(place, part, options, overwrite, progress)
    return DemoResult(results, tuple(sorted(path for path in folder.iterdir() if path.is_file())))


def _run(
    folder: Path,
    part: Part,
    options: Mapping[str, Any],
    overwrite: bool,
    progress: Progress | None,
) -> DemoPart:
    more = folder / MORE
    scan = PARTS[part.scan_of] if part.scan_of else part
    shown = _folder_of(part, folder)
    stream = _folder_of(scan, folder) / f"{scan.stem}.npz"
    reference = more / f"{scan.stem}_reference.npy"
    labels = more / f"{part.stem}_labels.npy"
    config = load_config(preset=part.preset)
    path = more / f"{scan.stem}_path.csv"
    settings = load_settings(scan.kind, options=options)
    if part.scan_of:
        summary = classify(stream, labels, config, overwrite=overwrite, progress=progress)
    else:
        beside = Beside(labels=reference, trajectory=path if part is PARTS["drive"] else None)
        simulate(part.kind, stream, settings, beside=beside, overwrite=overwrite)
        summary = classify(
            stream,
            stream.parent / f"{scan.stem}.laz",
            config,
            overwrite=overwrite,
            progress=progress,
        )
        classify(stream, labels, config, overwrite=overwrite)
    evaluation = evaluate_all([labels], [reference], part.mapping)
    mapping = load_mapping(part.mapping)
    pictures = class_pictures(
        labels, reference, mapping, summary.record.points_per_line, points=(stream, None)
    )
    # the page may be read on another machine: names without folders
    named = replace(evaluation, predicted=(labels.name,), reference=(reference.name,))
    page = as_html(named, mapping=mapping, pictures=pictures, origin=origin([labels]))
    _write_text(shown / f"{part.stem}_report.html", page)
    _write_text(more / f"{part.stem}.toml", to_toml(config))
    render(
        stream,
        shown / f"{part.stem}.png",
        config,
        replace(part.picture, reference=reference),
        overwrite=overwrite,
    )
    if part is PARTS["drive"]:
        # classified again for the heights above ground; the poses are only for the view
        mount = (0.0, settings.scanner.slant_deg, settings.scanner.heading_deg)
        placed = RenderOptions(trajectory=path, mount=mount)
        render_viewer(stream, folder / f"{part.stem}.html", config, placed, overwrite=overwrite)
    return DemoPart(summary, evaluation.matrix)


def _folder_of(part: Part, folder: Path) -> Path:
    return folder if part is PARTS["drive"] else folder / MORE


def _write_text(path: Path, text: str) -> None:
    with atomic_output(path, overwrite=True) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


@contextmanager
def _prepared(folder: Path, *, overwrite: bool) -> Iterator[Path]:
    """Give the folder to fill; a new folder gets its name when it is complete."""
    has_files = False
    is_new = not os.path.lexists(folder)
    try:
        if is_new:
            folder.parent.mkdir(parents=True, exist_ok=True)
            remove_unfinished(folder)
            temporary = temporary_name(folder)
            temporary.mkdir()
        else:
            has_files = any(folder.iterdir())
    except OSError as error:
        problem = f"cannot be used as the demo's folder ({error.strerror})"
        raise OutputError(str(folder), problem, "choose another with --output") from error
    if has_files and not overwrite:
        problem = "the folder contains files"
        raise OutputExistsError(
            str(folder), problem, "choose another with --output, or add --overwrite"
        )
    if not is_new:
        yield folder
        return
    try:
        yield temporary
        name_folder(temporary, folder)
    finally:
        discard(temporary)
