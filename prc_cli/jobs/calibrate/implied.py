"""Shares of supported shots and of background over many thresholds, and parameters from them.

The curves of Lehtola et al. (2019), Fig. 4, for every pair of zeta_p and zeta_s at once, from one
pass over the stream.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, F64, I64
from prc_cli.jobs.calibrate.sensor import SensorEstimate
from prc_cli.methods.prc.calibration_loops import bend_histogram, support_histogram
from prc_cli.methods.prc.pipeline import PrcParams
from prc_cli.methods.prc.support import (
    BackgroundParams,
    required_counts,
    stream_window,
    support,
    tail_after,
    window_reach,
)
from prc_cli.methods.prc.surfaces import PUBLISHED_AREA, PUBLISHED_BLOCK

DECADES = (-3, 2)
"""Range of the threshold sweep, as powers of ten [m] (Fig. 4)."""
PER_DECADE = 10
"""Thresholds per decade."""


def thresholds(*further_m: float) -> F64:
    """Return ascending thresholds from 1 mm to 100 m in logarithmic steps, and further ones [m]."""
    first, last = DECADES
    tenths = np.arange(first * PER_DECADE, last * PER_DECADE + 1)
    # 10 ** n of whole numbers is exact, so that 1 m is there as 1.0
    decade, tenth = np.divmod(tenths, PER_DECADE)
    grid = np.array([float(f"1e{d}") for d in decade]) * 10 ** (tenth / PER_DECADE)
    return np.unique(np.concatenate([grid, [value for value in further_m if value > 0]]))


@dataclass(frozen=True, slots=True, eq=False)
class Curves:
    """Numbers of supported and of background returns by threshold."""

    zetas_p: F64
    """(P,) float64, thresholds in the line [m]."""
    zetas_s: F64
    """(Q,) float64, thresholds to adjacent lines [m]."""
    supported: I64
    """(P, Q) int64, supported returns at every pair."""
    lengths: F64
    """(D,) float64, values of d_c [m]."""
    background: I64
    """(D,) int64, supported returns that eq. 9 marks at every d_c."""
    n_returns: int
    n_shots: int

    def share(self, zeta_p: float, zeta_s: float) -> float | None:
        """Return the supported share of the returns at thresholds; None for one off the grid."""
        p = np.flatnonzero(self.zetas_p == zeta_p)
        q = np.flatnonzero(self.zetas_s == zeta_s)
        return float(self.supported[p[0], q[0]] / self.n_returns) if p.size and q.size else None

    def over_zeta_p(self, zeta_s: float) -> F64:
        """Return the share over zeta_p with zeta_s fixed, (P,) float64."""
        column: F64 = self.supported[:, np.flatnonzero(self.zetas_s == zeta_s)[0]] / self.n_returns
        return column

    def over_zeta_s(self, zeta_p: float) -> F64:
        """Return the share over zeta_s with zeta_p fixed, (Q,) float64."""
        row: F64 = self.supported[np.flatnonzero(self.zetas_p == zeta_p)[0]] / self.n_returns
        return row

    def background_share(self) -> F64:
        """Return the share of the returns that are background over d_c, (D,) float64."""
        shares: F64 = self.background / max(1, self.n_returns)
        return shares

    def as_dict(self, zeta_p: float, zeta_s: float) -> dict[str, Any]:
        """Return the curves as plain lists, over one zeta with the other one fixed."""
        return {
            "n_shots": self.n_shots,
            "n_returns": self.n_returns,
            "over_zeta_p": {
                "zeta_s": zeta_s,
                "zeta_p": self.zetas_p.tolist(),
                "supported_share": self.over_zeta_p(zeta_s).tolist(),
            },
            "over_zeta_s": {
                "zeta_p": zeta_p,
                "zeta_s": self.zetas_s.tolist(),
                "supported_share": self.over_zeta_s(zeta_p).tolist(),
            },
            "over_d_c": {
                "d_c": self.lengths.tolist(),
                "background_share": self.background_share().tolist(),
            },
        }


@dataclass(slots=True)
class CurveCounter:
    """Accumulates the counts over blocks, in bounded memory."""

    params: PrcParams
    zetas_p: F64 = field(init=False)
    zetas_s: F64 = field(init=False)
    lengths: F64 = field(init=False)
    n_shots: int = 0
    _support: I64 = field(init=False)
    _bend: I64 = field(init=False)
    _tails: dict[int, F32] = field(default_factory=dict)

    def __post_init__(self) -> None:
        support = self.params.support
        # the curve over one threshold has the other one at 1 m, as published
        self.zetas_p = thresholds(1.0, support.zeta_p)
        self.zetas_s = thresholds(1.0, support.zeta_s)
        self.lengths = thresholds(self.params.background.d_c)
        self._support = np.zeros((len(self.zetas_p) + 1, len(self.zetas_s) + 1), np.int64)
        self._bend = np.zeros(len(self.lengths) + 1, np.int64)

    def add(self, block: ScanBlock) -> None:
        """Count a block with look-ahead (``next_m``); blocks of a scanner must come in order."""
        m = block.points_per_line
        tail = self._tails.get(block.scanner)
        if tail is None:
            tail = np.full(window_reach(m), np.nan, np.float32)
        window = stream_window(tail, block.range_m, block.next_m)
        self._tails[block.scanner] = tail_after(tail, block.range_m)
        in_slice, adjacent = required_counts(self.params.support)
        n = block.n_lines
        self._support += support_histogram(
            window, n, m, self.zetas_p, self.zetas_s, in_slice, adjacent
        )
        supported = support(window, m, self.params.support)
        self._bend += bend_histogram(window, supported, self.lengths, self.params.background.alpha)
        self.n_shots += block.range_m.size

    def finish(self) -> Curves:
        """Return the curves."""
        n_between_returns = int(self._bend.sum())
        return Curves(
            zetas_p=self.zetas_p,
            zetas_s=self.zetas_s,
            supported=self._support.cumsum(axis=0).cumsum(axis=1)[:-1, :-1],
            lengths=self.lengths,
            background=n_between_returns - self._bend.cumsum()[:-1],
            n_returns=int(self._support.sum()),
            n_shots=self.n_shots,
        )


D_C_SIGMAS = 17.0
"""d_c in standard deviations of the noise.

The deviation in eq. 9 on a flat surface is 1.22 of them, and 0.2 d_c should be 2.8 times that."""
D_C_STEPS = 2.0
"""d_c in distances between successive shots: eq. 9 compares three of them."""
ZETA_SIGMAS = 6.0
"""Least zeta in standard deviations.

The difference of two ranges is 1.41 of them, and must nearly always be accepted.
"""
PLATEAU_M = 10.0
"""Threshold beyond which the supported share no longer rises (Fig. 4, upper end of both ranges)."""
PLATEAU_SHARE = {"urban": 0.95, "forest": 0.5}
"""Part of the share at :data:`PLATEAU_M` that a threshold must reach.

In forest, thresholds are narrow on purpose.
"""
LEAST_PLATEAU = 0.2
"""Least supported share at :data:`PLATEAU_M` for a curve to be usable."""
LEAST_AREA = 12.0
"""Pixels of the smallest surface.

Three lines of four shots, of which the middle line is supported.
"""


@dataclass(frozen=True, slots=True)
class Advice:
    """A value for one key."""

    key: str
    """Dotted key of the configuration."""
    before: float | int | str
    value: float | int | str
    reason: str


def imply(
    sensor: SensorEstimate,
    curves: Curves,
    params: PrcParams,
    range_noise_m: float,
) -> tuple[Advice, ...]:
    """Derive d_c, A, k, zeta_s, zeta_p and the noise of the sequential-angle method."""
    return (
        _block(sensor, params),
        *_zetas(sensor, curves, params),
        _length(sensor, curves, params),
        _area(sensor, params),
        _range_noise(sensor, range_noise_m),
    )


def _block(sensor: SensorEstimate, params: PrcParams) -> Advice:
    k = params.lines_per_block
    spacing = (
        "without the speed of the platform no stream tells how far apart lines are, "
        "so k stays as configured"
    )
    if sensor.line_hz:
        spacing = (
            f"{sensor.line_hz:.4g} lines a second are {10 / sensor.line_hz:.3g} m apart at 10 m/s; "
            "the speed is not in the stream, so k stays as configured"
        )
    if sensor.n_lines < k:
        spacing += f" (the stream holds {sensor.n_lines} lines, less than one block)"
    return Advice("prc.lines_per_block", k, k, spacing)


def _zetas(sensor: SensorEstimate, curves: Curves, params: PrcParams) -> tuple[Advice, Advice]:
    support = params.support
    need = PLATEAU_SHARE[params.environment]
    noise = sensor.noise_at(sensor.range_quantiles_m["75%"]) or 0.0
    # each threshold is tested with the other one at its widest, and drawn with the other one at 1 m
    rows = (
        (
            "zeta_s",
            support.zeta_s,
            curves.zetas_s,
            curves.over_zeta_s(PLATEAU_M),
            curves.over_zeta_s(1.0),
        ),
        (
            "zeta_p",
            support.zeta_p,
            curves.zetas_p,
            curves.over_zeta_p(PLATEAU_M),
            curves.over_zeta_p(1.0),
        ),
    )
    advice = []
    for name, configured, grid, shares, drawn in rows:
        at_plateau = np.searchsorted(grid, PLATEAU_M)
        at_configured = np.searchsorted(grid, configured) if configured in grid else 0
        is_usable = float(shares[at_plateau]) >= LEAST_PLATEAU
        good = (shares >= need * shares[at_plateau]) & (grid >= ZETA_SIGMAS * noise)
        # reasons quote the curve that is drawn
        plateau = float(drawn[at_plateau])
        share = float(drawn[at_configured])
        if not is_usable:
            value = configured
            reason = (
                f"as configured: the curve has no plateau, since {PLATEAU_M:g} m supports "
                f"no more than {plateau:.1%} of the returns"
            )
        elif configured > 0 and good[at_configured]:
            value = configured
            reason = (
                f"on the plateau of its curve: supports {share:.1%} of the returns, "
                f"{PLATEAU_M:g} m {plateau:.1%}"
            )
        else:
            index = int(np.argmax(good)) if good.any() else len(grid) - 1
            value = round_up(float(grid[index]))
            least = (
                f"{need:.0%} of that and {ZETA_SIGMAS:g} times the noise of {1000 * noise:.2g} mm"
            )
            reason = (
                f"{configured:g} m supports {share:.1%} of the returns, "
                f"{PLATEAU_M:g} m {plateau:.1%}; "
                f"this is the least threshold that reaches {least}"
            )
        advice.append(Advice(f"prc.support.{name}", configured, value, reason))
    zeta_s, zeta_p = advice
    if float(zeta_s.value) < float(zeta_p.value):
        reason = (
            f"raised to zeta_p, as zeta_s >= zeta_p is advisable (II-B); by itself: {zeta_s.reason}"
        )
        zeta_s = replace(zeta_s, value=zeta_p.value, reason=reason)
    return zeta_s, zeta_p


def _length(sensor: SensorEstimate, curves: Curves, params: PrcParams) -> Advice:
    published = BackgroundParams().d_c
    mid = sensor.range_quantiles_m["75%"]
    bounds = [(published, "the published value; neither noise, rounding nor steps ask for more")]
    if (noise := sensor.noise_at(mid)) is not None:
        text = (
            f"{D_C_SIGMAS:g} times the deviation of flat stretches, "
            f"{1000 * noise:.2g} mm at {mid:.3g} m (three quarters of the returns are nearer)"
        )
        bounds.append((D_C_SIGMAS * noise, text))
    if sensor.rounding_m:
        text = f"ranges are stored in steps of {sensor.rounding_m:g} m"
        bounds.append((D_C_SIGMAS * sensor.rounding_m / math.sqrt(12), text))
    if sensor.step_rad:
        length = D_C_STEPS * sensor.step_rad * mid
        text = (
            f"the three shots of eq. 9 span {length:.2g} m at {mid:.3g} m under steps of "
            f"{math.degrees(sensor.step_rad):.2g} degrees, and nothing smaller shows"
        )
        bounds.append((length, text))
    value, reason = max(bounds, key=lambda item: item[0])
    others = "; ".join(
        f"{length_m:.2g} m for: {text}" for length_m, text in bounds[1:] if length_m != value
    )
    value = round_up(value)
    share = float(np.interp(math.log(value), np.log(curves.lengths), curves.background_share()))
    reason += f"; marks {share:.1%} of the returns" + (
        f" (less is asked by the rest: {others})" if others else ""
    )
    return Advice("prc.background.d_c", params.background.d_c, value, reason)


def _area(sensor: SensorEstimate, params: PrcParams) -> Advice:
    k = params.lines_per_block
    m = sensor.points_per_line
    scaled = PUBLISHED_AREA * k * m / PUBLISHED_BLOCK
    text = (
        f"the published share of a block, {PUBLISHED_AREA} of 99 x 2154 pixels, "
        f"is {scaled:.3g} of {k} x {m}"
    )
    if scaled < LEAST_AREA:
        reason = (
            f"{text}, fewer than three lines of four shots, "
            "the smallest patch whose middle is supported"
        )
        return Advice("prc.surfaces.area", params.surfaces.area, LEAST_AREA, reason)
    return Advice("prc.surfaces.area", params.surfaces.area, round(scaled, 1), text)


def _range_noise(sensor: SensorEstimate, configured: float) -> Advice:
    key = "sequential_angle.angles.range_noise_m"
    middle = sensor.range_quantiles_m["50%"]
    noise = sensor.noise_at(middle)
    if noise is None:
        reason = "no stretch of the stream is flat enough to measure the noise: as configured"
        return Advice(key, configured, configured, reason)
    reason = f"deviation of flat stretches at the median range, {middle:.3g} m"
    return Advice(key, configured, min(10.0, round_up(noise)), reason)


def round_up(value: float) -> float:
    """Round up to two significant digits.

    >>> round_up(0.3061), round_up(0.05)
    (0.31, 0.05)
    """
    if value <= 0:
        return value
    unit = 1 - math.floor(math.log10(value))
    # a value with two digits stays, despite rounding errors in the last bit
    return round(math.ceil(round(value * 10.0**unit, 6)) / 10.0**unit, max(0, unit))
