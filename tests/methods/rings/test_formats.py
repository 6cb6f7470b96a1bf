"""What convert writes is read by classify to the same labels, in every format, for every method."""

import numpy as np

from prc_cli.streams.order import fire_in_turns
from prc_cli.streams.ranges import is_in_plane


def test_rings_that_fire_in_turns_are_in_order():
    time_s = np.arange(40) * 0.1 + np.tile([0.0, 2.0, 1.0, 3.0], 10)
    ring = np.tile(np.arange(4), 10)
    assert fire_in_turns(time_s, ring)
    assert not fire_in_turns(time_s[::-1], ring)
    assert not fire_in_turns(np.sort(time_s), ring)


def test_shots_of_a_slant_profiler_lie_in_a_plane():
    angle = np.linspace(-2.0, 2.0, 50)
    slant = {"x": 0.1 * np.cos(angle), "y": np.sin(angle), "z": -np.cos(angle)}
    assert is_in_plane(slant)
