"""Reader of PLY files (Turk, 1994), binary of both byte orders and text."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.formats.binary import binary_body
from prc_cli.formats.clouds.source import (
    MAX_PROPERTIES,
    CloudHead,
    CloudSource,
    header_lines,
    text_body,
    whole_number,
)
from prc_cli.formats.options import Layout
from prc_cli.formats.records import Body, shorten
from prc_cli.formats.text.dialect import to_number

ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
"""Byte order by format; none for text."""
TYPES = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
    "int64": "i8",
    "uint64": "u8",
}
"""numpy types by the names of PLY; those of 64 bits are an extension."""
_AGAIN = "export it again"
_COPY = "copy it from the archive again"


@dataclass(slots=True)
class Element:
    """One element of a file."""

    name: str
    count: int
    properties: dict[str, str] = field(default_factory=dict)
    """numpy type without byte order by name."""
    list_name: str = ""
    """First property that is a list; empty = none."""

    def dtype(self, order: str) -> np.dtype[np.void]:
        """Return the record type."""
        return np.dtype([(name, order + kind) for name, kind in self.properties.items()])


@dataclass(slots=True)
class PlyHeader:
    """The header of a file."""

    form: str = ""
    """``ascii``, ``binary_little_endian`` or ``binary_big_endian``."""
    elements: list[Element] = field(default_factory=list)
    comments: list[str] = field(default_factory=list)
    n_lines: int = 0
    n_bytes: int = 0

    @property
    def vertex_at(self) -> int:
        """Index of the points among the elements, -1 if there are none."""
        return next(
            (index for index, element in enumerate(self.elements) if element.name == "vertex"), -1
        )

    @property
    def vertex(self) -> Element:
        """The points."""
        return self.elements[self.vertex_at]


def read_ply_header(path: Path) -> PlyHeader:
    """Read the header of a PLY file."""
    header = PlyHeader()
    for number, line, n_bytes in header_lines(path, "end_header", _COPY):
        where = f"{path}: line {number}"
        header.n_lines = number
        header.n_bytes = n_bytes
        word, _, rest = line.partition(" ")
        cells = rest.split()
        if number == 1:
            if line != "ply":
                raise InputError(
                    where, f"found {line[:12]!r}, expected ply", "check that this is a PLY file"
                )
        elif word in ("comment", "obj_info"):
            header.comments.append(rest)
        elif word == "format" and not header.form:
            if not cells or cells[0] not in ORDERS or cells[1:] != ["1.0"]:
                form = shorten(" ".join(cells))
                problem = f"found format {form!r}, expected {', '.join(ORDERS)} and 1.0"
                raise InputError(where, problem, _AGAIN)
            header.form = cells[0]
        elif word == "element":
            _add_element(where, cells, header.elements)
        elif word == "property" and header.elements:
            _add_property(where, cells, header.elements[-1])
        elif line not in ("", "end_header"):
            problem = f"found {shorten(line)!r}, expected format, comment, element or property"
            raise InputError(where, problem, _AGAIN)
    _check_points(path, header)
    return header


def _check_points(path: Path, header: PlyHeader) -> None:
    if not header.form:
        raise InputError(
            f"{path}: line 2",
            "no line format, expected e.g. format binary_little_endian 1.0",
            _AGAIN,
        )
    if header.vertex_at < 0:
        names = ", ".join(element.name for element in header.elements[:10]) or "none"
        raise InputError(str(path), f"no element vertex, it has {names}", "export the points")
    if header.vertex.list_name:
        problem = (
            f"property {header.vertex.list_name!r} of the points is a list, expected plain numbers"
        )
        raise InputError(str(path), problem, "export it without that property")
    if not header.vertex.properties or not header.vertex.count:
        raise InputError(
            str(path), "no points (element vertex is empty), expected scan data", _AGAIN
        )


def _add_element(where: str, cells: list[str], elements: list[Element]) -> None:
    if len(cells) != 2:
        raise InputError(
            where, f"found {shorten(' '.join(cells))!r}, expected a name and a count", _AGAIN
        )
    if any(element.name == cells[0] for element in elements):
        raise InputError(
            where, f"element {shorten(cells[0])!r} a second time, expected once", _AGAIN
        )
    elements.append(Element(cells[0], whole_number(where, cells[1])))


def _add_property(where: str, cells: list[str], element: Element) -> None:
    is_list = len(cells) == 4 and cells[0] == "list"
    kinds = cells[1:3] if is_list else cells[:1]
    unknown = [kind for kind in kinds if kind not in TYPES]
    if unknown or (len(cells) != 2 and not is_list):
        problem = (
            f"found the type {shorten(''.join(unknown[:1]))!r}, expected one of {' '.join(TYPES)}"
        )
        raise InputError(where, problem, _AGAIN)
    name = cells[-1]
    if name in element.properties:
        raise InputError(where, f"property {shorten(name)!r} a second time, expected once", _AGAIN)
    if len(element.properties) >= MAX_PROPERTIES:
        raise InputError(where, f"more than {MAX_PROPERTIES} properties of a point", _AGAIN)
    if is_list:
        element.list_name = element.list_name or name
    else:
        element.properties[name] = TYPES[cells[0]]


def offsets_of(comments: list[str]) -> tuple[float, float, float]:
    """Return the offset of the coordinates in a comment of IGN and other programs [m].

    >>> offsets_of(["offset Pos 649000.0 6840000.0 0.0"])
    (649000.0, 6840000.0, 0.0)
    """
    for comment in comments:
        cells = comment.split()
        if len(cells) == 5 and [cell.lower() for cell in cells[:2]] == ["offset", "pos"]:
            x, y, z = (to_number(cell) for cell in cells[2:])
            if (
                x is not None
                and y is not None
                and z is not None
                and all(map(math.isfinite, (x, y, z)))
            ):
                return x, y, z
    return 0.0, 0.0, 0.0


def open_ply(path: Path, layout: Layout | None = None) -> CloudSource:
    """Open the points of a PLY file."""
    header = read_ply_header(path)
    vertex = header.vertex
    order = ORDERS[header.form]
    names = tuple(vertex.properties)
    before = header.elements[: header.vertex_at]
    notes: tuple[str, ...] = ()
    keys = names
    if not order:
        first_line = header.n_lines + sum(element.count for element in before) + 1
        body: Body = text_body(path, names, first_line, vertex.count)
        keys = tuple(map(str, range(len(names))))
    else:
        if lists := [element.name for element in before if element.list_name and element.count]:
            problem = f"the points follow the lists of element {lists[0]!r}, expected them first"
            raise InputError(str(path), problem, "export the points alone")
        start = header.n_bytes + sum(
            element.count * element.dtype(order).itemsize for element in before
        )
        body = binary_body(path, vertex.dtype(order), start, vertex.count, _COPY)
        n_left = path.stat().st_size - start - vertex.count * vertex.dtype(order).itemsize
        if n_left and vertex is header.elements[-1]:
            notes = (
                (
                    f"{n_left} bytes behind the last point were left out: the header does not "
                    "name them"
                ),
            )
    head = CloudHead(
        path=path,
        format=f"PLY, {header.form.replace('_', ' ')}",
        keys=keys,
        types={name: np.dtype(kind) for name, kind in vertex.properties.items()},
        offsets_m=offsets_of(header.comments),
        comments=tuple(header.comments),
        notes=notes,
        others=tuple(
            element.name for element in header.elements if element is not vertex and element.count
        ),
        described={
            "format": header.form,
            "elements": {element.name: element.count for element in header.elements},
            "properties": dict(vertex.properties),
            "comments": list(header.comments),
        },
    )
    return CloudSource(head, body, layout)
