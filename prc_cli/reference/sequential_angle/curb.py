"""Possible curb points, and regions of vertical points that are curbs (Stamos et al. 2012, 6).

Regions are sets of points here, and grow by whole lines.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from prc_cli.core.classes import Surface
from prc_cli.core.types import F32, F64, I32, U8, Mask
from prc_cli.methods.sequential_angle.thresholds import CurbThresholds, OpenRegions

MISSING = int(Surface.MISSING)
VERTICAL = int(Surface.VERTICAL)


def possible_curbs(
    surface: U8,
    range_m: F32,
    xyz: F32,
    ground: Mask,
    z_g: F32,
    thresholds: CurbThresholds,
) -> I32:
    """Find possible curb points; see :func:`curb_loops.possible_curbs`."""
    beam = np.full(len(surface), -1, dtype=np.int32)
    for row in range(len(surface)):
        on_ground = np.flatnonzero(ground[row])
        if not len(on_ground):
            continue
        valid = np.flatnonzero(surface[row] != MISSING)
        ranges = range_m[row].astype(np.float64)
        for k in valid[valid > on_ground[-1]]:
            if float(xyz[row, k, 2]) > float(z_g[row]) + thresholds.search_height_m:
                break
            if surface[row, k] == VERTICAL:
                before = valid[valid <= k][-1 - thresholds.under_points :]
                if not ranges[before].max() - ranges[k] > thresholds.under_m:
                    beam[row] = k
                    break
    return beam


@dataclass(eq=False)
class Region:
    """A region of vertical points of one side."""

    side: int
    points: set[tuple[int, int]] = field(default_factory=set)
    """Line and beam."""
    low: float = np.inf
    high: float = -np.inf
    possible: bool = False
    fate: str = "open"
    """Or "high", "rejected", "curb"."""

    @property
    def first(self) -> int:
        """First line."""
        return min(line for line, _ in self.points)

    @property
    def last(self) -> int:
        """Last line."""
        return max(line for line, _ in self.points)


FATES = {1: "high", 2: "rejected", 3: "curb"}


class Growing:
    """All regions, and the rules for curbs."""

    def __init__(self, n_sides: int, regions: OpenRegions, thresholds: CurbThresholds) -> None:
        self.thresholds = thresholds
        known = [
            Region(int(side), low=float(low), high=float(high), possible=bool(possible))
            for side, low, high, possible in zip(
                regions.side, regions.low_m, regions.high_m, regions.possible, strict=True
            )
        ]
        self.of: dict[tuple[int, int, int], Region] = {}
        """Region of every vertical point, by side, line and beam."""
        for row, k in zip(*np.nonzero(regions.labels), strict=True):
            side = int(row) % n_sides
            line = int(row) // n_sides
            label = int(regions.labels[row, k])
            region = known[label - 4] if label >= 4 else Region(side, fate=FATES[label])
            region.points.add((line, int(k)))
            self.of[side, line, int(k)] = region

    def open(self, side: int) -> list[Region]:
        """Return the undecided regions of a side."""
        open_regions = {
            id(region): region
            for (of, _, _), region in self.of.items()
            if of == side and region.fate == "open"
        }
        return list(open_regions.values())

    def add_row(
        self,
        side: int,
        line: int,
        beams: list[int],
        here: F64,
        above: F64,
        possible: int,
    ) -> None:
        """Add the vertical points of a row."""

        def near(a: F64, b: F64) -> bool:
            x, y, z = a - b
            return bool(x * x + y * y + z * z < self.thresholds.grouping_m**2)

        above_of = {
            k: [
                self.of[side, line - 1, j]
                for j in (k - 1, k, k + 1)
                if (side, line - 1, j) in self.of and near(here[k], above[j])
            ]
            for k in beams
        }
        touched = {
            k: [region for region in above_of[k] if region.fate in ("open", "high")] for k in beams
        }
        # neighbours in the row belong together, and points that touch the same region above
        pairs = [
            (i, i + 1)
            for i, (j, k) in enumerate(pairwise(beams))
            if j + 1 == k and near(here[k], here[j])
        ]
        first_at: dict[int, int] = {}
        for i, k in enumerate(beams):
            pairs += [(first_at.setdefault(id(region), i), i) for region in touched[k]]
        first, second = np.array(pairs, int).reshape(-1, 2).T
        graph = coo_array((np.ones(len(pairs)), (first, second)), shape=(len(beams), len(beams)))
        n_groups, group_of = connected_components(graph, directed=False) if beams else (0, [])
        for number in range(n_groups):
            group = {beams[i] for i in np.flatnonzero(np.equal(group_of, number)).tolist()}
            joined = Region(side, {(line, k) for k in group}, possible=possible in group)
            z = [float(here[k, 2]) for k in group]
            joined.low = min(z)
            joined.high = max(z)
            for region in {id(region): region for k in group for region in touched[k]}.values():
                joined.points |= region.points
                joined.possible |= region.possible
                if region.fate == "high":
                    joined.fate = "high"
                joined.low, joined.high = min(joined.low, region.low), max(joined.high, region.high)
            if joined.high - joined.low > self.thresholds.max_height_m:
                joined.fate = "high"
            for point_line, k in joined.points:
                self.of[side, point_line, k] = joined

    def decide(self, region: Region, signed: F64) -> None:
        """Decide whether a region is a curb; ``signed``: the angles of its side by line."""
        region.fate = "rejected"
        if (
            not region.possible
            or float(region.high) - float(region.low) < self.thresholds.min_height_m
        ):
            return
        changes = [
            abs(signed[line, k] - signed[line, k - 1])
            for line, k in region.points
            if (line, k - 1) in region.points
        ]
        changes = [change for change in changes if not np.isnan(change)]
        many = region.last - region.first + 1 >= self.thresholds.min_lines
        if many or (changes and np.median(changes) < self.thresholds.curvature_deg):
            region.fate = "curb"


def connect_verticals(
    surface: U8,
    xyz: F32,
    signed: F32,
    possible: I32,
    n_sides: int,
    above_xyz: F32,
    above_signed: F32,
    regions: OpenRegions,
    thresholds: CurbThresholds,
    last: bool,
) -> tuple[Mask, OpenRegions]:
    """Connect vertical points; see :func:`curb_loops.connect_verticals`."""
    growing = Growing(n_sides, regions, thresholds)
    n = surface.shape[1]
    n_before = len(regions.labels) // n_sides
    n_new = len(surface) // n_sides
    n_lines = n_before + n_new
    points = np.concatenate([above_xyz, xyz]).astype(np.float64).reshape(n_new + 1, n_sides, n, 3)
    angles = np.full((n_lines + thresholds.min_lines, n_sides, n), np.nan)
    known = np.concatenate([above_signed, signed]).reshape(-1, n_sides, n)
    if len(known):
        angles[-len(known) :] = known
    angles = angles[thresholds.min_lines :]
    for row in range(len(surface)):
        side = row % n_sides
        new = row // n_sides
        line = n_before + new
        beams = np.flatnonzero(surface[row] == VERTICAL).tolist()
        growing.add_row(
            side, line, beams, points[new + 1, side], points[new, side], int(possible[row])
        )
        for region in growing.open(side):
            if region.last < line or line - region.first + 1 >= thresholds.max_lines:
                growing.decide(region, angles[:, side])
    undecided = [region for side in range(n_sides) for region in growing.open(side)]
    if last:
        for region in undecided:
            growing.decide(region, angles[:, region.side])
        undecided = []
    first_open = min([region.first for region in undecided], default=n_lines)

    curb = np.zeros(((first_open - regions.n_given) * n_sides, n), dtype=bool)
    begin = min(first_open, n_lines - 1)
    left = np.zeros(((n_lines - begin) * n_sides, n), dtype=np.int32)
    order: list[Region] = []
    for side, line, k in sorted(growing.of, key=lambda key: (key[1], key[0], key[2])):
        region = growing.of[side, line, k]
        if regions.n_given <= line < first_open:
            curb[(line - regions.n_given) * n_sides + side, k] = region.fate == "curb"
        if line >= begin:
            if region.fate == "open" and region not in order:
                order.append(region)
            number = (
                4 + order.index(region)
                if region.fate == "open"
                else {v: i for i, v in FATES.items()}[region.fate]
            )
            left[(line - begin) * n_sides + side, k] = number
    return curb, OpenRegions(
        labels=left,
        n_given=n_lines - begin if first_open == n_lines else 0,
        side=np.array([region.side for region in order], np.int32),
        first=np.array([region.first - begin for region in order], np.int32),
        last=np.array([region.last - begin for region in order], np.int32),
        possible=np.array([region.possible for region in order], np.bool_),
        low_m=np.array([region.low for region in order], np.float32),
        high_m=np.array([region.high for region in order], np.float32),
    )
