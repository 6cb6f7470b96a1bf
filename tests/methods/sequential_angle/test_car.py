"""The whole of sec. 7 on lines with known cars."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import Mask
from prc_cli.methods.sequential_angle.car import cars
from prc_cli.methods.sequential_angle.thresholds import CarThresholds
from tests.methods.sequential_angle.car_lines import (
    DENSE,
    NOISE_M,
    Piece,
    Seen,
    bush,
    car,
    curb,
    road,
    see,
    signed_angles,
    wall,
)
from tests.methods.sequential_angle.made import made


def find(found: Seen, params: CarThresholds | None = None) -> Mask:
    signed = signed_angles(found.lines)
    return cars(
        found.lines, found.surface, found.surface, signed, found.z_g, (params or CarThresholds()).at_noise(NOISE_M)
    ).car


def test_recall_and_precision_on_lines_of_a_street() -> None:
    rng = np.random.default_rng(6)
    scenes: list[list[Piece]] = []
    for _ in range(60):
        at = float(rng.uniform(4, 12))
        kerb = at + float(rng.uniform(2.2, 3.5))
        house = kerb + float(rng.uniform(1, 6))
        vehicle = car(at, glass=bool(rng.random() < 0.7), tyre=bool(rng.random() < 0.3))
        parked = vehicle if rng.random() < 0.6 else []
        tree = bush(kerb + 0.4) if rng.random() < 0.3 else []
        scenes.append([*road(), *parked, *curb(kerb), *tree, *wall(house, 0.15, windows=bool(rng.random() < 0.5))])
    found = see(scenes, rng, scanner_m=2.2)
    marked = find(found)
    truth = np.array([[name == "car" for name in names] for names in found.names]) & (found.surface > 0)
    both = (marked & truth).sum()
    assert both / truth.sum() > 0.9
    assert both / marked.sum() > 0.9


def test_only_returns_are_marked_and_none_of_dense_vegetation() -> None:
    found = see([[*road(), *car(6), *bush(9)], [*road(), *bush(5)]], np.random.default_rng(1))
    marked = find(found)
    assert marked[0].any()
    assert not marked[np.isnan(found.lines.range_m)].any()
    assert not marked[found.surface == DENSE].any()
    assert marked.dtype == np.bool_


def test_nothing_is_marked_behind_a_high_vertical() -> None:
    """What shows through the ground floor of a wall, between its foot and a window, stands behind it."""
    open_wall = [Piece("wall", (9.0, 0.0), (9.0, 0.3)), Piece("wall", (9.0, 1.1), (9.0, 8.0))]
    inside = [*road(), *open_wall, *car(13.5)]
    found = see([inside], np.random.default_rng(3), scanner_m=2.5)
    assert len(found.where("car")) > 5
    marked = find(found)
    assert not marked[0, found.where("car")].any()


def test_high_verticals_are_sought_in_the_layer_of_vegetation_and_surfaces() -> None:
    """A sign over the road that the car layer takes for dense vegetation hides what stands behind it all the same."""
    found = see([[*road(), *car(8), Piece("sign", (5.0, 2.0), (5.0, 8.0))]], np.random.default_rng(3), scanner_m=2.5)
    layer = found.surface.copy()
    layer[0, found.where("sign")] = DENSE
    signed, behind = signed_angles(found.lines), found.where("car")
    for surface, hidden in ((found.surface, True), (layer, False)):
        marked = cars(found.lines, surface, layer, signed, found.z_g, CarThresholds().at_noise(NOISE_M)).car
        assert marked[0, behind].any() != hidden


def test_sidewalk_behind_a_car_is_no_car() -> None:
    found = see([[*road(), *car(6), *curb(8.0), *wall(12.0, 0.15)]], np.random.default_rng(3), scanner_m=5.0)
    sidewalk = found.where("pavement")
    assert len(sidewalk) > 5
    assert find(found, made(CarThresholds, ground_layer_m=0))[0, sidewalk].any()
    assert not find(found)[0, sidewalk].any()
    assert find(found)[0, found.where("car")].mean() > 0.9


def test_without_ground_there_are_no_cars() -> None:
    found = see([[*road(), *car(6)]], np.random.default_rng(1))
    unknown = Seen(found.lines, found.surface, found.names, np.array([np.nan], np.float32))
    assert find(found).any()
    assert not find(unknown).any()


def test_lines_that_hold_nothing() -> None:
    found = see([[*road(), *car(6)]], np.random.default_rng(1))
    found.lines.range_m[:] = np.nan
    found.lines.xyz_m[:] = np.nan
    found.lines.horizontal_m[:] = np.nan
    found.surface[:] = 0
    assert not find(found).any()


def test_rows_do_not_know_each_other() -> None:
    rng = np.random.default_rng(11)
    scenes = [[*road(), *car(float(at)), *wall(20)] for at in rng.uniform(4, 12, 6)]
    found = see(scenes, rng)
    whole = find(found)
    for row in range(len(scenes)):
        lines = found.lines
        one = type(lines)(
            lines.range_m[row : row + 1],
            lines.xyz_m[row : row + 1],
            lines.horizontal_m[row : row + 1],
            lines.n_beams[row : row + 1],
            lines.beam_rad,
        )
        alone = find(Seen(one, found.surface[row : row + 1], found.names[row : row + 1], found.z_g[row : row + 1]))
        np.testing.assert_array_equal(alone[0], whole[row])
