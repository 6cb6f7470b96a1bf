"""LAS files for tests of writers, and a small independent parser.

Nothing here is shared with the package.
"""

import io
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import laspy
import lazrs
import numpy as np
from numpy.typing import NDArray

Raw = NDArray[np.uint8]


@dataclass
class Parsed:
    """A LAS or LAZ file taken apart."""

    header: bytes
    vlrs: list[bytes]
    user_bytes: bytes
    records: Raw
    tail: bytes
    form: int
    data: bytes

    def kept_vlrs(self) -> list[bytes]:
        """VLRs that are neither laszip's nor ours."""
        return [vlr for vlr in self.vlrs if not vlr[2:].startswith((b"laszip encoded", b"prc-cli"))]

    def record_payloads(self) -> list[bytes]:
        """Payloads of our run records among the VLRs."""
        return [vlr[54:] for vlr in self.vlrs if vlr[2:].startswith(b"prc-cli\0")]


def field(data: bytes, offset: int, form: str) -> int:
    return int(struct.unpack_from("<" + form, data, offset)[0])


def n_points(data: bytes) -> int:
    return (field(data, 247, "Q") if data[25] == 4 else 0) or field(data, 107, "I")


def parse(path: Path) -> Parsed:
    data = path.read_bytes()
    size = field(data, 94, "H")
    start = field(data, 96, "I")
    n_vlrs = field(data, 100, "I")
    length = field(data, 105, "H")
    form = data[104] & 0x3F
    compressed = bool(data[104] & 0x80)
    vlrs = []
    position = size
    for _ in range(n_vlrs):
        end = position + 54 + field(data, position + 20, "H")
        vlrs.append(data[position:end])
        position = end
    n = n_points(data)
    if compressed:
        laszip = next(vlr[54:] for vlr in vlrs if vlr[2:].startswith(b"laszip encoded"))
        records = np.empty(n * length, np.uint8)
        if n:
            stream = io.BytesIO(data)
            stream.seek(start)
            lazrs.LasZipDecompressor(stream, laszip).decompress_many(records)
        tail_at = field(data, 235, "Q") if data[25] == 4 and field(data, 243, "I") else len(data)
    else:
        tail_at = start + n * length
        records = np.frombuffer(data[start:tail_at], np.uint8).copy()
    return Parsed(
        data[:size],
        vlrs,
        data[position:start],
        records.reshape(n, length),
        data[tail_at:],
        form,
        data,
    )


def same_but_class(before: Parsed, after: Parsed) -> None:
    """Everything of the input is in the output, bit for bit, but for the class bits and the offsets
    that moved."""
    masked = [header_without_moved(item.header) for item in (before, after)]
    assert masked[0] == masked[1]
    assert before.kept_vlrs() == after.kept_vlrs()
    assert before.user_bytes == after.user_bytes
    assert np.array_equal(
        without_class(before.records, before.form), without_class(after.records, after.form)
    )
    assert before.tail == after.tail


def header_without_moved(header: bytes) -> bytes:
    """The header with zeros for what may differ.

    Point offset, number of VLRs, compression bit, tail offsets.
    """
    copy = bytearray(header)
    copy[96:104] = bytes(8)
    copy[104] &= 0x3F
    if header[25] >= 3:
        copy[227:235] = bytes(8)
    if header[25] >= 4:
        copy[235:243] = bytes(8)
    return bytes(copy)


def without_class(records: Raw, form: int) -> Raw:
    copy = records.copy()
    if form < 6:
        copy[:, 15] &= 0xE0
    else:
        copy[:, 16] = 0
    return copy


def classes(parsed: Parsed) -> Raw:
    return parsed.records[:, 15] & np.uint8(0x1F) if parsed.form < 6 else parsed.records[:, 16]


def vlr_bytes(user: bytes, number: int, payload: bytes) -> bytes:
    return struct.pack("<H16sHH32s", 0xAABB, user, number, len(payload), b"kept as it is") + payload


def evlr_bytes(user: bytes, number: int, payload: bytes) -> bytes:
    return struct.pack("<H16sHQ32s", 7, user, number, len(payload), b"kept too") + payload


VLRS = (
    vlr_bytes(b"LASF_Projection", 2112, b'PROJCS["x"]\0'),
    vlr_bytes(b"nobody\0dirt", 77, bytes(range(256))),
)
EVLRS = (evlr_bytes(b"nobody", 5, b"abc" * 50), evlr_bytes(b"LASF_Spec", 65535, bytes(1000)))


EXTRA = (
    laspy.ExtraBytesParams("amplitude", "f4", description="echo [dB]"),
    laspy.ExtraBytesParams("pair", "2u2"),
)


def make_las(
    path: Path,
    form: int,
    *,
    n: int = 300,
    seed: int = 0,
    minor: int | None = None,
    extra: Sequence[laspy.ExtraBytesParams] = EXTRA,
    vlrs: Sequence[bytes] = (),
    evlrs: Sequence[bytes] = (),
    user_bytes: bytes = b"",
    header_user_bytes: bytes = b"",
    raw_points: bool = False,
) -> Parsed:
    """Write a LAS or LAZ file with laspy, then splice in what laspy cannot write.

    Odd header fields are always there. ``raw_points`` fills every bit of the records at random
    (scanner channel 0 in formats 9 and 10, whose waveforms laszip cannot keep otherwise)."""
    rng = np.random.default_rng(seed)
    version = minor or (4 if form >= 6 else 3 if form >= 4 else 2)
    header = laspy.LasHeader(point_format=form, version=f"1.{version}")
    header.scales = np.array([0.001, 0.002, 0.0005])
    header.offsets = np.array([650_000.0, 6_860_000.0, -3.5])
    header.add_extra_dims(list(extra))
    las = laspy.LasData(header)
    length = las.point_format.size
    if raw_points:
        bits = rng.integers(0, 256, (n, length)).astype(np.uint8)
        if form >= 9:
            bits[:, 15] &= 0xCF
    else:
        bits = np.zeros((n, length), np.uint8)
        bits[:, 0:20:4] = rng.integers(0, 256, (n, 5))
        bits[:, 14] = 0x11 if form >= 6 else 0x09
    las.points = laspy.ScaleAwarePointRecord(
        bits.reshape(-1).view(las.point_format.dtype()),
        las.point_format,
        header.scales,
        header.offsets,
    )
    las.write(path)
    data = path.read_bytes()
    parsed = parse(path)
    head = bytearray(parsed.header + header_user_bytes)
    head[4:6] = struct.pack("<H", 4711)  # file source id
    head[6] |= 0x01
    head[8:24] = rng.integers(0, 256, 16).astype(np.uint8).tobytes()  # GUID
    head[26:58] = b"OLD SYSTEM\0with dirt behind the 0"[:32]
    head[58:90] = b"made by \xfc\xe4 in 1999".ljust(32, b"\0")
    head[90:94] = struct.pack("<HH", 366, 1999)
    head[111:131] = struct.pack("<5I", 9, 8, 7, 6, 5)  # counts by return that are wrong stay wrong
    head[179:227] = struct.pack("<6d", 1.5, -1.5, 2.5, -2.5, 3.5, float(-7))
    start = field(data, 96, "I")
    points = data[start : len(data) - len(parsed.tail)]
    every = list(vlrs) + parsed.vlrs
    new_start = len(head) + sum(map(len, every)) + len(user_bytes)
    if data[104] & 0x80:  # the chunk table offset is absolute
        table = struct.unpack_from("<q", points)[0] + new_start - start
        points = struct.pack("<q", table) + points[8:]
    head[94:104] = struct.pack("<HII", len(head), new_start, len(every))
    body = b"".join(every) + user_bytes + points
    if evlrs:
        assert head[25] == 4
        head[235:247] = struct.pack("<QI", len(head) + len(body), len(evlrs))
    path.write_bytes(bytes(head) + body + b"".join(evlrs))
    return parse(path)


def compressed(
    source: Path,
    output: Path,
    chunk_points: int,
    *,
    form: int,
    extra: int,
) -> Parsed:
    """Write a LAS file again as LAZ with chunks of any length."""
    plain = parse(source)
    payload = bytearray(lazrs.LazVlr.new_for_compression(form, extra).record_data())
    struct.pack_into("<I", payload, 12, chunk_points)
    vlr = struct.pack("<H16sHH32s", 0, b"laszip encoded", 22204, len(payload), b"") + bytes(payload)
    head = bytearray(plain.header)
    start = field(plain.data, 96, "I") + len(vlr)
    head[96:104] = struct.pack("<II", start, len(plain.vlrs) + 1)
    head[104] |= 0x80
    points = io.BytesIO(bytes(start))
    points.seek(start)
    compressor = lazrs.LasZipCompressor(points, lazrs.LazVlr(bytes(payload)))
    compressor.compress_many(plain.records.reshape(-1))
    compressor.done()
    body = b"".join([*plain.vlrs, vlr]) + plain.user_bytes + points.getvalue()[start:]
    if plain.tail:
        head[235:243] = struct.pack("<Q", len(head) + len(body))
    output.write_bytes(bytes(head) + body + plain.tail)
    return parse(output)


def make_laz(
    path: Path,
    form: int,
    n: int,
    chunk_points: int,
    seed: int = 0,
) -> Parsed:
    """Records of random bits, hence all scanner channels and return numbers, with extra bytes and
    EVLRs."""
    source = path.with_suffix(".las")
    make_las(source, form, n=n, seed=seed, evlrs=EVLRS, user_bytes=b"between", raw_points=True)
    return compressed(source, path, chunk_points, form=form, extra=8)


def random_laz(path: Path, rng: np.random.Generator) -> None:
    """Any format, chunk size and records.

    Rare return numbers such as 0 of 0, runs of channels and of classes.
    """
    form = int(rng.choice([6, 7, 8]))
    n = int(rng.choice([1, 2, 49, 50, 51, 300]))
    extra = EXTRA if rng.integers(2) else ()
    evlrs = EVLRS[: rng.integers(2)]
    plain = path.with_suffix(".las")
    made = make_las(plain, form, n=n, seed=n, extra=extra, evlrs=evlrs, raw_points=True)
    made.records[:, 14] = rng.choice([0x11, 0x21, 0x22, 0x00, 0x01, 0x10, 0x12, 0xFF], n)
    made.records[:, 15] = np.repeat(rng.integers(0, 4, n) << 4, 10)[:n]
    made.records[:, 16] = np.repeat(rng.integers(0, 256, n), 5)[:n]
    start = field(made.data, 96, "I")
    stop = start + made.records.size
    plain.write_bytes(made.data[:start] + made.records.tobytes() + made.data[stop:])
    chunk_points = int(rng.choice([1, 3, 50, 1000, 1 << 20]))
    compressed(plain, path, chunk_points, form=form, extra=8 if extra else 0)
