"""Records of the simulator's loops: sensor, bodies, hits."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from prc_cli.core.types import F64, I32, U8

Floats = Annotated[F64, 1]
Table = Annotated[F64, 2]


class SensorModel(NamedTuple):
    """Parameters of a scanner for the loops; most are fields of :class:`~.scanners.Scanner`."""

    step_rad: float
    """Angle between adjacent shots of a line [rad]."""
    exit_m: float
    """Width of the beam where it leaves the scanner [m]."""
    divergence: float
    """Width added per metre of range."""
    ambiguity_m: float
    pulse_m: float
    min_range_m: float
    max_range_m: float
    half_power: float
    """Power at which half of the echoes are found [1/m²]."""
    resolution_m: float
    noise_m: float
    noise_per_m: float
    noise_spread: float
    lost_share: float
    edge_m: float
    background_share: float
    sky_share: float
    bright_sky_share: float
    cluster_share: float
    cluster_m: float
    pane_share: float
    ghost_share: float
    leaves_share: float
    is_cw: bool
    """Whether the scanner is of a continuous wave, which mixes all echoes; else it is pulsed."""
    max_returns: int


class Hits(NamedTuple):
    """Surfaces that the shots of a block of lines met first."""

    t: Annotated[F64, 2]
    """(lines, M) float64, range [m]; inf = no surface."""
    body: Annotated[I32, 2]
    """(lines, M) int32, row in the bodies, -1 = none."""
    facing: Annotated[F64, 2]
    """(lines, M) float64, cosine of the angle of incidence, 0 to 1; 0 = no surface."""


class CastBodies(NamedTuple):
    """Arrays of :class:`prc_cli.simulation.world.Bodies` for the caster."""

    shape: Annotated[U8, 1]
    numbers: Table
    turn: Table
    """(n, 2) float64, cosine and sine of the yaw of ellipsoids and boxes."""
    density: Floats
    velocity: Table
    number: Floats
