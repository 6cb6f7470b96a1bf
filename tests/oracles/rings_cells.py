"""Slow twins of the loops over what stands on the ground around a spinning scanner."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import (
    F32,
    F32_2,
    F32_3,
    F64_1,
    F64_2,
    I32,
    I32_1,
    I32_2,
    I64_1,
    U8_2,
    Mask,
    Mask_1,
    Mask_2,
)
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


def _points(xyz_m: F32, mask: Mask) -> Iterator[tuple[tuple[int, int], tuple[float, float, float]]]:
    for line, i in np.argwhere(mask).tolist():
        x, y, z = xyz_m[line, i].astype(np.float64).tolist()
        yield (line, i), (x, y, z)


def mark_shots(
    xyz_m: F32_3,
    place: F32_2,
    above_m: F32_2,
    foot_m: float,
    root: float,
    step_rad: float,
    thresholds: MarkThresholds,
) -> U8_2:
    marks = np.zeros(place.shape, np.uint8)
    (n_lines, m) = place.shape
    there = ~np.isnan(place)
    for (line, i), (x, y, z) in _points(xyz_m, there):
        far = float(place[line, i]) / root
        far *= far
        step = max(far, 0.5) * step_rad
        k = min(max(int(thresholds.base_m / step + 0.5), 1), thresholds.most_lines)
        sides = [
            next(
                (
                    q
                    for q in (line + way * k, line + way * (k + 1))
                    if 0 <= q < n_lines and there[q, i]
                ),
                None,
            )
            for way in (-1, 1)
        ]
        if None not in sides:
            marks[line, i] |= ASKED
            before, after = (xyz_m[q, i].astype(np.float64) for q in sides)
            cx, cy, cz = after - before
            square = cx * cx + cy * cy + cz * cz
            most_m = max(thresholds.chord_m, thresholds.chord_steps * k * step)
            if 0 < square <= most_m * most_m:
                dx, dy, dz = np.array([x, y, z]) - before
                ex = dy * cz - dz * cy
                ey = dz * cx - dx * cz
                ez = dx * cy - dy * cx
                tolerance_m = thresholds.smooth_m + thresholds.smooth_per_m * far
                if ex * ex + ey * ey + ez * ez < tolerance_m * tolerance_m * square:
                    marks[line, i] |= SMOOTH
        elif line - k >= 0 and line + k < n_lines:
            marks[line, i] |= ASKED
        higher = [q for q in (i + 1, i + 2) if q < m and there[line, q]][:1]
        for q in higher if above_m[line, i] > foot_m else ():
            root_far = float(place[line, q]) / root
            rise = abs(float(xyz_m[line, q, 2]) - z)
            apart = abs(root_far * root_far - far)
            if apart < thresholds.upright * rise + thresholds.upright_m:
                marks[line, [i, q]] |= UPRIGHT
            elif rise < thresholds.level * apart:
                marks[line, [i, q]] |= LEVEL
    return marks


def lonely_shots(
    range_m: F32_2,
    intensity: F32_2,
    is_lit: bool,
    thresholds: LonelyThresholds,
) -> Mask_2:
    lonely = np.zeros(range_m.shape, np.bool_)
    with np.errstate(invalid="ignore"):
        near_scanner = range_m.astype(np.float64) < thresholds.reach_m
    for line, i in np.argwhere(near_scanner).tolist():
        around = slice(max(line - 3, 0), line + 4), slice(max(i - 2, 0), i + 3)
        range_here = float(range_m[line, i])
        ranges = range_m[around].astype(np.float64)
        away = np.abs(ranges - range_here)
        n_near = np.count_nonzero(away < thresholds.near_m + thresholds.near_per_m * range_here)
        n_alike = 0
        if is_lit:
            light = float(intensity[line, i])
            lights = intensity[around].astype(np.float64)
            limit = thresholds.alike * np.maximum(lights, light)
            n_alike = np.count_nonzero(
                (away < thresholds.beside_m) & (np.abs(lights - light) <= limit)
            )
        most = thresholds.most if is_lit else thresholds.unlit
        lonely[line, i] = n_near <= most + 1 and n_alike <= thresholds.bright
    return lonely


def fill_cells(
    xyz_m: F32_3,
    above_m: F32_2,
    marks: U8_2,
    leave_out: Mask_2,
    thresholds: CellThresholds,
) -> tuple[I64_1, F64_2, I32_2, I32_2, I32_2]:
    size = thresholds.cell_m
    half = thresholds.half_m
    n = int(2.0 * thresholds.half_m / thresholds.cell_m)
    grid = np.full((n, n), -1, np.int32)
    cell = np.full(above_m.shape, -1, np.int32)
    sums: list[NDArray[np.float64]] = []
    levels: list[int] = []
    where: list[tuple[int, int]] = []
    above = above_m.astype(np.float64)
    is_above = (above > thresholds.foot_m) & ~leave_out

    def place(x: float, y: float) -> tuple[int, int]:
        return math.floor((x + half) / size), math.floor((y + half) / size)

    for shot, (x, y, _) in _points(xyz_m, is_above):
        p, q = place(x, y)
        if not (2 <= p < n - 2 and 2 <= q < n - 2):
            continue
        if grid[p, q] < 0:
            grid[p, q] = len(where)
            where.append((p, q))
            sums.append(np.zeros(9))
            levels.append(0)
        c = cell[shot] = grid[p, q]
        x = x + half - (p + 0.5) * size
        y = y + half - (q + 0.5) * size
        bits = [bool(marks[shot] & bit) for bit in (SMOOTH, ASKED, UPRIGHT)]
        sums[c] += [1, x, y, x * x, x * y, y * y, *bits]
        levels[c] |= 1 << int(min(above[shot] / thresholds.storey_m, 61.0))
    for shot, (x, y, _) in _points(
        xyz_m, (above > thresholds.hem_m) & (above <= thresholds.foot_m) & ~leave_out
    ):
        p, q = place(x, y)
        if 0 <= p < n and 0 <= q < n:
            cell[shot] = grid[p, q]
    total = np.array(sums).reshape(len(where), 9)
    places = np.array(where, np.int32).reshape(len(where), 2)
    return np.array(levels, np.int64), total, places, grid, cell


def _around(
    grid: I32,
    where: I32,
    c: int,
    reach: int,
) -> Iterator[tuple[int, int, int]]:
    """Yield how far cells are away and which they are."""
    for dp in range(-reach, reach + 1):
        for dq in range(-reach, reach + 1):
            beside = int(grid[where[c, 0] + dp, where[c, 1] + dq])
            if beside >= 0:
                yield dp, dq, beside


def measure_cells(
    grid: I32_2,
    where: I32_2,
    sums: F64_2,
    levels: I64_1,
    thresholds: CellThresholds,
) -> F64_2:
    measures = np.zeros((len(where), 8))
    gap = int(thresholds.gap_m / thresholds.storey_m + 0.5)
    for c in range(len(where)):
        n = x = y = xx = xy = yy = upright = 0.0
        for dp, dq, beside in _around(grid, where, c, 1):
            shots, sx, sy, sxx, sxy, syy, _, _, n_upright = sums[beside]
            ox = dp * thresholds.cell_m
            oy = dq * thresholds.cell_m
            n = n + shots
            upright = upright + n_upright
            x = x + (sx + shots * ox)
            y = y + (sy + shots * oy)
            xx += sxx + 2.0 * ox * sx + shots * ox * ox
            xy += sxy + ox * sy + oy * sx + shots * ox * oy
            yy += syy + 2.0 * oy * sy + shots * oy * oy
        x = x / n
        y = y / n
        xx = xx / n - x * x
        xy = xy / n - x * y
        yy = yy / n - y * y
        half = 0.5 * (xx + yy)
        away = math.sqrt(0.25 * (xx - yy) * (xx - yy) + xy * xy)
        wide = [beside for _, _, beside in _around(grid, where, c, 2)]
        smooth, asked = (sum(sums[beside, k] for beside in wide) for k in (6, 7))
        seen = [k for k in range(62) if any(int(levels[beside]) >> k & 1 for beside in wide)]
        own_levels = [k for k in range(62) if int(levels[c]) >> k & 1]
        body = 0
        for k in own_levels:
            if k - body > gap:
                break
            body = k + 1
        measures[c] = (
            math.sqrt(max(half - away, 0.0)),
            math.sqrt(max(half + away, 0.0)),
            upright / n,
            smooth / max(asked, 1.0),
            len(seen),
            seen[-1] + 1 if seen else 1,
            len(wide),
            body,
        )
    return measures


def mean_around(
    grid: I32_2,
    where: I32_2,
    values: F64_1,
    weight: F64_1,
) -> F64_1:
    means = np.empty(len(where))
    for c in range(len(where)):
        total = sum_of = 0.0
        for _, _, beside in _around(grid, where, c, 2):
            total = total + weight[beside] * values[beside]
            sum_of = sum_of + weight[beside]
        means[c] = total / sum_of
    return means


def join_cells(grid: I32_2, where: I32_2, use: Mask_1) -> I32_1:
    body = np.where(use, np.arange(len(where)), -1)
    while True:
        before = body.copy()
        for c in np.flatnonzero(use):
            body[c] = min(
                body[beside] for _, _, beside in _around(grid, where, c, 1) if use[beside]
            )
        if (before == body).all():
            return body.astype(np.int32)


def low_plants(
    xyz_m: F32_3,
    above_m: F32_2,
    marks: U8_2,
    thresholds: SoilThresholds,
) -> Mask_2:
    size = thresholds.cell_m
    half = thresholds.half_m
    above = above_m.astype(np.float64)
    is_plant = above > thresholds.soil_m
    cells: dict[tuple[int, int], list[float]] = {}
    low = []
    for shot, (x, y, _) in _points(
        xyz_m, (above > thresholds.below_m) & (above <= thresholds.foot_m)
    ):
        if not (abs(x) < half - size and abs(y) < half - size):
            continue
        cell = int((x + half) / size), int((y + half) / size)
        low.append((shot, cell, math.sqrt(x * x + y * y)))
        if marks[shot] & ASKED:
            row = cells.setdefault(cell, [0.0] * 4)
            values = 1.0, float(marks[shot] & SMOOTH), above[shot], above[shot] * above[shot]
            cells[cell] = [a + b for a, b in zip(row, values, strict=True)]
    for shot, (p, q), far in low:
        if (p, q) not in cells:
            continue
        near = [
            cells[p + dp, q + dq]
            for dp in (-1, 0, 1)
            for dq in (-1, 0, 1)
            if (p + dp, q + dq) in cells
        ]
        n, smooth, height, square = (sum(column) for column in zip(*near, strict=True))
        if n < thresholds.shots:
            continue
        mean = height / n
        rough = min(math.sqrt(max(square / n - mean * mean, 0.0)), thresholds.most_rough_m)
        score = thresholds.bias + thresholds.smooth * smooth / n + thresholds.rough * rough
        is_plant[shot] = (
            score
            + thresholds.high * max(above[shot], thresholds.least_high_m)
            + thresholds.far * far
            > 0.0
        )
    return is_plant
