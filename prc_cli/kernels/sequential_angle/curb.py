"""Loops for curbs: where one may begin in a row, and regions of vertical points across lines (Stamos et al. 2012, 6).

Regions grow line by line, so that a region is known to be complete as soon as a line adds nothing to it. What can no
longer be a curb because it is too high, walls above all, is merged into one label and costs next to nothing.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F32, I32, U8, Mask
from prc_cli.kernels.cache import helper, inlined, kernel

NONE, HIGH, REJECTED, CURB, FIRST_REGION = 0, 1, 2, 3, 4
"""Labels: not vertical; too high for a curb; decided, not a curb; decided, a curb; from here on regions undecided."""

_MISSING = 0
_VERTICAL = 3


@kernel(
    "Tuple((boolean[::1], int32[::1]))(uint8[:, ::1], float32[:, ::1], float32[:, :, ::1], boolean[:, ::1], "
    "float32[::1], int64, float64, float64)"
)
def possible_curbs(
    surface: U8, range_m: F32, xyz: F32, ground: Mask, z_g: F32, reach: int, under: float, height: float
) -> tuple[Mask, I32]:
    """Find the first vertical point after the ground of every row that nothing lies under.

    Parameters
    ----------
    surface : (R, n) uint8
    range_m : (R, n) float32, metres
    xyz : (R, n, 3) float32, metres
    ground : (R, n) bool
    z_g : (R,) float32, metres
        Height of the ground.
    reach : int
        Valid points before a point that are looked at for something farther away under it.
    under : float, metres
        Farther away by more than this.
    height : float, metres
        The search ends at the first valid point higher above the ground.

    Returns
    -------
    found : (R,) bool
    beam : (R,) int32
        -1 where nothing was found.
    """
    n_rows, n = surface.shape
    found = np.zeros(n_rows, np.bool_)
    beam = np.full(n_rows, -1, np.int32)
    farthest = np.empty(n + 1, np.float32)
    for row in range(n_rows):
        last = n - 1
        while last >= 0 and not ground[row, last]:
            last -= 1
        if last < 0:
            continue
        limit = np.float64(z_g[row]) + height
        # ranges of the valid points, from the first that can matter
        first = last
        wanted = reach
        while first > 0 and wanted > 0:
            if surface[row, first] != _MISSING:
                wanted -= 1
            first -= 1
        count = 0
        for k in range(first, n):
            kind = surface[row, k]
            if kind == _MISSING:
                continue
            if k > last:
                if np.float64(xyz[row, k, 2]) > limit:
                    break
                if kind == _VERTICAL:
                    own = range_m[row, k]
                    most = own
                    for i in range(max(count - reach, 0), count):
                        most = max(most, farthest[i])
                    if not np.float64(most) - np.float64(own) > under:
                        found[row] = True
                        beam[row] = k
                        break
            farthest[count] = range_m[row, k]
            count += 1
    return found, beam


@inlined
def _root(parent: I32, label: int) -> int:
    """Follow a label to the one that stands for its region, shortening the way for the next one."""
    while parent[label] != label:
        parent[label] = parent[parent[label]]
        label = parent[label]
    return label


@inlined
def _near(here: F32, k: int, there: F32, j: int, reach_2: float) -> bool:
    """Tell whether two points lie within the grouping distance."""
    dx = np.float64(here[k, 0]) - np.float64(there[j, 0])
    dy = np.float64(here[k, 1]) - np.float64(there[j, 1])
    dz = np.float64(here[k, 2]) - np.float64(there[j, 2])
    return bool(dx * dx + dy * dy + dz * dz < reach_2)


@helper
def _join(parent: I32, spans: I32, low: F32, high: F32, one: int, other: int, by_line: bool, t_curb: float) -> int:
    """Make two regions one."""
    if one == HIGH or other == HIGH:
        parent[one] = HIGH
        parent[other] = HIGH
        return HIGH
    kept, gone = min(one, other), max(one, other)
    parent[gone] = kept
    if by_line and spans[one, 2] != spans[other, 2]:
        later = one if spans[one, 2] > spans[other, 2] else other
        low[kept] = low[later]
        high[kept] = high[later]
    else:
        low[kept] = min(low[one], low[other])
        high[kept] = max(high[one], high[other])
    spans[kept, 1] = min(spans[one, 1], spans[other, 1])
    spans[kept, 2] = max(spans[one, 2], spans[other, 2])
    spans[kept, 3] = max(spans[one, 3], spans[other, 3])
    if np.float64(high[kept]) - np.float64(low[kept]) > t_curb:
        parent[kept] = HIGH
        return HIGH
    return kept


@helper
def _is_straight(
    parent: I32,
    labels: I32,
    signed: F32,
    above_signed: F32,
    region: int,
    side: int,
    first: int,
    last: int,
    n_sides: int,
    n_before: int,
    limit: float,
) -> bool:
    """Tell whether the angle changes little from point to point of a region, in the median."""
    below = 0
    others = 0
    largest_below = -np.inf
    smallest_other = np.inf
    for line in range(first, last + 1):
        own = labels[line * n_sides + side]
        new = line - n_before
        # lines before this call are kept at the end of what was carried over
        angles = signed[new * n_sides + side] if new >= 0 else above_signed[len(above_signed) + new * n_sides + side]
        for k in range(1, len(own)):
            if own[k] < FIRST_REGION or own[k - 1] < FIRST_REGION:
                continue
            if _root(parent, own[k]) != region or _root(parent, own[k - 1]) != region:
                continue
            change = abs(np.float64(angles[k]) - np.float64(angles[k - 1]))
            if change < limit:
                below += 1
                largest_below = max(largest_below, change)
            elif change >= limit:  # neither holds for NaN
                others += 1
                smallest_other = min(smallest_other, change)
    if below == others:  # the median lies between the two
        return below > 0 and (largest_below + smallest_other) / 2.0 < limit
    return below > others


@helper
def _decide(
    parent: I32,
    spans: I32,
    labels: I32,
    signed: F32,
    above_signed: F32,
    region: int,
    n_sides: int,
    n_before: int,
    min_lines: int,
    limit: float,
) -> None:
    """Decide whether a complete region is a curb."""
    side, first, last = spans[region, 0], spans[region, 1], spans[region, 2]
    accepted = False
    if spans[region, 3] == 1:
        accepted = last - first + 1 >= min_lines or _is_straight(
            parent, labels, signed, above_signed, region, side, first, last, n_sides, n_before, limit
        )
    parent[region] = CURB if accepted else REJECTED


@helper
def _connect_row(
    surface: U8,
    here: F32,
    above: F32,
    own: I32,
    up: I32,
    side: int,
    line: int,
    start: int,
    parent: I32,
    spans: I32,
    low: F32,
    high: F32,
    undecided: I32,
    n_undecided: int,
    n_ids: int,
    reach_2: float,
    t_curb: float,
    by_line: bool,
) -> int:
    """Label the vertical points of a row, joining them to each other and to those of the row above.

    New regions are numbered from ``n_ids`` on and appended to ``undecided``; returns how many.
    """
    n = len(surface)
    n_new = 0
    for k in range(n):
        if surface[k] != _VERTICAL:
            own[k] = NONE
            continue
        z = here[k, 2]
        label = NONE
        if k > 0 and own[k - 1] != NONE and _near(here, k, here, k - 1, reach_2):
            label = _root(parent, own[k - 1])
            if label != HIGH:
                low[label] = min(low[label], z)
                high[label] = max(high[label], z)
                if np.float64(high[label]) - np.float64(low[label]) > t_curb:
                    parent[label] = HIGH
                    label = HIGH
        else:
            label = n_ids + n_new
            parent[label] = label
            spans[label, 0] = side
            spans[label, 1] = line
            spans[label, 2] = line
            spans[label, 3] = 0
            low[label] = z
            high[label] = z
            undecided[n_undecided + n_new] = label
            n_new += 1
        for j in range(max(k - 1, 0), min(k + 2, n)):
            if up[j] == NONE:
                continue
            other = _root(parent, up[j])
            if other in (label, REJECTED, CURB) or not _near(here, k, above, j, reach_2):
                continue
            label = _join(parent, spans, low, high, label, other, by_line, t_curb)
        if k == start and label != HIGH:
            spans[label, 3] = 1
        own[k] = label
    return n_new


@helper
def _carry(
    parent: I32, spans: I32, low: F32, high: F32, labels: I32, first_row: int, begin: int, n_ids: int
) -> tuple[I32, I32, F32]:
    """Return rows and regions for the next call: labels that stand for themselves, numbered as they come."""
    n_rows, n = labels.shape
    left = np.empty((n_rows - first_row, n), np.int32)
    number = np.zeros(n_ids, np.int32)
    number[HIGH] = HIGH
    number[REJECTED] = REJECTED
    number[CURB] = CURB
    n_left = 0
    for row in range(n_rows - first_row):
        for k in range(n):
            label = labels[row + first_row, k]
            label = _root(parent, label) if label > HIGH else label
            if label != NONE and number[label] == 0:
                number[label] = FIRST_REGION + n_left
                n_left += 1
            left[row, k] = number[label]
    regions = np.empty((n_left, 4), np.int32)
    extents = np.empty((n_left, 2), np.float32)
    for label in range(FIRST_REGION, n_ids):
        if number[label] != 0:
            i = number[label] - FIRST_REGION
            regions[i, 0] = spans[label, 0]
            regions[i, 1] = spans[label, 1] - begin
            regions[i, 2] = spans[label, 2] - begin
            regions[i, 3] = spans[label, 3]
            extents[i, 0] = low[label]
            extents[i, 1] = high[label]
    return left, regions, extents


@kernel(
    "Tuple((boolean[:, ::1], int32[:, ::1], int64, int32[:, ::1], float32[:, ::1]))(uint8[:, ::1], "
    "float32[:, :, ::1], float32[:, ::1], int32[::1], int64, int32[:, ::1], int64, float32[:, :, ::1], "
    "float32[:, ::1], int32[:, ::1], float32[:, ::1], float64, float64, int64, float64, int64, boolean, boolean)"
)
def connect_verticals(
    surface: U8,
    xyz: F32,
    signed: F32,
    possible: I32,
    n_sides: int,
    carried: I32,
    n_given: int,
    above_xyz: F32,
    above_signed: F32,
    regions: I32,
    extents: F32,
    reach: float,
    t_curb: float,
    min_lines: int,
    curvature: float,
    max_lines: int,
    by_line: bool,
    last: bool,
) -> tuple[Mask, I32, int, I32, F32]:
    """Connect vertical points across lines and decide which of the regions are curbs.

    Parameters
    ----------
    surface : (R, n) uint8
        Row = line * n_sides + side; regions never cross from side to side.
    xyz : (R, n, 3) float32, metres
    signed : (R, n) float32, degrees
        Signed angles, NaN where there is none.
    possible : (R,) int32
        Beam of the possible curb point, -1 = none.
    n_sides : int
    carried : (P, n) int32
        Labels of the rows before, at least of the last line: :data:`HIGH`, ... and regions from
        :data:`FIRST_REGION`.
    n_given : int
        Lines at its beginning that were returned as decided before, 0 or 1.
    above_xyz : (n_sides, n, 3) float32, metres
        Points of the last line.
    above_signed : ((min_lines - 1) * n_sides, n) float32, degrees
        Signed angles of the last lines.
    regions : (C, 4) int32
        Side, first and last line from the beginning of ``carried``, and whether it has a possible curb point.
    extents : (C, 2) float32, metres
        Lowest and highest z.
    reach : float, metres
        Neighbours closer than this belong together.
    t_curb : float, metres
        A region higher than this is not a curb.
    min_lines : int
        Lines that make a curb of a region with a possible curb point.
    curvature : float, degrees
        With fewer lines: the angle must change less than this from point to point, in the median.
    max_lines : int
        A region of so many lines is decided as it is, and closed.
    by_line : bool
        The height is that within a line, not that of the whole region.
    last : bool
        No more lines will come.

    Returns
    -------
    curb : (F, n) bool
        Rows that became decided, in order.
    carried, n_given, regions, extents
        For the next call.
    """
    n_rows, n = surface.shape
    n_before = len(carried) // n_sides
    n_lines = n_before + n_rows // n_sides
    labels = np.empty((n_lines * n_sides, n), np.int32)
    for row in range(len(carried)):
        for k in range(n):
            labels[row, k] = carried[row, k]
    n_vertical = 0
    for row in range(n_rows):
        for k in range(n):
            n_vertical += surface[row, k] == _VERTICAL
    n_ids = FIRST_REGION + len(regions)
    capacity = n_ids + n_vertical
    parent = np.empty(capacity, np.int32)
    spans = np.empty((capacity, 4), np.int32)
    low = np.empty(capacity, np.float32)
    high = np.empty(capacity, np.float32)
    undecided = np.empty((n_sides, capacity), np.int32)
    n_undecided = np.zeros(n_sides, np.int64)
    for label in range(n_ids):
        parent[label] = label
    for i in range(len(regions)):
        label = FIRST_REGION + i
        for j in range(4):
            spans[label, j] = regions[i, j]
        low[label] = extents[i, 0]
        high[label] = extents[i, 1]
        side = regions[i, 0]
        undecided[side, n_undecided[side]] = label
        n_undecided[side] += 1

    for row in range(n_rows):
        side = row % n_sides
        line = n_before + row // n_sides
        n_new = _connect_row(
            surface[row], xyz[row], xyz[row - n_sides] if row >= n_sides else above_xyz[side],
            labels[line * n_sides + side], labels[(line - 1) * n_sides + side], side, line, possible[row], parent,
            spans, low, high, undecided[side], n_undecided[side], n_ids, reach * reach, t_curb, by_line,
        )  # fmt: skip
        n_ids += n_new
        n_undecided[side] += n_new
        # what got nothing from this line is complete
        kept = 0
        for i in range(n_undecided[side]):
            label = undecided[side, i]
            if parent[label] != label:
                continue
            if spans[label, 2] == line and line - spans[label, 1] + 1 < max_lines:
                undecided[side, kept] = label
                kept += 1
            else:
                _decide(
                    parent, spans, labels, signed, above_signed, label, n_sides, n_before, min_lines, curvature
                )  # fmt: skip
        n_undecided[side] = kept

    first_open = n_lines
    for side in range(n_sides):
        for i in range(n_undecided[side]):
            label = undecided[side, i]
            if last:
                _decide(parent, spans, labels, signed, above_signed, label, n_sides, n_before, min_lines, curvature)
            else:
                first_open = min(first_open, spans[label, 1])

    curb = np.empty(((first_open - n_given) * n_sides, n), np.bool_)
    for row in range(len(curb)):
        for k in range(n):
            label = labels[row + n_given * n_sides, k]
            curb[row, k] = label > HIGH and _root(parent, label) == CURB
    begin = min(first_open, n_lines - 1)
    left, regions_left, extents_left = _carry(parent, spans, low, high, labels, begin * n_sides, begin, n_ids)
    return curb, left, n_lines - begin if first_open == n_lines else 0, regions_left, extents_left
