"""Loops of the fused classifier over shots and their neighbours.

Near neighbours, smoothness, direction.

The first two read the *window* of a block: its lines and :data:`LINES` more before and after. The
points of a line have :data:`COLUMNS` columns of NaN on either side. So neighbours are shifted
arrays, and comparisons with absent neighbours are false.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import F32, F32_1, F32_2, I32, U8, U8_2
from prc_cli.methods.fused.records import Beams, FiveLines, Points
from prc_cli.methods.fused.thresholds import ChordThresholds, NearThresholds, SmoothThresholds

LINES = 2
COLUMNS = 4
"""Greatest distance of neighbours, in lines and columns."""
MOST_STRIDE = 8
"""Greatest number of columns from a shot to the shots that it is compared with."""
PIECE = 128
"""Columns that are compared together with the same stride."""
MOST_COLUMNS = 60
"""Greatest half length of a chord, in columns."""
PAD = MOST_COLUMNS + 2
"""Empty columns beside a line, in which chords may end."""


@loop()
def plane_points(range_m: F32_2, sine: F32_1, cosine: F32_1) -> tuple[F32_2, F32_2]:
    """Turn ranges into points of the scan plane.

    ``range_m`` (lines, M) float32, metres; ``sine, cosine`` (M,) float32; returns side_m, height_m
    : (lines, M) float32, metres.
    """
    n_lines, m = range_m.shape
    side = np.empty((n_lines, m), np.float32)
    height = np.empty((n_lines, m), np.float32)
    for line in range(n_lines):
        ranges = range_m[line]
        y = side[line]
        z = height[line]
        for i in range(m):
            y[i] = ranges[i] * sine[i]
            z[i] = -(ranges[i] * cosine[i])
    return side, height


@helper
def _lay_out(
    ranges: F32,
    beams: Beams,
    side: F32,
    height: F32,
) -> None:
    """Write the points of a line between its margins, as :func:`plane_points` has them."""
    sine, cosine = beams
    m = len(ranges)
    y = side[COLUMNS : COLUMNS + m]
    z = height[COLUMNS : COLUMNS + m]
    # one result a loop: the compiler cannot always prove that several do not overlap
    for i in range(m):
        y[i] = ranges[i] * sine[i]
    for i in range(m):
        z[i] = -(ranges[i] * cosine[i])


@helper
def _empty_lines(m: int) -> F32:
    """Return a buffer for a coordinate of five lines, with NaN in the margins."""
    rows = np.empty((2 * LINES + 1, m + 2 * COLUMNS), np.float32)
    for row in range(2 * LINES + 1):
        for i in range(COLUMNS):
            rows[row, i] = rows[row, m + COLUMNS + i] = np.float32(np.nan)
    return rows


@inlined
def _is_near(
    dy: np.float32,
    dz: np.float32,
    near: np.float32,
    thin: np.float32,
    along: np.float32,
) -> np.uint8:
    """Whether two points are close, or on one level or upright surface at grazing incidence.

    ``along`` is not less than ``near``.
    """
    a = abs(dy)
    b = abs(dz)
    return np.uint8(max(a, b) < (along if min(a, b) < thin else near))


@helper
def _count_beside(
    points: Points,
    near: F32,
    along: F32,
    thin: np.float32,
    row: U8,
) -> None:
    """Count near neighbours among the four on either side; the line has margins."""
    y, z = points
    for i in range(len(row)):
        a = y[i + 4]
        b = z[i + 4]
        short = near[i]
        long = along[i]
        row[i] = (
            _is_near(y[i] - a, z[i] - b, short, thin, long)
            + _is_near(y[i + 1] - a, z[i + 1] - b, short, thin, long)
            + _is_near(y[i + 2] - a, z[i + 2] - b, short, thin, long)
            + _is_near(y[i + 3] - a, z[i + 3] - b, short, thin, long)
            + _is_near(y[i + 5] - a, z[i + 5] - b, short, thin, long)
            + _is_near(y[i + 6] - a, z[i + 6] - b, short, thin, long)
            + _is_near(y[i + 7] - a, z[i + 7] - b, short, thin, long)
            + _is_near(y[i + 8] - a, z[i + 8] - b, short, thin, long)
        )


@helper
def _count_across(
    points: Points,
    line: Points,
    next_line: Points,
    near: F32,
    along: F32,
    thin: np.float32,
    row: U8,
) -> None:
    """Add the near neighbours of the shots of a line among five of two other lines each.

    All have margins.
    """
    y, z = points
    y1, z1 = line
    y2, z2 = next_line
    for i in range(len(row)):
        a = y[i + 4]
        b = z[i + 4]
        short = near[i]
        long = along[i]
        row[i] += (
            _is_near(y1[i + 2] - a, z1[i + 2] - b, short, thin, long)
            + _is_near(y1[i + 3] - a, z1[i + 3] - b, short, thin, long)
            + _is_near(y1[i + 4] - a, z1[i + 4] - b, short, thin, long)
            + _is_near(y1[i + 5] - a, z1[i + 5] - b, short, thin, long)
            + _is_near(y1[i + 6] - a, z1[i + 6] - b, short, thin, long)
            + _is_near(y2[i + 2] - a, z2[i + 2] - b, short, thin, long)
            + _is_near(y2[i + 3] - a, z2[i + 3] - b, short, thin, long)
            + _is_near(y2[i + 4] - a, z2[i + 4] - b, short, thin, long)
            + _is_near(y2[i + 5] - a, z2[i + 5] - b, short, thin, long)
            + _is_near(y2[i + 6] - a, z2[i + 6] - b, short, thin, long)
        )


@loop()
def near_counts(
    range_m: F32_2,
    sine: F32_1,
    cosine: F32_1,
    step: np.float32,
    thresholds: NearThresholds,
) -> U8_2:
    """Count the near neighbours of every shot, of 8 in its line and 20 in the four lines around.

    ``range_m`` (lines + 4, M) float32, metres; ``sine, cosine`` (M,) float32; returns (lines, M)
    uint8.
    """
    m = range_m.shape[1]
    n_lines = range_m.shape[0] - 2 * LINES
    near_m = thresholds.near_m
    near_steps = thresholds.near_steps
    thin = thresholds.thin_m
    along_m = thresholds.along_m
    along_steps = thresholds.along_steps
    counts = np.empty((n_lines, m), np.uint8)
    near = np.empty(m, np.float32)
    along = np.empty(m, np.float32)
    # ring buffers of lines
    side = _empty_lines(m)
    height = _empty_lines(m)
    room = 2 * LINES + 1
    for line in range(range_m.shape[0]):
        _lay_out(range_m[line], Beams(sine, cosine), side[line % room], height[line % room])
        if line < 2 * LINES:
            continue
        ranges = range_m[line - LINES]
        for i in range(m):
            apart = ranges[i] * step
            short = max(near_m, near_steps * apart)
            near[i] = short
            along[i] = max(max(along_m, along_steps * apart), short)
        row = counts[line - 2 * LINES]
        a = (line - 4) % room
        b = (line - 3) % room
        c = (line - 2) % room
        d = (line - 1) % room
        e = line % room
        points = Points(side[c], height[c])
        second_before = Points(side[a], height[a])
        before = Points(side[b], height[b])
        after = Points(side[d], height[d])
        second_after = Points(side[e], height[e])
        _count_beside(points, near, along, thin, row)
        _count_across(points, second_before, before, near, along, thin, row)
        _count_across(points, after, second_after, near, along, thin, row)
    return counts


@inlined
def _on_line(
    ay: np.float32,
    az: np.float32,
    by: np.float32,
    bz: np.float32,
    y: np.float32,
    z: np.float32,
    tolerance: np.float32,
    gap: np.float32,
) -> np.uint8:
    """Whether a point is on the line through two others that are close; limits are squared."""
    dy = by - ay
    dz = bz - az
    long = dy * dy + dz * dz
    off = dy * (z - az) - dz * (y - ay)
    return np.uint8((long < gap) & (off * off < tolerance * long))


@inlined
def _between(
    ay: np.float32,
    az: np.float32,
    by: np.float32,
    bz: np.float32,
    y: np.float32,
    z: np.float32,
    tolerance: np.float32,
) -> np.uint8:
    """Whether a point lies midway between two others; the tolerance is squared."""
    half = np.float32(0.5)
    dy = (ay + by) * half - y
    dz = (az + bz) * half - z
    return np.uint8(dy * dy + dz * dz < np.float32(4.0) * tolerance)


@helper
def _pairs_in_line(
    ranges: F32,
    side: F32,
    height: F32,
    step: np.float32,
    thresholds: SmoothThresholds,
    row: U8,
) -> None:
    """Count the pairs of neighbours in the line that a shot lies on a straight line with."""
    base = thresholds.tolerance_m
    per_m = thresholds.tolerance_per_m
    gap_m = thresholds.gap_m
    gap_steps = thresholds.gap_steps
    for i in range(len(row)):
        tolerance = base + per_m * ranges[i]
        tolerance = tolerance * tolerance
        gap = max(gap_m, gap_steps * (ranges[i] * step))
        gap = gap * gap
        y1 = side[i + 2]
        y2 = side[i + 3]
        y = side[i + 4]
        y3 = side[i + 5]
        y4 = side[i + 6]
        z1 = height[i + 2]
        z2 = height[i + 3]
        z = height[i + 4]
        z3 = height[i + 5]
        z4 = height[i + 6]
        row[i] = (
            _on_line(y2, z2, y3, z3, y, z, tolerance, gap)
            + _on_line(y1, z1, y4, z4, y, z, tolerance, gap)
            + _on_line(y1, z1, y2, z2, y, z, tolerance, gap)
            + _on_line(y3, z3, y4, z4, y, z, tolerance, gap)
            + _on_line(y2, z2, y4, z4, y, z, tolerance, gap)
            + _on_line(y1, z1, y3, z3, y, z, tolerance, gap)
        )


@helper
def _write_strides(
    ranges: F32,
    step: np.float32,
    thresholds: SmoothThresholds,
    strides: I32,
) -> None:
    """Write how many columns the shots are away that each shot of a line is compared with.

    Less at the ends of the line, 1 for missing shots.
    """
    m = len(ranges)
    most = np.float32(MOST_STRIDE)
    apart = thresholds.apart_m
    leaf = np.float32(0.5) * thresholds.leaf_m
    for i in range(m):
        spacing = ranges[i] * step  # NaN stays NaN, which no comparison holds for
        columns = apart / spacing
        dense = np.int32(min(columns, most))
        sparse = np.int32(1) + (spacing <= leaf)
        strides[i] = dense if columns >= np.float32(2.0) else sparse
    for i in range(min(2 * MOST_STRIDE, m)):
        inside = np.int32(max(i // 2, 1))
        strides[i] = min(strides[i], inside)
        strides[m - 1 - i] = min(strides[m - 1 - i], inside)


@helper
def _pairs_with_stride(
    ranges: F32,
    side: F32,
    height: F32,
    step: np.float32,
    thresholds: SmoothThresholds,
    strides: I32,
    row: U8,
) -> None:
    """Count the pairs in the line again for shots that are compared with a stride of 2 or more.

    Piece by piece, once for every stride in the piece: with one stride the pairs are shifted
    arrays.
    """
    base = thresholds.tolerance_m
    per_m = thresholds.tolerance_per_m
    gap_m = thresholds.gap_m
    gap_steps = thresholds.gap_steps
    m = len(row)
    for first in range(0, m, PIECE):
        end = min(first + PIECE, m)
        strides_here = np.int32(0)
        for i in range(first, end):
            strides_here |= np.int32(1) << strides[i]
        for n in range(2, MOST_STRIDE + 1):
            if strides_here & np.int32(1 << n) == 0:
                continue
            # no shot nearer to the ends of the line has this stride
            low = max(first, 2 * n)
            high = min(end, m - 2 * n)
            start = low + COLUMNS
            size = high - low
            piece_m = ranges[low:high]
            stride = strides[low:high]
            counts = row[low:high]
            y0 = side[start : start + size]
            y1 = side[start - 2 * n :]
            y2 = side[start - n :]
            y3 = side[start + n :]
            y4 = side[start + 2 * n :]
            z0 = height[start : start + size]
            z1 = height[start - 2 * n :]
            z2 = height[start - n :]
            z3 = height[start + n :]
            z4 = height[start + 2 * n :]
            for k in range(size):
                y = y0[k]
                z = z0[k]
                tolerance = base + per_m * piece_m[k]
                tolerance = tolerance * tolerance
                gap = max(gap_m, gap_steps * (piece_m[k] * step))
                gap = gap * gap
                count = (
                    _on_line(y2[k], z2[k], y3[k], z3[k], y, z, tolerance, gap)
                    + _on_line(y1[k], z1[k], y4[k], z4[k], y, z, tolerance, gap)
                    + _on_line(y1[k], z1[k], y2[k], z2[k], y, z, tolerance, gap)
                    + _on_line(y3[k], z3[k], y4[k], z4[k], y, z, tolerance, gap)
                    + _on_line(y2[k], z2[k], y4[k], z4[k], y, z, tolerance, gap)
                    + _on_line(y1[k], z1[k], y3[k], z3[k], y, z, tolerance, gap)
                )
                counts[k] = np.uint8(count) if stride[k] == n else counts[k]


@helper
def _pairs_across(
    ranges: F32,
    sides: FiveLines,
    heights: FiveLines,
    thresholds: SmoothThresholds,
    row: U8,
) -> None:
    """Add the pairs across the lines, one shot before and one after, that a shot lies midway in."""
    base = thresholds.tolerance_m
    per_m = thresholds.tolerance_per_m
    ya, yb, yc, yd, ye = sides
    za, zb, zc, zd, ze = heights
    for i in range(len(row)):
        tolerance = base + per_m * ranges[i]
        tolerance = tolerance * tolerance
        y = yc[i + 4]
        z = zc[i + 4]
        row[i] += (
            _between(yb[i + 4], zb[i + 4], yd[i + 4], zd[i + 4], y, z, tolerance)
            + _between(yb[i + 5], zb[i + 5], yd[i + 3], zd[i + 3], y, z, tolerance)
            + _between(yb[i + 3], zb[i + 3], yd[i + 5], zd[i + 5], y, z, tolerance)
            + _between(ya[i + 4], za[i + 4], ye[i + 4], ze[i + 4], y, z, tolerance)
        )


@loop()
def smooth_counts(
    range_m: F32_2,
    sine: F32_1,
    cosine: F32_1,
    step: np.float32,
    thresholds: SmoothThresholds,
) -> U8_2:
    """Count the pairs of neighbours that a shot lies on a smooth surface with, of ten pairs.

    Six pairs are in its line, four across the lines.

    In the line, a shot must lie on the straight line through the pair. Where columns are nearer to
    each other than ``apart_m``, every second, third, ... column is compared, up to
    :data:`MOST_STRIDE`: two shots on one leaf are as smooth as two on a wall. Across lines, whose
    distance is not known, in the middle between the pair, within twice the tolerance.

    ``range_m`` (lines + 4, M) float32, metres; ``sine, cosine`` (M,) float32; returns (lines, M)
    uint8.
    """
    m = range_m.shape[1]
    n_lines = range_m.shape[0] - 2 * LINES
    counts = np.empty((n_lines, m), np.uint8)
    strides = np.empty(m, np.int32)
    side = _empty_lines(m)
    height = _empty_lines(m)
    room = 2 * LINES + 1
    for line in range(range_m.shape[0]):
        _lay_out(range_m[line], Beams(sine, cosine), side[line % room], height[line % room])
        if line < 2 * LINES:
            continue
        ranges = range_m[line - LINES]
        row = counts[line - 2 * LINES]
        a = (line - 4) % room
        b = (line - 3) % room
        c = (line - 2) % room
        d = (line - 1) % room
        e = line % room
        _pairs_in_line(ranges, side[c], height[c], step, thresholds, row)
        _write_strides(ranges, step, thresholds, strides)
        _pairs_with_stride(ranges, side[c], height[c], step, thresholds, strides, row)
        sides = FiveLines(side[a], side[b], side[c], side[d], side[e])
        heights = FiveLines(height[a], height[b], height[c], height[d], height[e])
        _pairs_across(ranges, sides, heights, thresholds, row)
    return counts


@inlined
def _is_upright(
    dy: np.float32,
    dz: np.float32,
    slope: np.float32,
    slack: np.float32,
    longest: np.float32,
) -> np.uint8:
    """Whether a chord is upright and not too long; with ``dy`` and ``dz`` exchanged, level."""
    return np.uint8((abs(dy) <= slope * abs(dz) + slack) & (dy * dy + dz * dz <= longest))


@helper
def _write_ends(
    values: F32,
    smooth: U8,
    way: int,
    shown: F32,
    ends: F32,
) -> None:
    """Write a coordinate of the points at which chords that end in a column end.

    That is the column if it is smooth, else the next one outwards, else the next one inwards.
    ``way`` is outwards: -1 or 1. Column 0 is at PAD, and columns beyond the line stay NaN. In the
    second half of ``ends`` the next one inwards is left out: it would be the shot itself.
    """
    n = len(shown)
    for i in range(len(values)):
        shown[PAD + i] = values[i] if smooth[i] > 0 else np.float32(np.nan)
    out = shown[1 + way : n - 1 + way]
    middle = shown[1 : n - 1]
    back = shown[1 - way : n - 1 - way]
    three = ends[1 : n - 1]
    two = ends[n + 1 : 2 * n - 1]
    for i in range(n - 2):
        # NaN marks columns that are not smooth
        first = middle[i] if middle[i] == middle[i] else out[i]
        two[i] = first
        three[i] = first if first == first else back[i]


@helper
def _count_chords(
    points: Points,
    before: Points,
    after: Points,
    thresholds: ChordThresholds,
    upright: U8,
    level: U8,
) -> None:
    """Count the upright and the level ones of the chords through the shots of a line.

    There are three: from the shot to one end, to the other, and from end to end.
    """
    slope = thresholds.slope
    slack = thresholds.slack_m
    longest = thresholds.longest_m * thresholds.longest_m
    y, z = points
    ay, az = before
    by, bz = after
    for i in range(len(y)):
        # NaN propagates for missing shots and ends, which are neither
        dy1 = ay[i] - y[i]
        dz1 = az[i] - z[i]
        dy2 = by[i] - y[i]
        dz2 = bz[i] - z[i]
        dy3 = dy1 - dy2
        dz3 = dz1 - dz2
        upright[i] = (
            _is_upright(dy1, dz1, slope, slack, longest)
            + _is_upright(dy2, dz2, slope, slack, longest)
            + _is_upright(dy3, dz3, slope, slack, longest)
        )
        level[i] = (
            _is_upright(dz1, dy1, slope, slack, longest)
            + _is_upright(dz2, dy2, slope, slack, longest)
            + _is_upright(dz3, dy3, slope, slack, longest)
        )


@loop()
def directions(
    range_m: F32_2,
    smooth: U8_2,
    sine: F32_1,
    cosine: F32_1,
    step: np.float32,
    thresholds: ChordThresholds,
) -> tuple[U8_2, U8_2]:
    """Count which chords through a shot are upright and which are level.

    A chord reaches as far to both sides as ``chord_m`` is long at that range, to shots that lie on
    something smooth; it and its two halves are looked at.

    ``range_m`` (lines, M) float32, metres; ``smooth`` (lines, M) uint8; ``sine, cosine`` (M,)
    float32; returns upright, level : (lines, M) uint8.
    """
    n_lines, m = range_m.shape
    n = m + 2 * PAD
    upright = np.empty((n_lines, m), np.uint8)
    level = np.empty((n_lines, m), np.uint8)
    reach = np.empty(m, np.int32)
    side = np.empty(m, np.float32)
    height = np.empty(m, np.float32)
    shown = np.empty(n, np.float32)
    ends = Points(np.empty(2 * n, np.float32), np.empty(2 * n, np.float32))
    for i in range(n):
        shown[i] = np.float32(np.nan)
    for i in range(2 * n):
        ends.side_m[i] = ends.height_m[i] = np.float32(np.nan)
    before = Points(np.empty(m, np.float32), np.empty(m, np.float32))
    after = Points(np.empty(m, np.float32), np.empty(m, np.float32))
    chord = thresholds.chord_m
    most = np.float32(MOST_COLUMNS)
    for line in range(n_lines):
        ranges = range_m[line]
        for i in range(m):
            columns = np.float32(0.0) if ranges[i] != ranges[i] else chord / (ranges[i] * step)
            reach[i] = np.int32(min(max(columns, np.float32(1.0)), most))
        for i in range(m):
            side[i] = ranges[i] * sine[i]
        for i in range(m):
            height[i] = -(ranges[i] * cosine[i])
        for way in (-1, 1):
            _write_ends(side, smooth[line], way, shown, ends.side_m)
            _write_ends(height, smooth[line], way, shown, ends.height_m)
            # a loop of its own: the other loops read memory in order, and use vector instructions
            chord_ends = before if way < 0 else after
            for i in range(m):
                columns_away = int(reach[i])
                place = np.uint64(PAD + i + way * columns_away + (n if columns_away == 1 else 0))
                chord_ends.side_m[i] = ends.side_m[place]
                chord_ends.height_m[i] = ends.height_m[place]
        _count_chords(Points(side, height), before, after, thresholds, upright[line], level[line])
    return upright, level
