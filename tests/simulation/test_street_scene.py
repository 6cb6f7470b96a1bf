"""The street: a drivable lane, ground without gaps, the same bodies for every query."""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.simulation.street.plan import CHARACTERS, StreetSceneParams
from prc_cli.simulation.street.scene import StreetScene
from prc_cli.simulation.world import Bodies


def around(scene: StreetScene, s: float, radius: float = 70.0, time_s: float = 0.0) -> Bodies:
    x, y, _ = scene.path_point(np.array([s]))[0][0].tolist()
    return scene.bodies_near(x, y, radius, time_s)


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


@pytest.mark.slow
@pytest.mark.parametrize("character", CHARACTERS)
def test_the_count_of_bodies_stays_moderate(character: str) -> None:
    scene = StreetScene(StreetSceneParams(character=character), seed=8)  # type: ignore[arg-type]
    for s in (0.0, 300.0, 600.0):
        assert 1000 < len(around(scene, s, 70.0)) < 6000
    made = sum(len(scene._piece(piece)[0]) for piece in range(20))
    assert made / 60 < 350
