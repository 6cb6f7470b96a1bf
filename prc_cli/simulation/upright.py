"""Reference labels of static scans: the classes of Stamos et al. (2012) instead of those of materials.

That classifier does not know buildings. It tells horizontal from vertical surfaces, and its ground is the road alone,
up to the curb. So a tripod's scan is labelled by what was hit and by how it lies: sidewalks and lawns are HORIZONTAL,
and so is what is nearer to level than to upright of houses, fences, posts and signs: roofs of up to 45 degrees, sills,
lintels, floors of balconies. All else of these is VERTICAL, as are trunks. People and wires have no class there and
stay UNCLASSIFIED.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.types import F64, I32, U8, Mask
from prc_cli.simulation.world import PROPERTIES, Bodies, Material, Shape

LEVEL_COSINE = float(np.cos(np.deg2rad(45.0)))
"""A face is level whose normal lies within 45 degrees of the vertical: to that it is nearer than to the horizon."""

_LABELS: dict[Material, Label] = {
    Material.SIDEWALK: Label.HORIZONTAL,
    Material.GRASS: Label.HORIZONTAL,
    Material.SOIL: Label.HORIZONTAL,
    Material.TRUNK: Label.VERTICAL,
}
"""Materials whose label does not ask how they lie and is not the one of :data:`PROPERTIES`."""
_ASKED = (
    Material.WALL, Material.GLASS, Material.DOOR, Material.BALCONY, Material.ROOF, Material.FENCE, Material.POLE,
    Material.SIGN,
)  # fmt: skip
"""Materials that are VERTICAL or HORIZONTAL."""


def static_labels(label: U8, bodies: Bodies, body: I32, place_m: F64) -> U8:
    """Return the labels of a static scan."""
    of_material = np.array([PROPERTIES[material].label for material in Material], np.uint8)
    own = np.array([_LABELS.get(material, PROPERTIES[material].label) for material in Material], np.uint8)
    # a shot split between two surfaces has the label of the one that its range is of, which may be the neighbour's
    found: U8 = np.where(np.isin(label, (Label.BUILDING, Label.POLE)), Label.VERTICAL, label).astype(np.uint8)
    at = np.flatnonzero((body >= 0) & (label != Label.NOISE) & (label != Label.MISSING))
    material = bodies.material[body[at]]
    known = of_material[material] == label[at]
    at, material = at[known], material[known]
    found[at] = own[material]
    at = at[np.isin(material, _ASKED)]
    level = is_level(bodies, body[at], place_m[at])
    found[at] = np.where(level, Label.HORIZONTAL, Label.VERTICAL)
    return found


def is_level(bodies: Bodies, body: I32, place_m: F64) -> Mask:
    """Tell level faces of boxes and triangles; poles, balls and what is filled with bars or leaves have none."""
    shape, numbers = bodies.shape[body], bodies.numbers[body]
    level = np.zeros(len(body), np.bool_)
    flat = np.flatnonzero(shape == Shape.TRIANGLE)
    a, b, c = numbers[flat, 0:3], numbers[flat, 3:6], numbers[flat, 6:9]
    normal = np.cross(b - a, c - a)
    level[flat] = np.abs(normal[:, 2]) > LEVEL_COSINE * np.linalg.norm(normal, axis=1)
    box = np.flatnonzero((shape == Shape.BOX) & (bodies.density[body] == 0.0))
    away, half, yaw = np.abs(place_m[box] - numbers[box, 0:3]), numbers[box, 3:6], numbers[box, 6]
    dx, dy = (place_m[box] - numbers[box, 0:3])[:, :2].T
    away[:, 0] = np.abs(np.cos(yaw) * dx + np.sin(yaw) * dy)
    away[:, 1] = np.abs(np.cos(yaw) * dy - np.sin(yaw) * dx)
    # the face that the place is nearest to
    level[box] = np.argmin(np.abs(away - half), axis=1) == 2
    return level
