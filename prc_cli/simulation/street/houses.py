"""Houses: facades with windows, doors and balconies, gable and flat roofs, yards, passages.

A facade costs few bodies: piers between the columns of windows and bands between the storeys are
boxes as deep as the recess, and one pane of glass runs behind all of them; so jambs, sills and
lintels come by themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from prc_cli.simulation.street.pile import Frame, Pile, Span
from prc_cli.simulation.street.plan import (
    BUILDING_LINE_M,
    Junction,
    Lot,
    Plan,
    Purpose,
    Side,
    generator,
)
from prc_cli.simulation.street.road import FAR_M, Ground, frame_at
from prc_cli.simulation.world import Material

_BASE_M = -1.5
"""Walls begin this far below the ground, for slopes [m]."""
_CURTAIN_M = 0.4
"""Behind a pane [m]: curtains, blinds, furniture, the room's wall."""


@dataclass(frozen=True, slots=True)
class Style:
    """Measures of a house [m]."""

    width: float
    depth: float
    storeys: int
    storey: float
    pitch: float
    """From window to window."""
    window: Span
    """Half of a window's width; its height."""
    recess: float
    gable: bool
    balconies: bool
    shop: bool

    @property
    def top(self) -> float:
        """Height of the eaves."""
        return self.storey * self.storeys + 0.5

    @property
    def middles(self) -> list[float]:
        """Middles of the columns of windows, along the facade."""
        count = max(1, int((self.width - 0.8) / self.pitch))
        return [(i - 0.5 * (count - 1)) * self.pitch for i in range(count)]


def build_houses(
    pile: Pile,
    ground: Ground,
    plan: Plan,
    seed: int,
) -> None:
    """Add the houses of a piece, along its side streets and behind open yards."""
    for side in plan.sides:
        rng = generator(seed, Purpose.HOUSES, plan.piece, side.side)
        for lot in side.lots:
            _on_lot(pile, ground, side, lot, rng)
        if side.junction is not None:
            _along_side_street(pile, ground, side.junction, side.side, rng)


def style_of(
    rng: np.random.Generator,
    kind: str,
    width: float,
    setback: float,
) -> Style:
    """Draw the measures of a house of one kind."""
    u = rng.random(9).tolist()
    storeys = {"terrace": 2 + int(3 * u[0]), "block": 4 + int(4 * u[0])}.get(
        kind, 1 + int(1.8 * u[0])
    )
    return Style(
        width=width,
        depth=9.0 + 2.0 * u[1],
        storeys=storeys,
        storey=2.8 + 0.6 * u[2],
        pitch=2.1 + 1.1 * u[3],
        window=(0.5 + 0.25 * u[4], 1.3 + 0.3 * u[5]),
        recess=0.10 + 0.10 * u[6],
        gable=kind == "house" or (kind == "terrace" and u[7] < 0.6),
        balconies=kind == "block" or (kind == "terrace" and u[7] > 0.7),
        shop=kind != "house" and setback == 0 and u[8] < 0.3,
    )


def _on_lot(
    pile: Pile,
    ground: Ground,
    side: Side,
    lot: Lot,
    rng: np.random.Generator,
) -> None:
    low, high = lot.span
    middle = 0.5 * (low + high)
    width = high - low
    across = side.side * (BUILDING_LINE_M + lot.setback)
    if lot.kind == "yard":
        far = BUILDING_LINE_M + rng.uniform(20.0, 32.0)
        if side.junction is not None and abs(side.junction.s - middle) < 30.0:
            # the houses of the side street are behind this yard
            return
        frame = frame_at(ground, middle, side.side * far, side.side)
        build(pile, frame, style_of(rng, "terrace", width + rng.uniform(0.0, 8.0), 1.0), rng)
        return
    if lot.kind == "passage":
        frame = frame_at(ground, middle, across, side.side)
        top = rng.uniform(7.0, 11.0)
        pile.box(frame, ((-0.5 * width, 0.5 * width), (0.0, 10.0), (3.1, top)), Material.WALL)
        behind = frame_at(ground, middle, side.side * (BUILDING_LINE_M + 28.0), side.side)
        pile.box(behind, ((-8.0, 8.0), (0.0, 8.0), (_BASE_M, rng.uniform(4.0, 9.0))), Material.WALL)
        return
    if lot.kind == "house":
        # the driveway or a path leads past the house
        gap = 3.8 if lot.driveway is not None else 2.0
        middle = middle + 0.5 * (0.8 - gap)
        width = width - gap - 0.8
    build(
        pile,
        frame_at(ground, middle, across, side.side),
        style_of(rng, lot.kind, width, lot.setback),
        rng,
    )


def _along_side_street(
    pile: Pile,
    ground: Ground,
    junction: Junction,
    side: int,
    rng: np.random.Generator,
) -> None:
    """Rows of houses on both sides of a side street, behind those on its corners."""
    for end, edge in ((1, junction.open[0]), (-1, junction.open[1])):
        d = BUILDING_LINE_M + 19.5
        while d < FAR_M - 8.0:
            width = rng.uniform(8.0, 12.0)
            frame = frame_at(ground, edge, side * (d + 0.5 * width))
            turned = replace(frame, yaw=frame.yaw + side * 0.5 * np.pi, mirror=side * end)
            build(pile, turned, style_of(rng, "terrace", width, 0.0), rng)
            d += width


def build(
    pile: Pile,
    frame: Frame,
    style: Style,
    rng: np.random.Generator,
) -> None:
    """Add a house."""
    half = 0.5 * style.width
    top = style.top
    back = style.recess + _CURTAIN_M
    pile.box(frame, ((-half, half), (back, style.depth), (_BASE_M, top)), Material.WALL)
    _front(pile, frame, style, door=int(rng.integers(len(style.middles))))
    if style.gable:
        _gable(pile, frame, style, rise=style.depth * rng.uniform(0.3, 0.5))
        if rng.random() < 0.6:
            u = rng.uniform(-0.35, 0.35) * style.width
            v = 0.5 * style.depth + 1.0
            pile.box(
                frame, ((u - 0.35, u + 0.35), (v - 0.3, v + 0.3), (top, top + 4.2)), Material.WALL
            )
    else:
        out = 0.15 + 0.3 * rng.random()
        pile.box(frame, ((-half, half), (-out, 0.05), (top - 0.3, top)), Material.WALL)
        pile.box(
            frame, ((-half, half), (0.0, style.depth), (top - 0.02, top + 0.05)), Material.ROOF
        )
    if style.storeys > 1 and rng.random() < 0.4:
        ledge = style.storey + 0.1
        pile.box(frame, ((-half, half), (-0.1, 0.02), (ledge, ledge + 0.18)), Material.WALL)
    if style.balconies:
        _balconies(pile, frame, style, first=int(rng.integers(2)))


def _front(
    pile: Pile,
    frame: Frame,
    style: Style,
    door: int,
) -> None:
    """Piers, bands, glass and door."""
    half = 0.5 * style.width
    deep = style.recess
    edges = [(middle - style.window[0], middle + style.window[0]) for middle in style.middles]
    low = -half
    end = half
    for i, (u0, u1) in enumerate([*edges, (end, end)]):
        # the first and the last pier close the house beside the panes
        outer = i in (0, len(edges))
        pile.box(
            frame,
            ((low, u0), (0.0, deep + _CURTAIN_M * outer), (_BASE_M, style.top)),
            Material.WALL,
        )
        low = u1
    sill = 0.45 if style.shop else 0.95
    inside = edges[0][0], edges[-1][1]
    way = edges[door]
    for span in ((inside[0], way[0]), (way[1], inside[1])):
        if span[1] - span[0] > 0.1:
            pile.box(frame, (span, (0.0, deep), (_BASE_M, sill)), Material.WALL)
    pile.box(frame, (way, (0.0, deep + 0.3), (_BASE_M, 0.12)), Material.WALL)
    pile.box(frame, (way, (deep - 0.04, deep + 0.04), (0.12, 2.15)), Material.DOOR)
    head = 2.6 if style.shop else 0.95 + style.window[1]
    for storey in range(1, style.storeys + 1):
        above = storey * style.storey + 0.9 if storey < style.storeys else style.top
        pile.box(frame, (inside, (0.0, deep), (head, above)), Material.WALL)
        head = above + style.window[1]
    (u0, u1) = inside
    top = style.top
    pile.face(
        frame, ((u0, deep, 0.0), (u1, deep, 0.0), (u1, deep, top), (u0, deep, top)), Material.GLASS
    )


def _gable(
    pile: Pile,
    frame: Frame,
    style: Style,
    rise: float,
) -> None:
    """Roof with its ridge along the street, eaves, and the triangles of wall under it."""
    half = 0.5 * style.width + 0.02
    middle = 0.5 * style.depth
    out = 0.4
    drop = out * rise / middle
    for eaves in (-out, style.depth + out):
        low = style.top - drop
        high = style.top + rise
        corners = (
            (-half, eaves, low),
            (half, eaves, low),
            (half, middle, high),
            (-half, middle, high),
        )
        pile.face(frame, corners, Material.ROOF)
    for u in (-half + 0.02, half - 0.02):
        ends = frame.point(u, 0.0, style.top), frame.point(u, style.depth, style.top)
        pile.triangle(*ends, frame.point(u, middle, style.top + rise), Material.WALL)
    pile.box(
        frame,
        ((-half, half), (-out - 0.1, -out + 0.02), (style.top - drop - 0.1, style.top - drop)),
        Material.ROOF,
    )


def _balconies(
    pile: Pile,
    frame: Frame,
    style: Style,
    first: int,
) -> None:
    """Balconies before every other column of windows: a slab and a railing of bars."""
    for middle in style.middles[first::2]:
        for storey in range(1, min(style.storeys, 6)):
            floor = storey * style.storey + 0.1
            if floor < 2.9:
                continue
            along = (
                middle - 0.5 * min(style.pitch, 2.6) + 0.1,
                middle + 0.5 * min(style.pitch, 2.6) - 0.1,
            )
            pile.box(frame, (along, (-1.1, 0.02), (floor - 0.15, floor)), Material.BALCONY)
            pile.box(frame, (along, (-1.1, -1.06), (floor, floor + 1.0)), Material.BALCONY, 25.0)
