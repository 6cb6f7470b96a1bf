"""Writers of streams as tables.

One row per cell, missing shots included, and one per further return of a shot.

``.csv`` (plain, gzip or zstd) is read by column name; numbers are the shortest text that gives the
same bits again. ``.parquet`` has the same columns, for other programs.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from prc_cli.core.classes import NO_CODE
from prc_cli.core.errors import OutputError
from prc_cli.formats.writing.base import StreamItem, StreamShape, StreamWriter
from prc_cli.formats.writing.rows import stream_rows

ROWS_AT_ONCE = 1 << 17
"""Rows converted at a time."""


def table_columns(shape: StreamShape) -> dict[str, pa.DataType]:
    """Return names and types of the columns of a stream, in their order."""
    angles = pa.float64()
    xyz = pa.float64() if shape.registered else pa.float32()
    wanted: list[tuple[str, bool, pa.DataType]] = [
        ("point_source_id", shape.scanners, pa.uint32()),
        ("line", True, pa.int64()),
        ("column", True, pa.int32()),
        ("return_number", shape.returns, pa.int32()),
        ("number_of_returns", shape.returns, pa.int32()),
        ("angle_deg", shape.angles, angles),
        ("range_m", True, pa.float32()),
        ("time_s", shape.times, pa.float64()),
        *((axis, shape.xyz or shape.registered, xyz) for axis in "xyz"),
        # without intensities a reader would choose the first return, whichever was chosen in the
        # input
        ("intensity", shape.intensity or shape.returns, pa.float32()),
        ("class", shape.codes, pa.int32()),
    ]
    return {name: kind for name, present, kind in wanted if present}


class _TableStream(StreamWriter):
    """Turns blocks into tables."""

    def __init__(self, path: Path, shape: StreamShape) -> None:
        super().__init__(path, shape)
        self._columns = table_columns(shape)
        self._schema = pa.schema(list(self._columns.items()))
        self._writer: Any = None

    def _add(self, item: StreamItem) -> None:
        lines = max(1, ROWS_AT_ONCE // item.block.points_per_line)
        for first in range(0, item.block.n_lines, lines):
            values = stream_rows(item, slice(first, min(first + lines, item.block.n_lines)))
            columns = [_array(values[name], kind) for name, kind in self._columns.items()]
            try:
                self._writer.write_table(pa.Table.from_arrays(columns, schema=self._schema))
            except pa.ArrowException as error:
                raise OutputError(
                    str(self.path), f"cannot be written ({error})", "check the disk"
                ) from error


class CsvStream(_TableStream):
    """Writer of text."""

    def _start(self) -> None:
        super()._start()
        kind = {".gz": "gzip", ".zst": "zstd"}.get(self.path.suffix.lower())
        sink: Any = pa.PythonFile(self._handle, mode="w")
        self._sink = sink if kind is None else pa.CompressedOutputStream(sink, kind)
        self._stack.callback(_close, self._sink)
        self._sink.write((",".join(self._columns) + "\n").encode())
        options = pa.csv.WriteOptions(include_header=False, quoting_style="none")
        self._writer = pa.csv.CSVWriter(self._sink, self._schema, write_options=options)
        self._stack.callback(_close, self._writer)

    def _close(self) -> None:
        self._writer.close()
        self._sink.close()
        super()._close()


class ParquetStream(_TableStream):
    """Writer of Parquet."""

    def _start(self) -> None:
        super()._start()
        self._writer = pa.parquet.ParquetWriter(self._handle, self._schema)
        self._stack.callback(_close, self._writer)

    def _close(self) -> None:
        self._writer.close()
        super()._close()


def _close(stream: Any) -> None:
    """Close the Arrow writer early, or it complains on stderr later.

    An abandoned file may be broken.
    """
    with contextlib.suppress(OSError, ValueError, pa.ArrowException):
        stream.close()


def _array(values: NDArray[Any], kind: pa.DataType) -> pa.Array:
    """Return a column; NaN and missing codes are empty cells."""
    if values.dtype.kind == "f":
        return pa.array(values, kind, mask=np.isnan(values))
    # Arrow names integer types as NumPy does
    return pa.array(values.astype(str(kind)), kind, mask=values == NO_CODE)
