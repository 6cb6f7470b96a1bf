"""The whole method: order of stages, state across lines, when lines are final."""

from collections.abc import Iterator
from dataclasses import fields, replace

import numpy as np
import pytest

from prc_cli.config import load_config
from prc_cli.core.blocks import cut
from prc_cli.core.classes import Label
from prc_cli.core.stream import ExtraReturns, LabelledBlock, ScanBlock, StageLabels
from prc_cli.jobs.classify import label_blocks
from prc_cli.methods.base import Wanted
from prc_cli.methods.run import run_blocks
from prc_cli.methods.sequential_angle.pipeline import (
    Beams,
    SequentialAngle,
    follow_ground,
    initial_state,
    within_lines,
)
from prc_cli.methods.sequential_angle.thresholds import SequentialAngleThresholds
from tests.simulated import static_arrays

PARAMS = SequentialAngleThresholds().at_noise()


def scan() -> ScanBlock:
    """A simulated static scan as one block."""
    return static_arrays(0.5, 1.5, 3)[0]


def cuts(block: ScanBlock, lines: int = 1) -> Iterator[ScanBlock]:
    """The same lines in blocks of some lines."""
    for start in range(0, block.n_lines, lines):
        yield cut(block, start, min(start + lines, block.n_lines))


def run(
    blocks: Iterator[ScanBlock], threads: int = 1, shots_at_once: int = 100_000
) -> list[np.ndarray]:
    """Classify blocks; return the labels and every stage of all lines."""
    items = list(
        run_blocks(
            blocks,
            SequentialAngle(PARAMS),
            threads=threads,
            shots_at_once=shots_at_once,
            wanted=Wanted(stages=True),
        )
    )
    stages = [item.stages for item in items if item.stages is not None]
    return [
        np.concatenate([item.labels for item in items]),
        *(
            np.concatenate([getattr(of_block, stage.name) for of_block in stages])
            for stage in fields(StageLabels)
        ),
    ]


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
@pytest.mark.parametrize("lines, threads, shots", [(1, 1, 1), (49, 2, 3000), (20, 3, 100_000)])
def test_labels_depend_neither_on_cuts_nor_on_threads(two_sides, lines, threads, shots):
    block = scan()
    block = both_sides(block) if two_sides else block
    expected = run(iter([block]))
    assert {Label.GROUND, Label.CAR, Label.VEGETATION, Label.VERTICAL} <= {
        Label(label) for label in np.unique(expected[0])
    }
    for result, whole in zip(run(cuts(block, lines), threads, shots), expected, strict=True):
        np.testing.assert_array_equal(result, whole)


def test_two_sides_are_classified_like_the_lines_that_they_are():
    """Half-lines of a profiler see what static lines see.

    Only the order in which heights come in differs.
    """
    block = scan()
    single = run(iter([block]))[0]
    double = run(iter([both_sides(block)]))[0]
    m = block.points_per_line
    unfolded = np.concatenate([double[:, m:], double[:, :m][:, ::-1]])
    assert np.mean(unfolded == single) > 0.99


def test_lines_wait_for_the_first_heights_of_the_ground_and_no_longer():
    block = scan()
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


def test_further_returns_are_labelled_from_their_own_line():
    block = scan()
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
            label_blocks(
                iter([replace(block, extra=extra_m)]),
                load_config(preset="street-scan").config.classifier,
            )
        )
        labels = np.concatenate([item.labels for item in items])
        extra_labels = np.concatenate([item.extra_labels for item in items])
        expected = np.full(1, Label.UNCLASSIFIED) if lone else labels[line, column]
        np.testing.assert_array_equal(extra_labels, expected)
