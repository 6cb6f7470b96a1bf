"""Parameters derived from the sensor and its stream, each with the reason in words."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from prc_cli.core.types import F64
from prc_cli.jobs.calibrate.curves import Curves
from prc_cli.jobs.calibrate.sensor import SensorEstimate
from prc_cli.methods.prc.pipeline import PrcParams
from prc_cli.methods.prc.support import BackgroundParams
from prc_cli.methods.prc.surfaces import PUBLISHED_AREA, PUBLISHED_BLOCK

D_C_SIGMAS = 17.0
"""d_c in standard deviations of the noise: the deviation in eq. 9 on a flat has 1.22 of them, 0.2 d_c should be 2.8
times that."""
D_C_STEPS = 2.0
"""d_c in distances between successive shots: eq. 9 compares three of them."""
ZETA_SIGMAS = 6.0
"""Least zeta in standard deviations: the difference of two ranges has 1.41 of them, and must nearly always agree."""
PLATEAU_M = 10.0
"""Threshold beyond which the supported share no longer rises (Fig. 4, upper end of both ranges)."""
PLATEAU_SHARE = {"urban": 0.95, "forest": 0.5}
"""Part of the share at :data:`PLATEAU_M` that a threshold must reach; in forest, thresholds are narrow on purpose."""
LEAST_PLATEAU = 0.2
"""Least supported share at :data:`PLATEAU_M` for a curve to be usable."""
LEAST_AREA = 12.0
"""Pixels of the smallest surface: three lines of four shots, of which the middle line is supported."""


@dataclass(frozen=True, slots=True)
class Advice:
    """A value for one key."""

    key: str
    """Dotted key of the configuration."""
    before: float | int | str
    value: float | int | str
    reason: str


def imply(sensor: SensorEstimate, curves: Curves, params: PrcParams, range_noise_m: float) -> tuple[Advice, ...]:
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
    spacing = "without the speed of the platform no stream tells how far apart lines are, so k stays as configured"
    if sensor.line_hz:
        spacing = (
            f"{sensor.line_hz:.4g} lines a second are {10 / sensor.line_hz:.3g} m apart at 10 m/s; "
            "the speed is not in the stream, so k stays as configured"
        )
    if sensor.n_lines < k:
        spacing += f" (the stream holds {sensor.n_lines} lines, less than one block)"
    return Advice("prc.lines_per_block", k, k, spacing)


def _zetas(sensor: SensorEstimate, curves: Curves, params: PrcParams) -> tuple[Advice, Advice]:
    support, need = params.support, PLATEAU_SHARE[params.environment]
    noise = sensor.noise_at(sensor.range_quantiles_m["75%"]) or 0.0
    # each threshold is examined with the other at its widest, so that a narrow one does not hide the other
    rows = (
        ("zeta_s", support.zeta_s, curves.zetas_s, curves.over_zeta_s(PLATEAU_M)),
        ("zeta_p", support.zeta_p, curves.zetas_p, curves.over_zeta_p(PLATEAU_M)),
    )
    found = []
    for name, configured, grid, shares in rows:
        plateau = float(shares[np.searchsorted(grid, PLATEAU_M)])
        good = (shares >= need * plateau) & (grid >= ZETA_SIGMAS * noise)
        at = float(shares[np.searchsorted(grid, _on(grid, configured))])
        if plateau < LEAST_PLATEAU:
            value = configured
            reason = (
                f"as configured: the curve has no plateau, since {PLATEAU_M:g} m supports no more than {plateau:.1%} "
                "of the returns"
            )
        elif configured > 0 and good[np.searchsorted(grid, configured)]:
            value = configured
            reason = f"on the plateau of its curve: supports {at:.1%} of the returns, {PLATEAU_M:g} m {plateau:.1%}"
        else:
            place = int(np.argmax(good)) if good.any() else len(grid) - 1
            value = round_up(float(grid[place]), 2)
            least = f"{need:.0%} of that and {ZETA_SIGMAS:g} times the noise of {1000 * noise:.2g} mm"
            reason = (
                f"{configured:g} m supports {at:.1%} of the returns, {PLATEAU_M:g} m {plateau:.1%}; this is the "
                f"least threshold that reaches {least}"
            )
        found.append(Advice(f"prc.support.{name}", configured, value, reason))
    zeta_s, zeta_p = found
    if float(zeta_s.value) < float(zeta_p.value):
        reason = f"raised to zeta_p, as zeta_s >= zeta_p is advisable (II-B); by itself: {zeta_s.reason}"
        zeta_s = replace(zeta_s, value=zeta_p.value, reason=reason)
    return zeta_s, zeta_p


def _on(grid: F64, value: float) -> float:
    """Return a value on the grid; zero is not on it."""
    return value if value in grid else float(grid[0])


def _length(sensor: SensorEstimate, curves: Curves, params: PrcParams) -> Advice:
    published = BackgroundParams().d_c
    mid = sensor.range_quantiles_m["75%"]
    bounds = [(published, "the published value; neither noise, rounding nor steps ask for more")]
    if (noise := sensor.noise_at(mid)) is not None:
        text = f"{D_C_SIGMAS:g} times the deviation of flat stretches, {1000 * noise:.2g} mm at {mid:.3g} m"
        bounds.append((D_C_SIGMAS * noise, f"{text} (three quarters of the returns are nearer)"))
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
    others = "; ".join(f"{other:.2g} m for: {text}" for other, text in bounds[1:] if other != value)
    value = round_up(value, 2)
    share = float(np.interp(math.log(value), np.log(curves.lengths), curves.background_share()))
    reason += f"; marks {share:.1%} of the returns" + (f" (less is asked by the rest: {others})" if others else "")
    return Advice("prc.background.d_c", params.background.d_c, value, reason)


def _area(sensor: SensorEstimate, params: PrcParams) -> Advice:
    k, m = params.lines_per_block, sensor.points_per_line
    scaled = PUBLISHED_AREA * k * m / PUBLISHED_BLOCK
    text = f"the published share of a block, {PUBLISHED_AREA} of 99 x 2154 pixels, is {scaled:.3g} of {k} x {m}"
    if scaled < LEAST_AREA:
        reason = f"{text}, fewer than three lines of four shots, the smallest patch whose middle is supported"
        return Advice("prc.surfaces.area", params.surfaces.area, LEAST_AREA, reason)
    return Advice("prc.surfaces.area", params.surfaces.area, round(scaled, 1), text)


def _range_noise(sensor: SensorEstimate, configured: float) -> Advice:
    key, middle = "sequential_angle.angles.range_noise_m", sensor.range_quantiles_m["50%"]
    noise = sensor.noise_at(middle)
    if noise is None:
        reason = "no stretch of the stream is flat enough to measure the noise: as configured"
        return Advice(key, configured, configured, reason)
    reason = f"deviation of flat stretches at the median range, {middle:.3g} m"
    return Advice(key, configured, min(10.0, round_up(noise, 2)), reason)


def round_up(value: float, digits: int) -> float:
    """Round up to significant digits.

    >>> round_up(0.3061, 2), round_up(0.05, 2)
    (0.31, 0.05)
    """
    if value <= 0:
        return value
    unit = digits - 1 - math.floor(math.log10(value))
    # a value with no more digits stays as it is, despite rounding errors in the last bit
    return round(math.ceil(round(value * 10.0**unit, 6)) / 10.0**unit, max(0, unit))
