""""""

from __future__ import annotations

import numpy as np
import pytest

from prc_cli.simulation.sensor import cast
from prc_cli.simulation.thresholds import Hits
from prc_cli.simulation.world import Bodies, Shape

FLOOR = (Shape.TRIANGLE, [-50, -50, -2, 50, -50, -2, 0, 90, -2])
POST = (Shape.CONE, [10, 0, -3, 10, 0, 3, 0.5, 0.5])


def world(
    *bodies: tuple[Shape, list[float]], density: float = 0.0, velocity: tuple[float, float] = (0, 0)
) -> Bodies:
    n = len(bodies)
    return Bodies(
        np.array([shape for shape, _ in bodies], np.uint8),
        np.array(
            [numbers + [0.0] * (9 - len(numbers)) for _, numbers in bodies], dtype=np.float64
        ).reshape(n, 9),
        np.zeros(n, np.uint8),
        np.full(n, density),
        np.full((n, 2), velocity, dtype=np.float64),
        np.arange(n) + 12345.0,
    )


def one_shot(
    bodies: Bodies,
    origin: tuple[float, ...],
    towards: tuple[float, ...],
    time_s: float = 0.0,
) -> Hits:
    direction = np.array(towards, dtype=np.float64)
    direction /= np.linalg.norm(direction)
    return cast(
        bodies,
        np.array(origin, dtype=np.float64)[None, None],
        direction[None, None],
        np.array([time_s]),
    )


@pytest.mark.parametrize(
    ("body", "origin", "towards", "t", "facing"),
    [
        (FLOOR, (0, 0, 0), (0, 0, -1), 2.0, 1.0),
        (FLOOR, (0, 0, -5), (0, 0, 1), 3.0, 1.0),  # from below
        (FLOOR, (0, 0, 0), (0, 1, -1), 2.0 * np.sqrt(2), np.sqrt(0.5)),
        (FLOOR, (0, 0, 0), (0, 0, 1), np.inf, 0.0),
        (FLOOR, (0, 0, -2), (0, 1, 0), np.inf, 0.0),  # along it
        (POST, (0, 0, 0), (1, 0, 0), 9.5, 1.0),
        (
            POST,
            (10, 0, 0),
            (1, 0, 0),
            0.5,
            1.0,
        ),  # from inside
        (
            POST,
            (10, 0, 9),
            (0, 0, -1),
            np.inf,
            0.0,
        ),  # open at both ends
        (
            (Shape.CONE, [10, 0, -3, 10, 0, 3, 1.0, 1.0]),
            (8, 0, 5),
            (1, 0, -1),
            3 * np.sqrt(2),
            np.sqrt(0.5),
        ),
        ((Shape.CONE, [10, 0, -1, 10, 0, 1, 2.0, 0.0]), (0, 0, 0), (1, 0, 0), 9.0, np.sqrt(0.5)),
        (
            (Shape.CONE, [10, 0, 0, 10, 0, 0, 2.0, 2.0]),
            (0, 0, 0),
            (1, 0, 0),
            np.inf,
            0.0,
        ),  # no length
        ((Shape.ELLIPSOID, [10, 0, 0, 3, 1, 1, 0]), (0, 0, 0), (1, 0, 0), 7.0, 1.0),
        ((Shape.ELLIPSOID, [10, 0, 0, 3, 1, 1, np.pi / 2]), (0, 0, 0), (1, 0, 0), 9.0, 1.0),
        ((Shape.ELLIPSOID, [0, 0, 0, 3, 1, 1, 0]), (0, 0, 0), (-1, 0, 0), 3.0, 1.0),
        ((Shape.BOX, [10, 0, 0, 2, 1, 1, 0]), (0, 0, 0), (1, 0, 0), 8.0, 1.0),
        (
            (Shape.BOX, [10, 0.1, 0, 1, 1, 1, np.pi / 4]),
            (0, 0, 0),
            (1, 0, 0),
            10.1 - np.sqrt(2),
            np.sqrt(0.5),
        ),
        ((Shape.BOX, [0, 0, 0, 2, 1, 1, 0]), (0, 0, 0), (0, 0, 1), 1.0, 1.0),
        ((Shape.BOX, [-10, 0, 0, 2, 1, 1, 0]), (0, 0, 0), (1, 0, 0), np.inf, 0.0),  # behind
    ],
)
def test_shots_meet_simple_bodies_where_geometry_says(
    body: tuple[Shape, list[float]],
    origin: tuple[float, ...],
    towards: tuple[float, ...],
    t: float,
    facing: float,
) -> None:
    hits = one_shot(world(body), origin, towards)
    assert hits.t.item() == pytest.approx(t)
    assert hits.facing.item() == pytest.approx(facing)
    assert hits.body.item() == (-1 if np.isinf(t) else 0)
