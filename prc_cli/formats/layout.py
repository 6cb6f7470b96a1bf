"""The record layout of raw dumps and text files: numpy record type, and decoding of stored numbers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError
from prc_cli.formats.options import Layout, LayoutField

FACTORS = {
    "m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048,
    "s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9,
    "rad": 1.0, "deg": math.pi / 180, "gon": math.pi / 200,
}  # fmt: skip
"""Metres, seconds or radians in one of a unit; ft is the international foot."""
_LENGTHS = ("", "m", "cm", "mm", "ft")
UNITS = {
    "range": _LENGTHS,
    "x": _LENGTHS,
    "y": _LENGTHS,
    "z": _LENGTHS,
    "time": ("", "s", "ms", "us", "ns"),
    "angle": ("", "deg", "rad", "gon"),
}
"""Units allowed for fields of a standard name; use ``scale`` to convert others."""


def record_dtype(layout: Layout) -> np.dtype[np.void]:
    """Return a layout as a numpy record type.

    >>> layout = Layout(endian="big", record_bytes=8, fields=(LayoutField(name="range", type="u2", scale=0.01),))
    >>> dtype = record_dtype(layout)
    >>> dtype.itemsize, dtype["range"].str
    (8, '>u2')
    """
    if not layout.fields:
        raise ConfigError("layout.fields", "none given, expected at least one field", "add a [[layout.fields]] table")
    check_fields(layout)
    types = [np.dtype(item.type).newbyteorder(layout.endian) for item in layout.fields]
    for item, stored in zip(layout.fields, types, strict=True):
        _check_missing(item, stored)
    ends = np.cumsum([stored.itemsize for stored in types]).tolist()
    size = ends[-1] if layout.record_bytes is None else layout.record_bytes
    if size < ends[-1]:
        problem = f"found {size}, but the fields take {ends[-1]} bytes"
        raise ConfigError("layout.record_bytes", problem, f"leave it out or give {ends[-1]} or more")
    return np.dtype(
        {
            "names": [item.name for item in layout.fields],
            "formats": types,
            "offsets": [0, *ends[:-1]],
            "itemsize": size,
        }
    )


def check_fields(layout: Layout) -> None:
    """Refuse units that do not belong to their field."""
    for item in layout.fields:
        known = UNITS.get(item.name)
        if known is not None and item.unit not in known:
            expected = " or ".join(unit for unit in known if unit)
            problem = f"field {item.name!r}: found unit {item.unit!r}, expected {expected}"
            raise ConfigError("layout.fields", problem, "convert with scale and offset")


def _check_missing(item: LayoutField, stored: np.dtype[Any]) -> None:
    """Refuse a missing value that the type cannot hold, because it would never match."""
    if item.missing is None:
        return
    if stored.kind == "f":
        fits = abs(item.missing) <= float(np.finfo(stored).max)
    else:
        bounds = np.iinfo(stored)
        fits = item.missing == int(item.missing) and bounds.min <= int(item.missing) <= bounds.max
    if not fits:
        problem = f"field {item.name!r}: found missing = {item.missing:g}, which {item.type} cannot hold"
        raise ConfigError("layout.fields", problem, "give the value as it is stored, before scale and offset")


def decode(stored: NDArray[Any], item: LayoutField) -> NDArray[Any]:
    """Turn stored numbers into values: ``stored * scale + offset`` in the unit of the field, NaN where missing.

    Values are in metres, seconds and radians.

    >>> import numpy as np
    >>> decode(np.array([12_345, 0], "<i4"), LayoutField(name="range", type="i4", scale=0.001, missing=0))
    array([12.345,    nan])
    """
    factor = 1.0 if item.unit in ("", "deg") else FACTORS[item.unit]
    plain = item.scale == 1.0 and item.offset == 0.0 and factor == 1.0
    missing = None if item.missing is None else stored == np.array(item.missing).astype(stored.dtype)
    if plain and missing is None and stored.dtype.kind in "iu" and item.name not in UNITS:
        return np.ascontiguousarray(stored, dtype=stored.dtype.newbyteorder("="))
    narrow = plain and item.name == "range" and stored.dtype.kind == "f" and stored.dtype.itemsize <= 4
    with np.errstate(over="ignore", invalid="ignore"):
        # a buffer read only for this need not be copied
        kept = item.name == "range" and plain and missing is None
        own = stored.flags.c_contiguous and (stored.flags.writeable or kept)
        values: NDArray[np.floating[Any]] = stored.astype(np.float32 if narrow else np.float64, copy=not own)
        if not plain:
            values *= item.scale
            values += item.offset
            if factor != 1.0:
                values *= factor
    if item.name == "angle" and item.unit in ("", "deg"):
        values = np.deg2rad(values)
    if missing is not None:
        values[missing] = np.nan
    return values
