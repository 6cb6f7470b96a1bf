"""Half-lines, lines with possible cars, high verticals, and classes.

Stamos et al. (2012), sec. 3, 7 and 8.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from prc_cli.core.classes import Label, Surface
from prc_cli.core.types import F32, F64, I32, U8, Mask


def first_high_verticals(
    surface: U8,
    xyz_m: F32,
    n_beams: I32,
    ground_m: F32,
    height_m: float,
) -> I32:
    """Find the first high vertical run; see :func:`labels_loops.first_high_verticals`."""
    beam = np.full(len(n_beams), -1, np.int32)
    for row, n in enumerate(n_beams):
        vertical = surface[row, :n] == Surface.VERTICAL
        ends = np.flatnonzero(vertical & ~np.append(vertical[1:], False))
        high = ends[xyz_m[row, ends, 2].astype(np.float64) > float(ground_m[row]) + height_m]
        if len(high):
            beam[row] = high[0]
    return beam


STATE = {Surface.HORIZONTAL: "H", Surface.VERTICAL: "V", Surface.MISSING: "M"}
"""State of the chain by surface code; all other codes end it."""


def first_triggers(
    surface: U8,
    n_beams: I32,
    increments: F64,
    threshold: float,
) -> I32:
    """Find the first trigger of every row; see :func:`labels_loops.first_triggers`."""
    beams = np.full(len(n_beams), -1, np.int32)
    for row, n in enumerate(n_beams):
        codes = surface[row, :n]
        returns = np.flatnonzero(codes)
        if len(returns) == 0:
            continue
        first = int(returns[0])
        states = "".join(STATE.get(Surface(code), "x") for code in codes[first:])
        chain, _, _ = states.partition("x")
        total = 0.0
        for position, (before, after) in enumerate(pairwise(chain), start=1):
            step = float(increments["HVM".index(before), "HVM".index(after)])
            total = total + step if total + step > 0 else 0.0
            if total > threshold:
                beams[row] = first + position
                break
    return beams


def arrange_lines(
    range_m: F32,
    xyz_m: F32,
    columns: I32,
    max_range_m: float,
) -> tuple[F32, F32, F32]:
    """Pick beams; see :func:`labels_loops.arrange_lines`."""
    shots = np.concatenate([range_m[:, :, None], xyz_m], axis=2)
    with np.errstate(invalid="ignore"):
        is_within = shots[:, :, 0].astype(np.float64) <= max_range_m
    is_within &= ~np.isnan(xyz_m).any(axis=2)
    shots[~is_within] = np.nan
    rows = np.concatenate([shots[:, side] for side in columns], axis=1)
    has_no_column = np.tile(columns.ravel() < 0, (len(range_m), 1))
    rows[has_no_column] = np.nan
    rows = rows.reshape(-1, columns.shape[1], 4)
    plan = rows[:, :, 1:3].astype(np.float64)
    horizontal = np.sqrt((plan * plan).sum(axis=2)).astype(np.float32)
    return np.ascontiguousarray(rows[:, :, 0]), np.ascontiguousarray(rows[:, :, 1:]), horizontal


def arrange_plane(
    range_m: F32,
    across: F64,
    up: F64,
    columns: I32,
    max_range_m: float,
) -> tuple[F32, F32, F32]:
    """Pick beams; see :func:`labels_loops.arrange_plane`."""
    r = range_m.astype(np.float64)
    x = r * across
    xyz = np.stack([x, np.where(np.isnan(x), np.nan, 0.0), r * up], axis=2).astype(np.float32)
    return arrange_lines(range_m, xyz, columns, max_range_m)


def mark_cars(
    intervals: I32,
    horizontal_m: F32,
    xyz_m: F32,
    surface: U8,
    limit_m: F32,
    low_m: F32,
) -> Mask:
    """Mark the returns of intervals; see :func:`labels_loops.mark_cars`."""
    inside = np.zeros(surface.shape, np.bool_)
    for row, first, last in intervals.tolist():
        inside[row, first : last + 1] = True
    is_low = np.less(xyz_m[..., 2], low_m[:, None])
    on_ground = np.logical_and(is_low, surface == Surface.HORIZONTAL)
    near = np.less_equal(horizontal_m, limit_m[:, None])
    marked: Mask = inside & near & ~on_ground
    return marked


def combine_classes(
    surface: U8,
    ground: Mask,
    car: Mask,
    horizontal_m: F32,
    curb: Mask,
    label_of: U8,
) -> U8:
    """Combine layers; see :func:`labels_loops.combine_classes`."""
    labels: U8 = np.take(label_of, surface)
    labels[ground] = Label.GROUND
    for row, on_curb in enumerate(curb):
        # cars behind the nearest point of a curb are none
        nearest = np.min(horizontal_m[row, on_curb], initial=np.inf)
        labels[row, car[row] & ~(horizontal_m[row] > nearest)] = Label.CAR
    labels[curb] = Label.CURB
    return labels


def mark_beyond(range_m: F32, labels: U8) -> tuple[U8, int]:
    """Mark returns beyond the reach; see :func:`labels_loops.mark_beyond`."""
    beyond = np.logical_and(labels == Label.MISSING, ~np.isnan(range_m))
    marked = np.where(beyond, np.uint8(Label.UNCLASSIFIED), labels)
    return marked, int(np.count_nonzero(beyond))
