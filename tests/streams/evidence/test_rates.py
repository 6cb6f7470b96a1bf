"""Shot rate, line rate and phase from times alone."""

from __future__ import annotations

from pathlib import Path

import laspy
import numpy as np
import pytest

from prc_cli.config import LoadedConfig, RunConfig, load_config
from prc_cli.core.blocks import join
from prc_cli.jobs.info import inspect
from prc_cli.streams.evidence.periods import measure_rates, measure_sweeps
from prc_cli.streams.open import open_input
from tests.formats.cloud_files import Array


def drive(line_hz: float, m: int, n_lines: int, seed: int = 0) -> tuple[Array, Array, Array]:
    """Times, line and column of the shots that return: a street with a third of sky, and leaves."""
    rng = np.random.default_rng(seed)
    line, column = np.divmod(np.arange(n_lines * m), m)
    sky = np.abs(column - 0.3 * m) < m / 6
    leaves = (np.abs(column - 0.7 * m) < m / 12) & (rng.random(len(line)) < 0.4)
    there = ~sky & ~leaves
    return ((line * m + column) / (line_hz * m) + 1000.0)[there], line[there], column[there]


@pytest.mark.parametrize(("line_hz", "m"), [(54.0, 2154), (48.0, 2154), (100.0, 300)])
@pytest.mark.parametrize("quantum", [0.0, 1e-7])
def test_rates_are_found_where_they_are_right(line_hz: float, m: int, quantum: float) -> None:
    """Shots a second of 54 x 2154 = 116 316, not the 103 392 of 48 lines a second."""
    time, _, _ = drive(line_hz, m, 60)
    if quantum:
        time = np.round(time / quantum) * quantum
    found = measure_rates(time)
    assert found is not None
    assert found.shot_hz == pytest.approx(line_hz * m, rel=2e-6)
    assert found.line_hz == pytest.approx(line_hz, rel=2e-5)
    assert found.points_per_line == m
    # the line begins in the middle of the sky
    phase = (found.time_origin_s - 1000) * line_hz % 1
    assert phase == pytest.approx(0.3, abs=0.01)


def las_of_times(path: Path, time: Array, xyz: Array) -> None:
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = np.full(3, 0.001), np.round(xyz.mean(axis=0))
    las = laspy.LasData(header)
    las.x, las.y, las.z = xyz.T
    las.gps_time = time
    las.return_number[:] = las.number_of_returns[:] = 1
    las.write(str(path))


def test_info_lists_all_that_is_missing_and_its_command_does(tmp_path: Path) -> None:
    """Lines and columns come back as they were; a guess of 48 lines a second makes shots collide."""
    time, line, column = drive(54.0, 2154, 40)
    angle = 2 * np.pi * column / 2154 - 0.6 * np.pi + np.pi
    range_m = np.minimum(2.0 / np.maximum(np.cos(angle), 0.05), 9.0 / np.maximum(np.abs(np.sin(angle)), 0.05))
    xyz = np.stack([5 * time, range_m * np.sin(angle), 2 - range_m * np.cos(angle)], axis=1)
    path, track = tmp_path / "a.laz", tmp_path / "t.csv"
    las_of_times(path, time, xyz)
    track.write_text("time,x,y,z\n" + "".join(f"{t},{5 * t},0,2\n" for t in (999.0, 1001.0)))
    found = inspect(path, LoadedConfig(RunConfig()))
    assert found.missing == ("--range trajectory:FILE",)
    assert "no scan lines, no columns and no ranges" in found.problem
    assert found.hint.startswith("the times show 116316 shots and 54")
    rules = {"range": f"trajectory:{track}"}
    block = join(list(open_input(path, load_config(options={"input": rules}).config.input).blocks()))
    assert block.tally.n_collisions == block.tally.n_unplaced == 0
    record = np.asarray(block.record)
    at_line, at_column = np.nonzero(record >= 0)
    shot = line * 2154 + column
    np.testing.assert_array_equal(np.diff(at_line * 2154 + at_column), np.diff(shot[record[record >= 0]]))
    guess = rules | {"lines": "time:48", "columns": f"time:{48 * 2154}"}
    guessed = inspect(path, load_config(options={"input": guess}))
    assert any("the times show 116316" in note for note in guessed.notes)
    assert guessed.facts is not None
    assert guessed.facts.tally.n_collisions > 1000


@pytest.mark.data
def test_the_real_profiler(real_data: Path) -> None:
    """Four lines, times rounded to four shots: 0.98374 us a shot, 5.0161 ms a line."""
    found = inspect(real_data / "profiler" / "jakarto_0.02s.las", LoadedConfig(RunConfig())).rates
    assert found is not None
    assert 1e6 / found.shot_hz == pytest.approx(0.98374, rel=5e-4)
    assert 1e3 / found.line_hz == pytest.approx(5.0161, rel=1e-4)
    assert abs(found.points_per_line - 5099) <= 2


@pytest.mark.parametrize("field_deg", [250.0, 310.0, 360.0])
@pytest.mark.parametrize("first", [0, 777])
@pytest.mark.parametrize("swaps", [False, True])
def test_the_sweep_tells_lines_of_shots_stamped_anew(field_deg: float, first: int, swaps: bool) -> None:
    """No time for the dead angle: what returns repeats, but where lines begin, and M, came out wrong."""
    _, line, column = drive(50.0, 1000, 300)
    shot = (line * 1000 + column)[first:]
    angle = np.deg2rad(field_deg) * column[first:] / 1000 + 0.3
    angle += np.random.default_rng(0).normal(0, 3e-4 if swaps else 0, len(angle))
    found = measure_sweeps(shot / 50_000.0 + 5e5, angle)
    assert found is not None
    assert found.points_per_line == 1000
    assert found.line_hz == pytest.approx(50.0, rel=1e-6)
    begin = (found.time_origin_s - 5e5) * 50_000.0
    assert begin == pytest.approx(round(begin), abs=0.01)
    if field_deg < 360.0:
        assert round(begin) % 1000 == 0
    assert measure_sweeps(shot / 50_000.0, -angle) is not None
