"""Labels do not depend on the lines per block; constants that stages and loops share are equal."""

import math

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, F64, U8
from prc_cli.jobs.classify import label_blocks
from prc_cli.methods.fused import classes_loops as fused_classes
from prc_cli.methods.fused import ground_loops as fused_ground
from prc_cli.methods.fused import neighbours_loops as fused_neighbours
from prc_cli.methods.fused import pipeline, plane
from prc_cli.methods.fused import strips_loops as fused_strips
from prc_cli.methods.fused import texture_loops as fused_texture
from prc_cli.methods.fused.confidence import Evidence
from prc_cli.methods.fused.interlace import align_columns
from prc_cli.methods.fused.pipeline import FusedParams, Stream
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.range_noise import (
    MIDDLE_OF_THREE,
    NORMAL_QUARTILE,
    PART_LINES,
    off_lines,
    range_noise,
)
from prc_cli.methods.fused.records import FilledSlots, Neighbours, Walls
from prc_cli.methods.fused.strips import Strips
from prc_cli.methods.fused.thresholds import STREET
from prc_cli.simulation.settings import load_settings, open_simulation

MOST = 0.001
"""Share of the labels that may change: everywhere none but in slow drives."""


def labels(range_m: F32, beam_rad: F64, k: int) -> U8:
    block = ScanBlock(0, range_m, beam_rad=beam_rad, is_last=True)
    return np.concatenate(
        [item.labels for item in label_blocks(iter([block]), FusedParams(lines_per_block=k))]
    )


def changed(range_m: F32, beam_rad: F64, *sizes: int) -> list[float]:
    """Return the share of the labels that change with the lines per block."""
    whole = labels(range_m, beam_rad, len(range_m))
    assert len(np.unique(whole)) > 5
    return [
        float((labels(range_m, beam_rad, k) != whole)[whole != Label.MISSING].mean()) for k in sizes
    ]


@pytest.mark.slow
@pytest.mark.parametrize("scanner", ["photon-80", "sick-push-broom"])
def test_on_a_street(scanner):
    """With range noise that is measured anew along the way, and cars that are found by lines on
    both sides."""
    options = {
        "seed": 5,
        "lines": 150,
        "scanner": {"name": scanner, "noise_m": 0.012, "points_per_line": 361},
    }
    scan = open_simulation("street", load_settings("street", options=options), threads=1).scan
    blocks = list(scan.blocks())
    angle_rad = blocks[0].angle_rad
    down_rad = scan.info.down_rad
    assert angle_rad is not None
    assert down_rad is not None
    beam_rad = (angle_rad - down_rad + np.pi) % (2 * np.pi) - np.pi
    assert (
        changed(np.concatenate([block.range_m for block in blocks]), beam_rad, 1, 16, 37, 128)
        == [0] * 4
    )


@pytest.mark.slow
@pytest.mark.data
def test_on_a_push_broom_strip(real_data):
    """Some of its lines are so close together that every second one is a stream of its own."""
    table = np.genfromtxt(
        real_data / "oakland" / "oakland_2.csv.gz", delimiter=",", skip_header=1, usecols=(0, 2, 3)
    )
    n_lines = len(np.unique(table[:, 0]))
    range_m = table[:, 2].reshape(n_lines, -1).astype(np.float32)
    beam_rad = np.deg2rad(table[: range_m.shape[1], 1])
    assert max(changed(range_m, beam_rad, 1, 16)) < MOST


@pytest.mark.parametrize("n", [100, 101, 102, 200, 201])
def test_the_noise_is_by_the_median(n):
    values = np.random.default_rng(n).choice(np.array([0.5, 1.0, 2.5, 7.0], np.float32), n)
    deviation = float(np.median(values)) / (NORMAL_QUARTILE * math.sqrt(MIDDLE_OF_THREE))
    assert range_noise(values) == deviation


@pytest.mark.parametrize("n, is_known", [(100, True), (99, False)])
def test_noise_takes_a_hundred_triples_of_shots(n, is_known):
    side: F32 = np.linspace(1, 9, n + 2, dtype=np.float32)[None]
    height = np.random.default_rng(2).normal(-2, 0.01, side.shape).astype(np.float32)
    assert (range_noise(off_lines(side, height)) is not None) is is_known


BEAM = np.deg2rad(np.linspace(40, 90, 101))
NOISE_M = 0.005


def wall(late: F64, *, lines: int = 40, per_line_m: float = 0.3) -> F32:
    """A wall that recedes from line to line, its columns ``late`` lines later, with range noise."""
    away_m = 6.0 + per_line_m * (np.arange(lines)[:, None] + late)
    ranges = away_m / np.sin(BEAM) + np.random.default_rng(4).normal(
        0.0, NOISE_M, (lines, len(BEAM))
    )
    return ranges.astype(np.float32)


def in_step(range_m: F32, interlace_rad: float = STREET.interlace_rad) -> F32:
    limits = STREET._replace(interlace_rad=interlace_rad)
    return align_columns(range_m, ScanPlane.of(BEAM), np.full(len(range_m), NOISE_M), limits)


@pytest.mark.parametrize("late", [0.5, -0.5])
def test_odd_columns_are_moved_by_half_a_line(late):
    odd = np.where(np.arange(len(BEAM)) % 2 == 1, late, 0.0)
    moved = in_step(wall(odd))
    inner = slice(1, -1)
    assert np.abs(moved - wall(0 * odd))[inner].max() < 0.03
    assert np.array_equal(moved[:, ::2], wall(odd)[:, ::2])


def test_lines_may_begin_with_either_half():
    odd = np.arange(len(BEAM)) % 2 == 1
    first = wall(np.where(odd, 0.5, 0.0))[:30]
    second = wall(np.where(odd, -0.5, 0.0), lines=60)[30:]
    moved = in_step(np.concatenate([first, second]))
    whole = wall(np.zeros(len(BEAM)), lines=60)
    off = np.abs(moved - whole).max(axis=1)
    assert off[1:22].max() < 0.03
    assert off[38:-1].max() < 0.03


def test_others_stay():
    odd = np.where(np.arange(len(BEAM)) % 2 == 1, 0.5, 0.0)
    level = wall(0 * odd)
    leaves = (level + np.random.default_rng(5).uniform(-1, 1, level.shape)).astype(np.float32)
    for ranges in (level, leaves, wall(odd)[:2], np.full((9, len(BEAM)), np.nan, np.float32)):
        assert in_step(ranges) is ranges
    assert in_step(wall(odd), np.inf).tolist() == wall(odd).tolist()
    assert in_step(wall(odd), np.deg2rad(0.6)).tolist() == wall(odd).tolist()


def test_missing_shots_stay_missing():
    ranges = wall(np.where(np.arange(len(BEAM)) % 2 == 1, 0.5, 0.0))
    ranges[10:12, 5:9] = np.nan
    assert np.array_equal(np.isnan(in_step(ranges)), np.isnan(ranges))


def test_evidence_of_streams_is_put_together_by_lines():
    """Lines are from the stream that their spacing asks for; those beside the block are empty."""

    def evidence(first: int, every: int) -> Evidence:
        # a stream has two more lines before and after those of the block
        lines = np.arange(first - 2 * every, 6 + 2 * every, every) + 10 * every
        values = np.repeat(lines[:, None], 3, axis=1)
        near, slots, walls = (
            kind(*len(kind._fields) * [values]) for kind in (Neighbours, FilledSlots, Walls)
        )
        return Evidence(near, values, values, Strips(slots, walls, values, values), 2)

    streams = [Stream(first, every, None, None) for first, every in ((0, 1), (0, 2), (1, 2))]
    apart = np.array([1, 2, 2, 1, 2, 1])
    evidences = [evidence(stream.first, stream.every) for stream in streams]
    merged = pipeline._merge_evidence(evidences, np.zeros((6, 3), np.float32), streams, apart)
    wanted = np.repeat((np.arange(6) + 10 * apart)[:, None], 3, axis=1)
    strips = merged.strips
    for values in (merged.texture, *strips.slots, *strips.walls, strips.levels, strips.kinds):
        np.testing.assert_array_equal(values, np.pad(wanted, ((1, 1), (0, 0))))
    for values in merged.neighbours:
        np.testing.assert_array_equal(values, wanted)
    alone = pipeline._merge_evidence(evidences[:1], merged.above_m, streams[:1], apart)
    assert alone is evidences[0]


@pytest.mark.parametrize("first, every, n_lines", [(0, 1, 5), (1, 2, 4), (2, 3, 91), (5, 8, 11)])
def test_lines_beyond_the_window_are_the_outermost_of_the_stream(first, every, n_lines):
    begin = pipeline.SPACED_LINES + first
    there = np.arange(begin % every, n_lines + 2 * pipeline.SPACED_LINES, every)
    n = len(range(first, n_lines, every))
    wanted = begin + every * np.arange(-pipeline.MARGIN_LINES, n + pipeline.MARGIN_LINES)
    nearest = there[np.abs(there[:, None] - wanted).argmin(axis=0)]
    np.testing.assert_array_equal(pipeline._rows_of_stream(first, every, n_lines), nearest)


def test_stages_and_loops_agree_on_what_lies_around_a_block():
    assert plane.INNER_LINES == fused_neighbours.LINES
    assert plane.WIDE_LINES == fused_strips.LINES == fused_texture.LINES
    assert PART_LINES <= pipeline.SPACED_LINES
    assert plane.INNER_LINES + plane.WIDE_LINES + plane.VOTE_LINES == plane.AROUND_LINES


def test_stages_and_loops_agree_on_places_beside_the_scanner():
    assert 2 * fused_classes.HALF_STRIP_M == fused_strips.STRIP_M
    # the walk reaches as far as the strips do
    assert 2 * fused_ground.BINS * fused_ground.BIN_M == fused_strips.STRIPS * fused_strips.STRIP_M
