"""Shot timing for lines found by time: decides which line a shot near the border belongs to.

Times in files are rounded, so the first shot of a line may have a time just before it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F64, I64

MAX_FILL = 1.05
"""Longest duration of a line in periods: with more, the column number or the rate is wrong."""
_MAX_AHEAD = 10
"""Neighbours more columns apart than this multiple of the typical step are ignored."""
_FEW_EQUAL = 0.995
"""Times count as finer than the time between shots from this share of neighbours with different times on."""


@dataclass(frozen=True, slots=True)
class ShotTiming:
    """Time between shots and between columns."""

    shot_s: float = 0.0
    """Time from shot to shot [s], 0 = unknown."""
    column_s: float = 0.0
    """Time from column to column if the input has column numbers [s], 0 = unknown."""


UNKNOWN = ShotTiming()


def find_timing(time_s: F64, column: I64 | None, line_hz: float, points_per_line: int | None) -> ShotTiming:
    """Find the timing from the first shots.

    >>> find_timing(np.arange(8) * 0.25, np.arange(8) % 4, 1.0, None)
    ShotTiming(shot_s=0.0, column_s=0.25)
    >>> find_timing(np.arange(8) * 0.25, None, 1.0, None)
    ShotTiming(shot_s=0.25, column_s=0.0)
    """
    given_s = 0.0 if points_per_line is None else 1 / (line_hz * points_per_line)
    if column is not None:
        return ShotTiming(given_s, _column_step(time_s, column, 1 / line_hz) or given_s)
    return ShotTiming(given_s or _shot_step(time_s, 1 / line_hz))


def _column_step(time_s: F64, column: I64, period_s: float) -> float:
    """Return the time from column to column, 0 if columns do not grow with time."""
    use = np.isfinite(time_s) & (column >= 0)
    step = np.diff(time_s[use])
    ahead = np.diff(column[use])
    # pairs less than a period apart with growing columns are in the same line
    near = (step >= 0) & (step < period_s)
    forward = near & (ahead > 0)
    if not forward.any() or np.count_nonzero(forward) < np.count_nonzero(near & (ahead < 0)):
        return 0.0
    forward &= ahead <= _MAX_AHEAD * np.median(ahead[forward])
    return float(step[forward].sum() / ahead[forward].sum())


def _shot_step(time_s: F64, period_s: float) -> float:
    """Return the typical time between neighbouring shots, 0 if unknown; rather an underestimate."""
    step = np.diff(time_s[np.isfinite(time_s)])
    step = step[(step >= 0) & (step < period_s)]
    ahead = step[step > 0]
    if not len(ahead):
        return 0.0
    if len(ahead) < _FEW_EQUAL * len(step):
        # shots share time stamps: use the mean
        return float(step[step < 2.5 * np.median(ahead)].mean())
    # shots may be missing between most neighbours: use the shortest fifth
    return float(np.median(ahead[ahead <= 1.5 * np.percentile(ahead, 20)]))


def time_in_line(column: I64, column_s: float, period_s: float) -> F64:
    """Return the time of shots since column 0 of their line."""
    since: F64 = column.astype(np.float64) * column_s
    return np.where((column >= 0) & (since < MAX_FILL * period_s), since, np.nan)
