"""The angle between columns, measured from the ranges alone.

On a plane that a scan line crosses, the inverse range is ``u = 1/r = A cos b + B sin b`` of the
beam's angle b, for any plane and any direction of down. With even columns, ``b = b0 + s j``, so
``u'' = -s² u`` along the columns, and s can be read off every piece of a plane. Pieces are windows
of adjacent returns with a quadratic fitted to u: one that does not fit (leaves, edges, mixed
returns) is dropped, one whose curvature is uncertain is not taken.

design/fused.md derives it; we found no publication that does this.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from prc_cli.core.types import F32, F64
from prc_cli.streams.down import spread_rows

MOST_SHOTS = 600_000
"""Shots that are looked at, in lines spread over those that are given."""
LEAST_COLUMNS = 160
"""Lines of fewer shots may be those of a spinning scanner, whose beams are uneven."""
WINDOWS = (9, 13, 19, 27, 39, 55, 79, 111, 159, 223)
"""Columns of a window: those that span some degrees tell most."""
LEAST_TURN = 1 / 80
"""A window spans this part of a line at least: in narrower ones u hardly bends."""
HOP = 3
"""Windows begin every third of their length."""
BENT = 0.004
ROUGH = 0.02
"""Largest share (RMS) by which inverse ranges of a plane are off the quadratic."""
CERTAIN = 0.08
"""Windows are taken whose curvature is known to this share."""
LEVELS = ((BENT, CERTAIN), (ROUGH, CERTAIN), (ROUGH, 0.15), (ROUGH, 0.3))
"""The next limits apply if the first leave too few windows.

Streets with noise of 3 cm, forests with 3 mm.
"""
LEAST_PIECES = 30
"""Fewer pieces of planes tell nothing."""
WIDEST_RAD = math.radians(16.0)
"""Windows that are wider see bent surfaces as one (roads have a crown).

They count if there are no others.
"""
PEAK_WIDTH = 0.03
"""Planes agree, bent surfaces do not.

The step is where most pieces lie within this share or their own error.
"""
SPREAD_SHARE = 0.25
"""A spread of the pieces shows bent ones among them.

This part of it is added to the uncertainty.
"""
WIDTHS_SHARE = 0.5
"""The same for the difference of the two most certain window widths.

Crowns of roads and bent walls show in it.
"""
MOST_OFF = 0.1
"""A step that is known less well is not used."""
LEAST_OFF = 0.005
LEAST_OFF_WIDE = 0.02
"""Least uncertainty if all pieces agree: they may all be on one road.

The second applies if all windows are wider than
:data:`WIDEST_RAD`: real roads bend them."""
LEAST_FIELD_RAD = math.radians(20.0)
"""Least angle of a line: ranges that hardly change have a curvature of next to nothing."""
TURN_OFF = 0.03
"""How much longer than a turn a line may seem, as a share."""
USUAL = {"1 deg": math.radians(1.0), **{f"1/{n} deg": math.radians(1.0) / n for n in (2, 3, 4)}}
"""Steps that scanners have."""
DIGITS = 6
"""Significant digits: the last bits of sums differ between machines."""
_TURN = 2.0 * math.pi


@dataclass(frozen=True, slots=True)
class AngleStep:
    """The angle from column to column as the ranges show it, without its sign."""

    step_rad: float
    off: float
    """Its uncertainty, as a share of the step."""
    n_pieces: int
    """Pieces of planes that it was read off."""
    usual: str = ""
    """The usual step within the uncertainty that was taken, as text."""

    def angles(self, points_per_line: int) -> F64:
        """Return the angle of every column from the first, (M,) float64 [rad]."""
        return self.step_rad * np.arange(points_per_line, dtype=np.float64)

    def shown(self, points_per_line: int) -> str:
        """Return the step as text.

        >>> AngleStep(math.radians(0.5), 0.002, 2951, "1/2 deg").shown(361)
        '0.5000 deg ± 0.0010 deg (2951 pieces of planes; taken as 1/2 deg), a field of 180.5 deg'
        """
        step = math.degrees(self.step_rad)
        taken = f"; taken as {self.usual}" if self.usual else ""
        field = f"a field of {step * points_per_line:.1f} deg"
        return (
            f"{step:.4f} deg ± {step * self.off:.4f} deg ({self.n_pieces} pieces of "
            f"planes{taken}), {field}"
        )


def measure_step(range_m: F32) -> AngleStep | None:
    """Measure the angle between columns."""
    n_lines, m = range_m.shape
    if m < LEAST_COLUMNS or not n_lines:
        return None
    rows = range_m[spread_rows(n_lines, max(MOST_SHOTS // m, 1))]
    inverse = 1.0 / rows.astype(np.float64)
    every: list[tuple[int, F64, F64]] = []
    for window in (width for width in WINDOWS if m * LEAST_TURN <= width <= m // 2):
        pieces = sliding_window_view(inverse, window, axis=1)[:, :: max(window // HOP, 1)].reshape(
            -1, window
        )
        every.append((window, *curvatures(pieces[np.isfinite(pieces).all(axis=1)], ROUGH)))
    for level in LEVELS:
        readings = [reading for of_width in every if (reading := _read(*of_width, m, *level))]
        if readings:
            break
    else:
        return None
    narrow = [reading for reading in readings if reading.step_rad * reading.window <= WIDEST_RAD]
    best = min(narrow or readings, key=lambda reading: reading.off)
    next_best = min(
        (reading for reading in readings if reading is not best),
        key=lambda reading: reading.off,
        default=best,
    )
    off = math.hypot(best.off, WIDTHS_SHARE * (next_best.step_rad / best.step_rad - 1.0))
    off = float(f"{max(off, LEAST_OFF if narrow else LEAST_OFF_WIDE):.2g}")
    for name, usual in {"360 deg / M": _TURN / m, **USUAL}.items():
        if abs(usual / best.step_rad - 1.0) <= off and usual * m < _TURN * (1.0 + 1e-9):
            return AngleStep(usual, off, best.n_pieces, name)
    if best.step_rad * m > _TURN * (1.0 + max(2.0 * off, TURN_OFF)):
        return None
    step = min(float(f"{best.step_rad:.{DIGITS}g}"), _TURN / m)
    return AngleStep(step, off, best.n_pieces)


class _Reading(NamedTuple):
    """The step that windows of one width measure."""

    step_rad: float
    off: float
    n_pieces: int
    window: int


def _read(
    window: int,
    curvature: F64,
    error: F64,
    points_per_line: int,
    bent: float,
    most_error: float,
) -> _Reading | None:
    is_straight = error < bent * _error_of_one(window)
    curvature = curvature[is_straight]
    error = error[is_straight]
    if len(curvature) < LEAST_PIECES:
        return None
    # the most certain half first, then all that are certain beside what these say
    middle = float(np.median(curvature[np.argsort(error)[: max(len(error) // 2, LEAST_PIECES)]]))
    for _ in range(5):
        is_certain = error < most_error * middle
        certain = curvature[is_certain]
        if middle <= 0 or len(certain) < LEAST_PIECES:
            return None
        middle = float(np.median(certain))
    middle = _peak(certain, error[is_certain], middle)
    if middle <= 0 or math.sqrt(middle) * points_per_line < LEAST_FIELD_RAD:
        return None
    # the step is the root of the curvature: half the relative error
    spread = 0.5 * 1.4826 * float(np.median(np.abs(certain - middle))) / middle
    steps, ratios = _ratios(window)
    off = spread * (SPREAD_SHARE + len(certain) ** -0.5)
    return _Reading(float(np.interp(middle, ratios, steps)), off, len(certain), window)


def _peak(curvature: F64, error: F64, centre: float) -> float:
    """Return the mode of the curvatures, from a value near to it."""
    for _ in range(30):
        width = np.maximum(error, PEAK_WIDTH * centre)
        weight = np.exp(-0.5 * ((curvature - centre) / width) ** 2) / width**2
        if not weight.any():
            break
        centre = float((weight * curvature).sum() / weight.sum())
    return centre


def curvatures(pieces: F64, bent: float) -> tuple[F64, F64]:
    """Return ``-u''/u`` amid windows of inverse ranges, and its standard error, (n,).

    Windows of one repeated range (a code) are left out.
    """
    window = pieces.shape[1]
    design, fit = _quadratic(window)
    coefficients = pieces @ fit.T
    off = np.sqrt(((pieces - coefficients @ design.T) ** 2).sum(axis=1) / (window - 3))
    amid = coefficients[:, 0]
    use = off < bent * amid
    use[use] = np.ptp(pieces[use], axis=1) > 0
    return -2.0 * coefficients[use, 2] / amid[use], _error_of_one(window) * off[use] / amid[use]


def _error_of_one(window: int) -> float:
    """Return the standard error of the curvature for inverse ranges of a relative error of 1."""
    return 2.0 * math.sqrt(float((_quadratic(window)[1][2] ** 2).sum()))


@lru_cache(maxsize=16)
def _quadratic(window: int) -> tuple[F64, F64]:
    """Return the design matrix of a quadratic, (W, 3), and its pseudo-inverse, (3, W)."""
    x = np.arange(window) - (window - 1) / 2
    design = np.stack([np.ones(window), x, x * x], axis=1)
    return design, np.linalg.pinv(design)


@lru_cache(maxsize=16)
def _ratios(window: int) -> tuple[F64, F64]:
    """Return steps, (n,) [rad], and the curvatures of quadratics fitted to them.

    They differ a little from the squared step, because ``u`` is no quadratic.
    """
    _, fit = _quadratic(window)
    steps = np.geomspace(1e-5, 2.4 / window, 500)
    coefficients = np.cos(np.outer(steps, np.arange(window) - (window - 1) / 2)) @ fit.T
    return steps, -2.0 * coefficients[:, 2] / coefficients[:, 0]
