"""Pieces of readers and writers at their limits, and what the records of a file hold."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest

from prc_cli.formats.input import Input
from prc_cli.formats.records import Contents, watched_contents


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
