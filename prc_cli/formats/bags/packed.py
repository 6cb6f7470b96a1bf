"""Messages that hold packets of a scanner as they came: Velodyne, Hesai, Nebula, Ouster."""

from __future__ import annotations

from typing import NamedTuple

from prc_cli.formats.bags.cursor import Cursor, ShortMessageError

VELODYNE, PANDAR, NEBULA = "velodyne_msgs/VelodyneScan", "pandar_msgs/PandarScan", "nebula_msgs/NebulaPackets"
OUSTER = ("ouster_sensor_msgs/PacketMsg", "ouster_msgs/PacketMsg", "ouster_ros/PacketMsg")
PACKED = (VELODYNE, PANDAR, NEBULA, *OUSTER)
_LEAST = {VELODYNE: 1214, PANDAR: 1512, NEBULA: 12}
"""Least bytes of a packet in a message."""


class PacketOf(NamedTuple):
    """A packet of a message."""

    time_s: float
    """When it was received [s]."""
    data: bytes


def parse_packets(kind: str, data: bytes, time_s: float, *, is_cdr: bool) -> tuple[str, list[PacketOf]]:
    """Return the frame of a message and its packets."""
    cursor = Cursor(data, is_cdr=is_cdr)
    if kind in OUSTER:
        return "", [PacketOf(time_s, cursor.array("u1").tobytes())]
    _, frame = cursor.header()
    n = cursor.number("I")
    if n > len(data) // _LEAST[kind]:
        message = f"says it holds {n} packets, which it is too short for"
        raise ShortMessageError(message)
    packets = []
    for _ in range(n):
        stamp_s = cursor.stamp()
        if kind == VELODYNE:
            packets.append(PacketOf(stamp_s, cursor.array("u1", 1206).tobytes()))
        elif kind == NEBULA:
            packets.append(PacketOf(stamp_s, cursor.array("u1").tobytes()))
        else:
            held = cursor.array("u1", 1500)
            packets.append(PacketOf(stamp_s, held[: cursor.number("I")].tobytes()))
    return frame, packets
