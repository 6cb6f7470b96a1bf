"""The Classification Lookup VLR: names of the classes of a file.

LAS 1.4 defines it as user id ``LASF_Spec``, record id 0: entries of 16 bytes, the class number and 15 characters. The
standard classes are named by the specification itself; user codes, 64 and up, mean what this record says.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

from prc_cli.core.classes import FIRST_USER_CODE
from prc_cli.formats.las.header import LasHeader, Vlr, make_vlr, read_header, text_of

LOOKUP_KEY = ("LASF_Spec", 0)
ENTRY_BYTES = 16
MOST_ENTRIES = 65_535 // ENTRY_BYTES
_TEXT = "Classification Lookup"


def lookup_vlr(names: Mapping[int, str]) -> Vlr:
    """Return a new record.

    >>> len(lookup_vlr({64: "stem", 65: "car"}).data)
    32
    """
    return make_vlr(LOOKUP_KEY, b"".join(_entry(code, name) for code, name in sorted(names.items())), _TEXT)


def names_in(las: LasHeader) -> dict[int, str]:
    """Return the names of user codes that a file holds."""
    found: dict[int, str] = {}
    for data in las.find(LOOKUP_KEY):
        for code, name in _entries(data):
            if code >= FIRST_USER_CODE and name:
                found.setdefault(code, name)
    return found


def names_of_file(path: Path) -> dict[int, str]:
    """Return the names of user codes that a LAS or LAZ file holds."""
    return names_in(read_header(path))


def with_lookup(las: LasHeader, vlrs: list[Vlr], names: Mapping[int, str]) -> tuple[list[Vlr], tuple[str, ...]]:
    """Return VLRs that name some classes; an existing record is extended in its place, byte for byte if possible."""
    if not names:
        return vlrs, ()
    if any(evlr.has(LOOKUP_KEY) for evlr in las.evlrs):
        return vlrs, ("the names of classes stand behind the points; they were left as they are",)
    place = next((index for index, vlr in enumerate(vlrs) if vlr.has(LOOKUP_KEY)), None)
    if place is None:
        return [*vlrs, lookup_vlr(names)], ()
    old = vlrs[place]
    data, notices = bytearray(old.data or b""), []
    if len(data) % ENTRY_BYTES:
        return vlrs, (f"the names of classes take {len(data)} bytes, no multiple of 16; they were left as they are",)
    at = {code: index * ENTRY_BYTES for index, (code, _) in reversed(list(enumerate(_entries(bytes(data)))))}
    for code, name in sorted(names.items()):
        entry = _entry(code, name)
        if code not in at:
            data += entry
            continue
        before = text_of(bytes(data[at[code] + 1 : at[code] + ENTRY_BYTES]))
        if before != text_of(entry[1:]):
            data[at[code] : at[code] + ENTRY_BYTES] = entry
            if before:
                notices.append(
                    f"class {code} was named {before!r} in the input; its name is now {text_of(entry[1:])!r}"
                )
    if bytes(data) == old.data:
        return vlrs, ()
    if len(data) > MOST_ENTRIES * ENTRY_BYTES:
        return vlrs, ("the names of classes fill their record; they were left as they are",)
    # the head keeps its reserved bytes and its description
    head = old.head[:20] + len(data).to_bytes(2, "little") + old.head[22:]
    return [*vlrs[:place], Vlr(head, bytes(data)), *vlrs[place + 1 :]], tuple(notices)


def _entry(code: int, name: str) -> bytes:
    return bytes([code]) + name.encode("ascii", "replace")[: ENTRY_BYTES - 1].ljust(ENTRY_BYTES - 1, b"\0")


def _entries(data: bytes) -> Iterator[tuple[int, str]]:
    for start in range(0, len(data) - ENTRY_BYTES + 1, ENTRY_BYTES):
        yield data[start], text_of(data[start + 1 : start + ENTRY_BYTES])
