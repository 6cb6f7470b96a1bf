"""What the simulator's loops and their slow twins are given, by name: the numbers of a sensor, and bodies as arrays."""

from __future__ import annotations

from typing import Annotated, NamedTuple

from prc_cli.core.types import F64, U8

Floats = Annotated[F64, 1]
Table = Annotated[F64, 2]


class SensorModel(NamedTuple):
    """What a scanner makes of the light that comes back."""

    step_rad: float
    """Angle between adjacent shots of a line [rad]."""
    exit_m: float
    """Width of the beam where it leaves the scanner [m]."""
    divergence: float
    """Width added per metre of range."""
    ambiguity_m: float
    """Ranges are given modulo this [m]; 0 = as they are."""
    pulse_m: float
    """Echoes farther apart than this are told apart [m]."""
    nearest_m: float
    """Least range that is given [m]."""
    farthest_m: float
    """Greatest range that is given [m]."""
    half_power: float
    """Power at which half of the echoes are found [1/m²]."""
    resolution_m: float
    """Step of the ranges that are given [m]."""
    noise_m: float
    """Standard deviation of a strong echo's range [m]."""
    noise_per_m: float
    """Standard deviation added per metre of range of a white surface, met squarely."""
    noise_spread: float
    """Standard deviation added per metre of depth that the beam spans on a slanted surface."""
    lost_share: float
    """Share of strong echoes that are not found."""
    edge_m: float
    """A mixed range this close to a surface is that surface's [m]."""
    background_share: float
    """Share of ranges that stray light replaces, where there is a surface."""
    sky_share: float
    """Share of shots without a surface that stray light gives a range."""
    bright_sky_share: float
    """The same in the brightest sky; 0 = the sky is even."""
    cluster_share: float
    """Share of ranges that stray light moves."""
    cluster_m: float
    """Standard deviation of that move [m]."""
    pane_share: float
    """Share of shots that glass answers with the pane."""
    ghost_share: float
    """Share of shots that glass answers with what it mirrors."""
    leaves_share: float
    """Share of shots on leaves whose light goes on behind the leaf."""
    is_cw: bool
    """Whether the scanner is of a continuous wave, which mixes all echoes; else it is pulsed."""
    max_returns: int
    """Returns of a shot that are given, at most."""


class CastBodies(NamedTuple):
    """Bodies as the caster takes them; as :class:`prc_cli.simulation.world.Bodies`, but for ``turn``."""

    shape: Annotated[U8, 1]
    """(n,) uint8, :class:`prc_cli.simulation.world.Shape`."""
    numbers: Table
    """(n, 9) float64, what they mean depends on the shape [m, rad]; at time 0."""
    turn: Table
    """(n, 2) float64, cosine and sine of the yaw of ellipsoids and boxes."""
    density: Floats
    """(n,) float64, leaf area density [m²/m³]; 0 = a surface."""
    velocity: Table
    """(n, 2) float64, along x and y [m/s]."""
    number: Floats
    """(n,) float64, identity from 0 to below 2^53, which seeds the leaves."""
