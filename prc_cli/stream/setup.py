"""What must be known of every scanner before its first block: sweep, column angles, M.

Found in the first records, and in one pass over the few dimensions needed where only the whole input can tell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from prc_cli.core.stream import Assumption, ReadTally
from prc_cli.core.types import F64, I64
from prc_cli.formats.options import InputConfig
from prc_cli.formats.ranges import clean_ranges
from prc_cli.formats.records import RecordSource
from prc_cli.stream import columns as column_rules
from prc_cli.stream.column_angles import (
    AngleGrid,
    column_angles,
    columns_by_angle,
    find_angle_grid,
)
from prc_cli.stream.down import NoDirectionError, fit_heights, shown_lean
from prc_cli.stream.limits import check_found_columns, check_image
from prc_cli.stream.lines import Sweep, find_sweep
from prc_cli.stream.reading import first_records, nothing_placed, whole_lines
from prc_cli.stream.rules import GridRules
from prc_cli.stream.shot_timing import UNKNOWN, Beat, find_beat
from prc_cli.stream.whole_lines import (
    LINE,
    ORDINAL,
    SPREAD,
    START,
    LineRules,
    ScanState,
    Table,
    WholeLines,
    advance,
    n_rows,
    take,
    whole_shots,
)

PROBE_RECORDS = 1 << 18
"""Records at the start that sweep and angles are estimated from."""
PROBE_RECORDS_EACH = 1 << 16
"""The same for every scanner where several share the input."""
NADIR_LINES = 64
"""Lines with returns that the direction of down is found in."""


@dataclass(frozen=True, slots=True)
class ScannerSetup:
    """What one scanner's cells depend on; fixed before the first block."""

    points_per_line: int
    sweep: Sweep | None
    angle_grid: AngleGrid | None
    angle_rad: F64 | None
    """(M,) float64, angle of every column [rad], None if unknown."""
    nadir_rad: float | None = None
    """Scan angle that points straight down [rad], None if unknown."""
    fall: float = 1.0
    """Metres that the height falls a metre of range there: the cosine of the lean of the scan plane."""
    beat: Beat = UNKNOWN
    n_shots: int = 0
    """Shots of the whole input, if it was read."""


@dataclass(frozen=True, slots=True)
class _Estimates:
    sweep: Sweep | None = None
    angle_grid: AngleGrid | None = None
    beat: Beat = UNKNOWN


@dataclass(frozen=True, slots=True)
class _Extent:
    """Size of one scanner's image."""

    n_lines: int = 0
    n_shots: int = 0
    longest: int = 0
    """Shots of the longest line."""
    max_column: int = -1


def find_setups(
    source: RecordSource, rules: GridRules, points_per_line: int | None, *, geometry: bool = True
) -> tuple[dict[int, ScannerSetup], int | None, tuple[Assumption, ...]]:
    """Estimate what the rules need, scanner by scanner.

    Parameters
    ----------
    source : RecordSource
    rules : GridRules
    points_per_line : int or None
        M where it is known already.
    geometry : bool
        Find the angles of the columns, and where down is, where lines and columns do not need them.

    Returns
    -------
    setups : dict of ScannerSetup by scanner
        Empty where the scanners of the input are not known and need not be.
    n_lines : int or None
        Lines of all scanners, if the whole input was read.
    assumptions : tuple of Assumption

    Raises
    ------
    InputError
        When the angles do not tell, or the image would be absurdly empty.
    """
    if points_per_line is not None and rules.config.points_per_line is None:
        check_found_columns(rules.path, points_per_line, source.n_records)
    estimates, probes = _probe(source, rules, points_per_line, geometry=geometry)
    n_lines: int | None = None
    extents: dict[int, _Extent] = {}
    sizes: dict[int, int | None] = dict.fromkeys(estimates, points_per_line)
    taken = _estimate_assumptions(rules, estimates)
    if points_per_line is None:
        for scanner, found in estimates.items():
            grid = found.angle_grid
            sizes[scanner] = grid.n_columns if grid is not None and grid.whole_turn else None
        if None in sizes.values() or not sizes:
            extents = _survey(source, rules, estimates)
            n_lines = sum(extent.n_lines for extent in extents.values())
            sizes = {scanner: sizes.get(scanner) or _size(rules, extents[scanner]) for scanner in sorted(extents)}
            images = {one: (extent.n_lines, sizes[one] or 1, extent.n_shots) for one, extent in extents.items()}
            check_image(rules.path, images, rules.scanner or "")
        shown = _shown_sizes(rules, sizes)
        taken.append(Assumption("input.points_per_line", shown, _size_reason(rules, whole_pass=n_lines is not None)))
    setups = {}
    for scanner, size in sizes.items():
        if size is None:
            continue
        if points_per_line is None:
            check_found_columns(rules.path, size, source.n_records)
        found = estimates.get(scanner, _Estimates())
        angle = _angles(rules, size, found, probes.get(scanner))
        nadir_rad, fall = None, 1.0
        if geometry and angle is not None and rules.height_names and scanner in probes:
            nadir_rad, fall, assumption = _nadir(rules, probes[scanner], scanner)
            taken.append(assumption)
        n_shots = extents[scanner].n_shots if scanner in extents else 0
        setups[scanner] = ScannerSetup(size, found.sweep, found.angle_grid, angle, nadir_rad, fall, found.beat, n_shots)
    return setups, n_lines, tuple(taken)


def _size(rules: GridRules, extent: _Extent) -> int:
    size = extent.longest if rules.columns == "order" else extent.max_column + 1
    return max(size, 1)


def _shown_sizes(rules: GridRules, sizes: dict[int, int | None]) -> str:
    """Return M for people, scanner by scanner where there are several."""
    if rules.scanner is None:
        return ", ".join(str(size) for size in sizes.values())
    return ", ".join(f"scanner {scanner}: {sizes[scanner]}" for scanner in sorted(sizes))


def _size_reason(rules: GridRules, *, whole_pass: bool) -> str:
    if not whole_pass:
        return "steps of the scan angle in a whole turn"
    return "shots of the longest line" if rules.columns == "order" else "highest column in the input"


def _estimate_assumptions(rules: GridRules, estimates: dict[int, _Estimates]) -> list[Assumption]:
    """Report what was estimated from the angles."""
    taken = []
    for scanner, found in estimates.items():
        which = "" if rules.scanner is None else f" of scanner {scanner}"
        if found.sweep is not None:
            way = "grows" if found.sweep.direction > 0 else "falls"
            shown = f"angle {way} over {math.degrees(found.sweep.span_rad):.2f} deg"
            taken.append(Assumption("input.lines", shown, f"found in the first records{which}"))
        grid = found.angle_grid
        if grid is not None and rules.config.angle_start is None:
            shown = f"{math.degrees(grid.start_rad):.4f}"
            taken.append(Assumption("input.angle_start", shown, f"earliest angle in the first records{which} [deg]"))
        if grid is not None and rules.config.angle_step is None:
            shown = f"{math.degrees(grid.step_rad):.6g}"
            taken.append(Assumption("input.angle_step", shown, f"from shot to shot in the first records{which} [deg]"))
    return taken


def _needs_probe(rules: GridRules) -> bool:
    """Whether the rules cannot work without the first records (column angles are a gift where there are some)."""
    return rules.lines == "angle-wrap" or rules.columns == "angle"


def given_angles(config: InputConfig, points_per_line: int) -> F64 | None:
    """Return the scan angle of every column as the configuration says it, (M,) float64 [rad]."""
    if config.angle_start is None or config.angle_step is None:
        return None
    return np.deg2rad(config.angle_start + config.angle_step * np.arange(points_per_line, dtype=np.float64))


def given_beat(rules: GridRules, points_per_line: int | None) -> Beat:
    """Return the beat as far as nothing needs to be read for it."""
    if rules.line_hz is None or points_per_line is None:
        return UNKNOWN
    return Beat(1 / (rules.line_hz * points_per_line))


def _needs_beat(rules: GridRules, points_per_line: int | None) -> bool:
    """Whether only the first records tell where in its line a shot is."""
    if rules.line_hz is None or rules.shot_hz is not None:
        return False
    return points_per_line is None or rules.column_dimension is not None


def _beat(rules: GridRules, records: Table, points_per_line: int | None) -> Beat:
    """Find the beat of the first records of a scanner."""
    if rules.line_hz is None or not _needs_beat(rules, points_per_line):
        return given_beat(rules, points_per_line)
    records, starts, _ = whole_shots(records, ScanState(), LineRules(rules, points_per_line, None), final=True)
    shots = take(records, starts)
    name = rules.column_dimension
    column = None if name is None else column_rules.columns_by_dimension(shots[name])
    return find_beat(np.asarray(shots["time"], np.float64), column, rules.line_hz, points_per_line)


def _probe(
    source: RecordSource, rules: GridRules, points_per_line: int | None, *, geometry: bool
) -> tuple[dict[int, _Estimates], dict[int, Table]]:
    """Read the first records of every scanner and estimate sweep and column angles."""
    for_angles = geometry and rules.has_angle and (rules.columns == "dimension" or rules.lines == "fixed")
    needs_beat = _needs_beat(rules, points_per_line)
    if not _needs_probe(rules) and not for_angles and not needs_beat:
        return ({0: _Estimates(beat=given_beat(rules, points_per_line))} if rules.scanner is None else {}), {}
    beside = ("angle", *(rules.height_names if geometry else ())) if rules.has_angle else ()
    names = tuple(dict.fromkeys((*rules.names, *beside)))
    limit = PROBE_RECORDS if rules.scanner is None else PROBE_RECORDS_EACH
    # every scanner must be met where the rules depend on its angles or its beat
    to_end = rules.scanner is not None and (_needs_probe(rules) or needs_beat)
    first = first_records(source, rules, names, limit, to_end=to_end)
    if not first:
        raise nothing_placed(source.path)
    estimates: dict[int, _Estimates] = {}
    probes: dict[int, Table] = {}
    for scanner, records in first.items():
        where = source.path if rules.scanner is None else f"{source.path}: {rules.scanner} {scanner}"
        sweep = find_sweep(records["angle"], where) if rules.lines == "angle-wrap" else None
        beat = _beat(rules, records, points_per_line)
        if not _needs_probe(rules) and not for_angles:
            estimates[scanner] = _Estimates(beat=beat)
            continue
        # lines that go back are judged while reading, not here
        lenient = replace(rules, config=rules.config.model_copy(update={"order": "trust"}))
        whole, _ = advance(scanner, records, ScanState(), LineRules(lenient, points_per_line, sweep, beat), final=True)
        grid = None
        if rules.columns == "angle" and whole is not None:
            grid = _angle_grid(rules, take(whole.records, whole.records[START]), where)
            if rules.line_hz is not None and points_per_line is None:
                # where shots are missing the columns tell better how far they are apart
                beat = replace(beat, shot_s=min(beat.shot_s, 1 / (rules.line_hz * grid.n_columns)))
        estimates[scanner] = _Estimates(sweep, grid, beat)
        if whole is not None:
            probes[scanner] = whole.records
    return estimates, probes


def _angle_grid(rules: GridRules, shots: Table, where: str) -> AngleGrid:
    start, step = rules.config.angle_start, rules.config.angle_step
    return find_angle_grid(
        shots["angle"],
        shots[LINE],
        where,
        start_rad=None if start is None else math.radians(start),
        step_rad=None if step is None else math.radians(step),
    )


def find_columns(whole: WholeLines, rules: GridRules, grid: AngleGrid | None) -> I64:
    """Return the column of every shot of whole lines, (n,) int64; below 0 or beyond M where there is none."""
    records = whole.records
    starts = records[START]
    shots = records if starts.all() else take(records, starts)
    line: I64 = shots[LINE]
    if rules.column_dimension is not None:
        return column_rules.columns_by_dimension(shots[rules.column_dimension])
    if grid is not None:
        return columns_by_angle(shots["angle"], grid)
    if rules.shot_hz is None:
        return column_rules.columns_by_order(line)
    spread: F64 = shots[SPREAD]
    stamp = np.asarray(shots["time"], np.float64)
    if rules.line_hz is not None and whole.origin_s is not None:
        # relative to the origin first: line / HZ keeps full resolution however long the drive
        spread, start = spread - whole.origin_s, line / rules.line_hz
    else:
        start = column_rules.line_starts(spread, line)
    return column_rules.columns_by_time(spread, stamp, shots[ORDINAL], line, rules.shot_hz, start)


def _survey(source: RecordSource, rules: GridRules, estimates: dict[int, _Estimates]) -> dict[int, _Extent]:
    """Read the whole input once for the size of the image."""

    def line_rules(scanner: int) -> LineRules:
        found = estimates.get(scanner, _Estimates())
        return LineRules(rules, None, found.sweep, found.beat)

    extents: dict[int, _Extent] = {}
    for whole in whole_lines(source, rules, line_rules):
        extent = extents.get(whole.scanner, _Extent())
        records = whole.records
        if n_rows(records):
            found = estimates.get(whole.scanner, _Estimates())
            column = find_columns(whole, rules, found.angle_grid)
            line = records[LINE][records[START]]
            borders = np.flatnonzero(np.diff(line, prepend=-1, append=np.iinfo(np.int64).max))
            extent = replace(
                extent,
                n_shots=extent.n_shots + len(line),
                longest=max(extent.longest, int(np.diff(borders).max(initial=0))),
                max_column=max(extent.max_column, int(column.max(initial=-1))),
            )
        extents[whole.scanner] = replace(extent, n_lines=whole.stop_line)
    return extents


def _nadir(rules: GridRules, probe: Table, scanner: int) -> tuple[float | None, float, Assumption]:
    """Find the scan angle that points straight down, and the fall along it, in heights of the first lines."""
    key = "input.nadir" if rules.scanner is None else f"input.nadir of {rules.scanner} {scanner}"
    range_m = clean_ranges(probe[rules.height_names[0]], rules.config.min_range, rules.config.max_range)[0]
    lines = np.unique(probe[LINE][np.isfinite(range_m)])[:NADIR_LINES]
    first = np.isin(probe[LINE], lines)
    try:
        fit = fit_heights(probe["angle"][first], range_m[first], probe["z"][first], probe[LINE][first])
    except NoDirectionError as error:
        return None, 1.0, Assumption(key, "not found", f"z is there beside range and scan angle, but {error}")
    why = f"found from z, range and scan angle of {fit.n_shots} shots, heights within {fit.off_m:.3f} m in the middle"
    shown = f"{math.degrees(fit.nadir_rad):.2f} deg{shown_lean(fit.fall)}"
    return fit.nadir_rad, fit.fall, Assumption(key, shown, why)


def _angles(rules: GridRules, size: int, found: _Estimates, probe: Table | None) -> F64 | None:
    if found.angle_grid is not None:
        return found.angle_grid.angles(size)
    if (given := given_angles(rules.config, size)) is not None:
        return given
    if probe is None or "angle" not in probe or rules.columns not in ("dimension", "order"):
        return None
    if rules.columns == "order" and rules.lines != "fixed":
        return None
    shots = take(probe, probe[START])
    line = shots[LINE]
    whole = WholeLines(0, 0, int(line[-1]) + 1 if len(line) else 0, probe, None, ReadTally())
    return column_angles(shots["angle"], find_columns(whole, rules, None), size)
