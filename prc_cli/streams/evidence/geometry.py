"""Checks of the geometry against level ground.

They test the direction of down, the angle between shots, and the unit of length.

The ground is the plane that nearly every line of the sample shows below the scanner; what the plane
says is compared with the angles and ranges in use. The angle between shots is compared with what
all planes say. Without planes nothing is said.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.stream import FAR_M
from prc_cli.core.types import F32, F64
from prc_cli.streams.angle_step import measure_step
from prc_cli.streams.angles import are_radians
from prc_cli.streams.down import MOST_LINES, DownGuess, guess_down, spread_rows, wrap
from prc_cli.streams.evidence.figures import Seen
from prc_cli.streams.evidence.table import verdict_of

DOWN = "down"
ANGLE_STEP = "angle-step"
UNITS = "units"
"""Names of the checks."""

DOWN_DOUBTFUL_RAD = math.radians(11.0)
DOWN_AGAINST_RAD = math.radians(20.0)
"""Largest angle between the direction in use and the one that the ranges show.

The guess is off by up to 2 deg in
streets and 8 deg in forests."""
LOOKS_DOWN_RAD = math.radians(30.0)
"""A scanner looks down if it measures this near to straight down."""
LEAST_ASIDE = 3.0
"""If it does not look down, the ground must be this many times the runner-up."""
LEAST_WINDOWS = 2
"""Windows that look elsewhere for the drive to contradict itself.

At least a quarter of all must do so.
"""
ELSEWHERE_RAD = math.radians(40.0)
"""From here on a window looks elsewhere."""

ARC_RAD = math.radians(50.0)
"""The depth of the ground is looked at up to this angle from straight down."""
MOST_ANGLES = 180
"""Most columns used for it."""
LEAST_ANGLES = 10
"""Columns near to straight down of a scanner that looks down."""
MOST_DOUBTLESS = 0.08
"""The step in use may be off by this share, or by :data:`SURE` times the uncertainty of the step
measured: of 64 lines this is up to 6 % off."""
SURE = 3.0
UNSURE = 0.05
"""A step that is measured less well cannot contradict the given step."""
FAR_FACTOR = 1.6
"""Steps that are off by this factor are against."""
UNEVEN_RAD = math.radians(2.0)
"""Beams that lie farther from a straight line in the column are not even."""
MOST_OFF = 0.03
"""Uncertainty of measured angles above which they give a warning."""

USUAL_M = 2.0
"""Scans are scaled to this depth, so that planes are found in any unit.

Of the units that are possible, the one that
brings the scanner nearest to this height is offered."""
LOW_M = 0.4
HIGH_M = 5.0
BLIND_LOW_M = 0.3
BLIND_HIGH_M = 6.0
LOWEST_M = 0.1
HIGHEST_M = 50.0
"""Depths of the ground: outside the first pair they give a warning.

If down is not known the second pair applies, because a slant makes the depth larger. Outside
the third pair the input is refused."""


def check_down(seen: Seen) -> Finding | None:
    """Compare straight down as it is used with what the ranges show."""
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
        return Finding(
            DOWN,
            Verdict.FINE,
            f"the ranges do not show level ground clearly ({_shown(guess)})",
            expected,
        )
    off = abs(math.remainder(guess.down_rad, 2 * math.pi))
    measured = f"level ground is {math.degrees(off):.0f} deg from straight down ({_shown(guess)})"
    verdict = verdict_of(doubtful=off > DOWN_DOUBTFUL_RAD, against=off > DOWN_AGAINST_RAD)
    hint = _corrected(seen, guess) if verdict else ""
    if not verdict and (n_off := _n_elsewhere(seen, seen.beam_rad, scale)):
        verdict = Verdict.DOUBTFUL
        measured = (
            f"level ground is elsewhere in {n_off} of {len(seen.windows)} samples along the drive"
        )
        hint = "check whether the scanner was moved, or the file contains two scanners"
    return Finding(DOWN, verdict, measured, expected, hint)


def _shown(guess: DownGuess) -> str:
    if guess.rival_rad is None:
        return "no runner-up"
    return (
        f"runner-up at {math.degrees(guess.rival_rad):.0f} deg, "
        f"{min(guess.ratio, 100.0):.1f} times weaker"
    )


def _corrected(seen: Seen, guess: DownGuess) -> str:
    """Return what would turn straight down to where the ground is."""
    if seen.angle_rad is None or seen.beam_rad is None:
        return "give x, y, z relative to the scanner, with z up"
    nearest = int(np.argmin(np.abs(wrap(seen.beam_rad - guess.down_rad))))
    away = math.remainder(float(guess.down_rad - seen.beam_rad[nearest]), 2 * math.pi)
    step = wrap(np.diff(seen.beam_rad)) * wrap(np.diff(seen.angle_rad))
    away = away if np.sign(step).sum() >= 0 else -away
    nadir = math.degrees(math.remainder(float(seen.angle_rad[nearest]) + away, 2 * math.pi))
    return f"give input.nadir; if that is the ground: --set input.nadir={nadir + 0.0:.0f}"


def _n_elsewhere(seen: Seen, beam_rad: F64, scale: float) -> int:
    """Return the number of windows with ground in another direction for sure.

    0 if they are few.
    """
    if len(seen.windows) < 2 * LEAST_WINDOWS:
        return 0
    n_off = 0
    for window in seen.windows:
        lines = window.range_m[spread_rows(len(window.range_m), MOST_LINES // 4)]
        guess = guess_down(beam_rad, lines * np.float32(scale), is_coarse=True)
        n_off += guess is not None and guess.is_sure and abs(guess.down_rad) > ELSEWHERE_RAD
    return n_off if n_off >= max(LEAST_WINDOWS, len(seen.windows) // 4) else 0


def check_angle_step(seen: Seen) -> Finding | None:
    """Compare the angle between shots with the one that planes show.

    A measured angle that is uncertain gives a warning.
    """
    if seen.angle_rad is not None and are_radians(seen.angle_rad):
        measured_text = (
            f"the angles of a line span {math.degrees(float(np.ptp(seen.angle_rad))):.3g} deg"
        )
        hint = f"if they are radians, name them angle_rad; if they have another scale: {_MEASURED}"
        return Finding(
            ANGLE_STEP,
            Verdict.AGAINST,
            measured_text,
            "degrees (a turn in radians spans 6.28)",
            hint,
        )
    step_rad = None if seen.beam_rad is None else _even_step(seen.beam_rad)
    if step_rad is None:
        return None
    off = seen.info.angles_off
    if off > MOST_OFF:
        measured_text = (
            f"the angles were measured from the ranges to ± {off:.1%}: "
            f"{math.degrees(step_rad):.4g} deg a shot"
        )
        expected = (
            f"± {MOST_OFF:.0%} (20 % off lowers the mean F1 by 0.11 in streets, 0.43 in forests)"
        )
        hint = "give the step of the scanner: --set input.angle_start=0 --set input.angle_step=DEG"
        return Finding(ANGLE_STEP, Verdict.DOUBTFUL, measured_text, expected, hint)
    measured = measure_step(_lines(seen))
    if measured is None or measured.off > UNSURE:
        return None
    factor = measured.step_rad / step_rad
    is_doubtful = abs(factor - 1.0) > max(MOST_DOUBTLESS, SURE * measured.off)
    verdict = verdict_of(
        doubtful=is_doubtful, against=is_doubtful and not 1 / FAR_FACTOR < factor < FAR_FACTOR
    )
    measured_text = f"the ranges show {factor:.2f} times the angle from shot to shot in use"
    shown = f"{math.degrees(measured.step_rad):.4g} deg, known to {measured.off:.1%}"
    hint = ""
    if verdict:
        hint = "check the angles of the shots (input.angle_step) and -M"
        hint += f"; to use the measured angles: {_MEASURED}"
    expected = f"{1 - MOST_DOUBTLESS:g} to {1 + MOST_DOUBTLESS:g}"
    return Finding(ANGLE_STEP, verdict, f"{measured_text} ({shown})", expected, hint)


_MEASURED = "--set input.angles=measured"


def _even_step(beam_rad: F64) -> float | None:
    """Return the angle from column to column of even beams, without its sign.

    None if they are not even.
    """
    beam = np.unwrap(beam_rad)
    column = np.arange(len(beam_rad))
    if len(beam) < 2:
        return None
    step = float(beam[-1] - beam[0]) / (len(beam) - 1)
    is_even = step != 0.0 and float(np.abs(beam - beam[0] - step * column).max()) < UNEVEN_RAD
    return abs(step) if is_even else None


UNITS_M = (0.001, 0.01, 0.3048, 1000.0)
"""Units that ranges are stored in by mistake [m]."""


def check_height(seen: Seen) -> Finding | None:
    """Compare the depth of the ground below the scanner with what platforms have.

    Ranges may be in another unit.
    """
    lines = _lines(seen)
    if not len(lines):
        return None
    low = LOW_M
    high = HIGH_M
    angle = seen.beam_rad if seen.beam_rad is not None else seen.angle_rad
    if angle is None:
        # for any angles: the ground is the nearest plane, and its depth its least range
        angle = wrap(2 * math.pi * np.arange(seen.points_per_line) / seen.points_per_line)
    scale = _scale(angle, lines)
    guess = guess_down(angle, lines * np.float32(scale))
    if guess is None:
        return None
    if seen.beam_rad is None:
        if not guess.is_sure:
            return None
        low = BLIND_LOW_M
        high = BLIND_HIGH_M
    elif abs(math.remainder(guess.down_rad, 2 * math.pi)) > DOWN_AGAINST_RAD:
        return None
    depth = guess.depth_m / scale * seen.info.down(seen.scanner)[1]
    is_usual = low <= depth <= high
    is_possible = LOWEST_M <= depth <= HIGHEST_M
    verdict = verdict_of(doubtful=not is_usual, against=not is_possible)
    measured = f"the scanner is {depth:.3g} m above the ground"
    scales = [scale for scale in UNITS_M if low <= scale * depth <= high] if verdict else []
    best = min(scales, key=lambda scale: abs(math.log(scale * depth / USUAL_M)), default=None)
    option = f"--set input.range_scale={best:g}" if best else ""
    hint = (
        f"check the unit of the ranges, assumed to be metres: {option or 'input.range_scale'}"
        if verdict
        else ""
    )
    return Finding(UNITS, verdict, measured, f"{low:g} to {high:g} m", hint, option)


def _lines(seen: Seen) -> F32:
    """Return lines with returns, spread over the windows."""
    n_lines = np.cumsum([0, *(len(window.range_m) for window in seen.windows)])
    rows: list[NDArray[np.float32]] = []
    # twice as many, because some may have no returns
    for row in spread_rows(int(n_lines[-1]), 2 * MOST_LINES):
        window = int(np.searchsorted(n_lines, row, side="right")) - 1
        rows.append(seen.windows[window].range_m[row - n_lines[window]])
    if not rows:
        return np.empty((0, seen.points_per_line), np.float32)
    # farther is no ground, and would overflow when it is scaled
    lines: F32 = np.minimum(np.stack(rows), np.float32(FAR_M))
    lines = lines[~np.isnan(lines).all(axis=1)]
    return lines[spread_rows(len(lines), MOST_LINES)]


def _scale(beam_rad: F64, range_m: F32) -> float:
    """Return the factor that brings the median depth below the scanner to :data:`USUAL_M`.

    1 if there are no returns.
    """
    below = np.flatnonzero(np.abs(beam_rad) < ARC_RAD)
    below = below[spread_rows(len(below), MOST_ANGLES)]
    depth = range_m[:, below].astype(np.float64) * np.cos(beam_rad[below])
    depth = depth[np.isfinite(depth)]
    # within the limits of float32, for any ranges
    return float(np.clip(USUAL_M / np.median(depth), 1e-6, 1e6)) if len(depth) else 1.0
