"""Arrays of a line of forest that belong together, by name."""

from __future__ import annotations

from typing import NamedTuple

from prc_cli.core.types import F64


class RunPoints(NamedTuple):
    """Shots of a line of forest, from which upright runs are made, (M,) float64."""

    side_m: F64
    """Distance to the side in the scan plane [m]."""
    height_m: F64
    """Height above the scanner in the scan plane [m]."""
    range_m: F64
    tolerance_m: F64
    """Greatest distance beside a run [m]."""
    spacing_m: F64
    """Distance of adjacent shots on something upright [m]."""


class RunStarts(NamedTuple):
    """First shot of every run of a line of forest, (M,) float64."""

    side_m: F64
    height_m: F64
