"""Objects above the ground in narrow strips beside the scanner.

Occupied heights, walls, low level surfaces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.profile import stage
from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.flanks_loops import find_flanks
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.records import FilledSlots, Neighbours, Walls
from prc_cli.methods.fused.strips_loops import (
    fill_strips,
    find_columns,
    find_walls,
    widen_levels,
    widen_slots,
)
from prc_cli.methods.fused.thresholds import Limits


@dataclass(frozen=True, slots=True, eq=False)
class Strips:
    """Objects above the ground beside the lines of a block."""

    slots: FilledSlots
    walls: Walls
    levels: U8
    """(lines, 2 strips) uint8, 1 = a low level surface, 17 = that of a body that hangs high."""
    kinds: U8
    """(lines, M) uint8, kind of free-standing thing that a shot is on, 0 = none."""

    def of_lines(self, lines: slice) -> Strips:
        """Return the strips of some lines."""
        return Strips(
            self.slots.of_lines(lines),
            self.walls.of_lines(lines),
            self.levels[lines],
            self.kinds[lines],
        )


@stage("strips")
def measure_strips(
    window_m: F32,
    above_m: F32,
    neighbours: Neighbours,
    plane: ScanPlane,
    limits: Limits,
) -> Strips:
    """Sort shots above the ground into strips, and combine five lines.

    ``window_m`` (lines + 4 + 2 n, M) float32, metres; ``above_m`` (lines + 4, M) float32, metres.
    """
    kinds = find_columns(window_m, above_m, neighbours, plane.beams, limits.columns)
    beside = (len(window_m) - len(above_m)) // 2
    range_m = window_m[beside : len(window_m) - beside]
    slots, sums, levels = fill_strips(
        range_m, above_m, neighbours, kinds, plane.beams, plane.step_rad, limits.strips
    )
    wide_levels = widen_levels(levels)
    flanks = np.zeros((len(wide_levels), sums.wall_m.shape[1]), np.uint8)
    if limits.flanks is not None:
        flanks, wide_levels = find_flanks(
            range_m,
            above_m,
            neighbours.upright,
            plane.beams,
            sums,
            slots.by_any,
            wide_levels,
            limits.flanks,
        )
    walls = find_walls(sums, flanks, limits.walls)
    wide_slots = FilledSlots(widen_slots(slots.by_any), widen_slots(slots.by_rough))
    return Strips(wide_slots, walls, wide_levels, kinds[2:-2])
