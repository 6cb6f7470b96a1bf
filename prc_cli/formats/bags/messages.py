"""Read the fields of messages as ROS 1 or CDR (ROS 2) writes them, and messages of packets."""

from __future__ import annotations

import struct
from typing import Any, Literal

import numpy as np
from numpy.typing import DTypeLike, NDArray


class ShortMessageError(ValueError):
    """A message ends before its fields do, or its lengths are wrong; the text says how."""

    def __init__(self, problem: str, hint: str = "") -> None:
        self.hint = hint
        """How to get another message; empty if the message is damaged."""
        super().__init__(problem)


def expect(is_so: bool, otherwise: str, hint: str = "") -> None:
    """Raise ShortMessageError with a text and a hint if a condition is false."""
    if not is_so:
        raise ShortMessageError(otherwise, hint)


class Cursor:
    """Position in the bytes of a message.

    ROS 1 packs fields without gaps, little-endian. CDR begins with four bytes that name the byte
    order, and aligns every number to its size, counted from behind them; strings end with a zero.
    """

    def __init__(self, data: bytes, *, is_cdr: bool) -> None:
        self.data = data
        self.is_cdr = is_cdr
        self.position = self._start = 4 if is_cdr else 0
        self.order: Literal["<", ">"] = "<"
        if is_cdr:
            known = len(data) >= 4 and data[0] == 0 and data[1] <= 1
            expect(
                known, f"begins with {data[:4].hex() or 'nothing'}, expected the four bytes of CDR"
            )
            self.order = "<" if data[1] else ">"

    def _align(self, size: int) -> None:
        if self.is_cdr:
            self.position += -(self.position - self._start) % size

    def _need(self, n: int) -> int:
        """Return the position and move ``n`` bytes on."""
        start = self.position
        expect(
            n <= len(self.data) - start,
            f"ends after {len(self.data)} bytes, expected {start + n} or more",
        )
        self.position += n
        return start

    def number(self, form: str) -> Any:
        """Read one number of a :mod:`struct` format letter."""
        size = struct.calcsize(f"={form}")
        self._align(size)
        return struct.unpack_from(self.order + form, self.data, self._need(size))[0]

    def numbers(self, form: str, n: int) -> tuple[Any, ...]:
        """Read ``n`` numbers of one format letter."""
        size = struct.calcsize(f"={form}")
        self._align(size)
        return struct.unpack_from(f"{self.order}{n}{form}", self.data, self._need(n * size))

    def text(self) -> str:
        """Read a string."""
        n = self.number("I")
        start = self._need(n)
        return self.data[start : start + n].rstrip(b"\0").decode("utf-8", errors="replace")

    def array(self, dtype: DTypeLike, n: int | None = None) -> NDArray[Any]:
        """Read a sequence of numbers, or ``n`` of them; a view of the message."""
        count = self.number("I") if n is None else n
        kind = np.dtype(dtype).newbyteorder(self.order)
        if count:
            self._align(kind.itemsize)
        start = self._need(count * kind.itemsize)
        return np.frombuffer(self.data, kind, count, start)

    def rest(self, dtype: DTypeLike) -> NDArray[Any]:
        """Return all complete numbers from here to the end, a view of the message; do not move."""
        kind = np.dtype(dtype).newbyteorder(self.order)
        return np.frombuffer(
            self.data, kind, (len(self.data) - self.position) // kind.itemsize, self.position
        )

    def header(self) -> tuple[float, str]:
        """Read a ``std_msgs/Header``; return its stamp [s] and frame."""
        if not self.is_cdr:
            self.number("I")  # sequence number
        return self.stamp(), self.text()

    def stamp(self) -> float:
        """Read a time [s]."""
        seconds = self.number("i" if self.is_cdr else "I")
        nanoseconds = self.number("I")
        return float(seconds + nanoseconds * 1e-9)


VELODYNE = "velodyne_msgs/VelodyneScan"
PANDAR = "pandar_msgs/PandarScan"
NEBULA = "nebula_msgs/NebulaPackets"
OUSTER = ("ouster_sensor_msgs/PacketMsg", "ouster_msgs/PacketMsg", "ouster_ros/PacketMsg")
PACKED = (VELODYNE, PANDAR, NEBULA, *OUSTER)
_LEAST = {VELODYNE: 1214, PANDAR: 1512, NEBULA: 12}
"""Least bytes of a packet in a message."""


def parse_packets(
    kind: str,
    data: bytes,
    time_s: float,
    *,
    is_cdr: bool,
) -> tuple[str, list[tuple[float, bytes]]]:
    """Return the frame of a message, and its packets with the time when they were received [s]."""
    cursor = Cursor(data, is_cdr=is_cdr)
    if kind in OUSTER:
        return "", [(time_s, cursor.array("u1").tobytes())]
    _, frame = cursor.header()
    n = cursor.number("I")
    expect(n <= len(data) // _LEAST[kind], f"says it holds {n} packets, which it is too short for")
    packets = []
    for _ in range(n):
        stamp_s = cursor.stamp()
        if kind == VELODYNE:
            packets.append((stamp_s, cursor.array("u1", 1206).tobytes()))
        elif kind == NEBULA:
            packets.append((stamp_s, cursor.array("u1").tobytes()))
        else:
            held = cursor.array("u1", 1500)
            packets.append((stamp_s, held[: cursor.number("I")].tobytes()))
    return frame, packets
