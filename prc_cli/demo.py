"""The main job on embedded data, once for either classifier: simulate a street, classify it, evaluate it, draw it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prc_cli.comparison import evaluate
from prc_cli.config import LoadedConfig, to_toml
from prc_cli.core.classes import ClassCodes
from prc_cli.core.errors import OutputError, OutputExistsError
from prc_cli.core.files import atomic_output
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.reports import as_json, as_markdown
from prc_cli.pipeline import Progress, RunSummary, classify
from prc_cli.rendering import RenderOptions, render
from prc_cli.simulation.static_scan import StaticScan, StaticScanParams, simulate_static_scan
from prc_cli.simulation.street import StreetParams, StreetScan, simulate_street

STATIC = StaticScanParams(azimuth_step_deg=0.5, elevation_step_deg=0.25)
"""The static scan of the demo: small, but with shots close enough together for curbs."""


@dataclass(frozen=True, slots=True)
class DemoPart:
    """What came out of one classifier."""

    summary: RunSummary
    """The run that wrote the LAZ file."""
    matrix: ConfusionMatrix
    """Labels of the run against those of the simulator."""


@dataclass(frozen=True, slots=True)
class DemoResult:
    """What the demo made."""

    drive: DemoPart
    """A drive down the street, classified with PRC."""
    static: DemoPart
    """A static scan of a street, classified with the sequential-angle classifier."""
    files: tuple[Path, ...]


def run_demo(
    folder: Path,
    config: LoadedConfig,
    params: StreetParams,
    *,
    static_config: LoadedConfig,
    static_params: StaticScanParams = STATIC,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> DemoResult:
    """Simulate a drive and a static scan and take them through the whole program.

    Parameters
    ----------
    folder : Path
        Where the files go; created if it does not exist.
    config : LoadedConfig
        Parameters of PRC.
    params : StreetParams
        Parameters of the drive, its seed among them.
    static_config : LoadedConfig
        Parameters of the sequential-angle classifier.
    static_params : StaticScanParams
        Parameters of the static scan.
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
    drive = _classify_drive(folder, config, simulate_street(params), overwrite, progress)
    static = _classify_static(folder, static_config, simulate_static_scan(static_params), overwrite, progress)
    return DemoResult(drive, static, tuple(sorted(folder.iterdir())))


def _classify_drive(
    folder: Path, config: LoadedConfig, street: StreetScan, overwrite: bool, progress: Progress | None
) -> DemoPart:
    stream, reference = folder / "street.npz", folder / "street_reference.npy"
    _write_street(street, stream, reference)
    part = _classify(stream, reference, config, "prc", overwrite, progress)
    _write_texts(folder, "", config, part)
    # the steps of the second block, as the paper's Fig. 1 shows them (Lehtola et al. 2019)
    options = RenderOptions(figure1=True, reference=reference)
    render(stream, folder / "street.png", config, options, overwrite=overwrite)
    return part


def _classify_static(
    folder: Path, config: LoadedConfig, scan: StaticScan, overwrite: bool, progress: Progress | None
) -> DemoPart:
    stream, reference = folder / "static_scan.npz", folder / "static_scan_reference.npy"
    _write_static(scan, stream, reference)
    part = _classify(stream, reference, config, "street_scan", overwrite, progress)
    _write_texts(folder, "static_scan_", config, part)
    options = RenderOptions(steps=("range", "coarse", "classes", "reference"), reference=reference)
    render(stream, folder / "static_scan.png", config, options, overwrite=overwrite)
    return part


def _classify(
    stream: Path, reference: Path, config: LoadedConfig, mapping: str, overwrite: bool, progress: Progress | None
) -> DemoPart:
    """Write LAZ and labels beside the stream, and compare the labels with the simulator's."""
    labels = stream.with_name(f"{stream.stem}_labels.npy")
    summary = classify(stream, stream.with_suffix(".laz"), config, overwrite=overwrite, progress=progress)
    classify(stream, labels, config, overwrite=overwrite)
    return DemoPart(summary, evaluate(labels, reference, mapping))


def _write_texts(folder: Path, prefix: str, config: LoadedConfig, part: DemoPart) -> None:
    """Write the configuration and the tables."""
    texts = {
        f"{prefix.removesuffix('_') or 'street'}.toml": to_toml(config),
        f"{prefix}evaluation.json": as_json(part.matrix),
        f"{prefix}evaluation.md": as_markdown(part.matrix),
    }
    for name, text in texts.items():
        with atomic_output(folder / name) as temporary:
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


def _write_static(scan: StaticScan, stream: Path, reference: Path) -> None:
    """Write a static scan as ranges and places relative to the scanner, and its reference labels as class codes."""
    items = list(scan.labelled_blocks())
    codes = ClassCodes().lookup()[np.concatenate([item.labels for item in items])]
    with atomic_output(stream) as temporary, temporary.open("wb") as handle:
        np.savez_compressed(
            handle,
            range_m=np.concatenate([item.block.range_m for item in items]),
            xyz=np.concatenate([item.block.xyz_m for item in items if item.block.xyz_m is not None]),
            zenith_deg=90.0 - np.rad2deg(scan.elevation_rad),
        )
    with atomic_output(reference) as temporary, temporary.open("wb") as handle:
        np.save(handle, codes.ravel())
