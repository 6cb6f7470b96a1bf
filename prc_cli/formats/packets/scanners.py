"""Chooses the decoder of a scanner's packets, and gathers packets of one scanner into blocks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F64, I64, U8
from prc_cli.formats.options import InputConfig
from prc_cli.formats.packets import hesai, velodyne
from prc_cli.formats.packets.columns import ColumnLines, Columns
from prc_cli.formats.packets.ouster import Metadata, OusterDecoder

BATCH_SHOTS = 1 << 17
"""Shots decoded at a time."""


class Decoder(Protocol):
    """Decodes the packets of one scanner; its state is what goes from packet to packet."""

    shift: I64
    n_columns: int
    n_records: int
    n_returns: int

    @property
    def name(self) -> str:
        """Maker and model."""

    def decode(self, packets: U8, host_s: F64, first_record: I64) -> Columns:
        """Decode packets of equal size."""


def is_scan(packet: bytes, metadata: Metadata | None) -> bool:
    """Whether a packet holds shots that can be decoded."""
    if len(packet) == velodyne.SIZE and packet[:2] == velodyne.FIRST_BYTES:
        return True
    return hesai.is_hesai(packet) or (metadata is not None and len(packet) == metadata.packet_size)


def open_decoder(where: str, first: bytes, metadata: Metadata | None, rule: str) -> Decoder:
    """Return the decoder for a scanner's first packet."""
    if metadata is not None and len(first) == metadata.packet_size:
        return OusterDecoder(where, metadata, rule)
    if hesai.is_hesai(first):
        return hesai.HesaiDecoder(where, first, rule)
    return velodyne.VelodyneDecoder(where, first, rule)


class PacketLines:
    """Gathers the packets of one scanner into blocks."""

    def __init__(self, where: str, scanner: int, first: bytes, metadata: Metadata | None, config: InputConfig) -> None:
        self._where = where
        self.decoder = open_decoder(where, first, metadata, config.return_)
        self.lines = ColumnLines(where, scanner, self.decoder.shift, config)
        self.points_per_line = len(self.decoder.shift)
        self._size = len(first)
        self._packets: list[bytes] = []
        self._times: list[float] = []
        self._records: list[int] = []
        self._enough = max(1, BATCH_SHOTS // max(1, self.decoder.n_records))

    @property
    def n_records(self) -> int:
        """Records of a packet."""
        return self.decoder.n_records

    def add(self, packet: bytes, time_s: float, first_record: int) -> Iterator[ScanBlock]:
        """Take a packet; yield blocks when there is enough for one."""
        if len(packet) != self._size:
            problem = f"found a packet of {len(packet)} bytes, expected {self._size} as before"
            raise InputError(self._where, problem, "split the capture where the set-up changed")
        self._packets.append(packet)
        self._times.append(time_s)
        self._records.append(first_record)
        if len(self._packets) == self._enough:
            yield from self._decode()

    def finish(self) -> Iterator[ScanBlock]:
        """Yield what waits."""
        yield from self._decode()
        yield from self.lines.finish()

    def _decode(self) -> Iterator[ScanBlock]:
        if not self._packets:
            return
        data: U8 = np.frombuffer(b"".join(self._packets), np.uint8).reshape(len(self._packets), self._size)
        times, records = np.array(self._times), np.array(self._records, np.int64)
        self._packets, self._times, self._records = [], [], []
        columns = self.decoder.decode(data, times, records)
        per_column = self.decoder.n_records // self.decoder.n_columns
        self.lines.count_not_fired(len(data) * self.decoder.n_records - len(columns) * per_column)
        if len(columns):
            yield from self.lines.add(columns)
