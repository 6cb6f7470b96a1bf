"""Reader of PCD files: text, binary and compressed (LZF); every count is checked against the size of the file."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.facts import KnownRule
from prc_cli.core.files import open_to_read
from prc_cli.formats.clouds.source import (
    CHUNK_BYTES,
    CHUNK_RECORDS,
    OWN_COMMENT,
    BinaryBody,
    Body,
    CloudHead,
    CloudSource,
    Columns,
)
from prc_cli.formats.options import Layout
from prc_cli.formats.text.body import TextBody
from prc_cli.formats.text.dialect import shorten, to_number

MAX_RATIO = 264 / 3
"""Most bytes that a byte of LZF can stand for: the longest match is 264 bytes in three."""
_SHORT = 32
"""Control bytes below this are followed by so many bytes, plus one, as they are."""


def decode_lzf(data: memoryview, n_bytes: int) -> bytearray | None:
    """Unpack data of a known size.

    Three bytes as they are, then six that repeat them:

    >>> decode_lzf(memoryview(bytes([2, 97, 98, 99, 0b100_00000, 2])), 9)
    bytearray(b'abcabcabc')
    """
    out = bytearray()
    at, end = 0, len(data)
    while at < end:
        control = data[at]
        at += 1
        if control < _SHORT:
            stop = at + control + 1
            if stop > end:
                return None
            out += data[at:stop]
            at = stop
        else:
            length = control >> 5
            if length == 7:
                if at >= end:
                    return None
                length += data[at]
                at += 1
            if at >= end:
                return None
            first = len(out) - ((control & 31) << 8) - data[at] - 1
            at += 1
            length += 2
            if first < 0:
                return None
            piece = out[first : first + length]
            # a match that reaches into itself repeats
            out += piece if len(piece) == length else (piece * (length // len(piece) + 1))[:length]
        if len(out) > n_bytes:
            return None
    return out if len(out) == n_bytes else None


MAX_HEADER_BYTES = 1 << 20
"""Longest header."""
MAX_FIELDS = 10_000
"""Most numbers of a point."""
MAX_UNPACKED_BYTES = 4 << 30
"""Largest compressed cloud when unpacked: it is held in memory."""
MAX_PER_LINE = 10_000_000
"""Longest line, as for ``input.points_per_line``."""
_KEYS = ("VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA")
_KINDS = {"I": "i", "U": "u", "F": "f"}
_SIZES = {"I": (1, 2, 4, 8), "U": (1, 2, 4, 8), "F": (4, 8)}
_AGAIN = "export it again"


@dataclass(frozen=True, slots=True)
class PcdHeader:
    """What the header says."""

    names: tuple[str, ...]
    """A name for every number of a point; empty names are padding."""
    types: tuple[np.dtype[Any], ...]
    width: int
    height: int
    viewpoint_m: tuple[float, ...]
    """Position of the sensor and its direction as a quaternion."""
    data: str
    n_lines: int
    n_bytes: int
    comments: tuple[str, ...] = ()

    @property
    def n_points(self) -> int:
        """Number of points."""
        return self.width * self.height

    @property
    def dtype(self) -> np.dtype[np.void]:
        """Record type, little-endian."""
        size = [each.itemsize for each in self.types]
        at = [sum(size[:index]) for index in range(len(size))]
        kept = [index for index, name in enumerate(self.names) if name]
        return np.dtype(
            {
                "names": [self.names[index] for index in kept],
                "formats": [self.types[index] for index in kept],
                "offsets": [at[index] for index in kept],
                "itemsize": sum(size),
            }
        )


def open_pcd(path: Path, layout: Layout | None = None) -> CloudSource:
    """Open a PCD file.

    An organised cloud (height above 1) has a line in every row, and NaN where a shot has no return.
    """
    header = read_pcd_header(path)
    body: Body
    if header.data == "ascii":
        # padding has no name of its own
        columns = tuple(name or f"_{index}" for index, name in enumerate(header.names))
        body = TextBody(path, columns, header.n_lines + 1, header.n_points)
    elif header.data == "binary":
        hint = "correct width and height, or copy it from the archive again"
        body = BinaryBody.within(path, header.dtype, header.n_bytes, header.n_points, hint)
    else:
        body = _compressed(path, header)
    kept = tuple(name for name in header.names if name)
    types = {} if header.data == "ascii" else {name: header.dtype[name] for name in kept}
    organised = header.height > 1
    head = CloudHead(
        path, f"PCD, {header.data.replace('_', ' ')}", kept, types,
        rules=_rules(header, kept), points_per_line=header.width if organised else None,
        comments=tuple(text for text in header.comments if text.startswith(OWN_COMMENT)),
        described={
            "width": header.width, "height": header.height, "points": header.n_points, "data": header.data,
            "viewpoint": list(header.viewpoint_m), "fields": list(kept),
        },
    )  # fmt: skip
    return CloudSource(head, body, layout)


def _rules(header: PcdHeader, names: tuple[str, ...]) -> tuple[KnownRule, ...]:
    rules = []
    lowered = {name.lower() for name in names}
    x, y, z = header.viewpoint_m[:3]
    if "range" not in lowered and {"x", "y", "z"} <= lowered:
        is_origin = (x, y, z) == (0.0, 0.0, 0.0)
        value = "sensor-xyz" if is_origin else f"origin:{x!r},{y!r},{z!r}"
        rules.append(KnownRule("range", value, "the viewpoint of the header is the place of the sensor"))
    if header.height > 1 and "ring" not in lowered:
        why = f"the cloud is organised: {header.height} rows of {header.width} points"
        rules.append(KnownRule("lines", "fixed", why))
    return tuple(rules)


def read_pcd_header(path: Path) -> PcdHeader:
    """Read the header of a PCD file."""
    with open_to_read(path) as handle:
        head = handle.read(MAX_HEADER_BYTES)
    found: dict[str, tuple[int, list[str]]] = {}
    at = number = 0
    comments: list[str] = []
    while "DATA" not in found:
        end = head.find(b"\n", at)
        if end < 0:
            problem = f"no line DATA in the first {len(head)} bytes"
            raise InputError(f"{path}: line {number + 1}", problem, "check that this is a PCD file")
        line = head[at:end].decode("utf-8", errors="replace").strip()
        at, number = end + 1, number + 1
        if line.startswith("#"):
            comments.append(line.removeprefix("#").strip())
        if not line or line.startswith("#"):
            continue
        cells = line.split()
        key = "FIELDS" if cells[0] == "COLUMNS" else cells[0]
        if key not in _KEYS or key in found:
            problem = f"found {shorten(line)!r}, expected each of {' '.join(_KEYS)} once"
            raise InputError(f"{path}: line {number}", problem, "check that this is a PCD file")
        found[key] = (number, cells[1:])
    return replace(_parse(path, found, number, at), comments=tuple(comments))


def _parse(path: Path, found: dict[str, tuple[int, list[str]]], n_lines: int, n_bytes: int) -> PcdHeader:
    lacking = [key for key in ("FIELDS", "SIZE", "TYPE", "WIDTH", "DATA") if key not in found]
    if lacking:
        raise InputError(str(path), f"the header has no line {lacking[0]}", _AGAIN)
    fields = found["FIELDS"][1]
    counts = [1] * len(fields)
    if "COUNT" in found:
        counts = [_whole(path, found["COUNT"][0], cell, MAX_FIELDS) for cell in found["COUNT"][1]]
    sizes = [_whole(path, found["SIZE"][0], cell, 8) for cell in found["SIZE"][1]]
    kinds = found["TYPE"][1]
    if not len(fields) == len(counts) == len(sizes) == len(kinds) or not fields:
        problem = (
            f"{len(fields)} FIELDS, {len(sizes)} SIZE, {len(kinds)} TYPE and {len(counts)} COUNT, expected as many"
        )
        raise InputError(str(path), problem, _AGAIN)
    if sum(counts) > MAX_FIELDS:
        raise InputError(f"{path}: line {found['COUNT'][0]}", f"more than {MAX_FIELDS} numbers a point", _AGAIN)
    names: list[str] = []
    types: list[np.dtype[Any]] = []
    for field, count, size, kind in zip(fields, counts, sizes, kinds, strict=True):
        if kind not in _KINDS or size not in _SIZES[kind]:
            problem = f"field {shorten(field)!r} is of type {shorten(kind)} and {size} bytes, expected I, U or F"
            raise InputError(f"{path}: line {found['TYPE'][0]}", problem, _AGAIN)
        own = "" if field == "_" else field
        names += [own if count == 1 or not own else f"{own}_{index}" for index in range(count)]
        types += [np.dtype(f"<{_KINDS[kind]}{size}")] * count
    named = [name for name in names if name]
    if not named or len(set(named)) != len(named):
        raise InputError(f"{path}: line {found['FIELDS'][0]}", "fields without names or of equal names", _AGAIN)
    data = " ".join(found["DATA"][1])
    if data not in ("ascii", "binary", "binary_compressed"):
        problem = f"found DATA {shorten(data)!r}, expected ascii, binary or binary_compressed"
        raise InputError(f"{path}: line {found['DATA'][0]}", problem, _AGAIN)
    width, height = _size(path, found)
    return PcdHeader(tuple(names), tuple(types), width, height, _viewpoint(path, found), data, n_lines, n_bytes)


def _size(path: Path, found: dict[str, tuple[int, list[str]]]) -> tuple[int, int]:
    """Return width and height; they must agree with the number of points."""

    def number(key: str, usual: int) -> int:
        line, cells = found.get(key, (0, [str(usual)]))
        return _whole(path, line, cells[0] if len(cells) == 1 else " ".join(cells), 1 << 53)

    width = number("WIDTH", 0)
    height = number("HEIGHT", 1)
    points = number("POINTS", width * height)
    if width * height != points:
        problem = f"WIDTH {width} x HEIGHT {height} = {width * height} points, but POINTS {points}"
        raise InputError(f"{path}: line {found['WIDTH'][0]}", problem, "correct the header or export it again")
    if not points:
        raise InputError(str(path), "no points, expected scan data", _AGAIN)
    if height > 1 and width > MAX_PER_LINE:
        raise InputError(str(path), f"rows of {width} points, expected at most {MAX_PER_LINE}", _AGAIN)
    return width, height


def _viewpoint(path: Path, found: dict[str, tuple[int, list[str]]]) -> tuple[float, ...]:
    line, cells = found.get("VIEWPOINT", (0, ["0", "0", "0", "1", "0", "0", "0"]))
    values = [to_number(cell) for cell in cells]
    kept = tuple(value for value in values if value is not None and math.isfinite(value))
    if len(values) != 7 or len(kept) != 7:
        raise InputError(f"{path}: line {line}", "VIEWPOINT needs seven numbers, x y z and a quaternion", _AGAIN)
    return kept


def _whole(path: Path, line: int, cell: str, most: int) -> int:
    if not (cell.isascii() and cell.isdecimal()) or len(cell) > 16 or int(cell) > most:
        raise InputError(f"{path}: line {line}", f"found {shorten(cell)!r}, expected a whole number", _AGAIN)
    return int(cell)


def _compressed(path: Path, header: PcdHeader) -> Body:
    """Unpack a compressed cloud, which holds its fields one after the other."""
    wanted = header.n_points * header.dtype.itemsize
    with open_to_read(path) as handle:
        there = handle.seek(0, 2) - header.n_bytes
        handle.seek(header.n_bytes)
        sizes = handle.read(8)
        n_packed, n_unpacked = struct.unpack("<II", sizes) if len(sizes) == 8 else (0, 0)
        if n_unpacked != wanted:
            problem = f"unpacks to {n_unpacked} bytes, the header says {header.n_points} points = {wanted} bytes"
            raise InputError(f"{path}: byte {header.n_bytes}", problem, "correct width and height, or export it again")
        if n_packed > there - 8 or wanted > n_packed * MAX_RATIO or wanted > MAX_UNPACKED_BYTES:
            problem = f"{n_packed} packed bytes of {max(there - 8, 0)} in the file, for {wanted} bytes of points"
            raise InputError(f"{path}: byte {header.n_bytes}", problem, "copy it from the archive again")
        packed = handle.read(n_packed)
    unpacked = decode_lzf(memoryview(packed), wanted)
    if unpacked is None:
        problem = f"the compressed points do not unpack to {wanted} bytes"
        raise InputError(f"{path}: byte {header.n_bytes + 8}", problem, "copy it from the archive again")
    columns: Columns = {}
    at = 0
    for name, kind in zip(header.names, header.types, strict=True):
        if name:
            columns[name] = np.frombuffer(unpacked, kind, header.n_points, at)
        at += header.n_points * kind.itemsize
    return _Held(columns, header.n_points)


@dataclass(frozen=True, slots=True)
class _Held:
    """Columns in memory."""

    columns: Columns
    n_records: int

    def chunks(self, names: tuple[str, ...]) -> Iterator[tuple[int, Columns, int]]:
        """Yield index of the first record, stored values by property, and number of records."""
        each = min(CHUNK_RECORDS, CHUNK_BYTES // 8)
        for first in range(0, self.n_records, each):
            stop = min(first + each, self.n_records)
            yield first, {name: self.columns[name][first:stop] for name in names}, stop - first
