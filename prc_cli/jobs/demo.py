"""``prc demo``: simulate, classify, evaluate and draw a scan for every method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from prc_cli.config import LoadedConfig, load_config, to_toml
from prc_cli.core.errors import OutputError, OutputExistsError
from prc_cli.core.files import atomic_output
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.reports import as_json, as_markdown
from prc_cli.jobs.classify import Progress, RunSummary, classify
from prc_cli.jobs.evaluate import evaluate
from prc_cli.jobs.render import RenderOptions, render
from prc_cli.jobs.simulate import Beside, simulate
from prc_cli.simulation.settings import Kind, load_settings


@dataclass(frozen=True, slots=True)
class Part:
    """A scan of the demo, and how it is processed."""

    kind: Kind
    """What is simulated."""
    stem: str
    """Prefix of its file names."""
    preset: str | None
    """Parameters of the classifier; None = the method is chosen for the scan, as where nothing is typed."""
    mapping: str
    """Class mapping of the evaluation."""
    picture: RenderOptions
    options: Mapping[str, Any]
    """Options of the simulation, without the seed."""
    scan_of: str = ""
    """Name of an earlier part whose scan is used; empty = its own scan."""


PARTS: dict[str, Part] = {
    # houses with and without gardens
    "drive": Part(
        "street",
        "street",
        None,
        "prc",
        RenderOptions(steps=("range", "classes", "reference")),
        {"lines": 600, "scene": {"name": "suburb"}},
    ),
    # the same drive, for the comparison: the steps of one block, as the paper's Fig. 1 shows them (Lehtola et al. 2019)
    "published": Part("street", "urban", "urban", "prc", RenderOptions(figure1=True), {}, scan_of="drive"),
    # every third line, and as close along the line as curbs need
    "static": Part(
        "street-scan",
        "static_scan",
        "street-scan",
        "street_scan",
        RenderOptions(steps=("range", "coarse", "classes", "reference")),
        {"scanner": {"azimuth_step_deg": 0.46, "points_per_line": 544}},
    ),
    # as far as one sees in a wood
    "walk": Part(
        "forest",
        "forest",
        None,
        "prc",
        RenderOptions(steps=("range", "classes", "reference")),
        {"lines": 255, "sight_m": 40.0},
    ),
}
"""A drive, classified by default and with PRC as published; a static scan, classified with the sequential-angle
classifier; and a walk in a forest, classified by default."""


@dataclass(frozen=True, slots=True)
class DemoPart:
    """Results of one part."""

    summary: RunSummary
    """The run that wrote the LAZ file, or the labels where there is none."""
    matrix: ConfusionMatrix
    """Labels of the run against those of the simulator."""


@dataclass(frozen=True, slots=True)
class DemoResult:
    """Results of the demo."""

    parts: Mapping[str, DemoPart]
    """By the names of :data:`PARTS`."""
    files: tuple[Path, ...]


def run_demo(
    folder: Path,
    *,
    seed: int = 1,
    lines: int | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> DemoResult:
    """Simulate the scans of :data:`PARTS`, then classify, evaluate and draw them.

    Parameters
    ----------
    folder : Path
        Output folder; created if it does not exist.
    seed : int
        Seed of the simulated scenes.
    lines : int, optional
        Scan lines of the drive.
    overwrite : bool
        Use a folder that is there already and holds files.
    progress : callable, optional
        Called with the number of lines that were just classified.

    Raises
    ------
    OutputExistsError
        When the folder holds files already.
    OutputError
        When it cannot be written.
    """
    _prepare(folder, overwrite=overwrite)
    found: dict[str, DemoPart] = {}
    for name, part in PARTS.items():
        options = {**part.options, "seed": seed}
        if name == "drive" and lines is not None:
            options["lines"] = lines
        found[name] = _run(folder, part, options, overwrite, progress)
    return DemoResult(found, tuple(sorted(folder.iterdir())))


def _run(folder: Path, part: Part, options: Mapping[str, Any], overwrite: bool, progress: Progress | None) -> DemoPart:
    """Simulate, classify into LAZ and labels, compare the labels with the simulator's, draw.

    The scan of an earlier part exists already, and its LAZ file is not written again.
    """
    scan = PARTS[part.scan_of] if part.scan_of else part
    stream, reference = folder / f"{scan.stem}.npz", folder / f"{scan.stem}_reference.npy"
    labels = folder / f"{part.stem}_labels.npy"
    config = load_config(preset=part.preset)
    if part.scan_of:
        summary = classify(stream, labels, config, overwrite=overwrite, progress=progress)
    else:
        settings = load_settings(part.kind, options=options)
        simulate(part.kind, stream, settings, beside=Beside(labels=reference), overwrite=overwrite)
        summary = classify(stream, stream.with_suffix(".laz"), config, overwrite=overwrite, progress=progress)
        classify(stream, labels, config, overwrite=overwrite)
    result = DemoPart(summary, evaluate(labels, reference, part.mapping))
    _write_texts(folder, part, config, result.matrix)
    render(stream, folder / f"{part.stem}.png", config, replace(part.picture, reference=reference), overwrite=overwrite)
    return result


def _write_texts(folder: Path, part: Part, config: LoadedConfig, matrix: ConfusionMatrix) -> None:
    """Write the configuration and the tables; those of the drive have no prefix."""
    prefix = "" if part.stem == "street" else f"{part.stem}_"
    texts = {
        f"{part.stem}.toml": to_toml(config),
        f"{prefix}evaluation.json": as_json(matrix),
        f"{prefix}evaluation.md": as_markdown(matrix),
    }
    for name, text in texts.items():
        with atomic_output(folder / name, overwrite=True) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")


def _prepare(folder: Path, *, overwrite: bool) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        taken = any(folder.iterdir())
    except OSError as error:
        problem = f"cannot be used as the demo's folder ({error.strerror})"
        raise OutputError(str(folder), problem, "choose another with --output") from error
    if taken and not overwrite:
        problem = "holds files already"
        raise OutputExistsError(str(folder), problem, "choose another with --output, or add --overwrite")
