"""Starts of lines by every rule, and ranges from coordinates."""

from typing import Any

import numpy as np
import pytest

from prc_cli.formats.options import InputConfig
from prc_cli.streams.ranges import RangeRule, measure_ranges, open_ranges
from prc_cli.streams.rules import with_elevation
from tests.streams.record_lists import MemorySource

RULES = {"lines": "elevation:20", "columns": "order", "range": "sensor-xyz"}


def points(elevation_deg: Any, length: float = 5.0) -> dict[str, Any]:
    angle = np.deg2rad(np.asarray(elevation_deg, float))
    return {"x": length * np.cos(angle), "y": np.zeros(len(angle)), "z": length * np.sin(angle)}


@pytest.mark.parametrize("chunk", [1, 2, 7])
def test_chunks_change_nothing_and_points_without_elevation_stay(chunk):
    rng = np.random.default_rng(3)
    cloud = points(np.concatenate([np.sort(rng.uniform(-40, 80, 9)) for _ in range(12)]))
    for name in "xyz":
        cloud[name][[0, 20, 47]] = (0.0, 0.0, np.nan)
    rules = InputConfig(**RULES)

    def lines(size: int) -> np.ndarray[Any, Any]:
        source, changed, _ = with_elevation(MemorySource(cloud, chunk_records=size), rules)
        name = changed.lines.partition(":")[2]
        return np.concatenate([part.values[name] for part in source.chunks((name, "angle"))])

    undivided = lines(1000)
    assert undivided.max() == 11
    assert np.array_equal(undivided[20], undivided[19])
    assert np.array_equal(lines(chunk), undivided)


ALL = ("range", "x", "y", "z", "time")


def opened(rule: str, dimensions: tuple[str, ...] = ALL) -> RangeRule:
    return open_ranges(rule, dimensions, "drive.laz", InputConfig(), crs_wkt=None)


def test_millimetres_survive_large_coordinates():
    rule = opened("origin:552000.125,6600000.25,-3")
    values = {
        "x": np.array([552000.125 + 0.003]),
        "y": np.array([6600000.25 - 0.004]),
        "z": np.array([-3.0]),
    }
    range_m, xyz = measure_ranges(values, rule)
    assert range_m.dtype == np.float64
    assert range_m[0] == pytest.approx(0.005, abs=1e-8)
    assert xyz is not None
    np.testing.assert_allclose(xyz[0], [0.003, -0.004, 0.0], atol=1e-8)
