"""All limits of the method for rings, by name.

The loops and ``prc explain`` read them.

The loops compute in float64. design/rings.md says what the limits were chosen on.
"""

from __future__ import annotations

import math
from typing import NamedTuple

BINS_PER_ROOT_M = 3.5
"""Bins of the distance from the scanner, per square root of a metre.

1.3 m wide at 5 m, 4 m at 50 m.
"""
N_BINS = 38
"""Bins: 118 m."""


class GroundThresholds(NamedTuple):
    """How the ground is found, in sectors of azimuth and bins of distance."""

    sector_rad: float = math.radians(4.0)
    """Width of a sector [rad]."""
    pair_m: float = 0.15
    """The lowest heights of a cell that differ by less are no stray returns [m]."""
    plane_m: float = 0.15
    """Lowest heights this near to a plane agree with it [m]."""
    step_m: float = 0.15
    """Greatest step in height from one cell to the next, over what is expected [m] ..."""
    rise: float = 0.08
    """... plus this much per metre upwards ..."""
    fall: float = 0.12
    """... and this much downwards ..."""
    gap_m: float = 12.0
    """... over this distance at most [m]."""
    slope: float = 0.2
    """Greatest slope that the walk goes on with."""
    follow_m: float = 5.0
    """Distance over which a new slope weighs as much as the one so far [m] ..."""
    follow: float = 0.6
    """... and its greatest weight."""
    far_m: float = 8.0
    """A slope is expected to go on for this distance at most [m]."""
    stiff: float = 0.5
    """Weight of each of the four cells around, against the heights of the cell itself."""
    near_m: float = 0.2
    """Shots this near to the ground correct it [m] ..."""
    near_per_m: float = 0.004
    """... plus this per metre of distance."""
    shots: float = 3.0
    """So many shots weigh as much as the lowest heights of a cell ..."""
    most: float = 4.0
    """... and this often at most."""


class MarkThresholds(NamedTuple):
    """What a shot is: smooth, upright, level, alone."""

    base_m: float = 0.2
    """Distance to the two shots along the ring that a shot is compared with [m]."""
    most_lines: int = 12
    """Most lines to them."""
    chord_m: float = 1.0
    """The two are at most so far apart [m] ..."""
    chord_steps: float = 8.0
    """... or so many distances between their lines."""
    smooth_m: float = 0.02
    """A smooth shot is this near to the line through the two [m] ..."""
    smooth_per_m: float = 0.0006
    """... plus this per metre of distance."""
    upright: float = 0.35
    """Rings meet an upright surface if they differ less in distance than by this share of height
    ..."""
    upright_m: float = 0.05
    """... plus this [m]."""
    level: float = 0.35
    """They meet a level one if they differ in height by less than this share of their distance."""


class LonelyThresholds(NamedTuple):
    """What snow, rain and dust are: shots near the scanner that nothing is beside."""

    reach_m: float = 25.0
    """Flakes are seen up to here [m]."""
    near_m: float = 0.2
    """Greatest difference in range to a shot that is near [m] ..."""
    near_per_m: float = 0.01
    """... plus this per metre of range."""
    most: float = 2.0
    """Most near shots of a flake, of 34 around ..."""
    unlit: float = 1.0
    """... where no intensity is known."""
    alike: float = 0.1
    """Shots are as bright if their intensities differ by less than this share ..."""
    beside_m: float = 2.0
    """... and they by less than this in range [m]."""
    bright: float = 3.0
    """What more shots around are as bright as, itself among them, is no flake."""


class SunkenThresholds(NamedTuple):
    """What mirror images below a wet road are: shots below the ground, alone there."""

    below_m: float = 0.4
    """They are so far below the ground [m] ..."""
    below_per_m: float = 0.01
    """... plus this per metre of distance."""
    lines: int = 5
    rings: int = 2
    """Shots this far away are around a shot."""
    most: float = 0.5
    """Where more of those around are below as well, there is lower ground."""


class CellThresholds(NamedTuple):
    """Columns of space of equal width, and the objects in them."""

    cell_m: float = 0.5
    """Width of a cell [m]."""
    half_m: float = 100.0
    """Cells reach so far from the scanner [m]."""
    foot_m: float = 0.25
    """What stands in a cell is higher than this above the ground [m]."""
    hem_m: float = 0.12
    """Shots higher than this are part of the object in their cell [m]."""
    gap_m: float = 0.75
    """Objects above a wider gap hang over the cell and do not count [m]."""
    storey_m: float = 0.25
    """Height of a level of a cell [m]; it has 62."""


class LeafThresholds(NamedTuple):
    """Foliage and walls, by a linear score of the cells around; it is foliage above zero."""

    bias: float = 10.5
    smooth: float = -5.9
    """Of the share of smooth shots, in 5 x 5 cells."""
    thick: float = 13.0
    """Of the thickness of what is in 3 x 3 cells, seen from above (standard deviation) [1/m]."""
    most_thick_m: float = 0.4
    """Thicker things count as this thick [m]."""
    upright: float = -4.0
    """Of the share of shots on upright surfaces, in 3 x 3 cells."""
    filled: float = -5.4
    """Of the share of levels with shots up to the highest, in 5 x 5 cells."""
    top: float = -1.1
    """Of the highest shot in 5 x 5 cells [1/m] ..."""
    most_top_m: float = 8.0
    """... up to here [m]."""
    surest: float = 4.0
    """Scores beyond count as this, in the mean of 5 x 5 cells that decides."""


class BoxThresholds(NamedTuple):
    """A vehicle: a body of its size that stands alone, and whose top is seen."""

    body_m: float = 2.25
    """Cells whose body reaches higher are no part of it [m]."""
    least_top_m: float = 0.8
    most_top_m: float = 1.5
    """Height of its top [m]."""
    most_share: float = 0.9
    """So many of its shots are in cells up to its top."""
    seen_m: float = 0.3
    """Rings pass over its top by this, at least [m]."""
    least_m: float = 1.0
    most_m: float = 7.5
    """Its length [m]."""
    narrow_m: float = 0.45
    wide_m: float = 2.7
    """Its width [m]."""
    smooth: float = 0.05
    most_smooth: float = 1.0
    """Share of its smooth shots."""
    upright: float = 0.1
    """Least share of shots on upright surfaces."""
    shots: int = 8
    """Fewest shots."""
    squat: float = 0.6
    """Its length is this share of its height, at least."""


class PoleThresholds(NamedTuple):
    """What a pole is: thin to all sides, and alone."""

    thin_m: float = 0.18
    """Standard deviation along what is in 3 x 3 cells, at most [m]."""
    least_m: float = 1.5
    """Least height [m]."""
    around: int = 5
    """Most cells with something in them, of 5 x 5."""
    shots: int = 4
    """Fewest shots."""


class SoilThresholds(NamedTuple):
    """Plants and bare ground among low shots, by a linear score of the places around.

    Plants are above zero.
    """

    foot_m: float = 0.25
    """Shots up to this above the ground are asked [m] ..."""
    below_m: float = -0.4
    """... and down to this [m]."""
    half_m: float = 40.0
    """They are asked up to so far from the scanner, in cells [m] ..."""
    cell_m: float = 0.5
    """... of this width [m]; those around count as well, 3 x 3."""
    shots: float = 3.0
    """With fewer shots, and farther away, what is higher than ... [m]"""
    soil_m: float = 0.12
    """... this is a plant."""
    bias: float = -1.2
    smooth: float = -6.6
    """Of the share of smooth shots."""
    rough: float = 59.0
    """Of the standard deviation of heights [1/m] ..."""
    most_rough_m: float = 0.15
    """... up to here [m]."""
    high: float = 30.0
    """Of the height above the ground [1/m] ..."""
    least_high_m: float = -0.1
    """... from here on [m]."""
    far: float = -0.12
    """Of the distance from the scanner [1/m]."""


class Limits(NamedTuple):
    """All limits."""

    ground: GroundThresholds = GroundThresholds()
    marks: MarkThresholds = MarkThresholds()
    lonely: LonelyThresholds = LonelyThresholds()
    sunken: SunkenThresholds = SunkenThresholds()
    cells: CellThresholds = CellThresholds()
    leaves: LeafThresholds = LeafThresholds()
    cars: BoxThresholds = BoxThresholds()
    vans: BoxThresholds = BoxThresholds(
        least_top_m=1.5, most_top_m=2.3, smooth=0.27, most_smooth=0.64, upright=0.4
    )
    lorries: BoxThresholds = BoxThresholds(
        body_m=3.75,
        least_top_m=2.3,
        most_top_m=3.6,
        seen_m=-0.35,
        least_m=2.5,
        most_m=12.0,
        narrow_m=0.45,
        wide_m=3.2,
        smooth=0.3,
        most_smooth=0.64,
        upright=0.4,
        shots=30,
    )
    poles: PoleThresholds = PoleThresholds()
    soil: SoilThresholds = SoilThresholds()


MANY = Limits()
"""Limits for 64 rings and more."""
FEW = Limits(
    soil=SoilThresholds(bias=2.0, rough=20.0), cars=BoxThresholds(smooth=0.04, narrow_m=0.38)
)
"""Limits for 16 to 40 rings: the shots of a place are of one or two rings, whose heights differ
less, and see less of a car."""
