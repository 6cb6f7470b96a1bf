"""One side of an evaluation: class codes of files, with the columns to match and split by."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import NO_CODE
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.types import F64, I64, U8, Mask
from prc_cli.formats.labels import open_codes
from prc_cli.formats.las.read import LasSource
from prc_cli.formats.records import (
    CLASS_CODE,
    CodeSource,
    Reading,
    RecordChunk,
    Source,
    filtered,
)
from prc_cli.formats.tables.read import open_table
from prc_cli.formats.writing.record import dense_line_beside
from prc_cli.matching.join import CODE, KEY, RECORD, SAME, Columns, in_step
from prc_cli.matching.keys import AXES, KeyRule, exact_keys

MISSING = 0
"""Code of a shot without return in label files."""
MAX_SAME = 3
"""Numbers of 16 bits that are packed into the one that must be equal."""
_LIMIT_16 = 1 << 16
_RECORD = "record number"
"""Column of the numbers of records; the blank keeps it apart from dimensions."""


def classified(records: Source) -> Source:
    """Return the records of labels that have a class, with :data:`CLASS_CODE` (uint8).

    Records without a class (an empty cell; code 0 in label files, a shot without return) are left
    out.
    """
    return filtered(records, lambda names, labels: _classified(names, labels, records.path))


def with_codes(records: Source, codes: CodeSource) -> Source:
    """Return the records that have a class in a file of codes, with it; see :func:`classified`."""

    def chunks(names: tuple[str, ...], stored: Source, labels: Source) -> Iterator[RecordChunk]:
        carried = tuple(name for name in names if name != CLASS_CODE)
        streams: list[Iterator[Columns]] = [
            ({**chunk.values, _RECORD: chunk.records()} for chunk in stored.chunks(carried)),
            (chunk.values for chunk in labels.chunks((CLASS_CODE,))),
        ]
        first = 0
        for values, coded in in_step(streams, lambda n: _check_counts(stored, labels, n)):
            record = values.pop(_RECORD)
            yield RecordChunk(first, {**values, **coded}, len(record), record)
            first += len(record)

    beside = filtered(records, chunks, codes, dimensions=(*records.dimensions, CLASS_CODE))
    return filtered(beside, lambda names, labels: _classified(names, labels, codes.path))


def _classified(names: tuple[str, ...], labels: Source, path: str) -> Iterator[RecordChunk]:
    n_kept = 0
    for chunk in labels.chunks(tuple(dict.fromkeys((*names, CLASS_CODE)))):
        codes = chunk.values[CLASS_CODE]
        has_class = (codes != MISSING) & (codes != NO_CODE)
        record = chunk.records()[has_class]
        values = {name: chunk.values[name][has_class] for name in names}
        if CLASS_CODE in names:
            values[CLASS_CODE] = _class_codes(path, codes[has_class], record)
        yield RecordChunk(n_kept, values, len(record), record)
        n_kept += len(record)


def _check_counts(records: Source, codes: Source, n: Sequence[int]) -> None:
    n_records, n_codes = n
    if n_records == n_codes:
        return
    expected = f"{n_records} as {records.path} has records"
    if n_codes < n_records:
        expected = f"one for every record of {records.path}, which has more"
    problem = f"found {n_codes} class codes, expected {expected}"
    raise InputError(codes.path, problem, "name the input that was classified")


def _class_codes(path: str, codes: NDArray[Any], record: I64) -> U8:
    """Return codes as LAS holds them, (n,) uint8; refuse others."""
    if codes.dtype == np.uint8:
        return codes
    with np.errstate(invalid="ignore"):
        wrong = ~((codes >= 0) & (codes <= 255) & (np.floor(codes) == codes))
    if wrong.any():
        first_wrong = int(np.argmax(wrong))
        problem = (
            f"record {record[first_wrong]}: found the class code {codes[first_wrong]}, "
            "expected 0 to 255 as LAS holds them"
        )
        hint = "name the dimension with LAS class codes: --dimension NAME"
        raise InputError(path, problem, hint)
    return codes.astype(np.uint8)


def with_key(records: Source, rule: KeyRule, code_dimension: str = "classification") -> Source:
    """Return records with the key of a rule, and their class.

    Chunks hold any of :data:`KEY` (float64), :data:`SAME` (int64), :data:`CODE` (uint8, from
    ``code_dimension``) and the dimensions of the records.
    """

    def chunks(names: tuple[str, ...], stored: Source) -> Iterator[RecordChunk]:
        carried = tuple(name for name in names if name not in (KEY, SAME, CODE))
        wanted = tuple(dict.fromkeys((*rule.names, code_dimension, *carried)))
        for chunk in stored.chunks(wanted):
            record = chunk.records()
            columns = {
                **chunk.values,
                CODE: _class_codes(stored.path, chunk.values[code_dimension], record),
                KEY: _keys(stored.path, chunk, rule),
                SAME: _packed(stored.path, chunk, rule.same),
            }
            values = {name: columns[name] for name in names}
            yield RecordChunk(chunk.first_record, values, chunk.n, record)

    return filtered(records, chunks, dimensions=(KEY, SAME, CODE, *records.dimensions))


def _keys(path: str, chunk: RecordChunk, rule: KeyRule) -> F64:
    if rule.kind == "record":
        return chunk.records().astype(np.float64)
    if rule.kind == "rank":
        first = chunk.first_record
        return np.arange(first, first + chunk.n, dtype=np.float64)
    stored = chunk.values[rule.dimension]
    key, usable = exact_keys(stored)
    expected = "a whole number below 2^53"
    if rule.kind in ("time", "place"):
        usable = np.isfinite(key)
        expected = f"a finite {'time' if rule.kind == 'time' else 'coordinate'}"
    if not usable.all():
        first_wrong = int(np.argmin(usable))
        problem = (
            f"record {chunk.records()[first_wrong]}: found {rule.dimension} "
            f"{stored[first_wrong]}, expected {expected} for every point"
        )
        hint = "leave such points out, or match by something else with --match"
        raise InputError(path, problem, hint)
    return key + rule.offset if rule.offset else key


def _packed(path: str, chunk: RecordChunk, names: tuple[str, ...]) -> I64:
    """Return dimensions that must be equal as one number, 16 bits each."""
    packed = np.zeros(chunk.n, np.int64)
    for name in names:
        stored = chunk.values[name]
        with np.errstate(invalid="ignore"):
            wrong = ~((stored >= 0) & (stored < _LIMIT_16) & (np.floor(stored) == stored))
        if wrong.any():
            first_wrong = int(np.argmax(wrong))
            problem = (
                f"record {chunk.records()[first_wrong]}: found {name} {stored[first_wrong]}, "
                "expected a whole number from 0 to 65535"
            )
            is_return = name == "return_number"
            hint = "--match time+no-return" if is_return else f"leave +{name} out of --match"
            raise InputError(path, problem, hint)
        packed = (packed << 16) | stored.astype(np.int64)
    return packed


@dataclass(frozen=True, slots=True)
class Survey:
    """Number, bounds and order of the keys of a source."""

    n_records: int
    """Records with a class."""
    n_read: int
    """Records of the input, up to the last one with a class."""
    low: float
    high: float
    """Bounds of the key; NaN without records."""
    in_order: bool
    """Whether the keys never go back."""


def survey(source: Source) -> Survey:
    """Read all keys and codes once."""
    n = n_read = 0
    low = np.inf
    high = -np.inf
    last = -np.inf
    in_order = True
    for chunk in source.chunks((KEY, SAME, CODE)):
        key = chunk.values[KEY]
        if not len(key):
            continue
        assert chunk.record is not None
        n += len(key)
        n_read = max(n_read, int(chunk.record[-1]) + 1)
        in_order = in_order and bool(key[0] >= last) and bool(np.all(key[1:] >= key[:-1]))
        last = float(key[-1])
        low = min(low, float(key.min()))
        high = max(high, float(key.max()))
    if not n:
        low = high = np.nan
    return Survey(n, n_read, low, high, in_order)


FILE = "file"
ROW = "row"
"""Index of the file, index of the record in it: int64, every side has them and :data:`CODE`."""
RANGE = "range"
LINE = "line"
SCANNER = "scanner"
SECONDS = "seconds"
CONFIDENCE = "confidence"
COLUMN = "column"
REASON = "reason"
"""What a side may have.

Range [m], scan line, scanner id, time [s], confidence [per cent], shot in the line, number of the
rule that gave the class.

-1 (NaN for ranges and times) = not known. :data:`SAME` is the return number, 0 to 255; 0 = not
known."""
MAX_RETURN = 255
UNKNOWN = -1
SCANNER_NAMES = ("scanner", "point_source_id", "scanner_channel")
"""Dimensions that identify the scanner; the first one present is taken."""
_NAMES = {
    SAME: ("return_number",),
    RANGE: ("range",),
    LINE: ("scan_line",),
    SCANNER: SCANNER_NAMES,
    SECONDS: ("time",),
    CONFIDENCE: (CONFIDENCE,),
    COLUMN: (COLUMN,),
    REASON: (REASON,),
}
_INDEX = ""
_LINE = "scan_line"
LONGEST_LINE = 1 << 22
"""A cell is one whole number: its line times this, and its column."""
_MAX_ID = 1 << 31

FARTHEST_M = 1e9
"""Coordinates beyond are as good as not finite [m]."""


@dataclass(frozen=True, slots=True)
class SideFile:
    """The files that one file of a side is read from."""

    codes: CodeSource
    name: str | None
    """Dimension that holds the codes, as it was asked for."""
    table: Source | None
    """The same file, if it holds more than codes."""
    points: Source | None
    """The points that labels alone belong to, record by record."""
    dense_line: int | None = None
    """M, where there is a code for every cell, in order; None = not known."""
    is_whole: bool = False
    """Whether a LAS file still has all its records, so that they can be counted."""

    @classmethod
    def open(cls, path: Path, dimension: str | None, points: Path | None) -> SideFile:
        """Open a file and the points it belongs to."""
        codes = open_codes(path, dimension)
        table = open_table(path)
        points_table = None
        if points is not None:
            if not points.is_file():
                raise InputError(
                    str(points), "no such file, expected the points of the labels", "check the name"
                )
            points_table = open_table(points)
            if points_table is None:
                problem = "unknown suffix, expected points: LAS, LAZ, text, .npz or .parquet"
                raise InputError(str(points), problem, "name the input of the run")
        return cls(codes, dimension, table, points_table, dense_line_beside(path))

    @property
    def sources(self) -> tuple[Source, ...]:
        """Whatever holds columns, the file itself first."""
        return tuple(source for source in (self.table, self.points) if source is not None)

    def find(self, names: tuple[str, ...]) -> tuple[Source, str] | None:
        """Return the source that holds the first of some dimensions, and its name there."""
        for source in self.sources:
            for name in names:
                if name in source.dimensions:
                    return source, name
        return None

    @property
    def knows_cells(self) -> bool:
        """Whether the scan line and the column of every record are known."""
        return self.has_cells or self.dense_line is not None

    @property
    def has_cells(self) -> bool:
        """Whether the records themselves hold their scan line and column."""
        return self.find((_LINE,)) is not None and self.find((COLUMN,)) is not None

    @property
    def crs(self) -> str | None:
        """Coordinate system of the coordinates, None where the file does not say."""
        place = self.find(("x",))
        return None if place is None else place[0].facts.crs_wkt

    def check_lengths(self, lengths: Sequence[int]) -> None:
        """Refuse codes, the first of some streams, that are not as many as the records."""
        if len(set(lengths)) == 1:
            return
        points = self.points.path if self.points is not None else "its own columns"
        problem = (
            f"{lengths[0]} class codes, but {points} holds {lengths[-1]} records; "
            "expected a code for every record"
        )
        raise InputError(self.codes.path, problem, "name the input that was classified")


@dataclass(slots=True)
class SideTally:
    """Counts of one reading of a side."""

    n_records: int = 0
    n_not_finite: int = 0
    """Records left out because a key or a coordinate is NaN or infinite."""
    low: float = np.inf
    high: float = -np.inf
    """Bounds of the key."""
    n_columns: int = 0
    """Up to the last one that has a record, where the key is the cell."""

    def add_keys(self, key: F64) -> None:
        """Widen the bounds by some keys."""
        self.low = min(self.low, float(key.min()))
        self.high = max(self.high, float(key.max()))
        self.n_columns = max(self.n_columns, int((key % LONGEST_LINE).max()) + 1)

    @property
    def n_usable(self) -> int:
        """Records that can find a partner."""
        return self.n_records - self.n_not_finite

    @property
    def n_lines(self) -> int:
        """Scan lines up to the last one that has a record, where the key is the cell."""
        return int(self.high // LONGEST_LINE) + 1


@dataclass(frozen=True)
class Side:
    """The records of one or several files, a source of :data:`KEY`, :data:`CODE` and more columns.

    Chunks of :meth:`chunks` carry ``record``, the index in all files together; records without a
    finite key are left out and counted in ``tally``, which every reading starts again.
    """

    files: Sequence[SideFile]
    key: KeyRule | None = None
    points_per_line: int | None = None
    tally: SideTally = field(default_factory=SideTally)
    format: str = "class codes"
    facts: SourceFacts = field(default_factory=SourceFacts)
    """The files are asked one by one: see :class:`SideFile`."""
    n_records: int | None = None
    """Not known before reading."""

    @property
    def path(self) -> str:
        """First file, for messages."""
        more = f" and {len(self.files) - 1} more" if len(self.files) > 1 else ""
        return f"{self.files[0].codes.path}{more}"

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names that :meth:`chunks` can deliver."""
        key = [] if self.key is None else [KEY]
        optional = [
            name
            for name in (SAME, RANGE, LINE, SCANNER, SECONDS, CONFIDENCE, COLUMN, REASON)
            if all(self._place(file, name) for file in self.files)
        ]
        has_place = all(file.find((axis,)) for file in self.files for axis in AXES)
        axes = AXES if has_place else ()
        return (*key, CODE, FILE, ROW, *optional, *axes)

    def check(self) -> None:
        """Refuse files without the key."""
        if self.key is None:
            return
        for file in self.files:
            for name in self.key.key_names:
                if self._place(file, name) is not None:
                    continue
                present: dict[str, None] = {}
                for source in file.sources:
                    present |= dict.fromkeys(source.dimensions[:30])
                problem = (
                    f"no {name!r} to match by in the file, which has: "
                    f"{', '.join(present) or 'class codes alone'}"
                )
                hint = "name the points that the labels belong to, or match by something else"
                raise ConfigError(file.codes.path, problem, hint)

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Read all files from the first record on."""
        for tally_field in fields(SideTally):
            setattr(self.tally, tally_field.name, tally_field.default)
        n_before = 0
        for index, file in enumerate(self.files):
            n_in_file = 0
            for columns, row in self._read(file, names):
                n = len(row)
                values = {**columns, ROW: row, FILE: np.full(n, index, np.int64)}
                first = n_before + n_in_file
                record = np.arange(first, first + n)
                n_in_file += n
                self.tally.n_records += n
                finite = self._finite(values, n)
                if not finite.all():
                    self.tally.n_not_finite += n - int(np.count_nonzero(finite))
                    values = {name: column[finite] for name, column in values.items()}
                    record = record[finite]
                if KEY in values and len(record):
                    self.tally.add_keys(values[KEY])
                read = {name: values[name] for name in names}
                yield RecordChunk(first, read, len(record), record)
            if not n_in_file:
                problem = "no records, expected class codes"
                raise InputError(file.codes.path, problem, "check the file")
            n_before += n_in_file

    def with_reading(self, reading: Reading) -> Side:
        """Return the side, which has one way of reading."""
        return self

    def _finite(self, values: Columns, n: int) -> Mask:
        """Return which records have a key, and a place if that is the key."""
        finite = np.ones(n, np.bool_)
        if self.key is None:
            return finite
        if self.key.kind == "place":
            for name in (KEY, *AXES):
                if name in values:
                    finite &= np.abs(values[name]) < FARTHEST_M
        elif KEY in values:
            finite &= np.isfinite(values[KEY])
        return finite

    def _place(self, file: SideFile, name: str) -> tuple[Source | None, str] | None:
        """Return the source of a column and its name there; a source of None = it is counted."""
        if name in (LINE, COLUMN) and self.points_per_line is not None:
            return file.find(_NAMES[name]) or (None, _INDEX)
        place = file.find(_NAMES.get(name, (name,)))
        by_index = name == RECORD and self.key == KeyRule("dimension", RECORD)
        # points may have been removed from a LAS file since
        is_whole = file.is_whole or not isinstance(file.table, LasSource)
        if place is None and by_index and is_whole:
            return None, _INDEX
        return place

    def _read(self, file: SideFile, names: tuple[str, ...]) -> Iterator[tuple[Columns, I64]]:
        """Yield the columns of a file but :data:`FILE` and :data:`ROW`, and record indices."""
        by_cell = KEY in names and self.key is not None and self.key.kind == "cell"
        has_cells = by_cell and file.has_cells
        dimensions = self._dimensions_to_read(names, has_cells=has_cells)
        places = {name: self._place(file, dimension) for name, dimension in dimensions.items()}
        by_source: dict[int, list[str]] = {}
        for place in places.values():
            if place is not None and place[0] is not None:
                by_source.setdefault(file.sources.index(place[0]), []).append(place[1])
        # codes in the same file as other columns are read together with them, once
        codes_in_table = (
            file.table is not None and 0 in by_source and file.codes.name in file.table.dimensions
        )
        streams: list[Iterator[Columns]] = []
        if codes_in_table:
            by_source[0].append(file.codes.name)
        else:
            streams.append({CLASS_CODE: codes} for codes in file.codes.codes())
        for k, source_names in by_source.items():
            chunks = file.sources[k].chunks(tuple(dict.fromkeys(source_names)))
            streams.append(chunk.values for chunk in chunks)

        row = 0
        for parts in in_step(streams, file.check_lengths):
            # a name is always read from the first source that has it
            read = {name: column for part in parts for name, column in part.items()}
            n = len(next(iter(read.values())))
            index = np.arange(row, row + n, dtype=np.int64)
            codes = read[file.codes.name if codes_in_table else CLASS_CODE]
            values: Columns = {CODE: file.codes.to_codes(codes, row) if codes_in_table else codes}
            for name, place in places.items():
                stored: NDArray[Any] = index
                if place is not None and place[0] is not None:
                    stored = read[place[1]]
                elif name == LINE and self.points_per_line:
                    stored = index // self.points_per_line
                elif name == COLUMN and self.points_per_line:
                    stored = index % self.points_per_line
                values[name] = self._typed(file, name, stored, row)
            if has_cells:
                values[KEY] = _cell_keys(values[_LINE], values[COLUMN])
            elif by_cell:
                values[KEY] = _cell_keys(*np.divmod(index, file.dense_line or 1))
            yield values, index
            row += n

    def _dimensions_to_read(self, names: tuple[str, ...], *, has_cells: bool) -> dict[str, str]:
        """Return the dimension of every column that is read or counted."""
        dimensions = {name: name for name in names if name not in (CODE, FILE, ROW)}
        if self.key is None:
            return dimensions
        if KEY in names:
            dimensions[KEY] = self.key.dimension
            if self.key.kind == "cell":  # made of line and column
                del dimensions[KEY]
            if has_cells:
                dimensions |= {_LINE: _LINE, COLUMN: COLUMN}
        if self.key.kind == "place":
            dimensions |= {axis: axis for axis in AXES}
        return dimensions

    def _typed(
        self,
        file: SideFile,
        name: str,
        stored: NDArray[Any],
        first: int,
    ) -> NDArray[Any]:
        """Return a column in the type of its name; ids must be exact in float64."""
        if name == KEY and self.key is not None and self.key.kind == "dimension":
            ids, exact = exact_keys(stored)
            wrong = ~(exact | np.isnan(ids))
            if wrong.any():
                first_wrong = int(np.argmax(wrong))
                problem = (
                    f"record {first + first_wrong}: found dimension:{self.key.dimension} "
                    f"{stored[first_wrong]}, expected a whole number below 2^53"
                )
                raise InputError(file.codes.path, problem, "match by a dimension of whole numbers")
            return ids
        if name in (KEY, RANGE, SECONDS, *AXES):
            return np.asarray(stored, np.float64)
        if name == SAME:
            return np.clip(_whole(stored), 0, MAX_RETURN)
        return _whole(stored)


def _cell_keys(line: NDArray[Any], column: NDArray[Any]) -> F64:
    """Return cells as whole numbers, NaN where one is not known.

    >>> _cell_keys(np.array([0, 1, -1]), np.array([7, 0, 3])).tolist()
    [7.0, 4194304.0, nan]
    """
    known = (line >= 0) & (column >= 0) & (column < LONGEST_LINE)
    return np.where(known, line * float(LONGEST_LINE) + column, np.nan)


def _whole(stored: NDArray[Any]) -> I64:
    """Return integers as int64; -1 for NaN, negative numbers and numbers of 2^31 or more."""
    with np.errstate(invalid="ignore"):
        wide = stored.astype(np.float64)
        known = (wide >= 0) & (wide < _MAX_ID)
    return np.where(known, wide, UNKNOWN).astype(np.int64)
