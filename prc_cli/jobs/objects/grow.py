"""Objects grow line by line: runs that lie near each other are one object.

An object is closed when no run has joined it for some lines, and cut when it gets too long. What is kept of it does not
grow with its size, so memory holds the objects in view.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from prc_cli.core.classes import Label
from prc_cli.jobs.objects.runs import Run


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


@dataclass(slots=True)
class _Growing:
    """An object that may still grow."""

    first: Run
    last_line: int
    front: list[Run] = field(default_factory=list)
    """Runs of the last lines."""
    n: int = 0
    columns: tuple[int, int] = (1 << 62, -1)
    side: tuple[float, float] = (math.inf, -math.inf)
    up: tuple[float, float] = (math.inf, -math.inf)
    above: tuple[float, float] = (math.nan, math.nan)
    nearest_m: float = math.inf
    sums: tuple[float, float, float] = (0.0, 0.0, 0.0)
    n_placed: int = 0
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sure: float = 0.0

    def add(self, run: Run, gap_lines: int) -> None:
        """Add a run of this line."""
        self.last_line = run.line
        self.front = [one for one in self.front if run.line - one.line <= gap_lines]
        self.front.append(run)
        self.n += run.n
        self.columns = min(self.columns[0], run.first_column), max(self.columns[1], run.last_column)
        self.side = min(self.side[0], run.side_m[0]), max(self.side[1], run.side_m[1])
        self.up = min(self.up[0], run.up_m[0]), max(self.up[1], run.up_m[1])
        self.above = _known(min, self.above[0], run.above_m[0]), _known(max, self.above[1], run.above_m[1])
        self.nearest_m = min(self.nearest_m, run.least_range_m)
        self.sums = _plus(self.sums, (run.sum_side_m, run.sum_range_m, run.sum_angle_rad))
        self.n_placed += run.n_placed
        self.xyz = _plus(self.xyz, run.sum_xyz_m)
        self.sure += run.sum_confidence

    def join(self, other: _Growing) -> None:
        """Take all that another one holds."""
        self.first = min(self.first, other.first, key=lambda run: run.line)
        self.last_line = max(self.last_line, other.last_line)
        self.front += other.front
        self.n += other.n
        self.columns = min(self.columns[0], other.columns[0]), max(self.columns[1], other.columns[1])
        self.side = min(self.side[0], other.side[0]), max(self.side[1], other.side[1])
        self.up = min(self.up[0], other.up[0]), max(self.up[1], other.up[1])
        self.above = _known(min, self.above[0], other.above[0]), _known(max, self.above[1], other.above[1])
        self.nearest_m = min(self.nearest_m, other.nearest_m)
        self.sums = _plus(self.sums, other.sums)
        self.n_placed += other.n_placed
        self.xyz = _plus(self.xyz, other.xyz)
        self.sure += other.sure

    def touches(self, run: Run, rule: Rule) -> bool:
        """Whether a run is near to one of the last lines."""
        return any(
            run.line - one.line <= rule.gap_lines + 1
            and run.side_m[0] - rule.side_m <= one.side_m[1]
            and one.side_m[0] <= run.side_m[1] + rule.side_m
            and run.up_m[0] - rule.up_m <= one.up_m[1]
            and one.up_m[0] <= run.up_m[1] + rule.up_m
            for one in self.front
        )


class Grower:
    """Grows the objects of one scanner.

    >>> grower = Grower(0, {Label.STEM: Rule(0.3, 2.0, 2, 3)})
    >>> run = Run(0, Label.STEM, 5, 7, 11, (3.0, 3.1), (-1.0, 1.0), 15.0, 16.0, 5.0, 3.0, (0.1, 2.1))
    >>> [grower.add([run], 0), [(thing.kind, thing.side_m) for thing in grower.add([], 4)]]
    [[], [('stem', 3.0)]]
    """

    def __init__(self, scanner: int, rules: dict[Label, Rule]) -> None:
        self._scanner, self._rules = scanner, rules
        self._growing: dict[Label, list[_Growing]] = {label: [] for label in rules}

    def add(self, runs: Iterable[Run], line: int) -> list[Thing]:
        """Add the runs of a line; return the objects that ended before it, without numbers."""
        ended = self._end(line)
        for run in runs:
            rule, growing = self._rules[run.kind], self._growing[run.kind]
            near = [one for one in growing if one.touches(run, rule)]
            if not near:
                near = [_Growing(run, run.line)]
                growing.append(near[0])
            for other in near[1:]:
                near[0].join(other)
                growing.remove(other)
            near[0].add(run, rule.gap_lines + 1)
        return ended

    def finish(self) -> list[Thing]:
        """Return all that is left."""
        return self._end(None)

    def _end(self, line: int | None) -> list[Thing]:
        """Close what no run joined for long, and cut what is too long; all where there are no more lines."""
        ended: list[Thing] = []
        for label, rule in self._rules.items():
            stay: list[_Growing] = []
            for one in self._growing[label]:
                is_open = (
                    line is not None
                    and line - one.last_line <= rule.gap_lines + 1
                    and one.last_line - one.first.line + 1 < rule.most_lines
                )
                if is_open:
                    stay.append(one)
                elif one.n >= rule.least_shots and one.up[1] - one.up[0] >= rule.least_height_m:
                    ended.append(self._thing(one))
            self._growing[label] = stay
        return sorted(ended, key=lambda thing: (thing.last_line, thing.first_line, thing.first_column, thing.kind))

    def _thing(self, one: _Growing) -> Thing:
        side, range_m, angle = (value / one.n for value in one.sums)
        x, y, z = (value / one.n_placed if one.n_placed else math.nan for value in one.xyz)
        return Thing(
            id=-1, kind=one.first.kind.name.lower(), scanner=self._scanner, first_line=one.first.line,
            last_line=one.last_line, first_column=one.columns[0], last_column=one.columns[1], n_shots=one.n,
            range_m=range_m, nearest_m=one.nearest_m, angle_deg=math.degrees(angle), side_m=side,
            width_m=one.side[1] - one.side[0], height_m=one.up[1] - one.up[0], base_m=one.above[0],
            top_m=one.above[1], x=x, y=y, z=z, confidence=one.sure / one.n,
        )  # fmt: skip


def _known(choose: Callable[[float, float], float], first: float, second: float) -> float:
    """Return the lesser or greater of two values that are known."""
    if math.isnan(first):
        return second
    return first if math.isnan(second) else choose(first, second)


def _plus(first: tuple[float, float, float], second: tuple[float, float, float]) -> tuple[float, float, float]:
    return first[0] + second[0], first[1] + second[1], first[2] + second[2]
