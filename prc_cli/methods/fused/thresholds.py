"""All limits of the fused classifier, by name.

The loops and ``prc explain`` read them.

The loops of the street compute in float32, those of the forest in float64, and their limits are of
that type. design/fused.md says what each is worth.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy import float32 as f32

NEVER = 1e9
"""A limit that no value reaches."""
NO_BINS = 99
"""More bins than a level surface can have."""
LEAST_NEAR = f32(2)
"""A shot with fewer near neighbours is lonely, and counts neither in the walk nor in a strip."""
FOOT_M = f32(0.15)
"""Lower shots above the ground are no part of what stands on it [m]."""
CAR_TOP_M = f32(4.75)
"""Things that reach higher are no cars, in the scan plane [m]."""
BEFORE_M = f32(2)
"""Foliage must be rougher up to this far in front of a wall, because of balconies [m]."""


class NearThresholds(NamedTuple):
    """Distance limits for near neighbours, in the scan plane."""

    near_m: np.float32 = f32(0.3)
    """Greatest distance to the side and in height, each [m] ..."""
    near_steps: np.float32 = f32(3)
    """... or so many distances between adjacent columns, if that is more."""
    thin_m: np.float32 = f32(0.1)
    """On one level or upright surface: greatest distance across it [m]."""
    along_m: np.float32 = f32(1)
    """Greatest distance along such a surface [m] ..."""
    along_steps: np.float32 = f32(8)
    """... or so many distances between adjacent columns, if that is more."""


class SmoothThresholds(NamedTuple):
    """Limits by which a shot and a pair of neighbours are on a smooth surface."""

    tolerance_m: np.float32 = f32(0.006)
    """Greatest distance from the line through the pair at range 0 [m]."""
    tolerance_per_m: np.float32 = f32(0.0006)
    """Added to it per metre of range."""
    gap_m: np.float32 = f32(0.4)
    """Greatest distance between the two of a pair within a line [m] ..."""
    gap_steps: np.float32 = f32(16)
    """... or so many distances between adjacent columns, if that is more."""
    apart_m: np.float32 = f32(0.012)
    """Least distance between the shots of a line that are compared, if columns are closer [m]."""
    leaf_m: np.float32 = f32(0.03)
    """Shots two columns away are compared if that is at most this far: leaves are smaller [m]."""


class SpacingThresholds(NamedTuple):
    """Limits by which shots are on leaves, and shots of another line on the same leaf."""

    tolerance_m: np.float32
    """Shots that differ by less in range are on the same surface, at range 0 [m]."""
    tolerance_per_m: np.float32
    """Added to it per metre of range."""
    near_m: np.float32 = f32(1.5)
    """Greatest difference in range to the shots on both sides of a leaf [m]."""


class ChordThresholds(NamedTuple):
    """When a chord through a shot is upright or level."""

    chord_m: np.float32 = f32(0.15)
    """Half length of the chord [m]."""
    slope: np.float32 = f32(0.4)
    """Greatest slope of an upright chord, metres to the side per metre of height.

    Of a level one, metres of height per metre to the side.
    """
    slack_m: np.float32 = f32(0.02)
    """Added to that limit [m]."""
    longest_m: np.float32 = f32(2)
    """Longer chords do not count [m]."""


class WalkThresholds(NamedTuple):
    """How the ground is followed from shot to shot and from line to line."""

    least_near: np.float32 = LEAST_NEAR
    """Near neighbours that a shot needs."""
    step_m: np.float32 = f32(0.14)
    """Greatest step in height from one shot to the next [m]."""
    slope: np.float32 = f32(0.3)
    """Added to the step per metre between the two shots ..."""
    slope_reach_m: np.float32 = f32(0.5)
    """... up to this distance [m]."""
    gap_slope: np.float32 = f32(0.08)
    """Added to the step per metre between the two shots, at any distance."""
    known_m: np.float32 = f32(0.15)
    """A shot this near to the remembered height of its place is ground without other limits [m]."""
    memory_lines: np.float32 = f32(60)
    """Lines that a place is remembered for."""
    follow: np.float32 = f32(0.4)
    """Share of a new height in the memory of its place."""
    start_reach_m: np.float32 = f32(4)
    """If no place is known, the ground is searched up to this far to the side [m]."""


class ColumnThresholds(NamedTuple):
    """What trunks, posts, people and pieces of posts are: things that lines see past.

    A thing is a run: adjacent shots of a line that count.
    """

    lines: np.float32 = f32(60)
    """Most lines that see a trunk or post."""
    least_near: np.float32 = LEAST_NEAR
    """Near neighbours of a shot that counts."""
    foot_m: np.float32 = f32(0.3)
    """Least height above the ground of a shot that counts [m]."""
    jump_m: np.float32 = f32(0.5)
    """Greatest difference in range between adjacent shots of a thing [m]."""
    reach: np.float32 = f32(1)
    """Columns from one shot of a thing to the next, at most; 2 = single shots may miss it."""
    far_m: np.float32 = f32(1)
    """What is beside a thing is farther than it by more than this [m]."""
    shots: np.float32 = f32(6)
    """Fewest shots of a thing with far things on both sides."""
    share: np.float32 = f32(0.8)
    """Least share of such shots."""
    tall_m: np.float32 = f32(1)
    """Least height from the lowest to the highest shot of a trunk or post [m]."""
    low_m: np.float32 = f32(3)
    """Greatest height above the ground of its lowest shot [m]."""
    high_m: np.float32 = f32(2.2)
    """Least height above the ground of its highest shot: people and cars are lower [m]."""
    deep_m: np.float32 = f32(0.6)
    """Greatest depth of a trunk or post [m]."""
    thin_lines: np.float32 = f32(3)
    """Lines that see a trunk or post, up to which it need not be round: too few to see that."""
    round_m: np.float32 = f32(0.008)
    """Least radius of one that more lines see, a line: lines are more than 1.6 cm apart [m]."""
    small_lines: np.float32 = f32(7)
    """Most lines that see something small, as people."""
    small_share: np.float32 = f32(0.7)
    """Least share of shots that so few lines see."""
    small_m: np.float32 = f32(0.5)
    """Greatest depth of something small [m]."""
    person_m: np.float32 = f32(1.5)
    """Least height of a person; lower things count only with far things behind them [m]."""
    post_m: np.float32 = f32(0.12)
    """Something small is a bollard if it is less deep than this [m] ..."""
    post_tall_m: np.float32 = f32(0.4)
    """... and a line sees more than this of its height [m] ..."""
    post_top_m: np.float32 = f32(1.25)
    """... or its top is lower than this: people are taller [m]."""
    mast_m: np.float32 = f32(4)
    """Least height of a mast in one line, lower things may be trunks [m]."""
    slim_lines: np.float32 = f32(4)
    """Most lines that see something thin, which may be a piece of a post."""
    piece_lines: np.float32 = f32(24)
    """Most lines that see a piece of a post, less high than ``tall_m``, in a slanted plane."""


class StripThresholds(NamedTuple):
    """Which shots count in a strip, and as what."""

    least_near: np.float32 = LEAST_NEAR
    """Near neighbours that a shot needs."""
    foot_m: np.float32 = FOOT_M
    """Least height above the ground [m]."""
    rough: np.float32 = f32(2)
    """Most smooth pairs of a rough shot."""
    smooth: np.float32 = f32(3)
    """Fewest smooth pairs of a smooth shot."""
    level_smooth: np.float32 = f32(6)
    """Fewest smooth pairs of a shot on a level surface."""
    level_top_m: np.float32 = CAR_TOP_M
    """Level surfaces are lower than this above the ground [m]."""
    jump_m: np.float32 = f32(1)
    """A level surface reaches to adjacent shots that are less than this to the side [m]."""


class WallThresholds(NamedTuple):
    """What a wall is."""

    height_m: np.float32 = f32(1.5)
    """Least height of its smooth upright surface, mean of five lines [m]."""
    share: np.float32 = f32(0.3)
    """Least share of that surface in everything in the strip."""
    lines: np.float32 = f32(3)
    """Fewest lines, of five, that see some of it."""
    before_m: np.float32 = BEFORE_M
    """A wall is reported to strips up to this far in front of it [m]."""


class FlankThresholds(NamedTuple):
    """What the flank of a vehicle is."""

    least_m: np.float32 = f32(0.1)
    """Least height of its smooth upright surface, mean of five lines [m]."""
    most_m: np.float32 = f32(3)
    """Greatest height of that [m]."""
    share: np.float32 = f32(0.3)
    """Least share of that in everything in the strip."""
    low_m: np.float32 = f32(0.1)
    sill_m: np.float32 = f32(0.5)
    """Ground is seen beneath it where the line of sight passes it between these heights [m] ..."""
    body_m: np.float32 = f32(0.7)
    """... and through it where above, up to this height [m]."""
    large_m: np.float32 = f32(1.5)
    """Least height of the smooth upright surface of bodies that hang higher than that [m]."""
    high_m: np.float32 = f32(1.5)
    """Bodies may hang as high as this, if nothing is below them [m]."""
    soil_m: np.float32 = f32(0.1)
    """Shots this near to the ground are ground [m]."""
    shots: np.float32 = f32(3)
    """Fewest shots of the ground beneath it, in five lines."""


class DecisionThresholds(NamedTuple):
    """Limits of the rules that label a shot."""

    least_near: np.float32 = LEAST_NEAR
    """A shot with fewer near neighbours is lonely."""
    spike_share: np.float32 = f32(0.65)
    """A rough shot is a spike if the share of smooth pairs around it is greater."""
    below_m: np.float32 = f32(0.3)
    """Rough shots farther below the ground are noise [m] ..."""
    pit_near: np.float32 = f32(9)
    """... unless upright and with as many near neighbours: the side of a pit."""
    leaf_near: np.float32 = f32(10)
    """A leaf higher than boxes has fewer near neighbours than this ..."""
    leaf_slots: np.float32 = f32(4)
    """... and, with the slots with rough shots around, at least so many."""
    lone_m: np.float32 = f32(5)
    """Shots without any near neighbour are noise up to this range [m]."""
    walked_m: np.float32 = f32(0.3)
    """Shots that the walk went over are ground up to this height difference [m]."""
    level_m: np.float32 = f32(0.12)
    """So are shots that are more level than upright, up to this [m]."""
    soil_m: np.float32 = f32(0.06)
    """So are shots that are not upright, up to this [m]."""
    leaf_share: np.float32 = f32(0.4)
    """A place with a smaller share of smooth pairs is foliage."""
    leaf_share_before_wall: np.float32 = f32(0.25)
    """The same close in front of a wall."""
    before_m: np.float32 = BEFORE_M
    """Greatest distance in front of a wall that is close [m]."""
    front_m: np.float32 = f32(0.4)
    """Shots up to this far in front of a wall are part of it [m]."""
    behind_m: np.float32 = f32(1)
    """So are shots seen through it, up to this far behind [m]."""
    over_m: np.float32 = f32(0.3)
    """Lines of sight up to this far above its top count as through it [m]."""
    roof_m: np.float32 = f32(6)
    """Roofs are up to this far behind a wall.

    Foliage must be as rough there as before it [m] ...
    """
    storey_m: np.float32 = f32(2.5)
    """... if the wall is this high above the ground [m]."""
    car_top_m: np.float32 = CAR_TOP_M
    """Things that reach above this are no cars [m] ..."""
    lorry_top_m: np.float32 = f32(5.75)
    """... nor, above this, lorries [m]."""
    car_bins: np.float32 = f32(4)
    """Bins with a level surface around a smooth shot that make it part of a car."""
    car_bins_rough: np.float32 = f32(6)
    """The same of a rough shot."""
    pole_m: np.float32 = f32(1)
    """Runs of a line that are less high are poles [m]; 0 = there are none."""
    jump_m: np.float32 = f32(0.5)
    """Difference in range at which a run ends [m]."""
    far_m: np.float32 = f32(1)
    """What is beside a pole is farther than it by more than this [m]."""
    crown_slots: np.float32 = f32(5)
    """Slots with rough shots above a pole that make it a trunk."""
    pole_shots: np.float32 = f32(6)
    """Fewest shots of its run."""
    thick_m: np.float32 = f32(0.16)
    """Least radius of a trunk [m]."""
    arm_m: np.float32 = f32(3)
    """Above this height level pieces may be poles: arms and lamps [m]."""
    box_m: np.float32 = f32(2)
    """Bins and cabinets are lower than this [m]; 0 = there are none."""
    box_flat_m: np.float32 = f32(0.25)
    """They are as deep as this at least, and so are their level tops [m] ..."""
    box_deep_m: np.float32 = f32(0.75)
    """... and as this at most [m]."""
    box_lines: np.float32 = f32(16)
    """So many other lines see them, at most."""
    foot_m: np.float32 = f32(0.3)
    """Lower shots are neither poles nor lonely leaves [m]."""
    ghost_m: np.float32 = f32(4)
    """Shots farther behind a wall than this may be ghosts [m] ..."""
    ghost_near: np.float32 = f32(6)
    """... if they have fewer near neighbours than this."""


class LateLeafThresholds(NamedTuple):
    """What a leaf among the noise is."""

    apart_m: np.float32 = f32(0.06)
    """Columns are at least this far apart there: nearer leaves have near neighbours [m]."""
    foot_m: np.float32 = FOOT_M
    """It is higher than this above the ground [m]."""
    leaves: np.float32 = f32(3)
    """So many leaves around, in three lines, ..."""
    range_m: np.float32 = f32(4)
    """... are within this in range [m]."""


class CurbThresholds(NamedTuple):
    """What a curb is."""

    least_m: np.float32 = f32(0.05)
    """Least height of its face [m]."""
    most_m: np.float32 = f32(0.25)
    """Greatest height of its face [m]."""
    reach_m: np.float32 = f32(0.4)
    """The ground up to this far to either side of the face gives its foot and top [m]."""
    half_m: np.float32 = f32(0.08)
    """Half width of the face [m]."""
    share: np.float32 = f32(0.6)
    """Share of its height that the ground rises by within the face, at least."""
    margin: np.float32 = f32(0.15)
    """Shots nearer to foot or top than this share of its height are ground."""
    steep: np.float32 = f32(1.5)
    """Column spacings that the line climbs over four columns on a face, at least."""


class FanThresholds(NamedTuple):
    """What a car is where shots are far apart."""

    least_m: np.float32 = f32(1.2)
    """Least height of its roof [m]."""
    most_m: np.float32 = f32(2)
    """Greatest height of its roof [m]."""
    smooth: np.float32 = f32(0.5)
    """Least share of smooth pairs around its shots, in a line across the roof."""
    share: np.float32 = f32(0.5)
    """Least share of such lines in all around that see something there."""


class Smoothness(NamedTuple):
    """How far a shot may be off the line through a pair of neighbours."""

    noise_sigmas: float = 2.25
    """In standard deviations of the range noise ..."""
    least_m: float = 0.006
    """... at least this [m] ..."""
    per_metre: float = 0.0006
    """... plus this per metre of range [m] ..."""
    per_step: float = 0.1
    """... plus this share of the column spacing."""
    pairs: SmoothThresholds = SmoothThresholds()

    def thresholds(self, noise_m: float, step_rad: float) -> SmoothThresholds:
        """Return the limits of the loop for a range noise [m] and a column step [rad]."""
        return self.pairs._replace(
            tolerance_m=f32(max(self.least_m, self.noise_sigmas * noise_m)),
            tolerance_per_m=f32(self.per_metre + self.per_step * step_rad),
        )


class Spaced(NamedTuple):
    """How far away neighbours in other lines are."""

    near_m: float = 1.5
    """At a leaf, both neighbours in the line are nearer in range than this [m] ..."""
    sigmas: float = 2.0
    """... and differ by more than so many tolerances of smoothness."""
    share: float = 0.4
    """Greatest share of leaves that another line sees again, besides those by chance."""
    keep_share: float = 0.3
    """The same for a smaller distance than now; less, so that the distance does not flicker."""
    least: int = 30
    """Fewest leaves that show a distance; with fewer it stays as it was."""
    decay: float = 0.9
    """Weight of what was seen four lines ago."""

    def thresholds(
        self, smoothness: Smoothness, noise_m: float, step_rad: float
    ) -> SpacingThresholds:
        """Return the limits of the loop for a range noise [m] and a column step [rad]."""
        smooth = smoothness.thresholds(noise_m, step_rad)
        per_m = self.sigmas * float(smooth.tolerance_per_m)
        return SpacingThresholds(
            f32(self.sigmas * float(smooth.tolerance_m)), f32(per_m), f32(self.near_m)
        )


class DepthThresholds(NamedTuple):
    """Which rough places are looked at again without nearer and farther shots."""

    share: np.float32
    """Places with a smaller share of smooth pairs ..."""
    depth_m: np.float32
    """... without shots that differ by more than this in range [m] ..."""
    pairs: np.float32
    """... around shots with at least so many smooth pairs."""


class Foliage(NamedTuple):
    """Surroundings that distinguish foliage."""

    half_width_m: float = 0.35
    """Half width of the surroundings that are averaged [m]."""
    at_depth: bool = True
    """Whether rough surroundings are looked at again without shots nearer or farther ..."""
    depth_m: float = 1.0
    """... by more than this [m] ..."""
    depth_pairs: int = 3
    """... around shots with this many smooth pairs; around all where columns are ..."""
    depth_step_rad: float = math.radians(0.2)
    """... at least this far apart [rad]."""

    def thresholds(self, share: float, step_rad: float) -> DepthThresholds:
        """Return the limits of the loop for a rough share and a column step [rad]."""
        pairs = 0 if step_rad >= self.depth_step_rad else self.depth_pairs
        return DepthThresholds(f32(share if self.at_depth else 0.0), f32(self.depth_m), f32(pairs))


class Votes(NamedTuple):
    """The final majority vote among neighbouring shots."""

    half_width_m: np.float32 = f32(1.0)
    """Half width of the voting surroundings [m]."""
    near_m: np.float32 = f32(1.5)
    """Shots vote if this near to the side and in height [m]."""


class Limits(NamedTuple):
    """All limits of a street; None = the step is left out."""

    near: NearThresholds = NearThresholds()
    smoothness: Smoothness = Smoothness()
    interlace_rad: float = math.radians(0.2)
    """Columns at least this far apart may be measured in two turns [rad]."""
    spaced: Spaced | None = Spaced()
    chords: ChordThresholds = ChordThresholds()
    walk: WalkThresholds = WalkThresholds()
    columns: ColumnThresholds = ColumnThresholds()
    strips: StripThresholds = StripThresholds()
    walls: WallThresholds = WallThresholds()
    flanks: FlankThresholds | None = FlankThresholds()
    foliage: Foliage = Foliage()
    decision: DecisionThresholds = DecisionThresholds()
    votes: Votes | None = Votes()
    late_leaves: LateLeafThresholds = LateLeafThresholds()
    curbs: CurbThresholds | None = CurbThresholds()
    roofs: FanThresholds = FanThresholds()
    roof_step_rad: float = math.radians(0.2)
    """Lines across roofs also find cars if columns are at least so far apart [rad]."""
    room_m: float = 6.0
    """A place is a room, without cars, if less than 1 % of the returns around are farther [m]."""


STREET = Limits()
"""Limits for profilers: shots are close together, and lines see one place after another."""


def in_room(limits: Limits) -> Limits:
    """Return the limits for a room, where no car is found."""
    bins = f32(NO_BINS)
    return limits._replace(
        decision=limits.decision._replace(car_bins=bins, car_bins_rough=bins),
        roofs=limits.roofs._replace(share=f32(NEVER)),
    )
