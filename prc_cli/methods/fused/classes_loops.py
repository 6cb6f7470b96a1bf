"""Why a shot of a street has its label.

The rules of the fused classifier, in the order in which they decide.

The first rule that applies gives the label. ``prc explain`` prints its name.

====  =================  ==========  ==============================================================
step  rule               label       reason
====  =================  ==========  ==============================================================
1     MISSING            missing     there is no return
1     LONELY             noise       nothing is near it, although the scanner is
2     ISOLATED           noise       few shots are near it; it is neither a leaf nor on a surface
2     SPIKE              noise       it is rough amid a smooth surface
2     BELOW_GROUND       noise       it is rough and far below the ground, and no side of a pit
1, 2  WALKED             ground      the walk along the ground went over it
1, 2  LEVEL_LOW          ground      it is low, and more level than upright
1, 2  LOW                ground      it is very low, and not upright
3     BEHIND_WALL        noise       it is far behind a wall, with few shots near: a reflection
3     IN_CAR             noise       it is in a car, with few shots near and no smooth pair
4     CROWN              vegetation  it is on something upright below a crown, and on no mast
4     TRUNK              vegetation  it is on something upright that is as thick as a trunk
4     POST               pole        it is on something upright and thin
4     ARM                pole        it is on something thin or short, high above the ground
5     SMALL              pole        it is on something small that stands free
5     SMOOTH             building    it is on a fence
5     LEVEL_BODY         car         it is low, with level surfaces around
5     FOLIAGE            vegetation  few pairs around are smooth, no wall is there: a hedge, a tree
5     LEAF               vegetation  few shots are near it, but other leaves are
5     FACADE             building    few pairs around are smooth, but it is in a wall
5     SMOOTH             building    everything else: something smooth above the ground
6     BOX                pole        it is on a bin or a cabinet, whatever it was so far
====  =================  ==========  ==============================================================

Steps are passes over a line. Steps 1, 3 and 5 read every shot; they have no loops inside and no
branches but the choice of a rule, so that the compiler uses vector instructions. Steps 2, 4 and 6
look around the few shots that need it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import LABELS_BY_REASON, Label, Reason
from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import F32, F32_2, I32, U8, U8_2, U64, Mask_2
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
    Beams,
    Beside,
    CarTops,
    FilledSlots,
    Line,
    Neighbours,
    Place,
    Shot,
    Surroundings,
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
BELOW_SMOOTH = 3
"""With this many smooth pairs, a shot below the ground is no reflection."""
GAP_SHOTS = 3
"""Lonely shots within a box."""

# What a shot is until a rule applies; no reason is one of these numbers
_OPEN = np.uint8(255)
_OPEN_LEAF = np.uint8(254)
"""A leaf among others, with few shots near it."""
_DOUBTFUL = np.uint8(253)
"""It may be noise: step 2 looks around it."""
_NOT_GROUND = np.uint8(0)
_NO_RETURN = np.uint8(Label.MISSING)
_NOISE = np.uint8(Label.NOISE)
_GROUND = np.uint8(Label.GROUND)
_MARKED = np.uint8(1)

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


# Step 1: noise and ground, as far as the shot alone tells


@helper
def _label_clear_shots(line: Line, limits: DecisionThresholds, labels: U8) -> None:
    for i in range(len(labels)):
        shot = _shot(line, i)
        is_few = np.float32(shot.near) < limits.least_near
        is_below = (shot.smooth < BELOW_SMOOTH) & (not (shot.above_m >= -limits.below_m))
        ground = _ground_rule(shot, limits)
        if shot.range_m != shot.range_m:
            rule = _MISSING
        elif is_few & (shot.near == 0) & (shot.range_m <= limits.lone_m):
            rule = _LONELY
        elif is_few | (shot.smooth == 0) | is_below:
            rule = _DOUBTFUL
        elif ground != _NOT_GROUND:
            rule = ground
        else:
            rule = _OPEN
        labels[i] = rule


@inlined
def _ground_rule(shot: Shot, limits: DecisionThresholds) -> np.uint8:
    off_m = abs(shot.above_m)
    if shot.is_walked & (off_m < limits.walked_m):
        return _WALKED
    if (shot.level > shot.upright) & (off_m < limits.level_m):
        return _LEVEL_LOW
    if (shot.upright <= shot.level + np.uint8(1)) & (off_m < limits.soil_m):
        return _LOW
    return _NOT_GROUND


# Step 2: noise and ground among the doubtful shots


@helper
def _label_doubtful_shots(
    shots: I32,
    line: Line,
    beside: Beside,
    rough_slots: U64,
    half_widths: I32,
    count_sums: Counts,
    limits: DecisionThresholds,
    labels: U8,
) -> None:
    for k in range(len(shots)):
        i = shots[k]
        if labels[i] != _DOUBTFUL:
            continue
        shot = _shot(line, i)
        place = _place(beside, i)
        slots = rough_slots[min(place.bin >> 1, STRIPS - 1)]
        first = max(i - int(half_widths[i]), 0)
        end = min(i + int(half_widths[i]) + 1, len(labels))

        is_few = np.float32(shot.near) < limits.least_near
        is_leaf = is_few and _is_among_leaves(shot, place, slots, limits)
        is_pit = shot.upright > 0 and np.float32(shot.near) >= limits.pit_near
        is_below = shot.above_m < -limits.below_m and shot.smooth < BELOW_SMOOTH
        ground = _ground_rule(shot, limits)
        if is_few and not is_leaf and not (shot.near > 0 and _is_on_surface(shot, place, limits)):
            rule = _ISOLATED
        elif shot.smooth == 0 and _is_smooth(count_sums[end] - count_sums[first], limits):
            rule = _SPIKE
        elif is_below and not is_pit:
            rule = _BELOW_GROUND
        elif ground != _NOT_GROUND:
            rule = ground
        elif is_leaf:
            rule = _OPEN_LEAF
        else:
            rule = _OPEN
        labels[i] = rule


@inlined
def _is_among_leaves(
    shot: Shot, place: Place, rough_slots: np.uint64, limits: DecisionThresholds
) -> bool:
    """Whether leaves are around: far away, gaps between them are wider than what counts as near."""
    if place.bin == BEYOND or not shot.above_m > limits.foot_m or _is_in_wall(shot, place, limits):
        return False
    return bool(np.float32(_slots_around(rough_slots, _slot(shot.above_m))) >= limits.leaf_slots)


@inlined
def _is_on_surface(shot: Shot, place: Place, limits: DecisionThresholds) -> bool:
    """Whether a shot is on a surface: the few shots left of a far one still agree with it."""
    is_on_ground = abs(shot.above_m) < limits.soil_m
    return bool((shot.smooth > 0) | is_on_ground | _is_in_wall(shot, place, limits))


@inlined
def _is_smooth(counts_around: np.uint32, limits: DecisionThresholds) -> bool:
    """Whether the shots around are smooth, in the line and in the lines before and after."""
    n_shots = np.int32(counts_around >> np.uint32(16))
    n_pairs = np.int32(counts_around & np.uint32(0xFFFF))
    return bool(np.float32(n_pairs) > limits.spike_share * np.float32(MOST_SMOOTH * n_shots))


# Step 3: what is around a shot, reflections, and what may be upright and thin


@helper
def _label_reflections(
    line: Line,
    beside: Beside,
    limits: DecisionThresholds,
    around: Surroundings,
    labels: U8,
    may_be_upright: U8,
) -> None:
    """Write the surroundings of every shot, label reflections, and mark shots for step 4."""
    for i in range(len(labels)):
        shot = _shot(line, i)
        place = _place(beside, i)
        is_rough = shot.texture < _leaf_share(shot, place, limits)
        is_foliage = is_rough & (not _is_of_wall(shot, place, limits))
        is_in_car = _is_in_car(shot, place, is_foliage)
        around.is_rough[i] = is_rough
        around.is_foliage[i] = is_foliage
        around.is_in_car[i] = is_in_car

        n_near = np.float32(shot.near)
        is_open = labels[i] >= _OPEN_LEAF
        is_far = _is_far_behind_wall(shot, place, is_foliage, limits)
        is_lost = is_in_car & (shot.smooth == 0) & (n_near < limits.least_near)
        if is_open & is_far & (n_near < limits.ghost_near):
            rule = _BEHIND_WALL
        elif is_open & is_lost:
            rule = _IN_CAR
        else:
            rule = labels[i]
        labels[i] = rule
        is_open = rule >= _OPEN_LEAF
        may_be_upright[i] = np.uint8(is_open & _may_be_upright(shot, place, is_in_car, limits))


@inlined
def _leaf_share(shot: Shot, place: Place, limits: DecisionThresholds) -> np.float32:
    """Below this share of smooth pairs around, a place is rough: balconies and roofs are, too."""
    before_m = abs(place.wall_ahead_m) - abs(shot.side_m)
    is_before = (before_m >= -STRIP_M) & (before_m <= limits.before_m)
    is_before &= place.wall_ahead_m != np.float32(0.0)
    is_house = is_before | _is_on_house(shot, place, limits.roof_m, limits)
    return limits.leaf_share_before_wall if is_house else limits.leaf_share


@inlined
def _is_of_wall(shot: Shot, place: Place, limits: DecisionThresholds) -> bool:
    """Whether a rough shot is in a wall, behind its panes, or on a facade, at any height."""
    is_near = _is_on_house(shot, place, limits.behind_m, limits)
    is_house = _is_on_house(shot, place, limits.roof_m, limits)
    is_on_facade = is_near & is_house & (place.wall_top_m > np.float32(0.0))
    return bool(_is_in_wall(shot, place, limits) | is_on_facade)


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
def _may_be_upright(shot: Shot, place: Place, is_in_car: bool, limits: DecisionThresholds) -> bool:
    """Whether a shot is on a post, or on a smooth piece that is upright or high."""
    is_piece = (shot.kind != np.uint8(0)) & (shot.kind < SMALL)
    is_up = (shot.level == 0) | (shot.above_m > limits.arm_m)
    is_of_car = is_in_car & (shot.kind != THIN)
    is_part = _is_in_wall(shot, place, limits) | is_of_car
    is_thin = is_piece & is_up & (shot.above_m > limits.foot_m) & (not is_part)
    is_thin &= shot.texture >= limits.leaf_share
    is_known = (place.bin < BEYOND) & (limits.pole_m > np.float32(0.0))
    return bool(is_known & (is_thin | (shot.kind == POST) | (shot.kind == MAST)))


# Step 4: trunks, posts and arms


@helper
def _label_uprights(
    shots: I32,
    window_m: F32,
    row: int,
    line: Line,
    beside: Beside,
    rough_slots: U64,
    limits: DecisionThresholds,
    labels: U8,
) -> None:
    """Label a list of shots on free-standing things; ``row`` is that of the line in the window."""
    range_m, side_m, height_m, above_m = line.range_m, line.side_m, line.height_m, line.above_m
    kind, level = line.kind, line.level
    end = 0
    is_round = False
    for k in range(len(shots)):
        i = shots[k]
        if i >= end:
            end, is_round = _round_run(range_m, side_m, height_m, kind, i, limits)
        above_slots = rough_slots[beside.bin[i] >> 1] >> np.uint64(_slot(above_m[i]))
        if kind[i] == MAST:
            rule = _POST
        elif np.float32(count_bits(above_slots)) >= limits.crown_slots:
            rule = _CROWN
        elif kind[i] == FEW_SHOTS:
            rule = labels[i]  # too few shots to tell a post: step 5
        elif is_round or _depth_m(window_m, row, i, side_m[i], limits) >= limits.thick_m:
            rule = _TRUNK
        elif (level[i] == 0) | (kind[i] == POST):
            rule = _POST
        else:
            rule = _ARM
        labels[i] = rule


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
    deep_m = side_m[first:end].max() - side_m[first:end].min()
    tall_m = height_m[first:end].max() - height_m[first:end].min()
    is_round = (deep_m >= limits.thick_m) & (deep_m < np.float32(0.5) * tall_m)
    return end, bool(is_round & (tall_m < np.float32(2.0) * limits.pole_m))


@inlined
def _depth_m(
    window_m: F32, row: int, i: int, side_m: np.float32, limits: DecisionThresholds
) -> np.float32:
    """Return the depth to the side of the object that the lines around see at a shot [m]."""
    least_m = most_m = window_m[row, i]
    for way in (-1, 1):
        last_m = window_m[row, i]
        for k in range(1, BESIDE + 1):
            range_m = window_m[row + way * k, i]
            if not (abs(range_m - last_m) < limits.jump_m):
                break
            least_m = min(least_m, range_m)
            most_m = max(most_m, range_m)
            last_m = range_m
    return np.float32((most_m - least_m) * (abs(side_m) / window_m[row, i]))


# Step 5: everything else above the ground


@helper
def _label_surfaces(
    line: Line,
    beside: Beside,
    around: Surroundings,
    limits: DecisionThresholds,
    labels: U8,
) -> None:
    for i in range(len(labels)):
        kind = line.kind[i] if beside.bin[i] < BEYOND else np.uint8(0)
        is_rough = around.is_rough[i]
        is_foliage = around.is_foliage[i]
        is_in_car = around.is_in_car[i]
        # foliage may stand free as well
        is_small = (kind >= SMALL) & (is_in_car | (line.texture[i] >= limits.leaf_share))
        if labels[i] < _OPEN_LEAF:
            rule = labels[i]
        elif is_small & (kind == FENCE):
            rule = _SMOOTH
        elif is_small:
            rule = _SMALL
        elif is_in_car:
            rule = _LEVEL_BODY
        elif is_foliage:
            rule = _FOLIAGE
        elif labels[i] == _OPEN_LEAF:
            rule = _LEAF
        elif is_rough:
            rule = _FACADE
        else:
            rule = _SMOOTH
        labels[i] = rule


# Step 6: bins and cabinets


@helper
def _mark_tops(line: Line, labels: U8, limits: DecisionThresholds, marks: U8) -> None:
    """Mark the shots of a line that may be on the top of a box: low, smooth and level."""
    for i in range(len(labels)):
        is_low = (line.above_m[i] > limits.foot_m) & (line.above_m[i] < limits.box_m)
        is_level = (line.level[i] > line.upright[i]) & (line.smooth[i] >= BOX_SMOOTH)
        marks[i] = np.uint8(is_low & is_level & _is_above_ground(labels[i]))


@helper
def _label_boxes(
    shots: I32,
    window_m: F32,
    row: int,
    line: Line,
    limits: DecisionThresholds,
    labels: U8,
) -> None:
    """Label the boxes whose tops are in a list.

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
                labels[j] = _BOX if _is_above_ground(labels[j]) else labels[j]


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
        is_noise = not _is_above_ground(labels[j]) and not _is_ground(labels[j])
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
        if _is_above_ground(labels[j]):
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
        if _is_above_ground(labels[j]) and line.above_m[j] > high_m - BOX_EVEN_M:
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
def _is_above_ground(rule: np.uint8) -> bool:
    label = LABELS_BY_REASON[rule]
    return bool((label != _NO_RETURN) & (label != _NOISE) & (label != _GROUND))


@inlined
def _is_ground(rule: np.uint8) -> bool:
    return bool(LABELS_BY_REASON[rule] == _GROUND)


# What the steps read: shots, points, places, strips and cars


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
def _list_marked(marks: U8, least: np.uint8, most: np.uint8, shots: I32) -> int:
    """List the shots of a line with marks from one to another, return how many there are."""
    n = 0
    for i in range(len(marks)):
        shots[n] = i
        n += (marks[i] >= least) & (marks[i] <= most)
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
    marks = np.empty(m, np.uint8)
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
    around = Surroundings(np.empty(m, np.bool_), np.empty(m, np.bool_), np.empty(m, np.bool_))
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
        _label_clear_shots(line, thresholds, rules)

        _find_cars(slots.by_any[n], levels[n], bin_counts, thresholds, cars)
        _bins(side_m, beside.bin)
        n_shots = _list_marked(rules, _DOUBTFUL, _OPEN, shots)
        _copy_walls(walls, n, walls_of_line)
        _look_beside(shots[:n_shots], walls_of_line, cars, beside)

        write_pairs(near[k + 1], smooth[k + 1], least, counts[(n + 2) % 3])
        _sum_up_three(counts[0], counts[1], counts[2], count_sums)
        _half_widths(range_m, step_rad, half_widths)
        _label_doubtful_shots(
            shots[:n_shots],
            line,
            beside,
            rough_slots,
            half_widths,
            count_sums,
            thresholds,
            rules,
        )

        _label_reflections(line, beside, thresholds, around, rules, marks)
        n_shots = _list_marked(marks, _MARKED, _MARKED, shots)
        _label_uprights(
            shots[:n_shots], window_m, row, line, beside, rough_slots, thresholds, rules
        )

        _label_surfaces(line, beside, around, thresholds, rules)

        _mark_tops(line, rules, thresholds, marks)
        n_shots = _list_marked(marks, _MARKED, _MARKED, shots)
        _label_boxes(shots[:n_shots], window_m, row, line, thresholds, rules)
    return labels
