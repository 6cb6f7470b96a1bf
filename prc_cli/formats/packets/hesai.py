"""Data packets of Hesai PandarXT (XT16, XT32).

A header of 12 bytes, 8 blocks of an azimuth and 4 bytes a channel (distance, reflectivity, one reserved), a tail of 24
bytes and a sequence number (Pandar XT user manuals, chapter 3). Angles are the nominal ones: 2 deg (XT16) or 1 deg
(XT32) from channel to channel, from 15 deg down.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.types import F64, I64, U8
from prc_cli.formats.packets.clock import PacketClock
from prc_cli.formats.packets.columns import Columns
from prc_cli.formats.packets.velodyne import finish_columns

FIRST_BYTES = b"\xee\xff\x06\x01"
N_BLOCKS = 8
_COLUMN_US = 50.0
_BLOCK_US = 5.632
"""From the time stamp back to the last block [us]."""
_CHANNEL_US = 1.512
"""From channel to channel of an XT32; an XT16 has every other one [us]."""
_ELEVATION_DEG = {16: 15.0 - 2.0 * np.arange(16), 32: 15.0 - np.arange(32)}
_TWO_RETURNS = (0x39, 0x3B, 0x3C)
_DAY_S = 86_400.0


def size_of(n_channels: int) -> int:
    """Return the bytes of a packet.

    >>> size_of(16), size_of(32)
    (568, 1080)
    """
    return 12 + N_BLOCKS * (2 + 4 * n_channels) + 28


def is_hesai(packet: bytes) -> bool:
    """Whether a packet is of a PandarXT."""
    if packet[:4] != FIRST_BYTES or len(packet) < 12:
        return False
    return packet[6] in _ELEVATION_DEG and packet[7] == N_BLOCKS and len(packet) == size_of(packet[6])


class HesaiDecoder:
    """Decodes the packets of one scanner; see :class:`prc_cli.formats.packets.velodyne.VelodyneDecoder`."""

    def __init__(self, where: str, first: bytes, rule: str) -> None:
        self._where, self._rule = where, rule
        self._m = m = first[6]
        self._packet = np.dtype(
            [
                ("head", "u1", 9),
                ("unit", "u1"),
                ("returns", "u1"),
                ("flags", "u1"),
                (
                    "blocks",
                    [("azimuth", "<u2"), ("shots", [("distance", "<u2"), ("light", "u1"), ("spare", "u1")], m)],
                    N_BLOCKS,
                ),
                ("reserved", "u1", 10),
                ("mode", "u1"),
                ("speed", "<u2"),
                ("date", "u1", 6),
                ("time", "<u4"),
                ("factory", "u1"),
                ("sequence", "<u4"),
            ]
        )
        table = np.frombuffer(first, self._packet)[0]
        self._mode, self._unit = int(table["mode"]), int(table["unit"])
        self.n_returns = 2 if self._mode in _TWO_RETURNS else 1
        self.shift: I64 = np.zeros(m, np.int64)
        self.n_columns = N_BLOCKS // self.n_returns
        self.n_records = self.n_columns * m * self.n_returns
        self._clock = PacketClock(_DAY_S, _COLUMN_US * 1e-6)

    @property
    def name(self) -> str:
        """Maker and model."""
        return f"Hesai XT{self._m}"

    def decode(self, packets: U8, host_s: F64, first_record: I64) -> Columns:
        """Decode packets, (n, size) uint8; see :meth:`prc_cli.formats.packets.velodyne.VelodyneDecoder.decode`."""
        m, r = self._m, self.n_returns
        table = np.ascontiguousarray(packets).view(self._packet)[:, 0]
        changed = (table["mode"] != self._mode) | (table["unit"] != self._unit)
        if changed.any():
            problem = "the return mode or the unit of distances changes, expected one of each"
            raise InputError(self._where, problem, "split the capture where the set-up changed")
        blocks = table["blocks"]
        # rings from low to high: channels are from high to low
        shots = blocks["shots"].reshape(len(table), N_BLOCKS // r, r, m)[..., ::-1]
        metres = shots["distance"].astype(np.float32) * np.float32(self._unit * 1e-3)
        metres[metres == 0] = np.nan
        light = shots["light"].astype(np.float32)
        azimuth = blocks["azimuth"][:, ::r].astype(np.int64)
        gap = np.diff(azimuth, axis=1) % 36000
        gap = np.concatenate([gap, gap[:, -1:]], axis=1)
        channel_s = np.arange(m)[::-1] * _CHANNEL_US * (32 // m) * 1e-6
        stamp_s = table["date"][:, 3:6] @ np.array([3600.0, 60.0, 1.0]) + table["time"] * 1e-6
        line, time_s = self._clock.columns(stamp_s, host_s, self.n_columns)
        # the stamp is that of the end
        time_s = time_s - ((self.n_columns - 1) * _COLUMN_US - _BLOCK_US) * 1e-6
        turned = azimuth.reshape(-1, 1) + gap.reshape(-1, 1) * (channel_s / (_COLUMN_US * 1e-6))
        within = np.arange(self.n_records).reshape(self.n_columns, m, r)
        record = (first_record[:, None, None, None] + within).reshape(-1, m, r)
        return finish_columns(
            line, time_s[:, None] + channel_s, np.deg2rad(turned / 100.0), np.deg2rad(_ELEVATION_DEG[m][::-1]),
            [metres[:, :, i].reshape(-1, m) for i in range(r)], [light[:, :, i].reshape(-1, m) for i in range(r)],
            record, self._rule,
        )  # fmt: skip
