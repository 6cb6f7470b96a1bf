"""Reader of raw dumps: fixed-size records of any numpy field layout."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from pathlib import Path

from prc_cli.core.errors import InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.files import open_to_read
from prc_cli.formats.binary import BinaryBody
from prc_cli.formats.options import RANGES_ONLY, Layout, record_dtype
from prc_cli.formats.records import Column, FieldSource, Reading, Source

FORMAT = "raw binary"
"""Reader name, for messages and ``prc info``."""


def layout_columns(layout: Layout) -> dict[str, Column]:
    """Return the dimensions of records that a layout describes."""
    return {item.name: Column(item.name, item.name, item) for item in layout.fields}


class RawBinarySource(FieldSource):
    """A raw dump as a :class:`prc_cli.formats.records.Source`."""

    body: BinaryBody

    def __init__(self, path: Path, layout: Layout, chunk_records: int | None = None) -> None:
        dtype = record_dtype(layout)
        n_records = _count(path, layout.header_bytes, dtype.itemsize)
        body = BinaryBody(path, dtype, layout.header_bytes, n_records, chunk_records)
        super().__init__(path, FORMAT, layout_columns(layout), body)
        header = {
            "header_bytes": layout.header_bytes,
            "record_bytes": dtype.itemsize,
            "records": n_records,
            "fields": {column.key: dtype[column.key].str for column in self.columns.values()},
        }
        self.facts = SourceFacts(line_hz=layout.line_frequency, header=header)

    def with_reading(self, reading: Reading) -> RawBinarySource:
        """Return the source whose chunks end with a block of lines (``multiple_of``)."""
        n_at_once = self.body.n_at_once
        n_blocks = max(1, n_at_once // reading.multiple_of)
        source = copy(self)
        source.body = replace(
            self.body, chunk_records=n_blocks * min(reading.multiple_of, n_at_once)
        )
        return source


def _count(path: Path, header: int, record_bytes: int) -> int:
    """Return the number of records behind the header; raise an error for a partial record."""
    with open_to_read(path) as handle:
        size = handle.seek(0, 2)
    if size <= header:
        expected = f"expected records of {record_bytes} bytes"
        problem = f"no bytes follow the header of {header} bytes, {expected}"
        hint = ""
        if not size:
            problem = f"the file is empty (0 bytes), {expected}"
            hint = "copy it again"
        elif size < header:
            problem = f"found {size} bytes, fewer than the header of {header} bytes"
        raise InputError(str(path), problem, hint or "check layout.header_bytes")
    n_records, n_left = divmod(size - header, record_bytes)
    if n_left:
        where = f"byte {size - n_left} (record {n_records})"
        problem = f"{where}: found {n_left} bytes, expected a record of {record_bytes} bytes"
        hint = (
            "copy it from the archive again, or check layout.header_bytes, fields and record_bytes"
        )
        raise InputError(str(path), problem, hint)
    return n_records


def open_dump(path: Path, layout: Layout | None) -> Source:
    """Open a dump by its layout, without fields as ranges; or a folder of pulses by its file."""
    if path.name.startswith("pulse-"):
        from prc_cli.formats.echopulse import EchoPulseSource, is_count_file

        if is_count_file(path):
            return EchoPulseSource(path)
    if layout is None:
        layout = RANGES_ONLY
    elif not layout.fields:
        layout = layout.model_copy(update={"fields": RANGES_ONLY.fields})
    return RawBinarySource(path, layout)
