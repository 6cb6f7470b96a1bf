"""Copies LAS or LAZ files with changed points; all other bytes stay the same.

Header, VLRs, user bytes, points and what follows them are copied in order. Only the points change, and with them the
offsets in the header; where records are left out, its counts and bounds too.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from prc_cli.core.errors import InputError, OutputError
from prc_cli.core.types import U8, Mask
from prc_cli.formats.las.header import (
    COMPRESSED,
    LASZIP_KEY,
    RECORD_KEY,
    STANDARD_HEADER,
    WKT_BIT,
    HeaderFields,
    LasHeader,
    Source,
    Vlr,
    damaged,
    make_vlr,
    open_source,
    read_header,
    standard_bytes,
)
from prc_cli.formats.las.laz import LazRecords, read_records, tail_bounds
from prc_cli.formats.las.points import VLR_LIMIT
from prc_cli.formats.las.sinks import (
    LasSink,
    LazSink,
    PointSink,
    Target,
    batch_records,
    copy_bytes,
    crc,
    has_variable_chunks,
    laszip_vlr,
)
from prc_cli.formats.writing.columns import OptionalColumn
from prc_cli.formats.writing.record import RunRecord

COPC_USER = "copc"
RECORD_TEXT = "prc run record"
"""Description of the VLR that holds the run record."""
Masks = Callable[[int], Iterator[Mask]]
"""Called with a batch size; yields a mask of the records to keep for every batch of the input; where they end, no
further record is read."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Differences between an output and its input."""

    point_format: int
    """Point format written."""
    compress: bool
    """LAZ."""
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
        """Whether the compressed records are read back and compared: waveform packets are sometimes damaged."""
        return self.compress and self.point_format in (9, 10)

    def upgrades(self, las: LasHeader) -> bool:
        """Whether the point format changes."""
        return self.point_format != las.point_format

    def only_classes(self, las: LasHeader) -> bool:
        """Whether only the classes change, in the same point format."""
        changed = self.appended or self.replaced or self.upgrades(las)
        return not changed and self.compress == las.compressed


def read_las(path: Path) -> LasHeader:
    """Read header, VLRs and EVLRs of a LAS or LAZ file with their positions."""
    las = read_header(path)
    if las.compressed:
        with open_source(path) as source:
            LazRecords(source, las)
    return las


def check_copied(las: LasHeader) -> None:
    """Refuse points that cannot be copied as bytes."""
    if any(vlr.user_id == "lascompatible" for vlr in las.vlrs):
        problem = "found LAS 1.4 points in LASzip's compatibility mode, whose classes lie in extra bytes"
        raise InputError(str(las.path), problem, "write it again as plain LAS 1.4, e.g. with las2las or PDAL")


def with_record(vlrs: list[Vlr], record: RunRecord) -> list[Vlr]:
    """Return the VLRs with a run record, replacing an old one, shortened if it is too long for a VLR."""
    new = make_vlr(RECORD_KEY, record.to_json_within(VLR_LIMIT), RECORD_TEXT)
    place = next((index for index, vlr in enumerate(vlrs) if vlr.has(RECORD_KEY)), len(vlrs))
    vlrs = [vlr for vlr in vlrs if not vlr.has(RECORD_KEY)]
    return [*vlrs[:place], new, *vlrs[place:]]


def with_laszip(las: LasHeader, plan: Plan, vlrs: list[Vlr]) -> tuple[list[Vlr], str | None]:
    """Return the VLRs that the compression of the plan needs, and the notices about them."""
    if not plan.compress:
        return [vlr for vlr in vlrs if not vlr.has(LASZIP_KEY)], None
    same = not plan.upgrades(las) and not plan.appended
    new = laszip_vlr(las, plan.point_format, las.n_extra_bytes + plan.n_appended, keep=same)
    old = las.vlr(LASZIP_KEY)
    if old is None or old.data is None:
        return [*vlrs, new], None
    notice = None
    if has_variable_chunks(old.data):
        notice = "compressed chunks of differing length were written as chunks of equal length"
    elif same and new.data != old.data:
        notice = "the points were compressed with a version of laszip's items that is not written"
        notice += "; the usual one is used"
    return [new if vlr.has(LASZIP_KEY) else vlr for vlr in vlrs], notice


def has_waveform_file(las: LasHeader) -> bool:
    """Whether waveforms are in a separate file beside the input."""
    fields = las.fields()
    return bool(fields.get("global_encoding") & 4 and fields.has("waveform_start"))


def copy_las(
    las: LasHeader, output: Path, temporary: Path, masks: Masks | None = None, record: RunRecord | None = None
) -> tuple[str, ...]:
    """Write a LAS or LAZ file again under a temporary name."""
    notices: list[str] = []
    plan = Plan(las.point_format, output.suffix.lower() == ".laz")
    vlrs, drop = list(las.vlrs), [COPC_USER]
    if any(vlr.user_id == COPC_USER for vlr in vlrs):
        if masks is not None or not (plan.compress and las.compressed):
            notices.append("the COPC index does not fit the rewritten records and was left out")
        vlrs = [vlr for vlr in vlrs if vlr.user_id != COPC_USER]
    if record is not None:
        vlrs = with_record(vlrs, record)
        drop.append(RECORD_KEY[0])
    if has_waveform_file(las):
        notices.append(f"waveforms lie in a file of their own: copy {las.path.stem}.wdp beside the output")
    vlrs, notice = with_laszip(las, plan, vlrs)
    notices += [notice] if notice else []
    seen = Seen(las, masks is not None)

    def points(source: Source, _: Target, open_sink: Callable[[], PointSink]) -> None:
        _copy_points(plan, source, open_sink(), masks, seen)

    write_again(las, plan, vlrs, temporary, points, seen.set_counts, drop=tuple(drop))
    if plan.is_checked:
        check_compressed(temporary, output, seen.checksum)
    return tuple(notices)


class Seen:
    """Counts and bounds of the records written, for the header."""

    def __init__(self, las: LasHeader, is_part: bool) -> None:
        self.las = las
        self.is_part = is_part
        self.checksum = 0
        self._n = 0
        self._by_return = np.zeros(16, np.int64)
        self._low = np.full(3, np.iinfo(np.int64).max)
        self._high = np.full(3, np.iinfo(np.int64).min)

    def see(self, records: U8) -> None:
        """Add records."""
        if not len(records):
            return
        self._n += len(records)
        number = records[:, 14] & (0x0F if self.las.point_format >= 6 else 0x07)
        self._by_return += np.bincount(number, minlength=16)
        xyz = np.ascontiguousarray(records[:, :12]).view("<i4")
        self._low = np.minimum(self._low, xyz.min(axis=0))
        self._high = np.maximum(self._high, xyz.max(axis=0))

    def set_counts(self, fields: HeaderFields) -> None:
        """Set counts and bounds from the records kept; fields that are zero in the input stay zero."""
        if not self.is_part:
            return
        if fields.get("legacy_n_points"):
            fields.set("legacy_n_points", self._n)
            fields.set("legacy_by_return", *self._by_return[1:6].tolist())
        if fields.has("n_points"):
            fields.set("n_points", self._n)
            fields.set("by_return", *self._by_return[1:].tolist())
        if self._n:
            scale, offset = np.array(self.las.scales), np.array(self.las.offsets)
            bounds = np.stack([self._high * scale + offset, self._low * scale + offset], axis=1)
            fields.set("bounds", *np.sort(bounds, axis=1)[:, ::-1].ravel().tolist())


def _copy_points(plan: Plan, source: Source, sink: PointSink, masks: Masks | None, seen: Seen) -> None:
    n = batch_records(seen.las, compressed=seen.las.compressed or plan.compress)
    keep = None if masks is None else masks(n)
    with contextlib.closing(read_records(source, seen.las, n)) as batches:
        for records in batches:
            if keep is None:
                chosen = records
            elif (mask := next(keep, None)) is not None:
                chosen = records[mask]
                seen.see(chosen)
            else:
                break
            if plan.is_checked:
                seen.checksum = crc(chosen, seen.checksum)
            if len(chosen):
                sink.write(chosen)
    sink.close()


def write_again(
    las: LasHeader,
    plan: Plan,
    vlrs: list[Vlr],
    temporary: Path,
    write_points: Callable[[Source, Target, Callable[[], PointSink]], None],
    finish: Callable[[HeaderFields], None],
    drop: tuple[str, ...],
) -> None:
    """Copy a file: header, VLRs and user bytes, points, what follows them, and the final header."""
    with open_source(las.path) as source, temporary.open("w+b") as writing:
        target = Target(writing)
        fields = _new_fields(las, plan, vlrs)
        target.write(fields.data)
        for vlr in vlrs:
            target.write(vlr.raw)
        copy_bytes(source, target, las.vlr_end, las.data_offset)

        def open_sink() -> PointSink:
            if not plan.compress:
                return LasSink(target)
            return LazSink(target, next(vlr.data or b"" for vlr in vlrs if vlr.has(LASZIP_KEY)))

        write_points(source, target, open_sink)
        tail = plan_tail(las, tail_bounds(source, las), target.tell(), drop=drop)
        for start, stop in tail.spans:
            copy_bytes(source, target, start, stop)
        _set_tail(fields, las, tail)
        finish(fields)
        target.seek(0)
        target.write(fields.data)
        target.flush()


def _new_fields(las: LasHeader, plan: Plan, vlrs: list[Vlr]) -> HeaderFields:
    """Return the header with the changes of the plan; the offsets behind the points are set later."""
    fields = las.fields()
    if plan.upgrades(las):
        fields = _as_1_4(fields)
        fields.set("legacy_n_points", 0)
        fields.set("legacy_by_return", 0, 0, 0, 0, 0)
        fields.set("global_encoding", fields.get("global_encoding") | WKT_BIT)
    if plan.upgrades(las) or plan.compress != las.compressed:
        fields.set("point_format", plan.point_format | (COMPRESSED if plan.compress else 0))
    added = standard_bytes(plan.point_format) - standard_bytes(las.point_format) + plan.n_appended
    fields.set("record_length", las.record_bytes + added)
    fields.set("n_vlrs", len(vlrs))
    user_bytes = las.data_offset - las.vlr_end
    offset = len(fields.data) + sum(len(vlr.raw) for vlr in vlrs) + user_bytes
    if offset >= 1 << 32:
        raise OutputError(str(las.path), f"points would begin at byte {offset}, LAS allows 4294967295")
    fields.set("point_offset", offset)
    return fields


def _as_1_4(fields: HeaderFields) -> HeaderFields:
    """Return a header of any version as LAS 1.4; user bytes at its end stay there."""
    minor = fields.data[25]
    if minor == 4:
        return fields
    standard = STANDARD_HEADER[minor]
    new = HeaderFields(bytes(fields.data[:standard]) + bytes(375 - standard) + bytes(fields.data[standard:]))
    new.data[25] = 4
    new.set("header_size", len(new.data))
    return new


@dataclass(frozen=True, slots=True)
class Tail:
    """Spans of the input that follow the points of the output."""

    spans: tuple[tuple[int, int], ...]
    """First byte and end of every copied span of the input, in order."""
    start: int
    """First byte behind the points of the output."""
    evlr_start: int
    """First EVLR of the output; 0 = none."""
    n_evlrs: int
    """EVLRs of the output."""

    def moved(self, position: int) -> int:
        """Return where a byte of the input lies in the output; the same number where it is not copied.

        >>> Tail(((100, 120), (150, 160)), 300, 0, 0).moved(155)
        325
        """
        at = self.start
        for first, stop in self.spans:
            if first <= position < stop:
                return at + position - first
            at += stop - first
        return position


def plan_tail(las: LasHeader, bounds: tuple[int, int], start: int, drop: tuple[str, ...]) -> Tail:
    """Plan the copy of everything behind the points, without the EVLRs of some user ids."""
    cursor, end = bounds
    if las.evlrs and las.evlrs[0].start < cursor:
        problem = f"found the first EVLR at byte {las.evlrs[0].start}, expected it behind the points (byte {cursor})"
        raise damaged(las.path, 235, problem)
    spans: list[tuple[int, int]] = []
    kept = [evlr for evlr in las.evlrs if evlr.user_id not in drop]
    for evlr in las.evlrs:
        if evlr.user_id in drop:
            spans.append((cursor, evlr.start))
            cursor = evlr.stop
    spans.append((cursor, max(cursor, end)))
    tail = Tail(tuple((first, stop) for first, stop in spans if first < stop), start, 0, len(kept))
    return replace(tail, evlr_start=tail.moved(kept[0].start) if kept else 0)


def _set_tail(fields: HeaderFields, las: LasHeader, tail: Tail) -> None:
    """Set the header fields that point behind the points."""
    before = las.fields()
    if fields.has("waveform_start") and before.get("waveform_start"):
        fields.set("waveform_start", tail.moved(before.get("waveform_start")))
    if not fields.has("evlr_start"):
        return
    if before.has("evlr_start"):
        fields.set("evlr_start", tail.evlr_start if tail.n_evlrs or las.evlrs else before.get("evlr_start"))
        fields.set("n_evlrs", tail.n_evlrs)
    elif fields.get("waveform_start") and fields.get("global_encoding") & 2:
        # LAS 1.3 has its waveforms in an EVLR, but only LAS 1.4 has a count of EVLRs
        fields.set("evlr_start", fields.get("waveform_start"))
        fields.set("n_evlrs", 1)


def check_compressed(path: Path, output: Path, checksum: int) -> None:
    """Decompress what was written and compare its CRC-32.

    The check is for waveform packets (formats 9 and 10) of several scanner channels, which version 3 of laszip's coder
    damages (seen with lazrs 0.8.2).
    """
    las, found = read_header(path), 0
    n = batch_records(las, compressed=True)
    with open_source(path) as source, contextlib.closing(read_records(source, las, n)) as batches:
        for records in batches:
            found = crc(records, found)
    if found != checksum:
        problem = f"LAZ does not hold the waveform packets of these point format {las.point_format} records unchanged"
        raise OutputError(str(output), problem, "write .las instead of .laz")
