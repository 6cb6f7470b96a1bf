"""Starts of lines by every rule, and ranges from coordinates."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.blocks import join
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.stream import ScanBlock
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig
from prc_cli.streams.angles import find_sweep
from prc_cli.streams.lines import LineState, lines_by_dimension
from prc_cli.streams.open import open_input
from prc_cli.streams.ranges import RangeRule, measure_ranges, open_ranges
from prc_cli.streams.rules import with_elevation
from tests.streams.record_lists import MemorySource

NAN = np.nan
WHERE = "drive.laz: scan_line"


@pytest.mark.parametrize("number, shown", [(3.5, "3.5"), (1e18, r"1e\+18"), (-1e300, r"-1e\+300")])
def test_dimension_refuses_what_is_no_line_number(number, shown):
    with pytest.raises(
        InputError,
        match=rf"scan_line: found line number {shown}, expected whole numbers; .*--lines",
    ):
        lines_by_dimension(np.array([1.0, number]), LineState(), WHERE)


def test_sweep_needs_angles_of_one_direction():
    with pytest.raises(
        InputError,
        match=r"drive.laz: the scan angle does not vary in 9 shots, expected sweeps; find l",
    ):
        find_sweep(np.zeros(9), "drive.laz")
    with pytest.raises(InputError, match="does not vary in 0 shots"):
        find_sweep(np.full(9, NAN), "drive.laz")
    there_and_back = np.tile(np.concatenate([np.arange(50), 50 - np.arange(50)]), 5)
    with pytest.raises(
        InputError,
        match="grows in 25[0-9] steps and falls in 24[0-9], expected sweeps of one direc",
    ):
        find_sweep(there_and_back, "drive.laz")


RULES = {"lines": "elevation:20", "columns": "order", "range": "sensor-xyz"}


def points(elevation_deg: Any, length: float = 5.0) -> dict[str, Any]:
    angle = np.deg2rad(np.asarray(elevation_deg, float))
    return {"x": length * np.cos(angle), "y": np.zeros(len(angle)), "z": length * np.sin(angle)}


def write(path: Path, columns: dict[str, Any]) -> Path:
    rows = zip(*(columns[name] for name in "xyz"), strict=True)
    path.write_text(
        "x,y,z\n" + "".join(",".join(repr(float(value)) for value in row) + "\n" for row in rows)
    )
    return path


def whole(path: Path, **rules: Any) -> ScanBlock:
    return join(list(open_input(Input.of(path), InputConfig(**{**RULES, **rules})).blocks()))


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


def test_what_cannot_have_lines_by_elevation_is_refused(tmp_path):
    path = write(tmp_path / "a.csv", points([-30, 0]))
    with pytest.raises(ConfigError, match=r"elevation:DEG with 0 < \|DEG\| < 180"):
        whole(path, lines="elevation:0")
    with pytest.raises(ConfigError, match="expected sensor-xyz"):
        whole(path, range="origin:0,0,0")
    ranges = tmp_path / "r.csv"
    ranges.write_text("range,column\n1,0\n2,1\n")
    with pytest.raises(ConfigError, match="has no x, y, z"):
        whole(ranges)
    assert whole(path, range="auto").n_lines == 1


@pytest.mark.data
@pytest.mark.parametrize(
    "name, n_lines, longest", [("car_cloud400.csv", 213, 141), ("car_cloud401.csv", 214, 142)]
)
def test_lines_of_a_rotating_profiler(
    real_data,
    name,
    n_lines,
    longest,
):
    from prc_cli.formats.options import Layout, LayoutField

    fields = tuple(LayoutField(name=axis, source=index) for index, axis in enumerate("xyz"))
    layout = (
        None if name.endswith("400.csv") else Layout(delimiter=" ", header=False, fields=fields)
    )
    stream = open_input(Input.of(real_data / "organised" / name, layout), InputConfig(**RULES))
    block = join(list(stream.blocks()))
    assert block.range_m.shape == (n_lines, longest)
    assert (block.records() >= 0).sum(axis=1).min() >= 61


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
