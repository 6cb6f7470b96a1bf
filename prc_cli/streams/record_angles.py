"""Judges the scan angles of the records: whether they sweep, are fine enough for columns, and turn round."""

from __future__ import annotations

import math

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.types import F64, I64
from prc_cli.formats.ranges import continues_run, mark_shots
from prc_cli.formats.records import RecordSource
from prc_cli.streams.angles import find_angle_grid, find_sweep
from prc_cli.streams.columns import begins_line, columns_by_angle, spread_columns
from prc_cli.streams.lines import LineState, lines_by_wrap
from prc_cli.streams.table import Table, take

MOST_SHARED = 0.01
"""Largest share of neighbours that angles may put into one column: from there on the check of collisions doubts."""
TURN_OFF = 0.02
"""Tolerance for whole turns."""
_LEAST_WRAPS = 4


def first_shots(source: RecordSource, names: tuple[str, ...], scanner: str | None) -> Table:
    """Return dimensions of the first shots of the first scanner, one record each."""
    has_returns = "number_of_returns" in source.dimensions
    keys = tuple(name for name in ("time", "angle", "scan_line") if name in source.dimensions)
    beside = tuple(name for name in ("return_number", "number_of_returns") if name in source.dimensions)
    wanted = (*names, *((*keys, *beside) if has_returns else ()), *((scanner,) if scanner is not None else ()))
    first = next(iter(source.chunks(tuple(dict.fromkeys(wanted)))), None)
    if first is None:
        return {name: np.empty(0) for name in names}
    values = first.values
    if scanner is not None:
        values = take(values, values[scanner] == values[scanner][:1])
    if has_returns:
        continues = continues_run(tuple(values[key] for key in keys), values["number_of_returns"])
        values = take(values, mark_shots(continues, values.get("return_number")))
    return {name: values[name] for name in names}


def has_sweeps(source: RecordSource, scanner: str | None) -> bool:
    """Whether the scan angles of the first records jump back between sweeps."""
    try:
        find_sweep(first_shots(source, ("angle",), scanner)["angle"], source.path)
    except InputError:
        return False
    return True


def lacks_shots(source: RecordSource, scanner: str | None, points_per_line: int) -> bool:
    """Whether sweeps of the scan angle hold fewer shots than a line of fixed length."""
    angle = np.asarray(first_shots(source, ("angle",), scanner)["angle"], np.float64)
    try:
        line, _, _ = lines_by_wrap(angle, find_sweep(angle, source.path), LineState())
    except InputError:
        return False
    sizes = np.bincount(line)[1:-1]
    return len(sizes) > 0 and bool(sizes.max() <= points_per_line) and bool(np.mean(sizes) < 0.99 * points_per_line)


def columns_of_angles(source: RecordSource, line_dimension: str | None, scanner: str | None) -> tuple[bool, str]:
    """Tell whether the scan angles of the records give their columns, and why or why not.

    They do where they sweep one way, and few neighbours share a step of the angle.
    """
    names = ("angle", *((line_dimension,) if line_dimension is not None else ()))
    shots = first_shots(source, names, scanner)
    angle = np.asarray(shots["angle"], np.float64)
    known = np.isfinite(angle)
    if np.count_nonzero(known) < MOST_SHARED * len(angle):
        return False, "the scan angles are not known"
    shots, angle = take(shots, known), angle[known]
    whole_turn = turns_round(source, scanner)
    try:
        sweep = find_sweep(angle, source.path)
        if line_dimension is None:
            line, _, _ = lines_by_wrap(angle, sweep, LineState())
        else:
            number = np.asarray(shots[line_dimension], np.float64)
            line = np.cumsum(np.diff(number, prepend=number[:1]) != 0)
        grid = find_angle_grid(angle, line, source.path, whole_turn=whole_turn)
    except InputError as error:
        return False, error.problem
    column: I64 = columns_by_angle(angle, grid)
    if grid.is_spread:
        column = spread_columns(column, line)
    within = ~begins_line(line)
    shared = float(np.mean(np.diff(column, prepend=0)[within] == 0))
    step = f"{abs(math.degrees(grid.step_rad)):.4g} deg"
    if shared > MOST_SHARED:
        return False, f"{shared:.0%} of neighbouring shots have the same scan angle within a step of {step}"
    return True, f"scan angles of the shots are there, in steps of {step}; shots without return are left out"


def turns_round(source: RecordSource, scanner: str | None) -> bool:
    """Whether lines are whole turns by their times, though no shot of some angles ever returns."""
    if source.facts.rule("turn") is not None:
        return True
    if not {"time", "angle"} <= set(source.dimensions):
        return False
    shots = first_shots(source, ("time", "angle"), scanner)
    turn = turn_of_times(*(np.asarray(shots[name], np.float64) for name in ("time", "angle")))
    return turn is not None and abs(turn / (2 * math.pi) - 1) <= TURN_OFF


def turn_of_times(time_s: F64, angle: F64) -> float | None:
    """Return the angle that the scanner turns in a line, also where no shot returns [rad]; None if unknown.

    Half of the shots of a turn return:

    >>> shot = np.arange(90)
    >>> turn_of_times(shot % 10 + shot // 10 * 20.0, shot % 10 * math.pi / 10) / math.pi
    2.0
    """
    use = np.isfinite(time_s) & np.isfinite(angle)
    time_s, angle = time_s[use], angle[use]
    if len(angle) < 2:
        return None
    with np.errstate(over="ignore", invalid="ignore"):  # of what no scanner measured
        dt, turned, span = np.diff(time_s), np.diff(angle), float(np.ptp(angle))
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
