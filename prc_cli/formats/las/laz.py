"""Reads and writes raw records of LAS and LAZ files in batches (lazrs).

A LAZ file is a sequence of independently compressed chunks and a table of their sizes. The table is
compared with the file and with the count in the header before decoding, so that a wrong number
gives an error and not a huge allocation.
"""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise, repeat
from typing import Any, BinaryIO, TypeAlias

import lazrs
import numpy as np

from prc_cli.core.errors import InputError, OutputError, PrcError
from prc_cli.core.files import begin_flush
from prc_cli.core.threads import default_threads, read_ahead
from prc_cli.core.types import I64, U8
from prc_cli.formats.las.header import (
    DAMAGED,
    LASZIP_KEY,
    InputBytes,
    LasHeader,
    Span,
    Vlr,
    damaged,
    make_vlr,
)
from prc_cli.formats.writing.disk import WRITE_BYTES

LAYERED_FORMATS = 6
"""From this point format on, chunks are compressed in layers, one per field."""
LARGE_CHUNK_BYTES = 32 << 20
"""Chunks that unpack to more than this are coded piece by piece.

The parallel coders of lazrs hold whole chunks.
"""
_CHUNK_SIZE_AT = 12
"""Byte of the chunk size in the laszip VLR."""
_VARIABLE_CHUNKS = 0xFFFFFFFF
_ITEMS_AT = 32
"""Byte where the items of a record begin: their number, then type, size and version of each."""
_WAVEPACKET13 = 9  # laszip's item type
_LAYERS = {6: 9, 7: 10, 8: 11, 9: 10, 10: 12}
"""Number of compressed layers by point format; extra bytes have one per byte."""
_TOGETHER_BYTES = 16 << 20
"""Most bytes of records decoded at a time, however many the cores."""
_ONE_RETURN = 0x1F
"""Highest value of the returns byte for at most one return.

The upper half holds the number of returns.
"""
_BATCH_RECORDS = 400_000
_BATCH_BYTES = 16 << 20
_PLAIN_BYTES = 1 << 19
_FLUSH_BYTES = 16 << 20
"""Bytes after which writing to disk is started, so that little is left to wait for at the end."""


class Target:
    """An output being written, also by lazrs."""

    def __init__(self, handle: BinaryIO) -> None:
        self._handle = handle
        self._n_unflushed = 0
        self.error: BaseException | None = None
        """The last error of the system or interrupt, because lazrs hides it."""
        self.tell = handle.tell

    def write(self, data: Any) -> int:
        """Write all bytes."""
        view = memoryview(data).cast("B")
        with self._errors():
            # keep writes aligned to pages: others make the system handle a page twice and take 1.5
            # times as long
            head = (
                WRITE_BYTES - self._handle.tell() % WRITE_BYTES
                if len(view) > WRITE_BYTES
                else len(view)
            )
            for first, last in pairwise((0, *range(head, len(view), WRITE_BYTES), len(view))):
                self._handle.write(view[first:last])
            self._n_unflushed += len(view)
            if self._n_unflushed >= _FLUSH_BYTES:
                stop = self._handle.tell()
                # after a seek back to a header, most of the bytes counted lie elsewhere
                begin_flush(self._handle, max(0, stop - self._n_unflushed), stop)
                self._n_unflushed = 0
        return len(view)

    def seek(self, position: int, whence: int = 0) -> int:
        """Go to a position; this flushes the buffer, so it may fail on a full disk."""
        with self._errors():
            return self._handle.seek(position, whence)

    def flush(self) -> None:
        """Flush the buffer."""
        with self._errors():
            self._handle.flush()

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except BaseException as error:
            self.error = error
            raise


@contextlib.contextmanager
def _coding(
    stream: InputBytes | Target, refusal: Callable[[BaseException], PrcError]
) -> Iterator[None]:
    """Raise the error of the system that lazrs hides; else an error of ours for one of lazrs."""
    try:
        yield
    except BaseException as error:
        if stream.error is not None:
            raise stream.error from error
        # pyo3's PanicException is no Exception and cannot be imported; Ctrl-C must pass
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        raise refusal(error) from error


def decoding(source: InputBytes, problem: str) -> contextlib.AbstractContextManager[None]:
    """Turn any exception or panic of the decompressor into :class:`InputError`."""
    return _coding(
        source, lambda error: InputError(str(source.path), f"{problem} ({error})", DAMAGED)
    )


def encoding(target: Target) -> contextlib.AbstractContextManager[None]:
    """Turn any exception or panic of the compressor into :class:`OutputError`."""
    hint = "write .las instead of .laz"
    return _coding(target, lambda error: OutputError("LAZ compression", f"failed ({error})", hint))


def new_laszip(where: str, point_format: int, n_extra_bytes: int) -> bytes:
    """Return the content of the laszip VLR of a new file, with chunks of 50 000 records."""
    try:
        content = bytearray(
            lazrs.LazVlr.new_for_compression(point_format, n_extra_bytes).record_data()
        )
    except lazrs.LazrsError as error:
        what = f"point format {point_format} with {n_extra_bytes} extra bytes"
        problem = f"{what} cannot be compressed ({error})"
        raise OutputError(where, problem, "write .las instead of .laz") from error
    for item_start in range(_ITEMS_AT + 2, len(content) - 5, 6):
        # lazrs writes 2 as the version of waveform packets in formats 4 and 5; LASzip accepts only
        # 1, and the bytes are the same
        if struct.unpack_from("<H", content, item_start)[0] == _WAVEPACKET13:
            struct.pack_into("<H", content, item_start + 4, 1)
    return bytes(content)


def laszip_vlr(
    header: LasHeader,
    point_format: int,
    n_extra_bytes: int,
    *,
    keep: bool,
) -> Vlr:
    """Return the laszip VLR of an output; the old one if records stay the same (``keep``)."""
    old = header.vlr(LASZIP_KEY)
    new = new_laszip(str(header.path), point_format, n_extra_bytes)
    if old is None or old.data is None:
        return make_vlr(LASZIP_KEY, new, "laszip (lazrs)")
    if not header.compressed or has_variable_chunks(old.data):
        return old.with_data(new)
    # lazrs 0.8.2 reads other versions of laszip's items, but does not write all of them correctly
    # (version 1 of RGB)
    if keep and old.data[_ITEMS_AT:] == new[_ITEMS_AT:]:
        return old
    # other records, same chunk size
    return old.with_data(with_chunk_size(new, _chunk_size(old.data)))


def with_chunk_size(laszip: bytes, n: int) -> bytes:
    """Return the content of a laszip VLR with another number of records in a chunk."""
    return laszip[:_CHUNK_SIZE_AT] + struct.pack("<I", n) + laszip[_CHUNK_SIZE_AT + 4 :]


def _chunk_size(laszip: bytes) -> int:
    return int(struct.unpack_from("<I", laszip, _CHUNK_SIZE_AT)[0])


def has_variable_chunks(laszip: bytes) -> bool:
    """Whether compressed chunks differ in length (for example COPC)."""
    return _chunk_size(laszip) == _VARIABLE_CHUNKS


def _items(laszip: bytes) -> list[tuple[int, int]]:
    """Return type and bytes of the items of a record, as far as they are in the VLR."""
    n_items = struct.unpack_from("<H", laszip, _ITEMS_AT)[0]
    return [
        struct.unpack_from("<HH", laszip, item_start)
        for item_start in range(_ITEMS_AT + 2, min(_ITEMS_AT + 2 + 6 * n_items, len(laszip) - 5), 6)
    ]


def chunk_head(point_format: int, n_extra_bytes: int) -> struct.Struct:
    """Return the format of the head of a chunk: number of records, bytes per layer.

    >>> chunk_head(6, 4).format
    '<14I'
    """
    return struct.Struct(f"<{1 + _LAYERS[point_format] + n_extra_bytes}I")


@dataclass(frozen=True, slots=True)
class ChunkTable:
    """Positions of the compressed chunks."""

    first_record: I64
    """(n + 1,) int64, index of the first record of every chunk, then the number of records."""
    first_byte: I64
    """(n + 1,) int64, position in the file of every chunk, then the end of the last."""
    n_unread: int
    """Chunks beyond the record count of the header; they are not read."""
    start: int
    """First byte of the chunk table."""
    stop: int
    """End of the bytes that may follow the chunk table."""


class LazRecords:
    """Chunks of a LAZ file."""

    def __init__(self, source: InputBytes, header: LasHeader) -> None:
        self._where = str(header.path)
        self._source = source
        self.header = header
        """Of the file."""
        laszip = header.vlr(LASZIP_KEY)
        if laszip is None or laszip.data is None:
            raise InputError(
                self._where, "the records are compressed but the laszip VLR is missing", DAMAGED
            )
        self._laszip = laszip.data
        self._check_laszip()
        with decoding(source, "the laszip VLR cannot be read"):
            self.vlr = lazrs.LazVlr(self._laszip)
        self.table = self._read_table()

    def _check_laszip(self) -> None:
        """Refuse items that do not belong to the point format: a decoder would take a gigabyte."""
        data = self._laszip
        where = f"{self._where}: laszip VLR"
        las = self.header
        n_items = struct.unpack_from("<H", data, _ITEMS_AT)[0] if len(data) >= _ITEMS_AT + 2 else 0
        least = _ITEMS_AT + 2 + 6 * max(n_items, 1)
        if n_items == 0 or len(data) < least:
            raise InputError(
                where, f"{len(data)} bytes for {n_items} items, expected at least {least}", DAMAGED
            )
        items = _items(data)
        usual = _items(new_laszip(self._where, las.point_format, las.n_extra_bytes))
        n_bytes = sum(size for _, size in items)
        if n_bytes != las.record_bytes:
            raise InputError(
                where,
                f"records of {n_bytes} bytes, expected the {las.record_bytes} of the header",
                DAMAGED,
            )
        if items != usual:
            shown = ", ".join(map(str, items))
            expected = ", ".join(map(str, usual))
            problem = f"items (type, bytes) {shown}, expected {expected}"
            raise InputError(where, f"{problem} for point format {las.point_format}", DAMAGED)
        if _chunk_size(data) == 0:
            raise InputError(where, "chunks of 0 records, expected at least 1", DAMAGED)

    def _read_table(self) -> ChunkTable:
        header = self.header
        path = self.header.path
        start = header.data_offset + 8
        position, stop = self._table_bounds()
        self._source.seek(position)
        raw = self._source.read(8)
        if len(raw) < 8:
            raise damaged(
                path, position, "the file ends, expected the LAZ chunk table: it changed while read"
            )
        n_chunks = struct.unpack("<II", raw)[1]
        # every chunk begins with one uncompressed record: limits the count before allocation
        least = 1
        most = (position - start) // header.record_bytes
        if not header.n_records:  # there may be no chunk, or an empty one
            least = 0
            most = max(most, 1)
        if not least <= n_chunks <= most:
            problem = f"chunk table of {n_chunks} chunks, expected {least} to {most}"
            raise damaged(path, position + 4, f"{problem} in {position - start} bytes")
        with decoding(self._source, f"the chunk table at byte {position} cannot be read"):
            self._source.seek(header.data_offset)
            pairs = lazrs.read_chunk_table(self._source, self.vlr)
        if not header.n_records:
            nothing: I64 = np.array([0], np.int64)
            return ChunkTable(nothing, nothing + start, 0, position, stop)
        # 32 bits in the file; the decoder returns damaged values as they are, so keep the sums
        # within int64
        table = np.array(pairs, dtype=np.uint64).reshape(-1, 2).clip(max=2**32).astype(np.int64)
        n_bytes = int(table[:, 1].sum())
        if (
            len(table) != n_chunks
            or n_bytes > position - start
            or (table[:, 1] < header.record_bytes).any()
        ):
            problem = f"chunk table of {n_bytes} bytes in {len(table)} chunks"
            raise damaged(path, position, f"{problem}, expected {position - start} bytes")
        n_until = np.cumsum(table[:, 0])
        if n_until[-1] < header.n_records:
            contents = f"the {len(table)} LAZ chunks hold at most {n_until[-1]}"
            problem = f"the header promises {header.n_records} records, {contents}"
            raise InputError(
                self._where,
                problem,
                "the header is wrong or records are lost; write the file again",
            )
        n_used = int(np.searchsorted(n_until, header.n_records)) + 1
        first_record = np.concatenate(([0], n_until[: n_used - 1], [header.n_records])).astype(
            np.int64
        )
        first_byte = start + np.concatenate(([0], np.cumsum(table[:n_used, 1]))).astype(np.int64)
        return ChunkTable(first_record, first_byte, len(table) - n_used, position, stop)

    def _table_bounds(self) -> tuple[int, int]:
        """Return the first byte of the chunk table, and the end of the bytes that may follow it."""
        header = self.header
        stop = header.file_bytes
        self._source.seek(header.data_offset)
        raw = self._source.read(8)
        position = struct.unpack("<q", raw)[0] if len(raw) == 8 else 0
        if position == -1 and stop >= header.data_offset + 16:
            # files written to a pipe have this position at their end
            stop -= 8
            self._source.seek(stop)
            position = struct.unpack(
                "<q", self._source.exact(8, "the position of the chunk table")
            )[0]
        if not header.data_offset + 8 <= position <= stop - 8:
            problem = "the LAZ chunk table was never written (an unfinished file)"
            if position > 0:
                problem = (
                    f"the LAZ chunk table should begin at byte {position}, "
                    f"found the file's end at byte {stop}"
                )
            raise InputError(
                self._where, f"{problem}; expected it after the {header.n_records} records", DAMAGED
            )
        return position, stop

    @property
    def n_chunks(self) -> int:
        """Chunks of records that the header counts."""
        return len(self.table.first_byte) - 1

    @property
    def largest(self) -> int:
        """Records for which a decoder allocates memory: the declared chunk size, full or not."""
        largest = int(np.diff(self.table.first_record).max())
        return (
            largest if self.vlr.uses_variable_size_chunks() else max(largest, self.vlr.chunk_size())
        )

    def sizes(self, first: int = 0, end: int | None = None) -> I64:
        """Return the numbers of records and of bytes of some chunks, (n, 2) int64."""
        chosen = slice(first, None if end is None else end + 1)
        return np.stack(
            [np.diff(self.table.first_record[chosen]), np.diff(self.table.first_byte[chosen])],
            axis=1,
        )

    def is_usual(self) -> bool:
        """Whether compressor, items and their versions are those that lazrs writes."""
        usual = new_laszip(self._where, self.header.point_format, self.header.n_extra_bytes)
        return self._laszip[:2] == usual[:2] and self._laszip[_ITEMS_AT:] == usual[_ITEMS_AT:]

    def batches(
        self,
        n_max: int,
        layers: int,
        layers_of_several: int | None = None,
        *,
        reuse: bool = False,
    ) -> Iterator[tuple[int, U8]]:
        """Yield the index of the first record and at most ``n_max`` raw records, (n, bytes) uint8.

        Parameters
        ----------
        n_max
            Most records of a batch.
        layers
            Layers to decode, for lazrs.
        layers_of_several
            Layers to decode from the first shot of several returns on; None = the same.
        reuse
            Whether records are only valid until the next ones, which is a tenth faster.
        """
        if not self.header.n_records:
            return
        size = self.header.record_bytes
        bounds = self.table.first_record
        in_memory = self.largest * size <= LARGE_CHUNK_BYTES
        kind = lazrs.ParLasZipDecompressor if in_memory else lazrs.LasZipDecompressor
        if layers_of_several is not None and not (
            in_memory and self.header.point_format >= LAYERED_FORMATS
        ):
            layers = layers_of_several
            layers_of_several = None
        decoder = self.open(self._source, kind, layers)
        # one chunk per core
        n_together = max(
            n_max, min(default_threads() * int(np.diff(bounds).max()), _TOGETHER_BYTES // size)
        )
        chunk = 0
        room = np.empty((0, size), np.uint8)
        while chunk < self.n_chunks:
            first = int(bounds[chunk])
            end = max(int(np.searchsorted(bounds, first + n_together, side="right")) - 1, chunk + 1)
            # the decoder goes on where it stopped
            position = self._source.tell()
            self._check_layers(chunk, end)
            self._source.seek(position)
            stop = int(bounds[end])
            # decode whole chunks even if longer than a batch: only then is damage noticed
            step = stop - first if in_memory else n_max
            for begin in range(first, stop, step):
                n = min(step, stop - begin)
                room = room if reuse and n <= len(room) else np.empty((n, size), np.uint8)
                raw: U8 = room[:n]
                self._decode(decoder, raw, chunk, end)
                if layers_of_several is not None and raw[:, 14].max(initial=0) > _ONE_RETURN:
                    decoder = self.open(self._source, kind, layers_of_several, begin)
                    layers_of_several = None
                    self._decode(decoder, raw, chunk, end)
                for start in range(0, len(raw), n_max):
                    yield begin + start, raw[start : start + n_max]
            chunk = end

    def open(
        self,
        source: InputBytes,
        kind: Any,
        layers: int,
        first: int = 0,
    ) -> Any:
        """Return a decoder of some layers, at a record of a source."""
        source.seek(self.header.data_offset)
        with decoding(source, "the compressed records cannot be opened"):
            decoder = kind(source, self._laszip, lazrs.DecompressionSelection(layers))
            if first:
                decoder.seek(first)
        return decoder

    def _decode(
        self,
        decoder: Any,
        raw: U8,
        chunk: int,
        end: int,
    ) -> None:
        """Decode records of some chunks; name the first chunk that cannot be decoded."""
        try:
            with decoding(self._source, ""):
                decoder.decompress_many(raw.reshape(-1))
            return
        except InputError:
            if self._source.error is not None:
                raise
        bounds = self.table.first_record
        first_byte = self.table.first_byte
        with contextlib.suppress(InputError), decoding(self._source, ""):
            decoder_of_all = self.open(
                self._source, type(decoder), lazrs.SELECTIVE_DECOMPRESS_ALL, int(bounds[chunk])
            )
            while chunk < end - 1:
                decoder_of_all.decompress_many(
                    bytearray(int(bounds[chunk + 1] - bounds[chunk]) * self.header.record_bytes)
                )
                chunk += 1
        problem = (
            f"records {bounds[chunk]} to {bounds[chunk + 1] - 1} cannot be decompressed: "
            f"LAZ chunk {chunk} at byte {first_byte[chunk]}, "
            f"expected {bounds[chunk + 1] - bounds[chunk]} records"
        )
        raise InputError(self._where, problem, DAMAGED)

    def heads(self, source: InputBytes, first: int, end: int) -> Iterator[tuple[int, int]]:
        """Yield the declared number of records and bytes of every chunk of point formats 6-10."""
        layout = chunk_head(self.header.point_format, self.header.n_extra_bytes)
        for begin in self.table.first_byte[first:end].tolist():
            source.seek(begin + self.header.record_bytes)
            head = source.read(layout.size)
            n_records, *layers = layout.unpack(head) if len(head) == layout.size else (0,)
            yield n_records, self.header.record_bytes + layout.size + sum(layers)

    def _check_layers(self, first: int, end: int) -> None:
        """Compare the sizes declared in chunks of point formats 6-10 with the chunk table."""
        if self.header.point_format < LAYERED_FORMATS:
            return
        path = self.header.path
        table = self.table
        chunks = zip(
            self.heads(self._source, first, end), self.sizes(first, end).tolist(), strict=True
        )
        for chunk, ((n_declared, declared_bytes), (n_records, n_bytes)) in enumerate(
            chunks, start=first
        ):
            begin = int(table.first_byte[chunk])
            what = f"LAZ chunk {chunk} (from record {table.first_record[chunk]})"
            if n_declared < n_records or (n_declared > n_records and chunk < self.n_chunks - 1):
                where = begin + self.header.record_bytes
                raise damaged(
                    path, where, f"{what} holds {n_declared} records, expected {n_records}"
                )
            if declared_bytes > n_bytes:
                raise damaged(
                    path, begin, f"{what} claims {declared_bytes} bytes, expected {n_bytes}"
                )


def read_batches(
    source: InputBytes,
    header: LasHeader,
    n_max: int,
    layers: int = lazrs.SELECTIVE_DECOMPRESS_ALL,
    layers_of_several: int | None = None,
    *,
    reuse: bool = False,
) -> Iterator[tuple[int, U8]]:
    """Yield the index of the first record and at most ``n_max`` raw records, (n, bytes) uint8.

    See :meth:`LazRecords.batches` for the layers of compressed records.
    """
    if header.compressed:
        yield from LazRecords(source, header).batches(n_max, layers, layers_of_several, reuse=reuse)
        return
    source.seek(header.data_offset)
    for first in range(0, header.n_records, n_max):
        raw: U8 = np.empty((min(n_max, header.n_records - first), header.record_bytes), np.uint8)
        n_read = source.into(raw.reshape(-1).data)
        if n_read < raw.size:
            record = first + n_read // header.record_bytes
            problem = f"the file ends at record {record}, expected {header.n_records}"
            raise InputError(str(header.path), f"{problem}: it changed while read", DAMAGED)
        yield first, raw


def read_records(source: InputBytes, header: LasHeader, n: int) -> Generator[U8]:
    """Yield raw records, ``n`` at a time, (n, bytes) uint8, decoded ahead in a thread.

    Close before the source.
    """
    batches = recut((raw for _, raw in read_batches(source, header, n)), repeat(n))
    # uncompressed records are read faster than one thread can hand them to another
    yield from (
        read_ahead(batches, depth=1) if header.compressed and header.n_records > n else batches
    )


def recut(parts: Iterable[U8], sizes: Iterable[int]) -> Generator[U8]:
    """Cut consecutive arrays into others of given lengths; the last one may be shorter.

    >>> [part.tolist() for part in recut([np.arange(3), np.arange(2), np.arange(1)], [1, 3, 4])]
    [[0], [1, 2, 0], [1, 0]]
    """
    remainder: U8 | None = None
    remaining = iter(parts)
    for size in sizes:
        pieces = [] if remainder is None else [remainder]
        n_records = sum(len(piece) for piece in pieces)
        while n_records < size and (part := next(remaining, None)) is not None:
            pieces.append(part)
            n_records += len(part)
        if not n_records:
            return
        joined = pieces[0] if len(pieces) == 1 else np.concatenate(pieces)
        yield joined[:size]
        remainder = joined[size:] if n_records > size else None


def tail_bounds(source: InputBytes, header: LasHeader) -> Span:
    """Return the part behind the points or their chunk table: EVLRs, waveforms, unknown bytes."""
    if not header.compressed:
        return Span(header.data_offset + header.n_records * header.record_bytes, header.file_bytes)
    if header.file_bytes < header.data_offset + 8:
        return Span(header.data_offset, header.file_bytes)
    records = LazRecords(source, header)
    table_at = records.table.start
    stop = records.table.stop
    with decoding(source, f"the chunk table at byte {table_at} cannot be read"):
        source.seek(table_at)
        table = lazrs.read_chunk_table_only(source, records.vlr)
        encoded = io.BytesIO()
        lazrs.write_chunk_table(encoded, table, records.vlr)
    source.seek(table_at)
    if source.read(len(encoded.getvalue())) == encoded.getvalue():
        return Span(table_at + len(encoded.getvalue()), stop)
    # a table of another encoder: only the offset of the EVLRs shows its end
    return Span(header.evlrs[0].start if header.evlrs else stop, stop)


class LasSink:
    """Uncompressed records."""

    def __init__(self, target: Target) -> None:
        self._target = target

    def write(self, records: U8) -> None:
        """Append (n, bytes) uint8 records."""
        self._target.write(np.ascontiguousarray(records).reshape(-1).data)

    def close(self) -> None:
        """Do nothing: no records are buffered."""


class LazSink:
    """Records compressed by laszip; batches and threads do not change the bytes."""

    def __init__(self, target: Target, laszip: bytes) -> None:
        self._target = target
        with encoding(target):
            vlr = lazrs.LazVlr(laszip)
            is_large = vlr.chunk_size() * vlr.item_size() > LARGE_CHUNK_BYTES
            self._compressor = (lazrs.LasZipCompressor if is_large else lazrs.ParLasZipCompressor)(
                target, vlr
            )

    def write(self, records: U8) -> None:
        """Append (n, bytes) uint8 records."""
        with encoding(self._target):
            self._compressor.compress_many(np.ascontiguousarray(records).reshape(-1))

    def close(self) -> None:
        """Write the last chunk and the chunk table; the target is then positioned behind them."""
        with encoding(self._target):
            self._compressor.done()
        self._target.flush()
        self._target.seek(0, 2)


PointSink: TypeAlias = LasSink | LazSink


def batch_size(record_bytes: int, *, compressed: bool) -> int:
    """Return the records per batch: chunks for every core, or a buffer in the processor's cache."""
    return max(
        1, min(_BATCH_RECORDS, (_BATCH_BYTES if compressed else _PLAIN_BYTES) // record_bytes)
    )


def batch_records(header: LasHeader, *, compressed: bool) -> int:
    """Return the number of input records per batch; whole chunks if compressed."""
    n = batch_size(header.record_bytes, compressed=compressed)
    laszip = header.vlr(LASZIP_KEY) if header.compressed else None
    chunk = n + 1 if laszip is None or laszip.data is None else _chunk_size(laszip.data)
    return n // chunk * chunk if chunk <= n else n


def check_laz() -> str:
    """Compress and decompress records with every coder of laszip; return their point formats."""
    for point_format, n_bytes in ((1, 28), (6, 30), (10, 67)):
        where = f"LAZ round trip of point format {point_format}"
        laszip = new_laszip(where, point_format, 0)
        memory = io.BytesIO()
        # a chunk is one whole record, then differences: here all zero except in the first bytes, as
        # in a scan
        records = np.zeros((2_000, n_bytes), np.uint8)
        records[:, :4] = np.random.default_rng(1).integers(0, 256, (2_000, 4), np.uint8)
        sink = LazSink(Target(memory), laszip)
        sink.write(records)
        sink.close()
        memory.seek(0)
        back: U8 = np.empty_like(records)
        lazrs.LasZipDecompressor(memory, laszip).decompress_many(back.reshape(-1))
        if not np.array_equal(back, records):
            raise OutputError(where, "the records that came back differ", "install lazrs again")
    return "1, 6, 10"
