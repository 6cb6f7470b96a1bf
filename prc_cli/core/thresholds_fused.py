"""Thresholds of the fused classifier's loops, by name.

The parameters of a stage build them (``params.thresholds()``), the compiled loop and its slow twin read them by field
name. The loops of the street compute in float32, those of the forest in float64, and their thresholds are of that type:
:func:`single` and :func:`double` convert.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import numpy as np

ThresholdsT = TypeVar("ThresholdsT", bound="tuple[Any, ...]")


def single(thresholds: ThresholdsT) -> ThresholdsT:
    """Return thresholds of the same class, each a float32.

    >>> single(WallThresholds(1.5, 0.3, 2)).before_m
    np.float32(2.0)
    """
    return type(thresholds)._make(np.float32(value) for value in thresholds)  # type: ignore[attr-defined, no-any-return]


def double(thresholds: ThresholdsT) -> ThresholdsT:
    """Return thresholds of the same class, each a float of 64 bits.

    >>> double(TerrainThresholds(1, 0.5, 0.1, 0)).bin_m
    1.0
    """
    return type(thresholds)._make(float(value) for value in thresholds)  # type: ignore[attr-defined, no-any-return]


class NearThresholds(NamedTuple):
    """Distance limits for near neighbours, in the scan plane."""

    near_m: float
    """Greatest distance to the side and in height, each [m] ..."""
    near_steps: float
    """... or so many distances between adjacent columns, if that is more."""
    thin_m: float
    """On one level or upright surface: greatest distance across it [m]."""
    along_m: float
    """Greatest distance along such a surface [m] ..."""
    along_steps: float
    """... or so many distances between adjacent columns, if that is more."""


class SmoothThresholds(NamedTuple):
    """When a shot and a pair of neighbours lie on a smooth surface."""

    tolerance_m: float
    """Greatest distance from the line through the pair at range 0 [m]."""
    tolerance_per_m: float
    """Added to it per metre of range."""
    gap_m: float
    """Greatest distance between the two of a pair within a line [m] ..."""
    gap_steps: float
    """... or so many distances between adjacent columns, if that is more."""


class ChordThresholds(NamedTuple):
    """When a chord through a shot is upright or level."""

    chord_m: float
    """Half length of the chord [m]."""
    slope: float
    """An upright chord goes less than this times its height to the side; a level one the other way round."""
    slack_m: float
    """Added to that limit [m]."""
    longest_m: float
    """Longer chords do not count [m]."""


class WalkThresholds(NamedTuple):
    """How the ground is followed from shot to shot and from line to line."""

    least_near: float
    """Near neighbours that a shot needs."""
    step_m: float
    """Greatest step in height from one shot to the next [m]."""
    slope: float
    """Added to the step per metre between the two shots ..."""
    slope_reach_m: float
    """... up to this distance [m]."""
    gap_slope: float
    """Added to the step per metre between the two shots, at any distance."""
    known_m: float
    """Greatest difference to the remembered height of the place [m]; enough without the other limits."""
    memory_lines: float
    """Lines that a place is remembered for."""
    follow: float
    """Share of a new height in the memory of its place."""


class StripThresholds(NamedTuple):
    """Which shots count in a strip, and as what."""

    least_near: float
    """Near neighbours that a shot needs."""
    foot_m: float
    """Least height above the ground [m]."""
    rough: float
    """Most smooth pairs of a rough shot."""
    smooth: float
    """Fewest smooth pairs of a smooth shot."""
    level_smooth: float
    """Fewest smooth pairs of a shot on a level surface."""
    level_top_m: float
    """Level surfaces are lower than this above the ground [m]."""
    jump_m: float
    """A level surface reaches to adjacent shots that are less than this to the side [m]."""


class WallThresholds(NamedTuple):
    """What a wall is."""

    height_m: float
    """Least height of its smooth upright surface, mean of five lines [m]."""
    share: float
    """Least share of that surface in everything in the strip."""
    before_m: float
    """A wall is reported to strips up to this far in front of it [m]."""


class DecisionThresholds(NamedTuple):
    """Limits of the questions that label a shot."""

    least_near: float
    """A shot with fewer near neighbours is lonely."""
    spike_share: float
    """A rough shot is a spike where the share of smooth pairs around it is greater."""
    below_m: float
    """Rough shots farther below the ground are noise [m]."""
    leaf_slots: float
    """Slots with rough shots around a lonely shot that make it a leaf."""
    walked_m: float
    """Shots that the walk went over are ground up to this height difference [m]."""
    level_m: float
    """So are shots that are more level than upright, up to this [m]."""
    soil_m: float
    """So are shots that are not upright, up to this [m]."""
    leaf_share: float
    """A place with a smaller share of smooth pairs is foliage."""
    leaf_share_before_wall: float
    """The same close in front of a wall."""
    before_m: float
    """Greatest distance in front of a wall that is close [m]."""
    front_m: float
    """Shots up to this far in front of a wall are part of it [m]."""
    behind_m: float
    """So are shots seen through it, up to this far behind [m]."""
    over_m: float
    """Lines of sight up to this far above its top count as through it [m]."""
    car_top_m: float
    """Things that reach above this are no cars [m]."""
    car_bins: float
    """Bins with a level surface around a smooth shot that make it part of a car."""
    car_bins_rough: float
    """The same of a rough shot."""
    pole_m: float
    """Runs of a line that are less high are poles [m]; 0 = there are none."""
    jump_m: float
    """Difference in range at which a run ends [m]."""
    far_m: float
    """What is beside a pole is farther than it by more than this [m]."""
    crown_slots: float
    """Slots with rough shots above a pole that make it a trunk."""
    foot_m: float
    """Lower shots are neither poles nor lonely leaves [m]."""
    keeps_held: float
    """1 = lonely shots that agree with a surface are kept; 0 = they are noise."""
    ghost_m: float
    """Shots farther behind a wall than this may be ghosts [m] ..."""
    ghost_near: float
    """... if they have fewer near neighbours than this."""


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
