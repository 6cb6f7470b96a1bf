"""Coordinates of the shots of an input.

They come from the records or from poses. Without both, the scan planes are drawn one behind the
other.
"""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.config import LoadedConfig, RunConfig, load_config, resolve
from prc_cli.core.classes import NO_CODE
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.stream import ScanBlock, ScanStream, StreamInfo
from prc_cli.core.threads import closing_items
from prc_cli.core.types import F32, F64, I64
from prc_cli.formats.input import Input
from prc_cli.formats.options import Layout
from prc_cli.formats.records import FilteredSource, RecordChunk, Source
from prc_cli.formats.writing.columns import (
    SPACING_M,
    AtStations,
    Coordinates,
    LinesApart,
    Placement,
)
from prc_cli.formats.writing.disk import DiskColumn
from prc_cli.formats.writing.record import reading_beside
from prc_cli.methods.rings.pipeline import is_fan
from prc_cli.streams.beams import with_beams
from prc_cli.streams.open import open_input
from prc_cli.streams.stream import Stream
from prc_cli.streams.trajectory import Trajectory, load_trajectory

_NAMES = ("x", "y", "z", "time", "range", "scan_line")
_KEPT = np.dtype([(name, np.float64) for name in _NAMES])
_READ_AT_ONCE = 1 << 17


@dataclass(frozen=True)
class _Placer:
    """Gives every shot of a drive coordinates by a trajectory.

    A shot of a profiler is in the scan plane: down, and to the left by the scan angle. Other
    scanners have coordinates relative to the scanner. The mount rotates both, the lever arm moves
    them, and the pose transforms them to the coordinates of the points.
    """

    stream: ScanStream
    track: Trajectory
    mount_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of the scanner on the vehicle."""
    arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From the trajectory's point to the scanner, on the axes of the vehicle."""
    nadir_deg: float = 0.0
    """Scan angle of the beam that points straight down."""

    @property
    def path(self) -> str:
        """File name, for messages."""
        return self.stream.info.path

    @cached_property
    def _mount(self) -> F64:
        """Turn of the scanner on the vehicle, (3, 3) float64."""
        from scipy.spatial.transform import Rotation

        matrix: F64 = Rotation.from_euler("ZYX", self.mount_deg[::-1], degrees=True).as_matrix()
        return matrix

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Place all shots, then yield them in the order of the records.

        NaN where there is no return.
        """
        fill = (np.nan,) * (len(_NAMES) - 1) + (-1.0,)
        with DiskColumn(Path(tempfile.gettempdir()) / "placed", _KEPT, fill) as rows:
            first = 0
            stop = self.stream.info.n_records or 0
            for block in self.stream.blocks():
                self._place(block, rows)
                # the last records may have no return
                stop = max(stop, len(rows), int(block.records().max(initial=-1)) + 1)
            for values in rows.chunks(_READ_AT_ONCE, stop=stop):
                yield RecordChunk(first, {name: values[name].copy() for name in names}, len(values))
                first += len(values)

    def _place(self, block: ScanBlock, rows: DiskColumn) -> None:
        extra = block.extra
        record = block.records()
        if block.time_s is None:
            problem = "the shots have no times, and a trajectory needs them"
            raise InputError(self.path, problem, "give the file that has the times")
        unit = self._directions(block)
        line = np.repeat(np.arange(block.n_lines), block.points_per_line)
        self._put(
            record.ravel(),
            unit.reshape(-1, 3),
            block.range_m.ravel(),
            block.time_s.ravel(),
            line,
            block,
            rows,
        )
        cell = extra.line, extra.column
        self._put(
            extra.record, unit[cell], extra.range_m, block.time_s[cell], extra.line, block, rows
        )

    def _put(
        self,
        record: I64,
        unit: F64,
        range_m: F32,
        time_s: F64,
        line: NDArray[Any],
        block: ScanBlock,
        rows: DiskColumn,
    ) -> None:
        is_placed = (
            np.isfinite(range_m)
            & np.isfinite(time_s)
            & np.isfinite(unit).all(axis=1)
            & (record >= 0)
        )
        values = np.empty(int(np.count_nonzero(is_placed)), _KEPT)
        vector = (
            unit[is_placed] * range_m[is_placed, None].astype(np.float64)
        ) @ self._mount.T + np.array(self.arm_m)
        values["x"], values["y"], values["z"] = self.track.places(time_s[is_placed], vector).T
        values["time"] = time_s[is_placed]
        values["range"] = range_m[is_placed]
        values["scan_line"] = block.first_line + line[is_placed]
        rows.put(record[is_placed], values)

    def _directions(self, block: ScanBlock) -> F64:
        """Return unit vectors of the scanner (lines, M, 3)."""
        if block.xyz_m is not None:
            with np.errstate(invalid="ignore"):
                xyz = block.xyz_m.astype(np.float64)
                return np.asarray(xyz / np.sqrt((xyz * xyz).sum(axis=2, keepdims=True)), np.float64)
        angle = block.angle_rad if block.angle_rad is not None else self.stream.info.angle_rad
        if angle is None:
            problem = "found no scan angles and no coordinates relative to the scanner"
            raise InputError(
                self.path, problem, "classify it with input.angle_start and input.angle_step set"
            )
        angle = angle - np.deg2rad(self.nadir_deg)
        if is_fan(angle):
            problem = "the beams are rings of a spinning scanner, but their azimuths are not known"
            raise InputError(self.path, problem, "give a file with x, y, z relative to the scanner")
        unit = np.stack([np.zeros_like(angle), np.sin(angle), -np.cos(angle)], axis=1)
        return np.broadcast_to(unit, (block.n_lines, *unit.shape))


XYZ = ("x", "y", "z")
SPEED_M_S = 8.0
WALK_M_S = 1.2
"""Assumed speeds in streets and forests, without a trajectory."""
_FIRST_LINES = 64
"""Number of lines for the estimate of the line frequency."""


def placed_source(
    drive: Path,
    labels: Path,
    trajectory: Path,
    mount: tuple[float, ...] = (),
    *,
    crs: str | None = None,
    layout: Layout | None = None,
) -> Source:
    """Open a drive as in the record beside its labels, with coordinates from poses and a mount.

    The dimensions are coordinates, time, range and line of every shot, by record.
    """
    layout_options = {} if layout is None else {"layout": layout.model_dump()}
    scan, loaded = resolve(drive, load_config(options=reading_beside(labels) | layout_options))
    reading = loaded.config.input
    if len(mount) not in (0, 3, 6) or not all(map(math.isfinite, mount)):
        values = ", ".join(f"{value:g}" for value in mount)
        problem = f"found {values}, expected ROLL,PITCH,YAW or ROLL,PITCH,YAW,X,Y,Z"
        raise ConfigError(
            "--mount", problem, "in degrees and metres, with the vehicle axes forward, left, up"
        )
    if reading.range.startswith(("trajectory:", "origin:")):
        kind = reading.range.partition(":")[0]
        problem = f"was read with range = {kind}, so its shots have coordinates"
        raise ConfigError(str(drive), problem, "leave out --trajectory")
    stream = open_input(scan, reading)
    system = reading.trajectory_crs or stream.info.facts.crs_wkt or crs
    track = load_trajectory(
        trajectory,
        crs=system,
        source_crs_wkt=None,
        time_offset=reading.trajectory_time_offset,
        max_gap=reading.trajectory_max_gap,
        topic=reading.trajectory_topic,
        with_turns=True,
    )
    arm = mount[3:] or reading.trajectory_lever_arm or (0.0, 0.0, 0.0)
    turn = (*mount[:3], 0.0, 0.0, 0.0)[:3]
    placer = _Placer(stream, track, turn, arm, reading.nadir or 0.0)  # type: ignore[arg-type]
    return FilteredSource(
        (),
        placer.chunks,
        placer.path,
        "drive",
        stream.info.n_records,
        _NAMES,
        lambda: SourceFacts(crs_wkt=system),
    )


def axes_of(
    records: Source | None,
    stream: Stream,
    first: ScanBlock,
    config: RunConfig,
) -> tuple[str, ...]:
    """Return the names of registered coordinates: records have them, blocks do not."""
    if records is None or not set(XYZ) <= set(records.dimensions):
        return ()
    rule = config.input.range if stream.grid is None else stream.grid.rules.range
    return XYZ if first.xyz_m is None or rule.partition(":")[0] in ("trajectory", "origin") else ()


@contextlib.contextmanager
def placement(
    scan: Input,
    output: Path,
    loaded: LoadedConfig,
    stream: Stream,
) -> Iterator[Placement | None]:
    """Give the coordinates of returns for a new cloud, from records or from assumed distances.

    None = the coordinates are relative to the scanner.
    """
    plain = stream.plain or stream
    with closing_items(plain.first_blocks()) as blocks:
        first = next(blocks, None)
    records = scan.records()
    axes = () if first is None else axes_of(records, plain, first, loaded.config)
    if first is not None and first.xyz_m is not None and plain.info.facts.stations:
        yield AtStations(plain.info.facts.stations)
        return
    if records is None or not axes:
        yield (
            None if first is None or first.xyz_m is not None else lines_apart(stream, loaded.config)
        )
        return
    with contextlib.ExitStack() as stack:
        carried = carry(records, None, axes, output, stack)
        if loaded.config.input.window is None:
            carried.read_all()
        yield carried.place


def lines_apart(stream: Stream, config: RunConfig) -> LinesApart:
    """Return the placement of the scan planes of a stream without coordinates."""
    beams: dict[int, F64] = {}
    # without beam directions the scan planes are drawn flat
    with contextlib.suppress(InputError, ConfigError):
        directed = stream if stream.beams is not None else with_beams(stream, config.input)
        beams = {
            scanner: directions.beam_rad
            for scanner, directions in (directed.beams or {}).items()
            if not directions.is_made_up
        }
    times: list[NDArray[Any]] = []
    if stream.info.line_hz is None:
        with closing_items(stream.first_blocks()) as blocks:
            for block in blocks:
                if block.time_s is None:
                    break
                times += list(block.time_s)
                if len(times) >= _FIRST_LINES:
                    break
    in_forest = (config.fused if config.method == "fused" else config.prc).environment == "forest"
    return LinesApart(
        beams,
        *spacing(
            stream.info, np.stack(times[:_FIRST_LINES]) if times else None, in_forest=in_forest
        ),
    )


def spacing(
    info: StreamInfo,
    time_s: NDArray[Any] | None,
    *,
    in_forest: bool,
    step: int = 1,
) -> tuple[float, str]:
    """Return the distance between lines [m], and how it is known.

    Parameters
    ----------
    info : StreamInfo
    time_s : (lines, M) or (lines, 1) float, optional
        Times of the lines [s].
    in_forest : bool
        Whether to assume the speed of a walk.
    step : int
        Number of lines from one row of ``time_s`` to the next.
    """
    hz = info.line_hz
    if hz is None and time_s is not None and len(time_s) > 1:
        with np.errstate(invalid="ignore"):
            starts = np.array(
                [np.nanmin(line) if np.isfinite(line).any() else np.nan for line in time_s]
            )
        period = (
            float(np.nanmedian(np.diff(starts))) / step
            if np.isfinite(np.diff(starts)).any()
            else 0.0
        )
        hz = 1 / period if period > 0 else None
    if hz is None:
        return SPACING_M, "assumed"
    speed_m_s = WALK_M_S if in_forest else SPEED_M_S
    return speed_m_s / hz, f"assumed: {speed_m_s:g} m/s"


class Carried:
    """Values by record; reads the input up to the last requested record."""

    def __init__(self, values: DiskColumn, rows: Iterator[tuple[NDArray[Any], int]]) -> None:
        self._values = values
        self._rows = rows
        self.n_odd = 0
        """Number of invalid codes so far."""

    def get(self, record: I64) -> NDArray[Any]:
        """Return the values of records; see :meth:`DiskColumn.get`."""
        last = int(record.max(initial=-1))
        while last >= len(self._values) and self._read():
            pass
        return self._values.get(record)

    def place(self, block: ScanBlock) -> Coordinates:
        """Return the coordinates of a block, (lines, M, 3), and of its further returns.

        NaN where there is no range.
        """
        values = self.get(block.records())
        extra = self.get(block.extra.record)
        registered = np.stack([values[name] for name in XYZ], axis=-1)
        registered[np.isnan(block.range_m)] = np.nan
        return Coordinates(registered, np.stack([extra[name] for name in XYZ], axis=-1))

    def read_all(self) -> None:
        """Read all remaining records."""
        while self._read():
            pass

    def _read(self) -> bool:
        rows, n_odd = next(self._rows, (None, 0))
        if rows is None:
            return False
        self._values.append(rows)
        self.n_odd += n_odd
        return True


def carry(
    records: Source,
    class_name: str | None,
    xyz: tuple[str, ...],
    output: Path,
    stack: contextlib.ExitStack,
) -> Carried:
    """Keep classes and coordinates of records in a temporary file; count invalid codes."""
    fields = [
        *((name, "<f8") for name in xyz),
        *([("code", "<i4")] if class_name is not None else []),
    ]
    fill = (*((np.nan,) * len(xyz)), *([NO_CODE] if class_name is not None else []))
    values = stack.enter_context(DiskColumn(output, np.dtype(fields), fill))
    rows = _rows_of(records, class_name, xyz, np.dtype(fields))
    stack.callback(rows.close)
    return Carried(values, rows)


def _rows_of(
    records: Source,
    class_name: str | None,
    xyz: tuple[str, ...],
    fields: np.dtype[Any],
) -> Generator[tuple[NDArray[Any], int]]:
    """Yield classes and coordinates of the next records, and their number of invalid codes."""
    names = (*xyz, *([class_name] if class_name is not None else []))
    for chunk in records.chunks(names):
        n_odd = 0
        rows = np.empty(chunk.n, fields)
        for name in xyz:
            rows[name] = chunk.values[name]
        if class_name is not None:
            codes = np.asarray(chunk.values[class_name], np.float64)
            is_integer = np.isfinite(codes) & (codes == np.floor(codes)) & (np.abs(codes) < 2**31)
            n_odd = int(np.count_nonzero(~is_integer & ~np.isnan(codes)))
            rows["code"] = np.where(is_integer, codes, NO_CODE)
        yield rows, n_odd
