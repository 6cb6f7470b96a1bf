"""COPC: classes change, the octree index stays valid."""

import struct
from pathlib import Path

import laspy
import numpy as np

from prc_cli.core.classes import ClassCodes
from prc_cli.formats.las.header import open_bytes, read_header
from tests.formats.common import random_labels, record_blocks, write

OCTREE = Path(__file__).parent / "octree.copc.laz"
"""An octree of two levels and point format 7 in a cube of 16 m, its index in two pages.

It was made with laspy and lazrs.
"""
N = 300


def nodes(path: Path) -> dict[tuple[int, int, int, int], int]:
    """Points of every node, by laspy's own reader, pages included."""
    with laspy.CopcReader.open(str(path)) as reader:
        nodes_by_key: dict[tuple[int, int, int, int], int] = {}
        reader.query(laspy.copc.Bounds(mins=np.zeros(3), maxs=np.full(3, 16.0)))
        for key, entry in reader.root_page.entries.items():
            if entry.point_count >= 0:
                nodes_by_key[key.level, key.x, key.y, key.z] = entry.point_count
    return nodes_by_key


def test_the_index_stays_valid(tmp_path):
    output = tmp_path / "out.copc.laz"
    labels = random_labels(N)
    record = write(output, OCTREE, record_blocks(labels))
    assert not any("COPC" in text for text in record.notices)
    assert nodes(output) == nodes(OCTREE)
    old = laspy.read(str(OCTREE))
    new = laspy.read(str(output))
    np.testing.assert_array_equal(new.classification, ClassCodes().lookup()[labels])
    for name in set(old.point_format.dimension_names) - {"classification"}:
        np.testing.assert_array_equal(old[name], new[name])
    assert [vlr.record_id for vlr in new.evlrs] == [1000, 5]
    # every level, and a part of the box, by the index alone
    for level, low in ((None, 0.0), (0, 0.0), (1, 8.0)):
        box = laspy.copc.Bounds(mins=np.full(3, low), maxs=np.full(3, low + 8.0))
        with laspy.CopcReader.open(str(output)) as reader:
            part = reader.query(box, level=level)
        record_of = np.searchsorted(np.sort(new.gps_time), part.gps_time)
        record_of = np.argsort(new.gps_time)[record_of]
        assert len(part) > 0
        for name in new.point_format.dimension_names:
            np.testing.assert_array_equal(part[name], new[name][record_of])


def test_an_index_that_lies_is_left_out(tmp_path):
    source = tmp_path / "in.copc.laz"
    output = tmp_path / "out.laz"
    good = OCTREE.read_bytes()
    with open_bytes(OCTREE) as opened:
        las = read_header(opened)
    position = next(evlr.start for evlr in las.evlrs if evlr.record_id == 1000) + 60
    for place, value in (
        (position + 16, struct.pack("<Q", 7)),
        (position + 24, struct.pack("<i", 5)),
        (position + 28, struct.pack("<i", 1)),
        (375 + 54 + 40, struct.pack("<Q", 3)),
        (375 + 54 + 48, struct.pack("<Q", 33)),
        (position + 8 * 32 + 16, struct.pack("<Q", position)),
    ):
        data = bytearray(good)
        data[place : place + len(value)] = value
        source.write_bytes(data)
        record = write(output, source, record_blocks(random_labels(N)))
        assert any("the COPC index does not fit" in text for text in record.notices)
        assert len(laspy.read(str(output))) == N
        output.unlink()
        output.with_name("out.laz.prc.json").unlink()
