"""Pieces of readers and writers at their limits, and what the records of a file hold."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from prc_cli.formats.input import Input
from prc_cli.formats.las import laz
from prc_cli.formats.las.header import find_points_per_line, open_bytes, read_header
from prc_cli.formats.las.laz import LazRecords
from prc_cli.formats.organised import ptx
from prc_cli.formats.records import Contents, watched_contents


def lines_of(data: bytes) -> list[bytes]:
    return data.splitlines(keepends=True)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("read", [1, 7])
def test_skipping_lines_equals_reading_them(
    monkeypatch: pytest.MonkeyPatch, seed: int, read: int
) -> None:
    monkeypatch.setattr(ptx, "BLOCK_BYTES", read)
    rng = np.random.default_rng(seed)
    data = b"\n".join(b"x" * n for n in rng.integers(0, 6, 9).tolist()) + (
        b"" if seed % 3 else b"\n"
    )
    every = lines_of(data)
    for n in range(11):
        survey: Any = ptx._Survey.__new__(ptx._Survey)
        survey._handle = io.BytesIO(data)
        survey._line = 7
        survey._path = Path("a.ptx")
        # an empty last line is none
        expected = min(n, len(every))
        assert survey._skip(n) == expected
        assert survey._line == 7 + expected
        assert survey._handle.read() == b"".join(every[n:])


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        (1, 1),
        (0, None),
        (-3, None),
        (True, None),
        (2.0, None),
        ("5", None),
        (2154, 2154),
        (None, None),
    ],
)
def test_points_per_line_of_the_own_record(value: object, expected: int | None) -> None:
    header: Any = SimpleNamespace(
        find=lambda _: [
            b"no json",
            b'{"stream": 3}',
            json.dumps({"stream": {"points_per_line": value}}).encode() + b"\0\0",
        ]
    )
    assert find_points_per_line(header) == expected


@pytest.fixture(scope="module")
def chunks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return 25 records in chunks of 10."""
    import laspy
    import lazrs

    path = tmp_path_factory.mktemp("laz") / "a.laz"
    las = laspy.create(point_format=1, file_version="1.2")
    las.gps_time = np.arange(25.0)
    raw = las.points.array.tobytes()
    vlr = lazrs.LazVlr.new_for_compression(1, 0)
    data = bytearray(
        vlr.record_data().tobytes()
        if hasattr(vlr.record_data(), "tobytes")
        else bytes(vlr.record_data())
    )
    struct.pack_into("<I", data, 12, 10)
    vlr = lazrs.LazVlr(bytes(data))
    las.write(path)
    head = bytearray(path.read_bytes())
    start = struct.unpack_from("<I", head, 96)[0]
    position = bytes(head).index(b"laszip encoded") + 16 + 2 + 2 + 32
    head[position : position + len(data)] = data
    body = io.BytesIO()
    body.write(bytes(head[:start]))
    compressor = lazrs.LasZipCompressor(body, vlr)
    compressor.compress_many(raw)
    compressor.done()
    path.write_bytes(body.getvalue())
    return path


@pytest.mark.parametrize("together", [1, 20 * 28, 16 << 20])
@pytest.mark.parametrize("n_max", [1, 7, 10, 1000])
def test_batches_hold_every_record_once(
    chunks: Path,
    monkeypatch: pytest.MonkeyPatch,
    together: int,
    n_max: int,
) -> None:
    monkeypatch.setattr(laz, "_TOGETHER_BYTES", together)
    with open_bytes(chunks) as source:
        header = read_header(source)
        records = LazRecords(source, header)
        assert records.table.first_record.tolist() == [0, 10, 20, 25]
        assert records.table.first_byte[0] == header.data_offset + 8
        assert records.table.first_byte[-1] == records.table.start
        assert records.table.n_unread == 0
        batches = [(first, bytes(raw)) for first, raw in records.batches(n_max, 0xFFFFFFFF)]
    assert [first for first, _ in batches] == list(
        np.cumsum([0, *(len(raw) // 28 for _, raw in batches)])
    )[:-1]
    assert max(len(raw) for _, raw in batches) <= n_max * 28
    times = (
        np.frombuffer(b"".join(raw for _, raw in batches), np.uint8)
        .reshape(25, 28)[:, 20:]
        .copy()
        .view("<f8")
    )
    assert times.ravel().tolist() == list(range(25))


def counted(path: Path) -> Contents:
    source = Input.of(path).records()
    contents = Contents()
    assert source is not None
    for _ in watched_contents(source, contents):
        pass
    return contents


def test_counts_agree_with_laspy(real_data: Path) -> None:
    """Three strips of an airborne scan, as laspy reads them."""
    laspy = pytest.importorskip("laspy")
    path = real_data / "las" / "three_strips_edge_flags.laz"
    las = laspy.read(path)
    contents = counted(path)
    for axis in "xyz":
        assert contents.bounds_m[axis] == pytest.approx((las[axis].min(), las[axis].max()))
    assert contents.time_s == pytest.approx((las.gps_time.min(), las.gps_time.max()))
    for counts, values in (
        (contents.classes, las.classification),
        (contents.sources, las.point_source_id),
    ):
        assert counts == dict(
            zip(
                *map(np.ndarray.tolist, np.unique(np.asarray(values), return_counts=True)),
                strict=True,
            )
        )
    both = (np.asarray(las.return_number) == 2) & (np.asarray(las.number_of_returns) == 3)
    assert contents.returns["2 of 3"] == np.count_nonzero(both)
    assert contents.is_registered


@pytest.mark.parametrize(
    ("x", "y", "is_registered"),
    [
        ([0, 300], [0, 0], False),
        ([0, 301], [0, 0], True),
        ([0, 0], [-2001, -1990], True),
        ([1900, 2000], [0, 1], False),
    ],
)
def test_coordinates_beyond_a_scanner_are_registered(
    x: list[float], y: list[float], is_registered: bool
) -> None:
    contents = Contents()
    assert contents.is_registered is None
    contents.see({"x": np.array(x, float), "y": np.array(y, float)})
    assert contents.is_registered is is_registered
