"""Bodies of the simulated world: a shape, a material and, for cars and people, a velocity.

A scene gives the bodies around a place (:data:`BodiesNear`). It makes them piece by piece from its
seed, so that the memory of a drive does not grow with its length.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from enum import IntEnum
from typing import TypeAlias

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.types import F64, I64, U8, Mask


class Shape(IntEnum):
    """Shape of a body, with its nine numbers; lengths in metres, angles in radians."""

    TRIANGLE = 0
    """Corners a, b, c, three coordinates each; seen from both sides."""
    CONE = 1
    """Truncated cone without caps: centres of both ends (3, 3), their radii (2), 0."""
    ELLIPSOID = 2
    """Centre (3), half axes (3), yaw, 0, 0; with a density filled with leaves, else a surface."""
    BOX = 3
    """Centre (3), half edges (3), yaw, 0, 0; with a density filled with leaves, else six faces."""


class Material(IntEnum):
    """Material of a body."""

    ASPHALT = 0
    SIDEWALK = 1
    CURB = 2
    GRASS = 3
    SOIL = 4
    WALL = 5
    GLASS = 6
    DOOR = 7
    BALCONY = 8
    ROOF = 9
    FENCE = 10
    CAR_BODY = 11
    CAR_GLASS = 12
    TYRE = 13
    POLE = 14
    SIGN = 15
    PERSON = 16
    TRUNK = 17
    BRANCH = 18
    LEAVES = 19
    HEDGE = 20
    STEM = 21
    UNDERGROWTH = 22
    DEAD_WOOD = 23
    WIRE = 24


@dataclass(frozen=True, slots=True)
class Property:
    """Properties of a material: its reference label, and its answer to a laser."""

    label: Label
    reflectance: float
    """Share of the light that a surface reflects at normal incidence, 0 to 1, at 785 to 1550 nm."""
    is_glass: bool = False
    """Light goes through, or to where the glass mirrors it."""


PROPERTIES: dict[Material, Property] = {
    Material.ASPHALT: Property(Label.GROUND, 0.17),
    Material.SIDEWALK: Property(Label.GROUND, 0.35),
    Material.CURB: Property(Label.CURB, 0.40),
    Material.GRASS: Property(Label.GROUND, 0.45),
    Material.SOIL: Property(Label.GROUND, 0.30),
    Material.WALL: Property(Label.BUILDING, 0.50),
    Material.GLASS: Property(Label.BUILDING, 0.08, is_glass=True),
    Material.DOOR: Property(Label.BUILDING, 0.30),
    Material.BALCONY: Property(Label.BUILDING, 0.45),
    Material.ROOF: Property(Label.BUILDING, 0.20),
    Material.FENCE: Property(Label.BUILDING, 0.40),
    Material.CAR_BODY: Property(Label.CAR, 0.25),
    Material.CAR_GLASS: Property(Label.CAR, 0.06, is_glass=True),
    Material.TYRE: Property(Label.CAR, 0.05),
    Material.POLE: Property(Label.POLE, 0.35),
    Material.SIGN: Property(Label.POLE, 0.80),
    Material.PERSON: Property(Label.UNCLASSIFIED, 0.35),
    Material.TRUNK: Property(Label.VEGETATION, 0.30),
    Material.BRANCH: Property(Label.VEGETATION, 0.30),
    Material.LEAVES: Property(Label.VEGETATION, 0.45),
    Material.HEDGE: Property(Label.VEGETATION, 0.45),
    Material.STEM: Property(Label.STEM, 0.30),
    Material.UNDERGROWTH: Property(Label.VEGETATION, 0.40),
    Material.DEAD_WOOD: Property(Label.VEGETATION, 0.30),
    Material.WIRE: Property(Label.UNCLASSIFIED, 0.25),
}
"""Label and reflectance of every material; a trunk is vegetation in towns, a stem in forest."""


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """Bodies as parallel arrays."""

    shape: U8
    """(n,) uint8, :class:`Shape`."""
    numbers: F64
    """(n, 9) float64, as :class:`Shape` says, in the world at time 0, z up [m, rad]."""
    material: U8
    """(n,) uint8, :class:`Material`."""
    density: F64
    """(n,) float64, leaf area density [m²/m³], 0 = a surface.

    The free path of a beam is exponential with a mean of two over the density: leaves face
    everywhere."""
    velocity: F64
    """(n, 2) float64, along x and y [m/s]."""
    number: F64
    """(n,) float64, identity, 0 to below 2^53, the same whatever is in sight; it seeds the
    leaves."""

    @classmethod
    def join(cls, parts: list[Bodies]) -> Bodies:
        """Return the bodies of several places as one."""
        u8 = np.empty(0, np.uint8)
        none = cls(u8, np.empty((0, 9)), u8, np.empty(0), np.empty((0, 2)), np.empty(0))
        columns = ([getattr(part, field.name) for part in [none, *parts]] for field in fields(cls))
        return cls(*map(np.concatenate, columns))

    def take(self, which: Mask) -> Bodies:
        """Return some of the bodies, in their order; (n,) bool."""
        return Bodies(*(getattr(self, f.name)[which] for f in fields(self)))

    def __len__(self) -> int:
        return len(self.shape)


BodiesNear: TypeAlias = Callable[[float, float, float, float], Bodies]
"""Returns the bodies that have a part within a circle (x, y, radius [m]) at a time [s], and others.

A body has the same numbers whatever the circle, and the order depends only on the seed."""


def hashed(seed: int, purpose: int, number: I64) -> F64:
    """Hash whole numbers to 0..1 (finaliser of SplitMix64, Steele et al. 2014).

    >>> hashed(7, 0, np.array([1, 2, 1])).round(3).tolist()
    [0.772, 0.246, 0.772]
    """
    start = (seed * 0x9E3779B97F4A7C15 + purpose * 0xD1B54A32D192ED03) % 2**64
    with np.errstate(over="ignore"):
        x = number.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + np.uint64(start)
        x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    x = x ^ (x >> np.uint64(31))
    return (x >> np.uint64(11)).astype(np.float64) * 2.0**-53
