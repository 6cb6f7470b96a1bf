"""Possible curb points, and regions of vertical points that are curbs (Stamos et al. 2012, 6).

Regions are sets of points here, and grow by whole lines.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from operator import itemgetter

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
"""Labels of points whose region is decided."""
FIRST_OPEN = 4
"""Label of the first undecided region; the others follow."""


class Growing:
    """All regions, and the rules for curbs."""

    def __init__(self, n_sides: int, regions: OpenRegions, thresholds: CurbThresholds) -> None:
        self.thresholds = thresholds
        open_regions = [
            Region(
                side=int(regions.side[i]),
                low=float(regions.low_m[i]),
                high=float(regions.high_m[i]),
                possible=bool(regions.possible[i]),
            )
            for i in range(len(regions.side))
        ]
        self.region_of: dict[tuple[int, int, int], Region] = {}
        """Region of every vertical point, by side, line and beam."""
        for row, k in np.argwhere(regions.labels).tolist():
            line, side = divmod(row, n_sides)
            label = int(regions.labels[row, k])
            if label >= FIRST_OPEN:
                region = open_regions[label - FIRST_OPEN]
            else:
                region = Region(side, fate=FATES[label])
            region.points.add((line, k))
            self.region_of[side, line, k] = region

    def open(self, side: int) -> list[Region]:
        """Return the undecided regions of a side."""
        open_regions = [
            region
            for (side_of_point, _, _), region in self.region_of.items()
            if side_of_point == side and region.fate == "open"
        ]
        return list(dict.fromkeys(open_regions))

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
        touched: list[list[Region]] = []
        for k in beams:
            regions = []
            for j in (k - 1, k, k + 1):
                region = self.region_of.get((side, line - 1, j))
                is_growing = region is not None and region.fate in ("open", "high")
                if region and is_growing and self.are_near(here[k], above[j]):
                    regions.append(region)
            touched.append(regions)
        for members in self.groups(beams, here, touched):
            group = [beams[i] for i in members]
            z = here[group, 2].tolist()
            joined = Region(
                side,
                points={(line, k) for k in group},
                low=min(z),
                high=max(z),
                possible=possible in group,
            )
            for region in {region for i in members for region in touched[i]}:
                joined.points |= region.points
                joined.possible |= region.possible
                joined.low = min(joined.low, region.low)
                joined.high = max(joined.high, region.high)
                if region.fate == "high":
                    joined.fate = "high"
            if joined.high - joined.low > self.thresholds.max_height_m:
                joined.fate = "high"
            for point_line, k in joined.points:
                self.region_of[side, point_line, k] = joined

    def are_near(self, first: F64, second: F64) -> bool:
        """Return whether two points (3,) belong together."""
        x, y, z = first - second
        return bool(x * x + y * y + z * z < self.thresholds.grouping_m**2)

    def groups(
        self, beams: list[int], here: F64, touched: list[list[Region]]
    ) -> Iterator[list[int]]:
        """Iterate over groups of points of a row, as indices into its beams.

        Neighbours in the row belong together, and points that touch the same region above.
        """
        if not beams:
            return
        pairs: list[tuple[int, int]] = []
        for i, (j, k) in enumerate(pairwise(beams)):
            if j + 1 == k and self.are_near(here[k], here[j]):
                pairs.append((i, i + 1))
        first_at: dict[Region, int] = {}
        for i, regions in enumerate(touched):
            pairs.extend((first_at.setdefault(region, i), i) for region in regions)
        first, second = np.array(pairs, int).reshape(-1, 2).T
        graph = coo_array((np.ones(len(pairs)), (first, second)), shape=(len(beams), len(beams)))
        n_groups, group_of = connected_components(graph, directed=False)
        for number in range(n_groups):
            yield np.flatnonzero(np.equal(group_of, number)).tolist()

    def decide(self, region: Region, signed: F64) -> None:
        """Decide whether a region is a curb; ``signed``: the angles of its side by line."""
        region.fate = "rejected"
        height_m = float(region.high) - float(region.low)
        if not region.possible or height_m < self.thresholds.min_height_m:
            return
        changes = []
        for line, k in region.points:
            if (line, k - 1) in region.points:
                change = abs(signed[line, k] - signed[line, k - 1])
                if not np.isnan(change):
                    changes.append(change)
        n_lines = region.last - region.first + 1
        is_long = n_lines >= self.thresholds.min_lines
        if is_long or (changes and np.median(changes) < self.thresholds.curvature_deg):
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
    # the known angles are those of the last lines
    known = np.concatenate([above_signed, signed]).reshape(-1, n_sides, n)
    angles = np.full((n_lines + thresholds.min_lines, n_sides, n), np.nan)
    if len(known):
        angles[-len(known) :] = known
    angles = angles[thresholds.min_lines :]

    for row in range(len(surface)):
        new, side = divmod(row, n_sides)
        line = n_before + new
        beams = np.flatnonzero(surface[row] == VERTICAL).tolist()
        here = points[new + 1, side]
        above = points[new, side]
        growing.add_row(side, line, beams, here, above, int(possible[row]))
        for region in growing.open(side):
            if region.last < line or line - region.first + 1 >= thresholds.max_lines:
                growing.decide(region, angles[:, side])
    undecided = [region for side in range(n_sides) for region in growing.open(side)]
    if last:
        for region in undecided:
            growing.decide(region, angles[:, region.side])
        undecided = []

    # curbs up to the first open line, and the labels of the lines from it on
    first_open = min([region.first for region in undecided], default=n_lines)
    curb = np.zeros(((first_open - regions.n_given) * n_sides, n), dtype=bool)
    begin = min(first_open, n_lines - 1)
    labels = np.zeros(((n_lines - begin) * n_sides, n), dtype=np.int32)
    numbers = {fate: number for number, fate in FATES.items()}
    open_regions: list[Region] = []
    for side, line, k in sorted(growing.region_of, key=itemgetter(1, 0, 2)):
        region = growing.region_of[side, line, k]
        if regions.n_given <= line < first_open:
            curb[(line - regions.n_given) * n_sides + side, k] = region.fate == "curb"
        if line < begin:
            continue
        label = numbers.get(region.fate)
        if label is None:
            if region not in open_regions:
                open_regions.append(region)
            label = FIRST_OPEN + open_regions.index(region)
        labels[(line - begin) * n_sides + side, k] = label
    return curb, OpenRegions(
        labels=labels,
        n_given=n_lines - begin if first_open == n_lines else 0,
        side=np.array([region.side for region in open_regions], np.int32),
        first=np.array([region.first - begin for region in open_regions], np.int32),
        last=np.array([region.last - begin for region in open_regions], np.int32),
        possible=np.array([region.possible for region in open_regions], np.bool_),
        low_m=np.array([region.low for region in open_regions], np.float32),
        high_m=np.array([region.high for region in open_regions], np.float32),
    )
