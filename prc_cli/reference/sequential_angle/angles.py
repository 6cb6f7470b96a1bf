"""The signed angle of every shot, its differences, and the line angle.

Stamos et al. (2012), sec. 3 and 7.1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import Surface
from prc_cli.core.types import F32, F64, I32, U8
from prc_cli.methods.sequential_angle.thresholds import ChordThresholds


def signed_angles(
    range_m: F32,
    xyz_m: F32,
    n_beams: I32,
    thresholds: ChordThresholds,
) -> tuple[F32, I32]:
    """Measure sV: angles of chords with the vertical, negative if a chord turns back."""
    signed_deg = np.full(range_m.shape, np.nan, np.float32)
    ahead = np.full(range_m.shape, -1, np.int32)
    for row in range(len(range_m)):
        valid = [k for k in range(n_beams[row]) if np.isfinite(range_m[row, k])]
        points = xyz_m[row].astype(np.float64)
        for i, k in enumerate(valid):
            after = first_far(points, k, valid[i + 1 :], thresholds)
            before = first_far(points, k, valid[:i][::-1], thresholds)
            if after is None:
                continue
            chord = points[after] - points[k]
            angle = np.degrees(np.arctan2(np.hypot(chord[0], chord[1]), chord[2]))
            turned_back = before is not None and np.dot(chord, points[k] - points[before]) < 0
            signed_deg[row, k] = -angle if turned_back else angle
            ahead[row, k] = after
    return signed_deg, ahead


def first_far(
    points: F64,
    here: int,
    others: list[int],
    thresholds: ChordThresholds,
) -> int | None:
    """Return the first of some shots that is far enough away for a chord."""
    for shot in others[: thresholds.max_shots]:
        chord = points[shot] - points[here]
        length_squared = float(chord @ chord)
        if chord.any() and length_squared >= thresholds.least_chord_m**2:
            return shot
    return None


def angle_differences(signed_deg: F32) -> F32:
    """Subtract successive angles; see :func:`angles_loops.angle_differences`."""
    differences = np.full_like(signed_deg, np.nan)
    for row, angles in enumerate(signed_deg):
        there = np.flatnonzero(~np.isnan(angles))
        differences[row, there] = np.diff(angles[there], prepend=angles[there][:1])
    return differences


def line_angles(
    range_m: F32,
    ahead: I32,
    surface: U8,
    beam_rad: F64,
) -> F32:
    """Measure line angles; see :func:`angles_loops.line_angles`."""
    angles = np.full(range_m.shape, np.nan, np.float32)
    has_angle = (surface == Surface.HORIZONTAL) & (ahead >= 0)
    for row, k in np.argwhere(has_angle).tolist():
        side = beam_rad[row % len(beam_rad)]
        j = ahead[row, k]
        phi = angle_at_first(side[k], side[j], float(range_m[row, k]), float(range_m[row, j]))
        angles[row, k] = np.degrees(phi + side[k])
    return angles


def angle_at_first(
    first_rad: float,
    second_rad: float,
    first_m: float,
    second_m: float,
) -> float:
    """Return the angle between the chord of two shots and the beam to the first one [rad]."""
    first = place(first_rad, first_m)
    chord = place(second_rad, second_m) - first
    cross = first[0] * chord[1] - first[1] * chord[0]
    return float(np.arctan2(abs(cross), first @ chord))


def place(beam_rad: float, range_m: float) -> NDArray[np.float64]:
    """Return a shot in the plane of its line, (2,) float64 [m].

    The beam turns from the first axis to the second.
    """
    return range_m * np.array([np.cos(beam_rad), np.sin(beam_rad)])
