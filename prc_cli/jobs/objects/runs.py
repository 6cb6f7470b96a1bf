"""Runs of shots of one object class in a scan line, with what is known of them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import Label
from prc_cli.core.stream import LabelledBlock
from prc_cli.core.types import F64, Mask

GAP_COLUMNS = 2
"""Shots of other classes, or without return, that a run may skip."""
JUMP_M = 0.5
"""Difference in range at which a run ends [m]."""


@dataclass(frozen=True, slots=True)
class Run:
    """Neighbouring shots of one class in a line; sums are over its shots."""

    line: int
    kind: Label
    n: int
    first_column: int
    last_column: int
    side_m: tuple[float, float]
    """Least and greatest distance to the side in the scan plane [m]; the sign is the side."""
    up_m: tuple[float, float]
    """Lowest and highest shot, above the scanner in the scan plane [m]."""
    sum_side_m: float
    sum_range_m: float
    sum_angle_rad: float
    least_range_m: float
    above_m: tuple[float, float]
    """The same above the ground [m]; NaN = unknown."""
    n_placed: int = 0
    """Shots with registered coordinates."""
    sum_xyz_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of their registered coordinates [m]."""
    sum_confidence: float = math.nan
    """Of their confidence [per cent]; NaN = not known."""


def runs_of(item: LabelledBlock, kinds: tuple[Label, ...], registered_m: F64 | None = None) -> Iterator[Run]:
    """Find the runs of a block, line by line."""
    block = item.block
    assert block.beam_rad is not None
    m = block.points_per_line
    at = np.flatnonzero(np.isin(item.labels.ravel(), kinds))
    if not len(at):
        return
    line, column = np.divmod(at, m)
    range_m = block.range_m.ravel()[at].astype(np.float64)
    label = item.labels.ravel()[at]
    beam = block.beam_rad[column]
    side, up = range_m * np.sin(beam), -range_m * np.cos(beam)
    above = np.full(len(at), np.nan) if item.above_m is None else item.above_m.ravel()[at].astype(np.float64)
    sure = np.full(len(at), np.nan) if item.confidence is None else item.confidence.ravel()[at].astype(np.float64)
    xyz = np.full((len(at), 3), np.nan) if registered_m is None else registered_m.reshape(-1, 3)[at]
    is_new = np.ones(len(at), np.bool_)
    is_new[1:] = (
        (np.diff(line) != 0)
        | (np.diff(column) > GAP_COLUMNS + 1)
        | (label[1:] != label[:-1])
        | (np.abs(np.diff(range_m)) > JUMP_M)
    )
    start = np.flatnonzero(is_new)
    n = np.diff(np.append(start, len(at)))
    placed: Mask = np.isfinite(xyz[:, 0]) & np.isfinite(xyz[:, 1]) & np.isfinite(xyz[:, 2])
    total = _sums(
        np.column_stack([side, range_m, beam, placed.astype(np.float64), np.where(placed[:, None], xyz, 0.0), sure]),
        start,
    )
    low = np.minimum.reduceat(np.column_stack([side, up, range_m]), start)
    high = np.maximum.reduceat(np.column_stack([side, up]), start)
    # fmin passes over what is not known
    lowest, highest = np.fmin.reduceat(above, start), np.fmax.reduceat(above, start)
    first, last = column[start], column[np.append(start[1:], len(at)) - 1]
    for i in range(len(start)):
        yield Run(
            line=block.first_line + int(line[start[i]]), kind=Label(int(label[start[i]])), n=int(n[i]),
            first_column=int(first[i]), last_column=int(last[i]),
            side_m=(float(low[i, 0]), float(high[i, 0])), up_m=(float(low[i, 1]), float(high[i, 1])),
            sum_side_m=float(total[i, 0]), sum_range_m=float(total[i, 1]), sum_angle_rad=float(total[i, 2]),
            least_range_m=float(low[i, 2]), above_m=(float(lowest[i]), float(highest[i])),
            n_placed=int(total[i, 3]), sum_xyz_m=(float(total[i, 4]), float(total[i, 5]), float(total[i, 6])),
            sum_confidence=float(total[i, 7]),
        )  # fmt: skip


def _sums(values: F64, start: NDArray[np.int64]) -> F64:
    found: F64 = np.add.reduceat(values, start)
    return found
