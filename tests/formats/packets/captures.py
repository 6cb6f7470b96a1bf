"""Captures made by code: frames of datagrams, in pcap and pcapng."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np

SOURCE = bytes([10, 0, 0, 7])
START_S = 1_700_000_000.25


def udp(payload: bytes, port: int = 2368) -> bytes:
    return struct.pack(">HHHH", 4000, port, 8 + len(payload), 0) + payload


def ip4(body: bytes, *, offset: int = 0, more: bool = False, number: int = 1, source: bytes = SOURCE) -> bytes:
    flags = (0x2000 if more else 0) | offset // 8
    head = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(body), number & 0xFFFF, flags, 64, 17, 0)
    return head + source + bytes([255] * 4) + body


def ip6(body: bytes) -> bytes:
    return struct.pack(">IHBB", 6 << 28, len(body), 17, 64) + bytes(15) + b"\7" + bytes(16) + body


def ethernet(packet: bytes, *, vlan: bool = False) -> bytes:
    kind = b"\x86\xdd" if packet[0] >> 4 == 6 else b"\x08\x00"
    return bytes(12) + (b"\x81\x00\x00\x05" if vlan else b"") + kind + packet


def write_pcap(path: Path, frames: list[tuple[float, bytes]], *, order: str = "<", nano: bool = False) -> Path:
    unit = 1e9 if nano else 1e6
    parts = [struct.pack(order + "IHHiIII", 0xA1B23C4D if nano else 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)]
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
        head = struct.pack(order + "IIIII", 0, stamp >> 32, stamp & 0xFFFFFFFF, len(frame), len(frame))
        parts.append(block(6, head + frame))
    path.write_bytes(b"".join(parts))
    return path


def vlp16(n: int = 20, *, seed: int = 3, model: int = 0x22, mode: int = 0x37, start_us: int = 5_000_000) -> list[bytes]:
    """Packets of a VLP-16 that turns at 10 Hz; a tenth of the shots have no return."""
    rng = np.random.default_rng(seed)
    packets = []
    for i in range(n):
        parts = []
        for block in range(12):
            azimuth = ((i * 12 + block) * 40) % 36000
            distance = rng.integers(1000, 1200, 32)
            distance[rng.random(32) < 0.1] = 0
            shots = b"".join(struct.pack("<HB", d, k) for k, d in enumerate(distance.tolist()))
            parts.append(struct.pack("<HH", 0xEEFF, azimuth) + shots)
        stamp = (start_us + round(i * 24 * 55.296)) % 3_600_000_000
        packets.append(b"".join(parts) + struct.pack("<IBB", stamp, mode, model))
    return packets


def framed(packets: list[bytes], port: int = 2368, source: bytes = SOURCE, step_s: float = 0.001327104) -> Any:
    return [
        (START_S + i * step_s, ethernet(ip4(udp(packet, port), number=i, source=source)))
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


def ouster(profile: str = "RNG19_RFL8_SIG16_NIR16", n_frames: int = 2) -> tuple[dict[str, Any], list[bytes]]:
    """Metadata and packets: the range of a pixel is 1000 (frame + 1) + column + 200 row millimetres."""
    table = json.loads(json.dumps(METADATA))
    table["data_format"]["udp_profile_lidar"] = profile
    packets = []
    for frame in range(n_frames):
        for first in range(0, 128, 16):
            body = b""
            for number in range(first, first + 16):
                stamp = (frame * 120 + number) * 1_000_000
                is_good = number < 120
                range_mm = [1000 * (frame + 1) + number + 200 * row for row in range(4)]
                body += _column(profile, stamp, number, frame, is_good, range_mm)
            legacy = profile == "LEGACY"
            head = b"" if legacy else struct.pack("<HH", 1, frame) + bytes(28)
            packets.append(head + body + (b"" if legacy else bytes(32)))
    return table, packets


def _column(profile: str, stamp: int, number: int, frame: int, is_good: bool, range_mm: list[int]) -> bytes:
    if profile == "LEGACY":
        head = struct.pack("<QHHI", stamp, number, frame, 0)
        pixels = [struct.pack("<IHHHH", one, 1, 7, 2, 0) for one in range_mm]
        return head + b"".join(pixels) + struct.pack("<I", 0xFFFFFFFF if is_good else 0)
    head = struct.pack("<QHH", stamp, number, int(is_good))
    if profile == "RNG19_RFL8_SIG16_NIR16":
        return head + b"".join(struct.pack("<IBBHHH", one, 1, 0, 7, 2, 0) for one in range_mm)
    if profile == "RNG15_RFL8_NIR8":
        return head + b"".join(struct.pack("<HBB", one // 8, 7, 1) for one in range_mm)
    return head + b"".join(
        struct.pack("<IIHHHH", one | 1 << 24, (one + 500) * (row % 2) | 1 << 24, 7, 9, 3, 0)
        for row, one in enumerate(range_mm)
    )
