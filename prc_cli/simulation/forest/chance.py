"""Random numbers of places: the same wherever one comes from and in whatever order one looks."""

from __future__ import annotations

from enum import IntEnum

import numpy as np

CELL_M = 9.0
"""Edge of the squares that the forest is made in [m]."""

BODIES_PER_CELL = 8192
"""More bodies than ever stand in one cell: their numbers count on within it."""


class Purpose(IntEnum):
    """What a generator is for; generators of two purposes know nothing of each other."""

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
    """Return the identity of the first body of a cell; those of its others follow. All stay below 2^53."""
    return float(generator(seed, Purpose.NUMBERS, i, j).integers(2**39)) * BODIES_PER_CELL
