"""Captures made by code: frames of datagrams, in pcap and pcapng."""

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

SOURCE = bytes([10, 0, 0, 7])
START_S = 1_700_000_000.25
PACKET_S = 0.001327104
"""From one packet to the next [s]."""


def udp(payload: bytes, port: int = 2368) -> bytes:
    return struct.pack(">HHHH", 4000, port, 8 + len(payload), 0) + payload


def ip4(
    body: bytes,
    *,
    offset: int = 0,
    more: bool = False,
    number: int = 1,
    source: bytes = SOURCE,
) -> bytes:
    flags = (0x2000 if more else 0) | offset // 8
    head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(body), number & 0xFFFF, flags, 64, 17, 0)
    return head + source + bytes([255] * 4) + body


def ip6(body: bytes) -> bytes:
    return struct.pack(">IHBB", 6 << 28, len(body), 17, 64) + bytes(15) + b"\7" + bytes(16) + body


def ethernet(packet: bytes, *, vlan: bool = False) -> bytes:
    kind = b"\x86\xdd" if packet[0] >> 4 == 6 else b"\x08\x00"
    return bytes(12) + (b"\x81\x00\x00\x05" if vlan else b"") + kind + packet


def write_pcap(
    path: Path,
    frames: list[tuple[float, bytes]],
    *,
    order: str = "<",
    nano: bool = False,
    link: int = 1,
) -> Path:
    unit = 1e9 if nano else 1e6
    parts = [
        struct.pack(order + "IHHiIII", 0xA1B23C4D if nano else 0xA1B2C3D4, 2, 4, 0, 0, 65535, link)
    ]
    for time_s, frame in frames:
        whole, part = divmod(round(time_s * unit), round(unit))
        parts += [struct.pack(order + "IIII", whole, part, len(frame), len(frame)), frame]
    path.write_bytes(b"".join(parts))
    return path


def write_pcapng(path: Path, frames: list[tuple[float, bytes]], *, order: str = "<") -> Path:
    def block(kind: int, body: bytes) -> bytes:
        body += bytes(-len(body) % 4)
        n = struct.pack(order + "I", len(body) + 12)
        return struct.pack(order + "I", kind) + n + body + n

    options = struct.pack(order + "HHBxxx", 9, 1, 9) + bytes(4)
    parts = [
        block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1)),
        block(1, struct.pack(order + "HHI", 1, 0, 65535) + options),
        block(0xBAD, b"of a later version"),
    ]
    for time_s, frame in frames:
        stamp = round(time_s * 1e9)
        head = struct.pack(
            order + "IIIII", 0, stamp >> 32, stamp & 0xFFFFFFFF, len(frame), len(frame)
        )
        parts.append(block(6, head + frame))
    path.write_bytes(b"".join(parts))
    return path


def vlp16(
    n: int = 20,
    *,
    model: int = 0x22,
    mode: int = 0x37,
) -> list[bytes]:
    """Packets of a VLP-16 that turns at 10 Hz; a tenth of the shots have no return."""
    return velodyne(n, model, mode=mode, firings=2)


BANKS = {0xA1: (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF), 0x40: (0xEEFF, 0xDDFF)}
"""Flags of the blocks of a column: VLS-128, and an HDL-64E, whose packets hold no number."""


def velodyne(
    n: int,
    model: int,
    *,
    seed: int = 3,
    mode: int = 0x37,
    start_us: int = 5_000_000,
    firings: int = 1,
) -> list[bytes]:
    """Packets of a Velodyne, 55.296 us (HDL-32E: 46.08, HDL-64E: 48) from column to column."""
    rng = np.random.default_rng(seed)
    flags = BANKS.get(model, (0xEEFF,))
    returns = 2 if mode == 0x39 else 1
    used = 12 // (len(flags) * returns) * len(flags) * returns
    columns = used * firings // (len(flags) * returns)
    period_us = {0x21: 46.08, 0x40: 48.0}.get(model, 55.296)
    packets = []
    for i in range(n):
        parts = []
        for block in range(12):
            group, bank = divmod(block // returns, len(flags))
            if model == 0x22:
                # both returns of a dual mode turn on here: a reader takes every other azimuth
                group = block
            azimuth = (round((i * columns // firings + group) * 20 * firings)) % 36000
            distance = rng.integers(1000, 1200, 32)
            distance[rng.random(32) < 0.1] = 0
            shots = b"".join(struct.pack("<HB", d, k) for k, d in enumerate(distance.tolist()))
            flag = flags[bank] if block < used else 0
            parts.append(struct.pack("<HH", flag, azimuth) + shots)
        stamp = (start_us + round(i * columns * period_us)) % 3_600_000_000
        packets.append(b"".join(parts) + struct.pack("<IBB", stamp, mode, model))
    return packets


HESAI = {
    "40P": (b"\xff\xee", 1262, 40, 10, 0, 3, 14, 10),
    "64": (b"\xee\xff\x40\x06", 1194, 64, 6, 8, 3, 14, 10),
    "QT64": (b"\xee\xff\x03\x01", 1072, 64, 4, 12, 4, 16, 12),
    "QT128": (b"\xee\xff\x03\x02", 1127, 128, 2, 12, 4, 33, 42),
    "XT16": (b"\xee\xff\x06\x01", 568, 16, 8, 12, 4, 10, 19),
    "XT32": (b"\xee\xff\x06\x01", 1080, 32, 8, 12, 4, 10, 19),
    "XT32M": (b"\xee\xff\x06\x01", 820, 32, 6, 12, 4, 10, 19),
    "128": (b"\xee\xff\x01\x03", 861, 128, 2, 12, 3, 33, 42),
    "OT128": (b"\xee\xff\x01\x04", 861, 128, 2, 12, 3, 33, 42),
}
"""First bytes, size, channels, blocks, bytes of header and shot, places of mode and time behind the
blocks."""


COLUMN_US = {
    "40P": 55.56,
    "64": 55.56,
    "QT64": 166.67,
    "QT128": 111.11,
    "128": 55.556,
    "OT128": 55.556,
}
"""From column to column; the others need 50."""


def hesai(
    name: str,
    n: int = 4,
    *,
    mode: int = 0x37,
) -> tuple[list[bytes], np.ndarray]:
    """Packets of a Hesai, and the distances in them in units of 4 mm, (blocks, channels)."""
    start, size, channels, n_blocks, head, shot, mode_at, time_at = HESAI[name]
    rng = np.random.default_rng(5)
    column_us = COLUMN_US.get(name, 50.0)
    returns = 2 if mode == 0x39 else 1
    packets = []
    every = []
    for i in range(n):
        packet = bytearray(size)
        packet[: len(start)] = start
        if head == 8:
            packet[5] = 4
        if head == 12:
            packet[6:10] = channels, n_blocks, 0, 4
        flag = 0 if head else 2
        stride = flag + 2 + shot * channels
        for block in range(n_blocks):
            distance = rng.integers(1000, 1200, channels)
            distance[rng.random(channels) < 0.1] = 0
            position = head + stride * block
            packet[position : position + flag] = b"\xff\xee"[:flag]
            struct.pack_into("<H", packet, position + flag, (i * n_blocks + block) // returns * 20)
            for k, millimetres in enumerate(distance.tolist()):
                struct.pack_into("<HB", packet, position + flag + 2 + shot * k, millimetres, k)
            every.append(distance)
        end = head + stride * n_blocks
        packet[end + mode_at] = mode
        struct.pack_into("<I", packet, end + time_at, round(i * n_blocks // returns * column_us))
        packets.append(bytes(packet))
    return packets, np.array(every)


def framed(
    packets: list[bytes],
    port: int = 2368,
) -> Any:
    return [
        (START_S + i * PACKET_S, ethernet(ip4(udp(packet, port), number=i)))
        for i, packet in enumerate(packets)
    ]


METADATA = {
    "beam_altitude_angles": [15.0, 5.0, -5.0, -15.0],
    "beam_azimuth_angles": [3.0, -3.0, 3.0, -3.0],
    "data_format": {
        "columns_per_frame": 120,
        "columns_per_packet": 16,
        "column_window": [0, 119],
        "pixels_per_column": 4,
        "pixel_shift_by_row": [2, 0, 2, 0],
        "udp_profile_lidar": "RNG19_RFL8_SIG16_NIR16",
    },
    "lidar_origin_to_beam_origin_mm": 15.0,
    "prod_line": "OS-1-4",
}


def ouster(
    profile: str = "RNG19_RFL8_SIG16_NIR16", *, good: int = 120
) -> tuple[dict[str, Any], list[bytes]]:
    """Metadata and packets: the range of a pixel is 1000 (frame + 1) + column + 200 row
    millimetres."""
    table = json.loads(json.dumps(METADATA))
    table["data_format"]["udp_profile_lidar"] = profile
    packets = []
    for frame in range(2):
        for first in range(0, 128, 16):
            body = b""
            for number in range(first, first + 16):
                stamp = (frame * 120 + number) * 1_000_000
                is_good = number < good
                range_mm = [1000 * (frame + 1) + number + 200 * row for row in range(4)]
                body += _column(profile, stamp, number, frame, is_good, range_mm)
            legacy = profile == "LEGACY"
            head = b"" if legacy else struct.pack("<HH", 1, frame) + bytes(28)
            packets.append(head + body + (b"" if legacy else bytes(32)))
    return table, packets


def _column(
    profile: str,
    stamp: int,
    number: int,
    frame: int,
    is_good: bool,
    range_mm: list[int],
) -> bytes:
    if profile == "LEGACY":
        head = struct.pack("<QHHI", stamp, number, frame, 0)
        pixels = [struct.pack("<IHHHH", millimetres, 1, 7, 2, 0) for millimetres in range_mm]
        return head + b"".join(pixels) + struct.pack("<I", 0xFFFFFFFF if is_good else 0)
    head = struct.pack("<QHH", stamp, number, int(is_good))
    if profile == "RNG19_RFL8_SIG16_NIR16":
        return head + b"".join(
            struct.pack("<IBBHHH", millimetres, 1, 0, 7, 2, 0) for millimetres in range_mm
        )
    if profile == "RNG15_RFL8_NIR8":
        return head + b"".join(
            struct.pack("<HBB", millimetres // 8, 7, 1) for millimetres in range_mm
        )
    return head + b"".join(
        struct.pack(
            "<IIHHHH", millimetres | 1 << 24, (millimetres + 500) * (row % 2) | 1 << 24, 7, 9, 3, 0
        )
        for row, millimetres in enumerate(range_mm)
    )
