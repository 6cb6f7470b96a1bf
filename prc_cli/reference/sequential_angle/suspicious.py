"""Lines that may hold a car: CUSUM of the chain of H, V and M (Stamos et al. 2012, sec. 7.2)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from prc_cli.core.classes import Surface
from prc_cli.core.types import F64, I32, U8, Mask

STATE = {Surface.HORIZONTAL: "H", Surface.VERTICAL: "V", Surface.MISSING: "M"}
"""State of the chain by surface code; all other codes end it."""


def first_triggers(
    surface: U8, n_beams: I32, increments: F64, threshold: float, closed_gaps_only: bool
) -> tuple[Mask, I32]:
    """Find the first trigger of every row; see :func:`suspicious_loops.first_triggers`."""
    beams = []
    for codes, n in zip(surface, n_beams, strict=True):
        returns = np.flatnonzero(codes[:n])
        beams.append(-1)
        if len(returns) == 0:
            continue
        first = int(returns[0])
        last = int(returns[-1]) if closed_gaps_only else int(n) - 1
        states = "".join(STATE.get(Surface(code), "x") for code in codes[first : last + 1]).partition("x")[0]
        steps = [float(increments["HVM".index(a), "HVM".index(b)]) for a, b in pairwise(states)]
        total = 0.0
        for position, step in enumerate(steps, start=1):
            total = total + step if total + step > 0 else 0.0
            if total > threshold:
                beams[-1] = first + position
                break
    beam = np.array(beams, np.int32).reshape(len(n_beams))
    return beam >= 0, beam
