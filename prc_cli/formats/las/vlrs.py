"""The VLRs that a LAS output gains: the run record, extra bytes, laszip, a WKT coordinate system."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from prc_cli.core.errors import OutputError
from prc_cli.formats.las.file import (
    EVLR_HEADER,
    VLR_HEADER,
    LasFile,
    Vlr,
)
from prc_cli.formats.writing.record import RunRecord

RECORD_KEY = ("prc-cli", 1)
EXTRA_BYTES_KEY = ("LASF_Spec", 4)
WKT_KEY = ("LASF_Projection", 2112)
GEO_KEYS_KEY = ("LASF_Projection", 34735)
COPC_USER = "copc"
VLR_LIMIT = 65_535
"""Largest payload of a VLR [bytes]."""
WKT_BIT = 16
"""Global encoding: the coordinate system is WKT."""

_RECORD_TEXT = "prc run record"
_DESCRIPTOR = struct.Struct("<2xBB32s124x32s")
_DTYPES: dict[int, np.dtype[Any]] = {1: np.dtype("u1"), 5: np.dtype("<u4"), 9: np.dtype("<f4")}
_SIZES = (0, 1, 1, 2, 2, 4, 4, 8, 8, 4, 8)  # bytes by data type 1-10; 11-20 two, 21-30 three of them


@dataclass(frozen=True, slots=True)
class ExtraDimension:
    """A dimension kept in extra bytes."""

    name: str
    data_type: int
    """Type number of LAS 1.4 table 24: 1 uint8, 5 uint32, 9 float32."""
    description: str
    """At most 32 characters."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """Type of a value."""
        return _DTYPES[self.data_type]

    def descriptor(self) -> bytes:
        """Return the 192 bytes that describe the dimension."""
        return _DESCRIPTOR.pack(self.data_type, 0, self.name.encode("ascii"), self.description.encode("ascii"))


RANGE = ExtraDimension("range", 9, "slant range [m]")
SCAN_LINE = ExtraDimension("scan_line", 5, "scan line in the stream")
COLUMN = ExtraDimension("column", 5, "shot in the scan line")


def make_vlr(key: tuple[str, int], payload: bytes, description: str) -> Vlr:
    """Return a VLR; the payload must fit :data:`VLR_LIMIT`."""
    header = VLR_HEADER.pack(0, key[0].encode("ascii"), key[1], len(payload), description.encode("ascii"))
    return Vlr(header + payload)


def record_vlr(record: RunRecord) -> Vlr:
    """Return the run record as a VLR, in short form if it is longer than a VLR may be."""
    return make_vlr(RECORD_KEY, record.to_json_within(VLR_LIMIT), _RECORD_TEXT)


def record_evlr(record: RunRecord) -> bytes:
    """Return the run record as an EVLR, header and payload: any length."""
    payload = record.to_json()
    return EVLR_HEADER.pack(0, RECORD_KEY[0].encode(), RECORD_KEY[1], len(payload), _RECORD_TEXT.encode()) + payload


def extra_bytes_vlr(dimensions: Sequence[ExtraDimension]) -> Vlr:
    """Return a new Extra Bytes VLR."""
    return make_vlr(EXTRA_BYTES_KEY, b"".join(item.descriptor() for item in dimensions), "Extra Bytes Record")


def find_dimension(las: LasFile, name: str) -> tuple[int, int] | None:
    """Return where a described extra dimension lies in the record, and its type number; None if absent."""
    offset = las.record_length - las.n_extra_bytes
    for data_type, options, found in _described(las.vlrs):
        if found == name:
            return offset, data_type
        offset += _size(data_type, options)
    return None


def with_extra_dimensions(las: LasFile, vlrs: list[Vlr], dimensions: Sequence[ExtraDimension], hint: str) -> list[Vlr]:
    """Return the VLRs with dimensions described behind those that the records have already.

    Bytes of the record that no VLR describes get an undocumented entry, so that the new ones are found. ``hint`` says
    what to do about an error.

    Raises
    ------
    OutputError
        When the VLRs describe more than the records hold, lie where they cannot grow, or are full.
    """
    if not dimensions:
        return vlrs
    described = sum(_size(data_type, options) for data_type, options, _ in _described(vlrs))
    hidden = las.n_extra_bytes - described
    elsewhere = any(evlr.key == EXTRA_BYTES_KEY for evlr in las.evlrs)
    if hidden < 0 or elsewhere:
        found = "in an EVLR" if elsewhere else f"as {described} bytes for the {las.n_extra_bytes} that records have"
        problem = f"found the extra bytes described {found}, expected an Extra Bytes VLR that can be extended"
        raise OutputError(str(las.path), problem, hint)
    new = b""
    while hidden > 0:
        new += _DESCRIPTOR.pack(0, min(hidden, 255), b"", b"not described in the input")
        hidden -= 255
    new += b"".join(item.descriptor() for item in dimensions)
    places = [index for index, vlr in enumerate(vlrs) if vlr.key == EXTRA_BYTES_KEY]
    if not places:
        return [*vlrs, make_vlr(EXTRA_BYTES_KEY, new, "Extra Bytes Record")]
    last = vlrs[places[-1]]
    if len(last.payload) + len(new) > VLR_LIMIT:
        problem = f"the Extra Bytes VLR is full ({len(last.payload)} of {VLR_LIMIT} bytes)"
        raise OutputError(str(las.path), problem, hint)
    grown = last.with_payload(last.payload + new)
    return [*vlrs[: places[-1]], grown, *vlrs[places[-1] + 1 :]]


def with_wkt(vlrs: list[Vlr], point_format: int) -> tuple[list[Vlr], str | None]:
    """Return the VLRs with a WKT coordinate system, as point formats 6-10 want it, and what to tell about it.

    GeoTIFF keys stay; a WKT is derived from their EPSG codes where pyproj is installed.
    """
    keys = {vlr.key: vlr for vlr in vlrs}
    if WKT_KEY in keys:
        return vlrs, "the coordinate system is now read from the file's own WKT"
    if GEO_KEYS_KEY not in keys:
        return vlrs, None
    wkt, text = _wkt_of_geo_keys(keys[GEO_KEYS_KEY].payload)
    if wkt is None or len(wkt) > VLR_LIMIT:
        return vlrs, (
            f"point format {point_format} wants its coordinate system as WKT, which could not be derived ({text}); "
            "the GeoTIFF keys were kept"
        )
    return [*vlrs, make_vlr(WKT_KEY, wkt, "OGC COORDINATE SYSTEM WKT")], f"coordinate system {text} added as WKT"


def _wkt_of_geo_keys(payload: bytes) -> tuple[bytes | None, str]:
    """WKT (null-terminated) of GeoTIFF keys, and the EPSG codes or the reason why there is none."""
    numbers = struct.unpack(f"<{len(payload) // 2}H", payload[: len(payload) // 2 * 2])
    entries = {numbers[i]: numbers[i + 3] for i in range(4, len(numbers) - 3, 4) if numbers[i + 1] == 0}
    horizontal = entries.get(3072) or entries.get(2048)  # projected, else geographic
    if not horizontal or horizontal == 32767:
        return None, "the GeoTIFF keys name no EPSG code"
    vertical = entries.get(4096, 32767)
    try:
        import pyproj
    except ImportError:
        return None, "pyproj is not installed; pip install prc-cli[crs]"
    tries = [(f"EPSG:{horizontal}", "")]
    if vertical != 32767:
        # old files give the code of a vertical datum, which is no coordinate system
        tries = [
            (f"EPSG:{horizontal}+{vertical}", ""),
            (f"EPSG:{horizontal}", f" (vertical code {vertical} is no EPSG system and was left out)"),
        ]
    problem = ""
    for text, remark in tries:
        try:
            wkt = pyproj.CRS.from_user_input(text).to_wkt("WKT1_GDAL")
            return wkt.encode("ascii") + b"\0", text + remark
        except (pyproj.exceptions.CRSError, UnicodeEncodeError) as error:
            problem = f"{text}: {error}"
    return None, problem


def _described(vlrs: Sequence[Vlr]) -> list[tuple[int, int, str]]:
    """Type, options and name of every described extra dimension, in order."""
    found = []
    for vlr in vlrs:
        if vlr.key == EXTRA_BYTES_KEY:
            payload = vlr.payload
            for at in range(0, len(payload) - 191, 192):
                data_type, options, name, _ = _DESCRIPTOR.unpack_from(payload, at)
                found.append((data_type, options, name.split(b"\0", 1)[0].decode("latin-1")))
    return found


def _size(data_type: int, options: int) -> int:
    if data_type == 0:
        return options
    return _SIZES[(data_type - 1) % 10 + 1] * ((data_type - 1) // 10 + 1)
