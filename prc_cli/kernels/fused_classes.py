"""The loops that weigh what was found around every shot and label it, for the fused classifier."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import Label
from prc_cli.core.types import F32, U8, Mask
from prc_cli.kernels.cache import helper, inlined, kernel

Slots = NDArray[np.uint64]

LINES = 2
"""Lines before and after that the texture looks at."""
MARGIN = 4
"""Lines of the window before and after the block."""
MOST_SMOOTH = 8
"""More smooth pairs than these make a shot no smoother."""
MOST_COLUMNS = 60
LEAST_COLUMNS = 2
"""Half widths of a place, in columns."""
STRIPS, STRIP_M, SLOT_M, SLOTS = 320, np.float32(0.5), np.float32(0.25), 64
"""As in :mod:`prc_cli.kernels.fused_strips`."""
(
    LEAST_NEAR,
    SPIKE_SHARE,
    BELOW_M,
    LEAF_SLOTS,
    WALKED_M,
    LEVEL_M,
    SOIL_M,
    LEAF_SHARE,
    LEAF_SHARE_BEFORE_WALL,
    BEFORE_M,
    FRONT_M,
    BEHIND_M,
    OVER_M,
    CAR_TOP_M,
    CAR_BINS,
    CAR_BINS_ROUGH,
    POLE_M,
    JUMP_M,
    FAR_M,
    CROWN_SLOTS,
    OBJECT_M,
    N_FIGURES,
) = range(22)
"""Figures of the decision, in this order."""
SPIKE_PLACE_M = np.float32(0.1)
"""Half width of the place beside a spike [m]."""
SPIKE_COLUMNS = 6
LEAF_REACH = 4
"""Slots up and down in which company of leaves is looked for."""
CAR_REACH = 6
"""Bins of level surface on either side that count."""
BELOW_SMOOTH = 3
"""Smooth pairs below the ground that are no reflection."""
ACROSS_LINES = 4
"""Lines before and after that tell whether a thing is thin."""
VOTERS = 4
"""Votes of a place in a line, on either side of a shot, where it has that many columns."""
GAP_SHOTS = 3
"""Shots without support that part a run, beside as many as it is long."""
_MISSING, _NOISE, _GROUND = int(Label.MISSING), int(Label.NOISE), int(Label.GROUND)
_OPEN = 255
"""Mark of shots that are not decided yet."""
_BUILDING, _VEGETATION, _OTHER = int(Label.BUILDING), int(Label.VEGETATION), int(Label.UNCLASSIFIED)


@kernel("float32[:, ::1](float32[:, ::1], uint8[:, ::1], uint8[:, ::1], float32, float32, float32)")
def mean_smoothness(
    range_m: F32, near: U8, smooth: U8, step: np.float32, least_near: np.float32, half_m: np.float32
) -> F32:
    """Average how smooth the shots around a shot are: in its line and two before and after, over a width in metres.

    Parameters
    ----------
    range_m : (lines + 4, M) float32, metres
        NaN = missing.
    near, smooth : (lines + 4, M) uint8
        Near neighbours and smooth pairs.
    step : float32, radians
        Angle from column to column.
    least_near : float32
        Shots with fewer near neighbours do not count.
    half_m : float32
        Half of the width [m]; 2 columns at least, 60 at most.

    Returns
    -------
    (lines, M) float32
        0 = all rough, 1 = all smooth; 0 where there is no return.
    """
    n_lines, m = range_m.shape[0] - 2 * LINES, range_m.shape[1]
    # smooth pairs so far in the lower half, shots so far in the upper
    so_far = np.zeros((n_lines + 2 * LINES, m + 1), np.int64)
    for line in range(n_lines + 2 * LINES):
        total = np.int64(0)
        company, own, row = near[line], smooth[line], so_far[line]
        for i in range(m):
            counts = np.float32(company[i]) >= least_near
            total += (np.int64(1 << 32) + np.int64(min(own[i], np.uint8(MOST_SMOOTH)))) if counts else np.int64(0)
            row[i + 1] = total
    mean = np.zeros((n_lines, m), np.float32)
    for line in range(n_lines):
        own, row = range_m[line + LINES], mean[line]
        l0, l1, l2 = so_far[line], so_far[line + 1], so_far[line + 2]
        l3, l4 = so_far[line + 3], so_far[line + 4]
        for i in range(m):
            if own[i] != own[i]:
                continue
            columns = min(max(int(half_m / (own[i] * step)), LEAST_COLUMNS), MOST_COLUMNS)
            a, b = max(i - columns, 0), min(i + columns + 1, m)
            total = (l0[b] - l0[a]) + (l1[b] - l1[a]) + (l2[b] - l2[a]) + (l3[b] - l3[a]) + (l4[b] - l4[a])
            shots = total >> 32
            pairs = total - (shots << 32)
            if shots > 0:
                row[i] = np.float32(pairs) / (np.float32(MOST_SMOOTH) * np.float32(shots))
    return mean


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
    low, high = max(slot - LEAF_REACH, 0), min(slot + LEAF_REACH, SLOTS - 1)
    ones = ~np.uint64(0) >> np.uint64(SLOTS - 1 - (high - low))
    return _bits(word & (ones << np.uint64(low)))


@inlined
def _is_tall(word: np.uint64, slot: int, top: int) -> bool:
    """Tell whether slots are filled from one up to another, but for gaps of two."""
    if slot >= top:
        return True
    filled = word | (word << np.uint64(1)) | (word << np.uint64(2))
    wanted = (~np.uint64(0) >> np.uint64(SLOTS - (top - slot))) << np.uint64(slot)
    return bool((filled & wanted) == wanted)


@helper
def _is_spike(
    near: U8, smooth: U8, line: int, i: int, range_m: np.float32, step: np.float32, least: np.float32, share: np.float32
) -> bool:
    """Tell whether the shots right beside a rough one are smooth, in its line and those before and after."""
    m = near.shape[1]
    columns = min(max(int(SPIKE_PLACE_M / (range_m * step)), LEAST_COLUMNS), SPIKE_COLUMNS)
    shots, pairs = 0, 0
    for k in range(line - 1, line + 2):
        for j in range(max(i - columns, 0), min(i + columns + 1, m)):
            if np.float32(near[k, j]) >= least:
                shots += 1
                pairs += min(int(smooth[k, j]), MOST_SMOOTH)
    return bool(np.float32(pairs) > share * np.float32(MOST_SMOOTH * shots))


@helper
def _is_short(ranges: F32, near: U8, heights: F32, i: int, figures: F32) -> bool:
    """Tell whether the run of a shot along its line is short, with something far or nothing behind both of its ends."""
    m = len(ranges)
    least, jump, far = figures[LEAST_NEAR], figures[JUMP_M], figures[FAR_M]
    low, high = heights[i], heights[i]
    length = 1
    for way in (-1, 1):
        last, j, gap = i, i + way, 0
        while True:
            if j < 0 or j >= m or gap > GAP_SHOTS + length:
                break
            if np.float32(near[j]) < least:
                gap += 1
                j += way
                continue
            if abs(ranges[j] - ranges[last]) < jump:
                last, gap = j, 0
                length += 1
                low, high = min(low, heights[j]), max(high, heights[j])
                if high - low >= figures[POLE_M]:
                    return False
                j += way
                continue
            if ranges[j] <= ranges[last] + far:
                return False
            break
    return True


@helper
def _is_thin(window_m: F32, line: int, i: int, far: np.float32) -> bool:
    """Tell whether lines close by, before and after, see nothing or something far in the direction of a shot."""
    own = window_m[line, i]
    before = after = 0
    for k in range(1, ACROSS_LINES + 1):
        if line - k >= 0 and not (window_m[line - k, i] <= own + far):
            before = k
            break
    for k in range(1, ACROSS_LINES + 1):
        if line + k < len(window_m) and not (window_m[line + k, i] <= own + far):
            after = k
            break
    return before > 0 and after > 0 and before + after <= ACROSS_LINES + 1


@inlined
def _is_ground(h: np.float32, is_walked: bool, upright: int, level: int, figures: F32) -> bool:
    """Tell whether a shot is on the ground: walked over, or low and more level than upright."""
    a = abs(h)
    return (
        (is_walked and a < figures[WALKED_M])
        or (a < figures[LEVEL_M] and level > upright)
        or (a < figures[SOIL_M] and upright <= level + 1)
    )


@helper
def _label_plain(
    ranges: F32, above: F32, counts: tuple[U8, U8, U8, U8], walked: Mask, figures: F32, labels: U8
) -> None:
    """Label what needs no second look: nothing, what is all alone, and ground; mark the rest as open.

    No branches, so that many shots are looked at at a time.
    """
    near, smooth, upright, level = counts
    least, below = figures[LEAST_NEAR], figures[BELOW_M]
    walked_m, level_m, soil_m = figures[WALKED_M], figures[LEVEL_M], figures[SOIL_M]
    for i in range(len(ranges)):
        h, pairs, up, flat = above[i], smooth[i], upright[i], level[i]
        off = abs(h)
        is_ground = (
            ((off < walked_m) & walked[i])
            | ((off < level_m) & (flat > up))
            | ((off < soil_m) & (up <= flat + np.uint8(1)))
        )
        company = np.float32(near[i])
        is_held = (company >= least) & (pairs > 0) & ((h >= -below) | (pairs >= BELOW_SMOOTH))
        code = np.uint8(_GROUND) if is_ground & is_held else np.uint8(_OPEN)
        code = np.uint8(_NOISE) if (near[i] == 0) & (company < least) else code
        labels[i] = code if ranges[i] == ranges[i] else np.uint8(_MISSING)


@inlined
def _in_wall(y: np.float32, z: np.float32, at: np.float32, top: np.float32, figures: F32) -> bool:
    """Tell whether a shot is in a wall or, seen through it, behind."""
    if at == np.float32(0.0):
        return False
    behind = abs(y) - abs(at)
    if behind < -figures[FRONT_M] or behind > figures[BEHIND_M]:
        return False
    through = z * (abs(at) / abs(y)) if behind > np.float32(0.0) else z
    return bool(through <= top + figures[OVER_M])


@inlined
def _level_bins(levels: U8, y: np.float32) -> int:
    """Count the bins with a level surface around a shot."""
    b = int(np.floor(y / (STRIP_M / np.float32(2.0)))) + STRIPS
    n = 0
    for q in range(max(b - CAR_REACH, 0), min(b + CAR_REACH + 1, 2 * STRIPS)):
        n += levels[q]
    return n


@helper
def _is_noise(
    places: tuple[U8, U8],
    line: int,
    i: int,
    shot: tuple[np.float32, np.float32, np.float32, np.float32],
    rows: tuple[Slots, F32, F32],
    step: np.float32,
    figures: F32,
) -> tuple[bool, bool]:
    """Tell whether a shot is noise, and whether it is a lonely leaf instead."""
    near, smooth = places
    r, y, z, h = shot
    rough, at, top = rows
    is_leaf = False
    if np.float32(near[line, i]) < figures[LEAST_NEAR]:
        b = _strip(y)
        if near[line, i] > 0 and b >= 0 and h > figures[OBJECT_M] and not _in_wall(y, z, at[b], top[b], figures):
            is_leaf = np.float32(_slots_around(rough[b], _slot(h))) >= figures[LEAF_SLOTS]
        if not is_leaf:
            return True, False
    if smooth[line, i] == 0 and _is_spike(near, smooth, line, i, r, step, figures[LEAST_NEAR], figures[SPIKE_SHARE]):
        return True, False
    return h < -figures[BELOW_M] and smooth[line, i] < BELOW_SMOOTH, is_leaf


@helper
def _label_open(
    window_m: F32,
    line: int,
    points: tuple[F32, F32, F32],
    counts: tuple[U8, U8, U8, U8],
    walked: Mask,
    texture: F32,
    slots: tuple[Slots, Slots],
    walls: tuple[F32, F32, F32],
    levels: U8,
    step: np.float32,
    figures: F32,
    labels: U8,
) -> None:
    """Ask the shots of a line that are open one question after the other."""
    k = line + LINES
    ranges, side, height, above = window_m[line + MARGIN], points[0][k], points[1][k], points[2][k]
    near, smooth, upright, level = counts[0][k], counts[1][k], counts[2][k], counts[3][k]
    is_walked, soft, least, below = walked[k], texture[line], figures[LEAST_NEAR], figures[BELOW_M]
    every, rough_slots, bins = slots[0][line], slots[1][line], levels[line]
    at, top, ahead = walls[0][line], walls[1][line], walls[2][line]
    car_slot, leaf_share = int(figures[CAR_TOP_M] / SLOT_M), figures[LEAF_SHARE]
    for i in range(len(labels)):
        if labels[i] != _OPEN:
            continue
        y, z, h = side[i], height[i], above[i]
        is_leaf = False
        if np.float32(near[i]) < least or smooth[i] == 0 or h < -below:
            is_noise, is_leaf = _is_noise(
                (counts[0], counts[1]), k, i, (ranges[i], y, z, h), (rough_slots, at, top), step, figures
            )
            if is_noise:
                labels[i] = _NOISE
                continue
            # of all others it is known that they are not
            if _is_ground(h, is_walked[i], int(upright[i]), int(level[i]), figures):
                labels[i] = _GROUND
                continue
        b = _strip(y)
        if b < 0:
            labels[i] = _VEGETATION if soft[i] < leaf_share or is_leaf else _BUILDING
            continue
        is_wall = _in_wall(y, z, at[b], top[b], figures)
        before = abs(ahead[b]) - abs(y)
        is_before = ahead[b] != np.float32(0.0) and -STRIP_M <= before <= figures[BEFORE_M]
        is_rough = soft[i] < (figures[LEAF_SHARE_BEFORE_WALL] if is_before else leaf_share) and not is_wall
        labels[i] = _VEGETATION if is_rough or is_leaf else _BUILDING
        if h >= np.float32(0.0) and not _is_tall(every[b], _slot(h), car_slot):
            enough = figures[CAR_BINS_ROUGH] if is_rough else figures[CAR_BINS]
            if np.float32(_level_bins(bins, y)) >= enough:
                labels[i] = _OTHER
                continue
        may_be_pole = not is_wall and level[i] == 0 and h > figures[OBJECT_M] and soft[i] >= leaf_share
        if figures[POLE_M] > 0 and may_be_pole:
            is_thin = _is_short(ranges, near, height, i, figures) or _is_thin(
                window_m, line + MARGIN, i, figures[FAR_M]
            )
            if is_thin:
                crown = np.float32(_bits(rough_slots[b] >> np.uint64(_slot(h))))
                labels[i] = _VEGETATION if crown >= figures[CROWN_SLOTS] else _OTHER


@kernel(
    "uint8[:, ::1](float32[:, ::1], UniTuple(float32[:, ::1], 3), UniTuple(uint8[:, ::1], 4), boolean[:, ::1],"
    " float32[:, ::1], UniTuple(uint64[:, ::1], 2), UniTuple(float32[:, ::1], 3), uint8[:, ::1], float32, float32[::1])"
)
def fused_labels(
    window_m: F32,
    points: tuple[F32, F32, F32],
    counts: tuple[U8, U8, U8, U8],
    walked: Mask,
    texture: F32,
    slots: tuple[Slots, Slots],
    walls: tuple[F32, F32, F32],
    levels: U8,
    step: np.float32,
    figures: F32,
) -> U8:
    """Label every shot of consecutive lines.

    Parameters
    ----------
    window_m : (lines + 8, M) float32, metres
        Ranges of these lines and of four before and after; NaN = missing.
    points : tuple of (lines + 4, M) float32, metres
        Side and height in the scan plane, and height above the ground, of these lines and two before and after.
    counts : tuple of (lines + 4, M) uint8
        Near neighbours, smooth pairs, upright and level chords.
    walked : (lines + 4, M) bool
        Shots that the walk along the ground went over.
    texture : (lines, M) float32
        Of :func:`mean_smoothness`.
    slots : tuple of (lines, STRIPS) uint64
        Of all and of rough shots, widened.
    walls : tuple of (lines, STRIPS) float32, metres
        Of :func:`prc_cli.kernels.fused_strips.find_walls`.
    levels : (lines, 2 STRIPS) uint8
        Widened.
    step : float32, radians
        Angle from column to column.
    figures : (N_FIGURES,) float32
        In the order of the constants above.

    Returns
    -------
    (lines, M) uint8
        :class:`prc_cli.core.classes.Label`.
    """
    n_lines, m = texture.shape
    near, smooth, upright, level = counts
    labels = np.empty((n_lines, m), np.uint8)
    for line in range(n_lines):
        k = line + LINES
        own = (near[k], smooth[k], upright[k], level[k])
        _label_plain(window_m[line + MARGIN], points[2][k], own, walked[k], figures, labels[line])
        _label_open(window_m, line, points, counts, walked, texture, slots, walls, levels, step, figures, labels[line])
    return labels


@inlined
def _differs(label: np.uint8, own: np.uint8) -> bool:
    """Tell whether a label is another one; nothing and noise are none."""
    return bool((label != own) & (label != _MISSING) & (label != _NOISE))


@helper
def _mark_unsettled(before: U8, own: U8, after: U8, unsettled: U8) -> None:
    """Mark the shots that some shot a few columns away, or one of the lines beside, has another label than."""
    m = len(own)
    for i in range(m):
        label = own[i]
        votes = (label != _MISSING) & (label != _NOISE) & (label != _GROUND)
        unsettled[i] = votes & (_differs(before[i], label) | _differs(after[i], label))
    if m <= VOTERS:
        first, last = own[0], own[m - 1]
        for i in range(m):
            label = own[i]
            votes = (label != _MISSING) & (label != _NOISE) & (label != _GROUND)
            unsettled[i] |= votes & (_differs(first, label) | _differs(last, label))
        return
    for way in range(2):
        # a shot and that VOTERS columns on, asked from both ends; beyond the ends the outermost one is asked
        asker = own[: m - VOTERS] if way == 0 else own[VOTERS:]
        asked = own[VOTERS:] if way == 0 else own[: m - VOTERS]
        marks = unsettled[: m - VOTERS] if way == 0 else unsettled[VOTERS:]
        for i in range(m - VOTERS):
            label = asker[i]
            votes = (label != _MISSING) & (label != _NOISE) & (label != _GROUND)
            marks[i] |= votes & _differs(asked[i], label)
        end = own[m - 1] if way == 0 else own[0]
        for k in range(VOTERS):
            i = m - VOTERS + k if way == 0 else k
            label = own[i]
            votes = (label != _MISSING) & (label != _NOISE) & (label != _GROUND)
            unsettled[i] |= votes & _differs(end, label)


@helper
def _vote(labels: U8, points: tuple[F32, F32], line: int, i: int, columns: int, near_m: np.float32) -> int:
    """Return the label that most shots of a place have which are near in space; the own one where several do."""
    m = labels.shape[1]
    y, z = points[0][line, i], points[1][line, i]
    other, building, vegetation = 0, 0, 0
    stride = max(columns // VOTERS, 1)
    for k in range(line - 1, line + 2):
        for j in range(max(i - columns, 0), min(i + columns + 1, m), stride):
            if abs(points[0][k, j] - y) < near_m and abs(points[1][k, j] - z) < near_m:
                other += labels[k, j] == _OTHER
                building += labels[k, j] == _BUILDING
                vegetation += labels[k, j] == _VEGETATION
    most = max(max(other, building), vegetation)
    own = int(labels[line, i])
    if (own == _OTHER and other == most) or (own == _BUILDING and building == most):
        return own
    if own == _VEGETATION and vegetation == most:
        return own
    if other == most:
        return _OTHER
    return _BUILDING if building == most else _VEGETATION


@kernel("uint8[:, ::1](uint8[:, ::1], float32[:, ::1], UniTuple(float32[:, ::1], 2), float32, float32, float32)")
def vote_labels(
    labels: U8, range_m: F32, points: tuple[F32, F32], step: np.float32, half_m: np.float32, near_m: np.float32
) -> U8:
    """Let every shot that is neither ground nor noise take the label of most of the shots around it.

    Where neither the shots four columns to both sides nor those of the lines before and after have another one, it
    keeps its own; noise has no say.

    Parameters
    ----------
    labels : (lines + 2, M) uint8
        :class:`prc_cli.core.classes.Label` of the block and a line before and after.
    range_m : (lines + 2, M) float32, metres
    points : tuple of (lines + 2, M) float32, metres
        Side and height in the scan plane.
    step : float32, radians
        Angle from column to column.
    half_m : float32
        Half width of the place [m]; 2 columns at least, 60 at most.
    near_m : float32
        Shots of the place count if they are this near to the side and in height, each [m].

    Returns
    -------
    (lines, M) uint8
    """
    n_lines, m = labels.shape[0] - 2, labels.shape[1]
    voted = labels[1 : n_lines + 1].copy()
    unsettled = np.empty(m, np.uint8)
    for row in range(n_lines):
        line = row + 1
        _mark_unsettled(labels[line - 1], labels[line], labels[line + 1], unsettled)
        for i in range(m):
            if unsettled[i]:
                columns = min(max(int(half_m / (range_m[line, i] * step)), LEAST_COLUMNS), MOST_COLUMNS)
                voted[row, i] = _vote(labels, points, line, i, columns, near_m)
    return voted
