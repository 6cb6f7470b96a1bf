"""Why a shot of a street has its label.

Two lists decide, and in both the first rule that applies: :func:`_label_noise_and_ground`, then
:func:`_label_things` for the shots that the first one leaves open. A rule gives a shot its reason
and with it its label; ``prc explain`` prints both. design/fused.md has the same rules in the same
order.

Loops over all shots have no loops inside and no branches but the choice of a rule, so that the
compiler uses vector instructions. What takes a look around a shot is found before, for the few
shots that need it, and is evidence in the lists (:class:`Around`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import Reason
from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import F32, F32_2, I32, U8, U8_2, U64, Mask, Mask_2
from prc_cli.methods.fused.lists_loops import list_few
from prc_cli.methods.fused.records import (
    FENCE,
    FEW_SHOTS,
    LORRY_BIN,
    MAST,
    POST,
    SLOT_M,
    SLOTS,
    SMALL,
    STRIP_M,
    STRIPS,
    THIN,
    Around,
    Beams,
    Beside,
    CarTops,
    FilledSlots,
    Line,
    Neighbours,
    Place,
    Shot,
    Walls,
)
from prc_cli.methods.fused.strips_loops import count_bits
from prc_cli.methods.fused.texture_loops import LINES, MOST_SMOOTH, write_pairs
from prc_cli.methods.fused.thresholds import DecisionThresholds

Counts = NDArray[np.uint32]
"""Shots in the upper half of a word, their smooth pairs in the lower half."""

MARGIN = 20
"""Lines of the window before and after the block."""
BESIDE = 12
"""Lines before and after by which a pole is found to be thick."""
TILT_M = np.float32(0.6)
"""What goes away by more than this is no pole [m]."""
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
LEAST_COLUMNS = 2
"""Least half width of a place, in columns."""
HALF_STRIP_M = np.float32(0.25)
"""Width of a bin of level surfaces [m]."""
BEYOND = 2 * STRIPS
"""Bin of shots beyond the strips."""
SPIKE_PLACE_M = np.float32(0.1)
"""Half width of the place beside a spike [m]."""
SPIKE_COLUMNS = 6
_FAR_BINS = np.float32(1e6)
LEAF_REACH = 4
"""Slots up and down in which other leaves are looked for."""
CAR_REACH = 6
"""Bins on either side in which level surfaces count."""
SMOOTH_PAIRS = 3
"""With so many smooth pairs, a shot is no leaf, nor a reflection below the ground."""
GAP_SHOTS = 3
"""Lonely shots within a box."""

# What a shot is until a rule applies; no reason is one of these numbers
_OPEN = np.uint8(255)

_MISSING = np.uint8(Reason.MISSING)
_LONELY = np.uint8(Reason.LONELY)
_ISOLATED = np.uint8(Reason.ISOLATED)
_SPIKE = np.uint8(Reason.SPIKE)
_BELOW_GROUND = np.uint8(Reason.BELOW_GROUND)
_WALKED = np.uint8(Reason.WALKED)
_LEVEL_LOW = np.uint8(Reason.LEVEL_LOW)
_LOW = np.uint8(Reason.LOW)
_BEHIND_WALL = np.uint8(Reason.BEHIND_WALL)
_IN_CAR = np.uint8(Reason.IN_CAR)
_CROWN = np.uint8(Reason.CROWN)
_TRUNK = np.uint8(Reason.TRUNK)
_POST = np.uint8(Reason.POST)
_ARM = np.uint8(Reason.ARM)
_SMALL = np.uint8(Reason.SMALL)
_LEVEL_BODY = np.uint8(Reason.LEVEL_BODY)
_FOLIAGE = np.uint8(Reason.FOLIAGE)
_LEAF = np.uint8(Reason.LEAF)
_FACADE = np.uint8(Reason.FACADE)
_SMOOTH = np.uint8(Reason.SMOOTH)
_BOX = np.uint8(Reason.BOX)


# The first list: noise and ground


@helper
def _label_noise_and_ground(
    line: Line, beside: Beside, limits: DecisionThresholds, around: Around, labels: U8
) -> None:
    """Label noise and ground, and say of the shots that are left what is around them."""
    for i in range(len(labels)):
        shot = _shot(line, i)
        place = _place(beside, i)

        # the evidence
        n_near = np.float32(shot.near)
        has_few_near = n_near < limits.least_near
        has_none_near = has_few_near & (shot.near == 0)
        has_smooth_pair = shot.smooth > 0
        off_m = abs(shot.above_m)
        is_level = shot.level > shot.upright
        is_upright = shot.upright > shot.level + np.uint8(1)
        is_soil = off_m < limits.soil_m
        is_far_below = (shot.above_m < -limits.below_m) & (shot.smooth < SMOOTH_PAIRS)
        is_side_of_pit = (shot.upright > 0) & (n_near >= limits.pit_near)
        is_in_wall = _is_in_wall(shot, place, limits)
        is_on_surface = (shot.near > 0) & (has_smooth_pair | is_soil | is_in_wall)
        is_rough = shot.texture < _leaf_share(shot, place, limits)
        is_foliage = is_rough & (not (is_in_wall | _is_on_facade(shot, place, limits)))
        is_in_car = _is_in_car(shot, place, is_foliage)
        is_behind_wall = _is_far_behind_wall(shot, place, is_foliage, limits)

        # the decision
        if shot.range_m != shot.range_m:
            rule = _MISSING  # missing: there is no return
        elif has_none_near & (shot.range_m <= limits.lone_m):
            rule = _LONELY  # noise: nothing is near it, although the scanner is
        elif has_few_near & (not around.is_leaf[i]) & (not is_on_surface):
            rule = _ISOLATED  # noise: few shots are near it, and no leaves or surface
        elif (not has_smooth_pair) & around.is_amid_smooth[i]:
            rule = _SPIKE  # noise: it is rough amid a smooth surface
        elif is_far_below & (not is_side_of_pit):
            rule = _BELOW_GROUND  # noise: a mirror image below the ground
        elif shot.is_walked & (off_m < limits.walked_m):
            rule = _WALKED  # ground: the walk along the ground went over it
        elif is_level & (off_m < limits.level_m):
            rule = _LEVEL_LOW  # ground: it is low, and more level than upright
        elif is_soil & (not is_upright):
            rule = _LOW  # ground: it is very low, and not upright
        elif is_behind_wall & (n_near < limits.ghost_near):
            rule = _BEHIND_WALL  # noise: a reflection in a pane
        elif is_in_car & has_few_near & (not has_smooth_pair):
            rule = _IN_CAR  # noise: a reflection in the window of a car
        else:
            rule = _OPEN
        labels[i] = rule

        is_open = rule == _OPEN
        around.is_rough[i] = is_rough
        around.is_foliage[i] = is_foliage
        around.is_in_car[i] = is_in_car
        is_part = is_in_wall | (is_in_car & (shot.kind != THIN))
        is_part |= around.is_leaf[i] & (not has_smooth_pair) & (shot.above_m > limits.arm_m)
        around.is_upright[i] = is_open & _may_be_upright(shot, place, is_part, limits)


# The second list: things above the ground


@helper
def _label_things(
    line: Line, bins: I32, limits: DecisionThresholds, around: Around, labels: U8
) -> None:
    """Label the shots that the first list leaves open."""
    for i in range(len(labels)):
        # the evidence
        kind = line.kind[i] if bins[i] < BEYOND else np.uint8(0)
        is_upright = around.is_upright[i]
        is_tree = is_upright & (kind != MAST)
        is_enough = is_upright & (kind != FEW_SHOTS)
        is_post = (line.level[i] == 0) | (kind == POST) | (kind == MAST)
        is_in_car = around.is_in_car[i]
        # foliage may be small and free, too
        is_small = (kind >= SMALL) & (is_in_car | (line.texture[i] >= limits.leaf_share))

        # the decision
        if labels[i] != _OPEN:
            rule = labels[i]
        elif around.is_box[i]:
            rule = _BOX  # pole: it is on a bin or a cabinet
        elif is_tree & around.is_below_crown[i]:
            rule = _CROWN  # vegetation: a trunk below its crown
        elif is_tree & is_enough & around.is_thick[i]:
            rule = _TRUNK  # vegetation: as thick as a trunk
        elif is_enough & is_post:
            rule = _POST  # pole: upright and thin
        elif is_enough:
            rule = _ARM  # pole: thin or short, high above the ground
        elif is_small & (kind == FENCE):
            rule = _SMOOTH  # building: a fence
        elif is_small:
            rule = _SMALL  # unclassified: small, and it stands free
        elif is_in_car:
            rule = _LEVEL_BODY  # car: low, with level surfaces around
        elif around.is_foliage[i]:
            rule = _FOLIAGE  # vegetation: few pairs around are smooth, and no wall is there
        elif around.is_leaf[i]:
            rule = _LEAF  # vegetation: few shots are near it, but other leaves are
        elif around.is_rough[i]:
            rule = _FACADE  # building: few pairs around are smooth, but a wall is there
        else:
            rule = _SMOOTH  # building: something smooth above the ground
        labels[i] = rule


# Evidence of a shot and its place


@inlined
def _leaf_share(shot: Shot, place: Place, limits: DecisionThresholds) -> np.float32:
    """Below this share of smooth pairs around, a place is rough: balconies and roofs are, too."""
    before_m = abs(place.wall_ahead_m) - abs(shot.side_m)
    is_before = (before_m >= -STRIP_M) & (before_m <= limits.before_m)
    is_before &= place.wall_ahead_m != np.float32(0.0)
    is_house = is_before | _is_on_house(shot, place, limits.roof_m, limits)
    return limits.leaf_share_before_wall if is_house else limits.leaf_share


@inlined
def _is_on_facade(shot: Shot, place: Place, limits: DecisionThresholds) -> bool:
    """Whether a shot is on a facade, or behind its panes, at any height."""
    is_near = _is_on_house(shot, place, limits.behind_m, limits)
    is_house = _is_on_house(shot, place, limits.roof_m, limits)
    return bool(is_near & is_house & (place.wall_top_m > np.float32(0.0)))


@inlined
def _is_in_wall(shot: Shot, place: Place, limits: DecisionThresholds) -> bool:
    """Whether a shot is in a wall, or behind it and seen through one of its windows."""
    away_m = abs(shot.side_m)
    wall_m = abs(place.wall_m)
    behind_m = away_m - wall_m
    at_wall_m = shot.height_m * (wall_m / away_m) if behind_m > np.float32(0.0) else shot.height_m
    is_between = (behind_m >= -limits.front_m) & (behind_m <= limits.behind_m)
    is_below_top = at_wall_m <= place.wall_top_m + limits.over_m
    return bool((wall_m != np.float32(0.0)) & is_between & is_below_top)


@inlined
def _is_on_house(shot: Shot, place: Place, most_m: np.float32, limits: DecisionThresholds) -> bool:
    """Whether a shot is up to so far behind a wall that is as high as a storey."""
    wall_m = abs(place.wall_m)
    behind_m = abs(shot.side_m) - wall_m
    storey_m = place.wall_top_m - shot.height_m + shot.above_m
    is_between = (behind_m >= -limits.front_m) & (behind_m <= most_m)
    return bool((wall_m != np.float32(0.0)) & is_between & (storey_m >= limits.storey_m))


@inlined
def _is_in_car(shot: Shot, place: Place, is_foliage: np.bool_) -> bool:
    """Whether a shot is low enough where enough level surfaces are around.

    Foliage needs more of them.
    """
    top_m = place.rough_car_top_m if is_foliage else place.car_top_m
    return bool((shot.above_m >= np.float32(0.0)) & (shot.above_m < top_m))


@inlined
def _is_far_behind_wall(
    shot: Shot, place: Place, is_foliage: np.bool_, limits: DecisionThresholds
) -> bool:
    """Whether the line of sight goes through a wall, and on for longer than a room is deep."""
    wall_m = abs(place.wall_m)
    away_m = abs(shot.side_m)
    behind_m = away_m - wall_m
    is_through = shot.height_m * wall_m <= place.wall_top_m * away_m
    is_far = (behind_m > limits.ghost_m) & is_foliage
    is_far |= (behind_m > limits.behind_m) & (shot.smooth == 0)
    return bool((wall_m != np.float32(0.0)) & is_through & is_far)


@inlined
def _may_be_upright(shot: Shot, place: Place, is_part: bool, limits: DecisionThresholds) -> bool:
    """Whether a shot is on a post, or on a smooth piece that is upright or high.

    Pieces of walls, cars and twigs are part of these.
    """
    is_piece = (shot.kind != np.uint8(0)) & (shot.kind < SMALL)
    is_up = (shot.level == 0) | (shot.above_m > limits.arm_m)
    is_thin = is_piece & is_up & (shot.above_m > limits.foot_m) & (not is_part)
    is_thin &= shot.texture >= limits.leaf_share
    is_known = (place.bin < BEYOND) & (limits.pole_m > np.float32(0.0))
    return bool(is_known & (is_thin | (shot.kind == POST) | (shot.kind == MAST)))


# Evidence around a shot: leaves, and smooth places


@helper
def _mark_doubtful(line: Line, limits: DecisionThresholds, around: Around, marks: Mask) -> None:
    """Mark all shots but missing ones, and those that the walk surely went over."""
    for i in range(len(line.range_m)):
        is_lone = np.float32(line.near[i]) < limits.least_near
        is_known = (not is_lone) & (line.smooth[i] > 0)
        is_known &= line.is_walked[i] & (abs(line.above_m[i]) < limits.walked_m)
        is_missing = line.range_m[i] != line.range_m[i]
        marks[i] = not (is_missing | is_known)
        around.is_leaf[i] = False


@helper
def _look_for_leaves(
    shots: I32,
    line: Line,
    beside: Beside,
    rough_slots: U64,
    half_widths: I32,
    count_sums: Counts,
    limits: DecisionThresholds,
    around: Around,
) -> None:
    """Find leaves around some shots, and smooth places around the rough ones.

    Gaps between far leaves are wide, and what is behind a bare branch may be smooth.
    """
    for k in range(len(shots)):
        i = shots[k]
        shot = _shot(line, i)
        is_low = shot.above_m < limits.box_m
        most_near = limits.least_near if is_low else limits.leaf_near
        if np.float32(shot.near) < most_near and shot.smooth < SMOOTH_PAIRS:
            place = _place(beside, i)
            if place.bin < BEYOND and shot.above_m > limits.foot_m:
                n_slots = _slots_around(rough_slots[place.bin >> 1], _slot(shot.above_m))
                is_house = _is_on_house(shot, place, limits.roof_m, limits)
                is_house |= _is_in_wall(shot, place, limits)
                is_amid = np.float32(n_slots + shot.near) >= limits.leaf_slots
                around.is_leaf[i] = is_amid and not is_house
        if line.smooth[i] == 0:
            first = max(i - int(half_widths[i]), 0)
            end = min(i + int(half_widths[i]) + 1, len(line.range_m))
            counts = count_sums[end] - count_sums[first]
            n_shots = np.int32(counts >> np.uint32(16))
            n_pairs = np.float32(np.int32(counts & np.uint32(0xFFFF)))
            most = limits.spike_share * np.float32(MOST_SMOOTH * n_shots)
            around.is_amid_smooth[i] = n_pairs > most


# Evidence around a shot: bins and cabinets


@helper
def _mark_tops(
    line: Line, labels: U8, limits: DecisionThresholds, around: Around, marks: Mask
) -> None:
    """Mark the shots of a line that may be on the top of a box: low, smooth and level."""
    for i in range(len(labels)):
        is_low = (line.above_m[i] > limits.foot_m) & (line.above_m[i] < limits.box_m)
        is_level = (line.level[i] > line.upright[i]) & (line.smooth[i] >= BOX_SMOOTH)
        marks[i] = is_low & is_level & (labels[i] == _OPEN)
        around.is_box[i] = False


@helper
def _look_for_boxes(
    shots: I32,
    window_m: F32,
    row: int,
    line: Line,
    labels: U8,
    limits: DecisionThresholds,
    around: Around,
) -> None:
    """Find the boxes whose tops are in a list.

    They stand alone: beyond their tops something far is seen, or nothing, and what is below them is
    ground.
    """
    done = -1
    for k in range(len(shots)):
        i = shots[k]
        if i <= done:
            continue
        first, before = _end_of_box(line, labels, i, -1, limits)
        last, after = _end_of_box(line, labels, i, 1, limits)
        done = last
        if before == first or after == last:
            continue
        if line.height_m[last] > line.height_m[first]:
            top = last
            beyond = after
            foot = first
            below = before
        else:
            top = first
            beyond = before
            foot = last
            below = after
        if beyond >= 0 and line.range_m[beyond] <= line.range_m[top] + limits.far_m:
            continue
        is_covered = below >= 0 and line.range_m[below] < line.range_m[foot]
        if is_covered and not _is_ground(labels[below]):
            continue
        is_box = _has_size_of_box(line, first, last, labels, limits)
        if is_box and _is_seen_by_few_lines(window_m, row, i, limits):
            for j in range(first, last + 1):
                around.is_box[j] = labels[j] == _OPEN


@helper
def _end_of_box(
    line: Line, labels: U8, i: int, way: int, limits: DecisionThresholds
) -> tuple[int, int]:
    """Follow a box along its line to one side.

    Return its last shot, and the next one, -1 = none close by.

    The next one is the last itself where it is no box: too high, or cut off by the end of the line.
    """
    last = i
    j = i + way
    gap = 0
    while 0 <= j < len(labels):
        is_noise = labels[j] != _OPEN and not _is_ground(labels[j])
        if is_noise or np.float32(line.near[j]) < limits.least_near:
            gap += 1
            if gap > GAP_SHOTS:
                return last, -1
        elif _is_ground(labels[j]) or not abs(line.range_m[j] - line.range_m[last]) < limits.jump_m:
            return last, j
        elif line.above_m[j] >= limits.box_m:
            return last, last
        else:
            last = j
            gap = 0
        j += way
    return last, last


@helper
def _has_size_of_box(
    line: Line, first: int, last: int, labels: U8, limits: DecisionThresholds
) -> bool:
    """Return whether a run of shots is smooth, as deep as a box, and has a level top."""
    high_m = -np.float32(np.inf)
    near_m = np.float32(np.inf)
    far_m = -np.float32(np.inf)
    n = 0
    n_smooth = 0
    for j in range(first, last + 1):
        if labels[j] == _OPEN:
            high_m = max(high_m, line.above_m[j])
            near_m = min(near_m, abs(line.side_m[j]))
            far_m = max(far_m, abs(line.side_m[j]))
            n += 1
            n_smooth += line.smooth[j] >= BOX_SMOOTH
    deep_m = far_m - near_m
    if (
        np.float32(n) < limits.pole_shots
        or deep_m > limits.box_deep_m
        or deep_m < limits.box_flat_m
    ):
        return False
    near_top_m = np.float32(np.inf)
    far_top_m = -np.float32(np.inf)
    for j in range(first, last + 1):
        if labels[j] == _OPEN and line.above_m[j] > high_m - BOX_EVEN_M:
            near_top_m = min(near_top_m, abs(line.side_m[j]))
            far_top_m = max(far_top_m, abs(line.side_m[j]))
    if far_top_m - near_top_m < limits.box_flat_m:
        return False
    return bool(np.float32(n_smooth) >= BOX_SHARE * np.float32(n))


@inlined
def _is_seen_by_few_lines(window_m: F32, row: int, i: int, limits: DecisionThresholds) -> bool:
    before = _lines_beside(window_m, row, i, -1, limits)
    if before == MARGIN or np.float32(before) > limits.box_lines:
        return False
    after = _lines_beside(window_m, row, i, 1, limits)
    return bool(after < MARGIN and np.float32(before + after) <= limits.box_lines)


@inlined
def _lines_beside(window_m: F32, row: int, i: int, way: int, limits: DecisionThresholds) -> int:
    """Return how many lines to one side see a box in the direction of a shot.

    MARGIN if none sees past it.

    Single lines that see past it do not count: they see background light, or look through a pane.
    """
    last_m = window_m[row, i]
    n_lines = 0
    n_off = 0
    n_past = 0
    for k in range(1, MARGIN + 1):
        range_m = window_m[row + way * k, i]
        if abs(range_m - last_m) < limits.jump_m:
            last_m = range_m
            n_lines = k
            n_off = 0
            n_past = 0
            continue
        n_off += 1
        n_past += not (range_m <= last_m + limits.far_m)
        if n_off == BOX_ODD:
            return n_lines if n_past >= BOX_ODD - 1 else MARGIN
    return MARGIN


@inlined
def _is_ground(rule: np.uint8) -> bool:
    return bool((rule == _WALKED) | (rule == _LEVEL_LOW) | (rule == _LOW))


# Evidence around a shot: trunks, posts and arms


@helper
def _look_at_uprights(
    shots: I32,
    window_m: F32,
    row: int,
    line: Line,
    bins: I32,
    rough_slots: U64,
    limits: DecisionThresholds,
    around: Around,
) -> None:
    """Find crowns above some shots, and how thick the thing is that they are on.

    ``row`` is that of the line in the window.
    """
    range_m, side_m, height_m, above_m = line.range_m, line.side_m, line.height_m, line.above_m
    kind = line.kind
    end = 0
    is_round = False
    for k in range(len(shots)):
        i = shots[k]
        if i >= end:
            end, is_round = _round_run(range_m, side_m, height_m, kind, i, limits)
        above_slots = rough_slots[bins[i] >> 1] >> np.uint64(_slot(above_m[i]))
        is_below_crown = np.float32(count_bits(above_slots)) >= limits.crown_slots
        around.is_below_crown[i] = is_below_crown
        around.is_thick[i] = not is_below_crown and (
            is_round or _is_thick(window_m, row, i, side_m[i], limits)
        )


@helper
def _round_run(
    range_m: F32,
    side_m: F32,
    height_m: F32,
    kind: U8,
    i: int,
    limits: DecisionThresholds,
) -> tuple[int, bool]:
    """Return the end of a free-standing run, and whether it is as deep as half a trunk.

    A slanted plane cuts an upright round thing from edge to edge, in an ellipse: it is seen as deep
    as its radius, and at least three times as high. What is deeper than that is something else, as
    is what goes up the whole line.
    """
    jump_m = limits.jump_m
    first = i
    end = i + 1
    while (
        end < len(kind) and 0 < kind[end] < SMALL and abs(range_m[end] - range_m[end - 1]) < jump_m
    ):
        end += 1
    while (
        first > 0
        and 0 < kind[first - 1] < SMALL
        and abs(range_m[first - 1] - range_m[first]) < jump_m
    ):
        first -= 1
    # step by step, because array reductions take half a second to compile
    left_m = right_m = side_m[first]
    low_m = high_m = height_m[first]
    for j in range(first + 1, end):
        left_m = min(left_m, side_m[j])
        right_m = max(right_m, side_m[j])
        low_m = min(low_m, height_m[j])
        high_m = max(high_m, height_m[j])
    deep_m = right_m - left_m
    tall_m = high_m - low_m
    is_round = (deep_m >= limits.thick_m) & (deep_m < np.float32(0.5) * tall_m)
    return end, bool(is_round & (tall_m < np.float32(2.0) * limits.pole_m))


@inlined
def _is_thick(
    window_m: F32, row: int, i: int, side_m: np.float32, limits: DecisionThresholds
) -> bool:
    """Whether half a circle with a trunk's radius fits what the lines around see at a shot best.

    A tilt changes no radius; what is tilted too much is no pole.
    """
    first = last = row
    while row - first < BESIDE and abs(window_m[first - 1, i] - window_m[first, i]) < limits.jump_m:
        first -= 1
    while last - row < BESIDE and abs(window_m[last + 1, i] - window_m[last, i]) < limits.jump_m:
        last += 1
    across = abs(side_m) / window_m[row, i]
    n = np.float32(last - first + 1)
    nearer = farther_m = product = np.float32(0.0)
    for k in range(first, last + 1):
        place = np.float32(2 * (k - first) + 1) / n - np.float32(1.0)
        front = np.sqrt(np.float32(1.0) - place * place)
        nearer += front
        farther_m += window_m[k, i]
        product += front * window_m[k, i]
    # least squares; the squares of all places add up to (n - 1 / n) / 3
    spread = n - (n - np.float32(1.0) / n) / np.float32(3.0) - nearer * nearer / n
    is_round = (nearer * farther_m / n - product) * across >= limits.thick_m * spread
    is_tilted = abs(window_m[last, i] - window_m[first, i]) * across > TILT_M
    return bool(is_tilted | ((last - first > 1) & is_round))


# What the lists read: shots, points, places, strips and cars


@inlined
def _shot(line: Line, i: int) -> Shot:
    return Shot(
        line.range_m[i],
        line.side_m[i],
        line.height_m[i],
        line.above_m[i],
        line.near[i],
        line.smooth[i],
        line.upright[i],
        line.level[i],
        line.is_walked[i],
        line.texture[i],
        line.kind[i],
    )


@inlined
def _place(beside: Beside, i: int) -> Place:
    return Place(
        beside.bin[i],
        beside.wall_m[i],
        beside.wall_top_m[i],
        beside.wall_ahead_m[i],
        beside.car_top_m[i],
        beside.rough_car_top_m[i],
    )


@helper
def _lay_out(range_m: F32, beams: Beams, side_m: F32, height_m: F32) -> None:
    """Write the points of a line in the scan plane."""
    for i in range(len(range_m)):
        side_m[i] = range_m[i] * beams.sine[i]
    for i in range(len(range_m)):
        height_m[i] = -(range_m[i] * beams.cosine[i])


@helper
def _sum_up_three(before: Counts, middle: Counts, after: Counts, sums: Counts) -> None:
    """Write the sums of the first 0, 1, ... columns of three lines together, (M + 1,)."""
    sums_after = sums[1:]
    for i in range(len(middle)):
        sums_after[i] = before[i] + middle[i] + after[i]
    total = np.uint32(0)
    sums[0] = total
    for i in range(len(middle)):
        total = np.uint32(total + sums_after[i])
        sums_after[i] = total


@helper
def _half_widths(range_m: F32, step_rad: np.float32, half_widths: I32) -> None:
    """Write the half width of every shot's place [columns]; missing shots get any number."""
    least = np.float32(LEAST_COLUMNS)
    most = np.float32(SPIKE_COLUMNS)
    for i in range(len(range_m)):
        r = range_m[i] if range_m[i] == range_m[i] else np.float32(1.0)
        half_widths[i] = np.int32(min(max(SPIKE_PLACE_M / (r * step_rad), least), most))


@inlined
def _slot(above_m: np.float32) -> int:
    return int(min(max(above_m / SLOT_M, np.float32(0.0)), np.float32(SLOTS - 1)))


@inlined
def _slots_around(word: np.uint64, slot: int) -> int:
    """Count the slots with something, near a slot."""
    low = max(slot - LEAF_REACH, 0)
    high = min(slot + LEAF_REACH, SLOTS - 1)
    ones = ~np.uint64(0) >> np.uint64(SLOTS - 1 - (high - low))
    return count_bits(word & (ones << np.uint64(low)))


@helper
def _bins(side_m: F32, bins: I32) -> None:
    """Write the half strip of every shot of a line, BEYOND if it is in none."""
    for i in range(len(side_m)):
        far_bin = min(max(side_m[i] / HALF_STRIP_M, -_FAR_BINS), _FAR_BINS)
        b = np.int32(np.floor(far_bin)) + np.int32(STRIPS)
        bins[i] = b if (b >= 0) & (b < BEYOND) else np.int32(BEYOND)


@helper
def _copy_walls(walls: Walls, n: int, walls_of_line: Walls) -> None:
    """Copy the walls of a line; the strip beyond the last one has none."""
    for b in range(STRIPS):
        walls_of_line.side_m[b] = walls.side_m[n, b]
        walls_of_line.top_m[b] = walls.top_m[n, b]
        walls_of_line.ahead_m[b] = walls.ahead_m[n, b]


@helper
def _look_beside(shots: I32, walls: Walls, cars: CarTops, beside: Beside) -> None:
    """Write the walls and cars in the strips of some shots.

    A loop of its own, as all others read memory in order.
    """
    for k in range(len(shots)):
        i = np.uint64(shots[k])
        q = np.uint64(beside.bin[i])
        b = q >> np.uint64(1)
        beside.wall_m[i] = walls.side_m[b]
        beside.wall_top_m[i] = walls.top_m[b]
        beside.wall_ahead_m[i] = walls.ahead_m[b]
        beside.car_top_m[i] = cars.smooth_m[q]
        beside.rough_car_top_m[i] = cars.rough_m[q]


@helper
def _count_bins(levels: U8, counts: U8) -> None:
    """Count the bins with a level surface around every bin of a line."""
    n = len(levels)
    # element by element, because array copies take seconds to compile
    for q in range(n):
        counts[q] = levels[q]
    for away in range(1, CAR_REACH + 1):
        for q in range(n - away):
            counts[q] += levels[q + away]
        for q in range(n - away):
            counts[q + away] += levels[q]


@helper
def _find_cars(
    slots: U64, levels: U8, counts: U8, limits: DecisionThresholds, cars: CarTops
) -> None:
    """Write up to which height the shots in every bin are of a car.

    There is a car where enough bins around are level. It ends below what reaches above cars without
    a gap; where the bins are those of a body that hangs high, above lorries.
    """
    car_slot = int(limits.car_top_m / SLOT_M)
    lorry_slot = int(limits.lorry_top_m / SLOT_M)
    least = min(limits.car_bins, limits.car_bins_rough)
    _count_bins(levels, counts)
    last = -1
    top_m = np.float32(0.0)
    for q in range(2 * STRIPS):
        n_level = np.float32(counts[q] & (LORRY_BIN - 1))
        n_high = np.float32(counts[q] // LORRY_BIN)
        if n_level < least:
            cars.smooth_m[q] = cars.rough_m[q] = np.float32(0.0)
            continue
        b = q // 2
        is_lorry = n_high >= least
        place = 2 * b + 1 if is_lorry else 2 * b
        if place != last:
            last = place
            word = slots[b]
            filled = word | (word << np.uint64(1)) | (word << np.uint64(2))
            slot = lorry_slot if is_lorry else car_slot
            while slot > 0 and (filled >> np.uint64(slot - 1)) & np.uint64(1) != np.uint64(0):
                slot -= 1
            top_m = np.float32(slot) * SLOT_M
        cars.smooth_m[q] = top_m if n_level >= limits.car_bins else np.float32(0.0)
        cars.rough_m[q] = top_m if n_level >= limits.car_bins_rough else np.float32(0.0)


@helper
def _list_shots(marks: Mask, shots: I32) -> int:
    """List the marked shots of a line, return how many there are."""
    n = 0
    for i in range(len(marks)):
        shots[n] = i
        n += marks[i]
    return n


@loop()
def fused_labels(
    window_m: F32_2,
    above_m: F32_2,
    neighbours: Neighbours,
    walked: Mask_2,
    texture: F32_2,
    slots: FilledSlots,
    walls: Walls,
    levels: U8_2,
    kinds: U8_2,
    beams: Beams,
    step_rad: np.float32,
    thresholds: DecisionThresholds,
) -> U8_2:
    """Give every shot the rule that decides it (:class:`~prc_cli.core.classes.Reason`).

    ``window_m`` (lines + 40, M) float32, metres; ``above_m``, ``neighbours`` and ``walked`` (lines
    + 4, M); ``texture`` (lines, M) float32, shares; ``slots`` and ``walls`` (lines, STRIPS);
    ``levels`` (lines, 2 STRIPS) uint8; ``kinds`` (lines, M) uint8; returns (lines, M) uint8.
    """
    n_lines, m = texture.shape
    near, smooth, upright, level = neighbours
    labels = np.empty((n_lines, m), np.uint8)
    shots = np.empty(m + 1, np.int32)
    bin_counts = np.empty(2 * STRIPS, np.uint8)
    cars = CarTops(np.zeros(BEYOND + 1, np.float32), np.zeros(BEYOND + 1, np.float32))
    walls_of_line = Walls(
        np.zeros(STRIPS + 1, np.float32),
        np.zeros(STRIPS + 1, np.float32),
        np.zeros(STRIPS + 1, np.float32),
    )
    half_widths = np.empty(m, np.int32)
    count_sums = np.empty(m + 1, np.uint32)
    side_m = np.empty(m, np.float32)
    height_m = np.empty(m, np.float32)
    beside = Beside(
        np.empty(m, np.int32),
        np.zeros(m, np.float32),
        np.zeros(m, np.float32),
        np.zeros(m, np.float32),
        np.zeros(m, np.float32),
        np.zeros(m, np.float32),
    )
    marks = np.empty(m, np.bool_)
    seen = np.zeros((9, m), np.bool_)
    around = Around(
        seen[0],
        seen[1],
        seen[2],
        seen[3],
        seen[4],
        seen[5],
        seen[6],
        seen[7],
        seen[8],
    )
    # ring buffer of lines
    counts = np.empty((3, m), np.uint32)
    least = thresholds.least_near
    for k in range(LINES - 1, LINES + 1):
        write_pairs(near[k], smooth[k], least, counts[k - LINES + 1])
    for n in range(n_lines):
        k = n + LINES
        row = n + MARGIN
        range_m = window_m[row]
        rules = labels[n]
        rough_slots = slots.by_rough[n]
        line = Line(
            range_m,
            side_m,
            height_m,
            above_m[k],
            near[k],
            smooth[k],
            upright[k],
            level[k],
            walked[k],
            texture[n],
            kinds[n],
        )
        _lay_out(range_m, beams, side_m, height_m)
        _mark_doubtful(line, thresholds, around, marks)
        n_shots = _list_shots(marks, shots)

        _bins(side_m, beside.bin)
        _find_cars(slots.by_any[n], levels[n], bin_counts, thresholds, cars)
        _copy_walls(walls, n, walls_of_line)
        _look_beside(shots[:n_shots], walls_of_line, cars, beside)

        write_pairs(near[k + 1], smooth[k + 1], least, counts[(n + 2) % 3])
        _sum_up_three(counts[0], counts[1], counts[2], count_sums)
        _half_widths(range_m, step_rad, half_widths)
        _look_for_leaves(
            shots[:n_shots],
            line,
            beside,
            rough_slots,
            half_widths,
            count_sums,
            thresholds,
            around,
        )

        _label_noise_and_ground(line, beside, thresholds, around, rules)

        _mark_tops(line, rules, thresholds, around, marks)
        n_shots = list_few(marks, shots)
        _look_for_boxes(shots[:n_shots], window_m, row, line, rules, thresholds, around)
        n_shots = list_few(around.is_upright, shots)
        _look_at_uprights(
            shots[:n_shots], window_m, row, line, beside.bin, rough_slots, thresholds, around
        )
        _label_things(line, beside.bin, thresholds, around, rules)
    return labels
