"""Points of LAS and LAZ files as raw records, read and written in batches; laszip through lazrs."""

from __future__ import annotations

import contextlib
import io
import struct
import zlib
from collections.abc import Generator, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import lazrs
import numpy as np

from prc_cli.core.errors import OutputError
from prc_cli.core.files import begin_flush
from prc_cli.core.threads import read_ahead
from prc_cli.core.types import U8
from prc_cli.formats.las.chunks import RUN_BYTES, chunk_head, find_run
from prc_cli.formats.las.file import (
    LasFile,
    Source,
    damaged,
    open_source,
)
from prc_cli.formats.writing.spool import WRITE_BYTES

LASZIP_KEY = ("laszip encoded", 22204)
CHUNK_POINTS = 50_000
"""Records in a compressed chunk, laszip's own default."""
_VARIABLE_CHUNKS = 0xFFFFFFFF
CHUNK_SIZE_AT = 12
"""Byte of the chunk size in the laszip VLR."""
ITEMS_AT = 32
"""Byte where the items of a record begin: number, then type, size and version of each."""
_WAVEPACKET13 = 9  # laszip's item type
_LAYERED_FORMATS = 6
"""From this point format on every field of a chunk is a layer of its own."""
_BATCH_RECORDS = 400_000
_BATCH_BYTES = 16 << 20
_PLAIN_BYTES = 1 << 19
_AHEAD = 1
_LARGE_CHUNK_BYTES = 32 << 20
_COPY_BYTES = 4 << 20
_FLUSH_BYTES = 16 << 20
"""Bytes after which the disk is set to work, so that little is left to be waited for at the end."""


class Target:
    """An output being written; keeps the system's own error, or an interrupt: lazrs would reword them."""

    def __init__(self, handle: BinaryIO) -> None:
        self._handle = handle
        self._n_unflushed = 0
        self.error: BaseException | None = None

    def write(self, data: Any) -> int:
        """Write all bytes."""
        view = memoryview(data).cast("B")
        try:
            # what begins inside a page makes the system work on it twice, and takes half as long again
            head = WRITE_BYTES - self._handle.tell() % WRITE_BYTES if len(view) > WRITE_BYTES else len(view)
            for first, last in pairwise((0, *range(head, len(view), WRITE_BYTES), len(view))):
                self._handle.write(view[first:last])
            self._n_unflushed += len(view)
            if self._n_unflushed >= _FLUSH_BYTES:
                stop = self._handle.tell()
                # after going back to a header, most of what was counted lies elsewhere
                begin_flush(self._handle, max(0, stop - self._n_unflushed), stop)
                self._n_unflushed = 0
            return len(view)
        except BaseException as error:
            self.error = error
            raise

    def seek(self, position: int, whence: int = 0) -> int:
        """Go to a position."""
        try:
            return self._handle.seek(position, whence)
        except BaseException as error:  # a seek flushes the buffer, hence may find the disk full
            self.error = error
            raise

    def tell(self) -> int:
        """Return the position."""
        return self._handle.tell()

    def flush(self) -> None:
        """Hand the buffer to the system."""
        try:
            self._handle.flush()
        except BaseException as error:
            self.error = error
            raise


class PointSink(Protocol):
    """Where raw records go."""

    def write(self, records: U8) -> None:
        """Append (n, record length) uint8 records."""

    def close(self) -> None:
        """Write what is still held back; the target stands behind the points then."""


class LasSink:
    """Records as they are."""

    def __init__(self, target: Target) -> None:
        self._target = target

    def write(self, records: U8) -> None:
        """Append records."""
        self._target.write(np.ascontiguousarray(records).reshape(-1).data)

    def close(self) -> None:
        """Nothing is held back."""


class LazSink:
    """Records compressed by laszip; the same bytes whatever the batches and the number of threads."""

    def __init__(self, target: Target, laszip: bytes) -> None:
        self._target = target
        with codec_errors(target):
            vlr = lazrs.LazVlr(laszip)
            kind = lazrs.LasZipCompressor if large_chunks(vlr) else lazrs.ParLasZipCompressor
            self._compressor = kind(target, vlr)

    def write(self, records: U8) -> None:
        """Append records."""
        with codec_errors(self._target):
            self._compressor.compress_many(np.ascontiguousarray(records).reshape(-1))

    def close(self) -> None:
        """Write the last chunk and the chunk table."""
        with codec_errors(self._target):
            self._compressor.done()
        self._target.flush()
        self._target.seek(0, 2)


def batch_records(record_length: int, *, compressed: bool) -> int:
    """Return how many records are handled together: bounded in number and in bytes.

    Compression takes several chunks at a time to keep every core busy; plain bytes go faster through a buffer that
    stays in the processor's cache.
    """
    return max(1, min(_BATCH_RECORDS, (_BATCH_BYTES if compressed else _PLAIN_BYTES) // record_length))


def read_points(source: Source, las: LasFile, n: int) -> Generator[U8]:
    """Read all raw records in batches of up to ``n``; each may be changed by the caller, until the next is asked for.

    Batches are decompressed ahead in a thread of their own; close the iterator before the source.

    Raises
    ------
    InputError
        When the points are cut off or cannot be decompressed.
    """
    if las.n_points == 0:
        return
    batches = _read_batches(source, las, n)
    # what is not compressed is read in less time than two threads take to hand it over
    yield from read_ahead(batches, depth=_AHEAD) if las.compressed and las.n_points > n else batches


def _read_batches(source: Source, las: LasFile, n: int) -> Generator[U8]:
    source.seek(las.point_offset)
    decompressor = _decompressor(source, las) if las.compressed else None
    # where a thread reads ahead, one is in use, others wait, one is being filled; new memory every time would cost as
    # much as reading
    n_buffers = _AHEAD + 2 if las.compressed else 1
    ring = [np.empty((min(n, las.n_points), las.record_length), np.uint8) for _ in range(n_buffers)]
    for first in range(0, las.n_points, n):
        records = ring[first // n % len(ring)][: las.n_points - first]
        if decompressor is None:
            source.into(records.reshape(-1).data, f"point record {first} and what follows")
        else:
            with decoding(source, first):
                decompressor.decompress_many(records.reshape(-1))
        yield records


def tail_bounds(source: Source, las: LasFile) -> tuple[int, int]:
    """Return where what follows the points begins and ends: EVLRs, waveforms, foreign bytes.

    Behind compressed points this is the end of the chunk table, found by encoding the table again.
    """
    if not las.compressed:
        return las.point_offset + las.n_points * las.record_length, las.size
    if las.size < las.point_offset + 8:
        return min(las.size, las.point_offset), las.size
    table_at, end = find_table(source, las)
    laszip = las.vlr(*LASZIP_KEY)
    assert laszip is not None
    with decoding(source, 0):
        vlr = lazrs.LazVlr(laszip.payload)
        source.seek(table_at)
        table = lazrs.read_chunk_table_only(source, vlr)
        again = io.BytesIO()
        lazrs.write_chunk_table(again, table, vlr)
    source.seek(table_at)
    if source.read(len(again.getvalue())) == again.getvalue():
        return table_at + len(again.getvalue()), end
    # another encoder's table: what follows is known only from the EVLRs' own offset
    return (las.evlrs[0].start if las.evlrs else end), end


def find_table(source: Source, las: LasFile) -> tuple[int, int]:
    """Return the first byte of the table of chunks, and the end of what follows it.

    Raises
    ------
    InputError
        When it lies elsewhere than behind the points, or says of more chunks than there can be: the library would
        make room for all of them first.
    """
    source.seek(las.point_offset)
    table_at = struct.unpack("<q", source.exact(8, "the chunk table offset"))[0]
    end = las.size
    if table_at == -1:  # written to a pipe: the offset stands at the very end, and is not needed again
        end -= 8
        source.seek(end)
        table_at = struct.unpack("<q", source.exact(8, "the chunk table offset"))[0]
    if not las.point_offset < table_at <= end - 8:
        problem = f"found the chunk table at byte {table_at}, expected it behind the points, before byte {end}"
        raise damaged(las.path, f"byte {las.point_offset}", problem)
    source.seek(table_at)
    n_chunks = struct.unpack("<II", source.exact(8, "the chunk table"))[1]
    # a chunk begins with a record as it is; a file without points may have one that is empty
    most = max(1, (table_at - las.point_offset - 8) // las.record_length)
    if n_chunks > most:
        problem = f"found a table of {n_chunks} chunks, expected at most {most} in {las.size} bytes"
        raise damaged(las.path, f"byte {table_at}", problem)
    return table_at, end


def laszip_payload(las: LasFile, point_format: int, n_extra_bytes: int, *, keep: bool) -> bytes:
    """Return the payload of an output's laszip VLR: the input's own where records and items stay as they are.

    Raises
    ------
    OutputError
        When the compression library cannot write the format.
    """
    old = las.vlr(*LASZIP_KEY)
    payload = new_laszip_payload(las.path, point_format, n_extra_bytes)
    if old is None or has_variable_chunks(old.payload):
        return payload
    # other versions of laszip's items are read, but not written faithfully (lazrs 0.8.2: version 1 of RGB)
    if keep and old.payload[ITEMS_AT:] == payload[ITEMS_AT:]:
        return old.payload
    # other records, but chunks as they were
    return payload[:CHUNK_SIZE_AT] + old.payload[CHUNK_SIZE_AT : CHUNK_SIZE_AT + 4] + payload[CHUNK_SIZE_AT + 4 :]


def new_laszip_payload(path: Path, point_format: int, n_extra_bytes: int) -> bytes:
    """Return the laszip VLR of a new file with chunks of :data:`CHUNK_POINTS` records."""
    try:
        payload = bytearray(lazrs.LazVlr.new_for_compression(point_format, n_extra_bytes).record_data())
    except lazrs.LazrsError as error:
        problem = f"point format {point_format} with {n_extra_bytes} extra bytes cannot be compressed ({error})"
        raise OutputError(str(path), problem, "write .las instead of .laz") from error
    n_items = struct.unpack_from("<H", payload, ITEMS_AT)[0]
    for at in range(ITEMS_AT + 2, ITEMS_AT + 2 + 6 * n_items, 6):
        # lazrs calls its only way of coding waveform packets of formats 4 and 5 version 2; LASzip knows the same
        # bytes as version 1 and refuses any other
        if struct.unpack_from("<H", payload, at)[0] == _WAVEPACKET13:
            struct.pack_into("<H", payload, at + 4, 1)
    return bytes(payload)


def has_variable_chunks(laszip: bytes) -> bool:
    """Whether compressed chunks differ in length (COPC, for one)."""
    return bool(struct.unpack_from("<I", laszip, CHUNK_SIZE_AT)[0] == _VARIABLE_CHUNKS)


def large_chunks(vlr: Any) -> bool:
    """Whether a compressed chunk unpacks to more than a batch: the parallel coders of lazrs hold whole chunks."""
    return bool(vlr.chunk_size() * vlr.item_size() > _LARGE_CHUNK_BYTES)


def check_compressed(path: Path, output: Path, las: LasFile, checksum: int) -> None:
    """Decompress what was written and compare its CRC-32.

    Waveform packets (formats 9 and 10) of several scanner channels do not survive laszip's third version: found
    with lazrs 0.8.2, and why this check is made.

    Raises
    ------
    OutputError
        When the records read back are not those that were written.
    """
    found = 0
    las = replace(las, size=path.stat().st_size)
    with open_source(path) as source:
        n = batch_records(las.record_length, compressed=True)
        with contextlib.closing(read_points(source, las, n)) as batches:
            for records in batches:
                found = crc(records, found)
    if found != checksum:
        problem = f"LAZ does not hold the waveform packets of these point format {las.point_format} records unchanged"
        raise OutputError(str(output), problem, "write .las instead of .laz")


def crc(records: U8, start: int = 0) -> int:
    """Continue a CRC-32 over records."""
    return zlib.crc32(np.ascontiguousarray(records).reshape(-1).data, start)


def copy_bytes(source: Source, target: Target, start: int, stop: int) -> None:
    """Copy a span of the input."""
    source.seek(start)
    while start < stop:
        piece = source.exact(min(_COPY_BYTES, stop - start), "the file")
        target.write(piece)
        start += len(piece)


def _decompressor(source: Source, las: LasFile) -> Any:
    laszip = las.vlr(*LASZIP_KEY)
    if laszip is None:
        raise damaged(las.path, "byte 104", "found compressed points without a laszip VLR, expected one")
    with decoding(source, 0):
        vlr = lazrs.LazVlr(laszip.payload)
        if vlr.item_size() != las.record_length:
            problem = f"found laszip items of {vlr.item_size()} bytes, expected {las.record_length} (record length)"
            raise damaged(las.path, "laszip VLR", problem)
        _check_chunks(source, las, vlr)
        if las.point_format >= _LAYERED_FORMATS:
            _check_layers(source, las, vlr, laszip.payload)
        serial = vlr.uses_variable_size_chunks() or large_chunks(vlr)
        kind = lazrs.LasZipDecompressor if serial else lazrs.ParLasZipDecompressor
        return kind(source, laszip.payload)


def _check_chunks(source: Source, las: LasFile, vlr: Any) -> None:
    """Refuse chunks that the library cannot be given; it stands where the points begin then."""
    start, table_at = las.point_offset + 8, find_table(source, las)[0]
    source.seek(las.point_offset)
    n_bytes = sum(n_bytes for _, n_bytes in lazrs.read_chunk_table(source, vlr))
    if n_bytes > table_at - start:
        problem = f"found chunks of {n_bytes} bytes, expected {table_at - start} before the chunk table"
        raise damaged(las.path, f"byte {table_at}", problem)
    if (byte := find_run(source, start, table_at)) is not None:
        problem = f"found {RUN_BYTES} bytes of 0xFF in a row, expected compressed records"
        raise damaged(las.path, f"byte {byte}", problem)
    source.seek(las.point_offset)


def _check_layers(source: Source, las: LasFile, vlr: Any, payload: bytes) -> None:
    """Refuse chunks whose layers claim more bytes than the chunk has: the decoder would make room for them first."""
    (n_items,) = struct.unpack_from("<H", payload, ITEMS_AT)
    items = struct.iter_unpack("<HHH", payload[ITEMS_AT + 2 : ITEMS_AT + 2 + 6 * n_items])
    head = chunk_head((kind, size) for kind, size, _ in items)
    first = las.point_offset + 8
    for chunk, (_, n_bytes) in enumerate(lazrs.read_chunk_table(source, vlr)):
        source.seek(first + las.record_length)
        layers = head.unpack(source.exact(head.size, f"LAZ chunk {chunk}"))[1:]
        claimed = las.record_length + head.size + sum(layers)
        if claimed > n_bytes:
            raise damaged(las.path, f"byte {first}", f"LAZ chunk {chunk} claims {claimed} bytes, expected {n_bytes}")
        first += n_bytes
    source.seek(las.point_offset)


@contextlib.contextmanager
def decoding(source: Source, first: int) -> Iterator[None]:
    """Turn what lazrs raises into the system's own error or one that names the records."""
    try:
        yield
    except BaseException as error:
        if source.error is not None:
            raise source.error from error
        if not _is_codec_error(error):
            raise
        raise damaged(
            source.path, f"point record {first} and what follows", f"cannot be decompressed ({error})"
        ) from error


@contextlib.contextmanager
def codec_errors(target: Target) -> Iterator[None]:
    """Turn what lazrs raises into the system's own error or one about the output."""
    try:
        yield
    except BaseException as error:
        if target.error is not None:
            raise target.error from error
        if not _is_codec_error(error):
            raise
        raise OutputError("LAZ compression", f"failed ({error})", "write .las instead of .laz") from error


def _is_codec_error(error: BaseException) -> bool:
    """Tell a refusal of lazrs, or a panic inside it (which is no Exception), from other errors."""
    return isinstance(error, lazrs.LazrsError) or type(error).__name__ == "PanicException"
