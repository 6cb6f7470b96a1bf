"""Oncoming cars and people who walk: where they are at any time, computed without what was before.

All of one stream have the same speed, so that they are beads on a string that moves along the street; which beads are
near a place at a time follows by arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from prc_cli.simulation.street import cars
from prc_cli.simulation.street.params import StreetSceneParams
from prc_cli.simulation.street.people import person
from prc_cli.simulation.street.pile import Frame, Pile
from prc_cli.simulation.street.plan import PIECE_M, Purpose, generator, junction_of
from prc_cli.simulation.street.road import Ground, frame_at
from prc_cli.simulation.world import Bodies

TIME_STEP_S = 0.25
"""Way and slope of those that move are taken anew after this time: they drive straight in between."""
_FIRST_NUMBER = 2.0**46
_STREAM_NUMBERS = 2.0**42
_EACH = 256.0


@dataclass(frozen=True, slots=True)
class Stream:
    """Those who move along the street one behind the other."""

    index: int
    speed: float
    """Along the street, negative = towards the scanner [m/s]."""
    spacing: float
    """Mean distance [m]."""
    d: float
    """To the left of the crown [m]."""
    cars: bool


def streams_of(params: StreetSceneParams) -> tuple[Stream, ...]:
    """Return the streams of a street."""
    streams = []
    if params.cars_per_km > 0:
        streams.append(Stream(0, -9.5, 1000.0 / params.cars_per_km, 1.75, cars=True))
    if params.people > 0:
        ways = ((7.2, 1.3), (7.8, -1.25), (-7.2, 1.35), (-7.8, -1.2))
        for i, (d, speed) in enumerate(ways):
            streams.append(Stream(1 + i, speed, 35.0 / params.people, d, cars=False))
    return tuple(streams)


def movers_near(
    ground: Ground, seed: int, streams: tuple[Stream, ...], middle_s: float, reach_m: float, step: int
) -> Bodies:
    """Return those that move and are near a place.

    Parameters
    ----------
    ground : Ground
        What they stand on.
    seed : int
        Of the street.
    streams : tuple of Stream
        Who moves.
    middle_s, reach_m : float
        Place along the street, and how far from it they are looked for [m].
    step : int
        Number of the time step, of :data:`TIME_STEP_S`.
    """
    time_s = (step + 0.5) * TIME_STEP_S
    parts = []
    for stream in streams:
        shift = stream.speed * time_s
        first = int(np.floor((middle_s - reach_m - shift) / stream.spacing))
        last = int(np.floor((middle_s + reach_m - shift) / stream.spacing))
        for number in range(first, last + 1):
            rng = generator(seed, Purpose.MOVERS, number + stream.index * 2**36)
            s = (number + 0.8 * rng.random()) * stream.spacing + shift
            if abs(s - middle_s) < reach_m:
                parts.append(_mover(ground, seed, stream, number, s, time_s, rng))
    return Bodies.join(parts)


def _mover(
    ground: Ground, seed: int, stream: Stream, number: int, s: float, time_s: float, rng: np.random.Generator
) -> Bodies:
    frame = frame_at(ground, s, stream.d, tilted=True)
    velocity = stream.speed * np.cos(frame.yaw), stream.speed * np.sin(frame.yaw)
    # bodies are given where they would have been at time 0
    begin = replace(frame, x=frame.x - velocity[0] * time_s, y=frame.y - velocity[1] * time_s)
    if stream.speed < 0:
        begin = replace(begin, yaw=begin.yaw + np.pi, slope=-begin.slope, roll=-begin.roll)
    pile = Pile(_FIRST_NUMBER + stream.index * _STREAM_NUMBERS + (number + 2.0**30) * _EACH)
    pile.velocity = velocity
    if stream.cars:
        cars.car(pile, begin, cars.draw_model(rng))
    else:
        upright = Frame(begin.x, begin.y, begin.z - _step_down(ground, seed, s, stream.d), begin.yaw)
        person(pile, upright, rng, rng.uniform(0.3, 0.7))
    return pile.bodies()


def _step_down(ground: Ground, seed: int, s: float, d: float) -> float:
    """Who crosses a side street is a curb lower [m]."""
    junction = junction_of(seed, int(np.floor(s / PIECE_M)))
    crosses = junction is not None and junction.on(1 if d > 0 else -1) and abs(s - junction.s) < junction.half + 0.5
    return ground.curb_m if crosses else 0.0
