"""Measures shot rate, line rate and phase of a scanner from the times of its returns alone.

For files with times but neither line numbers, columns nor scan angles. Shots are fired evenly, so the times of returns
lie on a lattice; sky and ground come back once a line, so what returns, and how high it lies, repeats after a line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F64
from prc_cli.streams.columns import StampState, spread_stamps
from prc_cli.streams.down import wrap

MAX_BINS = 1 << 22
"""Most shots that are looked at."""
LEAST_RETURNS = 2000
"""Fewer returns are not judged."""
LEAST_LINES = 3.0
"""Fewer lines show no period."""
LEAST_SHOTS = 40
"""Shorter lines are none."""
LEAST_STRENGTH = 0.2
"""Least correlation from line to line."""
FIRST_PEAK = 0.85
"""A line is the first lag that correlates by this share of the strongest."""
_FOLDED = 512
_DIRECTIONS = 72
_PASSING_RAD = math.radians(20.0)
"""Neighbouring returns that are farther apart do not tell when the sweep passed between them."""
_SEAM_RAD = math.radians(5.0)
"""A step of the angle that is larger than its time allows by this is a dead angle that got no time."""
_OFF_WHOLE = 0.1
_UNEVEN = 0.05
"""Nine of ten lines are as long as the others, within this share."""
_MOST_EQUAL = 0.02
"""With more equal neighbours, times are rounded more coarsely than shots."""


@dataclass(frozen=True, slots=True)
class TimedScan:
    """A scanner as its times show it."""

    shot_hz: float
    """Shots a second, with and without return [Hz]."""
    line_hz: float
    """Lines a second [Hz]."""
    time_origin_s: float
    """Time at which a line begins, in the middle of the longest stretch that rarely returns, at or before the first
    return [s]."""
    n_lines: float
    """Lines that were looked at."""
    strength: float
    """Correlation from line to line, 1 = the same."""
    share: float
    """Share of the shots that return."""

    @property
    def points_per_line(self) -> int:
        """M, shots in a line."""
        return max(math.ceil(self.shot_hz / self.line_hz - 0.01), 1)


def measure_rates(time_s: F64, height: F64 | None = None) -> TimedScan | None:
    """Measure the rates of a scanner.

    Lines of 100 shots, of which 60 return:

    >>> shot = np.arange(100 * 50)
    >>> found = measure_rates(shot[shot % 100 < 60] / 5000.0)
    >>> round(found.shot_hz, 3), round(found.line_hz, 2), found.points_per_line
    (5000.0, 50.0, 100)
    """
    use = np.isfinite(time_s)
    time_s = time_s[use]
    if len(time_s) < LEAST_RETURNS or np.any(np.diff(time_s) < 0):
        return None
    shot_s = shot_period(time_s)
    if not shot_s > 0:
        return None
    stop = int(np.searchsorted(time_s, time_s[0] + MAX_BINS * shot_s))
    time_s, use = time_s[:stop], np.flatnonzero(use)[:stop]
    # a rounded stamp stands for the shots fired after it
    spread_s, _, _ = spread_stamps(time_s, 1 / shot_s, StampState())
    bins = np.maximum.accumulate(np.rint((spread_s - time_s[0]) / shot_s).astype(np.int64))
    n = int(bins[-1]) + 1
    returns = np.bincount(bins, minlength=n).astype(np.float64)
    filled = np.minimum(returns, 1.0)
    signals = [returns - returns.mean()]
    if height is not None:
        tall = height[use]
        signals.append(_deviation(bins, np.where(np.isfinite(tall), tall, np.nanmedian(tall)), n))
    correlation = np.mean([_autocorrelation(signal) for signal in signals], axis=0)
    lag = _first_peak(correlation, int(n / LEAST_LINES))
    if lag is None:
        return None
    strength = float(correlation[lag])
    period = _refine_period(correlation, lag)
    begin = _begin(bins, period, filled)
    # at or before the first return
    origin = begin - period * math.ceil(begin / period)
    share = float(len(np.unique(bins))) / n
    return TimedScan(1 / shot_s, 1 / (period * shot_s), float(time_s[0] + origin * shot_s), n / period, strength, share)


def measure_sweeps(time_s: F64, angle_rad: F64) -> TimedScan | None:
    """Measure the rates of a scanner from the scan angles of its returns.

    Lines of 100 shots over 300 degrees, stamped without a gap between lines, of which 60 return:

    >>> shot = np.arange(100 * 50)
    >>> seen = (shot + 20) % 100 < 60
    >>> found = measure_sweeps(shot[seen] / 5000.0, np.deg2rad(3.0 * (shot[seen] % 100)))
    >>> round(found.line_hz, 6), found.points_per_line, round(found.time_origin_s * 5000) % 100
    (50.0, 100, 0)
    """
    use = np.isfinite(time_s) & np.isfinite(angle_rad)
    time_s, angle_rad = time_s[use], angle_rad[use]
    if len(time_s) < LEAST_RETURNS or np.any(np.diff(time_s) < 0):
        return None
    shot_s = shot_period(time_s)
    if not shot_s > 0:
        return None
    step = wrap(np.diff(angle_rad))
    way = math.copysign(1.0, float(np.sign(step).sum()))
    count, edges = np.histogram(wrap(angle_rad), _DIRECTIONS, (-math.pi, math.pi))
    busiest = int(np.argmax(count))
    away = way * wrap(angle_rad - 0.5 * float(edges[busiest] + edges[busiest + 1]))
    # where the sweep passes the direction that returns most
    at = np.flatnonzero((away[:-1] < 0) & (away[1:] >= 0) & (away[1:] - away[:-1] < _PASSING_RAD))
    share = -away[at] / np.maximum(away[at + 1] - away[at], 1e-12)
    passed = time_s[at] + share * (time_s[at + 1] - time_s[at])
    if len(passed) < LEAST_LINES:
        return None
    usual = float(np.median(np.diff(passed)))
    # shots that swap places pass twice
    passed = passed[np.diff(passed, prepend=-math.inf) > 0.5 * usual]
    if len(passed) < LEAST_LINES or not usual > LEAST_SHOTS * shot_s:
        return None
    line_s = _lattice(passed, float(np.median(np.diff(passed))))
    since = (passed - passed[0]) / line_s
    if float(np.percentile(np.abs(since - np.rint(since)), 90)) > _UNEVEN:
        return None
    begin_s, is_seam = _sweep_begin(time_s - passed[0], angle_rad, way, line_s)
    n_shots = line_s / shot_s
    if is_seam and abs(n_shots - round(n_shots)) < _OFF_WHOLE:
        # shots stamped one after the other: a line is a whole number of them
        line_s = round(n_shots) * shot_s
    begin_s += float(passed[0] - time_s[0])
    begin_s -= line_s * math.ceil(begin_s / line_s - 0.5 / n_shots)
    # at a shot; the middle between two is the one behind
    origin_s = float(time_s[0]) + math.floor(begin_s / shot_s + 0.6) * shot_s
    n_lines = float(time_s[-1] - time_s[0]) / line_s
    return TimedScan(1 / shot_s, 1 / line_s, origin_s, n_lines, 1.0, len(time_s) * shot_s / (n_lines * line_s))


def _sweep_begin(since_s: F64, angle_rad: F64, way: float, line_s: float) -> tuple[float, bool]:
    """Return the time within a line at which the sweep has its largest gap [s], and whether that got no time."""
    cell = (np.remainder(since_s, line_s) / line_s * _FOLDED).astype(np.int64) % _FOLDED
    seen = np.flatnonzero(np.bincount(cell, minlength=_FOLDED))
    cosine, sine = (np.bincount(cell, part(angle_rad), _FOLDED)[seen] for part in (np.cos, np.sin))
    middle = np.arctan2(sine, cosine)
    # angle from every cell to the next that returns
    ahead = np.remainder(way * np.diff(middle, append=middle[:1]), 2 * math.pi)
    ahead[ahead > 2 * math.pi - _PASSING_RAD] = 0.0
    cells = np.diff(seen, append=seen[:1] + _FOLDED)
    excess = ahead - cells * float(np.median(ahead / cells))
    # angles without time of their own, else the longest time without a return
    is_seam = bool(excess.max() > _SEAM_RAD)
    at = int(np.argmax(excess if is_seam else cells))
    gap = float(ahead[at])
    rough = (seen[at] + 0.5 + 0.5 * cells[at]) % _FOLDED / _FOLDED * line_s
    # to the shot, by neighbours on both sides of the gap
    step = way * wrap(np.diff(angle_rad))
    phase = since_s[:-1] + 0.5 * np.diff(since_s) - rough
    phase -= line_s * np.rint(phase / line_s)
    over = (step > 0.5 * min(gap, math.pi)) & (np.abs(phase) < 2 * line_s * cells[at] / _FOLDED)
    return float(rough + (np.median(phase[over]) if over.any() else 0.0)), is_seam


def shot_period(time_s: F64) -> float:
    """Return the time from shot to shot [s], 0 if the times show none."""
    step = np.diff(time_s)
    ahead = step[step > 0]
    if len(ahead) < LEAST_RETURNS // 10:
        return 0.0
    if np.count_nonzero(step == 0) > _MOST_EQUAL * len(step):
        return _rounded_period(time_s, float(np.percentile(ahead, 5)))
    return _lattice(time_s, float(np.median(ahead[ahead <= 1.5 * np.percentile(ahead, 20)])))


def _lattice(time_s: F64, usual: float) -> float:
    """Return the step of a lattice on which times lie, refined over ever longer distances; ``usual`` = about it."""
    lag = 1
    while lag < len(time_s):
        # the number of shots between two returns is certain only while the error has not grown to a share of a shot
        distance = time_s[lag:] - time_s[:-lag]
        n_shots = np.rint(distance / usual)
        use = (n_shots >= 1) & (n_shots <= 4 * lag) & (np.abs(distance / usual - n_shots) < 0.25)
        if np.count_nonzero(use) < 0.5 * len(use):
            break
        usual = float((distance[use] * n_shots[use]).sum() / (n_shots[use] ** 2).sum())
        lag *= 2
    return usual


def _rounded_period(time_s: F64, quantum: float) -> float:
    """Return the time from shot to shot where several share a stamp: from the longest stretches without a gap."""
    best = 0.0
    width = 64
    while width < len(time_s):
        span = time_s[width:] - time_s[:-width]
        # the ends of a stretch are rounded each by up to a quantum
        tight = np.partition(span, len(span) // 50)[: len(span) // 50 + 1]
        found = float(tight.mean()) / width
        if best and found > best * (1 + 1.5 * quantum / (width * best)):
            break
        best = found
        width *= 2
    return best


def _deviation(bins: np.ndarray, value: F64, n: int) -> F64:
    """Return values by bin less their slow change; 0 where there is none."""
    count = np.bincount(bins, minlength=n)
    mean = np.bincount(bins, value, n) / np.maximum(count, 1)
    middle = np.where(count > 0, mean - np.median(value), 0.0)
    most = float(np.percentile(np.abs(middle[count > 0]), 90)) or 1.0
    found: F64 = np.clip(middle / most, -1.0, 1.0)
    found -= found.mean()
    return found


def _autocorrelation(signal: F64) -> F64:
    """Return the correlation of a signal with itself by lag, 1 at lag 0, free of the length of the overlap."""
    n = len(signal)
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(signal, size)
    found = np.fft.irfft(spectrum * np.conj(spectrum), size)[:n]
    overlap = n - np.arange(n)
    found /= np.maximum(overlap, 1)
    scaled: F64 = found / found[0] if found[0] > 0 else np.zeros(n)
    return scaled


def _first_peak(correlation: F64, most: int) -> int | None:
    """Return the first lag that correlates nearly as much as any; None if none does."""
    inner = correlation[: most + 1]
    # the slope from lag 0 on is no line
    low = np.flatnonzero(inner < 0.5 * LEAST_STRENGTH)
    start = max(int(low[0]) if len(low) else len(inner), LEAST_SHOTS)
    if start >= len(inner) - 1:
        return None
    highest = float(inner[start:].max())
    if highest < LEAST_STRENGTH:
        return None
    peaks = np.flatnonzero((inner[start:-1] >= FIRST_PEAK * highest) & (inner[start:-1] >= inner[start + 1 :])) + start
    if not len(peaks):
        return None
    first = int(peaks[0])
    return first + int(np.argmax(inner[first : first + max(first // 50, 2)]))


def _refine_period(correlation: F64, lag: int) -> float:
    """Return the period in shots, from peaks at ever longer multiples of it."""
    period, multiple = float(lag), 1
    while True:
        at = round(period * multiple)
        reach = max(round(0.01 * lag / multiple), 3)
        if at + reach + 1 >= len(correlation) or at - reach < 1:
            return period
        window = correlation[at - reach : at + reach + 1]
        top = int(np.argmax(window))
        if window[top] < 0.5 * LEAST_STRENGTH:
            return period
        offset = 0.0
        if 0 < top < len(window) - 1:
            left, middle, right = window[top - 1 : top + 2]
            curve = left - 2 * middle + right
            offset = 0.5 * (left - right) / curve if curve < 0 else 0.0
        period = (at - reach + top + float(offset)) / multiple
        multiple *= 2


def _begin(bins: np.ndarray, period: float, filled: F64) -> float:
    """Return the place in the period that is the middle of the longest stretch that rarely returns [shots]."""
    n_cells = min(_FOLDED, max(int(period), 1))
    shots = np.arange(len(filled))
    cell = (np.remainder(shots, period) / period * n_cells).astype(np.int64) % n_cells
    share = np.bincount(cell, filled, n_cells) / np.maximum(np.bincount(cell, minlength=n_cells), 1)
    low = share <= share.min() + 0.1 * (share.max() - share.min())
    doubled = np.concatenate([low, low])
    edge = np.flatnonzero(np.diff(np.concatenate([[False], doubled, [False]]).astype(np.int8)))
    starts, stops = edge[::2], edge[1::2]
    longest = int(np.argmax(stops - starts))
    return float((starts[longest] + stops[longest]) / 2 % n_cells / n_cells * period)
