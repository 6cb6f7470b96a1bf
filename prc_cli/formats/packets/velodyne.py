"""Data packets of Velodyne scanners: VLP-16 (Puck, Puck LITE), Puck Hi-Res and HDL-32E.

1206 bytes: 12 blocks of a flag, an azimuth and 32 distances with reflectivity; then a time stamp, the return mode and
the model (VLP-16 user manual 63-9243, chapter 9; HDL-32E user manual 63-9113, appendix C). A firing of a VLP-16 has 16
lasers, of an HDL-32E 32. Cells without return are zeros.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.types import F32, F64, I64, U8
from prc_cli.formats.packets.clock import PacketClock
from prc_cli.formats.packets.columns import Columns, choose_of_two, place

SIZE = 1206
FIRST_BYTES = b"\xff\xee"
_STEP_M = 0.002
_DUAL = 0x39
_HOUR_S = 3600.0
_TURN = 36000
_BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("shots", [("distance", "<u2"), ("reflectivity", "u1")], 32)])
_PACKET = np.dtype([("blocks", _BLOCK, 12), ("time", "<u4"), ("mode", "u1"), ("model", "u1")])


@dataclass(frozen=True, slots=True)
class Model:
    """Nominal geometry of a scanner."""

    name: str
    elevation_deg: tuple[float, ...]
    """By laser, in the order of firing."""
    laser_us: float
    """From laser to laser."""
    firing_us: float
    """From firing to firing."""

    @property
    def order(self) -> list[int]:
        """Lasers from low to high."""
        return sorted(range(len(self.elevation_deg)), key=lambda laser: self.elevation_deg[laser])


def _interleaved(low: float, high: float, step: float) -> tuple[float, ...]:
    """Return elevations that alternate between a lower and an upper half, to thousandths."""
    return tuple(round((low if laser % 2 == 0 else high) + step * (laser // 2), 3) for laser in range(16))


_HDL32 = tuple(
    round((-30.67 if laser % 2 == 0 else -9.33) + 4 / 3 * (laser // 2), 2) for laser in range(32)
)  # fmt: skip
MODELS = {
    0x21: Model("Velodyne HDL-32E", _HDL32, 1.152, 46.08),
    0x22: Model("Velodyne VLP-16", _interleaved(-15.0, 1.0, 2.0), 2.304, 55.296),
    0x24: Model("Velodyne Puck Hi-Res", _interleaved(-10.0, 0.667, 4 / 3), 2.304, 55.296),
}
"""Models by their number in the packets (factory byte)."""
OTHERS = {0x23: "Puck LITE", 0x28: "VLP-32C", 0xA1: "VLS-128", 0x31: "Velarray"}


class VelodyneDecoder:
    """Decodes the packets of one scanner."""

    def __init__(self, where: str, first: bytes, rule: str) -> None:
        self._where, self._rule = where, rule
        mode, number = first[1204], first[1205]
        number = 0x22 if number == 0x23 else number
        if number not in MODELS:
            name = OTHERS.get(number, "unknown")
            known = ", ".join(model.name for model in MODELS.values())
            problem = f"found packets of model {number:#04x} ({name}), expected {known}"
            raise InputError(where, problem, "convert it with the maker's program, for example to LAS")
        self.model = MODELS[number]
        self._mode, self._number = mode, first[1205]
        self.n_returns = 2 if mode == _DUAL else 1
        m = len(self.model.elevation_deg)
        self.shift: I64 = np.zeros(m, np.int64)
        self.n_columns = 12 * (32 // m) // self.n_returns
        """Columns of a packet."""
        self.n_records = self.n_columns * m * self.n_returns
        """Records of a packet."""
        self._clock = PacketClock(_HOUR_S, self.model.firing_us * 1e-6)

    @property
    def name(self) -> str:
        """Maker and model."""
        return self.model.name

    def decode(self, packets: U8, host_s: F64, first_record: I64) -> Columns:
        """Decode packets."""
        model, m = self.model, len(self.model.elevation_deg)
        table = np.ascontiguousarray(packets).view(_PACKET)[:, 0]
        blocks = table["blocks"]
        changed = (table["model"] != self._number) | (table["mode"] != self._mode)
        if changed.any():
            bad = table[int(np.argmax(changed))]
            problem = (
                f"found model {bad['model']:#04x} and return mode {bad['mode']:#04x} after {self._number:#04x} and "
                f"{self._mode:#04x}, expected one of each"
            )
            raise InputError(self._where, problem, "split the capture where the set-up changed")
        n, per_block = len(table), 32 // m
        azimuth, gap = _azimuths(blocks["azimuth"].astype(np.int64), self.n_returns)
        shots = blocks["shots"]
        distance, lit = shots["distance"], shots["reflectivity"]
        # (packets, firings of blocks, returns, firings within a block, lasers)
        shape = (n, 12 // self.n_returns, self.n_returns, per_block, m)
        order = np.array(model.order)
        metres = (distance.astype(np.float32) * np.float32(_STEP_M)).reshape(shape)[..., order]
        metres[metres == 0] = np.nan
        light = lit.astype(np.float32).reshape(shape)[..., order]
        line, time_s = self._clock.columns(table["time"] * 1e-6, host_s, self.n_columns)
        laser_s = np.array(order) * model.laser_us * 1e-6
        within = (np.arange(per_block)[:, None] * model.firing_us + order * model.laser_us) / (
            per_block * model.firing_us
        )
        turned = azimuth[:, :, None, None] + gap[:, :, None, None] * within
        turned = np.deg2rad(turned.reshape(-1, m) / 100.0)
        record = _records(first_record, self.n_columns, m, self.n_returns)
        ranges = [metres[:, :, r].reshape(-1, m) for r in range(self.n_returns)]
        lights = [light[:, :, r].reshape(-1, m) for r in range(self.n_returns)]
        return finish_columns(
            line, time_s[:, None] + laser_s, turned, np.deg2rad(np.array(model.elevation_deg)[order]),
            ranges, lights, record, self._rule,
        )  # fmt: skip


def _azimuths(azimuth: I64, n_returns: int) -> tuple[I64, I64]:
    """Return the azimuth of every block and how far it turns to the next, (n, blocks) in hundredths of a degree."""
    azimuth = azimuth[:, ::n_returns]
    gap = np.diff(azimuth, axis=1) % _TURN
    # the last block has no next: it turns as the one before
    return azimuth, np.concatenate([gap, gap[:, -1:]], axis=1)


def _records(first: I64, n_columns: int, m: int, n_returns: int) -> I64:
    """Return the records of all shots, (columns, M, returns)."""
    within = np.arange(n_columns * m * n_returns).reshape(n_columns, m, n_returns)
    return (first[:, None, None, None] + within).reshape(-1, m, n_returns)


def finish_columns(
    line: I64,
    time_s: F64,
    azimuth_rad: F64,
    elevation_rad: F64,
    ranges: list[F32],
    lights: list[F32],
    record: I64,
    rule: str,
) -> Columns:
    """Choose the return that stands for every shot, and place it."""
    if len(ranges) == 1:
        xyz = place(ranges[0], azimuth_rad, elevation_rad)
        return Columns(line, ranges[0], record[..., 0], time_s, xyz, lights[0])
    first, second = ranges
    # a shot of one return holds it twice
    second = np.where(second == first, np.float32(math.nan), second)
    swap = choose_of_two(first, second, (lights[0], lights[1]), rule)
    own, other = np.where(swap, second, first), np.where(swap, first, second)
    light = np.where(swap, lights[1], lights[0])
    own_record = np.where(swap, record[..., 1], record[..., 0])
    other_record = np.where(swap, record[..., 0], record[..., 1])
    return Columns(
        line, own, own_record, time_s, place(own, azimuth_rad, elevation_rad), light, other, other_record
    )  # fmt: skip
