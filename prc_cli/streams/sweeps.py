"""Finds lines and columns by the directions from the scanner to the points (``range = trajectory`` or ``origin``).

What returns repeats only roughly from line to line; the direction of a shot repeats exactly. So the line rate and the
begin of lines are those of the sweep, also where shots were stamped anew without time for the angles that a scanner
does not measure.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from prc_cli.core.stream import Assumption
from prc_cli.core.types import F32, F64
from prc_cli.formats.options import InputConfig
from prc_cli.formats.ranges import continues_run, mark_shots
from prc_cli.formats.records import RecordSource
from prc_cli.streams.down import wrap
from prc_cli.streams.evidence.periods import TimedScan, measure_sweeps
from prc_cli.streams.grid import GridStream
from prc_cli.streams.ranges import XYZ, RangeRule, measure_ranges, open_ranges
from prc_cli.streams.rules import only_times_tell
from prc_cli.streams.sorting import sorted_by_time
from prc_cli.streams.table import take

MAX_SHOTS = 1 << 22
"""Most shots that are looked at."""
PLANE_SHOTS = 1 << 12
"""Shots of which a scan plane is fitted: about a line, in which no vehicle turns much."""


def with_sweeps(source: RecordSource, config: InputConfig) -> tuple[InputConfig, tuple[Assumption, ...]]:
    """Return the configuration with lines and columns by time, from the directions, where nothing else tells."""
    asks = (config.lines, config.columns, config.points_per_line) == ("auto", "auto", None)
    knows = config.range.partition(":")[0] in ("trajectory", "origin") and set(XYZ) <= set(source.dimensions)
    if not asks or not knows or not only_times_tell(source) or config.scanner != "none":
        return config, ()
    records = sorted_by_time(source) if config.order == "sort-time" else source
    rule = open_ranges(config.range, source.dimensions, source.path, config, crs_wkt=source.facts.crs_wkt)
    found = _rates(records, rule)
    if found is None:
        return config, ()
    rules: dict[str, object] = {"lines": f"time:{found.line_hz:.12g}", "columns": f"time:{found.shot_hz:.12g}"}
    why = f"the directions from the scanner sweep so, measured over {found.n_lines:.0f} lines"
    told = [Assumption(f"input.{key}", str(value), why) for key, value in rules.items()]
    if config.time_origin is None:
        rules["time_origin"] = found.time_origin_s
        told.append(Assumption("input.time_origin", f"{found.time_origin_s!r}", "where the sweep has its largest gap"))
    return config.model_copy(update=rules), tuple(told)


def tell_sweeps(stream: GridStream, told: tuple[Assumption, ...]) -> GridStream:
    """Return the stream with the assumptions reported."""
    return replace(stream, info=replace(stream.info, assumptions=(*told, *stream.info.assumptions)))


def _rates(source: RecordSource, rule: RangeRule) -> TimedScan | None:
    """Measure the sweep of the first shots."""
    has_returns = {"return_number", "number_of_returns"} <= set(source.dimensions)
    names = tuple(
        dict.fromkeys((*rule.names, "time", *(("return_number", "number_of_returns") if has_returns else ())))
    )
    times: list[F64] = []
    directions: list[F32] = []
    n = 0
    for chunk in source.chunks(names):
        values = chunk.values
        if has_returns:
            continues = continues_run((values["time"],), values["number_of_returns"])
            values = take(values, mark_shots(continues, values["return_number"]))
        _, xyz = measure_ranges(values, rule)
        times.append(np.asarray(values["time"], np.float64))
        directions.append(np.empty((0, 3), np.float32) if xyz is None else xyz)
        n += len(times[-1])
        if n >= MAX_SHOTS:
            break
    return measure_sweeps(np.concatenate(times), angles_in_planes(np.concatenate(directions))) if times else None


def angles_in_planes(xyz: F32) -> F64:
    """Return the angle of every shot in its scan plane, from the lowest direction [rad].

    >>> angle = np.linspace(-1.0, 1.0, 5)
    >>> line = np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=1).astype(np.float32)
    >>> np.abs(angles_in_planes(line)).round(3).tolist()
    [1.0, 0.5, 0.0, 0.5, 1.0]
    """
    wide = xyz.astype(np.float64)
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = wide / np.sqrt((wide * wide).sum(axis=1))[:, None]
    angle = np.full(len(unit), np.nan)
    before = np.array([0.0, 1.0, 0.0])
    for first in range(0, len(unit), PLANE_SHOTS):
        part = unit[first : first + PLANE_SHOTS]
        seen = part[np.isfinite(part).all(axis=1)]
        if len(seen) < 3:
            continue
        normal = np.linalg.eigh(seen.T @ seen)[1][:, 0]
        normal = normal if normal @ before >= 0 else -normal
        before = normal
        down = normal * normal[2] - np.array([0.0, 0.0, 1.0])
        down /= max(math.hypot(normal[0], normal[1]), 1e-9)
        angle[first : first + PLANE_SHOTS] = np.arctan2(part @ np.cross(normal, down), part @ down)
    return wrap(angle)
