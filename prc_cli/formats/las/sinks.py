"""Where raw records go: an output that is being written, as they are or compressed by laszip (lazrs)."""

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
from prc_cli.formats.writing.spool import WRITE_BYTES

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


def batch_size(record_bytes: int, *, compressed: bool) -> int:
    """Return how many records are handled together: bounded in number and in bytes.

    Compression takes several chunks at a time to keep every core busy; plain bytes go faster through a buffer that
    stays in the processor's cache.
    """
    return max(1, min(_BATCH_RECORDS, (_BATCH_BYTES if compressed else _PLAIN_BYTES) // record_bytes))


def batch_records(header: LasHeader, *, compressed: bool) -> int:
    """Return how many records of an input are handled together; whole chunks, if they are compressed."""
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


def laszip_vlr(header: LasHeader, point_format: int, n_extra_bytes: int, *, keep: bool) -> Vlr:
    """Return the laszip VLR of an output: the input's own where records and items stay as they are (``keep``).

    Raises
    ------
    OutputError
        When the compression library cannot write the format.
    """
    old = header.vlr(LASZIP_KEY)
    payload = new_laszip_payload(header.path, point_format, n_extra_bytes)
    if old is None or old.data is None:
        return make_vlr(LASZIP_KEY, payload, "laszip (lazrs)")
    if not header.compressed or has_variable_chunks(old.data):
        return old.with_data(payload)
    # other versions of laszip's items are read, but not written faithfully (lazrs 0.8.2: version 1 of RGB)
    if keep and old.data[ITEMS_AT:] == payload[ITEMS_AT:]:
        return old
    # other records, but chunks as they were
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
