"""COPC: classes change, the octree index stays valid."""

from pathlib import Path

import laspy
import numpy as np

from prc_cli.core.classes import ClassCodes
from tests.formats.common import random_labels, record_blocks, write

OCTREE = Path(__file__).parent / "octree.copc.laz"
"""An octree of two levels and point format 7 in a cube of 16 m, its index in two pages.

It was made with laspy and lazrs.
"""
N = 300


def test_the_index_stays_valid(tmp_path):
    output = tmp_path / "out.copc.laz"
    labels = random_labels(N)
    record = write(output, OCTREE, record_blocks(labels))
    assert not any("COPC" in text for text in record.notices)
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
