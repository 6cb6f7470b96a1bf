"""Decode the lidar packets of Ouster scanners, with the metadata (JSON) of the sensor.

A packet has columns; a column has a time stamp, a number within the frame, a status and a pixel a
ring (Ouster firmware user manual, "Lidar data packet format": LEGACY, and the profiles
RNG19_RFL8_SIG16_NIR16, its _DUAL form and RNG15_RFL8_NIR8). The lasers of a column point to
different azimuths, by whole columns of the frame (``pixel_shift_by_row``): a line is made of the
shots that point along it.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.files import read_small
from prc_cli.core.types import F32, F64, I64, U8
from prc_cli.formats.firings import Columns, choose, columns_of

MAX_METADATA = 1 << 20
"""Longest metadata file [bytes]."""
_MAX_COLUMNS = 4096
_MAX_PIXELS = 256
_FRAME_IDS = 1 << 16
_MOST = 1e6
"""Larger numbers are not angles, columns or millimetres."""


class _Return(NamedTuple):
    """Fields of a return in a pixel."""

    position: int
    """First byte of the range."""
    dtype: str
    mask: int
    """Bits of the range."""
    unit_m: float
    light_position: int
    """First byte of the signal, or of the reflectivity."""
    light_dtype: str


class _Profile(NamedTuple):
    """Bytes of the parts of a packet, and fields of a pixel."""

    size: int
    """Bytes of a pixel."""
    returns: tuple[_Return, ...]
    head: int = 32
    column: int = 12
    foot: int = 0
    end: int = 32


_PROFILES = {
    "LEGACY": _Profile(
        12, (_Return(0, "<u4", 0xFFFFF, 1e-3, 6, "<u2"),), head=0, column=16, foot=4, end=0
    ),
    "RNG19_RFL8_SIG16_NIR16": _Profile(12, (_Return(0, "<u4", 0x7FFFF, 1e-3, 6, "<u2"),)),
    "RNG15_RFL8_NIR8": _Profile(4, (_Return(0, "<u2", 0x7FFF, 8e-3, 2, "u1"),)),
    "RNG19_RFL8_SIG16_NIR16_DUAL": _Profile(
        16,
        (
            _Return(0, "<u4", 0x7FFFF, 1e-3, 8, "<u2"),
            _Return(4, "<u4", 0x7FFFF, 1e-3, 10, "<u2"),
        ),
    ),
}


@dataclass(frozen=True, slots=True)
class Metadata:
    """Metadata of a sensor."""

    path: str
    name: str
    """Product line."""
    profile: str
    n_pixels: int
    """Pixels of a column."""
    n_columns: int
    """Columns of a packet."""
    frame_columns: int
    """Columns of a turn."""
    window: tuple[int, int]
    """First and last column that is sent."""
    altitude_deg: F64
    azimuth_deg: F64
    shift: I64
    """(pixels,) int64, columns by which a pixel is behind its column in the frame."""
    origin_m: float
    """Distance from the axis to the origin of the beams [m]."""
    rotation: F64
    """(3, 3) float64, from the lidar's to the sensor's axes."""

    @property
    def packet_size(self) -> int:
        """Bytes of a packet."""
        form = _PROFILES[self.profile]
        return (
            form.head
            + (form.column + form.size * self.n_pixels + form.foot) * self.n_columns
            + form.end
        )


def read_metadata(path: Path) -> Metadata:
    """Read the metadata of a sensor, as its HTTP interface or the SDK writes them."""
    try:
        table = json.loads(read_small(path, MAX_METADATA))
    except (OSError, ValueError, RecursionError) as error:
        text = str(error).split("\n")[0][:80]
        raise InputError(
            str(path), f"cannot be read as JSON ({text})", "copy it from the sensor again"
        ) from None
    if not isinstance(table, dict):
        raise InputError(
            str(path),
            "found no JSON object, expected metadata of an Ouster sensor",
            "copy it again",
        )
    return _Parser(path, table).metadata()


class _Parser:
    """Finds values by name, in the flat (firmware 2.x client) and the nested form of metadata."""

    def __init__(self, path: Path, table: dict[str, Any]) -> None:
        self._path = path
        self._tables = [table, *(inner for inner in table.values() if isinstance(inner, dict))]
        self._tables += [
            inner
            for table_inside in self._tables[1:]
            for inner in table_inside.values()
            if isinstance(inner, dict)
        ]

    def _find(self, name: str, default: Any = None) -> Any:
        for table in self._tables:
            if name in table:
                return table[name]
        if default is None:
            raise self._wrong(name, "nothing", "a value of the sensor's metadata")
        return default

    def _wrong(self, name: str, value: Any, expected: str) -> InputError:
        shown = str(value)[:60]
        return InputError(
            f"{self._path}: {name}",
            f"found {shown}, expected {expected}",
            "copy it from the sensor",
        )

    def _whole(
        self,
        name: str,
        low: int,
        high: int,
        default: Any = None,
    ) -> int:
        value = self._find(name, default)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise self._wrong(name, value, f"a whole number from {low} to {high}")
        return value

    def _numbers(self, name: str, n: int, default: Any = None) -> F64:
        value = self._find(name, default)
        if not isinstance(value, list) or len(value) != n:
            kind = f"list of {len(value)}" if isinstance(value, list) else type(value).__name__
            raise self._wrong(name, kind, f"{n} numbers")
        for number in value:
            # compared, not converted: a whole number may be larger than any float
            if not isinstance(number, int | float) or not -_MOST < number < _MOST:
                raise self._wrong(name, number, f"{n} numbers of angles, columns or millimetres")
        return np.array(value, np.float64)

    def metadata(self) -> Metadata:
        profile = self._find("udp_profile_lidar", "LEGACY")
        if not isinstance(profile, str) or profile not in _PROFILES:
            raise self._wrong("udp_profile_lidar", profile, f"one of {', '.join(_PROFILES)}")
        n = self._whole("pixels_per_column", 1, _MAX_PIXELS)
        frame = self._whole("columns_per_frame", 1, _MAX_COLUMNS)
        azimuth = self._numbers("beam_azimuth_angles", n)
        window = self._numbers("column_window", 2, [0, frame - 1]).astype(np.int64)
        shift = self._numbers(
            "pixel_shift_by_row", n, np.rint(azimuth * frame / 360.0).tolist()
        ).astype(np.int64)
        if np.abs(shift).max() > frame or window.min() < 0 or window.max() >= frame:
            raise self._wrong(
                "pixel_shift_by_row", shift.max(), f"shifts within the {frame} columns of a frame"
            )
        matrix = self._numbers(
            "lidar_to_sensor_transform", 16, np.diag([-1.0, -1.0, 1.0, 1.0]).ravel().tolist()
        )
        origin = self._find("lidar_origin_to_beam_origin_mm", 0.0)
        if not isinstance(origin, int | float) or not abs(origin) < 1000:
            raise self._wrong("lidar_origin_to_beam_origin_mm", origin, "millimetres")
        return Metadata(
            path=str(self._path),
            name=str(self._find("prod_line", "Ouster"))[:40],
            profile=profile,
            n_pixels=n,
            n_columns=self._whole("columns_per_packet", 1, 128, 16),
            frame_columns=frame,
            window=(int(window[0]), int(window[1])),
            altitude_deg=self._numbers("beam_altitude_angles", n),
            azimuth_deg=azimuth,
            shift=shift,
            origin_m=origin * 1e-3,
            rotation=matrix.reshape(4, 4)[:3, :3],
        )


class OusterDecoder:
    """Decodes the packets of one scanner."""

    def __init__(self, where: str, metadata: Metadata, rule: str) -> None:
        self._where = where
        self._meta = metadata
        self._rule = rule
        m = self.points_per_line = metadata.n_pixels
        self.name = f"Ouster {metadata.name}, {metadata.profile}"
        form = self._form = _PROFILES[metadata.profile]
        self._is_legacy = metadata.profile == "LEGACY"
        self.n_returns = len(form.returns)
        self.n_columns = metadata.n_columns
        self.n_records = self.n_columns * m * self.n_returns
        self._order = np.argsort(metadata.altitude_deg, kind="stable")
        self.shift: I64 = metadata.shift[self._order]
        column = np.dtype(
            {
                "names": ["time", "number", "frame", "pixels", "status"],
                "formats": [
                    "<u8",
                    "<u2",
                    "<u2",
                    ("u1", (m, form.size)),
                    "<u4" if self._is_legacy else "<u2",
                ],
                "offsets": [
                    0,
                    8,
                    10,
                    form.column,
                    form.column + form.size * m if self._is_legacy else 10,
                ],
                "itemsize": form.column + form.size * m + form.foot,
            }
        )
        self._packet = np.dtype(
            [
                ("head", "u1", form.head),
                ("columns", column, self.n_columns),
                ("end", "u1", form.end),
            ]
        )
        first, last = metadata.window
        self._window_first = first
        n_window = (last - first) % metadata.frame_columns + 1
        # a whole turn continues in the next; parts of a turn do not
        span = int(self.shift.max() - self.shift.min())
        self._per_frame = n_window if n_window == metadata.frame_columns else n_window + span
        self._n_window = n_window
        self._frame: int | None = None
        self._turns = 0
        self._first_line: int | None = None

    def decode(self, packets: U8, host_s: F64, first_record: I64) -> Columns:
        """Decode packets of one size, (n, size) uint8."""
        m = self._meta.n_pixels
        r = self.n_returns
        table = np.ascontiguousarray(packets).view(self._packet)[:, 0]
        columns = table["columns"]
        if self._is_legacy:
            frame = columns["frame"].ravel()
            is_good = columns["status"].ravel() == 0xFFFFFFFF
        else:
            frame = np.repeat(table["head"][:, 2:4].copy().view("<u2")[:, 0], self.n_columns)
            is_good = (columns["status"].ravel() & 1).astype(bool)
        number = columns["number"].ravel().astype(np.int64)
        within = (number - self._window_first) % self._meta.frame_columns
        is_good &= (number < self._meta.frame_columns) & (within < self._n_window)
        record = first_record[:, None, None, None] + np.arange(self.n_records).reshape(
            self.n_columns, m, r
        )
        record = record.reshape(-1, m, r)[is_good]
        line = self._lines(frame.astype(np.int64)[is_good], within[is_good])
        pixels = np.ascontiguousarray(
            columns["pixels"].reshape(-1, m, columns["pixels"].shape[-1])[is_good]
        )
        ranges, intensities = self._pixels(pixels[:, self._order])
        time_s = np.repeat(columns["time"].ravel()[is_good, None] * 1e-9, m, axis=1)
        shots = choose(ranges, intensities, record, self._rule)
        xyz = self._place(shots.range_m, number[is_good])
        return columns_of(line, time_s, xyz, shots)

    def _lines(self, frame: I64, within: I64) -> I64:
        """Return the number of every column since the first."""
        if not len(frame):
            return np.zeros(0, np.int64)
        before = int(frame[0]) if self._frame is None else self._frame
        half = _FRAME_IDS // 2
        steps = (np.diff(frame, prepend=before) + half) % _FRAME_IDS - half
        turn = self._turns + np.cumsum(steps)
        self._frame = int(frame[-1])
        self._turns = int(turn[-1])
        line: I64 = turn * self._per_frame + within
        if self._first_line is None:
            self._first_line = int(line[0])
        return line - self._first_line

    def _place(self, range_m: F32, number: I64) -> F32:
        """Return coordinates on the sensor's axes [m] (firmware manual, "Lidar range to XYZ")."""
        meta = self._meta
        encoder = 2 * math.pi * (1.0 - number / meta.frame_columns)
        altitude = np.deg2rad(meta.altitude_deg[self._order])
        turned = encoder[:, None] - np.deg2rad(meta.azimuth_deg[self._order])
        beam = range_m - meta.origin_m
        flat = beam * np.cos(altitude)
        x = flat * np.cos(turned) + meta.origin_m * np.cos(encoder)[:, None]
        y = flat * np.sin(turned) + meta.origin_m * np.sin(encoder)[:, None]
        lidar = np.stack([x, y, beam * np.sin(altitude)], axis=-1)
        placed: F32 = (lidar @ meta.rotation.T).astype(np.float32)
        return placed

    def _pixels(self, pixels: U8) -> tuple[F32, F32]:
        """Return ranges [m] and intensities of pixels, (n, M, returns) float32; NaN = no return."""

        def field(place: int, dtype: str) -> Any:
            return np.ascontiguousarray(pixels[..., place : place + np.dtype(dtype).itemsize]).view(
                dtype
            )[..., 0]

        ranges, intensities = np.empty((2, *pixels.shape[:2], self.n_returns), np.float32)
        for index, form in enumerate(self._form.returns):
            stored = field(form.position, form.dtype) & form.mask
            ranges[..., index] = np.where(stored == 0, np.nan, stored * form.unit_m)
            intensities[..., index] = field(form.light_position, form.light_dtype)
        return ranges, intensities
