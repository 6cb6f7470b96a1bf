"""Classes put into LAZ chunks of point formats 6-8 without compressing anything else again.

A chunk of LASzip's layered kind holds its first record as it is, the number of records, the size of every layer and
the layers, each an arithmetic code of its own (Isenburg 2013; the ASPRS LAZ specification 1.4, sections on POINT14).
The code of the classes depends on the classes, the return numbers and the scanner channels and on nothing else, so
records that are zero elsewhere give the same layer. lazrs compresses such records; their layer replaces the old one,
all other bytes are copied.
"""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Generator, Iterator
from dataclasses import dataclass

import lazrs
import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.types import U8
from prc_cli.formats.las.contexts import LazContexts, contexts_of, records_of
from prc_cli.formats.las.header import DAMAGED, LASZIP_KEY, LasHeader, Source, open_source, standard_bytes
from prc_cli.formats.las.laz import CHUNK_SIZE_AT, ITEMS_AT, LazRecords, decoding
from prc_cli.formats.las.sinks import (
    Target,
    batch_records,
    codec_errors,
    has_variable_chunks,
    large_chunks,
    new_laszip_payload,
)

_LAYERS = {6: 9, 7: 10, 8: 11}
"""Layers of a chunk by point format; every extra byte has one more."""
_CLASS_LAYER = 2
"""The classes' place among them: after coordinates with returns and channel, and z."""
_CLASS_AT = 16


@dataclass(frozen=True, slots=True)
class Chunks:
    """The chunks of a file, all of them of the layered kind and sound as far as their heads tell."""

    chunk_points: int
    """Records in every chunk but the last."""
    n_layers: int
    first_byte: tuple[int, ...]
    """Position of every chunk, then the end of the last."""


def find_chunks(source: Source, las: LasHeader) -> Chunks | None:
    """Return the chunks of a file if classes can be put into them, else None.

    They cannot where the file is not LAZ of point format 6-8, chunks differ in length or are large, the laszip VLR
    is not the usual one, or chunk table and heads of chunks do not fit each other and the header.
    """
    if not las.compressed or las.point_format not in _LAYERS or not las.n_records:
        return None
    payload = _laszip(las)
    usual = new_laszip_payload(las.path, las.point_format, las.n_extra_bytes)
    # the compressor (layered chunks) and the items with their versions
    if has_variable_chunks(payload) or payload[:2] != usual[:2] or payload[ITEMS_AT:] != usual[ITEMS_AT:]:
        return None
    records = LazRecords(source, las)
    chunk_points, first_byte = records.vlr.chunk_size(), records.table.first_byte
    if large_chunks(records.vlr) or records.table.n_unread or len(first_byte) - 1 != -(-las.n_records // chunk_points):
        return None
    n_layers = _LAYERS[las.point_format] + las.n_extra_bytes
    chunks = Chunks(chunk_points, n_layers, tuple(first_byte.tolist()))
    return chunks if _heads_fit(source, las, chunks) else None


def _laszip(las: LasHeader) -> bytes:
    """Return the content of the laszip VLR."""
    laszip = las.vlr(LASZIP_KEY)
    assert laszip is not None
    return laszip.data or b""


def _heads_fit(source: Source, las: LasHeader, chunks: Chunks) -> bool:
    """Whether the records and the sizes of layers that every chunk declares are those it has."""
    head = struct.Struct(f"<{1 + chunks.n_layers}I")
    left = las.n_records
    for first, stop in zip(chunks.first_byte[:-1], chunks.first_byte[1:], strict=True):
        source.seek(first + las.record_bytes)
        data = source.read(head.size)
        if len(data) < head.size:
            return False
        held, *layers = head.unpack(data)
        if held != min(chunks.chunk_points, left):
            return False
        if las.record_bytes + head.size + sum(layers) != stop - first:
            return False
        left -= held
    return True


def splice_classes(
    source: Source, target: Target, las: LasHeader, chunks: Chunks, codes: Iterator[U8], kept: LazContexts | None = None
) -> None:
    """Write all chunks with other classes, and their table; the target stands behind it then.

    Parameters
    ----------
    source : Source
        Input.
    target : Target
        Stands where the points of the output begin.
    las : LasHeader
        Of the input.
    chunks : Chunks
        From :func:`find_chunks`.
    codes : iterator of (n,) uint8
        Class codes of consecutive records, :func:`splice_records` at a time.
    kept : LazContexts, optional
        From reading the input before; whatever it does not hold whole is decoded again.

    Raises
    ------
    InputError
        When the input is damaged.
    OutputError
        When the compression library fails.
    """
    payload = _laszip(las)
    start = target.tell()
    target.write(struct.pack("<q", 0))
    n = splice_records(las, chunks)
    table: list[tuple[int, int]] = []
    with contextlib.closing(_contexts(las, payload, n, kept)) as contexts:
        for batch, (context, new) in enumerate(zip(contexts, codes, strict=True)):
            records = records_of(context, standard_bytes(6))
            records[:, _CLASS_AT] = new
            first = batch * (n // chunks.chunk_points)
            for chunk, layer in enumerate(_class_layers(target, chunks.chunk_points, records), start=first):
                code = int(new[(chunk - first) * chunks.chunk_points])
                span = chunks.first_byte[chunk : chunk + 2]
                source.seek(span[0])
                old = source.exact(span[1] - span[0], f"LAZ chunk {chunk}")
                written = sum(target.write(part) for part in _with_layer(las, chunks, old, layer, code))
                table.append((chunks.chunk_points, written))
    table_at = target.tell()
    with codec_errors(target):
        lazrs.write_chunk_table(target, table, lazrs.LazVlr(payload))
    end = target.tell()
    target.seek(start)
    target.write(struct.pack("<q", table_at))
    target.seek(end)


def splice_records(las: LasHeader, chunks: Chunks) -> int:
    """Return how many records :func:`splice_classes` takes at a time: whole chunks, for every core some."""
    n = batch_records(las, compressed=True)
    return max(1, n // chunks.chunk_points) * chunks.chunk_points


def _contexts(las: LasHeader, payload: bytes, n: int, kept: LazContexts | None) -> Generator[U8]:
    """Yield the contexts of the classes of ``n`` records at a time, kept or decoded."""
    if kept is not None and kept.n_seen == las.n_records:
        yield from kept.take(n)
        return
    with open_source(las.path) as source:
        source.seek(las.data_offset)
        with decoding(source, "the compressed records cannot be opened"):
            selection = lazrs.DecompressionSelection(lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL)
            decompressor = lazrs.ParLasZipDecompressor(source, payload, selection)
        whole = np.empty((min(n, las.n_records), las.record_bytes), np.uint8)
        for first in range(0, las.n_records, n):
            records = whole[: las.n_records - first]
            with decoding(source, f"record {first} and what follows cannot be decompressed"):
                decompressor.decompress_many(records.reshape(-1))
            yield contexts_of(records)


def _class_layers(target: Target, chunk_points: int, records: U8) -> Iterator[memoryview]:
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
    head = struct.Struct(f"<{_LAYERS[6]}I")
    at = 8
    for _, n_bytes in table:
        sizes_at = at + standard_bytes(6) + 4
        sizes = head.unpack_from(view, sizes_at)
        first = sizes_at + head.size + sum(sizes[:_CLASS_LAYER])
        yield view[first : first + sizes[_CLASS_LAYER]]
        at += n_bytes


def _with_layer(
    las: LasHeader, chunks: Chunks, old: bytes, layer: memoryview, code: int
) -> tuple[bytearray, memoryview, memoryview, memoryview]:
    """Return the parts of a chunk with another layer of classes and another class of its first record."""
    head_bytes = las.record_bytes + 4 + 4 * chunks.n_layers
    head = bytearray(old[:head_bytes])
    sizes_at = las.record_bytes + 4
    sizes = struct.unpack_from(f"<{chunks.n_layers}I", head, sizes_at)
    if head_bytes + sum(sizes) != len(old):
        problem = f"found a chunk of {head_bytes + sum(sizes)} bytes, expected {len(old)} as at the start of the run"
        raise InputError(f"{las.path}: LAZ chunks", problem, DAMAGED)
    head[_CLASS_AT] = code
    struct.pack_into("<I", head, sizes_at + 4 * _CLASS_LAYER, len(layer))
    first = head_bytes + sum(sizes[:_CLASS_LAYER])
    view = memoryview(old)
    return head, view[head_bytes:first], layer, view[first + sizes[_CLASS_LAYER] :]
