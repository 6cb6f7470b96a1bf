"""What is guessed of a stream, and the sample that is judged."""

import csv
import gzip
from collections.abc import Iterator

import laspy
import numpy as np
import pytest

from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32
from prc_cli.jobs.choice import choice_by_beams
from prc_cli.streams.evidence.figures import LineSample
from prc_cli.streams.evidence.periods import estimate_points_per_line, measure_rates, shot_period
from prc_cli.streams.evidence.place import MOST_LINES, SAMPLE_LINES, place_of, place_of_blocks
from tests.formats.cloud_files import Array
from tests.methods.fused.street_lines import BEAM, street_lines


def street(m: int, n_lines: int, seed: int = 0) -> np.ndarray:
    """Lines of a rough profile that changes slowly along the way, 15 % missing at random."""
    rng = np.random.default_rng(seed)
    profile = (
        8
        + 3 * np.sin(np.linspace(0, 2 * np.pi, m))
        + np.cumsum(rng.normal(scale=0.3, size=m)).clip(-4, 4)
    )
    drift = np.cumsum(rng.normal(scale=0.02, size=(n_lines, 1)), axis=0)
    image = profile + drift + rng.normal(scale=0.02, size=(n_lines, m))
    image[rng.random(image.shape) < 0.15] = np.nan
    ranges: np.ndarray = np.abs(image).astype(np.float32)
    return ranges


@pytest.mark.parametrize("m, n_lines", [(10, 60), (97, 30), (97, 17), (1000, 40), (5099, 20)])
def test_period_of_a_street(m, n_lines):
    estimate = estimate_points_per_line(street(m, n_lines))
    assert estimate.points_per_line == m
    assert estimate.strength > 0.5
    assert estimate.n_shots_used == m * n_lines


@pytest.mark.parametrize("n_shots, m", [(99, None), (100, 5)])
def test_a_hundred_ranges_are_enough(n_shots, m):
    line = np.random.default_rng(2).uniform(2, 20, 5).astype(np.float32)
    assert estimate_points_per_line(np.tile(line, 20)[:n_shots]).points_per_line == m


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("number, m", [(1, 229), (2, 226), (3, 240)])
def test_oakland(real_data, number, m):
    with gzip.open(real_data / "oakland" / f"oakland_{number}.csv.gz", "rt") as handle:
        ranges = np.array(
            [float(row["range_m"] or "nan") for row in csv.DictReader(handle)], np.float32
        )
    estimate = estimate_points_per_line(ranges)
    assert estimate.points_per_line == m
    assert estimate.strength > 1.5
    assert estimate_points_per_line(ranges[np.isfinite(ranges)]).points_per_line is None
    assert (
        estimate_points_per_line(np.random.default_rng(0).permutation(ranges)).points_per_line
        is None
    )


def drive(
    line_hz: float,
    m: int,
    n_lines: int,
    seed: int = 0,
) -> tuple[Array, Array, Array]:
    """Times, line and column of the shots that return: a street with a third of sky, and leaves."""
    rng = np.random.default_rng(seed)
    line, column = np.divmod(np.arange(n_lines * m), m)
    sky = np.abs(column - 0.3 * m) < m / 6
    leaves = (np.abs(column - 0.7 * m) < m / 12) & (rng.random(len(line)) < 0.4)
    there = ~sky & ~leaves
    return ((line * m + column) / (line_hz * m) + 1000.0)[there], line[there], column[there]


@pytest.mark.data
def test_the_real_profiler(real_data):
    """Four lines, times rounded to four shots: 0.98374 us a shot, 5.0161 ms a line."""
    las = laspy.read(real_data / "profiler" / "jakarto_0.02s.las")
    scan = measure_rates(
        np.sort(np.asarray(las.gps_time)), np.asarray(las.z)[np.argsort(las.gps_time)]
    )
    assert scan is not None
    assert 1e6 / scan.shot_hz == pytest.approx(0.98374, rel=5e-4)
    assert 1e3 / scan.line_hz == pytest.approx(5.0161, rel=1e-4)
    assert abs(scan.points_per_line - 5099) <= 2


def forest_lines(n_lines: int, *, stems: bool = True) -> F32:
    """Patches of plants of 0.2 m, leaves on both sides, and a few stems."""
    rng = np.random.default_rng(4)
    side = np.sin(BEAM)
    down = np.cos(BEAM)
    with np.errstate(divide="ignore"):
        plants = rng.uniform(0, 0.2, (n_lines, len(BEAM))) * (np.arange(len(BEAM)) // 30 % 2)
        floor = np.where(down > 0, (1.8 - plants) / down, np.inf)
        leaves = np.where(down < 0.4, rng.uniform(3, 12, floor.shape) / np.abs(side), np.inf)
        stem = np.where((side > 0) & (np.arange(n_lines) % 8 == 0)[:, None], 5 / side, np.inf)
    every = np.minimum(floor, leaves)
    every = np.minimum(every, stem) if stems else every
    every[every > 60] = np.nan
    return every.astype(np.float32)


def test_a_road_in_the_open_is_a_street():
    road = street_lines(SAMPLE_LINES)[0]
    road[:, np.cos(BEAM) < 0.2] = np.nan
    place = place_of(road, BEAM)
    assert place.kind == "street"
    assert "no object is above the scanner" in place.why


def level_forest_lines(n_lines: int) -> F32:
    """A forest whose floor is as level as a model of the terrain."""
    forest = forest_lines(n_lines)
    floor = np.cos(BEAM) >= 0.2
    forest[:, floor] = (1.8 / np.cos(BEAM[floor])).astype(np.float32)
    return forest


def test_a_forest_on_a_level_floor_is_a_doubt():
    place = place_of(level_forest_lines(MOST_LINES), BEAM)
    assert place.kind == "unknown"
    assert "streets more smooth objects (42%)" in place.doubt
    choice = choice_by_beams(*_first_and_all(level_forest_lines(MOST_LINES)))
    assert (
        "for a forest: --preset fused-forest; for a street: --preset fused"
        in choice.findings[0].hint
    )


def test_bare_stems_on_a_level_floor_are_a_doubt():
    """They are as smooth as facades within a line, but narrow."""
    park = street_lines(MOST_LINES)[0]
    level = np.cos(BEAM) >= 0.2
    stem = np.where(np.arange(MOST_LINES) % 40 < 10, 5.0, np.nan)[:, None]
    park[:, level] = (1.8 / np.cos(BEAM[level])).astype(np.float32)
    park[:, ~level] = (stem / np.abs(np.sin(BEAM[~level]))).astype(np.float32)
    place = place_of(park, BEAM)
    assert place.kind == "unknown"
    assert "go on for 16 lines" in place.doubt


def test_clear_places_are_no_doubt():
    for lines in (street_lines(MOST_LINES)[0], forest_lines(MOST_LINES)):
        assert not choice_by_beams(*_first_and_all(lines)).findings


def _first_and_all(lines: F32) -> tuple[ScanBlock, Iterator[ScanBlock]]:
    block = ScanBlock(0, lines, beam_rad=BEAM)
    return block, iter((block,))


@pytest.mark.parametrize("cut", [1, 7, 64, 90])
def test_the_answer_depends_on_the_lines_alone(cut):
    lines = np.concatenate([np.full((5, len(BEAM)), np.nan, np.float32), street_lines(90)[0]])
    forest = forest_lines(40)

    def blocks() -> list[ScanBlock]:
        parts = []
        for start in range(0, len(lines), cut):
            parts.append(ScanBlock(start, lines[start : start + cut], beam_rad=BEAM))
            parts.append(ScanBlock(start, forest, scanner=1, beam_rad=BEAM))
        return parts

    assert place_of_blocks(iter(blocks())) == place_of(lines[5:], BEAM)


@pytest.mark.parametrize("cut", [1, 64, 100, 400])
def test_where_the_first_lines_leave_it_open_more_are_looked_at(cut):
    lines = np.concatenate([forest_lines(24), street_lines(MOST_LINES)[0]])
    first = place_of(lines[:SAMPLE_LINES], BEAM)
    blocks = (
        ScanBlock(first_line, lines[first_line : first_line + cut], beam_rad=BEAM)
        for first_line in range(0, len(lines), cut)
    )
    place = place_of_blocks(blocks)
    assert (first.kind, place.kind) == ("forest", "street")
    assert place == place_of(lines[:MOST_LINES], BEAM)


@pytest.mark.parametrize("chunk", [1, 31, 32, 33, 300])
@pytest.mark.parametrize("n_lines", [32 * 8 - 1, 32 * 8, 32 * 9 + 5, 32 * 41])
def test_a_sample_is_even_whatever_the_blocks(chunk, n_lines):
    """Windows of 32 lines: every first, second, fourth of them, at most 8."""
    m = 8192
    sample = LineSample(m)
    n_full = []
    for first in range(0, n_lines, chunk):
        stop = min(first + chunk, n_lines)
        sample.add(
            ScanBlock(
                first,
                np.broadcast_to(
                    np.arange(first, stop, dtype=np.float32)[:, None], (stop - first, m)
                ),
            )
        )
        n_full.append(sample.n_full)
    stride = 1
    while len(range(0, n_lines, 32 * stride)) > 8:
        stride *= 2
    assert [window.first_line for window in sample.windows()] == list(
        range(0, n_lines, 32 * stride)
    )
    for window in sample.windows():
        stop = min(window.first_line + 32, n_lines)
        assert window.range_m[:, -1].tolist() == list(range(window.first_line, stop))
    # full at 8 windows of 32 lines, and whenever every second of twice as many is kept
    assert n_full[-1] == sum(n_lines >= 32 * (7 * stride + 1) for stride in (1, 2, 4))


# -- estimates


@pytest.mark.parametrize("step_s", [1e-5, 3.7e-4])
def test_pauses_do_not_shift_the_period_of_shots(step_s):
    """Most shots in a row have returns; a pause is no whole number of shots long."""
    shot = np.arange(4000)
    shot = shot[shot % 7 < 5]
    time_s = step_s * (shot + 700.3 * (shot // 100))
    assert shot_period(time_s) == pytest.approx(step_s, rel=1e-4)
