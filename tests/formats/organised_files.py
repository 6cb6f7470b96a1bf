"""Writers of small PTX and E57 files, valid and damaged."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pye57 import libe57

from tests.clouds import seen

Array = np.ndarray[Any, Any]


def grid_points(
    n_lines: int,
    m: int,
    seed: int = 1,
    missing: float = 0.2,
) -> Array:
    """(n_lines, m, 4): x y z [m] of columns from low to high elevation, intensity 0 to 1.

    All zero = missing.
    """
    rng = np.random.default_rng(seed)
    azimuth = np.linspace(-1.0, 1.0, n_lines)[:, None]
    elevation = np.linspace(-0.8, 0.9, m)[None, :]
    length = rng.uniform(2, 40, (n_lines, m))
    points = np.empty((n_lines, m, 4))
    points[..., :3] = seen(length, azimuth, elevation)
    points[..., 3] = rng.uniform(0, 1, (n_lines, m))
    points = points.round(4)
    points[rng.uniform(size=(n_lines, m)) < missing] = (0, 0, 0, 0.5)
    return points


def turn_x(degrees: float) -> Array:
    """Rotation about x, for column vectors."""
    c = np.cos(np.deg2rad(degrees))
    s = np.sin(np.deg2rad(degrees))
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def ptx_header(
    n_lines: int,
    m: int,
    rotation: Array | None = None,
    shift: Sequence[float] = (0, 0, 0),
    position: Any = None,
) -> str:
    """The ten lines of a scan; ``rotation`` turns column vectors."""
    rows = (np.eye(3) if rotation is None else rotation).T
    position = shift if position is None else position
    text = [f"{n_lines}", f"{m}", " ".join(f"{v:.6f}" for v in position)]
    text += [" ".join(f"{v:.9f}" for v in row) for row in rows]
    text += [" ".join(f"{v:.9f}" for v in row) + " 0" for row in rows]
    text += [" ".join(f"{v:.6f}" for v in shift) + " 1"]
    return "\n".join(text) + "\n"


def ptx_rows(points: Array, colour: bool = False) -> str:
    """One line a point, columns outermost."""
    tail = " 10 20 30" if colour else ""
    return "".join(
        " ".join(f"{v:.4f}" for v in point) + tail + "\n"
        for point in points.reshape(-1, points.shape[-1])
    )


def ptx_scan(points: Array, colour: bool = False, **header: Any) -> str:
    return ptx_header(points.shape[0], points.shape[1], **header) + ptx_rows(points, colour)


def write_text(path: Path, text: str) -> Path:
    path.write_bytes(text.encode())
    return path


@dataclass
class Scan:
    """A scan of an E57 file to be written."""

    fields: dict[str, Array]
    rotation: tuple[float, float, float, float] | None = None
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bounds: tuple[int, int, int, int] | None = None
    limits: tuple[float, float] | None = None


def e57_fields(
    points: Array,
    *,
    keep_missing: bool = False,
) -> dict[str, Array]:
    """Fields of a grid's points, columns outermost.

    Missing cells have no point unless they are to be kept.
    """
    n_lines, m = points.shape[:2]
    column, row = (
        index.ravel() for index in np.meshgrid(np.arange(n_lines), np.arange(m), indexing="ij")
    )
    flat = points.reshape(-1, 4)
    there = np.ones(len(flat), bool) if keep_missing else flat[:, :3].any(axis=1)
    return {
        "cartesianX": flat[there, 0],
        "cartesianY": flat[there, 1],
        "cartesianZ": flat[there, 2],
        "intensity": flat[there, 3],
        "rowIndex": row[there],
        "columnIndex": column[there],
    }


def reordered(fields: dict[str, Array], order: Array) -> dict[str, Array]:
    return {name: values[order] for name, values in fields.items()}


def write_e57(path: Path, scans: Sequence[Scan]) -> Path:
    """Write scans with every field that is given.

    Whole numbers as integers, others as doubles or scaled integers.
    """
    path.unlink(missing_ok=True)
    image = libe57.ImageFile(str(path), "w")
    image.extensionsAdd("", libe57.E57_V1_0_URI)
    root = image.root()
    root.set("formatName", libe57.StringNode(image, "ASTM E57 3D Imaging Data File"))
    root.set("guid", libe57.StringNode(image, "{0}"))
    root.set("versionMajor", libe57.IntegerNode(image, 1))
    root.set("versionMinor", libe57.IntegerNode(image, 0))
    data = libe57.VectorNode(image, True)
    root.set("data3D", data)
    root.set("images2D", libe57.VectorNode(image, True))
    for scan in scans:
        _write_scan(image, data, scan)
    image.close()
    return path


def _write_scan(image: Any, data: Any, scan: Scan) -> None:
    def number(value: float) -> Any:
        is_whole = isinstance(value, int)
        return libe57.IntegerNode(image, value) if is_whole else libe57.FloatNode(image, value)

    def structure(names: Sequence[str], values: Sequence[float]) -> Any:
        node = libe57.StructureNode(image)
        for name, value in zip(names, values, strict=True):
            node.set(name, number(value))
        return node

    node = libe57.StructureNode(image)
    node.set("guid", libe57.StringNode(image, "{1}"))
    if scan.bounds is not None:
        names = ("rowMinimum", "rowMaximum", "columnMinimum", "columnMaximum")
        node.set("indexBounds", structure(names, scan.bounds))
    if scan.limits is not None:
        names = ("intensityMinimum", "intensityMaximum")
        node.set("intensityLimits", structure(names, scan.limits))
    if scan.rotation is not None:
        pose = libe57.StructureNode(image)
        pose.set("rotation", structure("wxyz", [float(value) for value in scan.rotation]))
        pose.set("translation", structure("xyz", scan.translation))
        node.set("pose", pose)
    prototype = libe57.StructureNode(image)
    n = len(next(iter(scan.fields.values())))
    buffers = libe57.VectorSourceDestBuffer()
    kept = []
    for name, values in scan.fields.items():
        if values.dtype.kind in "iu":
            low, high = (int(values.min()), int(values.max())) if n else (0, 0)
            item = libe57.IntegerNode(image, low, low, high)
        else:
            item = libe57.FloatNode(image, 0.0, libe57.E57_DOUBLE)
        prototype.set(name, item)
        kept.append(np.ascontiguousarray(values, np.float64) if n else np.zeros(1))
        buffers.append(libe57.SourceDestBuffer(image, name, kept[-1], max(n, 1), True, True))
    points = libe57.CompressedVectorNode(image, prototype, libe57.VectorNode(image, True))
    node.set("points", points)
    data.append(node)
    writer = points.writer(buffers)
    if n:
        writer.write(n)
    writer.close()


def write_odd_e57(name: str, **changed: Array | None) -> None:
    """Write a scan of 3 x 3 points with other fields, or without those that are None."""
    fields = {**e57_fields(grid_points(3, 3, missing=0)), **changed}
    write_e57(Path(f"{name}.e57"), [Scan({k: v for k, v in fields.items() if v is not None})])


_TABLE = []
for _byte in range(256):
    _crc = _byte
    for _ in range(8):
        _crc = (_crc >> 1) ^ (0x82F63B78 if _crc & 1 else 0)
    _TABLE.append(_crc)


def crc32c(data: bytes) -> int:
    """The checksum of an E57 page (Castagnoli)."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc = (crc >> 8) ^ _TABLE[(crc ^ byte) & 0xFF]
    return crc ^ 0xFFFFFFFF


def with_checksums(raw: bytes) -> bytes:
    """The file with the checksum of every page made right, so that a change in it reaches the
    decoder."""
    pages = [raw[start : start + 1024] for start in range(0, len(raw), 1024)]
    return b"".join(
        page[:1020] + struct.pack(">I", crc32c(page[:1020])) if len(page) == 1024 else page
        for page in pages
    )


def xml_section(raw: bytes) -> tuple[int, int]:
    """First byte and length without checksums of the XML section."""
    start, length = struct.unpack_from("<QQ", raw, 24)
    return start, length


def replace_xml(raw: bytes, old: bytes, new: bytes) -> bytes:
    """The file with another XML section at its end, checksums and header right."""
    start, length = xml_section(raw)
    pages = raw[: start // 1024 * 1024]
    payload = b"".join(
        raw[first_byte : first_byte + 1020] for first_byte in range(len(pages), len(raw), 1024)
    )
    before = payload[: start % 1024]
    xml = payload[start % 1024 : start % 1024 + length]
    assert old in xml, xml.decode()
    xml = xml.replace(old, new)
    payload = before + xml
    payload += b"\0" * (-len(payload) % 1020)
    made = bytearray(
        pages
        + b"".join(
            payload[first_byte : first_byte + 1020] + b"\0\0\0\0"
            for first_byte in range(0, len(payload), 1020)
        )
    )
    struct.pack_into("<Q", made, 16, len(made))
    struct.pack_into("<QQ", made, 24, start, len(xml))
    return with_checksums(bytes(made))
