"""Whole simulated scans to files: ``prc simulate``.

A scene, a scanner and what carries it become a stream, some lines at a time, and the stream becomes any file that
``prc convert`` writes, with the reference class of every shot. Memory does not grow with the length of the drive.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Literal, TypeAlias

import numpy as np
from pydantic import Field

from prc_cli.core.classes import LABEL_NAMES, ClassCodes, Label
from prc_cli.core.config import Params, build, merge, read_toml
from prc_cli.core.errors import ConfigError
from prc_cli.core.files import atomic_output, check_output, remove_stale
from prc_cli.core.threads import default_threads, write_behind
from prc_cli.core.types import F64, U8
from prc_cli.pipeline import Counts, Progress
from prc_cli.simulation.drive import (
    MOST_LINES,
    BodiesNear,
    SimulatedBlock,
    SimulatedScan,
    ground_below,
    lines_of,
    room_around,
)
from prc_cli.simulation.forest.params import PRESETS as FORESTS
from prc_cli.simulation.forest.params import ForestSceneParams
from prc_cli.simulation.forest.reference import reference_labels
from prc_cli.simulation.forest.scene import ForestScene
from prc_cli.simulation.scanners import SCANNERS, Scanner
from prc_cli.simulation.street.params import CHARACTERS, StreetSceneParams
from prc_cli.simulation.street.scene import StreetScene
from prc_cli.simulation.trajectory import MOTIONS, MotionParams, Station, Trajectory
from prc_cli.simulation.trajectory_files import WORLD, Frame, write_trajectory
from prc_cli.writers.record import ClassCount, Fingerprint, RunRecord
from prc_cli.writers.streams import (
    StreamItem,
    StreamShape,
    check_stream_output,
    open_stream_writer,
    outputs_of,
    stream_suffix,
)

Kind: TypeAlias = Literal["street", "forest", "street-scan"]

SCENES: dict[Kind, dict[str, dict[str, Any]]] = {
    "street": {"mixed": {}, **{name: {"character": name} for name in CHARACTERS}},
    "forest": {name: params.model_dump() for name, params in FORESTS.items()},
}
SCENES["street-scan"] = SCENES["street"]
"""Parameters of scenes by name."""

_DEFAULTS: dict[Kind, dict[str, str]] = {
    "street": {"scene": "mixed", "scanner": "photon-80", "trajectory": "car"},
    "forest": {"scene": "mixed", "scanner": "focus3d-120", "trajectory": "backpack"},
    "street-scan": {"scene": "mixed", "scanner": "scanstation2"},
}
_SIGHT_M: dict[Kind, float] = {"street": 120.0, "forest": 60.0, "street-scan": 160.0}
"""Nothing farther is simulated unless it is asked for [m]."""
_BESIDE = (".npy", ".bin", ".e57")
"""Outputs whose classes cannot be held, or not compared: they stand in a file beside."""
_LAS = (".las", ".laz")
_REGISTERED = (*_LAS, ".csv", ".csv.gz", ".csv.zst", ".parquet")
"""Outputs that hold registered coordinates beside the ranges."""
_ONE_RETURN = (".npy", ".npz", ".bin")
TRAJECTORY_HZ = 200.0
"""Positions a second of trajectories that are written."""
LOOK_AHEAD_M, LOOK_STEP_M = 60.0, 1.0
"""How far, and how closely, a place for a tripod is looked for [m]."""
STEM_MARGIN_M = 30.0
"""Trees so far from the way are listed."""
STEM_STEP_M = 10.0
"""They are looked for from places so far apart [m]."""


class _Settings(Params):
    """What every simulation has."""

    seed: int = Field(1, ge=0, lt=2**63, description="the same seed gives the same scene, way and noise")
    sight_m: float | None = Field(None, gt=1, le=2000, description="nothing farther is simulated [m]; unset = by kind")
    classes: ClassCodes = Field(default_factory=ClassCodes, description="class codes of the reference")


class FrameParams(Params):
    """A projected coordinate system in metres and where the simulated world lies in it."""

    crs: str = Field(Frame().crs, description="as pyproj takes it")
    easting_m: float = Field(Frame().easting_m, description="of the world's origin [m]")
    northing_m: float = Field(Frame().northing_m, description="of the world's origin [m]")
    height_m: float = Field(Frame().height_m, description="of the world's origin above the ellipsoid [m]")


_FRAME = "where the world lies on earth; unset = nowhere, coordinates count from the start, but for an SBET"


class DriveSettings(_Settings):
    """A drive down a street."""

    length_m: float = Field(300.0, gt=0, le=1e7, description="way of the platform [m]")
    duration_s: float | None = Field(None, gt=0, le=1e7, description="instead of a length [s]")
    lines: int | None = Field(None, ge=1, le=MOST_LINES, description="scan lines, instead of a length")
    scene: StreetSceneParams = Field(default_factory=StreetSceneParams, description="street")
    scanner: Scanner = Field(SCANNERS["photon-80"], description="scanner and its mount")
    trajectory: MotionParams = Field(MOTIONS["car"], description="how the platform moves")
    frame: FrameParams | None = Field(None, description=_FRAME)


class WalkSettings(_Settings):
    """A walk through a forest."""

    length_m: float = Field(100.0, gt=0, le=1e7, description="way of the platform [m]")
    duration_s: float | None = Field(None, gt=0, le=1e7, description="instead of a length [s]")
    lines: int | None = Field(None, ge=1, le=MOST_LINES, description="scan lines, instead of a length")
    scene: ForestSceneParams = Field(default_factory=ForestSceneParams, description="forest")
    scanner: Scanner = Field(SCANNERS["focus3d-120"], description="scanner and its mount")
    trajectory: MotionParams = Field(MOTIONS["backpack"], description="how the platform moves")
    frame: FrameParams | None = Field(None, description=_FRAME)


class StationParams(Params):
    """Where the tripod of a static scan stands, and how far its head turns."""

    along_m: float = Field(60.0, ge=0, le=1e6, description="from here on along the middle of the right-hand lane [m]")
    left_m: float = Field(0.0, ge=-30, le=30, description="to the left of it [m]")
    clearance_m: float = Field(
        2.5, ge=0, le=20, description="at the first place with so much room around; 0 = just where it is said [m]"
    )
    turn_deg: float = Field(360.0, gt=0, le=360, description="angle that the head turns [degrees]")


class StationSettings(_Settings):
    """A static scan of a street."""

    lines: int | None = Field(None, ge=1, le=MOST_LINES, description="scan lines, instead of station.turn_deg")
    scene: StreetSceneParams = Field(default_factory=StreetSceneParams, description="street")
    scanner: Scanner = Field(SCANNERS["scanstation2"], description="scanner")
    station: StationParams = Field(default_factory=StationParams, description="place")


Settings: TypeAlias = DriveSettings | WalkSettings | StationSettings
_MODELS: dict[Kind, type[Settings]] = {
    "street": DriveSettings,
    "forest": WalkSettings,
    "street-scan": StationSettings,
}
KINDS: tuple[Kind, ...] = tuple(_MODELS)
"""What can be simulated."""


def load_settings(kind: Kind, path: Path | str | None = None, options: Mapping[str, Any] | None = None) -> Settings:
    """Build the parameters of a simulation.

    Parameters
    ----------
    kind : {"street", "forest", "street-scan"}
        What is simulated.
    path : path, optional
        TOML file with the tables ``[scene]``, ``[scanner]`` and ``[trajectory]`` (``[station]`` for a static scan);
        ``name`` in a table is the preset that its other keys are laid over.
    options : mapping, optional
        Nested table laid over the file.

    Returns
    -------
    DriveSettings, WalkSettings or StationSettings

    Raises
    ------
    ConfigError
        Unknown kind, preset or key, or a value out of its bounds.

    Examples
    --------
    >>> load_settings("street", options={"scanner": {"name": "profiler-1mhz", "slant_deg": 30}}).scanner.line_hz
    200.0
    """
    if kind not in _MODELS:
        raise ConfigError("kind", f"found {kind!r}, expected one of: {', '.join(KINDS)}")
    where = "simulation" if path is None else str(path)
    written = {} if path is None else read_toml(Path(path))
    _refuse_two_presets(written, options or {}, where)
    table = merge(written, options or {})
    for name, presets in _presets(kind).items():
        given = table.get(name, {})
        if not isinstance(given, Mapping):
            raise ConfigError(where, f"{name}: found {given!r}, expected: a table")
        chosen = given.get("name", _DEFAULTS[kind][name])
        if chosen not in presets:
            problem = f"{name}.name: found {chosen!r}, expected one of: {', '.join(presets)}"
            raise ConfigError(where, problem)
        own = {key: value for key, value in given.items() if key != "name"}
        table[name] = merge(presets[chosen], own)
        if name == "trajectory" and "stop_every_m" not in own:
            table[name] = _with_room_to_stop(table[name])
    try:
        settings = build(_MODELS[kind], table, where)
    except ConfigError as error:
        # the hint of the other configuration leads nowhere here
        hint = error.hint if "prc config" not in error.hint else f"see `prc simulate parameters {kind}`"
        raise ConfigError(error.where, error.problem, hint) from None
    if settings.scanner.is_static != (kind == "street-scan"):
        found = "is static" if settings.scanner.is_static else "is none for a tripod"
        fitting = ", ".join(name for name, each in SCANNERS.items() if each.is_static == (kind == "street-scan"))
        raise ConfigError(where, f"scanner: the scanner {found}, expected one for a {kind}", f"choose from: {fitting}")
    return settings


def _refuse_two_presets(written: Mapping[str, Any], options: Mapping[str, Any], where: str) -> None:
    """Refuse a preset beside a table of the file: its keys would be laid over the preset, maybe every one of them."""
    for name in ("scene", "scanner", "trajectory"):
        asked, given = options.get(name), written.get(name)
        if not (isinstance(asked, Mapping) and isinstance(given, Mapping)):
            continue
        own = sorted(set(given) - {"name"})
        if "name" in asked and own and asked["name"] != given.get("name"):
            problem = f"{name}: found the preset {asked['name']!r} asked for beside {own[0]} in [{name}], expected one"
            raise ConfigError(where, problem, f"leave [{name}] out of the file, or do not ask for a preset")


def _presets(kind: Kind) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the presets of every table that has some."""
    found: dict[str, dict[str, dict[str, Any]]] = {
        "scene": SCENES[kind],
        "scanner": {name: scanner.model_dump() for name, scanner in SCANNERS.items()},
    }
    if kind != "street-scan":
        found["trajectory"] = {name: motion.model_dump() for name, motion in MOTIONS.items()}
    return found


def _with_room_to_stop(motion: dict[str, Any]) -> dict[str, Any]:
    """Move stops farther apart where the speed leaves no room to brake between them; asked-for ones are not moved."""
    if not motion["stop_every_m"]:
        return motion
    with contextlib.suppress(ValueError, TypeError, ZeroDivisionError):
        free = MotionParams(**{**motion, "stop_every_m": 0.0})
        return {**motion, "stop_every_m": max(motion["stop_every_m"], math.ceil(free.braking_m / 0.3))}
    return motion  # what is wrong with it is told where it is checked


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A scan that can be simulated, and what is known of its world."""

    kind: Kind
    settings: Settings
    scene: StreetScene | ForestScene
    scan: SimulatedScan

    @property
    def end_s(self) -> float:
        """When the last shot is made [s]."""
        scanner = self.scan.scanner
        return float(scanner.line_time_s(self.scan.n_lines - 1, 1)[0]) + scanner.shot_s * (scanner.points_per_line - 1)


def open_simulation(
    kind: Kind,
    settings: Settings | None = None,
    *,
    reference: Literal["truth", "cylinders"] = "truth",
    threads: int | None = None,
    with_xyz: bool | None = None,
    with_world: bool = False,
) -> Simulation:
    """Prepare a simulation; nothing is simulated before its blocks are asked for.

    Parameters
    ----------
    kind : {"street", "forest", "street-scan"}
    settings : optional
        From :func:`load_settings`.
    reference : {"truth", "cylinders"}
        Labels of what was hit; or, in forests, those of the paper's reference of cylinders around stems
        (:func:`prc_cli.simulation.forest.reference.reference_labels`).
    threads : int, optional
        Default: as many as there are cores.
    with_xyz, with_world : bool
        Whether coordinates relative to the scanner (default: for static scans) and registered ones are worked out.

    Returns
    -------
    Simulation
        ``.scan`` is a :class:`prc_cli.core.stream.ScanStream`.

    Examples
    --------
    >>> found = open_simulation("street", load_settings("street", options={"lines": 2}))
    >>> [block.range_m.shape for block in found.scan.blocks()]
    [(2, 2154)]
    """
    chosen = load_settings(kind) if settings is None else settings
    scanner, seed = chosen.scanner, chosen.seed
    sight_m = min(chosen.sight_m if chosen.sight_m is not None else _SIGHT_M[kind], scanner.max_range_m)
    if reference == "cylinders" and kind != "forest":
        raise ConfigError("reference", f"found 'cylinders', expected 'truth': a {kind} has no stems")
    scene: StreetScene | ForestScene
    platform: Station | Trajectory
    relabel: Callable[[F64], U8] | None = None
    if isinstance(chosen, WalkSettings):
        forest = scene = ForestScene(chosen.scene, seed)
        near = _timeless(forest)
        platform = Trajectory(forest.path_point, chosen.trajectory, scanner.height_m, seed)
        if reference == "cylinders":
            relabel = partial(reference_labels, forest)
    else:
        street = scene = StreetScene(chosen.scene, seed)
        near = street.bodies_near
        if isinstance(chosen, StationSettings):
            platform = _stand(street, chosen)
        else:
            platform = Trajectory(street.path_point, chosen.trajectory, scanner.height_m, seed)
    scan = SimulatedScan(
        f"simulated {kind}",
        near,
        scanner,
        platform,
        seed,
        _count_lines(chosen, platform),
        sight_m,
        threads=default_threads() if threads is None else threads,
        with_xyz=(kind == "street-scan") if with_xyz is None else with_xyz,
        with_world=with_world,
        relabel=relabel,
    )
    return Simulation(kind, chosen, scene, scan)


def _timeless(scene: ForestScene) -> BodiesNear:
    """Nothing moves in a forest."""
    return lambda x_m, y_m, radius_m, time_s: scene.bodies_near(x_m, y_m, radius_m)


def _count_lines(settings: Settings, platform: Station | Trajectory) -> int:
    if settings.lines is not None:
        return settings.lines
    if isinstance(settings, StationSettings):
        return max(1, round(settings.station.turn_deg / settings.scanner.azimuth_step_deg))
    if settings.duration_s is not None:
        return max(1, math.floor(settings.duration_s * settings.scanner.line_hz))
    assert isinstance(platform, Trajectory)
    return lines_of(platform, settings.scanner, settings.length_m)


def _stand(street: StreetScene, settings: StationSettings) -> Station:
    """Put the tripod where there is room; the azimuth of its lines counts from the direction of the street."""
    place = settings.station
    points, headings = street.path_point(place.along_m + np.arange(0.0, LOOK_AHEAD_M, LOOK_STEP_M))
    best: tuple[float, Station] | None = None
    for point, heading in zip(points, headings, strict=True):
        x = float(point[0] - place.left_m * np.sin(heading))
        y = float(point[1] + place.left_m * np.cos(heading))
        z = ground_below(street.bodies_near, x, y, float(point[2]))
        room_m = room_around(street.bodies_near, x, y, z) if place.clearance_m else 0.0
        if best is None or room_m > best[0]:
            best = room_m, Station(x, y, z + settings.scanner.height_m, float(heading))
        if room_m >= place.clearance_m:
            break
    assert best is not None
    return best[1]


@dataclass(frozen=True, slots=True)
class SimulationSummary:
    """What a simulation wrote."""

    output: Path
    record: RunRecord
    """Provenance, as stored beside the output: parameters, seed, version, classes."""
    counts: Counts
    files: tuple[Path, ...]
    """Everything that was written, the run record included."""

    def as_dict(self) -> dict[str, object]:
        """Return the run record with the names of the files, for JSON."""
        return {**self.record.as_dict(), "files": [str(path) for path in self.files]}


@dataclass(frozen=True, slots=True)
class Beside:
    """Files that are written beside the stream, each only if it has a name."""

    trajectory: Path | None = None
    """Where the scanner was: ``.sbet`` or ``.out`` SBET, else CSV."""
    labels: Path | None = None
    """``.npy``: the reference class of every record of the output; there by itself where the output holds none."""
    stems: Path | None = None
    """``.csv``: the trees beside the way."""

    def paths(self) -> tuple[Path, ...]:
        """Return those that have a name."""
        return tuple(path for path in (self.trajectory, self.labels, self.stems) if path is not None)


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
    """Simulate a scan into a file, with the reference class of every shot; all files exist whole or not at all.

    Parameters
    ----------
    kind : {"street", "forest", "street-scan"}
        What is simulated.
    output : path
        ``.las .laz .csv .csv.gz .csv.zst .parquet .npz .npy .bin .e57``. Where there is a return, the point clouds
        and tables hold its registered coordinates from the true pose.
    settings : optional
        From :func:`load_settings`.
    beside : Beside, optional
        Names of further files.
    reference : {"truth", "cylinders"}
        As :func:`open_simulation`.
    threads : int, optional
        Default: as many as there are cores. They do not change a byte.
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
    suffix = stream_suffix(output)
    chosen = load_settings(kind) if settings is None else settings
    wanted = check_simulation(kind, output, beside, overwrite=overwrite)
    for path in (*outputs_of(output), *wanted.paths()):
        remove_stale(path)
    frame = _frame(chosen, wanted)
    is_static = chosen.scanner.is_static
    simulation = open_simulation(
        kind,
        chosen,
        reference=reference,
        threads=threads,
        with_xyz=is_static or suffix == ".e57",
        with_world=not is_static and (suffix in _REGISTERED or reference == "cylinders"),
    )
    with contextlib.ExitStack() as stack:
        if wanted.trajectory is not None:
            temporary = stack.enter_context(atomic_output(wanted.trajectory))
            _write_trajectory(simulation, wanted.trajectory, temporary, frame)
        if wanted.stems is not None:
            temporary = stack.enter_context(atomic_output(wanted.stems))
            temporary.write_text("".join(f"{row}\n" for row in _stem_rows(simulation)), encoding="utf-8", newline="\n")
        codes_file: _CodesFile | None = None
        if wanted.labels is not None:
            handle = stack.enter_context(stack.enter_context(atomic_output(wanted.labels)).open("w+b"))
            codes_file = _CodesFile(handle)
        record, counts = _write(simulation, output, codes_file, frame, progress)
    return SimulationSummary(output, record, counts, (*outputs_of(output), *wanted.paths()))


def _write(
    simulation: Simulation, output: Path, codes_file: _CodesFile | None, frame: Frame, progress: Progress | None
) -> tuple[RunRecord, Counts]:
    """Simulate and write the stream, and the codes beside it."""
    scan, suffix = simulation.scan, stream_suffix(output)
    lookup = simulation.settings.classes.lookup()
    counts = Counts.none()
    shape = StreamShape(
        points_per_line=scan.scanner.points_per_line,
        scanners=False,
        returns=scan.scanner.max_returns > 1 and suffix not in _ONE_RETURN,
        angles=True,
        times=True,
        xyz=scan.with_xyz,
        registered=scan.with_world and not scan.with_xyz and suffix in _REGISTERED,
        intensity=True,
        codes=True,
        nadir_rad=scan.info.nadir_rad,
    )
    n_further = 0
    with open_stream_writer(output, shape) as writer:

        def put(found: SimulatedBlock) -> None:
            item = _item(found, lookup, frame.origin() if shape.registered else None)
            writer.add_item(item)
            if codes_file is not None:
                codes_file.write(codes_in_order(item, suffix))

        with write_behind(put) as queue:
            for found in scan.simulated():
                queue.put(found)
                counts = counts.add(found.labelled)
                n_further += len(found.labelled.extra_labels)
                if progress is not None:
                    progress(found.labelled.block.n_lines)
        record = _record(simulation, counts)
        told = list(writer.losses)
        if n_further and suffix in _ONE_RETURN:
            told.append(f"not kept: {n_further} further returns: a range image has one range a cell")
        if suffix == ".bin":
            told.append(f"read it with --config {output.name}.toml")
        if shape.registered and frame.crs:
            told.append(f"registered coordinates are those of {frame.crs}")
        if suffix == ".parquet":
            told.append("prc reads no stream from .parquet; it is for other programs")
        record = writer.finish(replace(record, notices=(*record.notices, *told)))
        if codes_file is not None:
            codes_file.finish()
    return record, counts


def _item(found: SimulatedBlock, lookup: U8, origin_m: F64 | None) -> StreamItem:
    labelled = found.labelled
    item = StreamItem(
        labelled.block,
        codes=lookup[labelled.labels].astype(np.int32),
        extra_codes=lookup[labelled.extra_labels].astype(np.int32),
    )
    if origin_m is None or found.world_m is None or found.extra_world_m is None:
        return item
    return replace(item, registered_m=found.world_m + origin_m, extra_registered_m=found.extra_world_m + origin_m)


def codes_in_order(item: StreamItem, suffix: str) -> U8:
    """Return the class codes of the records that an output has, in their order, (records,) uint8; 0 = no return."""
    assert item.codes is not None
    assert item.extra_codes is not None
    block = item.block
    codes = item.codes.ravel()
    extra = block.extra
    if suffix in _ONE_RETURN or not len(extra):
        found = codes if suffix not in _LAS else codes[~np.isnan(block.range_m.ravel())]
        return found.astype(np.uint8)
    # every return stands behind the one that stands for its shot, nearer ones first
    cell = extra.line.astype(np.int64) * block.points_per_line + extra.column
    own = np.flatnonzero(~np.isnan(block.range_m.ravel())) if suffix in _LAS else np.arange(len(codes))
    owner = np.concatenate([own, cell])
    rank = np.concatenate([np.full(len(own), -np.inf), extra.range_m if suffix in _LAS else np.zeros(len(cell))])
    order = np.lexsort((np.arange(len(owner)), rank, owner))
    return np.concatenate([codes[own], item.extra_codes])[order].astype(np.uint8)


class _CodesFile:
    """A ``.npy`` of class codes that grows."""

    def __init__(self, handle: BinaryIO) -> None:
        self._handle = handle
        self._n = 0
        self._header_bytes = handle.write(self._header())

    def _header(self) -> bytes:
        buffer = io.BytesIO()
        np.lib.format.write_array_header_1_0(buffer, {"descr": "|u1", "fortran_order": False, "shape": (self._n,)})
        return buffer.getvalue()

    def write(self, codes: U8) -> None:
        """Add the codes of the next records."""
        self._handle.write(codes.data)
        self._n += len(codes)

    def finish(self) -> None:
        """Say how many there are."""
        header = self._header()
        # numpy leaves room for the axis to grow, so that both headers take the same bytes
        assert len(header) == self._header_bytes
        self._handle.seek(0)
        self._handle.write(header)
        self._handle.flush()


def _record(simulation: Simulation, counts: Counts) -> RunRecord:
    settings, scan = simulation.settings, simulation.scan
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
        # there is no file: the parameters are what the output was made from
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
    """Return where the world lies on earth: as it is asked for, or where an SBET needs it."""
    asked = None if isinstance(settings, StationSettings) else settings.frame
    if asked is not None:
        return Frame(**asked.model_dump())
    is_sbet = beside.trajectory is not None and beside.trajectory.suffix.lower() in (".sbet", ".out")
    return Frame() if is_sbet else WORLD


def check_simulation(kind: Kind, output: Path, beside: Beside | None = None, *, overwrite: bool = False) -> Beside:
    """Refuse outputs before any work is done.

    Returns
    -------
    Beside
        What is written beside the stream; the file of labels has a name where one is needed.

    Raises
    ------
    ConfigError, OutputError, OutputExistsError
    """
    beside = beside or Beside()
    if beside.labels is None and stream_suffix(output) in _BESIDE:
        beside = replace(beside, labels=reference_path(output))
    if beside.labels is not None and beside.labels.suffix.lower() != ".npy":
        problem = f"found suffix {beside.labels.suffix!r}, expected .npy"
        raise ConfigError(str(beside.labels), problem, "labels are a class code a record, a NumPy array")
    if beside.stems is not None and kind != "forest":
        raise ConfigError("stems", f"asked for in a {kind}, which has none", "leave it out")
    if beside.trajectory is not None and kind == "street-scan":
        raise ConfigError("trajectory", "asked for of a tripod, which does not move", "leave it out")
    paths = [path.absolute() for path in (*outputs_of(output), *beside.paths())]
    if len(set(paths)) < len(paths):
        raise ConfigError(str(output), "two of the files that are to be written have one name")
    check_stream_output(output, overwrite=overwrite)
    for path in beside.paths():
        check_output(path, overwrite=overwrite)
    return beside


def reference_path(output: Path) -> Path:
    """Return where the reference classes of an output stand that holds none.

    >>> reference_path(Path("drive.e57")).name
    'drive_reference.npy'
    """
    return output.with_name(f"{output.stem}_reference.npy")


def _write_trajectory(simulation: Simulation, path: Path, temporary: Path, frame: Frame) -> None:
    """Write the trajectory under a name that keeps the suffix, which decides its format, then under the given one."""
    written = temporary.with_name(f"{temporary.name}{path.suffix}")
    write_trajectory(written, simulation.scan.platform, simulation.end_s, hz=TRAJECTORY_HZ, frame=frame)
    written.replace(temporary)


def _stem_rows(simulation: Simulation) -> Iterator[str]:
    """Yield the trees beside the way, each once, as lines of CSV."""
    scene, platform = simulation.scene, simulation.scan.platform
    assert isinstance(scene, ForestScene)
    assert isinstance(platform, Trajectory)
    length_m = float(platform.progress(np.array([simulation.end_s]))[0][0])
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
