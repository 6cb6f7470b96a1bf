"""Labels of static scans, by surface and its slope."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.simulation.drive import is_level, static_labels
from prc_cli.simulation.world import PROPERTIES, Bodies, Material, Shape

TURNED = np.deg2rad(30.0)


def bodies(*rows: tuple[Shape, Material, tuple[float, ...]], density: float = 0.0) -> Bodies:
    numbers = np.zeros((len(rows), 9))
    for i, (_, _, own) in enumerate(rows):
        numbers[i, : len(own)] = own
    return Bodies(
        np.array([shape for shape, _, _ in rows], np.uint8),
        numbers,
        np.array([material for _, material, _ in rows], np.uint8),
        np.full(len(rows), density),
        np.zeros((len(rows), 2)),
        np.arange(len(rows), dtype=np.float64),
    )


def block(density: float = 0.0) -> Bodies:
    """A long low box, turned by 30 degrees."""
    return bodies((Shape.BOX, Material.WALL, (10.0, 20.0, 3.0, 4.0, 1.0, 0.5, TURNED)), density=density)


def on_block(u: float, v: float, w: float) -> np.ndarray:
    """Place in the frame of the box."""
    cosine, sine = np.cos(TURNED), np.sin(TURNED)
    return np.array([10.0 + cosine * u - sine * v, 20.0 + sine * u + cosine * v, 3.0 + w])


def test_top_and_bottom_of_a_turned_box_are_level_and_its_sides_are_not() -> None:
    places = np.array(
        [on_block(*at) for at in ((3.9, 0.0, 0.5), (-3.0, 0.9, -0.5), (4.0, 0.9, 0.4), (0.0, -1.0, 0.3), (2.0, 1.0, 0))]
    )
    body = np.zeros(5, np.int32)
    assert is_level(block(), body, places).tolist() == [True, True, False, False, False]
    # 4 mm of noise change nothing 5 cm from an edge
    places += np.random.default_rng(1).normal(0.0, 0.004, places.shape)
    assert is_level(block(), body, places).tolist() == [True, True, False, False, False]
    assert not is_level(block(density=20.0), body, places).any()


def test_labels_follow_material_and_face() -> None:
    far = (0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0)
    expected = {
        Material.ASPHALT: Label.GROUND,
        Material.SIDEWALK: Label.HORIZONTAL,
        Material.CURB: Label.CURB,
        Material.GRASS: Label.HORIZONTAL,
        Material.WALL: Label.VERTICAL,
        Material.CAR_BODY: Label.CAR,
        Material.POLE: Label.VERTICAL,
        Material.PERSON: Label.UNCLASSIFIED,
        Material.TRUNK: Label.VERTICAL,
        Material.LEAVES: Label.VEGETATION,
    }
    world = bodies(*((Shape.BOX, material, far) for material in expected))
    label = np.array([PROPERTIES[material].label for material in expected], np.uint8)
    body = np.arange(len(expected), dtype=np.int32)
    side = np.tile([1.0, 0.2, 0.1], (len(expected), 1))
    assert static_labels(label, world, body, side).tolist() == list(expected.values())
    top = np.tile([0.1, 0.2, 1.0], (len(expected), 1))
    turned = {Material.WALL: Label.HORIZONTAL, Material.POLE: Label.HORIZONTAL}
    assert static_labels(label, world, body, top).tolist() == list((expected | turned).values())


def test_noise_missing_and_what_is_the_neighbours_stay() -> None:
    label = np.array([Label.NOISE, Label.MISSING, Label.CAR, Label.BUILDING, Label.GROUND], np.uint8)
    body = np.array([0, -1, 0, -1, -1], np.int32)
    found = static_labels(label, block(), body, np.full((5, 3), np.nan))
    assert found.tolist() == [Label.NOISE, Label.MISSING, Label.CAR, Label.VERTICAL, Label.GROUND]
