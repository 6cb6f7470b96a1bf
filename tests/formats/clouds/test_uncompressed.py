"""A PCD that says compressed and holds plain points, as pypcd4 writes it."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.clouds.pcd import open_pcd


def test_points_that_are_not_compressed_are_named(tmp_path: Path) -> None:
    body = np.arange(3000, dtype="<f4").tobytes()
    head = (
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1000\nHEIGHT "
        "1\nPOINTS 1000\n"
    )
    packed = (
        head.encode()
        + b"DATA binary_compressed\n"
        + struct.pack("<II", len(body), len(body))
        + body
    )
    (tmp_path / "a.pcd").write_bytes(packed)
    with pytest.raises(InputError, match="the points are not compressed") as caught:
        open_pcd(tmp_path / "a.pcd")
    assert "save it again as binary" in caught.value.hint
