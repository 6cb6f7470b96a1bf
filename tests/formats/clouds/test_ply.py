"""PLY and PCD, read and written."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plyfile import PlyData

from prc_cli.core.blocks import join
from prc_cli.core.classes import ClassCodes
from prc_cli.formats import binary
from prc_cli.formats.clouds.pcd import decode_lzf
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig
from prc_cli.formats.records import Source
from prc_cli.streams.open import open_input
from tests.formats.cloud_files import lzf, pcd, ply
from tests.formats.common import random_labels, record_blocks, write


def opened(path: Path) -> Source:
    source = Input.of(path).records()
    assert source is not None
    return source


@pytest.mark.parametrize("rows", [1, 7, 64, 1000])
def test_shots_do_not_depend_on_chunks(tmp_path, monkeypatch, rows):
    """A shot whose returns lie in two chunks is one shot, and no chunk waits for the next but for
    its last shot."""
    path = tmp_path / "a.ply"
    n_echo = np.random.default_rng(2).integers(1, 4, 300)
    shot = np.repeat(np.arange(300), n_echo)
    echo = np.arange(len(shot)) - np.repeat(np.cumsum(n_echo) - n_echo, n_echo) + 1
    made = {
        "GPS_time": shot * 1e-5,
        "range": echo.astype("f4"),
        "num_echo": echo.astype("u1"),
        "nb_of_echo": n_echo[shot].astype("u1"),
    }
    path.write_bytes(ply(made))
    monkeypatch.setattr(binary, "CHUNK_RECORDS", rows)
    names = ("return_number", "number_of_returns")
    chunks = list(opened(path).chunks(names))
    assert max(chunk.n for chunk in chunks) <= rows + 3
    values = {name: np.concatenate([chunk.values[name] for chunk in chunks]) for name in names}
    np.testing.assert_array_equal(values["return_number"], echo)
    np.testing.assert_array_equal(values["number_of_returns"], n_echo[shot])
    assert [chunk.first_record for chunk in chunks] == np.cumsum(
        [0, *(chunk.n for chunk in chunks)]
    )[:-1].tolist()


@pytest.mark.data
@pytest.mark.parametrize("number", [1, 4])
def test_the_profiler_of_ign(real_data, number):
    """The cells of the stream hold what plyfile reads, at the angle that the row says."""
    path = real_data / "riegl" / f"sample_riegl_18_0{number}.ply"
    row = PlyData.read(str(path))["vertex"].data
    stream = open_input(Input.of(path), InputConfig())
    block = join(list(stream.blocks()))
    assert stream.info.points_per_line == 2917
    record = block.records()
    there = record >= 0
    np.testing.assert_array_equal(block.range_m[there], row["range"][record[there]])
    angle = np.broadcast_to(np.asarray(stream.info.angle_rad), there.shape)[there]
    away = np.unwrap(np.stack([row["theta"][record[there]], angle]), axis=0)
    assert np.abs(np.diff(away, axis=0)).max() < 2.1 * 2 * np.pi / 2917
    seen = np.sort(np.concatenate([record[there], block.extra.record]))
    np.testing.assert_array_equal(seen, np.arange(len(row)))
    n_shots = len(np.unique(row["GPS_time"]))
    assert there.sum() + block.tally.n_collisions == n_shots
    assert block.tally.n_collisions < 0.003 * n_shots


@given(
    st.lists(
        st.binary(min_size=1, max_size=32) | st.tuples(st.integers(0, 8191), st.integers(3, 264)),
        max_size=50,
    )
)
def test_lzf_is_what_its_tokens_say(tokens):
    """Literals, and copies from so many bytes back of so many bytes."""
    packed = bytearray()
    data = bytearray(b"a")
    for token in (b"a", *tokens):
        if isinstance(token, bytes):
            packed += bytes([len(token) - 1]) + token
            data += token if len(packed) > 2 else b""
            continue
        back = token[0] % len(data)
        for _ in range(token[1]):
            data.append(data[-back - 1])
        length = token[1] - 2
        packed.append(min(length, 7) << 5 | back >> 8)
        packed += bytes([length - 7, back & 255] if length >= 7 else [back & 255])
    assert decode_lzf(memoryview(packed), len(data)) == data


@pytest.mark.parametrize("seed", range(3))
def test_damaged_lzf_is_told(seed):
    rng = np.random.default_rng(seed)
    packed = lzf(rng.integers(0, 3, 900, np.uint8).tobytes())
    for _ in range(300):
        damaged = bytearray(packed)
        damaged[rng.integers(len(damaged))] = rng.integers(256)
        unpacked = decode_lzf(memoryview(damaged[: rng.integers(1, len(damaged) + 1)]), 900)
        assert unpacked is None or len(unpacked) == 900


@pytest.mark.parametrize("form", ["ascii", "binary", "binary_little_endian", "binary_big_endian"])
def test_a_cloud_keeps_its_properties_as_plyfile_reads_them(tmp_path, form):
    """Class, line and column are added to what was there."""
    line, column = np.divmod(np.arange(300, dtype=np.uint32), 20)
    made = {
        "range": np.linspace(2, 60, 300, dtype=np.float32),
        "scan_line": line,
        "column": column,
        "quality": np.arange(300, dtype=np.int16),
    }
    source = tmp_path / ("g.pcd" if form == "binary" else "g.ply")
    source.write_bytes(pcd(made, form) if form == "binary" else ply(made, form))
    labels = random_labels(300)
    write(tmp_path / "o.ply", source, record_blocks(labels))
    vertex = PlyData.read(str(tmp_path / "o.ply"))["vertex"]
    made["class"] = ClassCodes().lookup()[labels]
    assert {prop.name for prop in vertex.properties} == made.keys()
    for name, values in made.items():
        np.testing.assert_array_equal(vertex[name], values)
