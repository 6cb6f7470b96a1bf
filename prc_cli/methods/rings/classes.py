"""The label of every shot: ground by its height, everything else by its cell, a column of space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import Reason
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, F64, I32, I64, U8, Mask
from prc_cli.methods.rings import cells_loops
from prc_cli.methods.rings.cells_loops import (
    SMOOTH,
    TOP_LEVEL,
    join_cells,
    mean_around,
    measure_cells,
)
from prc_cli.methods.rings.ground import Polar
from prc_cli.methods.rings.thresholds import (
    BINS_PER_ROOT_M,
    BoxThresholds,
    CellThresholds,
    Limits,
    SunkenThresholds,
)

UNIFORM = 12.0**0.5
"""Length of an evenly spread body, in its standard deviations."""
FEWEST_INTENSITIES = 16
MOST_EQUAL = 0.9
"""Intensities with fewer values, or with a larger share of equal ones, are not used."""
N_LEVELS = TOP_LEVEL + 2
"""Levels of height of a cell, and one more."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Columns of space with shots above the ground."""

    grid: I32
    """(n, n) int32, number of the cell, -1 = none."""
    of_shot: I32
    """(lines, M) int32, the same of every shot."""
    where: I32
    """(cells, 2) int32, place of a cell in the grid."""
    sums: F64
    """(cells, 9) float64, shots, their places and marks."""
    levels: I64
    """(cells,) int64, levels of height with shots, one bit each."""
    measures: F64
    """(cells, 8) float64; see :func:`cells_loops.measure_cells`."""

    def of_shots(self, values: F64) -> F32:
        """Return the value of the cell of every shot, (lines, M) float32; NaN = in no cell.

        ``values`` (cells,) float64.
        """
        values_of_shots: F32 = np.append(values, np.nan).astype(np.float32)[self.of_shot]
        return values_of_shots


@stage("marks")
def mark_shots(polar: Polar, above_m: F32, limits: Limits) -> U8:
    """Mark shots by the surfaces around them; see :func:`cells_loops.mark_shots`."""
    marks: U8 = cells_loops.mark_shots(
        polar.xyz_m,
        polar.place,
        above_m,
        limits.cells.foot_m,
        BINS_PER_ROOT_M,
        polar.step_rad,
        limits.marks,
    )
    return marks


@stage("flakes")
def lonely_shots(range_m: F32, intensity: F32 | None, limits: Limits) -> Mask:
    """Mark snow, rain and dust; see :func:`cells_loops.lonely_shots`."""
    is_lit = intensity is not None and is_varied(intensity)
    light = intensity if intensity is not None and is_lit else np.zeros((1, 1), np.float32)
    lonely: Mask = cells_loops.lonely_shots(
        range_m, np.ascontiguousarray(light, np.float32), is_lit, limits.lonely
    )
    return lonely


def is_varied(intensity: F32) -> bool:
    """Return whether intensities, (lines, M) float32, have many values, and none for most shots.

    >>> is_varied(np.full((9, 9), 255.0, np.float32)), is_varied(np.arange(81, dtype=np.float32))
    (False, True)
    """
    known = np.sort(intensity[np.isfinite(intensity)])
    if not len(known) or not known[-1] > 0.0:
        return False
    first_of_value = np.flatnonzero(np.diff(known, prepend=known[0] - 1.0))
    n_values = len(first_of_value)
    most = int(np.diff(first_of_value, append=len(known)).max())
    return n_values >= min(FEWEST_INTENSITIES, len(known) // 2) and most < MOST_EQUAL * len(known)


@stage("mirror")
def sunken_shots(polar: Polar, above_m: F32, limits: SunkenThresholds) -> Mask:
    """Mark mirror images, (lines, M) bool: shots well below the ground among shots that are not."""
    with np.errstate(invalid="ignore"):
        far_m = (polar.place / np.float32(BINS_PER_ROOT_M)) ** 2
        below: Mask = above_m < -limits.below_m - limits.below_per_m * far_m
    if not below.any():
        return below
    n_below = _sum_around(below.astype(np.int16), limits)
    n_known = _sum_around(np.isfinite(above_m).astype(np.int16), limits)
    sunken: Mask = below & (n_below < limits.most * n_known)
    return sunken


def _sum_around(values: NDArray[np.int16], limits: SunkenThresholds) -> NDArray[np.int16]:
    """Return the sums over the window around every shot."""
    sums = values
    for axis, reach in ((0, limits.lines), (1, limits.rings)):
        padding = [(0, 0), (0, 0)]
        padding[axis] = (reach + 1, reach)
        sums_before = np.cumsum(np.pad(sums, padding), axis=axis, dtype=np.int64)
        first = np.arange(sums.shape[axis])
        end = first + 2 * reach + 1
        in_window = np.take(sums_before, end, axis=axis) - np.take(sums_before, first, axis=axis)
        sums = in_window.astype(np.int16)
    return sums


@stage("cells")
def fill_cells(
    polar: Polar,
    above_m: F32,
    marks: U8,
    lonely: Mask,
    thresholds: CellThresholds,
) -> Cells:
    """Sum up and measure the shots of every column of space."""
    levels, sums, where, grid, of_shot = cells_loops.fill_cells(
        polar.xyz_m, above_m, marks, lonely, thresholds
    )
    measures = measure_cells(grid, where, sums, levels, thresholds)
    return Cells(grid, of_shot, where, sums, levels, measures)


@stage("bodies")
def label_cells(cells: Cells, sight_m: F64, limits: Limits) -> U8:
    """Return the rule of every cell, (cells,) uint8.

    ``sight_m`` (cells,) float64, height above the ground up to which rings look at the place of a
    cell.
    """
    rules = np.where(is_foliage(cells, limits), Reason.ROUGH_PLACE, Reason.THIN_SMOOTH).astype(
        np.uint8
    )
    long_m = cells.measures[:, 1]
    top = cells.measures[:, 5] * limits.cells.storey_m
    around = cells.measures[:, 6]
    poles = limits.poles
    is_thin: Mask = (long_m < poles.thin_m) & (top >= poles.least_m) & (around <= poles.around)
    rules[is_thin & (cells.sums[:, 0] >= poles.shots)] = Reason.THIN_PLACE
    large = Bodies.of(cells, limits.lorries.body_m, sight_m, limits.cells)
    small = Bodies.of(cells, limits.cars.body_m, sight_m, limits.cells)
    rules[large.are(limits.lorries, limits.cells.storey_m)] = Reason.LARGE_BOX
    for box in (limits.vans, limits.cars):
        rules[small.are(box, limits.cells.storey_m)] = Reason.CAR_BOX
    return rules


def is_foliage(cells: Cells, limits: Limits) -> Mask:
    """Return which cells contain foliage rather than walls, (cells,) bool."""
    # thickness [m], length [m], upright and smooth share, levels with shots and the highest one
    thick, _, upright, smooth, n_levels, top, _, _ = cells.measures.T
    weights = limits.leaves
    score = (
        weights.bias
        + weights.smooth * smooth
        + weights.thick * np.minimum(thick, weights.most_thick_m)
        + weights.upright * upright
    )
    score = score + weights.filled * n_levels / np.maximum(top, 1.0)
    score = score + weights.top * np.minimum(top * limits.cells.storey_m, weights.most_top_m)
    surest = np.clip(score, -weights.surest, weights.surest)
    foliage: Mask = mean_around(cells.grid, cells.where, surest, np.sqrt(cells.sums[:, 0])) > 0
    return foliage


@dataclass(frozen=True, slots=True, eq=False)
class Bodies:
    """Objects in adjacent cells, up to a height."""

    is_low: Mask
    """(cells,) bool, whether a cell is part of one."""
    of_cell: NDArray[np.intp]
    """(low cells,) number of the body."""
    shots: F64
    """(bodies,) float64, number of shots; the others likewise."""
    length_m: F64
    width_m: F64
    smooth: F64
    upright: F64
    counts: F64
    """(bodies, levels) float64, shots by the height of their cell, added up from the ground."""
    sight_m: F64
    """Height up to which rings look at it [m]."""

    @classmethod
    def of(
        cls,
        cells: Cells,
        body_m: float,
        sight_m: F64,
        thresholds: CellThresholds,
    ) -> Bodies:
        """Join the cells whose bodies are not higher than a limit [m]."""
        levels = cells.measures[:, 7].astype(np.int64)
        is_low = (levels > 0) & (levels * thresholds.storey_m <= body_m)
        body = join_cells(cells.grid, cells.where, is_low)
        # bodies have the number of their first cell
        number = np.cumsum(body == np.arange(len(body))) - 1
        of_cell = number[body[is_low]]
        n_bodies = int(number[-1]) + 1 if len(number) else 0
        sums = _sums_of(cells, is_low, of_cell, n_bodies, thresholds.cell_m)
        n = sums[:, 0]
        x = sums[:, 1] / n
        y = sums[:, 2] / n
        xx = sums[:, 3] / n - x * x
        xy = sums[:, 4] / n - x * y
        yy = sums[:, 5] / n - y * y
        half = 0.5 * (xx + yy)
        away = np.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
        bin_of_cell = of_cell * N_LEVELS + levels[is_low]
        counts = np.bincount(bin_of_cell, cells.sums[is_low, 0], n_bodies * N_LEVELS)
        sight = np.full(n_bodies, np.inf)
        np.minimum.at(sight, of_cell, sight_m[is_low])
        return cls(
            is_low=is_low,
            of_cell=of_cell,
            shots=n,
            length_m=UNIFORM * np.sqrt(np.maximum(half + away, 0.0)),
            width_m=UNIFORM * np.sqrt(np.maximum(half - away, 0.0)),
            smooth=sums[:, 6] / np.maximum(sums[:, 7], 1.0),
            upright=sums[:, 8] / n,
            counts=np.cumsum(counts.reshape(-1, N_LEVELS), axis=1),
            sight_m=sight,
        )

    def are(self, box: BoxThresholds, storey_m: float) -> Mask:
        """Return which cells are part of a body of a vehicle's size with a visible top."""
        top = np.argmax(self.counts >= box.most_share * self.shots[:, None], axis=1) * storey_m
        is_box = (self.shots >= box.shots) & (self.sight_m - top >= box.seen_m)
        is_box &= (top >= box.least_top_m) & (top <= box.most_top_m)
        is_box &= (self.length_m >= box.least_m) & (self.length_m <= box.most_m)
        is_box &= (self.width_m >= box.narrow_m) & (self.width_m <= box.wide_m)
        is_box &= (self.smooth >= box.smooth) & (self.smooth <= box.most_smooth)
        is_box &= (self.upright >= box.upright) & (self.upright <= 1.0)
        is_box &= self.length_m >= box.squat * top
        is_part = np.zeros(len(self.is_low), np.bool_)
        is_part[self.is_low] = is_box[self.of_cell]
        return is_part


def _sums_of(
    cells: Cells,
    is_low: Mask,
    of_cell: NDArray[np.intp],
    n_bodies: int,
    cell_m: float,
) -> F64:
    """Return the sums of bodies, (bodies, 9) float64, with places from the grid's corner [m]."""
    sums = cells.sums[is_low]
    place = (cells.where[is_low] + 0.5) * cell_m
    n = sums[:, 0]
    x = sums[:, 1]
    y = sums[:, 2]
    moved = sums.copy()
    moved[:, 1] = x + n * place[:, 0]
    moved[:, 2] = y + n * place[:, 1]
    moved[:, 3] += 2 * place[:, 0] * x + n * place[:, 0] ** 2
    moved[:, 4] += place[:, 0] * y + place[:, 1] * x + n * place[:, 0] * place[:, 1]
    moved[:, 5] += 2 * place[:, 1] * y + n * place[:, 1] ** 2
    return np.stack([np.bincount(of_cell, column, n_bodies) for column in moved.T], axis=1)


@stage("soil")
def low_plants(
    polar: Polar,
    above_m: F32,
    marks: U8,
    limits: Limits,
) -> Mask:
    """Mark the plants among low shots; see :func:`cells_loops.low_plants`."""
    is_plant: Mask = cells_loops.low_plants(polar.xyz_m, above_m, marks, limits.soil)
    return is_plant


@stage("labels")
def label_shots(
    above_m: F32,
    marks: U8,
    lonely: Mask,
    sunken: Mask,
    plants: Mask,
    cells: Cells,
    cell_rules: U8,
    limits: Limits,
) -> U8:
    """Return the rule that gives every shot its label, (lines, M) uint8."""
    has_cell = cells.of_shot >= 0
    of_cell = np.append(cell_rules, np.uint8(0))[cells.of_shot]
    surface = np.uint8(Reason.SURFACE)
    plant = np.uint8(Reason.LOW_PLANT)
    thin = np.uint8(Reason.THIN_SMOOTH)
    rough = np.uint8(Reason.ROUGH_PLACE)
    flake = np.uint8(Reason.FLAKE)
    high = np.where(has_cell, of_cell, np.where(marks & SMOOTH, thin, rough))
    low = np.where(plants, np.where(has_cell, of_cell, plant), surface)
    rules = np.where(above_m <= limits.soil.foot_m, low, high)
    rules = np.where((lonely & (above_m > limits.cells.hem_m)) | sunken, flake, rules)
    return np.where(np.isnan(above_m), np.uint8(Reason.MISSING), rules)
