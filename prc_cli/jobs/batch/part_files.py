"""What a part of a file found out, on disk: written once by whoever worked on it, read in order when all are there."""

from __future__ import annotations

import json
import math
import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.classifiers.prc.parts import BlockFacts
from prc_cli.core.errors import InputError
from prc_cli.core.files import atomic_output, open_to_read

_MAGIC = b"PRCPART1"
_END = b"PRCPARTEND"
_HEAD = struct.Struct("<IIIIIBI")
"""Lines, lines of the end that are kept, entries of pixels, of smooth and of drawn, bytes a shot, checksum."""
_MAX_HEADER = 1 << 16
_SIZES = (1, 2, 4)


@dataclass(frozen=True, slots=True)
class PartHeader:
    """What a part file belongs to; another one is never taken for it."""

    key: str
    """Hash of input, configuration and program version."""
    first_block: int
    stop_block: int
    points_per_line: int
    """M, shots in a scan line."""

    def to_json(self) -> bytes:
        """Return the header as a line of JSON."""
        return json.dumps(asdict(self), sort_keys=True).encode("ascii") + b"\n"


def write_part(path: Path, header: PartHeader, blocks: Iterable[BlockFacts]) -> None:
    """Write a part; the file exists whole or not at all.

    Raises
    ------
    OutputError
        When it cannot be written.
    """
    with atomic_output(path) as temporary, temporary.open("wb") as handle:
        handle.write(_MAGIC + header.to_json())
        for facts in blocks:
            _write_block(handle, facts)
        handle.write(_END)


def is_part(path: Path, header: PartHeader) -> bool:
    """Tell whether a part is there already, whole: written by an earlier run that was stopped."""
    try:
        with path.open("rb") as handle:
            if handle.read(len(_MAGIC)) != _MAGIC or handle.readline(_MAX_HEADER) != header.to_json():
                return False
            handle.seek(-len(_END), 2)
            return handle.read() == _END
    except OSError:
        return False


def read_part(path: Path, header: PartHeader) -> Iterator[BlockFacts]:
    """Read the blocks of a part in order.

    Raises
    ------
    InputError
        When it is absent, damaged or of something else.
    """
    where = str(path)
    with open_to_read(path) as handle:
        found = handle.read(len(_MAGIC)) + handle.readline(_MAX_HEADER)
        if found != _MAGIC + header.to_json():
            raise _damaged(where, "no part of this file")
        for _ in range(header.first_block, header.stop_block):
            yield _read_block(handle, where, header.points_per_line)
        if handle.read(len(_END) + 1) != _END:
            raise _damaged(where, "its end is not there")


def _write_block(handle: IO[bytes], facts: BlockFacts) -> None:
    image = np.ascontiguousarray(facts.image)
    arrays: list[NDArray[Any]] = [
        facts.first_line.astype("<i4"),
        facts.pixels.astype("<i4"),
        facts.smooth.astype("<i4"),
        facts.drawn.astype("<i4"),
        facts.last_image.astype("<i4"),
        np.packbits(facts.last_supported.ravel()),
        np.packbits(facts.small),
        image.astype(image.dtype.newbyteorder("<"), copy=False),
    ]
    checksum = 0
    for array in arrays:
        checksum = zlib.crc32(array.data, checksum)
    n_last, sizes = len(facts.last_image), (len(facts.pixels), len(facts.smooth), len(facts.drawn))
    handle.write(_HEAD.pack(facts.n_lines, n_last, *sizes, image.itemsize, checksum))
    for array in arrays:
        handle.write(array.data)


def _read_block(handle: IO[bytes], where: str, m: int) -> BlockFacts:
    head = handle.read(_HEAD.size)
    if len(head) < _HEAD.size:
        raise _damaged(where, "it ends early")
    n_lines, n_last, n_pixels, n_smooth, n_drawn, itemsize, checksum = _HEAD.unpack(head)
    # a block has at most one component a shot: nothing larger is believed, or room made for it
    if not (n_lines * m < 1 << 31 and n_last <= n_lines and itemsize in _SIZES):
        raise _damaged(where, "a block has impossible sizes")
    if max(n_pixels, n_smooth, n_drawn) > n_lines * m + 1:
        raise _damaged(where, "a block has more components than shots")
    counts = [(m, "<i4"), (n_pixels, "<i4"), (n_smooth, "<i4"), (n_drawn, "<i4"), (n_last * m, "<i4")]
    counts += [(-(-n_last * m // 8), "u1"), (-(-n_pixels // 8), "u1"), (n_lines * m, f"<u{itemsize}")]
    n_bytes = sum(n * np.dtype(kind).itemsize for n, kind in counts)
    raw = handle.read(n_bytes)
    if len(raw) < n_bytes or zlib.crc32(raw) != checksum:
        raise _damaged(where, "a block is damaged")
    arrays: list[NDArray[Any]] = []
    at = 0
    for n, kind in counts:
        arrays.append(np.frombuffer(raw, kind, n, at))
        at += n * np.dtype(kind).itemsize
    first_line, pixels, smooth, drawn, last_image, supported, small, image = arrays
    shape = (n_last, m)
    return BlockFacts(
        first_line=first_line.astype(np.int32),
        pixels=pixels.astype(np.int64),
        last_supported=np.unpackbits(supported, count=math.prod(shape)).astype(bool).reshape(shape),
        last_image=last_image.astype(np.int32).reshape(shape),
        small=np.unpackbits(small, count=n_pixels).astype(bool),
        smooth=smooth.astype(np.int64),
        image=image.astype(image.dtype.newbyteorder("="), copy=False).reshape(n_lines, m),
        drawn=drawn.astype(np.int32),
    )


def _damaged(where: str, problem: str) -> InputError:
    return InputError(where, f"{problem}, expected a part of this run", "remove it and run again: prc batch redoes it")
