"""Tests of what the records of a file hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.formats import open_source
from prc_cli.formats.records import Contents, watched_contents


def counted(path: Path) -> Contents:
    source, found = open_source(path), Contents()
    assert source is not None
    for _ in watched_contents(source, found):
        pass
    return found


def test_counts_agree_with_laspy(real_data: Path) -> None:
    """Three strips of an airborne scan, as laspy reads them."""
    laspy = pytest.importorskip("laspy")
    path = real_data / "las" / "three_strips_edge_flags.laz"
    las, found = laspy.read(path), counted(path)
    for axis in "xyz":
        assert found.bounds_m[axis] == pytest.approx((las[axis].min(), las[axis].max()))
    assert found.time_s == pytest.approx((las.gps_time.min(), las.gps_time.max()))
    for told, values in ((found.classes, las.classification), (found.sources, las.point_source_id)):
        assert told == dict(
            zip(*map(np.ndarray.tolist, np.unique(np.asarray(values), return_counts=True)), strict=True)
        )
    both = (np.asarray(las.return_number) == 2) & (np.asarray(las.number_of_returns) == 3)
    assert found.returns["2 of 3"] == np.count_nonzero(both)
    assert found.is_registered


@pytest.mark.parametrize(
    ("x", "y", "is_registered"),
    [
        ([0, 300], [0, 0], False),
        ([0, 301], [0, 0], True),
        ([0, 0], [-2001, -1990], True),
        ([1900, 2000], [0, 1], False),
    ],
)
def test_coordinates_beyond_a_scanner_are_registered(x: list[float], y: list[float], is_registered: bool) -> None:
    found = Contents()
    assert found.is_registered is None
    found.see({"x": np.array(x, float), "y": np.array(y, float)})
    assert found.is_registered is is_registered
