"""Spectra of cars and of foliage."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.random import Generator

from prc_cli.core.types import F32, I32
from prc_cli.methods.sequential_angle.car import fourier
from prc_cli.methods.sequential_angle.thresholds import FourierThresholds
from tests.methods.sequential_angle.made import made


def plain(**values: int) -> FourierThresholds:
    """Without the readings that are ours, so that every rule is tested by itself."""
    return made(FourierThresholds, **{"longest": 0, **values}).at_noise()


PARAMS = plain()
WHOLE = plain(window=0)


def foliage(rng: Generator, rows: int, n: int) -> F32:
    """Independent ranges, neighbouring beams much closer than leaves are deep: nearly along the beam, either way."""
    signs = np.where(rng.random((rows, n)) < 2 / 3, -1, 1)
    return (signs * np.abs(90 + rng.normal(0, 20, (rows, n)))).astype(np.float32)


def sides_and_roofs(rng: Generator, rows: int, n: int) -> F32:
    """A side, a sloping part and a roof, of changing shares, with the noise of angles."""
    angles = np.zeros((rows, n))
    for row in range(rows):
        edges = np.sort(rng.uniform(0.2, 0.9, 2)) * n
        k = np.arange(n)
        angles[row] = np.where(k < edges[0], 5.0, np.where(k < edges[1], 35.0, 88.0))
    return (angles + rng.normal(0, 15, (rows, n))).astype(np.float32)


def whole(rows: F32) -> I32:
    return np.array([(row, 0, rows.shape[1] - 1) for row in range(len(rows))], np.int32)


@pytest.mark.parametrize(("n", "share"), [(32, 0.92), (64, 0.85), (128, 0.65), (256, 0.20), (512, 0.0)])
def test_share_of_foliage_that_is_told(n: int, share: float) -> None:
    rows = foliage(np.random.default_rng(n), 600, n)
    told = 1 - fourier(rows, whole(rows), WHOLE).mean()
    assert abs(told - share) < 0.08


@pytest.mark.parametrize(("n", "most"), [(32, 0.08), (128, 0.0), (256, 0.0), (512, 0.0)])
def test_cars_are_kept(n: int, most: float) -> None:
    rows = sides_and_roofs(np.random.default_rng(n), 400, n)
    assert 1 - fourier(rows, whole(rows), WHOLE).mean() <= most


def test_windows_tell_long_foliage_too() -> None:
    rng = np.random.default_rng(5)
    leaves, bodies = foliage(rng, 200, 512), sides_and_roofs(rng, 200, 512)
    assert fourier(leaves, whole(leaves), WHOLE).mean() > 0.95
    assert fourier(leaves, whole(leaves), PARAMS).mean() < 0.1
    # a window on the side alone has a small mean: half of the windows may fail
    assert 0.85 < fourier(bodies, whole(bodies), PARAMS).mean() < 1


def test_cost_of_a_long_interval_is_bounded() -> None:
    rows = foliage(np.random.default_rng(1), 1, 40_000)
    assert not fourier(rows, whole(rows), plain(window=64))[0]
    assert fourier(rows, whole(rows), WHOLE)[0]
