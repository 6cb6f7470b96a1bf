"""Slow and obvious twin of :mod:`prc_cli.methods.fused.ground_loops`."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from prc_cli.core.types import F32, I32, Mask
from prc_cli.methods.fused.records import Beams, Neighbours, Sides
from prc_cli.methods.fused.thresholds import WalkThresholds

QUARTER = np.float32(0.25)
HALF = np.float32(0.5)
BINS = 320
MISSED_SHOTS = 16
MISSED_LINES = 8
MISSED_M = np.float32(0.6)
TENTH = np.float32(0.1)
LOST_LINES = 32
START_FOLLOW = np.float32(0.005)
MOST_AGE = np.iinfo(np.int32).max
Memory = tuple[F32, I32, F32, F32]


def walk_ground(
    range_m: F32,
    beams: Beams,
    neighbours: Neighbours,
    sides: Sides,
    memory: Memory,
    start_m: np.float32,
    lost: int,
    missed: int,
    keep: int,
    thresholds: WalkThresholds,
) -> tuple[F32, Mask, Memory, float, int, int]:
    """Find the ground; see :func:`prc_cli.methods.fused.ground_loops.walk_ground`."""
    side_m = range_m * beams[0]
    height_m = -(range_m * beams[1])
    above = np.full(side_m.shape, np.nan, np.float32)
    walked = np.zeros(side_m.shape, np.bool_)
    heights, ages, shots, sums = (memory_array.copy() for memory_array in memory)
    memories = [_Memory(heights[s], ages[s], thresholds) for s in range(2)]
    kept = None
    for line in range(len(side_m)):
        if line == keep:
            kept = _copied(heights, ages, shots, sums), start_m, lost, missed
        level = (neighbours[0][line] >= thresholds.least_near) & (neighbours[1][line] > 0)
        level &= neighbours[3][line] > neighbours[2][line]
        known = np.flatnonzero((ages.astype(np.float32) < thresholds.memory_lines).any(axis=0))
        if len(known):
            nearest_m = next(
                memory_side.height[known[0]]
                for memory_side in memories
                if memory_side.known()[known[0]]
            )
            start_m = nearest_m if lost < 0 else start_m + (nearest_m - start_m) * START_FOLLOW
            lost = 0
            shots[:] = sums[:] = 0
        elif _search(side_m[line][level], height_m[line][level], shots, sums, thresholds):
            lost += 1 if lost >= 0 else -1
            start_m = _lowest(shots, sums) if lost < 0 or lost >= LOST_LINES else start_m
        profiles = []
        for memory_of_side, columns, sign in zip(memories, sides, (1, -1), strict=True):
            on_way = [i for i in columns if level[i] and lost != -1]
            out_m = side_m[line] * np.float32(sign)
            steps = _steps(on_way, out_m, height_m[line], memory_of_side, start_m, thresholds)
            walked[line, [i for i, _ in steps]] = True
            memory_of_side.learn(_means([(place, height_m[line, i]) for i, place in steps]))
            profiles.append(memory_of_side.profile(start_m))
        for i in np.flatnonzero(~np.isnan(side_m[line])):
            profile = profiles[0] if side_m[line, i] >= 0 else profiles[1]
            place = max(abs(side_m[line, i]) / QUARTER - HALF, np.float32(0))
            b = min(int(place), BINS - 2)
            share = min(place - np.float32(b), np.float32(1))
            above[line, i] = height_m[line, i] - (
                profile[b] + (profile[b + 1] - profile[b]) * share
            )
        near = level & (np.abs(side_m[line]) < thresholds.start_reach_m) & (height_m[line] < 0)
        n_below = np.count_nonzero(above[line][near] < -MISSED_M)
        if n_below >= MISSED_SHOTS and n_below > np.count_nonzero(walked[line][near]):
            missed += 1
            _search(side_m[line][level], height_m[line][level], shots, sums, thresholds)
            if missed == MISSED_LINES:
                start_m = _lowest(shots, sums)
                missed = 0
                lost = 0
                ages[:] = MOST_AGE
                shots[:] = sums[:] = 0
        elif missed:
            missed = 0
            shots[:] = sums[:] = 0
    if kept is None:
        kept = _copied(heights, ages, shots, sums), start_m, lost, missed
    known_memory, known_start_m, known_lost, known_missed = kept
    return above, walked, known_memory, float(known_start_m), known_lost, known_missed


def _copied(
    heights: F32,
    ages: I32,
    shots: F32,
    sums: F32,
) -> Memory:
    return heights.copy(), ages.copy(), shots.copy(), sums.copy()


def _search(
    side_m: F32,
    height_m: F32,
    shots: F32,
    sums: F32,
    thresholds: WalkThresholds,
) -> bool:
    """Count level shots by depth: in the first row those near the scanner, in the second all."""
    is_found = False
    for y, z in zip(side_m, height_m, strict=True):
        depth = -z / TENTH
        if z < 0 and depth < shots.shape[1]:
            is_found = True
            for row in (0, 1) if abs(y) < thresholds.start_reach_m else (1,):
                shots[row, int(depth)] += np.float32(1)
                sums[row, int(depth)] += z
    return is_found


def _lowest(shots: F32, sums: F32) -> np.float32:
    """Return the mean height of the lowest depth with a quarter of the shots of the commonest
    one."""
    row = 0 if shots[0].any() else 1
    place = np.flatnonzero((shots[row] > 0) & (shots[row] >= shots[row].max() * QUARTER))[-1]
    mean: np.float32 = sums[row, place] / shots[row, place]
    return mean


class _Memory:
    """The ground of one side, as last seen."""

    def __init__(self, height: F32, age: I32, thresholds: WalkThresholds) -> None:
        self.height = height
        self.age = age
        self.lines = thresholds.memory_lines
        self.follow = thresholds.follow

    def known(self) -> Mask:
        fresh: Mask = self.age.astype(np.float32) < self.lines
        return fresh

    def learn(self, seen: dict[int, np.float32]) -> None:
        known = self.known()
        self.seen = sorted(seen)
        for b in self.seen:
            self.height[b] = (
                self.height[b] + (seen[b] - self.height[b]) * self.follow if known[b] else seen[b]
            )
        self.age += self.age < MOST_AGE
        self.age[self.seen] = 0

    def profile(self, start_m: np.float32) -> F32:
        known = self.known()
        known[self.seen] = True
        places = np.flatnonzero(known)
        profile = np.full(BINS, start_m, np.float32)
        if not len(places):
            return profile
        profile[: places[0]] = self.height[places[0]]
        profile[places[-1] :] = self.height[places[-1]]
        profile[places] = self.height[places]
        for a, b in pairwise(places):
            rise = (profile[b] - profile[a]) / np.float32(b - a)
            profile[a + 1 : b] = profile[a] + rise * np.arange(1, b - a, dtype=np.float32)
        return profile


def _steps(
    on_way: list[int],
    out_m: F32,
    height_m: F32,
    memory: _Memory,
    start_m: np.float32,
    thresholds: WalkThresholds,
) -> list[tuple[int, int]]:
    """Return the columns that the walk goes over, and their places."""
    known = memory.known()
    reached = np.float32(0)
    z = memory.height[np.argmax(known)] if known.any() else np.float32(start_m)
    steps = []
    for i in on_way:
        place = int(out_m[i] / QUARTER)
        if out_m[i] < 0 or place >= BINS or out_m[i] - reached < -np.float32(0.05):
            continue
        out = max(out_m[i] - reached, np.float32(0))
        limit = (
            thresholds.step_m
            + thresholds.slope * min(out, thresholds.slope_reach_m)
            + thresholds.gap_slope * out
        )
        remembered = known[place] and abs(height_m[i] - memory.height[place]) < thresholds.known_m
        if abs(height_m[i] - z) <= limit or remembered:
            steps.append((i, place))
            reached = out_m[i]
            z = height_m[i]
    return steps


def _means(visits: list[tuple[int, np.float32]]) -> dict[int, np.float32]:
    """Average the heights of every visit to a place, and then the visit before and this one."""
    means: dict[int, np.float32] = {}
    start = 0
    for end in range(1, len(visits) + 1):
        if end < len(visits) and visits[end][0] == visits[start][0]:
            continue
        total = np.float32(0)
        for _, z in visits[start:end]:
            total += z
        place = visits[start][0]
        mean = total / np.float32(end - start)
        means[place] = (means[place] + mean) * HALF if place in means else mean
        start = end
    return means
