"""Starts of lines by every rule, and ranges from coordinates."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from prc_cli.core.blocks import join
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.stream import ScanBlock
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig
from prc_cli.streams.angles import WrapState, find_sweep, lines_by_wrap
from prc_cli.streams.columns import StampState, spread_stamps
from prc_cli.streams.lines import LineState, lines_by_dimension
from prc_cli.streams.open import open_input
from prc_cli.streams.ranges import RangeRule, measure_ranges, open_ranges
from prc_cli.streams.rules import limits_of, with_elevation
from prc_cli.streams.trajectory import Trajectory
from tests.streams.record_lists import MemorySource

NAN = np.nan
WHERE = "drive.laz: scan_line"


@pytest.mark.parametrize(
    ("number", "shown"), [(3.5, "3.5"), (1e18, r"1e\+18"), (-1e300, r"-1e\+300")]
)
def test_dimension_refuses_what_is_no_line_number(number: float, shown: str) -> None:
    with pytest.raises(
        InputError,
        match=rf"scan_line: found line number {shown}, expected whole numbers; .*--lines",
    ):
        lines_by_dimension(np.array([1.0, number]), LineState(), WHERE)


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("size", [1, 2, 7, 1000])
def test_wrap_of_a_profiler_with_missing_shots(direction: int, size: int) -> None:
    rng = np.random.default_rng(5)
    line = np.repeat(np.arange(30), 36)
    angle = direction * np.tile(np.deg2rad(np.arange(0, 360, 10.0)), 30)
    keep = rng.random(len(line)) < 0.6
    line = line[keep]
    angle = angle[keep]
    angle[rng.random(len(angle)) < 0.05] = NAN
    sweep = find_sweep(angle, "drive.laz")
    assert sweep.direction == direction
    wraps = []
    state = WrapState()
    for start in range(0, len(angle), size):
        part, state = lines_by_wrap(angle[start : start + size], sweep, state)
        wraps.extend(part.tolist())
    # a shot without angle at the end of a line cannot be told from one at its begin
    finite = np.isfinite(angle)
    assert np.array_equal(np.array(wraps)[finite], line[finite])


def test_sweep_needs_angles_of_one_direction() -> None:
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


INF = np.inf


@pytest.mark.parametrize("size", [1, 2, 3, 1000])
def test_equal_stamps_are_spread(size: int) -> None:
    stamps = np.array([1.0, 1.0, 1.0, 2.0, 3.0, 3.0, NAN, NAN, 1.0])
    state = StampState()
    spread = []
    ordinals = []
    for start in range(0, len(stamps), size):
        part, ordinal, state = spread_stamps(stamps[start : start + size], 4.0, state)
        spread.extend(part.tolist())
        ordinals.extend(ordinal.tolist())
    assert ordinals == [0, 1, 2, 0, 0, 1, 0, 0, 0]
    np.testing.assert_array_equal(spread, [1.0, 1.25, 1.5, 2.0, 3.0, 3.25, NAN, NAN, 1.0])


@pytest.mark.parametrize(("origin", "is_told"), [(None, True), (0.5, False)])
def test_the_first_record_begins_the_lines_by_time_unless_told(
    origin: float | None, is_told: bool
) -> None:
    config = InputConfig(
        lines="time:10", columns="time:100", points_per_line=10, time_origin=origin
    )
    keys = {assumption.key for assumption in limits_of(config, "time:10", "time:100", ())}
    assert ("input.time_origin" in keys) == is_told


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
def test_chunks_change_nothing_and_points_without_elevation_stay(chunk: int) -> None:
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


def test_what_cannot_have_lines_by_elevation_is_refused(tmp_path: Path) -> None:
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
    ("name", "n_lines", "longest"), [("car_cloud400.csv", 213, 141), ("car_cloud401.csv", 214, 142)]
)
def test_lines_of_a_rotating_profiler(
    real_data: Path,
    name: str,
    n_lines: int,
    longest: int,
) -> None:
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


def test_coordinates_of_the_sensor() -> None:
    rule = opened("sensor-xyz")
    assert rule.names == ("x", "y", "z")
    values = {"x": np.array([3.0, np.nan]), "y": np.array([4, 0]), "z": np.array([12.0, 1.0])}
    range_m, xyz = measure_ranges(values, rule)
    np.testing.assert_array_equal(range_m, [13.0, np.nan])
    assert xyz is not None
    assert xyz.dtype == np.float32
    np.testing.assert_array_equal(xyz[0], [3, 4, 12])


def test_millimetres_survive_large_coordinates() -> None:
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


def test_along_a_trajectory() -> None:
    track = Trajectory(
        "drive.csv", np.array([0.0, 10.0]), np.array([[0.0, 0.0, 2.0], [100.0, 0.0, 2.0]])
    )
    rule = RangeRule(trajectory=track)
    assert rule.names == ("x", "y", "z", "time")
    values = {"x": np.array([10.0, 53.0]), "y": np.array([7.0, 4.0]), "z": np.array([2.0, 2.0])}
    range_m, xyz = measure_ranges({**values, "time": np.array([1.0, 5.0])}, rule)
    np.testing.assert_allclose(range_m, [7.0, 5.0])
    assert xyz is not None
    np.testing.assert_allclose(xyz, [[0, 7, 0], [3, 4, 0]], atol=1e-6)
    with pytest.raises(InputError, match="1 of 2 point times are outside the trajectory"):
        measure_ranges({**values, "time": np.array([1.0, 11.0])}, rule)
