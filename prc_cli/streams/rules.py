"""Resolves ``auto``: chooses the rules for lines, columns and ranges of an input, or says which options to give."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from difflib import SequenceMatcher

from prc_cli.core.errors import ConfigError, InputError, OrderError
from prc_cli.core.stream import Assumption
from prc_cli.formats.options import InputConfig, parse_rate
from prc_cli.formats.ranges import ReturnRule
from prc_cli.formats.records import STANDARD_NAMES, RecordSource
from prc_cli.streams.order import Policy
from prc_cli.streams.ranges import XYZ, is_sensor_xyz
from prc_cli.streams.record_angles import columns_of_angles, has_sweeps, lacks_shots, turns_round

_NO_RANGE = "no slant range"
_FIRED = frozenset(("range", "scan_line", "column", "angle", "time"))
"""Dimensions that tell of the shots."""
LOST = (
    "registered points without times, scan lines or ranges: the order in which they were fired is lost, so they cannot "
    "be classified"
)
LOST_HINT = (
    "classify the raw drive and carry its labels over (prc transfer), or give the points with their times; of x, y, z "
    "from the scanner: --lines elevation:DEG with --range sensor-xyz; if they lie as fired insist with --trust-order"
)


@dataclass(frozen=True, slots=True)
class GridRules:
    """Resolved rules that find the cell of every shot, the same for all scanners of an input."""

    path: str
    lines: str
    """``dimension``, ``fixed``, ``angle-wrap`` or ``time``."""
    columns: str
    """``dimension``, ``angle``, ``time`` or ``order``."""
    range: str
    """Resolved ``input.range``."""
    line_dimension: str | None
    column_dimension: str | None
    line_hz: float | None
    """Lines per second with ``lines = time``."""
    shot_hz: float | None
    """Shots per second with ``columns = time``."""
    scanner: str | None
    """Dimension with the scanner id."""
    has_time: bool
    has_angle: bool
    has_returns: bool
    """Whether the input has the number of returns."""
    has_return_number: bool
    has_intensity: bool
    has_sensor_xyz: bool
    """Whether there are coordinates relative to the scanner beside ranges."""
    height_names: tuple[str, ...]
    """Dimensions beside the scan angle for finding straight down: range and registered heights, or none."""
    assumptions: tuple[Assumption, ...]
    points_per_line: int | None
    """M if given."""
    time_origin_s: float | None
    """Time of line 0, column 0 if given [s]."""
    angle_start_deg: float | None
    """Scan angle of column 0 if given [deg]."""
    angle_step_deg: float | None
    """Scan angle between columns if given [deg]."""
    max_gap_lines: int
    """Most missing lines in a row."""
    pads_last_line: bool
    """Whether the last of fixed lines may be cut short."""
    chosen_return: ReturnRule
    """Which return of a shot the image shows."""
    order: Policy
    """Policy for records out of order."""
    whole_turn: bool = False
    """Whether lines are whole turns, by their times, though no shot of some angles ever returns."""

    @property
    def names(self) -> tuple[str, ...]:
        """Dimensions needed for lines, columns and shots."""
        wanted = (
            ("time", self.has_time),
            ("return_number", self.has_returns and self.has_return_number),
            ("number_of_returns", self.has_returns),
            ("angle", self.columns == "angle" or self.lines == "angle-wrap"),
            (self.line_dimension, True),
            (self.column_dimension, True),
            (self.scanner, True),
        )
        return tuple(dict.fromkeys(name for name, is_wanted in wanted if name is not None and is_wanted))

    @property
    def gives_angles(self) -> bool:
        """Whether the configuration gives the scan angle of every column."""
        return self.angle_start_deg is not None and self.angle_step_deg is not None

    @property
    def is_dense(self) -> bool:
        """Whether the records are dense: one per cell, in order."""
        fixed = self.lines == "fixed" and self.columns == "order" and self.range.startswith("dimension:")
        return (
            fixed
            and not self.has_sensor_xyz
            and self.scanner is None
            and not self.has_returns
            and self.order != "sort-time"
        )


def resolve_rules(source: RecordSource, config: InputConfig) -> GridRules:
    """Resolve ``auto`` and check that all named dimensions exist."""
    has = source.dimensions
    if config.order == "require" and is_order_lost(source, config):
        raise OrderError(source.path, LOST, LOST_HINT)
    if config.lines == "rings":
        problem = f"found 'rings', which {source.path} cannot be read by: it is no frame of x, y, z"
        raise ConfigError("input.lines", problem, "find lines in another way: --lines")
    taken: list[Assumption] = []
    lines, columns, range_ = _auto_rules(source, config, taken)
    scanner = _scanner(config)
    for key, rule in (("lines", lines), ("columns", columns), ("range", range_)):
        if rule.startswith("dimension:"):
            _check_dimension(f"input.{key}", rule.partition(":")[2], source)
        elif rule in ("angle", "angle-wrap"):
            _check_dimension(f"input.{key}", "angle", source)
        elif rule.startswith("time:"):
            _check_dimension(f"input.{key}", "time", source)
    if scanner is not None:
        _check_dimension("input.scanner", scanner, source)
    if columns.startswith("time:") and not lines.startswith("time:"):
        # no source for the start of lines
        why = "lines that begin with missing shots shift; with --lines time:HZ they do not"
        taken.append(Assumption("input.columns", "column 0 is the first return of each line", why))
    if config.columns == "order" and lines != "fixed":
        why = "given; where shots are left out, the rest of the line moves up"
        taken.append(Assumption("input.columns", "order", why))
    if lines.startswith("time:") and config.time_origin is None:
        why = "line 0, column 0 is taken to be fired then: the phase of the mirror is not in the input"
        taken.append(Assumption("input.time_origin", "time of the first record", why))
    if config.return_ != "strongest" and "number_of_returns" not in has:
        why = "the input does not say how many returns a shot has: every record is a shot"
        taken.append(Assumption("input.return", "no effect", why))
    return GridRules(
        path=source.path,
        lines=lines.partition(":")[0],
        columns=columns.partition(":")[0],
        range=range_,
        line_dimension=_argument(lines),
        column_dimension=_argument(columns),
        line_hz=parse_rate(lines) if lines.startswith("time:") else None,
        shot_hz=parse_rate(columns) if columns.startswith("time:") else None,
        scanner=scanner,
        has_time="time" in has,
        has_angle="angle" in has,
        has_returns="number_of_returns" in has,
        has_return_number="return_number" in has,
        has_intensity="intensity" in has,
        has_sensor_xyz=_has_sensor_xyz(source, range_, taken),
        height_names=_height_names(source, config, range_),
        assumptions=tuple(taken),
        points_per_line=config.points_per_line,
        time_origin_s=config.time_origin,
        angle_start_deg=config.angle_start,
        angle_step_deg=config.angle_step,
        max_gap_lines=config.max_gap_lines,
        pads_last_line=config.partial_line == "pad",
        chosen_return=config.return_,
        order=config.order,
        whole_turn=columns == "angle" and turns_round(source, scanner),
    )


def is_order_lost(source: RecordSource, config: InputConfig) -> bool:
    """Whether an input is registered points alone: nothing in it says in which order they were fired."""
    has = set(source.dimensions)
    told = config.range == "sensor-xyz" or any(one.startswith("dimension:") for one in (config.range, config.lines))
    return set(XYZ) <= has and not has & _FIRED and not source.facts.rules and not told


def trusting(source: RecordSource | None, config: InputConfig) -> InputConfig:
    """Return the configuration with which violations of the order are counted, not refused, unless it is lost."""
    if config.order != "require" or (source is not None and is_order_lost(source, config)):
        return config
    return config.model_copy(update={"order": "trust"})


def _auto_rules(source: RecordSource, config: InputConfig, taken: list[Assumption]) -> tuple[str, str, str]:
    """Return the rules for lines, columns and ranges with ``auto`` resolved."""
    missing: list[InputError] = []
    has = source.dimensions
    lines, columns, range_ = config.lines, config.columns, config.range
    if lines == "auto":
        lines = _or_missing(lambda: _auto_lines(source, config, taken), missing)
    if columns == "auto":
        # without lines, those by time are the ones that need columns
        of_lines = lines or ("time:" if "time" in has else "fixed")
        columns = _or_missing(lambda: _auto_columns(source, of_lines, config, taken), missing)
    if range_ == "auto":
        range_ = _or_missing(lambda: _auto_range(source, taken), missing)
    if missing:
        raise _all_missing(source, missing, config)
    return lines, columns, range_


def _or_missing(find: Callable[[], str], missing: list[InputError]) -> str:
    """Return the rule found; empty, with its error kept, where none is."""
    try:
        return find()
    except InputError as error:
        missing.append(error)
        return ""


MEASURED = " measures rates from the times and writes the command; or "
"""Where a hint names ``prc info``; what follows is the rest of the hint."""


def only_times_tell(source: RecordSource) -> bool:
    """Tell whether only the times of the records can say where lines and columns are."""
    return "time" in source.dimensions and not {"scan_line", "column", "angle"} & set(source.dimensions)


def _all_missing(source: RecordSource, missing: list[InputError], config: InputConfig) -> InputError:
    """Return one error for all that is missing, so that nobody is asked three times."""
    has_range = not any(error.problem.startswith(_NO_RANGE) for error in missing)
    if len(missing) == 1 or has_range:
        return _with_draft(source, missing[0])
    if not set(STANDARD_NAMES) & set(source.dimensions):
        problem = f"nothing says what its columns are: {', '.join(source.dimensions[:12])}"
        hint = "give a layout that names them (--layout FILE)"
        return _with_draft(source, InputError(source.path, problem, hint))
    problem = "; ".join(error.problem for error in missing)
    hint = "; ".join(error.hint for error in missing)
    if only_times_tell(source):
        is_sorted = " --sort-by-time" if config.order == "sort-time" else ""
        hint = f"prc info {source.path}{is_sorted}{MEASURED}{hint}"
    return _with_draft(source, InputError(source.path, problem, hint))


def _with_draft(source: RecordSource, error: InputError) -> InputError:
    """Name the command that drafts a layout, where one describes the records."""
    is_guessed = source.format == "raw binary" and source.dimensions == ("range",)
    if not is_guessed and (source.format != "text" or set(source.dimensions) <= set(STANDARD_NAMES)):
        return error
    draft = f"or prc info {source.path} --draft FILE.toml, which looks at the numbers, and --config FILE.toml"
    return InputError(source.path, error.problem, f"{error.hint}; {draft}")


def _height_names(source: RecordSource, config: InputConfig, range_: str) -> tuple[str, ...]:
    """Return the dimensions for heights, if there are heights, ranges and scan angles, and down is not given."""
    has_angles = "angle" in source.dimensions or (config.angle_start is not None and config.angle_step is not None)
    is_there = range_.startswith("dimension:") and has_angles and "z" in source.dimensions
    return (range_.partition(":")[2], "z") if is_there and config.nadir is None else ()


def _scanner(config: InputConfig) -> str | None:
    return None if config.scanner == "none" else config.scanner


def _argument(rule: str) -> str | None:
    return rule.partition(":")[2] if rule.startswith("dimension:") else None


def _implied(source: RecordSource, key: str, taken: list[Assumption]) -> str | None:
    """Return the rule that the format implies; None if it implies none."""
    rule = source.facts.rule(key)
    if rule is None or rule.value == "rings":
        return None
    taken.append(Assumption(f"input.{key}", rule.value, rule.why))
    return rule.value


def _auto_lines(source: RecordSource, config: InputConfig, taken: list[Assumption]) -> str:
    if "scan_line" in source.dimensions:
        taken.append(Assumption("input.lines", "dimension:scan_line", "the input has a dimension of this name"))
        return "dimension:scan_line"
    if (implied := _implied(source, "lines", taken)) is not None:
        return implied
    m = config.points_per_line
    if m is not None and not ("angle" in source.dimensions and lacks_shots(source, _scanner(config), m)):
        why = f"points_per_line = {m} is given and the input has no dimension scan_line"
        taken.append(Assumption("input.lines", "fixed", why))
        return "fixed"
    if "angle" in source.dimensions and has_sweeps(source, _scanner(config)):
        why = "no dimension scan_line, but the scan angle runs in sweeps"
        why += "" if m is None else f", and they lack some of their {m} shots"
        taken.append(Assumption("input.lines", "angle-wrap", why))
        return "angle-wrap"
    ways = ["-M NUMBER if no shot is left out", "--lines dimension:NAME"]
    if "range" in source.dimensions:
        ways[0] += " (prc info estimates it)"
    if set(XYZ) <= set(source.dimensions) and config.range in ("auto", "sensor-xyz"):
        drop = "--lines elevation:DEG" + ("" if config.range == "sensor-xyz" else " with --range sensor-xyz")
        ways.append(f"{drop} (x, y, z from the scanner, line after line)")
    if "time" in source.dimensions:
        ways.append("--lines time:HZ (scan lines a second)")
    problem = "no scan lines: the file has no dimension scan_line and points_per_line is not given"
    raise InputError(source.path, problem, f"give {_either(ways)}")


def _auto_columns(source: RecordSource, lines: str, config: InputConfig, taken: list[Assumption]) -> str:
    if lines == "fixed":
        taken.append(Assumption("input.columns", "order", "lines are fixed: every shot has its record"))
        return "order"
    if (implied := _implied(source, "columns", taken)) is not None:
        return implied
    if "column" in source.dimensions:
        taken.append(Assumption("input.columns", "dimension:column", "the input has a dimension of this name"))
        return "dimension:column"
    why = "the input has no dimension column"
    if "angle" in source.dimensions and _argument(lines) in (None, *source.dimensions):
        gives, why = columns_of_angles(source, _argument(lines), _scanner(config))
        if gives:
            taken.append(Assumption("input.columns", "angle", why))
            return "angle"
    if lines.startswith("time:"):
        ways = ["--columns time:HZ (shots a second)", "--columns order if no shot is left out"]
        problem = "no columns: the file has no dimension column, and lines found by time say nothing of them"
        raise InputError(source.path, problem, f"give {_either(ways)}")
    why = f"{why}; where shots are left out, the rest of the line moves up"
    taken.append(Assumption("input.columns", "order", why))
    return "order"


def _has_sensor_xyz(source: RecordSource, range_: str, taken: list[Assumption]) -> bool:
    """Whether coordinates beside ranges are relative to the scanner; not needed with scan angles."""
    kind, _, name = range_.partition(":")
    if kind != "dimension" or name in XYZ or "angle" in source.dimensions or not set(XYZ) <= set(source.dimensions):
        return False
    first = next(iter(source.chunks((*XYZ, name))), None)
    if first is None or not is_sensor_xyz(first.values, name):
        return False
    why = f"their length is {name!r} in the first records: they are relative to the scanner"
    taken.append(Assumption("input.range", "x, y, z as directions", why))
    return True


def _auto_range(source: RecordSource, taken: list[Assumption]) -> str:
    if "range" in source.dimensions:
        taken.append(Assumption("input.range", "dimension:range", "the input has a dimension of this name"))
        return "dimension:range"
    if (implied := _implied(source, "range", taken)) is not None:
        return implied
    ways = ["--range dimension:NAME"]
    if set(XYZ) <= set(source.dimensions):
        ways += ["--range trajectory:FILE"] if "time" in source.dimensions else []
        ways += ["--range origin:X,Y,Z (static scan)", "--range sensor-xyz (coordinates of the sensor itself)"]
    names = ", ".join(source.dimensions[:12]) + (", ..." if len(source.dimensions) > 12 else "")
    problem = f"{_NO_RANGE}: the file has no dimension range, it has {names or 'none'}"
    raise InputError(source.path, problem, f"give {_either(ways)}")


def _either(ways: list[str]) -> str:
    return ways[0] if len(ways) == 1 else f"{', '.join(ways[:-1])} or {ways[-1]}"


def _check_dimension(key: str, name: str, source: RecordSource) -> None:
    if name in source.dimensions:
        return
    nearest = sorted(source.dimensions, key=lambda other: -SequenceMatcher(None, name, other).ratio())
    problem = f"{source.path} has no dimension {name!r}"
    raise ConfigError(key, problem, f"it has: {', '.join(nearest)}" if nearest else "it has none")


def given_points_per_line(rules: GridRules, recorded: int | None) -> tuple[int | None, Assumption | None]:
    """Return M if known without reading."""
    key = "input.points_per_line"
    if rules.points_per_line is not None:
        # with column numbers in the file another M drops its last columns, or spreads its angles over too many
        if recorded and recorded != rules.points_per_line and rules.columns == "dimension":
            problem = f"found {rules.points_per_line}, but {rules.path} records {recorded} shots in a line"
            raise ConfigError(key, problem, "leave -M out")
        return rules.points_per_line, None
    if rules.lines == "fixed" and recorded is not None and recorded > 0:
        return recorded, Assumption(key, str(recorded), "recorded in the file")
    if rules.lines == "fixed":
        hint = f"give -M NUMBER; prc info {rules.path} estimates it"
        raise ConfigError(key, f"lines = fixed needs the shots in a scan line of {rules.path}", hint)
    if rules.line_hz is not None and rules.shot_hz is not None:
        # round up: rounding down would drop shots at the end of lines
        m = max(math.ceil(rules.shot_hz / rules.line_hz - 0.01), 1)
        return m, Assumption(key, str(m), f"{rules.shot_hz:g} shots and {rules.line_hz:g} lines a second")
    if recorded is not None and recorded > 0:
        return recorded, Assumption(key, str(recorded), "recorded in the file")
    return None, None
