"""Loops of the method for rings over objects on the ground: by shots, and by columns of space."""

from __future__ import annotations

import math

import numpy as np

from prc_cli.core.loops import helper, loop
from prc_cli.core.types import (
    F32,
    F32_2,
    F32_3,
    F64_1,
    F64_2,
    I32_1,
    I32_2,
    I64_1,
    U8_2,
    Mask_1,
    Mask_2,
)
from prc_cli.core.union_find_loops import find_root
from prc_cli.methods.rings.thresholds import (
    CellThresholds,
    LonelyThresholds,
    MarkThresholds,
    SoilThresholds,
)

SMOOTH = 1
ASKED = 2
UPRIGHT = 4
LEVEL = 8
"""Bits of a mark: on the line through two shots of its ring; such two shots exist; on an upright
surface; on a level surface."""
LINES = 3
RINGS = 2
"""Shots this far away are around a shot."""
N_SUMS = 9
"""Sums of a cell: shots, x, y, xx, xy, yy, smooth ones, asked ones, upright ones."""
N_MEASURES = 8
"""Measures of a cell; see :func:`measure_cells`."""
TOP_LEVEL = 61


@helper
def _beside(
    place: F32,
    line: int,
    way: int,
    i: int,
    most: int,
) -> int:
    """Return ``line`` if ring i has a shot in it, else the next line on if it has one, else -1."""
    for q in (line, line + way):
        if 0 <= q < most and place[q, i] == place[q, i]:
            return q
    return -1


@helper
def _smooth_bits(
    before: F32,
    shot: F32,
    after: F32,
    most_m: float,
    tolerance_m: float,
) -> int:
    """Return the bits SMOOTH and ASKED of a shot between two; only ASKED if these are far apart."""
    # distance from the line through both: length of the cross product over that of the chord
    cx = float(after[0]) - before[0]
    cy = float(after[1]) - before[1]
    cz = float(after[2]) - before[2]
    square = cx * cx + cy * cy + cz * cz
    if square > most_m * most_m or square == 0.0:
        return ASKED
    dx = float(shot[0]) - before[0]
    dy = float(shot[1]) - before[1]
    dz = float(shot[2]) - before[2]
    ex = dy * cz - dz * cy
    ey = dz * cx - dx * cz
    ez = dx * cy - dy * cx
    is_on_line = ex * ex + ey * ey + ez * ez < tolerance_m * tolerance_m * square
    return SMOOTH | ASKED if is_on_line else ASKED


@loop()
def mark_shots(
    xyz_m: F32_3,
    place: F32_2,
    above_m: F32_2,
    foot_m: float,
    root: float,
    step_rad: float,
    thresholds: MarkThresholds,
) -> U8_2:
    """Mark shots by neighbours in the ring and, above ``foot_m``, in the line; (lines, M) uint8.

    ``xyz_m`` (lines, M, 3) float32, metres; ``place, above_m`` (lines, M) float32; ``step_rad`` is
    the angle between lines; ``root`` the number of bins of ``place`` per square root of a metre.
    """
    n_lines, m = place.shape
    marks = np.zeros((n_lines, m), np.uint8)
    for line in range(n_lines):
        for i in range(m):
            if place[line, i] != place[line, i]:
                continue
            far = float(place[line, i]) / root
            far *= far
            step = max(far, 0.5) * step_rad
            k = min(max(int(thresholds.base_m / step + 0.5), 1), thresholds.most_lines)
            line_before = _beside(place, line - k, -1, i, n_lines)
            line_after = _beside(place, line + k, 1, i, n_lines)
            if line_before >= 0 and line_after >= 0:
                most_m = max(thresholds.chord_m, thresholds.chord_steps * k * step)
                tolerance_m = thresholds.smooth_m + thresholds.smooth_per_m * far
                marks[line, i] |= np.uint8(
                    _smooth_bits(
                        xyz_m[line_before, i],
                        xyz_m[line, i],
                        xyz_m[line_after, i],
                        most_m,
                        tolerance_m,
                    )
                )
            elif line - k >= 0 and line + k < n_lines:
                marks[line, i] |= np.uint8(ASKED)
            if not above_m[line, i] > foot_m:
                continue
            for q in range(i + 1, min(i + 3, m)):
                if place[line, q] != place[line, q]:
                    continue
                root_far = float(place[line, q]) / root
                rise = abs(float(xyz_m[line, q, 2]) - xyz_m[line, i, 2])
                distance_m = abs(root_far * root_far - far)
                mark = 0
                if distance_m < thresholds.upright * rise + thresholds.upright_m:
                    mark = UPRIGHT
                elif rise < thresholds.level * distance_m:
                    mark = LEVEL
                marks[line, i] |= np.uint8(mark)
                marks[line, q] |= np.uint8(mark)
                break
    return marks


@loop()
def lonely_shots(
    range_m: F32_2,
    intensity: F32_2,
    is_lit: bool,
    thresholds: LonelyThresholds,
) -> Mask_2:
    """Mark shots near the scanner with hardly any shot around as far, and no surface around.

    ``range_m`` (lines, M) float32, metres; ``intensity`` the same, or (1, 1) where ``is_lit`` is
    false.
    """
    n_lines, m = range_m.shape
    lonely = np.zeros((n_lines, m), np.bool_)
    most = thresholds.most if is_lit else thresholds.unlit
    for line in range(n_lines):
        for i in range(m):
            range_here = float(range_m[line, i])
            if not range_here < thresholds.reach_m:
                continue
            limit = thresholds.near_m + thresholds.near_per_m * range_here
            near = alike = 0
            for k in range(2 * RINGS + 1):
                # its own ring first: most shots have enough beside them there
                q = i + (k + 1) // 2 * (1 - 2 * (k % 2))
                if q < 0 or q >= m:
                    continue
                for p in range(max(line - LINES, 0), min(line + LINES + 1, n_lines)):
                    near += abs(float(range_m[p, q]) - range_here) < limit
                if near > most + 1:
                    break
            if near > most + 1:  # itself among them
                continue
            if is_lit:
                light = float(intensity[line, i])
                for q in range(max(i - RINGS, 0), min(i + RINGS + 1, m)):
                    for p in range(max(line - LINES, 0), min(line + LINES + 1, n_lines)):
                        light_beside = float(intensity[p, q])
                        is_beside = abs(float(range_m[p, q]) - range_here) < thresholds.beside_m
                        alike += is_beside and abs(light_beside - light) <= thresholds.alike * max(
                            light_beside, light
                        )
            lonely[line, i] = alike <= thresholds.bright
    return lonely


@loop()
def fill_cells(
    xyz_m: F32_3,
    above_m: F32_2,
    marks: U8_2,
    leave_out: Mask_2,
    thresholds: CellThresholds,
) -> tuple[I64_1, F64_2, I32_2, I32_2, I32_2]:
    """Sum up the shots above the ground in every column of space.

    ``xyz_m`` (lines, M, 3) float32, metres; ``above_m`` (lines, M) float32; ``marks`` (lines, M)
    uint8; ``leave_out`` (lines, M) bool; returns levels with shots, (cells,) int64, one bit each;
    sums (cells, N_SUMS) float64; places of the cells in the grid, (cells, 2) int32; the grid, (n,
    n) int32 with the number of the cell, -1 = empty; the cell of every shot, (lines, M) int32, -1 =
    none.
    """
    n_lines, m = above_m.shape
    size = thresholds.cell_m
    n = int(2.0 * thresholds.half_m / thresholds.cell_m)
    grid = np.full((n, n), -1, np.int32)
    cell = np.full((n_lines, m), -1, np.int32)
    k = 0
    for line in range(n_lines):
        for i in range(m):
            if not above_m[line, i] > thresholds.foot_m or leave_out[line, i]:
                continue
            p = math.floor((xyz_m[line, i, 0] + thresholds.half_m) / size)
            q = math.floor((xyz_m[line, i, 1] + thresholds.half_m) / size)
            if p < 2 or q < 2 or p >= n - 2 or q >= n - 2:
                continue
            if grid[p, q] < 0:
                grid[p, q] = k
                k += 1
            cell[line, i] = grid[p, q]
    where = np.empty((k, 2), np.int32)
    sums = np.zeros((k, N_SUMS))
    levels = np.zeros(k, np.int64)
    for line in range(n_lines):
        for i in range(m):
            c = cell[line, i]
            if c < 0:
                continue
            p = math.floor((xyz_m[line, i, 0] + thresholds.half_m) / size)
            q = math.floor((xyz_m[line, i, 1] + thresholds.half_m) / size)
            where[c, 0] = p
            where[c, 1] = q
            x = xyz_m[line, i, 0] + thresholds.half_m - (p + 0.5) * size
            y = xyz_m[line, i, 1] + thresholds.half_m - (q + 0.5) * size
            mark = int(marks[line, i])
            row = sums[c]
            row[0] += 1.0
            row[1] += x
            row[2] += y
            row[3] += x * x
            row[4] += x * y
            row[5] += y * y
            row[6] += mark & SMOOTH
            row[7] += (mark & ASKED) >> 1
            row[8] += (mark & UPRIGHT) >> 2
            levels[c] |= 1 << int(min(above_m[line, i] / thresholds.storey_m, float(TOP_LEVEL)))
    for line in range(n_lines):
        for i in range(m):
            if (
                not above_m[line, i] > thresholds.hem_m
                or above_m[line, i] > thresholds.foot_m
                or leave_out[line, i]
            ):
                continue
            p = math.floor((xyz_m[line, i, 0] + thresholds.half_m) / size)
            q = math.floor((xyz_m[line, i, 1] + thresholds.half_m) / size)
            if p >= 0 and q >= 0 and p < n and q < n:
                cell[line, i] = grid[p, q]
    return levels, sums, where, grid, cell


@helper
def _body_top(levels: int, gap: int) -> int:
    """Return the first level above the object that starts at the ground; 0 = the object hangs.

    The object ends at a gap of more than ``gap`` levels.
    """
    top = misses = 0
    for level in range(TOP_LEVEL + 1):
        if levels >> level & 1:
            top = level + 1
            misses = 0
        else:
            misses += 1
            if misses > gap:
                break
    return top


@loop()
def measure_cells(
    grid: I32_2,
    where: I32_2,
    sums: F64_2,
    levels: I64_1,
    thresholds: CellThresholds,
) -> F64_2:
    """Measure every cell with those around.

    ``grid`` (n, n) int32; ``where`` (cells, 2) int32; ``sums`` (cells, N_SUMS) float64; ``levels``
    (cells,) int64; returns (cells, N_MEASURES) float64: of 3 x 3 cells thickness and length of the
    shots (standard deviations, [m]) and the share of upright shots; of 5 x 5 cells the share of
    smooth shots, the number of levels with shots, the highest level, and the number of cells with
    shots; of the cell itself the first level above the object at the ground, 0 = it hangs.
    """
    measures = np.zeros((len(where), N_MEASURES))
    cell_m = thresholds.cell_m
    gap = int(thresholds.gap_m / thresholds.storey_m + 0.5)
    for c in range(len(where)):
        n = x = y = xx = xy = yy = upright = smooth = asked = 0.0
        levels_around = np.int64(0)
        cells = 0
        for dp in range(-2, 3):
            for dq in range(-2, 3):
                beside = grid[where[c, 0] + dp, where[c, 1] + dq]
                if beside < 0:
                    continue
                cells += 1
                row = sums[beside]
                smooth += row[6]
                asked += row[7]
                levels_around |= levels[beside]
                if abs(dp) == 2 or abs(dq) == 2:
                    continue
                ox = dp * cell_m
                oy = dq * cell_m
                n += row[0]
                x += row[1] + row[0] * ox
                y += row[2] + row[0] * oy
                xx += row[3] + 2.0 * ox * row[1] + row[0] * ox * ox
                xy += row[4] + ox * row[2] + oy * row[1] + row[0] * ox * oy
                yy += row[5] + 2.0 * oy * row[2] + row[0] * oy * oy
                upright += row[8]
        x = x / n
        y = y / n
        xx = xx / n - x * x
        xy = xy / n - x * y
        yy = yy / n - y * y
        half = 0.5 * (xx + yy)
        away = math.sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy)
        top = 0
        for level in range(TOP_LEVEL + 1):
            if levels_around >> level & 1:
                measures[c, 4] += 1.0
                top = level
        measures[c, 0] = math.sqrt(max(half - away, 0.0))
        measures[c, 1] = math.sqrt(max(half + away, 0.0))
        measures[c, 2] = upright / n
        measures[c, 3] = smooth / max(asked, 1.0)
        measures[c, 5] = top + 1.0
        measures[c, 6] = float(cells)
        measures[c, 7] = float(_body_top(levels[c], gap))
    return measures


@loop()
def mean_around(
    grid: I32_2,
    where: I32_2,
    values: F64_1,
    weight: F64_1,
) -> F64_1:
    """Return the weighted means of values of the 5 x 5 cells around every cell, (cells,) float64.

    ``grid`` (n, n) int32; ``where`` (cells, 2) int32; ``values, weight`` (cells,) float64.
    """
    means = np.empty(len(where))
    for c in range(len(where)):
        total = total_weight = 0.0
        for dp in range(-2, 3):
            for dq in range(-2, 3):
                beside = grid[where[c, 0] + dp, where[c, 1] + dq]
                if beside >= 0:
                    total += weight[beside] * values[beside]
                    total_weight += weight[beside]
        means[c] = total / total_weight
    return means


@loop()
def join_cells(grid: I32_2, where: I32_2, use: Mask_1) -> I32_1:
    """Return the body of every cell as the number of its first cell, (cells,) int32; -1 = unused.

    ``grid`` (n, n) int32; ``where`` (cells, 2) int32; ``use`` (cells,) bool.
    """
    parent = np.arange(len(where)).astype(np.int32)
    for c in range(len(where)):
        if not use[c]:
            continue
        for dp in range(-1, 2):
            for dq in range(-1, 2):
                beside = grid[where[c, 0] + dp, where[c, 1] + dq]
                if beside < 0 or not use[beside]:
                    continue
                root = find_root(parent, c)
                root_beside = find_root(parent, int(beside))
                parent[max(root, root_beside)] = min(root, root_beside)
    body = np.full(len(where), -1, np.int32)
    for c in range(len(where)):
        if use[c]:
            body[c] = find_root(parent, c)
    return body


@helper
def _is_low(
    above_m: float,
    x: float,
    y: float,
    thresholds: SoilThresholds,
) -> bool:
    inside = (
        abs(x) < thresholds.half_m - thresholds.cell_m
        and abs(y) < thresholds.half_m - thresholds.cell_m
    )
    return bool(inside and above_m > thresholds.below_m and above_m <= thresholds.foot_m)


@loop()
def low_plants(
    xyz_m: F32_3,
    above_m: F32_2,
    marks: U8_2,
    thresholds: SoilThresholds,
) -> Mask_2:
    """Mark the plants among low shots, (lines, M) bool: rough places, shots high above smooth ones.

    ``xyz_m`` (lines, M, 3) float32, metres; ``above_m`` (lines, M) float32; ``marks`` (lines, M)
    uint8.
    """
    n_lines, m = above_m.shape
    n = int(2.0 * thresholds.half_m / thresholds.cell_m)
    # shots, smooth ones, heights, their squares
    sums = np.zeros((n, n, 4))
    for line in range(n_lines):
        for i in range(m):
            x = float(xyz_m[line, i, 0])
            y = float(xyz_m[line, i, 1])
            above = float(above_m[line, i])
            if not _is_low(above, x, y, thresholds) or not marks[line, i] & ASKED:
                continue
            row = sums[
                int((x + thresholds.half_m) / thresholds.cell_m),
                int((y + thresholds.half_m) / thresholds.cell_m),
            ]
            row[0] += 1.0
            row[1] += float(marks[line, i] & SMOOTH)
            row[2] += above
            row[3] += above * above
    # the part of the score that all shots of a cell have; NaN = too few shots
    score = np.full((n, n), np.nan)
    for p in range(1, n - 1):
        for q in range(1, n - 1):
            if sums[p, q, 0] == 0.0:
                continue
            total = smooth = height = square = 0.0
            for dp in range(-1, 2):
                for dq in range(-1, 2):
                    row = sums[p + dp, q + dq]
                    total += row[0]
                    smooth += row[1]
                    height += row[2]
                    square += row[3]
            if total >= thresholds.shots:
                mean = height / total
                rough = min(
                    math.sqrt(max(square / total - mean * mean, 0.0)), thresholds.most_rough_m
                )
                score[p, q] = (
                    thresholds.bias + thresholds.smooth * smooth / total + thresholds.rough * rough
                )
    is_plant = np.zeros((n_lines, m), np.bool_)
    for line in range(n_lines):
        for i in range(m):
            x = float(xyz_m[line, i, 0])
            y = float(xyz_m[line, i, 1])
            above = float(above_m[line, i])
            cell_score = np.nan
            if _is_low(above, x, y, thresholds):
                p = int((x + thresholds.half_m) / thresholds.cell_m)
                cell_score = score[p, int((y + thresholds.half_m) / thresholds.cell_m)]
            if cell_score == cell_score:
                high = max(above, thresholds.least_high_m)
                is_plant[line, i] = (
                    cell_score + thresholds.high * high + thresholds.far * math.sqrt(x * x + y * y)
                    > 0.0
                )
            else:
                is_plant[line, i] = above > thresholds.soil_m
    return is_plant
