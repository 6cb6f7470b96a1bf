"""Decode the data packets of Velodyne and Hesai.

Blocks of an azimuth and the distances of all lasers.

Velodyne (user manuals of VLP-16, VLP-32C, HDL-32E, HDL-64E S3, VLS-128): 1206 bytes, 12 blocks of a
flag, an azimuth and 32 distances with reflectivity; then a time stamp, the return mode and the
model. Angles are those of the calibrations that velodyne-decoder brings along; an HDL-64E has one
of its own. Hesai (user manuals of Pandar40P, 64, QT64, QT128, XT, XT32M, 128 and OT128): a header,
blocks of an azimuth and the channels, a tail with mode and time. Angles and times of firing are the
makers' nominal ones (``hesai.json``). Cells without return are zeros.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.files import read_small
from prc_cli.core.types import F64, I64, U8
from prc_cli.formats.firings import MAX_SHIFT, Columns, choose, columns_of
from prc_cli.formats.packets.clock import PacketClock, place

_TURN = 36000
"""Azimuths are in hundredths of a degree."""
_SPLIT = "split the capture where the set-up changed"
NEEDED = "convert it with its maker's program: prc does not know its packets and laser angles"
_RETURNS = {**dict.fromkeys((0x39, 0x3A, 0x3B, 0x3C, 0x3E), 2), 0x3D: 3}
"""Returns a shot by mode; one in other modes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Model:
    """Packets of a scanner; arrays are (M,) float64, lasers in the order of its packets."""

    name: str
    packet: np.dtype[np.void]
    """Fields ``blocks`` (``azimuth``, ``shots``), ``stamp``, ``mode``, ``kind``, maybe ``date``."""
    elevation_deg: F64
    azimuth_deg: F64
    """Angle by which a laser looks ahead of the azimuth of its block."""
    fired_us: F64
    """From the first laser of a column."""
    column_us: float
    """From column to column."""
    stamp_us: float = 0.0
    """From the time stamp to the first column, or to the last one."""
    stamps_last: bool = False
    banks: int = 1
    """Blocks of a column."""
    firings: int = 1
    """Columns of a block."""
    unit_m: float = 0.0
    """Unit of distances; 0 = ``kind`` is the unit in millimetres."""
    least: int = 1
    """Smaller stored distances are no return."""
    added_m: float | F64 = 0.0
    """Offset of every distance [m]."""
    clock_s: float = 3600.0
    """Period of its clock."""
    has_mode: bool = True
    """Whether the packets hold return mode and model."""


# Velodyne

VELODYNE_SIZE = 1206
_SHOT3, _SHOT4 = (
    np.dtype(
        {
            "names": ["distance", "light"],
            "formats": ["<u2", "u1"],
            "offsets": [0, 2],
            "itemsize": size,
        }
    )
    for size in (3, 4)
)
_VELODYNE = np.dtype(
    [
        ("blocks", [("flag", "<u2"), ("azimuth", "<u2"), ("shots", _SHOT3, 32)], 12),
        ("stamp", "<u4"),
        ("mode", "u1"),
        ("kind", "u1"),
    ]
)


class _Firing(NamedTuple):
    """Firing of a Velodyne: lasers in slots, some at once, with pauses behind the first half."""

    name: str
    calibration: str
    column_us: float
    slot_us: float
    at_once: int = 1
    banks: int = 1
    firings: int = 1
    pauses: int = 0


_FIRINGS = {
    0x21: _Firing("HDL-32E", "HDL32E", 46.08, 1.152),
    0x22: _Firing("VLP-16", "VLP16", 55.296, 2.304, firings=2),
    0x24: _Firing("Puck Hi-Res", "PuckHiRes", 55.296, 2.304, firings=2),
    0x28: _Firing("VLP-32C", "VLP32C", 55.296, 2.304, at_once=2),
    0xA1: _Firing("VLS-128", "VLS128", 55.296, 2.665, at_once=8, banks=4, pauses=2),
}
"""By the number of the model in the packets."""
_OTHER_NUMBERS = {0x23: "VLP-32A or VLP-32B", 0x31: "Velarray"}
_FOUR_US = {"S2": (48.0, 6.0, (0.0, 1.26, 2.46, 3.66)), "S3": (57.6, 7.2, (0.0, 1.3, 2.5, 3.7))}
"""Times of an HDL-64E [us]: column to column, four lasers to the next four, within the four."""
_MAX_CALIBRATION = 1 << 20


def _velodyne(where: str, packet: bytes, calibration: Path | None) -> Model:
    # blocks of an HDL-64E alternate; its last bytes are a status
    if packet[100:102] == b"\xff\xdd" and packet[200:202] == b"\xff\xee":
        return _hdl64(where, calibration)
    if packet[1205] not in _FIRINGS:
        raise InputError(where, f"found packets of {describe(packet)}, expected {KNOWN}", NEEDED)
    firing = _FIRINGS[packet[1205]]
    library, yaml = _libraries(where)
    bundled = library.Calibration.default_calibs[library.Model.__members__[firing.calibration]]
    table = yaml.safe_load(bundled.to_string())
    up, turned = (
        # stored as float32: the calibrations have three decimals at most
        np.rad2deg([laser[key] for laser in table["lasers"]]).round(3)
        for key in ("vert_correction", "rot_correction")
    )
    slot = np.arange(len(up)) // firing.at_once
    return Model(
        name=f"Velodyne {firing.name}",
        packet=_VELODYNE,
        elevation_deg=up,
        azimuth_deg=0.0 - turned,
        fired_us=(slot + firing.pauses * (2 * slot > slot[-1])) * firing.slot_us,
        column_us=firing.column_us,
        banks=firing.banks,
        firings=firing.firings,
        unit_m=round(table["distance_resolution"], 4),
    )


def _libraries(where: str) -> tuple[Any, Any]:
    """Return velodyne-decoder and the library that reads its calibrations."""
    try:
        import velodyne_decoder
        import yaml
    except ImportError:
        problem = "reading packets of a Velodyne needs velodyne-decoder, which is not installed"
        raise InputError(where, problem, 'pip install ".[pcap]"') from None
    return velodyne_decoder, yaml


def _hdl64(where: str, calibration: Path | None) -> Model:
    hint = (
        "give --set input.metadata=FILE.yml; "
        "velodyne_decoder.hdl64e reads it from a capture of a minute"
    )
    if calibration is None:
        raise InputError(
            where, "packets of a Velodyne HDL-64E need the calibration of the unit", hint
        )
    _, yaml = _libraries(where)
    try:
        table = yaml.safe_load(read_small(calibration, _MAX_CALIBRATION))
        lasers = sorted(table["lasers"], key=lambda laser: int(laser["laser_id"]))
        keys = ("vert_correction", "rot_correction", "dist_correction")
        up, turned, added = (
            np.array([float(corrections.get(key, 0.0)) for corrections in lasers]) for key in keys
        )
        model = str(table.get("status", {}).get("Model", "S2"))
        unit_m = float(table.get("distance_resolution", 0.002))
    except (
        OSError,
        ValueError,
        TypeError,
        KeyError,
        AttributeError,
        RecursionError,
        yaml.YAMLError,
    ):
        raise InputError(str(calibration), "found no calibration of lasers", hint) from None
    if (
        len(up) != 64
        or not (np.abs([up, turned, added]) < 10).all()
        or not 0 < unit_m < 0.1
        or model not in _FOUR_US
    ):
        raise InputError(
            str(calibration), f"found {len(up)} lasers ({model[:9]}), expected 64 with angles", hint
        )
    column_us, four_us, within = _FOUR_US[model]
    laser = np.arange(64) % 32
    return Model(
        name=f"Velodyne HDL-64E {model}",
        packet=_VELODYNE,
        elevation_deg=np.rad2deg(up),
        azimuth_deg=-np.rad2deg(turned),
        fired_us=laser // 4 * four_us + np.array(within)[laser % 4],
        column_us=column_us,
        banks=2,
        unit_m=unit_m,
        added_m=added,
        has_mode=False,
    )


# Hesai


class _Layout(NamedTuple):
    """Parts of a Hesai's packets."""

    name: str
    start: bytes
    """First bytes."""
    sizes: tuple[int, ...]
    """Bytes of a packet."""
    lasers: int
    blocks: int
    head: int
    """Bytes of the header; 0 = every block has a flag instead."""
    shot: np.dtype[np.void]
    tail: tuple[int, int, int]
    """Bytes from the blocks to mode, date and time stamp."""
    column_us: float
    stamp_us: float
    stamps_last: bool = True
    unit_m: float = 0.0


_LONG_TAIL = (33, 36, 42)
_LAYOUTS = (
    _Layout(
        "40P",
        b"\xff\xee",
        (1262, 1266),
        40,
        10,
        0,
        _SHOT3,
        (14, 16, 10),
        55.56,
        -83.25,
        unit_m=0.004,
    ),
    _Layout(
        "64", b"\xee\xff\x40\x06", (1194, 1198), 64, 6, 8, _SHOT3, (14, 16, 10), 55.56, -97.248
    ),
    _Layout(
        "QT64",
        b"\xee\xff\x03\x01",
        (1068, 1072),
        64,
        4,
        12,
        _SHOT4,
        (16, 18, 12),
        166.67,
        38.02,
        stamps_last=False,
    ),
    _Layout(
        "QT128", b"\xee\xff\x03\x02", (1095, 1127), 128, 2, 12, _SHOT4, _LONG_TAIL, 111.11, 9.0
    ),
    _Layout("XT16", b"\xee\xff\x06\x01", (568,), 16, 8, 12, _SHOT4, (10, 13, 19), 50.0, 5.632),
    _Layout("XT32", b"\xee\xff\x06\x01", (1080,), 32, 8, 12, _SHOT4, (10, 13, 19), 50.0, 5.632),
    _Layout("XT32M", b"\xee\xff\x06\x01", (820,), 32, 6, 12, _SHOT4, (10, 13, 19), 50.0, 5.632),
    _Layout("128", b"\xee\xff\x01\x03", (861, 893), 128, 2, 12, _SHOT3, _LONG_TAIL, 55.556, 3.148),
    _Layout(
        "OT128", b"\xee\xff\x01\x04", (861, 893), 128, 2, 12, _SHOT3, _LONG_TAIL, 55.556, 43.346
    ),
)
KNOWN = ", ".join(
    [f"Velodyne {firing.name}" for firing in _FIRINGS.values()]
    + ["HDL-64E"]
    + [f"Hesai {layout.name}" for layout in _LAYOUTS]
)
"""Names of the models."""


def _layout(packet: bytes) -> _Layout | None:
    """Return the layout of a Hesai's packet; None for any other."""
    for layout in _LAYOUTS:
        if packet.startswith(layout.start) and len(packet) in layout.sizes:
            counts = packet[6:8] if layout.head == 12 else bytes([layout.lasers, layout.blocks])
            return layout if counts == bytes([layout.lasers, layout.blocks]) else None
    return None


def _hesai(layout: _Layout, size: int) -> Model:
    flag = 0 if layout.head else 2
    block = np.dtype(
        {
            "names": ["azimuth", "shots"],
            "formats": ["<u2", (layout.shot, layout.lasers)],
            "offsets": [flag, flag + 2],
            "itemsize": flag + 2 + layout.shot.itemsize * layout.lasers,
        }
    )
    end = layout.head + block.itemsize * layout.blocks
    # the unit of distances is in the header
    unit = {8: 5, 12: 9}.get(layout.head, 0)
    packet = np.dtype(
        {
            "names": ["blocks", "kind", "mode", "date", "stamp"],
            "formats": [(block, layout.blocks), "u1", "u1", ("u1", 6), "<u4"],
            "offsets": [layout.head, unit, *(end + behind for behind in layout.tail)],
            "itemsize": size,
        }
    )
    table = json.loads(Path(__file__).with_name("hesai.json").read_text("utf-8"))[layout.name]
    lasers: dict[str, Any] = {name: np.array(values) for name, values in table.items()}
    return Model(
        name=f"Hesai {layout.name}",
        packet=packet,
        column_us=layout.column_us,
        stamp_us=layout.stamp_us,
        stamps_last=layout.stamps_last,
        unit_m=layout.unit_m,
        least=4,
        clock_s=86_400.0,
        **lasers,
    )


# both


def is_spinning(packet: bytes) -> bool:
    """Return whether a packet is of a Velodyne, or of a Hesai with a known layout."""
    if len(packet) == VELODYNE_SIZE:
        return packet[:2] == b"\xff\xee"
    return _layout(packet) is not None


def is_hesai(packet: bytes) -> bool:
    """Return whether a packet begins with a header of Hesai, known or not."""
    return packet[:2] == b"\xee\xff" and len(packet) >= 12


def describe(packet: bytes) -> str:
    """Return the scanner that sent a packet, for messages.

    >>> describe(bytes([0xEE, 0xFF, 4, 3, 0, 0, 128, 2]) + bytes(1110))
    'Hesai, protocol 4.3, 128 channels in 2 blocks, 1118 bytes'
    """
    if len(packet) == VELODYNE_SIZE and packet[:2] == b"\xff\xee":
        number = packet[1205]
        return f"Velodyne model {number:#04x} ({_OTHER_NUMBERS.get(number, 'unknown')})"
    if is_hesai(packet):
        counts = f"{packet[6]} channels in {packet[7]} blocks"
        return f"Hesai, protocol {packet[2]}.{packet[3]}, {counts}, {len(packet)} bytes"
    return f"{len(packet)} bytes that begin with {packet[:4].hex() or 'nothing'}"


class SpinningDecoder:
    """Decodes the packets of one scanner."""

    def __init__(
        self,
        where: str,
        first: bytes,
        calibration: Path | None,
        rule: str,
    ) -> None:
        self._where = where
        self._rule = rule
        layout = _layout(first)
        self._model = model = (
            _velodyne(where, first, calibration) if layout is None else _hesai(layout, len(first))
        )
        table = np.frombuffer(first, model.packet)[0]
        self._mode = int(table["mode"])
        self._kind = int(table["kind"])
        self.name = model.name
        self._fields = model.packet.names or ()
        self.n_returns = _RETURNS.get(self._mode, 1) if model.has_mode else 1
        if self.n_returns > 2:
            problem = f"found three returns a shot (mode {self._mode:#04x}), expected one or two"
            raise InputError(where, problem, "set the scanner to two returns a shot")
        self._m = self.points_per_line = len(model.elevation_deg)
        self._order = np.argsort(model.elevation_deg, kind="stable")
        n_groups = table["blocks"].shape[0] // (model.banks * self.n_returns)
        self._used = n_groups * model.banks * self.n_returns
        """Blocks with shots; a VLS-128 has empty blocks."""
        self.n_columns = n_groups * model.firings
        self.n_records = self.n_columns * self._m * self.n_returns
        self._clock = PacketClock(model.clock_s, model.column_us * 1e-6)
        self._step = 0.0
        """From column to column, as in the first packets."""

    @property
    def shift(self) -> I64:
        """(M,) int64, columns that a ring looks ahead; zeros before packets are decoded."""
        if self._step < 1.0:
            return np.zeros(self._m, np.int64)
        ahead = np.rint(self._model.azimuth_deg[self._order] * 100.0 / self._step)
        return ahead.clip(-MAX_SHIFT, MAX_SHIFT).astype(np.int64)

    def decode(self, packets: U8, host_s: F64, first_record: I64) -> Columns:
        """Decode packets of one size, (n, size) uint8."""
        model = self._model
        m = self._m
        order = self._order
        table = np.ascontiguousarray(packets).view(model.packet)[:, 0]
        self._check(table)
        blocks = table["blocks"][:, : self._used]
        azimuth, gap = self._azimuths(
            blocks["azimuth"][:, :: model.banks * self.n_returns].astype(np.int64)
        )
        distance = self._by_column(blocks["shots"]["distance"])
        metres = distance.astype(np.float32) * np.float32(model.unit_m or self._kind * 1e-3)
        metres += np.broadcast_to(model.added_m, m).astype(np.float32)[order, None]
        metres[distance < model.least] = np.nan
        if self.n_returns == 2:
            # a shot of one return contains it twice
            metres[..., 1][metres[..., 1] == metres[..., 0]] = np.nan
        light = self._by_column(blocks["shots"]["light"]).astype(np.float32)
        within = np.arange(self.n_records).reshape(self.n_columns, m, self.n_returns)
        record = (first_record[:, None, None, None] + within).reshape(-1, m, self.n_returns)
        shots = choose(metres, light, record, self._rule)
        line, time_s = self._times(table, host_s)
        # turning of the head until a laser fires, as a share of the way to the next block
        turn = (np.arange(model.firings)[:, None] * model.column_us + model.fired_us[order]) / (
            model.firings * model.column_us
        )
        turned = (
            azimuth[:, :, None, None]
            + gap[:, :, None, None] * turn
            + model.azimuth_deg[order] * 100.0
        )
        turned = np.deg2rad(turned.reshape(-1, m) / 100.0)
        xyz = place(shots.range_m, turned, np.deg2rad(model.elevation_deg[order]))
        return columns_of(line, time_s, xyz, shots)

    def _check(self, table: NDArray[np.void]) -> None:
        changed = (table["mode"] != self._mode) | (table["kind"] != self._kind)
        if self._model.has_mode and changed.any():
            bad = table[int(np.argmax(changed))]
            what = "unit of distances" if "date" in self._fields else "model"
            problem = (
                f"found {what} {bad['kind']:#04x} and return mode {bad['mode']:#04x} "
                f"after {self._kind:#04x} and {self._mode:#04x}, expected one of each"
            )
            raise InputError(self._where, problem, _SPLIT)

    def _by_column(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values of blocks, (n, blocks, shots), as (columns, M, returns), rings upwards."""
        model = self._model
        shape = (
            len(values),
            -1,
            model.banks,
            self.n_returns,
            model.firings,
            self._m // model.banks,
        )
        parts = values.reshape(shape).transpose(0, 1, 4, 2, 5, 3)
        columns: NDArray[Any] = parts.reshape(-1, self._m, self.n_returns)[:, self._order]
        return columns

    def _azimuths(self, azimuth: I64) -> tuple[I64, NDArray[Any]]:
        """Return the azimuth of every group of blocks and the turn to the next, (n, groups)."""
        if azimuth.shape[1] > 1:
            gap = np.diff(azimuth, axis=1) % _TURN
            # the last block has no next: it turns as the one before
            gap = np.concatenate([gap, gap[:, -1:]], axis=1)
        else:
            steps = np.diff(azimuth[:, 0]) % _TURN
            gap = np.full(azimuth.shape, self._step or (np.median(steps) if len(steps) else 0.0))
        self._step = self._step or float(np.median(gap)) / self._model.firings
        return azimuth, gap

    def _times(self, table: NDArray[np.void], host_s: F64) -> tuple[I64, F64]:
        """Return number and times of every column, (columns,) and (columns, M) [s]."""
        model = self._model
        stamp_s = table["stamp"] * 1e-6
        if "date" in self._fields:
            stamp_s = table["date"][:, 3:6] @ np.array([3600.0, 60.0, 1.0]) + stamp_s
        line, time_s = self._clock.columns(stamp_s, host_s, self.n_columns)
        before_us = (self.n_columns - 1) * model.column_us if model.stamps_last else 0.0
        start = time_s + (model.stamp_us - before_us) * 1e-6
        return line, start[:, None] + model.fired_us[self._order] * 1e-6
