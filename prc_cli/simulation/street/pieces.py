"""Objects of a piece: parked cars, trees and furniture along the curb, gardens, people, wires."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from prc_cli.simulation.street import furniture, movers, trees
from prc_cli.simulation.street.pile import Frame, Pile, Span
from prc_cli.simulation.street.plan import (
    BUILDING_LINE_M,
    PIECE_M,
    PIECES_IN_BLOCK,
    ROAD_HALF_M,
    Character,
    Lot,
    Plan,
    Purpose,
    Side,
    StreetSceneParams,
    character_of,
    generator,
    kerbside_of,
)
from prc_cli.simulation.street.road import WALK_SLOPE, Ground, Kerbside, frame_at

_STRIP_M = ROAD_HALF_M + 0.75
"""Crown to the row of trees, lamps and signs [m]."""
_PARKED: dict[Character, float] = {
    "terraces": 1.0,
    "residential": 0.9,
    "boulevard": 1.0,
    "suburb": 0.45,
}
_TREES: dict[Character, float] = {
    "terraces": 0.3,
    "residential": 0.8,
    "boulevard": 1.6,
    "suburb": 0.6,
}
"""Shares of places that are taken, as factors on the parameters."""


@dataclass(slots=True)
class Kerb:
    """One side of a piece along its curb, and its occupied stretches."""

    ground: Ground
    plan: Plan
    side: Side
    pile: Pile
    params: StreetSceneParams
    kerbside: Kerbside
    variety: np.random.Generator
    """Random numbers of objects that only some parameters ask for."""
    taken: list[Span] = field(default_factory=list)

    def frame(self, s: float, d: float) -> Frame:
        """Frame with u along the street and v away from its crown; d without sign."""
        return frame_at(self.ground, s, self.side.side * d, self.side.side)

    def free(self, s: float, reach: float) -> bool:
        """Whether the strip at the curb is free within ``reach``: no body, low curb, street."""
        low = s - reach
        high = s + reach
        if low < self.plan.start or high > self.plan.start + PIECE_M:
            return False
        closed = list(self.side.dropped)
        if self.side.junction is not None:
            closed.append(self.side.junction.bend)
        return all(high < span[0] or low > span[1] for span in (*closed, *self.taken))

    def claim(self, s: float, reach: float) -> bool:
        """Take a place, if it is free."""
        if not self.free(s, reach):
            return False
        self.taken.append((s - reach, s + reach))
        return True


def kerbsides(plan: Plan, params: StreetSceneParams, seed: int) -> tuple[Kerbside, Kerbside]:
    """Return the kerbsides of a piece, left and right."""
    sides = []
    for side in plan.sides:
        low, raised = kerbside_of(seed, plan.piece, side.side)
        is_lowered = low < params.lowered_kerbs
        verge_m = 0.0
        if not is_lowered and raised < params.verges:
            verge_m = 0.05 + 0.04 * raised / params.verges
        sides.append(Kerbside(is_lowered, verge_m))
    return sides[0], sides[1]


def build_kerbs(
    pile: Pile,
    ground: Ground,
    plan: Plan,
    params: StreetSceneParams,
    seed: int,
) -> None:
    """Add everything of a piece but its ground and its houses."""
    for side, kerbside in zip(plan.sides, kerbsides(plan, params, seed), strict=True):
        variety = generator(seed, Purpose.VARIETY, plan.piece, side.side)
        kerb = Kerb(ground, plan, side, pile, params, kerbside, variety)
        if kerbside.lowered:
            kerb.taken.append((plan.start, plan.start + PIECE_M))
        _park(kerb, generator(seed, Purpose.PARKED, plan.piece, side.side))
        _furnish(kerb, generator(seed, Purpose.FURNITURE, plan.piece, side.side))
        _plant_trees(kerb, generator(seed, Purpose.TREES, plan.piece, side.side))
        garden_rng = generator(seed, Purpose.GARDENS, plan.piece, side.side)
        for lot in side.lots:
            _make_garden(kerb, lot, garden_rng)
    _hang_wires(pile, ground, plan, params, seed)


def _park(kerb: Kerb, rng: np.random.Generator) -> None:
    """Park cars in places of six metres, free at side streets, driveways and crossings."""
    side = kerb.side
    closed = [(low - 0.3, high + 0.3) for low, high in side.dropped]
    if side.junction is not None:
        closed.append((side.junction.bend[0] - 2.0, side.junction.bend[1] + 2.0))
    share = kerb.params.parked * _PARKED[kerb.plan.character]
    n_places = int(PIECE_M / 6.0)
    after_lorry = False
    for i in range(n_places):
        low = kerb.plan.start + 6.0 * i
        model = movers.draw_model(rng, kerb.params.vans)
        lorry_chance, parked_chance, gap_chance, room_chance = rng.random(4).tolist()
        turn_chance = rng.random()
        is_lorry = lorry_chance < 0.03 and i + 1 < n_places
        high = low + (12.0 if is_lorry else 6.0)
        is_closed = any(high > span[0] and low < span[1] for span in closed)
        if after_lorry or is_closed or parked_chance >= share:
            after_lorry = False
            continue
        after_lorry = is_lorry
        # from the curb to the wheels; lorries are wide and stand close to it
        if is_lorry:
            gap = 0.1 + 0.05 * gap_chance
            half_width = 1.2
            room = 0.5
        else:
            gap = 0.2 + 0.2 * gap_chance
            half_width = model.wide
            room = 2.75 - model.half
        outward = 1.0 if kerb.kerbside.lowered else -1.0
        d = side.side * (ROAD_HALF_M + (gap + half_width) * outward)
        s = 0.5 * (low + high) + room * (2.0 * room_chance - 1.0)
        frame = frame_at(kerb.ground, s, d, tilted=True)
        if kerb.kerbside.lowered:
            inner_drop = kerb.ground.ramp(abs(d) + (0.12 - half_width))
            outer_drop = kerb.ground.ramp(abs(d) + (half_width - 0.12))
            rise = WALK_SLOPE + (inner_drop - outer_drop) / (2.0 * (half_width - 0.12))
            z = frame.z - 0.5 * (inner_drop + outer_drop)
            frame = replace(frame, z=z, roll=side.side * rise)
        # cars drive on the right; now and then one is parked against it
        is_backwards = (side.side > 0) != (turn_chance < 0.08)
        if is_backwards:
            frame = replace(frame, yaw=frame.yaw + np.pi, slope=-frame.slope, roll=-frame.roll)
        if is_lorry:
            movers.lorry(kerb.pile, frame, 7.5)
        else:
            movers.car(kerb.pile, frame, model)


def _furnish(kerb: Kerb, rng: np.random.Generator) -> None:
    """Add lamps, shelters, bins and cabinets, signs and lights, and people who stand about."""
    pile = kerb.pile
    plan = kerb.plan
    side = kerb.side
    start = kerb.plan.start
    is_town = plan.character in ("terraces", "boulevard")
    if (plan.piece + (side.side > 0)) % 2 == 0:
        for s in (start + 3.5, start + 26.0):
            if kerb.claim(s, 0.6):
                furniture.lamp(pile, kerb.frame(s, ROAD_HALF_M + 0.6), 7.5 if is_town else 5.5)
                break
    _furnish_junction(kerb, rng, is_town=is_town)
    chances = rng.random(6).tolist()
    s = start + 5.0 + 20.0 * chances[1]
    if chances[0] < 0.10 and kerb.claim(s, 2.6):
        furniture.shelter(pile, kerb.frame(s, ROAD_HALF_M + 0.45))
    s = start + 1.0 + 28.0 * chances[2]
    if chances[4] < 0.55 and kerb.claim(s, 0.8):
        furniture.sign(pile, kerb.frame(s, ROAD_HALF_M + 0.5), rng)
    s = start + 1.0 + 28.0 * chances[3]
    if chances[5] < 0.55 and kerb.claim(s, 0.8):
        furniture.bin_or_box(pile, kerb.frame(s, ROAD_HALF_M + 0.5 + 0.3), rng)
    for _ in range(int(rng.poisson(0.8 * kerb.params.people))):
        s = start + PIECE_M * rng.random()
        yaw = rng.uniform(0.0, 2.0 * np.pi)
        if side.junction is None or not side.junction.bend[0] < s < side.junction.bend[1]:
            frame = replace(kerb.frame(s, BUILDING_LINE_M - 0.45), yaw=yaw)
            movers.person(pile, frame, rng, 0.0)


def _furnish_junction(kerb: Kerb, rng: np.random.Generator, *, is_town: bool) -> None:
    """Add lights or signs before the junction, bollards beside the crossing."""
    plan = kerb.plan
    if plan.junction is None or plan.crossing is None:
        return
    is_right = kerb.side.side < 0
    s = plan.junction.bend[0] - 0.9 if is_right else plan.junction.bend[1] + 0.9
    if kerb.claim(s, 0.5):
        frame = kerb.frame(s, ROAD_HALF_M + 0.6)
        if not is_right:  # it faces the other way
            frame = replace(frame, yaw=frame.yaw + np.pi, mirror=-frame.mirror)
        if is_town:
            furniture.traffic_light(kerb.pile, frame, arm=plan.character == "boulevard")
        else:
            furniture.sign(kerb.pile, frame, rng)
    if rng.random() < 0.6:
        low, high = plan.crossing
        for s in (low - 1.9, low - 0.9, high + 0.9, high + 1.9):
            if kerb.claim(s, 0.2):
                furniture.bollard(kerb.pile, kerb.frame(s, ROAD_HALF_M + 0.4))


def _plant_trees(kerb: Kerb, rng: np.random.Generator) -> None:
    """Add trees in the strip at the curb, as wide as the facades behind them allow."""
    params = kerb.params
    share = 0.0
    if params.trees > 0:
        share = min(params.trees * _TREES[kerb.plan.character], 0.97)
    usual_kind = trees.AVENUE if kerb.plan.character == "boulevard" else trees.STREET
    for i in range(4):
        s = kerb.plan.start + 7.5 * (i + 0.5) + rng.uniform(-0.8, 0.8)
        is_wanted = rng.random() < share
        is_birch = rng.random() < 0.2
        if not is_wanted or not kerb.claim(s, 0.6):
            continue
        setback = 4.0
        setbacks = [
            lot.setback
            for lot in kerb.side.lots
            if lot.span[0] - 2 < s < lot.span[1] + 2 and lot.kind != "yard"
        ]
        if setbacks:
            setback = min(setbacks)
        room = BUILDING_LINE_M + setback - _STRIP_M - 0.25
        if params.canopies > 0 and kerb.variety.random() < params.canopies:
            kind = trees.CANOPY
            room = max(room, 3.5)
        elif is_birch:
            kind = trees.BIRCH
        else:
            kind = usual_kind
        trees.tree(kerb.pile, kerb.frame(s, _STRIP_M), kind, rng, room)


def _make_garden(kerb: Kerb, lot: Lot, rng: np.random.Generator) -> None:
    """Add boundary, trees, bushes and the car of a garden or yard."""
    low, high = lot.span
    middle = 0.5 * (low + high)
    is_yard = lot.kind == "yard"
    if not is_yard and lot.setback < 1.5:
        return
    gaps = [lot.driveway] if lot.driveway is not None else []
    if not is_yard:
        gaps.append((middle - 2.0, middle - 0.8))
    depth = 14.0 if is_yard else lot.setback
    side_on = kerb.params.side_on
    if side_on > 0 and depth > 3.4 and kerb.variety.random() < side_on:
        _make_forecourt(kerb, lot, depth)
        return

    def place(s: float) -> Frame:
        return kerb.frame(s, BUILDING_LINE_M)

    span = (low + 0.05, high - 0.05)
    furniture.boundary(kerb.pile, place, span, gaps, rng, _wanted_boundary(kerb))
    for share in (0.22, 0.55):
        s = low + share * (high - low) + (0.0 if is_yard else 0.5)
        _plant_in_garden(kerb, s, depth, gaps, rng, is_yard=is_yard)
    junction = kerb.side.junction
    is_built_up = junction is not None and abs(junction.s - middle) < 24.0
    if lot.kind == "house" and not is_built_up and rng.random() < kerb.params.trees:
        behind_house = kerb.frame(low + 2.5, BUILDING_LINE_M + lot.setback + 17.0)
        trees.tree(kerb.pile, behind_house, trees.STREET, rng)
    if lot.driveway is not None and rng.random() < 0.4:
        model = movers.draw_model(rng)
        side = kerb.side.side
        s = 0.5 * sum(lot.driveway)
        d = BUILDING_LINE_M + 0.8 + model.half + max(0.0, lot.setback - 2.0)
        frame = frame_at(kerb.ground, s, side * d, tilted=True)
        fall = float(kerb.ground.line.side_slope(np.array([s]), side)[0])
        # the bonnet points into the garden: u away from the street, v along it
        yaw = frame.yaw + side * 0.5 * np.pi
        movers.car(kerb.pile, replace(frame, yaw=yaw, slope=fall, roll=-side * frame.slope), model)


def _plant_in_garden(
    kerb: Kerb,
    s: float,
    depth: float,
    gaps: list[Span],
    rng: np.random.Generator,
    *,
    is_yard: bool,
) -> None:
    """Add a tree, a bush or nothing at a place of a garden, off its paths."""
    tree_is_wanted = rng.random() < kerb.params.trees
    away = rng.uniform(0.4, 0.6)
    room = min(away * depth - 0.7, (1.0 - away) * depth - 0.4, 4.0)

    def is_off_paths(reach: float) -> bool:
        return not any(gap[0] - reach < s < gap[1] + reach for gap in gaps)

    if tree_is_wanted and room > 0.9 and is_off_paths(0.6):
        kind = trees.STREET if is_yard and rng.random() < 0.4 else trees.GARDEN
        trees.tree(kerb.pile, kerb.frame(s, BUILDING_LINE_M + away * depth), kind, rng, room)
    elif rng.random() < 0.6 and depth > 2.4 and is_off_paths(1.0):
        radius = min(rng.uniform(0.4, 0.9), 0.4 * depth)
        trees.bush(kerb.pile, kerb.frame(s, BUILDING_LINE_M + 0.55 * depth), radius, rng)


def _wanted_boundary(kerb: Kerb) -> Literal["any", "hedge", "fence"]:
    if kerb.params.fences == 0 and kerb.params.hedges == 0:
        return "any"
    fence_chance, hedge_chance = kerb.variety.random(2).tolist()
    if fence_chance < kerb.params.fences:
        return "fence"
    if hedge_chance < kerb.params.hedges:
        return "hedge"
    return "any"


def _make_forecourt(kerb: Kerb, lot: Lot, depth: float) -> None:
    """Park cars in front of a house or on a yard, open to the street and along it."""
    low, high = lot.span
    side = kerb.side.side
    away = BUILDING_LINE_M + 1.3 + float(kerb.variety.random()) * (min(depth, 9.0) - 2.6)
    for i in range(int((high - low) / 6.0)):
        model = movers.draw_model(kerb.variety, kerb.params.vans)
        empty_chance, shift = kerb.variety.random(2).tolist()
        if empty_chance > 0.8:
            continue
        s = low + 6.0 * i + 3.0 + 0.3 * shift
        frame = frame_at(kerb.ground, s, side * away, tilted=True)
        slope = float(kerb.ground.line.side_slope(np.array([s]), side)[0])
        movers.car(kerb.pile, replace(frame, roll=side * slope), model)


def _hang_wires(
    pile: Pile,
    ground: Ground,
    plan: Plan,
    params: StreetSceneParams,
    seed: int,
) -> None:
    """Add the overhead wires of some blocks without tall houses."""
    side = _wired(seed, plan.piece, params.character)
    if not side:
        return
    d = side * (ROAD_HALF_M + 1.05)
    start = frame_at(ground, plan.start, d, side)
    end = frame_at(ground, plan.start + PIECE_M, d, side)
    furniture.pole(pile, start)
    furniture.wires(pile, start, end)
    is_last = plan.piece % PIECES_IN_BLOCK == PIECES_IN_BLOCK - 1
    if is_last and _wired(seed, plan.piece + 1, params.character) != side:
        furniture.pole(pile, end)


def _wired(seed: int, piece: int, choice: str) -> int:
    """Return the side of the street with poles, 0 = none."""
    rng = generator(seed, Purpose.WIRES, piece // PIECES_IN_BLOCK)
    is_wired = rng.random() < 0.6
    side = 1 if rng.random() < 0.5 else -1
    has_low_houses = character_of(seed, piece, choice) in ("residential", "suburb")
    return side if has_low_houses and is_wired else 0
