"""Gently rolling ground: waves of several lengths, laid over with triangles."""

from __future__ import annotations

import math

import numpy as np

from prc_cli.core.types import F64
from prc_cli.simulation.forest.chance import CELL_M, Purpose, generator

_BANDS = ((50.0, 90.0, 0.35), (18.0, 30.0, 0.35), (6.0, 10.0, 0.30))
"""Shortest and longest wave [m], share of the slope's variance."""
_WAVES_PER_BAND = 6


class Terrain:
    """Height of the ground at every place."""

    def __init__(self, seed: int, slope_deg: float, incline_deg: float, step_m: float) -> None:
        self.squares = math.ceil(CELL_M / step_m - 1e-9)
        """Squares of two triangles along the edge of a cell."""
        self.step_m = CELL_M / self.squares
        """Edge of a square [m]."""
        self._incline = math.tan(math.radians(incline_deg))
        chance = generator(seed, Purpose.TERRAIN)
        shortest, longest, share = (np.repeat(column, _WAVES_PER_BAND) for column in zip(*_BANDS, strict=True))
        length = shortest + (longest - shortest) * chance.random(len(shortest))
        # directions are spread evenly, so that no seed rolls along one axis only
        within = np.tile(np.arange(_WAVES_PER_BAND), len(_BANDS))
        direction = (within + chance.random(len(length))) * np.pi / _WAVES_PER_BAND
        self._k = 2 * np.pi / length * np.stack([np.cos(direction), np.sin(direction)])
        self._phase = chance.random(len(length)) * 2 * np.pi
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
        """Return the height on the triangles, where things stand."""
        step = self.step_m
        i, j = np.floor(x / step), np.floor(y / step)
        u, v = x / step - i, y / step - j
        z00, z11 = self.level(i * step, j * step), self.level((i + 1) * step, (j + 1) * step)
        below = v <= u
        # the third corner lies beside the diagonal on either side
        z = self.level((i + below) * step, (j + ~below) * step)
        low, high = np.minimum(u, v), np.maximum(u, v)
        return z00 + (high - low) * (z - z00) + low * (z11 - z00)

    def triangles(self, i: int, j: int) -> F64:
        """Return the triangles of a cell."""
        n = self.squares
        columns, rows = np.meshgrid(
            np.arange(i * n, (i + 1) * n + 1, dtype=np.float64) * self.step_m,
            np.arange(j * n, (j + 1) * n + 1, dtype=np.float64) * self.step_m,
        )
        nodes = np.stack([columns, rows, self.level(columns, rows)], axis=-1)
        a, b, c, d = nodes[:-1, :-1], nodes[:-1, 1:], nodes[1:, 1:], nodes[1:, :-1]
        return np.stack([np.stack([a, b, c], axis=-2), np.stack([a, c, d], axis=-2)], axis=2).reshape(-1, 3, 3)
