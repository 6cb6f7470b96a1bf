"""Objects grow line by line: runs of shots of one class in a line that lie near each other are one object.

An object is closed when no run has joined it for some lines, and cut when it gets too long. What is
kept of it does not grow with its size, so memory holds the objects in view.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.stream import LabelledBlock
from prc_cli.core.types import F64

GAP_COLUMNS = 2
"""Shots of other classes, or without return, that a run may skip."""
JUMP_M = 0.5
"""Difference in range at which a run ends [m]."""
Extent = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Rule:
    """When runs are of one object, and which objects are told."""

    side_m: float
    """Greatest distance of two runs to the side [m]."""
    up_m: float
    """Greatest distance of two runs in height [m]."""
    gap_lines: int
    """Lines without a run before the object is closed."""
    least_shots: int
    least_height_m: float = 0.0
    """From the lowest to the highest shot [m]."""
    most_lines: int = 4000
    """The object is cut there."""


RULES: dict[str, Rule] = {
    # branches hide a stem or a post for a metre or two
    "stem": Rule(0.3, 2.0, 4, 30, 1.0),
    "pole": Rule(0.3, 2.0, 2, 8, 1.0),
    "car": Rule(0.6, 0.8, 1, 60, 0.4),
    "curb": Rule(0.3, 0.25, 3, 20, most_lines=256),
}
"""By the name of the class."""


@dataclass(frozen=True, slots=True)
class Thing:
    """An object, as it passed."""

    id: int
    """In the order of the ends."""
    kind: str
    scanner: int
    first_line: int
    last_line: int
    first_column: int
    last_column: int
    n_shots: int
    range_m: float
    """Mean range of its shots [m]."""
    nearest_m: float
    """Least range [m]."""
    angle_deg: float
    """Mean angle of its shots from straight down [deg]; the sign is the side of the scan plane."""
    side_m: float
    """Mean distance to the side in the scan plane [m]."""
    width_m: float
    """Extent to the side in the scan plane [m]."""
    height_m: float
    """From the lowest to the highest shot in the scan plane [m]."""
    base_m: float
    """Lowest shot above the ground [m]; NaN = no ground known."""
    top_m: float
    """Highest shot above the ground [m]; NaN = no ground known."""
    x: float = math.nan
    """Middle of its registered coordinates [m]; NaN = the input has none."""
    y: float = math.nan
    z: float = math.nan
    confidence: float = math.nan
    """Mean confidence of its shots [per cent]; NaN = not asked for."""


@dataclass(slots=True, eq=False)
class Part:
    """Shots of one object: neighbours in a line, or runs that were joined."""

    kind: Label
    first_line: int
    last_line: int
    n: int
    columns: tuple[int, int]
    side_m: Extent
    """Least and greatest distance to the side in the scan plane [m]; the sign is the side."""
    up_m: Extent
    """Lowest and highest shot, above the scanner in the scan plane [m]."""
    above_m: Extent
    """The same above the ground [m]; NaN = unknown."""
    nearest_m: float
    sums: F64
    """(8,) float64, over the shots.

    Distance to the side, range, angle, 1 where coordinates are registered, these,
    confidence."""
    front: list[tuple[int, Extent, Extent]] = field(default_factory=list)
    """Line and extents of the last runs."""

    def join(self, other: Part) -> None:
        """Take all that another one holds."""
        self.first_line = min(self.first_line, other.first_line)
        self.last_line = max(self.last_line, other.last_line)
        self.n += other.n
        self.columns = (
            min(self.columns[0], other.columns[0]),
            max(self.columns[1], other.columns[1]),
        )
        self.side_m, self.up_m = _both(self.side_m, other.side_m), _both(self.up_m, other.up_m)
        self.above_m = _both(self.above_m, other.above_m)
        self.nearest_m = min(self.nearest_m, other.nearest_m)
        self.sums = self.sums + other.sums
        self.front += other.front

    def touches(self, run: Part, rule: Rule) -> bool:
        """Whether a run is near to one of the last lines."""
        return any(
            run.last_line - line <= rule.gap_lines + 1
            and run.side_m[0] - rule.side_m <= side[1]
            and side[0] <= run.side_m[1] + rule.side_m
            and run.up_m[0] - rule.up_m <= up[1]
            and up[0] <= run.up_m[1] + rule.up_m
            for line, side, up in self.front
        )


def _both(first: Extent, second: Extent) -> Extent:
    """Return the extent of two; NaN = unknown."""
    return float(np.fmin(first[0], second[0])), float(np.fmax(first[1], second[1]))


def runs_of(
    item: LabelledBlock, kinds: tuple[Label, ...], registered_m: F64 | None = None
) -> Iterator[Part]:
    """Find the runs of a block, line by line."""
    block = item.block
    assert block.beam_rad is not None
    at = np.flatnonzero(np.isin(item.labels.ravel(), kinds))
    if not len(at):
        return
    line, column = np.divmod(at, block.points_per_line)
    range_m = block.range_m.ravel()[at].astype(np.float64)
    label = item.labels.ravel()[at]
    beam = block.beam_rad[column]
    side = range_m * np.sin(beam)
    up = -range_m * np.cos(beam)
    unknown = np.full(len(at), np.nan)
    above = unknown if item.above_m is None else item.above_m.ravel()[at].astype(np.float64)
    sure = unknown if item.confidence is None else item.confidence.ravel()[at].astype(np.float64)
    xyz = np.full((len(at), 3), np.nan) if registered_m is None else registered_m.reshape(-1, 3)[at]
    is_new = np.ones(len(at), np.bool_)
    is_new[1:] = (
        (np.diff(line) != 0)
        | (np.diff(column) > GAP_COLUMNS + 1)
        | (label[1:] != label[:-1])
        | (np.abs(np.diff(range_m)) > JUMP_M)
    )
    start = np.flatnonzero(is_new)
    stop = np.append(start[1:], len(at))
    placed = np.asarray(np.isfinite(xyz).all(axis=1))
    total = np.add.reduceat(
        np.column_stack(
            [
                side,
                range_m,
                beam,
                placed.astype(np.float64),
                np.where(placed[:, None], xyz, 0.0),
                sure,
            ]
        ),
        start,
    )
    # fmin passes over what is not known
    low = np.fmin.reduceat(np.column_stack([side, up, above, range_m]), start).tolist()
    high = np.fmax.reduceat(np.column_stack([side, up, above]), start).tolist()
    for i, (first, end) in enumerate(zip(start.tolist(), stop.tolist(), strict=True)):
        where = block.first_line + int(line[first])
        (side_0, up_0, above_0, nearest_m) = low[i]
        (side_1, up_1, above_1) = high[i]
        yield Part(
            Label(int(label[first])),
            where,
            where,
            end - first,
            (int(column[first]), int(column[end - 1])),
            (side_0, side_1),
            (up_0, up_1),
            (above_0, above_1),
            nearest_m,
            total[i],
            [(where, (side_0, side_1), (up_0, up_1))],
        )


class Grower:
    """Grows the objects of one scanner."""

    def __init__(self, scanner: int, rules: dict[Label, Rule]) -> None:
        self._scanner = scanner
        self._rules = rules
        self._growing: dict[Label, list[Part]] = {label: [] for label in rules}

    def add(self, runs: Iterable[Part], line: int) -> list[Thing]:
        """Add the runs of a line; return the objects that ended before it, without numbers."""
        ended = self._end(line)
        for run in runs:
            rule = self._rules[run.kind]
            growing = self._growing[run.kind]
            near = [one for one in growing if one.touches(run, rule)]
            for other in near[1:]:
                near[0].join(other)
                growing.remove(other)
            if near:
                near[0].join(run)
                near[0].front = [
                    one for one in near[0].front if line - one[0] <= rule.gap_lines + 1
                ]
            else:
                growing.append(run)
        return ended

    def finish(self) -> list[Thing]:
        """Return all that is left."""
        return self._end(None)

    def _end(self, line: int | None) -> list[Thing]:
        """Close what no run joined for long, and cut what is too long.

        All where there are no more lines.
        """
        ended: list[Thing] = []
        for label, rule in self._rules.items():
            stay: list[Part] = []
            for one in self._growing[label]:
                is_open = (
                    line is not None
                    and line - one.last_line <= rule.gap_lines + 1
                    and one.last_line - one.first_line + 1 < rule.most_lines
                )
                if is_open:
                    stay.append(one)
                elif one.n >= rule.least_shots and one.up_m[1] - one.up_m[0] >= rule.least_height_m:
                    ended.append(self._thing(one))
            self._growing[label] = stay
        return sorted(
            ended,
            key=lambda thing: (thing.last_line, thing.first_line, thing.first_column, thing.kind),
        )

    def _thing(self, one: Part) -> Thing:
        side, range_m, angle, n_placed, *xyz, sure = one.sums.tolist()
        x, y, z = (value / n_placed if n_placed else math.nan for value in xyz)
        return Thing(
            id=-1,
            kind=one.kind.name.lower(),
            scanner=self._scanner,
            first_line=one.first_line,
            last_line=one.last_line,
            first_column=one.columns[0],
            last_column=one.columns[1],
            n_shots=one.n,
            range_m=range_m / one.n,
            nearest_m=one.nearest_m,
            angle_deg=math.degrees(angle / one.n),
            side_m=side / one.n,
            width_m=one.side_m[1] - one.side_m[0],
            height_m=one.up_m[1] - one.up_m[0],
            base_m=one.above_m[0],
            top_m=one.above_m[1],
            x=x,
            y=y,
            z=z,
            confidence=sure / one.n,
        )
