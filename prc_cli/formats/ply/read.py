"""Reader of PLY files, binary of both byte orders and text."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.files import open_to_read
from prc_cli.formats.clouds import BinaryBody, Body, CloudHead, CloudSource
from prc_cli.formats.options import Layout
from prc_cli.formats.ply.header import FORMATS, PlyHeader, offsets_of, read_ply_header
from prc_cli.formats.text.body import TextBody


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
        described=header.describe(),
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
    with open_to_read(path) as handle:
        size = handle.seek(0, 2)
    there = max(size - start, 0)
    if n * dtype.itemsize > there:
        problem = f"the file ends in point {there // dtype.itemsize}, the header says {n} of {dtype.itemsize} bytes"
        raise InputError(str(path), problem, "copy it from the archive again")
    rest = there - n * dtype.itemsize
    if rest and header.vertex_at == len(header.elements) - 1:
        notes.append(f"{rest} bytes behind the last point were left out: the header does not name them")
    return BinaryBody(path, dtype, start, n)
