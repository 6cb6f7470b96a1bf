"""Arrays and numbers of the fused classifier that belong together, by name, with shapes and units.

The stages hand these records to the loops. A loop makes the same records of single lines, (M,)
arrays, with the rows of its arrays.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32, F32_1, F32_2, I32, I32_1, I32_2, U8, U8_2, U32, U64_2, Mask

STRIPS = 320
"""Number of strips beside the scanner, half of them on either side."""
STRIP_M = np.float32(0.5)
"""Width of a strip [m]."""
SLOTS = 64
"""Slots of a strip, from the ground up. The last one holds everything higher."""
SLOT_M = np.float32(0.25)
"""Height of a slot [m]."""
POST, THIN, SHORT, FEW_SHOTS, MAST, SMALL, FENCE = (np.uint8(kind) for kind in range(1, 8))
"""Kinds of free-standing things, 0 = none.

A trunk or post; a thin piece and a short piece, which may be of one; a piece of few shots;
a mast; something small and low, as people; a part of a fence. """
LORRY_BIN = 16
"""Counts of level bins count the bins of a body that hangs high once more, times this."""


class Neighbours(NamedTuple):
    """Neighbourhood counts of every shot, for the inner lines of a window."""

    near: U8_2
    """(lines, M) uint8, near neighbours, of 28."""
    smooth: U8_2
    """(lines, M) uint8, pairs of neighbours that lie on a smooth surface with the shot, of 10."""
    upright: U8_2
    """(lines, M) uint8, upright chords through the shot, of 3."""
    level: U8_2
    """(lines, M) uint8, level chords through the shot, of 3."""

    def of_lines(self, lines: slice) -> Neighbours:
        """Return the counts of some lines."""
        return Neighbours(
            self.near[lines], self.smooth[lines], self.upright[lines], self.level[lines]
        )


class Beams(NamedTuple):
    """Beam directions within the scan plane."""

    sine: F32_1
    """(M,) float32, metres to the side per metre of range; the sign is the side."""
    cosine: F32_1
    """(M,) float32, metres down per metre of range."""


class FilledSlots(NamedTuple):
    """Heights above the ground at which something is, one bit for every slot of a strip."""

    by_any: U64_2
    """(lines, STRIPS) uint64, slots with any shot."""
    by_rough: U64_2
    """(lines, STRIPS) uint64, slots with rough shots."""

    def of_lines(self, lines: slice) -> FilledSlots:
        """Return the slots of some lines."""
        return FilledSlots(self.by_any[lines], self.by_rough[lines])


class Walls(NamedTuple):
    """Walls beside every line; distances are negative on the negative side, 0 = no wall."""

    side_m: F32_2
    """(lines, STRIPS) float32, distance of the wall in or before a strip [m]."""
    top_m: F32_2
    """(lines, STRIPS) float32, height of the top of that wall above the scanner [m]."""
    ahead_m: F32_2
    """(lines, STRIPS) float32, distance of the wall in a strip or close behind it [m]."""

    def of_lines(self, lines: slice) -> Walls:
        """Return the walls of some lines."""
        return Walls(self.side_m[lines], self.top_m[lines], self.ahead_m[lines])


class StripSums(NamedTuple):
    """What stands in the strips of every line, added up over its shots, (lines, STRIPS) float32."""

    length_m: F32_2
    """Height of everything [m]."""
    wall_m: F32_2
    """Height of smooth upright surfaces [m]."""
    wall_place: F32_2
    """The same times the distance to the side; divided by ``wall_m``, where the surface is [m2]."""
    top_m: F32_2
    """Height of the top of these surfaces above the scanner [m]."""


class Sides(NamedTuple):
    """Columns on either side of the scanner, from straight down to straight up."""

    left: I32_1
    """(n,) int32, columns of the positive side."""
    right: I32_1
    """(n,) int32, columns of the negative side."""


class WalkMemory(NamedTuple):
    """Ground that the walk remembers from earlier lines, left and right."""

    height_m: F32_2
    """(2, BINS) float32, ground height by bin [m]."""
    age: I32_2
    """(2, BINS) int32, lines since the bin was last seen."""
    level_shots: F32_2
    """(2, DEPTHS) float32, level shots near the scanner, and all, since a bin was known."""
    level_m: F32_2
    """(2, DEPTHS) float32, sums of their heights [m]."""


class WalkStart(NamedTuple):
    """Where a walk along the ground starts if its side is not known."""

    start_m: float
    """Height of the nearest known bins of earlier lines [m].

    Where the ground was hidden for long (by a lorry, or a gap in the stream), a walk from the
    scanner's height would not reach it in small steps."""
    lost: int
    """Lines with level shots since any bin was known; below 0 = none ever was."""
    missed: int
    """Lines in a row in which level shots near the scanner lie below the known ground."""


class GroundMemory(NamedTuple):
    """Ground from earlier lines."""

    bins: WalkMemory
    start: WalkStart


class Points(NamedTuple):
    """Points of a line in the scan plane, (M,) float32."""

    side_m: F32
    """Distance to the side; the sign is the side [m]."""
    height_m: F32
    """Height above the scanner, or another height [m]."""


class VotingLine(NamedTuple):
    """A line whose shots vote, (M,) arrays."""

    side_m: F32
    """Distance to the side in the scan plane [m]."""
    height_m: F32
    """Height above the scanner in the scan plane [m]."""
    votes: U32
    """Vote of every shot, in its label's part of the word."""


class FiveLines(NamedTuple):
    """The same array of a line and of two lines before and after it, (M,) each."""

    second_before: NDArray[Any]
    before: NDArray[Any]
    middle: NDArray[Any]
    after: NDArray[Any]
    second_after: NDArray[Any]


class Line(NamedTuple):
    """A scan line, as the decision reads it; arrays are (M,)."""

    range_m: F32
    """Ranges [m], NaN = missing."""
    side_m: F32
    """Distance to the side in the scan plane; the sign is the side [m]."""
    height_m: F32
    """Height above the scanner in the scan plane [m]."""
    above_m: F32
    """Height above the ground in the scan plane [m]."""
    near: U8
    """As in :class:`Neighbours`, with the three that follow."""
    smooth: U8
    upright: U8
    level: U8
    is_walked: Mask
    """Shots that the walk along the ground went over."""
    texture: F32
    """Share of smooth pairs around every shot, 0 to 1: foliage has few."""
    kind: U8
    """Kind of free-standing thing that a shot is on, 0 = none."""


class Beside(NamedTuple):
    """Walls and cars in the strip of every shot of a line, (M,) arrays; 0 beyond the strips."""

    bin: I32
    """Half strip of the shot, -1 = beyond."""
    wall_m: F32
    """As ``side_m``, ``top_m`` and ``ahead_m`` of :class:`Walls`."""
    wall_top_m: F32
    wall_ahead_m: F32
    car_top_m: F32
    """Height above the ground up to which a shot in smooth surroundings is part of a car [m]."""
    rough_car_top_m: F32
    """The same of a shot in rough surroundings [m]."""


class Shot(NamedTuple):
    """A shot, as the rules read it; fields as in :class:`Line`."""

    range_m: np.float32
    side_m: np.float32
    height_m: np.float32
    above_m: np.float32
    near: np.uint8
    smooth: np.uint8
    upright: np.uint8
    level: np.uint8
    is_walked: bool
    texture: np.float32
    kind: np.uint8


class Place(NamedTuple):
    """Walls and cars in the strip of a shot; fields as in :class:`Beside`."""

    bin: int
    wall_m: np.float32
    wall_top_m: np.float32
    wall_ahead_m: np.float32
    car_top_m: np.float32
    rough_car_top_m: np.float32


class Around(NamedTuple):
    """What is around every shot of a line, (M,) bool each."""

    is_leaf: Mask
    """Few near it, rough shots at enough heights around, and no wall or facade."""
    is_amid_smooth: Mask
    """Everything around is smooth; known of shots without a smooth pair."""
    is_rough: Mask
    """Few pairs around are smooth: leaves, or the ornaments of a facade."""
    is_foliage: Mask
    """Rough, and neither in a wall nor seen through it: leaves."""
    is_in_car: Mask
    """Low, with level surfaces around that are wide enough for a car."""
    is_upright: Mask
    """It may be on a trunk, a post or an arm."""
    is_box: Mask
    """On a small box that is free on all sides."""
    is_below_crown: Mask
    """Upright, and rough shots are at enough heights above it."""
    is_thick: Mask
    """Upright, and as deep and round as a trunk."""


class CarTops(NamedTuple):
    """(2 STRIPS,) float32, height above ground of the top of a car, 0 = no car [m]."""

    smooth_m: F32
    """Shots in smooth surroundings."""
    rough_m: F32
    """Shots in rough surroundings."""
