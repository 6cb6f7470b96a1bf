"""What every writer shares: one protocol, outputs that appear whole with their run record or not at all."""

from __future__ import annotations

import contextlib
import os
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

from prc_cli.core.classes import LABEL_NAMES, MISSING_CODE, ClassCodes, Label
from prc_cli.core.errors import OutputError
from prc_cli.core.files import commit, output_errors, temporary_name
from prc_cli.core.stream import LabelledBlock
from prc_cli.core.types import I64, U8
from prc_cli.writers.options import HIGH_NOISE_CODE, OutputConfig, class_names
from prc_cli.writers.record import ClassCount, RunRecord, record_path
from prc_cli.writers.spool import Spool

SEGMENT_LIMIT = 1 << 32
"""Segment ids are written as uint32."""

CHUNK_RECORDS = 400_000
"""Records handled together when an output is written."""


@dataclass(frozen=True, slots=True)
class Columns:
    """What was spooled of consecutive records."""

    codes: U8
    """(n,) uint8, class codes."""
    segments: NDArray[np.uint32] | None
    """(n,) uint32, segment ids, if asked for."""
    ranges: NDArray[np.float32] | None
    """(n,) float32, ranges [m], NaN = none, if asked for."""


class LabelWriter(Protocol):
    """What :func:`prc_cli.writers.open_writer` gives; use it as a context manager."""

    @property
    def notices(self) -> tuple[str, ...]:
        """What the writer had to decide, in plain words; complete after :meth:`finish`."""

    def __enter__(self) -> Self:
        """Create the temporary files beside the output."""

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None:
        """Remove every temporary file; without :meth:`finish` nothing is left."""

    def add(self, block: LabelledBlock) -> None:
        """Take the labels of a block.

        Raises
        ------
        OutputError
            When they cannot be written (disk full) or cannot be held by the output.
        """

    def finish(self, record: RunRecord) -> RunRecord:
        """Write the output and ``<output>.prc.json``, give both their names; return the record as written.

        Raises
        ------
        OutputError
            When the output cannot be written whole; nothing is left then.
        InputError
            When the input, read again, is damaged.
        """


class StagedWriter(ABC):
    """A :class:`LabelWriter` that fills temporary files and renames them at the end."""

    def __init__(self, path: Path, codes: ClassCodes, options: OutputConfig) -> None:
        self.path = path
        self._codes = codes
        self._options = options
        self._names = class_names(codes, options)
        self._lookup = codes.lookup()
        self._counts = np.zeros(256, np.int64)
        self._notices: list[str] = []
        self._temporary = temporary_name(path)
        self._record_temporary = temporary_name(record_path(path))
        self._stack = contextlib.ExitStack()

    @property
    def notices(self) -> tuple[str, ...]:
        """What the writer had to decide, in plain words."""
        return tuple(self._notices)

    def __enter__(self) -> Self:
        try:
            with output_errors(self.path):
                for path in (self._temporary, self._record_temporary):
                    self._stack.callback(_remove, path)
                self._start()
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None:
        self._stack.close()

    def add(self, block: LabelledBlock) -> None:
        """Take the labels of a block (see :class:`LabelWriter`)."""
        with output_errors(self.path):
            self._add(block)

    def finish(self, record: RunRecord) -> RunRecord:
        """Write and name the output (see :class:`LabelWriter`)."""
        with output_errors(self.path):
            record = self._write(record)
            self._record_temporary.write_bytes(record.to_json())
            self._commit()
        return record

    @abstractmethod
    def _start(self) -> None:
        """Open temporary files; what must be closed or removed goes on ``self._stack``."""

    @abstractmethod
    def _add(self, block: LabelledBlock) -> None: ...

    @abstractmethod
    def _write(self, record: RunRecord) -> RunRecord:
        """Fill and close ``self._temporary``; return the completed record."""

    def _notice(self, text: str) -> None:
        if text not in self._notices:
            self._notices.append(text)

    def _spool(self, dtype: DTypeLike, fill: Any, n_records: int | None) -> Spool:
        path = temporary_name(self.path)
        self._stack.callback(_remove, path)
        spool = Spool(path, dtype, fill, n_records=n_records)
        self._stack.callback(_close, spool)  # runs before the removal: Windows keeps open files
        return spool

    def _encode(self, labels: U8, range_m: NDArray[np.float32]) -> U8:
        """Class codes of labels, same shape."""
        if labels.size and int(labels.max()) >= len(self._lookup):
            problem = f"found label {int(labels.max())}, expected 0 to {len(LABEL_NAMES) - 1}"
            raise OutputError(str(self.path), problem, "this is a fault of the classifier; please report it")
        codes = self._lookup[labels]
        beyond = self._options.high_noise_beyond
        if beyond is not None:
            codes[(labels == Label.NOISE) & (range_m > np.float64(beyond))] = HIGH_NOISE_CODE
        return codes

    def _segments(self, block: LabelledBlock) -> NDArray[np.uint32]:
        """Segment ids of the cells, (lines, M) uint32; 0 = none."""
        if block.segments is None:
            return np.zeros(block.labels.shape, np.uint32)
        if block.segments.size:
            low, high = int(block.segments.min()), int(block.segments.max())
            if low < 0 or high >= SEGMENT_LIMIT:
                problem = f"segment id {low if low < 0 else high} does not fit uint32 (0 to {SEGMENT_LIMIT - 1})"
                raise OutputError(str(self.path), problem, "set [output] segment_ids = false")
        return block.segments.astype(np.uint32)

    def _count(self, codes: U8) -> None:
        self._counts += np.bincount(codes, minlength=256)

    def _completed(self, record: RunRecord) -> RunRecord:
        classes = tuple(
            ClassCount(int(code), self._names.get(int(code), f"class {code}"), int(self._counts[code]))
            for code in np.flatnonzero(self._counts)
        )
        return record.with_written(classes, self.notices)

    def _commit(self) -> None:
        """Give output and record their names; the output goes first, being the one that others may hold open."""
        existed = self.path.exists()
        with self._record_temporary.open("rb+") as handle:
            os.fsync(handle.fileno())
        commit(self._temporary, self.path)
        try:
            commit(self._record_temporary, record_path(self.path))
        except BaseException:
            if not existed:
                _remove(self.path)
            raise


class ScatterWriter(StagedWriter):
    """A writer whose output is in record order: labels wait in spools until all are there.

    Parameters
    ----------
    n_records : int or None
        Records of the input; None if only reading could tell.
    """

    def __init__(self, path: Path, codes: ClassCodes, options: OutputConfig, n_records: int | None) -> None:
        super().__init__(path, codes, options)
        self._n_records = n_records
        self._with_range = False  # label files have no range column
        self._with_segments = options.segment_ids

    def _start(self) -> None:
        n = self._n_records
        self._code_spool = self._spool(np.uint8, self._codes.unclassified, n)
        self._segment_spool = self._spool(np.uint32, 0, n) if self._with_segments else None
        self._range_spool = self._spool(np.float32, np.nan, n) if self._with_range else None

    def _add(self, block: LabelledBlock) -> None:
        scan = block.block
        codes = self._encode(block.labels, scan.range_m)
        segments = self._segments(block).ravel() if self._segment_spool is not None else None
        self._put(scan.records().ravel(), codes.ravel(), segments, scan.range_m.ravel())
        if len(scan.extra):
            codes = self._encode(block.extra_labels, scan.extra.range_m)
            self._put(scan.extra.record, codes, None, scan.extra.range_m)

    def _put(
        self,
        record: I64,
        codes: U8,
        segments: NDArray[np.uint32] | None,
        range_m: NDArray[np.float32],
    ) -> None:
        keep = record >= 0
        if self._n_records is not None:
            outside = record >= self._n_records
            # cells that pad the last line have no record; only a shot with a label must have one
            if np.any(outside & (codes != MISSING_CODE)):
                problem = f"found a label for record {int(record.max())}, expected records below {self._n_records}"
                raise OutputError(str(self.path), problem, "check that the input did not change while it was read")
            keep &= ~outside
        whole = bool(keep.all())
        record = record if whole else record[keep]
        self._code_spool.put(record, codes if whole else codes[keep])
        if self._segment_spool is not None and segments is not None:
            self._segment_spool.put(record, segments if whole else segments[keep])
        if self._range_spool is not None:
            self._range_spool.put(record, range_m if whole else range_m[keep])

    def _total(self, record: RunRecord) -> int:
        """Entries of the output: the records that were read, as far as the reader could tell."""
        n = self._n_records if self._n_records is not None else record.n_records
        if n is None:
            return len(self._code_spool)
        for codes in self._code_spool.chunks(CHUNK_RECORDS, first=n):
            if np.any(codes != MISSING_CODE):
                problem = f"found labels for {len(self._code_spool)} records, expected {n}"
                raise OutputError(str(self.path), problem, "check that the input did not change while it was read")
        return n

    def _columns(self, total: int, chunk: int | None = None) -> Iterator[Columns]:
        """Codes, segment ids and ranges in record order, in chunks."""
        n = chunk or CHUNK_RECORDS

        def read(spool: Spool | None) -> Iterator[Any]:
            return repeat(None) if spool is None else spool.chunks(n, stop=total)

        columns = zip(read(self._code_spool), read(self._segment_spool), read(self._range_spool), strict=False)
        for codes, segments, ranges in columns:
            yield Columns(codes, segments, ranges)


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink(missing_ok=True)


def _close(spool: Spool) -> None:
    with contextlib.suppress(OSError):
        spool.close()
