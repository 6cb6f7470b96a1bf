"""Thresholds of the fused classifier's loops, by name.

The parameters of a stage build them (``params.thresholds()``), the compiled loop and its slow twin read them by field
name. The loops of the street compute in float32, those of the forest in float64, and their thresholds are of that type:
:func:`typed` converts.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache
from typing import Any, NamedTuple, TypeVar, get_type_hints

import numpy as np

ThresholdsT = TypeVar("ThresholdsT", bound="tuple[Any, ...]")


def typed(kind: type[ThresholdsT], **values: float) -> ThresholdsT:
    """Return thresholds of a class, each converted to the type of its field.

    >>> typed(WallThresholds, height_m=1.5, share=0.3, before_m=2, lines=4).before_m
    np.float32(2.0)
    >>> typed(TerrainThresholds, bin_m=1, slope=0.5, near_m=0.1, near_share=0).bin_m
    1.0
    """
    converted: ThresholdsT = _typed(kind, tuple(values.items()))
    return converted


@lru_cache(maxsize=64)
def _typed(kind: type[ThresholdsT], values: tuple[tuple[str, float], ...]) -> ThresholdsT:
    """Convert once for all blocks: they ask for the same thresholds again."""
    types = _field_types(kind)
    return kind(**{name: types[name](value) for name, value in values})


@cache
def _field_types(kind: type[tuple[Any, ...]]) -> dict[str, Callable[[float], Any]]:
    return get_type_hints(kind)


class NearThresholds(NamedTuple):
    """Distance limits for near neighbours, in the scan plane."""

    near_m: np.float32
    """Greatest distance to the side and in height, each [m] ..."""
    near_steps: np.float32
    """... or so many distances between adjacent columns, if that is more."""
    thin_m: np.float32
    """On one level or upright surface: greatest distance across it [m]."""
    along_m: np.float32
    """Greatest distance along such a surface [m] ..."""
    along_steps: np.float32
    """... or so many distances between adjacent columns, if that is more."""


class SmoothThresholds(NamedTuple):
    """When a shot and a pair of neighbours lie on a smooth surface."""

    tolerance_m: np.float32
    """Greatest distance from the line through the pair at range 0 [m]."""
    tolerance_per_m: np.float32
    """Added to it per metre of range."""
    gap_m: np.float32
    """Greatest distance between the two of a pair within a line [m] ..."""
    gap_steps: np.float32
    """... or so many distances between adjacent columns, if that is more."""
    apart_m: np.float32
    """Shots of a line are compared at least so far from each other, where columns allow it [m]."""


class SpacingThresholds(NamedTuple):
    """Which shots are on leaves, and when a shot of another line is on the same one."""

    tolerance_m: np.float32
    """Shots that differ by less in range are on one thing, at range 0 [m]."""
    tolerance_per_m: np.float32
    """Added to it per metre of range."""
    near_m: np.float32
    """Greatest difference in range to the shots on both sides of a leaf [m]."""


class ChordThresholds(NamedTuple):
    """When a chord through a shot is upright or level."""

    chord_m: np.float32
    """Half length of the chord [m]."""
    slope: np.float32
    """An upright chord goes less than this times its height to the side; a level one the other way round."""
    slack_m: np.float32
    """Added to that limit [m]."""
    longest_m: np.float32
    """Longer chords do not count [m]."""


class WalkThresholds(NamedTuple):
    """How the ground is followed from shot to shot and from line to line."""

    least_near: np.float32
    """Near neighbours that a shot needs."""
    step_m: np.float32
    """Greatest step in height from one shot to the next [m]."""
    slope: np.float32
    """Added to the step per metre between the two shots ..."""
    slope_reach_m: np.float32
    """... up to this distance [m]."""
    gap_slope: np.float32
    """Added to the step per metre between the two shots, at any distance."""
    known_m: np.float32
    """Greatest difference to the remembered height of the place [m]; enough without the other limits."""
    memory_lines: np.float32
    """Lines that a place is remembered for."""
    follow: np.float32
    """Share of a new height in the memory of its place."""
    start_reach_m: np.float32
    """Where no place is known, the ground is searched up to this far to the side, if anything is level there [m]."""


class StripThresholds(NamedTuple):
    """Which shots count in a strip, and as what."""

    least_near: np.float32
    """Near neighbours that a shot needs."""
    foot_m: np.float32
    """Least height above the ground [m]."""
    rough: np.float32
    """Most smooth pairs of a rough shot."""
    smooth: np.float32
    """Fewest smooth pairs of a smooth shot."""
    level_smooth: np.float32
    """Fewest smooth pairs of a shot on a level surface."""
    level_top_m: np.float32
    """Level surfaces are lower than this above the ground [m]."""
    jump_m: np.float32
    """A level surface reaches to adjacent shots that are less than this to the side [m]."""


class WallThresholds(NamedTuple):
    """What a wall is."""

    height_m: np.float32
    """Least height of its smooth upright surface, mean of five lines [m]."""
    share: np.float32
    """Least share of that surface in everything in the strip."""
    lines: np.float32
    """Fewest lines, of five, that see some of it."""
    before_m: np.float32
    """A wall is reported to strips up to this far in front of it [m]."""


class FlankThresholds(NamedTuple):
    """What the flank of a vehicle is."""

    least_m: np.float32
    """Least height of its smooth upright surface, mean of five lines [m]."""
    most_m: np.float32
    """Greatest height of that [m]."""
    share: np.float32
    """Least share of that in everything in the strip."""
    low_m: np.float32
    sill_m: np.float32
    """Ground is seen beneath it where the line of sight passes it between these heights [m] ..."""
    body_m: np.float32
    """... and through it where above, up to this height [m]."""
    large_m: np.float32
    """Least height of the smooth upright surface of bodies that hang higher than that [m]."""
    high_m: np.float32
    """Bodies may hang as high as this, if nothing is below them [m]."""
    soil_m: np.float32
    """Shots this near to the ground are ground [m]."""
    shots: np.float32
    """Fewest shots of the ground beneath it, in five lines."""


class DecisionThresholds(NamedTuple):
    """Limits of the questions that label a shot."""

    least_near: np.float32
    """A shot with fewer near neighbours is lonely."""
    spike_share: np.float32
    """A rough shot is a spike where the share of smooth pairs around it is greater."""
    below_m: np.float32
    """Rough shots farther below the ground are noise [m] ..."""
    pit_near: np.float32
    """... unless upright and with as many near neighbours: the side of a pit."""
    leaf_slots: np.float32
    """Slots with rough shots around a lonely shot that make it a leaf."""
    lone_m: np.float32
    """Shots without any near neighbour are noise up to this range [m]; farther ones may be leaves."""
    walked_m: np.float32
    """Shots that the walk went over are ground up to this height difference [m]."""
    level_m: np.float32
    """So are shots that are more level than upright, up to this [m]."""
    soil_m: np.float32
    """So are shots that are not upright, up to this [m]."""
    leaf_share: np.float32
    """A place with a smaller share of smooth pairs is foliage."""
    leaf_share_before_wall: np.float32
    """The same close in front of a wall."""
    before_m: np.float32
    """Greatest distance in front of a wall that is close [m]."""
    front_m: np.float32
    """Shots up to this far in front of a wall are part of it [m]."""
    behind_m: np.float32
    """So are shots seen through it, up to this far behind [m]."""
    over_m: np.float32
    """Lines of sight up to this far above its top count as through it [m]."""
    roof_m: np.float32
    """Roofs are up to this far behind a wall: foliage must be as rough there as before it [m] ..."""
    storey_m: np.float32
    """... if the wall is this high above the ground [m]."""
    car_top_m: np.float32
    """Things that reach above this are no cars [m] ..."""
    lorry_top_m: np.float32
    """... nor, above this, lorries [m]."""
    car_bins: np.float32
    """Bins with a level surface around a smooth shot that make it part of a car."""
    car_bins_rough: np.float32
    """The same of a rough shot."""
    pole_m: np.float32
    """Runs of a line that are less high are poles [m]; 0 = there are none."""
    jump_m: np.float32
    """Difference in range at which a run ends [m]."""
    far_m: np.float32
    """What is beside a pole is farther than it by more than this [m]."""
    across_lines: np.float32
    """Lines before and after by which a thing is found to be thin."""
    crown_slots: np.float32
    """Slots with rough shots above a pole that make it a trunk."""
    pole_shots: np.float32
    """Fewest shots of its run."""
    thick_m: np.float32
    """What is as deep, from the middle of its front to its edges, is a trunk [m]."""
    arm_m: np.float32
    """Above this height thin level things may be poles: arms and lamps [m]."""
    box_m: np.float32
    """Bins and cabinets are lower than this [m]; 0 = there are none."""
    box_flat_m: np.float32
    """They are as deep as this at least, and so are their level tops [m] ..."""
    box_deep_m: np.float32
    """... and as this at most [m]."""
    box_lines: np.float32
    """So many other lines see them, at most."""
    keeps_parts: np.float32
    """1 = what is beside a car is no pole; 0 = it may be, if it is narrow in other lines."""
    takes_long: np.float32
    """1 = poles may be long across lines, as fences are; 0 = lines close by see past them."""
    foot_m: np.float32
    """Lower shots are neither poles nor lonely leaves [m]."""
    keeps_held: np.float32
    """1 = lonely shots that agree with a surface are kept; 0 = they are noise."""
    ghost_m: np.float32
    """Shots farther behind a wall than this may be ghosts [m] ..."""
    ghost_near: np.float32
    """... if they have fewer near neighbours than this."""
    pane_m: np.float32
    """So are shots without any smooth pair farther behind a wall than this [m]."""
    cabin_near: np.float32
    """Shots of a car without any smooth pair and with fewer near neighbours than this are noise."""
    car_label: np.float32
    """Label of cars."""
    pole_label: np.float32
    """Label of poles."""


class AgainThresholds(NamedTuple):
    """Limits of the questions that are asked again of noise, and of what may be noise."""

    least_near: np.float32
    """A shot with fewer near neighbours is lonely."""
    spike_m: np.float32
    """Spikes that are nearer than this to a surface are part of it [m]."""
    sparse_texture: np.float32
    """Lonely shots are part of something sparse where the share of smooth pairs around is smaller ..."""
    sparse_shots: np.float32
    """... with this many near shots in a wider window ..."""
    through_share: np.float32
    """... and a smaller share of the window on surfaces before them."""
    low_m: np.float32
    """So are those this near to the ground, with ground around [m]."""
    mirror_m: np.float32
    """A mirror image in a car is farther than the car by more than this [m] ..."""
    mirror_share: np.float32
    """... and this share of the shots on either side are of the car."""
    alone_texture: np.float32
    """Rough shots may be alone where the share of smooth pairs around is greater ..."""
    foot_m: np.float32
    """... higher than this above the ground [m] ..."""
    alone_m: np.float32
    """... with no other within this in range [m] ..."""
    alone_gap_m: np.float32
    """... and none within this before, or behind [m]."""
    car_label: np.float32
    """Label of cars."""


class CurbThresholds(NamedTuple):
    """What a curb is."""

    least_m: np.float32
    """Least height of its face [m]."""
    most_m: np.float32
    """Greatest height of its face [m]."""
    reach_m: np.float32
    """The ground up to this far to either side of the face gives its foot and top [m]."""
    half_m: np.float32
    """Half width of the face [m]."""
    share: np.float32
    """Share of its height that the ground rises by within the face, at least."""
    margin: np.float32
    """Shots nearer to foot or top than this share of its height are ground."""
    steep: np.float32
    """Column spacings that the line climbs over four columns on a face, at least."""


class FanThresholds(NamedTuple):
    """What a car is where shots are far apart."""

    least_m: np.float32
    """Least height of its roof [m]."""
    most_m: np.float32
    """Greatest height of its roof [m]."""
    smooth: np.float32
    """Least share of smooth pairs around its shots, in a line across the roof."""
    share: np.float32
    """Least share of such lines in all around that see something there."""
    label: np.float32
    """Label of cars."""


class TerrainThresholds(NamedTuple):
    """How the ground of a forest is found."""

    bin_m: float
    """Width of a bin of the profile [m]."""
    slope: float
    """Greatest slope of the ground, metres per metre."""
    near_m: float
    """A shot of the ground differs from the return before it by at most this in range [m] ..."""
    near_share: float
    """... plus this share of the range."""


class RunThresholds(NamedTuple):
    """What an upright run of returns is."""

    step_rad: float
    """Angle between adjacent columns [rad]."""
    above_m: float
    """Least height above the ground [m]."""
    tolerance_m: float
    """Greatest distance beside the run [m] ..."""
    tolerance_share: float
    """... plus this share of the range ..."""
    steep: float
    """... plus this much per metre up or down."""
    gap_m: float
    """Longest gap within a run [m]."""
    gap_steep: float
    """Metres to the side per metre of a gap, at most."""
    behind_m: float
    """Returns farther than the run by more than this lie behind it [m]."""
    lean: float
    """Metres to the side per metre up, at most, from end to end."""
    short_m: float
    """Least length up of a run [m]."""


class StemThresholds(NamedTuple):
    """What a stem is: runs of successive lines, taken together."""

    near_m: float
    """Runs belong together where shots of one column differ by less than this in range [m] ..."""
    near_share: float
    """... plus this share of the range."""
    shots: float
    """Fewest shots."""
    runs: float
    """Fewest runs."""
    extent_m: float
    """Least height from the lowest to the highest end [m]."""
    total_m: float
    """Least length of all runs together [m]."""
    mean_m: float
    """Least mean length of the runs [m]."""
    through_share: float
    """Greatest share of returns from behind, of the stem's shots."""


class ForestThresholds(NamedTuple):
    """Limits of the labels in a forest."""

    below_m: float
    """Returns farther below the ground are noise [m]."""
    soil_m: float
    """Returns up to this height are ground [m]."""
    cover_m: float
    """Returns in flat places are ground up to this height [m]."""
    flat_m: float
    """Greatest step in height between adjacent shots of a flat place [m]."""
    top_m: float
    """Stems end at this height; above it they are vegetation [m]."""
    beside_m: float
    """Shots that differ from an adjacent stem shot by at most this in range are of the stem [m]; below 0 = none."""
    near_m: float
    """Shots are alone without another this near in range [m]; below 0 = none is alone."""
