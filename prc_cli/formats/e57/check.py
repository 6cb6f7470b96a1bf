"""Checks of an E57 file (ASTM E2807) before a library opens it.

The library trusts the XML section: entities are expanded without bound and deep nesting overflows its
stack. Both kill the process instead of raising, so they are refused here.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import IO
from xml.parsers import expat

from prc_cli.core.errors import InputError
from prc_cli.core.files import open_to_read

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
