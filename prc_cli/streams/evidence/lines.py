"""Checks of shots and lines by their ranges: firing order, and lines of M shots.

PRC compares a shot with its neighbours in the line and in the lines before and after (Lehtola et
al. 2019, section II). These checks test whether such neighbours are alike, as consecutive shots of
a scanner are.
"""

from __future__ import annotations

import math

import numpy as np

from prc_cli.core.findings import Finding, Verdict
from prc_cli.core.types import F32
from prc_cli.streams.evidence.figures import (
    LEAST_PAIRS,
    SMOOTH,
    TURNED,
    Figures,
    Seen,
    Turned,
    fold,
    lag_likeness,
    likeness,
)
from prc_cli.streams.evidence.line_limits import (
    ALIKE,
    AS_ALIKE,
    FAN_DEG,
    FAR_OFF,
    FOLD_AGAINST,
    FOLD_DOUBTFUL,
    FOLD_LONG,
    FOLD_NOTHING,
    FOLD_RANDOM,
    FOLD_REACH,
    FOLD_SHORT,
    FRAME_SHOTS,
    HALF,
    LEAST_LINES,
    LINE_AGAINST,
    LINE_DOUBTFUL,
    LONELY,
    MOST_UNLIKE,
    MOVED_AGAINST,
    MOVED_NOISE,
    MOVED_SAME,
    NEXT_CLEAR,
    ORDER_AGAINST,
    ORDER_DOUBTFUL,
    PERIOD_SHOTS,
    SECOND,
    SEEN_AGAIN,
    SHIFT_NEAR,
    SHIFTS,
    STANDING_LINES,
    TURNED_AGAINST,
)
from prc_cli.streams.evidence.periods import WEAK_PERIOD, estimate_points_per_line
from prc_cli.streams.evidence.table import verdict_of

_ORDER_HINT = (
    "check the layout (byte order, types, header bytes), or sort the shots by firing order"
)


def _share_of_random(difference: float, figures: Figures) -> float:
    """Return a difference beside that of random shots.

    NaN if all shots see one surface at one distance.
    """
    return difference / figures.random if figures.random >= SMOOTH else math.nan


def check_shot_order(figures: Figures) -> Finding | None:
    """Check whether consecutive shots see the same surfaces."""
    ratio = _share_of_random(figures.shot[0], figures)
    if not np.isfinite(ratio):
        return None
    name = "shot-order"
    times = "" if f"{ratio:.2g}" == "1" else f"{ratio:.2g} times "
    measured = f"ranges of neighbouring shots differ {times}as much as those of random shots"
    expected = f"below {ORDER_DOUBTFUL:g}"
    if figures.shot[1] < SECOND * figures.shot[0]:
        measured = (
            f"every second shot is more like a shot ({figures.shot[1]:.2g}) "
            f"than the next ({figures.shot[0]:.2g})"
        )
        hint = (
            "if two scanners alternate: --scanner DIMENSION; "
            "if several returns alternate: give the return number"
        )
        return Finding(name, Verdict.AGAINST, measured, "neighbours that are the most alike", hint)
    verdict = verdict_of(doubtful=ratio >= ORDER_DOUBTFUL, against=ratio >= ORDER_AGAINST)
    return Finding(name, verdict, measured, expected, _ORDER_HINT)


def check_line_length(seen: Seen, figures: Figures, turned: Turned | None) -> Finding | None:
    """Check whether lines repeat after M shots.

    If all columns ``turned`` at one place, M is right.
    """
    m = seen.points_per_line
    first = figures.line[0]
    if figures.random < SMOOTH:
        return None
    ratio = _share_of_random(first, figures) if seen.n_lines >= LEAST_LINES else math.nan
    if ratio >= ALIKE and (step := _step_alike(figures)):
        return _alternating(seen, figures, step)
    period = _period(seen)
    true = (
        _exact(seen, period) if period is not None and max(m / period, period / m) > FAR_OFF else m
    )
    if true != m and _is_as_alike(seen, true):
        return _repeating(seen, true)
    if not np.isfinite(ratio):
        return None
    name = "line-length"
    expected = f"lines of M = {m} shots that are alike"
    near = [m + off for off in range(-FOLD_REACH, FOLD_REACH + 1) if m + off > 1]
    next_length = _next_alike(seen, near) if m <= FRAME_SHOTS else None
    if next_length is not None and next_length != m:
        measured = f"the next line is {next_length} shots later, not {m}"
        return Finding(name, Verdict.AGAINST, measured, expected, *_remedy(seen, next_length))
    if is_shifted(turned, m) or (next_length == m and _is_fan(seen)):
        measured = f"neighbouring lines differ {ratio:.2g} times as much as random shots"
        return Finding(name, Verdict.FINE, measured, f"below {LINE_DOUBTFUL:g}")
    folded = {length: fold(seen.windows, length) for length in near}
    is_unlike = ratio >= LINE_DOUBTFUL or not folded[m] < FOLD_RANDOM
    if is_unlike and period is not None and abs(period - m) > FOLD_REACH:
        return _repeating(seen, period)
    others = (length for length in folded if length != m)
    better = min(others, key=lambda length: _or_inf(folded[length]))
    gain = folded[m] / folded[better] if np.isfinite(folded[m]) and folded[better] > 0 else math.nan
    is_long = seen.n_lines * FOLD_LONG >= m
    if gain >= (FOLD_DOUBTFUL if is_long else FOLD_SHORT):
        better = _next_alike(seen, list(folded)) or better
    if better != m and gain >= (FOLD_DOUBTFUL if is_long else FOLD_SHORT):
        measured = (
            f"along the stream, lines of {better} shots agree {gain:.2g} times better than "
            f"lines of {m}"
        )
        verdict = verdict_of(doubtful=True, against=gain >= FOLD_AGAINST and is_long)
        expected = f"no length that agrees better by {FOLD_DOUBTFUL:g}"
        return Finding(name, verdict, measured, expected, *_remedy(seen, better))
    hint = "check -M and --lines, and whether lines and columns are exchanged"
    if folded[m] > FOLD_RANDOM:
        measured = (
            f"lines far apart differ by {folded[m]:.2g}, so not even the ground is in one place"
        )
        verdict = verdict_of(doubtful=True, against=folded[m] > FOLD_NOTHING)
        return Finding(name, verdict, measured, f"at most {FOLD_RANDOM:g}", hint)
    measured = f"neighbouring lines differ {ratio:.2g} times as much as random shots"
    expected = f"below {LINE_DOUBTFUL:g}"
    verdict = verdict_of(doubtful=ratio >= LINE_DOUBTFUL, against=ratio >= LINE_AGAINST)
    return Finding(name, verdict, measured, expected, hint if verdict else "")


def _is_fan(seen: Seen) -> bool:
    if seen.has_rings:
        return True
    angle_rad = seen.angle_rad if seen.angle_rad is not None else seen.beam_rad
    return angle_rad is not None and float(np.ptp(np.unwrap(angle_rad))) < math.radians(FAN_DEG)


def _next_alike(seen: Seen, lengths: list[int]) -> int | None:
    """Return the length at which lines are most like the next one, if that is clear."""
    off = {length: lag_likeness(seen.windows, length) for length in lengths}
    first, second = sorted(off, key=lambda length: _or_inf(off[length]))[:2]
    return first if off[first] < NEXT_CLEAR * off[second] else None


def is_shifted(turned: Turned | None, points_per_line: int) -> bool:
    """Return whether all columns shift at a single place.

    A wrong M shifts them from every line to the next.
    """
    if turned is None or turned.gain >= TURNED or turned.n_places > 1:
        return False
    n_shots = abs(turned.share) * points_per_line
    near = SHIFT_NEAR * points_per_line
    return all(abs(n_shots - wrong * turned.distance) > near for wrong in range(1, FOLD_REACH + 1))


def check_columns_along(seen: Seen, turned: Turned | None) -> Finding | None:
    """Check whether all columns keep their place along the stream."""
    if turned is None:
        return None
    expected = f"at least {TURNED:g} times"
    if not is_shifted(turned, seen.points_per_line):
        measured = (
            "no shift of all columns makes places along the stream differ less than "
            f"{turned.gain:.2g} times"
        )
        return Finding("columns-along", Verdict.FINE, measured, expected)
    n_shots = round(abs(turned.share) * seen.points_per_line)
    measured = (
        f"before line {turned.line} all columns shift by {n_shots} shots "
        f"({turned.gain:.2g} times the difference)"
    )
    hint = "shots were lost or added there: split the file there"
    verdict = verdict_of(doubtful=True, against=turned.gain < TURNED_AGAINST)
    return Finding("columns-along", verdict, measured, expected, hint)


def check_noise(seen: Seen, figures: Figures) -> Finding | None:
    """Check whether the method tolerates the range noise."""
    if not np.isfinite(seen.most_noise_m) or not np.isfinite(figures.noise_m):
        return None
    measured = f"ranges have noise of about {figures.noise_m:.3f} m"
    hint = "widen the thresholds of this method (prc calibrate), or choose another method"
    verdict = verdict_of(doubtful=figures.noise_m > seen.most_noise_m)
    return Finding("range-noise", verdict, measured, f"at most {seen.most_noise_m:g} m", hint)


def _remedy(seen: Seen, points_per_line: int) -> tuple[str, str]:
    info = seen.info
    if info.line_rule == "time" and info.line_hz is not None:
        line_hz = info.line_hz * seen.points_per_line / points_per_line
        option = f"--lines time:{line_hz:.9g} -M {points_per_line}"
        return f"give {option}", option
    if info.line_rule in ("dimension", "angle-wrap"):
        option = f"--lines fixed --columns order -M {points_per_line}"
        return f"number whole lines; if no shot is left out: {option}", option
    option = f"-M {points_per_line}"
    return f"give {option}", option


def _repeating(seen: Seen, period: int) -> Finding:
    m = seen.points_per_line
    measured = f"the ranges repeat after {period} shots, not after {m}"
    expected = f"lines of M = {m} shots that are alike"
    return Finding("line-length", Verdict.AGAINST, measured, expected, *_remedy(seen, period))


def _step_alike(figures: Figures) -> int:
    """Return how many lines later comes one that is far more alike than the next.

    0 if there is none.
    """
    steps = (
        step
        for step in range(2, len(figures.line) + 1)
        if figures.line[step - 1] < SECOND * figures.line[0]
    )
    return next(steps, 0)


def _alternating(seen: Seen, figures: Figures, step: int) -> Finding:
    """Explain lines that alternate: to and fro, several scanners, or M too small."""
    if step == 2 and figures.reversed_line <= HALF * figures.line[1]:
        measured = "every second line runs the other way"
        return Finding(
            "line-length",
            Verdict.AGAINST,
            measured,
            "lines scanned the same way",
            "reverse every second line",
        )
    ordinal = {2: "2nd", 3: "3rd"}.get(step, f"{step}th")
    measured = f"a line is like the {ordinal} line after it, not the next"
    m = seen.points_per_line
    hint, option = _remedy(seen, m * step)
    hint = f"{hint} if lines are longer, or split several scanners with --scanner"
    expected = f"lines of M = {m} shots that are alike"
    return Finding("line-length", Verdict.AGAINST, measured, expected, hint, option)


def _or_inf(value: float) -> float:
    return value if np.isfinite(value) else math.inf


def _period(seen: Seen) -> int | None:
    """Return the period of the ranges in the longest window, None if it is weak."""
    if not seen.windows:
        return None
    estimate = estimate_points_per_line(_longest(seen))
    return estimate.points_per_line if estimate.strength >= WEAK_PERIOD else None


def _longest(seen: Seen) -> F32:
    """Return shots of the longest window, (n,) float32 [m]."""
    rows = max(seen.windows, key=lambda window: len(window.range_m)).range_m
    return rows[: -(-PERIOD_SHOTS // rows.shape[1])].ravel()[:PERIOD_SHOTS]


def _is_as_alike(seen: Seen, period: int) -> bool:
    """Return whether shots a period apart are as alike as those M apart.

    If these are too few, whether shots are alike at all.
    """
    logs = np.log(_longest(seen))
    m = seen.points_per_line
    of_period, of_m = (likeness(logs[:-lag], logs[lag:]) for lag in (period, m))
    return of_period <= (AS_ALIKE * of_m if np.isfinite(of_m) else MOST_UNLIKE)


def _exact(seen: Seen, period: int) -> int:
    """Return the multiple or part of M near a period, else the best length near it."""
    m = seen.points_per_line
    times = round(max(m / period, period / m))
    for length in (m // times, m * times):
        if (
            abs(length - period) <= max(FOLD_REACH, period // SHIFTS)
            and max(length, m) % min(length, m) == 0
        ):
            return length
    near = range(max(period - FOLD_REACH, 2), period + FOLD_REACH + 1)
    off = {
        length: period if period <= FRAME_SHOTS else _or_inf(fold(seen.windows, length))
        for length in near
    }
    return min(near, key=lambda length: (off[length], abs(length - period)))


def check_line_order(seen: Seen, figures: Figures) -> Finding | None:
    """Check whether the scene changes along the stream, but not from line to line."""
    near, far = figures.moved
    if figures.again > SEEN_AGAIN and seen.n_lines >= STANDING_LINES and not _is_fan(seen):
        share = f"{figures.again:.0%}"
        measured = f"{share} of the shots unlike their neighbours are repeated in the next line"
        hint = "the platform stops often, or lines are copies: remove such stretches"
        return Finding("standing", Verdict.DOUBTFUL, measured, f"at most {SEEN_AGAIN:.0%}", hint)
    if seen.n_lines < LEAST_LINES or not near > 0 or not np.isfinite(far):
        return None
    ratio = far / near
    measured = f"lines far apart differ {ratio:.2g} times as much as neighbouring lines"
    expected = f"at least {MOVED_SAME:g}"
    is_standing = not near >= MOVED_NOISE * figures.roughness
    if is_standing:
        doubtful = ratio < MOVED_SAME and seen.n_lines >= STANDING_LINES
        expected = f"{expected} in {STANDING_LINES} lines or more"
        hint = "the platform does not move: remove such stretches"
        return Finding("standing", verdict_of(doubtful=doubtful), measured, expected, hint)
    hint = "sort the lines by time of scan; in dense snow or fog, accept the check"
    verdict = verdict_of(doubtful=ratio < MOVED_SAME, against=ratio < MOVED_AGAINST)
    return Finding("line-order", verdict, measured, expected, hint)


def check_dropouts(figures: Figures) -> Finding | None:
    """Check whether shots are lost where surfaces are smooth."""
    if figures.n_between < LEAST_PAIRS:
        return None
    measured = f"{figures.lonely_missing:.1%} of the shots on smooth surfaces are missing"
    hint = (
        "check whether records were lost or filtered; labels at the edges of gaps are less reliable"
    )
    verdict = verdict_of(doubtful=figures.lonely_missing > LONELY)
    return Finding("dropouts", verdict, measured, f"at most {LONELY:.1%}", hint)
