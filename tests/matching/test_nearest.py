"""Nearest points of two clouds, against a search point by point, and the shift of the clouds."""

import io
from collections.abc import Iterator

import numpy as np
import pytest

from prc_cli.core.types import F64
from prc_cli.matching.join import Columns, JoinTally
from prc_cli.matching.nearest import CELL_M, Cloud, fit_of, nearest_join, tiles_of
from prc_cli.matching.shift import shift_of


def cloud(xyz: F64, seconds: F64 | None = None, step: int = 37) -> Cloud:
    def chunks() -> Iterator[Columns]:
        for first in range(0, len(xyz), step):
            part = slice(first, first + step)
            columns: Columns = {axis: xyz[part, k] for k, axis in enumerate("xyz")}
            columns["id"] = np.arange(len(xyz))[part]
            yield columns if seconds is None else {**columns, "seconds": seconds[part]}

    return Cloud(chunks(), io.BytesIO())


def points(n: int, seed: int, span: float = 60.0) -> F64:
    random = np.random.default_rng(seed)
    return random.uniform(-span, span, (n, 3)) * [1, 1, 0.01] + [6.7e5, 6.2e6, 40.0]


@pytest.mark.parametrize(
    "tolerance, n, most", [(0.5, 900, 50), (3.0, 300, 7), (3.0, 20, 1000), (0.5, 0, 50)]
)
def test_every_point_comes_once_with_its_nearest_one(
    monkeypatch,
    tolerance,
    n,
    most,
):
    monkeypatch.setattr(tiles_of, "__defaults__", (most,))
    left = points(n, 1)
    right = points(700, 2)
    tally = JoinTally()
    nearest = np.full(n, -2)
    for item in nearest_join(cloud(left), cloud(right), tolerance, tally):
        assert np.all(nearest[item.left["id"]] == -2)
        nearest[item.left["id"]] = np.where(
            item.partner_index >= 0, item.right["id"][item.partner_index], -1
        )
    apart = np.linalg.norm(left[:, None] - right[None], axis=2)
    expected = np.where(apart.min(axis=1) <= tolerance, apart.argmin(axis=1), -1)
    np.testing.assert_array_equal(nearest, expected)
    used = len(set(expected.tolist()) - {-1})
    assert (tally.n_left, tally.n_pairs, tally.n_right) == (n, int((expected >= 0).sum()), used)


def test_tiles_lie_around_left_points_only():
    cells = [(column, row) for column in range(9) for row in range(9)]
    right = np.array([(column + 0.5, row + 0.5, 0.0) for column, row in cells]) * CELL_M
    tiles = tiles_of(cloud(right[cells.index((4, 4))][None]), cloud(right), 1)
    around = {(column, row) for column in (3, 4, 5) for row in (3, 4, 5)}
    assert {(west // CELL_M, south // CELL_M) for west, south, *_ in tiles} == around


def test_of_points_as_near_the_one_of_the_nearest_time_is_taken():
    here = np.zeros((1, 3))
    right = np.array([[0.1, 0, 0], [0.1, 0, 0], [-0.1, 0, 0]])
    for seconds, expected in (([1.0, 5.0, 9.0], 1), ([5.0, 1.0, 9.0], 0), ([1.0, 1.0, 5.0], 2)):
        clouds = cloud(here, np.array([5.0])), cloud(right, np.array(seconds))
        (item,) = nearest_join(*clouds, 0.5, JoinTally())
        assert item.right["id"][item.partner_index].tolist() == [expected]


@pytest.mark.parametrize(
    "error, thinned, low, high",
    [(0.0, 1, 0.002, 0.3), (0.02, 1, 0.05, 0.3), (0.0, 9, 0.4, 1)],
)
def test_the_tolerance_follows_error_and_spacing(
    error,
    thinned,
    low,
    high,
):
    random = np.random.default_rng(0)
    flat = np.stack(
        [*(axis.ravel() * 0.1 for axis in np.mgrid[0:300, 0:300]), np.zeros(90_000)], axis=1
    )
    kept = flat[random.random(len(flat)) < 1 / thinned]
    fit = fit_of(
        cloud(flat, step=10_000), cloud(kept + random.normal(0, error, kept.shape), step=10_000)
    )
    assert fit is not None
    assert low <= fit.tolerance_m <= high
    assert fit_of(cloud(flat[:50]), cloud(flat[:50] + 1000.0)) is None


def street(seed: int) -> F64:
    """A street of 80 m: ground, houses with fronts and sides, bushes."""
    random = np.random.default_rng(seed)
    ground = random.uniform(0, 1, (60_000, 3)) * [80, 20, 0.01]
    fronts = random.uniform(0, 1, (30_000, 3)) * [80, 0.01, 6] + np.array([0, 20, 0])
    sides = [
        random.uniform(0, 1, (3_000, 3)) * [0.01, 6, 5] + np.array([x, 14, 0])
        for x in (9, 27, 44, 52, 70)
    ]
    bushes = [random.normal(0, 0.5, (2_000, 3)) + np.array([x, 3, 1]) for x in (12, 33, 61)]
    return np.concatenate([ground, fronts, *sides, *bushes])


def registered(xyz: F64, seed: int) -> F64:
    """The points with the error of a trajectory, 2 cm an axis, another one every 8 m."""
    random = np.random.default_rng(seed)
    error = random.normal(0, 0.02, (11, 3))
    return xyz + np.stack(
        [np.interp(xyz[:, 0], np.arange(11) * 8.0, axis_error) for axis_error in error.T], axis=1
    )


def quarters(xyz: F64) -> Cloud:
    parts = np.array_split(xyz, 4)
    return Cloud(
        iter([dict(zip("xyz", part.T.copy(), strict=True)) for part in parts]), io.BytesIO()
    )  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "shift",
    [(0.0, 0.12, 0.0), (0.0, 0.0, -0.1), (0.2, 0.3, 0.1), (1.0, 0.0, 0.0), (3.0, -2.0, 0.5)],
)
def test_a_shift_is_measured(shift):
    measured = shift_of(quarters(street(1)), quarters(registered(street(2), 5) + shift))
    assert measured is not None
    np.testing.assert_allclose(measured, shift, atol=0.03)


@pytest.mark.parametrize("tolerance", [1e8, 1e300])
def test_points_far_apart_and_any_tolerance_take_no_memory(tolerance):
    far = np.array([[0.0, 0.0, 0.0], [9e8, 9e8, 0.0]])
    tally = JoinTally()
    pairs = [
        item.partner_index.tolist()
        for item in nearest_join(cloud(far), cloud(far[::-1]), tolerance, tally)
    ]
    assert tally.n_pairs == 2
    assert sum(map(len, pairs)) == 2


def test_clouds_in_other_units_do_not_lie_on_each_other():
    metres = np.random.default_rng(3).random((1200, 3)) * [100, 100, 5]
    assert fit_of(cloud(metres), cloud(metres / 0.3048)) is None
