"""Loop of the fused classifier that finds flanks of vehicles.

Upright surfaces with ground beneath them.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F32, F32_2, I32, U8, U8_2, U64, U64_2
from prc_cli.kernels.cache import helper, inlined, kernel
from prc_cli.methods.fused.records import (
    LORRY_BIN,
    SLOT_M,
    STRIP_M,
    STRIPS,
    Beams,
    StripSums,
)
from prc_cli.methods.fused.thresholds import FlankThresholds

BIN_M = np.float32(0.125)
"""Width of a bin of ground, a quarter of a strip [m]."""
LINES = 2
"""Lines before and after that are combined with a line."""
BINS = 2 * STRIPS
"""Bins on either side."""
LEVEL_BIN_M = np.float32(0.25)
"""Width of a bin of level surfaces [m]."""
BODY_BINS = 6
"""Bins of level surfaces that are marked as the vehicle, from its flank on."""
MOST_SLOTS = 12
"""Slots in which the bottom of a body is looked for."""
FEWER = 4
"""Ground seen through the body is less than that beneath, divided by this."""
_FAR = np.float32(1e6)


@helper
def _count_ground(
    ranges: F32,
    above: F32,
    upright: U8,
    beams: Beams,
    soil_m: np.float32,
    bins: I32,
    depths: F32,
) -> None:
    """Count ground shots by bin of a line; write their depth below the scanner."""
    sine, cosine = beams
    bins[:] = 0
    for i in range(len(ranges)):
        if (abs(above[i]) < soil_m) & (upright[i] <= 1):
            y = ranges[i] * sine[i]
            q = int(np.floor(min(max(y / BIN_M, -_FAR), _FAR))) + BINS
            if 0 <= q < 2 * BINS:
                bins[q] += 1
                depths[q] = ranges[i] * cosine[i]


@helper
def _add_around(
    values: F32,
    line: int,
    lines: F32,
    sums: F32,
) -> None:
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
def _ground_behind(
    bins: I32,
    depths: F32,
    side: int,
    away: np.float32,
    thresholds: FlankThresholds,
) -> tuple[int, int]:
    """Count the ground that is seen beneath a body at a distance, and through it.

    By the height at which the line of sight passes the flank: below the sill, or above. At twice
    the distance of the flank it passes at half the height of the scanner.
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


@inlined
def _bottom(slots: U64, b: int, away: np.float32) -> np.float32:
    """Return the height above ground of what a line sees at a flank, its foot included [m]."""
    half = STRIPS // 2
    strip = min(int(away / STRIP_M), half - 1)
    nearer = max(strip - 1, 0)
    word = (
        slots[half + strip] | slots[half + nearer]
        if b >= half
        else slots[half - 1 - strip] | slots[half - 1 - nearer]
    )
    slot = 0
    while slot < MOST_SLOTS and (word >> np.uint64(slot)) & np.uint64(1) == np.uint64(0):
        slot += 1
    return np.float32(slot) * SLOT_M


@helper
def _ground_below(
    bins: I32,
    depths: F32,
    side: int,
    away: np.float32,
    bottom: np.float32,
) -> tuple[int, int]:
    """Count ground seen below the bottom of a body, and ground seen through the body."""
    beneath = beyond = 0
    first = min(int(min(away / BIN_M, _FAR)), BINS)
    for j in range(first, min(2 * first, BINS)):
        q = BINS + j if side == 0 else BINS - 1 - j
        if bins[q] == 0:
            continue
        passes = depths[q] * (np.float32(1.0) - away / ((np.float32(j) + np.float32(0.5)) * BIN_M))
        if np.float32(0.5) * bottom <= passes <= bottom:
            beneath += bins[q]
        elif passes > bottom + SLOT_M:
            beyond += bins[q]
    return beneath, beyond


@kernel()
def find_flanks(
    range_m: F32_2,
    above_m: F32_2,
    upright: U8_2,
    beams: Beams,
    sums: StripSums,
    slots: U64_2,
    levels: U8_2,
    thresholds: FlankThresholds,
) -> tuple[U8_2, U8_2]:
    """Find strips with the flank of a vehicle.

    Ground is seen right beneath it, and none farther behind.

    ``range_m, above_m`` (lines + 4, M) float32, metres; ``upright`` (lines + 4, M) uint8; ``beams``
    (M,) float32; ``sums`` (lines + 4, STRIPS) float32; ``slots`` (lines + 4,
    STRIPS) uint64; ``levels`` (lines, 2 STRIPS) uint8; returns ``flanks`` (lines, STRIPS) uint8,
    ``levels`` (lines, 2 STRIPS) uint8.
    """
    wall = sums.wall_m
    n_lines = levels.shape[0]
    flanks = np.empty((n_lines, STRIPS), np.uint8)
    all_levels = np.empty((n_lines, 2 * STRIPS), np.uint8)
    # ring buffer of lines
    room = 2 * LINES + 1
    bins = np.empty((room, 2 * BINS), np.int32)
    depths = np.empty((room, 2 * BINS), np.float32)
    lines = np.empty(STRIPS + 2, np.float32)
    walls = np.empty(STRIPS, np.float32)
    places = np.empty(STRIPS, np.float32)
    lengths = np.empty(STRIPS, np.float32)
    least = thresholds.least_m * np.float32(room)
    most = thresholds.most_m * np.float32(room)
    for k in range(n_lines + 2 * LINES):
        _count_ground(
            range_m[k],
            above_m[k],
            upright[k],
            beams,
            thresholds.soil_m,
            bins[k % room],
            depths[k % room],
        )
        if k < 2 * LINES:
            continue
        line = k - 2 * LINES
        all_levels[line] = levels[line]
        _add_around(sums.length_m, line, lines, lengths)
        _add_around(wall, line, lines, walls)
        _add_around(sums.wall_place, line, lines, places)
        for b in range(STRIPS):
            flanks[line, b] = 0
            if (
                walls[b] <= 0
                or walls[b] < least
                or walls[b] > most
                or walls[b] < thresholds.share * lengths[b]
            ):
                continue
            away = abs(places[b] / walls[b])
            side = 0 if b >= STRIPS // 2 else 1
            beneath = beyond = below = through = 0
            lowest = _FAR
            highest = np.float32(0.0)
            for c in range(line, line + room):
                # lines beside a post see the ground behind it
                if not _is_upright(wall[c], b):
                    continue
                low, high = _ground_behind(bins[c % room], depths[c % room], side, away, thresholds)
                beneath += low
                beyond += high
                bottom = _bottom(slots[c], b, away)
                if thresholds.body_m <= bottom <= thresholds.high_m:
                    low, high = _ground_below(bins[c % room], depths[c % room], side, away, bottom)
                    below += low
                    through += high
                    lowest = min(lowest, bottom)
                    highest = max(highest, bottom)
            big = walls[b] >= thresholds.large_m * np.float32(room)
            is_low = np.float32(beneath) >= thresholds.shots and beyond * FEWER <= beneath
            # a slanted plane meets the edge of a house higher from line to line
            is_even = highest - lowest <= SLOT_M
            hangs = (
                big
                and is_even
                and np.float32(below) >= thresholds.shots
                and through * FEWER <= below
            )
            if is_low or hangs:
                flanks[line, b] = 1
                first = int(min(away / LEVEL_BIN_M, _FAR))
                for j in range(first, min(first + BODY_BINS, STRIPS)):
                    all_levels[line, STRIPS + j if side == 0 else STRIPS - 1 - j] |= np.uint8(
                        LORRY_BIN | 1 if hangs else 1
                    )
    return flanks, all_levels
