"""Tells whether a dump without layout holds points, as frames of spinning scanners are often stored."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prc_cli.core.files import open_to_read

SAMPLE = 4096
"""Points that are looked at."""
LEAST = 64
"""Fewer tell nothing."""
FARTHEST_M = 300.0
"""Beyond the range of spinning scanners [m]."""
NEAREST_M = 0.3
"""Points of frames are hardly nearer to the scanner [m]."""
MOST_ODD = 0.01
"""Share of points that may be otherwise."""


def is_frame(path: Path) -> bool:
    """Whether a file is float32 x, y, z [m] and an intensity from 0 to 1, as KITTI stores its frames.

    Ranges alone are not: in every group of four the last would be from 0 to 1 m, and the others beside the scanner.
    """
    if path.stat().st_size % 16:
        return False
    with open_to_read(path) as handle:
        found = np.frombuffer(handle.read(16 * SAMPLE), "<f4").reshape(-1, 4).astype(np.float64)
    if len(found) < LEAST:
        return False
    with np.errstate(invalid="ignore", over="ignore"):
        far_m = np.sqrt((found[:, :3] ** 2).sum(axis=1))
        is_point = (far_m > NEAREST_M) & (far_m < FARTHEST_M) & (found[:, 3] >= 0) & (found[:, 3] <= 1)
        # coordinates lie on both sides of the scanner, ranges do not
        both = (found[:, :3] < 0).any() and (found[:, :3] > 0).any()
    return bool(both) and float(np.count_nonzero(~is_point)) <= MOST_ODD * len(found)
