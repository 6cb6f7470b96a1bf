"""Sort shots above the ground into narrow strips beside the scanner.

A strip is :data:`STRIP_M` wide; heights above the ground are divided into slots of :data:`SLOT_M`,
one bit each. Level surfaces are kept in bins of half the width. Strips of adjacent lines are
combined: lines are close together, and upright things stay in their strip from line to line. Trunks
and posts are no walls: lines on both sides see past them.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import F32, F32_2, I32, U8, U8_2, U64_2
from prc_cli.methods.fused.records import (
    FENCE,
    FEW_SHOTS,
    MAST,
    POST,
    SHORT,
    SLOT_M,
    SLOTS,
    SMALL,
    STRIP_M,
    STRIPS,
    THIN,
    Beams,
    FilledSlots,
    Neighbours,
    StripSums,
    Walls,
)
from prc_cli.methods.fused.thresholds import ColumnThresholds, StripThresholds, WallThresholds

LINES = 2
"""Lines before and after that are combined with a line."""
NO_TOP = np.float32(-1e9)
"""Top where there is no wall [m]."""
LEAST_COSINE = np.float32(0.3)
"""Lower limit of the cosine by which a shot's height extent is computed."""
UPRIGHT_CHORDS = 2
"""Least upright chords, of three, of a shot on an upright surface."""
_FAR_BINS = np.float32(1e6)
"""Limit of bin numbers, so that they fit an integer."""
FENCE_LINES = (9, 30)
FENCE_M = np.float32(0.2)
FENCE_SEEN = 6
"""A fence is seen as far away by so many of the lines this far before and after [m]."""
CLIMB_M = np.float32(0.3)
CLIMB_SIDE_M = np.float32(0.4)
"""An object is followed upwards over gaps of this height, and so far to the side [m]."""
COUNT = np.uint8(63)
CLOSE = np.uint8(64)
"""Bits of lines that see an object, and of an end with something close behind it."""
NO_END = np.uint8(127)
"""Where a thing goes on, or something stands before its end."""
FREE = np.uint8(1)
NARROW = np.uint8(2)
"""Marks of shots that lines on both sides see far past, and of those that few lines see."""
GAP = np.uint8(4)
"""Mark of single shots within a run that miss the thing."""
ROUND = np.float32(0.68)
"""By how much of its radius two inner quarters of a round thing are nearer than its outer ones."""
EVEN = np.float32(0.25)
"""Its inner quarters differ by less than this share of that, but for a tilt."""
CHEST_M = np.float32(1.0)
"""A higher start is a body only if it is taller than roof between windows [m]."""
MAST_SHARE = np.float32(0.4)
"""Least share of a mast that few lines see, with far things on both sides."""
MAST_SLOPE = np.float32(0.1)
"""A mast goes less to the side per metre of height."""
MAST_BEYOND = 4
"""Shots beyond the top of a mast that are on the mast or far behind it."""
SAMPLES = 8
"""Shots of a run by which its depth is measured, at most."""


@inlined
def _bin(y: np.float32, width: np.float32) -> np.int32:
    """Return the bin of a shot to the left or right, 0 = the first beside the scanner."""
    return np.int32(np.floor(min(max(y / width, -_FAR_BINS), _FAR_BINS)))


@inlined
def count_bits(word: np.uint64) -> int:
    """Return how many slots of a strip are marked."""
    n = 0
    while word != np.uint64(0):
        word &= word - np.uint64(1)
        n += 1
    return n


@helper
def _count_lines_of_objects(
    range_m: F32,
    earlier_m: F32,
    before_earlier_m: F32,
    jump: np.float32,
    far: np.float32,
    lines: U8,
) -> None:
    """Go on by one line: ``lines`` counts how many lines in a row see the object of a shot.

    The first of them is next to a line that sees past the object. A single missing shot does not
    end an object.
    """
    for i in range(len(range_m)):
        next_m = earlier_m[i] if earlier_m[i] == earlier_m[i] else before_earlier_m[i]
        is_same = (range_m[i] != range_m[i]) | (abs(range_m[i] - next_m) < jump)
        is_first = not (next_m <= range_m[i] + jump)
        count = np.uint8(min(lines[i] & COUNT, COUNT - np.uint8(1)) + np.uint8(1))
        more = count | (lines[i] & CLOSE)
        first = np.uint8(1) if not (next_m <= range_m[i] + far) else np.uint8(1) | CLOSE
        lines[i] = more if is_same else (first if is_first else NO_END)


@helper
def _mark_free(
    before: U8,
    after: U8,
    above: F32,
    near: U8,
    thresholds: ColumnThresholds,
    counted: U8,
    marks: U8,
) -> None:
    for i in range(len(marks)):
        counted[i] = (np.float32(near[i]) >= thresholds.least_near) & (above[i] > thresholds.foot_m)
    most = np.int32(thresholds.lines) + np.int32(1)
    few = np.int32(thresholds.small_lines) + np.int32(1)
    for i in range(len(marks)):
        # both counts contain the line itself
        n = np.int32(before[i] & COUNT) + np.int32(after[i] & COUNT)
        is_free = (n <= most) & ((before[i] | after[i]) < CLOSE)
        is_narrow = n <= few
        marks[i] = counted[i] * (is_free * FREE + is_narrow * NARROW)


@inlined
def _lines_of_object(before: np.uint8, after: np.uint8) -> np.float32:
    return np.float32(before & COUNT) + np.float32(after & COUNT) - np.float32(1)


@helper
def _mark_joins(ranges: F32, counted: U8, jump: np.float32, joins: U8) -> None:
    """Mark the shots that are on one thing with the shot before them."""
    joins[0] = 0
    joined = joins[1:]
    next_m = ranges[1:]
    next_counted = counted[1:]
    for i in range(len(joined)):
        is_near = np.uint8(abs(next_m[i] - ranges[i]) < jump)
        joined[i] = is_near & counted[i] & next_counted[i]


@inlined
def _last_of_run(
    ranges: F32,
    counted: U8,
    joins: U8,
    i: int,
    way: int,
    marks: U8,
    thresholds: ColumnThresholds,
) -> int:
    """Follow a run to one side, over single shots that miss the thing; mark these."""
    j = i + way
    reach = int(thresholds.reach)
    while 0 <= j < len(ranges) and abs(j - i) <= reach:
        if j - way == i and joins[max(j, i)] != 0:
            i = j
        elif j - way != i and counted[j] != 0 and abs(ranges[j] - ranges[i]) < thresholds.jump_m:
            marks[j - way] = GAP
            i = j
        elif ranges[j] <= ranges[i] + thresholds.far_m:
            break
        j += way
    return i


@inlined
def _bulge(
    window_m: F32,
    line: int,
    i: int,
    before: np.uint8,
    after: np.uint8,
) -> np.float32:
    """Return how much nearer an object's two inner quarters of lines are than its outer ones, or 0.

    A scan plane that is turned about the vertical sees round things tilted, but they are even.
    """
    first = line - int(before & COUNT) + 1
    n = int(_lines_of_object(before, after))
    if n < 3:
        return np.float32(0.0)
    quarter = max(n // 4, 1)
    half = (n + 1) // 2
    tilt = np.float32((n - quarter - half) / (n - quarter))
    bulge = skew = np.float32(0.0)
    for k in range(half):
        left = window_m[first + k, i]
        right = window_m[first + n - 1 - k, i]
        share = np.float32(1.0 / (quarter if k < quarter else quarter - half))
        bulge += share * (left + right)
        skew += share * (right - left) * (tilt if k < quarter else 1)
    return bulge if abs(skew) < EVEN * bulge else np.float32(0.0)


@helper
def _climb(
    window_m: F32,
    line: int,
    i: int,
    up: int,
    beams: Beams,
    most: np.float32,
) -> np.float32:
    """Return how much higher than a shot adjacent lines see its object [m].

    A slanted scan plane climbs an upright object from line to line.

    ``up`` is the direction of columns upwards, 1 or -1; the climb ends at ``most``.
    """
    sine, cosine = beams
    range_m = window_m[line, i]
    highest = np.float32(0.0)
    side = range_m * sine[i]
    foot = -(range_m * cosine[i])
    for way in (-1, 1):
        k = line + way
        j = i
        top = foot
        is_seen = True
        while is_seen and 0 <= k < len(window_m) and top - foot < most:
            q = j
            is_seen = False
            while 0 <= q < len(sine) and range_m * (cosine[j] - cosine[q]) < CLIMB_M:
                next_m = window_m[k, q]
                if abs(next_m * sine[q] - side) < CLIMB_SIDE_M:
                    top = max(top, -(next_m * cosine[q]))
                    j = q
                    is_seen = True
                q += up
            k += way
        highest = max(highest, top - foot)
    return highest


@inlined
def _is_fence(window_m: F32, line: int, i: int) -> bool:
    """Whether many lines farther along the street see something at a shot's range."""
    n = 0
    range_m = window_m[line, i]
    for k in range(max(line - FENCE_LINES[1], 0), min(line + FENCE_LINES[1] + 1, len(window_m))):
        n += (abs(k - line) >= FENCE_LINES[0]) & (abs(window_m[k, i] - range_m) < FENCE_M)
    return n >= FENCE_SEEN


@inlined
def _kind_of_run(
    window_m: F32,
    line: int,
    first: int,
    end: int,
    side: F32,
    above: F32,
    before: U8,
    after: U8,
    marks: U8,
    beams: Beams,
    thresholds: ColumnThresholds,
) -> np.uint8:
    """Return the kind of the shots ``first`` to ``end``: POST, MAST, SMALL, or 0 for none.

    Two groups of its shots are looked at, one after the other: those that few lines see (NARROW),
    which may be something small, then those that lines on both sides see far past (FREE), which
    may be a trunk or post.
    """
    n_free = n_few = n_far = 0
    for j in range(first, end):
        n_free += int(marks[j] & FREE != 0)
        n_few += int(marks[j] & NARROW != 0)
        n_far += int(marks[j] == FREE | NARROW)
    n_shots = np.float32(end - first)
    is_few = np.float32(n_few) >= max(thresholds.shots, thresholds.small_share * n_shots)
    is_free = np.float32(n_free) >= max(thresholds.shots, thresholds.share * n_shots)
    is_far = np.float32(n_far) >= MAST_SHARE * n_shots
    # most runs end here
    if not (is_few or is_free or is_far):
        return np.uint8(0)
    n_thin = 0
    head = first
    top = thresholds.high_m
    low = inner = few_low = few_inner = np.float32(np.inf)
    high = outer = few_high = few_outer = -low
    for j in range(first, end):
        if marks[j] & FREE != 0:
            n_thin += int(_lines_of_object(before[j], after[j]) <= thresholds.thin_lines)
            inner = min(inner, abs(side[j]))
            outer = max(outer, abs(side[j]))
            low = min(low, above[j])
            high = max(high, above[j])
        if marks[j] & NARROW != 0:
            head = j if above[j] > few_high else head
            few_inner = min(few_inner, abs(side[j]))
            few_outer = max(few_outer, abs(side[j]))
            few_low = min(few_low, above[j])
            few_high = max(few_high, above[j])
    deep = few_outer - few_inner
    tall = few_high - few_low
    if is_few and few_high < top and deep <= thresholds.small_m:
        is_upwards = beams.cosine[max(head - 1, 0)] > beams.cosine[min(head + 1, len(side) - 1)]
        up = 1 if is_upwards else -1
        climbed = few_high + _climb(window_m, line, head, up, beams, top)
        is_seen_past = np.float32(n_far) >= thresholds.small_share * np.float32(n_few)
        is_person = climbed > thresholds.person_m and (
            few_low <= CHEST_M or tall > thresholds.post_tall_m
        )
        if climbed < top and (is_person or is_seen_past):
            is_post = tall > thresholds.post_tall_m or climbed < thresholds.post_top_m
            is_post = is_post and is_seen_past and deep < thresholds.post_m
            return POST if is_post else SMALL
    if is_far and tall >= thresholds.mast_m and deep < MAST_SLOPE * tall:
        # a mast ends before the sky or far things, a trunk in its crown
        last, way = (end - 1, 1) if above[end - 1] > above[first] else (first, -1)
        is_mast = True
        for k in range(1, MAST_BEYOND + 1):
            j = min(max(last + way * k, 0), len(side) - 1)
            beyond_m = window_m[line, j] - window_m[line, last]
            is_mast &= not (beyond_m <= thresholds.far_m) or abs(beyond_m) < thresholds.jump_m
        if is_mast:
            return MAST
    deep = outer - inner
    tall = high - low
    if not is_free or deep > thresholds.deep_m or low > thresholds.low_m:
        return np.uint8(0)
    if tall < thresholds.tall_m or high < top:
        return np.uint8(0)
    if 2 * n_thin > n_free:
        return POST
    # what many lines see is a trunk only if it is round, at most of a sample of its shots
    n_sampled = n_round = k = 0
    stride = max(n_free // SAMPLES, 1)
    for j in range(first, end):
        if marks[j] & FREE == 0:
            continue
        if k % stride == 0:
            across = abs(side[j]) / window_m[line, j]
            radius = _bulge(window_m, line, j, before[j], after[j]) * across / ROUND
            least_m = thresholds.round_m * _lines_of_object(before[j], after[j])
            n_round += least_m <= radius <= thresholds.deep_m
            n_sampled += 1
        k += 1
    return POST if 2 * n_round > n_sampled else np.uint8(0)


@inlined
def _is_piece(ranges: F32, above: F32, first: int, end: int, thresholds: ColumnThresholds) -> bool:
    """Whether a run is short, with nothing or only far things beyond both ends."""
    is_free = first == 0 or not (ranges[first - 1] <= ranges[first] + thresholds.far_m)
    is_free &= end == len(above) or not (ranges[end] <= ranges[end - 1] + thresholds.far_m)
    if not is_free:
        return False
    low = high = above[first]
    for j in range(first, end):
        # shots that miss the thing have no height
        if above[j] != above[j]:
            return False
        low = min(low, above[j])
        high = max(high, above[j])
    return bool(high - low < thresholds.tall_m)


@loop()
def find_columns(
    window_m: F32_2,
    above_m: F32_2,
    neighbours: Neighbours,
    beams: Beams,
    thresholds: ColumnThresholds,
) -> U8_2:
    """Find posts, fences and other things that stand free, and say which of them a shot is on.

    Such a thing is a few lines wide; lines on both sides see something far behind it.

    ``window_m`` (lines + 2 n, M) float32, metres; ``above_m`` (lines, M) float32, metres;
    ``neighbours`` (lines, M) uint8; ``beams`` (M,) float32; returns (lines, M) uint8.
    """
    n_lines, m = above_m.shape
    margin = (len(window_m) - n_lines) // 2
    jump = thresholds.jump_m
    far = thresholds.far_m
    after = np.empty((n_lines, m), np.uint8)
    lines = np.full(m, NO_END)
    for k in range(len(window_m) - 3, margin - 1, -1):
        _count_lines_of_objects(window_m[k], window_m[k + 1], window_m[k + 2], jump, far, lines)
        if k < margin + n_lines:
            for i in range(m):
                after[k - margin, i] = lines[i]
    kinds = np.zeros((n_lines, m), np.uint8)
    counted = np.empty(m, np.uint8)
    joins = np.empty(m, np.uint8)
    marks = np.empty(m, np.uint8)
    side = np.empty(m, np.float32)
    for i in range(m):
        lines[i] = NO_END
    for k in range(2, margin + n_lines):
        _count_lines_of_objects(window_m[k], window_m[k - 1], window_m[k - 2], jump, far, lines)
        if k < margin:
            continue
        line = k - margin
        ranges = window_m[k]
        above = above_m[line]
        near = neighbours.near[line]
        _mark_free(lines, after[line], above, near, thresholds, counted, marks)
        _mark_joins(ranges, counted, jump, joins)
        for i in range(m):
            side[i] = ranges[i] * beams.sine[i]
        end = 0
        for i in range(m):
            if marks[i] == 0 or i < end:
                continue
            first = _last_of_run(ranges, counted, joins, i, -1, marks, thresholds)
            end = _last_of_run(ranges, counted, joins, i, 1, marks, thresholds) + 1
            kind = _kind_of_run(
                window_m,
                k,
                first,
                end,
                side,
                above,
                lines,
                after[line],
                marks,
                beams,
                thresholds,
            )
            is_piece = kind == 0 and _is_piece(ranges, above, first, end, thresholds)
            for j in range(first, end):
                if marks[j] & FREE == 0 and (kind < MAST or marks[j] == GAP):
                    continue
                n_seen = _lines_of_object(lines[j], after[line, j])
                kind_of_shot = kind
                if kind == 0 and n_seen <= thresholds.piece_lines:
                    if n_seen <= thresholds.slim_lines:
                        kind_of_shot = THIN
                    elif is_piece:
                        kind_of_shot = SHORT
                    if kind_of_shot != 0 and np.float32(end - first) < thresholds.shots:
                        kind_of_shot = FEW_SHOTS
                is_fence = (
                    kind != 0
                    and kind != MAST
                    and above[j] < thresholds.high_m
                    and _is_fence(window_m, k, j)
                )
                kinds[line, j] = FENCE if is_fence else kind_of_shot
    return kinds


@helper
def _list_counted(
    ranges: F32,
    side: F32,
    above: F32,
    near: U8,
    step: np.float32,
    thresholds: StripThresholds,
    strips: I32,
    extents: F32,
    shots: I32,
) -> int:
    """List the shots of a line above the ground, return how many; write their strips and extents.

    One result a loop: the compiler cannot prove that several do not overlap.
    """
    least = thresholds.least_near
    foot = thresholds.foot_m
    for i in range(len(ranges)):
        counted = (above[i] >= foot) & (np.float32(near[i]) >= least)
        b = _bin(side[i] if counted else np.float32(0.0), STRIP_M) + np.int32(STRIPS // 2)
        strips[i] = b if counted & (b >= 0) & (b < STRIPS) else np.int32(-1)
    for i in range(len(ranges)):
        extents[i] = ranges[i] * step / max(abs(side[i]) / ranges[i], LEAST_COSINE)
    n = 0
    for i in range(len(ranges)):
        shots[n] = i
        n += strips[i] >= 0
    return n


@helper
def _mark_kinds(
    height: F32,
    above: F32,
    neighbours: Neighbours,
    kinds: U8,
    thresholds: StripThresholds,
    slots: U8,
    rough: U8,
    upright: U8,
    level: U8,
) -> None:
    """Write the slots of a line's shots; mark rough shots, walls and low level surfaces.

    A level surface above the scanner is a ceiling, and not marked.
    """
    _, pairs, up, flat = neighbours
    foot = thresholds.foot_m
    most_rough = thresholds.rough
    least_smooth = thresholds.smooth
    least_level = thresholds.level_smooth
    level_top = thresholds.level_top_m
    for i in range(len(above)):
        h = above[i] if above[i] >= foot else np.float32(0.0)
        slots[i] = np.uint8(min(h / SLOT_M, np.float32(SLOTS - 1)))
    # rough between two rough shots on either side: in crowns all shots are; at the ends of a pole
    # or an edge of a wall, where every second shot is compared, two are
    m = len(pairs)
    for i in range(m):
        rough[i] = np.uint8(np.float32(pairs[i]) <= most_rough)
    for away in (1, 2):
        before = pairs[: m - 2 * away]
        middle = rough[away : m - away]
        after = pairs[2 * away :]
        for i in range(m - 2 * away):
            middle[i] &= np.uint8(
                (np.float32(before[i]) <= most_rough) & (np.float32(after[i]) <= most_rough)
            )
    for i in range(len(above)):
        is_wall = (up[i] >= UPRIGHT_CHORDS) & (kinds[i] != POST) & (kinds[i] != MAST)
        upright[i] = np.uint8((np.float32(pairs[i]) >= least_smooth) & is_wall)
    for i in range(len(above)):
        level[i] = np.uint8(
            (np.float32(pairs[i]) >= least_level)
            & (flat[i] > up[i])
            & (above[i] < level_top)
            & (above[i] >= foot)
            & (height[i] < np.float32(0.0))
        )


@helper
def _fill_line(
    shots: I32,
    strips: I32,
    slot: U8,
    is_rough: U8,
    shares: StripSums,
    slots: FilledSlots,
    sums: StripSums,
) -> None:
    extent_of, wall_of, place_of, top_of = shares
    every, rough = slots
    length, wall, place, top = sums
    # sums stay in registers until the next shot is in another strip
    b = np.uint64(0)
    bits = every[b]
    rough_bits = rough[b]
    all_m = length[b]
    wall_m = wall[b]
    place_m = place[b]
    highest = top[b]
    for k in range(len(shots)):
        i = np.uint64(shots[k])
        strip = np.uint64(strips[i])
        if strip != b:
            every[b] = bits
            rough[b] = rough_bits
            length[b] = all_m
            wall[b] = wall_m
            place[b] = place_m
            top[b] = highest
            b = strip
            bits = every[b]
            rough_bits = rough[b]
            all_m = length[b]
            wall_m = wall[b]
            place_m = place[b]
            highest = top[b]
        bits |= np.uint64(1) << np.uint64(slot[i])
        rough_bits |= np.uint64(is_rough[i]) << np.uint64(slot[i])
        all_m += extent_of[i]
        wall_m += wall_of[i]
        place_m += place_of[i]
        highest = max(highest, top_of[i])
    every[b] = bits
    rough[b] = rough_bits
    length[b] = all_m
    wall[b] = wall_m
    place[b] = place_m
    top[b] = highest


@helper
def _mark_levels(
    shots: I32,
    marks: U8,
    side: F32,
    jump: np.float32,
    levels: U8,
) -> None:
    """Mark the bins from a shot on a level surface to the adjacent shots that are close to it."""
    n = 0
    for k in range(len(shots)):
        i = shots[k]
        shots[n] = i
        n += marks[i]
    for k in range(n):
        i = shots[k]
        y = side[i]
        first = y
        last = y
        for j in (i - 1, i + 1):
            if 0 <= j < len(side) and abs(side[j] - y) < jump:
                first = min(first, side[j])
                last = max(last, side[j])
        low = max(int(_bin(first, STRIP_M / np.float32(2.0))) + STRIPS, 0)
        high = min(int(_bin(last, STRIP_M / np.float32(2.0))) + STRIPS, 2 * STRIPS - 1)
        for q in range(low, high + 1):
            levels[q] = np.uint8(1)


@loop()
def fill_strips(
    range_m: F32_2,
    above_m: F32_2,
    neighbours: Neighbours,
    kinds: U8_2,
    beams: Beams,
    step: np.float32,
    thresholds: StripThresholds,
) -> tuple[FilledSlots, StripSums, U8_2]:
    """Sort shots above the ground into strips, line by line.

    ``range_m, above_m`` (lines, M) float32, metres; ``neighbours`` (lines, M) uint8;
    ``kinds`` (lines, M) uint8; ``beams`` (M,) float32; returns the slots and sums of every strip,
    (lines, STRIPS), and ``levels`` (lines, 2 STRIPS) uint8.
    """
    n_lines, m = range_m.shape
    side = np.empty(m, np.float32)
    height = np.empty(m, np.float32)
    every = np.empty((n_lines, STRIPS), np.uint64)
    rough = np.empty((n_lines, STRIPS), np.uint64)
    length = np.empty((n_lines, STRIPS), np.float32)
    wall = np.empty((n_lines, STRIPS), np.float32)
    place = np.empty((n_lines, STRIPS), np.float32)
    top = np.empty((n_lines, STRIPS), np.float32)
    levels = np.empty((n_lines, 2 * STRIPS), np.uint8)
    shots = np.empty(m + 1, np.int32)
    strips = np.empty(m, np.int32)
    slot = np.empty(m, np.uint8)
    marks = np.empty((3, m), np.uint8)
    # of every shot of a line
    shares = StripSums(
        np.empty(m, np.float32),
        np.empty(m, np.float32),
        np.empty(m, np.float32),
        np.empty(m, np.float32),
    )
    for k in range(n_lines):
        for b in range(STRIPS):
            every[k, b] = rough[k, b] = np.uint64(0)
            length[k, b] = wall[k, b] = place[k, b] = np.float32(0.0)
            top[k, b] = NO_TOP
        for q in range(2 * STRIPS):
            levels[k, q] = np.uint8(0)
        ranges = range_m[k]
        above = above_m[k]
        for i in range(m):
            side[i] = ranges[i] * beams.sine[i]
        for i in range(m):
            height[i] = -(ranges[i] * beams.cosine[i])
        n = _list_counted(
            ranges,
            side,
            above,
            neighbours.near[k],
            step,
            thresholds,
            strips,
            shares.length_m,
            shots,
        )
        neighbours_of_line = Neighbours(
            neighbours.near[k], neighbours.smooth[k], neighbours.upright[k], neighbours.level[k]
        )
        _mark_kinds(
            height,
            above,
            neighbours_of_line,
            kinds[k],
            thresholds,
            slot,
            marks[0],
            marks[1],
            marks[2],
        )
        # shares of the line's shots in walls: no length and no top off walls
        upright = marks[1]
        extents, wall_of, place_of, top_of = shares
        for i in range(len(upright)):
            wall_of[i] = extents[i] if upright[i] != 0 else np.float32(0.0)
        for i in range(len(upright)):
            place_of[i] = extents[i] * side[i] if upright[i] != 0 else np.float32(0.0)
        for i in range(len(upright)):
            top_of[i] = height[i] if upright[i] != 0 else NO_TOP
        sums = StripSums(length[k], wall[k], place[k], top[k])
        slots = FilledSlots(every[k], rough[k])
        _fill_line(shots[:n], strips, slot, marks[0], shares, slots, sums)
        _mark_levels(shots[:n], marks[2], side, thresholds.jump_m, levels[k])
    return FilledSlots(every, rough), StripSums(length, wall, place, top), levels


@loop()
def widen_slots(slots: U64_2) -> U64_2:
    """Combine the slots of a line with those of the lines and strips around.

    ``slots`` (lines + 4, STRIPS) uint64; returns (lines, STRIPS) uint64.
    """
    n_lines = slots.shape[0] - 2 * LINES
    wide = np.empty((n_lines, STRIPS), np.uint64)
    lines = np.empty(STRIPS + 2, np.uint64)
    lines[0] = lines[STRIPS + 1] = np.uint64(0)
    for line in range(n_lines):
        row = wide[line]
        for b in range(STRIPS):
            lines[b + 1] = (
                slots[line, b]
                | slots[line + 1, b]
                | slots[line + 2, b]
                | slots[line + 3, b]
                | slots[line + 4, b]
            )
        for b in range(STRIPS):
            row[b] = lines[b] | lines[b + 1] | lines[b + 2]
    return wide


@loop()
def widen_levels(levels: U8_2) -> U8_2:
    """Combine the level surfaces of a line with those of the lines around.

    ``levels`` (lines + 4, 2 STRIPS) uint8; returns (lines, 2 STRIPS) uint8.
    """
    n_lines = levels.shape[0] - 2 * LINES
    n = levels.shape[1]
    wide = np.empty((n_lines, n), np.uint8)
    for line in range(n_lines):
        row = wide[line]
        for b in range(n):
            row[b] = (
                levels[line, b]
                | levels[line + 1, b]
                | levels[line + 2, b]
                | levels[line + 3, b]
                | levels[line + 4, b]
            )
    return wide


@helper
def sum_around(
    values: F32,
    line: int,
    lines: F32,
    sums: F32,
) -> None:
    """Add up the values of five lines, and then of three strips."""
    for b in range(STRIPS):
        before = (values[line, b] + values[line + 1, b]) + values[line + 2, b]
        lines[b + 1] = (before + values[line + 3, b]) + values[line + 4, b]
    lines[0] = lines[STRIPS + 1] = np.float32(0.0)
    for b in range(STRIPS):
        sums[b] = (lines[b] + lines[b + 1]) + lines[b + 2]


@helper
def _look_out(
    is_wall: U8,
    wall_at: F32,
    tops: F32,
    thresholds: WallThresholds,
    walls: Walls,
) -> None:
    """Write, for every strip of a line, the last wall before it and the next one behind it."""
    half = STRIPS // 2
    for s in range(2):
        way = 1 if s == 0 else -1
        first = half if s == 0 else half - 1
        last = -1
        for k in range(half):
            b = first + way * k
            if is_wall[b]:
                last = b
            if last >= 0:
                walls.side_m[b] = wall_at[last]
                walls.top_m[b] = tops[last]
        last = -1
        for k in range(half - 1, -1, -1):
            b = first + way * k
            if is_wall[b]:
                last = b
            if (
                last >= 0
                and abs(wall_at[last]) - np.float32(k) * STRIP_M <= thresholds.before_m + STRIP_M
            ):
                walls.ahead_m[b] = wall_at[last]


@loop()
def find_walls(sums: StripSums, flanks: U8_2, thresholds: WallThresholds) -> Walls:
    """Find the walls beside every line: strips with enough smooth upright surface.

    ``sums`` (lines + 4, STRIPS) float32; ``flanks`` (lines, STRIPS) uint8; returns the walls,
    (lines, STRIPS) float32, metres.
    """
    n_lines = sums.length_m.shape[0] - 2 * LINES
    walls = Walls(
        np.empty((n_lines, STRIPS), np.float32),
        np.empty((n_lines, STRIPS), np.float32),
        np.empty((n_lines, STRIPS), np.float32),
    )
    lines = np.empty(STRIPS + 2, np.float32)
    length_m = np.empty(STRIPS, np.float32)
    wall_m = np.empty(STRIPS, np.float32)
    places = np.empty(STRIPS, np.float32)
    top_m = np.empty(STRIPS, np.float32)
    wall_at = np.empty(STRIPS, np.float32)
    is_wall = np.empty(STRIPS, np.uint8)
    is_filled = np.empty(STRIPS + 2, np.uint8)
    n_filled = np.empty(STRIPS, np.uint8)
    least_m = thresholds.height_m * np.float32(2 * LINES + 1)
    for line in range(n_lines):
        sum_around(sums.length_m, line, lines, length_m)
        sum_around(sums.wall_m, line, lines, wall_m)
        sum_around(sums.wall_place, line, lines, places)
        # the highest of five lines and three strips
        tops = sums.top_m
        for b in range(STRIPS):
            before = max(tops[line, b], tops[line + 1, b])
            after = max(tops[line + 3, b], tops[line + 4, b])
            lines[b + 1] = max(max(before, tops[line + 2, b]), after)
        lines[0] = lines[STRIPS + 1] = NO_TOP
        for b in range(STRIPS):
            top_m[b] = max(max(lines[b], lines[b + 1]), lines[b + 2])
        # how many of five lines have something in a strip or beside it
        for b in range(STRIPS):
            n_filled[b] = np.uint8(0)
        is_filled[0] = is_filled[STRIPS + 1] = 0
        for k in range(line, line + 2 * LINES + 1):
            for b in range(STRIPS):
                is_filled[b + 1] = sums.wall_m[k, b] > 0
            for b in range(STRIPS):
                n_filled[b] += is_filled[b] | is_filled[b + 1] | is_filled[b + 2]
        side_m, tops_m, ahead_m = walls.side_m[line], walls.top_m[line], walls.ahead_m[line]
        for b in range(STRIPS):
            side_m[b] = tops_m[b] = ahead_m[b] = np.float32(0.0)
            is_tall = (wall_m[b] >= least_m) & (wall_m[b] > 0)
            is_most = wall_m[b] >= thresholds.share * length_m[b]
            is_seen = np.float32(n_filled[b]) >= thresholds.lines
            is_wall[b] = is_tall & is_most & is_seen & (flanks[line, b] == 0)
            wall_at[b] = places[b] / wall_m[b] if is_wall[b] else np.float32(0.0)
        _look_out(is_wall, wall_at, top_m, thresholds, Walls(side_m, tops_m, ahead_m))
    return walls
