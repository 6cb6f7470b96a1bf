"""Finds the scan angle of straight down from registered heights or from level ground.

Registered heights fall with the range times the cosine of the angle from straight down. Ground at
distance d with its normal at angle a has ranges ``r = d / cos(angle - a)``: it is a near plane that
fills a large part of nearly every line, with sky on the other side. Roads slope sideways by a
degree or two, which limits the accuracy of the second method.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32, F64, I64, Mask

MIN_RISE_RAD = math.radians(10.0)
"""Scan planes closer to the horizontal than this count as horizontal."""
MAX_HEIGHT_OFF_M = 0.25
"""Largest median deviation of registered heights from the fit.

With more, heights and angles do not match.
"""
MIN_SHOTS = 32
"""Least number of shots in excess of the number of lines for a fit of heights."""
MAX_COS_TILT = 1.05
"""Largest cosine of a fitted tilt; rounding leaves it a little over 1."""
MIN_SPREAD = 1e-3
"""Least ratio of the two singular values of a fit of heights."""
MIN_TILT_RAD = math.radians(6.0)
"""Smaller tilts of the scan plane count as vertical.

Heights err by less than 0.6 %, and fits of upright profilers give
up to 5 deg."""
DECIMALS = 10
"""Decimals of fitted angles [rad]: the last bits of a fit differ between machines."""
N_TRIMS = 5

SEARCH_STEP_RAD = math.radians(0.5)
REACH_RAD = math.radians(65.0)
"""Largest angle from straight down at which ground is searched."""
LEAST_RAD = math.radians(25.0)
"""Least angle filled by the ground."""
LEAST_RIVAL_RAD = math.radians(12.0)
"""Least angle filled by a plane that may contradict it."""
BIN_M = 0.1
"""Tolerance of the height of a plane [m]."""
N_BINS = 400
"""Planes farther away than this many bins do not count."""
LEAST_LINES = 4
MOST_LINES = 64
MOST_COLUMNS = 360
"""Most lines and columns used."""
NEAR_PLANE_M = 0.15
"""Distance from a plane up to which the shot of a single line lies in it [m]."""
SKY_RAD = math.radians(60.0)
"""The sky is searched up to this angle from the opposite direction."""
LEAST_SKY = 0.1
"""Added to the share of missing shots: in tunnels and forests there is no sky."""
DEAD_SHARE = 0.5
"""What a dead angle counts as: columns that do not exist, or are missing in every line."""
MOST_PEAKS = 8
PEAK_RAD = math.radians(10.0)
"""Directions closer to a better one than this are not judged by their own."""
RIVAL_RAD = math.radians(40.0)
"""Directions farther away than this contradict the best one."""
SURE_RATIO = 1.5
"""Least score over that of a direction that contradicts it."""
LEAST_LEVEL = 0.25
"""Least share of the shots around a direction that a floor or a ceiling fills."""
OPPOSITE_RAD = math.radians(10.0)
"""Floor and ceiling are level: one lies as near as this to the opposite direction of the other."""

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
    """Bring angles into (-pi, pi]."""
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


def fit_heights(
    angle: NDArray[Any],
    range_m: NDArray[Any],
    z: NDArray[Any],
    line: I64,
) -> HeightFit:
    """Find the scan angle that points straight down in registered heights.

    In the scan plane, ``z = height of the scanner - range cos(angle - nadir) cos(tilt)``, which is
    linear in ``range cos(angle)`` and ``range sin(angle)``. The height of the scanner is an unknown
    of every line, so that hills do not matter. Outliers are trimmed.
    """
    angle, range_m, z = (np.asarray(values, np.float64) for values in (angle, range_m, z))
    use: Mask = np.isfinite(angle) & np.isfinite(range_m) & np.isfinite(z) & (range_m > 0)
    angle = angle[use]
    range_m = range_m[use]
    z = z[use]
    line = line[use]
    _, row = np.unique(line, return_inverse=True)
    system = np.stack([range_m * np.cos(angle), range_m * np.sin(angle)], axis=1)
    keep = np.ones(len(z), np.bool_)
    for _ in range(N_TRIMS + 1):
        n = np.bincount(row[keep], minlength=int(row.max(initial=-1)) + 1)
        # one unknown per line
        if np.count_nonzero(keep) - np.count_nonzero(n) < MIN_SHOTS:
            raise NoDirectionError(
                f"too few shots have range, scan angle and height ({np.count_nonzero(keep)})"
            )
        centred = [_centre(values, row, keep, n) for values in (system[:, 0], system[:, 1], z)]
        matrix = np.stack(centred[:2], axis=1)
        solution: F64 = np.asarray(
            np.linalg.lstsq(matrix[keep], centred[2][keep], rcond=None)[0], np.float64
        )
        off: F64 = np.abs(centred[2] - matrix @ solution)
        keep = off <= max(3 * 1.4826 * float(np.median(off[keep])), 1e-3)
    _check_heights(solution, float(np.median(off)), matrix[keep])
    down_rad = round(math.atan2(-solution[1], -solution[0]), DECIMALS)
    cos_tilt = min(round(math.hypot(*solution), DECIMALS), 1.0)
    return HeightFit(down_rad, cos_tilt, float(np.median(off)), len(z))


def shown_tilt(cos_tilt: float) -> str:
    """Return a text with the tilt of the scan plane, empty where it is vertical."""
    if cos_tilt >= math.cos(MIN_TILT_RAD):
        return ""
    return f", the scan plane leans over by {math.degrees(math.acos(cos_tilt)):.1f} deg"


def _centre(
    values: F64,
    row: I64,
    keep: Mask,
    n: I64,
) -> F64:
    mean = np.bincount(row[keep], values[keep], len(n)) / np.maximum(n, 1)
    centred: F64 = values - mean[row]
    return centred


def _check_heights(solution: F64, off_m: float, matrix: F64) -> None:
    cos_tilt = math.hypot(*solution)
    if off_m > MAX_HEIGHT_OFF_M:
        raise NoDirectionError(
            f"the heights lie {off_m:.2f} m off what range and scan angle say, in the middle"
        )
    # below: closer to the horizontal than MIN_RISE_RAD; above: heights fall by more than the range
    if not math.sin(MIN_RISE_RAD) < cos_tilt < MAX_COS_TILT:
        raise NoDirectionError(
            f"the heights fall {cos_tilt:.2f} m a metre of range straight down, expected about 1"
        )
    values = np.linalg.svd(matrix, compute_uv=False)
    if values[-1] < MIN_SPREAD * values[0]:
        raise NoDirectionError("the scan angles of the first lines span too little")


@dataclass(frozen=True, slots=True)
class DownGuess:
    """Straight down as the ranges alone show it, and the next best direction."""

    down_rad: float
    """Scan angle of straight down [rad]."""
    depth_m: float
    """Distance of the plane that is used as the ground [m]."""
    rival_rad: float | None = None
    """Scan angle of the best other direction, more than :data:`RIVAL_RAD` away [rad].

    None if there is none.
    """
    ratio: float = math.inf
    """Score over that of the other direction."""

    @property
    def is_sure(self) -> bool:
        """Whether no other direction comes near."""
        return self.ratio >= SURE_RATIO

    @property
    def is_room(self) -> bool:
        """Whether the other direction is the opposite one: a floor and its ceiling."""
        return self.rival_rad is not None and math.cos(self.rival_rad - self.down_rad) < -math.cos(
            OPPOSITE_RAD
        )

    def shown(self) -> str:
        """Return a text for messages.

        >>> DownGuess(0.0, 2.0, math.radians(96.0), 3.14).shown()
        '0.0 deg (guessed from level ground; runner-up at 96 deg is 3.1 times weaker)'
        """
        rival = "no runner-up"
        if self.rival_rad is not None:
            weaker = f"{self.ratio:.1f}" if self.ratio < 100 else "over 100"
            rival = f"runner-up at {math.degrees(self.rival_rad):.0f} deg is {weaker} times weaker"
        return f"{math.degrees(self.down_rad):.1f} deg (guessed from level ground; {rival})"


def guess_down(angle_rad: F64, range_m: F32, *, is_coarse: bool = False) -> DownGuess | None:
    """Guess the scan angle of straight down: level ground below, and much sky above.

    Every direction gets a score: the angle filled by the plane across it, over the root of the
    plane's distance, times the share of lines that show this plane by themselves (facades come and
    go), times the share of missing shots around the opposite direction. A dead angle may be sky or
    not, and counts half. Where the other side is level, too, one is a floor and one its ceiling:
    the guess is sure only if it is the nearer one.
    """
    if len(range_m) < LEAST_LINES:
        return None
    few = 3 if is_coarse else 1
    angle, lines = _thinned(angle_rad, range_m, MOST_COLUMNS // few)
    middle = middle_of_lines(lines)
    if np.count_nonzero(np.isfinite(middle)) < 3:
        return None
    step = float(np.median(np.abs(wrap(np.diff(angle)))))
    down = np.arange(-math.pi, math.pi, few * SEARCH_STEP_RAD)
    # cosine of the angle between every direction and every column
    along = np.cos(down)[:, None] * np.cos(angle) + np.sin(down)[:, None] * np.sin(angle)
    fill, depth, inside = _planes(along, middle, step)
    score = fill / np.sqrt(depth) * (LEAST_SKY + _sky(along, lines, step))
    score[fill < LEAST_RIVAL_RAD] = 0.0
    planes = []
    for direction in _peaks(score, down):
        columns = np.flatnonzero(inside[direction])
        share = _share_of_lines(
            lines[:, columns] * along[direction, columns], float(depth[direction])
        )
        plane = _Plane(
            float(score[direction]) * share,
            *_fit_plane(angle[columns], middle[columns]),
            float(fill[direction]),
        )
        if plane.score > 0:
            planes.append(plane)
    guess = _choose(sorted(planes, key=lambda plane: -plane.score))
    if guess is None:
        return None
    # the sky above one of two level planes may be a dead angle alone: then the nearer one must be
    # what was found
    opposite = _level(guess.down_rad + math.pi, angle, lines, middle)
    if not opposite:
        return guess
    below = _level(guess.down_rad, angle, lines, middle)
    if below >= SURE_RATIO * opposite:
        return guess
    return replace(
        guess, rival_rad=math.remainder(guess.down_rad + math.pi, _TURN), ratio=below / opposite
    )


@dataclass(frozen=True, slots=True)
class _Plane:
    """A plane that may be the ground."""

    score: float
    down_rad: float
    depth_m: float
    fill_rad: float


def _level(
    direction_rad: float,
    angle_rad: F64,
    range_m: F32,
    middle_m: F64,
) -> float:
    """Return the share of shots on a level plane, over the root of its distance."""
    ways = direction_rad + np.arange(-OPPOSITE_RAD, OPPOSITE_RAD, SEARCH_STEP_RAD)
    along = np.cos(ways[:, None] - angle_rad)
    fill, depth, inside = _planes(along, middle_m, 1.0)
    fullest = int(np.argmax(fill))
    n_seen = np.count_nonzero((along[fullest] > math.cos(REACH_RAD)) & np.isfinite(middle_m))
    if not fill[fullest]:
        return 0.0
    share = (
        fill[fullest]
        / n_seen
        * _share_of_lines(
            range_m[:, inside[fullest]] * along[fullest, inside[fullest]], float(depth[fullest])
        )
    )
    return float(share) / math.sqrt(float(depth[fullest])) if share >= LEAST_LEVEL else 0.0


def _choose(planes: list[_Plane]) -> DownGuess | None:
    best = next((plane for plane in planes if plane.fill_rad >= LEAST_RAD), None)
    if best is None:
        return None
    for rival in planes:
        if abs(math.remainder(rival.down_rad - best.down_rad, _TURN)) > RIVAL_RAD:
            return DownGuess(best.down_rad, best.depth_m, rival.down_rad, best.score / rival.score)
    return DownGuess(best.down_rad, best.depth_m)


def spread_rows(n: int, most: int) -> NDArray[np.intp]:
    """Return the indices of at most ``most`` of ``n`` rows, evenly spread, ascending."""
    if n <= most:
        return np.arange(n)
    return np.arange(most) * (n - 1) // (most - 1)


def _thinned(angle_rad: F64, range_m: F32, most_columns: int) -> tuple[F64, F32]:
    every = -(-range_m.shape[1] // most_columns)
    return angle_rad[every // 2 :: every], range_m[
        spread_rows(len(range_m), MOST_LINES), every // 2 :: every
    ]


def middle_of_lines(range_m: F32) -> F64:
    """Return the median range of every column; NaN if at most half of the lines have one."""
    n_held = np.count_nonzero(np.isfinite(range_m), axis=0)
    ordered = np.sort(range_m.astype(np.float64), axis=0)  # NaN sorts last
    if not len(range_m):
        return np.full(range_m.shape[1], np.nan)
    middle: F64 = ordered[np.minimum(n_held // 2, len(range_m) - 1), np.arange(range_m.shape[1])]
    return np.where(2 * n_held > len(range_m), middle, np.nan)


def _planes(along: F64, middle_m: F64, step_rad: float) -> tuple[F64, F64, Mask]:
    """Return the fullest plane across every direction: angle [rad], distance [m], columns."""
    near = (along > math.cos(REACH_RAD)) & np.isfinite(middle_m)
    row, column = np.nonzero(near)
    depth = middle_m[column] * along[near]
    height = np.minimum(depth / BIN_M, N_BINS).astype(np.int64) + row * (N_BINS + 1)
    counts = np.bincount(height, minlength=len(along) * (N_BINS + 1)).reshape(len(along), -1)
    distance = (np.argmax(counts[:, :N_BINS], axis=1) + 0.5) * BIN_M
    inside = np.zeros(along.shape, np.bool_)
    inside[near] = np.abs(depth - distance[row]) < BIN_M
    return inside.sum(axis=1) * step_rad, distance, inside


def _sky(along: F64, range_m: F32, step_rad: float) -> F64:
    """Return the share of missing shots opposite to every direction; dead angles count half."""
    missing = np.isnan(range_m).mean(axis=0)
    missing[missing == 1.0] = DEAD_SHARE
    above = along < -math.cos(SKY_RAD)
    n_above = above.sum(axis=1)
    covered = np.minimum(n_above * step_rad / (2 * SKY_RAD), 1.0)
    seen = np.where(above, missing, 0.0).sum(axis=1) / np.maximum(n_above, 1)
    share: F64 = covered * seen + (1.0 - covered) * DEAD_SHARE
    return share


def _peaks(score: F64, down_rad: F64) -> list[int]:
    """Return the highest scores that are not beside a higher one, in descending order."""
    left = score.copy()
    peaks = []
    for _ in range(MOST_PEAKS):
        highest = int(np.argmax(left))
        if left[highest] <= 0:
            break
        peaks.append(highest)
        left[np.abs(wrap(down_rad - down_rad[highest])) < PEAK_RAD] = 0.0
    return peaks


def _share_of_lines(depth_m: NDArray[Any], distance_m: float) -> float:
    """Return the share of lines that have half of the columns of a plane in it."""
    on_plane = np.abs(depth_m - distance_m) < NEAR_PLANE_M
    return float(np.mean(on_plane.mean(axis=1) >= 0.5))


def _fit_plane(angle_rad: F64, range_m: F64) -> tuple[float, float]:
    # 1 / r = cos(angle - down) / distance, a straight line in cosine and sine of the angle
    waves = np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=1)
    a, b = np.linalg.lstsq(waves, 1.0 / range_m, rcond=None)[0]
    return round(math.atan2(b, a), DECIMALS), round(1.0 / max(math.hypot(a, b), 1e-9), DECIMALS)
