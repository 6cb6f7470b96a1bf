"""Which shots are leaves, and which are on a level surface: at every limit."""

import numpy as np
import pytest

from prc_cli.methods.fused.ground import follow_ground, no_memory
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.records import Neighbours
from prc_cli.methods.fused.spacing_loops import MOST_LAG, leaf_repeats
from prc_cli.methods.fused.thresholds import LEAST_NEAR, SpacingThresholds, WalkThresholds

LEAVES = SpacingThresholds(np.float32(0.125), np.float32(0.0), np.float32(1.0))
"""Shots differ by more than 0.125 m from those beside them, and by less than 1 m."""


@pytest.mark.parametrize(
    "steps_m, n_leaves",
    [
        ([0.5, -0.5, 0.5, -0.5, 0.5, -0.5], 3),  # all shots but two at either end
        ([0.5, -0.5, 0.5, -0.5], 1),
        ([0.5, -0.5, 0.5], 0),  # a ledge
        ([0.125, -0.5, 0.5, -0.5, 0.5, -0.5], 2),  # the shot before is on the same surface
        ([0.1875, -0.5, 0.5, -0.5, 0.5, -0.5], 3),
        ([0.25, 0.375, 0.25, 0.375, 0.25, 0.375], 0),  # a slope
        ([0.25, 0.4375, 0.25, 0.4375, 0.25, 0.4375], 3),
        ([1.0, -0.5, 0.5, -0.5, 0.5, -0.5], 2),  # the shot before is on something else
        ([0.9375, -0.5, 0.5, -0.5, 0.5, -0.5], 3),
    ],
)
@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("off_m, is_met", [(0.0, True), (0.0625, True), (0.125, False)])
def test_leaves_of_a_line_that_earlier_lines_meet_again(steps_m, n_leaves, turned, off_m, is_met):
    line = 5.0 + np.cumsum([0.0, *steps_m])
    lines = np.tile(line[::-1] if turned else line, (MOST_LAG + 1, 1)).astype(np.float32)
    lines[:-1] += np.float32(off_m)
    counts = leaf_repeats(lines, 0, LEAVES)
    assert counts[0, :-1].tolist() == [[n_leaves, n_leaves * is_met]] * 5


@pytest.mark.parametrize(
    "near, smooth, upright, level, is_level",
    [
        (LEAST_NEAR, 1, 0, 1, True),
        (LEAST_NEAR - 1, 1, 0, 1, False),
        (LEAST_NEAR, 0, 0, 1, False),
        (LEAST_NEAR, 1, 2, 2, False),
        (LEAST_NEAR, 1, 1, 2, True),
    ],
)
def test_the_walk_uses_level_shots_alone(near, smooth, upright, level, is_level):
    beam = np.deg2rad(np.linspace(-60.0, 60.0, 121))
    road = np.tile(2.0 / np.cos(beam), (3, 1)).astype(np.float32)
    counts = (np.full(road.shape, count, np.uint8) for count in (near, smooth, upright, level))
    plane = ScanPlane.of(beam)
    ground, _ = follow_ground(road, Neighbours(*counts), plane, no_memory(), 0, WalkThresholds())
    assert ground.walked.any() == ground.walked.all() == is_level
