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
        lowered = low < params.lowered_kerbs
        verge = not lowered and raised < params.verges
        sides.append(Kerbside(lowered, 0.05 + 0.04 * raised / params.verges if verge else 0.0))
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
        kerb = Kerb(
            ground,
            plan,
            side,
            pile,
            params,
            kerbside,
            generator(seed, Purpose.VARIETY, plan.piece, side.side),
        )
        if kerbside.lowered:
            kerb.taken.append((plan.start, plan.start + PIECE_M))
        _parked(kerb, generator(seed, Purpose.PARKED, plan.piece, side.side))
        _furniture(kerb, generator(seed, Purpose.FURNITURE, plan.piece, side.side))
        _trees(kerb, generator(seed, Purpose.TREES, plan.piece, side.side))
        rng = generator(seed, Purpose.GARDENS, plan.piece, side.side)
        for lot in side.lots:
            _garden(kerb, lot, rng)
    _wires(pile, ground, plan, params, seed)


def _parked(kerb: Kerb, rng: np.random.Generator) -> None:
    """Cars along the curb: places of six metres, free at side streets, driveways and crossings."""
    side = kerb.side
    start = kerb.plan.start
    closed = [(low - 0.3, high + 0.3) for low, high in side.dropped]
    if side.junction is not None:
        closed.append((side.junction.bend[0] - 2.0, side.junction.bend[1] + 2.0))
    share = kerb.params.parked * _PARKED[kerb.plan.character]
    count = int(PIECE_M / 6.0)
    after_lorry = False
    for i in range(count):
        low = start + 6.0 * i
        model = movers.draw_model(rng, kerb.params.vans)
        chance = rng.random(4)
        turn = rng.random()
        long = bool(chance[0] < 0.03 and i + 1 < count)
        high = low + (12.0 if long else 6.0)
        blocked = any(high > span[0] and low < span[1] for span in closed)
        if after_lorry or blocked or chance[1] >= share:
            after_lorry = False
            continue
        after_lorry = long
        # from the curb to the wheels; lorries are wide and stand close to it
        gap, wide = (0.1 + 0.05 * chance[2], 1.2) if long else (0.2 + 0.2 * chance[2], model.wide)
        d = side.side * (
            ROAD_HALF_M + (float(gap) + wide) * (1.0 if kerb.kerbside.lowered else -1.0)
        )
        room = 0.5 if long else 2.75 - model.half
        frame = frame_at(
            kerb.ground, 0.5 * (low + high) + room * (2.0 * float(chance[3]) - 1.0), d, tilted=True
        )
        if kerb.kerbside.lowered:
            # inner and outer wheels
            near, far = (kerb.ground.ramp(abs(d) + side_m) for side_m in (0.12 - wide, wide - 0.12))
            rise = WALK_SLOPE + (near - far) / (2.0 * (wide - 0.12))
            frame = replace(frame, z=frame.z - 0.5 * (near + far), roll=side.side * rise)
        # cars drive on the right; now and then one is parked against it
        backwards = (side.side > 0) != (turn < 0.08)
        if backwards:
            frame = replace(frame, yaw=frame.yaw + np.pi, slope=-frame.slope, roll=-frame.roll)
        if long:
            movers.lorry(kerb.pile, frame, 7.5)
        else:
            movers.car(kerb.pile, frame, model)


def _furniture(kerb: Kerb, rng: np.random.Generator) -> None:
    """Lamps, lights and signs at junctions, shelters, bins and cabinets; people who stand about."""
    pile = kerb.pile
    plan = kerb.plan
    side = kerb.side
    start = kerb.plan.start
    town = plan.character in ("terraces", "boulevard")
    if (plan.piece + (side.side > 0)) % 2 == 0:
        free = [s for s in (start + 3.5, start + 26.0) if kerb.free(s, 0.6)]
        if free and kerb.claim(free[0], 0.6):
            furniture.lamp(pile, kerb.frame(free[0], ROAD_HALF_M + 0.6), 7.5 if town else 5.5)
    _at_junction(kerb, rng, town=town)
    chance = rng.random(6).tolist()
    shelter = start + 5.0 + 20.0 * chance[1]
    if chance[0] < 0.10 and kerb.claim(shelter, 2.6):
        furniture.shelter(pile, kerb.frame(shelter, ROAD_HALF_M + 0.45))
    for i, add in enumerate((furniture.sign, furniture.bin_or_box)):
        s = start + 1.0 + 28.0 * chance[2 + i]
        if chance[4 + i] < 0.55 and kerb.claim(s, 0.8):
            add(pile, kerb.frame(s, ROAD_HALF_M + 0.5 + 0.3 * i), rng)
    for _ in range(int(rng.poisson(0.8 * kerb.params.people))):
        s = start + PIECE_M * rng.random()
        yaw = rng.uniform(0.0, 2.0 * np.pi)
        if side.junction is None or not side.junction.bend[0] < s < side.junction.bend[1]:
            movers.person(pile, replace(kerb.frame(s, BUILDING_LINE_M - 0.45), yaw=yaw), rng, 0.0)


def _at_junction(kerb: Kerb, rng: np.random.Generator, *, town: bool) -> None:
    """Lights or signs before the junction, bollards beside the crossing."""
    plan = kerb.plan
    side = kerb.side
    if plan.junction is None or plan.crossing is None:
        return
    s = plan.junction.bend[0] - 0.9 if side.side < 0 else plan.junction.bend[1] + 0.9
    if kerb.claim(s, 0.5):
        frame = kerb.frame(s, ROAD_HALF_M + 0.6)
        facing = (
            frame if side.side < 0 else replace(frame, yaw=frame.yaw + np.pi, mirror=-frame.mirror)
        )
        if town:
            furniture.traffic_light(kerb.pile, facing, arm=plan.character == "boulevard")
        else:
            furniture.sign(kerb.pile, facing, rng)
    if rng.random() < 0.6:
        low, high = plan.crossing
        for s in (low - 1.9, low - 0.9, high + 0.9, high + 1.9):
            if kerb.claim(s, 0.2):
                furniture.bollard(kerb.pile, kerb.frame(s, ROAD_HALF_M + 0.4))


def _trees(kerb: Kerb, rng: np.random.Generator) -> None:
    """Street trees in the strip at the curb, as wide as the facades behind them allow."""
    share = min(kerb.params.trees * _TREES[kerb.plan.character], 0.97 * (kerb.params.trees > 0))
    kind = trees.AVENUE if kerb.plan.character == "boulevard" else trees.STREET
    for i in range(4):
        s = kerb.plan.start + 7.5 * (i + 0.5) + rng.uniform(-0.8, 0.8)
        wanted = rng.random() < share
        birch = rng.random() < 0.2
        if not wanted or not kerb.claim(s, 0.6):
            continue
        near = [
            lot.setback
            for lot in kerb.side.lots
            if lot.span[0] - 2 < s < lot.span[1] + 2 and lot.kind != "yard"
        ]
        room = BUILDING_LINE_M + min(near, default=4.0) - _STRIP_M - 0.25
        wide = kerb.params.canopies > 0 and kerb.variety.random() < kerb.params.canopies
        if wide:
            species = trees.CANOPY
        else:
            species = trees.BIRCH if birch else kind
        trees.tree(
            kerb.pile, kerb.frame(s, _STRIP_M), species, rng, max(room, 3.5) if wide else room
        )


def _garden(kerb: Kerb, lot: Lot, rng: np.random.Generator) -> None:
    """Boundary, trees, bushes and the car of a garden or yard."""
    low, high = lot.span
    middle = 0.5 * (low + high)
    yard = lot.kind == "yard"
    if not yard and lot.setback < 1.5:
        return
    gaps = [lot.driveway] if lot.driveway is not None else []
    if lot.kind != "yard":
        gaps.append((middle - 2.0, middle - 0.8))
    depth = 14.0 if yard else lot.setback
    if kerb.params.side_on > 0 and depth > 3.4 and kerb.variety.random() < kerb.params.side_on:
        _forecourt(kerb, lot, depth)
        return
    furniture.boundary(
        kerb.pile,
        lambda s: kerb.frame(s, BUILDING_LINE_M),
        (low + 0.05, high - 0.05),
        gaps,
        rng,
        _boundary(kerb),
    )
    for share in (0.22, 0.55):
        wanted = rng.random() < kerb.params.trees
        away = rng.uniform(0.4, 0.6)
        room = min(away * depth - 0.7, (1.0 - away) * depth - 0.4, 4.0)
        s = low + share * (high - low) + (0.0 if yard else 0.5)
        if wanted and room > 0.9 and not any(gap[0] - 0.6 < s < gap[1] + 0.6 for gap in gaps):
            kind = trees.STREET if yard and rng.random() < 0.4 else trees.GARDEN
            trees.tree(kerb.pile, kerb.frame(s, BUILDING_LINE_M + away * depth), kind, rng, room)
        elif (
            rng.random() < 0.6
            and depth > 2.4
            and not any(gap[0] - 1.0 < s < gap[1] + 1.0 for gap in gaps)
        ):
            radius = min(rng.uniform(0.4, 0.9), 0.4 * depth)
            trees.bush(kerb.pile, kerb.frame(s, BUILDING_LINE_M + 0.55 * depth), radius, rng)
    junction = kerb.side.junction
    built_up = junction is not None and abs(junction.s - middle) < 24.0
    if lot.kind == "house" and not built_up and rng.random() < kerb.params.trees:
        trees.tree(
            kerb.pile,
            kerb.frame(low + 2.5, BUILDING_LINE_M + lot.setback + 17.0),
            trees.STREET,
            rng,
        )
    if lot.driveway is not None and rng.random() < 0.4:
        model = movers.draw_model(rng)
        s = 0.5 * sum(lot.driveway)
        d = BUILDING_LINE_M + 0.8 + model.half + max(0.0, lot.setback - 2.0)
        frame = frame_at(kerb.ground, s, kerb.side.side * d, tilted=True)
        fall = float(kerb.ground.line.side_slope(np.array([s]), kerb.side.side)[0])
        # the bonnet points into the garden: u away from the street, v along it
        yaw = frame.yaw + kerb.side.side * 0.5 * np.pi
        turned = replace(frame, yaw=yaw, slope=fall, roll=-kerb.side.side * frame.slope)
        movers.car(kerb.pile, turned, model)


def _boundary(kerb: Kerb) -> Literal["any", "hedge", "fence"]:
    if kerb.params.fences == 0 and kerb.params.hedges == 0:
        return "any"
    fence, hedge = kerb.variety.random(2).tolist()
    if fence < kerb.params.fences:
        return "fence"
    return "hedge" if hedge < kerb.params.hedges else "any"


def _forecourt(kerb: Kerb, lot: Lot, depth: float) -> None:
    """Park cars in front of a house or on a yard, open to the street and along it."""
    low, high = lot.span
    away = BUILDING_LINE_M + 1.3 + float(kerb.variety.random()) * (min(depth, 9.0) - 2.6)
    for i in range(int((high - low) / 6.0)):
        model = movers.draw_model(kerb.variety, kerb.params.vans)
        u = kerb.variety.random(2).tolist()
        if u[0] > 0.8:
            continue
        s = low + 6.0 * i + 3.0 + 0.3 * u[1]
        frame = frame_at(kerb.ground, s, kerb.side.side * away, tilted=True)
        roll = float(kerb.ground.line.side_slope(np.array([s]), kerb.side.side)[0])
        movers.car(kerb.pile, replace(frame, roll=kerb.side.side * roll), model)


def _wires(
    pile: Pile,
    ground: Ground,
    plan: Plan,
    params: StreetSceneParams,
    seed: int,
) -> None:
    """Overhead wires of some blocks without tall houses."""
    side = _wired(seed, plan.piece, params.character)
    if not side:
        return
    last = plan.piece % PIECES_IN_BLOCK == PIECES_IN_BLOCK - 1
    ends = [
        frame_at(ground, s, side * (ROAD_HALF_M + 1.05), side)
        for s in (plan.start, plan.start + PIECE_M)
    ]
    furniture.pole(pile, ends[0])
    furniture.wires(pile, ends[0], ends[1])
    if last and _wired(seed, plan.piece + 1, params.character) != side:
        furniture.pole(pile, ends[1])


def _wired(seed: int, piece: int, choice: str) -> int:
    """Side of the street on which poles stand, 0 = none."""
    rng = generator(seed, Purpose.WIRES, piece // PIECES_IN_BLOCK)
    chance = rng.random()
    side = 1 if rng.random() < 0.5 else -1
    fitting = character_of(seed, piece, choice) in ("residential", "suburb")
    return side if fitting and chance < 0.6 else 0
