"""Forests and streets: the same bodies from every place, a clear path, stems and the cylinders of
the paper."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.simulation.forest.params import ForestSceneParams
from prc_cli.simulation.forest.reference import reference_labels
from prc_cli.simulation.forest.scene import ForestScene
from prc_cli.simulation.forest.trees import Species, Stems
from prc_cli.simulation.street.road import DROP_M, _verges
from prc_cli.simulation.street.scene import StreetScene
from prc_cli.simulation.world import Bodies


@pytest.fixture(scope="module")
def scene():
    return ForestScene(ForestSceneParams(), seed=11)


def test_the_path_is_clear(scene):
    """Along 120 m, no stem stands where the walker passes."""
    s = np.arange(0.0, 120.0, 0.25)
    path, _ = scene.path_point(s)
    assert np.hypot(*np.diff(path[:, :2], axis=0).T).max() < 0.3
    low = path[:, :2].min(axis=0)
    high = path[:, :2].max(axis=0)
    middle = (low + high) / 2
    radius = float(np.hypot(*(high - low))) / 2 + 3
    stems = scene.stems_near(*middle, radius)
    for above in (0.0, 1.3, 2.0):
        axis = stems.axis(np.full(len(stems), above))
        gap = (
            np.hypot(*np.moveaxis(axis[:, None, :2] - path[:, :2], -1, 0)).min(axis=1)
            - stems.dbh / 2
        )
        assert gap.min() > scene.params.clearance_m - 0.05


class _OneTree:
    """A scene with a tree of 0.3 m at (10, 20), upright, its foot at 5 m.

    And one of 0.2 m at (30, 20), foot 8 m.
    """

    def stems_near(self, x_m: float, y_m: float, radius_m: float) -> Stems:
        return Stems(
            base=np.array([[10.0, 20.0, 5.0], [30.0, 20.0, 8.0]]),
            dbh=np.array([0.3, 0.2]),
            height=np.array([20.0, 15.0]),
            lean=np.zeros((2, 2)),
            sweep=np.zeros((2, 2)),
            species=np.array([Species.PINE, Species.BIRCH], dtype=np.uint8),
        )


def test_cylinders_of_the_paper_on_points_by_hand():
    """Radius two diameters; from 0.3 to 4.3 m above the foot.

    Ground up to 0.8 m above the nearest foot.
    """
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


def around(
    scene: StreetScene,
    s: float,
    radius: float = 70.0,
    time_s: float = 0.0,
) -> Bodies:
    x, y, _ = scene.path_point(np.array([s]))[0][0].tolist()
    return scene.bodies_near(x, y, radius, time_s)


def test_the_same_bodies_whatever_the_circle_and_the_way_there():
    whole = StreetScene(seed=11)
    two = StreetScene(seed=11)
    for s in (600.0, 30.0):
        around(two, s)
    a = around(whole, 100.0)
    b = around(two, 130.0)
    _, in_a, in_b = np.intersect1d(a.number, b.number, return_indices=True)
    assert in_a.size > 1500
    for name in Bodies.__slots__:
        np.testing.assert_array_equal(getattr(a, name)[in_a], getattr(b, name)[in_b])
    assert np.all(np.diff(in_b[np.argsort(in_a)]) > 0)
    assert np.unique(a.number).size == len(a)
    assert a.number.min() >= 0
    assert a.number.max() < 2.0**53
    # a smaller circle holds nothing that the larger one does not
    assert set(around(whole, 100.0, 25.0).number) <= set(a.number)
    fresh = around(StreetScene(seed=12), 100.0)
    assert not np.array_equal(a.numbers, fresh.numbers)


def test_verges_end_before_dropped_curbs():
    side: Any = SimpleNamespace(junction=None, dropped=[(10.0, 20.0)])
    assert _verges(side, [-5.0, 35.0], (0.0, 40.0)) == [(0.0, 10.0 - DROP_M), (20.0 + DROP_M, 35.0)]
