"""A layer of a LAZ chunk declared larger than the file is refused before allocation."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.las.rewrite import copy_las, read_las

N = 120_000


def write(path: Path, point_format: int) -> None:
    header = laspy.LasHeader(point_format=point_format, version="1.4")
    header.add_extra_dim(laspy.ExtraBytesParams("range", "f4"))
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.random.default_rng(3).normal(0, 9, (3, N))
    las["range"] = np.ones(N)
    las.write(path)


@pytest.mark.parametrize("point_format", [6, 7, 8])
def test_one_flipped_byte(tmp_path: Path, point_format: int) -> None:
    source, output = tmp_path / "in.laz", tmp_path / "out.las"
    write(source, point_format)
    data = bytearray(source.read_bytes())
    (at,) = struct.unpack_from("<I", data, 96)
    (record_length,) = struct.unpack_from("<H", data, 105)
    data[at + 8 + record_length + 4 + 4 * 2 + 3] ^= 0x40  # third layer of the first chunk: 1 GB more
    source.write_bytes(data)
    with pytest.raises(
        InputError, match=rf"byte {at + 8}: LAZ chunk 0 \(from record 0\) claims 10\d{{8}} bytes, expected \d+"
    ):
        copy_las(read_las(source), output, tmp_path / "part")
    assert not output.exists()
