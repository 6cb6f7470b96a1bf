"""Reads columns of arrays and Parquet files as lists of records, for evaluation."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.files import suffix_of
from prc_cli.core.process import bounded
from prc_cli.formats.arrays.rows import ArrayFile
from prc_cli.formats.names import usual_names
from prc_cli.formats.options import LayoutField, decode
from prc_cli.formats.records import Reading, RecordChunk, Source, nearest_first
from prc_cli.formats.registry import by_suffix

if TYPE_CHECKING:
    import pyarrow as pa

BUFFER_BYTES = 1 << 20
"""Bytes of a column of a Parquet file read at a time."""
CHUNK_RECORDS = 1 << 19
"""Records read at a time."""
AXES = ("x", "y", "z")
XYZ = "xyz"


def open_table(path: Path) -> Source | None:
    """Open a file of columns; None for files that only have class codes."""
    suffix = suffix_of(path)
    form = by_suffix("scans").get(suffix) or by_suffix("codes").get(suffix)
    return None if form is None else form.column_source(path)


class ArrayTable:
    """Reader of ``.npy`` and ``.npz`` files as records: one per cell of an image, in stream order.

    An array with one number per record is a column: (records,), or (lines, M) for images. ``xyz``
    has one axis more and becomes three columns. Images also have ``scan_line``, the row, and
    ``column``.
    """

    format = "array"
    """Reader name."""
    facts = SourceFacts()
    """The file has no other metadata."""

    def __init__(self, path: Path) -> None:
        self._file = ArrayFile(path)
        shapes = [
            header.shape for header in self._file.headers.values() if header.dtype.kind in "iuf"
        ]
        images = [shape for shape in shapes if len(shape) == 2 and shape[1] > 3]
        clouds = [shape[:2] for shape in shapes if len(shape) == 3 and shape[2] == 3]
        lists = [shape for shape in shapes if len(shape) == 1]
        self._image: tuple[int, ...] = max(
            [*images, *clouds] or lists or [(0,)], key=lambda shape: int(np.prod(shape))
        )
        self._columns: dict[str, tuple[str, int]] = {}
        for name, header in self._file.headers.items():
            if header.dtype.kind not in "iuf":
                continue
            if header.shape == self._image:
                self._columns[name] = (name, 0)
            elif name == XYZ and header.shape == (*self._image, 3):
                self._columns.update({axis: (name, k) for k, axis in enumerate(AXES)})
        self._columns, self._units = _by_standard(self._columns)

    @property
    def path(self) -> str:
        """File name, for messages."""
        return str(self._file.path)

    @property
    def n_records(self) -> int:
        """Number of records."""
        return int(np.prod(self._image))

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names that :meth:`chunks` can deliver."""
        cells = ("scan_line", "column") if len(self._image) == 2 else ()
        return (*self._columns, *(name for name in cells if name not in self._columns))

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Read from the start, in bounded memory."""
        _check_names(self, names)
        m = self._image[1] if len(self._image) == 2 else 1
        n_lines = max(1, CHUNK_RECORDS // m)
        arrays = tuple(
            dict.fromkeys(self._columns[name][0] for name in names if name in self._columns)
        )
        with self._file.open(*arrays) as readers:
            for first in range(0, self._image[0], n_lines):
                n = min(n_lines, self._image[0] - first)
                read = {name: rows.read(n) for name, rows in zip(arrays, readers, strict=True)}
                values: dict[str, NDArray[Any]] = {}
                for name in names:
                    if name in self._columns:
                        array, axis = self._columns[name]
                        is_xyz = read[array].size == 3 * n * m
                        stored = read[array].reshape(n * m, 3 if is_xyz else 1)
                        values[name] = _decoded(stored[:, axis], self._units.get(name))
                    elif name == "scan_line":
                        values[name] = np.repeat(np.arange(first, first + n), m)
                    else:
                        values[name] = np.tile(np.arange(m), n)
                yield RecordChunk(first * m, values, n * m)
            for rows in readers:
                rows.finish()

    def with_reading(self, reading: Reading) -> ArrayTable:
        """Return the source, which has one way of reading."""
        return self


class ParquetTable:
    """Reader of the numeric columns of a Parquet file as records."""

    format = "Parquet"
    """Reader name."""
    facts = SourceFacts()
    """The file has no other metadata."""

    def __init__(self, path: Path) -> None:
        import pyarrow as pa

        self._path = path
        try:
            schema, self.n_records = self._measure()
            # names are decoded here
            names = schema.names
            kinds = schema.types
        except (pa.ArrowException, OSError, ValueError) as error:
            raise _damaged(self._path, error) from error
        numbers = []
        for name, kind in zip(names, kinds, strict=True):
            stored = kind.value_type if pa.types.is_dictionary(kind) else kind
            if pa.types.is_integer(stored) or pa.types.is_floating(stored):
                numbers.append(name)
        self._columns, self._units = _by_standard({name: name for name in numbers})

    @property
    def path(self) -> str:
        """File name, for messages."""
        return str(self._path)

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names that :meth:`chunks` can deliver."""
        return tuple(self._columns)

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Read from the start, in bounded memory; an empty cell is NaN."""
        import pyarrow as pa

        _check_names(self, names)
        stored = tuple(dict.fromkeys(self._columns[name] for name in names))
        first = 0
        try:
            for batch in read_batches(self._path, stored):
                read = {name: _numbers(batch.column(name)) for name in stored}
                values = {
                    name: _decoded(read[self._columns[name]], self._units.get(name))
                    for name in names
                }
                yield RecordChunk(first, values, batch.num_rows)
                first += batch.num_rows
        except (pa.ArrowException, OSError, ValueError) as error:
            raise _damaged(self._path, error) from error

    def with_reading(self, reading: Reading) -> ParquetTable:
        """Return the source, which has one way of reading."""
        return self

    def _measure(self) -> tuple[pa.Schema, int]:
        from pyarrow import parquet

        with parquet.ParquetFile(self._path) as file:
            return file.schema_arrow, int(file.metadata.num_rows)


_Place = TypeVar("_Place")


def _by_standard(columns: dict[str, _Place]) -> tuple[dict[str, _Place], dict[str, LayoutField]]:
    """Return columns by standard name, if theirs is a usual one, and decodings of other units."""
    usual = usual_names(list(columns))
    standard = {dimension.name: name for name, dimension in usual.items()}
    units = {
        name: LayoutField.model_validate({"name": name, "unit": dimension.unit})
        for name, dimension in usual.items()
        if dimension.unit or name == "angle"
    }
    return {standard.get(name, name): place for name, place in columns.items()}, units


def _numbers(column: pa.Array) -> NDArray[Any]:
    import pyarrow as pa

    if isinstance(column, pa.DictionaryArray):
        column = column.dictionary_decode()
    values: NDArray[Any] = column.to_numpy(zero_copy_only=False)
    return values


def _decoded(stored: NDArray[Any], item: LayoutField | None) -> NDArray[Any]:
    return stored if item is None else decode(stored, item)


def read_batches(path: Path, columns: Sequence[str]) -> Iterator[pa.RecordBatch]:
    """Read top-level columns of a Parquet file in bounded memory."""
    from pyarrow import parquet

    # a row group can be as large as the file: read it through a small buffer
    with parquet.ParquetFile(path, pre_buffer=False, buffer_size=BUFFER_BYTES) as file:
        yield from bounded(path, file.iter_batches(batch_size=CHUNK_RECORDS, columns=list(columns)))


def _check_names(source: Source, names: tuple[str, ...]) -> None:
    unknown = [name for name in names if name not in source.dimensions]
    if unknown:
        known = ", ".join(nearest_first(source.dimensions, unknown[0])[:40])
        raise ConfigError(
            source.path, f"no dimension {unknown[0]!r} in the file", f"it has: {known or 'none'}"
        )


def _damaged(path: Path, error: Exception) -> InputError:
    text = " ".join(str(error).split())[:160]
    return InputError(
        str(path), f"no whole Parquet file ({text})", "copy it from the archive again"
    )
