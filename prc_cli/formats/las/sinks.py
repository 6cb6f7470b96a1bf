"""Sinks of raw records: an output file, uncompressed or compressed with laszip (lazrs)."""

from __future__ import annotations

import contextlib
import struct
import zlib
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import lazrs
import numpy as np

from prc_cli.core.errors import OutputError
from prc_cli.core.files import begin_flush
from prc_cli.core.types import U8
from prc_cli.formats.las.header import LASZIP_KEY, LasHeader, Source, Vlr, make_vlr
from prc_cli.formats.las.laz import CHUNK_SIZE_AT, ITEMS_AT
from prc_cli.formats.writing.disk import WRITE_BYTES

CHUNK_POINTS = 50_000
"""Records in a compressed chunk, laszip's own default."""
_VARIABLE_CHUNKS = 0xFFFFFFFF
_WAVEPACKET13 = 9  # laszip's item type
_BATCH_RECORDS = 400_000
_BATCH_BYTES = 16 << 20
_PLAIN_BYTES = 1 << 19
_LARGE_CHUNK_BYTES = 32 << 20
_COPY_BYTES = 4 << 20
_FLUSH_BYTES = 16 << 20
"""Bytes after which writing to disk is started, so that little is left to wait for at the end."""


class Target:
    """An output being written; keeps errors of the system and interrupts, which lazrs would reword."""

    def __init__(self, handle: BinaryIO) -> None:
        self._handle = handle
        self._n_unflushed = 0
        self.error: BaseException | None = None

    def write(self, data: Any) -> int:
        """Write all bytes."""
        view = memoryview(data).cast("B")
        try:
            # keep writes aligned to pages: others make the system handle a page twice and take 1.5 times as long
            head = WRITE_BYTES - self._handle.tell() % WRITE_BYTES if len(view) > WRITE_BYTES else len(view)
            for first, last in pairwise((0, *range(head, len(view), WRITE_BYTES), len(view))):
                self._handle.write(view[first:last])
            self._n_unflushed += len(view)
            if self._n_unflushed >= _FLUSH_BYTES:
                stop = self._handle.tell()
                # after a seek back to a header, most of the bytes counted lie elsewhere
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
        except BaseException as error:  # a seek flushes the buffer, so it may fail on a full disk
            self.error = error
            raise

    def tell(self) -> int:
        """Return the position."""
        return self._handle.tell()

    def flush(self) -> None:
        """Flush the buffer."""
        try:
            self._handle.flush()
        except BaseException as error:
            self.error = error
            raise


class PointSink(Protocol):
    """A sink of raw records."""

    def write(self, records: U8) -> None:
        """Append (n, record length) uint8 records."""

    def close(self) -> None:
        """Write buffered records; the target is then positioned behind the points."""


class LasSink:
    """Uncompressed records."""

    def __init__(self, target: Target) -> None:
        self._target = target

    def write(self, records: U8) -> None:
        """Append records."""
        self._target.write(np.ascontiguousarray(records).reshape(-1).data)

    def close(self) -> None:
        """Do nothing: no records are buffered."""


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


def batch_size(record_bytes: int, *, compressed: bool) -> int:
    """Return the number of records per batch, limited in number and bytes.

    Compression takes several chunks at a time to keep every core busy; uncompressed records are faster in a buffer that
    fits the processor's cache.
    """
    return max(1, min(_BATCH_RECORDS, (_BATCH_BYTES if compressed else _PLAIN_BYTES) // record_bytes))


def batch_records(header: LasHeader, *, compressed: bool) -> int:
    """Return the number of input records per batch; whole chunks if compressed."""
    n = batch_size(header.record_bytes, compressed=compressed)
    laszip = header.vlr(LASZIP_KEY) if header.compressed else None
    if laszip is None or has_variable_chunks(laszip.data or b""):
        return n
    chunk: int = struct.unpack_from("<I", laszip.data or b"", CHUNK_SIZE_AT)[0]
    return n // chunk * chunk if chunk <= n else n


def new_laszip_payload(path: Path, point_format: int, n_extra_bytes: int) -> bytes:
    """Return the laszip VLR of a new file with chunks of :data:`CHUNK_POINTS` records."""
    try:
        payload = bytearray(lazrs.LazVlr.new_for_compression(point_format, n_extra_bytes).record_data())
    except lazrs.LazrsError as error:
        problem = f"point format {point_format} with {n_extra_bytes} extra bytes cannot be compressed ({error})"
        raise OutputError(str(path), problem, "write .las instead of .laz") from error
    n_items = struct.unpack_from("<H", payload, ITEMS_AT)[0]
    for at in range(ITEMS_AT + 2, ITEMS_AT + 2 + 6 * n_items, 6):
        # lazrs writes 2 as the version of waveform packets in formats 4 and 5; LASzip accepts only 1, and the bytes are
        # the same
        if struct.unpack_from("<H", payload, at)[0] == _WAVEPACKET13:
            struct.pack_into("<H", payload, at + 4, 1)
    return bytes(payload)


def has_variable_chunks(laszip: bytes) -> bool:
    """Whether compressed chunks differ in length (for example COPC)."""
    return bool(struct.unpack_from("<I", laszip, CHUNK_SIZE_AT)[0] == _VARIABLE_CHUNKS)


def large_chunks(vlr: Any) -> bool:
    """Whether a compressed chunk unpacks to more than a batch; the parallel coders of lazrs hold whole chunks."""
    return bool(vlr.chunk_size() * vlr.item_size() > _LARGE_CHUNK_BYTES)


def laszip_vlr(header: LasHeader, point_format: int, n_extra_bytes: int, *, keep: bool) -> Vlr:
    """Return the laszip VLR of an output: that of the input where records and items stay the same (``keep``)."""
    old = header.vlr(LASZIP_KEY)
    payload = new_laszip_payload(header.path, point_format, n_extra_bytes)
    if old is None or old.data is None:
        return make_vlr(LASZIP_KEY, payload, "laszip (lazrs)")
    if not header.compressed or has_variable_chunks(old.data):
        return old.with_data(payload)
    # lazrs 0.8.2 reads other versions of laszip's items, but does not write all of them correctly (version 1 of RGB)
    if keep and old.data[ITEMS_AT:] == payload[ITEMS_AT:]:
        return old
    # other records, same chunk size
    chunk_size = old.data[CHUNK_SIZE_AT : CHUNK_SIZE_AT + 4]
    return old.with_data(payload[:CHUNK_SIZE_AT] + chunk_size + payload[CHUNK_SIZE_AT + 4 :])


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


@contextlib.contextmanager
def codec_errors(target: Target) -> Iterator[None]:
    """Turn exceptions of lazrs into the error of the system or one about the output."""
    try:
        yield
    except BaseException as error:
        if target.error is not None:
            raise target.error from error
        if not _is_codec_error(error):
            raise
        raise OutputError("LAZ compression", f"failed ({error})", "write .las instead of .laz") from error


def _is_codec_error(error: BaseException) -> bool:
    """Whether an error is from lazrs: a refusal, or a panic (which is not an Exception)."""
    return isinstance(error, lazrs.LazrsError) or type(error).__name__ == "PanicException"
