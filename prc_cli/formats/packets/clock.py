"""Numbers and times of firing columns, from the clock of a scanner and that of the capture."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F64, I64

SAME_CLOCK_S = 1.0
"""A scanner's clock within this of the capture's is taken to be set by GPS or PTP [s]."""


class PacketClock:
    """Turns the time stamps of packets into column numbers and times.

    A clock that agrees with the capture's (modulo its period) is believed; else the first packet is set to the
    capture's time, and the steps are the scanner's.
    """

    def __init__(self, period_s: float, column_s: float) -> None:
        self._period_s, self._column_s = period_s, column_s
        self._last: float | None = None
        self._elapsed = 0.0
        self._line = 0
        self._start_s = 0.0
        self.is_set = False
        """Whether the scanner's clock agrees with the capture's."""

    def columns(self, stamp_s: F64, host_s: F64, n_columns: int) -> tuple[I64, F64]:
        """Return number and time of every column of packets."""
        if self._last is None:
            self._last = float(stamp_s[0])
            off = (self._last - float(host_s[0]) + self._period_s / 2) % self._period_s - self._period_s / 2
            self.is_set = abs(off) <= SAME_CLOCK_S
            self._start_s = float(host_s[0]) + (off if self.is_set else 0.0)
        half = self._period_s / 2
        steps = (np.diff(stamp_s, prepend=self._last) + half) % self._period_s - half
        elapsed = self._elapsed + np.cumsum(steps)
        # every step is rounded by itself: stamps of whole microseconds do not add up to a column
        line = self._line + np.cumsum(np.rint(steps / self._column_s).astype(np.int64))
        self._last, self._elapsed, self._line = float(stamp_s[-1]), float(elapsed[-1]), int(line[-1])
        every = (line[:, None] + np.arange(n_columns)).reshape(-1)
        start = self._start_s + elapsed
        return every, (start[:, None] + np.arange(n_columns) * self._column_s).reshape(-1)
