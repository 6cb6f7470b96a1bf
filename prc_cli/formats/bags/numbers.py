"""Number the rings of a scanner, whose numbers may begin at 1, have steps, or have gaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.stream import MAX_RINGS
from prc_cli.core.types import I64

WIDTHS = (4, 8, 16, 32, 40, 64, 80, 128, MAX_RINGS)
"""Rings of usual scanners: a ring without returns in the first message keeps its place."""
FULL = 0.5
"""If a smaller share of the numbers occurs, the scanner has no other rings than these."""


@dataclass(frozen=True, slots=True)
class RingNumbers:
    """The rings of a scanner, and their numbers in messages."""

    n_rings: int
    """Rings in a line."""
    index: I64
    """(numbers,) int64, ring from 0 by its number in messages; -1 = not a ring."""
    note: str = ""
    """Unusual properties of the numbers; empty without any."""

    @classmethod
    def of(cls, number: I64) -> RingNumbers | None:
        """Return the rings of a first message, from the number of every point, (n,) int64.

        None = too many rings.

        >>> RingNumbers.of(np.arange(0, 64, 4)).n_rings, RingNumbers.of(np.arange(1, 65)).n_rings
        (16, 64)
        >>> RingNumbers.of(np.arange(60)).n_rings, RingNumbers.of(np.array([0, 3, 17, 40])).n_rings
        (64, 4)
        """
        present = np.unique(number)
        low = int(present[0])
        high = int(present[-1])
        step = int(np.gcd.reduce(np.diff(present))) if len(present) > 1 else 1
        begin = low % step if step > 1 else 0
        if step == 1 and low == 1 and high in WIDTHS:
            begin = 1
        n_numbers = (high - begin) // step + 1
        if len(present) < FULL * n_numbers:
            if len(present) > MAX_RINGS:
                return None
            index = np.full(high + 1, -1, np.int64)
            index[present] = np.arange(len(present))
            return cls(
                len(present),
                index,
                f"{len(present)} rings are numbered up to {high}: taken in their order",
            )
        if n_numbers > MAX_RINGS:
            return None
        n_rings = next(width for width in WIDTHS if width >= n_numbers)
        index = np.full(begin + step * (n_rings - 1) + 1, -1, np.int64)
        index[begin::step] = np.arange(n_rings)
        note = (
            f"rings are numbered in steps of {step}, from {low}: taken as {n_rings} rings"
            if step > 1
            else ""
        )
        return cls(n_rings, index, note)

    def of_points(self, number: I64) -> I64:
        """Return the ring of every point, (n,) int64; -1 = none."""
        inside = (number >= 0) & (number < len(self.index))
        rings: I64 = np.where(inside, self.index[number.clip(0, len(self.index) - 1)], -1)
        return rings
