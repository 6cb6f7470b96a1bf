"""Reader of LAS and LAZ files of all point formats; decodes requested dimensions in chunks."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from contextlib import closing
from copy import copy
from functools import cached_property
from pathlib import Path
from typing import Any

import lazrs
import numpy as np

from prc_cli.core.classes import count_bytes
from prc_cli.core.errors import ConfigError, OutputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.threads import read_ahead
from prc_cli.core.types import U8
from prc_cli.formats.las.header import (
    LasHeader,
    check_decodable,
    find_dropped,
    find_points_per_line,
    open_bytes,
    read_header,
    refused_by_laspy,
    text_of,
)
from prc_cli.formats.las.laz import LazRecords, read_batches
from prc_cli.formats.las.points import layers_of, read_layout
from prc_cli.formats.las.splice import LazContexts, contexts_of
from prc_cli.formats.las.vlrs import find_crs
from prc_cli.formats.names import angle_rules
from prc_cli.formats.options import Layout
from prc_cli.formats.records import Reading, RecordChunk, nearest_first, standard_first

CHUNK_RECORDS = 1 << 16
"""Records decoded at a time."""
CHUNK_BYTES = 64 << 20
"""Most bytes decoded at a time: long records make shorter chunks."""


class LasSource:
    """A LAS or LAZ file as a :class:`prc_cli.formats.records.Source`.

    The content decides whether it is compressed, not the suffix. Units: ``x``, ``y``, ``z`` float64
    in the file's coordinate system, ``time`` float64 [s] (gps_time as stored), ``angle`` float64
    [rad]; scaled extra bytes are scaled, their no-data values become NaN. Extra bytes of usual
    names are ranges, lines, columns and angles; the scan angle of the point format is then
    ``scan_angle``. Other extra bytes with the name of a field are ``extra_NAME``.
    """

    def __init__(self, path: Path, chunk_records: int = CHUNK_RECORDS) -> None:
        self._path = path
        self._n_unread_chunks = 0
        with open_bytes(path) as source:
            self.header: LasHeader = read_header(source)
            check_decodable(self.header)
            if self.header.compressed:
                self._n_unread_chunks = LazRecords(source, self.header).table.n_unread
        self._chunk_records = max(1, min(chunk_records, CHUNK_BYTES // self.header.record_bytes))
        self._layout = read_layout(self.header)
        self.laz_contexts = (
            LazContexts() if self.header.compressed and self.header.point_format >= 6 else None
        )
        """Kept from the records that :meth:`chunks` decodes, for rewriting the file."""
        self._reading = Reading()

    @property
    def path(self) -> str:
        """File name, for messages."""
        return str(self._path)

    @property
    def format(self) -> str:
        """``LAZ`` where the records are compressed, else ``LAS``."""
        return "LAZ" if self.header.compressed else "LAS"

    @property
    def n_records(self) -> int:
        """Number of records."""
        return self.header.n_records

    @property
    def crs_wkt(self) -> str | None:
        """Coordinate system: WKT, else ``EPSG:CODE`` from GeoTIFF keys, else None."""
        return find_crs(self.header)

    @cached_property
    def dimensions(self) -> tuple[str, ...]:
        """Names that :meth:`chunks` delivers, standard names first.

        ``time`` and ``angle`` only if any is not zero.
        """
        return standard_first([name for name in self._layout.fields if name not in self._zero])

    @cached_property
    def _zero(self) -> tuple[str, ...]:
        """Time and angle, if they are all zero in the first chunk: these are no dimensions."""
        names = tuple(name for name in ("time", "angle") if name in self._layout.fields)
        with closing(self._decoded(names)) as chunks:
            first = next(chunks)
        with np.errstate(invalid="ignore"):  # a signalling NaN is not zero either
            return tuple(name for name in names if not first.values[name].any())

    @cached_property
    def notes(self) -> tuple[str, ...]:
        """Notices about the file, one sentence each, for ``prc info``."""
        notes = []
        suffix = self._path.suffix.lower()
        if suffix in (".las", ".laz") and suffix != f".{self.format.lower()}":
            inside = "compressed" if self.header.compressed else "not compressed"
            notes.append(
                f"the suffix is {suffix} but the records are {inside}: read as {self.format}"
            )
        if self.header.is_legacy_count:
            notes.append(
                "the header's count of records (byte 247) is 0: "
                "the legacy count (byte 107) was taken"
            )
        if "time" in self._zero:
            notes.append("gps_time is 0 in the whole first chunk: the file has no times")
        if "angle" in self._zero:
            notes.append("scan_angle is 0 in the whole first chunk: the file has no scan angles")
        if self.header.n_unread_bytes and not self.header.n_unread_records:
            notes.append(
                f"{self.header.n_unread_bytes} bytes follow the last record the header counts: "
                "not read"
            )
        notes.extend(self._layout.notes)
        return tuple(notes)

    @cached_property
    def facts(self) -> SourceFacts:
        """Metadata of the file."""
        return SourceFacts(
            points_per_line=find_points_per_line(self.header),
            crs_wkt=self.crs_wkt,
            time_name="gps_time",
            range_name=self._layout.range_name,
            rules=angle_rules(self._layout.angle_name),
            notes=self.notes,
            refused=refused_by_laspy(self.header),
            unread=self._unread,
            dropped=find_dropped(self.header),
            laz_contexts=self.laz_contexts,
            header=self._header_values(),
        )

    @property
    def _unread(self) -> str:
        if n := self.header.n_unread_records:
            return f"{n:,} whole records follow the {self.n_records:,} that the header counts"
        if n := self._n_unread_chunks:
            follows = f"follow the {self.n_records:,} records that the header counts"
            return f"{n} LAZ chunks of records {follows}"
        return ""

    def with_reading(self, reading: Reading) -> LasSource:
        """Return the source that spares intensities, or decodes every compressed layer.

        Intensities take a fifth of the time: shots of one return are then left undefined.
        """
        source = copy(self)
        source._reading = self._reading.also(reading)
        return source

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode dimensions from the start, in the order of the file.

        LAZ is read ahead after the first chunk.
        """
        fields = self._layout.fields
        unknown = [name for name in names if name not in fields]
        if unknown:
            raise ConfigError(
                self.path,
                f"no dimension {unknown[0]!r} in the file",
                f"it has: {', '.join(nearest_first(fields, unknown[0]))}",
            )
        decoded = self._decoded(names)
        first = next(decoded)
        try:
            yield first
        except BaseException:
            decoded.close()
            raise
        # uncompressed records are decoded faster than one thread can hand them to another
        apart = self.header.compressed and first.n < self.n_records
        yield from read_ahead(decoded, depth=1) if apart else decoded

    def _decoded(self, names: tuple[str, ...]) -> Generator[RecordChunk]:
        """Decode batch by batch; every dimension is copied out of its batch."""
        fields = self._layout.fields
        contexts = self.laz_contexts
        for first, raw in self._batches(names):
            if contexts is not None and first == contexts.n_seen:
                contexts.see(first, contexts_of(raw))
            if contexts is not None and self._reading.checks_layers:
                contexts.check(first, len(raw))
            records = raw.view(self._layout.dtype)[:, 0]
            yield RecordChunk(
                first, {name: fields[name].decode(records) for name in names}, len(records)
            )

    def _batches(self, names: tuple[str, ...]) -> Iterator[tuple[int, U8]]:
        asked = [self._layout.fields[name] for name in names]
        layers = layers_of(asked)
        layers_of_several = None
        if self._reading.spares_intensity and "intensity" in names:
            layers_of_several = layers
            layers = layers_of(field for field in asked if field.layer != "intensity")
        if self._reading.checks_layers and self.laz_contexts is not None:
            layers = lazrs.SELECTIVE_DECOMPRESS_ALL
            layers_of_several = None
        with open_bytes(self._path) as source:
            yield from read_batches(
                source, self.header, self._chunk_records, layers, layers_of_several, reuse=True
            )

    def _header_values(self) -> dict[str, Any]:
        header = self.header
        extra_bytes = [
            {
                "name": extra.name,
                "type": extra.type_name,
                "description": extra.description,
                "scaled": extra.scale is not None,
            }
            for extra in self._layout.extra
        ]
        vlrs = [
            {
                "user_id": vlr.user_id,
                "record_id": vlr.record_id,
                "bytes": vlr.n_bytes,
                "description": vlr.description,
                "extended": vlr.extended,
            }
            for vlr in (*header.vlrs, *header.evlrs)
        ]
        return {
            "version": "{}.{}".format(*header.version),
            "point_format": header.point_format,
            "compressed": header.compressed,
            "records": header.n_records,
            "record_bytes": header.record_bytes,
            "scales": list(header.scales),
            "offsets": list(header.offsets),
            "bounds": {"min": list(header.mins), "max": list(header.maxs)},
            "system_id": text_of(header.fields().values("system_id")[0]),
            "generating_software": text_of(header.fields().values("software")[0]),
            "crs": self.crs_wkt,
            "extra_bytes": extra_bytes,
            "vlrs": vlrs,
            "notes": list(self.notes),
        }


def open_las(path: Path, layout: Layout | None) -> LasSource:
    """Open a LAS or LAZ file; the layout is not used."""
    return LasSource(path)


def classes_by_laspy(path: Path) -> dict[int, int]:
    """Count the classes of a LAS or LAZ file with laspy, an independent reader."""
    # imported here: costs 20 MiB and a tenth of a second
    import laspy

    try:
        points = laspy.read(path)
    except Exception as error:  # laspy raises errors of its own, and any others on damaged files
        raise OutputError(
            str(path), f"laspy does not read it ({error})", "report it, with laspy's version"
        ) from error
    counts = count_bytes(np.ascontiguousarray(points.classification, np.uint8))
    return {int(code): int(counts[code]) for code in np.flatnonzero(counts)}
