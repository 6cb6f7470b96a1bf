from __future__ import annotations

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.simulation.furniture import bodies_between
from prc_cli.simulation.houses import lots_between
from prc_cli.simulation.params import StreetParams
from prc_cli.simulation.rays import Bounds, Hits, Rays, lattice, through_ellipsoid, through_planes, window
from prc_cli.simulation.street import _rays, simulate_street


def ahead(*, x: float, z: float = 1.0) -> Rays:
    """One ray along the street."""
    return Rays(np.array([[x]]), 0.0, z, np.array([1.0]), np.array([0.0]), np.array([0.0]))


def test_ellipsoid_is_entered_and_left() -> None:
    way = through_ellipsoid(ahead(x=0.0), (10.0, 0.0, 1.0), (2.0, 5.0, 1.0))
    assert (way.enter.item(), way.leave.item()) == pytest.approx((8.0, 12.0))


def test_ellipsoid_of_infinite_height_is_a_cylinder() -> None:
    way = through_ellipsoid(ahead(x=0.0, z=50.0), (10.0, 0.0, 0.0), (2.0, 2.0, np.inf))
    assert way.enter.item() == pytest.approx(8.0)


@pytest.mark.parametrize(("x", "y"), [(0.0, 3.0), (20.0, 0.0), (10.0, 0.0)])
def test_bodies_beside_behind_or_around_the_scanner_are_missed(x: float, y: float) -> None:
    assert np.isinf(through_ellipsoid(ahead(x=x), (10.0, y, 1.0), (2.0, 2.0, 2.0)).enter.item())


def test_box_is_entered_and_left_and_missed() -> None:
    normals = np.vstack([np.eye(3), -np.eye(3)])
    offsets = np.array([12.0, 1.0, 2.0, -8.0, 1.0, 0.0])
    way = through_planes(ahead(x=0.0), normals, offsets)
    assert (way.enter.item(), way.leave.item()) == pytest.approx((8.0, 12.0))
    assert np.isinf(through_planes(ahead(x=0.0, z=2.5), normals, offsets).enter.item())
    assert np.isinf(through_planes(ahead(x=13.0), normals, offsets).enter.item())


@pytest.mark.parametrize("slant_deg", [-40.0, 0.0, 25.0, 60.0])
def test_window_loses_no_hit(slant_deg: float) -> None:
    params = StreetParams(n_lines=80, points_per_line=500, slant_deg=slant_deg, speed_m_s=15.0)
    angle = simulate_street(params).angle_rad
    rays = _rays(params, angle, 20, 60)
    chance, depth = np.random.default_rng(3).random((2, *rays.x.shape))
    n_hit = 0
    for body in bodies_between(1, float(rays.x.min()) - 60.0, float(rays.x.max()) + 60.0):
        everywhere, _ = body.cast(rays, chance, depth)
        place = window(rays, angle, body.bounds)
        inside = np.full(rays.x.shape, np.inf)
        if place is not None:
            inside[place] = body.cast(rays.part(*place), chance[place], depth[place])[0]
        assert np.array_equal(everywhere, inside)
        n_hit += int(np.isfinite(everywhere).sum())
    assert n_hit > 1000


def test_window_over_the_scanner_takes_all_columns() -> None:
    params = StreetParams(n_lines=40, points_per_line=100)
    angle = simulate_street(params).angle_rad
    place = window(_rays(params, angle, 0, 40), angle, Bounds((0.0, 5.0), (-3.0, 3.0), (6.0, 7.0)))
    assert place is not None
    assert place[1] == slice(0, 100)


def test_hits_keep_the_nearest_and_ignore_what_lies_behind() -> None:
    hits = Hits.none((1, 3))
    hits.take_nearer(np.array([[5.0, np.inf, -2.0]]), Label.GROUND, np.array([0.1, 0.2, 0.3]))
    hits.take_nearer(np.array([[6.0, 7.0, np.nan]]), Label.CAR)
    assert hits.t.tolist() == [[5.0, 7.0, np.inf]]
    assert hits.label.tolist() == [[Label.GROUND, Label.CAR, Label.MISSING]]
    assert hits.facing.tolist() == [[0.1, 1.0, 1.0]]


def test_lattice_is_uniform_reproducible_and_differs_by_every_key() -> None:
    keys = np.arange(-50_000, 50_000)
    numbers = lattice(7, keys)
    assert np.histogram(numbers, bins=10, range=(0, 1))[0] == pytest.approx([10_000] * 10, rel=0.05)
    assert np.array_equal(numbers[10:20], lattice(7, keys[10:20]))
    for other in (lattice(8, keys), lattice(7, 1, keys), lattice(7, keys, 1), lattice(7, keys + 1)):
        assert abs(np.corrcoef(numbers, other)[0, 1]) < 0.02


def test_lots_follow_each_other_and_do_not_depend_on_the_stretch() -> None:
    lots, part = lots_between(3, 1, -50.0, 500.0), lots_between(3, 1, 200.0, 260.0)
    assert (np.diff(lots.edge) >= 0).all()
    same = np.isin(lots.index, part.index)
    assert np.array_equal(lots.height[same], part.height)
    assert np.array_equal(lots.edge[:-1][same], part.edge[:-1])
    assert part.edge[0] < 200.0
    assert part.edge[-1] > 260.0
    long = lots_between(3, -1, 0.0, 20_000.0)
    for kind in (long.built, long.hedged, ~long.built & ~long.hedged):
        assert kind.mean() > 0.05
