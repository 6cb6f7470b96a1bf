"""Loops over rows: modes of samples, the ground within a row and its height across rows (Stamos et al. 2012, sec. 5).

The ground algorithm asks after every point whether the line angles so far have one mode. Mean shift from every sample
would make that cubic in the points of a row. Here samples fall into bins of an eighth of a bandwidth, the density of
a bin is a sum of whole numbers from one table, and a sample that is added changes it by additions alone: exact, in any
order, hence equal to the density computed anew. Its maxima are the points where mean shift ends, the minima between
them part their samples.
"""

from __future__ import annotations

import math

import numpy as np

from prc_cli.core.types import F32, F64, I32, I64, U8, Mask
from prc_cli.kernels.cache import helper, inlined, kernel

PER_BANDWIDTH = 8
"""Bins of a bandwidth."""
HALF = 43
"""Bins on either side beyond which the table is zero, 5.4 bandwidths."""
WEIGHT = np.rint(2.0**20 * np.exp(-0.5 * (np.arange(-HALF, HALF + 2) / PER_BANDWIDTH) ** 2)).astype(np.int64)
"""Gaussian kernel in whole numbers, one entry a bin, and a zero at the end."""
CLEAR = 2 * PER_BANDWIDTH - 1
"""Samples that span at most this many bins have one mode: means within two standard deviations give a density whose
logarithm is concave, since the variance of what lies in an interval is at most the square of half its length."""
LARGEST_DEG = 360.0
"""Line angles lie between 0 and this."""
LOWEST_M = -310.0
"""Height where the histogram of heights begins; what lies beyond its ends counts in its end bins."""
PER_METRE = 500
"""Its bins in a metre, 2 mm each."""
N_HEIGHTS = 370 * PER_METRE
"""Its bins, up to 60 m above the scanner."""
BEHIND = 2
"""Horizontal points behind a gap in a surface that have to continue its line."""

_HORIZONTAL = 2
_MISSING = 0

# slots of the heights: how many, their first and last coarse bin, their median, ...
_N, _LO, _HI, _MEDIAN, _BELOW, _WIDTH, _FIRST, _LAST, _OLDEST, _NEWEST = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
# ... and between which coarse bins memory has been cleared: all of it would be three megabytes for every block
_FROM, _TO = 10, 11
_SLOTS = 12
_AT_ONCE = 250
"""Bins of the histogram of heights that are looked at together for whether there is anything."""


@helper
def _walk(hist: I64, density: I64, lo: int, hi: int, tops: I64, counts: I64) -> int:
    """List the maxima of a density from low to high: twice their place, and the samples between the minima around."""
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
        if n > 0 and top - last < PER_BANDWIDTH:  # twice a place against twice half a bandwidth
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
    """Add so many samples in a bin to the density."""
    first = np.uint64(q - HALF)  # unsigned, and no view of the array: for vector instructions, and no count of views
    for j in range(np.uint64(2 * HALF + 1)):
        density[first + j] += count * WEIGHT[j]


@helper
def _build(hist: I64, density: I64, lo: int, hi: int) -> None:
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
def _forget(hist: I64, lo: int, hi: int) -> None:
    """Forget samples."""
    for q in range(max(lo, HALF), hi + 1):
        hist[q] = 0


@helper
def _clear_density(density: I64, lo: int, hi: int) -> None:
    """Forget the density of samples."""
    for q in range(max(lo, HALF) - HALF, hi + HALF + 1 if hi >= lo else 0):
        density[q] = 0


@helper
def _clear(hist: I64, density: I64, lo: int, hi: int) -> None:
    """Forget all samples and their density."""
    _forget(hist, lo, hi)
    _clear_density(density, lo, hi)


@kernel("Tuple((float64[::1], int64[::1]))(float64[::1], float64)")
def find_modes(values: F64, bandwidth: float) -> tuple[F64, I64]:
    """Find the modes of samples by mean shift with a Gaussian kernel (Comaniciu and Meer 2002), on a grid.

    Parameters
    ----------
    values : (n,) float64
        Finite.
    bandwidth : float
        Standard deviation of the kernel, in the unit of the values.

    Returns
    -------
    places : (m,) float64
        Modes that have samples, rising; to an eighth of a bandwidth.
    counts : (m,) int64
        Samples of every mode.
    """
    width = bandwidth / PER_BANDWIDTH
    if len(values) == 0:
        return np.empty(0, np.float64), np.empty(0, np.int64)
    lowest = highest = math.floor(values[0] / width)
    for value in values:
        q = math.floor(value / width)
        lowest, highest = min(lowest, q), max(highest, q)
    first, last = int(np.int64(HALF)), HALF + highest - lowest
    hist = np.zeros(last + 1 + HALF, np.int64)
    density = np.zeros(last + 1 + HALF, np.int64)
    for value in values:
        hist[math.floor(value / width) - lowest + HALF] += 1
    _build(hist, density, first, last)
    tops = np.empty(last + 1, np.int64)
    counts = np.empty(last + 1, np.int64)
    n = _walk(hist, density, first, last, tops, counts)
    n_kept = 0
    for i in range(n):
        n_kept += counts[i] > 0
    places = np.empty(n_kept, np.float64)
    samples = np.empty(n_kept, np.int64)
    n_kept = 0
    for i in range(n):
        if counts[i] > 0:
            places[n_kept] = (tops[i] / 2.0 - HALF + lowest + 0.5) * width
            samples[n_kept] = counts[i]
            n_kept += 1
    return places, samples


@helper
def _bandwidth(xyz: F32, ahead: I32, one: int, least: float, sigmas: float, noise: float) -> float:
    """Return the bandwidth for line angles [deg] at a point with a chord to another one.

    The standard deviation of a line angle is sqrt(2) noise sin(phi) / chord; the sine comes from the cross product.
    """
    other = ahead[one]
    x, y, z = np.float64(xyz[one, 0]), np.float64(xyz[one, 1]), np.float64(xyz[one, 2])
    dx, dy, dz = np.float64(xyz[other, 0]) - x, np.float64(xyz[other, 1]) - y, np.float64(xyz[other, 2]) - z
    cx, cy, cz = y * dz - z * dy, z * dx - x * dz, x * dy - y * dx
    cross = math.sqrt(cx * cx + cy * cy + cz * cz)
    chord_2 = dx * dx + dy * dy + dz * dz
    sigma = 57.29577951308232 * 1.4142135623730951 * noise * cross / (chord_2 * math.sqrt(x * x + y * y + z * z))
    found = max(least, sigmas * sigma)
    return found if found < 180.0 else 180.0  # also where there is no chord


@inlined
def _bin(angle: float, width: float, size: int) -> int:
    """Return the bin of a line angle."""
    return min(max(math.floor(angle / width), 0), size - 1) + HALF


@helper
def _count(angles: F64, n: int, width: float, size: int, hist: I64) -> None:
    """Count line angles, the first row of ``angles``, in their bins; the other row takes these, many at a time."""
    for i in range(n):
        angles[1, i] = min(max(np.floor(angles[0, i] / width), 0.0), size - 1.0)
    for i in range(n):
        hist[int(angles[1, i]) + HALF] += 1


@helper
def _fits(xyz: F32, horizontal: F32, beams: I32, n_points: int, k: int, n_fit: int, guard: float) -> bool:
    """Tell whether a point lies at the height of the local line through the last points."""
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
def _bridged(
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
    """Return the horizontal point at which a line goes on behind a few points that are not horizontal, or ``k``."""
    end = k
    passed = 0
    while k < n and surface[k] != _HORIZONTAL:
        if surface[k] != _MISSING:
            passed += 1
            if passed > bridge:
                return end
        k += 1
    behind = k
    seen = 0
    while k < n and seen < BEHIND:
        if surface[k] != _MISSING:
            if surface[k] != _HORIZONTAL or not _fits(xyz, horizontal, beams, n_points, k, n_fit, step):
                return end
            seen += 1
        k += 1
    return behind if seen == BEHIND else end


@helper
def _potential(  # noqa: PLR0915 - the references of arrays are counted wherever a helper takes them
    surface: U8,
    xyz: F32,
    horizontal: F32,
    phihat: F32,
    ahead: I32,
    n: int,
    start: int,
    first_run: int,
    least: int,
    smallest: float,
    sigmas: float,
    noise: float,
    n_fit: int,
    jump: float,
    bridge: int,
    step: float,
    beams: I32,
    sampled: I32,
    angles: F64,
    hist: I64,
    density: I64,
    tops: I64,
    counts: I64,
) -> tuple[int, float]:
    """Find potential ground in a row from a beam on: how many points, left in ``beams``, and the bandwidth (part a).

    ``hist`` and ``density`` are zero before and after. What every point goes through stands here and calls nothing
    with an array: numba counts the references of each array that it hands over, in atomic steps, which took most of
    the time. As long as the samples lie so close together that they have one mode, the least and the largest angle
    say so, and no bin is counted.
    """
    size = len(hist) - 2 * HALF
    n_points = n_samples = renew_at = int(np.int64(0))  # not the literal, for which helpers would be compiled once more
    lo = hi = peak = int(np.int64(-1))
    b = width = 0.0
    angle = least_deg = most_deg = lowest_deg = highest_deg = np.nan
    k = start
    growing = built = False
    while True:
        # the next horizontal point; more than a few that are neither that nor missing end the run
        while k < n and surface[k] == _MISSING:
            k += 1
        if n_points > 0 and k < n and surface[k] != _HORIZONTAL:
            k = _bridged(surface, xyz, horizontal, beams, n_points, k, n, n_fit, bridge, step)
        if k >= n or surface[k] != _HORIZONTAL:
            if growing or k >= n:
                break
            n_points = int(np.int64(0))
            k += 1
            continue
        if n_points > 0:
            # at another height than the points before, and than their line goes on to
            rise = abs(np.float64(xyz[k, 2]) - np.float64(xyz[beams[n_points - 1], 2]))
            if rise > jump and not _fits(xyz, horizontal, beams, n_points, k, n_fit, jump):
                if growing:
                    break
                n_points = int(np.int64(0))
        beams[n_points] = k
        n_points += 1
        k += 1
        if n_points < first_run:
            continue
        # the points but the last one that have a line angle are samples
        before = n_samples
        if not growing:
            n_samples = renew_at = int(np.int64(0))
            least_deg, most_deg = np.inf, -np.inf
        for i in range(n_points - 2 if growing else 0, n_points - 1):
            angle = np.float64(phihat[beams[i]])
            sampled[n_samples] = beams[i]
            angles[0, n_samples] = angle
            n_samples += angle == angle
            lowest_deg, highest_deg = least_deg, most_deg
            least_deg = angle if angle < least_deg else least_deg
            most_deg = angle if angle > most_deg else most_deg
        if growing and n_samples == before:
            continue
        one_mode = n_samples >= least
        if one_mode:
            q = int(np.int64(0))
            if n_samples >= renew_at:
                # the bandwidth follows the middle of the set whenever the set has grown by a half: that keeps the
                # work proportional to the number of points, whatever the bandwidth does
                renew_at = n_samples + n_samples // 2 + 1
                b = _bandwidth(xyz, ahead, sampled[n_samples // 2], smallest, sigmas, noise)
                width = b / PER_BANDWIDTH
                if built:
                    _forget(hist, lo, hi)
                lo, hi, built = _bin(least_deg, width, size), _bin(most_deg, width, size), False
            elif built or angle < lowest_deg or angle > highest_deg:
                q = _bin(angle, width, size)
                lo, hi = min(lo, q), max(hi, q)
                hist[q] += built
            one_mode = hi - lo <= CLEAR
            if not one_mode:
                if not built:
                    _count(angles, n_samples, width, size, hist)
                    built, peak = True, int(np.int64(-1))
                if peak >= 0:
                    # one maximum before: a second one can only arise between it and the new sample, on either side of
                    # which both parts of the density rise, or fall, together
                    i, end = min(peak, q), max(peak, q)
                    if i < end:
                        here = _density_at(hist, i)
                        rising = True
                        top = i
                        while i < end:
                            there = _density_at(hist, i + 1)
                            if there < here:
                                rising = False
                            elif there > here and not rising:
                                break
                            here = there
                            i += 1
                            if rising:
                                top = i
                        one_mode = i == end
                        peak = top if one_mode else int(np.int64(-1))
                    else:
                        one_mode = True
                if not one_mode:
                    _build(hist, density, lo, hi)
                    n_modes = _walk(hist, density, lo, hi, tops, counts)
                    _clear_density(density, lo, hi)
                    peak = tops[0] // 2 if n_modes == 1 else int(np.int64(-1))
                    enough = 0
                    for i in range(n_modes):
                        enough += counts[i] >= least
                    one_mode = enough == 1
        if growing and not one_mode:
            break
        if one_mode:
            growing = True
        else:  # no ground at this start: go one point on
            for i in range(n_points - 1):
                beams[i] = beams[i + 1]
            n_points -= 1
    if built:
        _forget(hist, lo, hi)
    return n_points - 2 if growing else 0, b


@helper
def _lowest_mean(xyz: F32, beams: I32, n_points: int, lowest: int, near: int) -> float:
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
def _main(counts: I64, n: int) -> int:
    """Return the mode with most samples, of equals the lowest."""
    best = 0
    for i in range(1, n):
        if counts[i] > counts[best]:
            best = i
    return best


@helper
def _extend(
    surface: U8,
    xyz: F32,
    horizontal: F32,
    phihat: F32,
    n: int,
    beams: I32,
    n_points: int,
    mode: float,
    b: float,
    n_fit: int,
    guard: float,
    bridge: int,
    step: float,
) -> int:
    """Grow ground over the horizontal points that follow; returns how many points there are then in ``beams``."""
    k = int(np.int64(beams[n_points - 1] + 1))
    while k < n:
        if surface[k] == _MISSING:
            k += 1
            continue
        if surface[k] != _HORIZONTAL:
            k = _bridged(surface, xyz, horizontal, beams, n_points, k, n, n_fit, bridge, step)
            if surface[k] != _HORIZONTAL:
                break
        # a point without a line angle is judged by its height alone
        if abs(np.float64(phihat[k]) - mode) > b:
            break
        if not _fits(xyz, horizontal, beams, n_points, k, n_fit, guard):
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
    b: float,
    angles: F64,
    hist: I64,
    density: I64,
    tops: I64,
    counts: I64,
) -> float:
    """Return the main mode of the line angles of some points [deg]; ``hist`` and ``density`` are as before."""
    size = len(hist) - 2 * HALF
    width = b / PER_BANDWIDTH
    least_deg, most_deg = np.inf, -np.inf
    n_samples = int(np.int64(0))
    for i in range(n_points):
        angle = np.float64(phihat[beams[i]])
        angles[0, n_samples] = angle
        n_samples += angle == angle
        least_deg = angle if angle < least_deg else least_deg
        most_deg = angle if angle > most_deg else most_deg
    lo, hi = _bin(least_deg, width, size), _bin(most_deg, width, size)
    _count(angles, n_samples, width, size, hist)
    _build(hist, density, lo, hi)
    best = _main(counts, _walk(hist, density, lo, hi, tops, counts))
    _clear(hist, density, lo, hi)
    return float((tops[best] / 2.0 - HALF + 0.5) * width)


@helper
def _resume(
    surface: U8,
    xyz: F32,
    horizontal: F32,
    phihat: F32,
    ahead: I32,
    n: int,
    first_run: int,
    least: int,
    smallest: float,
    sigmas: float,
    noise: float,
    n_fit: int,
    jump: float,
    bridge: int,
    step: float,
    guard: float,
    beams: I32,
    n_points: int,
    more: I32,
    sampled: I32,
    angles: F64,
    hist: I64,
    density: I64,
    tops: I64,
    counts: I64,
) -> int:
    """Look for more ground in the rest of a run of horizontal points; returns how many points are in ``beams`` then."""
    start = k = end = int(np.int64(beams[n_points - 1] + 1))
    passed = 0
    while k < n and passed <= bridge:
        if surface[k] == _HORIZONTAL:
            passed = 0
            end = k + 1
        elif surface[k] != _MISSING:
            passed += 1
        k += 1
    k = start
    crossed = False
    while start < end:
        n_more, b = _potential(
            surface, xyz, horizontal, phihat, ahead, end, start, first_run, least, smallest, sigmas, noise,
            n_fit, jump, bridge, step, more, sampled, angles, hist, density, tops, counts,
        )  # fmt: skip
        if n_more == 0:
            break
        start = int(np.int64(more[n_more - 1] + 1))
        while k < more[0]:
            crossed = crossed or (surface[k] != _HORIZONTAL and surface[k] != _MISSING)
            k += 1
        if _fits(
            xyz, horizontal, beams, n_points, int(np.int64(more[0])), n_fit, min(step, guard) if crossed else guard
        ):
            for i in range(n_more):
                beams[n_points + i] = more[i]
            mode = _main_angle(phihat, more, n_more, b, angles, hist, density, tops, counts)
            n_points = _extend(
                surface, xyz, horizontal, phihat, end, beams, n_points + n_more, mode, b, n_fit, guard, bridge, step
            )  # fmt: skip
            start = k = int(np.int64(beams[n_points - 1] + 1))
            crossed = False
    return n_points


@helper
def _height_bin(z: float) -> int:
    """Return the bin of a height; what lies outside counts in the end bins."""
    return int(min(max((z - LOWEST_M) * PER_METRE, 0.0), N_HEIGHTS - 1.0))


@helper
def _reach(hist: I64, density: I64, state: I64, q: int) -> None:
    """Clear memory as far as a sample in a coarse bin needs it."""
    if state[_FROM] == state[_TO]:
        state[_FROM] = state[_TO] = q - HALF
    for i in range(q - HALF, state[_FROM]):
        hist[i] = density[i] = 0
    for i in range(state[_TO], q + HALF + 1):
        hist[i] = density[i] = 0
    state[_FROM] = min(state[_FROM], q - HALF)
    state[_TO] = max(state[_TO], q + HALF + 1)


@helper
def _coarse(histogram: I32, hist: I64, density: I64, state: I64, width: int) -> None:
    """Bin the histogram of heights in an eighth of the bandwidth."""
    if state[_N] > 0:
        _clear(hist, density, state[_LO], state[_HI])
    state[_N] = 0
    state[_WIDTH] = width
    state[_LO] = state[_FIRST] // width + HALF
    state[_HI] = state[_LAST] // width + HALF
    _reach(hist, density, state, state[_LO])
    _reach(hist, density, state, state[_HI])
    for i in range(state[_FIRST], state[_LAST] + 1):
        if histogram[i] > 0:
            hist[i // width + HALF] += histogram[i]
            state[_N] += histogram[i]
    _build(hist, density, state[_LO], state[_HI])


@helper
def _height_width(median: int, share: float) -> int:
    """Return an eighth of the bandwidth of heights in bins, rounded up."""
    return max(1, math.ceil(share * abs(median + 0.5 + PER_METRE * LOWEST_M) / PER_BANDWIDTH))


@helper
def _open_heights(histogram: I32, hist: I64, density: I64, state: I64, share: float) -> None:
    """Take a histogram of heights up: its ends, its (lower) median, its density."""
    n = int(np.int64(0))
    for begin in range(0, N_HEIGHTS, _AT_ONCE):
        there = 0
        for i in range(begin, begin + _AT_ONCE):
            there += histogram[i]
        if there == 0:
            continue
        for i in range(begin, begin + _AT_ONCE):
            if histogram[i] > 0:
                if n == 0:
                    state[_FIRST] = i
                state[_LAST] = i
                n += histogram[i]
    if n == 0:
        return
    state[_MEDIAN] = state[_FIRST]
    state[_BELOW] = 0
    _settle(histogram, state, n)
    _coarse(histogram, hist, density, state, _height_width(state[_MEDIAN], share))


@helper
def _settle(histogram: I32, state: I64, n: int) -> None:
    """Bring the median of n heights to its place."""
    median, below = state[_MEDIAN], state[_BELOW]
    rank = (n - 1) // 2
    while below > rank:
        median -= 1
        below -= histogram[median]
    while below + histogram[median] <= rank:
        below += histogram[median]
        median += 1
    state[_MEDIAN] = median
    state[_BELOW] = below


@helper
def _add_height(histogram: I32, hist: I64, density: I64, state: I64, new: int, share: float) -> None:
    """Add a height to histogram, median and density."""
    histogram[new] += 1
    if state[_N] == 0:
        _open_heights(histogram, hist, density, state, share)
        return
    state[_FIRST] = min(state[_FIRST], new)
    state[_LAST] = max(state[_LAST], new)
    if new < state[_MEDIAN]:
        state[_BELOW] += 1
    _settle(histogram, state, state[_N] + 1)
    width = _height_width(state[_MEDIAN], share)
    if width == state[_WIDTH]:
        q = new // width + HALF
        _reach(hist, density, state, q)
        hist[q] += 1
        _spread(density, q, int(np.int64(1)))
        state[_LO] = min(state[_LO], q)
        state[_HI] = max(state[_HI], q)
        state[_N] += 1
    else:
        _coarse(histogram, hist, density, state, width)


@helper
def _forget_height(histogram: I32, hist: I64, density: I64, state: I64, old: int, share: float) -> None:
    """Take a height, not the last one, out of histogram, median and density."""
    histogram[old] -= 1
    width = state[_WIDTH]
    q = old // width + HALF
    hist[q] -= 1
    _spread(density, q, int(np.int64(-1)))
    state[_N] -= 1
    while histogram[state[_FIRST]] == 0:
        state[_FIRST] += 1
    while histogram[state[_LAST]] == 0:
        state[_LAST] -= 1
    state[_LO] = state[_FIRST] // width + HALF
    state[_HI] = state[_LAST] // width + HALF
    if old < state[_MEDIAN]:
        state[_BELOW] -= 1
    _settle(histogram, state, state[_N])
    if _height_width(state[_MEDIAN], share) != width:
        _coarse(histogram, hist, density, state, _height_width(state[_MEDIAN], share))


@helper
def _count_height(
    z: float, heights: I32, queue: I32, memory: int, hist: I64, density: I64, state: I64, share: float
) -> None:
    """Add a height, and forget the oldest one when there are more than can be remembered."""
    new = _height_bin(z)
    _add_height(heights, hist, density, state, new, share)
    if memory > 0:
        queue[state[_NEWEST]] = new
        state[_NEWEST] += 1
        if state[_NEWEST] - state[_OLDEST] > memory:
            _forget_height(heights, hist, density, state, queue[state[_OLDEST]], share)
            state[_OLDEST] += 1


@helper
def _main_height(histogram: I32, hist: I64, density: I64, state: I64, tops: I64, counts: I64) -> tuple[int, float]:
    """Return the samples of the main mode of the heights, and its place [m] after mean shift on the bins."""
    if state[_N] == 0:
        return 0, np.nan
    width = state[_WIDTH]
    best = _main(counts, _walk(hist, density, state[_LO], state[_HI], tops, counts))
    place = ((tops[best] - 2 * HALF) * width + width) // 2
    shift = 0.0
    for _ in range(20):
        moment = 0
        mass = 0
        reach = (HALF + 1) * width - 1
        for i in range(max(state[_FIRST], place - reach), min(state[_LAST], place + reach) + 1):
            if histogram[i] > 0:
                away = abs(i - place)
                j = away // width
                rest = away - j * width
                weight = (WEIGHT[HALF + j] * (width - rest) + WEIGHT[HALF + j + 1] * rest) // width
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


@kernel("Tuple((int64, float64, int32[::1], int32[::1]))(float64[::1], float64)")
def main_height(heights: F64, share: float) -> tuple[int, float, I32, I32]:
    """Find the main mode of heights.

    Parameters
    ----------
    heights : (n,) float64, metres
        Finite.
    share : float
        Bandwidth as a share of the median height; rounded up to a multiple of 16 mm.

    Returns
    -------
    count : int
        Heights of the main mode, 0 if there are none at all.
    height : float
        Its place [m], NaN if there are none.
    bins : (n,) int32
        Bin of every height.
    histogram : (N_HEIGHTS,) int32
        Heights in every bin, from :data:`LOWEST_M` on.
    """
    histogram = np.zeros(N_HEIGHTS, np.int32)
    bins = np.empty(len(heights), np.int32)
    for i in range(len(heights)):
        bins[i] = _height_bin(heights[i])
        histogram[bins[i]] += 1
    hist = np.empty(N_HEIGHTS + 2 * HALF, np.int64)
    density = np.empty(N_HEIGHTS + 2 * HALF, np.int64)
    tops = np.empty(N_HEIGHTS, np.int64)
    counts = np.empty(N_HEIGHTS, np.int64)
    state = np.zeros(_SLOTS, np.int64)
    _open_heights(histogram, hist, density, state, share)
    count, height = _main_height(histogram, hist, density, state, tops, counts)
    return count, height, bins, histogram


@kernel(
    "Tuple((int32[::1], int32[::1], float64[::1], float64[::1]))(uint8[:, ::1], float32[:, :, ::1], float32[:, ::1], "
    "float32[:, ::1], int32[:, ::1], int32[::1], int64, int64, int64, float64, float64, float64, int64, float64, "
    "int64, int64, float64)"
)
def potential_heights(
    surface: U8,
    xyz: F32,
    horizontal: F32,
    phihat: F32,
    ahead: I32,
    n_beams: I32,
    first_run: int,
    lowest: int,
    least: int,
    smallest: float,
    sigmas: float,
    noise: float,
    n_fit: int,
    jump: float,
    near: int,
    bridge: int,
    step: float,
) -> tuple[I32, I32, F64, F64]:
    """Find the first potential ground of every row and its height (part a).

    Parameters
    ----------
    surface : (R, n) uint8
    xyz : (R, n, 3) float32, metres
    horizontal : (R, n) float32, metres
        Horizontal distance from the scanner.
    phihat : (R, n) float32, degrees
        Line angles, NaN where there is none.
    ahead : (R, n) int32
        Beam that the line angle was measured to.
    n_beams : (R,) int32
    first_run : int
        Horizontal points in a row to begin with, at least 3.
    lowest : int
        Points whose mean height is the height of potential ground.
    least : int
        Samples that make a mode.
    smallest, sigmas, noise : float
        Bandwidth: the larger of ``smallest`` [deg] and so many standard deviations at a range noise [m].
    n_fit : int
        Points that the local line is laid through.
    jump : float, metres
        Height above or below the last point and the local line that ends potential ground.
    near : int
        Points at the beginning of potential ground that its height is taken from, 0 = all.
    bridge : int
        Points that are not horizontal, and not missing, that a run of horizontal points may pass over, where the next
        :data:`BEHIND` points continue the local line.
    step : float, metres
        Height above or below the local line up to which they continue it.

    Returns
    -------
    first, last : (R,) int32
        Its first and last beam, -1 = none; the horizontal points from one to the other are its points.
    bandwidth : (R,) float64
        That of its line angles at its end [deg], NaN = none.
    height : (R,) float64
        Its height [m], NaN = none.
    """
    n_rows, n = surface.shape
    size = math.ceil(LARGEST_DEG * PER_BANDWIDTH / smallest) + 1
    hist = np.zeros(size + 2 * HALF, np.int64)
    density = np.zeros(size + 2 * HALF, np.int64)
    tops = np.empty(size, np.int64)
    counts = np.empty(size, np.int64)
    beams = np.empty(n + 1, np.int32)
    sampled = np.empty(n + 1, np.int32)
    angles = np.empty((2, n + 1), np.float64)
    first = np.empty(n_rows, np.int32)
    last = np.empty(n_rows, np.int32)
    bandwidth = np.empty(n_rows, np.float64)
    height = np.empty(n_rows, np.float64)
    for row in range(n_rows):
        n_points, b = _potential(
            surface[row], xyz[row], horizontal[row], phihat[row], ahead[row], int(np.int64(n_beams[row])),
            int(np.int64(0)), first_run, least, smallest, sigmas,
            noise, n_fit, jump, bridge, step, beams, sampled, angles, hist, density, tops, counts,
        )  # fmt: skip
        first[row] = last[row] = -1
        bandwidth[row] = height[row] = np.nan
        if n_points > 0:
            first[row] = beams[0]
            last[row] = beams[n_points - 1]
            bandwidth[row] = b
            height[row] = _lowest_mean(xyz[row], beams, n_points, lowest, near)
    return first, last, bandwidth, height


@kernel(
    "Tuple((boolean[:, ::1], float32[::1], int32[::1], int32[::1], float64))(uint8[:, ::1], float32[:, :, ::1], "
    "float32[:, ::1], float32[:, ::1], int32[:, ::1], int32[::1], int32[::1], int32[::1], float64[::1], float64[::1], "
    "int64, int64, int64, float64, float64, float64, int64, float64, int64, int64, float64, int32[::1], int32[::1], "
    "float64, int64, int64, int64, int64, float64, boolean, boolean, float64, float64, float64, boolean)"
)
def ground_rows(  # noqa: PLR0915 - as above
    surface: U8,
    xyz: F32,
    horizontal: F32,
    phihat: F32,
    ahead: I32,
    n_beams: I32,
    first: I32,
    last: I32,
    bandwidth: F64,
    height: F64,
    first_run: int,
    lowest: int,
    least: int,
    smallest: float,
    sigmas: float,
    noise: float,
    n_fit: int,
    jump: float,
    near: int,
    bridge: int,
    step: float,
    histogram: I32,
    recent: I32,
    z_g: float,
    n_counted: int,
    n_start: int,
    n_least: int,
    memory: int,
    share: float,
    count_all: bool,
    renew_all: bool,
    tolerance: float,
    tolerance_m: float,
    guard: float,
    resume: bool,
) -> tuple[Mask, F32, I32, I32, float]:
    """Verify and grow the ground of every row and follow its height (part b).

    Parameters
    ----------
    surface, xyz, horizontal, phihat, ahead, n_beams
        As in :func:`potential_heights`.
    first, last, bandwidth, height
        The first potential ground of every row, of :func:`potential_heights`.
    first_run, lowest, least, smallest, sigmas, noise, n_fit, jump, near, bridge, step
        As in :func:`potential_heights`.
    histogram : (N_HEIGHTS,) int32
        Heights so far, from :data:`LOWEST_M` on; not changed.
    recent : (m,) int32
        Their bins, the oldest one first; only where there is a ``memory``.
    z_g : float, metres
        Height of the ground so far, NaN = unknown.
    n_counted : int
        Rows at the beginning whose heights the histogram holds already.
    n_start : int
        Heights that a first estimate of the ground needs.
    n_least : int
        Heights without which the ground stays unknown.
    memory : int
        Heights that the histogram holds, the oldest one is forgotten; 0 = all.
    share : float
        As in :func:`main_height`.
    count_all : bool
        Count heights of rows without ground too.
    renew_all : bool
        Compute ``z_g`` anew after every height that counts, not after those of rows with ground alone.
    tolerance : float
        Difference between a row's height and ``z_g``, as a share of ``z_g``, below which it is ground.
    tolerance_m : float, metres
        The same at least.
    guard : float, metres
        Height above or below the local line up to which ground grows.
    resume : bool
        Where growth ends within a run of horizontal points, look for more potential ground in the rest of the run.

    Returns
    -------
    ground : (R, n) bool
    z_g : (R,) float32
        Height of the ground after every row [m].
    histogram : (N_HEIGHTS,) int32
    recent : (m,) int32
    z_g : float
        After the last row.
    """
    n_rows, n = surface.shape
    size = math.ceil(LARGEST_DEG * PER_BANDWIDTH / smallest) + 1
    hist = np.zeros(size + 2 * HALF, np.int64)
    density = np.zeros(size + 2 * HALF, np.int64)
    tops = np.empty(max(size, N_HEIGHTS), np.int64)
    counts = np.empty(max(size, N_HEIGHTS), np.int64)
    beams = np.empty(n + 1, np.int32)
    sampled = np.empty(n + 1, np.int32)
    angles = np.empty((2, n + 1), np.float64)
    more = np.empty(n + 1, np.int32)
    heights = histogram.copy()
    queue = np.empty(len(recent) + n_rows, np.int32)
    for i in range(len(recent)):
        queue[i] = recent[i]
    z_hist = np.empty(N_HEIGHTS + 2 * HALF, np.int64)
    z_density = np.empty(N_HEIGHTS + 2 * HALF, np.int64)
    z_state = np.zeros(_SLOTS, np.int64)
    z_state[_NEWEST] = len(recent)
    _open_heights(heights, z_hist, z_density, z_state, share)
    ground = np.zeros((n_rows, n), np.bool_)
    z_rows = np.empty(n_rows, np.float32)
    for row in range(n_rows):
        to_count = row >= n_counted
        n_valid = int(np.int64(n_beams[row]))
        z_row, accepted = np.nan, False
        # the first potential ground is known
        n_points, b, z_i = int(np.int64(0)), bandwidth[row], height[row]
        if first[row] >= 0:
            for k in range(first[row], last[row] + 1):
                beams[n_points] = k
                n_points += surface[row, k] == _HORIZONTAL
        while n_points > 0:
            if to_count and z_state[_N] < n_start:  # too few to begin with: caught up on the way
                _count_height(z_i, heights, queue, memory, z_hist, z_density, z_state, share)
                to_count = False
                if z_g == z_g or z_state[_N] >= n_least:
                    _, z_g = _main_height(heights, z_hist, z_density, z_state, tops, counts)
            accepted = abs(z_i - z_g) < max(tolerance * abs(z_g), tolerance_m)
            if accepted or z_row != z_row:
                z_row = z_i
            if accepted:
                mode = _main_angle(phihat[row], beams, n_points, b, angles, hist, density, tops, counts)
                n_points = _extend(
                    surface[row], xyz[row], horizontal[row], phihat[row], n_valid, beams, n_points, mode, b,
                    n_fit, guard, bridge, step,
                )  # fmt: skip
                if resume:
                    n_points = _resume(
                        surface[row], xyz[row], horizontal[row], phihat[row], ahead[row], n_valid, first_run,
                        least, smallest, sigmas, noise, n_fit, jump, bridge, step, guard, beams, n_points,
                        more, sampled, angles, hist, density, tops, counts,
                    )  # fmt: skip
                for i in range(n_points):
                    ground[row, beams[i]] = True
                break
            n_points, b = _potential(
                surface[row], xyz[row], horizontal[row], phihat[row], ahead[row], n_valid,
                int(np.int64(beams[n_points - 1] + 1)), first_run, least, smallest, sigmas, noise, n_fit, jump, bridge,
                step, beams, sampled, angles, hist, density, tops, counts,
            )  # fmt: skip
            if n_points > 0:
                z_i = _lowest_mean(xyz[row], beams, n_points, lowest, near)
        if to_count and z_row == z_row and (accepted or count_all):
            _count_height(z_row, heights, queue, memory, z_hist, z_density, z_state, share)
            if accepted or renew_all:
                _, z_g = _main_height(heights, z_hist, z_density, z_state, tops, counts)
        z_rows[row] = z_g
    return ground, z_rows, heights, queue[z_state[_OLDEST] : z_state[_NEWEST]].copy(), z_g
