"""Short loops over half-lines (Stamos et al. 2012, sec. 3, 7 and 8).

Their order, lines that may hold a car, high verticals, and the final classes.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Label, Surface
from prc_cli.core.loops import loop
from prc_cli.core.types import (
    F32_1,
    F32_2,
    F32_3,
    F64_1,
    F64_2,
    I32_1,
    I32_2,
    U8_1,
    U8_2,
    Mask_2,
)

_NOTHING = _MISSING = int(Surface.MISSING)
_HORIZONTAL = int(Surface.HORIZONTAL)
_VERTICAL = int(Surface.VERTICAL)
_UNSEEN = int(Label.MISSING)
_GROUND = int(Label.GROUND)
_CAR = int(Label.CAR)
_CURB = int(Label.CURB)
_UNCLASSIFIED = int(Label.UNCLASSIFIED)


@loop("prc_cli.reference.sequential_angle.labels")
def first_high_verticals(
    surface: U8_2,
    xyz_m: F32_3,
    n_beams: I32_1,
    ground_m: F32_1,
    height_m: float,
) -> I32_1:
    """Find the last beam of the first vertical run of every row that ends high above the ground.

    ``surface`` (R, n) uint8; ``xyz_m`` (R, n, 3) float32, metres; ``n_beams`` (R,) int32;
    ``ground_m`` (R,) float32, metres; returns (R,) int32, -1 = none.
    """
    n_rows = len(n_beams)
    beam = np.full(n_rows, -1, np.int32)
    for row in range(n_rows):
        limit = np.float64(ground_m[row]) + height_m
        codes = surface[row]
        points = xyz_m[row]
        n = n_beams[row]
        for k in range(n):
            if (
                codes[k] == _VERTICAL
                and (k + 1 == n or codes[k + 1] != _VERTICAL)
                and points[k, 2] > limit
            ):
                beam[row] = k
                break
    return beam


@loop("prc_cli.reference.sequential_angle.labels")
def first_triggers(
    surface: U8_2,
    n_beams: I32_1,
    increments: F64_2,
    threshold: float,
) -> I32_1:
    """Run the CUSUM of the observable chain H, V, M along every row until it triggers.

    The chain begins at the first beam with a return and ends before the first return that is
    neither H nor V.

    ``surface`` (R, n) uint8; ``n_beams`` (R,) int32; ``increments`` (3, 3) float64; returns (R,)
    int32,
    -1 = never.
    """
    n_rows = len(n_beams)
    beam = np.full(n_rows, -1, np.int32)
    for row in range(n_rows):
        codes = surface[row]
        stop = n_beams[row]
        k = 0
        while k < stop and codes[k] == _MISSING:
            k += 1
        total = 0.0
        before = -1
        while k < stop:
            code = codes[k]
            if code == _HORIZONTAL:
                state = 0
            elif code == _VERTICAL:
                state = 1
            elif code == _MISSING:
                state = 2
            else:
                break
            if before >= 0:
                total = max(0.0, total + increments[before, state])
                if total > threshold:
                    beam[row] = k
                    break
            before = state
            k += 1
    return beam


@loop("prc_cli.reference.sequential_angle.labels")
def arrange_lines(
    range_m: F32_2,
    xyz_m: F32_3,
    columns: I32_2,
    max_range_m: float,
) -> tuple[F32_2, F32_3, F32_2]:
    """Pick the beams of half-lines out of scan lines with coordinates.

    ``range_m`` (lines, M) float32; ``xyz_m`` (lines, M, 3) float32; ``columns`` (n_sides, n) int32;
    returns (lines * n_sides, n) float32, (lines * n_sides, n, 3) float32, (lines * n_sides, n)
    float32.
    """
    n_lines = range_m.shape[0]
    n_sides, n = columns.shape
    ranges = np.empty((n_lines * n_sides, n), np.float32)
    xyz = np.empty((n_lines * n_sides, n, 3), np.float32)
    horizontal = np.empty((n_lines * n_sides, n), np.float32)
    nan = np.float32(np.nan)
    for line in range(n_lines):
        for side in range(n_sides):
            row = line * n_sides + side
            for k in range(n):
                column = max(columns[side, k], 0)
                r = range_m[line, column]
                x = xyz_m[line, column, 0]
                y = xyz_m[line, column, 1]
                z = xyz_m[line, column, 2]
                seen = (
                    np.float64(r) <= max_range_m
                    and not np.isnan(x + y + z)
                    and columns[side, k] >= 0
                )
                ranges[row, k] = r if seen else nan
                xyz[row, k, 0] = x if seen else nan
                xyz[row, k, 1] = y if seen else nan
                xyz[row, k, 2] = z if seen else nan
            for k in range(n):  # by itself, for vector instructions; NaN where the shot is missing
                x_here = np.float64(xyz[row, k, 0])
                y_here = np.float64(xyz[row, k, 1])
                horizontal[row, k] = np.float32(np.sqrt(x_here * x_here + y_here * y_here))
    return ranges, xyz, horizontal


@loop("prc_cli.reference.sequential_angle.labels")
def arrange_plane(
    range_m: F32_2,
    across: F64_1,
    up: F64_1,
    columns: I32_2,
    max_range_m: float,
) -> tuple[F32_2, F32_3, F32_2]:
    """Pick the beams of half-lines out of scan lines of ranges.

    Coordinates are those in the scan plane.

    ``range_m`` (lines, M) float32; ``across, up`` (M,) float64; ``columns`` (n_sides, n) int32;
    returns (lines * n_sides, n) float32, (lines * n_sides, n, 3) float32, (lines * n_sides, n)
    float32.
    """
    n_lines = range_m.shape[0]
    n_sides, n = columns.shape
    ranges = np.full((n_lines * n_sides, n), np.nan, np.float32)
    xyz = np.full((n_lines * n_sides, n, 3), np.nan, np.float32)
    horizontal = np.full((n_lines * n_sides, n), np.nan, np.float32)
    for line in range(n_lines):
        for side in range(n_sides):
            row = line * n_sides + side
            for k in range(n):
                column = columns[side, k]
                if column < 0:
                    continue
                r = np.float64(range_m[line, column])
                if r <= max_range_m:
                    x = r * across[column]
                    ranges[row, k] = range_m[line, column]
                    xyz[row, k, 0] = np.float32(x)
                    xyz[row, k, 1] = np.float32(0.0)
                    xyz[row, k, 2] = np.float32(r * up[column])
                    horizontal[row, k] = np.float32(abs(x))
    return ranges, xyz, horizontal


@loop("prc_cli.reference.sequential_angle.labels")
def mark_cars(
    intervals: I32_2,
    horizontal_m: F32_2,
    xyz_m: F32_3,
    surface: U8_2,
    limit_m: F32_1,
    low_m: F32_1,
) -> Mask_2:
    """Mark the returns of intervals that are neither too far away nor next to the ground.

    ``intervals`` (K, 3) int32; ``horizontal_m`` (R, n) float32, metres; ``xyz_m`` (R, n, 3)
    float32, metres; ``surface`` (R, n) uint8; ``limit_m`` (R,) float32, metres; ``low_m`` (R,)
    float32, metres; returns (R, n) bool.
    """
    marked = np.zeros(surface.shape, np.bool_)
    for i in range(len(intervals)):
        row = intervals[i, 0]
        limit = limit_m[row]
        low = low_m[row]
        for k in range(intervals[i, 1], intervals[i, 2] + 1):
            on_ground = surface[row, k] == _HORIZONTAL and xyz_m[row, k, 2] < low
            marked[row, k] = horizontal_m[row, k] <= limit and not on_ground
    return marked


@loop("prc_cli.reference.sequential_angle.labels")
def combine_classes(
    surface: U8_2,
    ground: Mask_2,
    car: Mask_2,
    horizontal_m: F32_2,
    curb: Mask_2,
    label_of: U8_1,
) -> U8_2:
    """Give every beam its class; cars behind a curb go back to the coarse classification.

    ``surface`` (R, n) uint8; ``ground, car`` (R, n) bool; ``horizontal_m`` (R, n) float32, metres;
    ``curb`` (R, n) bool; ``label_of`` (5,) uint8; returns (R, n) uint8.
    """
    n_rows, n = surface.shape
    labels = np.empty((n_rows, n), np.uint8)
    label_missing = label_of[0]
    label_vegetation = label_of[1]
    label_horizontal = label_of[2]
    label_vertical = label_of[3]
    label_undecided = label_of[4]
    for row in range(n_rows):
        nearest = np.float32(np.inf)
        for k in range(n):
            nearest = min(nearest, horizontal_m[row, k]) if curb[row, k] else nearest
        for k in range(n):  # selections, not a table: they are vector instructions
            code = surface[row, k]
            label = label_undecided
            label = label_missing if code == 0 else label
            label = label_vegetation if code == 1 else label
            label = label_horizontal if code == 2 else label
            label = label_vertical if code == 3 else label
            label = np.uint8(_GROUND) if ground[row, k] else label
            before_curb = not horizontal_m[row, k] > nearest
            label = np.uint8(_CAR) if car[row, k] and before_curb else label
            labels[row, k] = np.uint8(_CURB) if curb[row, k] else label
    return labels


@loop("prc_cli.reference.sequential_angle.labels")
def mark_beyond(range_m: F32_2, labels: U8_2) -> tuple[U8_2, int]:
    """Make returns unclassified that are beyond the scanner's reach, so missing to the method.

    ``range_m`` (lines, M) float32, metres; ``labels`` (lines, M) uint8; returns ``labels`` (lines,
    M) uint8.
    """
    n_lines, m = labels.shape
    marked = np.empty((n_lines, m), np.uint8)
    n_beyond = 0
    for line in range(n_lines):
        for k in range(m):
            label = labels[line, k]
            beyond = label == _UNSEEN and range_m[line, k] == range_m[line, k]
            marked[line, k] = np.uint8(_UNCLASSIFIED) if beyond else label
            n_beyond += beyond
    return marked, n_beyond
