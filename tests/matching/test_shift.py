"""Shifts between two registered clouds: measured to a centimetre, and none is named where there is none."""

from __future__ import annotations

import io

import numpy as np
import pytest

from prc_cli.core.types import F64
from prc_cli.matching.nearest import Cloud
from prc_cli.matching.shift import shift_of


def street(seed: int) -> F64:
    """A street of 80 m: ground, houses with fronts and sides, bushes."""
    random = np.random.default_rng(seed)
    ground = random.uniform(0, 1, (60_000, 3)) * [80, 20, 0.01]
    fronts = random.uniform(0, 1, (30_000, 3)) * [80, 0.01, 6] + np.array([0, 20, 0])
    sides = [random.uniform(0, 1, (3_000, 3)) * [0.01, 6, 5] + np.array([x, 14, 0]) for x in (9, 27, 44, 52, 70)]
    bushes = [random.normal(0, 0.5, (2_000, 3)) + np.array([x, 3, 1]) for x in (12, 33, 61)]
    return np.concatenate([ground, fronts, *sides, *bushes])


def registered(xyz: F64, seed: int) -> F64:
    """The points with the error of a trajectory, 2 cm an axis, another one every 8 m."""
    random = np.random.default_rng(seed)
    error = random.normal(0, 0.02, (11, 3))
    return xyz + np.stack([np.interp(xyz[:, 0], np.arange(11) * 8.0, one) for one in error.T], axis=1)


def cloud(xyz: F64) -> Cloud:
    parts = np.array_split(xyz, 4)
    return Cloud(iter([dict(zip("xyz", part.T.copy(), strict=True)) for part in parts]), io.BytesIO())  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(8))
def test_no_shift_is_named_where_there_is_none(seed: int) -> None:
    assert shift_of(cloud(street(seed)), cloud(registered(street(seed + 100), seed))) is None


@pytest.mark.parametrize(
    "shift", [(0.0, 0.12, 0.0), (0.0, 0.0, -0.1), (0.2, 0.3, 0.1), (1.0, 0.0, 0.0), (3.0, -2.0, 0.5)]
)
def test_a_shift_is_measured(shift: tuple[float, ...]) -> None:
    found = shift_of(cloud(street(1)), cloud(registered(street(2), 5) + shift))
    assert found is not None
    np.testing.assert_allclose(found, shift, atol=0.03)


def test_what_no_plane_faces_is_not_named() -> None:
    one, other = (np.random.default_rng(seed).uniform(0, 1, (40_000, 3)) * [80, 20, 0.01] for seed in (0, 1))
    found = shift_of(cloud(one), cloud(other + np.array([0.3, 0.3, 0.2])))
    assert found is not None
    np.testing.assert_allclose(found, (0, 0, 0.2), atol=0.01)
