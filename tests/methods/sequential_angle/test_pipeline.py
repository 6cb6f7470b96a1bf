"""The whole method: order of stages, state across lines, when lines are final."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np
import pytest

from prc_cli.config import RunConfig, load_config
from prc_cli.core.blocks import cut
from prc_cli.core.classes import Label
from prc_cli.core.stream import ExtraReturns, LabelledBlock, ScanBlock
from prc_cli.core.types import U8
from prc_cli.jobs.classify import label_blocks
from prc_cli.methods.base import OneByOne, Wanted
from prc_cli.methods.run import run_blocks
from prc_cli.methods.sequential_angle.pipeline import (
    Beams,
    SequentialAngle,
    SequentialAngleState,
    classify_block,
    follow_ground,
    initial_state,
    stages_in_columns,
    within_lines,
)
from prc_cli.methods.sequential_angle.thresholds import SequentialAngleThresholds
from tests.simulated import static_arrays

PARAMS = SequentialAngleThresholds().at_noise()


def scan(
    elevation_step: float = 0.5, azimuth_step: float = 1.5, seed: int = 3
) -> tuple[ScanBlock, U8]:
    """A simulated static scan as one block, and its reference labels."""
    return static_arrays(elevation_step, azimuth_step, seed)


def cuts(
    block: ScanBlock, rng: np.random.Generator | None = None, lines: int = 1
) -> Iterator[ScanBlock]:
    """The same lines in blocks of some or of random numbers of lines."""
    start = 0
    while start < block.n_lines:
        stop = min(start + (lines if rng is None else int(rng.integers(1, 60))), block.n_lines)
        yield cut(block, start, stop)
        start = stop


def run(
    blocks: Iterator[ScanBlock], params: SequentialAngleThresholds, n_lines: int
) -> tuple[list[np.ndarray], int]:
    """Feed blocks to the classifier.

    Return all that it says, and the most lines that ever waited.
    """
    turn: OneByOne[SequentialAngleState] | None = None
    parts: list[list[np.ndarray]] = []
    n_in = n_out = most = 0
    method = SequentialAngle(params)
    for block in blocks:
        scanner = method.scanner(block)
        turn = turn or OneByOne(method.initial_state(scanner))
        n_in += block.n_lines
        final = classify_block(
            block.range_m, block.xyz_m, scanner, turn, params, last=n_in == n_lines, stages=True
        )
        n_out += len(final.labels)
        stages = stages_in_columns(final.rows, final.labels, scanner)
        parts.append([final.labels, *(getattr(stages, stage.name) for stage in fields(stages))])
        most = max(most, n_in - n_out)
    assert n_out == n_in == n_lines
    return [np.concatenate(arrays) for arrays in zip(*parts, strict=True)], most


def both_sides(block: ScanBlock) -> ScanBlock:
    """A profiler's stream out of a static scan.

    Line i and line i + half a turn are the two sides of one line.
    """
    half = block.n_lines // 2
    near = slice(0, half)
    far = slice(half, 2 * half)
    assert block.beam_rad is not None
    assert block.xyz_m is not None
    return replace(
        block,
        range_m=np.concatenate([block.range_m[far][:, ::-1], block.range_m[near]], axis=1),
        xyz_m=np.concatenate([block.xyz_m[far][:, ::-1], block.xyz_m[near]], axis=1),
        beam_rad=np.concatenate([-block.beam_rad[::-1], block.beam_rad]),
    )


@pytest.mark.parametrize("two_sides", [False, True])
def test_labels_do_not_depend_on_how_the_stream_is_cut(two_sides: bool) -> None:
    block, _ = scan()
    block = both_sides(block) if two_sides else block
    rng = np.random.default_rng(12)
    expected, _ = run(iter([block]), PARAMS, block.n_lines)
    assert {Label.GROUND, Label.CAR, Label.VEGETATION, Label.VERTICAL} <= {
        Label(label) for label in np.unique(expected[0])
    }
    for blocks in (cuts(block), cuts(block, rng), cuts(block, rng), cuts(block, lines=49)):
        results, _ = run(blocks, PARAMS, block.n_lines)
        for result, expected_result in zip(results, expected, strict=True):
            np.testing.assert_array_equal(result, expected_result)


def test_two_sides_are_classified_like_the_lines_that_they_are() -> None:
    """Half-lines of a profiler see what static lines see.

    Only the order in which heights come in differs.
    """
    block, _ = scan()
    single, _ = run(iter([block]), PARAMS, block.n_lines)
    pair = both_sides(block)
    double, _ = run(iter([pair]), PARAMS, pair.n_lines)
    m = block.points_per_line
    unfolded = np.concatenate([double[0][:, m:], double[0][:, :m][:, ::-1]])
    assert np.mean(unfolded == single[0]) > 0.99


def test_lines_wait_for_the_first_heights_of_the_ground_and_no_longer() -> None:
    block, _ = scan()
    assert block.beam_rad is not None
    beams = Beams.of(block.beam_rad)
    ground = initial_state(beams, PARAMS).ground
    n_heights = 0
    known_at = 0
    for part in cuts(block):
        rows = within_lines(part.range_m, part.xyz_m, beams, PARAMS)
        n_heights += int(np.isfinite(rows.potential.height_m).sum())
        ready, ground = follow_ground(rows, ground, PARAMS, last=False)
        if ready:
            known_at = n_heights
            break
    assert known_at == PARAMS.ground.start_heights


def config() -> RunConfig:
    return load_config(preset="street-scan").config


def test_further_returns_are_labelled_from_their_own_line() -> None:
    block, _ = scan()
    # the scanner counts millimetres: neighbours of one range would have a right to each other's
    # class
    distinct = block.range_m + np.arange(block.points_per_line, dtype=np.float32) * np.float32(2e-5)
    block = replace(block, range_m=distinct)
    line, column = (axis.astype(np.int32) for axis in np.nonzero(~np.isnan(block.range_m)))
    ranges = block.range_m[line, column]
    extra = ExtraReturns(line, column, ranges, np.arange(len(line)))
    far = ExtraReturns(line[:1], column[:1], ranges[:1] + 50, np.zeros(1, np.int64))
    for extra_m, lone in ((extra, False), (far, True)):
        items: list[LabelledBlock] = list(
            label_blocks(iter([replace(block, extra=extra_m)]), config().classifier)
        )
        labels = np.concatenate([item.labels for item in items])
        extra_labels = np.concatenate([item.extra_labels for item in items])
        expected = np.full(1, Label.UNCLASSIFIED) if lone else labels[line, column]
        np.testing.assert_array_equal(extra_labels, expected)


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_threads_change_nothing(threads: int) -> None:
    block, _ = scan()
    whole, _ = run(iter([block]), PARAMS, block.n_lines)
    for shots in (1, 3000, 100_000):
        labelled = run_blocks(
            cuts(block, np.random.default_rng(5)),
            SequentialAngle(PARAMS),
            threads=threads,
            shots_at_once=shots,
            wanted=Wanted(stages=True),
        )
        parts = list(labelled)
        np.testing.assert_array_equal(np.concatenate([item.labels for item in parts]), whole[0])
        surfaces = [item.stages.surface for item in parts if item.stages is not None]
        np.testing.assert_array_equal(np.concatenate(surfaces), whole[1])
