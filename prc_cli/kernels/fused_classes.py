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
_QUIET = 1 << _MISSING | 1 << _NOISE
_DECIDED = _QUIET | 1 << _GROUND
"""Labels that have no vote, and that no vote changes, as bits."""
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
    return min(max(int(above / SLOT_M), 0), SLOTS - 1)


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


@helper
def _is_leaf(
    y: np.float32,
    z: np.float32,
    above: np.float32,
    line: int,
    rough: Slots,
    walls: tuple[F32, F32, F32],
    figures: F32,
) -> bool:
    """Tell whether a lonely shot is among rough ones, and not in a wall."""
    b = _strip(y)
    if b < 0 or above <= figures[OBJECT_M] or _in_wall(y, z, walls[0][line, b], walls[1][line, b], figures):
        return False
    return bool(np.float32(_slots_around(rough[line, b], _slot(above))) >= figures[LEAF_SLOTS])


@inlined
def _level_bins(levels: U8, y: np.float32) -> int:
    """Count the bins with a level surface around a shot."""
    b = int(np.floor(y / (STRIP_M / np.float32(2.0)))) + STRIPS
    n = 0
    for q in range(max(b - CAR_REACH, 0), min(b + CAR_REACH + 1, 2 * STRIPS)):
        n += levels[q]
    return n


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
    side, height, above = points
    near, smooth, upright, level = counts
    least = figures[LEAST_NEAR]
    car_slot = int(figures[CAR_TOP_M] / SLOT_M)
    labels = np.zeros((n_lines, m), np.uint8)
    for line in range(n_lines):
        k = line + LINES
        for i in range(m):
            r = window_m[line + MARGIN, i]
            if r != r:
                continue
            h, pairs = above[k, i], smooth[k, i]
            leaf = False
            if np.float32(near[k, i]) < least:
                # alone, unless it is a leaf among rough shots
                leaf = near[k, i] > 0 and _is_leaf(side[k, i], height[k, i], h, line, slots[1], walls, figures)
                if not leaf:
                    labels[line, i] = _NOISE
                    continue
            if pairs == 0 and _is_spike(near, smooth, k, i, r, step, least, figures[SPIKE_SHARE]):
                labels[line, i] = _NOISE
                continue
            if h < -figures[BELOW_M] and pairs < BELOW_SMOOTH:
                labels[line, i] = _NOISE
                continue
            up, flat = int(upright[k, i]), int(level[k, i])
            if _is_ground(h, walked[k, i], up, flat, figures):
                labels[line, i] = _GROUND
                continue
            y, z = side[k, i], height[k, i]
            b = _strip(y)
            wall = b >= 0 and _in_wall(y, z, walls[0][line, b], walls[1][line, b], figures)
            share = figures[LEAF_SHARE]
            if b >= 0 and walls[2][line, b] != np.float32(0.0):
                before = abs(walls[2][line, b]) - abs(y)
                if before <= figures[BEFORE_M] and before >= -STRIP_M:
                    share = figures[LEAF_SHARE_BEFORE_WALL]
            rough = texture[line, i] < share and not wall
            label = _VEGETATION if rough or leaf else _BUILDING
            if b < 0:
                labels[line, i] = label
                continue
            if h >= np.float32(0.0) and not _is_tall(slots[0][line, b], _slot(h), car_slot):
                bins = np.float32(_level_bins(levels[line], y))
                if bins >= (figures[CAR_BINS_ROUGH] if rough else figures[CAR_BINS]):
                    labels[line, i] = _OTHER
                    continue
            if (
                figures[POLE_M] > 0
                and not wall
                and flat == 0
                and h > figures[OBJECT_M]
                and texture[line, i] >= figures[LEAF_SHARE]
                and (
                    _is_short(window_m[line + MARGIN], near[k], height[k], i, figures)
                    or _is_thin(window_m, line + MARGIN, i, figures[FAR_M])
                )
            ):
                crown = _bits(slots[1][line, b] >> np.uint64(_slot(h)))
                label = _VEGETATION if crown >= figures[CROWN_SLOTS] else _OTHER
            labels[line, i] = label
    return labels


@inlined
def _may_differ(label: int, own: int) -> bool:
    """Tell whether a label is another one; nothing and noise have none."""
    return label != own and not (_QUIET >> label) & 1


@inlined
def _is_settled(labels: U8, line: int, i: int) -> bool:
    """Tell whether no shot a few columns away, and none of the lines beside, has another label."""
    m = labels.shape[1]
    own = labels[line, i]
    return not (
        _may_differ(labels[line - 1, i], own)
        or _may_differ(labels[line + 1, i], own)
        or _may_differ(labels[line, max(i - VOTERS, 0)], own)
        or _may_differ(labels[line, min(i + VOTERS, m - 1)], own)
    )


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
    for row in range(n_lines):
        line = row + 1
        for i in range(m):
            own = labels[line, i]
            if (_DECIDED >> own) & 1:
                continue
            if not _is_settled(labels, line, i):
                columns = min(max(int(half_m / (range_m[line, i] * step)), LEAST_COLUMNS), MOST_COLUMNS)
                voted[row, i] = _vote(labels, points, line, i, columns, near_m)
    return voted
