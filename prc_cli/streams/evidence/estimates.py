"""Estimates from ranges: whether they are in firing order, and the number of shots per scan line.

Consecutive scan lines of a mobile scanner see nearly the same profile, so ranges repeat after M shots
(Lehtola et al. 2019, section II: shot i, i + M and i - M are neighbours). The estimate needs missing shots in the
stream: without them, lines differ in length.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F32, F64, I64

MAX_SHOTS = 1 << 21
"""Most shots used, from the start."""
MIN_LINES = 16
"""Least number of lines for an estimate."""
WEAK = 0.35
"""Least strength of an estimate: random ranges, random walks and streams of too few lines stay below."""
WEAK_PERIOD = 0.5
"""Least strength of a period that is offered as M."""
RANDOM_PAIRS = 1_000_000
"""Most pairs compared by :func:`range_correlation`."""
_MULTIPLES = 6
"""Multiples of the period at which the correlation must rise again."""
_MULTIPLES_SEEN = 16
"""Multiples checked where the stream is long enough: lines of different lengths lose step by then."""


@dataclass(frozen=True, slots=True)
class PeriodEstimate:
    """Estimate of the shots in a scan line."""

    points_per_line: int | None
    """M, None if there is no estimate."""
    strength: float
    """Least rise of the autocorrelation from between the lines to the next line, over the first multiples of
    M: about 1 and more = lines alike, below :data:`WEAK` = no evidence; 0 if nothing could be computed."""
    n_shots_used: int
    """Number of shots used."""
    reason: str
    """The reason, for people."""


def estimate_points_per_line(range_m: F32, max_m: int = 65_536) -> PeriodEstimate:
    """Estimate M from the autocorrelation of the logarithms of the ranges.

    The correlation at a lag uses only pairs with two valid ranges, in products and energies. The smallest lag that
    rises almost as high above the dip before it as any other is the fundamental; its visible multiples refine it.

    >>> line = 10 + np.random.default_rng(0).random(120).cumsum()
    >>> estimate_points_per_line(np.tile(line, 20).astype(np.float32)).points_per_line
    120
    """
    flat = np.ravel(range_m)[:MAX_SHOTS].astype(np.float64)
    with np.errstate(invalid="ignore"):
        valid = np.isfinite(flat) & (flat > 0)
    max_lag = min(max_m, len(flat) // MIN_LINES)
    if np.count_nonzero(valid) < 100 or max_lag < 4:
        return PeriodEstimate(None, 0.0, len(flat), f"too few ranges: {np.count_nonzero(valid)} of {len(flat)} shots")
    logs = np.log(np.where(valid, flat, 1.0))
    # limit the weight of outliers
    low, middle, high = np.percentile(logs[valid], (1, 50, 99))
    signal = np.where(valid, np.clip(logs, low, high) - middle, 0.0)
    signal[valid] -= signal[valid].mean()
    if not signal.any():
        return PeriodEstimate(None, 0.0, len(flat), "all ranges are equal")
    correlation = _autocorrelation(signal, valid.astype(np.float64), _MULTIPLES * max_lag + max_lag // 2)
    period = _fundamental(correlation[: max_lag + 1])
    strength = _comb(correlation, period) if period else 0.0
    looked = f"{len(flat)} shots, lines of up to {max_lag}"
    if strength < WEAK:
        reason = f"no period in the ranges ({looked}): too few lines, missing shots left out, or not in order"
        return PeriodEstimate(None, strength, len(flat), reason)
    refined = _refine(correlation, period)
    reason = f"the ranges repeat after {refined} shots ({looked})"
    if valid.all():
        reason += "; no shot is missing: if the input leaves such shots out, this is a mean and no layout"
    return PeriodEstimate(refined, strength, len(flat), reason)


def _autocorrelation(signal: F64, valid: F64, n_lags: int) -> F64:
    """Correlation of the valid pairs at lags 0 to ``n_lags``, (n_lags + 1,), -1 to 1."""
    fft = np.fft  # that of SciPy takes 25 MiB more
    least_size = len(signal) + n_lags + 1
    size = min(odd << max(-(-least_size // odd) - 1, 0).bit_length() for odd in (1, 3, 5, 9, 15))
    of_signal = fft.rfft(signal, size)
    of_valid = fft.rfft(valid, size)
    of_energy = fft.rfft(signal * signal, size)
    products = fft.irfft(np.abs(of_signal) ** 2, size)[: n_lags + 1]
    # energies of the earlier and the later shots of valid pairs
    earlier = fft.irfft(np.conj(of_energy) * of_valid, size)[: n_lags + 1]
    later = fft.irfft(np.conj(of_valid) * of_energy, size)[: n_lags + 1]
    energy = np.sqrt(np.maximum(earlier, 0.0) * np.maximum(later, 0.0))
    least = 1e-6 * energy[0]
    correlation: F64 = np.where(energy > least, products / np.maximum(energy, least), 0.0)
    return np.clip(correlation, -1.0, 1.0)


def _fundamental(correlation: F64) -> int:
    """Return the smallest lag that rises almost as high above the dip before it as any lag does; 0 if none."""
    dip = np.minimum.accumulate(correlation)
    rise = correlation - dip
    peaks = _peaks(correlation)
    if not len(peaks):
        return 0
    highest = rise[peaks].max()
    first = int(peaks[rise[peaks] >= 0.9 * highest][0])
    # a broad peak is noisy: take its highest point before the correlation falls again
    fallen = np.flatnonzero(rise[first:] < 0.7 * highest)
    end = first + int(fallen[0]) if len(fallen) else len(correlation)
    return first + int(np.argmax(correlation[first:end]))


def _peaks(correlation: F64) -> I64:
    inner = correlation[1:-1]
    return np.flatnonzero((inner >= correlation[:-2]) & (inner > correlation[2:])) + 1


def _comb(correlation: F64, period: int) -> float:
    """Return the least rise at the first multiples of the period above the dip before each."""
    reach = max(period // 50, 1)
    rises = []
    for k in range(1, min(_MULTIPLES_SEEN, (len(correlation) - 1 - reach) // period) + 1):
        at = correlation[max(k * period - reach, 1) : k * period + reach + 1].max()
        rises.append(at - correlation[(k - 1) * period : k * period].min())
    return float(min(rises))


def _refine(correlation: F64, period: int) -> int:
    """Follow the peak to higher multiples, because a scene that shifts from line to line moves the first one."""
    refined = float(period)
    for k in range(2, _MULTIPLES_SEEN + 1):
        centre = round(k * refined)
        reach = max(round(0.75 * k), 2)
        if centre + reach >= len(correlation) or reach * 4 > period:
            break
        window = correlation[centre - reach : centre + reach + 1]
        if window.max() < 0.5 * correlation[period]:
            break
        refined = (centre - reach + int(np.argmax(window))) / k
    return round(refined)


def first_times(time_s: F64) -> F64:
    """Return the first known time of every line.

    >>> first_times(np.array([[np.nan, 1.5, 1.6], [np.nan, np.nan, np.nan]])).tolist()
    [1.5, nan]
    """
    known = np.isfinite(time_s)
    values = time_s[np.arange(len(time_s)), np.argmax(known, axis=1)]
    found: F64 = np.where(known.any(axis=1), values, np.nan)
    return found


def estimate_line_frequency(time_s: F64) -> float | None:
    """Estimate the scan lines a second from the times at which lines begin.

    >>> estimate_line_frequency(np.array([0.0, 0.02, 0.04, 0.08, 0.10]))
    50.0
    """
    steps = np.diff(time_s[np.isfinite(time_s)])
    steps = steps[steps > 0]
    if len(steps) < 2:
        return None
    period_s = float(np.median(steps))
    n_lines = np.rint(steps / period_s)
    is_even = (n_lines >= 1) & (np.abs(steps / period_s - n_lines) < 0.1 * np.maximum(n_lines, 1))
    if np.count_nonzero(is_even) < 0.8 * len(steps):
        return None
    return round(float(n_lines[is_even].sum() / steps[is_even].sum()), 9)


@dataclass(frozen=True, slots=True)
class RangeCorrelation:
    """Whether consecutive shots see the same surface."""

    ratio: float
    """Median range step between neighbours over that between random pairs; NaN with too few pairs."""
    n_pairs: int
    """Number of neighbouring pairs with two valid ranges."""

    @property
    def verdict(self) -> str:
        """Return the finding as a sentence.

        >>> RangeCorrelation(0.02, 9000).verdict
        'neighbouring shots have near ranges (ratio 0.02): as expected of shots in the order they were fired'
        """
        if not np.isfinite(self.ratio):
            return f"{self.n_pairs} neighbouring ranges are too few, or too alike, to tell"
        if self.ratio < 0.3:
            said = "neighbouring shots have near ranges", "as expected of shots in the order they were fired"
        elif self.ratio < 0.7:
            said = "neighbouring ranges are only loosely alike", "the order may be disturbed, or the scene very rough"
        else:
            said = "neighbouring ranges are as unlike as random pairs", "the order carries no spatial correlation"
        return f"{said[0]} (ratio {self.ratio:.2g}): {said[1]}"


def range_correlation(range_m: F32, seed: int = 0) -> RangeCorrelation:
    """Compare the range steps between neighbours with those between random pairs.

    >>> walk = np.cumsum(np.random.default_rng(1).normal(size=5000)).astype(np.float32)
    >>> range_correlation(walk).ratio < 0.1, range_correlation(np.random.default_rng(2).permutation(walk)).ratio > 0.9
    (True, True)
    """
    flat = np.ravel(range_m)
    valid = np.isfinite(flat)
    step = np.abs(np.diff(flat))[valid[1:] & valid[:-1]]
    values = flat[valid]
    if len(step) < 100:
        return RangeCorrelation(float("nan"), len(step))
    n_random = min(len(values), RANDOM_PAIRS)
    pairs = np.random.default_rng(seed).integers(0, len(values), size=(2, n_random))
    random_step = float(np.median(np.abs(values[pairs[0]] - values[pairs[1]])))
    ratio = float(np.median(step)) / random_step if random_step > 0 else float("nan")
    return RangeCorrelation(ratio, len(step))
