"""Finds the scan angle of straight down from registered heights or from level ground.

Registered heights fall with the range times the cosine of the angle from straight down. Ground at distance d with its
normal at angle a has ranges ``r = d / cos(angle - a)``: it is the nearest plane that fills a large part of the line.
Roads slope sideways by a degree or two, which limits the accuracy of the second method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32, F64, I64, Mask

MIN_RISE_RAD = math.radians(10.0)
"""Scan planes closer to the horizontal than this count as horizontal."""
MAX_HEIGHT_OFF_M = 0.25
"""Largest median deviation of registered heights from the fit: with more, heights and angles do not match."""
MIN_SHOTS = 32
"""Least number of shots in excess of the number of lines for a fit of heights."""
MAX_COS_TILT = 1.05
"""Largest cosine of a fitted tilt; rounding leaves it a little over 1."""
MIN_SPREAD = 1e-3
"""Least ratio of the two singular values of a fit of heights."""
MIN_TILT_RAD = math.radians(6.0)
"""Smaller tilts of the scan plane count as vertical: heights err by less than 0.6 %, and fits of upright profilers give
up to 5 deg."""
DECIMALS = 10
"""Decimals of fitted angles [rad]: the last bits of a fit differ between machines."""
N_TRIMS = 5

SEARCH_STEP_RAD = math.radians(0.5)
REACH_RAD = math.radians(65.0)
"""Largest angle from straight down at which ground is searched."""
LEAST_RAD = math.radians(25.0)
"""Least angle filled by the ground."""
BIN_M = 0.1
"""Tolerance of the height of a plane [m]."""
LEAST_LINES = 4

_TURN = 2 * math.pi


class NoDirectionError(ValueError):
    """Coordinates do not give straight down; the message says why."""


class TooFewReturnsError(NoDirectionError):
    """No line has two returns: no directions, and nothing to classify."""


class WrongOriginError(NoDirectionError):
    """The origin of the coordinates is not the scanner."""


class LevelLinesError(NoDirectionError):
    """Lines run sideways: rows and columns are swapped, or z is not up."""


class NoddingError(NoDirectionError):
    """The tilt of the scan planes changes from line to line."""


def wrap(angle: F64) -> F64:
    """Bring angles into (-pi, pi].

    >>> np.rad2deg(wrap(np.deg2rad([190.0, -180.0]))).round(6)
    array([-170.,  180.])
    """
    # -pi after rounding becomes pi
    wrapped: F64 = angle - _TURN * np.ceil((angle - math.pi) / _TURN)
    wrapped[wrapped <= -math.pi] = math.pi
    return wrapped


@dataclass(frozen=True, slots=True)
class HeightFit:
    """Fit of registered heights to scan angles."""

    down_rad: float
    """Scan angle of the beam that points straight down [rad]."""
    cos_tilt: float
    """Cosine of the tilt of the scan plane from the vertical, 1 at most."""
    off_m: float
    """Median deviation of the heights from the fit [m]."""
    n_shots: int


def fit_heights(angle: NDArray[Any], range_m: NDArray[Any], z: NDArray[Any], line: I64) -> HeightFit:
    """Find the scan angle that points straight down in registered heights.

    In the scan plane, ``z = height of the scanner - range cos(angle - nadir) cos(tilt)``, which is linear in ``range
    cos(angle)`` and ``range sin(angle)``. The height of the scanner is an unknown of every line, so that hills do not
    matter. Outliers are trimmed.

    Parameters
    ----------
    angle, range_m, z : (n,) float
        Scan angle [rad], range [m] and height [m] of every shot; values that are not finite are ignored.
    line : (n,) int64
        Its line.

    Raises
    ------
    NoDirectionError
        When too few shots have all three values, or the fit is poor.

    Examples
    --------
    >>> angle, range_m = np.deg2rad([60.0, 80.0, 100.0, 120.0] * 10), np.arange(2.0, 42.0)
    >>> z = 100 - range_m * np.cos(angle - np.deg2rad(90.0))
    >>> bool(abs(np.rad2deg(fit_heights(angle, range_m, z, np.zeros(40, int)).down_rad) - 90) < 1e-6)
    True
    """
    angle, range_m, z = (np.asarray(values, np.float64) for values in (angle, range_m, z))
    use: Mask = np.isfinite(angle) & np.isfinite(range_m) & np.isfinite(z) & (range_m > 0)
    angle, range_m, z, line = angle[use], range_m[use], z[use], line[use]
    _, row = np.unique(line, return_inverse=True)
    system = np.stack([range_m * np.cos(angle), range_m * np.sin(angle)], axis=1)
    keep = np.ones(len(z), np.bool_)
    solution: F64 = np.zeros(2)
    off: F64 = np.zeros(len(z))
    for _ in range(N_TRIMS + 1):
        n = np.bincount(row[keep], minlength=int(row.max(initial=-1)) + 1)
        # one unknown per line
        if np.count_nonzero(keep) - np.count_nonzero(n) < MIN_SHOTS:
            message = f"too few shots have range, scan angle and height ({np.count_nonzero(keep)})"
            raise NoDirectionError(message)
        centred = [_centre(values, row, keep, n) for values in (system[:, 0], system[:, 1], z)]
        matrix = np.stack(centred[:2], axis=1)
        solution = np.asarray(np.linalg.lstsq(matrix[keep], centred[2][keep], rcond=None)[0], np.float64)
        off = np.abs(centred[2] - matrix @ solution)
        keep = off <= max(3 * 1.4826 * float(np.median(off[keep])), 1e-3)
    _check_heights(solution, float(np.median(off)), matrix[keep])
    down_rad = round(math.atan2(-solution[1], -solution[0]), DECIMALS)
    cos_tilt = min(round(math.hypot(*solution), DECIMALS), 1.0)
    return HeightFit(down_rad, cos_tilt, float(np.median(off)), len(z))


def shown_tilt(cos_tilt: float) -> str:
    """Return a text with the tilt of the scan plane, empty where it is vertical.

    >>> shown_tilt(0.7071), shown_tilt(1.0)
    (', the scan plane leans over by 45.0 deg', '')
    """
    if cos_tilt >= math.cos(MIN_TILT_RAD):
        return ""
    return f", the scan plane leans over by {math.degrees(math.acos(cos_tilt)):.1f} deg"


def _centre(values: F64, row: I64, keep: Mask, n: I64) -> F64:
    """Subtract the mean of the kept shots of every line."""
    mean = np.bincount(row[keep], values[keep], len(n)) / np.maximum(n, 1)
    centred: F64 = values - mean[row]
    return centred


def _check_heights(solution: F64, off_m: float, matrix: F64) -> None:
    cos_tilt = math.hypot(*solution)
    if off_m > MAX_HEIGHT_OFF_M:
        message = f"the heights lie {off_m:.2f} m off what range and scan angle say, in the middle"
        raise NoDirectionError(message)
    # below: closer to the horizontal than MIN_RISE_RAD; above: heights fall by more than the range
    if not math.sin(MIN_RISE_RAD) < cos_tilt < MAX_COS_TILT:
        message = f"the heights fall {cos_tilt:.2f} m a metre of range straight down, expected about 1"
        raise NoDirectionError(message)
    values = np.linalg.svd(matrix, compute_uv=False)
    if values[-1] < MIN_SPREAD * values[0]:
        message = "the scan angles of the first lines span too little"
        raise NoDirectionError(message)


def down_of_ground(angle_rad: F64, range_m: F32) -> float | None:
    """Find the scan angle of straight down from level ground.

    Parameters
    ----------
    angle_rad : (M,) float64
        Scan angle of every column, turning one way [rad].
    range_m : (lines, M) float32, metres
        Lines with returns; NaN = missing.

    Returns
    -------
    float or None
        Scan angle [rad], None if no plane fills enough of the lines.

    Examples
    --------
    >>> angle = np.deg2rad(np.linspace(0, 180, 361))
    >>> down = np.cos(angle - np.deg2rad(100))
    >>> lines = np.tile(np.where(down > 0.2, 2.0 / np.maximum(down, 0.2), np.nan), (10, 1)).astype(np.float32)
    >>> round(math.degrees(down_of_ground(angle, lines)), 1)
    100.0
    """
    middle = _middle_of_lines(range_m)
    held = np.flatnonzero(np.isfinite(middle))
    if len(range_m) < LEAST_LINES or len(held) < 3:
        return None
    step = float(np.median(np.abs(wrap(np.diff(angle_rad)))))
    best, inside = 0.0, held[:0]
    for nadir in np.arange(-math.pi, math.pi, SEARCH_STEP_RAD):
        score, columns = _fill(angle_rad, middle, held, float(nadir), step)
        if score > best:
            best, inside = score, columns
    if len(inside) * step < LEAST_RAD:
        return None
    # 1 / r = cos(angle - nadir) / d, a straight line in cosine and sine of the angle
    waves = np.stack([np.cos(angle_rad[inside]), np.sin(angle_rad[inside])], axis=1)
    a, b = np.linalg.lstsq(waves, 1.0 / middle[inside], rcond=None)[0]
    return math.atan2(b, a)


def _middle_of_lines(range_m: F32) -> F64:
    """Return the median range of every column, NaN where no more than half of the lines have one."""
    n_held = np.count_nonzero(np.isfinite(range_m), axis=0)
    ordered = np.sort(range_m.astype(np.float64), axis=0)  # NaN sorts last
    middle: F64 = ordered[n_held // 2, np.arange(range_m.shape[1])] if len(range_m) else np.empty(0)
    return np.where(2 * n_held > len(range_m), middle, np.nan)


def _fill(
    angle_rad: F64, middle_m: F64, held: NDArray[np.intp], down_rad: float, step_rad: float
) -> tuple[float, NDArray[np.intp]]:
    """Return the score of a plane straight below (filled angle, nearer planes preferred) and its columns."""
    off = np.abs(wrap(angle_rad[held] - down_rad))
    near = held[off < REACH_RAD]
    if not len(near):
        return 0.0, near
    depth = middle_m[near] * np.cos(angle_rad[near] - down_rad)
    counts = np.bincount(np.minimum(depth / BIN_M, 1000).astype(np.int64))
    fullest = int(np.argmax(counts))
    inside = near[np.abs(depth - (fullest + 0.5) * BIN_M) < BIN_M]
    return len(inside) * step_rad / math.sqrt((fullest + 0.5) * BIN_M), inside
