"""The street as a scene: bodies around a place, made piece by piece."""

from __future__ import annotations

from functools import lru_cache
from threading import RLock

import numpy as np

from prc_cli.core.types import F64
from prc_cli.simulation.street.houses import build_houses
from prc_cli.simulation.street.movers import Movers
from prc_cli.simulation.street.pieces import build_kerbs, kerbsides
from prc_cli.simulation.street.pile import Pile, outlines
from prc_cli.simulation.street.plan import PIECE_M, Purpose, StreetSceneParams, generator, plan_of
from prc_cli.simulation.street.road import LANE_M, Centreline, Ground
from prc_cli.simulation.world import Bodies

_KEPT_PIECES = 64
"""Pieces that are remembered: more than are in sight at once."""
_REACH_M = 40.0
"""Bodies of a piece stay within this way along the street from its ends, as seen from the crown
[m]."""
_NUMBERS = 2.0**14
"""Identities that a piece has room for."""
_FIRST = 2.0**38
"""Shift of the identities, so that those of pieces before the start are not negative."""


class StreetScene:
    """A street without end, in pieces of 30 m, each made by its number and the seed alone."""

    def __init__(self, params: StreetSceneParams | None = None, seed: int = 1) -> None:
        self.params = params if params is not None else StreetSceneParams()
        self.seed = seed
        rng = generator(seed, Purpose.LINE)
        self.line = Centreline(rng, self.params.curves, self.params.hills)
        self.ground = Ground(self.line, rng.uniform(0.11, 0.14))
        self._movers = Movers(self.ground, seed, self.params)
        self._piece = lru_cache(_KEPT_PIECES)(self._make)
        # a cache alone would let every thread make the same pieces
        self._lock = RLock()

    def path_point(self, s_m: F64) -> tuple[F64, F64]:
        """Return the ground under the platform."""
        s = np.asarray(s_m, dtype=np.float64)
        z = self.ground.road(s, np.full(s.shape, LANE_M))
        return np.column_stack([self.line.lane(s), z]), self.line.heading(s)

    def bodies_near(
        self,
        x_m: float,
        y_m: float,
        radius_m: float,
        time_s: float = 0.0,
    ) -> Bodies:
        """Return the bodies within a circle, see :data:`prc_cli.simulation.world.BodiesNear`."""
        middle = self.line.nearest(x_m, y_m)
        # lines of equal s converge inside a curve: bodies are nearer there than s says
        reach = 1.35 * radius_m + _REACH_M
        first = int(np.floor((middle - reach) / PIECE_M))
        last = int(np.floor((middle + reach) / PIECE_M))
        parts = []
        for number in range(first, last + 1):
            with self._lock:
                bodies, bounds = self._piece(number)
            low_x, low_y, high_x, high_y = bounds.T
            gap_x = np.maximum(np.maximum(low_x - x_m, x_m - high_x), 0.0)
            gap_y = np.maximum(np.maximum(low_y - y_m, y_m - high_y), 0.0)
            parts.append(bodies.take(gap_x**2 + gap_y**2 <= radius_m**2))
        movers = self._movers.near(middle, 1.2 * radius_m + 10.0, time_s)
        return Bodies.join(parts + movers)

    def _make(self, number: int) -> tuple[Bodies, F64]:
        """Return the bodies of a piece and their bounds in plan."""
        pile = Pile((number + _FIRST / _NUMBERS) * _NUMBERS)
        plan = plan_of(self.seed, number, self.params.character, self.params.setback_m)
        self.ground.lay(pile, plan, *kerbsides(plan, self.params, self.seed))
        build_houses(pile, self.ground, plan, self.seed)
        build_kerbs(pile, self.ground, plan, self.params, self.seed)
        bodies = pile.bodies()
        return bodies, outlines(bodies)
