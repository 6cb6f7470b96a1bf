"""Base classes of all writers: blocks with class codes become an output with its run record."""

from __future__ import annotations

import contextlib
import os
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

from prc_cli.core.classes import (
    LABEL_NAMES,
    MISSING_CODE,
    NO_CODE,
    ClassCodes,
    Label,
    count_bytes,
    recode,
)
from prc_cli.core.errors import OutputError
from prc_cli.core.files import discard, output_errors, place_all, temporary_name
from prc_cli.core.stream import LabelledBlock, ScanBlock, StreamInfo
from prc_cli.core.types import F64, I64, U8
from prc_cli.formats.writing.columns import (
    HIGH_NOISE_CODE,
    Coordinates,
    LabelOutput,
    OptionalColumn,
    OutputConfig,
    Values,
    class_names,
    coordinates,
)
from prc_cli.formats.writing.disk import DiskColumn
from prc_cli.formats.writing.record import ClassCount, RunRecord, fingerprint, record_path

CHUNK_RECORDS = 400_000
"""Records per chunk when an output is written."""


@dataclass(frozen=True, slots=True)
class StreamItem:
    """A block with classes and coordinates of its records."""

    block: ScanBlock
    codes: NDArray[Any] | None = None
    """(lines, M), class code of every cell, :data:`NO_CODE` = none; None = no classes."""
    extra_codes: NDArray[Any] | None = None
    """(n,), class codes of ``block.extra``."""
    registered_m: F64 | None = None
    """(lines, M, 3) float64, coordinates of the input, or made up for a cloud [m]; NaN = none.

    None if ``block.xyz_m`` is used.
    """
    extra_registered_m: F64 | None = None
    """(n, 3) float64, the same for ``block.extra``."""
    labelled: LabelledBlock | None = None
    """Block of the classifier that gave the codes; None without one."""


@dataclass(frozen=True, slots=True)
class StreamShape:
    """Values that the blocks of a stream have, known from the first block."""

    points_per_line: int
    """M, the largest of all scanners."""
    scanners: bool
    """Whether the stream may have several scanners."""
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
    """Whether clouds and frames (``.ply .pcd .bin``) have no points for cells without a range."""
    rings: bool = False
    """Whether lines are cells of azimuth of a spinning scanner."""
    crs: str = ""
    """Coordinate system of registered coordinates, as pyproj takes it; empty = none."""
    compress: bool = False
    """Deflate the arrays of an archive (as ``numpy.savez_compressed``)."""

    @classmethod
    def of(
        cls,
        item: StreamItem,
        info: StreamInfo,
        *,
        scanners: bool,
        returns: bool,
    ) -> StreamShape:
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


@dataclass(frozen=True, slots=True)
class Columns:
    """Values of consecutive records, from disk."""

    codes: U8
    """(n,) uint8, class codes."""
    values: dict[str, Values]
    """(n,) arrays of the optional columns, by name."""
    record: I64
    """(n,) int64, index in the input of every record."""


class StagedWriter(ABC):
    """A context manager that fills temporary files and renames them at the end, or removes them.

    Blocks come from a classifier (:meth:`add`) or from a stream (:meth:`add_item`). A subclass
    writes an item (:meth:`_add`) and closes the file (:meth:`_close`, or :meth:`_write` if the file
    contains the run record).
    """

    one_scanner = ""
    """Name of a format of a single scanner, for messages; empty = several scanners are allowed."""

    def __init__(
        self, path: Path, labels: LabelOutput | None = None, columns: Sequence[OptionalColumn] = ()
    ) -> None:
        self.path = path
        self._labels = labels
        self._codes = ClassCodes() if labels is None else labels.codes
        self._options = OutputConfig() if labels is None else labels.options
        self._optional = tuple(columns)
        self._settled = False
        self._names = class_names(self._codes, self._options)
        self._lookup = np.zeros(256, np.uint8)
        self._lookup[: len(LABEL_NAMES)] = self._codes.lookup()
        self._counts = np.zeros(256, np.int64)
        self._notices: list[str] = []
        self._last_record: int | None = -1
        self._scanner: int | None = None
        self._files: list[tuple[Path, Path, bool]] = []
        """Temporary name, name, and whether a file of this name existed at the start."""
        self._temporary = self._output(path)
        self._record_temporary = self._output(record_path(path))
        self._stack = contextlib.ExitStack()

    @property
    def notices(self) -> tuple[str, ...]:
        """Notices of the writer for the user; complete after :meth:`finish`."""
        return tuple(self._notices)

    @property
    def losses(self) -> tuple[str, ...]:
        """Notices about values of the stream that the output cannot hold."""
        return ()

    def __enter__(self) -> Self:
        try:
            with output_errors(self.path):
                for temporary, _, _ in self._files:
                    self._stack.callback(discard, temporary)
                self._start()
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
        /,
    ) -> None:
        self._stack.close()

    def add(self, block: LabelledBlock) -> None:
        """Write the labels of a block."""
        with output_errors(self.path):
            self._settle(block)
            codes = self._encode(block.labels, block.block.range_m)
            extra = self._encode(block.extra_labels, block.block.extra.range_m)
            self._add(StreamItem(block.block, codes, extra, labelled=block))

    def add_item(self, item: StreamItem) -> None:
        """Write a block of a stream."""
        scanner = item.block.scanner
        if self._scanner is None:
            self._scanner = scanner
        elif self.one_scanner and scanner != self._scanner:
            scanners = f"found scanners {self._scanner} and {scanner}"
            problem = f"{scanners}, expected one: {self.one_scanner} has one scanner"
            raise OutputError(
                str(self.path), problem, "write .csv, .laz or .parquet, or split the input first"
            )
        with output_errors(self.path):
            self._settle(None)
            self._add(item)

    def finish(self, record: RunRecord) -> RunRecord:
        """Write the output and ``<output>.prc.json`` and rename them; return the written record."""
        with output_errors(self.path):
            self._settle(None)
            # the record beside the output has its size and hash
            record = replace(self._write(record), output=fingerprint(self._temporary))
            self._record_temporary.write_bytes(record.to_json())
            # the output is first, because another program may hold it open
            place_all(self._files)
        return record

    def _start(self) -> None:
        """Open temporary files; register closing and removal on ``self._stack``."""
        self._handle: BinaryIO = self._temporary.open("w+b")
        self._stack.callback(close_quietly, self._handle)

    def _begin(self) -> None:  # noqa: B027 - few writers need it
        """Prepare for the first block; called when ``self._optional`` is final."""

    @abstractmethod
    def _add(self, item: StreamItem) -> None: ...

    def _write(self, record: RunRecord) -> RunRecord:
        """Fill and close ``self._temporary``; return the completed record."""
        self._close()
        return self._completed(record)

    def _close(self) -> None:
        self._handle.close()

    def _output(self, path: Path) -> Path:
        """Register a file of the output; return its temporary name."""
        self._files.append((temporary_name(path), path, os.path.lexists(path)))
        return self._files[-1][0]

    def _scratch(self) -> BinaryIO:
        """Open a temporary file that is removed at the end."""
        path = temporary_name(self.path)
        self._stack.callback(discard, path)
        handle = path.open("w+b")
        self._stack.callback(close_quietly, handle)
        return handle

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
            self._notice(
                "points are in the order of the shots, not of the input's records; "
                "label files keep that one"
            )
            self._last_record = None
            return
        self._last_record = int(known[-1])

    def _encode(self, labels: U8, range_m: NDArray[np.float32]) -> U8:
        if labels.size and int(labels.max()) >= len(LABEL_NAMES):
            problem = f"found label {int(labels.max())}, expected 0 to {len(LABEL_NAMES) - 1}"
            raise OutputError(
                str(self.path), problem, "this is a fault of the classifier; please report it"
            )
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
            is_present = {
                column.name: column.of_shots(block) is not None for column in self._optional
            }
            added = {column.option for column in self._optional if is_present[column.name]}
            for column in self._optional:
                if not is_present[column.name] and column.option not in added:
                    self._notice(
                        f"output.{column.option} needs the {column.needs}; nothing was added"
                    )
            self._optional = tuple(column for column in self._optional if is_present[column.name])
        self._begin()

    def _cells(self, column: OptionalColumn, block: LabelledBlock) -> Values:
        """Values of an optional column for the cells of a block, (lines, M) of its type."""
        values = column.of_shots(block)
        if values is None:
            return np.full(block.labels.shape, column.fill, column.dtype)
        if values.size and values.dtype != column.dtype and column.dtype.kind == "u":
            limit = np.iinfo(column.dtype).max
            low = int(values.min())
            high = int(values.max())
            if low < 0 or high > limit:
                value = low if low < 0 else high
                problem = f"{column.what} {value} does not fit {column.dtype.name} (0 to {limit})"
                raise OutputError(str(self.path), problem, f"set [output] {column.option} = false")
        return values.astype(column.dtype, copy=False)

    def _coordinates(self, item: StreamItem) -> Coordinates:
        """Return the coordinates of the input, else those of the output's placement."""
        if item.registered_m is not None and item.extra_registered_m is not None:
            return Coordinates(item.registered_m, item.extra_registered_m)
        placed, notice = coordinates(
            item.block, None if self._labels is None else self._labels.place
        )
        if notice:
            self._notice(notice)
        return placed

    def _count(self, codes: U8) -> None:
        self._counts += count_bytes(codes)

    def _completed(self, record: RunRecord) -> RunRecord:
        """Return the record with notices and, if there are any, counts by class."""
        classes = tuple(
            ClassCount(
                int(code), self._names.get(int(code), f"class {code}"), int(self._counts[code])
            )
            for code in np.flatnonzero(self._counts)
        )
        return replace(
            record, classes=classes or record.classes, notices=(*record.notices, *self.notices)
        )


class StreamWriter(StagedWriter):
    """A writer of streams, block by block."""

    def __init__(self, path: Path, shape: StreamShape) -> None:
        super().__init__(path)
        self.shape = shape


class ScatterWriter(StagedWriter):
    """A writer of outputs in record order: labels wait on disk until all have arrived."""

    def __init__(
        self, labels: LabelOutput, columns: Sequence[OptionalColumn], n_records: int | None
    ) -> None:
        super().__init__(labels.path, labels, columns)
        self._n_records = n_records
        self._is_part = labels.is_part or labels.is_thinned
        self._spools: dict[str, DiskColumn] = {}
        self._first = sys.maxsize
        self._stop = 0
        """First record of a part, and the one behind its last."""

    def _start(self) -> None:
        # of a part, records without a code are not in the output
        fill = (np.int16, NO_CODE) if self._is_part else (np.uint8, self._codes.unclassified)
        self._code_spool = self._spool(*fill)

    def _begin(self) -> None:
        self._spools = {
            column.name: self._spool(column.dtype, column.fill) for column in self._optional
        }

    def _spool(self, dtype: DTypeLike, fill: Any) -> DiskColumn:
        return self._stack.enter_context(
            DiskColumn(self.path, dtype, fill, n_records=self._n_records)
        )

    def _add(self, item: StreamItem) -> None:
        scan = item.block
        codes = item.codes
        extra_codes = item.extra_codes
        block = item.labelled
        assert codes is not None
        assert extra_codes is not None
        values = {}
        if block is not None:
            for optional in self._optional:
                values[optional.name] = self._cells(optional, block).ravel()
        first = scan.first_line * scan.points_per_line
        most = sys.maxsize if self._n_records is None else self._n_records
        if scan.record is None and first + codes.size <= most:
            self._code_spool.put_run(first, codes.ravel())
            for name, column in values.items():
                self._spools[name].put_run(first, column)
            self._first = min(self._first, first)
            self._stop = max(self._stop, first + codes.size)
        else:
            self._put(scan.records().ravel(), codes.ravel(), values)
        if len(scan.extra):
            # records without a value have the fill value already
            extra_values = {
                optional.name: optional.of_extra(block)
                for optional in self._optional
                if optional.of_extra and block is not None
            }
            self._put(scan.extra.record, extra_codes, extra_values)

    def _put(self, record: I64, codes: NDArray[Any], values: dict[str, Values]) -> None:
        keep = record >= 0
        if self._n_records is not None and record.size and int(record.max()) >= self._n_records:
            outside = record >= self._n_records
            # cells that pad the last line have no record, unless they have a label
            if np.any(outside & (codes != MISSING_CODE)):
                last = int(record.max())
                problem = (
                    f"found a label for record {last}, expected records below {self._n_records}"
                )
                raise OutputError(
                    str(self.path), problem, "check that the input did not change while it was read"
                )
            keep &= ~outside
        if not keep.all():
            record = record[keep]
            codes = codes[keep]
            values = {name: column[keep] for name, column in values.items()}
        self._code_spool.put(record, codes)
        for name, column in values.items():
            self._spools[name].put(record, column)
        if self._is_part and len(record):
            self._first = min(self._first, int(record.min()))
            self._stop = max(self._stop, int(record.max()) + 1)

    def _total(self, record: RunRecord) -> int:
        """Return the number of entries of the output: records read, if known."""
        if self._is_part:
            return sum(len(columns.codes) for columns in self._columns(0))
        n = self._n_records if self._n_records is not None else record.n_records
        if n is None:
            return len(self._code_spool)
        for codes in self._code_spool.chunks(CHUNK_RECORDS, first=n):
            if np.any(codes != MISSING_CODE):
                problem = f"found labels for {len(self._code_spool)} records, expected {n}"
                raise OutputError(
                    str(self.path), problem, "check that the input did not change while it was read"
                )
        return n

    def _columns(self, total: int, chunk: int | None = None) -> Iterator[Columns]:
        n = chunk or CHUNK_RECORDS
        first = 0
        end = total
        if self._is_part:
            # chunks of a given size are aligned with those of the input, from its first record on
            first = min(self._first, self._stop) if chunk is None else 0
            end = self._stop
        for start in range(first, end, n):
            stop = min(start + n, end)
            codes = self._code_spool.span(start, stop)
            record = np.arange(start, stop)
            values = {name: spool.span(start, stop) for name, spool in self._spools.items()}
            if self._is_part:
                has_code = codes != NO_CODE
                codes = codes[has_code].astype(np.uint8)
                record = record[has_code]
                values = {name: column[has_code] for name, column in values.items()}
            yield Columns(codes, values, record)


def close_quietly(handle: BinaryIO) -> None:
    """Close after a failure, ignoring errors: a full disk may refuse the last buffer."""
    with contextlib.suppress(OSError):
        handle.close()
