"""Where the street runs: heading and height in closed form, position by a table over one period of the curves."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F64

LANE_M = -1.75
"""The lane's middle is this far to the left of the crown of the road [m]; the line of arc length runs here."""
PERIOD_M = 4800.0
"""The curves repeat after this way [m]; what stands along the street does not."""
_STEP_M = 1.0
_TURNS = ((3, 0.20), (7, 0.12), (13, 0.11))
"""Curves: periods in :data:`PERIOD_M` and largest turn of each [rad]; no radius is below 250 m."""
_HILLS = ((4, 5.0), (15, 0.45))
"""Hills: periods in :data:`PERIOD_M` and height [m]; no slope is above 3.5 %."""
_SIDE_SLOPES = ((5, 0.025), (19, 0.012))
"""The land beside the street: periods in :data:`PERIOD_M` and slope across [m/m]."""


class Centreline:
    """A line that is followed by the middle of the right-hand lane; its arc length (in plan) is the parameter s.

    The heading is a sum of three sines of s; the position is its integral, tabulated once over one period and
    interpolated by cubics that have the line's own tangents (error below a micrometre). All periods are alike but
    for a shift, so that any s costs the same.
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
        steps = 0.5 * _STEP_M * np.stack([np.cos(between) @ weights, np.sin(between) @ weights], axis=1)
        self._table: F64 = np.vstack([np.zeros((1, 2)), np.cumsum(steps, axis=0)])

    def heading(self, s_m: F64) -> F64:
        """Direction of the street, 0 = +x, counter-clockwise, 0 at the start [rad]; same shape as ``s_m``."""
        return _sum(self._turns, s_m) - self._turn_0

    def height(self, s_m: F64) -> F64:
        """Crown of the road above its start [m]; same shape as ``s_m``."""
        return _sum(self._hills, s_m) - self._hill_0

    def side_slope(self, s_m: F64, side: int) -> F64:
        """Slope of the land on the left (1) or right (-1), positive = up away from the street [m/m]."""
        return _sum(self._sides[side], s_m)

    def lane(self, s_m: F64) -> F64:
        """Position of the lane's middle in plan, (n, 2) float64 [m], for (n,) distances of any sign."""
        turns = np.floor(s_m / PERIOD_M)
        within = s_m - turns * PERIOD_M
        i = np.minimum((within / _STEP_M).astype(np.int64), len(self._table) - 2)
        f = (within / _STEP_M - i)[:, None]
        ends = self.heading(i * _STEP_M), self.heading((i + 1) * _STEP_M)
        t0, t1 = (_STEP_M * np.stack([np.cos(end), np.sin(end)], axis=1) for end in ends)
        p0, p1 = self._table[i], self._table[i + 1]
        # cubic of Hermite
        inside = (1 + 2 * f) * (1 - f) ** 2 * p0 + f * (1 - f) ** 2 * t0 + f**2 * (3 - 2 * f) * p1 - f**2 * (1 - f) * t1
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
        best, result = np.inf, 0.0
        for turn in (first - 1.0, first, first + 1.0):
            gap = self._table + turn * shift - (x_m, y_m)
            way = np.einsum("ij,ij->i", gap, gap)
            i = int(np.argmin(way))
            if way[i] < best:
                best, result = float(way[i]), float(turn * PERIOD_M + i * _STEP_M)
        return result


def _waves(rng: np.random.Generator, sizes: tuple[tuple[int, float], ...], factor: float) -> F64:
    """Wave number [1/m], amplitude and phase [rad] of every sine, (n, 3)."""
    rows = [(2 * np.pi * count / PERIOD_M, factor * size, rng.uniform(0, 2 * np.pi)) for count, size in sizes]
    return np.array(rows)


def _sum(waves: F64, s_m: F64) -> F64:
    total: F64 = (waves[:, 1] * np.sin(waves[:, 0] * s_m[..., None] + waves[:, 2])).sum(axis=-1)
    return total
