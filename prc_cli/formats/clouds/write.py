"""Write PLY and PCD: streams, classified inputs of other formats, and clouds with their classes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import NO_CODE
from prc_cli.core.errors import InputError, OutputError
from prc_cli.core.stream import LabelledBlock
from prc_cli.formats.binary import CHUNK_RECORDS
from prc_cli.formats.clouds.source import NO_CELL, OWN_COMMENT, CloudSource
from prc_cli.formats.writing.base import ScatterWriter, StagedWriter, StreamItem, StreamShape
from prc_cli.formats.writing.columns import (
    RANGE,
    ExtraDimension,
    LabelOutput,
    LinesApart,
    OptionalColumn,
    Values,
    asked_columns,
)
from prc_cli.formats.writing.record import RunRecord
from prc_cli.formats.writing.rows import stream_rows

CLOUD_SUFFIXES = (".ply", ".pcd")
"""Files of these writers."""
PLY_TYPES = {
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
    "i8": "int64",
    "u8": "uint64",
}
_COUNT_DIGITS = 20
_CLASS = "class"
_NO_CLASS = 0
_CELL_NAMES = ("scan_line", "column")


def cloud_header(
    suffix: str,
    dtype: np.dtype[np.void],
    n: int,
    comments: tuple[str, ...] = (),
    width: int | None = None,
    viewpoint: Sequence[float] = (),
) -> bytes:
    """Return a header, of equal length for any number of points.

    >>> print(cloud_header(".ply", np.dtype([("x", "<f4")]), 7).decode())
    ply
    format binary_little_endian 1.0
    element vertex 7
    comment ...................
    property float x
    end_header
    <BLANKLINE>
    """
    names = dtype.names or ()
    kinds = [dtype[name] for name in names]
    if suffix == ".ply":
        lines = [
            "ply",
            "format binary_little_endian 1.0",
            *(f"comment {text}" for text in comments),
        ]
        lines += [f"element vertex {n}", f"comment {'.' * (_COUNT_DIGITS - len(str(n)))}"]
        lines += [
            f"property {PLY_TYPES[kind.str[1:]]} {name}"
            for name, kind in zip(names, kinds, strict=True)
        ]
        return ("\n".join([*lines, "end_header"]) + "\n").encode()
    # organised only if every row is complete
    columns, rows = (width, n // width) if width and n and n % width == 0 and n > width else (n, 1)
    sizes = " ".join(str(kind.itemsize) for kind in kinds)
    types = " ".join({"f": "F", "u": "U", "i": "I"}[kind.kind] for kind in kinds)
    place = " ".join(f"{value:.17g}" for value in viewpoint or (0, 0, 0, 1, 0, 0, 0))
    counted = f"WIDTH {columns}\nHEIGHT {rows}\nVIEWPOINT {place}\nPOINTS {n}\n"
    padding = "." * (4 * _COUNT_DIGITS - len(f"{columns}{rows}{n}"))
    head = ["# .PCD v0.7", *(f"# {text}" for text in comments)]
    head += [f"# {padding}", "VERSION 0.7", f"FIELDS {' '.join(names)}", f"SIZE {sizes}"]
    return (
        "\n".join([*head, f"TYPE {types}", f"COUNT {' '.join('1' for _ in names)}", counted])
        + "DATA binary\n"
    ).encode()


def stream_dtype(shape: StreamShape) -> np.dtype[np.void]:
    """Return the record of a stream; thinned frames of spinning scanners are plain points."""
    xyz = "<f8" if shape.registered else "<f4"
    has_xyz = shape.xyz or shape.registered
    has_cells = not (shape.points and shape.rings)
    wanted = [
        *((axis, xyz, has_xyz) for axis in "xyz"),
        ("range", "<f4", has_cells),
        ("scan_line", "<u4", has_cells),
        ("column", "<u4", has_cells),
        ("time", "<f8", shape.times),
        ("angle_deg", "<f8", shape.angles),
        ("intensity", "<f4", shape.intensity or shape.returns),
        ("return_number", "<u1", shape.returns and has_cells),
        ("number_of_returns", "<u1", shape.returns and has_cells),
        ("point_source_id", "<u4", shape.scanners),
        (_CLASS, "<u1", shape.codes),
    ]
    return np.dtype([(name, kind) for name, kind, present in wanted if present])


_ROW_NAMES = {"range": "range_m", "scan_line": "line", "time": "time_s"}


def stream_records(item: StreamItem, rows: slice, dtype: np.dtype[np.void]) -> NDArray[Any]:
    """Return the records of lines of a block with missing shots; a missing class is 0."""
    values = stream_rows(item, rows)
    names = dtype.names or ()
    records = np.zeros(len(values["line"]), dtype)
    for name in names:
        column = values.get(_ROW_NAMES.get(name, name))
        if column is None:
            continue
        if name == _CLASS:
            column = np.where(
                (column == NO_CODE) | (column < 0) | (column > 255), _NO_CLASS, column
            )
        records[name] = np.minimum(column, 255) if dtype[name].str == "|u1" else column
    return records


class CloudWriter(StagedWriter):
    """Writer of a point for every cell and further return; a missing shot is NaN or left out."""

    def __init__(
        self, path: Path, shape: StreamShape | None = None, labels: LabelOutput | None = None
    ) -> None:
        super().__init__(path, labels)
        for column in asked_columns(self._options):
            if column.dimension is not RANGE:
                self._notice(
                    f"{self.path.suffix} outputs hold no {column.what}s; they need .las, "
                    ".laz or .csv"
                )
        self._shape = shape
        self._n = self._n_cells = self._n_codes_lost = 0

    @property
    def losses(self) -> tuple[str, ...]:
        """Class codes that do not fit into a byte."""
        if not self._n_codes_lost:
            return ()
        return (f"{self._n_codes_lost} class codes outside 0 to 255: written as {_NO_CLASS}",)

    def _write_header(self) -> np.dtype[np.void]:
        """Write the header, of equal length for any number of points; return the record type."""
        shape = self._shape
        m = 0
        if shape is None:  # no block has come
            dtype = np.dtype([("range", "<f4"), (_CLASS, "<u1")])
        else:
            dtype = stream_dtype(shape)
            m = shape.points_per_line
        # rows have equal width only without further returns, other line lengths and omitted shots
        width = m if self._labels is None and self._n == self._n_cells else None
        comments = (f"{OWN_COMMENT}{m}",) if m else ()
        self._handle.seek(0)
        self._handle.write(cloud_header(self.path.suffix.lower(), dtype, self._n, comments, width))
        return dtype

    def _add(self, item: StreamItem) -> None:
        block = item.block
        labels = self._labels
        if labels is not None:
            self._see_order(block)
            if self._shape is None:
                self._shape = StreamShape(
                    block.points_per_line,
                    scanners=True,
                    returns=True,
                    angles=block.angle_rad is not None,
                    times=block.time_s is not None,
                    xyz=True,
                    registered=not (labels.place is None or isinstance(labels.place, LinesApart)),
                    intensity=block.intensity is not None,
                    codes=True,
                )
            if labels.place is not None or block.xyz_m is None:
                registered_m, extra_registered_m = self._coordinates(item)
                item = replace(
                    item, registered_m=registered_m, extra_registered_m=extra_registered_m
                )
        elif item.codes is not None:
            self._n_codes_lost += int(np.count_nonzero((item.codes > 255) | (item.codes < NO_CODE)))
        assert self._shape is not None
        if not self._n_cells:
            self._dtype = self._write_header()
        n_lines = max(1, (CHUNK_RECORDS >> 1) // block.points_per_line)
        for first in range(0, block.n_lines, n_lines):
            rows = slice(first, min(first + n_lines, block.n_lines))
            records = stream_records(item, rows, self._dtype)
            if labels is not None or self._shape.points:
                records = records[~np.isnan(records["x" if labels is None else "range"])]
            if labels is not None:
                self._count(np.ascontiguousarray(records[_CLASS]))
            self._n += len(records)
            self._n_cells += (rows.stop - rows.start) * self._shape.points_per_line
            self._handle.write(records.data)

    def _close(self) -> None:
        self._write_header()
        self._handle.close()


def _cells(axis: int, name: str) -> OptionalColumn:
    """Return line or column of every shot as an optional column."""

    def of_shots(block: LabelledBlock) -> Values:
        numbers: Values = np.indices(block.block.range_m.shape, sparse=True)[axis]
        return np.broadcast_to(
            numbers + (0 if axis else block.block.first_line), block.block.range_m.shape
        )

    def of_extra(block: LabelledBlock) -> Values:
        extra = block.block.extra
        numbers = extra.column if axis else block.block.first_line + extra.line.astype(np.int64)
        return np.asarray(numbers).astype(np.uint32)

    dimension = ExtraDimension(name, np.dtype("<u4"), "")
    return OptionalColumn(
        dimension, name, "range", name.replace("_", " "), NO_CELL, of_shots, of_extra
    )


_CELLS: tuple[OptionalColumn, ...] = tuple(
    _cells(axis, name) for axis, name in enumerate(_CELL_NAMES)
)
_RANGE = OptionalColumn(
    RANGE,
    "range",
    "range",
    "range",
    np.nan,
    lambda block: block.block.range_m,
    lambda block: block.block.extra.range_m,
)


class CloudRewriter(ScatterWriter):
    """Writer of a cloud with all its properties, class, line, column (4294967295 = none), range."""

    def __init__(self, labels: LabelOutput, source: CloudSource) -> None:
        asked = [
            column for column in asked_columns(labels.options) if column.dimension is not RANGE
        ]
        present = {name.lower() for name in source.head.types}
        added = [_RANGE] if "range" not in source.dimensions else []
        cells = _CELLS
        if labels.is_thinned:
            cells = ()
            added = []
            asked = []
        super().__init__(labels, [*cells, *added, *asked], source.n_records)
        self._own_comment = f"{OWN_COMMENT}{labels.points_per_line}"
        self._source = source
        written = {_CLASS, *(column.name for column in cells)}
        self._kept = tuple(
            name
            for name in source.head.types
            if name.lower() not in written
            and name not in {column.name for column in (*added, *asked)}
        )
        replaced = sorted(present & written)
        if replaced:
            self._notice(f"the input has {', '.join(replaced)} already; the values were replaced")

        self._width = None if labels.is_thinned or labels.is_part else source.head.points_per_line
        if lost := self._lost():
            self._notice(f"not kept: {'; '.join(lost)}")

    def _lost(self) -> list[str]:
        """Return the facts of the input's header that the output cannot keep."""
        head = self._source.head
        is_pcd = self.path.suffix.lower() == ".pcd"
        lost = [f"element {name}" for name in head.others]
        lost += [
            f"field {name} as one field: its numbers are fields of their own"
            for name in head.vectors
        ]
        if head.viewpoint and not is_pcd:
            lost.append("the viewpoint " + " ".join(f"{value:g}" for value in head.viewpoint))
        if head.points_per_line and not (is_pcd and self._width):
            lost.append(f"the rows of {head.points_per_line} points")
        return lost

    def _write(self, record: RunRecord) -> RunRecord:
        source = self._source
        total = self._total(record)
        fields: list[tuple[str, np.dtype[Any]]] = []
        for name in self._kept:
            kind = source.head.types[name].newbyteorder("<")
            if kind.str[1:] not in PLY_TYPES:
                problem = f"cannot hold {name} of type {kind.str}"
                raise OutputError(str(self.path), problem, "write .laz instead")
            fields.append((name, kind))
        fields += [(column.name, column.dtype) for column in self._optional]
        dtype = np.dtype([*fields, (_CLASS, np.dtype("u1"))])
        with self._temporary.open("wb") as handle:
            comments = (
                *(text for text in source.head.comments if not text.startswith(OWN_COMMENT)),
                self._own_comment,
            )
            suffix = self.path.suffix.lower()
            viewpoint = source.head.viewpoint
            handle.write(cloud_header(suffix, dtype, total, comments, self._width, viewpoint))
            stored = source.stored(self._kept)
            for first, columns, n in stored:
                records = np.empty(n, dtype)
                for name in self._kept:
                    records[name] = columns[name]
                for column in self._optional:
                    records[column.name] = self._spools[column.name].span(first, first + n)
                records[_CLASS] = self._code_spool.span(first, first + n)
                if self._is_part:
                    records = records[self._code_spool.span(first, first + n) != NO_CODE]
                self._count(np.ascontiguousarray(records[_CLASS]))
                handle.write(records.data)
                total -= len(records)
                if not total and self._is_part:
                    break
        if total:
            problem = "found another number of points than at the start of the run"
            raise InputError(source.path, problem, "run again when nothing else writes the input")
        return self._completed(record)


def open_label_writer(labels: LabelOutput) -> StagedWriter:
    """Return the writer that keeps the properties of a PLY or PCD input, or writes a new cloud."""
    if labels.source.suffix in CLOUD_SUFFIXES:
        cloud = replace(labels.source, layout=None).records()
        if isinstance(cloud, CloudSource):
            return CloudRewriter(labels, cloud)
    return CloudWriter(labels.path, labels=labels)
