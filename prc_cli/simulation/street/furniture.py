"""Furniture of a street: lamps, signs, bins, shelters, wires, walls, fences and hedges."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Literal

import numpy as np

from prc_cli.simulation.street.pile import Frame, Pile, Span
from prc_cli.simulation.world import Material

_FOOT_M = -0.2
"""Posts begin this far below the ground [m]."""


def lamp(pile: Pile, frame: Frame, height: float) -> None:
    """Add a lamp whose arm reaches over the road; v of the frame points away from it."""
    top = frame.point(0.0, 0.0, height)
    pile.cone((frame.point(0.0, 0.0, _FOOT_M), top), (0.09, 0.05), Material.POLE)
    pile.cone((top, frame.point(0.0, -1.5, height + 0.25)), (0.04, 0.03), Material.POLE)
    pile.box(frame, ((-0.12, 0.12), (-2.0, -1.4), (height + 0.18, height + 0.30)), Material.POLE)


def traffic_light(pile: Pile, frame: Frame, *, arm: bool) -> None:
    """Add a traffic light, perhaps with a second one on an arm over the road."""
    high = 5.8 if arm else 3.4
    pile.cone(
        (frame.point(0.0, 0.0, _FOOT_M), frame.point(0.0, 0.0, high)), (0.08, 0.06), Material.POLE
    )
    pile.box(frame, ((-0.32, -0.1), (-0.15, 0.15), (2.3, 3.2)), Material.SIGN)
    if arm:
        pile.cone(
            (frame.point(0.0, 0.0, 5.7), frame.point(0.0, -3.6, 5.9)), (0.06, 0.04), Material.POLE
        )
        pile.box(frame, ((-0.2, 0.0), (-3.6, -3.3), (5.1, 6.0)), Material.SIGN)


def sign(pile: Pile, frame: Frame, rng: np.random.Generator) -> None:
    """Add a post with one or two plates, a triangle now and then."""
    top = rng.uniform(2.4, 2.9)
    pile.cone(
        (frame.point(0.0, 0.0, _FOOT_M), frame.point(0.0, 0.0, top)), (0.035, 0.035), Material.POLE
    )
    if rng.random() < 0.3:
        corners = ((0.05, -0.4, top), (0.05, 0.4, top), (0.05, 0.0, top - 0.7))
        a, b, c = (frame.point(*corner) for corner in corners)
        pile.triangle(a, b, c, Material.SIGN)
    else:
        half = rng.uniform(0.2, 0.35)
        pile.box(frame, ((0.04, 0.06), (-half, half), (top - 2 * half, top)), Material.SIGN)
    if rng.random() < 0.4:
        pile.box(frame, ((0.04, 0.06), (-0.25, 0.25), (top - 1.05, top - 0.75)), Material.SIGN)


def bin_or_box(pile: Pile, frame: Frame, rng: np.random.Generator) -> None:
    """Add a bin or a cabinet of the grid."""
    if rng.random() < 0.5:
        pile.box(
            frame, ((-0.3, 0.3), (-0.28, 0.28), (_FOOT_M, rng.uniform(0.9, 1.1))), Material.POLE
        )
        return
    half = rng.uniform(0.3, 0.6)
    pile.box(frame, ((-half, half), (-0.17, 0.17), (_FOOT_M, rng.uniform(1.0, 1.4))), Material.POLE)


def bollard(pile: Pile, frame: Frame) -> None:
    """Add a bollard."""
    pile.cone(
        (frame.point(0.0, 0.0, _FOOT_M), frame.point(0.0, 0.0, 0.9)), (0.06, 0.05), Material.POLE
    )
    pile.ellipsoid(frame.point(0.0, 0.0, 0.9), (0.06, 0.06, 0.05), 0.0, Material.POLE)


def shelter(pile: Pile, frame: Frame) -> None:
    """Add a bus shelter of glass that is open towards the road, with a bench.

    v points away from the road.
    """
    pile.box(frame, ((-2.0, 2.0), (-0.2, 1.3), (2.35, 2.45)), Material.POLE)
    pile.box(frame, ((-1.95, 1.95), (1.15, 1.17), (0.15, 2.25)), Material.GLASS)
    pile.box(frame, ((-1.2, 1.2), (0.75, 1.1), (0.42, 0.48)), Material.POLE)
    for u in (-1.95, 1.95):
        pile.box(frame, ((u - 0.01, u + 0.01), (0.2, 1.15), (0.15, 2.25)), Material.GLASS)
        for v in (-0.1, 1.16):
            pile.box(
                frame, ((u - 0.04, u + 0.04), (v - 0.04, v + 0.04), (_FOOT_M, 2.4)), Material.POLE
            )


def pole(pile: Pile, frame: Frame) -> None:
    """Add a pole for overhead wires, with its cross-arm."""
    pile.cone(
        (frame.point(0.0, 0.0, _FOOT_M), frame.point(0.0, 0.0, 8.0)), (0.14, 0.09), Material.POLE
    )
    pile.box(frame, ((-0.05, 0.05), (-0.8, 0.8), (7.4, 7.52)), Material.POLE)


def wires(pile: Pile, start: Frame, end: Frame) -> None:
    """Hang wires from pole to pole, each in four straight parts."""
    for v in (-0.7, 0.0, 0.7):
        a = start.point(0.0, v, 7.55)
        b = end.point(0.0, v, 7.55)
        knots = []
        for i in range(5):
            f = i / 4
            x, y, z = (left + f * (right - left) for left, right in zip(a, b, strict=True))
            knots.append((x, y, z - 2.0 * f * (1.0 - f)))
        for left, right in itertools.pairwise(knots):
            pile.cone((left, right), (0.008, 0.008), Material.WIRE)


def boundary(
    pile: Pile,
    place: Callable[[float], Frame],
    span: Span,
    gaps: list[Span],
    rng: np.random.Generator,
    wanted: Literal["any", "hedge", "fence"] = "any",
) -> None:
    """Add what ends a garden at the sidewalk: a hedge, wall or fence, or nothing."""
    kind = rng.random()
    high = rng.random()
    if wanted != "any":
        kind = 0.0 if wanted == "hedge" else 0.45 if kind < 0.5 else 0.80
    low, end = span
    stops = []
    for gap in sorted(gaps):
        stops.append((low, min(gap[0], end)))
        low = max(low, gap[1])
    stops.append((low, end))
    for u0, u1 in stops:
        parts = max(1, math.ceil((u1 - u0) / 5.0))
        for i in range(parts):
            half = 0.5 * (u1 - u0) / parts
            if half > 0.15:
                _fence(pile, place(u0 + (2 * i + 1) * half), half, kind, high)


def _fence(
    pile: Pile,
    frame: Frame,
    half: float,
    kind: float,
    high: float,
) -> None:
    along = (-half, half)
    if kind < 0.45:
        top = 0.9 + 1.1 * high
        pile.box(frame, (along, (0.05, 0.70), (-0.3, top)), Material.HEDGE, 12.0)
    elif kind < 0.65:
        pile.box(frame, (along, (0.05, 0.28), (-0.5, 0.5 + 1.1 * high)), Material.FENCE)
    elif kind < 0.80:
        # a low wall with a railing, or wire, whose bars let most shots through
        pile.box(frame, (along, (0.05, 0.25), (-0.5, 0.35)), Material.FENCE)
        pile.box(frame, (along, (0.13, 0.17), (0.35, 1.1 + 0.4 * high)), Material.FENCE, 20.0)
    elif kind < 0.92:
        pile.box(frame, (along, (0.05, 0.08), (0.05, 1.0 + 0.8 * high)), Material.FENCE)
