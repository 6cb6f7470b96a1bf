"""Which bytes and bits of a LAS record hold which dimension, and how they are decoded."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.formats.las.header import (
    DAMAGED,
    RECORD_BYTES,
    LasHeader,
    text_of,
)

_Columns: TypeAlias = tuple[tuple[str, str], ...]
_Bits: TypeAlias = dict[str, dict[str, int]]

_XYZ: _Columns = (("X", "<i4"), ("Y", "<i4"), ("Z", "<i4"))
_OLD: _Columns = (
    *_XYZ, ("intensity", "<u2"), ("bit_fields", "|u1"), ("raw_classification", "|u1"), ("scan_angle_rank", "|i1"),
    ("user_data", "|u1"), ("point_source_id", "<u2"),
)  # fmt: skip
_TIME: _Columns = (("gps_time", "<f8"),)
_NEW: _Columns = (
    *_XYZ, ("intensity", "<u2"), ("bit_fields", "|u1"), ("classification_flags", "|u1"), ("classification", "|u1"),
    ("user_data", "|u1"), ("scan_angle", "<i2"), ("point_source_id", "<u2"), *_TIME,
)  # fmt: skip
_COLOUR: _Columns = (("red", "<u2"), ("green", "<u2"), ("blue", "<u2"))
_NIR: _Columns = (("nir", "<u2"),)
_WAVE: _Columns = (
    ("wavepacket_index", "|u1"), ("wavepacket_offset", "<u8"), ("wavepacket_size", "<u4"),
    ("return_point_wave_location", "<f4"), ("x_t", "<f4"), ("y_t", "<f4"), ("z_t", "<f4"),
)  # fmt: skip
RECORD_COLUMNS: tuple[_Columns, ...] = (
    _OLD,
    (*_OLD, *_TIME),
    (*_OLD, *_COLOUR),
    (*_OLD, *_TIME, *_COLOUR),
    (*_OLD, *_TIME, *_WAVE),
    (*_OLD, *_TIME, *_COLOUR, *_WAVE),
    _NEW,
    (*_NEW, *_COLOUR),
    (*_NEW, *_COLOUR, *_NIR),
    (*_NEW, *_WAVE),
    (*_NEW, *_COLOUR, *_NIR, *_WAVE),
)
"""Stored fields and their types by point format (ASPRS LAS 1.4 R15, tables 7-17); written out here, since importing
laspy for them would take 20 MiB."""
_OLD_BITS: _Bits = {
    "bit_fields": {
        "return_number": 0x07, "number_of_returns": 0x38, "scan_direction_flag": 0x40, "edge_of_flight_line": 0x80,
    },
    "raw_classification": {"classification": 0x1F, "synthetic": 0x20, "key_point": 0x40, "withheld": 0x80},
}  # fmt: skip
_NEW_BITS: _Bits = {
    "bit_fields": {"return_number": 0x0F, "number_of_returns": 0xF0},
    "classification_flags": {
        "synthetic": 0x01, "key_point": 0x02, "withheld": 0x04, "overlap": 0x08, "scanner_channel": 0x30,
        "scan_direction_flag": 0x40, "edge_of_flight_line": 0x80,
    },
}  # fmt: skip
_FIRST_NEW = 6
"""Point formats from here on have four bits for return numbers and eight for classes."""
_DESCRIPTOR_BYTES = 192
_NUMBERS = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
"""Numpy types of the extra-bytes data types 1 to 10; 11 to 30 are pairs and triples of them."""
_RENAMED = {"gps_time": "time", "scan_angle": "angle", "scan_angle_rank": "angle"}
_ANGLE_RAD = {"scan_angle": math.radians(0.006), "scan_angle_rank": math.radians(1.0)}
_AS_FLOAT = frozenset(("range", "time", "angle"))


@dataclass(frozen=True, slots=True)
class Field:
    """How one dimension is decoded: ``stored * scale + offset``, or some bits of ``stored``."""

    column: str
    """Field of the structured record."""
    mask: int | None = None
    scale: float | None = None
    offset: float = 0.0
    no_data: float | int | None = None
    """Stored value that means none."""
    as_float: bool = False
    """float64 even where the stored number is another."""
    layer: str = "extra"
    """Dimension whose compressed layer holds it (point formats 6-10)."""

    def decode(self, records: NDArray[Any]) -> NDArray[Any]:
        """Return the dimension as an array of its own, so that the raw records can go."""
        stored = records[self.column]
        if self.mask is not None:
            return (stored & np.uint8(self.mask)) >> np.uint8((self.mask & -self.mask).bit_length() - 1)
        # damaged records may hold any bits: what is no number stays NaN or infinite and is counted later
        with np.errstate(invalid="ignore", over="ignore"):
            if self.scale is not None:
                values = stored * np.float64(self.scale) + np.float64(self.offset)
            elif self.as_float or self.no_data is not None:
                values = stored.astype(np.float64)
            else:
                return np.array(stored)
        if self.no_data is not None:
            values[stored == self.no_data] = np.nan
        return values


@dataclass(frozen=True, slots=True)
class RecordLayout:
    """The record of a file."""

    dtype: np.dtype[Any]
    """Structured type of a stored record."""
    fields: dict[str, Field]
    """Dimension name -> how it is decoded, in the order of the record."""
    extra: tuple[dict[str, Any], ...]
    """What the extra-bytes VLRs say of every dimension: name, type, description, scaled."""
    notes: tuple[str, ...]
    """What in the description does not fit the record."""


def bits_of(point_format: int) -> _Bits:
    """Return the dimensions that share a byte with others: its name, then the bits of each."""
    return _NEW_BITS if point_format >= _FIRST_NEW else _OLD_BITS


def read_layout(where: str, header: LasHeader) -> RecordLayout:
    """Put together the point format and the extra bytes.

    Raises
    ------
    InputError
        When an extra-bytes descriptor makes no sense.
    """
    point_format = header.point_format
    columns: list[tuple[Any, ...]] = list(RECORD_COLUMNS[point_format])
    bits = bits_of(point_format)
    fields: dict[str, Field] = {}
    for axis, (name, scale, offset) in enumerate(zip("xyz", header.scales, header.offsets, strict=True)):
        fields[name] = Field("XYZ"[axis], scale=scale, offset=offset, layer=name)
    for column, *_ in columns[3:]:
        parts = bits.get(column)
        if parts is None:
            name = _RENAMED.get(column, column)
            fields[name] = Field(column, scale=_ANGLE_RAD.get(column), as_float=name in _AS_FLOAT, layer=column)
        else:
            fields |= {name: Field(column, mask=mask, layer=name) for name, mask in parts.items()}
    described: list[dict[str, Any]] = []
    notes: list[str] = []
    left = header.record_bytes - RECORD_BYTES[point_format]
    # a file may hold several of these VLRs, each describes the bytes that follow those of the one before
    for data in header.find("LASF_Spec", 4):
        for start in range(0, len(data) - _DESCRIPTOR_BYTES + 1, _DESCRIPTOR_BYTES):
            left = _add_extra(where, data[start : start + _DESCRIPTOR_BYTES], left, (columns, fields, described, notes))
    if left:
        columns.append(("undescribed bytes", f"V{left}"))
        notes.append(f"{left} bytes of every record are described nowhere and not read")
    return RecordLayout(np.dtype(columns), fields, tuple(described), tuple(notes))


def _add_extra(
    where: str,
    descriptor: bytes,
    left: int,
    result: tuple[list[tuple[Any, ...]], dict[str, Field], list[dict[str, Any]], list[str]],
) -> int:
    """Add one extra-bytes dimension; return how many bytes of the record are left after it."""
    columns, fields, described, notes = result
    place = f"{where}: extra bytes VLR"
    data_type, options = descriptor[2], descriptor[3]
    name = text_of(descriptor[4:36]) or "unnamed"
    if data_type > 30:
        problem = f"{name!r} has data type {data_type}, expected 0 to 30"
        raise InputError(place, problem, DAMAGED)
    number = _NUMBERS[(data_type - 1) % 10]
    kind = f"V{options}" if data_type == 0 else number
    n_values = 1 if data_type == 0 else (data_type - 1) // 10 + 1
    n_bytes = np.dtype(kind).itemsize * n_values
    if n_bytes > left:
        notes.append(f"extra bytes {name!r} are described but records of this size do not hold them: left out")
        return left
    while name in fields or name in {"X", "Y", "Z"}:
        name = f"extra_{name}"
    column = f"{name} {len(columns)}"  # a blank: no clash with a field of the point format
    columns.append((column, kind, (n_values,)) if n_values > 1 else (column, kind))
    scaled = bool(options & 0x18) and data_type != 0
    described.append(
        {
            "name": name,
            "type": kind if n_values == 1 else f"{n_values}{kind}",
            "description": text_of(descriptor[160:192]),
            "scaled": scaled,
        }
    )
    if data_type == 0 or n_values > 1:
        return left - n_bytes  # neither raw bytes nor vectors are one number a record
    scale, offset = struct.unpack_from("<d16xd", descriptor, 112)
    scale, offset = (scale if options & 0x08 else 1.0), (offset if options & 0x10 else 0.0)
    if scaled and not (0 < abs(scale) < math.inf and abs(offset) < math.inf):
        problem = f"{name!r} has scale {scale} and offset {offset}, expected finite numbers and a scale other than 0"
        raise InputError(place, problem, DAMAGED)
    wide = {"u": "<Q", "i": "<q", "f": "<d"}[number[0]]
    no_data = struct.unpack_from(wide, descriptor, 40)[0] if options & 0x01 else None
    if no_data is not None and number[0] != "f":
        bounds = np.iinfo(number)
        no_data = no_data if bounds.min <= no_data <= bounds.max else None  # cannot occur
    elif number == "f4" and no_data is not None:
        with np.errstate(over="ignore"):
            no_data = float(np.float32(no_data))
    fields[name] = Field(column, None, scale if scaled else None, offset, no_data, as_float=name in _AS_FLOAT)
    return left - n_bytes


def layers_of(fields: list[Field]) -> int:
    """Return which compressed layers hold these fields, as lazrs wants it (point formats 6-10)."""
    import lazrs

    selection = int(lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL)
    for field in fields:
        layer = _LAYER.get(field.layer)
        if layer is None:
            # a dimension without a layer of its own: better too much than too little
            layer = "ALL_EXTRA_BYTES" if field.layer == "extra" else "ALL"
        if layer:
            selection |= int(getattr(lazrs, f"SELECTIVE_DECOMPRESS_{layer}"))
    return selection


_LAYER = {
    **dict.fromkeys(("x", "y", "return_number", "number_of_returns", "scanner_channel"), ""),
    "z": "Z",
    "classification": "CLASSIFICATION",
    **dict.fromkeys(
        ("synthetic", "key_point", "withheld", "overlap", "scan_direction_flag", "edge_of_flight_line"), "FLAGS"
    ),
    "intensity": "INTENSITY",
    "scan_angle": "SCAN_ANGLE",
    "user_data": "USER_DATA",
    "point_source_id": "POINT_SOURCE_ID",
    "gps_time": "GPS_TIME",
    **dict.fromkeys(("red", "green", "blue"), "RGB"),
    "nir": "NIR",
    **dict.fromkeys(
        ("wavepacket_index", "wavepacket_offset", "wavepacket_size", "return_point_wave_location", "x_t", "y_t", "z_t"),
        "WAVEPACKET",
    ),
}
