"""Slow and simple twin of :mod:`prc_cli.methods.fused.noise_loops`: every shot by itself."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from prc_cli.core.classes import Reason
from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.thresholds import AgainThresholds

MISSING = 0
NOISE = 2
VEGETATION = 5
CAR = 7


class _Window(NamedTuple):
    """A shot and what is around it."""

    labels: U8
    range_m: F32
    smooth: U8
    line: int
    i: int

    @property
    def range_of_shot(self) -> np.float32:
        return np.float32(self.range_m[self.line, self.i])

    def around(self, lines: int = 3) -> Iterator[tuple[int, int]]:
        """Yield the places of the window but the shot's own."""
        for k in range(self.line - lines, self.line + lines + 1):
            for j in range(max(self.i - 8, 0), min(self.i + 9, self.range_m.shape[1])):
                if (k, j) != (self.line, self.i):
                    yield k, j

    def is_mirrored(self, thresholds: AgainThresholds) -> bool:
        if not 2 <= self.i < self.range_m.shape[1] - 2:
            return False
        for way in (-1, 1):
            two = [self.i + way, self.i + 2 * way]
            if not (self.labels[self.line - 2, two] == CAR).any():
                return False
            if not (self.range_m[self.line, two] < self.range_of_shot - thresholds.mirror_m).any():
                return False
        sides = [0, 0]
        fellows = 0
        for k, j in self.around(1):
            off = self.range_m[k, j] - self.range_of_shot
            if off < -thresholds.mirror_m and self.labels[k - 2, j] == CAR and j != self.i:
                sides[int(j > self.i)] += 1
            if abs(off) <= thresholds.mirror_m and self.smooth[k, j] >= 2:
                fellows += 1
        return bool(min(sides) >= thresholds.mirror_share * np.float32(24) and fellows <= 1)

    def is_leaf(self, thresholds: AgainThresholds) -> bool:
        near = [
            cell
            for cell in self.around(1)
            if abs(self.range_m[cell] - self.range_of_shot) < thresholds.leaf_m
        ]
        return sum(self.labels[k - 2, j] == VEGETATION for k, j in near) >= thresholds.leaves

    def is_alone(self, thresholds: AgainThresholds) -> bool:
        ranges = np.array([self.range_m[place] for place in self.around()], np.float32)
        off = ranges[~np.isnan(ranges)] - self.range_of_shot
        if (np.abs(off) < thresholds.alone_m).any():
            return False
        # the shot itself is part of the window
        if np.isnan(ranges).sum() * 6 >= len(ranges) + 1:
            return False
        sides = [off[off > 0], -off[off < 0]]
        return any(
            len(distances) == 0 or distances.min() > thresholds.alone_gap_m for distances in sides
        )


def noise_again(
    labels: U8,
    voted: U8,
    range_m: F32,
    smooth: U8,
    above_m: F32,
    texture: F32,
    thresholds: AgainThresholds,
) -> U8:
    """Ask again which shots are noise.

    See :func:`prc_cli.methods.fused.noise_loops.noise_again`.
    """
    noisy = voted.copy()
    for line, i in zip(*np.nonzero(voted), strict=True):
        shot = _Window(labels, range_m, smooth, int(line) + 3, int(i))
        pairs = smooth[line + 3, i]
        is_high = above_m[line, i] > thresholds.foot_m
        is_noise = voted[line, i] == NOISE
        is_rough = (
            pairs == 0 and texture[line, i] > thresholds.alone_texture and is_high and not is_noise
        )
        is_open = pairs < 2 and labels[line + 1, i] not in (MISSING, NOISE)
        if is_noise and is_high and shot.is_leaf(thresholds):
            noisy[line, i] = Reason.LEAF
        elif is_rough and shot.is_alone(thresholds):
            noisy[line, i] = Reason.RANGE_ALONE
        elif is_open and not is_noise and shot.is_mirrored(thresholds):
            noisy[line, i] = Reason.MIRRORED
    return noisy
