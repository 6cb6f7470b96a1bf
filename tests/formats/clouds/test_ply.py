"""PLY and PCD, read and written."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plyfile import PlyData

from prc_cli.core.blocks import join
from prc_cli.core.classes import ClassCodes
from prc_cli.core.errors import InputError
from prc_cli.formats import binary
from prc_cli.formats.clouds.pcd import decode_lzf
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig, Layout
from prc_cli.formats.records import Source
from prc_cli.streams.open import open_input
from tests.formats.cloud_files import Array, lzf, pcd, ply
from tests.formats.common import random_labels, record_blocks, write

FORMS = ("ascii", "binary_little_endian", "binary_big_endian")
N = 700


def columns() -> dict[str, Array]:
    rng = np.random.default_rng(4)
    return {
        "GPS_time": np.arange(N) * 1e-5 + 54160.0,
        "theta": (np.arange(N) % 70 * 0.05 - 1.5).astype(np.float32),
        "range": rng.uniform(2, 60, N).astype(np.float32),
        "ring": (np.arange(N) % 9).astype(np.uint16),
    }


def opened(path: Path, layout: Layout | None = None) -> Source:
    source = Input.of(path, layout).records()
    assert source is not None
    return source


def read(source: Source, names: tuple[str, ...]) -> dict[str, Array]:
    chunks = list(source.chunks(names))
    return {name: np.concatenate([chunk.values[name] for chunk in chunks]) for name in names}


@pytest.mark.parametrize("form", FORMS)
def test_every_form_gives_the_same_values(tmp_path, form):
    path = tmp_path / "a.ply"
    made = columns()
    path.write_bytes(ply(made, form))
    source = opened(path)
    assert source.n_records == N
    values = read(source, ("time", "angle", "range", "ring"))
    for name, stored in zip(values, made, strict=True):
        np.testing.assert_array_equal(values[name], made[stored])


def test_returns_that_are_listed_again_are_not_shots(tmp_path):
    """The list of a shot is written anew with every return that is added."""
    path = tmp_path / "a.ply"
    lists = {
        1: [(1, 1)],
        2: [(1, 1), (1, 2), (2, 2)],
        3: [(1, 1), (1, 2), (2, 2), (1, 3), (2, 3), (3, 3)],
    }
    n_echo = np.random.default_rng(1).integers(1, 4, 400)
    rows = [
        (shot * 1e-5, shot % 40 * 0.1 - 2, 5.0 + echo, echo, count)
        for shot, n in enumerate(n_echo.tolist())
        for echo, count in lists[n]
    ]
    names = {"GPS_time": "f8", "theta": "f4", "range": "f4", "num_echo": "u1", "nb_of_echo": "u1"}
    made = {
        name: np.array(values, kind)
        for (name, kind), values in zip(names.items(), zip(*rows, strict=True), strict=True)
    }
    path.write_bytes(ply(made, "binary_big_endian"))
    source = opened(path)
    n_copies = int(np.sum(n_echo == 2) + 3 * np.sum(n_echo == 3))
    assert any(
        note.startswith(f"{n_copies} of the first {len(rows)} rows repeat an earlier return")
        for note in source.facts.notes
    )
    block = join(list(open_input(Input.of(path), InputConfig()).blocks()))
    assert np.isfinite(block.range_m).sum() == 400
    assert len(block.extra) == len(rows) - 400
    assert block.tally.n_collisions == 0
    np.testing.assert_array_equal(block.range_m[np.isfinite(block.range_m)], 6.0)


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


VERTEX = "format ascii 1.0\nelement vertex 1\n"
RANGE = "property float range\n"


@pytest.mark.parametrize(
    "head, message",
    [
        (f"format binary_little_endian 1.0\nelement vertex 3\n{RANGE}", "in point 1"),
        (f"format ascii 1.0\nelement vertex 99999\n{RANGE}property int a\n", "after 1"),
        (f"format binary 1.0\nelement vertex 1\n{RANGE}", "found format"),
        (f"{VERTEX}property real range\n", "found the type 'real'"),
        (f"format ascii 1.0\nelement vertex -1\n{RANGE}", "expected a whole number"),
        (f"{VERTEX}property list uchar int a\n", "is a list"),
        (f"format ascii 1.0\nelement face 1\n{RANGE}", "no element vertex, it has face"),
        (f"format ascii 1.0\nelement vertex 0\n{RANGE}", "no points"),
        (f"{VERTEX}property int a\nproperty int a\n", "second time"),
    ],
)
def test_headers_that_lie(tmp_path, head, message):
    path = tmp_path / "a.ply"
    path.write_bytes(f"ply\n{head}end_header\n1 2\n".encode())
    with pytest.raises(InputError, match=message):
        for _ in opened(path).chunks(()):
            pass


@pytest.mark.parametrize(
    "text, message", [(f"ply\n{VERTEX}", "no line end_header"), ("plx\n", "expected ply")]
)
def test_what_is_no_header(tmp_path, text, message):
    (tmp_path / "a.ply").write_text(text)
    with pytest.raises(InputError, match=message):
        opened(tmp_path / "a.ply")


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


DATA = ("ascii", "binary", "binary_compressed")
N_LINES = 13
M = 40


def pcd_columns() -> dict[str, Array]:
    rng = np.random.default_rng(3)
    xyz = rng.uniform(-20, 20, (N_LINES * M, 3)).astype(np.float32)
    xyz[rng.random(len(xyz)) < 0.2] = np.nan
    return {
        **{axis: xyz[:, index] for index, axis in enumerate("xyz")},
        "intensity": rng.integers(0, 900, len(xyz)).astype(np.uint16),
    }


@pytest.mark.parametrize(
    "old, new, message",
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
def test_pcd_headers_that_lie(
    tmp_path,
    data,
    old,
    new,
    message,
):
    path = tmp_path / "a.pcd"
    path.write_bytes(
        pcd(pcd_columns(), data, height=N_LINES).replace(old.encode(), new.encode(), 1)
    )
    with pytest.raises(InputError, match=message):
        Input.of(path).records()


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


@pytest.mark.parametrize("form", ["ascii", "binary_big_endian"])
@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_a_cloud_keeps_its_properties(tmp_path, form, suffix):
    """Class, line and column are added to what was there; plyfile reads it."""
    line, column = np.divmod(np.arange(300, dtype=np.uint32), 20)
    made = {
        "range": np.linspace(2, 60, 300, dtype=np.float32),
        "scan_line": line,
        "column": column,
        "quality": np.arange(300, dtype=np.int16),
    }
    source = tmp_path / f"g{suffix}"
    kind = "ascii" if form == "ascii" else "binary"
    source.write_bytes(ply(made, form, ("a comment",)) if suffix == ".ply" else pcd(made, kind))
    labels = random_labels(300)
    write(tmp_path / "o.ply", source, record_blocks(labels))
    vertex = PlyData.read(str(tmp_path / "o.ply"))["vertex"]
    names = [prop.name for prop in vertex.properties]
    assert names == ["range", "quality", "scan_line", "column", "class"]
    for name, values in made.items():
        np.testing.assert_array_equal(vertex[name], values)
    np.testing.assert_array_equal(vertex["class"], ClassCodes().lookup()[labels])


@pytest.mark.parametrize("has_faces", [False, True])
def test_bytes_behind_the_points_are_told_unless_the_header_names_them(tmp_path, has_faces):
    faces = "element face 1\nproperty list uchar int vertex_indices\n" if has_faces else ""
    head = (
        "ply\nformat binary_little_endian 1.0\nelement vertex 2\nproperty float "
        f"range\n{faces}end_header\n"
    )
    (tmp_path / "a.ply").write_bytes(
        head.encode() + np.array([1.5, 2.5], "<f4").tobytes() + b"\x01\0\0\0\0"
    )
    note = "5 bytes behind the last point were left out: the header does not name them"
    assert (note in opened(tmp_path / "a.ply").facts.notes) != has_faces


def test_points_that_are_not_compressed_are_named(tmp_path):
    """A PCD that says compressed and holds plain points, as pypcd4 writes it."""
    made = {axis: np.arange(1000, dtype=np.float32) for axis in "xyz"}
    head, _, _ = pcd(made, "binary_compressed").partition(b"compressed\n")
    body = np.arange(3000, dtype="<f4").tobytes()
    sizes = struct.pack("<II", len(body), len(body))
    (tmp_path / "a.pcd").write_bytes(head + b"compressed\n" + sizes + body)
    with pytest.raises(InputError, match="the points are not compressed") as caught:
        opened(tmp_path / "a.pcd")
    assert "save it again as binary" in caught.value.hint
