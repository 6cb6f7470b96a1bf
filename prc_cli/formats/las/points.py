"""Point records: the bytes and bits of every dimension, read and changed.

laspy defines the point formats and parses the extra-bytes descriptors. Records are (n, record
length) uint8 arrays, laid out as in the file (ASPRS LAS 1.4 R15, tables 7-17).
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import lazrs
import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError, OutputError
from prc_cli.core.types import U8
from prc_cli.formats.las.header import (
    DAMAGED,
    EXTRA_BYTES_KEY,
    LasHeader,
    Vlr,
    make_vlr,
    standard_bytes,
    text_of,
)
from prc_cli.formats.las.vlrs import VLR_LIMIT
from prc_cli.formats.names import usual_names
from prc_cli.formats.options import FACTORS
from prc_cli.formats.writing.columns import ExtraDimension

FORMAT_FOR_CODES = {0: 6, 1: 6, 2: 7, 3: 7, 4: 9, 5: 10}
"""By format with five-bit classes: the format with eight-bit classes and all its fields."""
SCAN_ANGLE_STEP_DEG = 0.006
"""Unit of the scan angle in formats 6-10 [deg]."""
_EXTRA_TEXT = "Extra Bytes Record"
DESCRIPTOR_BYTES = 192
"""Length of the descriptor of a dimension in an Extra Bytes VLR (LAS 1.4 R15, table 23)."""
_LAST_DATA_TYPE = 30
_RENAMED = {"gps_time": "time", "scan_angle": "angle", "scan_angle_rank": "angle"}
_ANGLE_RAD = {"scan_angle": math.radians(SCAN_ANGLE_STEP_DEG), "scan_angle_rank": math.radians(1.0)}
_AS_FLOAT = frozenset(("range", "time", "angle"))
_TAKEN = ("range", "scan_line", "column", "angle")
"""Standard dimensions that may be extra bytes with a usual name."""


@dataclass(frozen=True, slots=True)
class Field:
    """Decoding of a dimension: ``stored * scale + offset``, or some bits of ``stored``."""

    column: str
    """Field of the structured record."""
    mask: int | None = None
    scale: float | None = None
    offset: float = 0.0
    no_data: float | int | None = None
    """Stored value that means no data."""
    as_float: bool = False
    """Whether values are float64 whatever the stored type."""
    layer: str = "extra"
    """Dimension of the compressed layer that contains it (point formats 6-10)."""

    def decode(self, records: NDArray[Any]) -> NDArray[Any]:
        """Return the dimension as a new array, so that the raw records can be released."""
        stored = records[self.column]
        if self.mask is not None:
            return (stored & np.uint8(self.mask)) >> np.uint8(
                (self.mask & -self.mask).bit_length() - 1
            )
        # damaged records may hold any bits: NaN and infinity are counted later
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
class ExtraBytes:
    """Descriptor of an extra-bytes dimension."""

    name: str
    data_type: int
    """Number of the type in LAS 1.4 table 24."""
    description: str
    dtype: np.dtype[Any]
    """Type of one element; undocumented raw bytes have one element per byte."""
    n_values: int
    scale: float | None = None
    """None = not scaled."""
    offset: float = 0.0
    no_data: float | int | None = None
    place: int = 0
    """Its first byte in the record."""

    @property
    def n_bytes(self) -> int:
        """Bytes of a record."""
        return self.dtype.itemsize * self.n_values

    @property
    def type_name(self) -> str:
        """Type of its values in a record, for messages."""
        kind = f"V{self.n_bytes}" if self.data_type == 0 else self.dtype.str[1:]
        return kind if self.n_values == 1 else f"{self.n_values}{kind}"


@dataclass(frozen=True, slots=True)
class RecordLayout:
    """Fields of the records of a file."""

    dtype: np.dtype[Any]
    """Structured type of a stored record."""
    fields: dict[str, Field]
    """Dimension name -> decoding, in the order of the record."""
    extra: tuple[ExtraBytes, ...]
    """Described extra bytes that fit into the record, with unique names."""
    notes: tuple[str, ...]
    """Notices about extra bytes."""
    angle_name: str | None = None
    """Extra dimension of the scan angles; None = a field of the point format, if any."""
    range_name: str = "range"
    """Extra dimension of the slant range."""


@cache
def standard_columns(point_format: int) -> tuple[tuple[str, str], ...]:
    """Return the stored fields of a point format and their types."""
    import laspy

    return tuple(laspy.PointFormat(point_format).dtype().descr)


def read_layout(header: LasHeader) -> RecordLayout:
    """Combine the point format and the extra bytes."""
    from laspy.point.dims import COMPOSED_FIELDS

    columns: list[tuple[Any, ...]] = list(standard_columns(header.point_format))
    bits = COMPOSED_FIELDS[header.point_format]
    fields: dict[str, Field] = {}
    for axis, (name, scale, offset) in enumerate(
        zip("xyz", header.scales, header.offsets, strict=True)
    ):
        fields[name] = Field("XYZ"[axis], scale=scale, offset=offset, layer=name)
    for column, *_ in columns[3:]:
        if column in bits:
            fields |= {
                part.name: Field(column, mask=part.mask, layer=part.name) for part in bits[column]
            }
        else:
            name = _RENAMED.get(column, column)
            fields[name] = Field(
                column, scale=_ANGLE_RAD.get(column), as_float=name in _AS_FLOAT, layer=column
            )
    dimensions: list[ExtraBytes] = []
    described: dict[str, ExtraBytes] = {}
    notes: list[str] = []
    left = header.n_extra_bytes
    # a file may hold several of these VLRs, for consecutive extra bytes
    for extra in _described(str(header.path), header.find(EXTRA_BYTES_KEY)):
        if extra.n_bytes > left:
            what = f"extra bytes {extra.name!r} are described"
            notes.append(f"{what} but records of this size do not hold them: left out")
            continue
        name = extra.name
        while name in fields or name in {"X", "Y", "Z"}:
            name = f"extra_{name}"
        if name != extra.name and any(
            extra.name in (earlier.name, earlier.name.removeprefix("extra_"))
            for earlier in dimensions
        ):
            notes.append(
                f"several extra dimensions are named {extra.name!r}: "
                f"another one is read as {name!r}"
            )
        column = f"{name} {len(columns)}"  # a blank: no clash with a field of the point format
        kind = f"V{extra.n_bytes}" if extra.data_type == 0 else extra.dtype.str
        is_scalar = extra.n_values == 1 or extra.data_type == 0
        columns.append((column, kind) if is_scalar else (column, kind, (extra.n_values,)))
        dimensions.append(replace(extra, name=name, place=header.record_bytes - left))
        left -= extra.n_bytes
        if extra.data_type and is_scalar:  # raw bytes and vectors are not one number per record
            as_float = name in _AS_FLOAT
            fields[name] = Field(
                column, None, extra.scale, extra.offset, extra.no_data, as_float=as_float
            )
            described[name] = extra
    old_names = _take_usual(fields, described)
    if renamed := [
        f"{name_in_file} as {name}"
        for name, name_in_file in old_names.items()
        if name_in_file != name
    ]:
        notes.append(f"extra dimensions taken under another name: {', '.join(renamed)}")
    if left:
        columns.append(("undescribed bytes", f"V{left}"))
        notes.append(f"{left} bytes of every record are described nowhere and not read")
    angle_name = old_names.get("angle")
    range_name = old_names.get("range", "range")
    return RecordLayout(
        np.dtype(columns), fields, tuple(dimensions), tuple(notes), angle_name, range_name
    )


def _take_usual(fields: dict[str, Field], described: dict[str, ExtraBytes]) -> dict[str, str]:
    """Give extra dimensions with usual names standard ones; return old names by new name."""
    usual = usual_names([extra.name for extra in described.values()])
    names = list(described)
    taken: dict[str, str] = {}
    for standard in _TAKEN:
        column = usual.get(standard)
        if column is None or (standard in fields and standard not in ("angle", column.name)):
            continue
        field = fields.pop(names[column.index])
        unit = column.unit
        if standard == "angle":
            unit = unit or _unit_said(described[names[column.index]].description) or "deg"
            if "angle" in fields:
                fields["scan_angle"] = fields.pop("angle")
        if unit:
            factor = FACTORS[unit]
            field = replace(field, scale=(1.0 if field.scale is None else field.scale) * factor)
            field = replace(field, offset=field.offset * factor)
        fields[standard] = replace(field, as_float=standard in _AS_FLOAT)
        taken[standard] = column.name
    return taken


def _unit_said(description: str) -> str:
    """Return the unit in a description such as ``scan angle [rad]``; empty without one."""
    match = re.search(r"\b(rad|deg|gon)(?:ians?|rees?|s)?\b", description.lower())
    return "" if match is None else match[1]


def _described(where: str, contents: Iterable[bytes]) -> Iterator[ExtraBytes]:
    from laspy.vlrs.known import ExtraBytesStruct

    for data in contents:
        for start in range(0, len(data) - DESCRIPTOR_BYTES + 1, DESCRIPTOR_BYTES):
            yield _extra_bytes(
                f"{where}: extra bytes VLR", ExtraBytesStruct.from_buffer_copy(data, start)
            )


def _extra_bytes(where: str, entry: Any) -> ExtraBytes:
    name = text_of(entry.name) or "unnamed"
    if entry.data_type > _LAST_DATA_TYPE:
        problem = f"{name!r} has data type {entry.data_type}, expected 0 to {_LAST_DATA_TYPE}"
        raise InputError(where, problem, DAMAGED)
    if entry.data_type == 0:
        return ExtraBytes(name, 0, text_of(entry.description), np.dtype("u1"), entry.options)
    number = entry.dtype().base
    n_values = entry.num_elements()
    scale, offset = (
        None if value is None else float(value[0]) for value in (entry.scale, entry.offset)
    )
    if scale is None and offset is not None:
        scale = 1.0
    offset = 0.0 if offset is None else offset
    if (
        n_values == 1
        and scale is not None
        and not (0 < abs(scale) < math.inf and abs(offset) < math.inf)
    ):
        problem = f"{name!r} has scale {scale} and offset {offset}"
        raise InputError(
            where, f"{problem}, expected finite numbers and a scale other than 0", DAMAGED
        )
    no_data = _no_data(entry, number)
    return ExtraBytes(
        name,
        entry.data_type,
        text_of(entry.description),
        number,
        n_values,
        scale,
        offset,
        no_data,
    )


def _no_data(entry: Any, number: np.dtype[Any]) -> float | int | None:
    """Return the stored no-data value; laspy would convert values out of range to possible ones."""
    if not entry.options & entry.NO_DATA_BIT_MASK:
        return None
    value: float = struct.unpack_from(
        {"u": "<Q", "i": "<q", "f": "<d"}[number.kind], bytes(entry), 40
    )[0]
    if number.kind != "f":
        return value if np.iinfo(number).min <= value <= np.iinfo(number).max else None
    with np.errstate(over="ignore"):
        return float(number.type(value))


_LAYER = {
    **dict.fromkeys(
        ("x", "y", "return_number", "number_of_returns", "scanner_channel"), "XY_RETURNS_CHANNEL"
    ),
    **dict.fromkeys(
        (
            "synthetic",
            "key_point",
            "withheld",
            "overlap",
            "scan_direction_flag",
            "edge_of_flight_line",
        ),
        "FLAGS",
    ),
    **dict.fromkeys(("red", "green", "blue"), "RGB"),
    "extra": "ALL_EXTRA_BYTES",
}
"""Compressed layers with another name than their dimension."""


def layers_of(fields: Iterable[Field]) -> int:
    """Return the compressed layers of fields as bits for lazrs (point formats 6-10)."""
    selection = int(lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL)
    for field in fields:
        name = _LAYER.get(field.layer, field.layer.upper())
        # where no layer is known for a dimension, all are decoded
        selection |= int(
            getattr(lazrs, f"SELECTIVE_DECOMPRESS_{name}", lazrs.SELECTIVE_DECOMPRESS_ALL)
        )
    return selection


def descriptor(dimension: ExtraDimension) -> bytes:
    """Return the descriptor of a dimension, without minimum and maximum."""
    from laspy.vlrs.known import ExtraBytesStruct

    entry = ExtraBytesStruct.from_buffer_copy(bytes(DESCRIPTOR_BYTES))
    entry.data_type = data_type_of(dimension)
    entry.name = dimension.name.encode("ascii")
    entry.description = dimension.description.encode("ascii")
    return bytes(entry)


def data_type_of(dimension: ExtraDimension) -> int:
    """Return the number of its type in LAS 1.4 table 24."""
    from laspy.extradims import get_id_for_extra_dim_type

    return int(get_id_for_extra_dim_type(dimension.dtype))


def extra_bytes_vlr(dimensions: Sequence[ExtraDimension]) -> Vlr:
    """Return a new Extra Bytes VLR."""
    return make_vlr(EXTRA_BYTES_KEY, b"".join(map(descriptor, dimensions)), _EXTRA_TEXT)


def with_extra_dimensions(
    header: LasHeader,
    vlrs: list[Vlr],
    dimensions: Sequence[ExtraDimension],
    hint: str,
) -> list[Vlr]:
    """Return the VLRs with descriptors of new dimensions; bytes without a descriptor get one."""
    if not dimensions:
        return vlrs
    where = str(header.path)
    places = [index for index, vlr in enumerate(vlrs) if vlr.has(EXTRA_BYTES_KEY)]
    described = sum(
        extra.n_bytes for extra in _described(where, (vlrs[index].data or b"" for index in places))
    )
    hidden = header.n_extra_bytes - described
    elsewhere = any(vlr.has(EXTRA_BYTES_KEY) for vlr in header.evlrs)
    if hidden < 0 or elsewhere:
        place = "in an EVLR" if elsewhere else f"as {described} of {header.n_extra_bytes} bytes"
        problem = f"the extra bytes are described {place}, so no new ones can be added"
        raise OutputError(where, problem, hint)
    new = b""
    while hidden > 0:
        # type 0: the options field holds the length
        new += bytes((0, 0, 0, min(hidden, 255))).ljust(
            160, b"\0"
        ) + b"not described in the input".ljust(32, b"\0")
        hidden -= 255
    new += b"".join(map(descriptor, dimensions))
    if not places:
        return [*vlrs, make_vlr(EXTRA_BYTES_KEY, new, _EXTRA_TEXT)]
    last = vlrs[places[-1]]
    if last.n_bytes + len(new) > VLR_LIMIT:
        problem = f"the Extra Bytes VLR is full ({last.n_bytes} of {VLR_LIMIT} bytes)"
        raise OutputError(where, problem, hint)
    old = last.data or b""
    # readers refuse all descriptors if bytes follow the last whole one
    extended = last.with_data(old[: len(old) // DESCRIPTOR_BYTES * DESCRIPTOR_BYTES] + new)
    return [*vlrs[: places[-1]], extended, *vlrs[places[-1] + 1 :]]


def set_classes(records: U8, point_format: int, codes: U8) -> None:
    """Set the class codes of records in place; flag bits in the same byte stay."""
    if point_format >= 6:
        records[:, 16] = codes
        return
    if codes.size and int(codes.max()) > 31:
        message = (
            f"code {int(codes.max())} does not fit the five bits of point format {point_format}"
        )
        raise ValueError(message)
    records[:, 15] = (records[:, 15] & 0xE0) | codes


def upgrade(records: U8, point_format: int) -> U8:
    """Convert records of formats 0-5 to the matching format 6-10, classes and extra bytes included.

    Return number and count, scan direction, edge, the three flags and all fields of the same name
    are copied; the scan angle is converted from whole degrees to steps of 0.006 degrees; fields
    that the old format lacks (gps_time in 0 and 2, near infrared in 5, scanner channel, overlap)
    are zero.
    """
    new_format = FORMAT_FOR_CODES[point_format]
    n_extra = records.shape[1] - standard_bytes(point_format)
    extra = [("extra bytes", f"V{n_extra}")] if n_extra else []
    old = np.ascontiguousarray(records).view(np.dtype([*standard_columns(point_format), *extra]))[
        :, 0
    ]
    new = np.zeros(len(records), np.dtype([*standard_columns(new_format), *extra]))
    for name in set(old.dtype.names or ()) & set(new.dtype.names or ()):
        new[name] = old[name]
    returns = old["bit_fields"]
    class_byte = old["raw_classification"]
    new["bit_fields"] = (returns & 0x07) | ((returns & 0x38) << 1)
    new["classification_flags"] = (class_byte >> 5) | (returns & 0xC0)
    new["classification"] = class_byte & 0x1F
    new["scan_angle"] = np.rint(old["scan_angle_rank"].astype(np.float64) / SCAN_ANGLE_STEP_DEG)
    return new.view(np.uint8).reshape(len(records), new.dtype.itemsize)


def append_bytes(records: U8, columns: list[NDArray[Any]]) -> U8:
    """Append columns of little-endian numbers to records.

    >>> append_bytes(np.zeros((1, 2), np.uint8), [np.array([258], np.uint32)])
    array([[0, 0, 2, 1, 0, 0]], dtype=uint8)
    """
    parts = [records]
    for column in columns:
        little = np.ascontiguousarray(column, column.dtype.newbyteorder("<"))
        parts.append(little.view(np.uint8).reshape(len(records), -1))
    return np.concatenate(parts, axis=1)
