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
        if side.junction is None:
            continue
        # rows on both sides of the side street, behind the houses on its corners
        for end, edge in ((1, side.junction.open[0]), (-1, side.junction.open[1])):
            d = BUILDING_LINE_M + 19.5
            while d < FAR_M - 8.0:
                width = rng.uniform(8.0, 12.0)
                frame = frame_at(ground, edge, side.side * (d + 0.5 * width))
                yaw = frame.yaw + side.side * 0.5 * np.pi
                turned = replace(frame, yaw=yaw, mirror=side.side * end)
                build(pile, turned, style_of(rng, "terrace", width, 0.0), rng)
                d += width


def style_of(
    rng: np.random.Generator,
    kind: str,
    width: float,
    setback: float,
) -> Style:
    """Draw the measures of a house of one kind."""
    u = rng.random(9).tolist()
    is_terrace = kind == "terrace"
    is_block = kind == "block"
    if is_terrace:
        storeys = 2 + int(3 * u[0])
    elif is_block:
        storeys = 4 + int(4 * u[0])
    else:
        storeys = 1 + int(1.8 * u[0])
    return Style(
        width=width,
        depth=9.0 + 2.0 * u[1],
        storeys=storeys,
        storey=2.8 + 0.6 * u[2],
        pitch=2.1 + 1.1 * u[3],
        window=(0.5 + 0.25 * u[4], 1.3 + 0.3 * u[5]),
        recess=0.10 + 0.10 * u[6],
        gable=kind == "house" or (is_terrace and u[7] < 0.6),
        balconies=is_block or (is_terrace and u[7] > 0.7),
        shop=kind != "house" and setback == 0 and u[8] < 0.3,
    )


def _on_lot(
    pile: Pile,
    ground: Ground,
    side: Side,
    lot: Lot,
    rng: np.random.Generator,
) -> None:
    """Add what is built on a lot, or behind an open yard or a passage."""
    low, high = lot.span
    middle = 0.5 * (low + high)
    width = high - low
    facade = side.side * (BUILDING_LINE_M + lot.setback)
    if lot.kind == "yard":
        far = side.side * (BUILDING_LINE_M + rng.uniform(20.0, 32.0))
        if side.junction is not None and abs(side.junction.s - middle) < 30.0:
            # the houses of the side street are behind this yard
            return
        frame = frame_at(ground, middle, far, side.side)
        build(pile, frame, style_of(rng, "terrace", width + rng.uniform(0.0, 8.0), 1.0), rng)
    elif lot.kind == "passage":
        frame = frame_at(ground, middle, facade, side.side)
        above = (3.1, rng.uniform(7.0, 11.0))
        pile.box(frame, (-0.5 * width, 0.5 * width), (0.0, 10.0), above, Material.WALL)
        behind = frame_at(ground, middle, side.side * (BUILDING_LINE_M + 28.0), side.side)
        top = rng.uniform(4.0, 9.0)
        pile.box(behind, (-8.0, 8.0), (0.0, 8.0), (_BASE_M, top), Material.WALL)
    else:
        if lot.kind == "house":
            # the driveway or a path leads past the house
            gap = 3.8 if lot.driveway is not None else 2.0
            middle = middle + 0.5 * (0.8 - gap)
            width = width - gap - 0.8
        frame = frame_at(ground, middle, facade, side.side)
        build(pile, frame, style_of(rng, lot.kind, width, lot.setback), rng)


def build(
    pile: Pile,
    frame: Frame,
    style: Style,
    rng: np.random.Generator,
) -> None:
    """Add a house."""
    half = 0.5 * style.width
    along = (-half, half)
    top = style.top
    inner = (style.recess + _CURTAIN_M, style.depth)
    pile.box(frame, along, inner, (_BASE_M, top), Material.WALL)
    _front(pile, frame, style, door=int(rng.integers(len(style.middles))))
    if style.gable:
        _gable(pile, frame, style, rise=style.depth * rng.uniform(0.3, 0.5))
        if rng.random() < 0.6:
            u = rng.uniform(-0.35, 0.35) * style.width
            v = 0.5 * style.depth + 1.0
            chimney_u = (u - 0.35, u + 0.35)
            chimney_v = (v - 0.3, v + 0.3)
            pile.box(frame, chimney_u, chimney_v, (top, top + 4.2), Material.WALL)
    else:
        out = 0.15 + 0.3 * rng.random()
        pile.box(frame, along, (-out, 0.05), (top - 0.3, top), Material.WALL)
        pile.box(frame, along, (0.0, style.depth), (top - 0.02, top + 0.05), Material.ROOF)
    if style.storeys > 1 and rng.random() < 0.4:
        ledge = style.storey + 0.1
        pile.box(frame, along, (-0.1, 0.02), (ledge, ledge + 0.18), Material.WALL)
    if style.balconies:
        # before every other column of windows: a slab and a railing of bars
        half = 0.5 * min(style.pitch, 2.6)
        for middle in style.middles[int(rng.integers(2)) :: 2]:
            along = (middle - half + 0.1, middle + half - 0.1)
            for storey in range(1, min(style.storeys, 6)):
                floor = storey * style.storey + 0.1
                if floor >= 2.9:
                    slab = (floor - 0.15, floor)
                    railing = (floor, floor + 1.0)
                    pile.box(frame, along, (-1.1, 0.02), slab, Material.BALCONY)
                    pile.box(frame, along, (-1.1, -1.06), railing, Material.BALCONY, 25.0)


def _front(
    pile: Pile,
    frame: Frame,
    style: Style,
    door: int,
) -> None:
    """Add piers, bands, glass and door."""
    half = 0.5 * style.width
    recess = style.recess
    windows = [(middle - style.window[0], middle + style.window[0]) for middle in style.middles]
    pier_low = -half
    for i, (window_low, window_high) in enumerate([*windows, (half, half)]):
        # the first and the last pier close the house beside the panes
        is_outer = i in (0, len(windows))
        pier_v = (0.0, recess + _CURTAIN_M * is_outer)
        pile.box(frame, (pier_low, window_low), pier_v, (_BASE_M, style.top), Material.WALL)
        pier_low = window_high

    # the band under the windows, with the door
    low = windows[0][0]
    high = windows[-1][1]
    doorway = windows[door]
    sill = 0.45 if style.shop else 0.95
    for span in ((low, doorway[0]), (doorway[1], high)):
        if span[1] - span[0] > 0.1:
            pile.box(frame, span, (0.0, recess), (_BASE_M, sill), Material.WALL)
    pile.box(frame, doorway, (0.0, recess + 0.3), (_BASE_M, 0.12), Material.WALL)
    pile.box(frame, doorway, (recess - 0.04, recess + 0.04), (0.12, 2.15), Material.DOOR)

    # the bands above them
    lintel = 2.6 if style.shop else 0.95 + style.window[1]
    for storey in range(1, style.storeys + 1):
        next_sill = storey * style.storey + 0.9 if storey < style.storeys else style.top
        pile.box(frame, (low, high), (0.0, recess), (lintel, next_sill), Material.WALL)
        lintel = next_sill + style.window[1]
    top = style.top
    pane = ((low, recess, 0.0), (high, recess, 0.0), (high, recess, top), (low, recess, top))
    pile.face(frame, pane, Material.GLASS)


def _gable(
    pile: Pile,
    frame: Frame,
    style: Style,
    rise: float,
) -> None:
    """Add a roof with its ridge along the street, eaves, and the triangles of wall under it."""
    half = 0.5 * style.width + 0.02
    middle = 0.5 * style.depth
    out = 0.4
    eaves_w = style.top - out * rise / middle
    ridge_w = style.top + rise
    for eaves_v in (-out, style.depth + out):
        corners = (
            (-half, eaves_v, eaves_w),
            (half, eaves_v, eaves_w),
            (half, middle, ridge_w),
            (-half, middle, ridge_w),
        )
        pile.face(frame, corners, Material.ROOF)
    for u in (-half + 0.02, half - 0.02):
        front = frame.point(u, 0.0, style.top)
        back = frame.point(u, style.depth, style.top)
        ridge = frame.point(u, middle, ridge_w)
        pile.triangle(front, back, ridge, Material.WALL)
    gutter_v = (-out - 0.1, -out + 0.02)
    pile.box(frame, (-half, half), gutter_v, (eaves_w - 0.1, eaves_w), Material.ROOF)
