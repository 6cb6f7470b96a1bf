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
from tests.methods.sequential_angle.made import made
from tests.methods.sequential_angle.profiles import NOISE_M, ROAD_Z, H, Scene, Segment, V, scan, street


def limits(**values: Any) -> GroundThresholds:
    return made(GroundThresholds, **{"start_heights": 50, **values}).at_noise(NOISE_M)


PARAMS = limits()


def follow(
    lines: VerticalLines, surface: U8, phihat: F32, ahead: I32, state: GroundState, params: GroundThresholds
) -> tuple[Mask, F32, GroundState]:
    """Both parts of the algorithm."""
    potential = potential_ground(lines, surface, phihat, ahead, params)
    return ground(lines, surface, phihat, ahead, potential, state, params)


def find(scene: Scene, params: GroundThresholds = PARAMS) -> tuple[F64, Mask, F32, GroundState]:
    found = potential_ground(scene.lines, scene.surface, scene.phihat, scene.ahead, params)
    state = initial_ground(found.height_m, params)
    return found.height_m, *follow(scene.lines, scene.surface, scene.phihat, scene.ahead, state, params)


def road(scene: Scene) -> Mask:
    mask: Mask = (scene.surface == H) & (scene.lines.horizontal_m < 5.99) & (scene.lines.xyz_m[..., 2] < -1.2)
    return mask


def hedge() -> list[Segment]:
    """A flat hedge top, as wide as 2.5 m, that hides the road from below the scanner to 4.5 m."""
    return [(0.0, -1.0, 2.5, -1.0, H), *street()]


@pytest.mark.parametrize("slope", [-3.0, 0.0, 3.0])
@pytest.mark.parametrize("missing", [0.0, 0.3])
def test_road_is_ground_over_slopes_and_missing_shots(slope: float, missing: float) -> None:
    scene = scan([street(slope_deg=slope)] * 20, n=1500, missing=missing)
    _, found, z_g, _ = find(scene)
    assert found[road(scene)].mean() > 0.98
    assert road(scene)[found].mean() > 0.995
    assert np.all(np.abs(z_g - ROAD_Z) < (0.35 if slope else 0.03))


def test_height_is_robust_against_hedges_in_a_third_of_the_lines() -> None:
    scene = scan([hedge() if i % 10 < 3 else street() for i in range(80)], n=1500)
    heights, found, z_g, _ = find(scene)
    assert np.sum(np.abs(heights - ROAD_Z) > 0.5) == 24
    assert np.all(np.abs(z_g - ROAD_Z) < 0.03)
    # the road behind the hedge is found by repeating the search after it
    assert not (found & (scene.lines.xyz_m[..., 2] > -1.1)).any()
    assert found[road(scene)].mean() > 0.95
    assert found[::10].any(axis=1).mean() > 0.8  # rows with a hedge


def test_ground_does_not_climb_a_step_that_no_vertical_point_shows() -> None:
    scene = scan([street()] * 3, n=1000, noise_m=0.0)
    step = int(np.flatnonzero(scene.surface[0] == V)[0])
    flat = np.where(scene.surface == V, np.uint8(0), scene.surface)  # curb and wall missing
    phihat = np.where(flat == H, np.float32(90.0), np.float32(np.nan))  # which does not see the step
    state = initial_ground(np.full(3, ROAD_Z), PARAMS)

    def climbed(**values: float) -> bool:
        params = made(GroundThresholds, **{"resume": False, "bandwidth_sigmas": 0, **values}).at_noise(NOISE_M)
        found, _, _ = follow(scene.lines, flat, phihat, scene.ahead, state, params)
        assert found[:, : step - 5].any(axis=1).all()
        return bool(found[:, step:].any())

    assert not climbed()
    assert climbed(jump_m=1000.0)
    assert climbed(growth_height_m=0.5)  # potential ground ends at the jump, and growth takes it


def plane(slope_deg: float, turned_deg: float = 0.0) -> Scene:
    """Half-lines all around on a slope, from 1 m to 15 m."""
    rise = np.tan(np.deg2rad(slope_deg)) * np.cos(np.deg2rad(np.arange(0, 360, 4) + turned_deg))
    far = [[(0.6, ROAD_Z + 0.6 * t, 15.0, ROAD_Z + 15 * t, H)] for t in rise.tolist()]
    return scan(far, n=300)


@pytest.mark.parametrize("slope", [0.5, 1.0, 3.0, 5.0])
def test_a_slope_is_ground_all_around_whatever_the_first_line(slope: float) -> None:
    for turned in (0.0, 90.0, 200.0):
        scene = plane(slope, turned)
        _, found, z_g, _ = find(scene)
        shares = found.sum(axis=1) / (scene.surface == H).sum(axis=1)
        assert shares.mean() > 0.98
        assert shares.min() > 0.8
        assert np.all(np.abs(z_g - ROAD_Z) < 0.1)


def test_ground_is_followed_along_its_own_side() -> None:
    """One side sinks and the other one rises by half a metre: no height holds for both."""
    away_m = np.repeat(np.minimum(np.arange(120) * 0.01, 0.5), 2) * np.tile([-1.0, 1.0], 120)
    scene = scan([[(0.6, ROAD_Z + up, 15.0, ROAD_Z + up, H)] for up in away_m.tolist()], n=150)
    heights = find(scene)[0]

    def at_the_end(n_sides: int, **values: float) -> list[float]:
        params = limits(**values)
        state = initial_ground(heights, params, n_sides)
        found, _, _ = follow(scene.lines, scene.surface, scene.phihat, scene.ahead, state, params)
        first, left = scene.rows(0, 78), scene.rows(78, 240)  # the state holds the heights of both sides
        before, _, state = follow(first.lines, first.surface, first.phihat, first.ahead, state, params)
        behind, _, _ = follow(left.lines, left.surface, left.phihat, left.ahead, state, params)
        np.testing.assert_array_equal(np.concatenate([before, behind]), found)
        return [float(found[side::2][-40:].any(axis=1).mean()) for side in (0, 1)]

    assert at_the_end(2) == [1.0, 1.0]
    assert at_the_end(2, follow_m=0) == [1.0, 0.0]  # the dominant height is that of one of them
    assert at_the_end(1) == [1.0, 0.0]  # the height of the other side is of no use


@pytest.mark.parametrize(("below_m", "left"), [(0.9, True), (0.4, False)])
def test_the_bonnet_of_a_car_is_not_the_ground(below_m: float, left: bool) -> None:
    bonnet: list[Segment] = [(0.3, ROAD_Z + below_m, 6.0, ROAD_Z + below_m, H)]
    scene = scan([bonnet] * 80 + [street()] * 30, n=300)
    _, found, z_g, _ = find(scene)
    assert found[105:].any(axis=1).all() == left
    assert (abs(z_g[-1] - ROAD_Z) < 0.03) == left
    off = limits(roof_m=1000)
    assert not find(scene, off)[1][80:].any()


@pytest.mark.parametrize("memory", [100, 0])
def test_a_wrong_first_estimate_is_left_behind(memory: int) -> None:
    ramp: list[Segment] = [(0.3, -0.9, 6.0, -0.9, H)]
    scene = scan([ramp] * 49 + [street()] * 150, n=300)
    _, found, z_g, _ = find(scene, limits(memory_heights=memory))
    assert found[105:].any(axis=1).all()
    np.testing.assert_allclose(z_g[105:], ROAD_Z, atol=0.03)
    assert not find(scene, limits(renew_every=False))[1][60:].any()


@pytest.mark.parametrize("curb_m", [0.08, 0.12, 0.15])
@pytest.mark.parametrize("n", [300, 1000])
def test_ground_ends_at_a_curb_however_few_shots_meet_it(curb_m: float, n: int) -> None:
    scene = scan([street(curb_m)] * 20, n=n)
    assert ((scene.surface == V) & (scene.lines.horizontal_m < 6.1)).any(axis=1).all()
    _, found, _, _ = find(scene)
    assert found[road(scene)].mean() > 0.95
    assert not found[scene.lines.horizontal_m > 6.1].any()


@pytest.mark.parametrize("n_sides", [1, 2])
def test_cuts_change_nothing(n_sides: int) -> None:
    profiles = [hedge() if i % 7 == 0 else street(car=i % 5 == 0) for i in range(70)]
    scene = scan(profiles, n=250, n_sides=n_sides, missing=0.1)
    params = limits(start_heights=20, memory_heights=30)
    heights, whole, z_whole, last = find(scene, params)
    rng = np.random.default_rng(2)
    for _ in range(4):
        cuts = np.sort(rng.integers(0, 71, 5)) * n_sides
        edges = [0, *cuts.tolist(), len(scene.surface)]
        state = initial_ground(heights, params)
        parts = []
        for first, end in pairwise(edges):
            part = scene.rows(first, end)
            found, z_g, state = follow(part.lines, part.surface, part.phihat, part.ahead, state, params)
            parts.append((found, z_g))
        np.testing.assert_array_equal(np.concatenate([found for found, _ in parts]), whole)
        np.testing.assert_array_equal(np.concatenate([z_g for _, z_g in parts]), z_whole)
        np.testing.assert_array_equal(state.histogram, last.histogram)
        np.testing.assert_array_equal(state.recent, last.recent)
        assert state.z_g == last.z_g
