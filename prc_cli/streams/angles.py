"""Judges scan angles: whether they sweep, are fine enough for columns and turn round.

Gives the columns and their angles.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.types import F64, I64, Mask
from prc_cli.streams.columns import (
    MAX_COLUMN,
    AngleGrid,
    Table,
    begins_line,
    columns_by_angle,
    spread_columns,
    take,
)

FULL_TURN = 0.9
"""Lines that span at least this share of a turn count as whole turns."""
MAX_EQUAL = 0.5
"""Largest share of neighbouring shots with equal angles.

Beyond it, angles are too coarse for columns.
"""
MAX_ROUNDED = 0.005
"""Angles count as coarsely rounded from this share of neighbouring shots with equal angles on."""
MIN_AGREEMENT = 0.75
"""Least share of steps of the scan angle in one direction."""
SEAM_RAD = math.radians(10.0)
"""Larger steps beyond the usual one are dead angles within the line."""
_SHARE_OF_COLUMN = 0.05
_TURN = 2 * math.pi
LEAST_TURN_COLUMNS = 180
"""Columns of a line of a quarter turn or more.

Rings of a spinning scanner, which may lie as close, are fewer.
"""
MOST_SHARED = 0.01
"""Largest share of neighbours that angles may put into one column.

From there on the check of collisions gives a warning.
"""
TURN_OFF = 0.02
"""Tolerance for whole turns."""
_LEAST_WRAPS = 4


def are_radians(angle_rad: F64) -> bool:
    """Return whether a half or whole turn has the numbers of radians.

    >>> are_radians(np.deg2rad(np.linspace(0, 4.7, 1080))), are_radians(np.linspace(0, 4.7, 1080))
    (True, False)
    """
    return (
        len(angle_rad) >= LEAST_TURN_COLUMNS
        and math.pi / 2 < math.degrees(float(np.ptp(angle_rad))) <= 2 * math.pi
    )


@dataclass(frozen=True, slots=True)
class Sweep:
    """How the scan angle runs within a line."""

    direction: int
    """+1 = the angle grows from shot to shot, -1 = it falls."""
    span_rad: float
    """Angle between the ends of the longest lines [rad]."""
    noise_rad: float
    """Tolerance for steps back within a line [rad]."""


def find_sweep(angle: NDArray[Any], where: str) -> Sweep:
    """Find direction and span of the sweep from the first shots."""
    value = np.asarray(angle, np.float64)
    value = value[np.isfinite(value)]
    hint = "find lines another way: --lines dimension:NAME, fixed or time:HZ"
    low, high = np.percentile(value, (0.1, 99.9)) if len(value) else (0.0, 0.0)
    span = float(high - low)
    if not span > 0:
        raise InputError(
            where, f"the scan angle does not vary in {len(value)} shots, expected sweeps", hint
        )
    step = np.diff(value)
    step = step[np.abs(step) <= 0.5 * span]
    n_up = int(np.count_nonzero(step > 0))
    n_down = int(np.count_nonzero(step < 0))
    share = max(n_up, n_down) / max(n_up + n_down, 1)
    if share < MIN_AGREEMENT:
        problem = (
            f"the scan angle grows in {n_up} steps and falls in {n_down}, "
            "expected sweeps of one direction"
        )
        raise InputError(where, problem, hint)
    # angles are rounded: small steps back are not a wrap
    noise = max(
        2 * float(np.median(np.abs(step[step != 0]))) if n_up + n_down else 0.0, 0.01 * span
    )
    return Sweep(1 if n_up >= n_down else -1, span, noise)


@dataclass(frozen=True, slots=True)
class WrapState:
    """State of the sweeps of a scanner across chunks."""

    wraps: int = 0
    """Wraps so far."""
    last_angle: float = math.nan
    """Last known angle [rad]."""
    low: float = math.inf
    """Least angle of the line so far [rad]."""
    high: float = -math.inf
    """Greatest angle of the line so far [rad]."""
    last_span: float = 0.0
    """Span of the line before [rad]."""


def lines_by_wrap(angle: NDArray[Any], sweep: Sweep, state: WrapState) -> tuple[I64, WrapState]:
    """Start a line if the angle jumps back by half the span of this or the last line."""
    value = np.asarray(angle, np.float64)
    position = np.flatnonzero(np.isfinite(value))
    begins = np.zeros(len(value), np.int64)
    if len(position):
        seen = value[position]
        back = sweep.direction * (np.concatenate(([state.last_angle], seen[:-1])) - seen)
        # jumps larger than noise are few: check one by one whether a line ends
        jumps = np.flatnonzero(back > sweep.noise_rad)
        borders = np.concatenate(([0], jumps[jumps > 0]))
        lows = np.minimum.reduceat(seen, borders)
        highs = np.maximum.reduceat(seen, borders)
        pieces = iter(zip(lows.tolist(), highs.tolist(), strict=True))
        low = state.low
        high = state.high
        last_span = state.last_span
        if not len(jumps) or jumps[0] > 0:
            first_low, first_high = next(pieces)
            low = min(low, first_low)
            high = max(high, first_high)
        for jump, size, (piece_low, piece_high) in zip(
            jumps.tolist(), back[jumps].tolist(), pieces, strict=True
        ):
            if size > 0.5 * max(high - low, last_span):
                begins[position[jump]] = 1
                low, high, last_span = piece_low, piece_high, high - low
            else:
                low = min(low, piece_low)
                high = max(high, piece_high)
        state = replace(state, last_angle=float(seen[-1]), low=low, high=high, last_span=last_span)
    line = state.wraps + np.cumsum(begins)
    if len(line):
        state = replace(state, wraps=int(line[-1]))
    return line, state


def find_angle_grid(
    angle: NDArray[Any],
    line: I64,
    where: str,
    *,
    start_rad: float | None = None,
    step_rad: float | None = None,
    whole_turn: bool = False,
) -> AngleGrid:
    """Estimate columns from the first angles.

    The step is refined over distances, so that it fits whole lines.
    """
    finite = np.isfinite(angle)
    value = np.asarray(angle, np.float64)[finite]
    line = line[finite]
    within = ~begins_line(line)
    if not within.any():
        raise InputError(
            where, f"{len(value)} scan angles, too few to tell columns", "--columns order"
        )
    turn = np.diff(value, prepend=value[0])
    turn = turn - _TURN * np.rint(turn / _TURN)
    sign = math.copysign(
        1.0, step_rad if step_rad is not None else float(np.sum(np.sign(turn[within])))
    )
    forward = np.where(within, sign * turn, 0.0)
    # more than half a turn without return: still a step forward
    forward = np.where(forward < -0.5 * math.pi, forward + _TURN, forward)
    if step_rad is None:
        equal = float(np.mean(forward[within] == 0))
        if equal > MAX_EQUAL:
            problem = (
                f"{100 * equal:.0f} % of neighbouring shots have equal scan angles: "
                "rounded too coarsely"
            )
            raise InputError(
                where, problem, "take the order, --columns order, or the time, --columns time:HZ"
            )
        step = _refine_step(np.cumsum(forward), line, forward[within & (forward >= 0)])
    else:
        step = abs(step_rad)
    if not _TURN / MAX_COLUMN <= step < math.inf:
        problem = f"neighbouring shots are {math.degrees(step):.3g} degrees apart"
        expected = f"expected at most {MAX_COLUMN} columns in a turn"
        raise InputError(
            where,
            f"{problem}, {expected}",
            "take the order, --columns order, or give input.angle_step",
        )
    keep_step = step_rad is not None
    return _grid(
        value, line, forward, sign * step, start_rad, keep_step=keep_step, whole_turn=whole_turn
    )


def _refine_step(along: F64, line: I64, forward: F64) -> float:
    ahead = forward[forward > 0]
    if len(ahead) < (1 - MAX_ROUNDED) * len(forward):
        # rounded more coarsely than the step: differences are 0, 1 or 2 times the rounding, use
        # their mean
        step = float(np.mean(forward[forward < 2.5 * np.median(ahead)]))
    else:
        # shots may be missing between most neighbours: use the shortest fifth
        step = float(np.median(ahead[ahead < 1.5 * np.percentile(ahead, 20)]))
    lag = 1
    while lag < len(along):
        same = line[lag:] == line[:-lag]
        distance = (along[lag:] - along[:-lag])[same]
        n_steps = np.rint(distance / step)
        # beyond this, the number of steps is uncertain
        use = (n_steps >= 1) & (np.abs(distance / step - n_steps) < 0.25) & (n_steps <= 4 * lag)
        if use.any():
            step = float((distance[use] * n_steps[use]).sum() / (n_steps[use] ** 2).sum())
        lag *= 2
    return step


def _grid(
    value: F64,
    line: I64,
    forward: F64,
    step: float,
    start_rad: float | None,
    *,
    keep_step: bool,
    whole_turn: bool = False,
) -> AngleGrid:
    """Place column 0 and decide whether lines are whole turns."""
    begins = begins_line(line)
    first = np.flatnonzero(begins)
    along = np.cumsum(forward)
    reach = np.maximum.reduceat(along, first) - along[first]
    size = abs(step)
    sign = math.copysign(1.0, step)
    whole = whole_turn or float(np.max(reach)) + size >= FULL_TURN * _TURN
    if whole and not keep_step:
        # where it is known that lines are turns: a column for every shot, though the turn holds no
        # whole number
        n_columns = (
            math.ceil(_TURN / size - _SHARE_OF_COLUMN) if whole_turn else round(_TURN / size)
        )
        step = sign * _TURN / n_columns
        size = abs(step)
    if start_rad is None:
        # the earliest first shot of a line (the first line of the input may be cut), then fitted to
        # all angles
        early = value[first[1:] if len(first) > 2 else first]
        middle = _circular_mean(early)
        away = sign * (early - middle)
        away -= _TURN * np.rint(away / _TURN)
        start_rad = middle + sign * float(away.min())
        steps = sign * (value - start_rad) / size
        start_rad += sign * size * _circular_mean(steps * _TURN) / _TURN
    grid = AngleGrid(start_rad, step, round(_TURN / size), whole_turn=True, is_spread=whole_turn)
    if whole:
        return grid
    column = columns_by_angle(value[begins], grid)
    column = np.where(column > grid.n_columns / 2, column - grid.n_columns, column)
    n_columns = int(np.max(column + np.rint(reach / size).astype(np.int64))) + 1
    return replace(grid, n_columns=max(n_columns, 1), whole_turn=False)


def column_angles(angle: NDArray[Any], column: I64, points_per_line: int) -> F64 | None:
    """Mean scan angle of every column, from the first shots; columns not seen are interpolated."""
    value = np.asarray(angle, np.float64)
    use: Mask = np.isfinite(value) & (column >= 0) & (column < points_per_line)
    where = column[use]
    count = np.bincount(where, minlength=points_per_line)
    seen = np.flatnonzero(count)
    if len(seen) < 2 or 2 * len(seen) < points_per_line:
        return None
    cosine = np.bincount(where, np.cos(value[use]), points_per_line)[seen]
    sine = np.bincount(where, np.sin(value[use]), points_per_line)[seen]
    mean = np.unwrap(np.arctan2(sine, cosine))
    slope = float(np.median(np.diff(mean) / np.diff(seen)))
    spread = np.sqrt(np.maximum(1.0 - np.hypot(cosine, sine) / count[seen], 0.0) * 2)
    if float(np.median(spread)) > max(abs(slope), 1e-6):
        return None
    angles = np.interp(np.arange(points_per_line), seen, mean)
    for gap in np.flatnonzero(np.abs(np.diff(mean) - slope * np.diff(seen)) > SEAM_RAD):
        # columns not seen beside a dead angle continue the nearer side
        left = int(seen[gap])
        right = int(seen[gap + 1])
        middle = (left + right + 1) // 2
        angles[left:middle] = mean[gap] + slope * np.arange(middle - left)
        angles[middle:right] = mean[gap + 1] - slope * np.arange(right - middle, 0, -1)
    after = np.arange(seen[-1] + 1, points_per_line)
    before = np.arange(seen[0])
    angles[after] = mean[-1] + slope * (after - seen[-1])
    angles[before] = mean[0] + slope * (before - seen[0])
    return angles


def _circular_mean(value: F64) -> float:
    return math.atan2(float(np.sin(value).mean()), float(np.cos(value).mean()))


def has_sweeps(shots: Table, path: str) -> bool:
    """Whether the scan angles of the first shots jump back between sweeps."""
    try:
        find_sweep(shots["angle"], path)
    except InputError:
        return False
    return True


def lacks_shots(shots: Table, path: str, points_per_line: int) -> bool:
    """Whether sweeps of the scan angle have fewer shots than a line of fixed length."""
    angle = np.asarray(shots["angle"], np.float64)
    try:
        line, _ = lines_by_wrap(angle, find_sweep(angle, path), WrapState())
    except InputError:
        return False
    sizes = np.bincount(line)[1:-1]
    return (
        len(sizes) > 0
        and bool(sizes.max() <= points_per_line)
        and bool(np.mean(sizes) < 0.99 * points_per_line)
    )


def columns_of_angles(
    shots: Table,
    line_dimension: str | None,
    path: str,
    *,
    whole_turn: bool,
) -> tuple[bool, str]:
    """Return whether scan angles give columns, and why.

    They sweep one way, and few neighbours share a step.
    """
    angle = np.asarray(shots["angle"], np.float64)
    known = np.isfinite(angle)
    if np.count_nonzero(known) < MOST_SHARED * len(angle):
        return False, "the scan angles are not known"
    shots = take(shots, known)
    angle = angle[known]
    try:
        sweep = find_sweep(angle, path)
        if line_dimension is None:
            line, _ = lines_by_wrap(angle, sweep, WrapState())
        else:
            number = np.asarray(shots[line_dimension], np.float64)
            line = np.cumsum(np.diff(number, prepend=number[:1]) != 0)
        grid = find_angle_grid(angle, line, path, whole_turn=whole_turn)
    except InputError as error:
        return False, error.problem
    column: I64 = columns_by_angle(angle, grid)
    if grid.is_spread:
        column = spread_columns(column, line)
    within = ~begins_line(line)
    shared = float(np.mean(np.diff(column, prepend=0)[within] == 0))
    step = f"{abs(math.degrees(grid.step_rad)):.4g} deg"
    if shared > MOST_SHARED:
        return (
            False,
            f"{shared:.0%} of neighbouring shots have the same scan angle within a step of {step}",
        )
    return (
        True,
        (
            f"scan angles of the shots are there, in steps of {step}; "
            "shots without return are left out"
        ),
    )


def turns_round(shots: Table) -> bool:
    """Whether lines are whole turns by their times, though no shot of some angles ever returns."""
    if not {"time", "angle"} <= set(shots):
        return False
    turn = turn_of_times(*(np.asarray(shots[name], np.float64) for name in ("time", "angle")))
    return turn is not None and abs(turn / (2 * math.pi) - 1) <= TURN_OFF


def turn_of_times(time_s: F64, angle: F64) -> float | None:
    """Return the angle that the scanner turns in a line, also if no shot returns [rad].

    None if unknown.

    Half of the shots of a turn return:

    >>> shot = np.arange(90)
    >>> turn_of_times(shot % 10 + shot // 10 * 20.0, shot % 10 * math.pi / 10) / math.pi
    2.0
    """
    use = np.isfinite(time_s) & np.isfinite(angle)
    time_s = time_s[use]
    angle = angle[use]
    if len(angle) < 2:
        return None
    with np.errstate(over="ignore", invalid="ignore"):  # of what no scanner measured
        dt = np.diff(time_s)
        turned = np.diff(angle)
        span = float(np.ptp(angle))
        ahead = (dt > 0) & (np.abs(turned) < 0.12 * span)
        wraps = np.flatnonzero(np.abs(turned) > 0.5 * span)
        if len(wraps) < _LEAST_WRAPS or not ahead.any():
            return None
        rate = float(np.median(turned[ahead] / dt[ahead]))
        if not rate or not math.isfinite(rate):
            return None
        # from an angle in one line to the same angle in the next
        start = time_s[wraps + 1] - angle[wraps + 1] / rate
        turn = abs(rate * float(np.median(np.diff(start))))
    return turn if math.isfinite(turn) else None
