"""A bounded sample of a stream's lines, spread over all that has passed.

Windows of consecutive lines are kept. When there are too many, every second one is dropped and from then on only every
second one is taken, so that the sample is always even over the stream, whatever its length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32

N_WINDOWS = 8
"""Windows kept; half of them is the least once a stream is long."""
WINDOW_SHOTS = 1 << 17
"""Approximate shots of a window."""
LEAST_LINES, MOST_LINES = 32, 4096
"""Lines of a window: enough to see a period, and not the whole of a stream of short lines."""
MOST_SHOTS = 1 << 22
"""Most shots of a window; longer lines give smaller windows."""


@dataclass(frozen=True, slots=True)
class Window:
    """Consecutive lines of a scanner."""

    first_line: int
    range_m: F32
    """(lines, M) float32, ranges [m]; NaN = missing."""


def lines_of_window(points_per_line: int) -> int:
    """Return the number of lines of a window.

    >>> lines_of_window(2154), lines_of_window(16), lines_of_window(1 << 22)
    (60, 4096, 1)
    """
    usual = min(max(WINDOW_SHOTS // points_per_line, LEAST_LINES), MOST_LINES)
    return max(min(usual, MOST_SHOTS // points_per_line), 1)


class LineSample:
    """Collects the windows of one scanner.

    >>> sample = LineSample(1000)
    >>> for first in range(0, 10_000, 500):
    ...     sample.add(ScanBlock(first, np.full((500, 1000), first, np.float32)))
    >>> [window.first_line for window in sample.windows()]
    [0, 2096, 4192, 6288, 8384]
    """

    def __init__(self, points_per_line: int) -> None:
        self._points_per_line = points_per_line
        self._n_lines = lines_of_window(points_per_line)
        self._stride = 1
        self._first: int | None = None
        """Number of the first line of the stream."""
        self._kept: dict[int, F32] = {}
        self._open: dict[int, int] = {}
        self.n_full = 0
        """Times that the sample has been full."""

    def add(self, block: ScanBlock) -> None:
        """Take what is needed of the next lines of the scanner."""
        if self._first is None:
            self._first = block.first_line
        line = first = block.first_line - self._first
        stop = line + block.n_lines
        while line < stop:
            index = line // self._n_lines
            end = min((index + 1) * self._n_lines, stop)
            if index % self._stride == 0:
                self._take(index, line, block.range_m[line - first : end - first])
                line = end
            else:
                line = min(-(-index // self._stride) * self._stride * self._n_lines, stop)

    def _take(self, index: int, line: int, rows: F32) -> None:
        if index not in self._kept:
            if len(self._kept) == N_WINDOWS:
                self._thin()
                if index % self._stride:
                    return
            self._kept[index] = np.empty((self._n_lines, self._points_per_line), np.float32)
        at = line - index * self._n_lines
        self._kept[index][at : at + len(rows)] = rows
        self._open[index] = at + len(rows)
        if len(self._kept) == N_WINDOWS and self._open[index] == self._n_lines:
            self.n_full += 1

    def _thin(self) -> None:
        self._stride *= 2
        for index in [one for one in self._kept if one % self._stride]:
            del self._kept[index], self._open[index]

    def windows(self) -> tuple[Window, ...]:
        """Return the windows in the order of the stream; the last may be shorter."""
        return tuple(
            Window((self._first or 0) + index * self._n_lines, self._kept[index][: self._open[index]])
            for index in sorted(self._kept)
        )
