"""Slow and obvious twin of :mod:`prc_cli.kernels.fused.ground`."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from prc_cli.core.thresholds.fused import WalkThresholds
from prc_cli.core.types import F32, I32, U8, Mask

QUARTER, HALF, BINS = np.float32(0.25), np.float32(0.5), 320


def walk_ground(
    range_m: F32,
    beams: tuple[F32, F32],
    counts: tuple[U8, U8, U8, U8],
    sides: tuple[I32, I32],
    memory_m: F32,
    age: I32,
    start_m: np.float32,
    keep: int,
    thresholds: WalkThresholds,
) -> tuple[F32, Mask, F32, I32]:
    """Find the ground; see :func:`prc_cli.kernels.fused.ground.walk_ground`."""
    side_m, height_m = range_m * beams[0], -(range_m * beams[1])
    above, walked = np.full(side_m.shape, np.nan, np.float32), np.zeros(side_m.shape, np.bool_)
    memories = [_Memory(memory_m[s].copy(), age[s].copy(), thresholds) for s in range(2)]
    kept = None
    for line in range(len(side_m)):
        if line == keep:
            kept = [(one.height.copy(), one.age.copy()) for one in memories]
        profiles = []
        for memory, columns, sign in zip(memories, sides, (1, -1), strict=True):
            on_way = [
                i for i in columns
                if counts[0][line, i] >= thresholds.least_near and counts[1][line, i] > 0
                and counts[3][line, i] > counts[2][line, i]
            ]  # fmt: skip
            steps = _steps(on_way, side_m[line] * np.float32(sign), height_m[line], memory, start_m, thresholds)
            walked[line, [i for i, _ in steps]] = True
            memory.learn(_means([(place, height_m[line, i]) for i, place in steps]))
            profiles.append(memory.profile(start_m))
        for i in np.flatnonzero(~np.isnan(side_m[line])):
            profile = profiles[0] if side_m[line, i] >= 0 else profiles[1]
            place = max(abs(side_m[line, i]) / QUARTER - HALF, np.float32(0))
            b = min(int(place), BINS - 2)
            share = min(place - np.float32(b), np.float32(1))
            above[line, i] = height_m[line, i] - (profile[b] + (profile[b + 1] - profile[b]) * share)
    if kept is None:
        kept = [(one.height, one.age) for one in memories]
    return above, walked, np.stack([height for height, _ in kept]), np.stack([one for _, one in kept])


class _Memory:
    """The ground of one side, as last seen."""

    def __init__(self, height: F32, age: I32, thresholds: WalkThresholds) -> None:
        self.height, self.age = height, age
        self.lines, self.follow = thresholds.memory_lines, thresholds.follow

    def known(self) -> Mask:
        fresh: Mask = self.age.astype(np.float32) < self.lines
        return fresh

    def learn(self, seen: dict[int, np.float32]) -> None:
        known = self.known()
        self.seen = sorted(seen)
        for b in self.seen:
            self.height[b] = self.height[b] + (seen[b] - self.height[b]) * self.follow if known[b] else seen[b]
        self.age += 1
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
    on_way: list[int], out_m: F32, height_m: F32, memory: _Memory, start_m: np.float32, thresholds: WalkThresholds
) -> list[tuple[int, int]]:
    """Return the columns that the walk goes over, and their places."""
    known = memory.known()
    at, z = np.float32(0), memory.height[np.argmax(known)] if known.any() else np.float32(start_m)
    steps = []
    for i in on_way:
        place = int(out_m[i] / QUARTER)
        if out_m[i] < 0 or place >= BINS or out_m[i] - at < -np.float32(0.05):
            continue
        out = max(out_m[i] - at, np.float32(0))
        limit = thresholds.step_m + thresholds.slope * min(out, thresholds.slope_reach_m) + thresholds.gap_slope * out
        remembered = known[place] and abs(height_m[i] - memory.height[place]) < thresholds.known_m
        if abs(height_m[i] - z) <= limit or remembered:
            steps.append((i, place))
            at, z = out_m[i], height_m[i]
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
        place, mean = visits[start][0], total / np.float32(end - start)
        means[place] = (means[place] + mean) * HALF if place in means else mean
        start = end
    return means
