from __future__ import annotations

import math

import numpy as np
import pytest

from prc_cli.core.types import F64
from prc_cli.imaging.cloud import NARROWEST, DepthBuffer, FromAbove, Perspective, Sample


def box(n: int = 4000, seed: int = 1) -> F64:
    return np.random.default_rng(seed).uniform((-10, -5, 0), (10, 5, 4), (n, 3))


def test_a_sample_is_bounded_even_and_does_not_depend_on_the_chunks() -> None:
    rows = np.arange(10_000.0)[:, None]
    whole, parts = Sample(1, most=100), Sample(1, most=100)
    whole.add(rows)
    for first in range(0, len(rows), 37):
        parts.add(rows[first : first + 37])
    assert np.array_equal(whole.rows(), parts.rows())
    assert whole.n_seen == parts.n_seen == 10_000
    assert 50 <= len(whole.rows()) <= 100
    assert len(np.unique(np.diff(whole.rows()[:, 0]))) == 1
    assert Sample(3).rows().shape == (0, 3)


@pytest.mark.parametrize("azimuth", [0, 90, 215, -30])
@pytest.mark.parametrize("elevation", [-20, 0, 30, 89, 90])
def test_the_perspective_holds_the_points_upright(azimuth: float, elevation: float) -> None:
    points = box()
    view = Perspective.around(points, azimuth, elevation, 700, 500)
    right, down, depth = view.project(points)
    width, height = view.size
    inside = (right >= 0) & (right < width) & (down >= 0) & (down < height)
    assert inside.mean() > 0.85
    assert (depth > 0).all()
    assert width <= 700
    assert height <= 500
    if abs(elevation) < 80:
        up = view.project(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))[1]
        assert up[1] < up[0]
    # the eye stands where it was told to
    away = view.eye - (points.min(axis=0) + points.max(axis=0)) / 2
    assert math.degrees(math.asin(away[2] / np.linalg.norm(away))) == pytest.approx(elevation, abs=1.0)
    if abs(elevation) < 80:
        bearing = math.degrees(math.atan2(away[0], away[1]))
        assert (bearing - azimuth + 180) % 360 - 180 == pytest.approx(0, abs=1.0)


def test_the_nearest_point_wins_whatever_the_order() -> None:
    view = FromAbove(0.0, 10.0, 20.0, 1.0, (10, 10))
    points = np.array([[4.5, 4.5, z] for z in (1.0, 9.0, 3.0)])
    colours = np.array([[10, 0, 0], [0, 20, 0], [0, 0, 30]], np.uint8)
    pictures = []
    for order in ([0, 1, 2], [2, 1, 0], [1, 0, 2]):
        buffer = DepthBuffer(view)
        for i in order:
            buffer.add(points[i : i + 1], colours[i : i + 1])
        pictures.append(buffer.picture(close=0, shade=False))
    assert pictures[0][5, 4].tolist() == [0, 20, 0]
    assert all(np.array_equal(pictures[0], other) for other in pictures)
    assert (pictures[0] == 255).all(axis=2).sum() == 99


@pytest.mark.parametrize("along", [0, 1])
def test_a_row_of_points_from_above_has_room_beside_it(along: int) -> None:
    """A picture of a straight drive is not one pixel wide."""
    points = np.zeros((100, 3))
    points[:, along] = np.linspace(0, 100, 100)
    width, height = FromAbove.around(points, 400, 400).size
    long, short = (width, height) if along == 0 else (height, width)
    assert long == 400
    assert short == pytest.approx(NARROWEST * 400, rel=0.05)
