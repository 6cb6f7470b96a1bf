"""The ground around a spinning scanner, in scenes of a few numbers that a person can check."""

import numpy as np
import pytest

from prc_cli.methods.rings.cells_loops import lonely_shots
from prc_cli.methods.rings.ground_loops import lowest_heights, walk_outwards
from prc_cli.methods.rings.thresholds import GroundThresholds, LonelyThresholds


@pytest.mark.parametrize(
    "heights_m, lowest_m",
    [
        ([np.nan], np.nan),
        ([-1.5], -1.5),  # nothing else tells
        ([-1.5, -1.4], -1.45),
        ([-1.5, 0.0], np.nan),  # neither confirms the other
        ([-9.0, -1.5, -1.4], -1.45),  # a mirror image below
        ([-9.0, -9.1, -1.5], -9.05),  # two of them are believed
        ([-9.0, -5.0, -1.5, -1.4], np.nan),  # only the three lowest count
    ],
)
@pytest.mark.parametrize("up", [1.0, -1.0])
def test_two_shots_confirm_the_lowest_height(heights_m, lowest_m, up):
    xyz = np.zeros((1, len(heights_m), 3), np.float32)
    xyz[0, :, 2] = up * np.array(heights_m)
    place = np.where(np.isnan(xyz[..., 2]), np.nan, 0.5).astype(np.float32)
    lowest = lowest_heights(xyz, place, up, 1, 2, 0.15)
    np.testing.assert_allclose(lowest, [[lowest_m, np.nan]])


@pytest.mark.parametrize(
    "heights_m, is_ground",
    [
        ([0.0, 0.0, 0.0, 0.0], [True, True, True, True]),
        ([0.0, 0.1, 0.2, 0.3], [True, True, True, True]),  # a slope of 5 %
        ([0.0, 0.0, 1.0, 0.0], [True, True, False, True]),  # a car
        ([0.0, 0.0, -1.0, 0.0], [True, True, False, True]),  # a mirror image
        ([0.0, 0.0, np.nan, 0.0], [True, True, False, True]),  # behind the car
        ([1.0, 1.0, 1.0, 1.0], [False, False, False, False]),  # the roof of the own car
    ],
)
def test_the_walk_takes_what_is_near_to_what_it_expects(heights_m, is_ground):
    """Three sectors of cells at 1, 3, 5 and 7 m that see the same."""
    off_m = np.tile(np.array(heights_m, np.float32), (3, 1))
    middle_m = np.array([1.0, 3.0, 5.0, 7.0])
    height, seen = walk_outwards(off_m, middle_m, GroundThresholds())
    assert seen.tolist() == [is_ground] * 3
    np.testing.assert_array_equal(height[seen], off_m[seen])


@pytest.mark.parametrize(
    "range_m, around, light, is_lonely",
    [
        (5.0, {}, 10.0, True),
        (5.0, {(3, 1): 5.1}, 10.0, True),
        (5.0, {(3, 1): 5.1, (4, 2): 5.2, (2, 2): 4.9}, 10.0, False),  # three are near
        (5.0, {(3, 1): 5.3, (4, 2): 5.3, (2, 2): 4.7}, 10.0, True),  # but these are not
        (26.0, {}, 10.0, False),  # so far away, no flake is seen
    ],
)
def test_a_flake_has_hardly_a_shot_beside_it(range_m, around, light, is_lonely):
    ranges = np.full((7, 5), 40.0, np.float32)
    bright = np.full((7, 5), 90.0, np.float32)
    ranges[3, 2] = range_m
    bright[3, 2] = light
    for place, near_m in around.items():
        ranges[place] = near_m
    assert lonely_shots(ranges, bright, True, LonelyThresholds())[3, 2] == is_lonely
