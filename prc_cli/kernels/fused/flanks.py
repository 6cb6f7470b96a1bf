"""Loop of the fused classifier that finds flanks of vehicles: upright surfaces with ground beneath them."""

from __future__ import annotations

import numpy as np

from prc_cli.core.thresholds.fused import FlankThresholds
from prc_cli.core.types import F32, I32, U8
from prc_cli.kernels.cache import helper, kernel
from prc_cli.kernels.fused.strips import LINES, STRIPS

BIN_M = np.float32(0.125)
"""Width of a bin of ground, a quarter of a strip [m]."""
BINS = 2 * STRIPS
"""Bins on either side."""
LEVEL_BIN_M = np.float32(0.25)
"""Width of a bin of level surfaces [m]."""
BODY_BINS = 6
"""Bins of level surfaces that are marked as the vehicle, from its flank on."""
FEWER = 4
"""Ground seen through the body is less than that beneath, divided by this."""
_FAR = np.float32(1e6)


@helper
def _count_ground(
    ranges: F32, above: F32, upright: U8, beams: tuple[F32, F32], soil_m: np.float32, bins: I32, depths: F32
) -> None:
    """Count the shots of the ground in every bin of a line, and write how deep it lies below the scanner."""
    sine, cosine = beams
    for q in range(2 * BINS):
        bins[q] = 0
    for i in range(len(ranges)):
        if (abs(above[i]) < soil_m) & (upright[i] <= 1):
            y = ranges[i] * sine[i]
            q = int(np.floor(min(max(y / BIN_M, -_FAR), _FAR))) + BINS
            if 0 <= q < 2 * BINS:
                bins[q] += 1
                depths[q] = ranges[i] * cosine[i]


@helper
def _add_around(values: F32, line: int, lines: F32, sums: F32) -> None:
    """Add up the values of five lines, and then of three strips."""
    for b in range(STRIPS):
        before = (values[line, b] + values[line + 1, b]) + values[line + 2, b]
        lines[b + 1] = (before + values[line + 3, b]) + values[line + 4, b]
    lines[0] = lines[STRIPS + 1] = np.float32(0.0)
    for b in range(STRIPS):
        sums[b] = (lines[b] + lines[b + 1]) + lines[b + 2]


@helper
def _is_upright(wall: F32, b: int) -> bool:
    """Return whether a line has something upright in a strip or beside it."""
    return bool(wall[b] > 0 or wall[max(b - 1, 0)] > 0 or wall[min(b + 1, STRIPS - 1)] > 0)


@helper
def _ground_behind(bins: I32, depths: F32, side: int, away: np.float32, thresholds: FlankThresholds) -> tuple[int, int]:
    """Count the ground that is seen beneath a body at a distance, and through it.

    By the height at which the line of sight passes the flank: below the sill, or above. At twice the distance of the
    flank it passes at half the height of the scanner.
    """
    beneath = beyond = 0
    first = min(int(min(away / BIN_M, _FAR)), BINS)
    for j in range(first, min(2 * first, BINS)):
        q = BINS + j if side == 0 else BINS - 1 - j
        if bins[q] == 0:
            continue
        passes = depths[q] * (np.float32(1.0) - away / ((np.float32(j) + np.float32(0.5)) * BIN_M))
        if passes > thresholds.body_m:
            break
        if thresholds.low_m <= passes <= thresholds.sill_m:
            beneath += bins[q]
        elif passes > thresholds.sill_m:
            beyond += bins[q]
    return beneath, beyond


@kernel(
    "Tuple((uint8[:, ::1], uint8[:, ::1]))(float32[:, ::1], float32[:, ::1], uint8[:, ::1], UniTuple(float32[::1], 2), "
    "UniTuple(float32[:, ::1], 3), uint8[:, ::1], FlankThresholds)",
    tuples=[FlankThresholds],
)
def find_flanks(
    range_m: F32,
    above_m: F32,
    upright: U8,
    beams: tuple[F32, F32],
    sums: tuple[F32, F32, F32],
    levels: U8,
    thresholds: FlankThresholds,
) -> tuple[U8, U8]:
    """Find strips with the flank of a vehicle: ground is seen right beneath it, and none farther behind.

    Parameters
    ----------
    range_m, above_m : (lines + 4, M) float32, metres
        Range and height above the ground; NaN = missing.
    upright : (lines + 4, M) uint8
        Upright chords.
    beams : tuple of (M,) float32
        Sine and cosine of every column's beam from straight down.
    sums : tuple of (lines + 4, STRIPS) float32
        Height extents of the shots of a strip, of the smooth upright ones, and those times their side
        (:func:`prc_cli.kernels.fused.strips.fill_strips`).
    levels : (lines, 2 STRIPS) uint8
        Bins with a level surface, widened.
    thresholds : FlankThresholds of float32

    Returns
    -------
    flanks : (lines, STRIPS) uint8
        1 = a flank, which is no wall.
    levels : (lines, 2 STRIPS) uint8
        With the bins of the vehicles behind flanks.
    """
    length, wall, place = sums
    n_lines = levels.shape[0]
    flanks, found = np.empty((n_lines, STRIPS), np.uint8), np.empty((n_lines, 2 * STRIPS), np.uint8)
    # ring buffer of lines
    room = 2 * LINES + 1
    bins, depths = np.empty((room, 2 * BINS), np.int32), np.empty((room, 2 * BINS), np.float32)
    lines, walls, places = np.empty(STRIPS + 2, np.float32), np.empty(STRIPS, np.float32), np.empty(STRIPS, np.float32)
    lengths = np.empty(STRIPS, np.float32)
    least, most = thresholds.least_m * np.float32(room), thresholds.most_m * np.float32(room)
    for k in range(n_lines + 2 * LINES):
        _count_ground(range_m[k], above_m[k], upright[k], beams, thresholds.soil_m, bins[k % room], depths[k % room])
        if k < 2 * LINES:
            continue
        line = k - 2 * LINES
        for q in range(2 * STRIPS):
            found[line, q] = levels[line, q]
        _add_around(length, line, lines, lengths)
        _add_around(wall, line, lines, walls)
        _add_around(place, line, lines, places)
        for b in range(STRIPS):
            flanks[line, b] = 0
            if walls[b] <= 0 or walls[b] < least or walls[b] > most or walls[b] < thresholds.share * lengths[b]:
                continue
            away = abs(places[b] / walls[b])
            side = 0 if b >= STRIPS // 2 else 1
            beneath = beyond = 0
            for c in range(line, line + room):
                # lines beside a post see the ground behind it
                if _is_upright(wall[c], b):
                    low, high = _ground_behind(bins[c % room], depths[c % room], side, away, thresholds)
                    beneath += low
                    beyond += high
            if np.float32(beneath) >= thresholds.shots and beyond * FEWER <= beneath:
                flanks[line, b] = 1
                at = int(min(away / LEVEL_BIN_M, _FAR))
                for j in range(at, min(at + BODY_BINS, STRIPS)):
                    found[line, STRIPS + j if side == 0 else STRIPS - 1 - j] = 1
    return flanks, found
