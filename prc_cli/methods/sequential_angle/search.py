"""What became of every shot in the search for cars (Stamos et al. 2012, Fig. 3 and 4); computed only on request."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.classes import CarTest, TriggerSide
from prc_cli.core.types import I32, I64, U8, U16, Mask
from prc_cli.methods.sequential_angle.car import Cars
from prc_cli.methods.sequential_angle.lines import VerticalLines


@dataclass(frozen=True, slots=True, eq=False)
class CarSearch:
    """Triggers, intervals and tests of R rows of n beams; n = 0 where nobody asked for them."""

    trigger: U8
    """(R, n) uint8, :class:`~prc_cli.core.classes.TriggerSide`."""
    interval: U16
    """(R, n) uint16, number of the interval in its row, from 1; 0 = none."""
    test: U8
    """(R, n) uint8, :class:`~prc_cli.core.classes.CarTest`, before curbs are decided; OUTSIDE where missing."""

    @classmethod
    def none(cls, n_rows: int) -> CarSearch:
        """Return an empty search."""
        nothing = np.empty((n_rows, 0), np.uint8)
        return cls(nothing, nothing.astype(np.uint16), nothing)


def car_search(found: Cars, lines: VerticalLines) -> CarSearch:
    """Spread the results of the search over the beams.

    >>> spread(np.array([[0, 1, 2], [0, 4, 4]], np.int32), np.array([1, 2]), (1, 6))
    array([[0, 1, 1, 0, 2, 0]])
    """
    shape = lines.range_m.shape
    beam, at = np.arange(shape[1], dtype=np.int32), found.trigger[:, None]
    trigger = np.where(beam < at, TriggerSide.BEFORE, np.where(beam > at, TriggerSide.AFTER, TriggerSide.AT))
    trigger[(at < 0)[:, 0]] = TriggerSide.NONE
    trigger[beam >= lines.n_beams[:, None]] = TriggerSide.NONE
    divided, pieces = found.intervals.divided, found.intervals.pieces
    # rows are in order, so that the first interval of a row is found by bisection
    number = np.arange(len(divided)) - np.searchsorted(divided[:, 0], divided[:, 0]) + 1
    interval = spread(divided, number, shape)
    missing = np.isnan(lines.range_m)
    kept = spread(pieces, 1 + found.stable.astype(np.int64), shape)
    test = np.full(shape, CarTest.OUTSIDE, np.uint8)
    test[interval > 0] = CarTest.VERTICAL
    test[kept == 1] = CarTest.VEGETATION
    test[kept == 2] = CarTest.ON_GROUND
    test[(kept == 2) & _beyond(found, lines)] = CarTest.BEHIND_WALL
    test[found.car] = CarTest.CAR
    test[missing] = CarTest.OUTSIDE
    return CarSearch(trigger.astype(np.uint8), interval.astype(np.uint16), test)


def _beyond(found: Cars, lines: VerticalLines) -> Mask:
    beyond: Mask = lines.horizontal_m > found.limit_m[:, None]
    return beyond


def spread(intervals: I32, values: I64, shape: tuple[int, ...]) -> I64:
    """Give every beam the value of its interval, (R, n) int64; 0 = in none.

    ``intervals`` (K, 3) int32; ``values`` (K,) int64.
    """
    n_rows, n = shape
    changes = np.zeros(n_rows * n + 1, np.int64)
    first = intervals[:, 0].astype(np.int64) * n
    changes[first + intervals[:, 1]] += values
    changes[first + intervals[:, 2] + 1] -= values
    spread_out: I64 = np.cumsum(changes[:-1]).reshape(shape)
    return spread_out
