"""Finds vertical lines in points with only x, y, z (``input.lines = elevation:DEG``).

For files without missing shots and scan angles: the elevation rises along a line and drops to the first point of the
next one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from prc_cli.core.errors import ConfigError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.stream import Assumption
from prc_cli.formats.options import InputConfig, parse_rate
from prc_cli.formats.records import DerivedSource, RecordChunk, RecordSource
from prc_cli.streams.grid import GridStream

_XYZ = ("x", "y", "z")
_LINE = "line by elevation"
"""Name of the added column; the blank avoids clashes with dimensions."""


def with_elevation(source: RecordSource, config: InputConfig) -> tuple[RecordSource, InputConfig]:
    """Return the source with elevations as ``angle`` [rad] and line numbers, and the configuration to use them."""
    drop_deg = parse_rate(config.lines)
    if not 0 < abs(drop_deg) < 180:
        raise ConfigError("input.lines", f"found {config.lines!r}, expected elevation:DEG with 0 < |DEG| < 180")
    if config.range not in ("auto", "sensor-xyz"):
        problem = f"found {config.range!r}, expected sensor-xyz: the elevation is that of x, y, z from the scanner"
        raise ConfigError("input.range", problem, "add --range sensor-xyz, or find lines in another way")
    if not set(_XYZ) <= set(source.dimensions):
        problem = f"found {config.lines!r}, but {source.path} has no x, y, z"
        raise ConfigError("input.lines", problem, "find lines in another way: --lines")
    rules = config.model_copy(update={"lines": f"dimension:{_LINE}", "range": "sensor-xyz"})
    return _WithElevation(source, math.radians(drop_deg)), rules


def tell_elevation(stream: GridStream, rule: str) -> GridStream:
    """Return the stream of such a source with the assumptions reported, and -90 deg as straight down."""
    info = stream.info
    why = "lines end where the elevation of x, y, z jumps back; the scan angle is the elevation"
    assumptions = (Assumption("input.lines", rule, why), *info.assumptions)
    down_rad = None if info.angle_rad is None else -math.pi / 2
    return replace(stream, info=replace(info, assumptions=assumptions, down_rad=down_rad))


@dataclass(frozen=True)
class _WithElevation(DerivedSource):
    drop_rad: float

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names of the source, ``angle`` and the line."""
        return (*dict.fromkeys(("angle", *self.source.dimensions)), _LINE)

    @property
    def facts(self) -> SourceFacts:
        """Metadata of the source without notices, and without M, which is that of other lines."""
        return replace(self.source.facts, points_per_line=None, notes=())

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode the named dimensions; a point at the origin has no elevation and stays in the current line."""
        if not {"angle", _LINE} & set(names):
            yield from self.source.chunks(names)
            return
        own = tuple(name for name in names if name not in ("angle", _LINE))
        line, last = 0, np.nan
        for chunk in self.source.chunks(tuple(dict.fromkeys((*own, *_XYZ)))):
            x, y, z = (np.asarray(chunk.values[name], np.float64) for name in _XYZ)
            with np.errstate(over="ignore", invalid="ignore"):
                flat = np.hypot(x, y)
                angle = np.where((flat > 0) | (z != 0), np.arctan2(z, flat), np.nan)
            known = np.flatnonzero(~np.isnan(angle))
            begins = np.zeros(chunk.n, np.int64)
            if len(known):
                seen = angle[known]
                back = np.append(last, seen[:-1]) - seen
                begins[known] = back > self.drop_rad if self.drop_rad > 0 else back < self.drop_rad
                last = seen[-1]
            number = line + np.cumsum(begins)
            line = int(number[-1]) if chunk.n else line
            values = {name: chunk.values[name] for name in own}
            made = {"angle": angle, _LINE: number}
            yield replace(chunk, values={name: made[name] if name in made else values[name] for name in names})
