"""Step one, rules: choose how lines, columns and ranges are found, or name the options to give.

``auto`` is resolved, and where only the directions to the points tell lines and columns, they are
measured:

- ``lines = elevation:DEG``, for points with x, y, z but without missing shots: the elevation rises
  along a line and drops to the first point of the next one.
- ``range = trajectory`` or ``origin`` with times only: returns repeat only roughly from line to
  line, but the direction of a shot repeats exactly. So the line rate and the start of lines are
  those of the sweep, also if stamps leave out the angles that a scanner does not measure.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from prc_cli.core.errors import ConfigError, InputError, OrderError
from prc_cli.core.facts import KnownRule, SourceFacts
from prc_cli.core.stream import Assumption
from prc_cli.core.types import F32, F64
from prc_cli.formats.options import InputConfig, parse_rate
from prc_cli.formats.records import (
    STANDARD_NAMES,
    RecordChunk,
    Source,
    filtered,
    nearest_first,
)
from prc_cli.formats.sorting import sorted_by_time
from prc_cli.streams.angles import (
    columns_of_angles,
    has_sweeps,
    lacks_shots,
    turns_round,
)
from prc_cli.streams.columns import Table
from prc_cli.streams.directions import angles_in_planes
from prc_cli.streams.evidence.periods import TimedScan, measure_sweeps
from prc_cli.streams.head import Head, first_shots, shots_in_time
from prc_cli.streams.order import judge_first_records
from prc_cli.streams.ranges import (
    XYZ,
    RangeRule,
    is_in_plane,
    is_sensor_xyz,
    measure_ranges,
    open_ranges,
)

_NO_RANGE = "no slant range"
_FIRED = frozenset(("range", "scan_line", "column", "angle", "time"))
"""Dimensions that tell of the shots."""
LOST = "the file has no times, scan lines or ranges, so the order of the shots is lost"
LOST_HINT = (
    "classify the raw drive, then prc transfer; "
    "for x, y, z of the scanner: --lines elevation:DEG --range sensor-xyz; "
    "for shots in order: --trust-order"
)


@dataclass(frozen=True, slots=True)
class GridRules:
    """Resolved rules that find the cell of every shot, the same for all scanners of an input."""

    path: str
    config: InputConfig
    dimensions: tuple[str, ...]
    lines: str
    """``dimension``, ``fixed``, ``angle-wrap`` or ``time``."""
    columns: str
    """``dimension``, ``angle``, ``time`` or ``order``."""
    range: str
    """Resolved ``input.range``."""
    ranges: RangeRule
    line_dimension: str | None
    column_dimension: str | None
    line_hz: float | None
    """Lines per second with ``lines = time``."""
    shot_hz: float | None
    """Shots per second with ``columns = time``."""
    scanner: str | None
    """Dimension with the scanner id."""
    height_names: tuple[str, ...]
    """Dimensions beside the scan angle for finding straight down.

    These are range and registered heights, or none.
    """
    point_names: tuple[str, ...]
    """Dimensions beside the scan angle that test it: range and registered coordinates, or none."""
    whole_turn: bool
    """Whether lines are whole turns, by their times, though no shot of some angles ever returns."""
    points_per_line: int | None
    """M if known without reading."""
    assumptions: tuple[Assumption, ...]
    geometry: bool
    """Whether angles and straight down are wanted."""
    only_ranges: bool
    """Whether blocks have no times, and no intensities but for methods that need them."""
    with_intensity: bool
    """Whether the method needs intensities."""

    def has(self, name: str) -> bool:
        """Whether the input has a dimension."""
        return name in self.dimensions

    @property
    def has_returns(self) -> bool:
        """Whether the input has the number of returns."""
        return self.has("number_of_returns")

    @property
    def names(self) -> tuple[str, ...]:
        """Dimensions needed for lines, columns and shots."""
        wanted = (
            ("time", self.has("time")),
            ("return_number", self.has_returns and self.has("return_number")),
            ("number_of_returns", self.has_returns),
            ("angle", self.columns == "angle" or self.lines == "angle-wrap"),
            (self.line_dimension, True),
            (self.column_dimension, True),
            (self.scanner, True),
        )
        return tuple(
            dict.fromkeys(name for name, is_wanted in wanted if name is not None and is_wanted)
        )

    @property
    def carried(self) -> tuple[str, ...]:
        """Dimensions needed beside them, for the cells."""
        return (*self.ranges.names, *(("intensity",) if self.needs_intensity else ()))

    @property
    def spent(self) -> tuple[str, ...]:
        """Dimensions that only find shots and lines, and are dropped afterwards."""
        kept = {self.column_dimension, "angle", "return_number"}
        # these may also be the dimension of lines or scanners
        if not self.only_ranges or self.shot_hz is not None:
            kept.add("time")
        if self.needs_intensity:
            kept.add("intensity")
        return tuple(name for name in self.names if name not in kept)

    @property
    def needs_intensity(self) -> bool:
        """Whether intensities choose between returns, or blocks contain them."""
        decides = self.has_returns and self.config.return_ == "strongest"
        return self.has("intensity") and (decides or self.holds_intensity)

    @property
    def holds_intensity(self) -> bool:
        """Whether blocks contain intensities."""
        return self.has("intensity") and (self.with_intensity or not self.only_ranges)

    @property
    def gives_angles(self) -> bool:
        """Whether the configuration gives the scan angle of every column."""
        return self.config.angle_start is not None and self.config.angle_step is not None

    @property
    def pads_last_line(self) -> bool:
        """Whether the last of fixed lines may be cut short."""
        return self.config.partial_line == "pad"

    @property
    def is_dense(self) -> bool:
        """Whether the records are dense: one per cell, in order."""
        fixed = (
            self.lines == "fixed"
            and self.columns == "order"
            and self.range.startswith("dimension:")
        )
        plain = (
            fixed and not self.ranges.sensor_xyz and self.scanner is None and not self.has_returns
        )
        return plain and self.config.order != "sort-time"


@dataclass(frozen=True, slots=True)
class _Ways:
    """Resolved ``input.lines``, ``columns`` and ``range``."""

    lines: str
    columns: str
    range: str
    assumptions: tuple[Assumption, ...]


def resolve_rules(
    head: Head,
    config: InputConfig,
    *,
    geometry: bool = True,
    only_ranges: bool = False,
    with_intensity: bool = False,
) -> GridRules:
    """Resolve ``auto`` and check that all named dimensions exist."""
    if config.order == "require" and is_order_lost(head, config):
        raise OrderError(head.path, LOST, LOST_HINT)
    if is_timed_cloud(head, config):
        raise InputError(head.path, NO_RANGES, no_ranges_hint(head.path))
    if config.lines == "rings":
        problem = f"found 'rings', which {head.path} cannot be read by: it is no frame of x, y, z"
        raise ConfigError("input.lines", problem, "find lines in another way: --lines")
    try:
        ways = _resolve_ways(head, config)
    except InputError:
        # a file without lines is often a tile: then report its order instead
        if config.order == "require":
            judge_first_records(head)
        raise
    scanner = None if config.scanner == "none" else config.scanner
    _check_dimensions(head, ways, scanner)
    has_sensor_xyz = _has_sensor_xyz(head, ways.range)
    ranges = open_ranges(
        ways.range,
        head.dimensions,
        head.path,
        config,
        crs_wkt=head.facts.crs_wkt,
        sensor_xyz=has_sensor_xyz,
    )
    limits = limits_of(config, ways.lines, ways.columns, head.dimensions)
    assumptions = [*ways.assumptions, *limits]
    if has_sensor_xyz:
        name = _argument(ways.range)
        why = f"their length is {name!r} in the first records: they are relative to the scanner"
        assumptions.append(Assumption("input.range", "x, y, z as directions", why))
    line_hz = parse_rate(ways.lines) if ways.lines.startswith("time:") else None
    shot_hz = parse_rate(ways.columns) if ways.columns.startswith("time:") else None
    m, why_m = _known_points_per_line(head, config, ways.lines, ways.columns, line_hz, shot_hz)
    assumptions += ranges.assumptions
    if why_m is not None:
        assumptions.append(Assumption("input.points_per_line", str(m), why_m))
    needs_heights = geometry and not head.facts.downs
    return GridRules(
        path=head.path,
        config=config,
        dimensions=head.dimensions,
        lines=ways.lines.partition(":")[0],
        columns=ways.columns.partition(":")[0],
        range=ways.range,
        ranges=ranges,
        line_dimension=_argument(ways.lines),
        column_dimension=_argument(ways.columns),
        line_hz=line_hz,
        shot_hz=shot_hz,
        scanner=scanner,
        height_names=_height_names(head, config, ways.range) if needs_heights else (),
        point_names=_point_names(head, ways.range) if geometry else (),
        whole_turn=ways.columns == "angle" and _is_whole_turn(head, config),
        points_per_line=m,
        assumptions=tuple(assumptions),
        geometry=geometry,
        only_ranges=only_ranges,
        with_intensity=with_intensity,
    )


def _resolve_ways(head: Head, config: InputConfig) -> _Ways:
    """Replace ``auto``; everything that is missing is one error."""
    assumptions: list[Assumption] = []
    missing: list[InputError] = []

    def resolved(key: str, rule: str, answer: Callable[[], tuple[str, str]]) -> str:
        """Return the rule, or an empty text if there is none."""
        if rule != "auto":
            return rule
        try:
            rule, why = answer()
        except InputError as error:
            missing.append(error)
            return ""
        assumptions.append(Assumption(f"input.{key}", rule, why))
        return rule

    lines = resolved("lines", config.lines, lambda: _auto_lines(head, config))
    # without lines, those by time are the ones that need columns
    of_lines = lines or ("time:" if "time" in head.dimensions else "fixed")
    columns = resolved("columns", config.columns, lambda: _auto_columns(head, config, of_lines))
    range_ = resolved("range", config.range, lambda: _auto_range(head))
    if missing:
        raise _all_missing(head, missing, config)
    return _Ways(lines, columns, range_, tuple(assumptions))


def _check_dimensions(head: Head, ways: _Ways, scanner: str | None) -> None:
    for key, rule in (("lines", ways.lines), ("columns", ways.columns), ("range", ways.range)):
        kind, _, argument = rule.partition(":")
        if kind == "dimension":
            _check_dimension(f"input.{key}", argument, head)
        elif kind in ("angle", "angle-wrap", "time"):
            _check_dimension(f"input.{key}", kind.partition("-")[0], head)
    if scanner is not None:
        _check_dimension("input.scanner", scanner, head)


def limits_of(
    config: InputConfig, lines: str, columns: str, dimensions: tuple[str, ...]
) -> Iterator[Assumption]:
    """Yield what the rules of an input cannot know."""
    by_time = lines.startswith("time:")
    if columns.startswith("time:") and not by_time:
        # no source for the start of lines
        why = "lines that begin with missing shots shift; with --lines time:HZ they do not"
        yield Assumption("input.columns", "column 0 is the first return of each line", why)
    if config.columns == "order" and lines != "fixed":
        why = "given; if a shot is missing, the rest of its line moves up"
        yield Assumption("input.columns", "order", why)
    if by_time and config.time_origin is None:
        why = "assumed time of line 0, column 0: the input does not contain the phase of the mirror"
        yield Assumption("input.time_origin", "time of the first record", why)
    if config.return_ != "strongest" and "number_of_returns" not in dimensions:
        why = "the input does not say how many returns a shot has: every record is a shot"
        yield Assumption("input.return", "no effect", why)


def is_timed_cloud(source: Source, config: InputConfig) -> bool:
    """Whether an input is points with times, without ranges."""
    has = set(source.dimensions)
    knows = "range" in has or source.facts.rule("range") is not None
    return {*XYZ, "time"} <= has and config.range == "auto" and not knows


NO_RANGES = "the file has no ranges"
POINTS = "--range points"
"""The option that finds ranges from points and times."""
POINTS_HINT = (
    f"compute the ranges from the points and their times ({POINTS}); "
    "if you have the path of the scanner: --range trajectory:FILE"
)


def no_ranges_hint(path: str) -> str:
    """Return the command that classifies points with times.

    >>> no_ranges_hint("tile.laz").partition(";")[0]
    'type: prc classify tile.laz out.laz --range points'
    """
    name = "FILE" if path == "stdin" else shlex.quote(path)
    command = f"prc classify {name} out{Path(path).suffix} {POINTS}"
    return f"type: {command}; if you have the path of the scanner: --range trajectory:FILE"


def is_order_lost(source: Source, config: InputConfig) -> bool:
    """Whether an input is registered points without any order of firing."""
    has = set(source.dimensions)
    is_named = config.range == "sensor-xyz" or any(
        rule.startswith("dimension:") for rule in (config.range, config.lines)
    )
    return set(XYZ) <= has and not has & _FIRED and not source.facts.rules and not is_named


def trusting(source: Source | None, config: InputConfig) -> InputConfig:
    """Return the configuration that counts violations of the order, unless it is lost."""
    if config.order != "require" or (source is not None and is_order_lost(source, config)):
        return config
    return config.model_copy(update={"order": "trust"})


_IN_BRACKETS = re.compile(r" \([^)]*\)")
MEASURED = " measures the rates; or "
"""Where a hint names ``prc info``; what follows is the rest of the hint."""


def only_times_tell(source: Source) -> bool:
    """Tell whether only the times of the records can say where lines and columns are."""
    return "time" in source.dimensions and not {"scan_line", "column", "angle"} & set(
        source.dimensions
    )


def _all_missing(source: Source, missing: list[InputError], config: InputConfig) -> InputError:
    """Return one error for everything that is missing, instead of one after the other."""
    has_range = not any(error.problem.startswith(_NO_RANGE) for error in missing)
    if len(missing) == 1 or has_range:
        return _with_layout(source, missing[0])
    if not set(STANDARD_NAMES) & set(source.dimensions):
        problem = f"prc does not know these columns: {', '.join(source.dimensions[:12])}"
        hint = "name them in a layout: --layout FILE.toml"
        return InputError(source.path, problem, hint)
    faults = ", ".join(error.problem.partition(":")[0] for error in missing)
    lacks_range = missing[-1].problem.partition(": ")[2]
    problem = f"{faults}; {lacks_range}"
    hint = _IN_BRACKETS.sub("", "; ".join(error.hint for error in missing))
    if only_times_tell(source):
        is_sorted = " --sort-by-time" if config.order == "sort-time" else ""
        hint = f"prc info {source.path}{is_sorted}{MEASURED}{hint}"
    return _with_layout(source, InputError(source.path, problem, hint))


def _with_layout(source: Source, error: InputError) -> InputError:
    """Name the layout as another way if the columns of a file may have other names."""
    is_guessed = source.format == "raw binary" and source.dimensions == ("range",)
    if not is_guessed and (
        source.format != "text" or set(source.dimensions) <= set(STANDARD_NAMES)
    ):
        return error
    layout = "or name the fields of its records in a layout: --layout FILE.toml"
    return InputError(source.path, error.problem, f"{error.hint}; {layout}")


def _height_names(source: Source, config: InputConfig, range_: str) -> tuple[str, ...]:
    """Return the dimensions that give straight down from heights, if down is not given."""
    has_angles = "angle" in source.dimensions or (
        config.angle_start is not None and config.angle_step is not None
    )
    is_there = range_.startswith("dimension:") and has_angles and "z" in source.dimensions
    return (range_.partition(":")[2], "z") if is_there and config.nadir is None else ()


def _point_names(source: Source, range_: str) -> tuple[str, ...]:
    """Return the dimensions that test recorded scan angles, if all are there."""
    is_there = range_.startswith("dimension:") and {"angle", *XYZ} <= set(source.dimensions)
    return (range_.partition(":")[2], *XYZ) if is_there else ()


def _argument(rule: str) -> str | None:
    return rule.partition(":")[2] if rule.startswith("dimension:") else None


def _implied(
    source: Source,
    key: str,
    name: str,
    *,
    dimension_first: bool = True,
) -> tuple[str, str] | None:
    """Return the rule that a dimension or the format implies, and why; None if neither does."""
    rule = source.facts.rule(key)
    of_format = (rule.value, rule.why) if rule is not None and rule.value != "rings" else None
    named = (
        (f"dimension:{name}", "the input has a dimension of this name")
        if name in source.dimensions
        else None
    )
    return (named or of_format) if dimension_first else (of_format or named)


def _first_shots(source: Source, config: InputConfig) -> Table:
    scanner = None if config.scanner == "none" else config.scanner
    named = _argument(config.lines)
    return first_shots(source, scanner, *((named,) if named in source.dimensions else ()))


def _is_whole_turn(source: Source, config: InputConfig) -> bool:
    """Whether lines are whole turns, as the format or the times of the shots say."""
    if source.facts.rule("turn") is not None:
        return True
    has_turns = {"time", "angle"} <= set(source.dimensions)
    return has_turns and turns_round(_first_shots(source, config))


def _auto_lines(source: Source, config: InputConfig) -> tuple[str, str]:
    if (implied := _implied(source, "lines", "scan_line")) is not None:
        return implied
    m = config.points_per_line
    shots = _first_shots(source, config) if "angle" in source.dimensions else None
    if m is not None and (shots is None or not lacks_shots(shots, source.path, m)):
        return "fixed", f"points_per_line = {m} is given and the input has no dimension scan_line"
    if shots is not None and has_sweeps(shots, source.path):
        why = "no dimension scan_line, but the scan angle runs in sweeps"
        return "angle-wrap", why + ("" if m is None else f", and they lack some of their {m} shots")
    ways = ["-M NUMBER (shots per line)", "--lines dimension:NAME"]
    if "range" in source.dimensions:
        ways[0] = "-M NUMBER (shots per line, see prc info)"
    if set(XYZ) <= set(source.dimensions) and config.range in ("auto", "sensor-xyz"):
        drop = "--lines elevation:DEG" + (
            "" if config.range == "sensor-xyz" else " --range sensor-xyz"
        )
        ways.append(f"{drop} (x, y, z relative to the scanner)")
    if "time" in source.dimensions:
        ways.append("--lines time:HZ (lines per second)")
    problem = "no scan lines: the file has no dimension scan_line, and -M is not given"
    raise InputError(source.path, problem, f"give {_either(ways)}")


def _auto_columns(source: Source, config: InputConfig, lines: str) -> tuple[str, str]:
    if lines == "fixed":
        return "order", "lines are fixed: every shot has its record"
    if (implied := _implied(source, "columns", "column", dimension_first=False)) is not None:
        return implied
    why = "the input has no dimension column"
    if "angle" in source.dimensions and _argument(lines) in (None, *source.dimensions):
        shots = _first_shots(source, config)
        whole_turn = _is_whole_turn(source, config)
        gives, why = columns_of_angles(shots, _argument(lines), source.path, whole_turn=whole_turn)
        if gives:
            return "angle", why
    if lines.startswith("time:"):
        ways = ["--columns time:HZ (shots per second)", "--columns order if no shot is missing"]
        problem = "no columns: the file has no dimension column, and --columns is not given"
        raise InputError(source.path, problem, f"give {_either(ways)}")
    return "order", f"{why}; if a shot is missing, the rest of its line moves up"


def _has_sensor_xyz(source: Source, range_: str) -> bool:
    """Whether coordinates beside ranges are relative to the scanner.

    For a profiler, scan angles show it as well.
    """
    kind, _, name = range_.partition(":")
    if kind != "dimension" or name in XYZ or not set(XYZ) <= set(source.dimensions):
        return False
    first = next(iter(source.chunks((*XYZ, name))), None)
    if first is None or not is_sensor_xyz(first.values, name):
        return False
    return not ("angle" in source.dimensions and is_in_plane(first.values))


def _auto_range(source: Source) -> tuple[str, str]:
    if (implied := _implied(source, "range", "range")) is not None:
        return implied
    ways = ["--range dimension:NAME"]
    if set(XYZ) <= set(source.dimensions):
        ways += [
            "--range origin:X,Y,Z (static scan)",
            "--range sensor-xyz (x, y, z relative to the scanner)",
        ]
    # the file's own dimensions are behind those of its format
    every = sorted(source.dimensions, key=lambda name: not _RANGE_WORD.search(name.lower()))
    extra = [name for name in reversed(every) if name not in STANDARD_NAMES][
        : max(len(every) - 12, 0)
    ]
    every = list(dict.fromkeys([*every[:6], *extra, *every]))
    names = ", ".join(every[:12]) + (", ..." if len(every) > 12 else "")
    problem = f"{_NO_RANGE}: the file has no dimension range, it has {names or 'none'}"
    not_read = [note for note in source.facts.notes if "not read" in note]
    problem = "; ".join([problem, *not_read])
    raise InputError(source.path, problem, f"give {_either(ways)}")


_RANGE_WORD = re.compile(r"range|dist|slant|slope|depth|echo")
"""Names that may be those of a slant range."""


def _either(ways: list[str]) -> str:
    return ways[0] if len(ways) == 1 else f"{', '.join(ways[:-1])} or {ways[-1]}"


def _check_dimension(key: str, name: str, source: Source) -> None:
    if name in source.dimensions:
        return
    nearest = nearest_first(source.dimensions, name)
    problem = f"{source.path} has no dimension {name!r}"
    raise ConfigError(key, problem, f"it has: {', '.join(nearest)}" if nearest else "it has none")


def _known_points_per_line(
    source: Source,
    config: InputConfig,
    lines: str,
    columns: str,
    line_hz: float | None,
    shot_hz: float | None,
) -> tuple[int | None, str | None]:
    """Return M if known without reading, and why if it is not given."""
    configured = config.points_per_line
    recorded = source.facts.points_per_line
    key = "input.points_per_line"
    if configured is not None:
        # with column numbers in the file another M drops its last columns, or spreads its angles
        # over too many
        if recorded and recorded != configured and columns.startswith("dimension:"):
            problem = f"found {configured}, but {source.path} records {recorded} shots in a line"
            raise ConfigError(key, problem, "leave -M out")
        return configured, None
    is_recorded = recorded is not None and recorded > 0
    if lines == "fixed" and not is_recorded:
        hint = f"give -M NUMBER; prc info {source.path} estimates it"
        raise ConfigError(
            key, f"lines = fixed needs the shots in a scan line of {source.path}", hint
        )
    if line_hz is not None and shot_hz is not None:
        # round up: rounding down would drop shots at the end of lines
        m = max(math.ceil(shot_hz / line_hz - 0.01), 1)
        return m, f"{shot_hz:g} shots and {line_hz:g} lines a second"
    return (recorded, "recorded in the file") if is_recorded else (None, None)


_LINE = "line by elevation"
"""Name of the added column; the blank avoids clashes with dimensions."""


def with_elevation(
    source: Source, config: InputConfig
) -> tuple[Source, InputConfig, tuple[Assumption, ...]]:
    """Add elevations as ``angle`` [rad] and line numbers; return rules and assumptions, too."""
    drop_deg = parse_rate(config.lines)
    if not 0 < abs(drop_deg) < 180:
        raise ConfigError(
            "input.lines", f"found {config.lines!r}, expected elevation:DEG with 0 < |DEG| < 180"
        )
    if config.range not in ("auto", "sensor-xyz"):
        problem = (
            f"found {config.range!r}, expected sensor-xyz: "
            "the elevation is that of x, y, z from the scanner"
        )
        raise ConfigError(
            "input.range", problem, "add --range sensor-xyz, or find lines in another way"
        )
    if not set(XYZ) <= set(source.dimensions):
        problem = f"found {config.lines!r}, but {source.path} has no x, y, z"
        raise ConfigError("input.lines", problem, "find lines in another way: --lines")
    rules = config.model_copy(update={"lines": f"dimension:{_LINE}", "range": "sensor-xyz"})
    why = "lines end where the elevation of x, y, z jumps back; the scan angle is the elevation"
    drop_rad = math.radians(drop_deg)

    def chunks(names: tuple[str, ...], stored: Source) -> Iterator[RecordChunk]:
        return _elevations(names, stored, drop_rad)

    elevated = filtered(
        source,
        chunks,
        dimensions=(*dict.fromkeys(("angle", *source.dimensions)), _LINE),
        facts_of=_of_other_lines,
    )
    return elevated, rules, (Assumption("input.lines", config.lines, why),)


def _of_other_lines(facts: SourceFacts) -> SourceFacts:
    """Return the metadata without notices, and without M, which is that of other lines."""
    rules = (KnownRule("nadir", "-90", "angles are elevations"), *facts.rules)
    return replace(facts, points_per_line=None, notes=(), rules=rules)


def _elevations(names: tuple[str, ...], source: Source, drop_rad: float) -> Iterator[RecordChunk]:
    """Decode dimensions with ``angle`` and line number.

    A point at the origin has no elevation and stays in the current line.
    """
    if not {"angle", _LINE} & set(names):
        yield from source.chunks(names)
        return
    stored = tuple(name for name in names if name not in ("angle", _LINE))
    line = 0
    last = np.nan
    for chunk in source.chunks(tuple(dict.fromkeys((*stored, *XYZ)))):
        x, y, z = (np.asarray(chunk.values[name], np.float64) for name in XYZ)
        with np.errstate(over="ignore", invalid="ignore"):
            flat = np.hypot(x, y)
            angle = np.where((flat > 0) | (z != 0), np.arctan2(z, flat), np.nan)
        known = np.flatnonzero(~np.isnan(angle))
        begins = np.zeros(chunk.n, np.int64)
        if len(known):
            seen = angle[known]
            back = np.append(last, seen[:-1]) - seen
            begins[known] = back > drop_rad if drop_rad > 0 else back < drop_rad
            last = seen[-1]
        number = line + np.cumsum(begins)
        line = int(number[-1]) if chunk.n else line
        columns = {**chunk.values, "angle": angle, _LINE: number}
        yield replace(chunk, values={name: columns[name] for name in names})


MAX_SHOTS = 1 << 22
"""Most shots that are looked at for a sweep."""


def with_sweeps(source: Source, config: InputConfig) -> tuple[InputConfig, tuple[Assumption, ...]]:
    """Find lines and columns by time from the directions, if nothing else gives them."""
    is_open = (config.lines, config.columns, config.points_per_line) == ("auto", "auto", None)
    has_directions = config.range.partition(":")[0] in ("trajectory", "origin") and set(XYZ) <= set(
        source.dimensions
    )
    if not is_open or not has_directions or not only_times_tell(source) or config.scanner != "none":
        return config, ()
    records = sorted_by_time(source) if config.order == "sort-time" else source
    rule = open_ranges(
        config.range, source.dimensions, source.path, config, crs_wkt=source.facts.crs_wkt
    )
    scan = _rates(records, rule)
    if scan is None:
        return config, ()
    rules: dict[str, object] = {
        "lines": f"time:{scan.line_hz:.12g}",
        "columns": f"time:{scan.shot_hz:.12g}",
    }
    why = f"the directions from the scanner sweep so, measured over {scan.n_lines:.0f} lines"
    assumptions = [Assumption(f"input.{key}", str(value), why) for key, value in rules.items()]
    if config.time_origin is None:
        rules["time_origin"] = scan.time_origin_s
        assumptions.append(
            Assumption(
                "input.time_origin",
                f"{scan.time_origin_s!r}",
                "where the sweep has its largest gap",
            )
        )
    return config.model_copy(update=rules), tuple(assumptions)


def _rates(source: Source, rule: RangeRule) -> TimedScan | None:
    times: list[F64] = []
    directions: list[F32] = []
    for shots in shots_in_time(source, rule.names, MAX_SHOTS):
        _, xyz = measure_ranges(shots, rule)
        times.append(np.asarray(shots["time"], np.float64))
        directions.append(np.empty((0, 3), np.float32) if xyz is None else xyz)
    return (
        measure_sweeps(np.concatenate(times), angles_in_planes(np.concatenate(directions)))
        if times
        else None
    )
