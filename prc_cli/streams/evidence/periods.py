"""Periods: how many shots make a line, and how many shots and lines a second.

From ranges: consecutive lines of a mobile scanner see nearly the same profile, so ranges repeat
after M shots (Lehtola et al. 2019, section II: shot i, i + M and i - M are neighbours), if missing
shots are in the stream.

From times, where a file has neither line numbers, columns nor scan angles: shots are fired evenly,
so the times of returns lie on a lattice; sky and ground come back once a line, so what returns, and
how high it lies, repeats.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F32, F64, I64
from prc_cli.streams.columns import StampState, spread_stamps
from prc_cli.streams.down import wrap

MAX_SHOTS = 1 << 21
"""Most shots used, from the start."""
MIN_LINES = 16
"""Least number of lines for an estimate."""
WEAK = 0.35
"""Least strength of an estimate.

Random ranges, random walks and streams of too few lines stay below.
"""
WEAK_PERIOD = 0.5
"""Least strength of a period that is offered as M."""
RANDOM_PAIRS = 1_000_000
"""Most pairs compared by :func:`range_correlation`."""
_MULTIPLES = 6
"""Multiples of the period at which the correlation must rise again."""
_MULTIPLES_SEEN = 16
"""Multiples checked if the stream is long enough.

Lines of different lengths are no longer aligned by then.
"""


@dataclass(frozen=True, slots=True)
class PeriodEstimate:
    """Estimate of the shots in a scan line."""

    points_per_line: int | None
    """M, None if there is no estimate."""
    strength: float
    """Least rise of the autocorrelation from between the lines to the next line, over the first
    multiples of M: about 1 and more = lines alike, below :data:`WEAK` = no evidence; 0 if nothing
    could be computed."""
    n_shots_used: int
    """Number of shots used."""
    reason: str
    """The reason, for people."""


def estimate_points_per_line(range_m: F32, max_m: int = 65_536) -> PeriodEstimate:
    """Estimate M from the autocorrelation of the logarithms of the ranges.

    The correlation at a lag uses only pairs with two valid ranges, in products and energies. The
    smallest lag that rises almost as high above the dip before it as any other is the fundamental;
    its visible multiples refine it.
    """
    flat = np.ravel(range_m)[:MAX_SHOTS].astype(np.float64)
    with np.errstate(invalid="ignore"):
        valid = np.isfinite(flat) & (flat > 0)
    max_lag = min(max_m, len(flat) // MIN_LINES)
    n_valid = np.count_nonzero(valid)
    if n_valid < 100 or max_lag < 4:
        reason = f"too few ranges: {n_valid} of {len(flat)} shots"
        return PeriodEstimate(None, 0.0, len(flat), reason)
    logs = np.log(np.where(valid, flat, 1.0))
    # limit the weight of outliers
    low, middle, high = np.percentile(logs[valid], (1, 50, 99))
    signal = np.where(valid, np.clip(logs, low, high) - middle, 0.0)
    signal[valid] -= signal[valid].mean()
    if not signal.any():
        return PeriodEstimate(None, 0.0, len(flat), "all ranges are equal")
    n_lags = _MULTIPLES * max_lag + max_lag // 2
    correlation = _autocorrelation(signal, n_lags, valid.astype(np.float64))
    period = _fundamental(correlation[: max_lag + 1])
    strength = _comb(correlation, period) if period else 0.0
    looked = f"{len(flat)} shots, lines of up to {max_lag}"
    if strength < WEAK:
        reason = (
            f"no period in the ranges ({looked}): "
            "too few lines, missing shots left out, or not in order"
        )
        return PeriodEstimate(None, strength, len(flat), reason)
    refined = _refine(correlation, period)
    reason = f"the ranges repeat after {refined} shots ({looked})"
    if valid.all():
        reason += (
            "; no shot is missing: if the input leaves such shots out, this is a mean and no layout"
        )
    return PeriodEstimate(refined, strength, len(flat), reason)


def _autocorrelation(signal: F64, n_lags: int, valid: F64 | None = None) -> F64:
    """Correlation at lags 0 to ``n_lags``, (n_lags + 1,).

    With ``valid`` it is that of the valid pairs, -1 to 1; else 1 at lag 0.
    """
    fft = np.fft  # that of SciPy takes 25 MiB more
    # the least size that is a power of two times a small odd number: transforms of it are fast
    least_size = len(signal) + n_lags + 1
    size = min(odd << max(-(-least_size // odd) - 1, 0).bit_length() for odd in (1, 3, 5, 9, 15))
    products = fft.irfft(np.abs(fft.rfft(signal, size)) ** 2, size)[: n_lags + 1]
    if valid is None:
        # free of the length of the overlap
        products /= len(signal) - np.arange(n_lags + 1)
        if not products[0] > 0:
            return np.zeros(n_lags + 1)
        scaled: F64 = products / products[0]
        return scaled
    of_valid = fft.rfft(valid, size)
    of_energy = fft.rfft(signal * signal, size)
    # energies of the earlier and the later shots of valid pairs
    earlier = fft.irfft(np.conj(of_energy) * of_valid, size)[: n_lags + 1]
    later = fft.irfft(np.conj(of_valid) * of_energy, size)[: n_lags + 1]
    energy = np.sqrt(np.maximum(earlier, 0.0) * np.maximum(later, 0.0))
    least = 1e-6 * energy[0]
    correlation: F64 = np.where(energy > least, products / np.maximum(energy, least), 0.0)
    return np.clip(correlation, -1.0, 1.0)


def _fundamental(correlation: F64) -> int:
    """Return the smallest lag that rises almost as high above the dip before it as any lag does.

    0 if none.
    """
    rise = correlation - np.minimum.accumulate(correlation)
    inner = correlation[1:-1]
    is_peak = (inner >= correlation[:-2]) & (inner > correlation[2:])
    peaks = np.flatnonzero(is_peak) + 1
    if not len(peaks):
        return 0
    highest = rise[peaks].max()
    first = int(peaks[rise[peaks] >= 0.9 * highest][0])
    # a broad peak is noisy: take its highest point before the correlation falls again
    fallen = np.flatnonzero(rise[first:] < 0.7 * highest)
    end = first + int(fallen[0]) if len(fallen) else len(correlation)
    return first + int(np.argmax(correlation[first:end]))


def _comb(correlation: F64, period: int) -> float:
    """Return the least rise at the first multiples of the period above the dip before each."""
    reach = max(period // 50, 1)
    n_multiples = min(_MULTIPLES_SEEN, (len(correlation) - 1 - reach) // period)
    rises = []
    for k in range(1, n_multiples + 1):
        first = max(k * period - reach, 1)
        highest = correlation[first : k * period + reach + 1].max()
        lowest = correlation[(k - 1) * period : k * period].min()
        rises.append(highest - lowest)
    return float(min(rises))


def _refine(correlation: F64, period: int) -> int:
    """Follow the peak to higher multiples: a scene that moves between lines shifts the first."""
    refined = float(period)
    for k in range(2, _MULTIPLES_SEEN + 1):
        centre = round(k * refined)
        reach = max(round(0.75 * k), 2)
        if centre + reach >= len(correlation) or reach * 4 > period:
            break
        first = centre - reach
        window = correlation[first : centre + reach + 1]
        if window.max() < 0.5 * correlation[period]:
            break
        refined = (first + int(np.argmax(window))) / k
    return round(refined)


def first_times(time_s: F64) -> F64:
    """Return the first known time of every line."""
    known = np.isfinite(time_s)
    values = time_s[np.arange(len(time_s)), np.argmax(known, axis=1)]
    times: F64 = np.where(known.any(axis=1), values, np.nan)
    return times


def estimate_line_frequency(time_s: F64) -> float | None:
    """Estimate the scan lines a second from the times at which lines begin."""
    steps = np.diff(time_s[np.isfinite(time_s)])
    steps = steps[steps > 0]
    if len(steps) < 2:
        return None
    periods = steps / float(np.median(steps))
    n_lines = np.rint(periods)
    is_even = (n_lines >= 1) & (np.abs(periods - n_lines) < 0.1 * np.maximum(n_lines, 1))
    if np.count_nonzero(is_even) < 0.8 * len(steps):
        return None
    return round(float(n_lines[is_even].sum() / steps[is_even].sum()), 9)


@dataclass(frozen=True, slots=True)
class RangeCorrelation:
    """Whether consecutive shots see the same surface."""

    ratio: float
    """Median range step between neighbours over that between random pairs.

    NaN with too few pairs.
    """
    n_pairs: int
    """Number of neighbouring pairs with two valid ranges."""

    @property
    def verdict(self) -> str:
        """Return the finding as a sentence."""
        if not np.isfinite(self.ratio):
            return f"{self.n_pairs} neighbouring ranges are too few, or too similar, to judge"
        if self.ratio < 0.3:
            finding = "neighbouring shots have similar ranges"
            meaning = "as expected in the order of firing"
        elif self.ratio < 0.7:
            finding = "neighbouring ranges are only loosely alike"
            meaning = "the order may be wrong, or the scene very rough"
        else:
            finding = "neighbouring ranges differ as much as random pairs"
            meaning = "the records are not in the order of firing"
        return f"{finding} (ratio {self.ratio:.2g}): {meaning}"


def range_correlation(range_m: F32, seed: int = 0) -> RangeCorrelation:
    """Compare the range steps between neighbours with those between random pairs."""
    flat = np.ravel(range_m)
    valid = np.isfinite(flat)
    step = np.abs(np.diff(flat))[valid[1:] & valid[:-1]]
    if len(step) < 100:
        return RangeCorrelation(float("nan"), len(step))
    values = flat[valid]
    n_random = min(len(values), RANDOM_PAIRS)
    first, second = np.random.default_rng(seed).integers(0, len(values), size=(2, n_random))
    random_step = float(np.median(np.abs(values[first] - values[second])))
    ratio = float("nan")
    if random_step > 0:
        ratio = float(np.median(step)) / random_step
    return RangeCorrelation(ratio, len(step))


MAX_BINS = 1 << 22
"""Most shots that are looked at."""
LEAST_RETURNS = 2000
"""Fewer returns are not judged."""
LEAST_LINES = 3.0
"""Fewer lines show no period."""
LEAST_SHOTS = 40
"""Shorter sweeps of scan angles are no lines."""
LEAST_FIRINGS = 12
"""Shorter lines are none: 16 lasers in turn are a line of a spinning scanner."""
LEAST_STRENGTH = 0.2
"""Least correlation from line to line."""
FIRST_PEAK = 0.85
"""A line is the first lag that correlates by this share of the strongest."""
_FOLDED = 512
_DIRECTIONS = 72
_PASSING_RAD = math.radians(20.0)
"""Neighbouring returns that are farther apart do not tell when the sweep passed between them."""
_SEAM_RAD = math.radians(5.0)
"""Larger steps of the angle than the time allows are a dead angle without time."""
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
    """Time at which a line begins, in the middle of the longest stretch that rarely returns, at or
    before the first return [s]."""
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
    """Measure the rates of a scanner from the times of its returns, and from their heights.

    Parameters
    ----------
    time_s
        (n,) float64 [s]; NaN = unknown.
    height
        (n,) float64 [m].

    Returns
    -------
    TimedScan or None
        None if the times go back or show no lines.
    """
    known = np.isfinite(time_s)
    time_s = time_s[known]
    if len(time_s) < LEAST_RETURNS or np.any(np.diff(time_s) < 0):
        return None
    shot_s = shot_period(time_s)
    if not shot_s > 0:
        return None
    stop = int(np.searchsorted(time_s, time_s[0] + MAX_BINS * shot_s))
    time_s = time_s[:stop]
    # a rounded stamp is the time of the shots fired after it
    spread_s, _, _ = spread_stamps(time_s, 1 / shot_s, StampState())
    shots = np.rint((spread_s - time_s[0]) / shot_s).astype(np.int64)
    bins = np.maximum.accumulate(shots)
    n = int(bins[-1]) + 1
    returns = np.bincount(bins, minlength=n).astype(np.float64)
    signals = [returns - returns.mean()]
    if height is not None:
        known_height = height[np.flatnonzero(known)[:stop]]
        usual = np.nanmedian(known_height)
        known_height = np.where(np.isfinite(known_height), known_height, usual)
        signals.append(_deviation(bins, known_height, n))
    correlation = np.mean([_autocorrelation(signal, n - 1) for signal in signals], axis=0)
    lag = _first_peak(correlation, int(n / LEAST_LINES))
    if lag is None:
        return None
    period = _refine_period(correlation, lag)
    begin = _begin(np.minimum(returns, 1.0), period)
    # at or before the first return
    origin = begin - period * math.ceil(begin / period)
    return TimedScan(
        shot_hz=1 / shot_s,
        line_hz=1 / (period * shot_s),
        time_origin_s=float(time_s[0] + origin * shot_s),
        n_lines=n / period,
        strength=float(correlation[lag]),
        share=float(len(np.unique(bins))) / n,
    )


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
    time_s = time_s[use]
    angle_rad = angle_rad[use]
    if len(time_s) < LEAST_RETURNS or np.any(np.diff(time_s) < 0):
        return None
    shot_s = shot_period(time_s)
    if not shot_s > 0:
        return None
    # the times at which the sweep passes the direction that returns most
    way = math.copysign(1.0, float(np.sign(wrap(np.diff(angle_rad))).sum()))
    count, edges = np.histogram(wrap(angle_rad), _DIRECTIONS, (-math.pi, math.pi))
    busiest = int(np.argmax(count))
    away = way * wrap(angle_rad - 0.5 * float(edges[busiest] + edges[busiest + 1]))
    before = away[:-1]
    after = away[1:]
    is_passage = (before < 0) & (after >= 0) & (after - before < _PASSING_RAD)
    passages = np.flatnonzero(is_passage)
    share = -before[passages] / np.maximum(after[passages] - before[passages], 1e-12)
    passed_s = time_s[passages] + share * (time_s[passages + 1] - time_s[passages])
    if len(passed_s) < LEAST_LINES:
        return None
    usual_s = float(np.median(np.diff(passed_s)))
    # shots that swap places pass twice
    passed_s = passed_s[np.diff(passed_s, prepend=-math.inf) > 0.5 * usual_s]
    if len(passed_s) < LEAST_LINES or not usual_s > LEAST_SHOTS * shot_s:
        return None
    line_s = _lattice(passed_s, float(np.median(np.diff(passed_s))))
    since = (passed_s - passed_s[0]) / line_s
    if float(np.percentile(np.abs(since - np.rint(since)), 90)) > _UNEVEN:
        return None

    begin_s, is_seam = _sweep_begin(time_s - passed_s[0], angle_rad, way, line_s)
    n_shots = line_s / shot_s
    if is_seam and abs(n_shots - round(n_shots)) < _OFF_WHOLE:
        # shots stamped one after the other: a line is a whole number of them
        line_s = round(n_shots) * shot_s
    begin_s += float(passed_s[0] - time_s[0])
    begin_s -= line_s * math.ceil(begin_s / line_s - 0.5 / n_shots)
    # at a shot; the middle between two is the one behind
    origin_s = float(time_s[0]) + math.floor(begin_s / shot_s + 0.6) * shot_s
    n_lines = float(time_s[-1] - time_s[0]) / line_s
    return TimedScan(
        shot_hz=1 / shot_s,
        line_hz=1 / line_s,
        time_origin_s=origin_s,
        n_lines=n_lines,
        strength=1.0,
        share=len(time_s) * shot_s / (n_lines * line_s),
    )


def _sweep_begin(
    since_s: F64,
    angle_rad: F64,
    way: float,
    line_s: float,
) -> tuple[float, bool]:
    """Return the time of the largest gap in a sweep [s], and whether the gap takes no time."""
    # mean angle of every cell of the sweep that returns
    cell = (np.remainder(since_s, line_s) / line_s * _FOLDED).astype(np.int64) % _FOLDED
    filled = np.flatnonzero(np.bincount(cell, minlength=_FOLDED))
    cosine = np.bincount(cell, np.cos(angle_rad), _FOLDED)[filled]
    sine = np.bincount(cell, np.sin(angle_rad), _FOLDED)[filled]
    middle = np.arctan2(sine, cosine)
    # angle and cells from every one to the next
    to_next_rad = np.remainder(way * np.diff(middle, append=middle[:1]), 2 * math.pi)
    to_next_rad[to_next_rad > 2 * math.pi - _PASSING_RAD] = 0.0
    to_next = np.diff(filled, append=filled[:1] + _FOLDED)
    excess_rad = to_next_rad - to_next * float(np.median(to_next_rad / to_next))
    # angles without time of their own, else the longest time without a return
    is_seam = bool(excess_rad.max() > _SEAM_RAD)
    largest = int(np.argmax(excess_rad if is_seam else to_next))
    gap_rad = float(to_next_rad[largest])
    middle_cell = (filled[largest] + 0.5 + 0.5 * to_next[largest]) % _FOLDED
    rough_s = middle_cell / _FOLDED * line_s
    # to the shot, by neighbours on both sides of the gap
    step = way * wrap(np.diff(angle_rad))
    off_s = since_s[:-1] + 0.5 * np.diff(since_s) - rough_s
    off_s -= line_s * np.rint(off_s / line_s)
    is_near = np.abs(off_s) < 2 * line_s * to_next[largest] / _FOLDED
    is_across = (step > 0.5 * min(gap_rad, math.pi)) & is_near
    correction_s = np.median(off_s[is_across]) if is_across.any() else 0.0
    return float(rough_s + correction_s), is_seam


def shot_period(time_s: F64) -> float:
    """Return the time from shot to shot [s], 0 if the times show none."""
    step = np.diff(time_s)
    rising = step[step > 0]
    if len(rising) < LEAST_RETURNS // 10:
        return 0.0
    if np.count_nonzero(step == 0) > _MOST_EQUAL * len(step):
        return _rounded_period(time_s, float(np.percentile(rising, 5)))
    short = rising[rising <= 1.5 * np.percentile(rising, 20)]
    return _lattice(time_s, float(np.median(short)))


def _lattice(time_s: F64, step_s: float) -> float:
    """Return the step of a lattice on which times lie, refined over ever longer distances.

    ``step_s`` is a first estimate.
    """
    lag = 1
    while lag < len(time_s):
        # the number of shots between two returns is certain only while the error has not grown to a
        # share of a shot
        distance_s = time_s[lag:] - time_s[:-lag]
        steps = distance_s / step_s
        n_steps = np.rint(steps)
        use = (n_steps >= 1) & (n_steps <= 4 * lag) & (np.abs(steps - n_steps) < 0.25)
        if np.count_nonzero(use) < 0.5 * len(use):
            break
        products = (distance_s[use] * n_steps[use]).sum()
        step_s = float(products / (n_steps[use] ** 2).sum())
        lag *= 2
    return step_s


def _rounded_period(time_s: F64, quantum_s: float) -> float:
    """Return the time from shot to shot if several share a stamp.

    The longest stretches without a gap give it.
    """
    best_s = 0.0
    width = 64
    while width < len(time_s):
        span_s = time_s[width:] - time_s[:-width]
        # the ends of a stretch are rounded each by up to a quantum
        n_shortest = len(span_s) // 50
        shortest_s = np.partition(span_s, n_shortest)[: n_shortest + 1]
        period_s = float(shortest_s.mean()) / width
        if best_s and period_s > best_s * (1 + 1.5 * quantum_s / (width * best_s)):
            break
        best_s = period_s
        width *= 2
    return best_s


def _deviation(bins: I64, values: F64, n: int) -> F64:
    """Return the mean value of every bin from its usual one, -1 to 1; 0 where there is none."""
    count = np.bincount(bins, minlength=n)
    mean = np.bincount(bins, values, n) / np.maximum(count, 1)
    off = np.where(count > 0, mean - np.median(values), 0.0)
    most = float(np.percentile(np.abs(off[count > 0]), 90)) or 1.0
    deviation: F64 = np.clip(off / most, -1.0, 1.0)
    deviation -= deviation.mean()
    return deviation


def _first_peak(correlation: F64, most: int) -> int | None:
    """Return the first lag that correlates nearly as much as any; None if none does."""
    inner = correlation[: most + 1]
    # the slope from lag 0 on is no line
    low = np.flatnonzero(inner < 0.5 * LEAST_STRENGTH)
    start = max(int(low[0]) if len(low) else len(inner), LEAST_FIRINGS)
    if start >= len(inner) - 1:
        return None
    highest = float(inner[start:].max())
    if highest < LEAST_STRENGTH:
        return None
    lags = inner[start:-1]
    is_peak = (lags >= FIRST_PEAK * highest) & (lags >= inner[start + 1 :])
    if not is_peak.any():
        return None
    first = start + int(np.argmax(is_peak))
    return first + int(np.argmax(inner[first : first + max(first // 50, 2)]))


def _refine_period(correlation: F64, lag: int) -> float:
    """Return the period in shots, from peaks at ever longer multiples of it."""
    period = float(lag)
    multiple = 1
    while True:
        centre = round(period * multiple)
        reach = max(round(0.01 * lag / multiple), 3)
        first = centre - reach
        if centre + reach + 1 >= len(correlation) or first < 1:
            return period
        window = correlation[first : centre + reach + 1]
        top = int(np.argmax(window))
        if window[top] < 0.5 * LEAST_STRENGTH:
            return period
        # between the lags, by a parabola
        offset = 0.0
        if 0 < top < len(window) - 1:
            left, middle, right = window[top - 1 : top + 2]
            curve = left - 2 * middle + right
            if curve < 0:
                offset = float(0.5 * (left - right) / curve)
        period = (first + top + offset) / multiple
        multiple *= 2


def _begin(filled: F64, period: float) -> float:
    """Return the middle of the longest stretch of a period that rarely returns [shots].

    ``filled``: whether every shot returns, (n,) 0 or 1.
    """
    n_cells = min(_FOLDED, max(int(period), 1))
    shots = np.arange(len(filled))
    cell = (np.remainder(shots, period) / period * n_cells).astype(np.int64) % n_cells
    n_shots = np.maximum(np.bincount(cell, minlength=n_cells), 1)
    share = np.bincount(cell, filled, n_cells) / n_shots
    is_low = share <= share.min() + 0.1 * (share.max() - share.min())
    # a stretch may go on at the begin of the period
    padded = np.concatenate([[False], is_low, is_low, [False]])
    edges = np.flatnonzero(np.diff(padded.astype(np.int8)))
    starts = edges[::2]
    stops = edges[1::2]
    longest = int(np.argmax(stops - starts))
    middle = (starts[longest] + stops[longest]) / 2
    return float(middle % n_cells / n_cells * period)
