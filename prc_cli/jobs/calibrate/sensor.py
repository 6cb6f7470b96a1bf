"""Estimates noise, angular step, rounding and missing shots from a stream of ranges.

All estimates use histograms that are accumulated block by block, in bounded memory.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import nnls

from prc_cli.core.stream import ScanBlock, StreamInfo
from prc_cli.core.types import F32, F64, I64
from prc_cli.streams.angle_step import measure_step
from prc_cli.streams.evidence.figures import LineSample
from prc_cli.streams.evidence.periods import estimate_line_frequency, first_times

STRETCH = 9
"""Successive shots in a stretch that is tested for flatness."""
MAX_SPREAD = 1.3
"""Greatest ratio of ranges in a stretch.

Beyond it incidence is grazing, and the noise of the shots differs.
"""
MIN_STRETCHES = 50
"""Least number of stretches in a usable range bin."""
FLAT_M = 0.1
"""Deviation above which a stretch is foliage, not a noisy flat surface [m]."""
MAX_GROWTH = 2.0
"""A flat range bin has at most this multiple of the deviation of its neighbour, scaled by range."""

TIMED_LINES = 20_000
"""Lines from the start whose times give the line frequency."""
ALL_SHOTS = 2_000_000
"""Shots from the start that are all measured; after that ..."""
EVERY = 8
"""... every eighth block. Shots and missing shots are counted throughout."""

_RANGE_EDGES: F64 = np.geomspace(0.25, 512.0, 45)
"""Range bins for the noise, four per octave [m]."""
_NOISE_EDGES: F64 = np.geomspace(1e-6, 10.0, 281)
"""Deviation bins, forty per decade [m]."""
_LENGTH_EDGES: F64 = np.geomspace(1e-9, 1e39, 4801)
"""Bins for ranges and range differences, a hundred per decade [m]."""
_ROUNDINGS = tuple(
    sorted(
        (factor * 10.0**power for power in range(-4, 1) for factor in (1, 2, 2.5, 5)), reverse=True
    )
)
"""Candidate roundings of stored ranges, coarse ones first [m]."""
_ROUNDED_SHARE = 0.99
_SAMPLE_STEP = 37
"""Every n-th shot is tested for rounding."""


@dataclass(frozen=True, slots=True)
class NoiseBin:
    """Deviation of flat stretches in one range bin."""

    range_m: float
    """Middle of the bin [m]."""
    sigma_m: float
    """Most frequent standard deviation about a plane [m]."""
    n_stretches: int
    flat: bool
    """Whether it is used in the fit; foliage is not."""


@dataclass(frozen=True, slots=True)
class SensorEstimate:
    """Estimated properties; None = cannot be estimated from the stream."""

    points_per_line: int
    n_lines: int
    n_shots: int
    n_missing: int
    range_quantiles_m: dict[str, float]
    """Ranges below which 5, 25, 50, 75 and 95 % of the returns lie [m]."""
    sigma_m: float | None
    """Range-independent part of the noise [m]."""
    sigma_per_m: float | None
    """Part proportional to range [m per m]; includes surface relief under wider steps."""
    noise: tuple[NoiseBin, ...]
    step_rad: float | None
    """Angle between successive shots [rad]."""
    step_source: str
    """How the step was obtained, in words."""
    rounding_m: float | None
    """Stored ranges are multiples of this [m]."""
    line_hz: float | None
    in_line_m: float | None
    """Median range difference of successive shots [m]."""
    across_lines_m: float | None
    """Median range difference of shots in the same column of successive lines [m]."""

    @property
    def missing_share(self) -> float:
        """Share of shots without return."""
        return self.n_missing / self.n_shots

    def noise_at(self, range_m: float) -> float | None:
        """Return the standard deviation about a plane at a range [m]; None if it is unknown."""
        if self.sigma_m is None or self.sigma_per_m is None:
            return None
        return math.hypot(self.sigma_m, self.sigma_per_m * range_m)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain values; missing shots as a share, the step in degrees."""
        shown = {
            "n_missing": ("missing_share", self.missing_share),
            "step_rad": (
                "step_deg",
                None if self.step_rad is None else math.degrees(self.step_rad),
            ),
        }
        return dict(shown.get(name, (name, value)) for name, value in asdict(self).items())


@dataclass(slots=True)
class SensorMeter:
    """Accumulates measurements over blocks."""

    info: StreamInfo
    n_lines: int = 0
    n_shots: int = 0
    n_missing: int = 0
    _noise: I64 = field(
        default_factory=lambda: np.zeros((len(_RANGE_EDGES) - 1, len(_NOISE_EDGES) - 1), np.int64)
    )
    _ranges: I64 = field(default_factory=lambda: np.zeros(len(_LENGTH_EDGES) - 1, np.int64))
    _in_line: I64 = field(default_factory=lambda: np.zeros(len(_LENGTH_EDGES) - 1, np.int64))
    _across: I64 = field(default_factory=lambda: np.zeros(len(_LENGTH_EDGES) - 1, np.int64))
    _rounded: I64 = field(default_factory=lambda: np.zeros(len(_ROUNDINGS), np.int64))
    _n_sampled: int = 0
    _n_blocks: int = 0
    _angle_rad: F64 | None = None
    _lines: LineSample | None = None
    """Lines of the first scanner, for the angular step."""
    _scanner: int = 0
    _line_times: list[F64] = field(default_factory=list)

    def add(self, block: ScanBlock) -> None:
        """Measure a block of lines."""
        ranges = block.range_m
        self.n_lines += block.n_lines
        self.n_shots += ranges.size
        self.n_missing += int(np.count_nonzero(np.isnan(ranges)))
        self._n_blocks += 1
        if block.time_s is not None and self.n_lines <= TIMED_LINES:
            self._line_times.append(first_times(block.time_s))
        if self._lines is None:
            self._lines = LineSample(block.points_per_line)
            self._scanner = block.scanner
        if block.scanner == self._scanner:
            self._lines.add(block)
        if self.n_shots > ALL_SHOTS and self._n_blocks % EVERY:
            return
        if self._angle_rad is None:
            self._angle_rad = block.angle_rad
        self._ranges += _log_counts(ranges, _LENGTH_EDGES)
        self._in_line += _log_counts(np.abs(np.diff(ranges, axis=1)), _LENGTH_EDGES)
        self._across += _log_counts(np.abs(np.diff(ranges, axis=0)), _LENGTH_EDGES)
        middle, deviation = stretch_deviations(ranges)
        self._noise += np.histogram2d(middle, deviation, (_RANGE_EDGES, _NOISE_EDGES))[0].astype(
            np.int64
        )
        self._count_rounding(ranges)

    def finish(self) -> SensorEstimate:
        """Return the estimates."""
        quantiles = {
            f"{q}%": _quantile(self._ranges, _LENGTH_EDGES, q / 100) or math.nan
            for q in (5, 25, 50, 75, 95)
        }
        bins = _noise_bins(self._noise)
        sigma, per_metre = _fit_noise(bins)
        step, source = self._step()
        return SensorEstimate(
            points_per_line=self.info.points_per_line,
            n_lines=self.n_lines,
            n_shots=self.n_shots,
            n_missing=self.n_missing,
            range_quantiles_m=quantiles,
            noise=bins,
            sigma_m=sigma,
            sigma_per_m=per_metre,
            step_rad=step,
            step_source=source,
            rounding_m=self._rounding(),
            line_hz=self._line_hz(),
            in_line_m=_quantile(self._in_line, _LENGTH_EDGES, 0.5),
            across_lines_m=_quantile(self._across, _LENGTH_EDGES, 0.5),
        )

    def _line_hz(self) -> float | None:
        if self.info.line_hz is not None or not self._line_times:
            return self.info.line_hz
        return estimate_line_frequency(np.concatenate(self._line_times))

    def _step(self) -> tuple[float | None, str]:
        angle = self._angle_rad if self._angle_rad is not None else self.info.angle_rad
        windows = self._lines.windows() if self._lines is not None else ()
        measured = (
            measure_step(np.concatenate([window.range_m for window in windows]))
            if windows
            else None
        )
        shown = "" if measured is None else measured.shown(windows[0].range_m.shape[1])
        if angle is not None and len(angle) > 1:
            source = "the angles in the file"
            if shown:
                source += f"; the ranges show {shown}"
            return float(np.median(np.abs(np.diff(np.unwrap(angle))))), source
        if measured is None:
            return None, "the file holds no angles, and too few planes are seen to measure the step"
        return measured.step_rad, f"planes in the ranges, {shown}"

    def _count_rounding(self, ranges: F32) -> None:
        values = ranges.ravel()[::_SAMPLE_STEP]
        values = values[~np.isnan(values)]
        self._n_sampled += len(values)
        exact = values.astype(np.float64)
        slack = np.spacing(values).astype(np.float64)
        for index, unit in enumerate(_ROUNDINGS):
            error = np.abs(exact - np.round(exact / unit) * unit)
            # where float32 is coarser than the unit, every value would look rounded
            self._rounded[index] += np.count_nonzero((error <= slack) & (slack < unit / 16))

    def _rounding(self) -> float | None:
        for unit, count in zip(_ROUNDINGS, self._rounded.tolist(), strict=True):
            if self._n_sampled >= MIN_STRETCHES and count >= _ROUNDED_SHARE * self._n_sampled:
                return unit
        return None


def stretch_deviations(ranges: F32) -> tuple[F64, F64]:
    """Measure the deviation of stretches of shots from a plane, for any slope and angular step.

    On a plane the reciprocal of the range is a cosine of the scan angle, approximated by a parabola
    over a few shots. The residual of the reciprocals, times range squared, is the range noise.

    A wall 5 m away under steps of 1 degree, whose ranges differ by more than a centimetre:

    >>> wall = 5.0 / np.cos(np.deg2rad(np.arange(9.0)))
    >>> _, deviation = stretch_deviations(wall[None].astype(np.float32))
    >>> bool(deviation[0] < 1e-4)
    True
    """
    n = ranges.shape[1] // STRETCH
    stretches = ranges[:, : n * STRETCH].reshape(-1, STRETCH).astype(np.float64)
    with np.errstate(invalid="ignore"):
        low = stretches.min(axis=1)
        high = stretches.max(axis=1)
        stretches = stretches[high <= MAX_SPREAD * low]
    offset = np.arange(STRETCH) - STRETCH // 2
    basis = np.linalg.qr(np.stack([np.ones(STRETCH), offset, offset**2], axis=1))[0]
    residual = (1.0 / stretches) @ (np.eye(STRETCH) - basis @ basis.T)
    middle = stretches[:, STRETCH // 2]
    deviation: F64 = np.sqrt((residual**2).sum(axis=1) / (STRETCH - 3)) * middle**2
    return middle, deviation


def _log_counts(values: F32 | F64, edges: F64) -> I64:
    """Count values in logarithmic bins, without NaN and values outside."""
    flat = values.ravel()
    with np.errstate(divide="ignore", invalid="ignore"):
        bin_number = np.log(flat / edges[0]) * ((len(edges) - 1) / math.log(edges[-1] / edges[0]))
        inside = (bin_number >= 0) & (bin_number < len(edges) - 1)
    counts: I64 = np.bincount(bin_number[inside].astype(np.intp), minlength=len(edges) - 1)
    return counts


def _quantile(counts: I64, edges: F64, share: float) -> float | None:
    # the middle of the bin; None without values
    total = int(counts.sum())
    if not total:
        return None
    bin_number = int(np.searchsorted(counts.cumsum(), share * total))
    return float(math.sqrt(edges[bin_number] * edges[bin_number + 1]))


def _log_mode(counts: I64, edges: F64, smooth: int) -> float:
    """Return the most frequent value of logarithmic bins, after smoothing with a triangle."""
    weights = np.bartlett(smooth + 2)[1:-1]
    bin_number = int(np.argmax(np.convolve(counts, weights, mode="same")))
    return float(math.sqrt(edges[bin_number] * edges[bin_number + 1]))


def _noise_bins(counts: I64) -> tuple[NoiseBin, ...]:
    """Return the most frequent deviation by range, and whether the surface there is flat.

    The mode of the logarithm of sample standard deviations is that of the population, even for
    small samples. Foliage and edges are frequent, but spread over decades.
    """
    bins: list[tuple[float, float, int]] = []
    for low, high, row in zip(_RANGE_EDGES[:-1], _RANGE_EDGES[1:], counts, strict=True):
        n = int(row.sum())
        if n >= MIN_STRETCHES:
            bins.append((math.sqrt(low * high), _log_mode(row, _NOISE_EDGES, smooth=11), n))
    if not bins:
        return ()
    # start at the flattest well-filled bin relative to its range, then go outwards on either side
    most = max(n for _, _, n in bins)
    start = min(
        (index for index, (_, _, n) in enumerate(bins) if n >= most / 10),
        key=lambda i: bins[i][1],
    )
    flat = {start} if bins[start][1] < FLAT_M else set()
    for order in (range(start + 1, len(bins)), range(start - 1, -1, -1)):
        last = start
        for index in order:
            scale = max(1.0, bins[index][0] / bins[last][0])
            if (
                flat
                and bins[index][1] <= MAX_GROWTH * scale * bins[last][1]
                and bins[index][1] < FLAT_M
            ):
                flat.add(index)
                last = index
    return tuple(NoiseBin(*item, flat=index in flat) for index, item in enumerate(bins))


def _fit_noise(bins: tuple[NoiseBin, ...]) -> tuple[float | None, float | None]:
    """Fit ``sigma**2 = a**2 + (b * range)**2`` to the flat bins, minimising relative errors."""
    flat = [item for item in bins if item.flat]
    if not flat:
        return None, None
    square = np.array([item.sigma_m**2 for item in flat])
    weight = np.sqrt([item.n_stretches for item in flat]) / square
    table = np.stack([np.ones(len(flat)), [item.range_m**2 for item in flat]], axis=1)
    if len(flat) == 1:
        return flat[0].sigma_m, 0.0
    constant, growing = nnls(table * weight[:, None], square * weight)[0]
    return math.sqrt(constant), math.sqrt(growing)
