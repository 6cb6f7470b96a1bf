"""Parked and passing cars of the static street scan: rounded bodies on wheels, with a gap below and glass above.

Measures are those of the common size classes: 3.8 to 4.8 m long, 1.75 m wide, 1.45 to 1.6 m high, 16 to 20 cm of
ground clearance, tyres of 62 cm on 20 cm, 2 cm within the body (a Volkswagen Golf is 1.79 m wide, its tyres reach to
1.75 m); vans 5 m long and up to 2.3 m high. The roundness of tyres is not decoration: the classifier knows cars by it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.types import F64
from prc_cli.simulation.furniture import Body, Solid
from prc_cli.simulation.rays import Bounds
from prc_cli.simulation.static_bodies import Painted

_TYRE_M = 0.31
"""Radius of a tyre [m]."""
_FLAT_M = _TYRE_M * float(np.cos(np.pi / 14))
"""The same to the middle of a facet of its outline [m]."""

Outline = Sequence[tuple[float, float]]
"""Corners of a convex outline seen from the side, (forward, up), counter-clockwise [m]."""


def car(rng: np.random.Generator, place: tuple[float, float, float], heading: int, half: float) -> Iterator[Body]:
    """Build a car.

    Parameters
    ----------
    rng : Generator
        Decides on shape and paint.
    place : three numbers [m]
        Where its middle is, z where the tyres stand.
    heading : int
        1 = along the street, -1 = against it.
    half : float
        Half of its length [m]; from 2.45 m on it is a van.
    """
    van = half >= 2.45
    width = 0.97 if van else 0.86 + 0.04 * rng.random()
    roof = 1.95 + 0.35 * rng.random() if van else 1.44 + 0.16 * rng.random()
    clearance = 0.16 + 0.05 * rng.random()
    # one car in four is dark or freshly waxed: a third of the shots at it never come back
    lost = 0.33 if rng.random() < 0.25 else 0.06
    outlines = _van(half, clearance, roof) if van else _saloon(half, clearance, roof, hatch=rng.random() < 0.5)
    lower, cabin, panes = outlines
    glass = None if van and rng.random() < 0.6 else panes
    x, y, z = place
    placed = (x, y, z, heading)
    yield Painted(_prism(lower, placed, _bulge(width), None), lost)
    yield Painted(_prism(cabin, placed, _tumblehome(width, cabin[0][1], steep=van), glass), lost)
    for axle in (-0.58 * half, 0.62 * half):
        for outer in (1, -1):
            yield Painted(_wheel(axle, outer * (width - 0.02), outer, placed), 0.1)


def _wheel(axle: float, face: float, outer: int, placed: tuple[float, float, float, int]) -> Solid:
    """Wheel of 62 cm: its sidewall bulges 2 cm over the tread, as seen from above it leans towards the scanner.

    Parameters
    ----------
    axle, face : float
        Middle of the wheel and its outer side, forward and left of the car's middle [m].
    outer : int
        1 = on the left, -1 = on the right.
    placed : four numbers
        Place and heading of the car.
    """
    around = np.arange(14) * (2 * np.pi / 14)
    outline = [(axle + _TYRE_M * np.cos(a), _TYRE_M + _TYRE_M * np.sin(a)) for a in around]
    low, high = sorted((face, face - outer * 0.2))
    sides = [(0.0, 1.0, 0.0, high), (0.0, -1.0, 0.0, -low)]
    # from the edge of the tread to the widest place, where the sidewall faces down: the rest is inside the car
    rise, bulge = 0.05, 0.02
    length = np.hypot(rise, bulge)
    for a in around[7:] + np.pi / 14:
        forward, up = np.cos(a) * bulge / length, np.sin(a) * bulge / length
        tread = forward * (axle + _FLAT_M * np.cos(a)) + up * (_TYRE_M + _FLAT_M * np.sin(a))
        for sign, edge in ((1.0, high), (-1.0, -low)):
            sides.append((forward, sign * rise / length, up, tread + (edge - bulge) * rise / length))
    return _prism(outline, placed, sides, None)


def _saloon(
    half: float, clearance: float, roof: float, *, hatch: bool
) -> tuple[Outline, Outline, tuple[float, float]]:  # fmt: skip
    """Outlines of body and cabin, and the heights between which there is glass."""
    lower = [
        (-half + 0.12, clearance),
        (half - 0.15, clearance),
        (half, 0.40),
        (half - 0.02, 0.58),
        (half - 0.10, 0.69),
        (half - 0.28, 0.77),
        (half - 1.15, 0.90),
        (-half + 0.30, 0.93),
        (-half + 0.06, 0.86),
        (-half, 0.60),
        (-half, 0.36),
    ]
    front, back = half - 1.05, -half + (0.12 if hatch else 0.55)
    cabin = [
        (front, 0.88),
        (front - 0.72, roof - 0.12),
        (front - 0.95, roof - 0.045),
        (front - 1.45, roof),
        (back + 1.15, roof - 0.02),
        (back + (0.35 if hatch else 0.75), roof - 0.13),
        (back, 0.90),
    ]
    return lower, cabin, (0.99, roof - 0.11)


def _van(half: float, clearance: float, roof: float) -> tuple[Outline, Outline, tuple[float, float]]:
    """Outlines of a van, as for :func:`_saloon`."""
    lower = [
        (-half + 0.05, clearance + 0.04),
        (half - 0.15, clearance + 0.04),
        (half, 0.45),
        (half - 0.04, 0.80),
        (half - 0.22, 0.98),
        (half - 0.62, 1.10),
        (-half, 1.12),
        (-half, 0.45),
    ]
    cabin = [
        (half - 0.55, 1.05),
        (half - 1.10, roof - 0.14),
        (half - 1.30, roof - 0.04),
        (half - 1.80, roof),
        (-half + 0.4, roof),
        (-half + 0.08, roof - 0.12),
        (-half + 0.02, 1.05),
    ]
    return lower, cabin, (1.18, min(roof - 0.2, 1.75))


def _bulge(width: float) -> list[tuple[float, float, float, float]]:
    """Doors: widest at 0.55 m, drawn in above and below; planes (forward, left, up, offset)."""
    planes = []
    for sign in (1.0, -1.0):
        for tilt, z in ((0.0, 0.5), (0.14, 0.62), (0.35, 0.86), (-0.16, 0.42)):
            planes.append((0.0, sign * np.cos(tilt), np.sin(tilt), width * np.cos(tilt) + z * np.sin(tilt)))
    return planes


def _tumblehome(width: float, waist: float, *, steep: bool) -> list[tuple[float, float, float, float]]:
    """Side windows lean in towards the roof."""
    tilt = np.deg2rad(6.0 if steep else 22.0)
    reach = (width - (0.0 if steep else 0.03)) * np.cos(tilt) + waist * np.sin(tilt)
    return [(0.0, sign * np.cos(tilt), np.sin(tilt), reach) for sign in (1.0, -1.0)]


def _prism(
    outline: Outline,
    placed: tuple[float, float, float, int],
    sides: list[tuple[float, float, float, float]],
    glass: tuple[float, float] | None,
) -> Solid:  # fmt: skip
    """Body between side planes with an outline; all in coordinates of the car, which is then put in its place."""
    corners: F64 = np.array(outline)
    along = np.roll(corners, -1, axis=0) - corners
    length = np.hypot(along[:, 0], along[:, 1])
    forward, up = along[:, 1] / length, -along[:, 0] / length
    rim = np.stack([forward, np.zeros_like(up), up, forward * corners[:, 0] + up * corners[:, 1]], axis=1)
    planes: F64 = np.vstack([rim, np.array(sides)])
    x, y, z, heading = placed
    normals = planes[:, :3] * (heading, 1.0, 1.0)
    low, high = float(corners[:, 1].min()), float(corners[:, 1].max())
    # every side plane bounds the body at the height where it reaches farthest out
    level = [(left, lift, offset) for forward, left, lift, offset in sides if forward == 0]
    reach = [(left, (offset - (low if lift > 0 else high) * lift) / abs(left)) for left, lift, offset in level]
    wide = min(far for left, far in reach if left > 0)
    narrow = -min(far for left, far in reach if left < 0)
    ends = sorted(x + heading * end for end in (corners[:, 0].min(), corners[:, 0].max()))
    bounds = Bounds((ends[0], ends[1]), (y + narrow, y + wide), (z + low, z + high))
    return Solid(
        bounds,
        normals,
        planes[:, 3] + normals @ np.array([x, y, z]),
        Label.CAR,
        glass_z=None if glass is None else (z + glass[0], z + glass[1]),
    )
