"""Loops for curbs: possible curbs of rows, and regions of vertical points across lines.

Stamos et al. (2012), sec. 6. Regions grow line by line, so a region is complete as soon as a line
adds nothing to it. Regions that are too high for a curb, mostly walls, are merged into one label
and cost hardly any time.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import F32, F32_1, F32_2, F32_3, I32, I32_1, U8, U8_2, Mask, Mask_2
from prc_cli.core.union_find_loops import find_root
from prc_cli.methods.sequential_angle.thresholds import CurbThresholds, OpenRegions

NONE = 0
HIGH = 1
REJECTED = 2
CURB = 3
FIRST_REGION = 4
"""Labels: not vertical; too high for a curb; decided, no curb; decided, a curb; from here on
undecided regions."""

_MISSING = 0
_VERTICAL = 3


class _Table(NamedTuple):
    """All regions by label, including the fixed ones, and the labels of all lines.

    Read its arrays before a loop, not in it: numba counts the reference every time.
    """

    parent: I32
    """Label of the region that this one is a part of; its own label if it is a whole region."""
    side: I32
    first: I32
    """First line."""
    last: I32
    """Last line."""
    possible: Mask
    """Whether there is a possible curb point."""
    low: F32
    """Lowest height [m]."""
    high: F32
    """Highest height [m]."""
    labels: I32
    """(lines * sides, n) int32, label of every point."""


@inlined
def _lies_over(
    farthest: F32,
    count: int,
    reach: int,
    range_here: float,
    under: float,
) -> bool:
    """Whether one of the valid points before is farther away than a point."""
    most = range_here
    for i in range(max(count - reach, 0), count):
        most = max(most, farthest[i])
    return bool(np.float64(most) - np.float64(range_here) > under)


@loop("prc_cli.reference.sequential_angle.curb")
def possible_curbs(
    surface: U8_2,
    range_m: F32_2,
    xyz: F32_3,
    ground: Mask_2,
    z_g: F32_1,
    thresholds: CurbThresholds,
) -> I32_1:
    """Find the first vertical point after the ground of every row that nothing lies under.

    ``surface`` (R, n) uint8; ``range_m`` (R, n) float32, metres; ``xyz`` (R, n, 3) float32, metres;
    ``ground`` (R, n) bool; ``z_g`` (R,) float32, metres; returns (R,) int32, -1 = none.
    """
    n_rows, n = surface.shape
    reach = thresholds.under_points
    under = thresholds.under_m
    beam = np.full(n_rows, -1, np.int32)
    farthest = np.empty(n + 1, np.float32)
    for row in range(n_rows):
        last = n - 1
        while last >= 0 and not ground[row, last]:
            last -= 1
        if last < 0:
            continue
        limit = np.float64(z_g[row]) + thresholds.search_height_m
        # ranges of the valid points, from the first that can matter
        first = last
        n_wanted = reach
        while first > 0 and n_wanted > 0:
            n_wanted -= surface[row, first] != _MISSING
            first -= 1
        count = int(np.int64(0))
        for k in range(first, n):
            kind = surface[row, k]
            if kind == _MISSING:
                continue
            range_here = range_m[row, k]
            if k > last and np.float64(xyz[row, k, 2]) > limit:
                break
            if (
                k > last
                and kind == _VERTICAL
                and not _lies_over(farthest, count, reach, range_here, under)
            ):
                beam[row] = k
                break
            farthest[count] = range_here
            count += 1
    return beam


@inlined
def _near(
    here: F32,
    k: int,
    there: F32,
    j: int,
    reach_2: float,
) -> bool:
    """Whether two points are within the grouping distance; ``reach_2`` is its square [m2]."""
    dx = np.float64(here[k, 0]) - np.float64(there[j, 0])
    dy = np.float64(here[k, 1]) - np.float64(there[j, 1])
    dz = np.float64(here[k, 2]) - np.float64(there[j, 2])
    return bool(dx * dx + dy * dy + dz * dz < reach_2)


@inlined
def _join(
    table: _Table,
    region: int,
    region_above: int,
    thresholds: CurbThresholds,
) -> int:
    """Join two regions; return the label of the joined one."""
    parent = table.parent
    last = table.last
    low = table.low
    high = table.high
    if region == HIGH or region_above == HIGH:
        parent[region] = HIGH
        parent[region_above] = HIGH
        return HIGH
    kept = min(region, region_above)
    dropped = max(region, region_above)
    parent[dropped] = kept
    low[kept] = min(low[region], low[region_above])
    high[kept] = max(high[region], high[region_above])
    table.first[kept] = min(table.first[region], table.first[region_above])
    last[kept] = max(last[region], last[region_above])
    table.possible[kept] = table.possible[region] or table.possible[region_above]
    if np.float64(high[kept]) - np.float64(low[kept]) > thresholds.max_height_m:
        parent[kept] = HIGH
        return HIGH
    return kept


@helper
def _is_straight(
    table: _Table,
    signed: F32,
    above_signed: F32,
    region: int,
    n_sides: int,
    limit: float,
) -> bool:
    """Whether the median change of the angle from point to point of a region is small."""
    parent = table.parent
    labels = table.labels
    side = table.side[region]
    n_before = (len(labels) - len(signed)) // n_sides
    n_below = 0
    n_larger = 0
    largest_below = -np.inf
    smallest_larger = np.inf
    for line in range(table.first[region], table.last[region] + 1):
        line_labels = labels[line * n_sides + side]
        new = line - n_before
        if new >= 0:
            angles = signed[new * n_sides + side]
        else:  # lines of earlier calls
            angles = above_signed[len(above_signed) + new * n_sides + side]
        for k in range(1, len(line_labels)):
            if line_labels[k] < FIRST_REGION or line_labels[k - 1] < FIRST_REGION:
                continue
            if (
                find_root(parent, line_labels[k]) != region
                or find_root(parent, line_labels[k - 1]) != region
            ):
                continue
            change = abs(np.float64(angles[k]) - np.float64(angles[k - 1]))
            if change < limit:
                n_below += 1
                largest_below = max(largest_below, change)
            elif change >= limit:  # neither holds for NaN
                n_larger += 1
                smallest_larger = min(smallest_larger, change)
    if n_below == n_larger:  # the median lies between the two
        return n_below > 0 and (largest_below + smallest_larger) / 2.0 < limit
    return n_below > n_larger


@helper
def _decide(
    table: _Table,
    signed: F32,
    above_signed: F32,
    region: int,
    n_sides: int,
    thresholds: CurbThresholds,
) -> None:

    accepted = False
    high_m = np.float64(table.high[region]) - np.float64(table.low[region])
    if table.possible[region] and high_m >= thresholds.min_height_m:
        n_lines = table.last[region] - table.first[region] + 1
        accepted = n_lines >= thresholds.min_lines or _is_straight(
            table, signed, above_signed, region, n_sides, thresholds.curvature_deg
        )
    table.parent[region] = CURB if accepted else REJECTED


@helper
def _connect_row(
    table: _Table,
    surface: U8,
    here: F32,
    above: F32,
    row: int,
    n_sides: int,
    start: int,
    n_ids: int,
    thresholds: CurbThresholds,
) -> int:
    """Label the vertical points of a row; join them to each other and to those of the row above.

    ``row`` counts from the start of the labels. New regions are numbered from ``n_ids`` on; returns
    their number.
    """
    n = len(surface)
    side = row % n_sides
    line = row // n_sides
    row_labels = table.labels[row]
    labels_above = table.labels[row - n_sides]
    parent = table.parent
    low = table.low
    high = table.high
    sides = table.side
    first = table.first
    last = table.last
    possible = table.possible
    reach_2 = thresholds.grouping_m * thresholds.grouping_m
    n_new = 0
    for k in range(n):
        if surface[k] != _VERTICAL:
            row_labels[k] = NONE
            continue
        z = here[k, 2]
        label = NONE
        if k > 0 and row_labels[k - 1] != NONE and _near(here, k, here, k - 1, reach_2):
            label = find_root(parent, row_labels[k - 1])
            if label != HIGH:
                low[label] = min(low[label], z)
                high[label] = max(high[label], z)
                if np.float64(high[label]) - np.float64(low[label]) > thresholds.max_height_m:
                    parent[label] = HIGH
                    label = HIGH
        else:
            label = n_ids + n_new
            parent[label] = label
            sides[label] = side
            first[label] = last[label] = line
            possible[label] = False
            low[label] = high[label] = z
            n_new += 1
        for j in range(max(k - 1, 0), min(k + 2, n)):
            if labels_above[j] == NONE:
                continue
            region_above = find_root(parent, labels_above[j])
            if region_above in (label, REJECTED, CURB) or not _near(here, k, above, j, reach_2):
                continue
            label = _join(table, label, region_above, thresholds)
        if k == start and label != HIGH:
            possible[label] = True
        row_labels[k] = label
    return n_new


@helper
def _open_table(
    regions: OpenRegions,
    n_sides: int,
    n_lines: int,
    capacity: int,
) -> _Table:
    """Return a table of the open regions with room for ``n_lines`` and ``capacity`` labels."""
    n = regions.labels.shape[1]
    labels = np.empty((n_lines * n_sides, n), np.int32)
    before = regions.labels
    for row in range(len(before)):
        for k in range(n):
            labels[row, k] = before[row, k]
    table = _Table(
        parent=np.empty(capacity, np.int32),
        side=np.empty(capacity, np.int32),
        first=np.empty(capacity, np.int32),
        last=np.empty(capacity, np.int32),
        possible=np.empty(capacity, np.bool_),
        low=np.empty(capacity, np.float32),
        high=np.empty(capacity, np.float32),
        labels=labels,
    )
    for label in range(FIRST_REGION + len(regions.side)):
        table.parent[label] = label
    for i in range(len(regions.side)):
        label = FIRST_REGION + i
        table.side[label] = regions.side[i]
        table.first[label] = regions.first[i]
        table.last[label] = regions.last[i]
        table.possible[label] = regions.possible[i]
        table.low[label] = regions.low_m[i]
        table.high[label] = regions.high_m[i]
    return table


@helper
def _carry(
    table: _Table,
    n_sides: int,
    begin: int,
    n_given: int,
    n_ids: int,
) -> OpenRegions:
    """Return rows and regions for the next call, with new labels in the order of the rows."""
    labels = table.labels
    parent = table.parent
    n_rows, n = labels.shape
    first_row = begin * n_sides
    open_labels = np.empty((n_rows - first_row, n), np.int32)
    number = np.zeros(n_ids, np.int32)
    number[HIGH] = HIGH
    number[REJECTED] = REJECTED
    number[CURB] = CURB
    n_open = 0
    for row in range(n_rows - first_row):
        for k in range(n):
            label = labels[row + first_row, k]
            label = find_root(parent, label) if label > HIGH else label
            if label != NONE and number[label] == 0:
                number[label] = FIRST_REGION + n_open
                n_open += 1
            open_labels[row, k] = number[label]
    open_regions = OpenRegions(
        labels=open_labels,
        n_given=n_given,
        side=np.empty(n_open, np.int32),
        first=np.empty(n_open, np.int32),
        last=np.empty(n_open, np.int32),
        possible=np.empty(n_open, np.bool_),
        low_m=np.empty(n_open, np.float32),
        high_m=np.empty(n_open, np.float32),
    )
    for label in range(FIRST_REGION, n_ids):
        if number[label] != 0:
            i = number[label] - FIRST_REGION
            open_regions.side[i] = table.side[label]
            open_regions.first[i] = table.first[label] - begin
            open_regions.last[i] = table.last[label] - begin
            open_regions.possible[i] = table.possible[label]
            open_regions.low_m[i] = table.low[label]
            open_regions.high_m[i] = table.high[label]
    return open_regions


@loop("prc_cli.reference.sequential_angle.curb")
def connect_verticals(
    surface: U8_2,
    xyz: F32_3,
    signed: F32_2,
    possible: I32_1,
    n_sides: int,
    above_xyz: F32_3,
    above_signed: F32_2,
    regions: OpenRegions,
    thresholds: CurbThresholds,
    last: bool,
) -> tuple[Mask_2, OpenRegions]:
    """Connect vertical points across lines and decide which of the regions are curbs.

    ``surface`` (R, n) uint8; ``xyz`` (R, n, 3) float32, metres; ``signed`` (R, n) float32, degrees;
    ``possible`` (R,) int32; ``above_xyz`` (n_sides, n, 3) float32, metres; returns ``curb`` (F, n)
    bool.
    """
    n_rows, n = surface.shape
    n_before = len(regions.labels)
    n_lines = (n_before + n_rows) // n_sides
    n_vertical = 0
    for row in range(n_rows):
        for k in range(n):
            n_vertical += surface[row, k] == _VERTICAL
    n_ids = FIRST_REGION + len(regions.side)
    table = _open_table(regions, n_sides, n_lines, n_ids + n_vertical)
    parent = table.parent
    first_line = table.first
    last_line = table.last
    labels = table.labels
    undecided = np.empty((n_sides, n_ids + n_vertical), np.int32)
    n_undecided = np.zeros(n_sides, np.int64)
    for label in range(FIRST_REGION, n_ids):
        side = table.side[label]
        undecided[side, n_undecided[side]] = label
        n_undecided[side] += 1

    for row in range(n_rows):
        side = row % n_sides
        line = (n_before + row) // n_sides
        above = xyz[row - n_sides] if row >= n_sides else above_xyz[side]
        n_new = _connect_row(
            table,
            surface[row],
            xyz[row],
            above,
            n_before + row,
            n_sides,
            possible[row],
            n_ids,
            thresholds,
        )
        for label in range(n_ids, n_ids + n_new):
            undecided[side, n_undecided[side]] = label
            n_undecided[side] += 1
        n_ids += n_new
        # regions without a point in this line are complete
        kept = 0
        for i in range(n_undecided[side]):
            label = undecided[side, i]
            if parent[label] != label:
                continue
            if last_line[label] == line and line - first_line[label] + 1 < thresholds.max_lines:
                undecided[side, kept] = label
                kept += 1
            else:
                _decide(table, signed, above_signed, label, n_sides, thresholds)
        n_undecided[side] = kept

    first_open = n_lines
    for side in range(n_sides):
        for i in range(n_undecided[side]):
            label = undecided[side, i]
            if last:
                _decide(table, signed, above_signed, label, n_sides, thresholds)
            else:
                first_open = min(first_open, first_line[label])

    curb = np.empty(((first_open - regions.n_given) * n_sides, n), np.bool_)
    for row in range(len(curb)):
        for k in range(n):
            label = labels[row + regions.n_given * n_sides, k]
            curb[row, k] = label > HIGH and find_root(parent, label) == CURB
    begin = min(first_open, n_lines - 1)
    n_given = n_lines - begin if first_open == n_lines else 0
    return curb, _carry(table, n_sides, begin, n_given, n_ids)
