"""Cars in a line."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.methods.sequential_angle.car import dividers
from prc_cli.methods.sequential_angle.thresholds import DividerThresholds
from tests.methods.sequential_angle.scenes import NOISE_M, ROAD_Z, made, scan, street

PLAIN = made(
    DividerThresholds,
    return_points=0,
    from_start=False,
    flat_step_m=0.0,
    tall_m=0.0,
    vertical_top_m=0.0,
    straight_extent_m=0.0,
    lean_sigmas=0.0,
).at_noise(NOISE_M)
"""Without the readings that are ours, so that every rule is tested by itself."""


@pytest.mark.parametrize("curb_m", [0.0, 0.15])
@pytest.mark.parametrize("wall", [False, True])
def test_a_car_is_an_interval_and_walls_and_curbs_are_none(curb_m: float, wall: bool) -> None:
    for car in (False, True):
        scene = scan([street(curb_m, car=car, wall=wall)] * 12, n=800)
        triggers = np.zeros(12, np.int32)
        z_g = np.full(12, ROAD_Z, np.float32)
        cut = dividers(scene.lines, scene.surface, scene.signed, triggers, z_g, PLAIN)
        n_rows = len(np.unique(cut.pieces[:, 0]))
        assert n_rows >= 11 if car else n_rows <= 1
