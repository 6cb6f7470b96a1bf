"""Ground within a row and across rows."""

from __future__ import annotations

from itertools import pairwise
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
    Segment,
    made,
    scan,
    street,
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


def road(scene: Scene) -> Mask:
    mask: Mask = (
        (scene.surface == H)
        & (scene.lines.horizontal_m < 5.99)
        & (scene.lines.xyz_m[..., 2] < -1.2)
    )
    return mask


def hedge() -> list[Segment]:
    """A flat hedge top, as wide as 2.5 m, that hides the road from below the scanner to 4.5 m."""
    return [(0.0, -1.0, 2.5, -1.0, H), *street()]


@pytest.mark.slow
@pytest.mark.parametrize("slope", [-3.0, 0.0, 3.0])
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_road_is_ground_over_slopes_and_missing_shots(slope: float, missing: float) -> None:
    scene = scan([street(slope_deg=slope)] * 20, n=1500, missing=missing)
    _, mask, z_g, _ = find(scene)
    assert mask[road(scene)].mean() > 0.93  # measured: .95 and more
    assert road(scene)[mask].mean() > 0.995
    assert np.all(np.abs(z_g - ROAD_Z) < (0.35 if slope else 0.03))


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


@pytest.mark.slow
@pytest.mark.parametrize("n_sides", [1, 2])
def test_cuts_change_nothing(n_sides: int) -> None:
    profiles = [hedge() if i % 7 == 0 else street(car=i % 5 == 0) for i in range(70)]
    scene = scan(profiles, n=250, n_sides=n_sides, missing=0.1)
    params = limits(start_heights=20)
    heights, whole, z_whole, last = find(scene, params)
    rng = np.random.default_rng(2)
    for _ in range(4):
        cuts = np.sort(rng.integers(0, 71, 5)) * n_sides
        edges = [0, *cuts.tolist(), len(scene.surface)]
        state = initial_ground(heights, params)
        parts = []
        for first, end in pairwise(edges):
            part = scene.rows(first, end)
            mask, z_g, state = follow(
                part.lines, part.surface, part.phihat, part.ahead, state, params
            )
            parts.append((mask, z_g))
        np.testing.assert_array_equal(np.concatenate([mask for mask, _ in parts]), whole)
        np.testing.assert_array_equal(np.concatenate([z_g for _, z_g in parts]), z_whole)
        np.testing.assert_array_equal(state.histogram, last.histogram)
        assert state.z_g == last.z_g
