"""What can be chosen about a street."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from prc_cli.core.config import Params

Character = Literal["residential", "terraces", "suburb", "boulevard"]
"""What a stretch of street is like."""
CHARACTERS: tuple[Character, ...] = ("residential", "terraces", "suburb", "boulevard")


class StreetSceneParams(Params):
    """A street of any length and the objects along it."""

    character: Literal["mixed"] | Character = Field(
        "mixed", description="what the street is like; mixed = it changes along its length"
    )
    curves: float = Field(1.0, ge=0, le=1.5, description="factor on the curves; 0 = a straight street")
    hills: float = Field(1.0, ge=0, le=2, description="factor on the slopes; 0 = a level street")
    setback_m: float = Field(0.0, ge=0, le=25, description="how much farther back facades stand than usual [m]")
    trees: float = Field(0.6, ge=0, le=1, description="share of the places for trees that have one")
    parked: float = Field(0.7, ge=0, le=1, description="share of the parking places that are taken")
    people: float = Field(0.5, ge=0, le=1, description="how busy the sidewalks are")
    cars_per_km: float = Field(8.0, ge=0, le=40, description="oncoming cars on a kilometre of street [1/km]")
    verges: float = Field(
        0.0, ge=0, le=1, description="share of the block sides with a raised verge, edged by stones of 5 to 9 cm"
    )
    lowered_kerbs: float = Field(
        0.0, ge=0, le=1, description="share of the block sides with a kerb of 3 cm, behind which cars are parked"
    )
    vans: float = Field(0.12, ge=0, le=1, description="share of vans among the parked cars")
    fences: float = Field(0.0, ge=0, le=1, description="share of the gardens and yards with a close fence or a wall")
    hedges: float = Field(0.0, ge=0, le=1, description="share of the other gardens and yards with a hedge")
    canopies: float = Field(
        0.0, ge=0, le=1, description="share of the street trees whose crowns reach over the road, above 45 degrees"
    )
    side_on: float = Field(
        0.0, ge=0, le=1, description="share of the wide lots with cars parked along the street, 10 to 20 m from it"
    )


VARIED: dict[str, float] = {
    "verges": 0.4, "lowered_kerbs": 0.4, "vans": 0.2, "fences": 0.35, "hedges": 0.35, "canopies": 0.35,
    "side_on": 0.5, "cars_per_km": 20.0,
}  # fmt: skip
"""Parameters of a street with something of everything that the sequential-angle method is known to mistake."""
