"""Slow and obvious twins of :mod:`prc_cli.methods.fused.strips_loops`."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.records import Beams, Neighbours, StripSums
from prc_cli.methods.fused.thresholds import ColumnThresholds, StripThresholds, WallThresholds

N = 320
WIDTH = np.float32(0.5)
HALF_WIDTH = np.float32(0.25)
SLOT = np.float32(0.25)
NOTHING = np.float32(-1e9)
COLUMN, THIN, SHORT, FEW, SMALL, FENCE = range(1, 7)

Slots = NDArray[np.uint64]


def fill_strips(
    range_m: F32,
    above_m: F32,
    neighbours: Neighbours,
    kinds: U8,
    beams: Beams,
    step: np.float32,
    thresholds: StripThresholds,
) -> tuple[Slots, Slots, F32, F32, F32, F32, U8]:
    """Sort shots into strips; see :func:`prc_cli.methods.fused.strips_loops.fill_strips`."""
    ranges = range_m
    above = above_m
    side = ranges * beams[0]
    height = -(ranges * beams[1])
    near, smooth, upright, level = neighbours
    shape = (len(ranges), N)
    every = np.zeros(shape, np.uint64)
    rough = np.zeros(shape, np.uint64)
    length, wall, place = (np.zeros(shape, np.float32) for _ in range(3))
    top = np.full(shape, NOTHING)
    levels = np.zeros((len(ranges), 2 * N), np.uint8)
    for k, i in zip(
        *np.nonzero((above >= thresholds.foot_m) & (near >= thresholds.least_near)), strict=True
    ):
        y = side[k, i]
        strip = floor(side[k, i] / WIDTH) + N // 2
        if not 0 <= strip < N:
            continue
        bit = np.uint64(1 << min(int(above[k, i] / SLOT), 63))
        every[k, strip] |= bit
        reach = min(i, ranges.shape[1] - 1 - i, 2)
        beside = smooth[k, i - reach : i + reach + 1]
        if np.all(beside <= thresholds.rough):
            rough[k, strip] |= bit
        stands_for = ranges[k, i] * step / max(abs(y) / ranges[k, i], np.float32(0.3))
        length[k, strip] += stands_for
        if smooth[k, i] >= thresholds.smooth and upright[k, i] >= 2 and kinds[k, i] != COLUMN:
            wall[k, strip] += stands_for
            place[k, strip] += stands_for * y
            top[k, strip] = max(top[k, strip], height[k, i])
        is_level = smooth[k, i] >= thresholds.level_smooth and level[k, i] > upright[k, i]
        if is_level and above[k, i] < thresholds.level_top_m and height[k, i] < 0:
            adjacent = [side[k, j] for j in (i - 1, i + 1) if 0 <= j < side.shape[1]]
            beside = [distance for distance in adjacent if abs(distance - y) < thresholds.jump_m]
            low, high = (
                floor(end / HALF_WIDTH) + N for end in (min([y, *beside]), max([y, *beside]))
            )
            levels[k, max(low, 0) : max(min(high, 2 * N - 1) + 1, 0)] = 1
    return every, rough, length, wall, place, top, levels


def widen_slots(slots: Slots) -> Slots:
    """Widen slots; see :func:`prc_cli.methods.fused.strips_loops.widen_slots`."""
    padded = np.pad(slots, ((0, 0), (1, 1)))
    n_lines = len(slots) - 4
    wide = np.zeros((n_lines, N), np.uint64)
    for k in range(5):
        for b in range(3):
            wide |= padded[k : k + n_lines, b : b + N]
    return wide


def widen_levels(levels: U8) -> U8:
    """Widen level surfaces; see :func:`prc_cli.methods.fused.strips_loops.widen_levels`."""
    return np.stack([levels[k : k + 5].max(axis=0) for k in range(len(levels) - 4)])


def find_walls(sums: StripSums, flanks: U8, thresholds: WallThresholds) -> tuple[F32, F32, F32]:
    """Find walls; see :func:`prc_cli.methods.fused.strips_loops.find_walls`."""
    n_lines = len(sums[0]) - 4
    distance, top, ahead = (np.zeros((n_lines, N), np.float32) for _ in range(3))
    for line in range(n_lines):
        length, wall, place = (sum_around(values[line : line + 5]) for values in sums[:3])
        highest = np.pad(sums[3][line : line + 5].max(axis=0), 1, constant_values=NOTHING)
        is_wall = (
            (wall >= thresholds.height_m * np.float32(5))
            & (wall >= thresholds.share * length)
            & (wall > 0)
        )
        there = np.pad(sums[1][line : line + 5] > 0, ((0, 0), (1, 1)))
        seen_by = (there[:, :-2] | there[:, 1:-1] | there[:, 2:]).sum(axis=0)
        is_wall &= (flanks[line] == 0) & (seen_by >= thresholds.lines)
        for side in (np.arange(N // 2, N), np.arange(N // 2 - 1, -1, -1)):
            number = np.arange(N // 2)
            inwards = np.maximum.accumulate(np.where(is_wall[side], number, -1))
            outwards = np.minimum.accumulate(np.where(is_wall[side], number, N)[::-1])[::-1]
            for k in np.flatnonzero(inwards >= 0):
                w = side[inwards[k]]
                distance[line, side[k]] = place[w] / wall[w]
                top[line, side[k]] = highest[w : w + 3].max()
            for k in np.flatnonzero(outwards < N):
                w = side[outwards[k]]
                where = place[w] / wall[w]
                if abs(where) - np.float32(k) * WIDTH <= thresholds.before_m + WIDTH:
                    ahead[line, side[k]] = where
    return distance, top, ahead


def sum_around(values: F32) -> F32:
    """Add up five lines, and three strips."""
    lines = values[0].copy()
    for k in range(1, 5):
        lines = lines + values[k]
    padded = np.pad(lines, 1)
    total: F32 = (padded[:-2] + padded[1:-1]) + padded[2:]
    return total


@dataclass(frozen=True)
class _Lines:
    """Lines, and those before and after them."""

    window: F32
    above: F32
    near: U8
    smooth: U8
    beams: Beams
    limits: ColumnThresholds

    @property
    def margin(self) -> int:
        return (len(self.window) - len(self.above)) // 2

    def beyond(self, line: int, i: int, way: int) -> tuple[int, bool] | None:
        """Return how far away the first line is that sees past the thing of a shot, and whether
        far; None: none."""
        k = line + self.margin
        while 0 <= k + 2 * way < len(self.window):
            here, there, beyond = (self.window[k + n * way, i] for n in range(3))
            there = beyond if np.isnan(there) else there
            k += way
            if np.isnan(here) or np.abs(here - there) < self.limits.jump_m:
                continue
            if there <= here + self.limits.jump_m:
                return None
            return abs(k - line - self.margin), not there <= here + self.limits.far_m
        return None

    def seen(self, line: int, i: int, *, far: bool) -> range | None:
        """Return the lines of the window that see the thing of a shot, if those beside them see
        past it, or far."""
        before = self.beyond(line, i, -1)
        after = self.beyond(line, i, 1)
        if before is None or after is None or (far and not (before[1] and after[1])):
            return None
        lines = range(line + self.margin - before[0] + 1, line + self.margin + after[0])
        return (
            lines if len(lines) <= (self.limits.lines if far else self.limits.small_lines) else None
        )

    def is_held(self, line: int, i: int) -> bool:
        return bool(
            self.near[line, i] >= self.limits.least_near
            and self.above[line, i] > self.limits.foot_m
        )

    def free(self, line: int, run: list[int], *, far: bool) -> list[int]:
        return [i for i in run if self.is_held(line, i) and self.seen(line, i, far=far) is not None]

    def is_smooth(self, line: int, i: int) -> bool:
        return bool(self.smooth[line, i] >= self.limits.smooth)

    def n_seen(self, line: int, i: int) -> int:
        lines = self.seen(line, i, far=True)
        assert lines is not None
        return len(lines)

    def side(self, line: int, shots: list[int]) -> F32:
        return np.abs(self.window[line + self.margin, shots] * self.beams[0][shots])

    def runs(self, line: int) -> list[list[int]]:
        """Return the shots of every run of a line."""
        runs: list[list[int]] = []
        ranges = self.window[line + self.margin]
        for i in range(self.above.shape[1]):
            if not self.is_held(line, i):
                continue
            goes_on = (
                runs
                and runs[-1][-1] == i - 1
                and np.abs(ranges[i] - ranges[i - 1]) < self.limits.jump_m
            )
            if goes_on:
                runs[-1].append(i)
            else:
                runs.append([i])
        return runs

    def radius(self, line: int, i: int) -> np.float32:
        lines = self.seen(line, i, far=True)
        away = self.window[line + self.margin, i]
        assert lines is not None
        n = len(lines)
        q = max(len(lines) // 4, 1)
        if n < 3:
            return np.float32(0)
        there = self.window[lines.start : lines.stop, i]
        left, right, middle = (
            _added(part) for part in (there[:q], there[n - q :], there[q : n - q])
        )
        left = left / np.float32(q)
        right = right / np.float32(q)
        middle = middle / np.float32(n - 2 * q)
        if not min(left, right) > middle:
            return np.float32(0)
        bulge = np.float32(0.5) * (left + right) - middle
        return np.float32(bulge * (abs(away * self.beams[0][i]) / away) / np.float32(0.34))

    def kind(
        self,
        line: int,
        run: list[int],
        free: list[int],
        narrow: list[int],
    ) -> int:
        reach = self.reach(line, run, free, narrow)
        limits = self.limits
        if reach is None:
            return COLUMN if free and self.is_column(line, run, free) else 0
        is_post = sum(self.is_smooth(line, i) for i in narrow) >= limits.share * np.float32(
            len(narrow)
        )
        is_post &= bool(np.ptp(self.above[line, narrow]) > limits.post_tall_m)
        is_thin = self.is_far(free, narrow) and np.ptp(self.side(line, narrow)) < limits.post_m
        return COLUMN if is_thin and (is_post or reach < limits.post_top_m) else SMALL

    def is_far(self, free: list[int], narrow: list[int]) -> bool:
        return bool(len({*free} & {*narrow}) >= self.limits.small_share * np.float32(len(narrow)))

    def reach(
        self,
        line: int,
        run: list[int],
        free: list[int],
        narrow: list[int],
    ) -> np.float32 | None:
        """Return how high something small reaches; None = it is not small."""
        limits = self.limits
        above = self.above[line, narrow]
        if (
            len(narrow) < max(limits.shots, limits.small_share * np.float32(len(run)))
            or above.max() >= limits.high_m
        ):
            return None
        if np.ptp(self.side(line, narrow)) > limits.small_m:
            return None
        climbed = np.float32(above.max() + self.climb(line, narrow[int(np.argmax(above))]))
        is_cut = above.min() > np.float32(1) and np.ptp(above) <= limits.post_tall_m
        is_person = climbed > limits.person_m and not is_cut
        return (
            climbed
            if climbed < limits.high_m and (is_person or self.is_far(free, narrow))
            else None
        )

    def is_fence(self, line: int, i: int) -> bool:
        row = line + self.margin
        away = np.abs(np.arange(len(self.window)) - row)
        alike = np.abs(self.window[:, i] - self.window[row, i]) < np.float32(0.2)
        return bool(
            alike[(away >= 9) & (away <= 30)].sum() >= 6
            and self.above[line, i] < self.limits.high_m
        )

    def climb(self, line: int, i: int) -> np.float32:
        """Return how much higher lines around see the thing of a shot."""
        (sine, cosine) = self.beams
        row = line + self.margin
        best = np.float32(0)
        up = 1 if cosine[max(i - 1, 0)] > cosine[min(i + 1, len(sine) - 1)] else -1
        side = self.window * sine
        height = -(self.window * cosine)
        for way in (-1, 1):
            k = row + way
            j = i
            top = height[row, i]
            goes_on = True
            while (
                goes_on and 0 <= k < len(self.window) and top - height[row, i] < self.limits.high_m
            ):
                q = j
                goes_on = False
                while 0 <= q < len(sine) and self.window[row, i] * (
                    cosine[j] - cosine[q]
                ) < np.float32(0.3):
                    if np.abs(side[k, q] - side[row, i]) < np.float32(0.4):
                        top = max(top, height[k, q])
                        j = q
                        goes_on = True
                    q += up
                k += way
            best = max(best, top - height[row, i])
        return np.float32(best)

    def is_column(self, line: int, run: list[int], free: list[int]) -> bool:
        limits = self.limits
        smooth = [i for i in free if self.is_smooth(line, i)]
        if len(smooth) < max(
            limits.shots, limits.share * np.float32(sum(self.smooth[line, run] >= limits.smooth))
        ):
            return False
        above = self.above[line, free]
        if np.ptp(self.side(line, free)) > limits.deep_m or above.min() > limits.low_m:
            return False
        if np.ptp(above) < limits.tall_m or above.max() < limits.high_m:
            return False
        if 2 * sum(self.n_seen(line, i) <= limits.thin_lines for i in smooth) > len(smooth):
            return True
        radii = np.array(
            [self.radius(line, i) for i in smooth[:: max(len(smooth) // 8, 1)]], np.float32
        )
        return bool(2 * ((radii >= limits.round_m) & (radii <= limits.deep_m)).sum() > len(radii))

    def is_short(self, line: int, run: list[int]) -> bool:
        ranges = np.pad(self.window[line + self.margin], 1, constant_values=np.nan)
        far = self.limits.far_m
        first = run[0] + 1
        end = run[-1] + 2
        if ranges[first - 1] <= ranges[first] + far or ranges[end] <= ranges[end - 1] + far:
            return False
        return bool(np.ptp(self.above[line, run]) < self.limits.tall_m)

    def piece(self, line: int, run: list[int], i: int) -> int:
        n_seen = self.n_seen(line, i)
        limits = self.limits
        is_thin = n_seen <= min(limits.slim_lines, limits.piece_lines)
        if not is_thin and not (n_seen <= limits.piece_lines and self.is_short(line, run)):
            return 0
        return FEW if len(run) < limits.shots else THIN if is_thin else SHORT


def _added(values: F32) -> np.float32:
    """Add up one after the other, as the loop does."""
    total = np.float32(0)
    for value in values:
        total = np.float32(total + value)
    return total


def find_columns(
    window_m: F32,
    above_m: F32,
    neighbours: Neighbours,
    beams: Beams,
    thresholds: ColumnThresholds,
) -> U8:
    """Find trunks and posts; see :func:`prc_cli.methods.fused.strips_loops.find_columns`."""
    lines = _Lines(window_m, above_m, neighbours[0], neighbours[1], beams, thresholds)
    columns = np.zeros(above_m.shape, np.uint8)
    for line in range(len(above_m)):
        for run in lines.runs(line):
            free = lines.free(line, run, far=True)
            narrow = lines.free(line, run, far=False)
            kind = lines.kind(line, run, free, narrow) if free or narrow else 0
            for i in run if kind == SMALL else free:
                is_odd = kind == COLUMN and not lines.is_smooth(line, i)
                column_kind = kind or lines.piece(line, run, i)
                columns[line, i] = (FENCE if kind and lines.is_fence(line, i) else column_kind) * (
                    not is_odd
                )
    return columns
