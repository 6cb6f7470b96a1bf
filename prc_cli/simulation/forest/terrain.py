"""Gently rolling ground, the walker's way over it, and the random numbers of places."""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np

from prc_cli.core.types import F64
from prc_cli.simulation.forest.params import ForestSceneParams

CELL_M = 9.0
"""Edge of the squares that the forest is made in [m]."""

BODIES_PER_CELL = 8192
"""More than the bodies of a cell, whose numbers follow each other."""


class Purpose(IntEnum):
    """Purpose of a generator; generators of two purposes are independent."""

    CANDIDATES = 0
    TREES = 1
    FLOOR = 2
    DEAD_WOOD = 3
    NUMBERS = 4
    TERRAIN = 5
    PATH = 6


def generator(seed: int, purpose: Purpose, *place: int) -> np.random.Generator:
    """Return the generator of a place, fresh at every call."""
    # seed sequences take numbers from 0 on: the integers are folded onto them
    folded = [2 * index if index >= 0 else -2 * index - 1 for index in place]
    return np.random.default_rng([seed, int(purpose), *folded])


def first_number(seed: int, i: int, j: int) -> float:
    """Return the number of the first body of a cell; others follow, all below 2^53."""
    return float(generator(seed, Purpose.NUMBERS, i, j).integers(2**39)) * BODIES_PER_CELL


_WAVE_M = 17.0
"""Length of the bends within a row [m]."""
_TABLE_STEP_M = 0.02


class Rows:
    """Rows along x, k times the spacing apart: even ones are walked to +x, odd ones back.

    In a row the walker strays to either side, in the turns he does not. All rows are equally long
    on foot, so that any distance is found without walking there.
    """

    def __init__(self, params: ForestSceneParams, seed: int) -> None:
        self._length_m = params.row_length_m
        self._spacing_m = params.row_spacing_m
        self._wander_m = params.wander_m
        self._seed = seed
        self._bends = max(1, round(self._length_m / _WAVE_M))
        # the way on foot at shares of the row
        self._share = np.linspace(0.0, 1.0, int(self._length_m / _TABLE_STEP_M) + 2)
        _, slope = self._bend(self._share)
        stretch = np.hypot(1.0, slope)
        mean_stretch = (stretch[1:] + stretch[:-1]) / 2
        steps = mean_stretch * np.diff(self._share) * self._length_m
        self._walked = np.append(0.0, np.cumsum(steps))
        self.period_m = float(self._walked[-1]) + np.pi * self._spacing_m / 2
        """On foot along a row and the turn behind it [m]."""

    def point(self, s_m: F64) -> tuple[F64, F64]:
        """Return places along the way, (n, 2) [m], and the heading there, (n,) [rad]."""
        row = np.floor(s_m / self.period_m)
        walked = s_m - row * self.period_m
        forth = np.where(row % 2 == 0, 1.0, -1.0)

        # along the row
        share = np.interp(walked, self._walked, self._share)
        aside, slope = self._bend(share)
        side = self._side(row)
        along = share * self._length_m
        across = side * aside
        row_heading = forth * np.arctan(side * slope)

        # on the half circle behind it
        radius = self._spacing_m / 2
        angle = np.maximum(walked - self._walked[-1], 0.0) / radius
        along = along + radius * np.sin(angle)
        across = across + radius * (1 - np.cos(angle))

        x = np.where(forth > 0, along, self._length_m - along)
        y = row * self._spacing_m + across
        heading = np.where(forth > 0, 0.0, np.pi) + row_heading + forth * angle
        return np.stack([x, y], axis=-1), heading

    def distance(self, x: F64, y: F64) -> F64:
        """Return the distance of places from the way, to a few centimetres near it [m]."""
        nearest = np.full(np.broadcast(x, y).shape, np.inf)
        share = np.clip(x / self._length_m, 0.0, 1.0)
        beyond_ends = np.maximum(x - self._length_m, 0.0) + np.maximum(-x, 0.0)
        radius = self._spacing_m / 2
        for neighbour in (-1.0, 0.0, 1.0):
            row = np.round(y / self._spacing_m) + neighbour
            is_forth = row % 2 == 0
            aside, slope = self._bend(np.where(is_forth, share, 1 - share))
            row_y = row * self._spacing_m
            off_row = np.abs(y - row_y - self._side(row) * aside) / np.hypot(1.0, slope)
            nearest = np.minimum(nearest, np.hypot(off_row, beyond_ends))

            turn = np.floor(y / self._spacing_m) + neighbour
            is_far_end = turn % 2 == 0
            end_x = np.where(is_far_end, self._length_m, 0.0)
            end_y = (turn + 0.5) * self._spacing_m
            off_turn = np.abs(np.hypot(x - end_x, y - end_y) - radius)
            is_outside = np.where(is_far_end, x >= end_x, x <= end_x)
            nearest = np.where(is_outside, np.minimum(nearest, off_turn), nearest)
        return nearest

    def _bend(self, share: F64) -> tuple[F64, F64]:
        """Return how far a row strays at a share of it, and its slope; both are 0 at its ends."""
        window = np.sin(np.pi * share)
        phase = 2 * np.pi * self._bends * share + 0.7
        aside = self._wander_m * window**2 * np.sin(phase)
        window_part = 2 * np.cos(np.pi * share) * np.sin(phase)
        wave_part = 2 * self._bends * window * np.cos(phase)
        inner = window_part + wave_part
        slope = self._wander_m * np.pi * window * inner / self._length_m
        return aside, slope

    def _side(self, row: F64) -> F64:
        """Return 1 or -1 for every row, to which side it strays first."""
        rows, inverse = np.unique(row, return_inverse=True)
        sides = np.empty(len(rows))
        for i, number in enumerate(rows):
            chance = generator(self._seed, Purpose.PATH, int(number))
            sides[i] = float(chance.integers(2)) * 2 - 1
        return sides[inverse].reshape(row.shape)


_BANDS = ((50.0, 90.0, 0.35), (18.0, 30.0, 0.35), (6.0, 10.0, 0.30))
"""Shortest and longest wave [m], share of the slope's variance."""
_WAVES_PER_BAND = 6


class Terrain:
    """Height of the ground at every place."""

    def __init__(
        self,
        seed: int,
        slope_deg: float,
        incline_deg: float,
        step_m: float,
    ) -> None:
        self.squares = math.ceil(CELL_M / step_m - 1e-9)
        """Squares of two triangles along the edge of a cell."""
        self.step_m = CELL_M / self.squares
        """Edge of a square [m]."""
        self._incline = math.tan(math.radians(incline_deg))
        chance = generator(seed, Purpose.TERRAIN)
        bands = np.repeat(np.array(_BANDS), _WAVES_PER_BAND, axis=0)
        shortest, longest, share = bands.T
        n_waves = len(bands)
        length = shortest + (longest - shortest) * chance.random(n_waves)
        # directions are spread evenly, so that no seed rolls along one axis only
        within_band = np.tile(np.arange(_WAVES_PER_BAND), len(_BANDS))
        direction = (within_band + chance.random(n_waves)) * np.pi / _WAVES_PER_BAND
        self._k = 2 * np.pi / length * np.stack([np.cos(direction), np.sin(direction)])
        self._phase = chance.random(n_waves) * 2 * np.pi
        # the gradient of a wave of amplitude a has the mean square (a k)² / 2
        slope = math.tan(math.radians(slope_deg))
        self._amplitude = slope * np.sqrt(2 * share / _WAVES_PER_BAND) * length / (2 * np.pi)

    def level(self, x: F64, y: F64) -> F64:
        """Return the smooth height that the triangles follow."""
        z = self._incline * x
        for kx, ky, phase, amplitude in zip(*self._k, self._phase, self._amplitude, strict=True):
            z = z + amplitude * np.sin(kx * x + ky * y + phase)
        return z

    def height(self, x: F64, y: F64) -> F64:
        """Return the height of the triangles, the ground of all bodies, as x, y [m]."""
        step = self.step_m
        column = np.floor(x / step)
        row = np.floor(y / step)
        u = x / step - column
        v = y / step - row
        # the diagonal of a square, and the third corner on this side of it
        first_z = self.level(column * step, row * step)
        opposite_z = self.level((column + 1) * step, (row + 1) * step)
        is_below = v <= u
        corner_z = self.level((column + is_below) * step, (row + ~is_below) * step)
        low = np.minimum(u, v)
        high = np.maximum(u, v)
        return first_z + (high - low) * (corner_z - first_z) + low * (opposite_z - first_z)

    def triangles(self, i: int, j: int) -> F64:
        """Return the triangles of a cell, (n, 3, 3): corners, coordinates [m]."""
        n = self.squares
        grid_x = np.arange(i * n, (i + 1) * n + 1, dtype=np.float64) * self.step_m
        grid_y = np.arange(j * n, (j + 1) * n + 1, dtype=np.float64) * self.step_m
        x, y = np.meshgrid(grid_x, grid_y)
        nodes = np.stack([x, y, self.level(x, y)], axis=-1)
        a = nodes[:-1, :-1]
        b = nodes[:-1, 1:]
        c = nodes[1:, 1:]
        d = nodes[1:, :-1]
        below_diagonal = np.stack([a, b, c], axis=-2)
        above_diagonal = np.stack([a, c, d], axis=-2)
        return np.stack([below_diagonal, above_diagonal], axis=2).reshape(-1, 3, 3)
