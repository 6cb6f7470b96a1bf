"""The walker's way: rows to and fro with round turns between them, as a plot is surveyed, on and on."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F64
from prc_cli.simulation.forest.chance import Purpose, generator
from prc_cli.simulation.forest.params import ForestSceneParams

_WAVE_M = 17.0
"""Length of the bends within a row [m]."""
_TABLE_STEP_M = 0.02


class Rows:
    """Rows along x: even ones are walked towards +x, odd ones back; row k lies at y = k times the spacing.

    In a row the walker strays to either side, in the turns he does not. All rows are equally long on foot, so that
    any distance is found without walking there.
    """

    def __init__(self, params: ForestSceneParams, seed: int) -> None:
        self._length_m, self._spacing_m, self._wander_m = params.row_length_m, params.row_spacing_m, params.wander_m
        self._seed = seed
        self._bends = max(1, round(self._length_m / _WAVE_M))
        self._share = np.linspace(0.0, 1.0, int(self._length_m / _TABLE_STEP_M) + 2)
        stretch = np.hypot(1.0, self._bend(self._share)[1])
        steps = (stretch[1:] + stretch[:-1]) / 2 * np.diff(self._share) * self._length_m
        self._walked = np.append(0.0, np.cumsum(steps))
        self.period_m = float(self._walked[-1]) + np.pi * self._spacing_m / 2
        """On foot along a row and the turn behind it [m]."""

    def point(self, s_m: F64) -> tuple[F64, F64]:
        """Return places along the way."""
        row = np.floor(s_m / self.period_m)
        rest = s_m - row * self.period_m
        forth = np.where(row % 2 == 0, 1.0, -1.0)

        share = np.interp(rest, self._walked, self._share)
        aside, slope = self._bend(share)
        side = self._side(row)
        along, across = share * self._length_m, side * aside
        turned = forth * np.arctan(side * slope)

        radius = self._spacing_m / 2
        angle = np.maximum(rest - self._walked[-1], 0.0) / radius
        along = along + radius * np.sin(angle)
        across = across + radius * (1 - np.cos(angle))
        x = np.where(forth > 0, along, self._length_m - along)
        heading = np.where(forth > 0, 0.0, np.pi) + turned + forth * angle
        return np.stack([x, row * self._spacing_m + across], axis=-1), heading

    def distance(self, x: F64, y: F64) -> F64:
        """Return how far places are from the way, to within a few centimetres near it."""
        nearest = np.full(np.broadcast(x, y).shape, np.inf)
        share = np.clip(x / self._length_m, 0.0, 1.0)
        beside = np.maximum(x - self._length_m, 0.0) + np.maximum(-x, 0.0)
        radius = self._spacing_m / 2
        for neighbour in (-1.0, 0.0, 1.0):
            row = np.round(y / self._spacing_m) + neighbour
            forth = row % 2 == 0
            aside, slope = self._bend(np.where(forth, share, 1 - share))
            off_row = np.abs(y - row * self._spacing_m - self._side(row) * aside) / np.hypot(1.0, slope)
            nearest = np.minimum(nearest, np.hypot(off_row, beside))
            turn = np.floor(y / self._spacing_m) + neighbour
            end = np.where(turn % 2 == 0, self._length_m, 0.0)
            outside = np.where(turn % 2 == 0, x >= end, x <= end)
            off_turn = np.abs(np.hypot(x - end, y - (turn + 0.5) * self._spacing_m) - radius)
            nearest = np.where(outside, np.minimum(nearest, off_turn), nearest)
        return nearest

    def _bend(self, share: F64) -> tuple[F64, F64]:
        """Return how far a row strays at a share of it, and its slope; both are 0 at its ends."""
        window, phase = np.sin(np.pi * share), 2 * np.pi * self._bends * share + 0.7
        aside = self._wander_m * window**2 * np.sin(phase)
        inner = 2 * np.cos(np.pi * share) * np.sin(phase) + 2 * self._bends * window * np.cos(phase)
        return aside, self._wander_m * np.pi * window * inner / self._length_m

    def _side(self, row: F64) -> F64:
        """Return 1 or -1 for every row, to which side it strays first."""
        rows, inverse = np.unique(row, return_inverse=True)
        sides = [float(generator(self._seed, Purpose.PATH, int(r)).integers(2)) * 2 - 1 for r in rows]
        return np.array(sides)[inverse].reshape(row.shape)
