"""COPC files made by code, without using the package."""

from __future__ import annotations

import io
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any

import laspy
import lazrs
import numpy as np
from laspy.vlrs.vlrlist import VLRList

ENTRY = struct.Struct("<4iQii")


def make_copc(path: Path, point_format: int = 6, *, n: int = 900, two_pages: bool = True, seed: int = 2) -> Any:
    """Write an octree of two levels; returns the points in file order."""
    rng = np.random.default_rng(seed)
    header = laspy.LasHeader(version="1.4", point_format=point_format)
    header.scales, header.offsets = np.full(3, 0.001), np.zeros(3)
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
    points, cell = las.points.array[order], cell[order]
    sizes = np.bincount(cell, minlength=9)
    vlr = lazrs.LazVlr.new_for_compression(point_format, 0, True)
    header.vlrs.append(laspy.VLR("copc", 1, "copc info", bytes(160)))
    header.vlrs.append(laspy.VLR("laszip encoded", 22204, "laszip", bytes(vlr.record_data())))
    header.are_points_compressed = True
    header.point_count = n
    header.number_of_points_by_return = np.bincount(las.return_number, minlength=16)[1:16]
    header.mins, header.maxs = las.xyz.min(axis=0), las.xyz.max(axis=0)
    out = io.BytesIO()
    header.write_to(out)
    start = out.tell()
    compressor = lazrs.LasZipCompressor(out, vlr)
    at = np.concatenate([[0], np.cumsum(sizes)])
    for first, stop in pairwise(at.tolist()):
        if first:
            compressor.finish_current_chunk()
        compressor.compress_many(np.frombuffer(points[first:stop].tobytes(), np.uint8))
    compressor.done()
    path.write_bytes(_with_index(out, vlr, start, sizes, two_pages=two_pages))
    return points


def _with_index(out: io.BytesIO, vlr: Any, start: int, sizes: Any, *, two_pages: bool) -> bytearray:
    """Add the hierarchy behind the points, and let the header point to it."""
    info = [8.0, 8.0, 8.0, 8.0, 1.0]
    end = out.tell()
    out.seek(start)
    table = lazrs.read_chunk_table(out, vlr)
    places = start + 8 + np.concatenate([[0], np.cumsum([size for _, size in table])])
    keys = [(0, 0, 0, 0), *((1, k & 1, k >> 1 & 1, k >> 2) for k in range(8))]
    entries = [ENTRY.pack(*key, int(places[k]), table[k][1], int(sizes[k])) for k, key in enumerate(keys) if sizes[k]]
    base = end + 60
    # the last node in a page of its own, in the same record
    link = ENTRY.pack(*keys[8], base + 9 * ENTRY.size, ENTRY.size, -1)
    pages = b"".join([*entries[:8], link, entries[8]] if two_pages else entries)
    root = 9 * ENTRY.size
    evlr = io.BytesIO()
    VLRList([laspy.VLR("copc", 1000, "hierarchy", pages), laspy.VLR("other", 5, "more", b"abc")]).write_to(evlr, True)
    out.seek(end)
    out.write(evlr.getvalue())
    data = bytearray(out.getvalue())
    struct.pack_into("<5dQQ", data, 375 + 54, *info, base, root)
    struct.pack_into("<QI", data, 235, end, 2)
    return data
