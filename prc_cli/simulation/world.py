"""What the world is made of: bodies with a shape, a material and, for cars and people, a velocity.

A scene is anything that knows the bodies around a place (:data:`BodiesNear`). It makes them piece
by piece from its seed, so that a drive of any length needs the memory of what is in sight.
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
    """What the nine numbers of a body mean; lengths in metres, angles in radians."""

    TRIANGLE = 0
    """Corners a, b, c, three coordinates each; seen from both sides."""
    CONE = 1
    """Truncated cone without caps.

    Centre of one end (3), of the other end (3), radius there and there, 0.
    """
    ELLIPSOID = 2
    """Centre (3), half axes (3), yaw, 0, 0.

    Filled with leaves where it has a density, a surface elsewhere.
    """
    BOX = 3
    """Centre (3), half edges (3), yaw, 0, 0.

    Filled with leaves where it has a density, six faces elsewhere.
    """


class Material(IntEnum):
    """What a body is made of."""

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
    """What a material is to a laser and to the reference."""

    label: Label
    reflectance: float
    """Share of the light that comes back from a surface that is met squarely, 0 to 1, at about 785 to 1550 nm."""
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
"""Label and reflectance of every material.

In towns a trunk is vegetation; in forest it is a stem.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """Bodies as parallel arrays."""

    shape: U8
    """(n,) uint8, :class:`Shape`."""
    numbers: F64
    """(n, 9) float64, what they mean is said by the shape [m, rad].

    World coordinates, z up, at time 0.
    """
    material: U8
    """(n,) uint8, :class:`Material`."""
    density: F64
    """(n,) float64, 0 = a surface.

    Else leaf area density [m²/m³]: the free path of a beam is exponential, its mean
    two over the density (leaves that face everywhere)."""
    velocity: F64
    """(n, 2) float64, along x and y [m/s]."""
    number: F64
    """(n,) float64, an identity from 0 to below 2^53 that does not depend on what else is in sight.

    It seeds what is
    random about the body (its leaves)."""

    @classmethod
    def join(cls, parts: list[Bodies]) -> Bodies:
        """Return the bodies of several places as one."""
        u8 = np.empty(0, np.uint8)
        none = cls(u8, np.empty((0, 9)), u8, np.empty(0), np.empty((0, 2)), np.empty(0))
        return cls(
            *(
                np.concatenate([getattr(part, f.name) for part in [none, *parts]])
                for f in fields(cls)
            )
        )

    def take(self, which: Mask) -> Bodies:
        """Return some of the bodies, in their order; (n,) bool."""
        return Bodies(*(getattr(self, f.name)[which] for f in fields(self)))

    def __len__(self) -> int:
        return len(self.shape)


BodiesNear: TypeAlias = Callable[[float, float, float, float], Bodies]
"""Returns the bodies that have a part within a circle (x, y, radius [m]) at a time [s], and maybe a few more.

The same body has the same numbers whatever the circle, and bodies come in an order that depends on
nothing but the seed."""


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
