"""Step two, setup: fixes how every scanner is read before its first block.

It finds the sweep, the column angles, M and down.

From the first records, or from one pass over the needed dimensions where that takes the whole
input.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.stream import Assumption
from prc_cli.core.types import F32, F64, I64
from prc_cli.core.window import Window
from prc_cli.formats.systems import looks_geographic
from prc_cli.streams.agreement import (
    ANGLES,
    CONTINUED,
    CONTRADICTED,
    MOST_OFF,
    NOT_USED,
    continued,
    contradicted_share,
    stuck_columns,
    turns_back,
)
from prc_cli.streams.angle_step import measure_step
from prc_cli.streams.angles import Sweep, column_angles, find_angle_grid, find_sweep
from prc_cli.streams.columns import (
    LINE,
    MAX_COLUMN,
    START,
    AngleGrid,
    ColumnRule,
    Table,
    columns_by_dimension,
    find_columns,
    n_rows,
    take,
)
from prc_cli.streams.down import NoDirectionError, fit_heights, shown_tilt
from prc_cli.streams.head import HEAD_RECORDS, HEAD_RECORDS_EACH, Head, first_records
from prc_cli.streams.lines import (
    MAX_CELLS_PER_RECORD,
    MIN_CELLS,
    USUAL_GAP_LINES,
    LineRules,
    ScanState,
    WholeLines,
    advance,
    nothing_placed,
    scanners_in_turns,
    whole_lines,
    whole_shots,
)
from prc_cli.streams.ranges import clean_measured
from prc_cli.streams.rules import GridRules
from prc_cli.streams.steps import ONE, Step, find_step

SLACK = 1
"""Lines by number or time stay open for one more line.

Real files have swapped pairs at the border.
"""
DOWN_LINES = 64
"""Number of lines with returns used to find straight down."""


SPARE_CELLS = 20_000_000
"""The same while lines are read, when empty lines cost no memory and a second of time at most."""
_MAX_AHEAD = 10
"""Neighbours more columns apart than this multiple of the typical step are ignored."""
_FEW_EQUAL = 0.995
"""Least share of neighbours with different times if times are finer than shots."""


@dataclass(frozen=True, slots=True)
class ShotTiming:
    """Time between shots and between columns."""

    shot_s: float = 0.0
    """Time from shot to shot [s], 0 = unknown."""
    column_s: float = 0.0
    """Time from column to column if the input has column numbers [s], 0 = unknown."""


UNKNOWN = ShotTiming()


@dataclass(frozen=True, slots=True)
class ScannerSetup:
    """How one scanner is read, fixed before the first block."""

    points_per_line: int
    lines: LineRules
    columns: ColumnRule
    angle_rad: F64 | None = None
    """(M,) float64, angle of every column [rad], None if unknown."""
    down_rad: float | None = None
    """Scan angle of straight down [rad], None if unknown."""
    cos_tilt: float = 1.0
    """Cosine of the tilt of the scan plane from the vertical."""


@dataclass(frozen=True, slots=True)
class Steps:
    """Steps of the numbers of lines and columns."""

    lines: Step = ONE
    columns: Step = ONE


@dataclass(frozen=True, slots=True)
class Estimates:
    """Estimates for a scanner, as far as its rules need them."""

    sweep: Sweep | None = None
    angle_grid: AngleGrid | None = None
    timing: ShotTiming = UNKNOWN
    steps: Steps = Steps()


@dataclass(frozen=True, slots=True)
class Setup:
    """How all scanners of an input are read."""

    scanners: dict[int, ScannerSetup]
    """By scanner."""
    default: ScannerSetup | None
    """For scanners that are not among the first records; None where all are known."""
    n_lines: int | None
    """Scan lines of all scanners; None if they were not counted."""
    assumptions: tuple[Assumption, ...]


@dataclass(frozen=True, slots=True)
class Extent:
    """Size of the image of a scanner."""

    n_lines: int = 0
    n_shots: int = 0
    n_columns: int = 0


def set_up(head: Head, rules: GridRules, end: WindowEnd | None = None) -> Setup:
    """Fix how every scanner is read, from the head; M may take a pass over the whole input."""
    m = rules.points_per_line
    if m is not None and rules.config.points_per_line is None:
        check_found_columns(rules.path, m, head.n_records)
    steps = _steps(head, rules)
    estimates, probes = probe(head, rules, steps)
    unseen = Estimates(timing=_given_timing(rules), steps=_usual_step(steps))
    assumptions = [*_step_assumptions(rules, steps), *_estimate_assumptions(rules, estimates)]
    n_known = head.n_records or 0
    n_lines = None
    if m is not None:
        sizes = dict.fromkeys(estimates, m)
    else:
        sizes = _sizes_of_turns(estimates)
        if not sizes:
            extents = _survey(head, rules, estimates, end, unseen)
            sizes = _sizes_of_images(rules, extents, estimates)
            n_lines = sum(extent.n_lines for extent in extents.values())
            n_known = max(n_known, sum(extent.n_shots for extent in extents.values()))
        assumptions.append(_size_assumption(rules, sizes, end, is_counted=n_lines is not None))
    setups = {}
    downs = head.facts.downs
    for scanner, size in sizes.items():
        if m is None:
            check_found_columns(rules.path, size, head.n_records)
        setup, scanner_assumptions = _set_up_one(
            rules, scanner, size, estimates.get(scanner, unseen), probes.get(scanner), n_known
        )
        setups[scanner] = _with_known_down(setup, downs.get(scanner))
        assumptions += scanner_assumptions
    if m is None:
        return Setup(setups, None, n_lines, tuple(assumptions))
    default, _ = _set_up_one(rules, 0, m, unseen, None, head.n_records or 0)
    for scanner, down in downs.items():
        # scanners that were not among the first records
        setups.setdefault(scanner, _with_known_down(default, down))
    return Setup(setups, default, n_lines, tuple(assumptions))


def _with_known_down(setup: ScannerSetup, down: tuple[float, float] | None) -> ScannerSetup:
    if down is None:
        return setup
    down_rad, cos_tilt = down
    return replace(setup, down_rad=down_rad, cos_tilt=cos_tilt)


def _sizes_of_turns(estimates: dict[int, Estimates]) -> dict[int, int]:
    """Return M by scanner if the lines of all scanners are whole turns, else nothing."""
    grids = {scanner: estimate.angle_grid for scanner, estimate in estimates.items()}
    sizes = {
        scanner: grid.n_columns
        for scanner, grid in grids.items()
        if grid is not None and grid.whole_turn
    }
    return sizes if len(sizes) == len(estimates) else {}


def _sizes_of_images(
    rules: GridRules, extents: dict[int, Extent], estimates: dict[int, Estimates]
) -> dict[int, int]:
    """Return M by scanner, of its turns or else of its longest line; refuse empty images."""
    sizes = {}
    for scanner in sorted(extents):
        turns = {scanner: estimates[scanner]} if scanner in estimates else {}
        size = _sizes_of_turns(turns).get(scanner)
        sizes[scanner] = size or max(extents[scanner].n_columns, 1)
    images = {
        scanner: replace(extent, n_columns=sizes[scanner]) for scanner, extent in extents.items()
    }
    check_image(rules.path, images, rules.scanner or "")
    return sizes


def _size_assumption(
    rules: GridRules, sizes: dict[int, int], end: WindowEnd | None, *, is_counted: bool
) -> Assumption:
    shown = [
        f"{size}" if rules.scanner is None else f"scanner {scanner}: {size}"
        for scanner, size in sorted(sizes.items())
    ]
    why = _size_reason(rules, end, whole_pass=is_counted)
    return Assumption("input.points_per_line", ", ".join(shown), why)


def _set_up_one(
    rules: GridRules,
    scanner: int,
    m: int,
    estimates: Estimates,
    first: WholeLines | None,
    n_known: int,
) -> tuple[ScannerSetup, list[Assumption]]:
    columns = column_rule(rules, estimates)
    lines = replace(line_rules(rules, m, estimates), spent=rules.spent, n_known=n_known)
    # fixed lines: every shot has a cell, no limit needed
    if rules.lines != "fixed":
        n_spare = SPARE_CELLS if rules.scanner is None else MIN_CELLS
        max_gap = rules.config.max_gap_lines
        # a raised limit for gaps needs some more cells
        if max_gap > USUAL_GAP_LINES:
            n_spare += max_gap * m
        lines = replace(lines, n_spare=n_spare)
    recorded = _angles(rules, m, estimates, first)
    angle, assumptions = _agreed_angles(rules, first, columns, recorded, scanner)
    if first is None or angle is None or not rules.height_names:
        return ScannerSetup(m, lines, columns, angle), assumptions
    records = first.records
    if rules.gives_angles or angle is not recorded:
        records = _with_angles(first, columns, angle)
    down_rad, cos_tilt, down_assumption = _down(rules, records, scanner)
    assumptions.append(down_assumption)
    return ScannerSetup(m, lines, columns, angle, down_rad, cos_tilt), assumptions


def most_cells(n_records: int) -> int:
    """Return the most cells of an image of this many records."""
    return MIN_CELLS + MAX_CELLS_PER_RECORD * n_records


def check_image(path: str, images: dict[int, Extent], which: str = "") -> None:
    """Refuse an image that is absurdly empty."""
    spare = {
        scanner: most_cells(image.n_shots) - image.n_lines * image.n_columns
        for scanner, image in images.items()
    }
    n_cells = sum(image.n_lines * image.n_columns for image in images.values())
    is_empty = n_cells > most_cells(sum(image.n_shots for image in images.values()))
    # name the emptiest scanner
    for scanner in sorted(images, key=lambda number: spare[number]):
        image = images[scanner]
        if is_empty or image.n_columns > MAX_COLUMN:
            where = f"{path}: {which} {scanner}" if which else path
            problem = (
                f"{image.n_lines} lines of {image.n_columns} columns for {image.n_shots} shots"
            )
            cause = "a column number is wrong"
            hint = "give the shots in a scan line: -M NUMBER"
            if image.n_lines > max(image.n_shots, image.n_columns):
                cause = "line numbers or times jump"
                hint = f"check them, or {hint}"
            raise InputError(where, f"{problem}: {cause}, expected fewer cells", hint)


def check_found_columns(path: str, points_per_line: int, n_records: int | None) -> None:
    """Refuse an M, found or recorded in the file, that is too large for the number of records."""
    most = MAX_COLUMN if n_records is None else min(MAX_COLUMN, most_cells(n_records))
    if points_per_line > most:
        count = "" if n_records is None else f" for {n_records} records"
        problem = f"lines of {points_per_line} columns{count}, expected at most {most}"
        raise InputError(path, problem, "give the shots in a scan line: -M NUMBER")


def _size_reason(rules: GridRules, end: WindowEnd | None, *, whole_pass: bool) -> str:
    if not whole_pass:
        return "steps of the scan angle in a whole turn"
    where = (
        "" if end is None else f" up to the end of {end.window.option}; -M gives that of the drive"
    )
    if rules.columns == "order":
        return f"shots of the longest line{where}"
    return f"highest column in the input{where}"


def column_rule(rules: GridRules, estimates: Estimates) -> ColumnRule:
    """Return the column rule of a scanner."""
    return ColumnRule(
        dimension=rules.column_dimension,
        grid=estimates.angle_grid,
        shot_hz=rules.shot_hz,
        line_hz=rules.line_hz,
        step=estimates.steps.columns,
    )


def _survey(
    head: Head,
    rules: GridRules,
    estimates: dict[int, Estimates],
    end: WindowEnd | None,
    unseen: Estimates,
) -> dict[int, Extent]:
    """Count lines, shots and columns of every scanner in one pass, up to the end of a window."""
    extents: dict[int, Extent] = {}
    lines = whole_lines(
        head.source,
        rules,
        lambda scanner: line_rules(rules, None, estimates.get(scanner, unseen)),
        scanners_in_turns(head, rules),
    )
    for whole in lines:
        if end is not None and extents and end.passed(whole.first_line, whole.records):
            break
        before = extents.get(whole.scanner, Extent())
        n_shots = before.n_shots
        size = before.n_columns
        records = whole.records
        if n_rows(records):
            rule = column_rule(rules, estimates.get(whole.scanner, unseen))
            line = records[LINE][records[START]]
            n_shots += len(line)
            if rules.columns == "order":
                borders = np.flatnonzero(np.diff(line, prepend=-1, append=np.iinfo(np.int64).max))
                size = max(size, int(np.diff(borders).max(initial=0)))
            else:
                column = find_columns(records, rule, whole.origin_s)
                size = max(size, int(column.max(initial=-1)) + 1)
        extents[whole.scanner] = Extent(whole.stop_line, n_shots, size)
    return extents


def _agreed_angles(
    rules: GridRules,
    first: WholeLines | None,
    rule: ColumnRule,
    angle: F64 | None,
    scanner: int,
) -> tuple[F64 | None, list[Assumption]]:
    """Return recorded angles, mended where they are cut off.

    None if x, y, z contradict them.
    """
    if first is None or angle is None or rules.gives_angles or rules.config.angles == "measured":
        return angle, []
    key = ANGLES if rules.scanner is None else f"{ANGLES} of {rules.scanner} {scanner}"
    taken: list[Assumption] = []
    is_stuck = stuck_columns(angle)
    if is_stuck.any() and rules.columns != "angle":
        shown = f"{math.degrees(float(angle[is_stuck][0])):.4g} deg"
        problem = (
            f"the scan angles of {np.count_nonzero(is_stuck)} of {len(angle)} columns are cut "
            f"off at {shown}"
        )
        mended = continued(angle, is_stuck)
        if mended is None:
            return None, [Assumption(key, NOT_USED, f"{problem}: none is used")]
        angle = mended
        taken = [Assumption(key, CONTINUED, f"{problem}: these follow from the other columns")]
    if rules.columns != "angle" and turns_back(angle):
        return None, [
            Assumption(key, NOT_USED, "the scan angles run back within the line: none is used")
        ]
    share = _contradicted(rules, first, rule, angle)
    if share is None or share <= MOST_OFF:
        return angle, taken
    problem = f"x, y, z contradict range and scan angle in {share:.0%} of the columns"
    if rules.columns != "angle":
        measured = measure_step(_image(rules, first, rule, len(angle)))
        agreed = (
            None
            if measured is None
            else _contradicted(rules, first, rule, measured.angles(len(angle)))
        )
        if agreed is not None and agreed <= MOST_OFF:
            return None, [Assumption(key, NOT_USED, f"{problem}: the recorded angles are not used")]
    return angle, [*taken, Assumption(key, CONTRADICTED, problem)]


def _contradicted(
    rules: GridRules,
    first: WholeLines,
    rule: ColumnRule,
    angle: F64,
) -> float | None:
    """Return the share of columns whose x, y, z contradict range and angle.

    None if there are none.
    """
    if not rules.point_names:
        return None
    shots = take(first.records, first.records[START])
    range_m, _, _ = clean_measured(shots, replace(rules.ranges, sensor_xyz=False))
    xyz_m = np.stack(
        [np.asarray(shots[name], np.float64) for name in rules.point_names[1:]], axis=1
    )
    if looks_geographic(xyz_m):
        return None
    column = find_columns(first.records, rule, first.origin_s)
    return contradicted_share(range_m.astype(np.float64), xyz_m, shots[LINE], column, angle)


def _image(
    rules: GridRules,
    first: WholeLines,
    rule: ColumnRule,
    size: int,
) -> F32:
    """Return the ranges of the first lines, (lines, M) float32 [m]."""
    shots = take(first.records, first.records[START])
    range_m, _, _ = clean_measured(shots, replace(rules.ranges, sensor_xyz=False))
    column = find_columns(first.records, rule, first.origin_s)
    is_cell = (column >= 0) & (column < size)
    line = shots[LINE] - first.first_line
    image = np.full((first.stop_line - first.first_line, size), np.nan, np.float32)
    image[line[is_cell], column[is_cell]] = range_m[is_cell]
    return image[np.isfinite(image).any(axis=1)]


def _with_angles(whole: WholeLines, rule: ColumnRule, angle_rad: F64) -> Table:
    records = whole.records
    column = find_columns(records, rule, whole.origin_s)
    is_cell = (column >= 0) & (column < len(angle_rad))
    of_shot = np.where(is_cell, angle_rad[np.where(is_cell, column, 0)], np.nan)
    # further returns have the angle of their shot
    return {**records, "angle": of_shot[np.cumsum(records[START]) - 1]}


def _down(rules: GridRules, records: Table, scanner: int) -> tuple[float | None, float, Assumption]:
    key = "input.nadir" if rules.scanner is None else f"input.nadir of {rules.scanner} {scanner}"
    range_m, _, _ = clean_measured(records, replace(rules.ranges, sensor_xyz=False))
    lines = np.unique(records[LINE][np.isfinite(range_m)])[:DOWN_LINES]
    first = np.isin(records[LINE], lines)
    try:
        fit = fit_heights(
            records["angle"][first], range_m[first], records["z"][first], records[LINE][first]
        )
    except NoDirectionError as error:
        return (
            None,
            1.0,
            Assumption(key, "not found", f"z is there beside range and scan angle, but {error}"),
        )
    why = (
        f"found from z, range and scan angle of {fit.n_shots} shots, "
        f"heights within {fit.off_m:.3f} m in the middle"
    )
    shown = f"{math.degrees(fit.down_rad):.2f} deg{shown_tilt(fit.cos_tilt)}"
    return fit.down_rad, fit.cos_tilt, Assumption(key, shown, why)


def _angles(
    rules: GridRules,
    size: int,
    estimates: Estimates,
    first: WholeLines | None,
) -> F64 | None:
    """Return the scan angle of every column, (M,) [rad], None if unknown."""
    if estimates.angle_grid is not None:
        return estimates.angle_grid.angles(size)
    if rules.gives_angles:
        start = rules.config.angle_start or 0.0
        step = rules.config.angle_step or 0.0
        return np.deg2rad(start + step * np.arange(size, dtype=np.float64))
    if first is None or "angle" not in first.records or rules.columns not in ("dimension", "order"):
        return None
    if rules.columns == "order" and rules.lines != "fixed":
        return None
    angle = first.records["angle"][first.records[START]]
    return column_angles(
        angle, find_columns(first.records, column_rule(rules, estimates), None), size
    )


def line_rules(rules: GridRules, points_per_line: int | None, estimates: Estimates) -> LineRules:
    """Return how the lines of a scanner are found."""
    half_s = estimates.timing.shot_s / 2
    column = rules.column_dimension
    column_s = estimates.timing.column_s
    if rules.shot_hz is not None or not column_s > 0:
        column = None
        column_s = 0.0
    shared = ("time" if rules.has("time") else None, rules.line_dimension, rules.column_dimension)
    return LineRules(
        where=f"{rules.path}: {rules.line_dimension or 'lines = ' + rules.lines}",
        path=rules.path,
        dimension=rules.line_dimension,
        line_hz=rules.line_hz,
        half_shot_s=half_s if rules.shot_hz is None else 0.5 / rules.shot_hz,
        origin_s=rules.config.time_origin,
        column_dimension=column,
        column_s=column_s,
        sweep=estimates.sweep,
        points_per_line=points_per_line,
        same_shot=tuple(name for name in shared if name is not None) if rules.has_returns else None,
        shot_hz=rules.shot_hz,
        max_gap_lines=rules.config.max_gap_lines,
        refuse_back=rules.line_dimension is not None and rules.config.order == "require",
        slack=SLACK if rules.lines in ("dimension", "time") else 0,
        step=estimates.steps.lines,
    )


def _steps(head: Head, rules: GridRules) -> dict[int, Steps]:
    line = rules.line_dimension
    column = rules.column_dimension
    if line is None and column is None:
        return {}
    names = tuple(dict.fromkeys(name for name in (line, column, rules.scanner) if name is not None))
    first = first_records(head, rules.scanner, names, HEAD_RECORDS, to_end=False)
    return {
        scanner: Steps(
            ONE if line is None else find_step(records[line]),
            ONE if column is None else _column_number_step(records[column], rules.points_per_line),
        )
        for scanner, records in first.items()
    }


def _column_number_step(number: NDArray[Any], points_per_line: int | None) -> Step:
    """Return the step of column numbers.

    If they fit into a line of the configured M, they are used as they are.
    """
    is_meant = points_per_line is not None and np.all(
        columns_by_dimension(number) < points_per_line
    )
    return ONE if is_meant else find_step(number)


def _usual_step(steps: dict[int, Steps]) -> Steps:
    """Return the steps of a scanner that the first records lack.

    These are the steps that all other scanners share.
    """
    kinds = set(steps.values())
    return kinds.pop() if len(kinds) == 1 else Steps()


RISE = "rise by"
"""How assumptions say that numbers have a step."""


def setup_notes(assumptions: tuple[Assumption, ...]) -> tuple[str, ...]:
    """Return notes on steps that are divided out, and on recorded angles that are not used."""
    return tuple(
        assumption.why
        for assumption in assumptions
        if RISE in assumption.why or assumption.value in (CONTINUED, NOT_USED)
    )


def _step_assumptions(rules: GridRules, steps: dict[int, Steps]) -> list[Assumption]:
    taken = []
    for scanner, step in steps.items():
        which = "" if rules.scanner is None else f" of scanner {scanner}"
        for key, name, number_step in (
            ("lines", "line", step.lines),
            ("columns", "column", step.columns),
        ):
            if number_step.size > 1:
                why = f"the {name} numbers{which} {RISE} {number_step.size}: they are divided by it"
                taken.append(Assumption(f"input.{key}", f"every {number_step.size} numbers", why))
    return taken


def _estimate_assumptions(rules: GridRules, estimates: dict[int, Estimates]) -> list[Assumption]:
    taken = []
    for scanner, estimate in estimates.items():
        which = "" if rules.scanner is None else f" of scanner {scanner}"
        if estimate.sweep is not None:
            way = "grows" if estimate.sweep.direction > 0 else "falls"
            shown = f"angle {way} over {math.degrees(estimate.sweep.span_rad):.2f} deg"
            taken.append(Assumption("input.lines", shown, f"found in the first records{which}"))
        grid = estimate.angle_grid
        if grid is not None and rules.config.angle_start is None:
            shown = f"{math.degrees(grid.start_rad):.4f}"
            taken.append(
                Assumption(
                    "input.angle_start", shown, f"earliest angle in the first records{which} [deg]"
                )
            )
        if grid is not None and rules.config.angle_step is None:
            shown = f"{math.degrees(grid.step_rad):.6g}"
            taken.append(
                Assumption(
                    "input.angle_step",
                    shown,
                    f"from shot to shot in the first records{which} [deg]",
                )
            )
    return taken


def _given_timing(rules: GridRules) -> ShotTiming:
    if rules.line_hz is None or rules.points_per_line is None:
        return UNKNOWN
    return ShotTiming(1 / (rules.line_hz * rules.points_per_line))


def _timing(rules: GridRules, records: Table) -> ShotTiming:
    assert rules.line_hz is not None
    m = rules.points_per_line
    name = rules.column_dimension
    records, starts, _ = whole_shots(
        records, ScanState(), line_rules(rules, m, Estimates()), final=True
    )
    shots = take(records, starts)
    time_s = np.asarray(shots["time"], np.float64)
    period_s = 1 / rules.line_hz
    given_s = _given_timing(rules).shot_s
    if name is not None:
        return ShotTiming(
            given_s, _column_step(time_s, columns_by_dimension(shots[name]), period_s) or given_s
        )
    return ShotTiming(given_s or _shot_step(time_s, period_s))


def _column_step(time_s: F64, column: I64, period_s: float) -> float:
    """Return the time from column to column, 0 if columns do not grow with time."""
    use = np.isfinite(time_s) & (column >= 0)
    step = np.diff(time_s[use])
    ahead = np.diff(column[use])
    # pairs less than a period apart with growing columns are in the same line
    near = (step >= 0) & (step < period_s)
    forward = near & (ahead > 0)
    if not forward.any() or np.count_nonzero(forward) < np.count_nonzero(near & (ahead < 0)):
        return 0.0
    forward &= ahead <= _MAX_AHEAD * np.median(ahead[forward])
    return float(step[forward].sum() / ahead[forward].sum())


def _shot_step(time_s: F64, period_s: float) -> float:
    """Return the typical time between neighbouring shots, 0 if unknown; rather an underestimate."""
    step = np.diff(time_s[np.isfinite(time_s)])
    step = step[(step >= 0) & (step < period_s)]
    ahead = step[step > 0]
    if not len(ahead):
        return 0.0
    if len(ahead) < _FEW_EQUAL * len(step):
        # shots share time stamps: use the mean
        return float(step[step < 2.5 * np.median(ahead)].mean())
    # shots may be missing between most neighbours: use the shortest fifth
    return float(np.median(ahead[ahead <= 1.5 * np.percentile(ahead, 20)]))


def probe(
    head: Head, rules: GridRules, steps: dict[int, Steps]
) -> tuple[dict[int, Estimates], dict[int, WholeLines]]:
    """Read the first records of every scanner; estimate sweep, column angles and timing."""
    m = rules.points_per_line
    has_angle = rules.has("angle")
    needs_sweep = rules.lines == "angle-wrap" or rules.columns == "angle"
    by_column = rules.columns == "dimension" or rules.lines == "fixed"
    # angles that are given need no records, but heights beside them tell where down is
    has_heights = bool(rules.height_names) and rules.gives_angles
    for_angles = rules.geometry and ((has_angle and by_column) or has_heights)
    needs_timing = rules.line_hz is not None and rules.shot_hz is None
    needs_timing = needs_timing and (m is None or rules.column_dimension is not None)
    if not needs_sweep and not for_angles and not needs_timing:
        alone = Estimates(timing=_given_timing(rules), steps=_usual_step(steps))
        return ({0: alone} if rules.scanner is None else {}), {}
    beside = (*(("angle",) if has_angle else ()), *rules.height_names, *rules.point_names)
    names = tuple(dict.fromkeys((*rules.names, *beside)))
    limit = HEAD_RECORDS if rules.scanner is None else HEAD_RECORDS_EACH
    # find every scanner where the rules depend on its angles or timing
    to_end = rules.scanner is not None and (needs_sweep or needs_timing)
    first = first_records(head, rules.scanner, names, limit, to_end=to_end)
    if not first:
        raise nothing_placed(head.path)
    estimates: dict[int, Estimates] = {}
    probes: dict[int, WholeLines] = {}
    for scanner, records in first.items():
        where = head.path if rules.scanner is None else f"{head.path}: {rules.scanner} {scanner}"
        sweep = find_sweep(records["angle"], where) if rules.lines == "angle-wrap" else None
        timing = _timing(rules, records) if needs_timing else _given_timing(rules)
        estimate = Estimates(sweep, None, timing, steps.get(scanner) or _usual_step(steps))
        if needs_sweep or for_angles:
            # lines that go back are refused while reading, not here
            lenient = replace(line_rules(rules, m, estimate), refuse_back=False)
            whole, _ = advance(scanner, records, ScanState(), lenient, final=True)
            if whole is not None:
                probes[scanner] = whole
                estimate = _with_grid(rules, estimate, whole, where)
        estimates[scanner] = estimate
    return estimates, probes


def _with_grid(
    rules: GridRules,
    estimate: Estimates,
    whole: WholeLines,
    where: str,
) -> Estimates:
    if rules.columns != "angle":
        return estimate
    shots = take(whole.records, whole.records[START])
    start = rules.config.angle_start
    step = rules.config.angle_step
    grid = find_angle_grid(
        shots["angle"],
        shots[LINE],
        where,
        start_rad=None if start is None else math.radians(start),
        step_rad=None if step is None else math.radians(step),
        whole_turn=rules.whole_turn,
    )
    timing = estimate.timing
    if rules.line_hz is not None and rules.points_per_line is None:
        # where shots are missing, columns give the distance between them better
        timing = replace(timing, shot_s=min(timing.shot_s, 1 / (rules.line_hz * grid.n_columns)))
    return replace(estimate, angle_grid=grid, timing=timing)


@dataclass(slots=True)
class WindowEnd:
    """The end of a window, for records of one scanner in the order of the lines."""

    window: Window
    line_hz: float | None
    _origin_s: float | None = None

    def passed(self, first_line: int, records: Table) -> bool:
        """Whether these whole lines lie behind the window."""
        if self.window.in_lines:
            return first_line >= self.window.stop
        if not n_rows(records):
            return False
        if "time" not in records:
            return self.line_hz is not None and first_line / self.line_hz >= self.window.stop
        time_s = np.asarray(records["time"], np.float64)
        known = time_s[np.isfinite(time_s)]
        if not len(known):
            return False
        if self._origin_s is None:
            self._origin_s = float(known[0])
        return bool(known[0] >= self.window.bounds(self._origin_s)[1])
