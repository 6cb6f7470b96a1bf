"""Ground within a row and across rows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from prc_cli.core.types import F32, F64, I32, U8, Mask
from prc_cli.methods.sequential_angle.ground import ground, initial_ground, potential_ground
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import GroundState, GroundThresholds
from tests.methods.sequential_angle.scenes import (
    NOISE_M,
    ROAD_Z,
    H,
    Scene,
    made,
    scan,
)


def limits(**values: Any) -> GroundThresholds:
    return made(GroundThresholds, **{"start_heights": 50, "range_noise_m": NOISE_M, **values})


PARAMS = limits()


def follow(
    lines: VerticalLines,
    surface: U8,
    phihat: F32,
    ahead: I32,
    state: GroundState,
    params: GroundThresholds,
) -> tuple[Mask, F32, GroundState]:
    """Both parts of the algorithm."""
    potential = potential_ground(lines, surface, phihat, ahead, params)
    return ground(lines, surface, phihat, ahead, potential, state, params)


def find(scene: Scene, params: GroundThresholds = PARAMS) -> tuple[F64, Mask, F32, GroundState]:
    potential = potential_ground(scene.lines, scene.surface, scene.phihat, scene.ahead, params)
    state = initial_ground(potential.height_m, params)
    return potential.height_m, *follow(
        scene.lines, scene.surface, scene.phihat, scene.ahead, state, params
    )


def plane(slope_deg: float, turned_deg: float = 0.0) -> Scene:
    """Half-lines all around on a slope, from 1 m to 15 m."""
    rise = np.tan(np.deg2rad(slope_deg)) * np.cos(np.deg2rad(np.arange(0, 360, 4) + turned_deg))
    far = [[(0.6, ROAD_Z + 0.6 * t, 15.0, ROAD_Z + 15 * t, H)] for t in rise.tolist()]
    return scan(far, n=300)


@pytest.mark.parametrize("slope", [0.5, 1.0, 3.0])
def test_a_slope_is_ground_all_around_whatever_the_first_line(slope: float) -> None:
    for turned in (0.0, 90.0, 200.0):
        scene = plane(slope, turned)
        _, mask, z_g, _ = find(scene)
        shares = mask.sum(axis=1) / (scene.surface == H).sum(axis=1)
        assert shares.mean() > 0.98
        assert shares.min() > 0.8
        assert np.all(np.abs(z_g - ROAD_Z) < 0.1)
