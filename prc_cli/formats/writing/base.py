"""Base classes of writers: outputs appear complete, with their run record, or not at all."""

from __future__ import annotations

import contextlib
import os
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Protocol, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

from prc_cli.core.bytewise import count_bytes, recode
from prc_cli.core.classes import LABEL_NAMES, MISSING_CODE, ClassCodes, Label
from prc_cli.core.errors import OutputError
from prc_cli.core.files import output_errors, place_all, temporary_name
from prc_cli.core.stream import LabelledBlock, ScanBlock, StreamInfo
from prc_cli.core.types import F64, I32, I64, U8
from prc_cli.formats.writing.columns import HIGH_NOISE_CODE, OptionalColumn, OutputConfig, Values, class_names
from prc_cli.formats.writing.disk import DiskColumn
from prc_cli.formats.writing.record import ClassCount, RunRecord, fingerprint, record_path

CHUNK_RECORDS = 400_000
"""Records per chunk when an output is written."""


@dataclass(frozen=True, slots=True)
class Columns:
    """Spooled values of consecutive records."""

    codes: U8
    """(n,) uint8, class codes."""
    values: dict[str, Values]
    """(n,) arrays of the optional columns, by name."""
    record: I64 | None = None
    """(n,) int64, index in the input of every record; None = the next ones from 0 on, without a gap."""


class Closable(Protocol):
    """Anything with a ``close`` method."""

    def close(self) -> None:
        """Close it."""


class Writer(Protocol):
    """Interface of all writers: a context manager whose output exists complete or not at all."""

    @property
    def notices(self) -> tuple[str, ...]:
        """Notices of the writer for the user; complete after :meth:`finish`."""

    def __enter__(self) -> Self:
        """Create the temporary files beside the output."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None:
        """Remove every temporary file; without :meth:`finish` no output is left."""

    def finish(self, record: RunRecord) -> RunRecord:
        """Write and rename the output and ``<output>.prc.json``; return the record as written."""


class LabelWriter(Writer, Protocol):
    """Writer that :func:`prc_cli.formats.writing.open_writer` returns."""

    def add(self, block: LabelledBlock) -> None:
        """Take the labels of a block."""


class StagedOutput(ABC):
    """A :class:`Writer` that fills temporary files and renames them at the end."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._notices: list[str] = []
        self._last_record: int | None = -1
        self._files: list[tuple[Path, Path, bool]] = []
        """Temporary name, name, and whether a file of this name is replaced: one that is there at the beginning."""
        self._temporary = self._output(path)
        self._record_temporary = self._output(record_path(path))
        self._stack = contextlib.ExitStack()

    @property
    def notices(self) -> tuple[str, ...]:
        """Notices of the writer for the user."""
        return tuple(self._notices)

    def __enter__(self) -> Self:
        try:
            with output_errors(self.path):
                for temporary, _, _ in self._files:
                    self._stack.callback(remove_quietly, temporary)
                self._start()
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None:
        self._stack.close()

    @abstractmethod
    def _start(self) -> None:
        """Open temporary files; register closing and removal on ``self._stack``."""

    def _output(self, path: Path) -> Path:
        """Register a file of the output; return its temporary name."""
        self._files.append((temporary_name(path), path, os.path.lexists(path)))
        return self._files[-1][0]

    def _notice(self, text: str) -> None:
        if text not in self._notices:
            self._notices.append(text)

    def _see_order(self, scan: ScanBlock) -> None:
        """Notice once that shots are not in the order of the input's records."""
        if scan.record is None or self._last_record is None:
            return
        known = scan.record[scan.record >= 0]
        if not len(known):
            return
        if known[0] < self._last_record or np.any(known[1:] < known[:-1]):
            self._notice("points are in the order of the shots, not of the input's records; label files keep that one")
            self._last_record = None
            return
        self._last_record = int(known[-1])

    def _with_output(self, record: RunRecord) -> RunRecord:
        """Return the record beside the output, with size and hash of what was written."""
        return replace(record, output=fingerprint(self._temporary))

    def _commit(self) -> None:
        """Give the files their final names, or none.

        The output is first, because another program may hold it open.
        """
        place_all(self._files)


class StagedWriter(StagedOutput):
    """A :class:`LabelWriter` with temporary files."""

    def __init__(self, path: Path, codes: ClassCodes, options: OutputConfig, columns: Sequence[OptionalColumn]) -> None:
        super().__init__(path)
        self._codes = codes
        self._options = options
        self._optional = tuple(columns)
        self._settled = False
        self._names = class_names(codes, options)
        self._lookup = np.zeros(256, np.uint8)
        self._lookup[: len(LABEL_NAMES)] = codes.lookup()
        self._counts = np.zeros(256, np.int64)

    def add(self, block: LabelledBlock) -> None:
        """Take the labels of a block (see :class:`LabelWriter`)."""
        with output_errors(self.path):
            self._settle(block)
            self._add(block)

    def finish(self, record: RunRecord) -> RunRecord:
        """Write and name the output (see :class:`LabelWriter`)."""
        with output_errors(self.path):
            self._settle(None)
            record = self._with_output(self._write(record))
            self._record_temporary.write_bytes(record.to_json())
            self._commit()
        return record

    @abstractmethod
    def _begin(self) -> None:
        """Prepare for the first block; called when ``self._optional`` is final."""

    @abstractmethod
    def _add(self, block: LabelledBlock) -> None: ...

    @abstractmethod
    def _write(self, record: RunRecord) -> RunRecord:
        """Fill and close ``self._temporary``; return the completed record."""

    def _spool(self, dtype: DTypeLike, fill: Any, n_records: int | None) -> DiskColumn:
        return self._stack.enter_context(DiskColumn(self.path, dtype, fill, n_records=n_records))

    def _encode(self, labels: U8, range_m: NDArray[np.float32]) -> U8:
        """Class codes of labels, same shape."""
        if labels.size and int(labels.max()) >= len(LABEL_NAMES):
            problem = f"found label {int(labels.max())}, expected 0 to {len(LABEL_NAMES) - 1}"
            raise OutputError(str(self.path), problem, "this is a fault of the classifier; please report it")
        codes = recode(labels, self._lookup)
        beyond = self._options.high_noise_beyond
        if beyond is not None:
            codes[(labels == Label.NOISE) & (range_m > np.float64(beyond))] = HIGH_NOISE_CODE
        return codes

    def _settle(self, block: LabelledBlock | None) -> None:
        """Drop optional columns that the first block lacks, once; without any block all stay."""
        if self._settled:
            return
        self._settled = True
        if block is not None:
            found = {column.name: column.of_shots(block) is not None for column in self._optional}
            added = {column.option for column in self._optional if found[column.name]}
            for column in self._optional:
                if not found[column.name] and column.option not in added:
                    self._notice(f"output.{column.option} needs the {column.needs}; nothing was added")
            self._optional = tuple(column for column in self._optional if found[column.name])
        self._begin()

    def _cells(self, column: OptionalColumn, block: LabelledBlock) -> Values:
        """Values of an optional column for the cells of a block, (lines, M) of its type."""
        values = column.of_shots(block)
        if values is None:
            return np.full(block.labels.shape, column.fill, column.dtype)
        if values.size and values.dtype != column.dtype and column.dtype.kind == "u":
            limit = np.iinfo(column.dtype).max
            low, high = int(values.min()), int(values.max())
            if low < 0 or high > limit:
                problem = f"{column.what} {low if low < 0 else high} does not fit {column.dtype.name} (0 to {limit})"
                raise OutputError(str(self.path), problem, f"set [output] {column.option} = false")
        return values.astype(column.dtype, copy=False)

    def _count(self, codes: U8) -> None:
        self._counts += count_bytes(codes)

    def _completed(self, record: RunRecord) -> RunRecord:
        classes = tuple(
            ClassCount(int(code), self._names.get(int(code), f"class {code}"), int(self._counts[code]))
            for code in np.flatnonzero(self._counts)
        )
        return record.with_written(classes, self.notices)


class ScatterWriter(StagedWriter):
    """A writer of outputs in record order: labels are spooled until all have arrived."""

    def __init__(
        self,
        path: Path,
        codes: ClassCodes,
        options: OutputConfig,
        columns: Sequence[OptionalColumn],
        n_records: int | None,
        *,
        is_part: bool = False,
    ) -> None:
        super().__init__(path, codes, options, columns)
        self._n_records = n_records
        self._is_part = is_part
        self._spools: dict[str, DiskColumn] = {}
        self._there: DiskColumn | None = None
        """Of a part: 1 for every record that it holds."""
        self._first, self._stop = sys.maxsize, 0
        """Bounds of the records that it holds."""

    def _start(self) -> None:
        self._code_spool = self._spool(np.uint8, self._codes.unclassified, self._n_records)
        if self._is_part:
            self._there = self._spool(np.uint8, 0, self._n_records)

    def _begin(self) -> None:
        for column in self._optional:
            self._spools[column.name] = self._spool(column.dtype, column.fill, self._n_records)

    def _add(self, block: LabelledBlock) -> None:
        scan = block.block
        codes = self._encode(block.labels, scan.range_m)
        values = {column.name: self._cells(column, block).ravel() for column in self._optional}
        if scan.record is None and (first := scan.first_line * scan.points_per_line) + codes.size <= self._limit:
            self._put_run(first, codes.ravel(), values)
        else:
            self._put(scan.records().ravel(), codes.ravel(), values)
        if len(scan.extra):
            codes = self._encode(block.extra_labels, scan.extra.range_m)
            # records without a value have the fill value already
            own = {column.name: column.of_extra(block) for column in self._optional if column.of_extra is not None}
            self._put(scan.extra.record, codes, own)

    @property
    def _limit(self) -> int:
        """Most records."""
        return sys.maxsize if self._n_records is None else self._n_records

    def _put_run(self, first: int, codes: U8, values: dict[str, Values]) -> None:
        """Take consecutive records."""
        self._code_spool.put_run(first, codes)
        for name, column in values.items():
            self._spools[name].put_run(first, column)
        if self._there is not None and len(codes):
            self._there.put_run(first, np.ones(len(codes), np.uint8))
            self._first, self._stop = min(self._first, first), max(self._stop, first + len(codes))

    def _put(self, record: I64, codes: U8, values: dict[str, Values]) -> None:
        keep = record >= 0
        if self._n_records is not None and record.size and int(record.max()) >= self._n_records:
            outside = record >= self._n_records
            # cells that pad the last line have no record, unless they have a label
            if np.any(outside & (codes != MISSING_CODE)):
                problem = f"found a label for record {int(record.max())}, expected records below {self._n_records}"
                raise OutputError(str(self.path), problem, "check that the input did not change while it was read")
            keep &= ~outside
        whole = bool(keep.all())
        record = record if whole else record[keep]
        self._code_spool.put(record, codes if whole else codes[keep])
        for name, column in values.items():
            self._spools[name].put(record, column if whole else column[keep])
        if self._there is not None and len(record):
            self._there.put(record, np.ones(len(record), np.uint8))
            self._first = min(self._first, int(record.min()))
            self._stop = max(self._stop, int(record.max()) + 1)

    def _total(self, record: RunRecord) -> int:
        """Return the number of entries of the output: records read, if known."""
        if self._there is not None:
            first = min(self._first, self._stop)
            return sum(int(np.count_nonzero(one)) for one in self._there.chunks(CHUNK_RECORDS, first=first))
        n = self._n_records if self._n_records is not None else record.n_records
        if n is None:
            return len(self._code_spool)
        for codes in self._code_spool.chunks(CHUNK_RECORDS, first=n):
            if np.any(codes != MISSING_CODE):
                problem = f"found labels for {len(self._code_spool)} records, expected {n}"
                raise OutputError(str(self.path), problem, "check that the input did not change while it was read")
        return n

    def _columns(self, total: int, chunk: int | None = None) -> Iterator[Columns]:
        """Codes and optional columns in record order, in chunks; of a part, those of its records."""
        n = chunk or CHUNK_RECORDS
        if self._there is not None:
            # chunks of a given size go with those of the input, from its first record on
            yield from self._part_columns(n, min(self._first, self._stop) if chunk is None else 0)
            return
        names = list(self._spools)
        columns = [spool.chunks(n, stop=total) for spool in self._spools.values()]
        for codes, *values in zip(self._code_spool.chunks(n, stop=total), *columns, strict=True):
            yield Columns(codes, dict(zip(names, values, strict=True)))

    def _part_columns(self, n: int, first: int) -> Iterator[Columns]:
        """Return codes and optional columns of the records of a part, of ``n`` records of the input at a time."""
        assert self._there is not None
        for start in range(first, self._stop, n):
            stop = min(start + n, self._stop)
            there = self._there.span(start, stop) != 0
            record = start + np.flatnonzero(there)
            values = {name: spool.span(start, stop)[there] for name, spool in self._spools.items()}
            yield Columns(self._code_spool.span(start, stop)[there], values, record)


def remove_quietly(path: Path) -> None:
    """Remove a temporary file, if it exists."""
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)


def close_quietly(handle: Closable) -> None:
    """Close after a failure, ignoring errors: a full disk may refuse the last buffer."""
    with contextlib.suppress(OSError):
        handle.close()


NO_CODE = -1
"""Class code of a shot without one."""


@dataclass(frozen=True, slots=True)
class StreamItem:
    """A block with classes and coordinates of its records."""

    block: ScanBlock
    codes: I32 | None = None
    """(lines, M) int32, class code of every cell, :data:`NO_CODE` = none; None where the input has no classes."""
    extra_codes: I32 | None = None
    """(n,) int32, class codes of ``block.extra``."""
    registered_m: F64 | None = None
    """(lines, M, 3) float64, coordinates of the input, or made up for a cloud [m], NaN = none; None where they are
    those of ``block.xyz_m``."""
    extra_registered_m: F64 | None = None
    """(n, 3) float64, the same for ``block.extra``."""


@dataclass(frozen=True, slots=True)
class StreamShape:
    """Which values the blocks of a stream have, known from the first block."""

    points_per_line: int
    """M, the largest of all scanners."""
    scanners: bool
    """Whether the stream may hold several scanners."""
    returns: bool
    """Whether the input counts the returns of a shot."""
    angles: bool
    times: bool
    xyz: bool
    """Whether blocks have coordinates relative to the scanner."""
    registered: bool
    """Whether blocks have coordinates of the input beside ranges."""
    intensity: bool
    codes: bool
    down_rad: float | None = None
    """Scan angle that points straight down [rad], None = unknown."""
    points: bool = False
    """Whether clouds and frames (``.ply .pcd .bin``) hold returns alone: cells without a range have no point."""
    rings: bool = False
    """Whether lines are cells of azimuth of a spinning scanner."""
    crs: str = ""
    """Coordinate system of registered coordinates, as pyproj takes it; empty = none."""
    compress: bool = False
    """Deflate the arrays of an archive (as ``numpy.savez_compressed``)."""

    @classmethod
    def of(cls, item: StreamItem, info: StreamInfo, *, scanners: bool, returns: bool) -> StreamShape:
        """Return the shape of a stream from its first block."""
        block = item.block
        return cls(
            points_per_line=info.points_per_line,
            scanners=scanners,
            returns=returns,
            angles=block.angle_rad is not None,
            times=block.time_s is not None,
            xyz=block.xyz_m is not None,
            registered=item.registered_m is not None,
            intensity=block.intensity is not None,
            codes=item.codes is not None,
            down_rad=info.down_rad,
        )


class StreamWriter(Writer, Protocol):
    """Writer that :func:`prc_cli.formats.writing.open_stream_writer` returns."""

    @property
    def losses(self) -> tuple[str, ...]:
        """Notices about values that the output cannot hold."""

    def add_item(self, item: StreamItem) -> None:
        """Take a block."""


class StagedStreamWriter(StagedOutput):
    """A :class:`StreamWriter` with temporary files."""

    one_scanner = ""
    """Name of the format in messages, for formats of a single scanner; empty = several scanners are allowed."""

    def __init__(self, path: Path, shape: StreamShape) -> None:
        super().__init__(path)
        self.shape = shape
        self._scanner: int | None = None

    @property
    def losses(self) -> tuple[str, ...]:
        """Notices about values that the output cannot hold."""
        return ()

    def add_item(self, item: StreamItem) -> None:
        """Take a block (see :class:`StreamWriter`)."""
        scanner = item.block.scanner
        if self._scanner is None:
            self._scanner = scanner
        elif self.one_scanner and scanner != self._scanner:
            problem = (
                f"found scanners {self._scanner} and {scanner}, expected one: {self.one_scanner} holds one scanner"
            )
            raise OutputError(str(self.path), problem, "write .csv, .laz or .parquet, or split the input first")
        with output_errors(self.path):
            self._add(item)

    def finish(self, record: RunRecord) -> RunRecord:
        """Write and name the outputs (see :class:`StreamWriter`)."""
        with output_errors(self.path):
            self._write()
            record = self._with_output(replace(record, notices=(*record.notices, *self.notices)))
            self._record_temporary.write_bytes(record.to_json())
            self._commit()
        return record

    @abstractmethod
    def _add(self, item: StreamItem) -> None: ...

    @abstractmethod
    def _write(self) -> None:
        """Write the rest and close every temporary file."""

    def _scratch(self) -> BinaryIO:
        """Open a temporary file that is removed at the end."""
        path = temporary_name(self.path)
        self._stack.callback(remove_quietly, path)
        handle = path.open("w+b")
        self._stack.callback(close_quietly, handle)
        return handle
