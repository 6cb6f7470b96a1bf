"""Clocks of packets, and directions of shots as in the manuals of scanners."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32, F64, I64

SAME_CLOCK_S = 1.0
"""A clock of a scanner this close to the clock of the capture is set by GPS or PTP [s]."""


class PacketClock:
    """Turns time stamps of packets into columns and times.

    A clock that differs from the clock of the capture is set to it.
    """

    def __init__(self, period_s: float, column_s: float) -> None:
        self._period_s = period_s
        self._column_s = column_s
        self._last: float | None = None
        self._elapsed = 0.0
        self._line = 0
        self._start_s = 0.0

    def columns(self, stamp_s: F64, host_s: F64, n_columns: int) -> tuple[I64, F64]:
        """Return number and time of every column of packets."""
        half = self._period_s / 2
        if self._last is None:
            self._last = float(stamp_s[0])
            off = (self._last - float(host_s[0]) + half) % self._period_s - half
            self._start_s = float(host_s[0]) + (off if abs(off) <= SAME_CLOCK_S else 0.0)
        steps = (np.diff(stamp_s, prepend=self._last) + half) % self._period_s - half
        elapsed = self._elapsed + np.cumsum(steps)
        # each step is rounded: the errors of stamps in microseconds must not add up
        line = self._line + np.cumsum(np.rint(steps / self._column_s).astype(np.int64))
        self._last = float(stamp_s[-1])
        self._elapsed = float(elapsed[-1])
        self._line = int(line[-1])
        every = (line[:, None] + np.arange(n_columns)).reshape(-1)
        start = self._start_s + elapsed
        return every, (start[:, None] + np.arange(n_columns) * self._column_s).reshape(-1)


def place(range_m: NDArray[Any], azimuth_rad: F64, elevation_rad: F64) -> F32:
    """Return (..., 3) float32 [m], z up, azimuth from y towards x as in the manuals."""
    xyz: F32 = np.empty((*range_m.shape, 3), np.float32)
    flat = range_m * np.cos(elevation_rad)
    xyz[..., 0] = flat * np.sin(azimuth_rad)
    xyz[..., 1] = flat * np.cos(azimuth_rad)
    xyz[..., 2] = range_m * np.sin(elevation_rad)
    return xyz
