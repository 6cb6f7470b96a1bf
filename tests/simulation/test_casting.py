""""""

from typing import Any

import numpy as np
import pytest

from prc_cli.core.classes import Label
from prc_cli.core.types import F64
from prc_cli.simulation.casting_loops import _sort
from prc_cli.simulation.sensor import cast
from prc_cli.simulation.thresholds import Hits
from prc_cli.simulation.world import Bodies, Shape

FLOOR = (Shape.TRIANGLE, [-50, -50, -2, 50, -50, -2, 0, 90, -2])


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


def profile(
    n_lines: int = 1,
    m: int = 720,
    roll_rad: float = 0.0,
    slant_rad: float = 0.0,
) -> tuple[F64, F64, F64]:
    """Lines all around, from below over the left.

    The platform drives at 10 m/s and rolls within each line.
    """
    time = (np.arange(n_lines)[:, None] + np.arange(m) / m) / 50.0
    angle = 2 * np.pi * np.arange(m) / m + np.linspace(0, roll_rad, m) + 0 * time
    direction = np.stack(
        [np.cos(angle) * -np.sin(slant_rad), np.sin(angle), np.cos(angle) * -np.cos(slant_rad)],
        axis=2,
    )
    origin = np.stack([10.0 * time, 0 * time, 0 * time], axis=2)
    return origin, direction, time


@pytest.mark.parametrize(
    "body, origin, towards, t, facing",
    [
        (FLOOR, (0, 0, 0), (0, 0, -1), 2.0, 1.0),
        (FLOOR, (0, 0, -5), (0, 0, 1), 3.0, 1.0),  # from below
        (FLOOR, (0, 0, 0), (0, 1, -1), 2.0 * np.sqrt(2), np.sqrt(0.5)),
        (FLOOR, (0, 0, 0), (0, 0, 1), np.inf, 0.0),
        (FLOOR, (0, 0, -2), (0, 1, 0), np.inf, 0.0),  # along it
        ((Shape.CONE, [10, 0, -3, 10, 0, 3, 0.5, 0.5]), (0, 0, 0), (1, 0, 0), 9.5, 1.0),
        (
            (Shape.CONE, [10, 0, -3, 10, 0, 3, 0.5, 0.5]),
            (10, 0, 0),
            (1, 0, 0),
            0.5,
            1.0,
        ),  # from inside
        (
            (Shape.CONE, [10, 0, -3, 10, 0, 3, 0.5, 0.5]),
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
    body,
    origin,
    towards,
    t,
    facing,
):
    hits = one_shot(world(body), origin, towards)
    assert hits.t.item() == pytest.approx(t)
    assert hits.facing.item() == pytest.approx(facing)
    assert hits.body.item() == (-1 if np.isinf(t) else 0)


@pytest.mark.parametrize("slant_rad", [0.0, 0.6])
@pytest.mark.parametrize("roll_rad", [0.0, 0.03, -0.03])
def test_no_shot_leaves_a_closed_room(slant_rad, roll_rad):
    corners = np.array([[x, y, z] for x in (-9.0, 11.0) for y in (-3.0, 4.0) for z in (-2.0, 3.0)])
    faces = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    triangles = [
        (Shape.TRIANGLE, corners[[face[0], face[k], face[k + 1]]].ravel().tolist())
        for face in faces
        for k in (1, 2)
    ]
    origin, direction, time = profile(8, roll_rad=roll_rad, slant_rad=slant_rad)
    hits = cast(world(*triangles), origin, direction, time)
    as_box = cast(world((Shape.BOX, [1.0, 0.5, 0.5, 10.0, 3.5, 2.5, 0])), origin, direction, time)
    np.testing.assert_allclose(hits.t, as_box.t)
    np.testing.assert_allclose(hits.facing, as_box.facing, atol=1e-12)
    assert np.isfinite(hits.t).all()


def leafy() -> Bodies:
    crowns = [(Shape.ELLIPSOID, [0, y, z, 3, 2, 2, 0.3]) for y in (-9, -5, 5, 9) for z in (0, 3)]
    return world(*crowns, (Shape.BOX, [0, 3, -1, 40, 0.5, 1, 0]), density=1.0)


def test_hits_do_not_depend_on_how_lines_are_cut_into_blocks():
    origin, direction, time = profile(6)
    whole = cast(leafy(), origin, direction, time, first_shot=10**12)
    for i in range(6):
        part = slice(i, i + 1)
        line = cast(leafy(), origin[part], direction[part], time[part], first_shot=10**12 + i * 720)
        for name in ("t", "body", "facing"):
            np.testing.assert_array_equal(getattr(line, name), getattr(whole, name)[part])
    assert 0.2 < np.isfinite(whole.t).mean() < 0.9


LINES = 400


def hits(
    t: Any,
    body: Any = 0,
    facing: Any = 1.0,
    lines: int = LINES,
    columns: int = 100,
) -> Hits:
    """Hits of which each number may be given for all, or by column."""
    shape = (lines, columns)
    number = np.broadcast_to(np.asarray(body, dtype=np.int32), shape).copy()
    t = np.where(number < 0, np.inf, np.broadcast_to(np.asarray(t, dtype=np.float64), shape))
    return Hits(t, number, np.broadcast_to(np.asarray(facing, dtype=np.float64), shape).copy())


def test_the_loop_reads_the_labels_that_are_meant():
    from prc_cli.simulation import sensor_loops as loops

    assert (loops.LABEL_MISSING, loops.LABEL_NOISE) == (Label.MISSING, Label.NOISE)


@pytest.mark.parametrize("n", [0, 1, 2, 3, 8, 40])
def test_rows_are_sorted_by_their_keys(n):
    rng = np.random.default_rng(n)
    for _ in range(9):
        keys = rng.integers(0, 20, (40, 3)).astype(np.float64)
        before = rng.permutation(40)
        rows = before.copy()
        _sort(keys, rows, n)
        assert (np.diff(keys[rows[:n], 2]) >= 0).all()
        assert sorted(rows[:n]) == sorted(before[:n])
        assert rows[n:].tolist() == before[n:].tolist()
