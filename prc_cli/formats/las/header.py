"""The frame of a LAS file: header, variable length records and their sizes, checked against the file.

Nothing here trusts a count or a length before it was compared with the size of the file, so that a damaged or
hostile file costs neither memory nor time. What the fields mean follows the LAS specification 1.4 R15.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from prc_cli.core.errors import InputError

RECORD_BYTES = {0: 20, 1: 28, 2: 26, 3: 34, 4: 57, 5: 63, 6: 30, 7: 36, 8: 38, 9: 59, 10: 67}
"""Bytes of a record by point format, without extra bytes."""
HEADER_BYTES = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375}
"""Least size of the header by minor version."""
MAX_HEAD_BYTES = 64 << 20
"""Header and VLRs are held in memory; more than this before the first record is taken for damage."""
MAX_EVLRS = 100_000
"""More extended VLRs than this are taken for damage."""
MAX_KEPT_EVLR_BYTES = 1 << 20
"""Extended VLRs may hold whole waveforms; only short ones are kept in memory."""
DAMAGED = "copy the file again or write it anew with the program that made it"


@dataclass(frozen=True, slots=True)
class Vlr:
    """A variable length record."""

    user_id: str
    record_id: int
    description: str
    n_bytes: int
    """Length of its content."""
    data: bytes | None
    """Content; None for long extended records."""
    extended: bool


@dataclass(frozen=True, slots=True)
class LasHeader:
    """What the header says, after it was checked."""

    version: tuple[int, int]
    point_format: int
    compressed: bool
    record_bytes: int
    """Bytes of an (uncompressed) record, extra bytes included."""
    n_records: int
    is_legacy_count: bool
    """LAS 1.4: whether only the legacy count (byte 107) is set, and was taken."""
    data_offset: int
    """Byte where the records begin."""
    n_unread_bytes: int
    """LAS: bytes between the last record and the extended VLRs or the end of the file; 0 for LAZ."""
    file_bytes: int
    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    mins: tuple[float, float, float]
    maxs: tuple[float, float, float]
    system_id: str
    software: str
    vlrs: tuple[Vlr, ...]
    """VLRs, then extended VLRs."""

    def find(self, user_id: str, record_id: int) -> list[bytes]:
        """Return the contents of the VLRs of this id."""
        wanted = (user_id, record_id)
        return [vlr.data for vlr in self.vlrs if (vlr.user_id, vlr.record_id) == wanted and vlr.data is not None]


def read_header(path: Path) -> LasHeader:
    """Read and check header, VLRs and extended VLRs.

    Raises
    ------
    InputError
        When the file is not LAS, is cut short, holds no records, or contradicts itself.
    """
    try:
        with path.open("rb") as handle:
            return _read(handle, str(path), path.stat().st_size)
    except OSError as error:
        problem = f"cannot be read ({error.strerror or error})"
        raise InputError(str(path), problem, "check name and permissions") from None


def _read(handle: BinaryIO, where: str, file_bytes: int) -> LasHeader:
    if file_bytes == 0:
        raise InputError(where, "empty file, expected a LAS header of at least 227 bytes", DAMAGED)
    head = handle.read(HEADER_BYTES[4])
    if head[:4] != b"LASF"[: len(head)]:
        problem = f"begins with {head[:4]!r}, expected b'LASF': not a LAS or LAZ file"
        raise InputError(where, problem, "give raw dumps a [layout] and one of the suffixes .bin .raw .dat")
    minor = head[25] if len(head) > 25 else 0
    if len(head) > 25 and (head[24] != 1 or minor not in HEADER_BYTES):
        raise damaged(where, 24, f"LAS version {head[24]}.{minor}, expected 1.0 to 1.4")
    if len(head) < HEADER_BYTES[minor]:
        problem = f"header cut short: {len(head)} bytes, expected at least {HEADER_BYTES[minor]}"
        raise InputError(where, problem, DAMAGED)
    header_bytes, data_offset, n_vlrs, format_byte, record_bytes, n_records = struct.unpack_from("<HIIBHI", head, 94)
    evlr_start, n_evlrs, is_legacy_count = 0, 0, False
    if minor >= 4:
        evlr_start, n_evlrs, count = struct.unpack_from("<QIQ", head, 235)
        # some writers of 1.4 leave the new count empty; formats from 6 on must not use the old one
        is_legacy_count = count == 0 and n_records > 0 and format_byte & 0x3F < 6
        n_records = n_records if is_legacy_count else count
    _check_frame(where, file_bytes, (header_bytes, HEADER_BYTES[minor]), data_offset)
    point_format = _check_format(where, format_byte, record_bytes)
    numbers = struct.unpack_from("<12d", head, 131)
    _check_scales(where, numbers)
    if n_records == 0:
        left = file_bytes - data_offset
        problem = f"the header says 0 records, expected at least one ({left} bytes follow the header)"
        raise damaged(where, 247 if minor >= 4 else 107, problem, "nothing to read; check how it was made")
    vlrs = _read_vlrs(handle, where, header_bytes, data_offset, n_vlrs)
    compressed = bool(format_byte & 0xC0)
    n_unread = 0
    if not compressed:
        ends = file_bytes, evlr_start if n_evlrs else None
        _check_count(where, n_records, record_bytes, data_offset, ends)
        n_unread = (evlr_start if n_evlrs else file_bytes) - data_offset - n_records * record_bytes
    if n_evlrs:
        vlrs += _read_evlrs(handle, where, (evlr_start, data_offset, file_bytes), n_evlrs)
    return LasHeader(
        version=(1, minor),
        point_format=point_format,
        compressed=compressed,
        record_bytes=record_bytes,
        n_records=n_records,
        is_legacy_count=is_legacy_count,
        data_offset=data_offset,
        n_unread_bytes=n_unread,
        file_bytes=file_bytes,
        scales=numbers[0:3],
        offsets=numbers[3:6],
        mins=(numbers[7], numbers[9], numbers[11]),
        maxs=(numbers[6], numbers[8], numbers[10]),
        system_id=text_of(head[26:58]),
        software=text_of(head[58:90]),
        vlrs=tuple(vlrs),
    )


def damaged(where: str, byte: int, problem: str, hint: str = DAMAGED) -> InputError:
    """Return the error for a position in the file; to be raised by the caller."""
    return InputError(f"{where}: byte {byte}", problem, hint)


def _check_frame(where: str, file_bytes: int, header_bytes: tuple[int, int], data_offset: int) -> None:
    found, least = header_bytes
    if found < least:
        raise damaged(where, 94, f"header size {found}, expected at least {least}")
    if not found <= data_offset <= file_bytes:
        problem = f"records begin at byte {data_offset}, expected between the header's end ({found}) and the file's"
        raise damaged(where, 96, f"{problem} ({file_bytes}): the file is cut short or damaged")
    if data_offset > MAX_HEAD_BYTES:
        problem = f"{data_offset} bytes before the first record, expected at most {MAX_HEAD_BYTES}"
        raise damaged(where, 96, problem)


def _check_format(where: str, format_byte: int, record_bytes: int) -> int:
    point_format = format_byte & 0x3F
    if point_format not in RECORD_BYTES:
        raise damaged(where, 104, f"point format {point_format}, expected 0 to 10")
    if record_bytes < RECORD_BYTES[point_format]:
        problem = f"records of {record_bytes} bytes, expected at least {RECORD_BYTES[point_format]}"
        raise damaged(where, 105, f"{problem} for point format {point_format}")
    return point_format


def _check_scales(where: str, numbers: tuple[float, ...]) -> None:
    for i, axis in enumerate("xyz"):
        scale, offset = numbers[i], numbers[3 + i]
        # a comparison with NaN is false, infinity is caught by the upper bound
        if not 0 < abs(scale) < float("inf"):
            problem = f"{axis} scale factor {scale}, expected a finite number other than 0"
            raise damaged(where, 131 + 8 * i, problem)
        if not abs(offset) < float("inf"):
            raise damaged(where, 155 + 8 * i, f"{axis} offset {offset}, expected a finite number")


def _check_count(where: str, n_records: int, record_bytes: int, data_offset: int, ends: tuple[int, int | None]) -> None:
    file_bytes, evlr_start = ends
    needed = data_offset + n_records * record_bytes
    if needed > file_bytes:
        found = (file_bytes - data_offset) // record_bytes
        problem = (
            f"the header promises {n_records} records, {needed} bytes in all; found {file_bytes} bytes, "
            f"room for {found} records"
        )
        raise InputError(where, problem, "the file is cut short or its header lies; " + DAMAGED)
    if evlr_start is not None and data_offset <= evlr_start < needed:
        problem = (
            f"the header promises {n_records} records up to byte {needed}, but extended VLRs begin at byte "
            f"{evlr_start}, expected after the records"
        )
        raise InputError(where, problem, DAMAGED)


def _read_vlrs(handle: BinaryIO, where: str, start: int, end: int, count: int) -> list[Vlr]:
    if count * 54 > end - start:
        problem = f"{count} VLRs in {end - start} bytes before the records, expected at most {(end - start) // 54}"
        raise damaged(where, 100, problem)
    handle.seek(start)
    data = handle.read(end - start)
    vlrs = []
    position = 0
    for index in range(count):
        if position + 54 > len(data):
            problem = f"VLR {index + 1} of {count} lies beyond the start of the records (byte {end})"
            raise damaged(where, start + position, problem)
        user_id, record_id, length, description = struct.unpack_from("<2x16sHH32s", data, position)
        position += 54
        if length > len(data) - position:
            problem = f"VLR {index + 1} of {count} claims {length} bytes, {len(data) - position} are left"
            raise damaged(where, start + position - 54, f"{problem} before the records")
        content = data[position : position + length]
        vlrs.append(Vlr(text_of(user_id), record_id, text_of(description), length, content, extended=False))
        position += length
    return vlrs


def _read_evlrs(handle: BinaryIO, where: str, bounds: tuple[int, int, int], count: int) -> list[Vlr]:
    position, data_offset, file_bytes = bounds
    if not data_offset <= position <= file_bytes:
        problem = (
            f"extended VLRs begin at byte {position}, expected between {data_offset} and the file's end {file_bytes}"
        )
        raise damaged(where, 235, problem, "the file is cut short; " + DAMAGED)
    if count * 60 > file_bytes - position or count > MAX_EVLRS:
        most = min((file_bytes - position) // 60, MAX_EVLRS)
        raise damaged(where, 243, f"{count} extended VLRs, expected at most {most}")
    vlrs = []
    for index in range(count):
        handle.seek(position)
        head = handle.read(60)
        length = struct.unpack_from("<Q", head, 20)[0] if len(head) == 60 else 0
        left = file_bytes - position - 60
        if length > left or left < 0:
            problem = f"extended VLR {index + 1} of {count} claims {length} bytes, {max(left, 0)} are left in the file"
            raise damaged(where, position, problem, "the file is cut short; " + DAMAGED)
        user_id, record_id, _, description = struct.unpack("<2x16sHQ32s", head)
        content = handle.read(length) if length <= MAX_KEPT_EVLR_BYTES else None
        vlrs.append(Vlr(text_of(user_id), record_id, text_of(description), length, content, extended=True))
        position += 60 + length
    return vlrs


def text_of(raw: bytes) -> str:
    """Return a zero-terminated text; bytes that are no UTF-8 are shown as such, never an error."""
    return raw.split(b"\0")[0].decode("utf-8", "replace").strip()


def find_crs(header: LasHeader) -> str | None:
    """Return the coordinate system: WKT as it stands, else ``EPSG:CODE`` from GeoTIFF keys, else None."""
    for data in header.find("LASF_Projection", 2112):
        if text := text_of(data):
            return text
    for data in header.find("LASF_Projection", 34735):
        words = struct.unpack(f"<{len(data) // 2}H", data[: len(data) // 2 * 2])
        # entries of (key, where the value is, count, value); 0 = the value stands here; 32767 = user defined
        keys = {words[i]: words[i + 3] for i in range(4, len(words) - 3, 4) if words[i + 1] == 0}
        code = keys.get(3072) or keys.get(2048)
        if code and code < 32767:
            return f"EPSG:{code}"
    for data in header.find("liblas", 2112):
        if text := text_of(data):
            return text
    return None


def find_points_per_line(header: LasHeader) -> int | None:
    """Return M where this program wrote the file and said so in its provenance VLR, else None."""
    for data in header.find("prc-cli", 1):
        try:
            value = json.loads(data.rstrip(b"\0"))["stream"]["points_per_line"]
        except (ValueError, LookupError, TypeError, RecursionError):
            continue
        if isinstance(value, int) and not isinstance(value, bool) and value > 0:
            return value
    return None
