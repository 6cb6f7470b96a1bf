"""The label of every shot: ground by its height, everything else by the column of space that it stands in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prc_cli import kernels
from prc_cli.core.classes import Reason
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, F64, I32, I64, U8, Mask
from prc_cli.methods.rings.ground import Polar
from prc_cli.methods.rings.thresholds import BINS_PER_ROOT_M, BoxThresholds, CellThresholds, Limits

UNIFORM = 12.0**0.5
"""Length of what is evenly spread, in its standard deviations."""
SMOOTH, ASKED = 1, 2
"""Bits of marks, as in :mod:`cells_loops`."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Columns of space in which something stands."""

    grid: I32
    """(n, n) int32, number of the cell, -1 = none."""
    of_shot: I32
    """(lines, M) int32, the same of every shot."""
    where: I32
    """(cells, 2) int32, place in the grid."""
    sums: F64
    """(cells, 9) float64, shots, their places and marks."""
    levels: I64
    """(cells,) int64, levels of height with shots, one bit each."""
    measures: F64
    """(cells, 7) float64; see :func:`cells_loops.measure_cells`."""

    def of_shots(self, values: F64) -> F32:
        """Return values of the cells, (cells,) float64, by shot; NaN where it is in none."""
        found: F32 = np.append(values, np.nan).astype(np.float32)[self.of_shot]
        return found


@stage("marks")
def mark_shots(polar: Polar, above_m: F32, limits: Limits) -> U8:
    """Mark what stands on the ground; see :func:`cells_loops.mark_shots`."""
    marks: U8 = kernels.mark_shots(
        polar.xyz_m, polar.place, above_m, limits.cells.foot_m, BINS_PER_ROOT_M, polar.step_rad, limits.marks
    )
    return marks


@stage("flakes")
def lonely_shots(range_m: F32, intensity: F32 | None, limits: Limits) -> Mask:
    """Mark snow, rain and dust; see :func:`cells_loops.lonely_shots`."""
    is_lit = intensity is not None and bool(np.nanmax(intensity, initial=0.0) > 0.0)
    light = intensity if intensity is not None and is_lit else np.zeros((1, 1), np.float32)
    found: Mask = kernels.lonely_shots(range_m, np.ascontiguousarray(light, np.float32), is_lit, limits.lonely)
    return found


@stage("cells")
def fill_cells(polar: Polar, above_m: F32, marks: U8, lonely: Mask, thresholds: CellThresholds) -> Cells:
    """Sum up and measure what stands in every column of space."""
    grid, of_shot, where, sums, levels = kernels.fill_cells(polar.xyz_m, above_m, marks, lonely, thresholds)
    measures = kernels.measure_cells(grid, where, sums, levels, thresholds.cell_m)
    return Cells(grid, of_shot, where, sums, levels, measures)


@stage("bodies")
def label_cells(cells: Cells, sight_m: F64, limits: Limits) -> U8:
    """Return the rule of every cell, (cells,) uint8.

    ``sight_m`` (cells,) float64, height above the ground up to which rings look at the place of a cell.
    """
    rules = np.where(is_foliage(cells, limits), Reason.ROUGH_PLACE, Reason.THIN_SMOOTH).astype(np.uint8)
    rules[_is_pole(cells, limits)] = Reason.THIN_PLACE
    boxes = ((limits.lorries, Reason.LARGE_BOX), (limits.vans, Reason.CAR_BOX), (limits.cars, Reason.CAR_BOX))
    for box, reason in boxes:
        rules[_is_in_box(cells, sight_m, box, limits.cells)] = reason
    return rules


def is_foliage(cells: Cells, limits: Limits) -> Mask:
    """Return which cells hold foliage rather than walls, (cells,) bool."""
    thick, _, upright, smooth, n_levels, top, _ = cells.measures.T
    own = limits.leaves
    score = own.bias + own.smooth * smooth + own.thick * np.minimum(thick, own.most_thick_m) + own.upright * upright
    score = score + own.filled * n_levels / np.maximum(top, 1.0)
    score = score + own.top * np.minimum(top * limits.cells.storey_m, own.most_top_m)
    foliage: Mask = score > 0
    return foliage


def _is_pole(cells: Cells, limits: Limits) -> Mask:
    """Return which cells are thin to all sides, high, and alone."""
    long_m, top, around = cells.measures[:, 1], cells.measures[:, 5] * limits.cells.storey_m, cells.measures[:, 6]
    own = limits.poles
    found: Mask = (long_m < own.thin_m) & (top >= own.least_m) & (around <= own.around)
    return found & (cells.sums[:, 0] >= own.shots)


def _is_in_box(cells: Cells, sight_m: F64, box: BoxThresholds, thresholds: CellThresholds) -> Mask:
    """Return which cells are part of a body of a vehicle's size whose top is seen."""
    body_m = body_tops(cells.levels, round(box.gap_m / thresholds.storey_m)) * thresholds.storey_m
    is_low = (body_m > 0) & (body_m <= box.body_m)
    body = kernels.join_cells(cells.grid, cells.where, is_low)
    found = np.zeros(len(body), np.bool_)
    if not is_low.any():
        return found
    first, of_body = np.unique(body[is_low], return_inverse=True)
    sums = _sums_of(cells, is_low, of_body, len(first), thresholds.cell_m)
    n = sums[:, 0]
    x, y = sums[:, 1] / n, sums[:, 2] / n
    xx, xy, yy = sums[:, 3] / n - x * x, sums[:, 4] / n - x * y, sums[:, 5] / n - y * y
    half, away = 0.5 * (xx + yy), np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    length, width = (UNIFORM * np.sqrt(np.maximum(half + sign * away, 0.0)) for sign in (1.0, -1.0))
    top, sight = np.zeros(len(first)), np.full(len(first), np.inf)
    np.maximum.at(top, of_body, body_m[is_low])
    np.minimum.at(sight, of_body, sight_m[is_low])
    smooth = sums[:, 6] / np.maximum(sums[:, 7], 1.0)
    is_box = (n >= box.shots) & (top >= box.least_top_m) & (top <= box.most_top_m) & (sight - top >= box.seen_m)
    is_box &= (length >= box.least_m) & (length <= box.most_m) & (length >= box.squat * top)
    is_box &= sums[:, 8] >= box.upright * n
    is_box &= (width >= box.narrow_m) & (width <= box.wide_m) & (smooth >= box.smooth) & (smooth <= box.most_smooth)
    found[is_low] = is_box[of_body]
    return found


def _sums_of(cells: Cells, use: Mask, of_body: NDArray[np.intp], n_bodies: int, cell_m: float) -> F64:
    """Return the sums of bodies, (bodies, 9) float64, places from the corner of the grid [m]."""
    own, place = cells.sums[use], (cells.where[use] + 0.5) * cell_m
    n, x, y = own[:, 0], own[:, 1], own[:, 2]
    moved = own.copy()
    moved[:, 1], moved[:, 2] = x + n * place[:, 0], y + n * place[:, 1]
    moved[:, 3] += 2 * place[:, 0] * x + n * place[:, 0] ** 2
    moved[:, 4] += place[:, 0] * y + place[:, 1] * x + n * place[:, 0] * place[:, 1]
    moved[:, 5] += 2 * place[:, 1] * y + n * place[:, 1] ** 2
    return np.stack([np.bincount(of_body, column, n_bodies) for column in moved.T], axis=1)


def body_tops(levels: I64, gap: int) -> I64:
    """Return the first level above what stands on the ground without a gap, (cells,) int64; 0 = it hangs.

    A car, and above a gap of eight levels a crown:

    >>> body_tops(np.array([0b11_00000000_11110, 0b1000000]), 3).tolist()
    [5, 0]
    """
    top, misses = np.zeros(len(levels), np.int64), np.zeros(len(levels), np.int64)
    for level in range(62):
        there = (levels >> level & 1).astype(np.bool_)
        misses = np.where(there & (misses <= gap), 0, misses + 1)
        top = np.where(misses == 0, level + 1, top)
    return top


@stage("soil")
def low_plants(polar: Polar, above_m: F32, marks: U8, limits: Limits) -> Mask:
    """Mark the plants among low shots; see :func:`cells_loops.low_plants`."""
    found: Mask = kernels.low_plants(polar.xyz_m, above_m, marks, limits.soil)
    return found


@stage("labels")
def label_shots(
    above_m: F32, marks: U8, lonely: Mask, plants: Mask, cells: Cells, cell_rules: U8, limits: Limits
) -> U8:
    """Return the rule that gives every shot its label, (lines, M) uint8."""
    rules = np.where(marks & SMOOTH, Reason.THIN_SMOOTH, Reason.ROUGH_PLACE).astype(np.uint8)
    is_low = above_m <= limits.soil.foot_m
    rules[is_low] = np.where(plants[is_low], Reason.LOW_PLANT, Reason.SURFACE)
    has_cell = (cells.of_shot >= 0) & (~is_low | plants)
    rules[has_cell] = cell_rules[cells.of_shot[has_cell]]
    rules[lonely & (above_m > limits.cells.hem_m)] = Reason.FLAKE
    rules[np.isnan(above_m)] = Reason.MISSING
    return rules
