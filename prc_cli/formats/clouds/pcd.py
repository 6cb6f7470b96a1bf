"""Reader of PCD files: text, binary and compressed (LZF)."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.facts import KnownRule
from prc_cli.core.files import open_to_read
from prc_cli.formats.binary import CHUNK_RECORDS, binary_body
from prc_cli.formats.clouds.source import (
    MAX_PROPERTIES,
    OWN_COMMENT,
    CloudHead,
    CloudSource,
    Columns,
    header_lines,
    text_body,
    whole_number,
)
from prc_cli.formats.options import Layout
from prc_cli.formats.organised.scans import MAX_POINTS_PER_LINE
from prc_cli.formats.records import Body, shorten
from prc_cli.formats.text.dialect import to_number

MAX_RATIO = 264 / 3
"""Most unpacked bytes of a byte of LZF: the longest match is 264 bytes in three."""
_SHORT = 32
"""A smaller control byte n means that n + 1 plain bytes follow."""


def decode_lzf(data: memoryview, n_bytes: int) -> bytearray | None:
    """Unpack LZF data of a known size; None if they are damaged."""
    out = bytearray()
    position = 0
    end = len(data)
    while position < end:
        control = data[position]
        position += 1
        if control < _SHORT:
            stop = position + control + 1
            if stop > end:
                return None
            out += data[position:stop]
            position = stop
        else:
            length = control >> 5
            if length == 7:
                if position >= end:
                    return None
                length += data[position]
                position += 1
            if position >= end:
                return None
            first = len(out) - ((control & 31) << 8) - data[position] - 1
            position += 1
            length += 2
            if first < 0:
                return None
            piece = out[first : first + length]
            # a match that reaches into itself repeats
            out += piece if len(piece) == length else (piece * (length // len(piece) + 1))[:length]
        if len(out) > n_bytes:
            return None
    return out if len(out) == n_bytes else None


MAX_UNPACKED_BYTES = 4 << 30
"""Largest compressed cloud when unpacked: it is held in memory."""
USUAL_VIEWPOINT = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
"""Viewpoint of headers without a position of the sensor."""
_KEYS = (
    "VERSION",
    "FIELDS",
    "SIZE",
    "TYPE",
    "COUNT",
    "WIDTH",
    "HEIGHT",
    "VIEWPOINT",
    "POINTS",
    "DATA",
)
_KINDS = {"I": ("i", (1, 2, 4, 8)), "U": ("u", (1, 2, 4, 8)), "F": ("f", (4, 8))}
"""Letter and sizes of a numpy type."""
_AGAIN = "export it again"
_COPY = "copy it from the archive again"


@dataclass(slots=True)
class PcdHeader:
    """The header of a file."""

    path: Path
    lines: dict[str, tuple[int, list[str]]] = field(default_factory=dict)
    """Number of the line, and the words behind the key, by key."""
    comments: list[str] = field(default_factory=list)
    n_lines: int = 0
    n_bytes: int = 0

    def where(self, key: str) -> str:
        """Return file and line, for messages."""
        return f"{self.path}: line {self.lines[key][0]}" if key in self.lines else str(self.path)

    def words(self, key: str, usual: str = "") -> list[str]:
        """Return the words of a line."""
        return self.lines[key][1] if key in self.lines else usual.split()

    def numbers(self, key: str, most: int, usual: str = "") -> list[int]:
        """Return whole numbers of a line."""
        return [whole_number(self.where(key), cell, most) for cell in self.words(key, usual)]

    def number(self, key: str, usual: int = 1) -> int:
        """Return the one whole number of a line."""
        return whole_number(self.where(key), " ".join(self.words(key, str(usual))))


def read_pcd_header(path: Path) -> PcdHeader:
    """Read the header of a PCD file."""
    header = PcdHeader(path)
    for number, line, n_bytes in header_lines(path, "DATA", "check that this is a PCD file"):
        header.n_lines = number
        header.n_bytes = n_bytes
        if line.startswith("#"):
            header.comments.append(line.removeprefix("#").strip())
        elif line:
            key, *cells = line.split()
            key = "FIELDS" if key == "COLUMNS" else key
            if key not in _KEYS or key in header.lines:
                problem = f"found {shorten(line)!r}, expected each of {' '.join(_KEYS)} once"
                raise InputError(f"{path}: line {number}", problem, "check that this is a PCD file")
            header.lines[key] = (number, cells)
    for key in ("FIELDS", "SIZE", "TYPE", "WIDTH"):
        if key not in header.lines:
            raise InputError(str(path), f"the header has no line {key}", _AGAIN)
    return header


def _fields(header: PcdHeader) -> list[tuple[str, np.dtype[Any]]]:
    """Return name and type of every number of a point; empty names are padding."""
    fields = header.words("FIELDS")
    kinds = header.words("TYPE")
    sizes = header.numbers("SIZE", 8)
    counts = header.numbers("COUNT", MAX_PROPERTIES, "1 " * len(fields))
    if not len(fields) == len(counts) == len(sizes) == len(kinds) or not fields:
        problem = (
            f"{len(fields)} FIELDS, {len(sizes)} SIZE, {len(kinds)} TYPE and {len(counts)} COUNT"
        )
        raise InputError(str(header.path), f"{problem}, expected as many", _AGAIN)
    if sum(counts) > MAX_PROPERTIES:
        raise InputError(
            header.where("COUNT"), f"more than {MAX_PROPERTIES} numbers a point", _AGAIN
        )
    numbers: list[tuple[str, np.dtype[Any]]] = []
    for name, count, size, kind in zip(fields, counts, sizes, kinds, strict=True):
        letter, known = _KINDS.get(kind, ("", ()))
        if size not in known:
            field_type = f"type {shorten(kind)} and {size} bytes"
            problem = f"field {shorten(name)!r} is of {field_type}, expected I, U or F"
            raise InputError(header.where("TYPE"), problem, _AGAIN)
        base = "" if name == "_" else name
        names = [base if count == 1 or not base else f"{base}_{index}" for index in range(count)]
        numbers += [(number_name, np.dtype(f"<{letter}{size}")) for number_name in names]
    named = [name for name, _ in numbers if name]
    if not named or len(set(named)) != len(named):
        raise InputError(header.where("FIELDS"), "fields without names or of equal names", _AGAIN)
    return numbers


def _size(header: PcdHeader) -> tuple[int, int]:
    """Return width and height, which must agree with the number of points."""
    width = header.number("WIDTH")
    height = header.number("HEIGHT")
    points = header.number("POINTS", width * height)
    if width * height != points:
        problem = f"WIDTH {width} x HEIGHT {height} = {width * height} points, but POINTS {points}"
        raise InputError(header.where("WIDTH"), problem, "correct the header or export it again")
    if not points:
        raise InputError(str(header.path), "no points, expected scan data", _AGAIN)
    if height > 1 and width > MAX_POINTS_PER_LINE:
        raise InputError(
            str(header.path),
            f"rows of {width} points, expected at most {MAX_POINTS_PER_LINE}",
            _AGAIN,
        )
    return width, height


def _viewpoint(header: PcdHeader) -> list[float]:
    """Return the position of the sensor and its direction as a quaternion."""
    values = [to_number(cell) for cell in header.words("VIEWPOINT", "0 0 0 1 0 0 0")]
    kept = [value for value in values if value is not None and math.isfinite(value)]
    if len(values) != 7 or len(kept) != 7:
        raise InputError(
            header.where("VIEWPOINT"),
            "VIEWPOINT needs seven numbers, x y z and a quaternion",
            _AGAIN,
        )
    return kept


def open_pcd(path: Path, layout: Layout | None = None) -> CloudSource:
    """Open a PCD file; in an organised one every row is a line, and NaN is a missing shot."""
    header = read_pcd_header(path)
    fields = _fields(header)
    data = " ".join(header.words("DATA"))
    if data not in ("ascii", "binary", "binary_compressed"):
        problem = f"found DATA {shorten(data)!r}, expected ascii, binary or binary_compressed"
        raise InputError(header.where("DATA"), problem, _AGAIN)
    width, height = _size(header)
    viewpoint = _viewpoint(header)
    types = {name: np.dtype("f8") if data == "ascii" else kind for name, kind in fields if name}
    keys = tuple(types)
    if data == "ascii":
        # padding has no name of its own
        body: Body = text_body(
            path, tuple(name for name, _ in fields), header.n_lines + 1, width * height
        )
        keys = tuple(str(index) for index, (name, _) in enumerate(fields) if name)
    elif data == "binary":
        hint = "correct width and height, or copy it from the archive again"
        body = binary_body(path, _dtype(fields), header.n_bytes, width * height, hint)
    else:
        body = _compressed(header, fields, width * height)
    head = CloudHead(
        path=path,
        format=f"PCD, {data.replace('_', ' ')}",
        types=types,
        keys=keys,
        rules=_rules(viewpoint, width, height, {name.lower() for name in types}),
        points_per_line=width if height > 1 else None,
        viewpoint=tuple(viewpoint) if tuple(viewpoint) != USUAL_VIEWPOINT else (),
        vectors=tuple(
            name
            for name, count in zip(
                header.words("FIELDS"),
                header.numbers("COUNT", MAX_PROPERTIES, "1 " * len(fields)),
                strict=False,
            )
            if count > 1 and name != "_"
        ),
        comments=tuple(text for text in header.comments if text.startswith(OWN_COMMENT)),
        described={
            "width": width,
            "height": height,
            "points": width * height,
            "data": data,
            "viewpoint": viewpoint,
            "fields": list(types),
        },
    )
    return CloudSource(head, body, layout)


def _dtype(fields: list[tuple[str, np.dtype[Any]]]) -> np.dtype[np.void]:
    """Return the record of a point, padding left out."""
    ends = np.cumsum([kind.itemsize for _, kind in fields]).tolist()
    named = [
        (name, kind, end - kind.itemsize)
        for (name, kind), end in zip(fields, ends, strict=True)
        if name
    ]
    names, formats, offsets = zip(*named, strict=True)
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": ends[-1]})


def _rules(
    viewpoint: list[float],
    width: int,
    height: int,
    names: set[str],
) -> tuple[KnownRule, ...]:
    rules = []
    x, y, z = viewpoint[:3]
    if "range" not in names and {"x", "y", "z"} <= names:
        value = f"origin:{x!r},{y!r},{z!r}" if any((x, y, z)) else "sensor-xyz"
        rules.append(
            KnownRule("range", value, "the viewpoint of the header is the place of the sensor")
        )
    if height > 1 and "ring" not in names:
        rules.append(
            KnownRule("lines", "fixed", f"the cloud is organised: {height} rows of {width} points")
        )
    return tuple(rules)


def _compressed(header: PcdHeader, fields: list[tuple[str, np.dtype[Any]]], n: int) -> Body:
    """Unpack a compressed cloud, whose fields follow each other."""
    path = header.path
    start = header.n_bytes
    wanted = n * sum(kind.itemsize for _, kind in fields)
    with open_to_read(path) as handle:
        there = handle.seek(0, 2) - start
        handle.seek(start)
        sizes = handle.read(8)
        n_packed, n_unpacked = struct.unpack("<II", sizes) if len(sizes) == 8 else (0, 0)
        if n_unpacked != wanted:
            problem = f"unpacks to {n_unpacked} bytes, the header says {n} points = {wanted} bytes"
            raise InputError(
                f"{path}: byte {start}", problem, "correct width and height, or export it again"
            )
        if n_packed > there - 8 or wanted > n_packed * MAX_RATIO or wanted > MAX_UNPACKED_BYTES:
            problem = (
                f"{n_packed} packed bytes of {max(there - 8, 0)}, for {wanted} bytes of points"
            )
            raise InputError(f"{path}: byte {start}", problem, _COPY)
        unpacked = decode_lzf(memoryview(handle.read(n_packed)), wanted)
    if unpacked is None and n_packed == n_unpacked:
        problem = "the header says compressed, but the points are not compressed"
        hint = "save it again as binary, for example with Open3D or PCL"
        raise InputError(f"{path}: byte {start + 8}", problem, hint)
    if unpacked is None:
        raise InputError(
            f"{path}: byte {start + 8}",
            f"the compressed points do not unpack to {wanted} bytes",
            _COPY,
        )
    columns: Columns = {}
    offset = 0
    for name, kind in fields:
        if name:
            columns[name] = np.frombuffer(unpacked, kind, n, offset)
        offset += n * kind.itemsize
    return _Held(columns, n)


@dataclass(frozen=True, slots=True)
class _Held:
    """Columns in memory."""

    columns: Columns
    n_records: int

    def stored(self, keys: tuple[str, ...]) -> Iterator[tuple[int, Columns, int]]:
        for first in range(0, self.n_records, CHUNK_RECORDS):
            stop = min(first + CHUNK_RECORDS, self.n_records)
            yield first, {key: self.columns[key][first:stop] for key in keys}, stop - first
