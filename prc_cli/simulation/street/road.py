"""The ground: road, curbs that drop at driveways and crossings, sidewalks, land, side streets.

One surface of triangles that share their corners. Across the street it is made of strips between
lines of constant distance from the crown; along the street its lines are straight between stations
of 5 m, so that corners that stand on a line between stations leave no cracks.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
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
        # places at every step, by Gauss quadrature with four places within it
        node = np.arange(int(PERIOD_M / _STEP_M) + 1) * _STEP_M
        places, weights = np.polynomial.legendre.leggauss(4)
        heading = self.heading(node[:-1, None] + 0.5 * _STEP_M * (places + 1.0))
        sums = np.stack([np.cos(heading) @ weights, np.sin(heading) @ weights], axis=1)
        steps = 0.5 * _STEP_M * sums
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
        periods = np.floor(s_m / PERIOD_M)
        within = s_m - periods * PERIOD_M
        i = np.minimum((within / _STEP_M).astype(np.int64), len(self._table) - 2)
        f = (within / _STEP_M - i)[:, None]
        start = self._table[i]
        end = self._table[i + 1]
        start_heading = self.heading(i * _STEP_M)
        end_heading = self.heading((i + 1) * _STEP_M)
        start_tangent = _STEP_M * np.stack([np.cos(start_heading), np.sin(start_heading)], axis=1)
        end_tangent = _STEP_M * np.stack([np.cos(end_heading), np.sin(end_heading)], axis=1)
        # cubic of Hermite
        inside = (
            (1 + 2 * f) * (1 - f) ** 2 * start
            + f * (1 - f) ** 2 * start_tangent
            + f**2 * (3 - 2 * f) * end
            - f**2 * (1 - f) * end_tangent
        )
        place: F64 = inside + periods[:, None] * self._table[-1]
        return place

    def place(self, s_m: F64, d_m: F64) -> F64:
        """Points ``d_m`` to the left of the crown, (n, 2) float64 [m]."""
        heading = self.heading(s_m)
        left = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
        place: F64 = self.lane(s_m) + (d_m - LANE_M)[:, None] * left
        return place

    def nearest(self, x_m: float, y_m: float) -> float:
        """Distance along the street of the place that is nearest to a point, to a metre [m]."""
        shift = self._table[-1]
        period = np.floor((x_m * shift[0] + y_m * shift[1]) / (shift @ shift))
        least = np.inf
        nearest_s = 0.0
        for turn in (period - 1.0, period, period + 1.0):
            offset = self._table + turn * shift - (x_m, y_m)
            squared = np.einsum("ij,ij->i", offset, offset)
            i = int(np.argmin(squared))
            if squared[i] < least:
                least = float(squared[i])
                nearest_s = float(turn * PERIOD_M + i * _STEP_M)
        return nearest_s


def _waves(rng: np.random.Generator, sizes: Sequence[tuple[int, float]], factor: float) -> F64:
    """Wave number [1/m], amplitude and phase [rad] of every sine, (n, 3)."""
    rows = []
    for n_periods, amplitude in sizes:
        wave_number = 2 * np.pi * n_periods / PERIOD_M
        rows.append((wave_number, factor * amplitude, rng.uniform(0, 2 * np.pi)))
    return np.array(rows)


def _sum(waves: F64, s_m: F64) -> F64:
    wave_number, amplitude, phase = waves.T
    total: F64 = (amplitude * np.sin(wave_number * s_m[..., None] + phase)).sum(axis=-1)
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
        land = slope * np.maximum(away - BUILDING_LINE_M, 0.0)
        height: F64 = self.line.height(s_m) + fall + walk + land
        return height

    def height(self, s_m: float, d_m: float) -> float:
        """Return the height of the ground, without side streets and dropped curbs [m]."""
        raised = self.curb_m if abs(d_m) > ROAD_HALF_M else 0.0
        return float(self.road(np.array([s_m]), np.array([d_m]))[0]) + raised

    def ramp(self, away_m: float) -> float:
        """Return the drop of the ground behind a lowered curb, by distance from the crown [m]."""
        return (self.curb_m - _LOW_CURB_M) * max(1.0 - (away_m - ROAD_HALF_M) / _RAMP_M, 0.0)

    def spot(self, s: float, d: float, *, tilted: bool) -> Frame:
        """Return a frame on the ground with u along the street; level unless ``tilted``."""
        places = np.array([s, s - 1.0, s + 1.0])
        across = np.full(3, d)
        x, y = self.line.place(places, across)[0].tolist()
        yaw = float(self.line.heading(places)[0])
        z, z_before, z_after = self.road(places, across).tolist()
        is_on_road = abs(d) < ROAD_HALF_M
        if abs(d) > ROAD_HALF_M:
            z += self.curb_m
        if not tilted:
            return Frame(x, y, z, yaw)
        roll = -float(np.sign(d)) * _CROSS_FALL if is_on_road else 0.0
        return Frame(x, y, z, yaw, slope=0.5 * (z_after - z_before), roll=roll)

    def lay(self, pile: Pile, plan: Plan, left: Kerbside = PLAIN, right: Kerbside = PLAIN) -> None:
        """Add the ground of a piece with the kerbs and verges of its sides."""
        mesh = _Mesh(self, plan.start, pile)
        stations = mesh.s.tolist()
        has_verge = plan.character in ("suburb", "boulevard")
        for side, kerbside in zip(plan.sides, (left, right), strict=True):
            road = (0.0, side.side * ROAD_HALF_M)
            for along in itertools.pairwise(stations):
                mesh.strip(along, road, 0.0, Material.ASPHALT)
            curb_m = _LOW_CURB_M if kerbside.lowered else self.curb_m
            for stretch in _stretches(side, stations):
                mesh.kerbside(_stops(side, stations, stretch, curb_m), side, verge=has_verge)
                if kerbside.verge_m > 0:
                    verges = _verges(side, stations, stretch)
                    mesh.raised_verge(verges, side, kerbside.verge_m)
            self._land(mesh, side, stations, plan)
            if side.junction is not None:
                _side_street(mesh, side.junction, side.side, self.curb_m)

    def _land(
        self,
        mesh: _Mesh,
        side: Side,
        stations: list[float],
        plan: Plan,
    ) -> None:
        """Add front gardens and the land behind them, paved at driveways and corners."""
        driveways = [lot.driveway for lot in side.lots if lot.driveway is not None]
        junction = side.junction
        borders = set(stations)
        for driveway in driveways:
            borders.update(driveway)
        if junction is not None:
            borders.update(junction.open)
            borders.update(_edges(junction))
        places = sorted(s for s in borders if stations[0] <= s <= stations[-1])
        has_soil = plan.character == "terraces" or (
            plan.piece % 3 == 1 and plan.character == "residential"
        )
        front = (side.side * BUILDING_LINE_M, side.side * _FRONT_M)
        behind = (side.side * _FRONT_M, side.side * FAR_M)
        for along in itertools.pairwise(places):
            middle = 0.5 * (along[0] + along[1])
            material = Material.SOIL if has_soil else Material.GRASS
            if junction is not None and junction.open[0] < middle < junction.open[1]:
                street_low, street_high = _edges(junction)
                if street_low < middle < street_high:
                    continue
                material = Material.SIDEWALK
            is_driveway = any(low < middle < high for low, high in driveways)
            front_material = Material.SIDEWALK if is_driveway else material
            mesh.strip(along, front, self.curb_m, front_material)
            mesh.strip(along, behind, self.curb_m, material)


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
        x, y, left_x, left_y, z, left_slope, right_slope = (
            (1 - f) * before + f * after
            for before, after in zip(self._rows[i], self._rows[i + 1], strict=True)
        )
        away = abs(d)
        fall = WALK_SLOPE * min(max(away - ROAD_HALF_M, 0.0), BUILDING_LINE_M - ROAD_HALF_M)
        fall -= _CROSS_FALL * min(away, ROAD_HALF_M)
        slope = left_slope if d > 0 else right_slope
        land = max(away - BUILDING_LINE_M, 0.0) * slope
        return x + d * left_x, y + d * left_y, z + fall + land + up

    def strip(
        self,
        along: Span,
        across: Span,
        up: float,
        material: Material,
    ) -> None:
        """Add a strip at a height above the road."""
        s0, s1 = along
        d0, d1 = across
        a = self.point(s0, d0, up)
        b = self.point(s1, d0, up)
        c = self.point(s1, d1, up)
        d = self.point(s0, d1, up)
        self.pile.quad(a, b, c, d, material)

    def kerbside(self, stops: list[_CurbStop], side: Side, *, verge: bool) -> None:
        """Add gutter corners, curb, verge and sidewalk along the stops of a curb."""
        top = self.ground.curb_m
        gutter = side.side * ROAD_HALF_M
        back = side.side * BUILDING_LINE_M
        walk_m = BUILDING_LINE_M - ROAD_HALF_M
        lines = []
        for stop in stops:
            inner = stop.d_top + (BUILDING_LINE_M - stop.d_top) * _RAMP_M / walk_m
            lines.append(
                (
                    self.point(stop.s_foot, gutter, 0.0),
                    self.point(stop.s_foot, side.side * stop.d_foot, 0.0),
                    self.point(stop.s_top, side.side * stop.d_top, stop.height_m),
                    self.point(stop.s_top, side.side * inner, top),
                    self.point(stop.s_top, back, top),
                )
            )
        for i in range(len(stops) - 1):
            is_straight = max(stops[i].d_foot, stops[i + 1].d_foot) <= ROAD_HALF_M
            is_high = min(stops[i].height_m, stops[i + 1].height_m) >= top - 1e-9
            is_green = verge and is_high and is_straight
            materials = [Material.ASPHALT, Material.CURB, Material.SIDEWALK, Material.SIDEWALK]
            if is_green:
                materials[2] = Material.GRASS
            a = lines[i]
            b = lines[i + 1]
            # a straight curb has no corner of the gutter before it
            for j in range(1 if is_straight else 0, len(materials)):
                self.pile.quad(a[j], b[j], b[j + 1], a[j + 1], materials[j])

    def raised_verge(self, stretches: list[Span], side: Side, height_m: float) -> None:
        """Add a verge over the strip at the curb, between edging stones on all sides."""
        foot = self.ground.curb_m
        top = foot + height_m
        front = side.side * (ROAD_HALF_M + 2 * _BATTER_M)
        back = side.side * (ROAD_HALF_M + _RAMP_M)
        for low, high in stretches:
            places = [low, *(s for s in self.s.tolist() if low < s < high), high]
            for along in itertools.pairwise(places):
                self.strip(along, (front, back), top, Material.GRASS)
            # around the verge: along its front, back along its other side
            corners = [(s, front) for s in places] + [(s, back) for s in reversed(places)]
            for (s0, d0), (s1, d1) in itertools.pairwise([*corners, corners[0]]):
                a = self.point(s0, d0, foot)
                b = self.point(s1, d1, foot)
                c = self.point(s1, d1, top)
                d = self.point(s0, d0, top)
                self.pile.quad(a, b, c, d, Material.CURB)


def _verges(side: Side, stations: list[float], stretch: Span) -> list[Span]:
    """Return where verges are along a stretch: not at low curbs and bends of side streets."""
    low, high = stretch
    if side.junction is not None:
        if high < side.junction.s:
            high = side.junction.bend[0]
        else:
            low = side.junction.bend[1]
    low = max(low, stations[0])
    high = min(high, stations[-1])
    verges = []
    for dropped_low, dropped_high in [*side.dropped, (high + DROP_M, high)]:
        end = min(dropped_low - DROP_M, high)
        if end - low > 1.0:
            verges.append((low, end))
        low = max(low, dropped_high + DROP_M)
    return verges


def _edges(junction: Junction) -> Span:
    return junction.s - junction.half - _BATTER_M, junction.s + junction.half + _BATTER_M


def _stretches(side: Side, stations: list[float]) -> list[Span]:
    """Return the curbs of a side: one, or one before and one behind its junction."""
    first = stations[0]
    last = stations[-1]
    if side.junction is None:
        return [(first, last)]
    before = side.junction.s - side.junction.half
    behind = side.junction.s + side.junction.half
    return [(first, before), (behind, last)]


def _stops(
    side: Side,
    stations: list[float],
    stretch: Span,
    curb_m: float,
) -> list[_CurbStop]:
    """Return the places along a curb: straight ones, and a quarter circle at a junction."""
    low, high = stretch
    junction = side.junction
    is_before = junction is not None and high < junction.s
    arc: list[_CurbStop] = []
    if junction is not None:
        arc = _arc(junction, curb_m, is_before=is_before)
        if is_before:
            high = junction.bend[0]
        else:
            low = junction.bend[1]
    knots: list[float] = []
    heights: list[float] = []
    for dropped_low, dropped_high in side.dropped:
        knots += [dropped_low - DROP_M, dropped_low, dropped_high, dropped_high + DROP_M]
        heights += [curb_m, _LOW_CURB_M, _LOW_CURB_M, curb_m]
    places = sorted(s for s in {*stations, *knots, low, high} if low <= s <= high)
    curbs = np.interp(places, knots, heights).tolist() if knots else [curb_m] * len(places)
    straight = [
        _CurbStop(s, ROAD_HALF_M, s, ROAD_HALF_M + _BATTER_M, height_m)
        for s, height_m in zip(places, curbs, strict=True)
    ]
    if not arc:
        return straight
    return straight[:-1] + arc if is_before else arc + straight[1:]


def _arc(junction: Junction, curb_m: float, *, is_before: bool) -> list[_CurbStop]:
    """Return the quarter circle of a curb into a side street, in the order of the main street."""
    end = -1 if is_before else 1
    middle = junction.bend[0] if is_before else junction.bend[1]
    centre = ROAD_HALF_M + CORNER_M
    foot = CORNER_M
    top = CORNER_M - _BATTER_M
    stops = []
    for angle in np.linspace(0.0, 0.5 * np.pi, 5).tolist():
        along = float(np.sin(angle))
        out = float(np.cos(angle))
        stops.append(
            _CurbStop(
                s_foot=middle - end * foot * along,
                d_foot=centre - foot * out,
                s_top=middle - end * top * along,
                d_top=centre - top * out,
                height_m=curb_m,
            )
        )
    return stops if is_before else stops[::-1]


def _side_street(
    mesh: _Mesh,
    junction: Junction,
    side: int,
    curb_m: float,
) -> None:
    """Add a side street: a road with a crown from the main road on, and its curbs."""
    low = junction.s - junction.half
    high = junction.s + junction.half
    inner = mesh.s[(mesh.s > low) & (mesh.s < high)].tolist()
    along = sorted({low, *inner, junction.s, high})
    across = [ROAD_HALF_M, ROAD_HALF_M + CORNER_M, BUILDING_LINE_M, _FRONT_M, FAR_M]

    def on_road(s: float, d: float) -> Point:
        from_edge = junction.half - abs(s - junction.s)
        crown = _CROSS_FALL * from_edge * min((d - ROAD_HALF_M) / CORNER_M, 1.0)
        return mesh.point(s, side * d, crown)

    for s0, s1 in itertools.pairwise(along):
        for d0, d1 in itertools.pairwise(across):
            a = on_road(s0, d0)
            b = on_road(s1, d0)
            c = on_road(s1, d1)
            d = on_road(s0, d1)
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
    frame = ground.spot(s, d, tilted=tilted)
    return replace(frame, roll=frame.roll * mirror, mirror=mirror)
