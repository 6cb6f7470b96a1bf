"""Pieces of readers and writers at their limits, and what the records of a file hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.formats.input import Input
from prc_cli.formats.records import Contents, watched_contents


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
