"""LAS or LAZ in, LAS or LAZ out: classes set, everything else bit for bit as it was.

The input is read again as bytes. Header, VLRs, user bytes, points and what follows them are copied in their order;
changed are the class of every record, what the ``[output]`` table asks for, and the offsets that this moves.
"""

from __future__ import annotations

import contextlib
from collections.abc import Generator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from prc_cli.core.classes import ClassCodes
from prc_cli.core.errors import InputError, OutputError
from prc_cli.core.facts import ClassContexts
from prc_cli.core.types import U8
from prc_cli.formats.las.codec import (
    LASZIP_KEY,
    LasSink,
    LazSink,
    PointSink,
    Target,
    batch_records,
    check_compressed,
    copy_bytes,
    crc,
    has_variable_chunks,
    laszip_payload,
    read_points,
    tail_bounds,
)
from prc_cli.formats.las.file import (
    POINT_SIZES,
    STANDARD_HEADER,
    Header,
    LasFile,
    Source,
    Vlr,
    open_source,
    read_structure,
)
from prc_cli.formats.las.points import (
    FORMAT_FOR_CODES,
    append_bytes,
    count_returns,
    set_classes,
    upgrade,
)
from prc_cli.formats.las.splice import find_chunks, splice_classes, splice_records
from prc_cli.formats.las.tail import Tail, plan_tail
from prc_cli.formats.las.vlrs import (
    COPC_USER,
    RECORD_KEY,
    WKT_BIT,
    find_dimension,
    make_vlr,
    record_vlr,
    with_extra_dimensions,
    with_wkt,
)
from prc_cli.formats.writing.base import Columns, ScatterWriter
from prc_cli.formats.writing.columns import OptionalColumn, asked_columns
from prc_cli.formats.writing.options import FIVE_BIT_LIMIT, OutputConfig
from prc_cli.formats.writing.record import RunRecord


@dataclass(frozen=True, slots=True)
class Plan:
    """What an output differs in from its input."""

    point_format: int
    """Point format written."""
    compress: bool
    """LAZ."""
    appended: tuple[OptionalColumn, ...] = ()
    """Columns appended to every record, in order."""
    replaced: tuple[tuple[OptionalColumn, int], ...] = ()
    """Columns that the records have already and that are replaced, each with its first byte."""

    @property
    def n_appended(self) -> int:
        """Bytes appended to every record."""
        return sum(column.dtype.itemsize for column in self.appended)

    def only_classes(self, las: LasFile) -> bool:
        """Whether the points differ in nothing but their classes, stored as they were."""
        changed = self.appended or self.replaced or self.point_format != las.point_format
        return not changed and self.compress == las.compressed


class LasRewriter(ScatterWriter):
    """Writer of a LAS or LAZ file from the LAS or LAZ file that was classified."""

    def __init__(
        self,
        path: Path,
        codes: ClassCodes,
        options: OutputConfig,
        source: Path,
        laz_contexts: ClassContexts | None = None,
    ) -> None:
        self._source_path = source
        self._laz_contexts = laz_contexts
        self._state = self._source_state()
        las = self._structure()
        super().__init__(path, codes, options, asked_columns(options), las.n_points)
        self._las = las
        self._compress = path.suffix.lower() == ".laz"

    def _structure(self) -> LasFile:
        with open_source(self._source_path) as source:
            return read_structure(source)

    def _source_state(self) -> tuple[int, int, int]:
        """Size, time of the last change and number of the input file: another one of any is another file."""
        with open_source(self._source_path) as source:
            return source.state()

    def _write(self, record: RunRecord) -> RunRecord:
        las = self._structure()
        if las != replace(self._las, header=las.header) or las.header.data != self._las.header.data:
            problem = "found another header than at the start of the run, expected the same file"
            raise InputError(str(self._source_path), problem, "run again when nothing else writes the input")
        for columns in self._columns(las.n_points):
            self._count(columns.codes)
        plan = self._plan(las)
        vlrs, bits = self._vlrs(las, plan)
        record = self._completed(record)
        place = next((index for index, vlr in enumerate(vlrs) if vlr.key == RECORD_KEY), len(vlrs))
        vlrs = [vlr for vlr in vlrs if vlr.key != RECORD_KEY]
        vlrs.insert(place, record_vlr(record))
        with open_source(self._source_path) as source, self._temporary.open("w+b") as writing:
            self._rewrite(las, plan, vlrs, bits, source, writing)
        if self._source_state() != self._state:
            problem = "changed while it was read"
            raise InputError(str(self._source_path), problem, "run again when nothing else writes the input")
        return record

    def _plan(self, las: LasFile) -> Plan:
        used = np.flatnonzero(self._counts)
        highest = int(used[-1]) if len(used) else 0
        form = las.point_format
        if form < 6 and highest >= FIVE_BIT_LIMIT:
            form = FORMAT_FOR_CODES[las.point_format]
            lost = {0: "; gps_time is 0", 2: "; gps_time is 0", 5: "; near infrared is 0"}.get(las.point_format, "")
            self._notice(f"point format {las.point_format} cannot hold code {highest}; upgraded to {form}{lost}")
        moved = POINT_SIZES[form] - POINT_SIZES[las.point_format]
        appended, replaced = [], []
        for column in self._optional:
            dimension = column.dimension
            found = find_dimension(las, dimension.name)
            if found is None:
                appended.append(column)
            elif found[1] != dimension.data_type:
                problem = f"the input has extra bytes named {dimension.name!r} of type {found[1]}, expected none"
                problem += f" or type {dimension.data_type}"
                raise OutputError(str(las.path), problem, f"set [output] {column.option} = false")
            elif column.keep:
                self._notice(f"the input has {column.name} already; it was kept as it is")
            else:
                self._notice(f"the input has {column.name} already; its values were replaced")
                replaced.append((column, found[0] + moved))
        plan = Plan(form, self._compress, tuple(appended), tuple(replaced))
        length = las.record_length + moved + plan.n_appended
        if length > 65_535:
            raise OutputError(
                str(las.path), f"records would take {length} bytes, LAS allows 65535", "add no extra bytes"
            )
        return plan

    def _vlrs(self, las: LasFile, plan: Plan) -> tuple[list[Vlr], int]:
        """VLRs of the output, the run record still the old one; and the global encoding bits to add."""
        vlrs = list(las.vlrs)
        bits = 0
        if any(vlr.key[0] == COPC_USER for vlr in vlrs):
            self._notice(
                "the COPC index does not fit the rewritten chunks and was left out: the output is plain LAS/LAZ"
            )
            vlrs = [vlr for vlr in vlrs if vlr.key[0] != COPC_USER]
        if any(vlr.key[0] == "lascompatible" for vlr in vlrs):
            problem = "found LAS 1.4 points in LASzip's compatibility mode, whose classes lie in extra bytes"
            raise InputError(str(las.path), problem, "write it again as plain LAS 1.4, e.g. with las2las or PDAL")
        options = dict.fromkeys(column.option for column in plan.appended)
        hint = "set [output] " + " and ".join(f"{option} = false" for option in options)
        vlrs = with_extra_dimensions(las, vlrs, [column.dimension for column in plan.appended], hint)
        if plan.point_format != las.point_format:
            bits = WKT_BIT
            vlrs, notice = with_wkt(vlrs, plan.point_format)
            if notice:
                self._notice(notice)
        if las.header.get("global_encoding") & 4 and las.header.has("waveform_start"):
            self._notice(
                f"waveforms lie in a file of their own beside the input; copy {las.path.stem}.wdp beside the output"
            )
        return self._with_laszip(las, plan, vlrs), bits

    def _with_laszip(self, las: LasFile, plan: Plan, vlrs: list[Vlr]) -> list[Vlr]:
        if not plan.compress:
            return [vlr for vlr in vlrs if vlr.key != LASZIP_KEY]
        same = plan.point_format == las.point_format and not plan.appended
        extra = las.n_extra_bytes + plan.n_appended
        payload = laszip_payload(las, plan.point_format, extra, keep=same)
        old = las.vlr(*LASZIP_KEY)
        if old is None:
            return [*vlrs, make_vlr(LASZIP_KEY, payload, "laszip (lazrs)")]
        if has_variable_chunks(old.payload):
            self._notice("compressed chunks of differing length were written as chunks of equal length")
        elif same and payload != old.payload:
            self._notice(
                "the points were compressed with a version of laszip's items that is not written; the usual one is used"
            )
        return [old.with_payload(payload) if vlr.key == LASZIP_KEY else vlr for vlr in vlrs]

    def _rewrite(self, las: LasFile, plan: Plan, vlrs: list[Vlr], bits: int, source: Source, writing: BinaryIO) -> None:
        target = Target(writing)
        header = new_header(las, plan, vlrs, bits)
        target.write(header.data)
        for vlr in vlrs:
            target.write(vlr.raw)
        copy_bytes(source, target, las.vlr_end, las.point_offset)  # user bytes
        checksum, returns = self._write_points(las, plan, vlrs, source, target)
        tail = plan_tail(las, tail_bounds(source, las), target.tell(), drop=(RECORD_KEY[0], COPC_USER))
        for start, stop in tail.spans:
            copy_bytes(source, target, start, stop)
        set_tail(header, las, tail)
        if plan.point_format != las.point_format:
            header.set("n_points", las.n_points)
            header.set("by_return", *returns.tolist())
        target.seek(0)
        target.write(header.data)
        target.flush()
        if plan.compress and plan.point_format in (9, 10):
            written = replace(las, header=header, vlrs=tuple(vlrs), point_format=plan.point_format, compressed=True)
            written = replace(written, record_length=header.get("record_length"))
            check_compressed(self._temporary, self.path, written, checksum)

    def _write_points(
        self, las: LasFile, plan: Plan, vlrs: list[Vlr], source: Source, target: Target
    ) -> tuple[int, np.ndarray[tuple[int], np.dtype[np.int64]]]:
        """Write every record with its class; return CRC-32 and counts by return (of an upgraded format)."""
        checksum = 0
        returns = np.zeros(15, np.int64)
        chunks = find_chunks(source, las) if plan.only_classes(las) else None
        if chunks is not None:
            codes = (columns.codes for columns in self._columns(las.n_points, splice_records(las, chunks)))
            splice_classes(source, target, las, chunks, codes, self._laz_contexts)
            return checksum, returns
        sink: PointSink = LasSink(target)
        if plan.compress:
            sink = LazSink(target, next(vlr.payload for vlr in vlrs if vlr.key == LASZIP_KEY))
        with contextlib.closing(self._records(las, plan, source)) as batches:
            for records in batches:
                if plan.point_format != las.point_format:
                    returns += count_returns(records)
                if plan.compress and plan.point_format in (9, 10):
                    checksum = crc(records, checksum)
                sink.write(records)
        sink.close()
        return checksum, returns

    def _records(self, las: LasFile, plan: Plan, source: Source) -> Generator[U8]:
        n = batch_records(las.record_length, compressed=las.compressed or plan.compress)
        with contextlib.closing(read_points(source, las, n)) as batches:
            for records, columns in zip(batches, self._columns(las.n_points, n), strict=True):
                yield changed(records, columns, las, plan)


def changed(records: U8, columns: Columns, las: LasFile, plan: Plan) -> U8:
    """Return records as they go into the output; the given ones may be changed in place."""
    if plan.point_format != las.point_format:
        records = upgrade(records, las.point_format)
    set_classes(records, plan.point_format, columns.codes)
    for column, at in plan.replaced:
        values = columns.values[column.name].view(np.uint8).reshape(len(records), -1)
        records[:, at : at + column.dtype.itemsize] = values
    if plan.appended:
        records = append_bytes(records, [columns.values[column.name] for column in plan.appended])
    return records


def new_header(las: LasFile, plan: Plan, vlrs: list[Vlr], bits: int) -> Header:
    """Return the input's header with the fields that the plan changes; what follows the points is set later."""
    header = las.header.copy()
    if plan.point_format != las.point_format:
        header = _as_1_4(header)
        header.set("legacy_n_points", 0)
        header.set("legacy_by_return", 0, 0, 0, 0, 0)
        header.set("global_encoding", header.get("global_encoding") | bits)
    if plan.point_format != las.point_format or plan.compress != las.compressed:
        header.set("point_format", plan.point_format | (0x80 if plan.compress else 0))
    added = POINT_SIZES[plan.point_format] - POINT_SIZES[las.point_format] + plan.n_appended
    header.set("record_length", las.record_length + added)
    header.set("n_vlrs", len(vlrs))
    user_bytes = las.point_offset - las.vlr_end
    offset = len(header.data) + sum(len(vlr.raw) for vlr in vlrs) + user_bytes
    if offset >= 1 << 32:
        raise OutputError(str(las.path), f"points would begin at byte {offset}, LAS allows 4294967295")
    header.set("point_offset", offset)
    return header


def _as_1_4(header: Header) -> Header:
    """Return a header of any version as LAS 1.4; user bytes at its end stay there."""
    minor = header.data[25]
    if minor == 4:
        return header
    standard = STANDARD_HEADER[minor]
    new = Header(bytes(header.data[:standard]) + bytes(375 - standard) + bytes(header.data[standard:]))
    new.data[25] = 4
    new.set("header_size", len(new.data))
    return new


def set_tail(header: Header, las: LasFile, tail: Tail) -> None:
    """Set the header fields that point at what follows the points."""
    if header.has("waveform_start") and las.header.get("waveform_start"):
        header.set("waveform_start", tail.moved(las.header.get("waveform_start")))
    if not header.has("evlr_start"):
        return
    if las.header.has("evlr_start"):
        header.set("evlr_start", tail.evlr_start if tail.n_evlrs or las.evlrs else las.header.get("evlr_start"))
        header.set("n_evlrs", tail.n_evlrs)
    elif header.get("waveform_start") and header.get("global_encoding") & 2:
        # LAS 1.3 keeps its waveforms in an EVLR that only 1.4 counts
        header.set("evlr_start", header.get("waveform_start"))
        header.set("n_evlrs", 1)
