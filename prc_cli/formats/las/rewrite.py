"""Writes LAS or LAZ files again with other classes, or with some of their records.

Header, VLRs, user bytes, points and all bytes behind them are copied in order. Only the points, the
offsets in the header and the columns of ``[output]`` change. If records are left out, the counts
and bounds of the header change too.
"""

from __future__ import annotations

import contextlib
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import ClassCodes
from prc_cli.core.errors import ConfigError, InputError, OutputError
from prc_cli.core.files import output_errors
from prc_cli.core.types import I64, U8, Mask
from prc_cli.formats.las import LAZ
from prc_cli.formats.las.build import LasBuilder
from prc_cli.formats.las.header import (
    COMPRESSED,
    LASZIP_KEY,
    RECORD_KEY,
    STANDARD_HEADER,
    WKT_BIT,
    HeaderFields,
    InputBytes,
    LasHeader,
    Span,
    Vlr,
    damaged,
    open_bytes,
    read_header,
    readable,
    standard_bytes,
)
from prc_cli.formats.las.laz import (
    LasSink,
    LazRecords,
    LazSink,
    PointSink,
    Target,
    batch_records,
    has_variable_chunks,
    laszip_vlr,
    read_records,
    tail_bounds,
)
from prc_cli.formats.las.points import (
    FORMAT_FOR_CODES,
    append_bytes,
    data_type_of,
    read_layout,
    set_classes,
    upgrade,
    with_extra_dimensions,
)
from prc_cli.formats.las.splice import COPC_USER, find_chunks, move_index, splice_classes
from prc_cli.formats.las.vlrs import with_lookup, with_record, with_wkt
from prc_cli.formats.writing.base import Columns, ScatterWriter, StagedWriter
from prc_cli.formats.writing.columns import (
    FIVE_BIT_LIMIT,
    OPTIONAL_COLUMNS,
    LabelOutput,
    OptionalColumn,
    asked_columns,
)
from prc_cli.formats.writing.record import RunRecord

if TYPE_CHECKING:
    from prc_cli.formats.input import Input

Masks: TypeAlias = Callable[[int], Iterator[Mask]]
"""Called with a batch size; yields a mask of the records to keep for every batch of the input.

Behind the last mask no record is read.
"""
CARRIED = tuple(column.name for column in OPTIONAL_COLUMNS)
"""Dimensions of this program that can be written with the class."""
_COPY_BYTES = 4 << 20
_MINOR_VERSION = 25
"""Byte of the header with the minor version."""
_RETURN_NUMBER = 14
"""Byte of a record whose lowest bits are the return number: 4 bits from point format 6 on, else 3.

Its first 12 bytes are x, y, z, int32 each.
"""
_EVLR_START = 235
"""Byte of the header where the start of the EVLRs is."""
_WAVEFORMS_INSIDE = 2
_WAVEFORMS_BESIDE = 4
"""Bits of ``global_encoding``: waveforms are in the file, or in a file beside it."""
_WAVEFORM_FORMATS_LAZ = (9, 10)
"""Point formats whose compressed waveform packets may be damaged."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Differences between an output and its input."""

    las: LasHeader
    """The input."""
    point_format: int
    """Point format written."""
    compress: bool
    """LAZ."""
    is_part: bool = False
    """Whether records are left out."""
    appended: tuple[OptionalColumn, ...] = ()
    """Columns appended to every record, in order."""
    replaced: tuple[tuple[OptionalColumn, int], ...] = ()
    """Columns present in the records whose values are replaced, each with its first byte."""

    @property
    def n_appended(self) -> int:
        """Bytes appended to every record."""
        return sum(column.dtype.itemsize for column in self.appended)

    @property
    def is_checked(self) -> bool:
        """Whether the written records are read back and compared with the right ones."""
        return self.compress and self.point_format in _WAVEFORM_FORMATS_LAZ

    @property
    def upgrades(self) -> bool:
        """Whether the point format changes."""
        return self.point_format != self.las.point_format

    @property
    def only_classes(self) -> bool:
        """Whether only the classes change, in the same point format."""
        changed = self.appended or self.replaced or self.upgrades or self.is_part
        return not changed and self.compress == self.las.compressed

    @property
    def batch(self) -> int:
        """Records per batch."""
        return batch_records(self.las, compressed=self.las.compressed or self.compress)


def read_las(path: Path) -> LasHeader:
    """Read header, VLRs and EVLRs of a LAS or LAZ file, and check its chunk table."""
    with open_bytes(path) as source:
        return _checked_header(source)


def _checked_header(source: InputBytes) -> LasHeader:
    las = read_header(source)
    if las.compressed:
        LazRecords(source, las)
    return las


def check_copied(las: LasHeader) -> None:
    """Refuse points that cannot be copied as bytes."""
    if any(vlr.user_id == "lascompatible" for vlr in las.vlrs):
        problem = (
            "found LAS 1.4 points in LASzip's compatibility mode, whose classes lie in extra bytes"
        )
        raise InputError(
            str(las.path), problem, "write it again as plain LAS 1.4, e.g. with las2las or PDAL"
        )


def copy_las(
    las: LasHeader,
    output: Path,
    temporary: Path,
    masks: Masks | None = None,
    record: RunRecord | None = None,
) -> tuple[str, ...]:
    """Copy the records of the masks to a temporary LAS or LAZ file; return notices."""
    plan = Plan(las, las.point_format, output.suffix.lower() == LAZ, is_part=masks is not None)
    notices: list[str] = []
    _note_unreadable(las, notices.append)
    vlrs = _planned_vlrs(plan, notices.append)
    dropped_users: tuple[str, ...] = (COPC_USER,)
    if record is not None:
        vlrs = with_record(vlrs, record)
        dropped_users = (COPC_USER, RECORD_KEY.user_id)
    points = _PointWriter(plan)
    with open_bytes(las.path) as source, temporary.open("w+b") as file:
        written = _OutputFile(plan, vlrs, source, Target(file))
        with contextlib.closing(read_records(source, las, plan.batch)) as batches:
            if masks is None:
                points.write(written.open_sink(), batches)
            else:
                # the masks first: behind the last one no batch is decoded
                pairs = zip(masks(plan.batch), batches, strict=False)
                points.write(written.open_sink(), (records[mask] for mask, records in pairs))
        written.finish(points, dropped_users)
    points.check(temporary, output)
    return tuple(notices)


def _note_unreadable(las: LasHeader, notice: Callable[[str], None]) -> None:
    if any(readable(vlr) != vlr for vlr in (*las.vlrs, *las.evlrs)):
        notice(
            "names or coordinate systems in the header have bytes that are no text; "
            "they were written as ?"
        )


def _planned_vlrs(plan: Plan, notice: Callable[[str], None]) -> list[Vlr]:
    """Return the VLRs of an output, still with the old run record; give notices of unusual ones.

    The index of a COPC file fits the chunks of the input alone.
    """
    las = plan.las
    vlrs = list(las.vlrs)
    if any(vlr.user_id == COPC_USER for vlr in vlrs):
        notice(
            "the COPC index does not fit the rewritten chunks and was left out: "
            "the output is plain LAS/LAZ"
        )
        vlrs = [vlr for vlr in vlrs if vlr.user_id != COPC_USER]
    options = dict.fromkeys(column.option for column in plan.appended)
    hint = "set [output] " + " and ".join(f"{option} = false" for option in options)
    vlrs = with_extra_dimensions(las, vlrs, [column.dimension for column in plan.appended], hint)
    if plan.upgrades:
        vlrs, crs_notice = with_wkt(vlrs, plan.point_format)
        if crs_notice:
            notice(crs_notice)
    fields = las.fields()
    if fields.get("global_encoding") & _WAVEFORMS_BESIDE and fields.has("waveform_start"):
        name = f"{las.path.stem}.wdp"
        beside = "copy it beside the output, with the output's name and .wdp"
        notice(f"waveforms lie in a file of their own beside the input, {name}; {beside}")
    if not plan.compress:
        return [vlr for vlr in vlrs if not vlr.has(LASZIP_KEY)]
    return _with_laszip(plan, vlrs, notice)


def _with_laszip(plan: Plan, vlrs: list[Vlr], notice: Callable[[str], None]) -> list[Vlr]:
    """Return the VLRs with the one that describes the compression of the output."""
    las = plan.las
    same_records = not plan.upgrades and not plan.appended
    n_extra_bytes = las.n_extra_bytes + plan.n_appended
    laszip = laszip_vlr(las, plan.point_format, n_extra_bytes, keep=same_records)
    input_laszip = las.vlr(LASZIP_KEY)
    if input_laszip is None or input_laszip.data is None:
        return [*vlrs, laszip]
    if has_variable_chunks(input_laszip.data):
        notice("compressed chunks of differing length were written as chunks of equal length")
    elif same_records and laszip.data != input_laszip.data:
        problem = "the points were compressed with a version of laszip's items that is not written"
        notice(f"{problem}; the usual one is used")
    return [laszip if vlr.has(LASZIP_KEY) else vlr for vlr in vlrs]


class _PointWriter:
    """Writes records, and collects counts, bounds and checksum for the header and the check."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._checksum = 0
        self._n = 0
        self._by_return = np.zeros(16, np.int64)
        self._low = np.full(3, np.iinfo(np.int64).max)
        self._high = np.full(3, np.iinfo(np.int64).min)

    def write(self, sink: PointSink, batches: Iterable[U8]) -> None:
        """Write batches of records, (n, record_bytes) uint8, and close the sink."""
        for records in batches:
            if not len(records):
                continue
            if self._plan.is_part or self._plan.upgrades:
                self._n += len(records)
                bits = 0x0F if self._plan.point_format >= 6 else 0x07
                return_number = records[:, _RETURN_NUMBER] & bits
                self._by_return += np.bincount(return_number, minlength=16)
            if self._plan.is_part:
                xyz = np.ascontiguousarray(records[:, :12]).view("<i4")
                self._low = np.minimum(self._low, xyz.min(axis=0))
                self._high = np.maximum(self._high, xyz.max(axis=0))
            if self._plan.is_checked:
                self._checksum = zlib.crc32(np.ascontiguousarray(records).data, self._checksum)
            sink.write(records)
        sink.close()

    def set_counts(self, fields: HeaderFields) -> None:
        """Set counts, and bounds of a part, in a header; legacy counts of zero stay zero."""
        plan = self._plan
        if not plan.is_part and not plan.upgrades:
            return
        if fields.get("legacy_n_points"):
            fields.set("legacy_n_points", self._n)
            fields.set("legacy_by_return", *self._by_return[1:6].tolist())
        if fields.has("n_points"):
            fields.set("n_points", self._n)
            fields.set("by_return", *self._by_return[1:].tolist())
        if plan.is_part and self._n:
            scale = np.array(plan.las.scales)
            offset = np.array(plan.las.offsets)
            ends = np.stack([self._low * scale + offset, self._high * scale + offset], axis=1)
            # a scale may be negative
            min_max = np.sort(ends, axis=1)
            # the header has x max, x min, y max, ...
            fields.set("bounds", *min_max[:, ::-1].ravel().tolist())

    def check(self, written: Path, output: Path) -> None:
        """Compare the CRC-32 of the output: lazrs 0.8.2 damages packets of several channels."""
        if not self._plan.is_checked:
            return
        checksum = 0
        with open_bytes(written) as source:
            las = read_header(source)
            for records in read_records(source, las, self._plan.batch):
                checksum = zlib.crc32(np.ascontiguousarray(records).data, checksum)
        if checksum != self._checksum:
            point_format = self._plan.point_format
            problem = f"LAZ changes the waveform packets of records of point format {point_format}"
            raise OutputError(str(output), problem, "write .las instead of .laz")


class _OutputFile:
    """A file that is written from its header to its last byte; the caller writes the points."""

    def __init__(self, plan: Plan, vlrs: list[Vlr], source: InputBytes, target: Target) -> None:
        """Write what precedes the points."""
        self._plan = plan
        self._source = source
        self._target = target
        self._vlrs = [readable(vlr) for vlr in vlrs]
        self._fields = _new_fields(plan, self._vlrs)
        # it only takes its place: counts and offsets are known at the end
        target.write(self._fields.data)
        for vlr in self._vlrs:
            target.write(vlr.raw)
        _copy_bytes(source, target, plan.las.vlr_end, plan.las.data_offset)

    def open_sink(self) -> PointSink:
        if not self._plan.compress:
            return LasSink(self._target)
        laszip = next(vlr.data or b"" for vlr in self._vlrs if vlr.has(LASZIP_KEY))
        return LazSink(self._target, laszip)

    def finish(self, points: _PointWriter, dropped_users: tuple[str, ...]) -> Tail:
        """Write what follows the points, without the EVLRs of some user ids, and the header."""
        las = self._plan.las
        target = self._target
        tail = plan_tail(las, tail_bounds(self._source, las), target.tell(), dropped_users)
        for start, stop in tail.spans:
            _copy_bytes(self._source, target, start, stop)
        for evlr in las.evlrs:
            readable_evlr = readable(evlr)
            if evlr.user_id not in dropped_users and readable_evlr != evlr:
                # of the same length as the copied one
                target.seek(tail.moved(evlr.start))
                target.write(readable_evlr.raw)
        _set_tail(self._fields, las, tail)
        points.set_counts(self._fields)
        target.seek(0)
        target.write(self._fields.data)
        target.flush()
        return tail


def _copy_bytes(
    source: InputBytes,
    target: Target,
    start: int,
    stop: int,
) -> None:
    source.seek(start)
    for position in range(start, stop, _COPY_BYTES):
        target.write(source.exact(min(_COPY_BYTES, stop - position), "the file"))


def _new_fields(plan: Plan, vlrs: list[Vlr]) -> HeaderFields:
    las = plan.las
    fields = plan.las.fields()
    if plan.upgrades:
        minor = fields.data[_MINOR_VERSION]
        if minor < 4:
            # LAS 1.4: zeros in the new fields, then the user bytes at the end of the old header
            old_bytes = STANDARD_HEADER[minor]
            new_fields = bytes(STANDARD_HEADER[4] - old_bytes)
            fields = HeaderFields(las.raw[:old_bytes] + new_fields + las.raw[old_bytes:])
            fields.data[_MINOR_VERSION] = 4
            fields.set("header_size", len(fields.data))
        fields.set("legacy_n_points", 0)
        fields.set("legacy_by_return", 0, 0, 0, 0, 0)
        fields.set("global_encoding", fields.get("global_encoding") | WKT_BIT)
    if plan.upgrades or plan.compress != las.compressed:
        fields.set("point_format", plan.point_format | (COMPRESSED if plan.compress else 0))
    record_growth = standard_bytes(plan.point_format) - standard_bytes(las.point_format)
    fields.set("record_length", las.record_bytes + record_growth + plan.n_appended)
    fields.set("n_vlrs", len(vlrs))
    vlr_bytes = sum(len(vlr.raw) for vlr in vlrs)
    user_bytes = las.data_offset - las.vlr_end
    point_offset = len(fields.data) + vlr_bytes + user_bytes
    if point_offset >= 1 << 32:
        raise OutputError(
            str(las.path), f"points would begin at byte {point_offset}, LAS allows 4294967295"
        )
    fields.set("point_offset", point_offset)
    return fields


@dataclass(frozen=True, slots=True)
class Tail:
    """Parts of the input that follow the points of the output."""

    spans: tuple[Span, ...]
    """Copied parts of the input, in order."""
    start: int
    """First byte behind the points of the output."""
    evlr_start: int
    """First EVLR of the output; 0 = none."""
    n_evlrs: int
    """EVLRs of the output."""

    def moved(self, position: int) -> int:
        """Return the position in the output of a byte of the input; the same if it is not copied.

        >>> Tail((Span(100, 120), Span(150, 160)), 300, 0, 0).moved(155)
        325
        """
        target = self.start
        for first, stop in self.spans:
            if first <= position < stop:
                return target + position - first
            target += stop - first
        return position


def plan_tail(
    las: LasHeader,
    bounds: Span,
    start: int,
    dropped_users: tuple[str, ...],
) -> Tail:
    """Plan the copy of everything behind the points, without the EVLRs of some user ids.

    ``bounds`` are the bytes behind the points of the input; ``start`` is the first of the output.
    """
    cursor = bounds.start
    if las.evlrs and las.evlrs[0].start < cursor:
        first_byte = las.evlrs[0].start
        problem = (
            f"the first EVLR is at byte {first_byte}, expected it behind the points (byte {cursor})"
        )
        raise damaged(las.path, _EVLR_START, problem)
    spans: list[Span] = []
    for evlr in las.evlrs:
        if evlr.user_id in dropped_users:
            # up to this EVLR, then on behind it
            spans.append(Span(cursor, evlr.start))
            cursor = evlr.stop
    spans.append(Span(cursor, max(cursor, bounds.stop)))
    copied = tuple(span for span in spans if span.start < span.stop)
    kept = [evlr for evlr in las.evlrs if evlr.user_id not in dropped_users]
    tail = Tail(copied, start, evlr_start=0, n_evlrs=len(kept))
    return replace(tail, evlr_start=tail.moved(kept[0].start)) if kept else tail


def _set_tail(fields: HeaderFields, las: LasHeader, tail: Tail) -> None:
    """Set the positions of waveforms and EVLRs in the header of the output."""
    input_fields = las.fields()
    if fields.has("waveform_start") and input_fields.get("waveform_start"):
        fields.set("waveform_start", tail.moved(input_fields.get("waveform_start")))
    if not fields.has("evlr_start"):
        return
    if input_fields.has("evlr_start"):
        if tail.n_evlrs or las.evlrs:
            fields.set("evlr_start", tail.evlr_start)
        else:
            # without EVLRs the value means nothing, and stays as it was
            fields.set("evlr_start", input_fields.get("evlr_start"))
        fields.set("n_evlrs", tail.n_evlrs)
    elif fields.get("waveform_start") and fields.get("global_encoding") & _WAVEFORMS_INSIDE:
        # LAS 1.3 has its waveforms in an EVLR, but only LAS 1.4 has a count of EVLRs
        fields.set("evlr_start", fields.get("waveform_start"))
        fields.set("n_evlrs", 1)


def _header_bytes(las: LasHeader) -> tuple[object, ...]:
    return las.raw, las.vlrs, las.evlrs, las.file_bytes


class LasRewriter(ScatterWriter):
    """Writer of a LAS or LAZ file from the LAS or LAZ file that was classified."""

    def __init__(self, labels: LabelOutput) -> None:
        self._source_path = labels.source.path
        self._laz_contexts = None if labels.is_part else labels.laz_contexts
        self._user_names = dict(labels.user_names)
        with open_bytes(self._source_path) as source:
            # compared at the end: another program may have changed the input
            self._state_at_start = source.state()
            self._las = _checked_header(source)
        super().__init__(labels, asked_columns(labels.options), self._las.n_records)
        self._compress = labels.path.suffix.lower() == LAZ

    def _write(self, record: RunRecord) -> RunRecord:
        las = read_las(self._source_path)
        if _header_bytes(las) != _header_bytes(self._las):
            raise self._changed(
                "found another header than at the start of the run, expected the same file"
            )
        check_copied(las)
        # the highest code decides the point format, so codes are counted before the plan
        for columns in self._columns(las.n_records):
            self._count(columns.codes)
        plan = self._plan(las)

        # if only classes change, chunks of LAZ may be copied with new classes (else None), and the
        # index of a COPC file stays
        splice = None
        if plan.only_classes:
            with open_bytes(self._source_path) as source:
                splice = find_chunks(source, las)
        is_copc = splice is not None and bool(splice.pages)
        _note_unreadable(las, self._notice)
        vlrs = list(las.vlrs)
        dropped_users: tuple[str, ...] = (RECORD_KEY.user_id,)
        if not is_copc:
            vlrs, notices = with_lookup(las, _planned_vlrs(plan, self._notice), self._user_names)
            for notice in notices:
                self._notice(notice)
            dropped_users = (RECORD_KEY.user_id, COPC_USER)
        record = self._completed(record)

        points = _PointWriter(plan)
        moved_chunks: dict[int, tuple[int, int]] = {}
        values = self._columns(las.n_records, plan.batch)
        with open_bytes(self._source_path) as source, self._temporary.open("w+b") as file:
            target = Target(file)
            written = _OutputFile(plan, with_record(vlrs, record), source, target)
            if splice is None:
                with contextlib.closing(read_records(source, las, plan.batch)) as batches:
                    changed = self._changed_batches(plan, values, batches)
                    points.write(written.open_sink(), changed)
            else:
                codes = (columns.codes for columns in values)
                moved_chunks |= splice_classes(source, target, splice, codes, self._laz_contexts)
            tail = written.finish(points, dropped_users)

        if splice is not None and is_copc:
            moved_pages = {page.position: tail.moved(page.position) for page in splice.pages}
            move_index(self._temporary, las, splice, moved_chunks, moved_pages)
        points.check(self._temporary, self.path)
        with open_bytes(self._source_path) as source:
            if source.state() != self._state_at_start:
                raise self._changed("changed while it was read")
        return record

    def _changed(self, problem: str) -> InputError:
        hint = "run again when nothing else writes the input"
        return InputError(str(self._source_path), problem, hint)

    def _changed_batches(
        self, plan: Plan, values: Iterator[Columns], batches: Iterator[U8]
    ) -> Iterator[U8]:
        """Yield the records of the output; of a part, only the records that have values."""
        # the columns first: behind the last one no batch is decoded
        for batch, (columns, records) in enumerate(zip(values, batches, strict=not plan.is_part)):
            if plan.is_part:
                first_record = batch * plan.batch
                records = records[columns.record - first_record]
            if len(records):
                yield changed_records(records, columns, plan)

    def _plan(self, las: LasHeader) -> Plan:
        used = np.flatnonzero(self._counts)
        highest = int(used[-1]) if len(used) else 0
        point_format = las.point_format
        if point_format < 6 and highest >= FIVE_BIT_LIMIT:
            point_format = FORMAT_FOR_CODES[las.point_format]
            new_fields = {0: "; gps_time is 0", 2: "; gps_time is 0", 5: "; near infrared is 0"}
            self._notice(
                f"point format {las.point_format} cannot hold code {highest}; "
                f"upgraded to {point_format}{new_fields.get(las.point_format, '')}"
            )
        record_growth = standard_bytes(point_format) - standard_bytes(las.point_format)
        appended = []
        replaced = []
        # the extra bytes of the input are read only if columns may collide with them
        input_columns = {}
        if self._optional:
            input_columns = {extra.name: extra for extra in read_layout(las).extra}
        for column in self._optional:
            same_name = input_columns.get(column.name)
            data_type = data_type_of(column.dimension)
            if same_name is None:
                appended.append(column)
            elif same_name.data_type != data_type:
                extra_bytes = f"extra bytes named {column.name!r} of type {same_name.data_type}"
                problem = f"the input has {extra_bytes}, expected none or type {data_type}"
                raise OutputError(str(las.path), problem, f"set [output] {column.option} = false")
            elif column.keep:
                self._notice(f"the input has {column.name} already; it was kept as it is")
            else:
                self._notice(f"the input has {column.name} already; its values were replaced")
                replaced.append((column, same_name.place + record_growth))
        plan = Plan(
            las=las,
            point_format=point_format,
            compress=self._compress,
            is_part=self._is_part,
            appended=tuple(appended),
            replaced=tuple(replaced),
        )
        length = las.record_bytes + record_growth + plan.n_appended
        if length > 65_535:
            problem = f"records would take {length} bytes, LAS allows 65535"
            raise OutputError(str(las.path), problem, "add no extra bytes")
        return plan


def changed_records(records: U8, columns: Columns, plan: Plan) -> U8:
    """Return the records of the output, (n, bytes) uint8; may change the given ones in place."""
    if plan.upgrades:
        records = upgrade(records, plan.las.point_format)
    set_classes(records, plan.point_format, columns.codes)
    for column, first_byte in plan.replaced:
        values = columns.values[column.name].view(np.uint8).reshape(len(records), -1)
        records[:, first_byte : first_byte + column.dtype.itemsize] = values
    if plan.appended:
        records = append_bytes(records, [columns.values[column.name] for column in plan.appended])
    return records


class LasRecoder(LasRewriter):
    """Writer of a LAS file from another one.

    In its ``with`` block, call :meth:`put` for every record, then :meth:`finish`.
    """

    def __init__(self, path: Path, source: Input, carried: tuple[str, ...] = ()) -> None:
        super().__init__(
            LabelOutput(
                path=path, source=source, n_records=None, points_per_line=0, codes=ClassCodes()
            )
        )
        for name in carried:
            if name not in CARRIED:
                raise ConfigError(
                    "--carry", f"found {name!r}, expected one of {', '.join(CARRIED)}"
                )
        # carried values replace columns of the same name that the output has already
        chosen = (column for column in OPTIONAL_COLUMNS if column.name in carried)
        self._optional = tuple(replace(column, keep=False) for column in chosen)

    def __enter__(self) -> Self:
        super().__enter__()
        try:
            with output_errors(self.path):
                # there is no first block that could lack columns: all are written
                self._settle(None)
        except BaseException:
            self._stack.close()
            raise
        return self

    def name_classes(self, names: Mapping[int, str]) -> None:
        """Set the names of user codes in the output."""
        self._user_names = dict(names)

    def put(self, record: I64, codes: U8) -> None:
        """Set class codes by record index."""
        with output_errors(self.path):
            self._put(record, codes, {})

    def put_values(self, record: I64, values: dict[str, NDArray[Any]]) -> None:
        """Set carried dimensions by record index."""
        with output_errors(self.path):
            for column in self._optional:
                self._spools[column.name].put(record, values[column.name].astype(column.dtype))


def open_label_writer(labels: LabelOutput) -> StagedWriter:
    """Return the rewriter of a LAS or LAZ input, or the builder of a new file."""
    if labels.source.is_las:
        return LasRewriter(labels)
    return LasBuilder(labels.path, labels=labels)
