"""Reads raw records of LAS and LAZ files in batches; the chunk table of a LAZ file is checked first.

A LAZ file is a sequence of independently compressed chunks and a table of their sizes. The table is compared with the
file and with the count in the header before decoding, so that a wrong number gives an error and not a huge allocation.
Chunks are decoded in parallel (lazrs).
"""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import lazrs
import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.threads import default_threads, read_ahead
from prc_cli.core.types import I64, U8
from prc_cli.formats.las.header import DAMAGED, LASZIP_KEY, LasHeader, Source, damaged, open_source

CHUNK_SIZE_AT = 12
"""Byte of the chunk size in the laszip VLR."""
ITEMS_AT = 32
"""Byte where the items of a record begin: their number, then type, size and version of each."""
LAYERED_FORMATS = 6
"""From this point format on, chunks are compressed in layers, one per field."""

_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Number of compressed layers by item type; extra bytes (14) have one per byte."""
_POINT10, _TIME, _RGB, _WAVE, _POINT14 = (6, 20), (7, 8), (8, 6), (9, 29), (10, 30)
_RGB14, _RGBNIR14, _WAVE14 = (11, 6), (12, 8), (13, 29)
_ITEMS = {
    0: (_POINT10,), 1: (_POINT10, _TIME), 2: (_POINT10, _RGB), 3: (_POINT10, _TIME, _RGB),
    4: (_POINT10, _TIME, _WAVE), 5: (_POINT10, _TIME, _RGB, _WAVE),
    6: (_POINT14,), 7: (_POINT14, _RGB14), 8: (_POINT14, _RGBNIR14), 9: (_POINT14, _WAVE14),
    10: (_POINT14, _RGBNIR14, _WAVE14),
}  # fmt: skip
"""Items of a record, (type, bytes), by point format; extra bytes follow as type 0, in layered chunks as type 14."""
_TOGETHER_BYTES = 16 << 20
"""Most bytes of records decoded at a time, however many the cores."""
_ONE_RETURN = 0x1F
"""Highest value of the returns byte for at most one return; the upper half holds the number of returns."""
_AHEAD = 1
"""Batches decoded ahead of the consumer."""
_SERIAL_BYTES = 256 << 20
"""Chunks that unpack to more than this are decoded piece by piece on one core."""
_SHARED_BYTES = 32 << 20
"""The same limit where several chunks are held at a time."""


@dataclass(frozen=True, slots=True)
class ChunkTable:
    """Where the compressed chunks lie."""

    first_record: I64
    """(n + 1,) int64, index of the first record of every chunk, then the number of records."""
    first_byte: I64
    """(n + 1,) int64, position in the file of every chunk, then the end of the last."""
    n_unread: int
    """Chunks entirely beyond the record count of the header; they are not read."""
    start: int
    """First byte of the chunk table."""
    stop: int
    """End of the bytes that may follow the chunk table."""


class LazRecords:
    """Raw records of a LAZ file in batches, from the start."""

    def __init__(self, source: Source, header: LasHeader) -> None:
        self._where = str(header.path)
        self._source = source
        self.header = header
        """Of the file."""
        found = header.vlr(LASZIP_KEY)
        if found is None or found.data is None:
            problem = "the records are compressed but the laszip VLR is missing"
            raise InputError(self._where, problem, DAMAGED)
        self.vlr_data = found.data
        """Content of the laszip VLR."""
        self._items = self._read_items()
        with decoding(source, "the laszip VLR cannot be read"):
            self.vlr = lazrs.LazVlr(self.vlr_data)
        self.table = self._read_table()

    def _read_items(self) -> list[tuple[int, int]]:
        """Return (type, bytes) of the items of a record, after checking the VLR."""
        data, where = self.vlr_data, f"{self._where}: laszip VLR"
        n_items = struct.unpack_from("<H", data, ITEMS_AT)[0] if len(data) >= ITEMS_AT + 2 else 0
        least = ITEMS_AT + 2 + 6 * max(n_items, 1)
        if n_items == 0 or len(data) < least:
            problem = f"{len(data)} bytes for {n_items} items, expected at least {least}"
            raise InputError(where, problem, DAMAGED)
        items = [struct.unpack_from("<HH", data, ITEMS_AT + 2 + 6 * i) for i in range(n_items)]
        n_bytes = sum(size for _, size in items)
        if n_bytes != self.header.record_bytes:
            problem = f"records of {n_bytes} bytes, expected the {self.header.record_bytes} of the header"
            raise InputError(where, problem, DAMAGED)
        if not _are_items_of(items, self.header.point_format):
            found, core = ", ".join(map(str, items)), _ITEMS[self.header.point_format]
            problem = f"items (type, bytes) {found}, expected {', '.join(map(str, core))} and extra bytes at most"
            raise InputError(where, f"{problem} for point format {self.header.point_format}", DAMAGED)
        if struct.unpack_from("<I", data, CHUNK_SIZE_AT)[0] == 0:
            raise InputError(where, "chunks of 0 records, expected at least 1", DAMAGED)
        return [(int(kind), int(size)) for kind, size in items]

    def _read_table(self) -> ChunkTable:
        header, path = self.header, self.header.path
        start = header.data_offset + 8
        position, stop = self._table_bounds()
        self._source.seek(position)
        raw = self._source.read(8)
        if len(raw) < 8:
            raise damaged(path, position, "the file ends, expected the LAZ chunk table: it changed while read")
        n_chunks = struct.unpack("<II", raw)[1]
        # every chunk begins with one uncompressed record: limits the count before allocation
        least, most = 1, (position - start) // header.record_bytes
        if not header.n_records:  # there may be no chunk, or an empty one
            least, most = 0, max(most, 1)
        if not least <= n_chunks <= most:
            problem = f"chunk table of {n_chunks} chunks, expected {least} to {most} in {position - start} bytes"
            raise damaged(path, position + 4, problem)
        with decoding(self._source, f"the chunk table at byte {position} cannot be read"):
            self._source.seek(header.data_offset)
            pairs = lazrs.read_chunk_table(self._source, self.vlr)
        if not header.n_records:
            nothing: I64 = np.array([0], np.int64)
            return ChunkTable(nothing, nothing + start, 0, position, stop)
        # 32 bits in the file; the decoder returns damaged values as they are, so keep the sums within int64
        table = np.array(pairs, dtype=np.uint64).reshape(-1, 2).clip(max=2**32).astype(np.int64)
        n_bytes = int(table[:, 1].sum())
        if len(table) != n_chunks or n_bytes > position - start or (table[:, 1] < header.record_bytes).any():
            problem = f"chunk table of {n_bytes} bytes in {len(table)} chunks"
            raise damaged(path, position, f"{problem}, expected {position - start} bytes")
        held = np.cumsum(table[:, 0])
        if held[-1] < header.n_records:
            found = f"the {len(table)} LAZ chunks hold at most {held[-1]}"
            problem = f"the header promises {header.n_records} records, {found}"
            raise InputError(self._where, problem, "the header lies or records are lost; write the file anew")
        n_used = int(np.searchsorted(held, header.n_records)) + 1
        first_record = np.concatenate(([0], held[: n_used - 1], [header.n_records])).astype(np.int64)
        first_byte = start + np.concatenate(([0], np.cumsum(table[:n_used, 1]))).astype(np.int64)
        return ChunkTable(first_record, first_byte, len(table) - n_used, position, stop)

    def _table_bounds(self) -> tuple[int, int]:
        """Return the byte where the chunk table begins, and the end of the bytes that may follow it."""
        header = self.header
        stop = header.file_bytes
        self._source.seek(header.data_offset)
        raw = self._source.read(8)
        position = struct.unpack("<q", raw)[0] if len(raw) == 8 else 0
        if position == -1 and stop >= header.data_offset + 16:
            # files written to a pipe have this position at their end
            stop -= 8
            self._source.seek(stop)
            position = struct.unpack("<q", self._source.exact(8, "the position of the chunk table"))[0]
        if not header.data_offset + 8 <= position <= stop - 8:
            problem = (
                f"the LAZ chunk table should begin at byte {position}, found the file's end at byte {stop}"
                if position > 0
                else "the LAZ chunk table was never written (an unfinished file)"
            )
            raise InputError(self._where, f"{problem}; expected it after the {header.n_records} records", DAMAGED)
        return position, stop

    def batches(
        self, n_max: int, selection: int, several: int | None = None, n_buffers: int = 1
    ) -> Iterator[tuple[int, memoryview]]:
        """Decode from the start."""
        if not self.header.n_records:
            return
        size = self.header.record_bytes
        largest = int(np.diff(self.table.first_record).max())
        # the parallel decoder allocates the declared chunk size, whether full or not
        declared = self.vlr.chunk_size()
        limit = _SERIAL_BYTES if n_buffers == 1 else _SHARED_BYTES
        whole = largest * size <= limit and (declared * size <= limit or self.vlr.uses_variable_size_chunks())
        kind = lazrs.ParLasZipDecompressor if whole else lazrs.LasZipDecompressor
        if several is not None and not (whole and self.header.point_format >= LAYERED_FORMATS):
            selection, several = several, None
        decoder = self.open(self._source, kind, selection)
        n_chunks = len(self.table.first_record) - 1
        # one chunk per core
        n_together = max(n_max, min(default_threads() * largest, _TOGETHER_BYTES // size))
        buffers = _Buffers(n_buffers)
        chunk = 0
        while chunk < n_chunks:
            first = int(self.table.first_record[chunk])
            end = max(int(np.searchsorted(self.table.first_record, first + n_together, side="right")) - 1, chunk + 1)
            # a second handle: the decoder needs the position of the first one unchanged
            with open_source(self.header.path) as source:
                self._check_layers(source, chunk, end)
            stop = int(self.table.first_record[end])
            # decode whole chunks even if longer than a batch: only then is damage noticed
            step = stop - first if whole else n_max
            for begin in range(first, stop, step):
                raw = buffers.next(min(step, stop - begin) * size)
                if not self._decode(decoder, raw):
                    raise self._damage(chunk, end, begin, kind)
                if several is not None and _has_several(raw, size):
                    decoder = self.open(self._source, kind, several)
                    with decoding(self._source, "the compressed records cannot be opened"):
                        decoder.seek(begin)
                    several = None
                    if not self._decode(decoder, raw):
                        raise self._damage(chunk, end, begin, kind)
                for start in range(0, len(raw), n_max * size):
                    yield begin + start // size, raw[start : start + n_max * size]
            chunk = end

    def open(self, source: Source, kind: Any, selection: int) -> Any:
        """Return a decoder of some layers, at the first record of a source."""
        source.seek(self.header.data_offset)
        with decoding(source, "the compressed records cannot be opened"):
            return kind(source, self.vlr_data, lazrs.DecompressionSelection(selection))

    def _decode(self, decoder: Any, raw: memoryview) -> bool:
        try:
            with decoding(self._source, ""):
                decoder.decompress_many(raw)
        except InputError:
            if self._source.error is not None:
                raise
            return False
        return True

    def _damage(self, chunk: int, end: int, begin: int, kind: Any) -> InputError:
        """Find the first chunk that cannot be decoded and say where it lies."""
        bounds = self.table.first_record
        if kind is lazrs.ParLasZipDecompressor:
            with contextlib.suppress(InputError), decoding(self._source, ""):
                decoder = self.open(self._source, kind, lazrs.SELECTIVE_DECOMPRESS_ALL)
                decoder.seek(begin)
                while chunk < end - 1:
                    decoder.decompress_many(
                        bytearray(int(bounds[chunk + 1] - bounds[chunk]) * self.header.record_bytes)
                    )
                    chunk += 1
            begin = int(bounds[chunk])
        problem = (
            f"records {begin} to {bounds[chunk + 1] - 1} cannot be decompressed (LAZ chunk {chunk} at byte "
            f"{self.table.first_byte[chunk]}): its {self.table.first_byte[chunk + 1] - self.table.first_byte[chunk]} "
            f"bytes do not hold the {bounds[chunk + 1] - bounds[chunk]} records expected"
        )
        return InputError(self._where, problem, DAMAGED)

    @property
    def n_layers(self) -> int:
        """Compressed layers of a chunk of point formats 6-10."""
        return chunk_head(self._items).size // 4 - 1

    def heads(self, source: Source, first: int, end: int) -> Iterator[tuple[int, int]]:
        """Yield the declared number of records and bytes of every chunk of point formats 6-10."""
        layout = chunk_head(self._items)
        for begin in self.table.first_byte[first:end].tolist():
            source.seek(begin + self.header.record_bytes)
            head = source.read(layout.size)
            held, *layers = layout.unpack(head) if len(head) == layout.size else (0,)
            yield held, self.header.record_bytes + layout.size + sum(layers)

    def _check_layers(self, source: Source, first: int, end: int) -> None:
        """Compare the sizes declared in chunks of point formats 6-10 with the chunk table."""
        if self._items[0][0] < 10:
            return
        path, table = self.header.path, self.table
        for chunk, (held, claimed) in enumerate(self.heads(source, first, end), start=first):
            begin, n_bytes = int(table.first_byte[chunk]), int(table.first_byte[chunk + 1] - table.first_byte[chunk])
            n_records = int(table.first_record[chunk + 1] - table.first_record[chunk])
            what = f"LAZ chunk {chunk} (from record {table.first_record[chunk]})"
            if held < n_records or (held > n_records and chunk < len(table.first_byte) - 2):
                where = begin + self.header.record_bytes
                raise damaged(path, where, f"{what} holds {held} records, expected {n_records}")
            if claimed > n_bytes:
                raise damaged(path, begin, f"{what} claims {claimed} bytes, expected {n_bytes}")


def _are_items_of(items: Sequence[tuple[int, int]], point_format: int) -> bool:
    """Whether the items of a record are those of its point format: others make a decoder take a gigabyte."""
    core = _ITEMS.get(point_format)
    if core is None or tuple(items[: len(core)]) != core:
        return False
    extra = 14 if point_format >= LAYERED_FORMATS else 0
    return [kind for kind, _ in items[len(core) :]] in ([], [extra])


def read_batches(
    source: Source,
    header: LasHeader,
    n_max: int,
    layers: tuple[int, int | None] = (lazrs.SELECTIVE_DECOMPRESS_ALL, None),
    n_buffers: int = 1,
) -> Iterator[tuple[int, memoryview]]:
    """Yield the index of the first record and the raw records, up to ``n_max`` at a time, compressed or not."""
    if header.compressed:
        yield from LazRecords(source, header).batches(n_max, *layers, n_buffers=n_buffers)
        return
    size = header.record_bytes
    source.seek(header.data_offset)
    buffers = _Buffers(n_buffers)
    for first in range(0, header.n_records, n_max):
        batch = buffers.next(min(n_max, header.n_records - first) * size)
        found = source.into(batch)
        if found < len(batch):
            record = first + found // size
            problem = f"the file ends at record {record}, expected {header.n_records}: it changed while read"
            raise InputError(str(header.path), problem, DAMAGED)
        yield first, batch


def read_records(source: Source, header: LasHeader, n: int) -> Generator[U8]:
    """Yield all raw records, ``n`` at a time; the caller may change an array until it asks for the next.

    Compressed records are decoded ahead in a thread; close the iterator before the source.
    """
    # uncompressed records are read faster than one thread can hand them to another
    ahead = header.compressed and header.n_records > n
    # arrays that wait for the caller are copies: a batch may be decoded while nothing is taken, and reuse their buffer
    batches = _exactly(read_batches(source, header, n, n_buffers=2 if ahead else 1), header, n, copied=ahead)
    yield from read_ahead(batches, depth=_AHEAD) if ahead else batches


def _exactly(batches: Iterator[tuple[int, memoryview]], header: LasHeader, n: int, *, copied: bool) -> Generator[U8]:
    """Join and cut batches to ``n`` records each, fewer in the last; ``copied``: into memory of their own."""
    n_left, n_held = header.n_records, 0
    for _, raw in batches:
        rows = np.frombuffer(raw, np.uint8).reshape(-1, header.record_bytes)
        while len(rows):
            wanted = min(n, n_left)
            if n_held == 0 and len(rows) >= wanted:
                yield rows[:wanted].copy() if copied else rows[:wanted]
                rows = rows[wanted:]
                n_left -= wanted
                continue
            if n_held == 0:
                held: U8 = np.empty((wanted, header.record_bytes), np.uint8)
            taken = rows[: wanted - n_held]
            held[n_held : n_held + len(taken)] = taken
            n_held += len(taken)
            rows = rows[len(taken) :]
            if n_held == wanted:
                yield held
                n_left -= wanted
                n_held = 0


def tail_bounds(source: Source, header: LasHeader) -> tuple[int, int]:
    """Return the first byte and the end of what follows the points: EVLRs, waveforms, unknown bytes.

    Behind compressed points this is the end of the chunk table, found by encoding the table again.
    """
    if not header.compressed:
        return header.data_offset + header.n_records * header.record_bytes, header.file_bytes
    if header.file_bytes < header.data_offset + 8:
        return header.data_offset, header.file_bytes
    records = LazRecords(source, header)
    table_at, stop = records.table.start, records.table.stop
    with decoding(source, f"the chunk table at byte {table_at} cannot be read"):
        source.seek(table_at)
        table = lazrs.read_chunk_table_only(source, records.vlr)
        again = io.BytesIO()
        lazrs.write_chunk_table(again, table, records.vlr)
    source.seek(table_at)
    if source.read(len(again.getvalue())) == again.getvalue():
        return table_at + len(again.getvalue()), stop
    # a table of another encoder: only the offset of the EVLRs tells where the rest begins
    return (header.evlrs[0].start if header.evlrs else stop), stop


class _Buffers:
    """Buffers used in turn: allocating each time would take as long as reading."""

    def __init__(self, n: int) -> None:
        self._turns = cycle(range(n))
        self._buffers: list[U8] = [np.empty(0, np.uint8)] * n

    def next(self, n_bytes: int) -> memoryview:
        """Return the next buffer; it is used again after all others."""
        turn = next(self._turns)
        if len(self._buffers[turn]) < n_bytes:
            self._buffers[turn] = np.empty(n_bytes, np.uint8)
        return self._buffers[turn][:n_bytes].data


def chunk_head(items: Iterable[tuple[int, int]]) -> struct.Struct:
    """Return the format of the head behind the first record of a chunk: record count, bytes per layer.

    Point format 6 with four extra bytes:

    >>> chunk_head([(10, 30), (14, 4)]).format
    '<14I'
    """
    return struct.Struct(f"<{1 + sum(_LAYERS.get(kind, n_bytes) for kind, n_bytes in items)}I")


def _has_several(raw: memoryview, record_bytes: int) -> bool:
    """Whether any shot among records of point formats 6-10 has several returns."""
    returns = np.frombuffer(raw, np.uint8)[14::record_bytes]
    return bool(returns.max(initial=0) > _ONE_RETURN)


@contextlib.contextmanager
def decoding(source: Source, problem: str) -> Iterator[None]:
    """Turn any exception or panic of the decompressor into :class:`InputError`."""
    try:
        yield
    except BaseException as error:
        if source.error is not None:  # raise the error of the system, which the library rewords
            raise source.error from error
        # pyo3's PanicException is no Exception and cannot be imported; Ctrl-C must pass
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        raise InputError(str(source.path), f"{problem} ({error})", DAMAGED) from error
