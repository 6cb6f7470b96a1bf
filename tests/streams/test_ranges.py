"""Slant ranges from every origin, computed in float64."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.options import InputConfig
from prc_cli.streams.ranges import RangeRule, measure_ranges, open_ranges
from prc_cli.streams.trajectory import Trajectory

ALL = ("range", "x", "y", "z", "time")


def opened(rule: str, dimensions: tuple[str, ...] = ALL) -> RangeRule:
    return open_ranges(rule, dimensions, "drive.laz", InputConfig(), crs_wkt=None)


def test_coordinates_of_the_sensor() -> None:
    rule = opened("sensor-xyz")
    assert rule.names == ("x", "y", "z")
    values = {"x": np.array([3.0, np.nan]), "y": np.array([4, 0]), "z": np.array([12.0, 1.0])}
    found, xyz = measure_ranges(values, rule)
    np.testing.assert_array_equal(found, [13.0, np.nan])
    assert xyz is not None
    assert xyz.dtype == np.float32
    np.testing.assert_array_equal(xyz[0], [3, 4, 12])


def test_millimetres_survive_large_coordinates() -> None:
    rule = opened("origin:552000.125,6600000.25,-3")
    values = {"x": np.array([552000.125 + 0.003]), "y": np.array([6600000.25 - 0.004]), "z": np.array([-3.0])}
    found, xyz = measure_ranges(values, rule)
    assert found.dtype == np.float64
    assert found[0] == pytest.approx(0.005, abs=1e-8)
    assert xyz is not None
    np.testing.assert_allclose(xyz[0], [0.003, -0.004, 0.0], atol=1e-8)


def test_along_a_trajectory() -> None:
    track = Trajectory("drive.csv", np.array([0.0, 10.0]), np.array([[0.0, 0.0, 2.0], [100.0, 0.0, 2.0]]))
    rule = RangeRule(trajectory=track)
    assert rule.names == ("x", "y", "z", "time")
    values = {"x": np.array([10.0, 53.0]), "y": np.array([7.0, 4.0]), "z": np.array([2.0, 2.0])}
    found, xyz = measure_ranges({**values, "time": np.array([1.0, 5.0])}, rule)
    np.testing.assert_allclose(found, [7.0, 5.0])
    assert xyz is not None
    np.testing.assert_allclose(xyz, [[0, 7, 0], [3, 4, 0]], atol=1e-6)
    with pytest.raises(InputError, match="1 of 2 point times are outside the trajectory"):
        measure_ranges({**values, "time": np.array([1.0, 11.0])}, rule)
