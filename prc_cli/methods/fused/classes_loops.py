"""Loops of the fused classifier that label every shot, from its neighbours, the ground and the walls."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import LABEL_BITS, Label, Reason
from prc_cli.core.types import F32, F32_1, F32_2, I32, U8, U8_2, U64_2, Mask, Mask_2
from prc_cli.kernels.cache import helper, inlined, kernel
from prc_cli.methods.fused.thresholds import DecisionThresholds

Slots = NDArray[np.uint64]
Pairs = NDArray[np.uint32]

LINES = 2
"""Lines before and after a line that its texture is computed from."""
MARGIN = 20
"""Lines of the window before and after the block."""
BESIDE = 12
"""Lines before and after by which a pole is found to be thick."""
BOX_ODD = 3
"""Consecutive lines that see something else than a box where it ends.

All of them but one see past it.
"""
BOX_EVEN_M = np.float32(0.12)
"""Shots this much below the highest one of a box are on its top [m]."""
BOX_SMOOTH = 3
"""Smooth pairs of a smooth shot of a box."""
BOX_SHARE = np.float32(0.8)
"""Least share of such shots."""
MOST_SMOOTH = 8
"""Greatest number of smooth pairs that counts."""
LEAST_COLUMNS = 2
"""Least half width of a place, in columns."""
COLUMN, THIN, _, FEW, SMALL, FENCE = (np.uint8(kind) for kind in (1, 2, 3, 4, 5, 6))
STRIPS = 320
STRIP_M = np.float32(0.5)
SLOT_M = np.float32(0.25)
SLOTS = 64
"""As in :mod:`strips_loops`."""
HANGS = 16
"""As in :mod:`flanks_loops`."""
HALF_STRIP_M = np.float32(0.25)
"""Width of a bin of level surfaces [m]."""
SPIKE_PLACE_M = np.float32(0.1)
"""Half width of the place beside a spike [m]."""
SPIKE_COLUMNS = 6
_FAR_BINS = np.float32(1e6)
LEAF_REACH = 4
"""Slots up and down in which other leaves are looked for."""
CAR_REACH = 6
"""Bins on either side in which level surfaces count."""
BELOW_SMOOTH = 3
"""With this many smooth pairs, a shot below the ground is no reflection."""
GAP_SHOTS = 3
"""Lonely shots within a box."""
_MISSING = int(Label.MISSING)
_NOISE = int(Label.NOISE)
_GROUND = int(Label.GROUND)
_OPEN = 255
_LEAF = 254
_ODD = 253
"""Marks of undecided shots, of lonely leaves, and of shots that may be noise.

No reason is one of them.
"""
_LABEL = np.uint8(LABEL_BITS)
_LONELY, _ISOLATED, _SPIKE, _BELOW = (
    np.uint8(rule) for rule in (Reason.LONELY, Reason.ISOLATED, Reason.SPIKE, Reason.BELOW_GROUND)
)
_BEHIND_WALL = np.uint8(Reason.BEHIND_WALL)
_IN_CAR = np.uint8(Reason.IN_CAR)
_WALKED = np.uint8(Reason.WALKED)
_LEVEL_LOW = np.uint8(Reason.LEVEL_LOW)
_LOW = np.uint8(Reason.LOW)
_SMOOTH = np.uint8(Reason.SMOOTH)
_FACADE = np.uint8(Reason.FACADE)
_ONE_LEAF = np.uint8(Reason.LEAF)
_FOLIAGE = np.uint8(Reason.FOLIAGE)
_CROWN = np.uint8(Reason.CROWN)
_TRUNK = np.uint8(Reason.TRUNK)
_SMALL = np.uint8(Reason.SMALL)
_LEVEL_BODY = np.uint8(Reason.LEVEL_BODY)
_POST = np.uint8(Reason.POST)
_ARM = np.uint8(Reason.ARM)
_BOX = np.uint8(Reason.BOX)


@helper
def _count_pairs(
    near: U8,
    smooth: U8,
    least: np.float32,
    places: Pairs,
) -> None:
    """Write the counts of a line's shots.

    One shot in the upper half of a word, its smooth pairs in the lower half.

    A place has at most 605 shots and 4840 pairs, so neither half overflows.
    """
    for i in range(len(near)):
        pairs = np.uint32(min(smooth[i], np.uint8(MOST_SMOOTH)))
        places[i] = pairs | np.uint32(1 << 16) if np.float32(near[i]) >= least else np.uint32(0)


@helper
def _sum_up_three(
    one: Pairs,
    other: Pairs,
    third: Pairs,
    so_far: Pairs,
) -> None:
    """Write the sums of the first 0, 1, ... columns of three lines together.

    As :func:`_sum_up` does.
    """
    own = so_far[1:]
    for i in range(len(one)):
        own[i] = one[i] + other[i] + third[i]
    total = np.uint32(0)
    so_far[0] = total
    for i in range(len(one)):
        total = np.uint32(total + own[i])
        own[i] = total


@helper
def _lay_out(
    ranges: F32,
    beams: tuple[F32, F32],
    side: F32,
    height: F32,
) -> None:
    """Write the points of a line in the scan plane."""
    sine, cosine = beams
    for i in range(len(ranges)):
        side[i] = ranges[i] * sine[i]
    for i in range(len(ranges)):
        height[i] = -(ranges[i] * cosine[i])


@helper
def _half_widths(
    ranges: F32,
    step: np.float32,
    half_m: np.float32,
    most: int,
    columns: I32,
) -> None:
    """Write the half width of every shot's place in columns.

    Any number where the shot is missing.
    """
    fewest = np.float32(LEAST_COLUMNS)
    most_of_all = np.float32(most)
    for i in range(len(ranges)):
        r = ranges[i] if ranges[i] == ranges[i] else np.float32(1.0)
        columns[i] = np.int32(min(max(half_m / (r * step), fewest), most_of_all))


@inlined
def _bits(word: np.uint64) -> int:
    """Count the bits of a word."""
    n = 0
    while word != np.uint64(0):
        word &= word - np.uint64(1)
        n += 1
    return n


@inlined
def _strip(y: np.float32) -> int:
    """Return the strip of a shot, -1 = beyond."""
    b = int(np.floor(y / STRIP_M)) + STRIPS // 2
    return b if 0 <= b < STRIPS else -1


@inlined
def _slot(above: np.float32) -> int:
    return int(min(max(above / SLOT_M, np.float32(0.0)), np.float32(SLOTS - 1)))


@inlined
def _slots_around(word: np.uint64, slot: int) -> int:
    """Count the slots with something, near a slot."""
    low = max(slot - LEAF_REACH, 0)
    high = min(slot + LEAF_REACH, SLOTS - 1)
    ones = ~np.uint64(0) >> np.uint64(SLOTS - 1 - (high - low))
    return _bits(word & (ones << np.uint64(low)))


@inlined
def _depth_across(
    window_m: F32,
    line: int,
    i: int,
    jump: np.float32,
) -> np.float32:
    """Return how deep the thing is that lines before and after see in the direction of a shot, along its beam."""
    least = most = window_m[line, i]
    for way in (-1, 1):
        last = window_m[line, i]
        for k in range(1, BESIDE + 1):
            there = window_m[line + way * k, i]
            if not (abs(there - last) < jump):
                break
            least = min(least, there)
            most = max(most, there)
            last = there
    return np.float32(most - least)


@inlined
def _ground_rule(
    h: np.float32,
    is_walked: bool,
    up: np.uint8,
    flat: np.uint8,
    thresholds: DecisionThresholds,
) -> np.uint8:
    """Return why a shot is on the ground.

    Walked over, or low and more level than upright; 0 = it is not.
    """
    off = abs(h)
    rule = _LOW if (off < thresholds.soil_m) & (up <= flat + np.uint8(1)) else np.uint8(0)
    rule = _LEVEL_LOW if (off < thresholds.level_m) & (flat > up) else rule
    return _WALKED if (off < thresholds.walked_m) & is_walked else rule


@helper
def _label_plain(
    ranges: F32,
    above: F32,
    counts: tuple[U8, U8, U8, U8],
    walked: Mask,
    thresholds: DecisionThresholds,
    labels: U8,
) -> None:
    """Label missing shots, near shots without any neighbour, and ground.

    Mark the others as undecided.

    Without branches, so that the compiler can use vector instructions.
    """
    near, smooth, upright, level = counts
    least = thresholds.least_near
    below = thresholds.below_m
    lone = thresholds.lone_m
    for i in range(len(ranges)):
        h = above[i]
        pairs = smooth[i]
        up = upright[i]
        flat = level[i]
        ground = _ground_rule(h, walked[i], up, flat, thresholds)
        n_near = np.float32(near[i])
        is_held = (n_near >= least) & (pairs > 0) & ((h >= -below) | (pairs >= BELOW_SMOOTH))
        is_odd = (n_near < least) | (pairs == 0) | (h < -below)
        code = np.uint8(_ODD) if is_odd else np.uint8(_OPEN)
        code = ground if (ground != 0) & is_held else code
        code = _LONELY if (near[i] == 0) & (n_near < least) & (ranges[i] <= lone) else code
        labels[i] = code if ranges[i] == ranges[i] else np.uint8(_MISSING)


@inlined
def _in_wall(
    y: np.float32,
    z: np.float32,
    at: np.float32,
    top: np.float32,
    thresholds: DecisionThresholds,
) -> bool:
    """Return whether a shot is in a wall, or behind it and seen through it."""
    behind = abs(y) - abs(at)
    through = z * (abs(at) / abs(y)) if behind > np.float32(0.0) else z
    is_between = (behind >= -thresholds.front_m) & (behind <= thresholds.behind_m)
    return bool((at != np.float32(0.0)) & is_between & (through <= top + thresholds.over_m))


@helper
def _count_bins(levels: U8, counts: U8) -> None:
    """Count the bins with a level surface around every bin of a line."""
    n = len(levels)
    counts[:] = levels
    for away in range(1, CAR_REACH + 1):
        for q in range(n - away):
            counts[q] += levels[q + away]
        for q in range(n - away):
            counts[q + away] += levels[q]


@helper
def _find_cars(
    every: Slots,
    levels: U8,
    counts: U8,
    thresholds: DecisionThresholds,
    cars: tuple[F32, F32],
) -> None:
    """Write up to which height a smooth shot and a rough shot in every bin are of a car.

    0 = no car.

    There is a car where enough bins around are level. It ends below what reaches above cars without
    a gap; where they are those of a body that hangs high, lorries.
    """
    smooth_bins = thresholds.car_bins
    rough_bins = thresholds.car_bins_rough
    car_slot = int(thresholds.car_top_m / SLOT_M)
    lorry_slot = int(thresholds.lorry_top_m / SLOT_M)
    least = min(smooth_bins, rough_bins)
    _count_bins(levels, counts)
    last = -1
    below = np.float32(0.0)
    for q in range(2 * STRIPS):
        n = np.float32(counts[q] & (HANGS - 1))
        hanging = np.float32(counts[q] // HANGS)
        if n < least:
            cars[0][q] = cars[1][q] = np.float32(0.0)
            continue
        b = q // 2
        high = hanging >= least
        place = 2 * b + 1 if high else 2 * b
        if place != last:
            word = every[b]
            last = place
            filled = word | (word << np.uint64(1)) | (word << np.uint64(2))
            slot = lorry_slot if high else car_slot
            while slot > 0 and (filled >> np.uint64(slot - 1)) & np.uint64(1) != np.uint64(0):
                slot -= 1
            below = np.float32(slot) * SLOT_M
        cars[0][q] = below if n >= smooth_bins else np.float32(0.0)
        cars[1][q] = below if n >= rough_bins else np.float32(0.0)


@helper
def _list_marked(
    labels: U8,
    least: int,
    most: int,
    shots: I32,
) -> int:
    """List the shots of a line with marks from one to another, return how many there are."""
    n = 0
    for i in range(len(labels)):
        shots[n] = i
        n += (labels[i] >= least) & (labels[i] <= most)
    return n


@helper
def _label_odd(
    shots: I32,
    points: tuple[F32, F32, F32],
    counts: tuple[U8, U8, U8, U8],
    walked: Mask,
    rows: tuple[Slots, F32, F32],
    spikes: tuple[I32, Pairs],
    thresholds: DecisionThresholds,
    labels: U8,
) -> None:
    """Label noise among the doubtful shots of a line, and ground; mark lonely leaves."""
    side, height, above = points
    near, smooth, upright, level = counts
    rough, at, top = rows
    columns, so_far = spikes
    least = thresholds.least_near
    below = thresholds.below_m
    share = thresholds.spike_share
    foot = thresholds.foot_m
    leaf_slots = thresholds.leaf_slots
    for k in range(len(shots)):
        i = shots[k]
        h = above[i]
        pairs = smooth[i]
        is_leaf = False
        if np.float32(near[i]) < least:
            y = side[i]
            b = _strip(y)
            is_wall = b >= 0 and _in_wall(y, height[i], at[b], top[b], thresholds)
            # the few shots left of a far surface still agree with it
            is_held = pairs > 0 or is_wall or abs(h) < thresholds.soil_m
            if b >= 0 and h > foot and not is_wall:
                # far away, gaps between leaves are wider than what counts as near
                is_leaf = bool(np.float32(_slots_around(rough[b], _slot(h))) >= leaf_slots)
            if not (is_leaf or (is_held and near[i] > 0)):
                labels[i] = _ISOLATED
                continue
        # spikes: the adjacent shots are smooth, in the line and in the lines before and after
        half = int(columns[i])
        place = so_far[min(i + half + 1, len(side))] - so_far[max(i - half, 0)]
        shots_there = np.int32(place >> np.uint32(16))
        pairs_there = np.int32(place & np.uint32(0xFFFF))
        is_spike = (pairs == 0) & (
            np.float32(pairs_there) > share * np.float32(MOST_SMOOTH * shots_there)
        )
        is_pit = (upright[i] > 0) & (np.float32(near[i]) >= thresholds.pit_near)
        ground = _ground_rule(h, walked[i], upright[i], level[i], thresholds)
        if is_spike:
            labels[i] = _SPIKE
        elif (h < -below) & (pairs < BELOW_SMOOTH) & (not is_pit):
            labels[i] = _BELOW
        elif ground != 0:
            labels[i] = ground
        elif is_leaf:
            labels[i] = _LEAF


@helper
def _bins(side: F32, bins: I32) -> None:
    """Write the bin of half a strip of every shot of a line, -1 = beyond."""
    for i in range(len(side)):
        q = np.int32(np.floor(min(max(side[i] / HALF_STRIP_M, -_FAR_BINS), _FAR_BINS))) + np.int32(
            STRIPS
        )
        bins[i] = q if (q >= 0) & (q < 2 * STRIPS) else np.int32(-1)


@helper
def _look_up(
    shots: I32,
    bins: I32,
    walls: tuple[F32, F32, F32],
    cars: tuple[F32, F32],
    found: tuple[F32, F32, F32, F32, F32],
) -> None:
    """Write the walls and cars in the strips of some shots.

    a loop of its own, as all others read memory in order.
    """
    at, top, ahead = walls
    own_at, own_top, own_ahead, below, rough_below = found
    for k in range(len(shots)):
        i = np.uint64(shots[k])
        q = np.uint64(max(bins[i], np.int32(0)))
        b = q >> np.uint64(1)
        own_at[i] = at[b]
        own_top[i] = top[b]
        own_ahead[i] = ahead[b]
        below[i] = cars[0][q]
        rough_below[i] = cars[1][q]


@helper
def _label_things(
    points: tuple[F32, F32, F32],
    counts: tuple[U8, U8, U8, U8],
    soft: F32,
    bins: I32,
    found: tuple[F32, F32, F32, F32, F32],
    alone: U8,
    thresholds: DecisionThresholds,
    labels: U8,
    poles: U8,
) -> None:
    """Label the shots of a line that are neither lonely nor ground; mark those that may be poles.

    Without branches, so that the compiler can use vector instructions.
    """
    side, height, above = points
    near, smooth, _, level = counts
    at, top, ahead, car_below, rough_below = found
    leaf_share = thresholds.leaf_share
    share_before = thresholds.leaf_share_before_wall
    before_m = thresholds.before_m
    foot = thresholds.foot_m
    poles_wanted = thresholds.pole_m > 0
    ghost_m = thresholds.ghost_m
    ghost_near = thresholds.ghost_near
    least = thresholds.least_near
    nothing = np.float32(0.0)
    arm_m = thresholds.arm_m
    front_m = thresholds.front_m
    behind_m = thresholds.behind_m
    roof_m = thresholds.roof_m
    storey_m = thresholds.storey_m
    for i in range(len(labels)):
        y = side[i]
        z = height[i]
        h = above[i]
        texture = soft[i]
        is_leaf = labels[i] == _LEAF
        is_here = bins[i] >= 0
        wall = abs(at[i])
        end = top[i]
        is_wall = _in_wall(y, z, at[i], end, thresholds)
        before = abs(ahead[i]) - abs(y)
        is_before = (ahead[i] != nothing) & (before >= -STRIP_M) & (before <= before_m) & is_here
        beyond = abs(y) - wall
        is_roof = (
            (wall != nothing)
            & (beyond >= -front_m)
            & (beyond <= roof_m)
            & (end - z + h >= storey_m)
            & is_here
        )
        is_soft = texture < (share_before if is_before | is_roof else leaf_share)
        is_facade = is_roof & (beyond <= behind_m) & (end > nothing)
        is_rough = is_soft & (not ((is_wall & is_here) | is_facade))
        is_car = (h >= nothing) & (h < (rough_below[i] if is_rough else car_below[i])) & is_here
        label = _FACADE if is_soft else _SMOOTH
        label = _ONE_LEAF if is_leaf else label
        label = _FOLIAGE if is_rough else label
        label = _LEVEL_BODY if is_car else label
        is_bare = smooth[i] == 0
        is_past = (wall != nothing) & (z * wall <= end * abs(y)) & is_here
        is_far = ((beyond > ghost_m) & is_rough) | ((beyond > behind_m) & is_bare)
        is_lost = is_bare & is_car & (np.float32(near[i]) < least)
        is_behind = is_past & is_far & (np.float32(near[i]) < ghost_near)
        is_ghost = is_behind | is_lost
        label = _IN_CAR if is_lost else label
        label = _BEHIND_WALL if is_behind else label
        is_sure = is_here & (not is_ghost)
        is_small = is_sure & (alone[i] >= SMALL) & ((texture >= leaf_share) | is_car)
        label = (_SMOOTH if alone[i] == FENCE else _SMALL) if is_small else label
        is_open = labels[i] >= np.uint8(_ODD)
        labels[i] = label if is_open else labels[i]
        is_thin = alone[i] == THIN
        is_piece = (alone[i] != np.uint8(0)) & (alone[i] < SMALL)
        is_up = (level[i] == 0) | (h > arm_m)
        is_part = is_wall | (is_car & (not is_thin))
        may_be_pole = is_piece & is_up & (h > foot) & (texture >= leaf_share) & (not is_part)
        poles[i] = np.uint8(is_open & is_sure & (may_be_pole | (alone[i] == COLUMN)) & poles_wanted)


@helper
def _round_run(
    ranges: F32,
    points: tuple[F32, F32, F32],
    alone: U8,
    i: int,
    thresholds: DecisionThresholds,
) -> tuple[int, bool]:
    """Return the end of the run of a shot that stands alone, and whether it is as deep as the front half of a trunk.

    A slanted plane cuts an upright round thing from edge to edge, in an ellipse: it is seen as deep
    as its radius, and at least three times as high. What is deeper than that is something else, as
    is what goes up the whole line.
    """
    side, height, _ = points
    first = i
    end = i + 1
    jump = thresholds.jump_m
    while end < len(alone) and 0 < alone[end] < SMALL and abs(ranges[end] - ranges[end - 1]) < jump:
        end += 1
    while (
        first > 0 and 0 < alone[first - 1] < SMALL and abs(ranges[first - 1] - ranges[first]) < jump
    ):
        first -= 1
    deep = side[first:end].max() - side[first:end].min()
    tall = height[first:end].max() - height[first:end].min()
    is_round = (deep >= thresholds.thick_m) & (deep < np.float32(0.5) * tall)
    return end, bool(is_round & (tall < np.float32(2.0) * thresholds.pole_m))


@helper
def _label_poles(
    shots: I32,
    window_m: F32,
    line: int,
    level: U8,
    points: tuple[F32, F32, F32],
    alone: U8,
    rough: Slots,
    thresholds: DecisionThresholds,
    labels: U8,
) -> None:
    """Label a list of shots on poles and trunks.

    Of a piece of few shots only whether it is in a crown is known.
    """
    side, _, above = points
    end = 0
    is_round = False
    for k in range(len(shots)):
        i = shots[k]
        if i >= end:
            end, is_round = _round_run(window_m[line], points, alone, i, thresholds)
        crown = np.float32(_bits(rough[_strip(side[i])] >> np.uint64(_slot(above[i]))))
        if crown >= thresholds.crown_slots:
            labels[i] = _CROWN
        elif alone[i] != FEW:
            deep_m = _depth_across(window_m, line, i, thresholds.jump_m) * (
                abs(side[i]) / window_m[line, i]
            )
            upright = _POST if level[i] == 0 or alone[i] == COLUMN else _ARM
            labels[i] = _TRUNK if is_round or deep_m >= thresholds.thick_m else upright


@inlined
def _is_thing(rule: np.uint8) -> bool:
    """Return whether a rule is that of a thing above the ground."""
    label = rule & _LABEL
    return bool((label != _MISSING) & (label != _NOISE) & (label != _GROUND))


@inlined
def _is_soil(rule: np.uint8) -> bool:
    return bool(rule & _LABEL == _GROUND)


@helper
def _mark_tops(
    above: F32,
    counts: tuple[U8, U8, U8, U8],
    labels: U8,
    thresholds: DecisionThresholds,
    marks: U8,
) -> None:
    """Mark the shots of a line that may be on the top of a box: low, smooth and level."""
    _, smooth, upright, level = counts
    foot = thresholds.foot_m
    top = thresholds.box_m
    for i in range(len(labels)):
        is_low = (above[i] > foot) & (above[i] < top)
        is_level = (level[i] > upright[i]) & (smooth[i] >= BOX_SMOOTH)
        marks[i] = np.uint8(is_low & is_level & _is_thing(labels[i]))


@inlined
def _lines_beside(
    window_m: F32,
    line: int,
    i: int,
    way: int,
    thresholds: DecisionThresholds,
) -> int:
    """Return how many lines to one side see a thing in the direction of a shot, if those beyond see past it.

    Otherwise :data:`MARGIN`. Single lines do not count: they see background light, or look through
    a pane.
    """
    last = window_m[line, i]
    n = odd = past = 0
    for k in range(1, MARGIN + 1):
        there = window_m[line + way * k, i]
        if abs(there - last) < thresholds.jump_m:
            last = there
            n = k
            odd = 0
            past = 0
            continue
        odd += 1
        past += not (there <= last + thresholds.far_m)
        if odd == BOX_ODD:
            return n if past >= BOX_ODD - 1 else MARGIN
    return MARGIN


@helper
def _end_of_box(
    ranges: F32,
    near: U8,
    points: tuple[F32, F32, F32],
    labels: U8,
    i: int,
    way: int,
    thresholds: DecisionThresholds,
) -> tuple[int, int]:
    """Follow a box along its line to one side.

    Return its last shot, and the next one, -1 = none close by.

    The next one is the last itself where it is no box: too high, or cut off by the end of the line.
    """
    _, _, above = points
    last = i
    j = i + way
    gap = 0
    while 0 <= j < len(ranges):
        is_other = not _is_thing(labels[j]) and not _is_soil(labels[j])
        if is_other or np.float32(near[j]) < thresholds.least_near:
            gap += 1
            if gap > GAP_SHOTS:
                return last, -1
        elif _is_soil(labels[j]) or not abs(ranges[j] - ranges[last]) < thresholds.jump_m:
            return last, j
        elif above[j] >= thresholds.box_m:
            return last, last
        else:
            last = j
            gap = 0
        j += way
    return last, last


@helper
def _is_box(
    window_m: F32,
    line: int,
    i: int,
    ends: tuple[int, int],
    points: tuple[F32, F32, F32],
    smooth: U8,
    labels: U8,
    thresholds: DecisionThresholds,
) -> bool:
    """Return whether the shots from one to another are a bin or a cabinet.

    Small to all sides, with a level top.
    """
    side, _, above = points
    first, last = ends
    high = inner_top = inner = np.float32(np.inf)
    high, outer, outer_top = -high, -high, -high
    n = n_smooth = 0
    for j in range(first, last + 1):
        if _is_thing(labels[j]):
            high = max(high, above[j])
            inner = min(inner, abs(side[j]))
            outer = max(outer, abs(side[j]))
            n += 1
            n_smooth += smooth[j] >= BOX_SMOOTH
    deep = outer - inner
    if (
        np.float32(n) < thresholds.pole_shots
        or deep > thresholds.box_deep_m
        or deep < thresholds.box_flat_m
    ):
        return False
    for j in range(first, last + 1):
        if _is_thing(labels[j]) and above[j] > high - BOX_EVEN_M:
            inner_top = min(inner_top, abs(side[j]))
            outer_top = max(outer_top, abs(side[j]))
    if outer_top - inner_top < thresholds.box_flat_m or np.float32(
        n_smooth
    ) < BOX_SHARE * np.float32(n):
        return False
    before = _lines_beside(window_m, line, i, -1, thresholds)
    if before == MARGIN or np.float32(before) > thresholds.box_lines:
        return False
    after = _lines_beside(window_m, line, i, 1, thresholds)
    return bool(after < MARGIN and np.float32(before + after) <= thresholds.box_lines)


@helper
def _label_boxes(
    shots: I32,
    window_m: F32,
    line: int,
    counts: tuple[U8, U8, U8, U8],
    points: tuple[F32, F32, F32],
    thresholds: DecisionThresholds,
    labels: U8,
) -> None:
    """Label the boxes whose tops are in a list: bins and cabinets.

    They stand alone: beyond their tops something far is seen, or nothing, and what is below them is
    ground.
    """
    ranges = window_m[line]
    height = points[1]
    done = -1
    for k in range(len(shots)):
        i = shots[k]
        if i <= done:
            continue
        first, before = _end_of_box(ranges, counts[0], points, labels, i, -1, thresholds)
        last, after = _end_of_box(ranges, counts[0], points, labels, i, 1, thresholds)
        done = last
        if before == first or after == last:
            continue
        is_up = height[last] > height[first]
        top, beyond, foot, below = (
            (last, after, first, before) if is_up else (first, before, last, after)
        )
        if beyond >= 0 and ranges[beyond] <= ranges[top] + thresholds.far_m:
            continue
        if below >= 0 and not _is_soil(labels[below]) and ranges[below] < ranges[foot]:
            continue
        if _is_box(window_m, line, i, (first, last), points, counts[1], labels, thresholds):
            for j in range(first, last + 1):
                labels[j] = _BOX if _is_thing(labels[j]) else labels[j]


@kernel()
def fused_labels(
    window_m: F32_2,
    above_m: F32_2,
    counts: tuple[U8_2, U8_2, U8_2, U8_2],
    walked: Mask_2,
    texture: F32_2,
    slots: tuple[U64_2, U64_2],
    walls: tuple[F32_2, F32_2, F32_2],
    levels: U8_2,
    alone: U8_2,
    beams: tuple[F32_1, F32_1],
    step: np.float32,
    thresholds: DecisionThresholds,
) -> U8_2:
    """Give every shot of consecutive lines the rule that decides on it (:class:`~prc_cli.core.classes.Reason`).

    ``window_m`` (lines + 40, M) float32, metres; ``above_m`` (lines + 4, M) float32, metres;
    ``counts`` tuple of (lines + 4, M) uint8; ``walked`` (lines + 4, M) bool; ``texture`` (lines, M)
    float32; ``slots`` tuple of (lines, STRIPS) uint64; ``walls`` tuple of (lines, STRIPS) float32,
    metres; ``levels`` (lines, 2 STRIPS) uint8; ``alone`` (lines, M) uint8; ``beams`` tuple of (M,)
    float32; returns (lines, M) uint8.
    """
    n_lines, m = texture.shape
    near, smooth, upright, level = counts
    labels = np.empty((n_lines, m), np.uint8)
    shots = np.empty(m + 1, np.int32)
    marks = np.empty(m, np.uint8)
    bin_counts = np.empty(2 * STRIPS, np.uint8)
    cars = (np.empty(2 * STRIPS, np.float32), np.empty(2 * STRIPS, np.float32))
    columns = np.empty(m, np.int32)
    bins = np.empty(m, np.int32)
    so_far = np.empty(m + 1, np.uint32)
    found = (
        np.zeros(m, np.float32),
        np.zeros(m, np.float32),
        np.zeros(m, np.float32),
        np.zeros(m, np.float32),
        np.zeros(m, np.float32),
    )
    side = np.empty(m, np.float32)
    height = np.empty(m, np.float32)
    # ring buffer of lines
    pairs = np.empty((3, m), np.uint32)
    for line in range(2):
        _count_pairs(
            near[line + LINES - 1], smooth[line + LINES - 1], thresholds.least_near, pairs[line]
        )
    for line in range(n_lines):
        k = line + LINES
        row = labels[line]
        own = (near[k], smooth[k], upright[k], level[k])
        ranges = window_m[line + MARGIN]
        _lay_out(ranges, beams, side, height)
        place = side, height, above_m[k]
        rows = walls[0][line], walls[1][line], walls[2][line]
        rough = slots[1][line]
        _label_plain(ranges, place[2], own, walked[k], thresholds, row)
        n = _list_marked(row, _ODD, _ODD, shots)
        _count_pairs(near[k + 1], smooth[k + 1], thresholds.least_near, pairs[(line + 2) % 3])
        _sum_up_three(pairs[0], pairs[1], pairs[2], so_far)
        _half_widths(ranges, step, SPIKE_PLACE_M, SPIKE_COLUMNS, columns)
        _label_odd(
            shots[:n],
            place,
            own,
            walked[k],
            (rough, rows[0], rows[1]),
            (columns, so_far),
            thresholds,
            row,
        )
        n = _list_marked(row, _ODD, _OPEN, shots)
        _find_cars(slots[0][line], levels[line], bin_counts, thresholds, cars)
        _bins(place[0], bins)
        _look_up(shots[:n], bins, rows, cars, found)
        _label_things(place, own, texture[line], bins, found, alone[line], thresholds, row, marks)
        n = _list_marked(marks, 1, 1, shots)
        _label_poles(
            shots[:n], window_m, line + MARGIN, own[3], place, alone[line], rough, thresholds, row
        )
        _mark_tops(place[2], own, row, thresholds, marks)
        n = _list_marked(marks, 1, 1, shots)
        _label_boxes(shots[:n], window_m, line + MARGIN, own, place, thresholds, row)
    return labels
