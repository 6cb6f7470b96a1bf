"""Read the UDP datagrams of a capture (pcap, pcapng) over IPv4 and IPv6, in bounded memory."""

from __future__ import annotations

import struct
from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from ipaddress import ip_address
from pathlib import Path
from typing import IO, NamedTuple

from prc_cli.core.errors import InputError
from prc_cli.core.files import open_to_read

MAX_PACKET = 1 << 18
"""Longest packet of a capture, as in libpcap [bytes]."""
MAX_BLOCK = 1 << 24
"""Longest block of a pcapng file that is not a packet [bytes]."""
MAX_PENDING = 64
"""Most incomplete datagrams that are kept."""
MAX_DATAGRAM = 1 << 16
_UDP = 17
_FRAGMENT = 44
_PCAP = {
    b"\xd4\xc3\xb2\xa1": ("<", 1e-6),
    b"\xa1\xb2\xc3\xd4": (">", 1e-6),
    b"\x4d\x3c\xb2\xa1": ("<", 1e-9),
    b"\xa1\xb2\x3c\x4d": (">", 1e-9),
}
"""Byte order and unit of time [s] by the first four bytes."""
_PCAPNG = b"\x0a\x0d\x0d\x0a"
_ETHERNET = 1
_RAW = 101
_LINUX = 113
_LINUX2 = 276
_VLAN = (0x8100, 0x88A8, 0x9100)


class Datagram(NamedTuple):
    """The content of a UDP datagram."""

    time_s: float
    """Capture time of its first packet [s]."""
    source: str
    """Address that sent it."""
    port: int
    """Port that it was sent to."""
    payload: bytes


@dataclass(slots=True)
class CaptureCount:
    """Losses of a capture."""

    n_short: int = 0
    """Packets that were cut by the snapshot length."""
    n_fragments_lost: int = 0
    """Datagrams without one of their fragments."""
    end: str = ""
    """Why the capture ends too early; empty if it does not."""


class _Packet(NamedTuple):
    """A packet of a capture."""

    time_s: float
    link: int
    """Kind of network."""
    data: bytes
    is_complete: bool
    """Whether the capture kept all bytes."""


def read_datagrams(path: Path, count: CaptureCount) -> Iterator[Datagram]:
    """Yield the UDP datagrams of a capture in its order."""
    waiting = _Fragments(count)
    for packet in _packets(path, count):
        ip = _strip_link(packet.link, packet.data)
        datagram = None if ip is None else _strip_ip(ip, packet.time_s, waiting)
        if datagram is not None:
            yield datagram
        elif not packet.is_complete:
            count.n_short += 1
    waiting.finish()


def _packets(path: Path, count: CaptureCount) -> Iterator[_Packet]:
    with open_to_read(path) as handle:
        magic = handle.read(4)
        if magic in _PCAP:
            yield from _pcap(path, handle, *_PCAP[magic], count)
        elif magic == _PCAPNG:
            handle.seek(0)
            yield from _pcapng(path, handle, count)
        else:
            problem = f"begins with {magic.hex()}, expected a capture (pcap or pcapng)"
            hint = "capture with tcpdump or Wireshark, and do not compress it"
            raise InputError(str(path), problem, hint)


def _damaged(path: Path, position: int, problem: str) -> InputError:
    return InputError(f"{path}: byte {position}", problem, "copy it from the archive again")


def _pcap(
    path: Path,
    handle: IO[bytes],
    order: str,
    unit: float,
    count: CaptureCount,
) -> Iterator[_Packet]:
    head = handle.read(20)
    if len(head) < 20:
        count.end = "the capture ends within its header"
        return
    link = struct.unpack(order + "HHiIII", head)[5] & 0xFFFF
    position = 24
    n = 0
    while record := handle.read(16):
        kept, n_sent = struct.unpack(order + "II", record[8:]) if len(record) == 16 else (0, 0)
        if kept > MAX_PACKET:
            raise _damaged(
                path, position, f"found a packet of {kept} bytes, expected at most {MAX_PACKET}"
            )
        data = handle.read(kept)
        if len(record) < 16 or len(data) < kept:
            count.end = f"the capture ends in the middle of packet {n} at byte {position}"
            return
        seconds, part = struct.unpack(order + "II", record[:8])
        yield _Packet(seconds + part * unit, link, data, kept >= n_sent)
        position += 16 + kept
        n += 1


def _pcapng(path: Path, handle: IO[bytes], count: CaptureCount) -> Iterator[_Packet]:
    order = "<"
    position = 0
    interfaces: list[tuple[int, float]] = []
    while head := handle.read(8):
        if head[:4] == _PCAPNG and len(head) == 8:
            mark = handle.read(4)
            order = ">" if mark == b"\x1a\x2b\x3c\x4d" else "<"
            if len(mark) == 4 and mark not in (b"\x1a\x2b\x3c\x4d", b"\x4d\x3c\x2b\x1a"):
                raise _damaged(path, position, "found no byte order of pcapng")
            interfaces = []
            head += mark
        n = struct.unpack_from(order + "I", head, 4)[0] if len(head) >= 8 else 0
        if len(head) >= 8 and (n < 12 or n > MAX_BLOCK or n % 4):
            raise _damaged(
                path, position, f"found a block of {n} bytes, expected 12 to {MAX_BLOCK}"
            )
        body = handle.read(n - len(head)) if len(head) >= 8 else b""
        if len(head) < 8 or len(head) + len(body) < n:
            count.end = f"the capture ends in the middle of a block at byte {position}"
            return
        kind = struct.unpack_from(order + "I", head)[0]
        try:
            if kind == 1:
                interfaces.append(_interface(order, body))
            elif kind in (2, 3, 6):
                yield _packet(kind, order, body, interfaces)
        except (struct.error, IndexError):
            raise _damaged(
                path, position, "found a block that is too short for what it is"
            ) from None
        if len(interfaces) > MAX_PENDING:
            raise _damaged(path, position, f"found more than {MAX_PENDING} interfaces")
        position += n


def _interface(order: str, body: bytes) -> tuple[int, float]:
    """Return the network and the unit of time of an interface (option 9; 10^-6 s without it)."""
    link = struct.unpack_from(order + "H", body)[0]
    unit = 1e-6
    i = 8
    while i + 4 <= len(body) - 4:
        code, n = struct.unpack_from(order + "HH", body, i)
        if code == 0:
            break
        if code == 9 and n == 1:
            power = body[i + 4]
            unit = 2.0 ** -(power & 0x7F) if power & 0x80 else 10.0 ** -min(power, 300)
        i += 4 + n + -n % 4
    return link, unit


def _packet(
    kind: int,
    order: str,
    body: bytes,
    interfaces: list[tuple[int, float]],
) -> _Packet:
    """Return a packet of an enhanced (6), simple (3) or obsolete (2) block."""
    if kind == 3:
        (n_sent,) = struct.unpack_from(order + "I", body)
        data = body[4:-4][:n_sent]
        return _Packet(0.0, interfaces[0][0], data, len(data) >= n_sent)
    form = "IIIII" if kind == 6 else "HxxIIII"
    number, high, low, kept, n_sent = struct.unpack_from(order + form, body)
    link, unit = interfaces[number]
    data = body[20 : 20 + kept]
    return _Packet(((high << 32) | low) * unit, link, data, len(data) >= n_sent)


def _strip_link(link: int, packet: bytes) -> memoryview | None:
    """Return the IP packet in a packet of a network; None if there is none."""
    view = memoryview(packet)
    if link == _RAW or link in (12, 14, 228, 229):
        return view
    if link in (0, 108):
        return view[4:]
    position = {_ETHERNET: 12, _LINUX: 14, _LINUX2: 0}.get(link)
    if position is None or len(packet) < 20:
        return None
    kind = (packet[position] << 8) | packet[position + 1]
    position = 20 if link == _LINUX2 else position + 2
    while kind in _VLAN and len(packet) >= position + 4:
        kind = (packet[position + 2] << 8) | packet[position + 3]
        position += 4
    return view[position:] if kind in (0x0800, 0x86DD) else None


def _strip_ip(ip: memoryview, time_s: float, waiting: _Fragments) -> Datagram | None:
    """Return the UDP datagram in an IP packet, or the one that its fragment completes."""
    version = ip[0] >> 4 if len(ip) >= 20 else 0
    if version == 4:
        head = (ip[0] & 15) * 4
        total = (ip[2] << 8) | ip[3]
        if head < 20 or ip[9] != _UDP:
            return None
        # 0 if the network card cuts packets itself
        total = total or len(ip)
        flags = (ip[6] << 8) | ip[7]
        source = ip[12:16]
        offset = (flags & 0x1FFF) * 8
        more = bool(flags & 0x2000)
        body = ip[head:total]
        if len(ip) < total:
            return None
        if not offset and not more:
            return _udp(source, body, time_s)
        return waiting.add((bytes(ip[12:20]), bytes(ip[4:6])), source, offset, more, body, time_s)
    if version == 6 and len(ip) >= 40:
        body = ip[40 : 40 + ((ip[4] << 8) | ip[5])]
        if ip[6] == _UDP:
            return _udp(ip[8:24], body, time_s)
        if ip[6] == _FRAGMENT and len(body) >= 8 and body[0] == _UDP:
            flags = (body[2] << 8) | body[3]
            key = (bytes(ip[8:40]), bytes(body[4:8]))
            return waiting.add(key, ip[8:24], flags & 0xFFF8, bool(flags & 1), body[8:], time_s)
    return None


def _udp(source: memoryview, body: memoryview, time_s: float) -> Datagram | None:
    if len(body) < 8:
        return None
    length = (body[4] << 8) | body[5]
    if not 8 <= length <= len(body):
        return None
    return Datagram(
        time_s, str(ip_address(bytes(source))), (body[2] << 8) | body[3], bytes(body[8:length])
    )


@dataclass(slots=True)
class _Pending:
    """Fragments of a datagram."""

    source: memoryview
    time_s: float
    parts: dict[int, memoryview] = field(default_factory=dict)
    total: int | None = None
    """Bytes of the datagram; None before its last fragment."""


class _Fragments:
    """Joins fragments; drops the oldest datagram if too many are incomplete."""

    def __init__(self, count: CaptureCount) -> None:
        self._count = count
        self._pending: OrderedDict[tuple[bytes, bytes], _Pending] = OrderedDict()

    def add(
        self,
        key: tuple[bytes, bytes],
        source: memoryview,
        offset: int,
        more: bool,
        body: memoryview,
        time_s: float,
    ) -> Datagram | None:
        if offset + len(body) > MAX_DATAGRAM:
            return None
        pending = self._pending.setdefault(key, _Pending(source, time_s))
        pending.parts[offset] = body
        if not more:
            pending.total = offset + len(body)
        if pending.total is not None and sum(map(len, pending.parts.values())) >= pending.total:
            del self._pending[key]
            content = b"".join(
                bytes(pending.parts[offset_of_part]) for offset_of_part in sorted(pending.parts)
            )
            return _udp(pending.source, memoryview(content[: pending.total]), pending.time_s)
        if len(self._pending) > MAX_PENDING:
            self._pending.popitem(last=False)
            self._count.n_fragments_lost += 1
        return None

    def finish(self) -> None:
        self._count.n_fragments_lost += len(self._pending)
        self._pending.clear()
