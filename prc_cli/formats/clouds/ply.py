"""Reader of PLY files (Turk, 1994), binary of both byte orders and text; counts are checked against the file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.files import open_to_read
from prc_cli.formats.clouds.source import BinaryBody, Body, CloudHead, CloudSource
from prc_cli.formats.options import Layout
from prc_cli.formats.text.body import TextBody
from prc_cli.formats.text.dialect import shorten, to_number

MAX_HEADER_BYTES = 1 << 20
"""Longest header."""
MAX_PROPERTIES = 10_000
"""Most properties of a point."""
MAX_COUNT = 1 << 53
"""Most records of an element."""
FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
"""Byte order by format; none for text."""
TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8", "int64": "i8", "uint64": "u8",
}  # fmt: skip
"""numpy types by the names of PLY; those of 64 bits are an extension."""
_MAGIC = b"ply"
_END = "end_header"
_AGAIN = "export it again"


@dataclass(frozen=True, slots=True)
class Element:
    """One element of a file."""

    name: str
    count: int
    properties: tuple[tuple[str, str], ...]
    """Name and numpy type without byte order."""
    list_name: str = ""
    """First property that is a list; empty = none."""

    def dtype(self, order: str) -> np.dtype[np.void]:
        """Return the record type."""
        return np.dtype([(name, order + kind) for name, kind in self.properties])


@dataclass(frozen=True, slots=True)
class PlyHeader:
    """What the header says."""

    form: str
    """``ascii``, ``binary_little_endian`` or ``binary_big_endian``."""
    elements: tuple[Element, ...]
    comments: tuple[str, ...]
    n_lines: int
    """Lines of the header."""
    n_bytes: int
    """First byte behind the header."""

    vertex_at: int
    """Index of the points among the elements."""

    @property
    def vertex(self) -> Element:
        """The points."""
        return self.elements[self.vertex_at]


def read_ply_header(path: Path) -> PlyHeader:
    """Read the header of a PLY file."""
    with open_to_read(path) as handle:
        head = handle.read(MAX_HEADER_BYTES)
    if not head.startswith(_MAGIC) or head[3:4] not in (b"\n", b"\r"):
        found = shorten(head[:12].decode("latin-1"))
        raise InputError(f"{path}: line 1", f"found {found!r}, expected ply", "check that this is a PLY file")
    lines: list[str] = []
    at = 0
    while not lines or lines[-1] != _END:
        end = head.find(b"\n", at)
        if end < 0:
            problem = f"no line {_END} in the first {len(head)} bytes"
            raise InputError(f"{path}: line {len(lines) + 1}", problem, "copy it from the archive again")
        lines.append(head[at:end].removesuffix(b"\r").decode("utf-8", errors="replace").strip())
        at = end + 1
    return _parse(path, lines, at)


def _parse(path: Path, lines: list[str], n_bytes: int) -> PlyHeader:
    form = ""
    comments: list[str] = []
    elements: list[Element] = []
    for number, line in enumerate(lines[1:-1], 2):
        where = f"{path}: line {number}"
        word, _, rest = line.partition(" ")
        cells = rest.split()
        if word in ("comment", "obj_info"):
            comments.append(rest)
        elif word == "format" and not form:
            if not cells or cells[0] not in FORMATS or cells[1:] != ["1.0"]:
                problem = f"found format {shorten(' '.join(cells))!r}, expected {', '.join(FORMATS)} and 1.0"
                raise InputError(where, problem, _AGAIN)
            form = cells[0]
        elif word == "element":
            elements.append(_element(where, cells, elements))
        elif word == "property" and elements:
            elements[-1] = _with_property(where, cells, elements[-1])
        elif line:
            problem = f"found {shorten(line)!r}, expected format, comment, element or property"
            raise InputError(where, problem, _AGAIN)
    if not form:
        raise InputError(f"{path}: line 2", "no line format, expected e.g. format binary_little_endian 1.0", _AGAIN)
    at = next((index for index, one in enumerate(elements) if one.name == "vertex"), None)
    if at is None:
        names = ", ".join(one.name for one in elements[:10]) or "none"
        raise InputError(str(path), f"no element vertex, it has {names}", "export the points")
    vertex = elements[at]
    if vertex.list_name:
        problem = f"property {vertex.list_name!r} of the points is a list, expected plain numbers"
        raise InputError(str(path), problem, "export it without that property")
    if not vertex.properties or not vertex.count:
        raise InputError(str(path), "no points (element vertex is empty), expected scan data", _AGAIN)
    return PlyHeader(form, tuple(elements), tuple(comments), len(lines), n_bytes, at)


def _element(where: str, cells: list[str], before: list[Element]) -> Element:
    count = cells[1] if len(cells) == 2 else ""
    if not (count.isascii() and count.isdecimal()) or len(count) > 16 or int(count) > MAX_COUNT:
        raise InputError(where, f"found {shorten(' '.join(cells))!r}, expected a name and a count", _AGAIN)
    if any(one.name == cells[0] for one in before):
        raise InputError(where, f"element {shorten(cells[0])!r} a second time, expected once", _AGAIN)
    return Element(cells[0], int(count), ())


def _with_property(where: str, cells: list[str], element: Element) -> Element:
    if len(cells) == 4 and cells[0] == "list":
        unknown = [kind for kind in cells[1:3] if kind not in TYPES]
        name = cells[3]
    else:
        unknown = [] if len(cells) == 2 and cells[0] in TYPES else cells[:1] or [""]
        name = cells[-1] if cells else ""
    if unknown or not name:
        problem = f"found the type {shorten(unknown[0] if unknown else '')!r}, expected one of {' '.join(TYPES)}"
        raise InputError(where, problem, _AGAIN)
    if any(name == other for other, _ in element.properties):
        raise InputError(where, f"property {shorten(name)!r} a second time, expected once", _AGAIN)
    if len(element.properties) >= MAX_PROPERTIES:
        raise InputError(where, f"more than {MAX_PROPERTIES} properties of a point", _AGAIN)
    if cells[0] == "list":
        return Element(element.name, element.count, element.properties, element.list_name or name)
    return Element(element.name, element.count, (*element.properties, (name, TYPES[cells[0]])), element.list_name)


def offsets_of(comments: tuple[str, ...]) -> tuple[float, float, float]:
    """Return the offset of the coordinates that a comment gives [m], as IGN and other programs write it.

    >>> offsets_of(("offset Pos 649000.0 6840000.0 0.0",))
    (649000.0, 6840000.0, 0.0)
    """
    for comment in comments:
        cells = comment.split()
        if len(cells) == 5 and [cell.lower() for cell in cells[:2]] == ["offset", "pos"]:
            x, y, z = (to_number(cell) for cell in cells[2:])
            if x is not None and y is not None and z is not None and all(map(math.isfinite, (x, y, z))):
                return x, y, z
    return 0.0, 0.0, 0.0


def open_ply(path: Path, layout: Layout | None = None) -> CloudSource:
    """Open the points of a PLY file."""
    header = read_ply_header(path)
    vertex = header.vertex
    names = tuple(name for name, _ in vertex.properties)
    notes: list[str] = []
    body = _text(path, header, names) if header.form == "ascii" else _binary(path, header, notes)
    types = {name: np.dtype(kind) for name, kind in vertex.properties}
    head = CloudHead(
        path, f"PLY, {header.form.replace('_', ' ')}", names, types,
        offsets_m=offsets_of(header.comments), comments=header.comments, notes=tuple(notes),
        described={
            "format": header.form,
            "elements": {one.name: one.count for one in header.elements},
            "properties": dict(vertex.properties),
            "comments": list(header.comments),
        },
    )  # fmt: skip
    return CloudSource(head, body, layout)


def _text(path: Path, header: PlyHeader, names: tuple[str, ...]) -> Body:
    before = sum(one.count for one in header.elements[: header.vertex_at])
    return TextBody(path, names, header.n_lines + before + 1, header.vertex.count)


def _binary(path: Path, header: PlyHeader, notes: list[str]) -> Body:
    order, start = FORMATS[header.form], header.n_bytes
    for one in header.elements[: header.vertex_at]:
        if one.list_name and one.count:
            problem = f"the points follow the lists of element {one.name!r}, expected them first"
            raise InputError(str(path), problem, "export the points alone")
        start += one.count * one.dtype(order).itemsize
    dtype, n = header.vertex.dtype(order), header.vertex.count
    body = BinaryBody.within(path, dtype, start, n, "copy it from the archive again")
    rest = path.stat().st_size - start - n * dtype.itemsize
    if rest and header.vertex_at == len(header.elements) - 1:
        notes.append(f"{rest} bytes behind the last point were left out: the header does not name them")
    return body
