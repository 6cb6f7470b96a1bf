"""Scan lines as half-lines from straight down upwards (Stamos et al. 2012, sec. 3)."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F32, F64, I32


def arrange_lines(range_m: F32, xyz_m: F32, columns: I32, max_range_m: float) -> tuple[F32, F32, F32]:
    """Pick beams; see :func:`lines_loops.arrange_lines`."""
    everything = np.concatenate([range_m[:, :, None], xyz_m], axis=2)
    with np.errstate(invalid="ignore"):
        seen = (everything[:, :, 0].astype(np.float64) <= max_range_m) & ~np.isnan(xyz_m).any(axis=2)
    everything[~seen] = np.nan
    rows = np.concatenate([everything[:, side] for side in columns], axis=1)
    rows[np.tile(columns.ravel() < 0, (len(range_m), 1))] = np.nan
    rows = rows.reshape(-1, columns.shape[1], 4)
    plan = rows[:, :, 1:3].astype(np.float64)
    horizontal = np.sqrt((plan * plan).sum(axis=2)).astype(np.float32)
    return np.ascontiguousarray(rows[:, :, 0]), np.ascontiguousarray(rows[:, :, 1:]), horizontal


def arrange_plane(range_m: F32, across: F64, up: F64, columns: I32, max_range_m: float) -> tuple[F32, F32, F32]:
    """Pick beams; see :func:`lines_loops.arrange_plane`."""
    r = range_m.astype(np.float64)
    x = r * across
    xyz = np.stack([x, np.where(np.isnan(x), np.nan, 0.0), r * up], axis=2).astype(np.float32)
    return arrange_lines(range_m, xyz, columns, max_range_m)
