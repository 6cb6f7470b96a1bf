"""COPC: classes change, the octree index stays valid."""

from __future__ import annotations

import struct
from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.formats.las.header import read_header
from tests.formats.las.copc_files import make_copc
from tests.formats.las.test_rewrite import random_labels, record_blocks, write


def nodes(path: Path) -> dict[tuple[int, int, int, int], int]:
    """Points of every node, by laspy's own reader, pages included."""
    with laspy.CopcReader.open(str(path)) as reader:
        found: dict[tuple[int, int, int, int], int] = {}
        reader.query(laspy.copc.Bounds(mins=np.zeros(3), maxs=np.full(3, 16.0)))
        for key, entry in reader.root_page.entries.items():
            if entry.point_count >= 0:
                found[key.level, key.x, key.y, key.z] = entry.point_count
    return found


@pytest.mark.parametrize("point_format", [6, 7, 8])
@pytest.mark.parametrize("two_pages", [False, True])
def test_the_index_stays_valid(tmp_path: Path, point_format: int, two_pages: bool) -> None:
    source, output = tmp_path / "in.copc.laz", tmp_path / "out.copc.laz"
    points = make_copc(source, point_format, two_pages=two_pages)
    labels = random_labels(len(points))
    record = write(output, source, record_blocks(labels))
    assert not any("COPC" in text for text in record.notices)
    assert nodes(output) == nodes(source)
    old, new = laspy.read(str(source)), laspy.read(str(output))
    assert not np.array_equal(old.classification, new.classification)
    classes = np.array(new.classification)
    for name in old.point_format.dimension_names:
        if name != "classification":
            np.testing.assert_array_equal(old[name], new[name])
    assert [vlr.record_id for vlr in new.evlrs] == [1000, 5]
    # every part of the box, and every level, by the index alone
    for level in (None, 0, 1):
        for low in (0.0, 8.0):
            box = laspy.copc.Bounds(mins=np.full(3, low), maxs=np.full(3, low + 8.0))
            found = []
            for path in (source, output):
                with laspy.CopcReader.open(str(path)) as reader:
                    found.append(reader.query(box, level=level))
            assert len(found[0]) == len(found[1]) > 0
            order = [np.lexsort((one.gps_time, one.x)) for one in found]
            for name in ("X", "Y", "Z", "gps_time", "intensity", "return_number"):
                np.testing.assert_array_equal(found[0][name][order[0]], found[1][name][order[1]])
            # the class of every point found is that of the record
            by_time = dict(zip(new.gps_time.tolist(), classes.tolist(), strict=True))
            got = [by_time[time] for time in np.array(found[1].gps_time).tolist()]
            np.testing.assert_array_equal(np.array(found[1].classification), got)


def test_an_index_that_lies_is_left_out(tmp_path: Path) -> None:
    source, output = tmp_path / "in.copc.laz", tmp_path / "out.laz"
    n = len(make_copc(source))
    data = bytearray(source.read_bytes())
    las = read_header(source)
    at = next(evlr.start for evlr in las.evlrs if evlr.record_id == 1000) + 60
    good = bytes(data)
    for place, value in (
        (at + 16, struct.pack("<Q", 7)), (at + 24, struct.pack("<i", 5)), (at + 28, struct.pack("<i", 1)),
        (375 + 54 + 40, struct.pack("<Q", 3)), (375 + 54 + 48, struct.pack("<Q", 33)),
        (at + 8 * 32 + 16, struct.pack("<Q", at)),
    ):  # fmt: skip
        data[:] = good
        data[place : place + len(value)] = value
        source.write_bytes(data)
        record = write(output, source, record_blocks(random_labels(n)))
        assert any("the COPC index does not fit" in text for text in record.notices)
        assert len(laspy.read(str(output))) == n
        output.unlink()
        output.with_name("out.laz.prc.json").unlink()
