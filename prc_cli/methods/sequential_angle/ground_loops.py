"""Loops for the ground within a row and its height across rows (Stamos et al. 2012, sec. 5).

After every point the ground algorithm needs to know whether the line angles so far have one mode.
Mean shift from every sample would make that cubic in the points of a row. Here samples fall into
bins of an eighth of a bandwidth. The density of a bin is a sum of integers from one table, and
adding a sample needs additions only. They are exact in any order, so the density is always that of
all samples together. Its maxima are the points where mean shift ends, and the minima between them
separate the samples of the modes.
"""

from __future__ import annotations

import math
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

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
CLEAR = 2 * PER_BANDWIDTH - 1
"""Samples that span at most this many bins have one mode.

Means within two standard deviations give a density whose logarithm is concave, since the variance
of samples in an interval is at most the square of half its length.
"""
LARGEST_DEG = 360.0
"""Line angles lie between 0 and this."""
LOWEST_M = -310.0
"""Height where the histogram of heights starts; heights beyond its ends count in its end bins."""
PER_METRE = 500
"""Its bins in a metre, 2 mm each."""
N_HEIGHTS = 370 * PER_METRE
"""Its bins, up to 60 m above the scanner."""
BEHIND = 2
"""Horizontal points behind a gap in a surface that have to continue its line."""
ZERO = cast("int", np.int64(0))
NONE = cast("int", np.int64(-1))
"""Integers that numba does not treat as literals: it would compile helpers again for a literal."""

_HORIZONTAL = 2
_MISSING = 0

_FIGURES = np.dtype(
    [
        (name, np.int64)
        for name in (
            "n",  # heights in the histogram
            "first",
            "last",  # their first and last bin
            "median",
            "below",  # the bin of their median, and heights in the bins below
            "width",  # bins of the histogram in a coarse bin
            "lo",
            "hi",  # first and last coarse bin
            "cleared_from",
            # coarse bins between which memory has been cleared: not all three megabytes
            "cleared_to",
            "oldest",
            "newest",  # ends of the queue
        )
    ]
)
_AT_ONCE = 250
"""Bins of the histogram of heights that are skipped together if they are empty."""


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
    """Memory for the line angles of a row and their modes.

    ``hist`` and ``density`` are zero between calls.
    """

    sampled: I32
    """Beams of the samples."""
    angles: F64
    """(2, n) float64, line angles of the samples, and room for their bins."""
    hist: I64
    """Samples in every bin, with :data:`HALF` bins more at either end."""
    density: I64
    """Density in every bin."""
    tops: I64
    """Places of the modes, twice their bin."""
    counts: I64
    """Samples of the modes."""


class _Heights(NamedTuple):
    """Heights of rows: all in fine bins, and those that count in coarse ones with their density."""

    histogram: I32
    queue: I32
    """Bins of the heights that are remembered, between the figures ``oldest`` and ``newest``."""
    hist: I64
    """Heights in every coarse bin, with :data:`HALF` bins more at the beginning."""
    density: I64
    figures: NDArray[np.void]
    """(1,) of :data:`_FIGURES`."""


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
def _add_density(
    hist: I64,
    density: I64,
    lo: int,
    hi: int,
) -> None:
    """Compute the density of binned samples; it must be zero before."""
    for q in range(lo, hi + 1):
        if hist[q] > 0:
            _spread(density, q, hist[q])


@inlined
def _density_at(hist: I64, q: int) -> int:
    """Compute the density of binned samples in one bin."""
    first = np.uint64(q - HALF)
    total = 0
    for j in range(np.uint64(2 * HALF + 1)):
        total += hist[first + j] * WEIGHT[j]
    return total


@helper
def _clear_bins(hist: I64, lo: int, hi: int) -> None:

    for q in range(max(lo, HALF), hi + 1):
        hist[q] = 0


@helper
def _clear_density(density: I64, lo: int, hi: int) -> None:

    for q in range(max(lo, HALF) - HALF, hi + HALF + 1 if hi >= lo else 0):
        density[q] = 0


@helper
def _clear(
    hist: I64,
    density: I64,
    lo: int,
    hi: int,
) -> None:

    _clear_bins(hist, lo, hi)
    _clear_density(density, lo, hi)


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
def _count_in_bins(
    angles: F64,
    n: int,
    width: float,
    size: int,
    hist: I64,
) -> None:
    """Count line angles, the first row of ``angles``, in bins; the second row gets the bins."""
    for i in range(n):
        angles[1, i] = min(max(np.floor(angles[0, i] / width), 0.0), size - 1.0)
    for i in range(n):
        hist[int(angles[1, i]) + HALF] += 1


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
def _after_bridge(
    surface: U8,
    xyz: F32,
    horizontal: F32,
    beams: I32,
    n_points: int,
    k: int,
    n: int,
    n_fit: int,
    bridge: int,
    step: float,
) -> int:
    """Return where a line continues behind a few points that are not horizontal, else ``k``."""
    end = k
    n_passed = 0
    while k < n and surface[k] != _HORIZONTAL:
        if surface[k] != _MISSING:
            n_passed += 1
            if n_passed > bridge:
                return end
        k += 1
    behind = k
    n_horizontal = 0
    while k < n and n_horizontal < BEHIND:
        if surface[k] != _MISSING:
            if surface[k] != _HORIZONTAL or not _continues_line(
                xyz, horizontal, beams, n_points, k, n_fit, step
            ):
                return end
            n_horizontal += 1
        k += 1
    return behind if n_horizontal == BEHIND else end


@helper
def _follow_peak(hist: I64, peak: int, q: int) -> int:
    """Return the only maximum of a density after a sample in bin ``q`` was added; -1 = maybe two.

    ``peak`` is the maximum before. A second one can only appear between it and the new sample: on
    both sides of that stretch the two parts of the density rise, or fall, together.
    """
    i = min(peak, q)
    end = max(peak, q)
    if i == end:
        return peak
    top = i
    density_here = _density_at(hist, i)
    rising = True
    while i < end:
        density_next = _density_at(hist, i + 1)
        if density_next < density_here:
            rising = False
        elif density_next > density_here and not rising:
            return -1
        density_here = density_next
        i += 1
        if rising:
            top = i
    return top


@helper
def _count_modes(
    scratch: _Scratch,
    lo: int,
    hi: int,
    least: int,
) -> tuple[int, int]:
    """Return the number of modes with at least ``least`` samples, and the bin of the only maximum.

    The bin is -1 if there are several.
    """
    density = scratch.density
    tops = scratch.tops
    counts = scratch.counts
    _add_density(scratch.hist, density, lo, hi)
    n_modes = _find_modes(scratch.hist, density, lo, hi, tops, counts)
    _clear_density(density, lo, hi)
    enough = 0
    for i in range(n_modes):
        enough += counts[i] >= least
    return enough, tops[0] // 2 if n_modes == 1 else NONE


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

    All work for every point is in this function, see :class:`_Row`. As long as the samples are so
    close together that they have one mode, the least and the largest angle show it, and no bin is
    counted.
    """
    surface = row.surface
    xyz = row.xyz
    horizontal = row.horizontal
    phihat = row.phihat
    sampled = scratch.sampled
    angles = scratch.angles
    hist = scratch.hist
    jump = thresholds.jump_m
    n_fit = thresholds.growth_points
    first_run = thresholds.first_run
    least = thresholds.mode_samples
    size = len(hist) - 2 * HALF
    n_points = n_samples = renew_at = ZERO
    lo = hi = peak = NONE
    bandwidth = width = 0.0
    angle = least_deg = most_deg = lowest_deg = highest_deg = np.nan
    k = start
    growing = is_binned = False
    while True:
        # the next horizontal point; more than a few that are neither that nor missing end the run
        while k < n and surface[k] == _MISSING:
            k += 1
        if n_points > 0 and k < n and surface[k] != _HORIZONTAL:
            k = _after_bridge(
                surface,
                xyz,
                horizontal,
                beams,
                n_points,
                k,
                n,
                n_fit,
                thresholds.bridge,
                thresholds.bridge_height_m,
            )
        if k >= n or surface[k] != _HORIZONTAL:
            if growing or k >= n:
                break
            n_points = ZERO
            k += 1
            continue
        if n_points > 0:
            # at another height than the last point, and than their line here
            rise = abs(np.float64(xyz[k, 2]) - np.float64(xyz[beams[n_points - 1], 2]))
            if rise > jump and not _continues_line(
                xyz, horizontal, beams, n_points, k, n_fit, jump
            ):
                if growing:
                    break
                n_points = ZERO
        beams[n_points] = k
        n_points += 1
        k += 1
        if n_points < first_run:
            continue
        # the points but the last one that have a line angle are samples
        n_samples_before = n_samples
        if not growing:
            n_samples = renew_at = ZERO
            least_deg = np.inf
            most_deg = -np.inf
        for i in range(n_points - 2 if growing else 0, n_points - 1):
            angle = np.float64(phihat[beams[i]])
            sampled[n_samples] = beams[i]
            angles[0, n_samples] = angle
            n_samples += angle == angle
            lowest_deg = least_deg
            highest_deg = most_deg
            least_deg = angle if angle < least_deg else least_deg
            most_deg = angle if angle > most_deg else most_deg
        if growing and n_samples == n_samples_before:
            continue
        one_mode = n_samples >= least
        if one_mode:
            q = ZERO
            if n_samples >= renew_at:
                # the bandwidth is renewed whenever the set has grown by a half: that keeps the work
                # proportional to the number of points
                renew_at = n_samples + n_samples // 2 + 1
                bandwidth = _bandwidth(
                    xyz,
                    row.ahead,
                    sampled[n_samples // 2],
                    thresholds.bandwidth_deg,
                    thresholds.bandwidth_sigmas,
                    thresholds.range_noise_m,
                )
                width = bandwidth / PER_BANDWIDTH
                if is_binned:
                    _clear_bins(hist, lo, hi)
                lo = _bin(least_deg, width, size)
                hi = _bin(most_deg, width, size)
                is_binned = False
            elif is_binned or angle < lowest_deg or angle > highest_deg:
                q = _bin(angle, width, size)
                lo = min(lo, q)
                hi = max(hi, q)
                hist[q] += is_binned
            if hi - lo > CLEAR:
                if not is_binned:
                    _count_in_bins(angles, n_samples, width, size, hist)
                    is_binned = True
                    peak = NONE
                if peak >= 0:
                    peak = _follow_peak(hist, peak, q)
                if peak < 0:
                    n_modes, peak = _count_modes(scratch, lo, hi, least)
                    one_mode = n_modes == 1
        if growing and not one_mode:
            break
        if one_mode:
            growing = True
        else:  # no ground at this start: try the next point
            for i in range(n_points - 1):
                beams[i] = beams[i + 1]
            n_points -= 1
    if is_binned:
        _clear_bins(hist, lo, hi)
    return n_points - 2 if growing else 0, bandwidth


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
            k = _after_bridge(
                surface,
                xyz,
                horizontal,
                beams,
                n_points,
                k,
                n,
                n_fit,
                thresholds.bridge,
                thresholds.bridge_height_m,
            )
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
    angles = scratch.angles
    hist = scratch.hist
    density = scratch.density
    tops = scratch.tops
    counts = scratch.counts
    size = len(hist) - 2 * HALF
    width = bandwidth / PER_BANDWIDTH
    least_deg = np.inf
    most_deg = -np.inf
    n_samples = ZERO
    for i in range(n_points):
        angle = np.float64(phihat[beams[i]])
        angles[0, n_samples] = angle
        n_samples += angle == angle
        least_deg = angle if angle < least_deg else least_deg
        most_deg = angle if angle > most_deg else most_deg
    lo = _bin(least_deg, width, size)
    hi = _bin(most_deg, width, size)
    _count_in_bins(angles, n_samples, width, size, hist)
    _add_density(hist, density, lo, hi)
    best = _largest_mode(counts, _find_modes(hist, density, lo, hi, tops, counts))
    _clear(hist, density, lo, hi)
    return float((tops[best] / 2.0 - HALF + 0.5) * width)


@helper
def _end_of_run(
    surface: U8,
    start: int,
    n: int,
    bridge: int,
) -> int:
    """Return the beam behind a run of horizontal points with gaps of at most ``bridge`` points."""
    end = k = start
    n_passed = 0
    while k < n and n_passed <= bridge:
        if surface[k] == _HORIZONTAL:
            n_passed = 0
            end = k + 1
        elif surface[k] != _MISSING:
            n_passed += 1
        k += 1
    return end


@helper
def _resume(
    row: _Row,
    n: int,
    beams: I32,
    n_points: int,
    candidates: I32,
    thresholds: GroundThresholds,
    scratch: _Scratch,
) -> int:
    """Add ground from the remainder of a run of horizontal points; return the number of points."""
    surface = row.surface
    guard = thresholds.growth_height_m
    start = k = int(np.int64(beams[n_points - 1] + 1))
    end = _end_of_run(surface, start, n, thresholds.bridge)
    crossed = False
    while start < end:
        n_candidates, bandwidth = _find_potential(row, end, start, thresholds, candidates, scratch)
        if n_candidates == 0:
            break
        start = int(np.int64(candidates[n_candidates - 1] + 1))
        while k < candidates[0]:
            crossed = crossed or (surface[k] != _HORIZONTAL and surface[k] != _MISSING)
            k += 1
        if _continues_line(
            row.xyz,
            row.horizontal,
            beams,
            n_points,
            int(np.int64(candidates[0])),
            thresholds.growth_points,
            min(thresholds.bridge_height_m, guard) if crossed else guard,
        ):
            for i in range(n_candidates):
                beams[n_points + i] = candidates[i]
            mode = _main_angle(row.phihat, candidates, n_candidates, bandwidth, scratch)
            n_points = _grow_run(
                row, end, beams, n_points + n_candidates, mode, bandwidth, thresholds
            )
            start = k = int(np.int64(beams[n_points - 1] + 1))
            crossed = False
    return n_points


@helper
def _grow(
    row: _Row,
    n: int,
    beams: I32,
    n_points: int,
    bandwidth: float,
    candidates: I32,
    thresholds: GroundThresholds,
    scratch: _Scratch,
) -> int:
    """Grow accepted ground over the remainder of its run; return the number of points."""
    mode = _main_angle(row.phihat, beams, n_points, bandwidth, scratch)
    n_points = _grow_run(row, n, beams, n_points, mode, bandwidth, thresholds)
    if thresholds.resume:
        n_points = _resume(row, n, beams, n_points, candidates, thresholds, scratch)
    return n_points


@helper
def _height_bin(z: float) -> int:

    return int(min(max((z - LOWEST_M) * PER_METRE, 0.0), N_HEIGHTS - 1.0))


@helper
def _clear_around(heights: _Heights, q: int) -> None:
    """Clear the memory that a sample in a coarse bin needs."""
    hist = heights.hist
    density = heights.density
    figures = heights.figures[0]
    if figures["cleared_from"] == figures["cleared_to"]:
        figures["cleared_from"] = figures["cleared_to"] = q - HALF
    for i in range(q - HALF, figures["cleared_from"]):
        hist[i] = density[i] = 0
    for i in range(figures["cleared_to"], q + HALF + 1):
        hist[i] = density[i] = 0
    figures["cleared_from"] = min(figures["cleared_from"], q - HALF)
    figures["cleared_to"] = max(figures["cleared_to"], q + HALF + 1)


@helper
def _bin_coarsely(heights: _Heights, width: int) -> None:
    """Bin the histogram of heights in an eighth of the bandwidth."""
    histogram = heights.histogram
    hist = heights.hist
    figures = heights.figures[0]
    if figures["n"] > 0:
        _clear(hist, heights.density, figures["lo"], figures["hi"])
    lo = figures["first"] // width + HALF
    hi = figures["last"] // width + HALF
    _clear_around(heights, lo)
    _clear_around(heights, hi)
    n = ZERO
    for i in range(figures["first"], figures["last"] + 1):
        if histogram[i] > 0:
            hist[i // width + HALF] += histogram[i]
            n += histogram[i]
    figures["n"] = n
    figures["width"] = width
    figures["lo"] = lo
    figures["hi"] = hi
    _add_density(hist, heights.density, lo, hi)


@helper
def _height_width(median: int, share: float) -> int:
    """Return an eighth of the bandwidth of heights in bins, rounded up."""
    return max(1, math.ceil(share * abs(median + 0.5 + PER_METRE * LOWEST_M) / PER_BANDWIDTH))


@helper
def _new_heights(
    histogram: I32,
    queue: I32,
    n_queued: int,
    share: float,
) -> _Heights:

    heights = _Heights(
        histogram=histogram,
        queue=queue,
        hist=np.empty(N_HEIGHTS + 2 * HALF, np.int64),
        density=np.empty(N_HEIGHTS + 2 * HALF, np.int64),
        figures=np.zeros(1, _FIGURES),
    )
    heights.figures[0]["newest"] = n_queued
    _index_heights(heights, share)
    return heights


@helper
def _index_heights(heights: _Heights, share: float) -> None:
    """Find the ends of a histogram of heights, its (lower) median, its density."""
    histogram = heights.histogram
    figures = heights.figures[0]
    n = ZERO
    for begin in range(0, N_HEIGHTS, _AT_ONCE):
        n_there = 0
        for i in range(begin, begin + _AT_ONCE):
            n_there += histogram[i]
        if n_there == 0:
            continue
        for i in range(begin, begin + _AT_ONCE):
            if histogram[i] > 0:
                figures["first"] = i if n == 0 else figures["first"]
                figures["last"] = i
                n += histogram[i]
    if n == 0:
        return
    figures["median"] = figures["first"]
    figures["below"] = 0
    _move_median(heights, n)
    _bin_coarsely(heights, _height_width(figures["median"], share))


@helper
def _move_median(heights: _Heights, n: int) -> None:
    """Move the median to its bin among n heights."""
    histogram = heights.histogram
    figures = heights.figures[0]
    median = figures["median"]
    below = figures["below"]
    rank = (n - 1) // 2
    while below > rank:
        median -= 1
        below -= histogram[median]
    while below + histogram[median] <= rank:
        below += histogram[median]
        median += 1
    figures["median"] = median
    figures["below"] = below


@helper
def _add_height(heights: _Heights, new: int, share: float) -> None:
    """Add a height to histogram, median and density."""
    figures = heights.figures[0]
    heights.histogram[new] += 1
    if figures["n"] == 0:
        _index_heights(heights, share)
        return
    figures["first"] = min(figures["first"], new)
    figures["last"] = max(figures["last"], new)
    figures["below"] += new < figures["median"]
    _move_median(heights, figures["n"] + 1)
    width = _height_width(figures["median"], share)
    if width == figures["width"]:
        q = new // width + HALF
        _clear_around(heights, q)
        heights.hist[q] += 1
        _spread(heights.density, q, int(np.int64(1)))
        figures["lo"] = min(figures["lo"], q)
        figures["hi"] = max(figures["hi"], q)
        figures["n"] += 1
    else:
        _bin_coarsely(heights, width)


@helper
def _forget_height(heights: _Heights, old: int, share: float) -> None:
    """Remove a height from histogram, median and density; another height must remain."""
    histogram = heights.histogram
    figures = heights.figures[0]
    histogram[old] -= 1
    width = figures["width"]
    q = old // width + HALF
    heights.hist[q] -= 1
    _spread(heights.density, q, NONE)
    figures["n"] -= 1
    while histogram[figures["first"]] == 0:
        figures["first"] += 1
    while histogram[figures["last"]] == 0:
        figures["last"] -= 1
    figures["lo"] = figures["first"] // width + HALF
    figures["hi"] = figures["last"] // width + HALF
    figures["below"] -= old < figures["median"]
    _move_median(heights, figures["n"])
    if _height_width(figures["median"], share) != width:
        _bin_coarsely(heights, _height_width(figures["median"], share))


@helper
def _count_height(
    heights: _Heights,
    z: float,
    memory: int,
    share: float,
) -> None:
    """Add a height, and remove the oldest one if there are more than ``memory``."""
    figures = heights.figures[0]
    new = _height_bin(z)
    _add_height(heights, new, share)
    if memory > 0:
        heights.queue[figures["newest"]] = new
        figures["newest"] += 1
        if figures["newest"] - figures["oldest"] > memory:
            _forget_height(heights, int(np.int64(heights.queue[figures["oldest"]])), share)
            figures["oldest"] += 1


@helper
def _mode_below_roof(
    tops: I64,
    counts: I64,
    best: int,
    width: int,
    roof_m: float,
    roof_share: float,
) -> int:
    """Return the lowest mode below the main one if that is a roof, else the main one.

    The main mode is a roof if a mode far enough below has a large enough share of its samples.
    """
    for i in range(best):
        below_m = (((tops[best] - tops[i]) * width) // 2) / PER_METRE
        if below_m >= roof_m and np.float64(counts[i]) >= roof_share * np.float64(counts[best]):
            return i
    return best


@helper
def _main_height(
    heights: _Heights,
    tops: I64,
    counts: I64,
    roof_m: float,
    roof_share: float,
) -> tuple[int, float]:
    """Return the number of heights in the main mode, and its height [m] by mean shift on the bins.

    If the main mode is a roof, the ground below it is used.
    """
    histogram = heights.histogram
    figures = heights.figures[0]
    if figures["n"] == 0:
        return 0, np.nan
    width = figures["width"]
    best = _largest_mode(
        counts,
        _find_modes(heights.hist, heights.density, figures["lo"], figures["hi"], tops, counts),
    )
    best = _mode_below_roof(tops, counts, best, width, roof_m, roof_share)
    place = ((tops[best] - 2 * HALF) * width + width) // 2
    shift = 0.0
    for _ in range(20):
        moment = 0
        mass = 0
        reach = (HALF + 1) * width - 1
        for i in range(
            max(figures["first"], place - reach), min(figures["last"], place + reach) + 1
        ):
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
    return counts[best], (place + 0.5 + shift) / PER_METRE + LOWEST_M


@loop("prc_cli.reference.sequential_angle.ground")
def main_height(
    heights: F64_1,
    share: float,
    roof_m: float,
    roof_share: float,
) -> tuple[int, float, I32_1, I32_1]:
    """Find the main mode of heights.

    ``heights`` (n,) float64, metres; returns ``bins`` (n,) int32, ``histogram`` (N_HEIGHTS,) int32.
    """
    histogram = np.zeros(N_HEIGHTS, np.int32)
    bins = np.empty(len(heights), np.int32)
    for i in range(len(heights)):
        bins[i] = _height_bin(heights[i])
        histogram[bins[i]] += 1
    index = _new_heights(histogram, bins, ZERO, share)
    tops = np.empty(N_HEIGHTS, np.int64)
    counts = np.empty(N_HEIGHTS, np.int64)
    count, height = _main_height(index, tops, counts, roof_m, roof_share)
    return count, height, bins, histogram


@helper
def _new_scratch(n: int, size: int, n_modes: int) -> _Scratch:
    """Return memory for rows of ``n`` beams, ``size`` bins of line angles and ``n_modes`` modes."""
    return _Scratch(
        sampled=np.empty(n + 1, np.int32),
        angles=np.empty((2, n + 1), np.float64),
        hist=np.zeros(size + 2 * HALF, np.int64),
        density=np.zeros(size + 2 * HALF, np.int64),
        tops=np.empty(n_modes, np.int64),
        counts=np.empty(n_modes, np.int64),
    )


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
    size = math.ceil(LARGEST_DEG * PER_BANDWIDTH / thresholds.bandwidth_deg) + 1
    scratch = _new_scratch(n, size, size)
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
    size = math.ceil(LARGEST_DEG * PER_BANDWIDTH / thresholds.bandwidth_deg) + 1
    scratch = _new_scratch(n, size, max(size, N_HEIGHTS))
    tops = scratch.tops
    counts = scratch.counts
    beams = np.empty(n + 1, np.int32)
    candidates = np.empty(n + 1, np.int32)
    n_recent = len(state.recent)
    queue = np.empty(n_recent + n_rows, np.int32)
    queue[:n_recent] = state.recent
    memory = thresholds.memory_heights
    share = thresholds.height_bandwidth
    z_g = state.z_g
    roof_m = thresholds.roof_m
    roof_share = thresholds.roof_share
    heights = _new_heights(state.histogram.copy(), queue, n_recent, share)
    figures = heights.figures[0]
    ground = np.zeros((n_rows, n), np.bool_)
    z_rows = np.empty(n_rows, np.float32)
    side_m = state.side_m.copy()
    follow_m = thresholds.follow_m
    for i in range(n_rows):
        row = _Row(surface[i], xyz[i], horizontal[i], phihat[i], ahead[i])
        n_valid = int(np.int64(n_beams[i]))
        to_count = i >= state.n_in_histogram_ahead
        side = i % len(side_m)
        z_row = np.nan
        accepted = False
        # the first potential ground is known
        n_points = _horizontal_beams(row.surface, potential.first[i], potential.last[i], beams)
        bandwidth = potential.bandwidth_deg[i]
        z_i = potential.height_m[i]
        while n_points > 0:
            # the first estimate had too few heights: count this one at once
            if to_count and figures["n"] < thresholds.start_heights:
                _count_height(heights, z_i, memory, share)
                to_count = False
                if z_g == z_g or figures["n"] >= thresholds.least_heights:
                    _, z_g = _main_height(heights, tops, counts, roof_m, roof_share)
            accepted = abs(z_i - z_g) < max(
                thresholds.height_tolerance * abs(z_g), thresholds.height_tolerance_m
            )
            accepted = accepted or abs(z_i - side_m[side]) < follow_m
            if accepted or z_row != z_row:
                z_row = z_i
            if accepted:
                break
            start = int(np.int64(beams[n_points - 1] + 1))
            n_points, bandwidth = _find_potential(row, n_valid, start, thresholds, beams, scratch)
            if n_points > 0:
                z_i = _lowest_mean(
                    row.xyz, beams, n_points, thresholds.lowest_points, thresholds.height_points
                )
        if accepted:
            side_m[side] = z_i
            for j in range(
                _grow(row, n_valid, beams, n_points, bandwidth, candidates, thresholds, scratch)
            ):
                ground[i, beams[j]] = True
        if to_count and z_row == z_row:
            _count_height(heights, z_row, memory, share)
            if accepted or thresholds.renew_every:
                _, z_g = _main_height(heights, tops, counts, roof_m, roof_share)
        z_rows[i] = z_g
    recent = queue[figures["oldest"] : figures["newest"]].copy()
    n_still_ahead = max(state.n_in_histogram_ahead - n_rows, 0)
    return ground, z_rows, GroundState(heights.histogram, recent, z_g, n_still_ahead, side_m)
