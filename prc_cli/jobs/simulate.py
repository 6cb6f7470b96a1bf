"""``prc simulate``: writes simulated scans to files.

A scene, a scanner and its platform produce a stream, some lines at a time. The stream is written to
any format of ``prc convert``, with the reference class of every shot. Memory does not grow with the
length of the drive.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

import numpy as np

from prc_cli.core.classes import LABEL_NAMES, Label
from prc_cli.core.errors import ConfigError
from prc_cli.core.files import atomic_output, whole_set
from prc_cli.core.threads import write_behind
from prc_cli.core.types import F64, U8
from prc_cli.formats import LAS_SUFFIXES
from prc_cli.formats.bags import BAG
from prc_cli.formats.outputs import (
    BESIDE,
    open_stream_writer,
    outputs_of,
    prepare_stream_output,
    stream_format,
    stream_suffix,
)
from prc_cli.formats.raw_binary.write import FrameFolder
from prc_cli.formats.registry import format_of
from prc_cli.formats.trajectory import SBET_SUFFIXES
from prc_cli.formats.writing.base import StreamItem, StreamShape
from prc_cli.formats.writing.disk import NpyFile
from prc_cli.formats.writing.record import ClassCount, Fingerprint, RunRecord
from prc_cli.jobs.run import Counts, Progress, RunSummary
from prc_cli.simulation.drive import SimulatedBlock
from prc_cli.simulation.forest.scene import ForestScene
from prc_cli.simulation.scanners import Scanner
from prc_cli.simulation.settings import (
    Kind,
    Settings,
    Simulation,
    StationSettings,
    load_settings,
    open_simulation,
)
from prc_cli.simulation.trajectory import WORLD, Frame, Trajectory, check_frame, write_trajectory

TRAJECTORY_HZ = 200.0
"""Positions per second in trajectory files."""
STEM_MARGIN_M = 30.0
"""Greatest distance of listed trees from the path [m]."""
STEM_STEP_M = 10.0
"""Spacing of the places along the path from which trees are searched [m]."""


@dataclass(frozen=True, slots=True, repr=False)
class SimulationSummary(RunSummary):
    """Summary of a simulation; the record has parameters, seed, version and classes."""

    files: tuple[Path, ...] = ()
    """All files written, including the run record."""

    def as_dict(self) -> dict[str, object]:
        """Return the run record with the names of the files, for JSON."""
        return {**self.record.as_dict(), "files": [str(path) for path in self.files]}


@dataclass(frozen=True, slots=True)
class Beside:
    """Additional output files, each written only if it has a name."""

    trajectory: Path | None = None
    """Trajectory of the scanner: ``.sbet`` or ``.out`` for SBET, ``.csv``."""
    labels: Path | None = None
    """``.npy``: the reference class of every record; the default if the output has no classes."""
    stems: Path | None = None
    """``.csv``: the trees beside the path."""
    frames: Path | None = None
    """Folder of KITTI frames: turns of a spinning scanner with classes, poses and times."""

    def paths(self) -> tuple[Path, ...]:
        """Return the files that have a name."""
        return tuple(
            path for path in (self.trajectory, self.labels, self.stems) if path is not None
        )


def simulate(
    kind: Kind,
    output: Path | str,
    settings: Settings | None = None,
    *,
    beside: Beside | None = None,
    reference: Literal["truth", "cylinders"] = "truth",
    threads: int | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> SimulationSummary:
    """Simulate a scan into files, which are complete or absent.

    Parameters
    ----------
    kind : {"street", "forest", "street-scan"}
        What is simulated.
    output : path
        ``.las .laz .csv .csv.gz .csv.zst .parquet .npz .npy .bin .bag .db3 .mcap``. Point
        clouds and tables have the registered coordinates of every return, from the true pose.
    settings : optional
        From :func:`load_settings`.
    beside : Beside, optional
        Names of further files.
    reference : {"truth", "cylinders"}
        As :func:`open_simulation`.
    threads : int, optional
        Default: one per core. The output does not depend on it.
    overwrite : bool
        Replace existing outputs.
    progress : callable, optional
        Called with the number of scan lines that were just finished.

    Returns
    -------
    SimulationSummary

    Raises
    ------
    ConfigError, OutputError
        See :mod:`prc_cli.core.errors`; nothing is left behind.
    """
    output = Path(output)
    form = stream_format(output)
    chosen = load_settings(kind) if settings is None else settings
    files = check_simulation(kind, output, chosen.scanner, beside, overwrite=overwrite)
    frame = _frame(chosen, files)
    check_frame(files.trajectory or output, frame)
    is_static = chosen.scanner.is_static
    # the direction of a ring does not follow from its line
    in_cells = chosen.scanner.spins and "relative" in form.holds and not form.holds_all
    simulation = open_simulation(
        kind,
        chosen,
        reference=reference,
        threads=threads,
        with_xyz=is_static or files.frames is not None or in_cells,
        with_world=not is_static and (form.holds_all or reference == "cylinders"),
    )
    with whole_set(), contextlib.ExitStack() as stack:
        if files.trajectory is not None:
            temporary = stack.enter_context(atomic_output(files.trajectory))
            platform = simulation.scan.platform
            end_s = simulation.end_s
            write_trajectory(
                files.trajectory, platform, end_s, hz=TRAJECTORY_HZ, frame=frame, into=temporary
            )
        if files.stems is not None:
            temporary = stack.enter_context(atomic_output(files.stems))
            temporary.write_text(
                "".join(f"{row}\n" for row in _stem_rows(simulation)),
                encoding="utf-8",
                newline="\n",
            )
        codes_file: NpyFile | None = None
        if files.labels is not None:
            handle = stack.enter_context(
                stack.enter_context(atomic_output(files.labels)).open("w+b")
            )
            codes_file = NpyFile(handle, "|u1")
        frames = None if files.frames is None else stack.enter_context(FrameFolder(files.frames))
        record, counts = _write(simulation, output, codes_file, frame, frames, progress)
    written = (*outputs_of(output), *files.paths())
    return SimulationSummary(output, record, counts, files=written)


def _write(
    simulation: Simulation,
    output: Path,
    codes_file: NpyFile | None,
    frame: Frame,
    frames: FrameFolder | None,
    progress: Progress | None,
) -> tuple[RunRecord, Counts]:
    scan = simulation.scan
    form = stream_format(output)
    lookup = simulation.settings.classes.lookup()
    counts = Counts.none()
    shape = StreamShape(
        points_per_line=scan.scanner.points_per_line,
        scanners=False,
        returns=scan.scanner.max_returns > 1 and "returns" in form.holds,
        angles=True,
        times=True,
        xyz=scan.with_xyz,
        registered=scan.with_world and not scan.with_xyz and form.holds_all,
        intensity=True,
        codes=True,
        down_rad=scan.info.down_rad,
        crs=frame.crs,
    )
    with open_stream_writer(output, shape) as writer:

        def put(simulated: SimulatedBlock) -> None:
            item = _item(simulated, lookup, frame.origin() if shape.registered else None)
            writer.add_item(item)
            if codes_file is not None:
                codes_file.append(codes_in_order(item, output))
            if frames is not None:
                frames.add(item, _pose_of(simulation, item))

        with write_behind(put) as queue:
            for simulated in scan.simulated():
                queue.put(simulated)
                counts = counts.add(simulated.labelled)
                if progress is not None:
                    progress(simulated.labelled.block.n_lines)
        record = _record(simulation, counts)
        texts = _notices(output, counts.n_extra, frame.crs if shape.registered else None)
        record = writer.finish(replace(record, notices=(*record.notices, *writer.losses, *texts)))
        if codes_file is not None:
            codes_file.finish()
        if frames is not None:
            frames.finish()
    return record, counts


def _notices(output: Path, n_extra: int, registered_crs: str | None) -> Iterator[str]:
    form = stream_format(output)
    suffix = stream_suffix(output)
    if n_extra and "returns" not in form.holds:
        yield f"not kept: {n_extra} further returns: a range image has one range a cell"
    if form.is_dump:
        yield f"read it with --config {output.name}.toml"
    if registered_crs:
        text = f"registered coordinates are those of {registered_crs}"
        if suffix in LAS_SUFFIXES and find_spec("pyproj") is None:
            text += '; the file does not name it without pyproj: pip install ".[crs]"'
        yield text
    if format_of(output) is None:
        yield f"prc reads no stream from {suffix}; it is for other programs"


def _pose_of(simulation: Simulation, item: StreamItem) -> F64:
    # (4, 4), position and orientation of the scanner in the middle of the time of a block
    time_s = item.block.time_s
    assert time_s is not None
    pose = simulation.scan.platform.pose(np.array([(time_s[0].min() + time_s[-1].max()) / 2.0]))
    matrix = np.eye(4)
    matrix[:3, :3] = pose.turn()[0]
    matrix[:3, 3] = pose.position[0]
    return matrix


def _item(simulated: SimulatedBlock, lookup: U8, origin_m: F64 | None) -> StreamItem:
    labelled = simulated.labelled
    item = StreamItem(
        labelled.block,
        codes=lookup[labelled.labels].astype(np.int32),
        extra_codes=lookup[labelled.extra_labels].astype(np.int32),
    )
    if origin_m is None or simulated.world_m is None or simulated.extra_world_m is None:
        return item
    return replace(
        item,
        registered_m=simulated.world_m + origin_m,
        extra_registered_m=simulated.extra_world_m + origin_m,
    )


def codes_in_order(item: StreamItem, output: Path) -> U8:
    """Return the class codes of the records of an output, (records,) uint8; 0 = no return."""
    assert item.codes is not None
    assert item.extra_codes is not None
    block = item.block
    codes = item.codes.ravel()
    extra = block.extra
    suffix = stream_suffix(output)
    if "returns" not in stream_format(output).holds or not len(extra):
        if suffix in LAS_SUFFIXES:
            codes = codes[~np.isnan(block.range_m.ravel())]
        return codes.astype(np.uint8)
    # further returns follow the main return of their shot, nearer ones first
    cell = extra.line.astype(np.int64) * block.points_per_line + extra.column
    main = np.arange(len(codes))
    extra_rank: F64 = np.zeros(len(cell))
    if suffix in LAS_SUFFIXES:
        main = np.flatnonzero(~np.isnan(block.range_m.ravel()))
        extra_rank = extra.range_m.astype(np.float64)
    shot = np.concatenate([main, cell])
    rank = np.concatenate([np.full(len(main), -np.inf), extra_rank])
    order = np.lexsort((np.arange(len(shot)), rank, shot))
    return np.concatenate([codes[main], item.extra_codes])[order].astype(np.uint8)


def _record(simulation: Simulation, counts: Counts) -> RunRecord:
    settings = simulation.settings
    scan = simulation.scan
    table = {"kind": simulation.kind, **settings.model_dump(mode="json", exclude_none=True)}
    text = json.dumps(table, sort_keys=True).encode()
    codes = settings.classes
    classes = tuple(
        ClassCount(codes.code(label), LABEL_NAMES[label], int(counts.labels[label]))
        for label in Label
        if counts.labels[label] and label is not Label.MISSING
    )
    return RunRecord(
        config={"simulation": table},
        # there is no input file: the input is the parameters of the simulation
        input=Fingerprint(scan.name, len(text), hashlib.sha256(text).hexdigest()),
        format="simulation",
        points_per_line=scan.scanner.points_per_line,
        n_lines=counts.n_lines,
        n_records=counts.n_shots,
        n_missing=int(counts.labels[Label.MISSING]),
        assumptions=scan.info.assumptions,
        classes=classes,
    )


def _frame(settings: Settings, beside: Beside) -> Frame:
    # as configured, or the default frame for an SBET
    configured = None if isinstance(settings, StationSettings) else settings.frame
    if configured is not None:
        return configured
    is_sbet = beside.trajectory is not None and beside.trajectory.suffix.lower() in SBET_SUFFIXES
    return Frame() if is_sbet else WORLD


def check_simulation(
    kind: Kind,
    output: Path,
    scanner: Scanner,
    beside: Beside | None = None,
    *,
    overwrite: bool = False,
) -> Beside:
    """Refuse outputs before any work is done."""
    beside = beside or Beside()
    form = stream_format(output)
    # if the output cannot have classes that prc reads, they go to a file beside it
    has_codes = "codes" in form.holds and format_of(output, "codes") is not None
    if beside.labels is None and not has_codes:
        beside = replace(beside, labels=reference_path(output))
    if form.name == BAG and (scanner.is_static or beside.labels is not None):
        refused = "labels beside it, which it holds itself"
        if scanner.is_static:
            refused = "a scan from a tripod"
        hint = "write .npz, or leave out what it cannot hold"
        raise ConfigError(str(output), f"a bag, asked for {refused}", hint)
    if beside.stems is not None and kind != "forest":
        raise ConfigError("stems", f"asked for in a {kind}, which has none", "leave it out")
    if beside.trajectory is not None and kind == "street-scan":
        raise ConfigError(
            "trajectory", "asked for of a tripod, which does not move", "leave it out"
        )
    if beside.frames is not None and not scanner.spins:
        raise ConfigError(
            "frames", "asked for of a scanner that does not spin", "choose --scanner vlp-16"
        )
    for name, suffixes in BESIDE.items():
        path = getattr(beside, name)
        if path is not None and path.suffix.lower() not in suffixes:
            problem = f"found suffix {path.suffix!r}, expected {' or '.join(suffixes)}"
            raise ConfigError(str(path), problem, f"write the {name} under such a name")
    paths = [path.absolute() for path in (*outputs_of(output), *beside.paths())]
    if len(set(paths)) < len(paths):
        raise ConfigError(str(output), "two of the files that are to be written have one name")
    folders = () if beside.frames is None else (beside.frames,)
    prepare_stream_output(output, *beside.paths(), overwrite=overwrite, folders=folders)
    return beside


def reference_path(output: Path) -> Path:
    """Return the file for the reference classes of an output that cannot hold them.

    >>> reference_path(Path("drive.laz")).name
    'drive_reference.npy'
    """
    return output.with_name(f"{output.stem}_reference.npy")


def _stem_rows(simulation: Simulation) -> Iterator[str]:
    # lines of CSV, every tree once
    scene = simulation.scene
    platform = simulation.scan.platform
    assert isinstance(scene, ForestScene)
    assert isinstance(platform, Trajectory)
    length_m = float(platform.progress(np.array([simulation.end_s])).distance[0])
    seen: set[bytes] = set()
    for number, s_m in enumerate(np.arange(0.0, length_m + STEM_STEP_M, STEM_STEP_M)):
        point, _ = scene.path_point(np.array([s_m]))
        stems = scene.stems_near(float(point[0, 0]), float(point[0, 1]), STEM_MARGIN_M)
        fresh = np.array([place.tobytes() not in seen for place in stems.base], np.bool_)
        seen.update(place.tobytes() for place in stems.base)
        rows = stems.take(fresh).rows()
        header = next(rows)
        if not number:
            yield header
        yield from rows
