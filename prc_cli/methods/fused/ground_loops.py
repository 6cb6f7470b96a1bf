"""Follow the ground of every line outwards, on both sides of the scanner."""

from __future__ import annotations

import numpy as np

from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import F32, F32_2, I32, U8, Mask, Mask_2
from prc_cli.methods.fused.records import (
    Beams,
    GroundMemory,
    Neighbours,
    Points,
    Sides,
    WalkMemory,
    WalkStart,
)
from prc_cli.methods.fused.thresholds import WalkThresholds

BINS = 320
BIN_M = np.float32(0.25)
"""Number of places on either side at which the ground is remembered, and their width [m]."""
BACK_M = np.float32(0.05)
"""The walk may go back this far on its way out, because of range noise [m]."""
MOST_AGE = np.iinfo(np.int32).max
"""Ages stop here [lines]."""
DEPTHS = 1000
DEPTH_M = np.float32(0.1)
"""Number of depths at which the ground is searched, and their distance [m]."""
LOST_LINES = 32
"""If no ground was known for so many lines with level shots, it is searched again."""
MISSED_SHOTS = 16
MISSED_LINES = 8
MISSED_M = np.float32(0.6)
"""The ground is searched again if, in so many lines in a row, so many level shots near the scanner
lie this far below the known ground, and more of them than on it."""
START_FOLLOW = np.float32(0.005)
"""Share of a new height in the start: that of a single line may be a car's."""
MANY = np.float32(0.25)
"""The ground is the lowest depth with this share of the level shots of the commonest depth."""


@helper
def _nearest(heights: F32, ages: I32, lines: np.float32) -> tuple[bool, np.float32]:
    """Return whether any place is remembered, and the height of the nearest one of both sides."""
    for b in range(BINS):
        for s in range(2):
            if np.float32(ages[s, b]) < lines:
                return True, heights[s, b]
    return False, np.float32(0.0)


@helper
def _count_depths(
    points: Points,
    is_level: U8,
    reach_m: np.float32,
    counts: F32,
    sums: F32,
) -> bool:
    """Count the level shots of a line at every depth below the scanner.

    Row 0 of ``counts`` and ``sums`` is of shots near the scanner, row 1 of all. Return whether the
    line has such a shot.
    """
    side, height = points
    is_any = False
    for i in range(len(side)):
        if (is_level[i] != 0) & (height[i] < np.float32(0.0)):
            depth = -height[i] / DEPTH_M
            if depth < np.float32(DEPTHS):
                d = int(depth)
                counts[1, d] += np.float32(1.0)
                sums[1, d] += height[i]
                is_any = True
                if abs(side[i]) < reach_m:
                    counts[0, d] += np.float32(1.0)
                    sums[0, d] += height[i]
    return is_any


@helper
def _misses_ground(
    points: Points,
    is_level: U8,
    above: F32,
    walked: Mask,
    reach_m: np.float32,
) -> bool:
    """Whether more level shots near the scanner lie below the known ground than on it."""
    side, height = points
    n_below = 0
    n_walked = 0
    for i in range(len(side)):
        if (is_level[i] != 0) & (abs(side[i]) < reach_m) & (height[i] < np.float32(0.0)):
            n_below += int(above[i] < -MISSED_M)
            n_walked += int(walked[i])
    return (n_below >= MISSED_SHOTS) & (n_below > n_walked)


@helper
def _clear(counts: F32, sums: F32) -> None:
    """Forget the counted level shots."""
    for s in range(2):
        for d in range(DEPTHS):
            counts[s, d] = sums[s, d] = np.float32(0.0)


@helper
def _lowest(counts: F32, sums: F32) -> np.float32:
    """Return the mean height of the lowest depth with many level shots; at least one was counted.

    Shots near the scanner decide, if there are any.
    """
    row = 1
    most = np.float32(0.0)
    for d in range(DEPTHS):
        most = max(most, counts[0, d])
    if most > np.float32(0.0):
        row = 0
    else:
        for d in range(DEPTHS):
            most = max(most, counts[1, d])
    lowest_m = np.float32(0.0)
    for d in range(DEPTHS):
        if (counts[row, d] > np.float32(0.0)) & (counts[row, d] >= MANY * most):
            lowest_m = sums[row, d] / counts[row, d]
    return lowest_m


@inlined
def _seen_height(before: np.float32, is_seen: np.uint8, mean: np.float32) -> np.float32:
    """Return the height of a place that the walk leaves, the mean of two visits if it came back.

    Takes no arrays: passing them for every place costs more than the rest of the walk.
    """
    return (before + mean) * np.float32(0.5) if is_seen else mean


@helper
def _mark_level(
    near: U8,
    smooth: U8,
    upright: U8,
    level: U8,
    least: np.float32,
    is_level: U8,
) -> None:
    """Mark the shots of a line on a level surface, which alone a walk may use."""
    for i in range(len(near)):
        is_level[i] = np.uint8(
            (np.float32(near[i]) >= least) & (smooth[i] > 0) & (level[i] > upright[i])
        )


@helper
def _walk(
    columns: I32,
    sign: np.float32,
    points: Points,
    is_level: U8,
    level_shots: I32,
    memory: F32,
    age: I32,
    start_m: np.float32,
    thresholds: WalkThresholds,
    profile: F32,
    seen: U8,
    walked: Mask,
) -> None:
    """Follow the ground outwards on one side of a line, in small steps of height."""
    lines = thresholds.memory_lines
    # starts at the height of the nearest remembered place
    last_y = np.float32(0.0)
    last_z = start_m
    for b in range(BINS):
        if np.float32(age[b]) < lines:
            last_z = memory[b]
            break
    near_m = thresholds.known_m
    step = thresholds.step_m
    slope = thresholds.slope
    reach = thresholds.slope_reach_m
    gap = thresholds.gap_slope
    place = -1
    total = np.float32(0.0)
    n = np.float32(0.0)
    n_level = 0
    for k in range(len(columns)):
        level_shots[n_level] = columns[k]
        n_level += is_level[columns[k]]
    for k in range(n_level):
        i = level_shots[k]
        y = points.side_m[i] * sign
        z = points.height_m[i]
        out = y - last_y
        if out < -BACK_M or y < np.float32(0.0) or y >= BINS * BIN_M:
            continue
        b = int(y / BIN_M)
        out = max(out, np.float32(0.0))
        limit = step + slope * min(out, reach) + gap * out
        if abs(z - last_z) <= limit or (np.float32(age[b]) < lines and abs(z - memory[b]) < near_m):
            walked[i] = True
            if b != place:
                if place >= 0:
                    profile[place] = _seen_height(profile[place], seen[place], total / n)
                    seen[place] = 1
                place = b
                total = np.float32(0.0)
                n = np.float32(0.0)
            total += z
            n += np.float32(1.0)
            last_y = y
            last_z = z
    if place >= 0:
        profile[place] = _seen_height(profile[place], seen[place], total / n)
        seen[place] = 1


@helper
def _remember(
    profile: F32,
    seen: U8,
    memory: F32,
    age: I32,
    thresholds: WalkThresholds,
) -> None:
    """Update the memory by the heights of a line.

    Fill the profile from the memory where the line saw no ground.
    """
    lines = thresholds.memory_lines
    follow = thresholds.follow
    for b in range(BINS):
        # without branches, for vector instructions
        is_seen = seen[b] != 0
        mean = profile[b]
        known_m = memory[b]
        followed = known_m + (mean - known_m) * follow if np.float32(age[b]) < lines else mean
        older = age[b] + np.int32(age[b] < MOST_AGE)
        is_known = np.float32(older) < lines
        profile[b] = followed if is_seen else (known_m if is_known else mean)
        memory[b] = followed if is_seen else known_m
        age[b] = np.int32(0) if is_seen else np.int32(older)
        seen[b] = np.uint8(is_seen | is_known)


@helper
def _fill(profile: F32, seen: U8, start_m: np.float32) -> None:
    """Interpolate between the places where the ground is known; level beyond the outermost."""
    last = -1
    for b in range(BINS):
        if not seen[b]:
            continue
        if b - last > 1:
            low = profile[b] if last < 0 else profile[last]
            rise = (profile[b] - low) / np.float32(b - last)
            for q in range(last + 1, b):
                profile[q] = low + rise * np.float32(q - last)
        last = b
    beyond = profile[last] if last >= 0 else start_m
    for q in range(last + 1, BINS):
        profile[q] = beyond


@helper
def _measure_heights(
    points: Points,
    profiles: F32,
    places: I32,
    shares: F32,
    grounds: F32,
    above: F32,
) -> None:
    """Write the heights of the shots of a line above the ground.

    Step by step, because only a loop that reads memory in order uses vector instructions.
    """
    side, height = points
    # the place before every shot in both profiles, and the share of the next one
    half = np.float32(0.5)
    for i in range(len(side)):
        y = side[i] if side[i] == side[i] else np.float32(0.0)
        # limited before it becomes an integer: ranges may be any number
        place = min(max(abs(y) / BIN_M - half, np.float32(0.0)), np.float32(BINS - 1))
        b = min(np.int32(place), np.int32(BINS - 2))
        shares[i] = min(place - np.float32(b), np.float32(1.0))
        places[i] = b if y >= np.float32(0.0) else b + np.int32(BINS)
    for i in range(len(places)):
        place_before = np.uint64(places[i])
        inner = profiles[place_before]
        outer = profiles[place_before + np.uint64(1)]
        grounds[i] = inner + (outer - inner) * shares[i]
    for i in range(len(side)):
        above[i] = height[i] - grounds[i] if side[i] == side[i] else np.float32(np.nan)


@helper
def _copy(memory: WalkMemory, to: WalkMemory) -> None:
    """Copy element by element, because array copies take seconds to compile."""
    heights, ages, counts, sums = memory
    to_heights, to_ages, to_counts, to_sums = to
    for s in range(2):
        for b in range(BINS):
            to_heights[s, b] = heights[s, b]
            to_ages[s, b] = ages[s, b]
        for d in range(DEPTHS):
            to_counts[s, d] = counts[s, d]
            to_sums[s, d] = sums[s, d]


@helper
def _empty_memory() -> WalkMemory:
    return WalkMemory(
        np.empty((2, BINS), np.float32),
        np.empty((2, BINS), np.int32),
        np.empty((2, DEPTHS), np.float32),
        np.empty((2, DEPTHS), np.float32),
    )


@helper
def _start_of_line(
    memory: WalkMemory,
    start_m: np.float32,
    lost: int,
    points: Points,
    is_level: U8,
    thresholds: WalkThresholds,
) -> tuple[np.float32, int]:
    """Return the height at which a walk starts, and for how many lines the ground has been lost.

    The start is used on a side where no place is remembered. It follows the nearest remembered
    place. If the ground is lost for long, or was never known, it is the lowest depth with many
    level shots in the lines since then. The number of lines is negative if the ground was never
    known.
    """
    heights, ages, counts, sums = memory
    is_known, nearest_m = _nearest(heights, ages, thresholds.memory_lines)
    if is_known:
        start_m = start_m + (nearest_m - start_m) * START_FOLLOW if lost >= 0 else nearest_m
        # counts of earlier lines go when the ground is known again
        if lost != 0:
            _clear(counts, sums)
        return start_m, 0
    if _count_depths(points, is_level, thresholds.start_reach_m, counts, sums):
        lost = lost - 1 if lost < 0 else lost + 1
        if lost < 0 or lost >= LOST_LINES:
            start_m = _lowest(counts, sums)
    return start_m, lost


@loop()
def walk_ground(
    range_m: F32_2,
    beams: Beams,
    neighbours: Neighbours,
    sides: Sides,
    memory: GroundMemory,
    keep: int,
    thresholds: WalkThresholds,
) -> tuple[F32_2, Mask_2, GroundMemory]:
    """Find the ground of consecutive lines, and the height of every shot above it.

    A stream may begin with a part of the scene: a tile shows distant ledges or the roof of a car
    first, and the walk stays on them. So lines are counted in which the walk misses level shots
    near the scanner that lie below it (``missed``). After some in a row the memory is cleared, and
    the walk starts at these shots. The memory that is returned is that before line ``keep``.

    ``range_m`` (lines, M) float32, metres; ``beams`` (M,) float32; ``counts`` tuple of
    (lines, M) uint8; ``sides`` (n,) int32; returns ``above_m`` (lines, M) float32, metres,
    ``walked`` (lines, M) bool, and the memory.
    """
    n_lines, m = range_m.shape
    above = np.empty((n_lines, m), np.float32)
    walked = np.empty((n_lines, m), np.bool_)
    now = _empty_memory()
    kept = _empty_memory()
    _copy(memory.bins, now)
    kept_start = memory.start
    start_m = np.float32(memory.start.start_m)
    lost = memory.start.lost
    missed = memory.start.missed
    heights, ages, shots, sums = now
    profiles = np.empty(2 * BINS, np.float32)
    seen = np.empty(BINS, np.uint8)
    level_shots = np.empty(m + 1, np.int32)
    places = np.empty(m, np.int32)
    shares = np.empty(m, np.float32)
    grounds = np.empty(m, np.float32)
    side = np.empty(m, np.float32)
    height = np.empty(m, np.float32)
    points = Points(side, height)
    is_level = np.empty(m, np.uint8)
    near, smooth, upright, level = neighbours
    for line in range(n_lines):
        if line == keep:
            _copy(now, kept)
            kept_start = WalkStart(np.float64(start_m), lost, missed)
        ranges = range_m[line]
        for i in range(m):
            side[i] = ranges[i] * beams.sine[i]
        for i in range(m):
            height[i] = -(ranges[i] * beams.cosine[i])
        _mark_level(
            near[line], smooth[line], upright[line], level[line], thresholds.least_near, is_level
        )
        start_m, lost = _start_of_line(now, start_m, lost, points, is_level, thresholds)
        walked_of_line = walked[line]
        for i in range(m):
            walked_of_line[i] = False
        for s in range(2):
            columns = sides.left if s == 0 else sides.right
            # a stream may begin amid a line, in which no ground is seen
            columns = columns[: len(columns) if lost != -1 else 0]
            sign = np.float32(1.0) if s == 0 else np.float32(-1.0)
            profile = profiles[s * BINS : (s + 1) * BINS]
            for b in range(BINS):
                seen[b] = 0
                profile[b] = np.float32(0.0)
            _walk(
                columns,
                sign,
                points,
                is_level,
                level_shots,
                heights[s],
                ages[s],
                start_m,
                thresholds,
                profile,
                seen,
                walked_of_line,
            )
            _remember(profile, seen, heights[s], ages[s], thresholds)
            _fill(profile, seen, start_m)
        _measure_heights(points, profiles, places, shares, grounds, above[line])
        if _misses_ground(points, is_level, above[line], walked_of_line, thresholds.start_reach_m):
            missed += 1
            _count_depths(points, is_level, thresholds.start_reach_m, shots, sums)
            if missed >= MISSED_LINES:
                start_m = _lowest(shots, sums)
                for s in range(2):
                    for b in range(BINS):
                        ages[s, b] = MOST_AGE
                _clear(shots, sums)
                missed = 0
                lost = 0
        elif missed > 0:
            missed = 0
            _clear(shots, sums)
    if keep >= n_lines:
        _copy(now, kept)
        kept_start = WalkStart(np.float64(start_m), lost, missed)
    return above, walked, GroundMemory(kept, kept_start)
