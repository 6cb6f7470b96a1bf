"""Finds the step of line and column numbers.

Counters may be shared or decimated, or come from an encoder.

A counter that several facets or scanners share rises by their number from line to line; columns may
be ticks of an encoder. Without division all numbers between would be empty lines and columns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import I64, Mask

LEAST_NUMBERS = 8
"""Fewer different numbers show no step."""
LEAST_SHARE = 0.99
"""Least share of the numbers that are on the step; a few may be misread."""
RARE = 0.05
"""Numbers of fewer shots than this share of the usual line or column may be misread."""
FREQUENT = 0.01
"""Least share of a difference that tells of the step."""
MOST_SIZE = 1 << 20
"""Larger steps are numbers of something else."""
MOST_NUMBER = 2.0**53
"""Numbers from here on are not exact in float64."""


@dataclass(frozen=True, slots=True)
class Step:
    """A constant step of whole numbers."""

    size: int = 1
    phase: int = 0
    """Remainder that the numbers leave, divided by the size."""

    def ordinal(self, number: I64) -> tuple[I64, Mask]:
        """Return numbers divided by the step, (n,) int64, and whether they are on it, (n,) bool."""
        if self.size == 1:
            return number, np.ones(len(number), np.bool_)
        ordinal, remainder = np.divmod(number, self.size)
        return ordinal, remainder == self.phase


ONE = Step()
"""Every number counts."""


def find_step(numbers: NDArray[np.generic]) -> Step:
    """Return the step of numbers, (n,); of few or uneven ones :data:`ONE`.

    >>> find_step(np.arange(7, 400, 5)), find_step(np.arange(400) // 3)
    (Step(size=5, phase=2), Step(size=1, phase=0))
    """
    value = np.asarray(numbers, np.float64)
    with np.errstate(invalid="ignore"):
        whole = value[
            np.isfinite(value) & (value == np.floor(value)) & (np.abs(value) < MOST_NUMBER)
        ]
    number, count = np.unique(whole.astype(np.int64), return_counts=True)
    usual = number[count >= RARE * np.median(count)] if len(number) else number
    if len(usual) < LEAST_NUMBERS:
        return ONE
    rise, n_rises = np.unique(np.diff(usual), return_counts=True)
    frequent = rise[n_rises >= FREQUENT * n_rises.sum()]
    size = math.gcd(*frequent.tolist()) if len(frequent) else 1
    if size <= 1:
        return ONE
    shares = np.bincount(number % size, count) / count.sum() if size <= MOST_SIZE else np.zeros(1)
    phase = int(np.argmax(shares))
    return Step(size, phase) if shares[phase] >= LEAST_SHARE else ONE
