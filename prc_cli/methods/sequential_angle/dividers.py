"""Intervals of a line that may be cars, cut at dividers (Stamos et al. 2012, sec. 7.3)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pydantic import Field, model_validator

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.types import F32, I32, U8
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import DividerThresholds


class DividersParams(Params):
    """Where a car begins and ends along a line (``[sequential_angle.car.dividers]``)."""

    sudden_from_deg: float = Field(
        -5.0,
        ge=-180,
        le=180,
        description="l1: a change from H to V at a signed angle below this is gradual [deg] (published)",
    )
    sudden_to_deg: float = Field(
        20.0,
        ge=-180,
        le=180,
        description="l2: so is one above this; gradual changes begin an interval [deg] (published)",
    )
    change_chord_m: float = Field(
        0.1, ge=0, le=10, description="that angle is measured to the first return at least this far away, ... [m]"
    )
    change_chord_sigmas: float = Field(
        8.0,
        ge=0,
        le=1000,
        description="... and at least this many times the range noise; published: both 0, the signed angle of "
        "the point itself",
    )
    change_reach: int = Field(
        200, ge=1, le=100_000, description="returns that are looked at for either end of that chord [returns]"
    )
    under_points: int = Field(
        30,
        ge=1,
        le=10_000,
        description="L: returns before a sudden change among which TestUnder looks [returns] (published)",
    )
    under_m: float = Field(
        0.01,
        ge=0,
        le=100,
        description="a return before that is farther away by more than this, ... [m] (published)",
    )
    under_sigmas: float = Field(
        6.0,
        ge=0,
        le=1000,
        description="... and by more than this many times the range noise, lies under the point, which then begins an "
        "interval; published: 0, the distance alone",
    )
    separation_m: float = Field(
        4.0, gt=0, le=1e4, description="t_sep: successive returns farther apart are two objects, ... [m] (published)"
    )
    return_points: int = Field(
        8,
        ge=0,
        le=100_000,
        description="... unless one of so many returns after the jump is back at the object: such jumps go through "
        "its windows; published: 0 [returns]",
    )
    from_start: bool = Field(
        True,
        description="a line that begins with V begins with an interval, because a car that stands close hides the "
        "ground before it; published: false",
    )
    flat_length_m: float = Field(
        3.0, gt=0, le=1e4, description="horizontal length from which a flat stretch is ground [m] (published)"
    )
    flat_residual_m: float = Field(
        0.05, gt=0, le=10, description="largest rms distance of its heights from a straight line [m]"
    )
    flat_slope_deg: float = Field(10.0, gt=0, lt=90, description="largest slope of that line [deg]")
    flat_step_m: float = Field(
        0.2,
        ge=0,
        le=1e3,
        description="a change of height from one return to the next that ends such a stretch, as from a bonnet to the "
        "road behind; published: 0, none does [m]",
    )
    flat_above_m: float = Field(
        1.0,
        ge=0,
        le=1e3,
        description="such a stretch ends no interval where it begins higher than this above the lowest return of the "
        "interval, as the roof of a car does; published: so large that it is off [m]",
    )
    height_m: float = Field(
        2.0,
        gt=0,
        le=1e3,
        description="t_height: cars are not sought above the first return this high over the ground [m] (published)",
    )
    tall_m: float = Field(
        2.6,
        ge=0,
        le=1e3,
        description="they are along a vertical run that goes on from below and ends no higher than this above the "
        "ground, as the side of a van does; published: 0, they are not [m]",
    )
    glass_m: float = Field(
        1.0,
        ge=0,
        le=1e3,
        description="dense vegetation does not end the search where the next return behind it is horizontal or "
        "vertical and no farther away than the last one before it by this: it is the window of a car; published: 0, "
        "it does [m]",
    )
    vertical_extent_m: float = Field(
        1.2, gt=0, le=1e3, description="runs of vertical points of this height or more are cut out, ... [m]"
    )
    vertical_top_m: float = Field(
        2.6,
        ge=0,
        le=1e3,
        description="... if they end higher than this above the ground, as no car does; 0 = wherever they end [m]",
    )
    vertical_lean_deg: float = Field(
        2.5, ge=0, le=45, description="or if they lean less than this from the vertical [deg]"
    )
    vertical_open: bool = Field(
        True,
        description="or if they go on to the last beam of the line, so that nothing tells where they end; "
        "published: false",
    )
    straight_points: int = Field(
        16,
        ge=1,
        le=100_000,
        description="fewer points do not show whether a run is straight or upright: their height decides [points]",
    )
    straight_extent_m: float = Field(
        0.25,
        ge=0,
        le=1e3,
        description="so are runs of this height or more that are straight and upright, as walls, fences and posts are "
        "and the sides of cars are not; 0 = none [m]",
    )
    straight_m: float = Field(
        0.01, ge=0, le=10, description="straight is what lies this near to a straight line, rms [m], ..."
    )
    straight_sigmas: float = Field(2.0, ge=0, le=1000, description="... or as many times the range noise")
    straight_lean_deg: float = Field(
        1.5, ge=0, le=45, description="upright is what leans less than this from the vertical [deg]"
    )
    relief_m: float = Field(
        0.03,
        ge=0,
        le=10,
        description="runs of vertical and horizontal points as high as vertical_extent_m and as upright, but only this "
        "straight (rms), are cut out too: walls with reliefs; published: 0, none is [m]",
    )
    lean_sigmas: float = Field(
        2.0,
        ge=0,
        le=1000,
        description="both leans may be larger by so many standard deviations of a lean, as the range noise makes it "
        "from so many points of such heights",
    )
    vertical_break_m: float = Field(
        0.5,
        ge=0,
        le=1e4,
        description="a change of horizontal distance from one return to the next that ends such a run [m]",
    )

    def thresholds(self, range_noise_m: float) -> DividerThresholds:
        """Return the thresholds of the kernels, for a standard deviation of the range [m]."""
        return DividerThresholds(
            height_m=self.height_m,
            tall_m=self.tall_m,
            glass_m=self.glass_m,
            sudden_from_deg=self.sudden_from_deg,
            sudden_to_deg=self.sudden_to_deg,
            chord_m=max(self.change_chord_m, self.change_chord_sigmas * range_noise_m),
            chord_reach=self.change_reach,
            under_points=self.under_points,
            under_m=max(self.under_m, self.under_sigmas * range_noise_m),
            separation_m=self.separation_m,
            return_points=self.return_points,
            from_start=self.from_start,
            flat_length_m=self.flat_length_m,
            flat_residual_m=self.flat_residual_m,
            flat_slope=math.tan(math.radians(self.flat_slope_deg)),
            flat_step_m=self.flat_step_m if self.flat_step_m > 0 else math.inf,
            flat_above_m=self.flat_above_m,
            vertical_extent_m=self.vertical_extent_m,
            vertical_break_m=self.vertical_break_m,
            vertical_top_m=self.vertical_top_m if self.vertical_top_m > 0 else -math.inf,
            vertical_slope=math.tan(math.radians(self.vertical_lean_deg)),
            vertical_open=self.vertical_open,
            straight_points=self.straight_points,
            straight_extent_m=self.straight_extent_m if self.straight_extent_m > 0 else math.inf,
            straight_residual_m=max(self.straight_m, self.straight_sigmas * range_noise_m),
            straight_slope=math.tan(math.radians(self.straight_lean_deg)),
            relief_m=self.relief_m,
            lean_noise_m=self.lean_sigmas * range_noise_m,
        )

    @model_validator(mode="after")
    def _check(self) -> DividersParams:
        if self.sudden_from_deg > self.sudden_to_deg:
            message = f"sudden_from_deg ({self.sudden_from_deg}) not above sudden_to_deg ({self.sudden_to_deg})"
            raise ValueError(message)
        return self


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """Parts of lines that may be cars: row, first beam, last beam, both of them returns; by row and beam."""

    divided: I32
    """(K, 3) int32, t1 and t2 of every interval."""
    pieces: I32
    """(L, 3) int32, v1 and v2 of what is left of them without long vertical runs."""


def dividers(
    lines: VerticalLines,
    car_surface: U8,
    signed_deg: F32,
    trigger: I32,
    z_g: F32,
    params: DividersParams,
    *,
    range_noise_m: float,
) -> Intervals:
    """Cut suspicious lines into intervals that may be cars.

    The search covers the whole line, not only the part from the trigger on, because the trigger often comes late on
    the car. It ends before the first point of T' (or without an angle) that is not seen through the window of a car,
    before the first point that is too high and not on the side of a van, or at the end of the line.

    1. An interval begins at the first change from H to V that is gradual (a tyre), or sudden with something farther
       away under it (bumper, side; not a wall, curb or pole that stands on the ground).
    2. A jump of more than ``separation_m`` away from the scanner ends it; the next interval begins behind the jump.
    3. If an interval contains a long flat stretch within one run of H, it ends at the first point of the stretch
       instead, and the search goes on as in 1. after its last point. A stretch is flat if a straight line fits its
       heights (so sloping ground counts) and the line is not steep (so a roof and the ground behind it are not one
       stretch), and if it begins low enough to be no roof. It may be part of a run, since only a jump separates such
       a roof from such ground.
    4. Runs of V with a height of ``vertical_extent_m`` or more are cut out. The height includes the part above the end
       of the search, as the interval holds only what is visible of a wall between the car's roof and ``height_m``. A
       run ends where the distance changes: the side of a car and the wall behind it are two surfaces. So are lower
       runs that are straight and upright, and rough walls, of which a part is H.

    ``car_surface`` (R, n) uint8; ``signed_deg`` (R, n) float32, degrees; ``trigger`` (R,) int32; ``z_g`` (R,) float32,
    metres.

    Notes
    -----
    Measured on simulated lines with exact labels: scanner 1.8 m above the ground, noise 5 mm, steps of 0.06 to
    0.2 deg, objects at 3 to 13 m. The test for something under a point succeeds for 100 % of the sides of cars with
    limits from 1 to 6 cm, and wrongly for up to 32 % of walls and curbs with 1 cm, 3 % with 2 cm, none with 3 cm:
    within 5 m the ranges of successive ground points differ by little more than the noise. Chords of 8, 10, 12 cm
    make .87, .92, .95 of walls sudden, and .03, .04, .11 of tyres; longer chords miss curbs.
    """
    thresholds = params.thresholds(range_noise_m)
    intervals = kernels.car_intervals(
        car_surface, lines.range_m, lines.xyz_m, lines.horizontal_m, signed_deg, lines.n_beams, trigger >= 0, z_g,
        thresholds,
    )  # fmt: skip
    left: I32 = kernels.cut_verticals(
        car_surface, lines.xyz_m, lines.horizontal_m, lines.n_beams, intervals, z_g, thresholds
    )
    return Intervals(intervals, left)
