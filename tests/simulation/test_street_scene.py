"""The street: a drivable lane, ground without gaps, the same bodies for every query."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.simulation.casting import cast
from prc_cli.simulation.street.plan import CHARACTERS, StreetSceneParams
from prc_cli.simulation.street.scene import StreetScene
from prc_cli.simulation.world import Bodies, Material


def look_down(bodies: Bodies, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ranges and rows of what is under (lines, M, 3) places."""
    down = np.zeros(places.shape)
    down[..., 2] = -1.0
    hits = cast(bodies, places, down, np.zeros(len(places)))
    return hits.t, hits.body


def grid(scene: StreetScene, s: np.ndarray, d: np.ndarray, up: float) -> np.ndarray:
    """Places above the street, (len(s), len(d), 3); the height is that above the lane."""
    z = scene.path_point(s)[0][:, 2] + up
    rows = [scene.line.place(np.full(d.shape, at), d) for at in s.tolist()]
    return np.concatenate([np.array(rows), np.broadcast_to(z[:, None, None], (*z.shape, d.size, 1))], axis=2)


def around(scene: StreetScene, s: float, radius: float = 70.0, time_s: float = 0.0) -> Bodies:
    x, y, _ = scene.path_point(np.array([s]))[0][0].tolist()
    return scene.bodies_near(x, y, radius, time_s)


def test_the_path_is_continuous_and_measured_by_its_length() -> None:
    scene = StreetScene(seed=3)
    s = np.arange(-300.0, 10_000.0, 0.25)
    point, heading = scene.path_point(s)
    step = np.diff(point, axis=0)
    assert np.hypot(step[:, 0], step[:, 1]) == pytest.approx(0.25, abs=1e-6)
    assert np.abs(step[:, 2]).max() < 0.05 * 0.25
    assert np.abs(np.diff(heading)).max() < 0.25 / 200.0
    middle = 0.5 * (heading[1:] + heading[:-1])
    assert np.arctan2(step[:, 1], step[:, 0]) == pytest.approx(middle, abs=1e-5)
    start, heading_0 = scene.path_point(np.zeros(1))
    assert start[0, :2] == pytest.approx(0.0, abs=1e-12)
    assert heading_0[0] == pytest.approx(0.0, abs=1e-12)
    assert np.ptp(heading) > 0.2
    assert np.ptp(point[:, 2]) > 3.0


@pytest.mark.parametrize("s", [-700.0, 0.0, 12_345.6, 1e6])
def test_nearest_finds_the_place_again(s: float) -> None:
    line = StreetScene(seed=5).line
    for d in (-30.0, 0.0, 45.0):
        x, y = line.place(np.array([s]), np.array([d]))[0].tolist()
        assert line.nearest(x, y) == pytest.approx(s, abs=0.8)


def test_the_same_bodies_whatever_the_circle_and_the_way_there() -> None:
    one, two = StreetScene(seed=11), StreetScene(seed=11)
    for s in (600.0, 30.0):
        around(two, s)
    a, b = around(one, 100.0), around(two, 130.0)
    _, in_a, in_b = np.intersect1d(a.number, b.number, return_indices=True)
    assert in_a.size > 1500
    for name in Bodies.__slots__:
        np.testing.assert_array_equal(getattr(a, name)[in_a], getattr(b, name)[in_b])
    assert np.all(np.diff(in_b[np.argsort(in_a)]) > 0)
    assert np.unique(a.number).size == len(a)
    assert a.number.min() >= 0
    assert a.number.max() < 2.0**53
    # a smaller circle holds nothing that the larger one does not
    assert set(around(one, 100.0, 25.0).number) <= set(a.number)
    other = around(StreetScene(seed=12), 100.0)
    assert not np.array_equal(a.numbers, other.numbers)


@pytest.mark.parametrize("character", CHARACTERS)
def test_the_lane_is_clear_and_follows_the_road(character: str) -> None:
    scene = StreetScene(StreetSceneParams(character=character, cars_per_km=0), seed=4)  # type: ignore[arg-type]
    d = np.linspace(-2.8, 2.8, 15)
    for start in (0.0, 90.0, 180.0):
        s = start + np.arange(0.0, 90.0, 0.6)
        bodies = around(scene, start + 45.0, 60.0)
        t, body = look_down(bodies, grid(scene, s, d, 3.6))
        assert np.all(body >= 0)
        assert set(bodies.material[body].ravel()) == {Material.ASPHALT}
        design = np.array([scene.ground.road(np.full(d.shape, at), d) for at in s.tolist()])
        z = scene.path_point(s)[0][:, 2:] + 3.6 - t
        assert np.abs(z - design).max() < 0.004


@pytest.mark.parametrize("character", CHARACTERS)
def test_the_count_of_bodies_stays_moderate(character: str) -> None:
    scene = StreetScene(StreetSceneParams(character=character), seed=8)  # type: ignore[arg-type]
    for s in (0.0, 300.0, 600.0):
        assert 1000 < len(around(scene, s, 70.0)) < 6000
    made = sum(len(scene._piece(piece)[0]) for piece in range(20))
    assert made / 60 < 350
