"""Writes classes into a copy of a LAS or LAZ file; nothing else changes except as ``[output]`` asks."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import ClassCodes
from prc_cli.core.errors import ConfigError, InputError, OutputError
from prc_cli.core.files import output_errors
from prc_cli.core.types import I64, U8
from prc_cli.formats.las import SUFFIXES
from prc_cli.formats.las.build import LasBuilder
from prc_cli.formats.las.copc import Copc, find_copc, move_index, splice_copc
from prc_cli.formats.las.copy import (
    COPC_USER,
    Plan,
    Seen,
    check_compressed,
    check_copied,
    has_waveform_file,
    read_las,
    with_laszip,
    with_record,
    write_again,
)
from prc_cli.formats.las.crs import with_wkt
from prc_cli.formats.las.header import RECORD_KEY, HeaderFields, LasHeader, Source, Vlr, open_source, standard_bytes
from prc_cli.formats.las.laz import read_records
from prc_cli.formats.las.lookup import with_lookup
from prc_cli.formats.las.points import (
    FORMAT_FOR_CODES,
    append_bytes,
    count_returns,
    data_type_of,
    read_layout,
    set_classes,
    upgrade,
    with_extra_dimensions,
)
from prc_cli.formats.las.sinks import PointSink, Target, batch_records, crc
from prc_cli.formats.las.splice import find_chunks, splice_classes, splice_records
from prc_cli.formats.writing.base import Columns, ScatterWriter, StagedWriter
from prc_cli.formats.writing.columns import FIVE_BIT_LIMIT, OPTIONAL_COLUMNS, LabelOutput, asked_columns
from prc_cli.formats.writing.record import RunRecord


class LasRewriter(ScatterWriter):
    """Writer of a LAS or LAZ file from the LAS or LAZ file that was classified."""

    def __init__(self, labels: LabelOutput) -> None:
        self._source_path = labels.source
        self._laz_contexts = None if labels.is_part else labels.laz_contexts
        self._user_names = dict(labels.user_names)
        self._state = self._source_state()
        self._las = read_las(labels.source)
        super().__init__(labels, asked_columns(labels.options), self._las.n_records)
        self._compress = labels.path.suffix.lower() == ".laz"

    def _source_state(self) -> tuple[int, int, int, int]:
        """Size, times of the last change and number of the input file: if one differs, the file has changed."""
        with open_source(self._source_path) as source:
            return source.state()

    def _write(self, record: RunRecord) -> RunRecord:
        las, before = read_las(self._source_path), self._las
        if (las.raw, las.vlrs, las.evlrs, las.file_bytes) != (before.raw, before.vlrs, before.evlrs, before.file_bytes):
            problem = "found another header than at the start of the run, expected the same file"
            raise InputError(str(self._source_path), problem, "run again when nothing else writes the input")
        for columns in self._columns(las.n_records):
            self._count(columns.codes)
        plan = self._plan(las)
        copc = self._copc(las, plan)
        vlrs = self._vlrs(las, plan, keeps_index=copc is not None)
        record = self._completed(record)
        points = _Points(las, plan, is_part=self._is_part)

        moved: dict[int, tuple[int, int]] = {}

        def write_points(source: Source, target: Target, open_sink: Callable[[], PointSink]) -> None:
            if copc is not None:
                n = batch_records(las, compressed=True)
                codes = (columns.codes for columns in self._columns(las.n_records, n))
                moved.update(splice_copc(source, target, copc, codes, self._laz_contexts))
                return
            chunks = find_chunks(source, las) if plan.only_classes(las) and not self._is_part else None
            if chunks is None:
                n = batch_records(las, compressed=las.compressed or plan.compress)
                points.write(source, open_sink(), n, self._columns(las.n_records, n))
                return
            codes = (columns.codes for columns in self._columns(las.n_records, splice_records(chunks)))
            splice_classes(source, target, chunks, codes, self._laz_contexts)

        drop = (RECORD_KEY[0],) if copc is not None else (RECORD_KEY[0], COPC_USER)
        write_again(las, plan, with_record(vlrs, record), self._temporary, write_points, points.finish, drop)
        if copc is not None:
            with open_source(self._source_path) as source:
                move_index(self._temporary, source, copc, moved)
        if plan.is_checked:
            check_compressed(self._temporary, self.path, points.checksum)
        if self._source_state() != self._state:
            problem = "changed while it was read"
            raise InputError(str(self._source_path), problem, "run again when nothing else writes the input")
        return record

    def _plan(self, las: LasHeader) -> Plan:
        used = np.flatnonzero(self._counts)
        highest = int(used[-1]) if len(used) else 0
        form = las.point_format
        if form < 6 and highest >= FIVE_BIT_LIMIT:
            form = FORMAT_FOR_CODES[las.point_format]
            lost = {0: "; gps_time is 0", 2: "; gps_time is 0", 5: "; near infrared is 0"}.get(las.point_format, "")
            self._notice(f"point format {las.point_format} cannot hold code {highest}; upgraded to {form}{lost}")
        moved = standard_bytes(form) - standard_bytes(las.point_format)
        appended, replaced = [], []
        there = {extra.name: extra for extra in read_layout(las).extra} if self._optional else {}
        for column in self._optional:
            found, data_type = there.get(column.name), data_type_of(column.dimension)
            if found is None:
                appended.append(column)
            elif found.data_type != data_type:
                problem = f"the input has extra bytes named {column.name!r} of type {found.data_type}, expected none"
                problem += f" or type {data_type}"
                raise OutputError(str(las.path), problem, f"set [output] {column.option} = false")
            elif column.keep:
                self._notice(f"the input has {column.name} already; it was kept as it is")
            else:
                self._notice(f"the input has {column.name} already; its values were replaced")
                replaced.append((column, found.place + moved))
        plan = Plan(form, self._compress, tuple(appended), tuple(replaced))
        length = las.record_bytes + moved + plan.n_appended
        if length > 65_535:
            raise OutputError(
                str(las.path), f"records would take {length} bytes, LAS allows 65535", "add no extra bytes"
            )
        return plan

    def _copc(self, las: LasHeader, plan: Plan) -> Copc | None:
        """Return the index of a COPC input that the output keeps."""
        if self._is_part or not plan.only_classes(las) or not any(vlr.user_id == COPC_USER for vlr in las.vlrs):
            return None
        with open_source(self._source_path) as source:
            return find_copc(source, las)

    def _vlrs(self, las: LasHeader, plan: Plan, *, keeps_index: bool) -> list[Vlr]:
        """VLRs of the output, still with the old run record."""
        vlrs = list(las.vlrs)
        if keeps_index:
            check_copied(las)
            return vlrs
        if any(vlr.user_id == COPC_USER for vlr in vlrs):
            self._notice(
                "the COPC index does not fit the rewritten chunks and was left out: the output is plain LAS/LAZ"
            )
            vlrs = [vlr for vlr in vlrs if vlr.user_id != COPC_USER]
        check_copied(las)
        options = dict.fromkeys(column.option for column in plan.appended)
        hint = "set [output] " + " and ".join(f"{option} = false" for option in options)
        vlrs = with_extra_dimensions(las, vlrs, [column.dimension for column in plan.appended], hint)
        if plan.upgrades(las):
            vlrs, notice = with_wkt(vlrs, plan.point_format)
            if notice:
                self._notice(notice)
        if has_waveform_file(las):
            self._notice(
                f"waveforms lie in a file of their own beside the input; copy {las.path.stem}.wdp beside the output"
            )
        vlrs, notice = with_laszip(las, plan, vlrs)
        if notice:
            self._notice(notice)
        vlrs, notices = with_lookup(las, vlrs, self._user_names)
        for notice in notices:
            self._notice(notice)
        return vlrs


class _Points:
    """Writes every record with its class, and collects counts and checksum for the header and the check."""

    def __init__(self, las: LasHeader, plan: Plan, *, is_part: bool = False) -> None:
        self._las = las
        self._plan = plan
        self.checksum = 0
        self._is_part = is_part
        self._seen = Seen(replace(las, point_format=plan.point_format), is_part)
        self._returns = np.zeros(15, np.int64)

    def write(self, source: Source, sink: PointSink, n: int, columns: Iterator[Columns]) -> None:
        """Write all records, ``n`` at a time; of a part, those of its records."""
        with contextlib.closing(read_records(source, self._las, n)) as batches:
            pairs = _of_part(batches, columns, n) if self._is_part else zip(batches, columns, strict=True)
            for old, values in pairs:
                records = changed(old, values, self._las, self._plan)
                if self._is_part:
                    self._seen.see(records)
                if self._plan.upgrades(self._las):
                    self._returns += count_returns(records)
                if self._plan.is_checked:
                    self.checksum = crc(records, self.checksum)
                sink.write(records)
        sink.close()

    def finish(self, fields: HeaderFields) -> None:
        """Set the counts of a header that was of an older version, or of a part; and the bounds of a part."""
        if self._is_part:
            self._seen.set_counts(fields)
            return
        if self._plan.upgrades(self._las):
            fields.set("n_points", self._las.n_records)
            fields.set("by_return", *self._returns.tolist())


def _of_part(batches: Iterator[U8], columns: Iterator[Columns], n: int) -> Iterator[tuple[U8, Columns]]:
    """Yield the records of a part with their values, and read no farther than to the last of them."""
    # the columns first: where they end, no further batch is decoded
    for k, (values, old) in enumerate(zip(columns, batches, strict=False)):
        if len(values.record):
            yield old[values.record - k * n], values


def changed(records: U8, columns: Columns, las: LasHeader, plan: Plan) -> U8:
    """Return records as the output holds them; may change the given ones in place."""
    if plan.upgrades(las):
        records = upgrade(records, las.point_format)
    set_classes(records, plan.point_format, columns.codes)
    for column, at in plan.replaced:
        values = columns.values[column.name].view(np.uint8).reshape(len(records), -1)
        records[:, at : at + column.dtype.itemsize] = values
    if plan.appended:
        records = append_bytes(records, [columns.values[column.name] for column in plan.appended])
    return records


CARRIED = tuple(column.name for column in OPTIONAL_COLUMNS)
"""Dimensions of this program that can be written along with the class."""


class LasRecoder(LasRewriter):
    """Writer of a LAS or LAZ file from another one, with a class code for every record.

    Use it as a context manager: :meth:`put` every record once, then :meth:`finish`; without it no output is left.
    """

    def __init__(self, path: Path, source: Path, carried: tuple[str, ...] = ()) -> None:
        super().__init__(LabelOutput(path=path, source=source, n_records=None, points_per_line=0, codes=ClassCodes()))
        for name in carried:
            if name not in CARRIED:
                raise ConfigError("--carry", f"found {name!r}, expected one of {', '.join(CARRIED)}")
        chosen = (column for column in OPTIONAL_COLUMNS if column.name in carried)
        self._optional = tuple(replace(column, keep=False) for column in chosen)

    def __enter__(self) -> Self:
        super().__enter__()
        try:
            with output_errors(self.path):
                self._settle(None)
        except BaseException:
            self._stack.close()
            raise
        return self

    def name_classes(self, names: Mapping[int, str]) -> None:
        """Set the names of user codes that the output has to name."""
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
    """Return the writer that keeps all of a LAS or LAZ input but the class, or makes a new file of another input."""
    if labels.source.suffix.lower() in SUFFIXES:
        return LasRewriter(labels)
    return LasBuilder(labels.path, labels=labels)
