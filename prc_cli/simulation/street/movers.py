"""Cars, vans and lorries, parked or oncoming, and people who walk, at any time.

A car is a body with wheel arches, a cabin of glass with a roof and pillars, wheels, and a gap
below. Measures are those of common models: cars 3.8 to 4.8 m long, 1.75 to 1.85 m wide and 1.45 to
1.65 m high with 16 to 20 cm of ground clearance and tyres of 62 to 66 cm; vans 5 to 5.6 m long and
1.95 to 2.5 m high; lorries of 7.5 t.

All movers of a stream have the same speed, like beads on a string that moves along the street. So
the movers near a place at a time follow by arithmetic.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from prc_cli.simulation.street.pile import Frame, Pile, Point, Span
from prc_cli.simulation.street.plan import (
    PIECE_M,
    Purpose,
    StreetSceneParams,
    generator,
    junction_of,
)
from prc_cli.simulation.street.road import Ground, frame_at
from prc_cli.simulation.world import Bodies, Material


@dataclass(frozen=True, slots=True)
class Model:
    """Measures of a car; u is forward from its middle, w is up [m]."""

    half: float
    wide: float
    """Half of its width."""
    clearance: float
    tyre: float
    """Radius of a tyre."""
    axles: Span
    """Rear, front."""
    deck: tuple[tuple[float, float], ...]
    """Upper edge of the body from the rear to the front, (u, w)."""
    cabin: tuple[float, float, float, float]
    """Foot of the rear window, rear and front of the roof, foot of the windscreen."""
    roof: float
    lean: float
    """The roof is narrower than the waist by this much on either side."""
    glazed: bool
    """False = a van or lorry whose cabin has panes at its front only."""

    def waist(self, u: float) -> float:
        """Upper edge of the body [m]."""
        places, heights = zip(*self.deck, strict=True)
        return float(np.interp(u, places, heights))


def draw_model(rng: np.random.Generator, vans: float = 0.12) -> Model:
    """Draw a car, or a van with a probability."""
    kind, length, tyre, height, tail, width = rng.random(6).tolist()
    if kind < vans:
        half = 2.5 + 0.3 * length
        return Model(
            half=half,
            wide=0.98,
            clearance=0.20,
            tyre=0.33,
            axles=(-0.58 * half, 0.66 * half),
            deck=((-half, 1.10), (half - 0.85, 1.10), (half - 0.15, 0.85), (half, 0.50)),
            cabin=(-half + 0.02, -half + 0.12, half - 1.55, half - 0.75),
            roof=1.95 + 0.55 * height,
            lean=0.10,
            glazed=tail < 0.3,
        )
    half = 1.9 + 0.45 * length
    roof = 1.45 + 0.08 * height + (0.15 if kind > 0.8 else 0.0)
    waist = 0.62 * roof
    is_hatchback = tail < 0.6
    rear = -half + (0.10 if is_hatchback else 0.75)
    return Model(
        half=half,
        wide=0.875 + 0.05 * width,
        clearance=0.17 + 0.03 * tyre,
        tyre=0.31 + 0.02 * tyre,
        axles=(-0.60 * half, 0.64 * half),
        deck=(
            (-half, 0.50),
            (-half + 0.05, waist - 0.03),
            (half - 1.20, waist),
            (half - 0.25, 0.72),
            (half, 0.48),
        ),
        cabin=(rear, rear + (0.45 if is_hatchback else 0.75), half - 1.95, half - 1.10),
        roof=roof,
        lean=0.17,
        glazed=True,
    )


def car(pile: Pile, frame: Frame, model: Model) -> None:
    """Add a car."""
    _body(pile, frame, model)
    _cabin(pile, frame, model)
    under_u = (-model.half + 0.15, model.half - 0.15)
    under_v = (-model.wide + 0.25, model.wide - 0.25)
    pile.box(frame, under_u, under_v, (model.clearance + 0.02, 0.62), Material.CAR_BODY)
    for axle in model.axles:
        for side in (-1.0, 1.0):
            wheel = frame.point(axle, side * (model.wide - 0.12), model.tyre)
            pile.ellipsoid(wheel, (model.tyre, 0.13, model.tyre), frame.yaw, Material.TYRE)


def _body(pile: Pile, frame: Frame, model: Model) -> None:
    """Add flanks with arches over the wheels, bonnet and boot, ends."""
    arch = model.tyre + 0.05
    arch_top = 2 * model.tyre + 0.04
    low = [(-model.half, model.clearance + 0.1)]
    for axle in model.axles:
        low += [
            (axle - arch, model.clearance),
            (axle - 0.6 * arch, arch_top),
            (axle + 0.6 * arch, arch_top),
            (axle + arch, model.clearance),
        ]
    low.append((model.half, model.clearance + 0.1))
    # the upper edge has corners above the arches, so that no triangle lies across an arch
    above_arches = [(u, model.waist(u)) for u, w in low if w == arch_top]
    upper = sorted({*model.deck, *above_arches})
    inner = model.wide - 0.03
    for side in (-1.0, 1.0):
        under = [frame.point(u, side * model.wide, w) for u, w in low]
        over = [frame.point(u, side * inner, w) for u, w in upper]
        # triangles between the lower and the upper edge, from the rear to the front
        i = j = 0
        while i + 1 < len(low) or j + 1 < len(over):
            is_upper_done = j + 1 == len(over)
            if is_upper_done or (i + 1 < len(low) and low[i + 1][0] < upper[j + 1][0]):
                pile.triangle(under[i], under[i + 1], over[j], Material.CAR_BODY)
                i += 1
            else:
                pile.triangle(under[i], over[j + 1], over[j], Material.CAR_BODY)
                j += 1
    for (u0, w0), (u1, w1) in itertools.pairwise(model.deck):
        corners = ((u0, -inner, w0), (u1, -inner, w1), (u1, inner, w1), (u0, inner, w0))
        pile.face(frame, corners, Material.CAR_BODY)
    foot = model.clearance + 0.1
    for end in (-model.half, model.half):
        top = model.waist(end)
        corners = (
            (end, -model.wide, foot),
            (end, model.wide, foot),
            (end, inner, top),
            (end, -inner, top),
        )
        pile.face(frame, corners, Material.CAR_BODY)


def _cabin(pile: Pile, frame: Frame, model: Model) -> None:
    """Windows all around under a roof, and what is seen through them: seats."""
    back, roof_back, roof_front, front = model.cabin
    wide = model.wide - 0.04
    narrow = model.wide - model.lean

    def corner(
        foot: float,
        top: float,
        side: float,
        up: float,
    ) -> Point:
        """Point of a pillar between its foot (0) and the roof (1)."""
        low = model.waist(foot) - 0.02
        v = wide + up * (narrow - wide)
        return frame.point(foot + up * (top - foot), side * v, low + up * (model.roof - low))

    side_glass = Material.CAR_GLASS if model.glazed else Material.CAR_BODY
    rear = (back, roof_back)
    fore = (front, roof_front)
    for side in (-1.0, 1.0):
        levels = ((0.0, 0.88, side_glass), (0.88, 1.0, Material.CAR_BODY))
        for low, high, material in levels:
            a = corner(*rear, side, low)
            b = corner(*fore, side, low)
            c = corner(*fore, side, high)
            d = corner(*rear, side, high)
            pile.quad(a, b, c, d, material)
        if not model.glazed:
            _door_pane(pile, frame, model, side)
    for pillar, material in ((fore, Material.CAR_GLASS), (rear, side_glass)):
        a = corner(*pillar, -1.0, 0.0)
        b = corner(*pillar, 1.0, 0.0)
        c = corner(*pillar, 1.0, 1.0)
        d = corner(*pillar, -1.0, 1.0)
        pile.quad(a, b, c, d, material)
    a = corner(*rear, -1.0, 1.0)
    b = corner(*rear, 1.0, 1.0)
    c = corner(*fore, 1.0, 1.0)
    d = corner(*fore, -1.0, 1.0)
    pile.quad(a, b, c, d, Material.CAR_BODY)
    if model.glazed:
        for u in (roof_front - 0.3, 0.5 * (back + roof_front) + 0.2):
            backs = (u - 0.35, u - 0.2)
            pile.box(frame, backs, (-0.6, 0.6), (0.6, model.roof - 0.25), Material.CAR_BODY)


def _door_pane(
    pile: Pile,
    frame: Frame,
    model: Model,
    side: float,
) -> None:
    """Add the side window of a van's cabin, a little before its flank."""
    back = model.cabin[2] - 0.35
    front = model.cabin[3] - 0.25
    low = 0.12
    high = 0.62
    rise = model.roof - model.waist(back)

    def corner(u: float, up: float) -> Point:
        wide = model.wide - 0.04 + (model.wide - model.lean - model.wide + 0.04) * up
        return frame.point(u, side * (wide + 0.01), model.waist(u) + up * rise)

    a = corner(back, low)
    b = corner(front, low)
    c = corner(front - 0.4, high)
    d = corner(back, high)
    pile.quad(a, b, c, d, Material.CAR_GLASS)


def lorry(pile: Pile, frame: Frame, length: float) -> None:
    """Add a small lorry: a cabin with a windscreen before a box on wheels."""
    half = 0.5 * length
    wide = 1.15
    load_v = (-wide - 0.05, wide + 0.05)
    upper_cabin_u = (half - 1.75, half - 0.15)
    upper_cabin_v = (-wide + 0.05, wide - 0.05)
    pile.box(frame, (-half, half - 1.9), load_v, (1.0, 3.3), Material.CAR_BODY)
    pile.box(frame, (-half + 0.3, half - 0.2), (-0.45, 0.45), (0.55, 1.0), Material.CAR_BODY)
    pile.box(frame, (half - 1.75, half), (-wide, wide), (0.5, 1.45), Material.CAR_BODY)
    pile.box(frame, upper_cabin_u, upper_cabin_v, (1.45, 2.55), Material.CAR_BODY)
    windscreen = (
        (half - 0.02, -1.0, 1.5),
        (half - 0.02, 1.0, 1.5),
        (half - 0.13, 1.0, 2.4),
        (half - 0.13, -1.0, 2.4),
    )
    pile.face(frame, windscreen, Material.CAR_GLASS)
    for side in (-1.0, 1.0):
        v = side * (wide - 0.04)
        side_window = (
            (half - 1.3, v, 1.5),
            (half - 0.35, v, 1.5),
            (half - 0.45, v, 2.3),
            (half - 1.3, v, 2.3),
        )
        pile.face(frame, side_window, Material.CAR_GLASS)
        for axle in (-half + 1.4, half - 0.9):
            wheel = frame.point(axle, side * (wide - 0.16), 0.42)
            pile.ellipsoid(wheel, (0.42, 0.16, 0.42), frame.yaw, Material.TYRE)


def person(
    pile: Pile,
    frame: Frame,
    rng: np.random.Generator,
    stride: float,
) -> None:
    """Add a person; ``stride`` from foot to foot [m]."""
    tall = rng.uniform(1.55, 1.9)
    hip_w = 0.50 * tall
    for side in (-1.0, 1.0):
        foot = frame.point(0.5 * side * stride, 0.10 * side, 0.0)
        hip = frame.point(0.0, 0.09 * side, hip_w)
        pile.cone(foot, hip, (0.06, 0.09), Material.PERSON)
        hand = frame.point(-0.4 * side * stride, 0.29 * side, hip_w - 0.05)
        shoulder = frame.point(0.0, 0.21 * side, 0.81 * tall)
        pile.cone(hand, shoulder, (0.04, 0.055), Material.PERSON)
    trunk = (0.14, 0.21, 0.20 * tall)
    pile.ellipsoid(frame.point(0.0, 0.0, 0.67 * tall), trunk, frame.yaw, Material.PERSON)
    head = (0.10, 0.085, 0.065 * tall)
    pile.ellipsoid(frame.point(0.02, 0.0, 0.935 * tall), head, frame.yaw, Material.PERSON)


TIME_STEP_S = 0.25
"""Way and slope of cars change in these steps: they drive straight in between [s]."""
_WALK_STEP_S = 2.0
"""The same for people who walk [s]."""
_FIRST_NUMBER = 2.0**46
_STREAM_NUMBERS = 2.0**42
_EACH = 256.0


@dataclass(frozen=True, slots=True)
class Stream:
    """Movers that follow one another along the street."""

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
        """Time of a straight step [s]."""
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
    """The movers near any place at any time."""

    def __init__(self, ground: Ground, seed: int, params: StreetSceneParams) -> None:
        self._ground = ground
        self._seed = seed
        self._streams = streams_of(params)
        self._place = lru_cache(1024)(self._draw_place)
        self._bodies = lru_cache(256)(self._make)

    def near(self, middle_s: float, reach_m: float, time_s: float) -> list[Bodies]:
        """Return the movers near a place."""
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
            parts.extend(self._bodies(stream, number, step) for number in near)
        return parts

    def _rng(self, stream: Stream, number: int) -> np.random.Generator:
        return generator(self._seed, Purpose.MOVERS, number + stream.index * 2**36)

    def _draw_place(self, stream: Stream, number: int) -> float:
        """Distance along the street at time 0 [m]."""
        return (number + 0.8 * float(self._rng(stream, number).random())) * stream.spacing

    def _make(self, stream: Stream, number: int, step: int) -> Bodies:
        rng = self._rng(stream, number)
        time_s = (step + 0.5) * stream.step_s
        s = (number + 0.8 * rng.random()) * stream.spacing + stream.speed * time_s
        frame = frame_at(self._ground, s, stream.d, tilted=True)
        velocity = stream.speed * np.cos(frame.yaw), stream.speed * np.sin(frame.yaw)
        # bodies are given where they would have been at time 0
        x = frame.x - velocity[0] * time_s
        y = frame.y - velocity[1] * time_s
        begin = replace(frame, x=x, y=y)
        if stream.speed < 0:
            begin = replace(begin, yaw=begin.yaw + np.pi, slope=-begin.slope, roll=-begin.roll)
        pile = Pile(_FIRST_NUMBER + stream.index * _STREAM_NUMBERS + (number + 2.0**30) * _EACH)
        pile.velocity = velocity
        if stream.cars:
            car(pile, begin, draw_model(rng))
        else:
            # a person who crosses a side street steps down
            z = begin.z
            junction = junction_of(self._seed, int(np.floor(s / PIECE_M)))
            is_beside = junction is not None and junction.on(1 if stream.d > 0 else -1)
            if junction and is_beside and abs(s - junction.s) < junction.half + 0.5:
                z -= self._ground.curb_m
            person(pile, Frame(x, y, z, begin.yaw), rng, rng.uniform(0.3, 0.7))
        return pile.bodies()
