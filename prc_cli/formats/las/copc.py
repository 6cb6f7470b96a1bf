"""New classes in COPC files, with the octree index kept (COPC 1.0: hobu, 2021).

A COPC file is LAZ with a chunk for every node of an octree; the index names the first byte and the length of every
chunk. Classes change in place of their layer (:mod:`.splice`), so chunks move and change their length, and nothing
else: the same nodes hold the same points.
"""

from __future__ import annotations

import struct
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import lazrs
import numpy as np

from prc_cli.core.errors import OutputError
from prc_cli.core.facts import ClassContexts
from prc_cli.core.types import U8
from prc_cli.formats.las.contexts import contexts_of, records_of
from prc_cli.formats.las.header import LasHeader, Source, Vlr, open_source, read_header, standard_bytes
from prc_cli.formats.las.laz import ITEMS_AT, LazRecords
from prc_cli.formats.las.sinks import Target, batch_records, has_variable_chunks, new_laszip_payload
from prc_cli.formats.las.splice import CLASS_AT, chunk_table, class_layers, write_chunk

COPC_KEY, HIERARCHY_KEY = ("copc", 1), ("copc", 1000)
_INFO_BYTES = 160
_ROOT_AT = 40
"""Byte of the root page's position and length in the info record."""
_ENTRY = struct.Struct("<4iQii")
"""Level and place of a node, position, length, and number of points, -1 = another page."""
_POINT_FORMATS = (6, 7, 8)
_LARGE_CHUNK_BYTES = 32 << 20
_INFO_OFFSET = 375 + 54
"""Where the content of the info record must lie."""


@dataclass(frozen=True, slots=True)
class Copc:
    """The index of a COPC file whose classes can be replaced."""

    chunks: LazRecords
    pages: tuple[tuple[int, int], ...]
    """Position in the file and length of every page of the hierarchy."""
    hierarchy: tuple[Vlr, ...]
    """Hold the pages: all in one, or each in its own."""


def find_copc(source: Source, las: LasHeader) -> Copc | None:
    """Return the index of a COPC file, None where it is none, or where index, chunks and header disagree."""
    info, hierarchy = las.vlr(COPC_KEY), _hierarchy(las)
    if info is None or info.data is None or len(info.data) != _INFO_BYTES or not hierarchy:
        return None
    if not las.compressed or las.point_format not in _POINT_FORMATS or not las.n_records or las.vlrs[0] is not info:
        return None
    chunks = LazRecords(source, las)
    found, usual = chunks.vlr_data, new_laszip_payload(las.path, las.point_format, las.n_extra_bytes)
    if not has_variable_chunks(found) or found[:2] != usual[:2] or found[ITEMS_AT:] != usual[ITEMS_AT:]:
        return None
    table = chunks.table
    sizes = np.diff(table.first_record)
    if table.n_unread or int(sizes.max()) * las.record_bytes > _LARGE_CHUNK_BYTES:
        return None
    heads = list(chunks.heads(source, 0, len(sizes)))
    if heads != list(zip(sizes, np.diff(table.first_byte), strict=True)):
        return None
    root = struct.unpack_from("<QQ", info.data, _ROOT_AT)
    pages = _find_pages(source, hierarchy, (int(root[0]), int(root[1])))
    if pages is None or not _names_chunks(source, pages, chunks):
        return None
    return Copc(chunks, pages, hierarchy)


def _hierarchy(las: LasHeader) -> tuple[Vlr, ...]:
    return tuple(evlr for evlr in las.evlrs if evlr.has(HIERARCHY_KEY))


def _holder(hierarchy: tuple[Vlr, ...], at: int, size: int) -> int | None:
    """Return which record holds a page; None if none does."""
    index = bisect_right(hierarchy, at, key=_start_of) - 1
    inside = index >= 0 and hierarchy[index].start + len(hierarchy[index].head) <= at
    return index if inside and at + size <= hierarchy[index].stop else None


def _start_of(record: Vlr) -> int:
    return record.start


def _find_pages(
    source: Source, hierarchy: tuple[Vlr, ...], root: tuple[int, int]
) -> tuple[tuple[int, int], ...] | None:
    """Return all pages; None if one lies outside the records, is cut, or comes twice."""
    pages: list[tuple[int, int]] = [root]
    seen = {root[0]}
    for at, size in pages:
        if size <= 0 or size % _ENTRY.size or _holder(hierarchy, at, size) is None:
            return None
        for *_, offset, length, count in _entries(source, at, size):
            if count != -1:
                continue
            if offset in seen:
                return None
            seen.add(offset)
            pages.append((offset, length))
    # pages that share bytes would be more than the records hold
    return tuple(pages) if sum(size for _, size in pages) <= sum(one.n_bytes for one in hierarchy) else None


def _entries(source: Source, at: int, size: int) -> Iterator[tuple[int, ...]]:
    source.seek(at)
    yield from _ENTRY.iter_unpack(source.exact(size, "the COPC hierarchy"))


def _names_chunks(source: Source, pages: tuple[tuple[int, int], ...], chunks: LazRecords) -> bool:
    """Whether the nodes with points are the chunks, each once."""
    table = chunks.table
    n_bytes, n_points = np.diff(table.first_byte).tolist(), np.diff(table.first_record).tolist()
    places = zip(table.first_byte[:-1].tolist(), n_bytes, n_points, strict=True)
    wanted = set(places)
    for at, size in pages:
        for *_, offset, length, count in _entries(source, at, size):
            if count > 0:
                if (offset, length, count) not in wanted:
                    return False
                wanted.remove((offset, length, count))
    return not wanted


def splice_copc(
    source: Source, target: Target, copc: Copc, codes: Iterator[U8], kept: ClassContexts | None = None
) -> dict[int, tuple[int, int]]:
    """Write all chunks with new classes, and their table; the target is then positioned behind it."""
    chunks = copc.chunks
    table = chunks.table
    first_byte, n_points = table.first_byte.tolist(), np.diff(table.first_record).tolist()
    moved: dict[int, tuple[int, int]] = {}
    contexts = _by_chunk(_contexts(chunks, kept), n_points)
    with chunk_table(target, chunks.vlr) as written:
        for chunk, (context, new) in enumerate(zip(contexts, _by_chunk(codes, n_points), strict=True)):
            records = records_of(context, standard_bytes(6))
            records[:, CLASS_AT] = new
            layer = next(class_layers(target, len(new), records))
            at = target.tell()
            length = write_chunk(source, target, chunks, chunk, layer, int(new[0]))
            moved[first_byte[chunk]] = (at, length)
            written.append((n_points[chunk], length))
    return moved


def _contexts(chunks: LazRecords, kept: ClassContexts | None) -> Iterator[U8]:
    """Yield the contexts of the classes; layers that nobody has decoded yet are decoded, too, as they are copied."""
    las = chunks.header
    is_sound = kept is not None and kept.n_checked == las.n_records
    layers = lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL if is_sound else lazrs.SELECTIVE_DECOMPRESS_ALL
    n = batch_records(las, compressed=True)
    # a handle of its own: the decoder needs its position unchanged
    with open_source(las.path) as source:
        for _, raw in LazRecords(source, las).batches(n, layers):
            yield contexts_of(np.frombuffer(raw, np.uint8).reshape(-1, las.record_bytes))


def _by_chunk(batches: Iterator[U8], sizes: list[int]) -> Iterator[U8]:
    """Cut consecutive values into chunks of given sizes."""
    held: list[U8] = []
    n_held = 0
    for size in sizes:
        while n_held < size:
            part = next(batches)
            held.append(part)
            n_held += len(part)
        whole = np.concatenate(held) if len(held) > 1 else held[0]
        yield whole[:size]
        held, n_held = [whole[size:]], n_held - size


def move_index(written: Path, source: Source, copc: Copc, moved: dict[int, tuple[int, int]]) -> None:
    """Let the index of the output point to its chunks and pages."""
    las = read_header(written)
    info, hierarchy = las.vlr(COPC_KEY), _hierarchy(las)
    if info is None or info.data is None or las.vlrs[0] is not info or len(hierarchy) != len(copc.hierarchy):
        raise OutputError(str(written), "found no COPC index in the output", "this is a fault; please report it")
    shifts = [new.start - old.start for new, old in zip(hierarchy, copc.hierarchy, strict=True)]

    def shift_of(at: int) -> int:
        return shifts[_holder(copc.hierarchy, at, _ENTRY.size) or 0]

    with written.open("r+b") as handle:
        for at, size in copc.pages:
            entries = []
            for *key, offset, length, count in _entries(source, at, size):
                if count > 0:
                    offset, length = moved[offset]
                elif count == -1:
                    offset += shift_of(offset)
                entries.append(_ENTRY.pack(*key, offset, length, count))
            handle.seek(at + shift_of(at))
            handle.write(b"".join(entries))
        root_at, root_bytes = copc.pages[0]
        handle.seek(_INFO_OFFSET + _ROOT_AT)
        handle.write(struct.pack("<QQ", root_at + shift_of(root_at), root_bytes))
