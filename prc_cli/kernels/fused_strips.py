"""Loops over what stands above the ground, sorted into narrow strips beside the scanner, for the fused classifier.

A strip is :data:`STRIP_M` wide; its heights above the ground are cut into slots of :data:`SLOT_M`, one bit each. Level
surfaces are kept in bins half as wide. What neighbouring lines see in a strip is put together: lines are not far apart,
and what stands upright stays in its strip from line to line.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32, U8
from prc_cli.kernels.cache import helper, kernel

Slots = NDArray[np.uint64]

STRIPS, STRIP_M, SLOT_M = 320, np.float32(0.5), np.float32(0.25)
"""Number of strips, half of them on either side, their width and the height of a slot [m]."""
SLOTS = 64
"""Slots of a strip; the last holds all that is higher."""
LINES = 2
"""Lines before and after that are put together with a line."""
NO_TOP = np.float32(-1e9)
"""Top of nothing [m]."""
LEAST_NEAR, FOOT_M, ROUGH, SMOOTH, LEVEL_SMOOTH, LEVEL_TOP_M, JUMP_M = range(7)
"""Figures of the strips, in this order."""
LEAST_COSINE = np.float32(0.3)
"""Surfaces are not taken to be met at more than this cosine when the height that a shot stands for is reckoned."""
UPRIGHT_CHORDS = 2
"""Upright chords, of three, of a shot on an upright surface."""
WALL_M, WALL_SHARE, BEFORE_M = range(3)
"""Figures of walls, in this order."""


@helper
def _fill_line(
    points: tuple[F32, F32, F32, F32],
    counts: tuple[U8, U8, U8, U8],
    step: np.float32,
    figures: F32,
    slots: tuple[Slots, Slots],
    sums: tuple[F32, F32, F32, F32],
    levels: U8,
) -> None:
    """Put the shots of a line into its strips."""
    ranges, side, height, above = points
    near, smooth, upright, level = counts
    every, rough = slots
    length, wall, place, top = sums
    least, foot = figures[LEAST_NEAR], figures[FOOT_M]
    m = len(ranges)
    for i in range(m):
        h, y = above[i], side[i]
        if not (h >= foot) or np.float32(near[i]) < least:
            continue
        b = int(np.floor(y / STRIP_M)) + STRIPS // 2
        if b < 0 or b >= STRIPS:
            continue
        bit = np.uint64(1) << np.uint64(int(min(h / SLOT_M, np.float32(SLOTS - 1))))
        every[b] |= bit
        if np.float32(smooth[i]) <= figures[ROUGH]:
            rough[b] |= bit
        # the height that the shot stands for, if it is on an upright surface
        stands_for = ranges[i] * step / max(abs(y) / ranges[i], LEAST_COSINE)
        length[b] += stands_for
        pairs = np.float32(smooth[i])
        if pairs >= figures[SMOOTH] and upright[i] >= UPRIGHT_CHORDS:
            wall[b] += stands_for
            place[b] += stands_for * y
            top[b] = max(top[b], height[i])
        if pairs >= figures[LEVEL_SMOOTH] and level[i] > upright[i] and h < figures[LEVEL_TOP_M]:
            first, last = y, y
            for j in (i - 1, i + 1):
                if 0 <= j < m and abs(side[j] - y) < figures[JUMP_M]:
                    first, last = min(first, side[j]), max(last, side[j])
            low = max(int(np.floor(first / (STRIP_M / np.float32(2.0)))) + STRIPS, 0)
            high = min(int(np.floor(last / (STRIP_M / np.float32(2.0)))) + STRIPS, 2 * STRIPS - 1)
            for q in range(low, high + 1):
                levels[q] = 1


@kernel(
    "Tuple((uint64[:, ::1], uint64[:, ::1], float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[:, ::1],"
    " uint8[:, ::1]))"
    "(UniTuple(float32[:, ::1], 4), UniTuple(uint8[:, ::1], 4), float32, float32[::1])"
)
def fill_strips(
    points: tuple[F32, F32, F32, F32], counts: tuple[U8, U8, U8, U8], step: np.float32, figures: F32
) -> tuple[Slots, Slots, F32, F32, F32, F32, U8]:
    """Sort what stands above the ground into strips, line by line.

    Parameters
    ----------
    points : tuple of (lines, M) float32, metres
        Range, side and height in the scan plane, height above the ground; NaN = missing.
    counts : tuple of (lines, M) uint8
        Near neighbours, smooth pairs, upright and level chords.
    step : float32, radians
        Angle from column to column.
    figures : (7,) float32
        Shots with LEAST_NEAR near neighbours that are FOOT_M above the ground count. With ROUGH smooth pairs or fewer
        they are rough, with SMOOTH or more smooth. Level surfaces of LEVEL_SMOOTH pairs below LEVEL_TOP_M count; they
        reach to the shots before and after that are less than JUMP_M away.

    Returns
    -------
    every, rough : (lines, STRIPS) uint64
        Slots with a shot, and with a rough one; bit 0 begins at the ground.
    length_m, wall_m, place, top_m : (lines, STRIPS) float32
        Height that the shots of a strip stand for; that of smooth upright ones; the sum of side times height of these;
        the height above the scanner of the highest of these, :data:`NO_TOP` = none.
    levels : (lines, 2 STRIPS) uint8
        1 where a smooth level surface is.
    """
    n_lines = points[0].shape[0]
    every, rough = np.zeros((n_lines, STRIPS), np.uint64), np.zeros((n_lines, STRIPS), np.uint64)
    length, wall = np.zeros((n_lines, STRIPS), np.float32), np.zeros((n_lines, STRIPS), np.float32)
    place, top = np.zeros((n_lines, STRIPS), np.float32), np.full((n_lines, STRIPS), NO_TOP, np.float32)
    levels = np.zeros((n_lines, 2 * STRIPS), np.uint8)
    for k in range(n_lines):
        _fill_line(
            (points[0][k], points[1][k], points[2][k], points[3][k]),
            (counts[0][k], counts[1][k], counts[2][k], counts[3][k]),
            step,
            figures,
            (every[k], rough[k]),
            (length[k], wall[k], place[k], top[k]),
            levels[k],
        )
    return every, rough, length, wall, place, top, levels


@kernel("uint64[:, ::1](uint64[:, ::1])")
def widen_slots(slots: Slots) -> Slots:
    """Put the slots of a line together with those of the lines and strips around.

    Parameters
    ----------
    slots : (lines + 4, STRIPS) uint64

    Returns
    -------
    (lines, STRIPS) uint64
        Slots of the two lines before and after and of the strips beside as well.
    """
    n_lines = slots.shape[0] - 2 * LINES
    wide = np.empty((n_lines, STRIPS), np.uint64)
    for line in range(n_lines):
        row = wide[line]
        row[:] = slots[line]
        for k in range(line + 1, line + 2 * LINES + 1):
            for b in range(STRIPS):
                row[b] |= slots[k, b]
        before = np.uint64(0)
        for b in range(STRIPS):
            own = row[b]
            row[b] = before | own | (row[b + 1] if b + 1 < STRIPS else np.uint64(0))
            before = own
    return wide


@kernel("uint8[:, ::1](uint8[:, ::1])")
def widen_levels(levels: U8) -> U8:
    """Put the level surfaces of a line together with those of the lines around.

    Parameters
    ----------
    levels : (lines + 4, 2 STRIPS) uint8

    Returns
    -------
    (lines, 2 STRIPS) uint8
    """
    n_lines, n = levels.shape[0] - 2 * LINES, levels.shape[1]
    wide = np.empty((n_lines, n), np.uint8)
    for line in range(n_lines):
        row = wide[line]
        row[:] = levels[line]
        for k in range(line + 1, line + 2 * LINES + 1):
            for b in range(n):
                row[b] |= levels[k, b]
    return wide


@helper
def _sum_around(values: F32, line: int, sums: F32) -> None:
    """Add up the values of five lines, and then of three strips."""
    sums[:] = values[line]
    for k in range(line + 1, line + 2 * LINES + 1):
        for b in range(STRIPS):
            sums[b] += values[k, b]
    before = np.float32(0.0)
    for b in range(STRIPS):
        own = sums[b]
        sums[b] = (before + own) + (sums[b + 1] if b + 1 < STRIPS else np.float32(0.0))
        before = own


@helper
def _top_around(values: F32, line: int, tops: F32) -> None:
    """Find the highest of five lines and three strips."""
    tops[:] = values[line]
    for k in range(line + 1, line + 2 * LINES + 1):
        for b in range(STRIPS):
            tops[b] = max(tops[b], values[k, b])
    before = NO_TOP
    for b in range(STRIPS):
        own = tops[b]
        tops[b] = max(max(before, own), tops[b + 1] if b + 1 < STRIPS else NO_TOP)
        before = own


@helper
def _look_out(is_wall: U8, wall_at: F32, tops: F32, figures: F32, found: tuple[F32, F32, F32]) -> None:
    """Tell every strip of a line of the wall before it, seen from the scanner, and of the wall behind it."""
    at, top, ahead = found
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
                at[b], top[b] = wall_at[last], tops[last]
        last = -1
        for k in range(half - 1, -1, -1):
            b = first + way * k
            if is_wall[b]:
                last = b
            if last >= 0 and abs(wall_at[last]) - np.float32(k) * STRIP_M <= figures[BEFORE_M] + STRIP_M:
                ahead[b] = wall_at[last]


@kernel("UniTuple(float32[:, ::1], 3)(UniTuple(float32[:, ::1], 4), float32[::1])")
def find_walls(sums: tuple[F32, F32, F32, F32], figures: F32) -> tuple[F32, F32, F32]:
    """Find the walls beside every line: strips where most of what stands is smooth and upright, and high enough.

    Parameters
    ----------
    sums : tuple of (lines + 4, STRIPS) float32
        Of :func:`fill_strips`.
    figures : (3,) float32
        A wall is WALL_M high in the mean of the lines and WALL_SHARE of all that its strips show. It is told to all
        strips behind it up to the next wall, and to those up to BEFORE_M before it.

    Returns
    -------
    at_m, top_m : (lines, STRIPS) float32, metres
        Side and top of the last wall that a strip holds or lies behind; 0 = none.
    ahead_m : (lines, STRIPS) float32, metres
        Side of the wall that a strip holds or lies before; 0 = none.
    """
    length, wall, place, top = sums
    n_lines = length.shape[0] - 2 * LINES
    at, tops = np.zeros((n_lines, STRIPS), np.float32), np.zeros((n_lines, STRIPS), np.float32)
    ahead = np.zeros((n_lines, STRIPS), np.float32)
    lengths, walls, places = (np.empty(STRIPS, np.float32), np.empty(STRIPS, np.float32), np.empty(STRIPS, np.float32))
    highest, wall_at, is_wall = np.empty(STRIPS, np.float32), np.empty(STRIPS, np.float32), np.empty(STRIPS, np.uint8)
    enough = figures[WALL_M] * np.float32(2 * LINES + 1)
    for line in range(n_lines):
        _sum_around(length, line, lengths)
        _sum_around(wall, line, walls)
        _sum_around(place, line, places)
        _top_around(top, line, highest)
        for b in range(STRIPS):
            is_wall[b] = (walls[b] >= enough) & (walls[b] >= figures[WALL_SHARE] * lengths[b]) & (walls[b] > 0)
            wall_at[b] = places[b] / walls[b] if is_wall[b] else np.float32(0.0)
        _look_out(is_wall, wall_at, highest, figures, (at[line], tops[line], ahead[line]))
    return at, tops, ahead
