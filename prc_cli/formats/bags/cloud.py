"""Reads ``sensor_msgs/PointCloud2`` with the ring and the time of every point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32, F64, I64
from prc_cli.formats.bags.messages import Cursor, expect

CLOUD = "sensor_msgs/PointCloud2"
RINGS = ("ring", "channel", "laser_id")
TIMES = ("time", "t", "timestamp", "time_stamp", "offset_time", "time_offset")
LIGHTS = ("intensity", "reflectivity", "signal", "i")
SCAN_LINE = "scan_line"
"""Field of clouds that prc writes: the scan line of a point, from which staggering follows."""
TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
Position: TypeAlias = tuple[float, float, float]
_NO_RINGS = (
    "let the driver write the ring and the time of every point; "
    "Livox and other scanners without rings are not supported"
)
_OPTIONAL = ("light", "time", "line")
_MAX_FIELDS = 100
_ABSOLUTE_S = 2.0
"""Times with a larger median do not start at the stamp of the message, which is shorter [s]."""


@dataclass(frozen=True, slots=True)
class Cloud:
    """A message, decoded; points in its order, those without coordinates included."""

    frame: str
    stamp_s: float
    """Time of the message [s]."""
    ring: I64
    """(n,) int64."""
    time: F64
    """(n,) float64, as stored: see :meth:`times`; NaN if points have none."""
    usual_unit_s: float
    """Usual unit of stored times: floats are seconds, integers are nanoseconds [s]."""
    xyz_m: F32
    """(n, 3) float32 [m]; NaN = no return."""
    range_m: F32
    """(n,) float32 [m]."""
    intensity: F32
    """(n,) float32, NaN if there is none."""
    scan_line: I64 | None = None
    """(n,) int64, scan line as written by prc."""

    @property
    def n_records(self) -> int:
        """Points, with and without coordinates."""
        return len(self.ring)

    @property
    def has_times(self) -> bool:
        """Whether the times of the points differ."""
        known = self.time[np.isfinite(self.time) & np.isfinite(self.range_m)]
        return len(known) > 0 and float(known.min()) < float(known.max())

    def times(self, unit_s: float) -> F64:
        """Return the time of every point, (n,) float64 [s]; ``unit_s`` is the unit as stored."""
        with np.errstate(all="ignore"):
            time_s: F64 = self.time * unit_s
        # empty points may have no time of their own
        known = time_s[np.isfinite(time_s) & np.isfinite(self.range_m)]
        is_absolute = len(known) > 0 and float(np.median(np.abs(known))) > _ABSOLUTE_S
        return time_s if is_absolute else time_s + self.stamp_s


def parse_cloud(
    data: bytes,
    *,
    is_cdr: bool,
    scale: float = 1.0,
    origin_m: Position = (0.0, 0.0, 0.0),
) -> Cloud:
    """Decode a message whose coordinates are in a unit [m].

    ``origin_m`` is the place of the scanner in them, from which ranges are measured [m].
    """
    cursor = Cursor(data, is_cdr=is_cdr)
    stamp_s, frame = cursor.header()
    height, width, n_fields = (cursor.number("I") for _ in range(3))
    expect(
        n_fields <= _MAX_FIELDS,
        f"says that a point has {n_fields} fields, expected at most {_MAX_FIELDS}",
    )
    fields = {}
    for _ in range(n_fields):
        name = cursor.text()
        offset = cursor.number("I")
        kind = cursor.number("B")
        _ = cursor.number("I")
        fields[name] = (offset, kind)
    order = ">" if cursor.number("B") else "<"
    step = cursor.number("I")
    row_step = cursor.number("I")
    raw = cursor.array("u1")
    n_row = width * step
    expect(
        height <= 1 or row_step >= n_row,
        f"says that {width} points of {step} bytes are a row of {row_step}",
    )
    row_step = max(row_step, n_row)
    is_whole = not height or row_step * (height - 1) + n_row <= len(raw)
    expect(
        is_whole, f"says it holds {height} x {width} points of {step} bytes, found {len(raw)} bytes"
    )
    # rows may be longer than their points
    rows = np.lib.stride_tricks.as_strided(
        raw, (height, n_row) if n_row else (0, step), (row_step, 1), writeable=False
    )
    table = np.frombuffer(rows.tobytes(), _point(fields, step, order))
    return _decoded(frame, stamp_s, table, scale, origin_m)


def _point(fields: dict[str, tuple[int, int]], step: int, order: str) -> np.dtype[np.void]:
    """Return the type of a point: x, y, z, ring, and time, light, line if present."""
    names = {
        "x": ("x",),
        "y": ("y",),
        "z": ("z",),
        "ring": RINGS,
        "time": TIMES,
        "light": LIGHTS,
        "line": (SCAN_LINE,),
    }
    parts = {}
    lacking = []
    for part, usual_names in names.items():
        name = next((name for name in usual_names if name in fields), None)
        if name is not None:
            parts[part] = fields[name]
        elif part not in _OPTIONAL:
            lacking.append(part)
    shown = ", ".join(fields)[:200]
    # beams of a Livox draw rosettes, and its ``line`` is a laser, no cone
    is_livox = "tag" in fields and ("line" in fields or "ring" in fields)
    expect(not is_livox, f"has points of a Livox (fields: {shown}), expected rings", _NO_RINGS)
    has_all = bool(step) and not lacking
    hint = _NO_RINGS if lacking == ["ring"] else ""
    expect(has_all, f"has points without {', '.join(lacking) or 'bytes'} (fields: {shown})", hint)
    has_types = all(kind in TYPES for _, kind in parts.values())
    expect(has_types, "has fields of an unknown type")
    kinds = [np.dtype(order + TYPES[kind]) for _, kind in parts.values()]
    offsets = [offset for offset, _ in parts.values()]
    ends = [offset + kind.itemsize for offset, kind in zip(offsets, kinds, strict=True)]
    expect(max(ends) <= step, f"has fields beyond the {step} bytes of a point")
    return np.dtype({"names": list(parts), "formats": kinds, "offsets": offsets, "itemsize": step})


def _decoded(
    frame: str,
    stamp_s: float,
    table: NDArray[np.void],
    scale: float,
    origin_m: Position,
) -> Cloud:
    xyz: F32 = np.empty((len(table), 3), np.float32)
    with np.errstate(all="ignore"):
        for axis, name in enumerate("xyz"):
            if origin_m[axis]:
                # coordinates of a map need float64 for millimetres
                xyz[:, axis] = table[name].astype(np.float64) * scale - origin_m[axis]
            else:
                xyz[:, axis] = table[name]
                xyz[:, axis] *= np.float32(scale)
        squares = xyz.astype(np.float64) ** 2
        ranges: F32 = np.sqrt(squares[:, 0] + squares[:, 1] + squares[:, 2]).astype(np.float32)
        is_missing = ~(np.isfinite(ranges) & (ranges > 0))
        if is_missing.any():
            xyz[is_missing] = np.nan
            ranges[is_missing] = np.nan
        has_times = "time" in (table.dtype.names or ())
        times = table["time"].astype(np.float64) if has_times else np.full(len(table), np.nan)
        unit_s = 1e-9 if has_times and table.dtype["time"].kind in "iu" else 1.0
        stored = table["ring"]
        if stored.dtype.kind == "f":
            stored = np.where(np.isfinite(stored), stored, -1).clip(-1, 1 << 20)
        rings: I64 = stored.astype(np.int64).clip(-1, 1 << 20)
        has_light = "light" in (table.dtype.names or ())
        intensity = (
            table["light"].astype(np.float32)
            if has_light
            else np.full(len(table), np.nan, np.float32)
        )
    has_lines = "line" in (table.dtype.names or ()) and table.dtype["line"].kind in "iu"
    scan_line = table["line"].astype(np.int64) if has_lines else None
    return Cloud(frame, stamp_s, rings, times, unit_s, xyz, ranges, intensity, scan_line)
