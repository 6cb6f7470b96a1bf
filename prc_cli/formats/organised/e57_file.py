"""E57 scans (ASTM E2807) as arrays, checked before the library opens them."""

from __future__ import annotations

import contextlib
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any
from xml.parsers import expat

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.files import open_to_read
from prc_cli.core.process import step
from prc_cli.core.types import F64
from prc_cli.formats.organised.scans import MAX_SCANS

MAX_XML_BYTES = 64 << 20
"""Largest XML section: a scan takes some kilobytes of it."""
MAX_ELEMENTS = 2_000_000
MAX_DEPTH = 64
"""Deepest nesting of elements; the standard itself needs about ten levels."""
_HEADER = struct.Struct("<8sIIQQQQ")
_PAGE_BYTES = 1024
_PAYLOAD_BYTES = 1020
"""Bytes of a page before its checksum."""


def check_frame(path: Path) -> None:
    """Refuse a file that is not E57, is cut short, or has an unsafe XML section."""
    size = path.stat().st_size
    with open_to_read(path) as handle:
        start, length = _check_header(path, handle.read(_HEADER.size), size)
        _check_xml(path, _payload(handle, start, length))


def _check_header(path: Path, head: bytes, size: int) -> tuple[int, int]:
    """Return the first byte of the XML section in the file and its length without checksums."""
    if not head.startswith(b"ASTM-E57"):
        problem = f"begins with {head[:8]!r}, expected the signature b'ASTM-E57'"
        raise InputError(str(path), problem, "check that this is an E57 file")
    if len(head) < _HEADER.size:
        problem = f"the file ends after {size} bytes, expected a header of {_HEADER.size}"
        raise InputError(str(path), problem, "copy it from the archive again")
    _, major, minor, length, xml_start, xml_length, page = _HEADER.unpack(head)
    if major != 1 or page != _PAGE_BYTES:
        problem = f"found E57 version {major}.{minor} with pages of {page} bytes, expected 1.x with {_PAGE_BYTES}"
        raise InputError(str(path), problem, "check that this is an E57 file")
    if length != size:
        problem = f"the file has {size} bytes, its header says {length}"
        raise InputError(str(path), problem, "copy it from the archive again")
    n_payload = size // _PAGE_BYTES * _PAYLOAD_BYTES
    before = xml_start // _PAGE_BYTES * _PAYLOAD_BYTES + min(xml_start % _PAGE_BYTES, _PAYLOAD_BYTES)
    if not (_HEADER.size <= xml_start and 0 < xml_length <= n_payload - before):
        problem = f"the header puts an XML section of {xml_length} bytes at byte {xml_start} of {size}"
        raise InputError(str(path), problem, "copy it from the archive again")
    if xml_length > MAX_XML_BYTES:
        problem = f"found an XML section of {xml_length} bytes, expected at most {MAX_XML_BYTES}"
        raise InputError(str(path), problem, "split the file")
    return xml_start, xml_length


def _payload(handle: IO[bytes], start: int, length: int) -> Iterator[bytes]:
    """Yield ``length`` bytes from byte ``start`` of the file on, checksums left out."""
    handle.seek(start)
    position = start
    while length > 0:
        room = _PAYLOAD_BYTES - position % _PAGE_BYTES
        if room > 0:
            found = handle.read(min(room, length))
            if not found:
                return
            yield found
            length -= len(found)
        position += max(room, 0)
        rest = -position % _PAGE_BYTES
        handle.seek(rest, 1)
        position += rest


class _RefusedError(Exception):
    """Raised inside the parser's callbacks."""


def _check_xml(path: Path, parts: Iterator[bytes]) -> None:
    depth = n_elements = 0

    def start(_name: str, _attributes: dict[str, str]) -> None:
        nonlocal depth, n_elements
        depth, n_elements = depth + 1, n_elements + 1
        if depth > MAX_DEPTH:
            raise _RefusedError(f"elements inside one another {depth} deep, expected at most {MAX_DEPTH}")
        if n_elements > MAX_ELEMENTS:
            raise _RefusedError(f"more than {MAX_ELEMENTS} elements, expected fewer")

    def end(_name: str) -> None:
        nonlocal depth
        depth -= 1

    def declaration(*_: object) -> None:
        raise _RefusedError("a document type declaration, expected none")

    def encoding(_version: str, name: str | None, _standalone: int) -> None:
        # the standard allows only UTF-8; another encoding could hide a declaration from this check
        if name is not None and name.upper() != "UTF-8":
            raise _RefusedError(f"the encoding {name[:20]!r}, expected UTF-8")

    parser = expat.ParserCreate("UTF-8")
    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.XmlDeclHandler = encoding
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = declaration
    try:
        for part in parts:
            parser.Parse(part, False)
        parser.Parse(b"", True)
    except expat.ExpatError as error:
        problem = f"the XML section is damaged ({error})"
        raise InputError(str(path), problem, "copy it from the archive again") from error
    except _RefusedError as refused:
        raise InputError(str(path), f"the XML section has {refused}", "export the scan again") from None


CHUNK_POINTS = 1 << 17
"""Points decoded at a time."""

ROW, COLUMN, RETURN, INTENSITY = "rowIndex", "columnIndex", "returnIndex", "intensity"
CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
CARTESIAN_STATE, SPHERICAL_STATE = "cartesianInvalidState", "sphericalInvalidState"

_NOT_AS_EXPECTED = (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError)
"""Exceptions of the library for nodes of a type other than the standard's."""


@dataclass(frozen=True, slots=True)
class E57Scan:
    """Metadata of a scan from the XML section."""

    index: int
    fields: tuple[str, ...]
    """Names of the fields of a point."""
    n_points: int
    bounds: tuple[tuple[int, int], tuple[int, int]] | None
    """First and last row, first and last column in the header; None if absent."""
    intensity_limits: tuple[float, float] | None
    """Intensity limits in the header; None if absent or not a range."""
    quaternion: tuple[float, float, float, float] | None
    """Rotation of the pose, w x y z; None without a pose."""
    translation_m: tuple[float, float, float]
    """Position of the scanner in the file's coordinates [m]."""


class E57File:
    """An E57 file that is open for reading."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            from pye57 import libe57
        except ImportError:
            problem = "reading E57 needs pye57, which is not installed"
            raise InputError(str(path), problem, "pip install prc-cli[e57]") from None
        self._library = libe57
        check_frame(path)
        with self._errors(), step(path):
            self._image = libe57.ImageFile(os.fsencode(path), "r")  # a name need not be UTF-8

    def __enter__(self) -> E57File:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(self._library.E57Exception):
            self._image.close()

    @contextlib.contextmanager
    def _errors(self, what: str = "") -> Iterator[None]:
        """Turn exceptions of the library into one-line errors."""
        try:
            yield
        except (self._library.E57Exception, *_NOT_AS_EXPECTED) as error:
            text = (str(error).strip().splitlines() or [type(error).__name__])[0].strip(" *")
            where = f"{self._path}: {what}" if what else str(self._path)
            problem = f"the E57 structure is damaged or not as the standard has it ({text})"
            raise InputError(where, problem, "copy it from the archive again or export it again") from error

    def scans(self) -> list[E57Scan]:
        """Return the metadata of every scan from the XML section."""
        with self._errors():
            root = self._image.root()
            n = root["data3D"].childCount() if root.isDefined("data3D") else 0
        if n > MAX_SCANS:
            raise InputError(str(self._path), f"found {n} scans, expected at most {MAX_SCANS}", "split the file")
        size = self._path.stat().st_size
        found = []
        for index in range(n):
            with self._errors(f"scan {index}"):
                found.append(self._scan(index))
            if found[-1].n_points > 8 * size:
                problem = (
                    f"found {found[-1].n_points} points in a file of {size} bytes, expected a bit a point at least"
                )
                raise InputError(f"{self._path}: scan {index}", problem, "export the scan again")
        return found

    def _scan(self, index: int) -> E57Scan:
        node = self._image.root()["data3D"][index]
        points = node["points"]
        prototype = self._library.StructureNode(points.prototype())
        fields = tuple(prototype.get(i).elementName() for i in range(prototype.childCount()))
        quaternion, translation = None, (0.0, 0.0, 0.0)
        if node.isDefined("pose"):
            pose = node["pose"]
            if pose.isDefined("rotation"):
                quaternion = tuple(_value(pose["rotation"][key]) for key in "wxyz")
            if pose.isDefined("translation"):
                translation = tuple(_value(pose["translation"][key]) for key in "xyz")  # type: ignore[assignment]
        return E57Scan(
            index,
            fields,
            int(points.childCount()),
            _bounds(node),
            _limits(node),
            quaternion,  # type: ignore[arg-type]
            translation,
        )

    def chunks(self, scan: E57Scan, names: tuple[str, ...]) -> Iterator[dict[str, F64]]:
        """Decode the named fields of all points of a scan, scaled to metres and radians."""
        what = f"scan {scan.index}"
        n_all = 0
        with self._errors(what):
            reader, buffers = self._reader(scan, names)
        try:
            while True:
                with self._errors(f"{what}, after point {n_all}"), step(self._path):
                    n = reader.read()
                n_all += n
                if not n or n_all > scan.n_points:
                    break
                yield {name: buffers[name][:n].copy() for name in names}
        finally:
            with contextlib.suppress(self._library.E57Exception):
                reader.close()
        if n_all != scan.n_points:
            problem = f"found {n_all} points, the file's XML section says {scan.n_points}"
            raise InputError(f"{self._path}: {what}", problem, "copy it from the archive again")

    def _reader(self, scan: E57Scan, names: tuple[str, ...]) -> tuple[Any, dict[str, F64]]:
        capacity = max(1, min(CHUNK_POINTS, scan.n_points))
        buffers: dict[str, F64] = {name: np.zeros(capacity) for name in names}
        wrapped = self._library.VectorSourceDestBuffer()
        for name, values in buffers.items():
            wrapped.append(self._library.SourceDestBuffer(self._image, name, values, capacity, True, True))
        return self._image.root()["data3D"][scan.index]["points"].reader(wrapped), buffers


def _value(node: Any) -> float:
    return float(node.scaledValue()) if hasattr(node, "scaledValue") else float(node.value())


def _bounds(node: Any) -> tuple[tuple[int, int], tuple[int, int]] | None:
    if not node.isDefined("indexBounds"):
        return None
    table = node["indexBounds"]
    names = ("rowMinimum", "rowMaximum", "columnMinimum", "columnMaximum")
    if not all(table.isDefined(name) for name in names):
        return None
    values = [_value(table[name]) for name in names]
    if not np.isfinite(values).all():
        return None
    row_low, row_high, column_low, column_high = (int(value) for value in values)
    return (row_low, row_high), (column_low, column_high)


def _limits(node: Any) -> tuple[float, float] | None:
    if not node.isDefined("intensityLimits"):
        return None
    table = node["intensityLimits"]
    if not (table.isDefined("intensityMinimum") and table.isDefined("intensityMaximum")):
        return None
    low, high = _value(table["intensityMinimum"]), _value(table["intensityMaximum"])
    return (low, high) if np.isfinite(high - low) and high > low else None
