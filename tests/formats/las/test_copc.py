"""COPC: classes change, the octree index stays valid."""

from __future__ import annotations

import io
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any

import laspy
import lazrs
import numpy as np
import pytest
from laspy.vlrs.vlrlist import VLRList

from prc_cli.core.classes import ClassCodes
from prc_cli.formats.las.header import open_bytes, read_header
from tests.formats.common import random_labels, record_blocks, write


def nodes(path: Path) -> dict[tuple[int, int, int, int], int]:
    """Points of every node, by laspy's own reader, pages included."""
    with laspy.CopcReader.open(str(path)) as reader:
        nodes_by_key: dict[tuple[int, int, int, int], int] = {}
        reader.query(laspy.copc.Bounds(mins=np.zeros(3), maxs=np.full(3, 16.0)))
        for key, entry in reader.root_page.entries.items():
            if entry.point_count >= 0:
                nodes_by_key[key.level, key.x, key.y, key.z] = entry.point_count
    return nodes_by_key


@pytest.mark.parametrize("point_format", [6, 7, 8])
@pytest.mark.parametrize("two_pages", [False, True])
def test_the_index_stays_valid(tmp_path: Path, point_format: int, two_pages: bool) -> None:
    source = tmp_path / "in.copc.laz"
    output = tmp_path / "out.copc.laz"
    labels = random_labels(len(make_copc(source, point_format, two_pages=two_pages)))
    record = write(output, source, record_blocks(labels))
    assert not any("COPC" in text for text in record.notices)
    assert nodes(output) == nodes(source)
    old = laspy.read(str(source))
    new = laspy.read(str(output))
    np.testing.assert_array_equal(new.classification, ClassCodes().lookup()[labels])
    for name in set(old.point_format.dimension_names) - {"classification"}:
        np.testing.assert_array_equal(old[name], new[name])
    assert [vlr.record_id for vlr in new.evlrs] == [1000, 5]
    # every level, and a part of the box, by the index alone
    for level, low in ((None, 0.0), (0, 0.0), (1, 8.0)):
        box = laspy.copc.Bounds(mins=np.full(3, low), maxs=np.full(3, low + 8.0))
        with laspy.CopcReader.open(str(output)) as reader:
            part = reader.query(box, level=level)
        record_of = np.searchsorted(np.sort(new.gps_time), part.gps_time)
        record_of = np.argsort(new.gps_time)[record_of]
        assert len(part) > 0
        for name in new.point_format.dimension_names:
            np.testing.assert_array_equal(part[name], new[name][record_of])


def test_an_index_that_lies_is_left_out(tmp_path: Path) -> None:
    source = tmp_path / "in.copc.laz"
    output = tmp_path / "out.laz"
    n = len(make_copc(source))
    data = bytearray(source.read_bytes())
    with open_bytes(source) as opened:
        las = read_header(opened)
    position = next(evlr.start for evlr in las.evlrs if evlr.record_id == 1000) + 60
    good = bytes(data)
    for place, value in (
        (position + 16, struct.pack("<Q", 7)),
        (position + 24, struct.pack("<i", 5)),
        (position + 28, struct.pack("<i", 1)),
        (375 + 54 + 40, struct.pack("<Q", 3)),
        (375 + 54 + 48, struct.pack("<Q", 33)),
        (position + 8 * 32 + 16, struct.pack("<Q", position)),
    ):
        data[:] = good
        data[place : place + len(value)] = value
        source.write_bytes(data)
        record = write(output, source, record_blocks(random_labels(n)))
        assert any("the COPC index does not fit" in text for text in record.notices)
        assert len(laspy.read(str(output))) == n
        output.unlink()
        output.with_name("out.laz.prc.json").unlink()


ENTRY = struct.Struct("<4iQii")


def make_copc(
    path: Path,
    point_format: int = 6,
    *,
    n: int = 900,
    two_pages: bool = True,
) -> Any:
    """Write an octree of two levels; returns the points in file order."""
    rng = np.random.default_rng(2)
    header = laspy.LasHeader(version="1.4", point_format=point_format)
    header.scales = np.full(3, 0.001)
    header.offsets = np.zeros(3)
    las = laspy.LasData(header)
    las.xyz = rng.uniform(0, 16, (n, 3))
    las.gps_time = np.sort(rng.uniform(0, 9, n))
    las.number_of_returns = rng.integers(1, 4, n)
    las.return_number = np.minimum(rng.integers(1, 4, n), las.number_of_returns)
    las.classification = rng.integers(0, 20, n)
    las.intensity = rng.integers(0, 60_000, n)
    cell = (las.x >= 8).astype(int) + 2 * (las.y >= 8) + 4 * (las.z >= 8) + 1
    cell[rng.random(n) < 0.1] = 0
    order = np.argsort(cell, kind="stable")
    points = las.points.array[order]
    cell = cell[order]
    sizes = np.bincount(cell, minlength=9)
    vlr = lazrs.LazVlr.new_for_compression(point_format, 0, True)
    header.vlrs.append(laspy.VLR("copc", 1, "copc info", bytes(160)))
    header.vlrs.append(laspy.VLR("laszip encoded", 22204, "laszip", bytes(vlr.record_data())))
    header.are_points_compressed = True
    header.point_count = n
    header.number_of_points_by_return = np.bincount(las.return_number, minlength=16)[1:16]
    header.mins = las.xyz.min(axis=0)
    header.maxs = las.xyz.max(axis=0)
    out = io.BytesIO()
    header.write_to(out)
    start = out.tell()
    compressor = lazrs.LasZipCompressor(out, vlr)
    bounds = np.concatenate([[0], np.cumsum(sizes)])
    for first, stop in pairwise(bounds.tolist()):
        if first:
            compressor.finish_current_chunk()
        compressor.compress_many(np.frombuffer(points[first:stop].tobytes(), np.uint8))
    compressor.done()
    path.write_bytes(_with_index(out, vlr, start, sizes, two_pages=two_pages))
    return points


def _with_index(
    out: io.BytesIO,
    vlr: Any,
    start: int,
    sizes: Any,
    *,
    two_pages: bool,
) -> bytearray:
    """Add the hierarchy behind the points, and let the header point to it."""
    info = [8.0, 8.0, 8.0, 8.0, 1.0]
    end = out.tell()
    out.seek(start)
    table = lazrs.read_chunk_table(out, vlr)
    places = start + 8 + np.concatenate([[0], np.cumsum([size for _, size in table])])
    keys = [(0, 0, 0, 0), *((1, k & 1, k >> 1 & 1, k >> 2) for k in range(8))]
    entries = [
        ENTRY.pack(*key, int(places[k]), table[k][1], int(sizes[k]))
        for k, key in enumerate(keys)
        if sizes[k]
    ]
    base = end + 60
    # the last node in a page of its own, in the same record
    link = ENTRY.pack(*keys[8], base + 9 * ENTRY.size, ENTRY.size, -1)
    pages = b"".join([*entries[:8], link, entries[8]] if two_pages else entries)
    root = 9 * ENTRY.size
    evlr = io.BytesIO()
    VLRList(
        [laspy.VLR("copc", 1000, "hierarchy", pages), laspy.VLR("other", 5, "more", b"abc")]
    ).write_to(evlr, True)
    out.seek(end)
    out.write(evlr.getvalue())
    data = bytearray(out.getvalue())
    struct.pack_into("<5dQQ", data, 375 + 54, *info, base, root)
    struct.pack_into("<QI", data, 235, end, 2)
    return data
