"""PLY and PCD files and pulse folders, made by code without using the package."""

import struct
from pathlib import Path
from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]
PLY_NAMES = {
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
}


def ply(
    columns: dict[str, Array], form: str = "binary_little_endian", comments: tuple[str, ...] = ()
) -> bytes:
    """A PLY file of one column per property."""
    n = len(next(iter(columns.values())))
    kinds = {name: PLY_NAMES[column.dtype.str[1:]] for name, column in columns.items()}
    head = [
        "ply",
        f"format {form} 1.0",
        *(f"comment {text}" for text in comments),
        f"element vertex {n}",
    ]
    head += [*(f"property {kind} {name}" for name, kind in kinds.items()), "end_header", ""]
    return "\n".join(head).encode() + body(
        columns, {"ascii": "", "binary_big_endian": ">"}.get(form, "<")
    )


def body(columns: dict[str, Array], order: str) -> bytes:
    """Records in a byte order, or as rows of text."""
    if not order:
        rows = zip(*(column.tolist() for column in columns.values()), strict=True)
        return "".join(" ".join(map(repr, row)) + "\n" for row in rows).encode()
    dtype = np.dtype([(name, order + column.dtype.str[1:]) for name, column in columns.items()])
    records = np.empty(len(next(iter(columns.values()))), dtype)
    for name, column in columns.items():
        records[name] = column
    return records.tobytes()


def pcd(
    columns: dict[str, Array],
    data: str = "binary",
    height: int = 1,
    viewpoint: str = "0 0 0 1 0 0 0",
) -> bytes:
    """A PCD file of one column per field."""
    n = len(next(iter(columns.values())))
    kinds = [column.dtype for column in columns.values()]
    head = (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {' '.join(columns)}\nSIZE "
        f"{' '.join(str(kind.itemsize) for kind in kinds)}\n"
        f"TYPE {' '.join(kind.kind.upper() for kind in kinds)}\nCOUNT "
        f"{' '.join('1' for _ in kinds)}\n"
        f"WIDTH {n // height}\nHEIGHT {height}\nVIEWPOINT {viewpoint}\nPOINTS {n}\nDATA {data}\n"
    )
    if data != "binary_compressed":
        return head.encode() + body(columns, "<" if data == "binary" else "")
    raw = b"".join(
        column.astype(column.dtype.newbyteorder("<")).tobytes() for column in columns.values()
    )
    packed = lzf(raw)
    return head.encode() + struct.pack("<II", len(packed), len(raw)) + packed


def lzf(data: bytes) -> bytes:
    """LZF without any copies: literals of up to 32 bytes."""
    parts = (data[first : first + 32] for first in range(0, len(data), 32))
    return b"".join(bytes([len(part) - 1]) + part for part in parts)


def pulse_folder(folder: Path, n_lines: int = 12, m: int = 60) -> Path:
    """A folder of pulses and echoes; returns the file that counts."""
    rng = np.random.default_rng(8)
    n = n_lines * m
    theta = np.arange(n) % m * (2 * np.pi / m) - np.pi
    count = np.where(np.abs(theta) > 2.5, 0, rng.integers(1, 4, n)).astype(np.uint8)
    folder.mkdir(exist_ok=True)
    theta.astype("<f4").tofile(folder / "pulse-float32-theta.bin")
    count.tofile(folder / "pulse-uint8-n_echo.bin")
    (5 + np.arange(count.sum()) % 97 / 10).astype("<f4").tofile(folder / "echo-float32-range.bin")
    rng.uniform(0, 30, count.sum()).astype("<f4").tofile(folder / "echo-float32-amplitude.bin")
    (folder / "time.txt").write_text(f"{n} entries 100.0 + 1e-05 pulse_index")
    return folder / "pulse-uint8-n_echo.bin"
