"""Loop of the fused classifier that finds flanks of vehicles.

Upright surfaces with ground beneath them.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import F32, F32_2, I32, U8, U8_2, U64, U64_2
from prc_cli.methods.fused.records import (
    LORRY_BIN,
    SLOT_M,
    STRIP_M,
    STRIPS,
    Beams,
    StripSums,
)
from prc_cli.methods.fused.strips_loops import LINES, sum_around
from prc_cli.methods.fused.thresholds import FlankThresholds

BIN_M = np.float32(0.125)
"""Width of a bin of ground, a quarter of a strip [m]."""
BINS = 2 * STRIPS
"""Bins of ground on either side."""
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
def _sort_ground(
    ranges: F32,
    above: F32,
    chords: U8,
    beams: Beams,
    soil_m: np.float32,
    places: I32,
    shots: I32,
    bins: I32,
    depths: F32,
) -> None:
    """Count the ground shots of a line by bin, and write their depth below the scanner [m]."""
    for i in range(len(ranges)):
        is_soil = (abs(above[i]) < soil_m) & (chords[i] <= 1)
        y = ranges[i] * beams.sine[i] if is_soil else _FAR
        q = np.int32(np.floor(min(max(y / BIN_M, -_FAR), _FAR))) + np.int32(BINS)
        places[i] = q if (q >= 0) & (q < 2 * BINS) else np.int32(-1)
    n = 0
    for i in range(len(ranges)):
        shots[n] = i
        n += places[i] >= 0
    for b in range(len(bins)):
        bins[b] = np.int32(0)
    for k in range(n):
        shot = np.uint64(shots[k])
        place = np.uint64(places[shot])
        bins[place] += 1
        depths[place] = ranges[shot] * beams.cosine[shot]


@helper
def _ground_past_sill(
    bins: I32,
    depths: F32,
    side: int,
    away: np.float32,
    thresholds: FlankThresholds,
) -> tuple[int, int]:
    """Count the ground that is seen beneath the sill of a body at a distance, and through it.

    The height at which the line of sight passes the flank decides: below the sill, or above. To
    ground at twice the distance of the flank it passes at half the height of the scanner.
    """
    beneath = through = 0
    first = min(int(min(away / BIN_M, _FAR)), BINS)
    for j in range(first, min(2 * first, BINS)):
        q = BINS + j if side == 0 else BINS - 1 - j
        if bins[q] == 0:
            continue
        middle_m = (np.float32(j) + np.float32(0.5)) * BIN_M
        passes_m = depths[q] * (np.float32(1.0) - away / middle_m)
        if passes_m > thresholds.body_m:
            break
        if thresholds.low_m <= passes_m <= thresholds.sill_m:
            beneath += bins[q]
        elif passes_m > thresholds.sill_m:
            through += bins[q]
    return beneath, through


@inlined
def _bottom(slots: U64, b: int, away: np.float32) -> np.float32:
    """Return the height above ground at which a body at a distance starts, 0 at its foot [m]."""
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
def _ground_past_bottom(
    bins: I32,
    depths: F32,
    side: int,
    away: np.float32,
    bottom: np.float32,
) -> tuple[int, int]:
    """Count the ground that is seen beneath the bottom of a high body, and through the body."""
    beneath = through = 0
    first = min(int(min(away / BIN_M, _FAR)), BINS)
    for j in range(first, min(2 * first, BINS)):
        q = BINS + j if side == 0 else BINS - 1 - j
        if bins[q] == 0:
            continue
        middle_m = (np.float32(j) + np.float32(0.5)) * BIN_M
        passes_m = depths[q] * (np.float32(1.0) - away / middle_m)
        if np.float32(0.5) * bottom <= passes_m <= bottom:
            beneath += bins[q]
        elif passes_m > bottom + SLOT_M:
            through += bins[q]
    return beneath, through


@loop()
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
    """Find strips with the flank of a vehicle: ground is seen right beneath it, and not through it.

    Beneath the sill of a low body, or beneath the bottom of a high one, as a lorry's.

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
    places_of_shots = np.empty(range_m.shape[1], np.int32)
    shots = np.empty(range_m.shape[1] + 1, np.int32)
    lines = np.empty(STRIPS + 2, np.float32)
    walls = np.empty(STRIPS, np.float32)
    places = np.empty(STRIPS, np.float32)
    lengths = np.empty(STRIPS, np.float32)
    least = thresholds.least_m * np.float32(room)
    most = thresholds.most_m * np.float32(room)
    for k in range(n_lines + 2 * LINES):
        _sort_ground(
            range_m[k],
            above_m[k],
            upright[k],
            beams,
            thresholds.soil_m,
            places_of_shots,
            shots,
            bins[k % room],
            depths[k % room],
        )
        if k < 2 * LINES:
            continue
        line = k - 2 * LINES
        for q in range(2 * STRIPS):
            all_levels[line, q] = levels[line, q]
        sum_around(sums.length_m, line, lines, lengths)
        sum_around(wall, line, lines, walls)
        sum_around(sums.wall_place, line, lines, places)
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
            beneath_sill = through_low = beneath_bottom = through_high = 0
            lowest = _FAR
            highest = np.float32(0.0)
            for c in range(line, line + room):
                # lines without something upright in the strip see the ground behind a post
                wall_m = wall[c]
                if not (
                    wall_m[b] > 0 or wall_m[max(b - 1, 0)] > 0 or wall_m[min(b + 1, STRIPS - 1)] > 0
                ):
                    continue
                bins_of_line = bins[c % room]
                depths_of_line = depths[c % room]
                beneath, through = _ground_past_sill(
                    bins_of_line, depths_of_line, side, away, thresholds
                )
                beneath_sill += beneath
                through_low += through
                bottom = _bottom(slots[c], b, away)
                if thresholds.body_m <= bottom <= thresholds.high_m:
                    beneath, through = _ground_past_bottom(
                        bins_of_line, depths_of_line, side, away, bottom
                    )
                    beneath_bottom += beneath
                    through_high += through
                    lowest = min(lowest, bottom)
                    highest = max(highest, bottom)
            is_low = (
                np.float32(beneath_sill) >= thresholds.shots and through_low * FEWER <= beneath_sill
            )
            # a slanted plane meets the edge of a house higher from line to line
            is_even = highest - lowest <= SLOT_M
            is_high = (
                walls[b] >= thresholds.large_m * np.float32(room)
                and is_even
                and np.float32(beneath_bottom) >= thresholds.shots
                and through_high * FEWER <= beneath_bottom
            )
            if is_low or is_high:
                flanks[line, b] = 1
                first = int(min(away / LEVEL_BIN_M, _FAR))
                mark = np.uint8(LORRY_BIN | 1 if is_high else 1)
                for j in range(first, min(first + BODY_BINS, STRIPS)):
                    all_levels[line, STRIPS + j if side == 0 else STRIPS - 1 - j] |= mark
    return flanks, all_levels
