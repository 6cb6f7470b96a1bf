"""Slow and simple twins of :mod:`prc_cli.methods.fused.classes_loops`.

The conditions of the decision, one by one.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import floor

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import Reason
from prc_cli.core.types import F32, I64, U8, Mask
from prc_cli.methods.fused.records import Beams, FilledSlots, Neighbours, Walls
from prc_cli.methods.fused.thresholds import DecisionThresholds

MISSING, _, NOISE, GROUND = range(4)
Slots = NDArray[np.uint64]

MARGIN = 20
BESIDE = 12
COLUMN, THIN, _, FEW, SMALL, FENCE = range(1, 7)
WIDTH = np.float32(0.5)
SLOT = np.float32(0.25)
N = 320


@dataclass(frozen=True)
class _Shot:
    """A shot and what is known around it."""

    window: F32
    points: tuple[F32, F32, F32]
    counts: Neighbours
    is_walked: bool
    texture: np.float32
    slots: FilledSlots
    walls: Walls
    levels: U8
    alone: U8
    step: np.float32
    thresholds: DecisionThresholds
    line: int
    i: int

    @property
    def near(self) -> int:
        return int(self.counts[0][self.line + 2, self.i])

    @property
    def smooth(self) -> int:
        return int(self.counts[1][self.line + 2, self.i])

    @property
    def upright(self) -> int:
        return int(self.counts[2][self.line + 2, self.i])

    @property
    def level(self) -> int:
        return int(self.counts[3][self.line + 2, self.i])

    @property
    def range_m(self) -> np.float32:
        return np.float32(self.window[self.line + MARGIN, self.i])

    @property
    def side(self) -> np.float32:
        return np.float32(self.points[0][self.line + 2, self.i])

    @property
    def height(self) -> np.float32:
        return np.float32(self.points[1][self.line + 2, self.i])

    @property
    def above(self) -> np.float32:
        return np.float32(self.points[2][self.line + 2, self.i])

    @property
    def strip(self) -> int | None:
        b = floor(self.side / WIDTH) + N // 2
        return b if 0 <= b < N else None

    @property
    def slot(self) -> int:
        return min(max(int(self.above / SLOT), 0), 63)

    def filled(self, which: int) -> list[bool]:
        """Return which slots of the strip have something, from low to high."""
        word = int(self.slots[which][self.line, self.strip])
        return [bool(word >> k & 1) for k in range(64)]

    def is_in_wall(self) -> bool:
        if self.strip is None:
            return False
        distance = self.walls[0][self.line, self.strip]
        top = self.walls[1][self.line, self.strip]
        behind = abs(self.side) - abs(distance)
        if distance == 0 or not -self.thresholds.front_m <= behind <= self.thresholds.behind_m:
            return False
        through = self.height * (abs(distance) / abs(self.side)) if behind > 0 else self.height
        return bool(through <= top + self.thresholds.over_m)

    def is_leaf(self) -> bool:
        if self.near == 0 and self.range_m <= self.thresholds.lone_m:
            return False
        if self.strip is None or self.above <= self.thresholds.foot_m or self.is_in_wall():
            return False
        around = self.filled(1)[max(self.slot - 4, 0) : self.slot + 5]
        return bool(sum(around) >= self.thresholds.leaf_slots)

    def is_held(self) -> bool:
        on_ground = abs(self.above) < self.thresholds.soil_m
        return bool(self.smooth > 0 or on_ground or self.is_in_wall())

    def is_ghost(self, *, rough: bool) -> bool:
        if self.strip is None or not self.near < self.thresholds.ghost_near:
            return False
        away = abs(self.walls[0][self.line, self.strip])
        top = self.walls[1][self.line, self.strip]
        beyond = abs(self.side) - away
        far = (rough and beyond > self.thresholds.ghost_m) or (
            self.smooth == 0 and beyond > self.thresholds.behind_m
        )
        return bool(far and away != 0 and self.height * away <= top * abs(self.side))

    def is_lost_in_car(self) -> bool:
        return bool(self.smooth == 0 and self.near < self.thresholds.least_near)

    def _is_about_wall(self, most_m: np.float32) -> bool:
        """Return whether a shot is a little before a house, or not farther than this behind it, at
        any height."""
        if self.strip is None:
            return False
        distance = self.walls[0][self.line, self.strip]
        if (
            self.walls[1][self.line, self.strip] - self.height + self.above
            < self.thresholds.storey_m
        ):
            return False
        return bool(
            distance != 0 and -self.thresholds.front_m <= abs(self.side) - abs(distance) <= most_m
        )

    def is_facade(self) -> bool:
        limits = self.thresholds
        if not (self._is_about_wall(limits.roof_m) and self._is_about_wall(limits.behind_m)):
            return False
        return bool(self.walls[1][self.line, self.strip] > 0)

    def is_spike(self) -> bool:
        if self.smooth > 0:
            return False
        columns = min(max(int(np.float32(0.1) / (self.range_m * self.step)), 2), 6)
        lines = slice(self.line + 1, self.line + 4)
        place = lines, slice(max(self.i - columns, 0), self.i + columns + 1)
        counts = self.counts[0][place] >= self.thresholds.least_near
        pairs = int(np.minimum(self.counts[1][place], 8)[counts].sum())
        return bool(
            np.float32(pairs) > self.thresholds.spike_share * np.float32(8 * int(counts.sum()))
        )

    def is_reflection(self) -> bool:
        is_pit = self.upright > 0 and self.near >= self.thresholds.pit_near
        return bool(self.above < -self.thresholds.below_m) and self.smooth < 3 and not is_pit

    def ground(self) -> Reason | None:
        off = abs(self.above)
        if self.is_walked and off < self.thresholds.walked_m:
            return Reason.WALKED
        if off < self.thresholds.level_m and self.level > self.upright:
            return Reason.LEVEL_LOW
        return (
            Reason.LOW if off < self.thresholds.soil_m and self.upright <= self.level + 1 else None
        )

    def leaf_share(self) -> np.float32:
        ahead = np.float32(0) if self.strip is None else self.walls[2][self.line, self.strip]
        before = abs(ahead) - abs(self.side)
        near_wall = ahead != 0 and -WIDTH <= before <= self.thresholds.before_m
        limits = self.thresholds
        near_wall = near_wall or self._is_about_wall(limits.roof_m)
        return np.float32(limits.leaf_share_before_wall if near_wall else limits.leaf_share)

    def is_low_with_level(self, *, rough: bool) -> bool:
        if self.strip is None or not self.above >= 0:
            return False
        b = floor(self.side / np.float32(0.25)) + N
        limits = self.thresholds
        around = self.levels[self.line, max(b - 6, 0) : b + 7]
        is_lorry = int((around // 16).sum()) >= min(limits.car_bins, limits.car_bins_rough)
        top = int((limits.lorry_top_m if is_lorry else limits.car_top_m) / SLOT)
        filled = self.filled(0)
        closed = [
            filled[k] or (k > 0 and filled[k - 1]) or (k > 1 and filled[k - 2]) for k in range(64)
        ]
        if all(closed[self.slot : top]):
            return False
        return bool(
            int((around % 16).sum()) >= (limits.car_bins_rough if rough else limits.car_bins)
        )

    @property
    def kind(self) -> int:
        """What it is of, if that stands alone and is near enough."""
        return int(self.alone[self.line, self.i]) if self.strip is not None else 0

    def is_standing(self, *, is_car: bool) -> bool:
        if self.kind in (0, SMALL, FENCE) or not self.thresholds.pole_m > 0:
            return False
        if self.kind == COLUMN:
            return True
        if self.level > 0 and not self.above > self.thresholds.arm_m:
            return False
        if self.is_in_wall() or (is_car and self.kind != THIN):
            return False
        return bool(
            self.above > self.thresholds.foot_m and self.texture >= self.thresholds.leaf_share
        )

    def is_thick(self) -> bool:
        limits = self.thresholds
        column = self.window[:, self.i]
        middle = self.line + MARGIN
        seen = [column[middle]]
        for way in (-1, 1):
            for k in range(1, BESIDE + 1):
                there = column[middle + way * k]
                before = column[middle + way * (k - 1)]
                if not np.abs(there - before) < limits.jump_m:
                    break
                seen.append(there)
        across = np.float32(max(seen) - min(seen)) * (abs(self.side) / self.range_m)
        return bool(across >= limits.thick_m)

    def is_round(self) -> bool:
        """Return whether the run that stands alone around a shot is as deep as the front half of a
        trunk."""
        limits = self.thresholds
        ranges = self.window[self.line + MARGIN]
        run = [self.i]
        for way in (-1, 1):
            j = self.i + way
            while 0 <= j < len(ranges) and self.alone[self.line, j] in (1, 2, 3, FEW):
                if not np.abs(ranges[j] - ranges[j - way]) < limits.jump_m:
                    break
                run.append(j)
                j += way
        deep, tall = (np.ptp(points[self.line + 2, run]) for points in self.points[:2])
        return bool(
            limits.thick_m <= deep < np.float32(0.5) * tall and tall < np.float32(2) * limits.pole_m
        )

    def has_crown(self) -> bool:
        return bool(sum(self.filled(1)[self.slot :]) >= self.thresholds.crown_slots)

    def rule(self) -> Reason:
        return self._noise() or self.ground() or self._thing()

    def _noise(self) -> Reason | None:
        if self.near < self.thresholds.least_near:
            if self.near == 0 and self.range_m <= self.thresholds.lone_m:
                return Reason.LONELY
            if not (self.is_leaf() or (self.near > 0 and self.is_held())):
                return Reason.ISOLATED
        if self.is_spike():
            return Reason.SPIKE
        return Reason.BELOW_GROUND if self.is_reflection() else None

    def _thing(self) -> Reason:
        soft = bool(self.texture < self.leaf_share())
        rough = soft and not self.is_in_wall() and not self.is_facade()
        is_car = self.is_low_with_level(rough=rough)
        if self.is_ghost(rough=rough):
            return Reason.BEHIND_WALL
        if is_car and self.is_lost_in_car():
            return Reason.IN_CAR
        if self.is_standing(is_car=is_car) and (upright := self._upright()):
            return upright
        if self.kind >= SMALL and (is_car or self.texture >= self.thresholds.leaf_share):
            return Reason.SMALL if self.kind == SMALL else Reason.SMOOTH
        if is_car:
            return Reason.LEVEL_BODY
        if rough:
            return Reason.FOLIAGE
        if self.near < self.thresholds.least_near and self.is_leaf():
            return Reason.LEAF
        return Reason.FACADE if soft else Reason.SMOOTH

    def _upright(self) -> Reason | None:
        if self.has_crown():
            return Reason.CROWN
        if self.kind == FEW:
            return None
        if self.is_round() or self.is_thick():
            return Reason.TRUNK
        return Reason.POST if self.level == 0 or self.kind == COLUMN else Reason.ARM


def fused_labels(
    window_m: F32,
    above_m: F32,
    neighbours: Neighbours,
    walked: Mask,
    texture: F32,
    slots: FilledSlots,
    walls: Walls,
    levels: U8,
    kinds: U8,
    beams: Beams,
    step_rad: np.float32,
    thresholds: DecisionThresholds,
) -> U8:
    """Find the rules of shots; see :func:`prc_cli.methods.fused.classes_loops.fused_labels`."""
    points = (*_points(window_m[MARGIN - 2 : 2 - MARGIN], beams), above_m)
    labels = np.full(texture.shape, MISSING, np.uint8)
    for line, i in zip(*np.nonzero(~np.isnan(window_m[MARGIN:-MARGIN])), strict=True):
        is_walked = bool(walked[line + 2, i])
        soft = np.float32(texture[line, i])
        shot = _Shot(
            window_m,
            points,
            neighbours,
            is_walked,
            soft,
            slots,
            walls,
            levels,
            kinds,
            step_rad,
            thresholds,
            int(line),
            int(i),
        )
        labels[line, i] = shot.rule()
    for line, row in enumerate(labels):
        ranges = window_m[line : line + 2 * MARGIN + 1]
        twin_line = _Line(
            ranges,
            *(image[line + 2] for image in points),
            *(seen[line + 2] for seen in neighbours),
            row,
            thresholds,
        )
        twin_line.label_boxes()
    return labels


@dataclass(frozen=True)
class _Line:
    """A line in which boxes are looked for."""

    window: F32
    side: F32
    height: F32
    above: F32
    near: U8
    smooth: U8
    upright: U8
    level: U8
    labels: U8
    limits: DecisionThresholds

    @property
    def ranges(self) -> F32:
        return self.window[MARGIN]

    def is_thing(self, j: int) -> bool:
        return self.labels[j] % 16 not in (MISSING, NOISE, GROUND)

    def is_top(self, i: int) -> bool:
        is_low = self.limits.foot_m < self.above[i] < self.limits.box_m
        return bool(
            self.is_thing(i) and is_low and self.level[i] > self.upright[i] and self.smooth[i] >= 3
        )

    def end(self, i: int, way: int) -> tuple[int, int]:
        """Return the last shot of a box to one side, and the next shot; -1 = none close by."""
        last = i
        gap = 0
        j = i + way
        while 0 <= j < len(self.labels) and gap <= 3:
            if self.labels[j] % 16 in (MISSING, NOISE) or self.near[j] < self.limits.least_near:
                gap += 1
            elif (
                self.labels[j] % 16 == GROUND
                or not abs(self.ranges[j] - self.ranges[last]) < self.limits.jump_m
            ):
                return last, j
            elif self.above[j] >= self.limits.box_m:
                return last, last
            else:
                last = j
                gap = 0
            j += way
        return last, -1 if gap > 3 else last

    def lines_beside(self, i: int, way: int) -> int | None:
        last = self.ranges[i]
        seen = 0
        others = []
        for k in range(1, MARGIN + 1):
            there = self.window[MARGIN + way * k, i]
            if abs(there - last) < self.limits.jump_m:
                last = there
                seen = k
                others = []
                continue
            others.append(not there <= last + self.limits.far_m)
            if len(others) == 3:
                return seen if sum(others) >= 2 else None
        return None

    def is_small(self, i: int, shots: I64) -> bool:
        limits = self.limits
        away = np.abs(self.side[shots])
        if (
            len(shots) < limits.pole_shots
            or not limits.box_flat_m <= np.ptp(away) <= limits.box_deep_m
        ):
            return False
        on_top = self.above[shots] > self.above[shots].max() - np.float32(0.12)
        if np.ptp(away[on_top]) < limits.box_flat_m:
            return False
        if np.float32((self.smooth[shots] >= 3).sum()) < np.float32(0.8) * np.float32(len(shots)):
            return False
        before = self.lines_beside(i, -1)
        after = self.lines_beside(i, 1)
        return before is not None and after is not None and before + after <= limits.box_lines

    def label_boxes(self) -> None:
        done = -1
        for i in range(len(self.labels)):
            if i <= done or not self.is_top(i):
                continue
            (first, before) = self.end(i, -1)
            (last, after) = self.end(i, 1)
            done = last
            if before == first or after == last:
                continue
            ends = [(first, before), (last, after)]
            if not self.height[last] > self.height[first]:
                ends.reverse()
            (foot, below), (top, beyond) = ends
            if beyond >= 0 and self.ranges[beyond] <= self.ranges[top] + self.limits.far_m:
                continue
            if (
                below >= 0
                and self.labels[below] % 16 != GROUND
                and self.ranges[below] < self.ranges[foot]
            ):
                continue
            shots = np.array([j for j in range(first, last + 1) if self.is_thing(j)])
            if self.is_small(i, shots):
                self.labels[shots] = np.uint8(Reason.BOX)


def _points(range_m: F32, beams: Beams) -> tuple[F32, F32]:
    """Turn ranges into points of the scan plane."""
    return range_m * beams[0], -(range_m * beams[1])
