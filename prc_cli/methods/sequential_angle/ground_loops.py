"""Loops for the ground within a row and its height across rows (Stamos et al. 2012, sec. 5).

After every point the ground algorithm needs to know whether the line angles so far have one mode.
Samples fall into bins of an eighth of a bandwidth, and the density of a bin is a sum of integers
from one table. Its maxima are the points where mean shift ends, and the minima between them
separate the samples of the modes. Integers are exact in any order: a sample is added by additions,
and the density is always that of all samples together.
"""

from __future__ import annotations

import math
from typing import NamedTuple, cast

import numpy as np

from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import (
    F32,
    F32_1,
    F32_2,
    F32_3,
    F64,
    F64_1,
    I32,
    I32_1,
    I32_2,
    I64,
    U8,
    U8_2,
    Mask_2,
)
from prc_cli.methods.sequential_angle.thresholds import (
    GroundState,
    GroundThresholds,
    PotentialGround,
)

PER_BANDWIDTH = 8
"""Bins of a bandwidth."""
HALF = 43
"""Bins on either side beyond which the table is zero, 5.4 bandwidths."""
WEIGHT = np.rint(2.0**20 * np.exp(-0.5 * (np.arange(-HALF, HALF + 2) / PER_BANDWIDTH) ** 2)).astype(
    np.int64
)
"""Gaussian kernel in whole numbers, one entry a bin, and a zero at the end."""
LARGEST_DEG = 360.0
"""Line angles lie between 0 and this."""
LOWEST_M = -310.0
"""Height where the histogram of heights starts; heights beyond its ends count in its end bins."""
PER_METRE = 500
"""Its bins in a metre, 2 mm each."""
N_HEIGHTS = 370 * PER_METRE
"""Its bins, up to 60 m above the scanner."""
ZERO = cast("int", np.int64(0))
NONE = cast("int", np.int64(-1))
"""Integers that numba does not treat as literals: it would compile helpers again for a literal."""

_HORIZONTAL = 2
_MISSING = 0


class _Row(NamedTuple):
    """One row.

    Read its arrays before a loop, and pass no array to a function for every point: numba counts the
    references to each array in atomic steps, which needed most of the time.
    """

    surface: U8
    """(n,) uint8, coarse layer."""
    xyz: F32
    """(n, 3) float32 [m]."""
    horizontal: F32
    """(n,) float32, horizontal distance [m]."""
    phihat: F32
    """(n,) float32, line angle of horizontal points [deg]."""
    ahead: I32
    """(n,) int32, beam at the other end of the chord, -1 = none."""


class _Scratch(NamedTuple):
    """Memory for the modes of samples in bins; ``hist`` and ``density`` are zero between calls."""

    angles: F64
    """(n,) float64, line angles of the samples."""
    hist: I64
    """Samples in every bin, with :data:`HALF` bins more at either end."""
    density: I64
    """Density in every bin."""
    tops: I64
    """Places of the modes, twice their bin."""
    counts: I64
    """Samples of the modes."""


@helper
def _find_modes(
    hist: I64,
    density: I64,
    lo: int,
    hi: int,
    tops: I64,
    counts: I64,
) -> int:
    """List the maxima of a density from low to high; return their number.

    ``tops`` gets twice their bin, ``counts`` the samples between the minima around them.
    """
    n = 0
    last = 0
    best = 0
    k = lo
    while k <= hi:
        count = 0
        while k < hi and density[k + 1] >= density[k]:
            count += hist[k]
            k += 1
        height = density[k]
        first = k
        while first > lo and density[first - 1] == height:
            first -= 1
        top = first + k
        count += hist[k]
        while k < hi and density[k + 1] <= density[k]:
            k += 1
            count += hist[k]
        k += 1
        if n > 0 and top - last < PER_BANDWIDTH:  # twice a bin, so twice half a bandwidth
            counts[n - 1] += count
            if height > best:
                tops[n - 1] = top
                best = height
        else:
            tops[n] = top
            counts[n] = count
            best = height
            n += 1
        last = top
    return n


@inlined
def _spread(density: I64, q: int, count: int) -> None:
    """Add ``count`` samples in bin ``q`` to the density."""
    # unsigned, and no view of the array: for vector instructions, and no count of views
    first = np.uint64(q - HALF)
    for j in range(np.uint64(2 * HALF + 1)):
        density[first + j] += count * WEIGHT[j]


@helper
def _clear(hist: I64, density: I64, lo: int, hi: int) -> None:
    """Forget the samples in some bins."""
    for q in range(lo - HALF, hi + HALF + 1):
        hist[q] = 0
        density[q] = 0


@helper
def _bandwidth(
    xyz: F32,
    ahead: I32,
    beam: int,
    least: float,
    sigmas: float,
    noise: float,
) -> float:
    """Return the bandwidth for line angles [deg] at a point with a chord.

    The standard deviation of a line angle is sqrt(2) noise sin(phi) / chord; the sine comes from
    the cross product.
    """
    end = ahead[beam]
    x = np.float64(xyz[beam, 0])
    y = np.float64(xyz[beam, 1])
    z = np.float64(xyz[beam, 2])
    dx = np.float64(xyz[end, 0]) - x
    dy = np.float64(xyz[end, 1]) - y
    dz = np.float64(xyz[end, 2]) - z
    cx = y * dz - z * dy
    cy = z * dx - x * dz
    cz = x * dy - y * dx
    cross = math.sqrt(cx * cx + cy * cy + cz * cz)
    chord_2 = dx * dx + dy * dy + dz * dz
    sigma = (
        57.29577951308232
        * 1.4142135623730951
        * noise
        * cross
        / (chord_2 * math.sqrt(x * x + y * y + z * z))
    )
    bandwidth = max(least, sigmas * sigma)
    return bandwidth if bandwidth < 180.0 else 180.0  # also where there is no chord


@inlined
def _bin(angle: float, width: float, size: int) -> int:
    """Return the bin of a line angle."""
    return min(max(math.floor(angle / width), 0), size - 1) + HALF


@helper
def _continues_line(
    xyz: F32,
    horizontal: F32,
    beams: I32,
    n_points: int,
    k: int,
    n_fit: int,
    guard: float,
) -> bool:
    """Whether a point is at the height of the local line through the last points."""
    first = max(n_points - n_fit, 0)
    count = n_points - first
    mean_x = 0.0
    mean_z = 0.0
    for i in range(first, n_points):
        mean_x += np.float64(horizontal[beams[i]])
        mean_z += np.float64(xyz[beams[i], 2])
    mean_x /= count
    mean_z /= count
    sxx = 0.0
    sxz = 0.0
    for i in range(first, n_points):
        dx = np.float64(horizontal[beams[i]]) - mean_x
        sxx += dx * dx
        sxz += dx * (np.float64(xyz[beams[i], 2]) - mean_z)
    slope = sxz / (sxx + count * guard * guard)
    expected = mean_z + slope * (np.float64(horizontal[k]) - mean_x)
    return bool(abs(np.float64(xyz[k, 2]) - expected) <= guard)


@helper
def _bin_angles(scratch: _Scratch, n: int, width: float) -> tuple[int, int]:
    """Count line angles in bins, and return the first and the last bin."""
    size = len(scratch.hist) - 2 * HALF
    lo = hi = _bin(scratch.angles[0], width, size)
    for i in range(n):
        q = _bin(scratch.angles[i], width, size)
        lo = min(lo, q)
        hi = max(hi, q)
        scratch.hist[q] += 1
        _spread(scratch.density, q, 1)
    return lo, hi


@helper
def _has_one_mode(scratch: _Scratch, lo: int, hi: int, least: int) -> bool:
    """Whether one mode has at least ``least`` samples."""
    n_modes = _find_modes(scratch.hist, scratch.density, lo, hi, scratch.tops, scratch.counts)
    n_large = 0
    for i in range(n_modes):
        n_large += scratch.counts[i] >= least
    return n_large == 1


@helper
def _find_potential(
    row: _Row,
    n: int,
    start: int,
    thresholds: GroundThresholds,
    beams: I32,
    scratch: _Scratch,
) -> tuple[int, float]:
    """Find potential ground in a row from a beam on (part a).

    Returns the number of points, whose beams are in ``beams``, and the bandwidth [deg].
    """
    surface = row.surface
    phihat = row.phihat
    angles = scratch.angles
    size = len(scratch.hist) - 2 * HALF
    n_points = n_samples = renew_at = ZERO
    lo = ZERO
    hi = NONE
    bandwidth = width = 0.0
    growing = False
    k = start
    while k < n:
        if surface[k] == _MISSING:
            k += 1
            continue
        if surface[k] != _HORIZONTAL:
            if growing:
                break
            n_points = ZERO
            k += 1
            continue
        beams[n_points] = k
        n_points += 1
        k += 1
        if n_points < thresholds.first_run:
            continue
        # the points but the last one that have a line angle are samples
        n_before = n_samples if growing else ZERO
        n_samples = n_before
        for i in range(n_points - 2 if growing else 0, n_points - 1):
            angles[n_samples] = phihat[beams[i]]
            n_samples += angles[n_samples] == angles[n_samples]
        if growing and n_samples == n_before:
            continue
        one_mode = n_samples >= thresholds.mode_samples
        if one_mode:
            if not growing or n_samples >= renew_at:
                # the bandwidth is renewed whenever the set has grown by a half
                renew_at = n_samples + n_samples // 2 + 1
                bandwidth = _bandwidth(
                    row.xyz,
                    row.ahead,
                    _sampled(phihat, beams, n_samples // 2),
                    thresholds.bandwidth_deg,
                    thresholds.bandwidth_sigmas,
                    thresholds.range_noise_m,
                )
                width = bandwidth / PER_BANDWIDTH
                _clear(scratch.hist, scratch.density, max(lo, HALF), hi)
                lo, hi = _bin_angles(scratch, n_samples, width)
            else:
                q = _bin(angles[n_samples - 1], width, size)
                lo = min(lo, q)
                hi = max(hi, q)
                scratch.hist[q] += 1
                _spread(scratch.density, q, 1)
            one_mode = _has_one_mode(scratch, lo, hi, thresholds.mode_samples)
        if growing and not one_mode:
            break
        growing = one_mode
        if not growing:  # no ground at this start: try the next point
            for i in range(n_points - 1):
                beams[i] = beams[i + 1]
            n_points -= 1
    _clear(scratch.hist, scratch.density, max(lo, HALF), hi)
    return n_points - 2 if growing else 0, bandwidth


@helper
def _sampled(phihat: F32, beams: I32, number: int) -> int:
    """Return the beam of a sample: the points without a line angle are none."""
    i = ZERO
    while True:
        angle = phihat[beams[i]]
        if angle == angle:
            if number == 0:
                return int(np.int64(beams[i]))
            number -= 1
        i += 1


@helper
def _lowest_mean(
    xyz: F32,
    beams: I32,
    n_points: int,
    lowest: int,
    near: int,
) -> float:
    """Return the mean height of the lowest of the first points, of all if ``near`` is 0."""
    heights = np.empty(lowest, np.float64)
    kept = 0
    for i in range(min(n_points, near) if near > 0 else n_points):
        z = np.float64(xyz[beams[i], 2])
        if kept == lowest and z >= heights[kept - 1]:
            continue
        j = kept if kept < lowest else kept - 1
        while j > 0 and heights[j - 1] > z:
            heights[j] = heights[j - 1]
            j -= 1
        heights[j] = z
        kept = min(kept + 1, lowest)
    total = 0.0
    for i in range(kept):
        total += heights[i]
    return total / kept


@helper
def _largest_mode(counts: I64, n: int) -> int:
    """Return the mode with most samples, of equals the lowest one."""
    best = 0
    for i in range(1, n):
        if counts[i] > counts[best]:
            best = i
    return best


@helper
def _grow_run(
    row: _Row,
    n: int,
    beams: I32,
    n_points: int,
    mode: float,
    bandwidth: float,
    thresholds: GroundThresholds,
) -> int:
    """Grow ground over the horizontal points that follow; return the new number of points."""
    surface = row.surface
    xyz = row.xyz
    horizontal = row.horizontal
    phihat = row.phihat
    n_fit = thresholds.growth_points
    guard = thresholds.growth_height_m
    k = int(np.int64(beams[n_points - 1] + 1))
    while k < n:
        if surface[k] == _MISSING:
            k += 1
            continue
        if surface[k] != _HORIZONTAL:
            break
        # a point without a line angle is tested by its height only
        if abs(np.float64(phihat[k]) - mode) > bandwidth:
            break
        if not _continues_line(xyz, horizontal, beams, n_points, k, n_fit, guard):
            break
        beams[n_points] = k
        n_points += 1
        k += 1
    return n_points


@helper
def _main_angle(
    phihat: F32,
    beams: I32,
    n_points: int,
    bandwidth: float,
    scratch: _Scratch,
) -> float:
    """Return the main mode of the line angles of some points [deg]."""
    width = bandwidth / PER_BANDWIDTH
    n_samples = ZERO
    for i in range(n_points):
        scratch.angles[n_samples] = phihat[beams[i]]
        n_samples += scratch.angles[n_samples] == scratch.angles[n_samples]
    lo, hi = _bin_angles(scratch, n_samples, width)
    tops = scratch.tops
    best = _largest_mode(
        scratch.counts, _find_modes(scratch.hist, scratch.density, lo, hi, tops, scratch.counts)
    )
    _clear(scratch.hist, scratch.density, lo, hi)
    return float((tops[best] / 2.0 - HALF + 0.5) * width)


@helper
def _height_bin(z: float) -> int:

    return int(min(max((z - LOWEST_M) * PER_METRE, 0.0), N_HEIGHTS - 1.0))


@helper
def _main_height(histogram: I32, first: int, last: int, share: float, scratch: _Scratch) -> float:
    """Return the main mode of heights between two bins [m], by mean shift on the bins."""
    hist = scratch.hist
    density = scratch.density
    tops = scratch.tops
    n = ZERO
    for i in range(first, last + 1):
        n += histogram[i]
    median = first
    below = ZERO
    while below + histogram[median] <= (n - 1) // 2:
        below += histogram[median]
        median += 1
    # coarse bins of an eighth of the bandwidth, rounded up
    width = max(1, math.ceil(share * abs(median + 0.5 + PER_METRE * LOWEST_M) / PER_BANDWIDTH))
    lo = first // width + HALF
    hi = last // width + HALF
    for i in range(first, last + 1):
        if histogram[i] > 0:
            hist[i // width + HALF] += histogram[i]
            _spread(density, i // width + HALF, histogram[i])
    best = _largest_mode(scratch.counts, _find_modes(hist, density, lo, hi, tops, scratch.counts))
    _clear(hist, density, lo, hi)
    place = ((tops[best] - 2 * HALF) * width + width) // 2
    reach = (HALF + 1) * width - 1
    shift = 0.0
    for _ in range(20):
        moment = 0
        mass = 0
        for i in range(max(first, place - reach), min(last, place + reach) + 1):
            if histogram[i] > 0:
                distance = abs(i - place)
                j = distance // width
                remainder = distance - j * width
                weight = (
                    WEIGHT[HALF + j] * (width - remainder) + WEIGHT[HALF + j + 1] * remainder
                ) // width
                moment += weight * histogram[i] * (i - place)
                mass += weight * histogram[i]
        if mass == 0:
            break
        shift = moment / mass
        step = math.floor(shift + 0.5)
        if step == 0:
            break
        place += step
        shift = 0.0
    return float((place + 0.5 + shift) / PER_METRE + LOWEST_M)


@loop("prc_cli.reference.sequential_angle.ground")
def main_height(heights: F64_1, share: float) -> tuple[float, I32_1]:
    """Find the main mode of heights [m], NaN = no heights.

    ``heights`` (n,) float64, metres; returns ``histogram`` (N_HEIGHTS,) int32 beside it.
    """
    histogram = np.zeros(N_HEIGHTS, np.int32)
    first = int(np.int64(N_HEIGHTS))
    last = NONE
    for z in heights:
        q = _height_bin(z)
        histogram[q] += 1
        first = min(first, q)
        last = max(last, q)
    if last < 0:
        return np.nan, histogram
    scratch = _new_scratch(1, N_HEIGHTS)
    return _main_height(histogram, first, last, share, scratch), histogram


@helper
def _new_scratch(n: int, size: int) -> _Scratch:
    """Return memory for rows of ``n`` beams and ``size`` bins."""
    return _Scratch(
        angles=np.empty(n + 1, np.float64),
        hist=np.zeros(size + 2 * HALF, np.int64),
        density=np.zeros(size + 2 * HALF, np.int64),
        tops=np.empty(size, np.int64),
        counts=np.empty(size, np.int64),
    )


@helper
def _bins_of_angles(thresholds: GroundThresholds) -> int:

    return math.ceil(LARGEST_DEG * PER_BANDWIDTH / thresholds.bandwidth_deg) + 1


@loop("prc_cli.reference.sequential_angle.ground")
def potential_heights(
    surface: U8_2,
    xyz: F32_3,
    horizontal: F32_2,
    phihat: F32_2,
    ahead: I32_2,
    n_beams: I32_1,
    thresholds: GroundThresholds,
) -> PotentialGround:
    """Find the first potential ground of every row and its height (part a).

    ``surface`` (R, n) uint8; ``xyz`` (R, n, 3) float32, metres; ``horizontal`` (R, n) float32,
    metres; ``phihat`` (R, n) float32, degrees; ``ahead`` (R, n) int32; ``n_beams`` (R,) int32.
    """
    n_rows, n = surface.shape
    scratch = _new_scratch(n, _bins_of_angles(thresholds))
    beams = np.empty(n + 1, np.int32)
    first = np.empty(n_rows, np.int32)
    last = np.empty(n_rows, np.int32)
    bandwidth = np.empty(n_rows, np.float64)
    height = np.empty(n_rows, np.float64)
    for i in range(n_rows):
        row = _Row(surface[i], xyz[i], horizontal[i], phihat[i], ahead[i])
        n_points, bandwidth_deg = _find_potential(
            row, int(np.int64(n_beams[i])), ZERO, thresholds, beams, scratch
        )
        first[i] = last[i] = -1
        bandwidth[i] = height[i] = np.nan
        if n_points > 0:
            first[i] = beams[0]
            last[i] = beams[n_points - 1]
            bandwidth[i] = bandwidth_deg
            height[i] = _lowest_mean(
                row.xyz, beams, n_points, thresholds.lowest_points, thresholds.height_points
            )
    return PotentialGround(first, last, bandwidth, height)


@helper
def _horizontal_beams(
    surface: U8,
    first: int,
    last: int,
    beams: I32,
) -> int:
    """List the horizontal points from one beam to another; return their number.

    There are none if ``first`` is -1.
    """
    n_points = ZERO
    if first >= 0:
        for k in range(first, last + 1):
            beams[n_points] = k
            n_points += surface[k] == _HORIZONTAL
    return n_points


@loop("prc_cli.reference.sequential_angle.ground")
def ground_rows(
    surface: U8_2,
    xyz: F32_3,
    horizontal: F32_2,
    phihat: F32_2,
    ahead: I32_2,
    n_beams: I32_1,
    potential: PotentialGround,
    state: GroundState,
    thresholds: GroundThresholds,
) -> tuple[Mask_2, F32_1, GroundState]:
    """Verify and grow the ground of every row and follow its height (part b).

    Returns ``ground`` (R, n) bool, ``z_g`` (R,) float32.
    """
    n_rows, n = surface.shape
    scratch = _new_scratch(n, _bins_of_angles(thresholds))
    scratch_of_heights = _new_scratch(1, N_HEIGHTS)
    beams = np.empty(n + 1, np.int32)
    share = thresholds.height_bandwidth
    z_g = state.z_g
    histogram = state.histogram.copy()
    n_heights = ZERO
    first = int(np.int64(N_HEIGHTS))
    last = NONE
    for q in range(N_HEIGHTS):
        if histogram[q] > 0:
            n_heights += histogram[q]
            first = min(first, q)
            last = q
    ground = np.zeros((n_rows, n), np.bool_)
    z_rows = np.empty(n_rows, np.float32)
    for i in range(n_rows):
        row = _Row(surface[i], xyz[i], horizontal[i], phihat[i], ahead[i])
        n_valid = int(np.int64(n_beams[i]))
        to_count = i >= state.n_in_histogram_ahead
        z_row = np.nan
        accepted = False
        # the first potential ground is known
        n_points = _horizontal_beams(row.surface, potential.first[i], potential.last[i], beams)
        bandwidth = potential.bandwidth_deg[i]
        z_i = potential.height_m[i]
        while n_points > 0 and not accepted:
            # the first estimate had too few heights: count this one at once
            if to_count and n_heights < thresholds.start_heights:
                q = _height_bin(z_i)
                histogram[q] += 1
                n_heights += 1
                first = min(first, q)
                last = max(last, q)
                to_count = False
                z_g = _main_height(histogram, first, last, share, scratch_of_heights)
            accepted = abs(z_i - z_g) < thresholds.height_tolerance * abs(z_g)
            if accepted or z_row != z_row:
                z_row = z_i
            if not accepted:
                start = int(np.int64(beams[n_points - 1] + 1))
                n_points, bandwidth = _find_potential(
                    row, n_valid, start, thresholds, beams, scratch
                )
                if n_points > 0:
                    z_i = _lowest_mean(
                        row.xyz, beams, n_points, thresholds.lowest_points, thresholds.height_points
                    )
        if accepted:
            mode = _main_angle(row.phihat, beams, n_points, bandwidth, scratch)
            n_points = _grow_run(row, n_valid, beams, n_points, mode, bandwidth, thresholds)
            for j in range(n_points):
                ground[i, beams[j]] = True
        if to_count and z_row == z_row:
            q = _height_bin(z_row)
            histogram[q] += 1
            n_heights += 1
            first = min(first, q)
            last = max(last, q)
            if accepted:
                z_g = _main_height(histogram, first, last, share, scratch_of_heights)
        z_rows[i] = z_g
    n_still_ahead = max(state.n_in_histogram_ahead - n_rows, 0)
    return ground, z_rows, GroundState(histogram, z_g, n_still_ahead)
