"""Checks of the geometry against level ground: where down is, the angle between shots, and the unit of length.

The ground is the plane that nearly every line of the sample shows below the scanner; what the plane says is compared
with the angles and ranges in use. Without such a plane nothing is said.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import FAR_M
from prc_cli.core.types import F32, F64
from prc_cli.streams.down import MOST_LINES, DownGuess, guess_down, middle_of_lines, spread_rows, wrap
from prc_cli.streams.evidence.seen import Seen
from prc_cli.streams.evidence.table import Check

DOWN, ANGLE_STEP, UNITS = "down", "angle-step", "units"
"""Names of the checks."""

DOWN_DOUBTFUL_RAD, DOWN_AGAINST_RAD = math.radians(11.0), math.radians(20.0)
"""Largest angle between the direction in use and the one that the ranges show: the guess is off by up to 2 deg in
streets and 8 deg in forests."""
LOOKS_DOWN_RAD = math.radians(30.0)
"""A scanner looks down if it measures this near to straight down."""
LEAST_ASIDE = 3.0
"""Where it does not, the ground must be so many times the runner-up."""
LEAST_WINDOWS = 2
"""Windows that look elsewhere for the drive to contradict itself; also at least a quarter of all."""
LEAST_TURN_COLUMNS = 180
"""Columns of a line of a quarter turn or more; rings of a spinning scanner, which may lie as close, are fewer."""
ELSEWHERE_RAD = math.radians(40.0)
"""From here on a window looks elsewhere."""

ARC_RAD = math.radians(50.0)
"""The ground is compared up to this angle from straight down."""
LEAST_ARC_RAD = math.radians(25.0)
"""Least angle with returns for that."""
MOST_ANGLES = 180
LEAST_ANGLES = 10
"""Columns used to measure the angle step."""
FACTORS: F64 = np.exp(np.linspace(math.log(0.4), math.log(2.5), 65))
"""True angle step over that in use, as far as it is looked for."""
STEEP_RAD = math.radians(80.0)
"""Beams farther from straight down see no ground."""
ON_GROUND = 0.012
"""Deviation from the plane up to which a shot lies on it, as a share of its inverse range at the depth."""
N_FITS = 6
LOW_FACTOR, HIGH_FACTOR, HIGHER_FACTOR, FAR_FACTOR = 0.83, 1.08, 1.2, 1.6
"""Factors below the first and above the second are doubtful where the ground is clear, above the third where it is not
as well, above the fourth against. Good streets have .97 to 1.03;
ground that rises on both sides, as in forests, has down to .9."""
GROUND_SHARE, LESS_GROUND = 0.8, 0.9
"""Least share of shots on the ground for doubt, and the most ground that the step in use may show of what the better
one shows."""
FAR_LESS_GROUND, LOW_SHARE = 0.4, 0.95
"""The latter where the ground is not clear, and the former for factors below 1: near walls look like such ground."""

USUAL_M = 2.0
"""Scans are scaled to this depth, so that planes are found in any unit."""
LOW_M, HIGH_M = 0.4, 5.0
BLIND_LOW_M, BLIND_HIGH_M = 0.3, 6.0
LOWEST_M, HIGHEST_M = 0.1, 50.0
"""Depths of the ground: outside the first are doubtful; where down is not known outside the second, because a slant
makes the depth larger; outside the third against."""


@dataclass(frozen=True, slots=True)
class StepFit:
    """How the ground bends."""

    factor: float
    """True angle step over that in use."""
    share: float
    """Share of the shots up to :data:`ARC_RAD` from straight down that lie on the ground then."""
    with_one: float
    """Shots on the ground with the step in use, as a share of those."""


def check_down(seen: Seen) -> Finding | None:
    """Compare straight down as it is used with what the ranges show.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from prc_cli.core.stream import StreamInfo
    >>> from prc_cli.streams.evidence.sample import Window
    >>> beam = np.deg2rad(np.arange(-180.0, 180.0))
    >>> line = np.where(np.cos(beam) > 0.3, 2 / np.maximum(np.cos(beam), 0.3), np.nan).astype(np.float32)
    >>> window = Window(0, np.tile(line, (20, 1)))
    >>> seen = Seen(StreamInfo("a.npy", "array", 360, None, None), 0, (window,), beam_rad=beam)
    >>> check_down(seen).verdict.name, check_down(replace(seen, beam_rad=wrap(beam + 0.3))).verdict.name
    ('FINE', 'DOUBTFUL')
    """
    if seen.beam_rad is None:
        return None
    lines = _lines(seen)
    if not len(lines):
        return None
    scale = _scale(seen.beam_rad, lines)
    guess = guess_down(seen.beam_rad, lines * np.float32(scale))
    if guess is None:
        return None
    expected = f"within {math.degrees(DOWN_DOUBTFUL_RAD):.0f} deg of the direction in use"
    # of a scanner that does not look down the nearest plane is a wall
    looks_down = np.count_nonzero(np.abs(seen.beam_rad) < LOOKS_DOWN_RAD) >= LEAST_ANGLES
    if not guess.is_sure or (guess.ratio < LEAST_ASIDE and not looks_down):
        return Finding(DOWN, Verdict.FINE, f"the ranges do not tell where level ground is ({_shown(guess)})", expected)
    off = abs(math.remainder(guess.down_rad, 2 * math.pi))
    found = f"level ground is {math.degrees(off):.0f} deg from straight down ({_shown(guess)})"
    verdict = _verdict(is_doubtful=off > DOWN_DOUBTFUL_RAD, is_against=off > DOWN_AGAINST_RAD)
    hint = f"give input.nadir, or {_corrected(seen, guess)}" if verdict else ""
    if not verdict and (n_off := _n_elsewhere(seen, seen.beam_rad, scale)):
        verdict = Verdict.DOUBTFUL
        found = f"level ground is elsewhere in {n_off} of {len(seen.windows)} samples along the drive"
        hint = "check whether the scanner was moved, or parts of the file are of another scanner"
    return Finding(DOWN, verdict, found, expected, hint)


def _verdict(*, is_doubtful: bool, is_against: bool) -> Verdict:
    if is_against:
        return Verdict.AGAINST
    return Verdict.DOUBTFUL if is_doubtful else Verdict.FINE


def _shown(guess: DownGuess) -> str:
    if guess.rival_rad is None:
        return "no runner-up"
    return f"runner-up at {math.degrees(guess.rival_rad):.0f} deg, {min(guess.ratio, 100.0):.1f} times weaker"


def _corrected(seen: Seen, guess: DownGuess) -> str:
    """Return what would turn straight down to where the ground is."""
    if seen.angle_rad is None or seen.beam_rad is None:
        return "coordinates relative to the scanner with z up"
    at = int(np.argmin(np.abs(wrap(seen.beam_rad - guess.down_rad))))
    away = math.remainder(float(guess.down_rad - seen.beam_rad[at]), 2 * math.pi)
    step = wrap(np.diff(seen.beam_rad)) * wrap(np.diff(seen.angle_rad))
    away = away if np.sign(step).sum() >= 0 else -away
    nadir = math.degrees(math.remainder(float(seen.angle_rad[at]) + away, 2 * math.pi))
    return f"where the ground is right --set input.nadir={nadir + 0.0:.0f}"


def _n_elsewhere(seen: Seen, beam_rad: F64, scale: float) -> int:
    """Return the number of windows with ground in another direction for sure; 0 where they are few."""
    if len(seen.windows) < 2 * LEAST_WINDOWS:
        return 0
    n_off = 0
    for window in seen.windows:
        lines = window.range_m[spread_rows(len(window.range_m), MOST_LINES // 4)]
        guess = guess_down(beam_rad, lines * np.float32(scale), is_coarse=True)
        n_off += guess is not None and guess.is_sure and abs(guess.down_rad) > ELSEWHERE_RAD
    return n_off if n_off >= max(LEAST_WINDOWS, len(seen.windows) // 4) else 0


def check_angle_step(seen: Seen) -> Finding | None:
    """Compare the angle between shots with how the ground bends: at distance d its ranges are ``d / cos(angle)``."""
    if seen.angle_rad is not None and _are_radians(seen.angle_rad):
        found = f"the angles of a line span {math.degrees(float(np.ptp(seen.angle_rad))):.3g} deg"
        hint = "if they are radians, name them angle_rad"
        return Finding(ANGLE_STEP, Verdict.AGAINST, found, "degrees: the numbers of a turn in radians span 6.28", hint)
    if seen.beam_rad is None:
        return None
    fit = fit_step(seen.beam_rad, _lines(seen))
    if fit is None:
        return None
    is_usual = LOW_FACTOR <= fit.factor <= HIGH_FACTOR
    least_share = GROUND_SHARE if fit.factor > 1 else LOW_SHARE
    is_clear = fit.share > least_share and fit.with_one < LESS_GROUND
    is_far = fit.factor > HIGHER_FACTOR and fit.with_one < FAR_LESS_GROUND
    is_doubtful = is_far or (not is_usual and is_clear)
    verdict = _verdict(is_doubtful=is_doubtful, is_against=is_far and fit.factor > FAR_FACTOR)
    found = f"the ground is flat with angles {fit.factor:.2f} times as large"
    if not is_usual and not verdict:
        found = f"the ground does not tell the angle step (flat with {fit.factor:.2f} times, but not for sure)"
    hint = "check the angles of the shots: input.angle_step, and -M where it was computed from M" if verdict else ""
    return Finding(ANGLE_STEP, verdict, found, f"{LOW_FACTOR:g} to {HIGH_FACTOR:g}", hint)


def _are_radians(angle_rad: F64) -> bool:
    """Return whether so many columns lie so close that the numbers of a half or whole turn are those of radians."""
    return len(angle_rad) >= LEAST_TURN_COLUMNS and math.pi / 2 < math.degrees(float(np.ptp(angle_rad))) <= 2 * math.pi


def fit_step(beam_rad: F64, range_m: F32) -> StepFit | None:
    """Find the factor of the angles with which most of the ground is a plane; None with too few returns.

    Parameters
    ----------
    beam_rad : (M,) float64
        Angle of every column from straight down [rad].
    range_m : (lines, M) float32, metres
        NaN = missing.

    Examples
    --------
    >>> beam = np.deg2rad(np.arange(-60.0, 60.0))
    >>> lines = np.tile(2 / np.cos(beam), (8, 1)).astype(np.float32)
    >>> round(fit_step(beam, lines).factor, 2), round(fit_step(0.9 * beam, lines).factor, 2)
    (1.0, 1.11)
    """
    below = np.flatnonzero(np.abs(beam_rad) < ARC_RAD)
    below = below[spread_rows(len(below), MOST_ANGLES)]
    middle = middle_of_lines(range_m[:, below])
    is_seen = np.isfinite(middle)
    angle, near = beam_rad[below][is_seen], 1.0 / middle[is_seen]
    if len(angle) < LEAST_ANGLES or np.ptp(angle) < LEAST_ARC_RAD:
        return None
    turned = FACTORS[:, None] * angle
    cosine, sine = np.cos(turned), np.sin(turned)
    possible = np.abs(turned) < STEEP_RAD
    near = near / np.median(near)
    weight = possible.astype(np.float64)
    for _ in range(N_FITS):
        off = _off_plane(cosine, sine, near, weight)
        # a weighted median would be slower, and the outermost factors see few shots
        limit = np.maximum(2.5 * np.median(off, axis=1), ON_GROUND)
        weight = ((off < limit[:, None]) & possible).astype(np.float64)
    on_ground = np.count_nonzero((off < ON_GROUND) & possible, axis=1)
    best = int(on_ground.max())
    if not best:
        return None
    factor = float(np.mean(FACTORS[on_ground >= 0.97 * best]))
    at_one = int(on_ground[np.argmin(np.abs(FACTORS - 1.0))])
    return StepFit(factor, best / len(angle), at_one / best)


def _off_plane(cosine: F64, sine: F64, near: F64, weight: F64) -> F64:
    """Return how far shots are off the plane of each factor, as a share of its inverse distance."""
    cc, cs, ss = ((weight * a * b).sum(axis=1) for a, b in ((cosine, cosine), (cosine, sine), (sine, sine)))
    cn, sn = (weight * cosine * near).sum(axis=1), (weight * sine * near).sum(axis=1)
    determinant = cc * ss - cs * cs
    determinant = np.where(np.abs(determinant) < 1e-12, np.inf, determinant)
    a, b = (ss * cn - cs * sn) / determinant, (cc * sn - cs * cn) / determinant
    plane = a[:, None] * cosine + b[:, None] * sine
    off: F64 = np.abs(plane - near) / np.maximum(np.hypot(a, b), 1e-9)[:, None]
    return off


def check_height(seen: Seen) -> Finding | None:
    """Compare the depth of the ground below the scanner with what platforms have: ranges may be in another unit."""
    lines = _lines(seen)
    if not len(lines):
        return None
    low, high = LOW_M, HIGH_M
    angle = seen.beam_rad if seen.beam_rad is not None else seen.angle_rad
    if angle is None:
        # whatever the angles are: the ground is the nearest plane, and its depth its least range
        angle = wrap(2 * math.pi * np.arange(seen.points_per_line) / seen.points_per_line)
    scale = _scale(angle, lines)
    guess = guess_down(angle, lines * np.float32(scale))
    if guess is None:
        return None
    if seen.beam_rad is None:
        if not guess.is_sure:
            return None
        low, high = BLIND_LOW_M, BLIND_HIGH_M
    elif abs(math.remainder(guess.down_rad, 2 * math.pi)) > DOWN_AGAINST_RAD:
        return None
    depth = guess.depth_m / scale * seen.info.down(seen.scanner)[1]
    is_usual, is_possible = low <= depth <= high, LOWEST_M <= depth <= HIGHEST_M
    verdict = _verdict(is_doubtful=not is_usual, is_against=not is_possible)
    found = f"the scanner is {depth:.3g} m above the ground"
    scales = [scale for scale in (0.001, 0.01, 0.3048) if low <= scale * depth <= high] if verdict else []
    option = f"--set input.range_scale={scales[0]:g}" if scales else ""
    hint = (
        f"check the unit of the ranges, which are taken for metres: {option or 'input.range_scale'}" if verdict else ""
    )
    return Finding(UNITS, verdict, found, f"{low:g} to {high:g} m", hint, option)


def _lines(seen: Seen) -> F32:
    """Return lines with returns, spread over the windows."""
    n_lines = np.cumsum([0, *(len(window.range_m) for window in seen.windows)])
    found: list[NDArray[np.float32]] = []
    # twice as many, because some may have no returns
    for row in spread_rows(int(n_lines[-1]), 2 * MOST_LINES):
        window = int(np.searchsorted(n_lines, row, side="right")) - 1
        found.append(seen.windows[window].range_m[row - n_lines[window]])
    if not found:
        return np.empty((0, seen.points_per_line), np.float32)
    # farther is no ground, and would overflow when it is scaled
    lines: F32 = np.minimum(np.stack(found), np.float32(FAR_M))
    lines = lines[~np.isnan(lines).all(axis=1)]
    return lines[spread_rows(len(lines), MOST_LINES)]


def _scale(beam_rad: F64, range_m: F32) -> float:
    """Return the factor that brings the median depth below the scanner to :data:`USUAL_M`; 1 where nothing is there."""
    below = np.flatnonzero(np.abs(beam_rad) < ARC_RAD)
    below = below[spread_rows(len(below), MOST_ANGLES)]
    depth = range_m[:, below].astype(np.float64) * np.cos(beam_rad[below])
    depth = depth[np.isfinite(depth)]
    # within what float32 holds, whatever the ranges are
    return float(np.clip(USUAL_M / np.median(depth), 1e-6, 1e6)) if len(depth) else 1.0


GEOMETRY_CHECKS: tuple[Check, ...] = (
    Check(
        UNITS,
        "Is the scanner as high above the ground as platforms are?",
        "Doubtful below 0.4 m and above 5 m, where down is not known below 0.3 m and above 6 m; refused below 0.1 m "
        "and above 50 m",
        "Scanners stand 0.6 m (robots) to 4 m (trucks, trains) high. A street in feet is 6.6 to 13 m deep in 22 scans, "
        "ranges in centimetres or millimetres hundreds",
        "Scans without level ground; feet taken for metres where the scanner is lower than 1.5 m.",
    ),
    Check(
        ANGLE_STEP,
        "Is the ground flat with the angles in use?",
        "Over 50 deg to either side. Doubtful where angles 1.08 times as large, or 0.83 times, make most of the "
        "ground a "
        "plane that is none with those in use; refused from 1.6 times, and where 180 columns or more span "
        "1.6 to 6.3 deg (radians)",
        "Good streets give 0.97 to 1.03; ground that rises on both sides, as in forests, down to 0.9. Half the step "
        "was "
        "refused in 158 of 158 drives, nine tenths doubted in 123",
        "Nine tenths of the step where little of the ground is seen: a gap down, push-brooms.",
    ),
    Check(
        DOWN,
        "Is level ground where straight down is said to be?",
        "Where the ranges tell for sure: doubtful from 11 deg, refused from 20 deg; doubtful where samples along the "
        "drive look elsewhere",
        "The guess is off by up to 2 deg in streets, and 9.6 deg in forests. Down told wrongly by 15 deg was noticed "
        "in "
        "312 of 316 drives, by 45 and 180 deg in all",
        "Cross slopes of more than 11 deg look like a wrong down. Scans without level ground are not judged, nor are "
        "scanners that do not look down.",
    ),
)
"""Checks of the geometry, for the page "How prc knows"."""
