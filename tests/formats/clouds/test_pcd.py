"""PCD: text, binary and compressed; organised clouds; headers that lie."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.blocks import join
from prc_cli.core.errors import InputError
from prc_cli.formats import open_source
from prc_cli.formats.clouds.pcd import decode_lzf
from prc_cli.formats.options import InputConfig
from prc_cli.streams.open import open_input
from tests.formats.cloud_files import Array, lzf, pcd

DATA = ("ascii", "binary", "binary_compressed")
N_LINES, M = 13, 40


def columns() -> dict[str, Array]:
    rng = np.random.default_rng(3)
    xyz = rng.uniform(-20, 20, (N_LINES * M, 3)).astype(np.float32)
    xyz[rng.random(len(xyz)) < 0.2] = np.nan
    return {
        **{axis: xyz[:, at] for at, axis in enumerate("xyz")},
        "intensity": rng.integers(0, 900, len(xyz)).astype(np.uint16),
    }


@pytest.mark.parametrize("data", DATA)
def test_an_organised_cloud_keeps_its_empty_cells(tmp_path: Path, data: str) -> None:
    path, made = tmp_path / "a.pcd", columns()
    path.write_bytes(pcd(made, data, height=N_LINES))
    stream = open_input(path, InputConfig())
    assert stream.info.points_per_line == M
    block = join(list(stream.blocks()))
    xyz = np.stack([made[axis] for axis in "xyz"], axis=1).astype(float)
    expected = np.sqrt((xyz**2).sum(axis=1)).reshape(N_LINES, M)
    np.testing.assert_allclose(block.range_m, expected, rtol=1e-6)
    np.testing.assert_array_equal(np.asarray(block.intensity).ravel(), made["intensity"])


def test_fields_of_several_numbers_and_padding(tmp_path: Path) -> None:
    path = tmp_path / "a.pcd"
    head = "VERSION .7\nFIELDS range _ h\nSIZE 4 1 2\nTYPE F U I\nCOUNT 1 3 2\nWIDTH 2\nPOINTS 2\nDATA binary\n"
    path.write_bytes(head.encode() + struct.pack("<f3xhhf3xhh", 1.5, 1, 2, 2.5, 3, 4))
    source = open_source(path)
    assert source is not None
    assert source.dimensions == ("range", "h_0", "h_1")
    (chunk,) = source.chunks(("h_1", "range"))
    assert chunk.values["h_1"].tolist() == [2, 4]
    assert chunk.values["range"].tolist() == [1.5, 2.5]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("WIDTH 40", "WIDTH 41", "WIDTH 41 x HEIGHT 13 = 533 points, but POINTS 520"),
        ("WIDTH 40\nHEIGHT 13", "WIDTH 4000\nHEIGHT 1300", "but POINTS 520"),
        ("POINTS 520", "POINTS 5200", "but POINTS 5200"),
        ("SIZE 4 4 4 2", "SIZE 4 4 4 3", "of type U and 3 bytes"),
        ("COUNT 1 1 1 1", "COUNT 1 1 1", "3 COUNT, expected as many"),
        ("DATA ", "DATA x", "found DATA"),
        ("FIELDS x", "FIELDS y", "equal names"),
        ("VIEWPOINT 0", "VIEWPOINT nan", "seven numbers"),
        ("VERSION", "VERSIOM", "expected each of"),
    ],
)
@pytest.mark.parametrize("data", DATA)
def test_headers_that_lie(tmp_path: Path, data: str, old: str, new: str, told: str) -> None:
    path = tmp_path / "a.pcd"
    path.write_bytes(pcd(columns(), data, height=N_LINES).replace(old.encode(), new.encode(), 1))
    with pytest.raises(InputError, match=told):
        open_source(path)


def test_lzf_gives_back_what_was_packed() -> None:
    rng = np.random.default_rng(0)
    for size in (0, 1, 2, 31, 32, 33, 500, 20_000):
        for data in (bytes(size), rng.bytes(size), rng.integers(0, 3, size, np.uint8).tobytes()):
            assert decode_lzf(memoryview(lzf(data)), size) == data


@pytest.mark.parametrize("seed", range(3))
def test_damaged_lzf_is_told(seed: int) -> None:
    rng = np.random.default_rng(seed)
    packed = lzf(rng.integers(0, 3, 900, np.uint8).tobytes())
    for _ in range(300):
        damaged = bytearray(packed)
        damaged[rng.integers(len(damaged))] = rng.integers(256)
        found = decode_lzf(memoryview(damaged[: rng.integers(1, len(damaged) + 1)]), 900)
        assert found is None or len(found) == 900
