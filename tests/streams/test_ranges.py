"""Slant ranges from every origin, computed in float64."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from prc_cli.core.errors import InputError
from prc_cli.formats.options import InputConfig
from prc_cli.streams.grid import open_grid
from prc_cli.streams.ranges import RangeRule, measure_ranges, open_ranges
from prc_cli.streams.trajectory import Trajectory
from tests.streams.record_lists import MemorySource, read

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


def test_ranges_from_a_trajectory_file(tmp_path: Path) -> None:
    (tmp_path / "drive.csv").write_text("time,x,y,z\n0,0,0,2\n10,100,0,2\n")
    records = {
        "x": np.array([0.0, 50.0, 100.0]),
        "y": np.array([5.0, 6.0, 7.0]),
        "z": np.full(3, 2.0),
        "time": np.array([0.0, 5.0, 10.0]),
    }
    config = InputConfig(range=f"trajectory:{tmp_path / 'drive.csv'}", points_per_line=3, trajectory_max_gap=20.0)
    whole = read(open_grid(MemorySource(records), config))
    np.testing.assert_allclose(whole.range_m, [[5, 6, 7]])
    assert whole.blocks[0].xyz_m is not None
    (taken,) = opened(config.range).assumptions
    assert taken.value == "trajectory of 2 positions from 0.000 to 10.000 s"
    assert "no lever arm" in taken.why
    shifted = InputConfig(
        range=f"trajectory:{tmp_path / 'drive.csv'}",
        points_per_line=3,
        trajectory_time_offset=5.0,
        trajectory_max_gap=20.0,
    )
    with pytest.raises(InputError, match="outside the trajectory"):
        read(open_grid(MemorySource(records), shifted))
    with pytest.raises(InputError, match="gap"):
        read(open_grid(MemorySource(records), config.model_copy(update={"trajectory_max_gap": 9.0})))
    with pytest.raises(InputError, match="cannot be read"):
        open_grid(MemorySource(records), config.model_copy(update={"range": "trajectory:none.csv"}))
