"""Parameters of a street, and its plan by pieces: junctions, lots, driveways, crossings."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np
from pydantic import Field

from prc_cli.core.config import Params
from prc_cli.simulation.street.pile import Span

Character = Literal["residential", "terraces", "suburb", "boulevard"]
"""Character of a stretch of street."""
CHARACTERS: tuple[Character, ...] = ("residential", "terraces", "suburb", "boulevard")


class StreetSceneParams(Params):
    """A street of any length and the objects along it."""

    character: Literal["mixed", "residential", "terraces", "suburb", "boulevard"] = Field(
        "mixed", description="what the street is like; mixed = it changes along its length"
    )
    curves: float = Field(
        1.0, ge=0, le=1.5, description="factor on the curves; 0 = a straight street"
    )
    hills: float = Field(1.0, ge=0, le=2, description="factor on the slopes; 0 = a level street")
    setback_m: float = Field(
        0.0, ge=0, le=25, description="how much farther back facades stand than usual [m]"
    )
    trees: float = Field(0.6, ge=0, le=1, description="share of the places for trees that have one")
    parked: float = Field(0.7, ge=0, le=1, description="share of the parking places that are taken")
    people: float = Field(0.5, ge=0, le=1, description="how busy the sidewalks are")
    cars_per_km: float = Field(
        8.0, ge=0, le=40, description="oncoming cars on a kilometre of street [1/km]"
    )
    verges: float = Field(
        0.0,
        ge=0,
        le=1,
        description="share of the block sides with a raised verge, edged by stones of 5 to 9 cm",
    )
    lowered_kerbs: float = Field(
        0.0,
        ge=0,
        le=1,
        description="share of the block sides with a kerb of 3 cm, behind which cars are parked",
    )
    vans: float = Field(0.12, ge=0, le=1, description="share of vans among the parked cars")
    fences: float = Field(
        0.0, ge=0, le=1, description="share of the gardens and yards with a close fence or a wall"
    )
    hedges: float = Field(
        0.0, ge=0, le=1, description="share of the other gardens and yards with a hedge"
    )
    canopies: float = Field(
        0.0,
        ge=0,
        le=1,
        description="share of the street trees whose crowns reach over the road, above 45 degrees",
    )
    side_on: float = Field(
        0.0,
        ge=0,
        le=1,
        description="share of the wide lots with cars parked along the street, 10 to 20 m from it",
    )


VARIED: dict[str, float] = {
    "verges": 0.4,
    "lowered_kerbs": 0.4,
    "vans": 0.2,
    "fences": 0.35,
    "hedges": 0.35,
    "canopies": 0.35,
    "side_on": 0.5,
    "cars_per_km": 20.0,
}
"""Parameters of a street with every object that the sequential-angle method confuses."""

PIECE_M = 30.0
"""Length of a piece [m]."""
PIECES_IN_BLOCK = 4
"""A block has one junction and one character."""
ROAD_HALF_M = 5.5
"""Crown to curb [m]: a lane of 3.3 m and 2.2 m for parking."""
BUILDING_LINE_M = 8.8
"""Crown to the back of the sidewalk [m]."""
CORNER_M = 3.0
"""Radius of the curb around the corner of a side street [m]."""
DROP_M = 0.6
"""Way along the street in which a curb drops [m]."""
SIDE_WALK_M = 2.5
"""Width of the sidewalks of side streets [m]; less than the radius, so that corners have room."""


class Purpose(IntEnum):
    """Purpose of random numbers; every purpose and place has its own generator."""

    LINE = 0
    BLOCK = 1
    BORDER = 2
    LOTS = 3
    HOUSES = 4
    FURNITURE = 5
    PARKED = 6
    TREES = 7
    GARDENS = 8
    MOVERS = 9
    WIRES = 10
    KERBSIDE = 11
    VARIETY = 12


def generator(
    seed: int,
    purpose: Purpose,
    number: int = 0,
    side: int = 1,
) -> np.random.Generator:
    """Return the generator of a purpose at a place (piece, block, car)."""
    place = (int(purpose) * 2 + (side > 0)) * 2**56 + number + 2**40
    return np.random.Generator(np.random.Philox(key=np.array([seed, place], dtype=np.uint64)))


@dataclass(frozen=True, slots=True)
class Junction:
    """Mouth of a side street."""

    s: float
    half: float
    """Half of the width of its road [m]."""
    left: bool
    right: bool

    def on(self, side: int) -> bool:
        """Whether a side street leaves on this side (1 = left)."""
        return self.left if side > 0 else self.right

    @property
    def open(self) -> Span:
        """Between the facades [m]."""
        reach = self.half + SIDE_WALK_M
        return self.s - reach, self.s + reach

    @property
    def bend(self) -> Span:
        """Between the beginnings of the curbs' bends [m]."""
        reach = self.half + CORNER_M
        return self.s - reach, self.s + reach


@dataclass(frozen=True, slots=True)
class Lot:
    """A stretch of one side, behind the sidewalk."""

    span: Span
    kind: str
    """'terrace', 'house', 'block', 'passage' or 'yard'."""
    setback: float
    """Of the facade behind the building line [m]."""
    driveway: Span | None
    """Stretch in which cars cross the sidewalk [m]."""


@dataclass(frozen=True, slots=True)
class Side:
    """One side of a piece."""

    side: int
    """1 = left, -1 = right."""
    junction: Junction | None
    lots: tuple[Lot, ...]
    dropped: tuple[Span, ...]
    """Stretches with a low curb [m]."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Contents of a piece."""

    piece: int
    start: float
    """Distance along the street of its beginning [m]."""
    character: Character
    junction: Junction | None
    crossing: Span | None
    sides: tuple[Side, Side]


def character_of(seed: int, piece: int, choice: str) -> Character:
    """Return the character of the stretch around a piece."""
    for name in CHARACTERS:
        if choice == name:
            return name
    rng = generator(seed, Purpose.BLOCK, piece // PIECES_IN_BLOCK)
    return CHARACTERS[int(rng.integers(len(CHARACTERS)))]


def plan_of(
    seed: int,
    piece: int,
    choice: str,
    setback_m: float = 0.0,
) -> Plan:
    """Lay out a piece."""
    start = piece * PIECE_M
    character = character_of(seed, piece, choice)
    junction = junction_of(seed, piece)
    crossing = None
    if junction is not None:
        early = junction.s < start + 0.5 * PIECE_M
        # its ramps end where the curb begins to bend
        end = junction.bend[1] + DROP_M if early else junction.bend[0] - DROP_M - 2.5
        crossing = (end, end + 2.5)
    left, right = (
        _side(seed, piece, side, character, junction, crossing, setback_m) for side in (1, -1)
    )
    return Plan(piece, start, character, junction, crossing, (left, right))


def junction_of(seed: int, piece: int) -> Junction | None:
    """Return the junction of a piece, if it has one: one in four has."""
    rng = generator(seed, Purpose.BLOCK, piece // PIECES_IN_BLOCK, side=-1)
    which = int(rng.integers(1, 3))
    shift = rng.uniform(-4, 4)
    half = rng.uniform(3.2, 4.2)
    sides = rng.integers(3)
    if piece % PIECES_IN_BLOCK != which:
        return None
    return Junction(
        (piece + 0.5) * PIECE_M + shift, half, left=bool(sides != 1), right=bool(sides != 0)
    )


def _border(seed: int, piece: int, side: int) -> float:
    return piece * PIECE_M + float(generator(seed, Purpose.BORDER, piece, side).uniform(-2.5, 2.5))


def _side(
    seed: int,
    piece: int,
    side: int,
    character: Character,
    junction: Junction | None,
    crossing: Span | None,
    setback_m: float,
) -> Side:
    rng = generator(seed, Purpose.LOTS, piece, side)
    low = _border(seed, piece, side)
    high = _border(seed, piece + 1, side)
    side_street = junction if junction is not None and junction.on(side) else None
    stretches = (
        [(low, high)]
        if side_street is None
        else [(low, side_street.open[0]), (side_street.open[1], high)]
    )
    lots = [lot for stretch in stretches for lot in _lots(rng, stretch, character)]
    dropped = [lot.driveway for lot in lots if lot.driveway is not None]
    if side_street is not None:
        dropped = [
            d
            for d in dropped
            if d[1] < side_street.bend[0] - 0.8 or d[0] > side_street.bend[1] + 0.8
        ]
    if crossing is not None:
        dropped = [d for d in dropped if d[1] < crossing[0] - 1.6 or d[0] > crossing[1] + 1.6] + [
            crossing
        ]
    # low curbs and their ramps stay within the piece, so that pieces meet at whole curbs
    start = piece * PIECE_M
    dropped = [d for d in dropped if d[0] > start + 0.9 and d[1] < start + PIECE_M - 0.9]
    kept = tuple(
        Lot(
            lot.span,
            lot.kind,
            lot.setback + setback_m,
            lot.driveway if lot.driveway in dropped else None,
        )
        for lot in lots
    )
    return Side(side, side_street, kept, tuple(sorted(dropped)))


_WIDTHS: dict[Character, Span] = {
    "terraces": (6.0, 11.0),
    "residential": (9.0, 15.0),
    "suburb": (13.0, 18.0),
    "boulevard": (11.0, 18.0),
}


def _lots(rng: np.random.Generator, stretch: Span, character: Character) -> list[Lot]:
    """Share a stretch among lots of roughly equal width."""
    low, high = stretch
    width = rng.uniform(*_WIDTHS[character])
    count = max(1, round((high - low) / width))
    cuts = low + (high - low) * np.arange(count + 1) / count
    cuts[1:-1] += rng.uniform(-1.0, 1.0, count - 1)
    lots = []
    for u0, u1 in zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True):
        kind, setback = _kind(rng, character, u1 - u0)
        driveway = None
        if kind in ("house", "yard") and u1 - u0 > 8 and rng.random() < 0.7:
            driveway = (u1 - 3.3, u1 - 0.6)
        elif kind == "passage":
            driveway = (0.5 * (u0 + u1) - 1.4, 0.5 * (u0 + u1) + 1.4)
        lots.append(Lot((u0, u1), kind, setback, driveway))
    return lots


def _kind(rng: np.random.Generator, character: Character, width: float) -> tuple[str, float]:
    chance = rng.random()
    depth = rng.random()
    if character == "terraces":
        setback = 0.0 if depth < 0.7 else 0.3
        if chance < 0.08:
            return "passage", setback
        return ("yard" if chance < 0.14 else "terrace"), setback
    if character == "suburb":
        return ("yard" if chance < 0.15 or width < 8 else "house"), 3.5 + 3.0 * depth
    if character == "boulevard":
        if chance < 0.5:
            return ("yard" if chance < 0.1 else "terrace"), 0.0
        return "block", 2.5
    if chance < 0.35:
        return "terrace", 0.0
    setback = 2.0 + 2.0 * depth
    if chance < 0.5 or width < 8:
        return "yard", setback
    return ("house" if chance < 0.8 else "block"), setback


def kerbside_of(seed: int, piece: int, side: int) -> Span:
    """Return two random numbers of a side of a block, for its kerb and its verge."""
    low, raised = (
        generator(seed, Purpose.KERBSIDE, piece // PIECES_IN_BLOCK, side).random(2).tolist()
    )
    return low, raised
