"""The main job on embedded data: simulate a street, classify it, evaluate it, draw it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from prc_cli.classifiers.prc.pipeline import initial_state, trace_block
from prc_cli.comparison import evaluate
from prc_cli.config import LoadedConfig, to_toml
from prc_cli.core.classes import ClassCodes, Label
from prc_cli.core.errors import OutputError, OutputExistsError
from prc_cli.core.files import atomic_output
from prc_cli.core.types import U8
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.reports import as_json, as_markdown
from prc_cli.imaging.pictures import (
    label_picture,
    mask_picture,
    range_picture,
    segment_picture,
    stack_pictures,
    write_png,
)
from prc_cli.pipeline import Progress, RunSummary, classify
from prc_cli.readers.regroup import regroup
from prc_cli.simulation.street import StreetParams, StreetScan, simulate_street


@dataclass(frozen=True, slots=True)
class DemoResult:
    """What the demo made."""

    summary: RunSummary
    """The run that wrote the LAZ file."""
    matrix: ConfusionMatrix
    """Labels of the run against those of the simulator."""
    files: tuple[Path, ...]


def run_demo(
    folder: Path,
    config: LoadedConfig,
    params: StreetParams,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> DemoResult:
    """Simulate a street and take it through the whole program.

    Parameters
    ----------
    folder : Path
        Where the files go; created if it does not exist.
    config : LoadedConfig
        Parameters of the classifier.
    params : StreetParams
        Parameters of the street, its seed among them.
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
    street = simulate_street(params)
    stream, reference = folder / "street.npz", folder / "street_reference.npy"
    _write_street(street, stream, reference)
    with atomic_output(folder / "street.toml") as temporary:
        temporary.write_text(to_toml(config), encoding="utf-8", newline="\n")
    summary = classify(stream, folder / "street.laz", config, overwrite=overwrite, progress=progress)
    classify(stream, folder / "street_labels.npy", config, overwrite=overwrite)
    matrix = evaluate(folder / "street_labels.npy", reference, "prc")
    for name, text in (("evaluation.json", as_json(matrix)), ("evaluation.md", as_markdown(matrix))):
        with atomic_output(folder / name) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    _draw(street, config, folder / "street.png")
    return DemoResult(summary, matrix, tuple(sorted(folder.iterdir())))


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


def _write_street(street: StreetScan, stream: Path, reference: Path) -> None:
    """Write the stream as a range image and its reference labels as class codes, one a shot."""
    items = list(street.labelled_blocks())
    ranges = np.concatenate([item.block.range_m for item in items])
    codes = ClassCodes().lookup()[np.concatenate([item.labels for item in items])]
    time_s = np.arange(len(ranges)) / street.params.line_hz
    # numpy adds a suffix to names that lack its own, so the temporary file is given as a handle
    with atomic_output(stream) as temporary, temporary.open("wb") as handle:
        np.savez_compressed(handle, range_m=ranges, angle_deg=np.rad2deg(street.angle_rad), time_s=time_s)
    with atomic_output(reference) as temporary, temporary.open("wb") as handle:
        np.save(handle, codes.ravel())


def _draw(street: StreetScan, config: LoadedConfig, path: Path) -> None:
    """Draw the steps of the second block, as the paper's Fig. 1 does (Lehtola et al. 2019)."""
    params = config.config.prc
    state = initial_state(street.params.points_per_line)
    blocks = regroup(street.blocks(), params.lines_per_block)
    reference: list[U8] = []
    for index, block in enumerate(islice(blocks, 2)):
        trace = trace_block(block.range_m, block.next_m, state, params)
        state = trace.result.state
        shown, first, n_lines = trace, index * params.lines_per_block, block.n_lines
        ranges = block.range_m
    for item in street.labelled_blocks(lines=1):
        if item.block.first_line >= first + n_lines:
            break
        if item.block.first_line >= first:
            reference.append(item.labels)
    pictures = [
        ("range", range_picture(ranges)),
        ("supported (white), noise and missing (black)", mask_picture(shown.supported)),
        ("extended background (white)", mask_picture(shown.background)),
        ("smooth components H", segment_picture(shown.components.to_segments())),
        ("non-smooth patches V", segment_picture(shown.surfaces.to_patches())),
        ("classes", label_picture(shown.result.labels)),
        ("reference of the simulator", label_picture(np.concatenate(reference))),
    ]
    present = np.unique(np.concatenate([shown.result.labels.ravel(), np.concatenate(reference).ravel()]))
    write_png(path, stack_pictures(pictures, legend=[Label(label) for label in present]))
