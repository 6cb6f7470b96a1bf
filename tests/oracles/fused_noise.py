"""Slow and simple twin of :mod:`prc_cli.methods.fused.noise_loops`: every shot by itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.thresholds import AgainThresholds, NearThresholds

MISSING, NOISE, GROUND, BUILDING = 0, 2, 3, 4


@dataclass(frozen=True)
class _Window:
    """A shot and what is around it."""

    labels: U8
    range_m: F32
    smooth: U8
    beams: tuple[F32, F32]
    line: int
    i: int

    @property
    def own(self) -> np.float32:
        return np.float32(self.range_m[self.line, self.i])

    def around(self, lines: int = 3) -> Iterator[tuple[int, int]]:
        """Yield the places of the window but the shot's own."""
        for k in range(self.line - lines, self.line + lines + 1):
            for j in range(max(self.i - 8, 0), min(self.i + 9, self.range_m.shape[1])):
                if (k, j) != (self.line, self.i):
                    yield k, j

    def point(self, k: int, j: int) -> tuple[np.float32, np.float32]:
        return self.range_m[k, j] * self.beams[0][j], -(self.range_m[k, j] * self.beams[1][j])

    def is_on_surface(self, off_m: np.float32) -> bool:
        if not 2 <= self.i < self.range_m.shape[1] - 2:
            return False
        sine, cosine, agreeing = self.beams[0][self.i], self.beams[1][self.i], []
        for away in (1, 2):
            (ay, az), (by, bz) = self.point(self.line, self.i - away), self.point(self.line, self.i + away)
            if np.isnan(ay) or np.isnan(by):
                continue
            across = sine * (bz - az) + cosine * (by - ay)
            agreeing.append(abs(ay * bz - az * by - self.own * across) < off_m * abs(across))
        for away in (-1, 0, 1):
            before, after = self.range_m[self.line - 1, self.i + away], self.range_m[self.line + 1, self.i - away]
            if not (np.isnan(before) or np.isnan(after)):
                agreeing.append(abs(np.float32(0.5) * (before + after) - self.own) < off_m)
        return sum(agreeing) > 0 and 2 * sum(agreeing) >= len(agreeing)

    def is_sparse(self, step: np.float32, limits: NearThresholds, thresholds: AgainThresholds) -> bool:
        y, z = self.point(self.line, self.i)
        near = max(limits.near_m, limits.near_steps * (self.own * step))
        along = max(limits.along_m, limits.along_steps * (self.own * step), near)
        present, close, before = 0, 0, 0
        for k, j in self.around():
            if np.isnan(self.range_m[k, j]):
                continue
            present += 1
            a, b = (abs(one - other) for one, other in zip(self.point(k, j), (y, z), strict=True))
            if max(a, b) < (along if min(a, b) < limits.thin_m else near):
                close += 1
            elif self.range_m[k, j] < self.own and self.smooth[k, j] >= 2:
                before += 1
        return bool(close >= thresholds.sparse_shots and before < thresholds.through_share * np.float32(present))

    def is_amid_ground(self) -> bool:
        return sum(int(self.labels[k - 2, j]) == GROUND for k, j in self.around(1)) >= 2

    def is_mirrored(self, thresholds: AgainThresholds) -> bool:
        if not 2 <= self.i < self.range_m.shape[1] - 2:
            return False
        for way in (-1, 1):
            two = [self.i + way, self.i + 2 * way]
            if not (self.labels[self.line - 2, two] == thresholds.car_label).any():
                return False
            if not (self.range_m[self.line, two] < self.own - thresholds.mirror_m).any():
                return False
        sides, fellows = [0, 0], 0
        for k, j in self.around(1):
            off = self.range_m[k, j] - self.own
            if off < -thresholds.mirror_m and self.labels[k - 2, j] == thresholds.car_label and j != self.i:
                sides[int(j > self.i)] += 1
            if abs(off) <= thresholds.mirror_m and self.smooth[k, j] >= 2:
                fellows += 1
        return bool(min(sides) >= thresholds.mirror_share * np.float32(24) and fellows <= 1)

    def is_alone(self, thresholds: AgainThresholds) -> bool:
        ranges = np.array([self.range_m[place] for place in self.around()], np.float32)
        off = ranges[~np.isnan(ranges)] - self.own
        if (np.abs(off) < thresholds.alone_m).any():
            return False
        # the shot itself is part of the window
        if np.isnan(ranges).sum() * 6 >= len(ranges) + 1:
            return False
        sides = [off[off > 0], -off[off < 0]]
        return any(len(one) == 0 or one.min() > thresholds.alone_gap_m for one in sides)

    def label_around(self) -> int:
        least, found = np.float32(1e9), BUILDING
        for k, j in self.around(1):
            off = abs(self.range_m[k, j] - self.own)
            if self.labels[k - 2, j] not in (MISSING, NOISE) and off < least:
                least, found = off, int(self.labels[k - 2, j])
        return found


def noise_again(
    labels: U8,
    voted: U8,
    range_m: F32,
    counts: tuple[U8, U8],
    above_m: F32,
    texture: F32,
    beams: tuple[F32, F32],
    step: np.float32,
    limits: NearThresholds,
    thresholds: AgainThresholds,
) -> U8:
    """Ask again which shots are noise; see :func:`prc_cli.methods.fused.noise_loops.noise_again`."""
    found = voted.copy()
    for line, i in zip(*np.nonzero(voted != MISSING), strict=True):
        shot = _Window(labels, range_m, counts[1], beams, int(line) + 3, int(i))
        near, smooth, soft = counts[0][line + 3, i], counts[1][line + 3, i], texture[line, i]
        if voted[line, i] == NOISE:
            if near >= thresholds.least_near:
                is_kept = smooth == 0 and shot.is_on_surface(thresholds.spike_m)
            elif not soft < thresholds.sparse_texture:
                continue
            elif abs(above_m[line, i]) < thresholds.low_m and shot.is_amid_ground():
                found[line, i] = GROUND
                continue
            else:
                is_kept = near > 0 and shot.is_sparse(step, limits, thresholds)
            if is_kept:
                found[line, i] = shot.label_around()
            continue
        may_be_alone = smooth == 0 and soft > thresholds.alone_texture and above_m[line, i] > thresholds.foot_m
        is_mirrored = smooth < 2 and labels[line + 1, i] not in (MISSING, NOISE) and shot.is_mirrored(thresholds)
        if is_mirrored or (may_be_alone and shot.is_alone(thresholds)):
            found[line, i] = NOISE
    return found
