"""Classes in forest, in the scan plane: ground, stems, other vegetation, noise.

Needs the ranges, as PRC does (Lehtola et al. 2019), and the vertical direction in the scan plane;
no pose. Blocks are independent: the ground is estimated anew every few lines, and a few lines are
enough to find a stem.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8, Mask
from prc_cli.methods.forest.stems_loops import (
    forest_labels,
    ground_heights,
    ground_profiles,
    stem_shots,
    upright_runs,
)
from prc_cli.methods.forest.thresholds import Forest
from prc_cli.methods.plane import Plane

LEAST_COLUMNS = 2
MOST_COLUMNS = 8
"""Limits of the columns searched for near shots on either side; more would be slow."""


@stage("ground")
def heights_over_ground(range_m: F32, plane: Plane, limits: Forest) -> F32:
    """Return the height of every return above the ground.

    The ground height of a bin is its third-lowest return. Where plants hide the ground, the bin
    rises above its neighbours by more than the terrain slope allows; such bins are interpolated.

    ``range_m`` (lines, M) float32, metres; returns (lines, M) float32, metres.

    Flat ground 2 m below the scanner, and an object 1 m high on it:

    >>> beam = np.deg2rad(np.linspace(-60, 60, 241))
    >>> lines = np.tile(2 / np.cos(beam), (4, 1)).astype(np.float32)
    >>> lines[:, 120] = 1.0
    >>> heights = heights_over_ground(lines, Plane.of(beam), Forest())
    >>> heights[0, [0, 120]].round(2) + 0.0
    array([0., 1.], dtype=float32)
    """
    bin_m = limits.terrain.bin_m
    together = limits.lines_together
    n_bins = 2 * max(int(np.ceil(limits.reach_m / bin_m)), 1)
    profiles = ground_profiles(range_m, plane.sine, plane.cosine, together, n_bins, limits.terrain)
    return ground_heights(range_m, plane.sine, plane.cosine, profiles, together, bin_m)


@stage("stems")
def find_stems(
    range_m: F32,
    heights_m: F32,
    plane: Plane,
    noise_m: float,
    limits: Forest,
) -> Mask:
    """Mark the shots on stems: upright, opaque, and continuous from line to line.

    A tilted scan plane cuts a stem in a narrow upright ellipse, whose length is the stem's diameter
    over the sine of the tilt; an upright plane cuts it from foot to crown. So every line has a run
    of returns one above the other. Crowns have such runs by chance, but these are short, have
    returns from behind, and end with their line.

    ``range_m`` (lines, M) float32, metres; ``heights_m`` (lines, M) float32, metres; returns
    (lines, M) bool.

    A stem 4 m to the side, and ground; the same line four times:

    >>> beam = np.deg2rad(np.linspace(45, 100, 551))
    >>> down = np.maximum(np.cos(beam), 1e-9)
    >>> lines = np.tile(np.minimum(4 / np.sin(beam), 2 / down), (4, 1)).astype(np.float32)
    >>> heights = (2 - lines * np.cos(beam)).astype(np.float32)
    >>> stems = find_stems(lines, heights, Plane.of(beam), 0.0, Forest())
    >>> heights[stems].min().round(1), stems[:, -1].all()
    (np.float32(0.1), np.True_)
    """
    thresholds = limits.run_thresholds(plane.step_rad, noise_m)
    runs, table = upright_runs(range_m, heights_m, plane.sine, plane.cosine, thresholds)
    return stem_shots(range_m, runs, table, limits.stems)


class Woods(NamedTuple):
    """What a block of forest holds."""

    reasons: U8
    """(lines, M) uint8, :class:`~prc_cli.core.classes.Reason`."""
    above_m: F32
    """(lines, M) float32, heights above the ground in the scan plane [m]."""
    on_stem: Mask
    """(lines, M) bool."""


def forest(
    range_m: F32,
    plane: Plane,
    noise_m: float,
    limits: Forest,
) -> Woods:
    """Label a block of forest, (lines, M) float32 [m].

    Ground, a stem, and a stray shot in front of the sky:

    >>> from prc_cli.core.classes import Reason
    >>> beam = np.deg2rad(np.linspace(45, 110, 651))
    >>> down = np.maximum(np.cos(beam), 1e-9)
    >>> lines = np.tile(np.minimum(4 / np.sin(beam), 2 / down), (8, 1)).astype(np.float32)
    >>> lines[:, 551:] = np.nan
    >>> lines[3, 600] = 30.0
    >>> found = forest(lines, Plane.of(beam), 0.0, Forest()).reasons
    >>> [Reason(found[3, column]).name for column in (0, 500, 590, 600)]
    ['SOIL', 'ON_STEM', 'MISSING', 'ALONE']
    """
    range_m = np.ascontiguousarray(range_m)
    heights = heights_over_ground(range_m, plane, limits)
    stems = find_stems(range_m, heights, plane, noise_m, limits)
    return Woods(_decide(range_m, heights, stems, plane, noise_m, limits), heights, stems)


@stage("classes")
def _decide(
    range_m: F32,
    heights_m: F32,
    stems: Mask,
    plane: Plane,
    noise_m: float,
    limits: Forest,
) -> U8:
    """Decide what is ground and stem; other shots are vegetation, or noise if no shot is near."""
    columns = round(limits.alone_rad / plane.step_rad) if plane.step_rad > 0 else LEAST_COLUMNS
    around = min(max(columns, LEAST_COLUMNS), MOST_COLUMNS)
    return forest_labels(range_m, heights_m, stems, around, limits.class_thresholds(noise_m))
