"""Oncoming cars and people who walk: where they are at any time, computed without what was before.

All of one stream have the same speed, so that they are beads on a string that moves along the street; which beads are
near a place at a time follows by arithmetic.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from prc_cli.simulation.street import cars
from prc_cli.simulation.street.pile import Frame, Pile
from prc_cli.simulation.street.plan import PIECE_M, Purpose, StreetSceneParams, generator, junction_of
from prc_cli.simulation.street.road import Ground, frame_at
from prc_cli.simulation.world import Bodies, Material


def person(pile: Pile, frame: Frame, rng: np.random.Generator, stride: float) -> None:
    """Add somebody."""
    tall = rng.uniform(1.55, 1.9)
    hip = 0.50 * tall
    for side in (-1.0, 1.0):
        foot = frame.at(0.5 * side * stride, 0.10 * side, 0.0)
        pile.cone((foot, frame.at(0.0, 0.09 * side, hip)), (0.06, 0.09), Material.PERSON)
        hand = frame.at(-0.4 * side * stride, 0.29 * side, hip - 0.05)
        pile.cone((hand, frame.at(0.0, 0.21 * side, 0.81 * tall)), (0.04, 0.055), Material.PERSON)
    pile.ellipsoid(frame.at(0.0, 0.0, 0.67 * tall), (0.14, 0.21, 0.20 * tall), frame.yaw, Material.PERSON)
    pile.ellipsoid(frame.at(0.02, 0.0, 0.935 * tall), (0.10, 0.085, 0.065 * tall), frame.yaw, Material.PERSON)


TIME_STEP_S = 0.25
"""Way and slope of cars are taken anew after this time: they drive straight in between."""
_WALK_STEP_S = 2.0
"""The same for those who walk."""
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

    @property
    def step_s(self) -> float:
        """How long one goes straight on [s]."""
        return TIME_STEP_S if self.cars else _WALK_STEP_S


def streams_of(params: StreetSceneParams) -> tuple[Stream, ...]:
    """Return the streams of a street."""
    streams = []
    if params.cars_per_km > 0:
        streams.append(Stream(0, -9.5, 1000.0 / params.cars_per_km, 1.75, cars=True))
    if params.people > 0:
        ways = ((7.6, 1.3), (8.05, -1.25), (-7.6, 1.35), (-8.05, -1.2))
        for i, (d, speed) in enumerate(ways):
            streams.append(Stream(1 + i, speed, 35.0 / params.people, d, cars=False))
    return tuple(streams)


class Movers:
    """Those that move, wherever and whenever."""

    def __init__(self, ground: Ground, seed: int, params: StreetSceneParams) -> None:
        self._ground, self._seed, self._streams = ground, seed, streams_of(params)
        self._place = lru_cache(1024)(self._draw_place)
        self._bodies = lru_cache(256)(self._make)

    def near(self, middle_s: float, reach_m: float, time_s: float) -> list[Bodies]:
        """Return those that are near a place."""
        parts: list[Bodies] = []
        for stream in self._streams:
            step = int(np.floor(time_s / stream.step_s))
            shift = stream.speed * (step + 0.5) * stream.step_s
            first = int(np.floor((middle_s - reach_m - shift) / stream.spacing))
            last = int(np.floor((middle_s + reach_m - shift) / stream.spacing))
            near = [
                number
                for number in range(first, last + 1)
                if abs(self._place(stream, number) + shift - middle_s) < reach_m
            ]
            parts += [self._bodies(stream, number, step) for number in near]
        return parts

    def _rng(self, stream: Stream, number: int) -> np.random.Generator:
        return generator(self._seed, Purpose.MOVERS, number + stream.index * 2**36)

    def _draw_place(self, stream: Stream, number: int) -> float:
        """Distance along the street at time 0 [m]."""
        return (number + 0.8 * float(self._rng(stream, number).random())) * stream.spacing

    def _make(self, stream: Stream, number: int, step: int) -> Bodies:
        rng, time_s = self._rng(stream, number), (step + 0.5) * stream.step_s
        s = (number + 0.8 * rng.random()) * stream.spacing + stream.speed * time_s
        return _mover(self._ground, self._seed, stream, number, s, time_s, rng)


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
