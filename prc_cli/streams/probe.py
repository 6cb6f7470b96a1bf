"""Estimates sweep, angular columns and shot timing from the first records of every scanner."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from prc_cli.core.stream import Assumption
from prc_cli.formats.records import RecordSource
from prc_cli.streams.angles import Sweep, find_angle_grid, find_sweep
from prc_cli.streams.columns import AngleGrid, columns_by_dimension
from prc_cli.streams.lines import (
    UNKNOWN,
    FixedLines,
    LineRule,
    NumberedLines,
    ShotTiming,
    SweptLines,
    TimedLines,
    find_timing,
)
from prc_cli.streams.reading import first_records, nothing_placed
from prc_cli.streams.rules import GridRules
from prc_cli.streams.table import LINE, START, Table, take
from prc_cli.streams.whole_lines import Admission, CellLimit, LineRules, ScanState, WholeLines, advance, whole_shots

PROBE_RECORDS = 1 << 18
"""Number of first records used for estimates."""
PROBE_RECORDS_EACH = 1 << 16
"""The same per scanner where several share the input."""
SLACK = 1
"""Lines by number or time stay open for one more line: real files have swapped pairs at the border."""


@dataclass(frozen=True, slots=True)
class Estimates:
    """Estimates for a scanner, as far as its rules need them."""

    sweep: Sweep | None = None
    angle_grid: AngleGrid | None = None
    timing: ShotTiming = UNKNOWN


def line_rules(
    rules: GridRules,
    points_per_line: int | None,
    found: Estimates,
    *,
    cells: CellLimit | None = None,
    spent: tuple[str, ...] = (),
    judges_order: bool = True,
) -> LineRules:
    """Return the parameters of a scanner's lines."""
    is_numbered = rules.line_dimension is not None
    admission = Admission(
        where=f"{rules.path}: {rules.line_dimension or 'lines = ' + rules.lines}",
        max_gap_lines=rules.max_gap_lines,
        refuse_back=is_numbered and judges_order and rules.order == "require",
        slack=SLACK if rules.lines in ("dimension", "time") else 0,
        begins_with_first=rules.time_origin_s is None or is_numbered,
        cells=cells,
    )
    shared = ("time" if rules.has_time else None, rules.line_dimension, rules.column_dimension)
    return LineRules(
        path=rules.path,
        line=_line_rule(rules, points_per_line, found),
        admission=admission,
        same_shot=tuple(name for name in shared if name is not None) if rules.has_returns else None,
        shot_hz=rules.shot_hz,
        points_per_line=points_per_line,
        spent=spent,
    )


def _line_rule(rules: GridRules, points_per_line: int | None, found: Estimates) -> LineRule:
    if rules.line_dimension is not None:
        return NumberedLines(rules.line_dimension, rules.path)
    if rules.line_hz is None:
        return SweptLines(found.sweep) if found.sweep is not None else FixedLines(points_per_line or 1)
    if rules.shot_hz is not None:
        return TimedLines(rules.line_hz, 0.5 / rules.shot_hz, rules.time_origin_s)
    half_s, column_s = found.timing.shot_s / 2, found.timing.column_s
    column = rules.column_dimension if column_s > 0 else None
    return TimedLines(rules.line_hz, half_s, rules.time_origin_s, column, column_s)


def estimate_assumptions(rules: GridRules, estimates: dict[int, Estimates]) -> list[Assumption]:
    """Report the estimates from angles."""
    taken = []
    for scanner, found in estimates.items():
        which = "" if rules.scanner is None else f" of scanner {scanner}"
        if found.sweep is not None:
            way = "grows" if found.sweep.direction > 0 else "falls"
            shown = f"angle {way} over {math.degrees(found.sweep.span_rad):.2f} deg"
            taken.append(Assumption("input.lines", shown, f"found in the first records{which}"))
        grid = found.angle_grid
        if grid is not None and rules.angle_start_deg is None:
            shown = f"{math.degrees(grid.start_rad):.4f}"
            taken.append(Assumption("input.angle_start", shown, f"earliest angle in the first records{which} [deg]"))
        if grid is not None and rules.angle_step_deg is None:
            shown = f"{math.degrees(grid.step_rad):.6g}"
            taken.append(Assumption("input.angle_step", shown, f"from shot to shot in the first records{which} [deg]"))
    return taken


def _needs_probe(rules: GridRules) -> bool:
    """Whether the rules need the first records (column angles are optional)."""
    return rules.lines == "angle-wrap" or rules.columns == "angle"


def given_timing(rules: GridRules, points_per_line: int | None) -> ShotTiming:
    """Return the timing as far as known without reading."""
    if rules.line_hz is None or points_per_line is None:
        return UNKNOWN
    return ShotTiming(1 / (rules.line_hz * points_per_line))


def _needs_timing(rules: GridRules, points_per_line: int | None) -> bool:
    """Whether shot timing must be estimated from the first records."""
    if rules.line_hz is None or rules.shot_hz is not None:
        return False
    return points_per_line is None or rules.column_dimension is not None


def _timing(rules: GridRules, records: Table, points_per_line: int | None) -> ShotTiming:
    """Estimate shot timing from the first records of a scanner."""
    if rules.line_hz is None or not _needs_timing(rules, points_per_line):
        return given_timing(rules, points_per_line)
    every = line_rules(rules, points_per_line, Estimates())
    records, starts, _ = whole_shots(records, ScanState(), every, final=True)
    shots = take(records, starts)
    name = rules.column_dimension
    column = None if name is None else columns_by_dimension(shots[name])
    return find_timing(np.asarray(shots["time"], np.float64), column, rules.line_hz, points_per_line)


def probe(
    source: RecordSource, rules: GridRules, points_per_line: int | None, *, geometry: bool
) -> tuple[dict[int, Estimates], dict[int, WholeLines]]:
    """Read the first records of every scanner; estimate sweep, column angles and timing."""
    by_column = rules.columns == "dimension" or rules.lines == "fixed"
    # angles that are given need no records, but heights beside them tell where down is
    has_heights = bool(rules.height_names) and rules.gives_angles
    for_angles = geometry and ((rules.has_angle and by_column) or has_heights)
    needs_timing = _needs_timing(rules, points_per_line)
    if not _needs_probe(rules) and not for_angles and not needs_timing:
        return ({0: Estimates(timing=given_timing(rules, points_per_line))} if rules.scanner is None else {}), {}
    beside = (*(("angle",) if rules.has_angle else ()), *(rules.height_names if geometry else ()))
    names = tuple(dict.fromkeys((*rules.names, *beside)))
    limit = PROBE_RECORDS if rules.scanner is None else PROBE_RECORDS_EACH
    # find every scanner where the rules depend on its angles or timing
    to_end = rules.scanner is not None and (_needs_probe(rules) or needs_timing)
    first = first_records(source, rules.scanner, names, limit, to_end=to_end)
    if not first:
        raise nothing_placed(source.path)
    estimates: dict[int, Estimates] = {}
    probes: dict[int, WholeLines] = {}
    for scanner, records in first.items():
        where = source.path if rules.scanner is None else f"{source.path}: {rules.scanner} {scanner}"
        sweep = find_sweep(records["angle"], where) if rules.lines == "angle-wrap" else None
        timing = _timing(rules, records, points_per_line)
        if not _needs_probe(rules) and not for_angles:
            estimates[scanner] = Estimates(timing=timing)
            continue
        # lines that go back are refused while reading, not here
        lenient = line_rules(rules, points_per_line, Estimates(sweep, None, timing), judges_order=False)
        whole, _ = advance(scanner, records, ScanState(), lenient, final=True)
        grid = None
        if rules.columns == "angle" and whole is not None:
            grid = _angle_grid(rules, take(whole.records, whole.records[START]), where)
            if rules.line_hz is not None and points_per_line is None:
                # where shots are missing, columns give the distance between them better
                timing = replace(timing, shot_s=min(timing.shot_s, 1 / (rules.line_hz * grid.n_columns)))
        estimates[scanner] = Estimates(sweep, grid, timing)
        if whole is not None:
            probes[scanner] = whole
    return estimates, probes


def _angle_grid(rules: GridRules, shots: Table, where: str) -> AngleGrid:
    start, step = rules.angle_start_deg, rules.angle_step_deg
    return find_angle_grid(
        shots["angle"],
        shots[LINE],
        where,
        start_rad=None if start is None else math.radians(start),
        step_rad=None if step is None else math.radians(step),
        whole_turn=rules.whole_turn,
    )
