"""Loops that give shots their class, when all stages have had their say (Stamos et al. 2012, sec. 7 and 8)."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Label, Surface
from prc_cli.core.types import F32, I32, U8, Mask
from prc_cli.kernels.cache import helper, kernel

_NOTHING, _HORIZONTAL = int(Surface.MISSING), int(Surface.HORIZONTAL)
_CURB_DEPTH_M = 0.3
"""Curb points that are farther behind the nearest one of their row belong to another curb [m]."""
_MISSING, _GROUND, _CAR, _CURB = int(Label.MISSING), int(Label.GROUND), int(Label.CAR), int(Label.CURB)
_UNCLASSIFIED = int(Label.UNCLASSIFIED)


@kernel(
    "boolean[:, ::1](int32[:, ::1], float32[:, ::1], float32[:, :, ::1], uint8[:, ::1], float32[::1], float32[::1])"
)
def mark_cars(intervals: I32, horizontal_m: F32, xyz_m: F32, surface: U8, limit_m: F32, low_m: F32) -> Mask:
    """Mark the returns of intervals that are neither too far away nor next to the ground.

    ``intervals`` (K, 3) int32; ``horizontal_m`` (R, n) float32, metres; ``xyz_m`` (R, n, 3) float32, metres;
    ``surface`` (R, n) uint8; ``limit_m`` (R,) float32, metres; ``low_m`` (R,) float32, metres; returns (R, n) bool.
    """
    marked = np.zeros(surface.shape, np.bool_)
    for i in range(len(intervals)):
        row = intervals[i, 0]
        limit, low = limit_m[row], low_m[row]
        for k in range(intervals[i, 1], intervals[i, 2] + 1):
            on_ground = surface[row, k] == _HORIZONTAL and xyz_m[row, k, 2] < low
            marked[row, k] = horizontal_m[row, k] <= limit and not on_ground
    return marked


@helper
def _curb_of(curb: Mask, horizontal_m: F32, xyz_m: F32, row: int, n: int) -> tuple[float, float]:
    """Return the least distance of the curb points of a row, and how high those next to it reach [m]."""
    nearest = np.float32(np.inf)
    for k in range(n):
        if curb[row, k]:
            nearest = min(nearest, horizontal_m[row, k])
    top = -np.inf
    for k in range(n):
        if curb[row, k] and np.float64(horizontal_m[row, k]) - np.float64(nearest) <= _CURB_DEPTH_M:
            top = max(top, np.float64(xyz_m[row, k, 2]))
    return np.float64(nearest), top


@helper
def _foot(surface: U8, car: Mask, xyz_m: F32, row: int, k: int, n: int, base: float) -> tuple[int, float]:
    """Follow car points to the last one; return the beam after them, and the height of what they stand on.

    That is the lowest of them, or the last horizontal point before them if it is lower.
    """
    foot = base
    end = k
    while end < n and (car[row, end] or surface[row, end] == _NOTHING):
        if car[row, end]:
            foot = min(foot, np.float64(xyz_m[row, end, 2]))
        end += 1
    return end, foot


@kernel(
    "uint8[:, ::1](uint8[:, ::1], boolean[:, ::1], boolean[:, ::1], float32[:, ::1], float32[:, :, ::1], "
    "boolean[:, ::1], uint8[::1], float64)"
)
def combine_classes(
    surface: U8, ground: Mask, car: Mask, horizontal_m: F32, xyz_m: F32, curb: Mask, label_of: U8, below_m: float
) -> U8:
    """Give every beam its class; cars behind a curb go back to the coarse classification.

    ``surface`` (R, n) uint8; ``ground, car`` (R, n) bool; ``horizontal_m`` (R, n) float32, metres; ``xyz_m`` (R, n, 3)
    float32, metres; ``curb`` (R, n) bool; ``label_of`` (5,) uint8; returns (R, n) uint8.
    """
    n_rows, n = surface.shape
    labels = np.empty((n_rows, n), np.uint8)
    zero, one, two, three, four = label_of[0], label_of[1], label_of[2], label_of[3], label_of[4]
    for row in range(n_rows):
        n_curb = 0
        for k in range(n):
            n_curb += curb[row, k]
        for k in range(n):  # selections, not a table: they are vector instructions
            code = surface[row, k]
            label = zero if code == 0 else one if code == 1 else two if code == 2 else three if code == 3 else four
            label = np.uint8(_GROUND) if ground[row, k] else label
            labels[row, k] = np.uint8(_CAR) if car[row, k] and n_curb == 0 else label
        if n_curb > 0:
            nearest, top = _curb_of(curb, horizontal_m, xyz_m, row, n)
            base = np.inf
            k = int(np.int64(0))
            while k < n:
                if not car[row, k]:
                    if surface[row, k] == _HORIZONTAL:
                        base = np.float64(xyz_m[row, k, 2])
                    k += 1
                    continue
                end, foot = _foot(surface, car, xyz_m, row, k, n, base)
                stands_below = foot < top - below_m
                for j in range(k, end):
                    if car[row, j] and (stands_below or not np.float64(horizontal_m[row, j]) > nearest):
                        labels[row, j] = _CAR
                k = end
            for k in range(n):
                if curb[row, k]:
                    labels[row, k] = _CURB
    return labels


@kernel("Tuple((uint8[:, ::1], int64))(float32[:, ::1], uint8[:, ::1])")
def mark_beyond(range_m: F32, labels: U8) -> tuple[U8, int]:
    """Call returns unclassified that are missing to the method, lying beyond the scanner's reach.

    ``range_m`` (lines, M) float32, metres; ``labels`` (lines, M) uint8; returns ``labels`` (lines, M) uint8.
    """
    n_lines, m = labels.shape
    marked = np.empty((n_lines, m), np.uint8)
    n_beyond = 0
    for line in range(n_lines):
        for k in range(m):
            label = labels[line, k]
            beyond = label == _MISSING and range_m[line, k] == range_m[line, k]
            marked[line, k] = np.uint8(_UNCLASSIFIED) if beyond else label
            n_beyond += beyond
    return marked, n_beyond
