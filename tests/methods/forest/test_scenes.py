"""The rules of the forest, one small scene each: what a shot is like, and the right rule."""

import numpy as np
import pytest

from prc_cli.core.classes import Reason
from prc_cli.methods.forest.stems_loops import forest_labels
from prc_cli.methods.forest.thresholds import FOREST


@pytest.mark.parametrize(
    "right, height_m, range_m, is_stem",
    [
        (Reason.MISSING, np.nan, np.nan, False),
        (Reason.FAR_BELOW, -0.21, 9.0, False),
        (Reason.SOIL, -0.19, 9.0, False),
        (Reason.SOIL, 0.03, 9.0, False),
        (Reason.ON_STEM, 0.03, 9.0, True),
        (Reason.ON_STEM, 19.0, 9.0, True),
        (Reason.ABOVE_TOP, 21.0, 9.0, True),
        (Reason.BESIDE_STEM, 1.0, 5.04, False),  # the stem beside it is at 5 m
        (Reason.PLANT, 1.0, 5.06, False),
        (Reason.PLANT, 21.0, 5.04, False),
        (Reason.ALONE, 1.0, 5.6, False),
        (Reason.PLANT, 0.1, 5.2, False),  # low, but its neighbours are higher
    ],
)
def test_the_right_rule_decides_in_a_forest(right, height_m, range_m, is_stem):
    """The shot is the third of five, all others on a stem, the last two at its height."""
    ranges = np.full((1, 5), 5.0, np.float32)
    heights = np.full((1, 5), 1.0, np.float32)
    stems = np.array([[True, True, False, True, True]])
    ranges[0, 2], heights[0, 2], stems[0, 2] = range_m, height_m, is_stem
    limits = FOREST.classes._replace(top_m=20.0)
    rules = forest_labels(ranges, heights, stems, 2, limits)
    assert Reason(rules[0, 2]).name == right.name


def test_low_and_flat_is_ground_in_a_forest():
    heights = np.array([[0.12, 0.13, 0.14, 0.15, 0.30]], np.float32)
    ranges = np.array([[5.0, 5.1, 5.2, 5.3, 5.4]], np.float32)
    rules = forest_labels(ranges, heights, np.zeros((1, 5), np.bool_), 2, FOREST.classes)
    names = [Reason(rule).name for rule in rules[0]]
    assert names == ["PLANT", "FLAT", "FLAT", "PLANT", "PLANT"]
