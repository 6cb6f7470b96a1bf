"""Reader of raw dumps: fixed-size records of any numpy field layout."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.files import open_to_read
from prc_cli.formats.options import RANGES_ONLY, Layout, decode, record_dtype
from prc_cli.formats.records import RecordChunk, RecordSource, standard_first

CHUNK_RECORDS = 1 << 18
"""Records decoded at a time."""
CHUNK_BYTES = 64 << 20
"""Most bytes decoded at a time: long records make shorter chunks."""


class LayoutRecords:
    """Records of a layout, wherever their bytes come from."""

    format = "raw binary"
    """Reader name, for messages and ``prc info``."""

    def __init__(self, layout: Layout, path: str) -> None:
        self.path = path
        """File name, for messages."""
        self._header_bytes = layout.header_bytes
        self._dtype = record_dtype(layout)
        self._fields = {item.name: item for item in layout.fields}

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names that can be decoded, standard names first."""
        return standard_first(self._fields)

    @property
    def facts(self) -> SourceFacts:
        """Metadata: none beside the layout."""
        return SourceFacts()

    def _check_names(self, names: tuple[str, ...]) -> None:
        unknown = [name for name in names if name not in self._fields]
        if unknown:
            hint = f"the layout has: {', '.join(self.dimensions)}"
            raise ConfigError(self.path, f"no dimension {unknown[0]!r} in the layout", hint)

    def _decoded(self, first: int, records: NDArray[Any], names: tuple[str, ...]) -> RecordChunk:
        values = {name: decode(records[name], self._fields[name]) for name in names}
        return RecordChunk(first, values, len(records))


class RawBinarySource(LayoutRecords):
    """A raw dump as a :class:`prc_cli.formats.records.RecordSource`."""

    def __init__(self, path: Path, layout: Layout, chunk_records: int = CHUNK_RECORDS) -> None:
        super().__init__(layout, str(path))
        self._path = path
        self._chunk_records = max(1, min(chunk_records, CHUNK_BYTES // self._dtype.itemsize))
        self._n_records = self._count()

    def _count(self) -> int:
        """Return the number of records behind the header; a partial record is an error."""
        with open_to_read(self._path) as handle:
            size = handle.seek(0, 2)
        header, each = self._header_bytes, self._dtype.itemsize
        if not size:
            problem = f"the file is empty (0 bytes), expected records of {each} bytes"
            raise InputError(self.path, problem, "copy it from the archive again")
        if size < header:
            problem = f"found {size} bytes, fewer than the header of {header} bytes"
            raise InputError(self.path, problem, "check layout.header_bytes")
        if size == header:
            problem = f"nothing follows the header of {header} bytes, expected records of {each} bytes"
            raise InputError(self.path, problem, "check layout.header_bytes")
        n_records, rest = divmod(size - header, each)
        if rest:
            problem = f"byte {size - rest} (record {n_records}): found {rest} bytes, expected a record of {each} bytes"
            hint = "copy it from the archive again, or check layout.header_bytes, fields and record_bytes"
            raise InputError(self.path, problem, hint)
        return n_records

    def align_chunks(self, n_records: int) -> None:
        """Decode a multiple of this many records at a time, where the limits allow.

        Chunks that end with a block of lines need not be joined later; values stay the same.
        """
        self._chunk_records = max(1, self._chunk_records // n_records) * min(n_records, self._chunk_records)

    @property
    def facts(self) -> SourceFacts:
        """Metadata of the file."""
        return SourceFacts(describe=self.describe, align_chunks=self.align_chunks)

    @property
    def n_records(self) -> int:
        """Number of records, from the size of the file."""
        return self._n_records

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode the named fields in bounded memory, in the order of the file."""
        self._check_names(names)
        with open_to_read(self._path) as handle:
            handle.seek(self._header_bytes)
            for start in range(0, self._n_records, self._chunk_records):
                records = self._read(handle, start, min(self._chunk_records, self._n_records - start))
                yield self._decoded(start, records, names)

    def _read(self, handle: IO[bytes], first: int, wanted: int) -> NDArray[Any]:
        try:
            records = np.fromfile(handle, dtype=self._dtype, count=wanted)
        except OSError as error:
            problem = f"record {first} and on cannot be read ({error.strerror or error})"
            raise InputError(self.path, problem, "check the disk or copy the file again") from error
        if len(records) < wanted:
            found = first + len(records)
            at = self._header_bytes + found * self._dtype.itemsize
            problem = f"byte {at} (record {found}): the file ends, expected {self._n_records} records as when opened"
            raise InputError(self.path, problem, "it was cut while being read; wait until its writer is done")
        return records

    def describe(self) -> dict[str, Any]:
        """Return the layout as plain values for JSON, for ``prc info``."""
        return {
            "header_bytes": self._header_bytes,
            "record_bytes": self._dtype.itemsize,
            "records": self._n_records,
            "fields": {name: self._dtype[name].str for name in self._fields},
        }


def open_dump(path: Path, layout: Layout | None) -> RecordSource:
    """Open a dump by its layout, as ranges alone where the layout has no fields, or a folder of pulses by its file."""
    if path.name.startswith("pulse-"):
        from prc_cli.formats.echopulse import EchoPulseSource, is_count_file

        if is_count_file(path):
            return EchoPulseSource(path)
    if layout is None or not layout.fields:
        layout = RANGES_ONLY if layout is None else layout.model_copy(update={"fields": RANGES_ONLY.fields})
    return RawBinarySource(path, layout)
