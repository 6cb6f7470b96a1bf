"""Finds out whether a raw dump is a frame of a spinning scanner, as KITTI and nuScenes have it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from prc_cli.core.files import open_to_read
from prc_cli.core.stream import MAX_RINGS
from prc_cli.core.types import F64, Mask

_EVEN = 0.9
_MAJORITY = 0.99
FRAME_BYTES = 1 << 22
"""Bytes at the start of a dump that are tested for a frame: more than a frame of 128 rings."""
LEAST_FRAME = 1000
"""A frame has at least this many records."""
STAGGERED_DEG = 10.0
"""Neighbouring azimuths of a frame differ by less.

The rings of Ouster's scanners are staggered by up to 6.4 deg.
"""
LEAST_KNOWN = 0.5
"""Least share of points that are numbers."""
LEAST_RINGS = 8
"""A frame has at least this many rings."""
FLAT_DEG = 0.5
"""Elevations of a ring scatter less."""
FRAME_REACH_M = 300.0
"""No coordinate of a frame lies beyond [m]."""
_SOME = 0.05

FRAME_FIELDS = ("x", "y", "z", "intensity", "ring", "time")
"""float32 numbers of a point of a frame: 4 in KITTI, 5 in nuScenes, 6 in Boreas."""


def is_frame(path: Path) -> bool:
    """Whether a dump is a frame of a spinning scanner: points of :data:`FRAME_FIELDS`."""
    return frame_fields(path) is not None


def frame_fields(path: Path) -> tuple[str, ...] | None:
    """Return the fields of the points of a frame; None for any other dump.

    The numbers are float32; points that did not return may be NaN or zero. Without numbers of rings
    the points are in the order of the rings, or of the firings.
    """
    with open_to_read(path) as handle:
        n_bytes = handle.seek(0, 2)
        handle.seek(0)
        head = handle.read(FRAME_BYTES)
    for n_fields in (4, 5, 6):
        size = 4 * n_fields
        if n_bytes % size or n_bytes < size * LEAST_FRAME:
            continue
        with np.errstate(invalid="ignore"):  # a signalling NaN
            rows = (
                np.frombuffer(head[: len(head) // size * size], "<f4")
                .reshape(-1, n_fields)
                .astype(np.float64)
            )
        if _are_points(rows):
            return FRAME_FIELDS[:n_fields]
    return None


def _are_points(rows: F64) -> bool:
    is_known = np.isfinite(rows).all(axis=1)
    if np.mean(is_known) < LEAST_KNOWN:
        return False
    rows = rows[is_known]
    if np.abs(rows[:, :3]).max() > FRAME_REACH_M:
        return False
    points = rows[rows[:, :3].any(axis=1)]
    x, y, z = points[:, :3].T
    distance = np.sqrt(x * x + y * y + z * z)
    if len(distance) < LEAST_FRAME:
        return False
    azimuth = np.arctan2(y, x)
    step = np.angle(np.exp(1j * np.diff(azimuth)))
    is_whole_turn = min(min(np.mean(axis < 0), np.mean(axis > 0)) for axis in (x, y)) > _SOME
    elevation = np.arctan2(z, np.hypot(x, y))
    return bool(
        rows[:, 3].min() >= 0
        and rows[:, 3].max() < 1 << 16
        and _mostly(distance > 0.5)
        and _mostly(np.abs(z) < 0.8 * distance)
        and (rows.shape[1] == 4 or _are_rings(rows[:, 4]))
        and np.mean(np.abs(step) < np.deg2rad(STAGGERED_DEG)) > _EVEN
        and (is_whole_turn or rows.shape[1] > 4 or _are_sweeps(azimuth, step, elevation))
    )


def _are_rings(numbers: F64) -> bool:
    n = len(np.unique(numbers))
    return bool(
        LEAST_RINGS <= n <= MAX_RINGS
        and (numbers == np.rint(numbers)).all()
        and (numbers >= 0).all()
    )


def _are_sweeps(azimuth: F64, step: F64, elevation: F64) -> bool:
    """Whether points of a sector are ring after ring: azimuths restart, elevations stay."""
    sense = np.sign(np.median(step[step != 0]))
    low, high = np.percentile(azimuth, [5, 95])
    back = np.flatnonzero(-sense * step > (high - low) / 2) + 1
    if not LEAST_RINGS <= len(back) + 1 <= MAX_RINGS:
        return False
    spreads = [np.std(part) for part in np.split(elevation, back) if len(part) > 1]
    return bool(np.median(spreads) < np.deg2rad(FLAT_DEG))


def _mostly(mask: Mask) -> bool:
    return bool(np.mean(mask) > _MAJORITY)
