"""Combines the results of all algorithms into classes (Stamos et al. 2012, sec. 7 and 8)."""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Label, Surface
from prc_cli.core.types import F32, I32, U8, Mask


def mark_cars(intervals: I32, horizontal_m: F32, xyz_m: F32, surface: U8, limit_m: F32, low_m: F32) -> Mask:
    """Mark the returns of intervals; see :func:`labels_loops.mark_cars`."""
    inside = np.zeros(surface.shape, np.bool_)
    for row, first, last in intervals.tolist():
        inside[row, first : last + 1] = True
    on_ground = np.logical_and(np.less(xyz_m[..., 2], low_m[:, None]), surface == Surface.HORIZONTAL)
    near = np.less_equal(horizontal_m, limit_m[:, None])
    marked: Mask = inside & near & ~on_ground
    return marked


def combine_classes(
    surface: U8, ground: Mask, car: Mask, horizontal_m: F32, xyz_m: F32, curb: Mask, label_of: U8, below_m: float
) -> U8:
    """Combine layers; see :func:`labels_loops.combine_classes`."""
    labels: U8 = np.take(label_of, surface)
    labels[ground] = Label.GROUND
    for row, here in enumerate(curb):
        if not here.any():
            labels[row, car[row]] = Label.CAR
            continue
        distance, height = horizontal_m[row].astype(np.float64), xyz_m[row, :, 2].astype(np.float64)
        nearest = distance[here].min()
        top = height[here & (distance - nearest <= 0.3)].max()
        for one in runs_of_cars(surface[row], car[row]):
            level = [k for k in range(one[0]) if surface[row, k] == Surface.HORIZONTAL and not car[row, k]]
            stands_on = min([*height[one].tolist(), *height[level[-1:]].tolist()])
            for k in one:
                if stands_on < top - below_m or not distance[k] > nearest:
                    labels[row, k] = Label.CAR
    labels[curb] = Label.CURB
    return labels


def runs_of_cars(surface: U8, car: Mask) -> list[list[int]]:
    """Return the car points of a line that nothing but missing points lies between, together."""
    found: list[list[int]] = [[]]
    for k, code in enumerate(surface):
        if car[k]:
            found[-1].append(k)
        elif code != Surface.MISSING and found[-1]:
            found.append([])
    return [run for run in found if run]


def mark_beyond(range_m: F32, labels: U8) -> tuple[U8, int]:
    """Mark returns beyond the reach; see :func:`labels_loops.mark_beyond`."""
    beyond = np.logical_and(labels == Label.MISSING, ~np.isnan(range_m))
    return np.where(beyond, np.uint8(Label.UNCLASSIFIED), labels), int(np.count_nonzero(beyond))
