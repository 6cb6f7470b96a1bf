"""The loop over beams that tells which lines may hold a car (Stamos et al. 2012, sec. 7.2)."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Surface
from prc_cli.core.types import F64, I32, U8, Mask
from prc_cli.kernels.cache import kernel

_MISSING, _HORIZONTAL, _VERTICAL = int(Surface.MISSING), int(Surface.HORIZONTAL), int(Surface.VERTICAL)


@kernel("Tuple((boolean[::1], int32[::1]))(uint8[:, ::1], int32[::1], float64[:, ::1], float64, boolean)")
def first_triggers(
    surface: U8, n_beams: I32, increments: F64, threshold: float, closed_gaps_only: bool
) -> tuple[Mask, I32]:
    """Run the CUSUM of the observable chain H, V, M along every row until it triggers.

    The chain begins at the first beam with a return and ends before the first return that is neither H nor V.

    ``surface`` (R, n) uint8; ``n_beams`` (R,) int32; ``increments`` (3, 3) float64; returns ``triggered`` (R,) bool,
    ``beam`` (R,) int32.
    """
    n_rows = len(n_beams)
    triggered = np.zeros(n_rows, np.bool_)
    beam = np.full(n_rows, -1, np.int32)
    for row in range(n_rows):
        codes = surface[row]
        stop = n_beams[row]
        if closed_gaps_only:
            while stop > 0 and codes[stop - 1] == _MISSING:
                stop -= 1
        k = 0
        while k < stop and codes[k] == _MISSING:
            k += 1
        total = 0.0
        before = -1
        while k < stop:
            code = codes[k]
            if code == _HORIZONTAL:
                state = 0
            elif code == _VERTICAL:
                state = 1
            elif code == _MISSING:
                state = 2
            else:
                break
            if before >= 0:
                total = max(0.0, total + increments[before, state])
                if total > threshold:
                    triggered[row] = True
                    beam[row] = k
                    break
            before = state
            k += 1
    return triggered, beam
