"""Sets up every scanner before its first block: sweep, column angles, M.

From the first records, or from one pass over the needed dimensions where that takes the whole input.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from prc_cli.core.stream import Assumption
from prc_cli.core.types import F64
from prc_cli.formats.records import RecordSource
from prc_cli.streams.angles import column_angles
from prc_cli.streams.columns import AngleGrid, ColumnRule, find_columns
from prc_cli.streams.down import NoDirectionError, fit_heights, shown_tilt
from prc_cli.streams.probe import Estimates, estimate_assumptions, line_rules, probe
from prc_cli.streams.ranges import RangeRule, clean_measured
from prc_cli.streams.reading import whole_lines
from prc_cli.streams.rules import GridRules
from prc_cli.streams.table import LINE, START, Table, n_rows
from prc_cli.streams.whole_lines import LineRules, WholeLines, check_found_columns, check_image
from prc_cli.streams.window import WindowEnd

DOWN_LINES = 64
"""Number of lines with returns used to find straight down."""


@dataclass(frozen=True, slots=True)
class ScannerSetup:
    """Parameters of the cells of one scanner, fixed before the first block."""

    points_per_line: int
    found: Estimates
    angle_rad: F64 | None
    """(M,) float64, angle of every column [rad], None if unknown."""
    down_rad: float | None = None
    """Scan angle of straight down [rad], None if unknown."""
    cos_tilt: float = 1.0
    """Cosine of the tilt of the scan plane from the vertical."""
    n_shots: int = 0
    """Number of shots, if the whole input was read."""


@dataclass(frozen=True, slots=True)
class _Extent:
    """Size of the image of one scanner."""

    n_lines: int = 0
    n_shots: int = 0
    longest: int = 0
    """Number of shots in the longest line."""
    max_column: int = -1


def find_setups(
    source: RecordSource,
    rules: GridRules,
    ranges: RangeRule,
    points_per_line: int | None,
    *,
    geometry: bool = True,
    end: WindowEnd | None = None,
) -> tuple[dict[int, ScannerSetup], int | None, tuple[Assumption, ...]]:
    """Estimate the parameters that the rules need, for every scanner."""
    if points_per_line is not None and rules.points_per_line is None:
        check_found_columns(rules.path, points_per_line, source.n_records)
    estimates, probes = probe(source, rules, points_per_line, geometry=geometry)
    n_lines: int | None = None
    extents: dict[int, _Extent] = {}
    sizes: dict[int, int | None] = dict.fromkeys(estimates, points_per_line)
    taken = estimate_assumptions(rules, estimates)
    if points_per_line is None:
        for scanner, found in estimates.items():
            grid = found.angle_grid
            sizes[scanner] = grid.n_columns if grid is not None and grid.whole_turn else None
        if None in sizes.values() or not sizes:
            extents = _survey(source, rules, estimates, end)
            n_lines = sum(extent.n_lines for extent in extents.values())
            sizes = {scanner: sizes.get(scanner) or _size(rules, extents[scanner]) for scanner in sorted(extents)}
            images = {one: (extent.n_lines, sizes[one] or 1, extent.n_shots) for one, extent in extents.items()}
            check_image(rules.path, images, rules.scanner or "")
        shown = _shown_sizes(rules, sizes)
        taken.append(
            Assumption("input.points_per_line", shown, _size_reason(rules, end, whole_pass=n_lines is not None))
        )
    setups = {}
    for scanner, size in sizes.items():
        if size is None:
            continue
        if points_per_line is None:
            check_found_columns(rules.path, size, source.n_records)
        found = estimates.get(scanner, Estimates())
        angle = _angles(rules, size, found, probes.get(scanner))
        down_rad, cos_tilt = None, 1.0
        if geometry and angle is not None and rules.height_names and scanner in probes:
            whole = _with_angles(probes[scanner], column_rule(rules, found.angle_grid), angle, rules)
            down_rad, cos_tilt, assumption = _down(rules, ranges, whole, scanner)
            taken.append(assumption)
        n_shots = extents[scanner].n_shots if scanner in extents else 0
        setups[scanner] = ScannerSetup(size, found, angle, down_rad, cos_tilt, n_shots)
    return setups, n_lines, tuple(taken)


def _size(rules: GridRules, extent: _Extent) -> int:
    size = extent.longest if rules.columns == "order" else extent.max_column + 1
    return max(size, 1)


def _shown_sizes(rules: GridRules, sizes: dict[int, int | None]) -> str:
    """Return M as text, by scanner if there are several."""
    if rules.scanner is None:
        return ", ".join(str(size) for size in sizes.values())
    return ", ".join(f"scanner {scanner}: {sizes[scanner]}" for scanner in sorted(sizes))


def _size_reason(rules: GridRules, end: WindowEnd | None, *, whole_pass: bool) -> str:
    if not whole_pass:
        return "steps of the scan angle in a whole turn"
    where = "" if end is None else f" up to the end of {end.window.option}; -M gives that of the drive"
    if rules.columns == "order":
        return f"shots of the longest line{where}"
    return f"highest column in the input{where}"


def given_angles(rules: GridRules, points_per_line: int) -> F64 | None:
    """Return the scan angle of every column if given, (M,) float64 [rad]."""
    if rules.angle_start_deg is None or rules.angle_step_deg is None:
        return None
    return np.deg2rad(rules.angle_start_deg + rules.angle_step_deg * np.arange(points_per_line, dtype=np.float64))


def column_rule(rules: GridRules, grid: AngleGrid | None) -> ColumnRule:
    """Return the column rule of a scanner."""
    return ColumnRule(rules.column_dimension, grid, rules.shot_hz, rules.line_hz)


def _survey(
    source: RecordSource, rules: GridRules, estimates: dict[int, Estimates], end: WindowEnd | None
) -> dict[int, _Extent]:
    """Read the input once for the size of the image: the whole of it, or to the end of a window."""

    def of_scanner(scanner: int) -> LineRules:
        return line_rules(rules, None, estimates.get(scanner, Estimates()))

    extents: dict[int, _Extent] = {}
    for whole in whole_lines(source, rules, of_scanner):
        if end is not None and extents and end.passed(whole.first_line, whole.records):
            break
        extent = extents.get(whole.scanner, _Extent())
        records = whole.records
        if n_rows(records):
            found = estimates.get(whole.scanner, Estimates())
            column = find_columns(records, column_rule(rules, found.angle_grid), whole.origin_s)
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


def _with_angles(whole: WholeLines, rule: ColumnRule, angle_rad: F64, rules: GridRules) -> Table:
    """Return records with scan angles: those of their columns where the configuration gives them."""
    records = whole.records
    if not rules.gives_angles:
        return records
    column = find_columns(records, rule, whole.origin_s)
    is_cell = (column >= 0) & (column < len(angle_rad))
    of_shot = np.where(is_cell, angle_rad[np.where(is_cell, column, 0)], np.nan)
    # further returns have the angle of their shot
    return {**records, "angle": of_shot[np.cumsum(records[START]) - 1]}


def _down(rules: GridRules, ranges: RangeRule, records: Table, scanner: int) -> tuple[float | None, float, Assumption]:
    """Find the scan angle of straight down, and the tilt, from heights of the first lines."""
    key = "input.nadir" if rules.scanner is None else f"input.nadir of {rules.scanner} {scanner}"
    range_m, _, _ = clean_measured(records, replace(ranges, sensor_xyz=False))
    lines = np.unique(records[LINE][np.isfinite(range_m)])[:DOWN_LINES]
    first = np.isin(records[LINE], lines)
    try:
        fit = fit_heights(records["angle"][first], range_m[first], records["z"][first], records[LINE][first])
    except NoDirectionError as error:
        return None, 1.0, Assumption(key, "not found", f"z is there beside range and scan angle, but {error}")
    why = f"found from z, range and scan angle of {fit.n_shots} shots, heights within {fit.off_m:.3f} m in the middle"
    shown = f"{math.degrees(fit.down_rad):.2f} deg{shown_tilt(fit.cos_tilt)}"
    return fit.down_rad, fit.cos_tilt, Assumption(key, shown, why)


def _angles(rules: GridRules, size: int, found: Estimates, whole: WholeLines | None) -> F64 | None:
    if found.angle_grid is not None:
        return found.angle_grid.angles(size)
    if (given := given_angles(rules, size)) is not None:
        return given
    if whole is None or "angle" not in whole.records or rules.columns not in ("dimension", "order"):
        return None
    if rules.columns == "order" and rules.lines != "fixed":
        return None
    angle = whole.records["angle"][whole.records[START]]
    return column_angles(angle, find_columns(whole.records, column_rule(rules, None), None), size)
