"""Read E57 (ASTM E2807), organised scans in a binary container, with pye57.

Points carry the row and column of their cell; a cell without a point is a missing shot. A first
pass reads only these two, for the number of lines and beams and the order of the points. Points
that do not come column by column are grouped by columns in a temporary file.
"""

from __future__ import annotations

import contextlib
import os
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.files import open_to_read
from prc_cli.core.process import step
from prc_cli.core.stream import Assumption, ExtraReturns, ReadTally, ScanBlock
from prc_cli.core.types import F64, I64
from prc_cli.formats.options import InputConfig, origin_of
from prc_cli.formats.organised.scans import (
    INTENSITY_STEPS,
    MAX_LINES,
    MAX_POINTS_PER_LINE,
    MAX_SCANS,
    Pose,
    ScanShape,
    check_rules,
    check_shapes,
    describe,
    in_turn,
    is_rotation,
    lengths,
    lines_per_block,
    listed,
    spans,
    to_float32,
)
from prc_cli.formats.ranges import choose_returns, clean_ranges
from prc_cli.formats.writing.disk import scratch_errors, scratch_file

CHUNK_POINTS = 1 << 17
"""Points decoded at a time."""
MAX_RETURNS = 64
"""Most points per cell, averaged over a line: the points of a line are held in memory."""
MAX_SPARSE = 1000
"""Most cells per point: more means damaged indices."""
SPARE_CELLS = 10_000_000
"""Number of cells always allowed, however few the points."""

ROW = "rowIndex"
COLUMN = "columnIndex"
RETURN = "returnIndex"
INTENSITY = "intensity"
CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
CARTESIAN_STATE = "cartesianInvalidState"
SPHERICAL_STATE = "sphericalInvalidState"

_HEAD = struct.Struct("<8sIIQ")
"""Signature, version and length of the file."""
_COPY = "copy it from the archive again"
_AGAIN = "export the scan again"
_NOT_AS_EXPECTED = (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError)
"""Exceptions of the library for nodes of a type other than the standard's."""

_POINT = np.dtype(
    [
        ("line", np.int32),
        ("row", np.int32),
        ("record", np.int64),
        ("xyz", np.float32, 3),
        ("range", np.float32),
        ("intensity", np.float32),
        ("return", np.float32),
    ]
)


@dataclass(frozen=True, slots=True)
class E57Scan:
    """Metadata of a scan from the XML section."""

    index: int
    fields: tuple[str, ...]
    """Names of the fields of a point."""
    n_points: int
    bounds: tuple[tuple[int, int], tuple[int, int]] | None
    """First and last row, first and last column in the header; None if absent."""
    intensity_limits: tuple[float, float] | None
    """Intensity limits in the header; None if absent or not a range."""
    quaternion: tuple[float, ...] | None
    """Rotation of the pose, w x y z; None without a pose."""
    station_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Translation of the pose [m]."""


class E57File:
    """An E57 file that is open for reading."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            from pye57 import libe57
        except ImportError:
            problem = "reading E57 needs pye57, which is not installed"
            raise InputError(str(path), problem, 'pip install ".[e57]"') from None
        self._library = libe57
        _check_frame(path)
        with self._errors(), step(path):
            self._image = libe57.ImageFile(os.fsencode(path), "r")  # a name need not be UTF-8

    def __enter__(self) -> E57File:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(self._library.E57Exception):
            self._image.close()

    @contextlib.contextmanager
    def _errors(self, what: str = "") -> Iterator[None]:
        try:
            yield
        except (self._library.E57Exception, *_NOT_AS_EXPECTED) as error:
            text = (str(error).strip().splitlines() or [type(error).__name__])[0].strip(" *")
            where = f"{self._path}: {what}" if what else str(self._path)
            problem = f"the E57 structure is damaged or not as in the standard ({text})"
            hint = "copy it from the archive again or export it again"
            raise InputError(where, problem, hint) from error

    def scans(self) -> list[E57Scan]:
        """Return the metadata of every scan from the XML section."""
        with self._errors():
            root = self._image.root()
            n = root["data3D"].childCount() if root.isDefined("data3D") else 0
        if n > MAX_SCANS:
            raise InputError(
                str(self._path), f"found {n} scans, expected at most {MAX_SCANS}", "split the file"
            )
        size = self._path.stat().st_size
        scans = []
        for index in range(n):
            with self._errors(f"scan {index}"):
                scans.append(self._scan(index))
            if scans[-1].n_points > 8 * size:
                n = scans[-1].n_points
                problem = f"found {n} points in a file of {size} bytes, expected a bit a point"
                raise InputError(f"{self._path}: scan {index}", problem, _AGAIN)
        return scans

    def _scan(self, index: int) -> E57Scan:
        node = self._image.root()["data3D"][index]
        points = node["points"]
        prototype = self._library.StructureNode(points.prototype())
        fields = tuple(prototype.get(i).elementName() for i in range(prototype.childCount()))
        quaternion = None
        if node.isDefined("pose") and node["pose"].isDefined("rotation"):
            quaternion = tuple(_value(node["pose"]["rotation"][key]) for key in "wxyz")
        station = (0.0, 0.0, 0.0)
        if node.isDefined("pose") and node["pose"].isDefined("translation"):
            x, y, z = (_value(node["pose"]["translation"][key]) for key in "xyz")
            station = (x, y, z) if np.isfinite([x, y, z]).all() else station
        return E57Scan(
            index,
            fields,
            int(points.childCount()),
            _bounds(node),
            _limits(node),
            quaternion,
            station,
        )

    def chunks(self, scan: E57Scan, names: tuple[str, ...]) -> Iterator[dict[str, F64]]:
        """Decode the named fields of all points of a scan, scaled to metres and radians."""
        what = f"scan {scan.index}"
        n_all = 0
        with self._errors(what):
            reader, buffers = self._reader(scan, names)
        try:
            while True:
                with self._errors(f"{what}, after point {n_all}"), step(self._path):
                    n = reader.read()
                n_all += n
                if not n or n_all > scan.n_points:
                    break
                yield {name: buffers[name][:n].copy() for name in names}
        finally:
            with contextlib.suppress(self._library.E57Exception):
                reader.close()
        if n_all != scan.n_points:
            problem = f"found {n_all} points, the file's XML section says {scan.n_points}"
            raise InputError(f"{self._path}: {what}", problem, _COPY)

    def _reader(self, scan: E57Scan, names: tuple[str, ...]) -> tuple[Any, dict[str, F64]]:
        capacity = max(1, min(CHUNK_POINTS, scan.n_points))
        buffers: dict[str, F64] = {name: np.zeros(capacity) for name in names}
        wrapped = self._library.VectorSourceDestBuffer()
        for name, values in buffers.items():
            wrapped.append(
                self._library.SourceDestBuffer(self._image, name, values, capacity, True, True)
            )
        return self._image.root()["data3D"][scan.index]["points"].reader(wrapped), buffers


def _check_frame(path: Path) -> None:
    """Refuse a file that is not E57 or is cut; the library checks the rest."""
    size = path.stat().st_size
    with open_to_read(path) as handle:
        head = handle.read(_HEAD.size)
    if not head.startswith(b"ASTM-E57"):
        problem = f"begins with {head[:8]!r}, expected the signature b'ASTM-E57'"
        raise InputError(str(path), problem, "check that this is an E57 file")
    *_, length = _HEAD.unpack(head.ljust(_HEAD.size, b"\0"))
    if length != size:
        raise InputError(str(path), f"the file has {size} bytes, its header says {length}", _COPY)


def _value(node: Any) -> float:
    return float(node.scaledValue()) if hasattr(node, "scaledValue") else float(node.value())


def _values(node: Any, table: str, *names: str) -> list[float] | None:
    """Return the numbers of a table; None if one is absent or not finite."""
    if not node.isDefined(table) or not all(node[table].isDefined(name) for name in names):
        return None
    values = [_value(node[table][name]) for name in names]
    return values if np.isfinite(values).all() else None


def _bounds(node: Any) -> tuple[tuple[int, int], tuple[int, int]] | None:
    values = _values(
        node, "indexBounds", "rowMinimum", "rowMaximum", "columnMinimum", "columnMaximum"
    )
    if values is None:
        return None
    row_low, row_high, column_low, column_high = map(int, values)
    return (row_low, row_high), (column_low, column_high)


def _limits(node: Any) -> tuple[float, float] | None:
    low, high = _values(node, "intensityLimits", "intensityMinimum", "intensityMaximum") or (
        0.0,
        0.0,
    )
    return (low, high) if np.isfinite(high - low) and high > low else None


@dataclass(frozen=True, slots=True)
class _Scan:
    """A scan with the numbers of its cells and its pose."""

    table: E57Scan
    shape: ScanShape
    first_row: int
    first_column: int
    counts: I64
    """(n_lines,) int64, points of every line."""
    in_order: bool
    """Whether the points come column by column."""
    pose: Pose

    @property
    def bounds_differ(self) -> bool:
        """Whether the header's bounds exclude points."""
        bounds = self.table.bounds
        if bounds is None or not self.shape.n_cells:
            return False
        rows = (self.first_row, self.first_row + self.shape.points_per_line - 1)
        columns = (self.first_column, self.first_column + self.shape.n_lines - 1)
        return bounds != (rows, columns)


class E57Stream:
    """An E57 file as a :class:`prc_cli.core.stream.ScanStream`.

    The origin of a scan's own coordinates is the scanner; the rotation of its pose turns z up.
    Cells without a point, points marked invalid and points at the origin are missing shots. Cells
    with several points are shots with several returns.
    """

    def __init__(
        self, path: Path, config: InputConfig, _lines_at_once: int = 1
    ) -> None:  # scans are blocks
        check_rules(path, config, may_have_origin=True)
        self._origin_m = origin_of(config)
        self._path = path
        self._config = config
        self._scans: list[_Scan] = []
        with E57File(path) as file:
            tables = file.scans()
            takes_origin = self._takes_origin(tables)  # before all points are read
            self._spare_cells = SPARE_CELLS
            n_records = 0
            for table in tables:
                self._scans.append(self._survey(file, table, n_records))
                n_records += table.n_points
        shapes = [scan.shape for scan in self._scans]
        check_shapes(path, shapes, config)
        poses = [scan.pose for scan in self._scans]
        notes = []
        if differ := [scan.shape.scanner for scan in self._scans if scan.bounds_differ]:
            unfit = f"the header's index bounds do not fit scan {listed(differ)}"
            notes.append(f"{unfit}: prc uses the rows and columns of the points")
        self.info = describe(
            path,
            "E57",
            shapes,
            self._assumptions(),
            notes,
            poses,
            takes_origin=takes_origin,
        )

    def _takes_origin(self, tables: Sequence[E57Scan]) -> bool:
        """Whether ``--range origin:X,Y,Z`` applies: one scan of x, y, z without a pose.

        Raises :class:`~prc_cli.core.errors.ConfigError` if the option is given and does not apply.
        """
        full = [table for table in tables if table.n_points]
        applies = len(full) == 1 and all(
            table.quaternion is None and not any(table.station_m) and _is_cartesian(table)
            for table in full
        )
        if self._origin_m is not None and not applies:
            problem = f"{self._path.name} is not one scan of x, y, z without a pose"
            raise ConfigError("input.range", problem, "leave it out: the file says where it is")
        return applies

    def _where(self, index: int) -> str:
        return f"{self._path}: scan {index}"

    def _survey(self, file: E57File, table: E57Scan, first_record: int) -> _Scan:
        """Find the lines and beams of a scan from the indices of its points."""
        pose = self._pose(table)
        nothing = ScanShape(table.index, 0, 0, 0, first_record)
        if not table.n_points:
            return _Scan(table, nothing, 0, 0, np.zeros(0, np.int64), True, pose)
        self._check_fields(table)
        tally = _IndexTally(self._where(table.index))
        for chunk in file.chunks(table, (ROW, COLUMN)):
            tally.add(chunk[ROW], chunk[COLUMN])
        (row_low, row_high) = tally.rows
        (column_low, column_high) = tally.columns
        if table.bounds is not None:
            rows, columns = table.bounds
            larger = (rows[1] - rows[0] + 1) * (columns[1] - columns[0] + 1)
            inside = (
                rows[0] <= row_low <= row_high <= rows[1]
                and columns[0] <= column_low <= column_high <= columns[1]
            )
            sane = rows[1] - rows[0] < MAX_POINTS_PER_LINE and columns[1] - columns[0] < MAX_LINES
            if inside and sane and larger <= MAX_SPARSE * table.n_points:
                (row_low, row_high), (column_low, column_high) = table.bounds
        shape = ScanShape(
            table.index,
            column_high - column_low + 1,
            row_high - row_low + 1,
            table.n_points,
            first_record,
        )
        self._spare_cells -= max(shape.n_cells - MAX_SPARSE * table.n_points, 0)
        if self._spare_cells < 0:
            size = f"{shape.n_lines} columns x {shape.points_per_line} rows"
            problem = f"found {table.n_points} points in {size}, expected a denser scan"
            raise InputError(self._where(table.index), problem, _AGAIN)
        counts = np.zeros(shape.n_lines, np.int64)
        first_column = tally.columns[0] - column_low
        counts[first_column : first_column + tally.columns[1] - tally.columns[0] + 1] = tally.counts
        if counts.max() > MAX_RETURNS * shape.points_per_line:
            column = column_low + int(counts.argmax())
            problem = (
                f"found {counts.max()} points in column {column} of {shape.points_per_line} rows"
            )
            raise InputError(self._where(table.index), problem, _AGAIN)
        return _Scan(table, shape, row_low, column_low, counts, tally.in_order, pose)

    def _check_fields(self, table: E57Scan) -> None:
        where = self._where(table.index)
        shown = ", ".join(table.fields[:30]) or "none"
        lacking = [name for name in (ROW, COLUMN) if name not in table.fields]
        if lacking:
            names = " and no ".join(lacking)
            problem = f"no {names}: the points are not organised in rows and columns, found {shown}"
            hint = "export it as a structured (gridded) E57 or PTX, with row and column"
            raise InputError(where, problem, hint)
        if not any(set(names) <= set(table.fields) for names in (CARTESIAN, SPHERICAL)):
            problem = f"expected {', '.join(CARTESIAN)} or {', '.join(SPHERICAL)}, found {shown}"
            raise InputError(where, problem, _AGAIN)

    def _pose(self, table: E57Scan) -> Pose:
        station_m = np.array(table.station_m)
        if self._origin_m is not None:
            place_m = np.array(self._origin_m)
            return Pose(np.eye(3), -place_m, place_m)
        if table.quaternion is None:
            return replace(Pose.none(), station_m=station_m)
        w, x, y, z = table.quaternion
        with np.errstate(over="ignore", invalid="ignore"):
            length = float(np.sqrt(w * w + x * x + y * y + z * z))
        if not 0.9 < length < 1.1:
            problem = (
                f"the pose's rotation is ({w:g}, {x:g}, {y:g}, {z:g}), expected a quaternion "
                "of length 1"
            )
            raise InputError(self._where(table.index), problem, _AGAIN)
        w = w / length
        x = x / length
        y = y / length
        z = z / length
        turn = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        assert is_rotation(turn)
        return Pose(turn.T.copy(), np.zeros(3), station_m)

    def _assumptions(self) -> list[Assumption]:
        full = [scan for scan in self._scans if scan.shape.n_cells]
        turned = any(not np.array_equal(scan.pose.rotation, np.eye(3)) for scan in full)
        how = "turned by the poses" if turned else "as they are: no pose turns them"
        assumptions = [
            Assumption(
                "input.range", "sensor-xyz", f"the scanner is the origin of a scan; points {how}"
            )
        ]
        n_scattered = sum(not scan.in_order for scan in full)
        if n_scattered:
            scattered = f"{n_scattered} of {len(full)} scans"
            why = f"the points of {scattered} do not come column by column: sorted on disk"
            assumptions.append(Assumption("input.columns", f"{ROW}, {COLUMN}", why))
        else:
            assumptions.append(
                Assumption("input.columns", f"{ROW}, {COLUMN}", "the points come column by column")
            )
        if any(INTENSITY in scan.table.fields and scan.table.intensity_limits for scan in full):
            why = "the header's limits are its ends"
            assumptions.append(Assumption("input", "intensity: 0 to 65535 in the stream", why))
        used = {name for scan in full for name in (ROW, COLUMN, *_used_fields(scan.table))}
        fields = dict.fromkeys(name for scan in full for name in scan.table.fields)
        if unread := [name for name in fields if name not in used]:
            assumptions.append(
                Assumption("input", f"not read: {', '.join(unread[:20])}", "they are not needed")
            )
        return assumptions

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start."""
        with E57File(self._path) as file:
            for scan in self._scans:
                if scan.shape.n_cells:
                    yield from self._scan_blocks(file, scan)

    def _scan_blocks(self, file: E57File, scan: _Scan) -> Iterator[ScanBlock]:
        lines = lines_per_block(scan.shape.points_per_line)
        ends = np.append(0, np.cumsum(scan.counts))
        pieces = list(spans(scan.shape.n_lines, lines))
        edges = ends[[first for first, _ in pieces] + [scan.shape.n_lines]]
        tallies: list[ReadTally] = []
        points = self._points(file, scan, tallies)
        sizes = np.diff(edges).tolist()
        by_piece = (
            in_turn(points, sizes, self._changed(scan))
            if scan.in_order
            else _scattered(points, edges, lines)
        )
        for (first, stop), points_of_piece in zip(pieces, by_piece, strict=True):
            if len(points_of_piece) and not (
                points_of_piece["line"].min() >= first and points_of_piece["line"].max() < stop
            ):
                raise self._changed(scan)
            block = self._block(scan, first, stop - first, points_of_piece)
            tally = sum(tallies, block.tally)
            tallies.clear()
            yield replace(block, tally=tally, is_last=stop == scan.shape.n_lines)

    def _changed(self, scan: _Scan) -> InputError:
        problem = "the points changed after the file was opened"
        return InputError(
            self._where(scan.table.index), problem, "run again when the copy is complete"
        )

    def _points(
        self, file: E57File, scan: _Scan, tallies: list[ReadTally]
    ) -> Iterator[NDArray[Any]]:
        """Yield points with their cells, in the order of the file.

        Add refused ones to the tallies.
        """
        table = scan.table
        shape = scan.shape
        cartesian = _is_cartesian(table)
        state = CARTESIAN_STATE if cartesian else SPHERICAL_STATE
        position = shape.first_record
        for chunk in file.chunks(table, (ROW, COLUMN, *_used_fields(table))):
            n = len(chunk[ROW])
            points = np.zeros(n, _POINT)
            line = chunk[COLUMN] - scan.first_column
            row = chunk[ROW] - scan.first_row
            if not (
                (line >= 0) & (line < shape.n_lines) & (row >= 0) & (row < shape.points_per_line)
            ).all():
                raise self._changed(scan)
            points["line"] = line
            points["row"] = row
            points["record"] = np.arange(position, position + n)
            position += n
            xyz, length = _coordinates(chunk, scan.pose, cartesian=cartesian)
            if state in chunk:
                length[chunk[state] != 0] = np.nan
            points["range"], tally = clean_ranges(
                length, self._config.min_range, self._config.max_range
            )
            tallies.append(tally + ReadTally(n_records=n))
            points["xyz"] = to_float32(xyz)
            points["intensity"] = _scaled(chunk[INTENSITY], table) if INTENSITY in chunk else np.nan
            points["return"] = to_float32(chunk[RETURN]) if RETURN in chunk else np.nan
            missing = np.isnan(points["range"])
            points["xyz"][missing] = np.nan
            points["intensity"][missing] = np.nan
            yield points

    def _block(
        self,
        scan: _Scan,
        first: int,
        n_lines: int,
        points: NDArray[Any],
    ) -> ScanBlock:
        m = scan.shape.points_per_line
        cell = (points["line"].astype(np.int64) - first) * m + points["row"]
        with_intensity = INTENSITY in scan.table.fields
        with_returns = RETURN in scan.table.fields
        extra = ExtraReturns.none()
        tally = ReadTally()
        if not (cell[1:] > cell[:-1]).all():
            order = np.argsort(cell, kind="stable")
            points = points[order]
            cell = cell[order]
            starts = np.append(True, cell[1:] != cell[:-1])
            is_main = choose_returns(
                starts,
                points["range"],
                points["intensity"] if with_intensity else None,
                points["return"] if with_returns else None,
                self._config.return_,
            )
            further = points[~is_main]
            extra = ExtraReturns(
                (further["line"] - first).astype(np.int32),
                further["row"].copy(),
                further["range"].copy(),
                further["record"].copy(),
            )
            points = points[is_main]
            cell = cell[is_main]
            tally = (
                ReadTally(n_extra_returns=len(further))
                if with_returns
                else ReadTally(n_collisions=len(further))
            )

        def image(name: str, fill: float, *shape: int) -> NDArray[Any]:
            values = np.full((n_lines * m, *shape), fill, _POINT[name].base)
            values[cell] = points[name]
            return values.reshape(n_lines, m, *shape)

        return ScanBlock(
            first_line=first,
            range_m=image("range", np.nan),
            record=image("record", -1),
            scanner=scan.shape.scanner,
            xyz_m=image("xyz", np.nan, 3),
            intensity=image("intensity", np.nan) if with_intensity else None,
            extra=extra,
            tally=tally,
        )


def _is_cartesian(table: E57Scan) -> bool:
    return set(CARTESIAN) <= set(table.fields)


def _used_fields(table: E57Scan) -> tuple[str, ...]:
    """Return the fields of a point that are read beside row and column."""
    coordinates, state = (
        (CARTESIAN, CARTESIAN_STATE) if _is_cartesian(table) else (SPHERICAL, SPHERICAL_STATE)
    )
    return (*coordinates, *(name for name in (state, INTENSITY, RETURN) if name in table.fields))


class _IndexTally:
    """Rows and columns of the points of a scan."""

    def __init__(self, where: str) -> None:
        self._where = where
        self.rows = (0, -1)
        self.columns = (0, -1)
        self.in_order = True
        self.counts: I64 = np.zeros(0, np.int64)
        """Number of points by column, from the first to the last column with points."""
        self._last = -np.inf

    def add(self, row: F64, column: F64) -> None:
        rows = self._span(ROW, row, self.rows)
        columns = self._span(COLUMN, column, self.columns)
        for name, (low, high), limit in (
            (ROW, rows, MAX_POINTS_PER_LINE),
            (COLUMN, columns, MAX_LINES),
        ):
            if high - low >= limit:
                problem = f"found {name} from {low} to {high}, expected at most {limit} of them"
                raise InputError(self._where, problem, _AGAIN)
        if columns != self.columns:
            grown = np.zeros(columns[1] - columns[0] + 1, np.int64)
            offset = self.columns[0] - columns[0]
            grown[offset : offset + len(self.counts)] = self.counts
            self.counts = grown
        self.rows = rows
        self.columns = columns
        number = column.astype(np.int64)
        low = int(number.min())
        counts = np.bincount(number - low)
        self.counts[low - columns[0] : low - columns[0] + len(counts)] += counts
        self.in_order = self.in_order and bool(
            column[0] >= self._last and (column[1:] >= column[:-1]).all()
        )
        self._last = column[-1]

    def _span(self, name: str, index: F64, before: tuple[int, int]) -> tuple[int, int]:
        # signalling NaNs raise an invalid-value warning
        with np.errstate(invalid="ignore"):
            low = float(index.min())
            high = float(index.max())
            is_whole = abs(low) < 2**52 and abs(high) < 2**52 and (index == np.rint(index)).all()
        if not is_whole:
            problem = f"found {name} from {low:g} to {high:g}, expected whole numbers"
            raise InputError(self._where, problem, _AGAIN)
        if before[1] < before[0]:
            return int(low), int(high)
        return min(before[0], int(low)), max(before[1], int(high))


def _coordinates(chunk: dict[str, F64], pose: Pose, *, cartesian: bool) -> tuple[F64, F64]:
    """Return sensor-centred coordinates (n, 3) and ranges (n,) [m], NaN at the origin."""
    if cartesian:
        xyz = np.stack([chunk[name] for name in CARTESIAN], axis=1)
        placed = pose.apply(xyz)
        length = lengths(placed if pose.offset_m.any() else xyz)
        length[(xyz == 0).all(axis=1)] = np.nan
        return placed, length
    length, azimuth, elevation = (chunk[name] for name in SPHERICAL)
    with np.errstate(over="ignore", invalid="ignore"):
        flat = length * np.cos(elevation)
        xyz = np.stack(
            [flat * np.cos(azimuth), flat * np.sin(azimuth), length * np.sin(elevation)], axis=1
        )
    # a range without a direction is no point
    length = np.where(np.isfinite(azimuth) & np.isfinite(elevation) & (length != 0), length, np.nan)
    return pose.apply(xyz), length


def _scaled(intensity: F64, table: E57Scan) -> NDArray[np.float32]:
    """Return intensities scaled to 0 to 65535 by the header's limits, unchanged without limits."""
    if table.intensity_limits is None:
        return to_float32(intensity)
    low, high = table.intensity_limits
    with np.errstate(over="ignore", invalid="ignore"):
        return to_float32((intensity - low) / (high - low) * INTENSITY_STEPS)


def _scattered(points: Iterator[NDArray[Any]], edges: I64, lines: int) -> Iterator[NDArray[Any]]:
    """Group points of any order by ``lines`` lines, through a file with a place for each group."""
    with scratch_file("the points of a scan") as handle:
        filled = edges[:-1].copy()
        for chunk in points:
            group = chunk["line"] // lines
            order = np.argsort(group, kind="stable")
            chunk = chunk[order]
            group = group[order]
            starts = np.flatnonzero(np.append(True, group[1:] != group[:-1]))
            with scratch_errors("the points of a scan"):
                for start, stop in zip(starts, np.append(starts[1:], len(chunk)), strict=True):
                    number = int(group[start])
                    handle.seek(int(filled[number]) * _POINT.itemsize)
                    handle.write(chunk[start:stop].tobytes())
                    filled[number] += stop - start
        if not np.array_equal(filled, edges[1:]):
            raise InputError(
                "E57",
                "the points changed while they were read",
                "run again when the copy is complete",
            )
        for first, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
            with scratch_errors("the points of a scan"):
                handle.seek(first * _POINT.itemsize)
                raw = handle.read((stop - first) * _POINT.itemsize)
            yield np.frombuffer(raw, _POINT)
