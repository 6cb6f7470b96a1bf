"""Objects above the ground in narrow strips beside the scanner.

Occupied heights, walls, low level surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prc_cli import kernels
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.neighbours import Neighbours
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.thresholds import Limits


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """Objects above the ground beside the lines of a block."""

    slots: tuple[NDArray[np.uint64], NDArray[np.uint64]]
    """(lines, strips) uint64, occupied heights by all shots and by rough shots, one bit per 0.25 m."""
    walls: tuple[F32, F32, F32]
    """(lines, strips) float32, distance and top of the wall in or before a strip.

    Distance of the wall in or behind.
    """
    levels: U8
    """(lines, 2 strips) uint8, 1 = a low level surface."""
    columns: U8
    """(lines, M) uint8, shots on trunks and posts, which lines on both sides see past."""


@stage("strips")
def stand(
    window_m: F32,
    above_m: F32,
    seen: Neighbours,
    plane: ScanPlane,
    limits: Limits,
) -> Standing:
    """Sort shots above the ground into strips, and combine five lines.

    ``window_m`` (lines + 4 + 2 n, M) float32, metres; ``above_m`` (lines + 4, M) float32, metres.
    """
    columns = kernels.find_columns(window_m, above_m, seen.counts, plane.beams, limits.columns)
    beside = (len(window_m) - len(above_m)) // 2
    range_m = window_m[beside : len(window_m) - beside]
    every, rough, length, wall, place, top, levels = kernels.fill_strips(
        range_m, above_m, seen.counts, columns, plane.beams, plane.step_rad, limits.strips
    )
    wide = kernels.widen_levels(levels)
    vehicles = np.zeros((len(wide), every.shape[1]), np.uint8)
    if limits.flanks is not None:
        vehicles, wide = kernels.find_flanks(
            range_m,
            above_m,
            seen.upright,
            plane.beams,
            (length, wall, place),
            every,
            wide,
            limits.flanks,
        )
    found = kernels.find_walls((length, wall, place, top), vehicles, limits.walls)
    return Standing(
        (kernels.widen_slots(every), kernels.widen_slots(rough)), found, wide, columns[2:-2]
    )
