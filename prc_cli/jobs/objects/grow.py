"""Grows objects line by line: neighbouring runs of shots of one class become one object.

An object is closed when no run has joined it for some lines, and cut when it gets too long. Its
record has a fixed size, so memory holds only the objects in view.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from prc_cli.core.classes import Label
from prc_cli.core.stream import LabelledBlock
from prc_cli.core.types import F64

GAP_COLUMNS = 2
"""Shots of other classes, or without return, that a run may skip."""
JUMP_M = 0.5
"""Difference in range at which a run ends [m]."""
Extent = tuple[float, float]
"""Least and greatest value [m]; NaN = unknown."""


@dataclass(frozen=True, slots=True)
class Rule:
    """When two runs belong to one object, and which objects are listed."""

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
    """An object that reaches this length is cut."""


RULES: dict[str, Rule] = {
    # branches hide a stem or a post for a metre or two
    "stem": Rule(0.3, 2.0, 4, 30, 1.0),
    "pole": Rule(0.3, 2.0, 2, 8, 1.0),
    "car": Rule(0.6, 0.8, 1, 60, 0.4),
    "curb": Rule(0.3, 0.25, 3, 20, most_lines=256),
}
"""By the name of the class."""


@dataclass(frozen=True, slots=True)
class ScanObject:
    """An object, as it passed."""

    id: int
    """Number, in the order in which the objects end."""
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
    """Mean confidence of its shots [per cent]; NaN = not computed."""


class RunExtent(NamedTuple):
    """Where a run was."""

    line: int
    side_m: Extent
    up_m: Extent


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
    """Lowest and highest shot above the ground [m]; NaN = unknown."""
    nearest_m: float
    sums: F64
    """(8,) float64, summed over the shots.

    Distance to the side, range, angle, 1 for registered coordinates, x, y, z, confidence.
    """
    front: list[RunExtent] = field(default_factory=list)
    """The last runs."""

    def join(self, part: Part) -> None:
        """Add the shots of another part."""
        self.first_line = min(self.first_line, part.first_line)
        self.last_line = max(self.last_line, part.last_line)
        self.n += part.n
        self.columns = (
            min(self.columns[0], part.columns[0]),
            max(self.columns[1], part.columns[1]),
        )
        self.side_m = _union(self.side_m, part.side_m)
        self.up_m = _union(self.up_m, part.up_m)
        self.above_m = _union(self.above_m, part.above_m)
        self.nearest_m = min(self.nearest_m, part.nearest_m)
        self.sums = self.sums + part.sums
        self.front += part.front

    def touches(self, run: Part, rule: Rule) -> bool:
        """Whether a run is near to one of the last runs."""
        return any(
            run.last_line - last.line <= rule.gap_lines + 1
            and run.side_m[0] - rule.side_m <= last.side_m[1]
            and last.side_m[0] <= run.side_m[1] + rule.side_m
            and run.up_m[0] - rule.up_m <= last.up_m[1]
            and last.up_m[0] <= run.up_m[1] + rule.up_m
            for last in self.front
        )


def _union(first: Extent, second: Extent) -> Extent:
    # fmin and fmax ignore NaN
    return float(np.fmin(first[0], second[0])), float(np.fmax(first[1], second[1]))


def runs_of(
    item: LabelledBlock, kinds: tuple[Label, ...], registered_m: F64 | None = None
) -> Iterator[Part]:
    """Find the runs of a block, line by line.

    ``registered_m`` is (L, M, 3) float64, the registered coordinates of the shots [m].
    """
    block = item.block
    assert block.beam_rad is not None
    shots = np.flatnonzero(np.isin(item.labels.ravel(), kinds))
    if not len(shots):
        return
    line, column = np.divmod(shots, block.points_per_line)
    range_m = block.range_m.ravel()[shots].astype(np.float64)
    label = item.labels.ravel()[shots]
    beam = block.beam_rad[column]
    side = range_m * np.sin(beam)
    up = -range_m * np.cos(beam)
    unknown = np.full(len(shots), np.nan)
    above = unknown if item.above_m is None else item.above_m.ravel()[shots].astype(np.float64)
    sure = unknown if item.confidence is None else item.confidence.ravel()[shots].astype(np.float64)
    xyz = (
        np.full((len(shots), 3), np.nan)
        if registered_m is None
        else registered_m.reshape(-1, 3)[shots]
    )
    is_new = np.ones(len(shots), np.bool_)
    is_new[1:] = (
        (np.diff(line) != 0)
        | (np.diff(column) > GAP_COLUMNS + 1)
        | (label[1:] != label[:-1])
        | (np.abs(np.diff(range_m)) > JUMP_M)
    )
    start = np.flatnonzero(is_new)
    stop = np.append(start[1:], len(shots))
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
    # fmin and fmax ignore NaN
    low = np.fmin.reduceat(np.column_stack([side, up, above, range_m]), start).tolist()
    high = np.fmax.reduceat(np.column_stack([side, up, above]), start).tolist()
    for i, (first, end) in enumerate(zip(start.tolist(), stop.tolist(), strict=True)):
        line_number = block.first_line + int(line[first])
        (least_side, lowest, least_above, nearest_m) = low[i]
        (greatest_side, highest, greatest_above) = high[i]
        side_m = (least_side, greatest_side)
        up_m = (lowest, highest)
        yield Part(
            kind=Label(int(label[first])),
            first_line=line_number,
            last_line=line_number,
            n=end - first,
            columns=(int(column[first]), int(column[end - 1])),
            side_m=side_m,
            up_m=up_m,
            above_m=(least_above, greatest_above),
            nearest_m=nearest_m,
            sums=total[i],
            front=[RunExtent(line_number, side_m, up_m)],
        )


class Grower:
    """Grows the objects of one scanner."""

    def __init__(self, scanner: int, rules: dict[Label, Rule]) -> None:
        self._scanner = scanner
        self._rules = rules
        self._growing: dict[Label, list[Part]] = {label: [] for label in rules}

    def add(self, runs: Iterable[Part], line: int) -> list[ScanObject]:
        """Add the runs of a line; return the objects that ended before it, without numbers."""
        ended = self._end(line)
        for run in runs:
            rule = self._rules[run.kind]
            growing = self._growing[run.kind]
            near = [part for part in growing if part.touches(run, rule)]
            if not near:
                growing.append(run)
                continue
            first, *others = near
            for part in others:
                first.join(part)
                growing.remove(part)
            first.join(run)
            first.front = [last for last in first.front if line - last.line <= rule.gap_lines + 1]
        return ended

    def finish(self) -> list[ScanObject]:
        """Close all objects and return them."""
        return self._end(None)

    def _end(self, line: int | None) -> list[ScanObject]:
        """Close the objects that no run has joined for long or that are too long; all, if None."""
        ended: list[ScanObject] = []
        for label, rule in self._rules.items():
            stay: list[Part] = []
            for part in self._growing[label]:
                is_open = (
                    line is not None
                    and line - part.last_line <= rule.gap_lines + 1
                    and part.last_line - part.first_line + 1 < rule.most_lines
                )
                if is_open:
                    stay.append(part)
                elif (
                    part.n >= rule.least_shots
                    and part.up_m[1] - part.up_m[0] >= rule.least_height_m
                ):
                    ended.append(self._summary(part))
            self._growing[label] = stay
        return sorted(
            ended,
            key=attrgetter("last_line", "first_line", "first_column", "kind"),
        )

    def _summary(self, part: Part) -> ScanObject:
        side, range_m, angle, n_placed, *xyz, confidence = part.sums.tolist()
        x, y, z = (value / n_placed if n_placed else math.nan for value in xyz)
        return ScanObject(
            id=-1,
            kind=part.kind.name.lower(),
            scanner=self._scanner,
            first_line=part.first_line,
            last_line=part.last_line,
            first_column=part.columns[0],
            last_column=part.columns[1],
            n_shots=part.n,
            range_m=range_m / part.n,
            nearest_m=part.nearest_m,
            angle_deg=math.degrees(angle / part.n),
            side_m=side / part.n,
            width_m=part.side_m[1] - part.side_m[0],
            height_m=part.up_m[1] - part.up_m[0],
            base_m=part.above_m[0],
            top_m=part.above_m[1],
            x=x,
            y=y,
            z=z,
            confidence=confidence / part.n,
        )
