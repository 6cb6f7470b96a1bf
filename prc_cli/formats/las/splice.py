"""Replaces the classes in LAZ chunks of point formats 6-8 and copies other layers; COPC stays COPC.

A layered chunk of LASzip holds its first record uncompressed, the number of records, the size of
every layer and the layers, each with its own arithmetic coder (Isenburg 2013; the ASPRS LAZ
specification 1.4, sections on POINT14). The layer of classes depends only on the classes, the
return numbers and the scanner channels (the context), so records that are zero elsewhere give the
same layer. lazrs compresses such records; their layer replaces the old one, all other bytes are
copied. Every layer is decoded once before, by the reader or here, so that no damage is
copied.

A COPC file (COPC 1.0: hobu, 2021) is LAZ with a chunk for every node of an octree; its index
has the first byte and the length of every chunk, and only these change.
"""

from __future__ import annotations

import contextlib
import io
import struct
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import NamedTuple

import lazrs
import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.facts import ClassContexts
from prc_cli.core.types import U8
from prc_cli.formats.las.header import (
    DAMAGED,
    InputBytes,
    LasHeader,
    VlrKey,
    open_bytes,
    standard_bytes,
)
from prc_cli.formats.las.laz import (
    LARGE_CHUNK_BYTES,
    LazRecords,
    Target,
    batch_records,
    chunk_head,
    encoding,
    new_laszip,
    recut,
    with_chunk_size,
)

_POINT_FORMATS = (6, 7, 8)
_CLASS_LAYER = 2
"""Index of the layer of classes: behind x and y with returns and channel, and z."""
_RETURNS_AT = 14
_CHANNEL_AT = 15
_CLASS_AT = 16
_ONLY = 4
"""Bit of a context: single return; the two bits below are the channel."""
KEPT_BYTES = 32 << 20
"""Memory limit for contexts that differ from record to record."""
COPC_USER = "copc"
_COPC_KEY = VlrKey(COPC_USER, 1)
_HIERARCHY_KEY = VlrKey(COPC_USER, 1000)
_INFO_BYTES = 160
_ROOT_AT = 40
"""Byte of the root page's position and length in the info record."""
_INFO_OFFSET = 375 + 54
"""First byte of the content of the info record."""
_ENTRY = struct.Struct("<4iQii")
"""Level and place of a node, position, length, and number of points, -1 = another page."""


def contexts_of(records: U8) -> U8:
    """Return the contexts of raw records."""
    # return 1 of at most 1
    only = (records[:, _RETURNS_AT] & np.uint8(0xEF)) == 1
    channel = (records[:, _CHANNEL_AT] >> np.uint8(4)) & np.uint8(3)
    contexts: U8 = channel | (only.view(np.uint8) << np.uint8(2))
    return contexts


def records_of(contexts: U8) -> U8:
    """Return raw records of point format 6 with these contexts, else zeros."""
    records = np.zeros((len(contexts), standard_bytes(6)), np.uint8)
    records[:, _RETURNS_AT] = np.where(contexts & _ONLY, 0x11, 0x21)
    records[:, _CHANNEL_AT] = (contexts & 3) << np.uint8(4)
    return records


class LazContexts:
    """Contexts of the first records of a file, kept while it is read for its writer."""

    def __init__(self) -> None:
        self.n_seen = 0
        self.n_checked = 0
        """Records of which every layer was decoded, from the first one."""
        self._parts: list[U8] = []
        self._n_bytes = 0
        self._lock = threading.Lock()

    def see(self, first: int, contexts: U8) -> None:
        """Keep the contexts of records that follow those seen so far; others are ignored."""
        if not np.any(contexts != contexts[:1]):
            contexts = np.broadcast_to(contexts[:1].copy(), contexts.shape)  # one byte of memory
        n_bytes = len(contexts) * contexts.strides[0]
        with self._lock:
            if first == self.n_seen and self._n_bytes + n_bytes <= KEPT_BYTES:
                self._parts.append(contexts)
                self._n_bytes += n_bytes
                self.n_seen += len(contexts)

    def check(self, first: int, n: int) -> None:
        """Note that every layer of ``n`` records could be decoded, if they follow the last ones."""
        with self._lock:
            if first == self.n_checked:
                self.n_checked += n

    def take(self, n: int) -> Iterator[U8]:
        """Yield the contexts kept, ``n`` at a time, fewer at the end."""
        yield from recut(self._parts, repeat(n))


class Page(NamedTuple):
    """A page of the hierarchy of a COPC file."""

    position: int
    """First byte in the file."""
    size: int
    """Number of bytes."""


@dataclass(frozen=True, slots=True)
class Splice:
    """A file whose classes can be replaced."""

    chunks: LazRecords
    pages: tuple[Page, ...] = ()
    """COPC: pages of the hierarchy, the root first."""


def find_chunks(source: InputBytes, las: LasHeader) -> Splice | None:
    """Return the chunks of usual LAZ of point formats 6 to 8; None for other files."""
    if not las.compressed or las.point_format not in _POINT_FORMATS or not las.n_records:
        return None
    chunks = LazRecords(source, las)
    if (
        not chunks.is_usual()
        or chunks.table.n_unread
        or chunks.largest * las.record_bytes > LARGE_CHUNK_BYTES
    ):
        return None
    if list(chunks.heads(source, 0, chunks.n_chunks)) != list(map(tuple, chunks.sizes().tolist())):
        return None
    if not chunks.vlr.uses_variable_size_chunks():
        return Splice(chunks)
    pages = _find_pages(source, las)
    return Splice(chunks, pages) if pages and _index_fits(source, pages, chunks) else None


def _find_pages(source: InputBytes, las: LasHeader) -> tuple[Page, ...]:
    """Return all pages of a COPC index; none if one is outside the index, cut, or repeated."""
    info = las.vlr(_COPC_KEY)
    hierarchy = [evlr for evlr in las.evlrs if evlr.has(_HIERARCHY_KEY)]
    if (
        info is None
        or info.data is None
        or len(info.data) != _INFO_BYTES
        or las.vlrs[0] is not info
    ):
        return ()
    root = Page(*struct.unpack_from("<QQ", info.data, _ROOT_AT))
    pages = [root]
    positions = {root.position}
    n_bytes = 0
    for page in pages:
        n_bytes += page.size
        # pages that share bytes would be more than the records hold
        is_sound = (
            page.size > 0
            and page.size % _ENTRY.size == 0
            and n_bytes <= sum(evlr.n_bytes for evlr in hierarchy)
        )
        if not is_sound or not any(
            evlr.start + len(evlr.head) <= page.position and page.position + page.size <= evlr.stop
            for evlr in hierarchy
        ):
            return ()
        for *_, position, size, count in _entries(source, page):
            if count != -1:
                continue
            if position in positions:
                return ()
            positions.add(position)
            pages.append(Page(position, size))
    return tuple(pages)


def _entries(source: InputBytes, page: Page) -> Iterator[tuple[int, ...]]:
    source.seek(page.position)
    yield from _ENTRY.iter_unpack(source.exact(page.size, "the COPC hierarchy"))


def _index_fits(source: InputBytes, pages: Iterable[Page], chunks: LazRecords) -> bool:
    """Whether the nodes with points are the chunks, each once."""
    places = zip(chunks.table.first_byte.tolist(), chunks.sizes().tolist(), strict=False)
    wanted = sorted((first, length, n) for first, (n, length) in places)
    nodes = (entry[4:] for page in pages for entry in _entries(source, page))
    return sorted(node for node in nodes if node[2] > 0) == wanted


def splice_classes(
    source: InputBytes,
    target: Target,
    splice: Splice,
    codes: Iterator[U8],
    kept: ClassContexts | None = None,
) -> dict[int, tuple[int, int]]:
    """Write all chunks with new classes, and their table.

    Returns
    -------
    dict
        New position and length of every chunk, by old position.
    """
    chunks = splice.chunks
    sizes = chunks.sizes()[:, 0].tolist()
    places = chunks.table.first_byte.tolist()
    # some chunks per core where they are equal
    n = 1 if splice.pages else max(1, batch_records(chunks.header, compressed=True) // sizes[0])
    groups = [sizes[first : first + n] for first in range(0, len(sizes), n)]
    totals = [sum(group) for group in groups]
    moved: dict[int, tuple[int, int]] = {}
    with (
        _chunk_table(target, chunks.vlr) as table,
        contextlib.closing(recut(_contexts(chunks, kept), totals)) as contexts,
    ):
        for group, context, new in zip(groups, contexts, recut(codes, totals), strict=True):
            records = records_of(context)
            records[:, _CLASS_AT] = new
            layers = _class_layers(target, group[0], records)
            for n_records, layer, first in zip(
                group, layers, range(0, len(new), group[0]), strict=True
            ):
                position = target.tell()
                chunk = len(table)
                table.append(
                    (n_records, _write_chunk(source, target, chunks, chunk, layer, int(new[first])))
                )
                moved[places[chunk]] = (position, table[-1][1])
    return moved


@contextlib.contextmanager
def _chunk_table(target: Target, vlr: lazrs.LazVlr) -> Iterator[list[tuple[int, int]]]:
    """Yield a table of records and bytes to fill; write it and its position at the end."""
    start = target.tell()
    target.write(struct.pack("<q", 0))
    table: list[tuple[int, int]] = []
    yield table
    table_at = target.tell()
    with encoding(target):
        lazrs.write_chunk_table(target, table, vlr)
    end = target.tell()
    target.seek(start)
    target.write(struct.pack("<q", table_at))
    target.seek(end)


def _contexts(chunks: LazRecords, kept: ClassContexts | None) -> Iterator[U8]:
    """Yield the contexts of the classes, kept or decoded; raise an error for a damaged layer."""
    las = chunks.header
    n = batch_records(las, compressed=True)
    is_sound = kept is not None and kept.n_checked == las.n_records
    if kept is not None and is_sound and kept.n_seen == las.n_records:
        yield from kept.take(n)
        return
    layers = (
        lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL
        if is_sound
        else lazrs.SELECTIVE_DECOMPRESS_ALL
    )
    # a handle of its own: the decoder needs its position unchanged
    with open_bytes(las.path) as source:
        for _, records in LazRecords(source, las).batches(n, layers):
            yield contexts_of(records)


def _class_layers(target: Target, chunk_points: int, records: U8) -> Iterator[memoryview]:
    """Compress records of point format 6 and yield the layer of classes of every chunk."""
    buffer = io.BytesIO()
    with encoding(target):
        vlr = lazrs.LazVlr(with_chunk_size(new_laszip("classes", 6, 0), chunk_points))
        compressor = lazrs.ParLasZipCompressor(buffer, vlr)
        compressor.compress_many(records.reshape(-1))
        compressor.done()
        buffer.seek(0)
        table = lazrs.read_chunk_table(buffer, vlr)
    view = buffer.getbuffer()
    head = chunk_head(6, 0)
    chunk_start = 8
    for _, n_bytes in table:
        _, *sizes = head.unpack_from(view, chunk_start + standard_bytes(6))
        first = chunk_start + standard_bytes(6) + head.size + sum(sizes[:_CLASS_LAYER])
        yield view[first : first + sizes[_CLASS_LAYER]]
        chunk_start += n_bytes


def _write_chunk(
    source: InputBytes,
    target: Target,
    chunks: LazRecords,
    chunk: int,
    layer: memoryview,
    code: int,
) -> int:
    """Write a chunk with a new layer of classes and class of its first record; return its bytes."""
    las = chunks.header
    first, stop = chunks.table.first_byte[chunk : chunk + 2].tolist()
    source.seek(first)
    old = memoryview(source.exact(stop - first, f"LAZ chunk {chunk}"))
    head = chunk_head(las.point_format, las.n_extra_bytes)
    n_records, *sizes = head.unpack_from(old, las.record_bytes)
    layers_at = las.record_bytes + head.size
    if layers_at + sum(sizes) != len(old):
        n_bytes = layers_at + sum(sizes)
        problem = (
            f"found a chunk of {n_bytes} bytes, expected {len(old)} as at the start of the run"
        )
        raise InputError(f"{las.path}: LAZ chunks", problem, DAMAGED)
    before = layers_at + sum(sizes[:_CLASS_LAYER])
    behind = before + sizes[_CLASS_LAYER]
    sizes[_CLASS_LAYER] = len(layer)
    new = bytearray(old[:layers_at])
    new[_CLASS_AT] = code
    head.pack_into(new, las.record_bytes, n_records, *sizes)
    return sum(target.write(part) for part in (new, old[layers_at:before], layer, old[behind:]))


def move_index(
    written: Path,
    las: LasHeader,
    splice: Splice,
    moved: dict[int, tuple[int, int]],
    place: dict[int, int],
) -> None:
    """Write new positions of chunks (``moved``) and pages (``place``) into a COPC index."""
    with open_bytes(las.path) as source, written.open("r+b") as handle:
        for page in splice.pages:
            entries = []
            for *key, offset, length, count in _entries(source, page):
                if count > 0:
                    offset, length = moved[offset]
                elif count == -1:
                    offset = place[offset]
                entries.append(_ENTRY.pack(*key, offset, length, count))
            handle.seek(place[page.position])
            handle.write(b"".join(entries))
        root = splice.pages[0]
        handle.seek(_INFO_OFFSET + _ROOT_AT)
        handle.write(struct.pack("<QQ", place[root.position], root.size))
