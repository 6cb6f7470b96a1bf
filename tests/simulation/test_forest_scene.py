"""The forest: the same from every position, stems as configured, a clear path, the cylinders of the paper."""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.simulation.forest.params import PRESETS, ForestSceneParams
from prc_cli.simulation.forest.reference import reference_labels
from prc_cli.simulation.forest.scene import ForestScene
from prc_cli.simulation.forest.terrain import Terrain
from prc_cli.simulation.forest.trees import Species, Stems
from prc_cli.simulation.world import PROPERTIES, Bodies, Material, Shape


@pytest.fixture(scope="module")
def scene() -> ForestScene:
    return ForestScene(ForestSceneParams(), seed=11)


@pytest.fixture(scope="module")
def bodies(scene: ForestScene) -> Bodies:
    return scene.bodies_near(15.0, 25.0, 25.0)


def _assert_same(one: Bodies, other: Bodies) -> None:
    for field in fields(Bodies):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name), err_msg=field.name)


def test_the_same_seed_makes_the_same_forest_whatever_was_seen_before(scene: ForestScene) -> None:
    fresh = ForestScene(ForestSceneParams(), seed=11)
    fresh.bodies_near(-40.0, 90.0, 20.0)
    _assert_same(fresh.bodies_near(15.0, 25.0, 12.0), scene.bodies_near(15.0, 25.0, 12.0))


def test_two_threads_make_every_cell_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[tuple[str, int, int]] = []
    for name in ("_make_cell", "_make_stems"):
        monkeypatch.setattr(ForestScene, name, _slow(name, getattr(ForestScene, name), made))
    scene = ForestScene(ForestSceneParams(), seed=11)
    with ThreadPoolExecutor(2) as pool:
        one, other = pool.map(lambda _: scene.bodies_near(15.0, 25.0, 5.0), range(2))
    _assert_same(one, other)
    assert made
    assert len(set(made)) == len(made)


def _slow(name: str, make: Callable[..., Any], made: list[tuple[str, int, int]]) -> Callable[..., Any]:
    """Note what is made, slowly enough for another thread to ask for it."""

    def wrapper(self: ForestScene, i: int, j: int) -> Any:
        made.append((name, i, j))
        time.sleep(0.005)
        return make(self, i, j)

    return wrapper


def test_no_body_in_a_circle_is_left_out(scene: ForestScene, bodies: Bodies) -> None:
    small = scene.bodies_near(18.0, 22.0, 6.0)
    large = scene.bodies_near(18.0, 22.0, 30.0)
    # both ends of a cone and the middle of all else: what is inside must be there
    ends = large.numbers.reshape(-1, 3, 3)[:, :2, :2] - (18.0, 22.0)
    ends[large.shape == Shape.ELLIPSOID, 1] = ends[large.shape == Shape.ELLIPSOID, 0]
    inside = (np.hypot(ends[..., 0], ends[..., 1]) < 6.0).any(axis=1)
    assert inside.sum() > 100
    assert np.isin(large.number[inside], small.number).all()


def test_bodies_keep_the_contract_of_the_world(bodies: Bodies) -> None:
    assert {field.name: getattr(bodies, field.name).dtype.name for field in fields(Bodies)} == {
        "shape": "uint8",
        "numbers": "float64",
        "material": "uint8",
        "density": "float64",
        "velocity": "float64",
        "number": "float64",
    }
    assert np.isfinite(bodies.numbers).all()
    assert bodies.number.min() >= 0
    assert bodies.number.max() < 2**53
    assert (bodies.number == np.floor(bodies.number)).all()
    assert not bodies.velocity.any()
    assert (bodies.density >= 0).all()
    assert (bodies.density[bodies.shape != Shape.ELLIPSOID] == 0).all()
    round_ = bodies.shape == Shape.ELLIPSOID
    assert (bodies.numbers[round_, 3:6] > 0).all()
    cones = bodies.numbers[bodies.shape == Shape.CONE]
    assert (cones[:, 6:8] >= 0).all()
    assert (cones[:, 6:8].max(axis=1) > 0).all()
    leaves = np.isin(bodies.material, [Material.LEAVES, Material.GRASS])
    assert (bodies.density[leaves] > 0).all()


def test_all_that_makes_a_forest_is_there(bodies: Bodies) -> None:
    labels = {PROPERTIES[Material(m)].label for m in np.unique(bodies.material)}
    assert labels == {Label.GROUND, Label.STEM, Label.VEGETATION}
    assert {Material.SOIL, Material.DEAD_WOOD, Material.UNDERGROWTH, Material.LEAVES, Material.BRANCH} <= {
        Material(m) for m in np.unique(bodies.material)
    }


@pytest.mark.parametrize("name", PRESETS)
def test_a_walker_sees_no_more_bodies_than_the_caster_can_bear(name: str) -> None:
    assert 3000 < len(ForestScene(PRESETS[name], seed=2).bodies_near(20.0, 30.0, 30.0)) < 10_000


def test_what_is_asked_for_none_of_is_not_there() -> None:
    bare = ForestSceneParams(
        stems_per_ha=0,
        mounds_per_ha=0,
        shrubs_per_ha=0,
        saplings_per_ha=0,
        herbs_per_ha=0,
        logs_per_ha=0,
        stumps_per_ha=0,
    )
    scene = ForestScene(bare, seed=1)
    assert set(scene.bodies_near(0, 0, 20).material) == {Material.SOIL}
    assert len(scene.stems_near(0, 0, 20)) == 0


@pytest.mark.parametrize("stems_per_ha", [300.0, 1200.0])
def test_stems_are_as_dense_as_asked_for_and_keep_apart(stems_per_ha: float) -> None:
    # one row far away from the place that is counted
    scene = ForestScene(ForestSceneParams(stems_per_ha=stems_per_ha), seed=5)
    stems = scene.stems_near(-150.0, 0.0, 80.0)
    area_ha = np.pi * 0.8**2
    assert len(stems) / area_ha == pytest.approx(stems_per_ha, rel=0.06)
    xy = stems.base[:, :2]
    apart = np.hypot(*np.moveaxis(xy[:, None] - xy, -1, 0)) + np.diag(np.full(len(xy), np.inf))
    expected = np.sqrt(0.5 / (np.pi * stems_per_ha / 10_000))
    assert expected <= apart.min() < 1.15 * expected


def test_stems_taper_and_are_as_thick_at_breast_height_as_listed(scene: ForestScene, bodies: Bodies) -> None:
    cones = bodies.numbers[bodies.material == Material.STEM]
    assert len(cones) > 250
    assert (cones[:, 6] >= cones[:, 7]).all()
    stems = scene.stems_near(15.0, 25.0, 20.0)
    for breast, dbh in zip(stems.breast, stems.dbh, strict=True):
        ends_here = np.abs(cones[:, 3:6] - breast).max(axis=1) < 1e-9
        assert cones[ends_here, 7] == pytest.approx([dbh / 2])


def test_the_path_is_clear(scene: ForestScene) -> None:
    """Along 120 m, nothing solid or leafy stands where the walker and the scanner on his back pass."""
    s = np.arange(0.0, 120.0, 0.25)
    path, _ = scene.path_point(s)
    low, high = path[:, :2].min(axis=0), path[:, :2].max(axis=0)
    middle = (low + high) / 2
    radius = float(np.hypot(*(high - low))) / 2 + 3
    stems = scene.stems_near(*middle, radius)
    for above in (0.0, 1.3, 2.0):
        axis = stems.axis(np.full(len(stems), above))
        gap = np.hypot(*np.moveaxis(axis[:, None, :2] - path[:, :2], -1, 0)).min(axis=1) - stems.dbh / 2
        assert gap.min() > scene.params.clearance_m - 0.05
    bodies = scene.bodies_near(*middle, radius)
    scanner = path + np.array([0, 0, 2.1])
    tufts = bodies.numbers[bodies.shape == Shape.ELLIPSOID]
    for centre, half, yaw in zip(tufts[:, :3], tufts[:, 3:6], tufts[:, 6], strict=True):
        offset = scanner - centre
        along = np.cos(yaw) * offset[:, 0] + np.sin(yaw) * offset[:, 1]
        across = np.cos(yaw) * offset[:, 1] - np.sin(yaw) * offset[:, 0]
        assert ((along / half[0]) ** 2 + (across / half[1]) ** 2 + (offset[:, 2] / half[2]) ** 2 > 1).all()


def test_the_path_runs_in_rows_without_jumps(scene: ForestScene) -> None:
    s = np.arange(-150.0, 400.0, 0.02)
    path, heading = scene.path_point(s)
    steps = np.diff(path[:, :2], axis=0)
    assert np.hypot(*steps.T) == pytest.approx(0.02, rel=0.01)
    assert np.abs(np.diff(path[:, 2])).max() < 0.02
    assert np.abs(np.diff(heading)).max() < 0.02 / (scene.params.row_spacing_m / 2) * 1.5
    towards = np.arctan2(steps[:, 1], steps[:, 0])
    turned = (towards - (heading[1:] + heading[:-1]) / 2 + np.pi) % (2 * np.pi) - np.pi
    assert np.abs(turned).max() < 0.005
    rows, _ = scene.path_point(np.arange(6) * scene.rows.period_m)
    assert rows[:, 0] == pytest.approx([0, 40, 0, 40, 0, 40], abs=1e-6)
    assert rows[:, 1] == pytest.approx(np.arange(6) * 10.0)


@pytest.mark.parametrize("step_m", [0.5, 1.5])
def test_triangles_meet_without_cracks_and_follow_the_level(step_m: float) -> None:
    terrain = Terrain(seed=3, slope_deg=8.0, incline_deg=5.0, step_m=step_m)
    corners = np.concatenate([terrain.triangles(i, j) for i in (-1, 0) for j in (0, 1)])
    assert len(corners) == 4 * 2 * terrain.squares**2
    edges: dict[tuple[bytes, bytes], int] = {}
    for triangle in corners:
        for a, b in ((0, 1), (1, 2), (2, 0)):
            first, second = sorted([triangle[a].tobytes(), triangle[b].tobytes()])
            edges[first, second] = edges.get((first, second), 0) + 1
    # every edge has two triangles, but those around the whole
    assert sorted(edges.values()).count(1) == 4 * 2 * terrain.squares
    assert max(edges.values()) == 2
    middle = corners.mean(axis=1)
    assert terrain.height(middle[:, 0], middle[:, 1]) == pytest.approx(middle[:, 2])
    assert terrain.height(corners[:, 0, 0], corners[:, 0, 1]) == pytest.approx(corners[:, 0, 2])
    assert np.abs(terrain.level(middle[:, 0], middle[:, 1]) - middle[:, 2]).max() < 0.06


class _OneTree:
    """A scene with a tree of 0.3 m at (10, 20), upright, its foot at 5 m; and one of 0.2 m at (30, 20), foot 8 m."""

    def stems_near(self, x_m: float, y_m: float, radius_m: float) -> Stems:
        return Stems(
            base=np.array([[10.0, 20.0, 5.0], [30.0, 20.0, 8.0]]),
            dbh=np.array([0.3, 0.2]),
            height=np.array([20.0, 15.0]),
            lean=np.zeros((2, 2)),
            sweep=np.zeros((2, 2)),
            species=np.array([Species.PINE, Species.BIRCH], dtype=np.uint8),
        )


def test_cylinders_of_the_paper_on_points_by_hand() -> None:
    """Radius two diameters; from 0.3 to 4.3 m above the foot; ground up to 0.8 m above the nearest foot."""
    cases = [
        ((10.0, 20.0, 6.3), Label.STEM),
        ((10.59, 20.0, 6.3), Label.STEM),
        ((10.61, 20.0, 6.3), Label.NOISE),
        ((10.0, 19.41, 9.29), Label.STEM),
        ((10.0, 20.0, 9.31), Label.NOISE),
        ((10.0, 20.0, 5.31), Label.STEM),
        ((10.0, 20.0, 5.29), Label.GROUND),
        ((12.0, 20.0, 5.79), Label.GROUND),
        ((12.0, 20.0, 5.81), Label.NOISE),
        ((12.0, 20.0, 2.0), Label.GROUND),
        # the second tree is nearer: its own height counts
        ((29.0, 20.0, 8.7), Label.GROUND),
        ((29.61, 20.0, 9.0), Label.STEM),
        ((29.59, 20.0, 9.0), Label.NOISE),
        ((np.nan, 20.0, 9.0), Label.MISSING),
        ((np.inf, 20.0, 9.0), Label.MISSING),
    ]
    scene = _OneTree()
    labels = reference_labels(scene, np.array([xyz for xyz, _ in cases]))  # type: ignore[arg-type]
    assert [Label(label) for label in labels] == [label for _, label in cases]
    assert labels.dtype == np.uint8
