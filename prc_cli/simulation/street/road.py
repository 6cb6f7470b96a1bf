"""The ground: road, curbs that drop at driveways and crossings, sidewalks, land, side streets.

One surface of triangles that share their corners. Across the street it is made of strips between
lines of constant distance from the crown; along the street its lines are straight between stations
of 5 m, so that corners that stand on a line between stations leave no cracks.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from prc_cli.core.types import F64
from prc_cli.simulation.street.pile import Frame, Pile, Point, Span
from prc_cli.simulation.street.plan import (
    BUILDING_LINE_M,
    CORNER_M,
    DROP_M,
    PIECE_M,
    ROAD_HALF_M,
    Junction,
    Plan,
    Side,
)
from prc_cli.simulation.world import Material

LANE_M = -1.75
"""The lane's middle is this far to the left of the crown [m]; arc length is measured here."""
PERIOD_M = 4800.0
"""The curves repeat after this way [m]; objects do not."""
_STEP_M = 1.0
_TURNS = ((3, 0.20), (7, 0.12), (13, 0.11))
"""Curves: periods in :data:`PERIOD_M` and largest turn of each [rad]; no radius is below 250 m."""
_HILLS = ((4, 5.0), (15, 0.45))
"""Hills: periods in :data:`PERIOD_M` and height [m]; no slope is above 3.5 %."""
_SIDE_SLOPES = ((5, 0.025), (19, 0.012))
"""The land beside the street: periods in :data:`PERIOD_M` and slope across [m/m]."""


class Centreline:
    """A line that is followed by the middle of the right-hand lane.

    Its arc length (in plan) is the parameter s.

    The heading is a sum of three sines of s; the position is its integral, tabulated once over one
    period and interpolated by cubics that have the line's own tangents (error below a micrometre).
    All periods are alike but for a shift, so that any s costs the same.
    """

    def __init__(self, rng: np.random.Generator, curves: float, hills: float) -> None:
        self._turns = _waves(rng, _TURNS, curves)
        self._hills = _waves(rng, _HILLS, hills)
        self._sides = {side: _waves(rng, _SIDE_SLOPES, hills) for side in (1, -1)}
        self._turn_0 = float(_sum(self._turns, np.zeros(1))[0])
        self._hill_0 = float(_sum(self._hills, np.zeros(1))[0])
        node = np.arange(int(PERIOD_M / _STEP_M) + 1) * _STEP_M
        places, weights = np.polynomial.legendre.leggauss(4)
        between = self.heading(node[:-1, None] + 0.5 * _STEP_M * (places + 1.0))
        steps = (
            0.5 * _STEP_M * np.stack([np.cos(between) @ weights, np.sin(between) @ weights], axis=1)
        )
        self._table: F64 = np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])

    def heading(self, s_m: F64) -> F64:
        """Direction of the street, of the shape of ``s_m``, 0 = +x, positive to the left [rad]."""
        return _sum(self._turns, s_m) - self._turn_0

    def height(self, s_m: F64) -> F64:
        """Crown of the road above its start [m]; same shape as ``s_m``."""
        return _sum(self._hills, s_m) - self._hill_0

    def side_slope(self, s_m: F64, side: int) -> F64:
        """Return the slope of the land left (1) or right (-1), positive = up outwards [m/m]."""
        return _sum(self._sides[side], s_m)

    def lane(self, s_m: F64) -> F64:
        """Return the middle of the lane in plan at distances (n,), (n, 2) float64 [m]."""
        turns = np.floor(s_m / PERIOD_M)
        within = s_m - turns * PERIOD_M
        i = np.minimum((within / _STEP_M).astype(np.int64), len(self._table) - 2)
        f = (within / _STEP_M - i)[:, None]
        ends = self.heading(i * _STEP_M), self.heading((i + 1) * _STEP_M)
        t0, t1 = (_STEP_M * np.stack([np.cos(end), np.sin(end)], axis=1) for end in ends)
        p0 = self._table[i]
        p1 = self._table[i + 1]
        # cubic of Hermite
        inside = (
            (1 + 2 * f) * (1 - f) ** 2 * p0
            + f * (1 - f) ** 2 * t0
            + f**2 * (3 - 2 * f) * p1
            - f**2 * (1 - f) * t1
        )
        place: F64 = inside + turns[:, None] * self._table[-1]
        return place

    def place(self, s_m: F64, d_m: F64) -> F64:
        """Points ``d_m`` to the left of the crown, (n, 2) float64 [m]."""
        heading = self.heading(s_m)
        away = (d_m - LANE_M)[:, None]
        place: F64 = self.lane(s_m) + away * np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        return place

    def nearest(self, x_m: float, y_m: float) -> float:
        """Distance along the street of the place that is nearest to a point, to a metre [m]."""
        shift = self._table[-1]
        first = np.floor((x_m * shift[0] + y_m * shift[1]) / (shift @ shift))
        best = np.inf
        result = 0.0
        for turn in (first - 1.0, first, first + 1.0):
            gap = self._table + turn * shift - (x_m, y_m)
            way = np.einsum("ij,ij->i", gap, gap)
            i = int(np.argmin(way))
            if way[i] < best:
                best = float(way[i])
                result = float(turn * PERIOD_M + i * _STEP_M)
        return result


def _waves(rng: np.random.Generator, sizes: tuple[tuple[int, float], ...], factor: float) -> F64:
    """Wave number [1/m], amplitude and phase [rad] of every sine, (n, 3)."""
    rows = [
        (2 * np.pi * count / PERIOD_M, factor * size, rng.uniform(0, 2 * np.pi))
        for count, size in sizes
    ]
    return np.array(rows)


def _sum(waves: F64, s_m: F64) -> F64:
    total: F64 = (waves[:, 1] * np.sin(waves[:, 0] * s_m[..., None] + waves[:, 2])).sum(axis=-1)
    return total


STATION_M = 5.0
FAR_M = 62.0
"""The ground ends this far from the crown [m]."""
_FRONT_M = 14.8
"""Front gardens end here [m]."""
_CROSS_FALL = 0.0225
WALK_SLOPE = 0.02
_RAMP_M = 1.4
"""Width of the strip beside the curb: verge, or the ramp of a dropped curb [m]."""
_BATTER_M = 0.02
"""The top of a curb stands back from its foot by this much [m]."""
_LOW_CURB_M = 0.03


@dataclass(frozen=True, slots=True)
class Kerbside:
    """Kerb and verge of a side of a piece."""

    lowered: bool = False
    """The curb is low everywhere."""
    verge_m: float = 0.0
    """Height of a raised verge above the curb [m]; 0 = none."""


PLAIN = Kerbside()
"""A curb, and no raised verge."""


class Ground:
    """Heights and triangles of the ground."""

    def __init__(self, line: Centreline, curb_m: float) -> None:
        self.line = line
        self.curb_m = curb_m

    def road(self, s_m: F64, d_m: F64) -> F64:
        """Height of the road, continued under sidewalks and land, (n,) float64 [m]."""
        away = np.abs(d_m)
        slope = np.where(d_m > 0, self.line.side_slope(s_m, 1), self.line.side_slope(s_m, -1))
        fall = -_CROSS_FALL * np.minimum(away, ROAD_HALF_M)
        walk = WALK_SLOPE * np.clip(away - ROAD_HALF_M, 0.0, BUILDING_LINE_M - ROAD_HALF_M)
        result: F64 = (
            self.line.height(s_m) + fall + walk + slope * np.maximum(away - BUILDING_LINE_M, 0.0)
        )
        return result

    def height(self, s_m: float, d_m: float) -> float:
        """Return the height of the ground, without side streets and dropped curbs [m]."""
        raised = self.curb_m if abs(d_m) > ROAD_HALF_M else 0.0
        return float(self.road(np.array([s_m]), np.array([d_m]))[0]) + raised

    def ramp(self, away_m: float) -> float:
        """Return the drop of the ground behind a lowered curb, by distance from the crown [m]."""
        return (self.curb_m - _LOW_CURB_M) * max(1.0 - (away_m - ROAD_HALF_M) / _RAMP_M, 0.0)

    def spot(
        self, s: float, d: float, *, tilted: bool
    ) -> tuple[float, float, float, float, float, float]:
        """Return place and height [m], heading [rad], slopes along and left, 0 if not tilted."""
        places = np.array([s, s - 1.0, s + 1.0])
        heading = self.line.heading(places)
        (x, y), *_ = self.line.place(places, np.full(3, d)).tolist()
        z = self.road(places, np.full(3, d)).tolist()
        up = self.curb_m if abs(d) > ROAD_HALF_M else 0.0
        if not tilted:
            return x, y, z[0] + up, float(heading[0]), 0.0, 0.0
        roll = -float(np.sign(d)) * _CROSS_FALL if abs(d) < ROAD_HALF_M else 0.0
        return x, y, z[0] + up, float(heading[0]), 0.5 * (z[2] - z[1]), roll

    def lay(
        self, pile: Pile, plan: Plan, kerbsides: tuple[Kerbside, Kerbside] = (PLAIN, PLAIN)
    ) -> None:
        """Add the ground of a piece; its sides have the kerbs and verges of ``kerbsides``."""
        mesh = _Mesh(self, plan.start, pile)
        base = mesh.s.tolist()
        for side, kerbside in zip(plan.sides, kerbsides, strict=True):
            for s0, s1 in itertools.pairwise(base):
                mesh.strip((s0, s1), (0.0, side.side * ROAD_HALF_M), 0.0, Material.ASPHALT)
            verge = plan.character in ("suburb", "boulevard")
            for low, high in _stretches(side, base):
                curb_m = _LOW_CURB_M if kerbside.lowered else self.curb_m
                mesh.kerbside(_stops(side, base, (low, high), curb_m), side, verge=verge)
                if kerbside.verge_m > 0:
                    mesh.raised_verge(_verges(side, base, (low, high)), side, kerbside.verge_m)
            self._land(mesh, side, base, plan)
            if side.junction is not None:
                _side_street(mesh, side.junction, side.side, self.curb_m)

    def _land(
        self,
        mesh: _Mesh,
        side: Side,
        base: list[float],
        plan: Plan,
    ) -> None:
        ways = [lot.driveway for lot in side.lots if lot.driveway is not None]
        junction = side.junction
        top = self.curb_m
        more = [s for way in ways for s in way]
        if junction is not None:
            more += [*junction.open, *_edges(junction)]
        every = [s for s in sorted({*base, *more}) if base[0] <= s <= base[-1]]
        soil = plan.character == "terraces" or (
            plan.piece % 3 == 1 and plan.character == "residential"
        )
        land = Material.SOIL if soil else Material.GRASS
        for s0, s1 in itertools.pairwise(every):
            middle = 0.5 * (s0 + s1)
            paved = land
            if junction is not None and junction.open[0] < middle < junction.open[1]:
                if _edges(junction)[0] < middle < _edges(junction)[1]:
                    continue
                paved = Material.SIDEWALK
            drive = any(low < middle < high for low, high in ways)
            front = Material.SIDEWALK if drive else paved
            mesh.strip((s0, s1), (side.side * BUILDING_LINE_M, side.side * _FRONT_M), top, front)
            mesh.strip((s0, s1), (side.side * _FRONT_M, side.side * FAR_M), top, paved)


class _CurbStop(NamedTuple):
    """A place along a curb: distance along the street and from its crown, without sign [m]."""

    s_foot: float
    d_foot: float
    s_top: float
    d_top: float
    height_m: float


class _Mesh:
    """Turns places of the street into corners: straight between the stations."""

    def __init__(self, ground: Ground, start: float, pile: Pile) -> None:
        self.ground = ground
        self.start = start
        self.pile = pile
        self.s: F64 = start + STATION_M * np.arange(int(PIECE_M / STATION_M) + 1, dtype=np.float64)
        line = ground.line
        crown = np.zeros(self.s.shape)
        heading = line.heading(self.s)
        self._rows: list[list[float]] = np.column_stack(
            [
                line.place(self.s, crown),
                -np.sin(heading),
                np.cos(heading),
                line.height(self.s),
                line.side_slope(self.s, 1),
                line.side_slope(self.s, -1),
            ]
        ).tolist()

    def point(self, s: float, d: float, up: float) -> Point:
        """Corner at a height above the (continued) road [m]."""
        i = min(max(int((s - self.start) // STATION_M), 0), len(self._rows) - 2)
        f = (s - self.start) / STATION_M - i
        x, y, left, ahead, z, *slopes = (
            (1 - f) * before + f * after
            for before, after in zip(self._rows[i], self._rows[i + 1], strict=True)
        )
        away = abs(d)
        fall = WALK_SLOPE * min(max(away - ROAD_HALF_M, 0.0), BUILDING_LINE_M - ROAD_HALF_M)
        fall -= _CROSS_FALL * min(away, ROAD_HALF_M)
        beyond = max(away - BUILDING_LINE_M, 0.0) * slopes[0 if d > 0 else 1]
        return x + d * left, y + d * ahead, z + fall + beyond + up

    def strip(
        self,
        along: Span,
        across: Span,
        up: float,
        material: Material,
    ) -> None:
        """Add a strip at a height above the road."""
        (s0, s1) = along
        (d0, d1) = across
        corners = (
            self.point(s0, d0, up),
            self.point(s1, d0, up),
            self.point(s1, d1, up),
            self.point(s0, d1, up),
        )
        self.pile.quad(*corners, material)

    def kerbside(self, stops: list[_CurbStop], side: Side, *, verge: bool) -> None:
        """Add gutter corners, curb, verge and sidewalk along the stops of a curb."""
        top = self.ground.curb_m
        gutter = side.side * ROAD_HALF_M
        back = side.side * BUILDING_LINE_M
        lines = []
        for s_foot, d_foot, s_top, d_top, curb in stops:
            inner = d_top + (BUILDING_LINE_M - d_top) * _RAMP_M / (BUILDING_LINE_M - ROAD_HALF_M)
            lines.append(
                (
                    self.point(s_foot, gutter, 0.0),
                    self.point(s_foot, side.side * d_foot, 0.0),
                    self.point(s_top, side.side * d_top, curb),
                    self.point(s_top, side.side * inner, top),
                    self.point(s_top, back, top),
                )
            )
        for i in range(len(stops) - 1):
            a = lines[i]
            b = lines[i + 1]
            is_straight = max(stops[i].d_foot, stops[i + 1].d_foot) <= ROAD_HALF_M
            is_high = min(stops[i].height_m, stops[i + 1].height_m) >= top - 1e-9
            green = verge and is_high and is_straight
            materials = (
                Material.ASPHALT,
                Material.CURB,
                Material.GRASS if green else Material.SIDEWALK,
                Material.SIDEWALK,
            )
            for j, material in enumerate(materials):
                if j == 0 and is_straight:
                    continue
                self.pile.quad(a[j], b[j], b[j + 1], a[j + 1], material)

    def raised_verge(self, stretches: list[Span], side: Side, height_m: float) -> None:
        """Add a verge over the strip at the curb, between edging stones on all sides."""
        top = self.ground.curb_m + height_m
        d0, d1 = (side.side * d for d in (ROAD_HALF_M + 2 * _BATTER_M, ROAD_HALF_M + _RAMP_M))
        for low, high in stretches:
            places = [low, *(s for s in self.s.tolist() if low < s < high), high]
            for s0, s1 in itertools.pairwise(places):
                self.strip((s0, s1), (d0, d1), top, Material.GRASS)
            corners = [(s, d0) for s in places] + [(s, d1) for s in reversed(places)]
            for (s0, from_d), (s1, to_d) in zip(corners, corners[1:] + corners[:1], strict=True):
                a = self.point(s0, from_d, self.ground.curb_m)
                b = self.point(s1, to_d, self.ground.curb_m)
                c = self.point(s1, to_d, top)
                d = self.point(s0, from_d, top)
                self.pile.quad(a, b, c, d, Material.CURB)


def _verges(side: Side, base: list[float], stretch: Span) -> list[Span]:
    # low curbs and the bends of side streets have no verge
    low, high = stretch
    if side.junction is not None:
        low, high = (
            (low, side.junction.bend[0])
            if high < side.junction.s
            else (side.junction.bend[1], high)
        )
    low = max(low, base[0])
    high = min(high, base[-1])
    verges = []
    for d0, d1 in [*side.dropped, (high + DROP_M, high)]:
        end = min(d0 - DROP_M, high)
        if end - low > 1.0:
            verges.append((low, end))
        low = max(low, d1 + DROP_M)
    return verges


def _edges(junction: Junction) -> Span:
    return junction.s - junction.half - _BATTER_M, junction.s + junction.half + _BATTER_M


def _stretches(side: Side, base: list[float]) -> list[Span]:
    if side.junction is None:
        return [(base[0], base[-1])]
    return [
        (base[0], side.junction.s - side.junction.half),
        (side.junction.s + side.junction.half, base[-1]),
    ]


def _stops(
    side: Side,
    base: list[float],
    stretch: Span,
    curb_m: float,
) -> list[_CurbStop]:
    low, high = stretch
    straight_low = low
    straight_high = high
    arc: list[_CurbStop] = []
    junction = side.junction
    if junction is not None:
        end = -1 if high < junction.s else 1
        middle = junction.bend[0] if end < 0 else junction.bend[1]
        straight_low, straight_high = (low, middle) if end < 0 else (middle, high)
        for a in np.linspace(0.0, 0.5 * np.pi, 5).tolist():
            foot = CORNER_M
            top = CORNER_M - _BATTER_M
            into = float(np.sin(a))
            out = float(np.cos(a))
            centre = ROAD_HALF_M + CORNER_M
            arc.append(
                _CurbStop(
                    s_foot=middle - end * foot * into,
                    d_foot=centre - foot * out,
                    s_top=middle - end * top * into,
                    d_top=centre - top * out,
                    height_m=curb_m,
                )
            )
        arc = arc if end < 0 else arc[::-1]
    knots = []
    heights = []
    for d0, d1 in side.dropped:
        knots += [d0 - DROP_M, d0, d1, d1 + DROP_M]
        heights += [curb_m, _LOW_CURB_M, _LOW_CURB_M, curb_m]
    every = {*base, *knots, straight_low, straight_high}
    places = sorted(s for s in every if straight_low <= s <= straight_high)
    curbs = np.interp(places, knots, heights).tolist() if knots else [curb_m] * len(places)
    straight = [
        _CurbStop(s, ROAD_HALF_M, s, ROAD_HALF_M + _BATTER_M, height_m)
        for s, height_m in zip(places, curbs, strict=True)
    ]
    if not arc:
        return straight
    return straight[:-1] + arc if high < (junction.s if junction else 0.0) else arc + straight[1:]


def _side_street(
    mesh: _Mesh,
    junction: Junction,
    side: int,
    curb_m: float,
) -> None:
    """Add a side street: a road with a crown from the main road on, and its curbs."""
    corner = ROAD_HALF_M + CORNER_M
    across = [ROAD_HALF_M, corner, BUILDING_LINE_M, _FRONT_M, FAR_M]
    low = junction.s - junction.half
    high = junction.s + junction.half
    inner = mesh.s[(mesh.s > low) & (mesh.s < high)].tolist()
    along = sorted({low, *inner, junction.s, high})

    def crown(s: float, d: float) -> float:
        return (
            _CROSS_FALL
            * (junction.half - abs(s - junction.s))
            * min((d - ROAD_HALF_M) / CORNER_M, 1.0)
        )

    for s0, s1 in itertools.pairwise(along):
        for d0, d1 in itertools.pairwise(across):
            places = ((s0, d0), (s1, d0), (s1, d1), (s0, d1))
            a, b, c, d = (mesh.point(s, side * away, crown(s, away)) for s, away in places)
            mesh.pile.quad(a, b, c, d, Material.ASPHALT)
    for foot, top in ((low, low - _BATTER_M), (high, high + _BATTER_M)):
        for d0, d1 in itertools.pairwise(across):
            a = mesh.point(foot, side * d0, 0.0)
            b = mesh.point(foot, side * d1, 0.0)
            c = mesh.point(top, side * d1, curb_m)
            d = mesh.point(top, side * d0, curb_m)
            mesh.pile.quad(a, b, c, d, Material.CURB)


def frame_at(
    ground: Ground,
    s: float,
    d: float,
    mirror: int = 1,
    *,
    tilted: bool = False,
) -> Frame:
    """Return a frame on the ground with u along the street.

    ``tilted`` = with the slopes of the road.
    """
    x, y, z, yaw, slope, roll = ground.spot(s, d, tilted=tilted)
    return Frame(x, y, z, yaw, slope, roll * mirror, mirror)
