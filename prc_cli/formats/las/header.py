"""Reads header, VLRs and extended VLRs of a LAS file, with the position of every part.

Every count and length is compared with the size of the file first, so that a damaged or hostile
file costs neither memory nor time. VLRs keep their bytes, because a rewritten file must not lose
any. The fields follow the LAS specification 1.4 R15; LASzip sets the highest bit of the format byte
in LAZ files.
"""

from __future__ import annotations

import contextlib
import json
import logging
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from prc_cli.core.errors import InputError
from prc_cli.core.files import file_state
from prc_cli.formats.writing.record import dropped_of

STANDARD_HEADER = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375, 5: 393}
"""Header length by minor version; bytes beyond it are user bytes."""
MOST_MINOR = 10
"""Versions from here on are damage, not newer ones."""
N_POINT_FORMATS = 11
MAX_HEAD_BYTES = 64 << 20
"""Most bytes before the first record, which stay in memory: more is damage."""
MAX_EVLRS = 100_000
"""Most extended VLRs: more is damage."""
MAX_KEPT_EVLR_BYTES = 1 << 20
"""Longest extended VLR kept in memory; others may hold waveforms."""
DAMAGED = "copy the file again or write it again with the program that made it"
COMPRESSED = 0x80
"""Bit of the format byte: the records are compressed."""
WKT_BIT = 16
"""Global encoding: the coordinate system is WKT."""


class VlrKey(NamedTuple):
    """The kind of a VLR."""

    user_id: str
    record_id: int


LASZIP_KEY = VlrKey("laszip encoded", 22204)
RECORD_KEY = VlrKey("prc-cli", 1)
EXTRA_BYTES_KEY = VlrKey("LASF_Spec", 4)
WKT_KEY = VlrKey("LASF_Projection", 2112)
GEO_KEYS_KEY = VlrKey("LASF_Projection", 34735)

_VLR_HEAD = struct.Struct("<H16sHH32s")
_EVLR_HEAD = struct.Struct("<H16sHQ32s")

_FIELDS = {
    "global_encoding": (6, "<H"),
    "system_id": (26, "<32s"),
    "software": (58, "<32s"),
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


class HeaderFields:
    """Header bytes with named fields that can be changed.

    >>> fields = HeaderFields(bytes(227))
    >>> fields.set("n_vlrs", 3)
    >>> fields.get("n_vlrs"), fields.has("evlr_start")
    (3, False)
    """

    def __init__(self, data: bytes) -> None:
        self.data = bytearray(data)

    def has(self, name: str) -> bool:
        """Whether the header's version holds a field."""
        offset, form = _FIELDS[name]
        return offset + struct.calcsize(form) <= STANDARD_HEADER.get(self.data[25], 227)

    def get(self, name: str) -> int:
        """Return a field of one integer; 0 if the version has no such field."""
        return int(self.values(name)[0]) if self.has(name) else 0

    def values(self, name: str) -> tuple[Any, ...]:
        """Return all values of a field."""
        offset, form = _FIELDS[name]
        return struct.unpack_from(form, self.data, offset)

    def set(self, name: str, *values: float | bytes) -> None:
        """Set all values of a field."""
        offset, form = _FIELDS[name]
        struct.pack_into(form, self.data, offset, *values)


@dataclass(frozen=True, slots=True)
class Vlr:
    """A variable length record, plain or extended, as stored in the file."""

    head: bytes
    """Head before the content: 54 bytes, 60 of an extended one."""
    data: bytes | None
    """Content; None for long extended records."""
    start: int = 0
    """First byte of an extended one in the file it was read from."""

    @property
    def extended(self) -> bool:
        """Whether it is an extended one, behind the points."""
        return len(self.head) == _EVLR_HEAD.size

    @property
    def user_id(self) -> str:
        """Name of the program or organisation that defined it."""
        return text_of(self.head[2:18])

    @property
    def record_id(self) -> int:
        """Number among the records of its user."""
        return int.from_bytes(self.head[18:20], "little")

    @property
    def key(self) -> VlrKey:
        """User id and record id."""
        return VlrKey(self.user_id, self.record_id)

    def has(self, key: VlrKey) -> bool:
        """Whether it has this user id and record id.

        Fast, because damaged files may have a million VLRs.
        """
        return self.record_id == key.record_id and self.user_id == key.user_id

    @property
    def description(self) -> str:
        """Description."""
        return text_of(self.head[-32:])

    @property
    def n_bytes(self) -> int:
        """Length of its content."""
        return int.from_bytes(self.head[20:-32], "little")

    @property
    def stop(self) -> int:
        """First byte behind an extended one in the file."""
        return self.start + len(self.head) + self.n_bytes

    @property
    def raw(self) -> bytes:
        """Head and content."""
        return self.head + (self.data or b"")

    def with_data(self, data: bytes) -> Vlr:
        """Return a plain record with another content."""
        return Vlr(self.head[:20] + len(data).to_bytes(2, "little") + self.head[22:], data)


_TEXTS = {
    VlrKey("LASF_Projection", 34737): "ascii",
    VlrKey("LASF_Projection", 2111): "utf-8",
    WKT_KEY: "utf-8",
}
"""Records whose content is text, with its encoding."""
_DESCRIPTOR_BYTES = 192
_DESCRIPTOR_TEXTS = ((4, 36), (160, 192))
"""Bytes of the name and of the description in a descriptor of extra bytes."""


def readable(vlr: Vlr) -> Vlr:
    """Return a record with valid texts, because other programs refuse files with invalid ones.

    Texts are the user id, coordinate systems and descriptors of extra bytes. Invalid bytes become
    ``?``, so that no other byte moves.
    """
    name, zero, padding = vlr.head[2:18].partition(b"\0")
    head = vlr.head[:2] + _as_text(name) + zero + padding + vlr.head[18:]
    data = vlr.data
    if data and vlr.key in _TEXTS:
        data = _as_text(data, _TEXTS[vlr.key])
    elif data and vlr.has(EXTRA_BYTES_KEY):
        described = bytearray(data)
        for first in range(0, len(data) - _DESCRIPTOR_BYTES + 1, _DESCRIPTOR_BYTES):
            for begin, end in _DESCRIPTOR_TEXTS:
                described[first + begin : first + end] = _as_text(data[first + begin : first + end])
        data = bytes(described)
    return Vlr(head, data, vlr.start)


def _as_text(raw: bytes, codec: str = "utf-8") -> bytes:
    try:
        raw.decode(codec)
    except UnicodeDecodeError:
        return bytes(byte if byte < 0x80 else ord("?") for byte in raw)
    return raw


def make_vlr(
    key: VlrKey,
    data: bytes,
    description: str,
    *,
    extended: bool = False,
) -> Vlr:
    """Return a VLR; a plain one has at most 65535 bytes."""
    head = _EVLR_HEAD if extended else _VLR_HEAD
    return Vlr(
        head.pack(
            0, key.user_id.encode("ascii"), key.record_id, len(data), description.encode("ascii")
        ),
        data,
    )


def new_header() -> HeaderFields:
    """Return the header of a new LAS 1.4 file, without a date: equal runs give equal bytes."""
    fields = HeaderFields(bytes(STANDARD_HEADER[4]))
    fields.data[:4] = b"LASF"
    fields.data[25] = 4
    fields.data[24] = 1
    fields.set("global_encoding", WKT_BIT)
    fields.set("header_size", len(fields.data))
    return fields


@dataclass(frozen=True, slots=True)
class LasHeader:
    """A checked header."""

    path: Path
    file_bytes: int
    raw: bytes
    """Header bytes, user bytes at its end included."""
    version: tuple[int, int]
    point_format: int
    compressed: bool
    record_bytes: int
    """Bytes of an (uncompressed) record, extra bytes included."""
    n_records: int
    is_legacy_count: bool
    """LAS 1.4: whether only the legacy count (byte 107) is set and therefore used."""
    data_offset: int
    """Byte where the records begin."""
    vlr_end: int
    """First byte behind the VLRs; user bytes may follow up to the records."""
    scales: tuple[float, ...]
    offsets: tuple[float, ...]
    vlrs: tuple[Vlr, ...]
    evlrs: tuple[Vlr, ...]
    """Extended VLRs."""

    @property
    def n_extra_bytes(self) -> int:
        """Bytes of a record beyond its point format."""
        return self.record_bytes - standard_bytes(self.point_format)

    @property
    def n_unread_bytes(self) -> int:
        """LAS: bytes behind the last record, up to extended VLRs or the end of the file; LAZ: 0."""
        stop = self.evlrs[0].start if self.evlrs else self.file_bytes
        return (
            0 if self.compressed else stop - self.data_offset - self.n_records * self.record_bytes
        )

    @property
    def n_unread_records(self) -> int:
        """LAS: whole records beyond the count of the header; 0 if they are zeros or waveforms."""
        n = self.n_unread_bytes // self.record_bytes
        if n < 1 or self.fields().get("waveform_start"):
            return 0
        with open_bytes(self.path) as source:
            source.seek(self.data_offset + self.n_records * self.record_bytes)
            return n if any(source.read(self.record_bytes)) else 0

    @property
    def mins(self) -> tuple[float, ...]:
        """Least x, y, z in the header."""
        return self.fields().values("bounds")[1::2]

    @property
    def maxs(self) -> tuple[float, ...]:
        """Largest x, y, z in the header."""
        return self.fields().values("bounds")[::2]

    def fields(self) -> HeaderFields:
        """Return a copy of the header's bytes, to be changed."""
        return HeaderFields(self.raw)

    def vlr(self, key: VlrKey) -> Vlr | None:
        """Return the first plain VLR of a user id and record id."""
        return next((vlr for vlr in self.vlrs if vlr.has(key)), None)

    def find(self, key: VlrKey) -> list[bytes]:
        """Return the contents of all VLRs of a user id and record id, extended ones last."""
        vlrs = chain(self.vlrs, self.evlrs)
        return [vlr.data for vlr in vlrs if vlr.data is not None and vlr.has(key)]


class InputBytes:
    """An input opened for reading, also by lazrs; its failures become input errors."""

    def __init__(self, path: Path, handle: BinaryIO) -> None:
        self.path = path
        self.error: InputError | None = None
        """The last failure, because lazrs hides it."""
        self.seek = handle.seek
        self.tell = handle.tell
        self._handle = handle

    def state(self) -> tuple[int, int, int, int]:
        """Return size, times and number of the file (:func:`prc_cli.core.files.file_state`)."""
        return file_state(self._handle.fileno())

    def read(self, n: int = -1) -> bytes:
        """Read up to ``n`` bytes."""
        with self._errors():
            return self._handle.read(n)

    def into(self, view: memoryview) -> int:
        """Read into a buffer; return the number of bytes read, less at the end of the file."""
        with self._errors():
            return int(self._handle.readinto(view))  # type: ignore[attr-defined]

    def exact(self, n: int, what: str) -> bytes:
        """Read ``n`` bytes, or raise an error that names the part that is cut off."""
        start = self.tell()
        data = self.read(n)
        if len(data) != n:
            raise damaged(
                self.path, start, f"{what} is cut off: found {len(data)} bytes, expected {n}"
            )
        return data

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.error = damaged(self.path, self.tell(), f"cannot be read ({error.strerror})")
            raise self.error from error


class Span(NamedTuple):
    """A part of a file."""

    start: int
    """First byte."""
    stop: int
    """First byte behind it."""


@contextlib.contextmanager
def open_bytes(path: Path) -> Iterator[InputBytes]:
    """Open an input for reading."""
    try:
        handle = path.open("rb")
    except OSError as error:
        problem = f"cannot be read ({error.strerror or error})"
        raise InputError(str(path), problem, "check name and permissions") from None
    with handle:
        yield InputBytes(path, handle)


def damaged(
    path: Path,
    byte: int,
    problem: str,
    hint: str = DAMAGED,
) -> InputError:
    """Return an error that names a position in the file, for the caller to raise."""
    return InputError(f"{path}: byte {byte}", problem, hint)


@cache
def standard_bytes(point_format: int) -> int:
    """Return the bytes of a record of a point format, without extra bytes."""
    import laspy

    return int(laspy.PointFormat(point_format).size)


def read_header(source: InputBytes) -> LasHeader:
    """Read and check header, VLRs and extended VLRs; a file without records is accepted."""
    path = source.path
    file_bytes = source.state()[0]
    fields = _read_fields(source, file_bytes)
    point_format = fields.get("point_format") & ~COMPRESSED
    compressed = bool(fields.get("point_format") & COMPRESSED)
    n_records = fields.get("legacy_n_points")
    is_legacy_count = False
    if fields.has("n_points"):
        # some LAS 1.4 writers leave the new count 0; formats 6 and up must not use the old one
        is_legacy_count = not fields.get("n_points") and n_records > 0 and point_format < 6
        n_records = n_records if is_legacy_count else fields.get("n_points")
    data_offset = fields.get("point_offset")
    record_bytes = fields.get("record_length")
    if not n_records and fields.get("legacy_n_points"):
        raise no_records(path, fields, file_bytes - data_offset)
    vlrs, vlr_end = _read_vlrs(source, fields)
    if not compressed:
        _check_count(path, n_records, fields, file_bytes)
    evlrs = _read_evlrs(source, fields, file_bytes) if fields.get("n_evlrs") else ()
    return LasHeader(
        path=path,
        file_bytes=file_bytes,
        raw=bytes(fields.data),
        version=(1, fields.data[25]),
        point_format=point_format,
        compressed=compressed,
        record_bytes=record_bytes,
        n_records=n_records,
        is_legacy_count=is_legacy_count,
        data_offset=data_offset,
        vlr_end=vlr_end,
        scales=fields.values("scales"),
        offsets=fields.values("offsets"),
        vlrs=vlrs,
        evlrs=evlrs,
    )


def _read_fields(source: InputBytes, file_bytes: int) -> HeaderFields:
    """Read the header with its user bytes; compare its sizes with each other and with the file."""
    path = source.path
    where = str(source.path)
    if file_bytes == 0:
        raise InputError(where, "empty file, expected a LAS header of at least 227 bytes", DAMAGED)
    head = source.read(max(STANDARD_HEADER.values()))
    if head[:4] != b"LASF"[: len(head)]:
        problem = f"begins with {head[:4]!r}, expected b'LASF': not a LAS or LAZ file"
        raise InputError(
            where, problem, "give raw dumps a [layout] and one of the suffixes .bin .raw .dat"
        )
    major, minor = head[24:26] if len(head) > 25 else (1, 0)
    if major != 1 or minor not in STANDARD_HEADER:
        is_newer = major == 1 and max(STANDARD_HEADER) < minor < MOST_MINOR
        hint = "save it as LAS 1.4 with the program that made it" if is_newer else DAMAGED
        raise damaged(
            path, 24, f"LAS version {major}.{minor}, expected 1.0 to 1.{max(STANDARD_HEADER)}", hint
        )
    least = STANDARD_HEADER[minor]
    if len(head) < least:
        raise InputError(
            where, f"header cut short: {len(head)} bytes, expected at least {least}", DAMAGED
        )
    fields = HeaderFields(head[:least])
    size = fields.get("header_size")
    start = fields.get("point_offset")
    record_bytes = fields.get("record_length")
    point_format = fields.get("point_format") & ~COMPRESSED
    if size < least:
        raise damaged(path, 94, f"header size {size}, expected at least {least}")
    if not size <= start <= file_bytes:
        problem = f"records begin at byte {start}, expected byte {size} to {file_bytes}"
        raise damaged(path, 96, f"{problem}: the file is cut short or damaged")
    if start > MAX_HEAD_BYTES:
        raise damaged(
            path, 96, f"{start} bytes before the first record, expected at most {MAX_HEAD_BYTES}"
        )
    if point_format >= N_POINT_FORMATS:
        raise damaged(
            path, 104, f"point format {point_format}, expected 0 to {N_POINT_FORMATS - 1}"
        )
    if record_bytes < (least := standard_bytes(point_format)):
        problem = f"records of {record_bytes} bytes, expected at least {least}"
        raise damaged(path, 105, f"{problem} for point format {point_format}")
    source.seek(0)
    return HeaderFields(source.read(size))


def no_records(path: Path, fields: HeaderFields, left: int) -> InputError:
    """Return the error of a file whose header counts no records."""
    problem = f"the header says 0 records, expected at least one ({left} bytes follow the header)"
    return damaged(
        path,
        247 if fields.has("n_points") else 107,
        problem,
        "nothing to read; check how it was made",
    )


def check_decodable(header: LasHeader) -> None:
    """Raise an error for files without records or finite scales, which can only be copied."""
    for i, axis in enumerate("xyz"):
        scale = header.scales[i]
        offset = header.offsets[i]
        # comparisons with NaN are false; the upper bound catches infinity
        if not 0 < abs(scale) < float("inf"):
            problem = f"{axis} scale factor {scale}, expected a finite number other than 0"
            raise damaged(header.path, 131 + 8 * i, problem)
        if not abs(offset) < float("inf"):
            raise damaged(
                header.path, 155 + 8 * i, f"{axis} offset {offset}, expected a finite number"
            )
    if header.n_records == 0:
        raise no_records(header.path, header.fields(), header.file_bytes - header.data_offset)


def refused_by_laspy(header: LasHeader) -> str:
    """Return the reason if laspy refuses the header or the VLRs; else an empty text.

    Long waveforms are left out, because laspy reads them whole.
    """
    import laspy

    logging.getLogger("laspy").addHandler(logging.NullHandler())  # else its warnings are printed
    try:
        with header.path.open("rb") as handle:
            small = (
                bool(header.evlrs) and header.file_bytes - header.evlrs[0].start <= MAX_HEAD_BYTES
            )
            laspy.LasHeader.read_from(handle, read_evlrs=small)
    except Exception as error:  # of any kind: descriptors index tables, texts are decoded
        return " ".join(f"{type(error).__name__}: {error}".split())[:120]
    return ""


def _check_count(
    path: Path,
    n_records: int,
    fields: HeaderFields,
    file_bytes: int,
) -> None:
    """Compare the number of uncompressed records with the size of the file."""
    start = fields.get("point_offset")
    size = fields.get("record_length")
    evlr_start = fields.get("evlr_start")
    needed = start + n_records * size
    if needed > file_bytes:
        problem = (
            f"the header promises {n_records} records, {needed} bytes in all; "
            f"found {file_bytes} bytes, room for {(file_bytes - start) // size} records"
        )
        raise InputError(str(path), problem, "the file is cut short or its header lies; " + DAMAGED)
    if fields.get("n_evlrs") and start <= evlr_start < needed:
        problem = (
            f"the header promises {n_records} records up to byte {needed}, "
            f"but extended VLRs begin at byte {evlr_start}"
        )
        raise InputError(str(path), problem, DAMAGED)


def _read_vlrs(source: InputBytes, fields: HeaderFields) -> tuple[tuple[Vlr, ...], int]:
    start = fields.get("header_size")
    end = fields.get("point_offset")
    count = fields.get("n_vlrs")
    most = (end - start) // _VLR_HEAD.size
    if count > most:
        problem = f"{count} VLRs in {end - start} bytes before the records, expected at most {most}"
        raise damaged(source.path, 100, problem)
    source.seek(start)
    data = source.read(end - start)
    vlrs = []
    position = 0
    for index in range(count):
        content = position + _VLR_HEAD.size
        what = f"VLR {index + 1} of {count}"
        if content > len(data):
            problem = f"{what} lies beyond the start of the records (byte {end})"
            raise damaged(source.path, start + position, problem)
        vlr = Vlr(data[position:content], None)
        if vlr.n_bytes > len(data) - content:
            n_left = len(data) - content
            problem = f"{what} claims {vlr.n_bytes} bytes, {n_left} are left before the records"
            raise damaged(source.path, start + position, problem)
        position = content + vlr.n_bytes
        vlrs.append(Vlr(vlr.head, data[content:position]))
    return tuple(vlrs), start + position


def _read_evlrs(source: InputBytes, fields: HeaderFields, file_bytes: int) -> tuple[Vlr, ...]:
    position = fields.get("evlr_start")
    first = fields.get("point_offset")
    count = fields.get("n_evlrs")
    hint = "the file is cut short; " + DAMAGED
    if not first <= position <= file_bytes:
        problem = f"extended VLRs begin at byte {position}, expected byte {first} to {file_bytes}"
        raise damaged(source.path, 235, problem, hint)
    most = min((file_bytes - position) // _EVLR_HEAD.size, MAX_EVLRS)
    if count > most:
        raise damaged(source.path, 243, f"{count} extended VLRs, expected at most {most}")
    vlrs = []
    for index in range(count):
        source.seek(position)
        vlr = Vlr(source.read(_EVLR_HEAD.size).ljust(_EVLR_HEAD.size, b"\0"), None, position)
        left = file_bytes - position - _EVLR_HEAD.size
        if vlr.n_bytes > left:
            what = f"extended VLR {index + 1} of {count}"
            problem = f"{what} claims {vlr.n_bytes} bytes, {max(left, 0)} are left in the file"
            raise damaged(source.path, position, problem, hint)
        content = source.read(vlr.n_bytes) if vlr.n_bytes <= MAX_KEPT_EVLR_BYTES else None
        vlrs.append(Vlr(vlr.head, content, position))
        position = vlr.stop
    return tuple(vlrs)


def text_of(raw: bytes | str) -> str:
    """Return a zero-terminated text; bytes that are not UTF-8 are shown escaped."""
    text = raw if isinstance(raw, str) else raw.split(b"\0")[0].decode("utf-8", "replace")
    return text.strip()


def find_dropped(header: LasHeader) -> str:
    """Return the note of the run record on shots that were left out; empty = none were."""
    return next(filter(None, map(dropped_of, _run_records(header))), "")


def find_points_per_line(header: LasHeader) -> int | None:
    """Return M from the run record of this program, None if the file has none."""
    for record in _run_records(header):
        with contextlib.suppress(LookupError, TypeError):
            value = record["stream"]["points_per_line"]
            if isinstance(value, int) and not isinstance(value, bool) and value > 0:
                return value
    return None


def _run_records(header: LasHeader) -> Iterator[Any]:
    for data in header.find(RECORD_KEY):
        with contextlib.suppress(ValueError, RecursionError):
            yield json.loads(data.rstrip(b"\0"))
