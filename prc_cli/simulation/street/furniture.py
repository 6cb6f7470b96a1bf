"""Furniture of a street: lamps, signs, bins, shelters, wires, walls, fences and hedges."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Literal

import numpy as np

from prc_cli.simulation.street.pile import Frame, Pile, Point, Span
from prc_cli.simulation.world import Material

_FOOT_M = -0.2
"""Posts begin this far below the ground [m]."""


def lamp(pile: Pile, frame: Frame, height: float) -> None:
    """Add a lamp whose arm reaches over the road; v of the frame points away from it."""
    _post(pile, frame, height, (0.09, 0.05))
    top = frame.point(0.0, 0.0, height)
    arm_end = frame.point(0.0, -1.5, height + 0.25)
    pile.cone(top, arm_end, (0.04, 0.03), Material.POLE)
    light = (height + 0.18, height + 0.30)
    pile.box(frame, (-0.12, 0.12), (-2.0, -1.4), light, Material.POLE)


def _post(pile: Pile, frame: Frame, height: float, radii: Span) -> None:
    foot = frame.point(0.0, 0.0, _FOOT_M)
    top = frame.point(0.0, 0.0, height)
    pile.cone(foot, top, radii, Material.POLE)


def traffic_light(pile: Pile, frame: Frame, *, arm: bool) -> None:
    """Add a traffic light, perhaps with a second one on an arm over the road."""
    _post(pile, frame, 5.8 if arm else 3.4, (0.08, 0.06))
    pile.box(frame, (-0.32, -0.1), (-0.15, 0.15), (2.3, 3.2), Material.SIGN)
    if arm:
        arm_start = frame.point(0.0, 0.0, 5.7)
        arm_end = frame.point(0.0, -3.6, 5.9)
        pile.cone(arm_start, arm_end, (0.06, 0.04), Material.POLE)
        pile.box(frame, (-0.2, 0.0), (-3.6, -3.3), (5.1, 6.0), Material.SIGN)


def sign(pile: Pile, frame: Frame, rng: np.random.Generator) -> None:
    """Add a post with one or two plates, a triangle now and then."""
    top = rng.uniform(2.4, 2.9)
    _post(pile, frame, top, (0.035, 0.035))
    if rng.random() < 0.3:
        left = frame.point(0.05, -0.4, top)
        right = frame.point(0.05, 0.4, top)
        low = frame.point(0.05, 0.0, top - 0.7)
        pile.triangle(left, right, low, Material.SIGN)
    else:
        half = rng.uniform(0.2, 0.35)
        pile.box(frame, (0.04, 0.06), (-half, half), (top - 2 * half, top), Material.SIGN)
    if rng.random() < 0.4:
        second_plate = (top - 1.05, top - 0.75)
        pile.box(frame, (0.04, 0.06), (-0.25, 0.25), second_plate, Material.SIGN)


def bin_or_box(pile: Pile, frame: Frame, rng: np.random.Generator) -> None:
    """Add a bin or a cabinet of the grid."""
    if rng.random() < 0.5:
        top = rng.uniform(0.9, 1.1)
        pile.box(frame, (-0.3, 0.3), (-0.28, 0.28), (_FOOT_M, top), Material.POLE)
        return
    half = rng.uniform(0.3, 0.6)
    top = rng.uniform(1.0, 1.4)
    pile.box(frame, (-half, half), (-0.17, 0.17), (_FOOT_M, top), Material.POLE)


def bollard(pile: Pile, frame: Frame) -> None:
    """Add a bollard."""
    _post(pile, frame, 0.9, (0.06, 0.05))
    pile.ellipsoid(frame.point(0.0, 0.0, 0.9), (0.06, 0.06, 0.05), 0.0, Material.POLE)


def shelter(pile: Pile, frame: Frame) -> None:
    """Add a bus shelter of glass that is open towards the road, with a bench.

    v points away from the road.
    """
    pile.box(frame, (-2.0, 2.0), (-0.2, 1.3), (2.35, 2.45), Material.POLE)
    pile.box(frame, (-1.95, 1.95), (1.15, 1.17), (0.15, 2.25), Material.GLASS)
    pile.box(frame, (-1.2, 1.2), (0.75, 1.1), (0.42, 0.48), Material.POLE)
    for u in (-1.95, 1.95):
        pile.box(frame, (u - 0.01, u + 0.01), (0.2, 1.15), (0.15, 2.25), Material.GLASS)
        for v in (-0.1, 1.16):
            post_u = (u - 0.04, u + 0.04)
            post_v = (v - 0.04, v + 0.04)
            pile.box(frame, post_u, post_v, (_FOOT_M, 2.4), Material.POLE)


def pole(pile: Pile, frame: Frame) -> None:
    """Add a pole for overhead wires, with its cross-arm."""
    _post(pile, frame, 8.0, (0.14, 0.09))
    pile.box(frame, (-0.05, 0.05), (-0.8, 0.8), (7.4, 7.52), Material.POLE)


def wires(pile: Pile, start: Frame, end: Frame) -> None:
    """Hang wires from pole to pole, each in four straight parts."""
    for v in (-0.7, 0.0, 0.7):
        first = start.point(0.0, v, 7.55)
        last = end.point(0.0, v, 7.55)
        knots: list[Point] = []
        for i in range(5):
            share = i / 4
            x, y, z = (a + share * (b - a) for a, b in zip(first, last, strict=True))
            sag = 2.0 * share * (1.0 - share)
            knots.append((x, y, z - sag))
        for left, right in itertools.pairwise(knots):
            pile.cone(left, right, (0.008, 0.008), Material.WIRE)


def boundary(
    pile: Pile,
    place: Callable[[float], Frame],
    span: Span,
    gaps: list[Span],
    rng: np.random.Generator,
    wanted: Literal["any", "hedge", "fence"] = "any",
) -> None:
    """Add what ends a garden at the sidewalk: a hedge, wall or fence, or nothing.

    Parameters
    ----------
    pile : Pile
    place : callable
        Frame at a distance along the street [m].
    span : (float, float)
        Ends of the garden along the street [m].
    gaps : list of (float, float)
        Driveways and paths through the boundary [m].
    rng : Generator
    wanted : str
    """
    chance = rng.random()
    high = rng.random()
    if wanted == "hedge":
        kind = "hedge"
    elif wanted == "fence":
        kind = "wall" if chance < 0.5 else "fence"
    else:
        kind = _kind_of(chance)
    if not kind:
        return
    low, end = span
    stretches: list[Span] = []
    for gap_low, gap_high in sorted(gaps):
        stretches.append((low, min(gap_low, end)))
        low = max(low, gap_high)
    stretches.append((low, end))
    for first, last in stretches:
        n_parts = max(1, math.ceil((last - first) / 5.0))
        half = 0.5 * (last - first) / n_parts
        if half <= 0.15:
            continue
        for i in range(n_parts):
            _boundary_part(pile, place(first + (2 * i + 1) * half), half, kind, high)


def _kind_of(chance: float) -> str:
    """Return a kind of boundary; empty = an open garden."""
    for below, kind in ((0.45, "hedge"), (0.65, "wall"), (0.80, "railing"), (0.92, "fence")):
        if chance < below:
            return kind
    return ""


def _boundary_part(
    pile: Pile,
    frame: Frame,
    half: float,
    kind: str,
    high: float,
) -> None:
    """Add a straight part; ``high`` from 0 to 1 is its height among those of its kind."""
    along = (-half, half)
    if kind == "hedge":
        pile.box(frame, along, (0.05, 0.70), (-0.3, 0.9 + 1.1 * high), Material.HEDGE, 12.0)
    elif kind == "wall":
        pile.box(frame, along, (0.05, 0.28), (-0.5, 0.5 + 1.1 * high), Material.FENCE)
    elif kind == "railing":
        # a low wall with a railing, or wire, whose bars let most shots through
        pile.box(frame, along, (0.05, 0.25), (-0.5, 0.35), Material.FENCE)
        pile.box(frame, along, (0.13, 0.17), (0.35, 1.1 + 0.4 * high), Material.FENCE, 20.0)
    else:
        pile.box(frame, along, (0.05, 0.08), (0.05, 1.0 + 0.8 * high), Material.FENCE)
