"""Replaces the classes in LAZ chunks of point formats 6-8 without recompressing other layers.

A layered chunk of LASzip holds its first record uncompressed, the number of records, the size of every layer and the
layers, each with its own arithmetic coder (Isenburg 2013; the ASPRS LAZ specification 1.4, sections on POINT14). The
layer of classes depends only on the classes, the return numbers and the scanner channels, so records that are zero
elsewhere give the same layer. lazrs compresses such records; their layer replaces the old one, all other bytes are
copied. So that no damage is copied with them, every layer is decoded once before, by the reader or here.
"""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Generator, Iterator

import lazrs
import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.facts import ClassContexts
from prc_cli.core.types import U8
from prc_cli.formats.las.contexts import contexts_of, records_of
from prc_cli.formats.las.header import DAMAGED, LasHeader, Source, open_source, standard_bytes
from prc_cli.formats.las.laz import CHUNK_SIZE_AT, ITEMS_AT, LazRecords, chunk_head, decoding
from prc_cli.formats.las.sinks import (
    Target,
    batch_records,
    codec_errors,
    has_variable_chunks,
    large_chunks,
    new_laszip_payload,
)

_POINT_FORMATS = (6, 7, 8)
_CLASS_LAYER = 2
"""Index of the layer of classes: behind x and y with returns and channel, and z."""
CLASS_AT = 16


def find_chunks(source: Source, las: LasHeader) -> LazRecords | None:
    """Return the chunks of a file if their classes can be replaced, else None.

    None where the file is not LAZ of point format 6-8, chunks differ in length or are large, the laszip VLR is unusual,
    or chunk table, heads of chunks and header contradict each other.
    """
    if not las.compressed or las.point_format not in _POINT_FORMATS or not las.n_records:
        return None
    records = LazRecords(source, las)
    found, usual = records.vlr_data, new_laszip_payload(las.path, las.point_format, las.n_extra_bytes)
    # the compressor (layered chunks) and the items with their versions
    if has_variable_chunks(found) or found[:2] != usual[:2] or found[ITEMS_AT:] != usual[ITEMS_AT:]:
        return None
    n_chunks, n = len(records.table.first_byte) - 1, records.vlr.chunk_size()
    if large_chunks(records.vlr) or records.table.n_unread or n_chunks != -(-las.n_records // n):
        return None
    sizes = zip(np.diff(records.table.first_record), np.diff(records.table.first_byte), strict=True)
    return records if list(records.heads(source, 0, n_chunks)) == list(sizes) else None


def splice_classes(
    source: Source, target: Target, chunks: LazRecords, codes: Iterator[U8], kept: ClassContexts | None = None
) -> None:
    """Write all chunks with new classes, and their table; the target is then positioned behind it."""
    n, n_chunk = splice_records(chunks), chunks.vlr.chunk_size()
    with chunk_table(target, chunks.vlr) as table, contextlib.closing(_contexts(chunks, n, kept)) as contexts:
        for batch, (context, new) in enumerate(zip(contexts, codes, strict=True)):
            records = records_of(context, standard_bytes(6))
            records[:, CLASS_AT] = new
            first = batch * (n // n_chunk)
            for chunk, layer in enumerate(class_layers(target, n_chunk, records), start=first):
                code = int(new[(chunk - first) * n_chunk])
                table.append((n_chunk, write_chunk(source, target, chunks, chunk, layer, code)))


@contextlib.contextmanager
def chunk_table(target: Target, vlr: lazrs.LazVlr) -> Iterator[list[tuple[int, int]]]:
    """Leave room for the position of the chunk table, and write the table behind the chunks.

    Gives the table to fill: records and bytes of every chunk. The target is then positioned behind it.
    """
    start = target.tell()
    target.write(struct.pack("<q", 0))
    table: list[tuple[int, int]] = []
    yield table
    table_at = target.tell()
    with codec_errors(target):
        lazrs.write_chunk_table(target, table, vlr)
    end = target.tell()
    target.seek(start)
    target.write(struct.pack("<q", table_at))
    target.seek(end)


def write_chunk(source: Source, target: Target, chunks: LazRecords, chunk: int, layer: memoryview, code: int) -> int:
    """Write a chunk with a new layer of classes and a new class of its first record; return its number of bytes."""
    first, stop = (int(at) for at in chunks.table.first_byte[chunk : chunk + 2])
    source.seek(first)
    old = source.exact(stop - first, f"LAZ chunk {chunk}")
    return sum(target.write(part) for part in _with_layer(chunks, old, layer, code))


def splice_records(chunks: LazRecords) -> int:
    """Return the number of records per batch of :func:`splice_classes`: some whole chunks per core."""
    n_chunk: int = chunks.vlr.chunk_size()
    return max(1, batch_records(chunks.header, compressed=True) // n_chunk) * n_chunk


def _contexts(chunks: LazRecords, n: int, kept: ClassContexts | None) -> Generator[U8]:
    """Yield the contexts of the classes of ``n`` records at a time, kept or decoded.

    Layers that nobody has decoded yet are decoded with them: a damaged one is refused here.
    """
    las = chunks.header
    is_sound = kept is not None and kept.n_checked == las.n_records
    if kept is not None and is_sound and kept.n_seen == las.n_records:
        yield from kept.take(n)
        return
    with open_source(las.path) as source:
        layers = lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL if is_sound else lazrs.SELECTIVE_DECOMPRESS_ALL
        decompressor = chunks.open(source, lazrs.ParLasZipDecompressor, layers)
        whole = np.empty((min(n, las.n_records), las.record_bytes), np.uint8)
        for first in range(0, las.n_records, n):
            records = whole[: las.n_records - first]
            with decoding(source, f"record {first} and what follows cannot be decompressed"):
                decompressor.decompress_many(records.reshape(-1))
            yield contexts_of(records)


def class_layers(target: Target, chunk_points: int, records: U8) -> Iterator[memoryview]:
    """Compress records of format 6 and yield the layer of classes of every chunk."""
    buffer = io.BytesIO()
    with codec_errors(target):
        payload = bytearray(lazrs.LazVlr.new_for_compression(6, 0).record_data())
        struct.pack_into("<I", payload, CHUNK_SIZE_AT, chunk_points)
        vlr = lazrs.LazVlr(bytes(payload))
        compressor = lazrs.ParLasZipCompressor(buffer, vlr)
        compressor.compress_many(records.reshape(-1))
        compressor.done()
        buffer.seek(0)
        table = lazrs.read_chunk_table(buffer, vlr)
    view = buffer.getbuffer()
    head = chunk_head([(10, standard_bytes(6))])
    at = 8
    for _, n_bytes in table:
        _, *sizes = head.unpack_from(view, at + standard_bytes(6))
        first = at + standard_bytes(6) + head.size + sum(sizes[:_CLASS_LAYER])
        yield view[first : first + sizes[_CLASS_LAYER]]
        at += n_bytes


def _with_layer(
    chunks: LazRecords, old: bytes, layer: memoryview, code: int
) -> tuple[bytearray, memoryview, memoryview, memoryview]:
    """Return the parts of a chunk with a new layer of classes and a new class of its first record."""
    sizes_at = chunks.header.record_bytes + 4
    head_bytes = sizes_at + 4 * chunks.n_layers
    head = bytearray(old[:head_bytes])
    sizes = struct.unpack_from(f"<{chunks.n_layers}I", head, sizes_at)
    if head_bytes + sum(sizes) != len(old):
        problem = f"found a chunk of {head_bytes + sum(sizes)} bytes, expected {len(old)} as at the start of the run"
        raise InputError(f"{chunks.header.path}: LAZ chunks", problem, DAMAGED)
    head[CLASS_AT] = code
    struct.pack_into("<I", head, sizes_at + 4 * _CLASS_LAYER, len(layer))
    first = head_bytes + sum(sizes[:_CLASS_LAYER])
    view = memoryview(old)
    return head, view[head_bytes:first], layer, view[first + sizes[_CLASS_LAYER] :]
