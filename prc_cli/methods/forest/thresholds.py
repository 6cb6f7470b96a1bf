"""All limits of the forest, by name, in double precision.

The loops and ``prc explain`` read them. design/fused_forest.md says what they were chosen on.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class TerrainThresholds(NamedTuple):
    """How the ground of a forest is found."""

    bin_m: float = 0.25
    """Width of a bin of the profile [m]."""
    slope: float = 0.5
    """Greatest slope of the ground, metres per metre."""
    near_m: float = 0.1
    """A shot of the ground differs from the return before it by at most this in range [m] ..."""
    near_share: float = 0.05
    """... plus this share of the range."""


class RunThresholds(NamedTuple):
    """What an upright run of returns is."""

    step_rad: float = 0.0
    """Angle between adjacent columns [rad]."""
    above_m: float = 0.05
    """Least height above the ground [m]."""
    tolerance_m: float = 0.004
    """Greatest distance beside the run [m] ..."""
    tolerance_share: float = 0.0003
    """... plus this share of the range ..."""
    steep: float = 1.0
    """... plus this much per metre up or down."""
    gap_m: float = 0.3
    """Longest gap within a run [m]."""
    gap_steep: float = 0.1
    """Metres to the side per metre of a gap, at most."""
    behind_m: float = 0.15
    """Returns farther than the run by more than this lie behind it [m]."""
    lean: float = 0.7
    """Metres to the side per metre up, at most, from end to end."""
    short_m: float = 0.03
    """Least length up of a run [m]."""


class StemThresholds(NamedTuple):
    """What a stem is: runs of successive lines, taken together."""

    near_m: float = 0.05
    """Runs belong together if shots of one column differ by less than this in range [m] ..."""
    near_share: float = 0.005
    """... plus this share of the range."""
    shots: float = 12.0
    """Fewest shots."""
    runs: float = 3.0
    """Fewest runs."""
    extent_m: float = 0.5
    """Least height from the lowest to the highest end [m]."""
    total_m: float = 1.0
    """Least length of all runs together [m]."""
    mean_m: float = 0.12
    """Least mean length of the runs [m]."""
    through_share: float = 0.1
    """Greatest share of returns from behind, of the stem's shots."""


class ForestThresholds(NamedTuple):
    """Limits of the labels in a forest."""

    below_m: float = 0.2
    """Returns farther below the ground are noise [m]."""
    soil_m: float = 0.04
    """Returns up to this height are ground [m]."""
    cover_m: float = 0.15
    """Returns in flat places are ground up to this height [m]."""
    flat_m: float = 0.04
    """Greatest step in height between adjacent shots of a flat place [m]."""
    top_m: float = 1000.0
    """Stems end at this height; above it they are vegetation [m]."""
    beside_m: float = 0.05
    """Shots that differ from an adjacent stem shot by at most this in range are of the stem [m].

    Below 0 = none.
    """
    near_m: float = 0.3
    """Shots are alone without another this near in range [m]; below 0 = none is alone."""


class Forest(NamedTuple):
    """All limits of a forest."""

    terrain: TerrainThresholds = TerrainThresholds()
    lines_together: int = 4
    """Successive lines that share a profile of the ground."""
    reach_m: float = 80.0
    """How far to either side the profile goes [m]."""
    runs: RunThresholds = RunThresholds()
    stems: StemThresholds = StemThresholds()
    classes: ForestThresholds = ForestThresholds()
    run_sigmas: float = 2.0
    """Greatest distance of a return beside a run, in sigmas of the range noise."""
    soil_sigmas: float = 2.0
    """Height up to which returns are ground, in sigmas of the range noise."""
    flat_sigmas: float = 3.0
    """Greatest step in height between adjacent shots of a flat place, in the same sigmas."""
    alone_rad: float = math.radians(0.3)
    """Angle on either side, along the line, in which a shot without a near shot is alone [rad]."""

    def run_thresholds(self, step_rad: float, noise_m: float) -> RunThresholds:
        """Return the limits of the loop over the runs of a line, for a range noise [m]."""
        tolerance_m = max(self.runs.tolerance_m, self.run_sigmas * noise_m)
        return self.runs._replace(step_rad=step_rad, tolerance_m=tolerance_m)

    def class_thresholds(self, noise_m: float) -> ForestThresholds:
        """Return the limits of the loop that labels, for a range noise [m]."""
        soil_m = max(self.classes.soil_m, self.soil_sigmas * noise_m)
        flat_m = max(self.classes.flat_m, self.flat_sigmas * noise_m)
        return self.classes._replace(
            soil_m=soil_m, cover_m=max(self.classes.cover_m, soil_m), flat_m=flat_m
        )


FOREST = Forest()
