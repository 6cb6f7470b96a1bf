"""A LAS or LAZ file as bytes: header fields, VLRs, points and what follows them, each where it lies.

The rewriter copies bytes, so nothing here interprets more than it must. Offsets and sizes are those of the ASPRS
LAS 1.4 R15 specification, tables 3 (header), 5 (VLR), 6 (EVLR) and 7-17 (point formats).
"""

from __future__ import annotations

import contextlib
import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from prc_cli.core.errors import InputError

POINT_SIZES = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Bytes of a record of point formats 0-10, without extra bytes."""

STANDARD_HEADER = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375}
"""Header bytes by minor version; what a larger header holds beyond is the user's."""

VLR_HEADER = struct.Struct("<H16sHH32s")
EVLR_HEADER = struct.Struct("<H16sHQ32s")

_FIELDS = {
    "global_encoding": (6, "<H"),
    "system_id": (26, "<32s"),
    "generating_software": (58, "<32s"),
    "minor_version": (25, "<B"),
    "header_size": (94, "<H"),
    "point_offset": (96, "<I"),
    "n_vlrs": (100, "<I"),
    "point_format": (104, "<B"),
    "record_length": (105, "<H"),
    "legacy_n_points": (107, "<I"),
    "legacy_by_return": (111, "<5I"),
    "scales": (131, "<3d"),
    "offsets": (155, "<3d"),
    "bounds": (179, "<6d"),
    "waveform_start": (227, "<Q"),
    "evlr_start": (235, "<Q"),
    "n_evlrs": (243, "<I"),
    "n_points": (247, "<Q"),
    "by_return": (255, "<15Q"),
}


class Header:
    """Header bytes with named fields; fields that the version does not have cannot be set.

    Examples
    --------
    >>> header = Header(bytes(227))
    >>> header.set("n_vlrs", 3)
    >>> header.get("n_vlrs"), header.has("evlr_start")
    (3, False)
    """

    def __init__(self, data: bytes) -> None:
        self.data = bytearray(data)

    def has(self, name: str) -> bool:
        """Whether the header's version holds a field."""
        offset, form = _FIELDS[name]
        return offset + struct.calcsize(form) <= STANDARD_HEADER.get(self.data[25], 227)

    def get(self, name: str) -> int:
        """Return a field that holds one integer; 0 where the version has no such field."""
        offset, form = _FIELDS[name]
        return int(struct.unpack_from(form, self.data, offset)[0]) if self.has(name) else 0

    def set(self, name: str, *values: int | float | bytes) -> None:
        """Set all values of a field."""
        if not self.has(name):
            message = f"LAS 1.{self.data[25]} has no header field {name}"
            raise KeyError(message)
        offset, form = _FIELDS[name]
        struct.pack_into(form, self.data, offset, *values)

    def copy(self) -> Header:
        """Return an independent copy."""
        return Header(bytes(self.data))


@dataclass(frozen=True, slots=True)
class Vlr:
    """A variable length record, whole."""

    raw: bytes
    """Header and payload."""

    @property
    def key(self) -> tuple[str, int]:
        """User id and record id."""
        _, user, record, _, _ = VLR_HEADER.unpack_from(self.raw)
        return _text(user), int(record)

    @property
    def payload(self) -> bytes:
        """What follows the 54 header bytes."""
        return self.raw[VLR_HEADER.size :]

    def with_payload(self, payload: bytes) -> Vlr:
        """Return the record with another payload."""
        reserved, user, record, _, description = VLR_HEADER.unpack_from(self.raw)
        return Vlr(VLR_HEADER.pack(reserved, user, record, len(payload), description) + payload)


@dataclass(frozen=True, slots=True)
class Evlr:
    """Where an extended variable length record lies; its payload may be gigabytes."""

    start: int
    size: int
    """Bytes of header and payload."""
    key: tuple[str, int]
    """User id and record id."""


@dataclass(frozen=True, slots=True)
class LasFile:
    """Where everything of a LAS or LAZ file lies."""

    path: Path
    size: int
    header: Header
    vlrs: tuple[Vlr, ...]
    vlr_end: int
    """First byte after the VLRs; user bytes may follow up to the points."""
    point_format: int
    record_length: int
    n_points: int
    compressed: bool
    evlrs: tuple[Evlr, ...]

    @property
    def point_offset(self) -> int:
        """First byte of the points."""
        return self.header.get("point_offset")

    @property
    def n_extra_bytes(self) -> int:
        """Bytes of a record beyond its point format."""
        return self.record_length - POINT_SIZES[self.point_format]

    def vlr(self, user_id: str, record_id: int) -> Vlr | None:
        """Return the first VLR of a user id and record id."""
        return next((vlr for vlr in self.vlrs if vlr.key == (user_id, record_id)), None)


class Source:
    """An input opened for reading, whose failures are about the input and not about the output."""

    def __init__(self, path: Path, handle: BinaryIO) -> None:
        self.path = path
        self.error: InputError | None = None
        self._handle = handle

    def seek(self, position: int, whence: int = 0) -> int:
        """Go to a position (also called by lazrs)."""
        return self._handle.seek(position, whence)

    def state(self) -> tuple[int, int, int]:
        """Return size, time of the last change [ns] and number of the file."""
        found = os.fstat(self._handle.fileno())
        return found.st_size, found.st_mtime_ns, found.st_ino

    def tell(self) -> int:
        """Return the position."""
        return self._handle.tell()

    def read(self, n: int = -1) -> bytes:
        """Read up to ``n`` bytes (also called by lazrs, which hides the error: it is kept)."""
        try:
            return self._handle.read(n)
        except OSError as error:
            self.error = damaged(self.path, f"byte {self.tell()}", f"cannot be read ({error.strerror})")
            raise self.error from error

    def into(self, view: memoryview, what: str) -> None:
        """Fill a buffer or say what is cut off."""
        done = 0
        while done < len(view):
            try:
                got = self._handle.readinto(view[done:])  # type: ignore[attr-defined]
            except OSError as error:
                raise damaged(self.path, f"byte {self.tell()}", f"cannot be read ({error.strerror})") from error
            if not got:
                raise damaged(self.path, what, f"cut off: found {done} bytes, expected {len(view)}")
            done += got

    def exact(self, n: int, what: str) -> bytes:
        """Read ``n`` bytes or say what is cut off."""
        start = self.tell()
        data = self.read(n)
        if len(data) != n:
            problem = f"{what} is cut off: found {len(data)} bytes, expected {n}"
            raise damaged(self.path, f"byte {start}", problem)
        return data


@contextlib.contextmanager
def open_source(path: Path) -> Iterator[Source]:
    """Open an input for reading.

    Raises
    ------
    InputError
        When it cannot be opened.
    """
    try:
        handle = path.open("rb")
    except OSError as error:
        problem = f"cannot be read ({error.strerror or error})"
        raise InputError(str(path), problem, "check that the file exists and its permissions") from error
    with handle:
        yield Source(path, handle)


def damaged(path: Path, position: str, problem: str) -> InputError:
    """Return the error of a file that is not what its header says."""
    return InputError(f"{path}: {position}", problem, "copy the file again from its source, or repair it")


def read_structure(source: Source) -> LasFile:
    """Read header, VLRs and the places of EVLRs.

    Raises
    ------
    InputError
        When the file is cut off or its parts overlap; the message names the position.
    """
    size = source.seek(0, 2)
    source.seek(0)
    start = source.exact(min(227, size), "the header")
    if start[:4] != b"LASF" or len(start) < 227:
        raise damaged(
            source.path, "byte 0", f"found {start[:4]!r} and {size} bytes, expected a LAS header of 227 or more"
        )
    header_size = struct.unpack_from("<H", start, 94)[0]
    least = STANDARD_HEADER.get(start[25])
    if start[24] != 1 or least is None or header_size < least:
        problem = f"found LAS {start[24]}.{start[25]} with a header of {header_size} bytes, expected LAS 1.0 to 1.4"
        raise damaged(source.path, "byte 24", problem)
    header = Header(start + source.exact(header_size - 227, "the header"))
    form = header.get("point_format") & 0x3F
    n_points = header.get("n_points") or header.get("legacy_n_points")
    if form >= len(POINT_SIZES) or header.get("record_length") < POINT_SIZES[form]:
        problem = f"found point format {form} with records of {header.get('record_length')} bytes, expected format 0-10"
        raise damaged(source.path, "byte 104", problem)
    vlrs, vlr_end = _read_vlrs(source, header, size)
    las = LasFile(
        path=source.path,
        size=size,
        header=header,
        vlrs=vlrs,
        vlr_end=vlr_end,
        point_format=form,
        record_length=header.get("record_length"),
        n_points=n_points,
        compressed=bool(header.get("point_format") & 0x80),
        evlrs=(),
    )
    if not las.compressed and las.point_offset + n_points * las.record_length > size:
        found = max(size - las.point_offset, 0) // las.record_length
        raise damaged(source.path, f"byte {las.point_offset}", f"found {found} point records, expected {n_points}")
    if las.compressed:
        _check_laszip(las)
    return replace(las, evlrs=_read_evlrs(source, header, size))


def _check_laszip(las: LasFile) -> None:
    """Refuse a laszip VLR that cannot be; that there is none is told where the points are read."""
    laszip = las.vlr("laszip encoded", 22204)
    if laszip is None:
        return
    data = laszip.payload
    n_items = struct.unpack_from("<H", data, 32)[0] if len(data) >= 34 else 0
    if not n_items or len(data) < 34 + 6 * n_items or not struct.unpack_from("<I", data, 12)[0]:
        problem = f"found {len(data)} bytes for {n_items} items of a record, or chunks of 0 records"
        raise damaged(las.path, "laszip VLR", problem)


def _read_vlrs(source: Source, header: Header, size: int) -> tuple[tuple[Vlr, ...], int]:
    position = header.get("header_size")
    end = header.get("point_offset")
    if not position <= end <= size:
        raise damaged(source.path, "byte 96", f"found points at byte {end}, expected byte {position} to {size}")
    vlrs = []
    source.seek(position)
    for number in range(header.get("n_vlrs")):
        if position + VLR_HEADER.size > end:
            problem = f"found the points at byte {end}, expected {header.get('n_vlrs')} VLRs before them"
            raise damaged(source.path, f"byte {position} (VLR {number})", problem)
        head = source.exact(VLR_HEADER.size, "a VLR")
        vlr = Vlr(head + source.exact(VLR_HEADER.unpack(head)[3], "a VLR"))
        position += len(vlr.raw)
        if position > end:
            problem = f"found a VLR that ends at byte {position}, expected at most byte {end} where the points begin"
            raise damaged(source.path, f"byte {position - len(vlr.raw)} (VLR {number})", problem)
        vlrs.append(vlr)
    return tuple(vlrs), position


def _read_evlrs(source: Source, header: Header, size: int) -> tuple[Evlr, ...]:
    position = header.get("evlr_start")
    evlrs = []
    for number in range(header.get("n_evlrs")):
        where = f"byte {position} (EVLR {number})"
        if not header.get("point_offset") <= position <= size - EVLR_HEADER.size:
            raise damaged(source.path, where, f"found {size} bytes, expected an EVLR after the points")
        source.seek(position)
        _, user, record, length, _ = EVLR_HEADER.unpack(source.exact(EVLR_HEADER.size, "an EVLR"))
        evlr = Evlr(position, EVLR_HEADER.size + length, (_text(user), int(record)))
        position += evlr.size
        if position > size:
            raise damaged(source.path, where, f"found {size} bytes, expected the EVLR to end at byte {position}")
        evlrs.append(evlr)
    return tuple(evlrs)


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode("latin-1")
