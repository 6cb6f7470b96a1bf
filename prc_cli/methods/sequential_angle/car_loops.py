"""Loops that cut lines into intervals which may be cars, and test their spectrum.

Stamos et al. (2012), sec. 7.
"""

from __future__ import annotations

import math
from typing import cast

import numpy as np

from prc_cli.core.classes import Surface
from prc_cli.core.loops import helper, loop
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
    U8,
    U8_2,
    Mask_1,
)
from prc_cli.methods.sequential_angle.thresholds import DividerThresholds, FourierThresholds

_CHUNK = 64
"""Frequencies computed at once: enough for vector instructions, few enough to stop early."""

_TIE = 1e-9
"""Relative difference of two magnitudes that counts as none: a spectrum is not more exact."""
ZERO = cast("int", np.int64(0))
NONE = cast("int", np.int64(-1))
"""Integers that numba does not treat as literals: it would compile helpers again for a literal."""


@loop()
def _powers(
    values: F64_1,
    first: int,
    n_frequencies: int,
    power: F64_1,
) -> None:
    """Compute the power of successive frequencies by Goertzel's recursion.

    The loop over frequencies is the inner one because vector instructions work on it.
    """
    n = len(values)
    turn = np.empty(n_frequencies, np.float64)
    state = np.zeros(n_frequencies, np.float64)
    state_before = np.zeros(n_frequencies, np.float64)
    for k in range(n_frequencies):
        turn[k] = 2.0 * math.cos(2.0 * math.pi * (first + k) / n)
    odd = n % 2
    if odd:
        state[:] = values[0]
    for i in range(odd, n, 2):  # two samples a round, so that no state has to be copied
        x = values[i]
        y = values[i + 1]
        for k in range(n_frequencies):
            state_between = x + turn[k] * state[k] - state_before[k]
            state[k] = y + turn[k] * state_between - state[k]
            state_before[k] = state_between
    for k in range(n_frequencies):
        power[k] = max(
            0.0,
            state[k] * state[k]
            + state_before[k] * state_before[k]
            - turn[k] * state[k] * state_before[k],
        )


@loop()
def _is_stable(values: F64_1, band: float, ratio: float) -> bool:
    """Whether no frequency from ``band * N`` up exceeds ``ratio`` times the largest one.

    With a ratio below 1 a frequency of the band exceeds that share of the largest of all if and
    only if one exceeds that share of the largest below the band. So the few frequencies below the
    band come first, then those of the band until one exceeds. The band is skipped if all its energy
    together, known from Parseval's theorem, is too small.
    """
    n = len(values)
    n_low = min(math.ceil(band * n), n // 2 + 1)
    power = np.empty(max(n_low, _CHUNK), np.float64)
    energy = 0.0
    for x in values:
        energy += x * x
    energy *= n
    energy_above = energy
    largest = 0.0
    for first in range(0, n_low, _CHUNK):
        size = min(_CHUNK, n_low - first)
        _powers(values, first, size, power)
        for k in range(size):
            largest = max(largest, power[k])
            energy_above -= power[k] if first + k == 0 or 2 * (first + k) == n else 2.0 * power[k]
    share = (ratio * (1.0 + _TIE)) ** 2
    # every frequency but N/2 has its energy twice, at k and at N - k: as if all were that of N/2
    if energy_above + 1e-12 * energy <= share * largest:
        return True
    for first in range(n_low, n // 2 + 1, _CHUNK):
        size = min(_CHUNK, n // 2 + 1 - first)
        _powers(values, first, size, power)
        for k in range(size):
            if power[k] > share * largest:
                return False
    return True


@loop("prc_cli.reference.sequential_angle.car")
def stable_intervals(signed_deg: F32_2, intervals: I32_2, thresholds: FourierThresholds) -> Mask_1:
    """Mark intervals whose signed angles have no high frequency.

    Long intervals are cut into the least number of windows of nearly equal size; at least half of
    them must be without high frequencies.

    ``signed_deg`` (R, n) float32, degrees; ``intervals`` (K, 3) int32; returns (K,) bool.
    """
    stable = np.zeros(len(intervals), np.bool_)
    values = np.empty(signed_deg.shape[1], np.float64)
    for i in range(len(intervals)):
        row = signed_deg[intervals[i, 0]]
        n = 0
        for k in range(intervals[i, 1], intervals[i, 2] + 1):
            value = row[k]
            if value == value:
                values[n] = value
                n += 1
        if n == 0:
            continue
        if thresholds.longest > 0 and n > thresholds.longest:
            stable[i] = True
            continue
        n_windows = (n + thresholds.window - 1) // thresholds.window
        n_stable = 0
        for window in range(n_windows):
            part = values[window * n // n_windows : (window + 1) * n // n_windows]
            n_stable += _is_stable(part, thresholds.band, thresholds.ratio)
        stable[i] = 2 * n_stable >= n_windows
    return stable


_MISSING = int(Surface.MISSING)
_VEGETATION = int(Surface.VEGETATION)
_HORIZONTAL = int(Surface.HORIZONTAL)
_VERTICAL = int(Surface.VERTICAL)


_Z = 2
_RANGE = 3
_DISTANCE = 4
"""Columns of the points of a row: x, y, z, range, horizontal distance [m]."""
_BACK_M = 1.0
"""A point no farther than this behind the point before a jump is on the same object [m] ..."""
_WINDOW_M = 0.8
"""... if it is no higher above it than the window of a car [m]."""


@helper
def _top_of_van(
    surface: U8,
    horizontal_m: F32,
    xyz_m: F32,
    row: int,
    k: int,
    n: int,
    most_m: float,
) -> int:
    """Return the beam after the vertical run that beam ``k`` continues; -1 = it ends too high."""
    while k < n:
        if horizontal_m[row, k] == horizontal_m[row, k]:
            if surface[row, k] != _VERTICAL:
                return k
            if xyz_m[row, k, 2] > most_m:
                return -1
        elif k + 1 == n:
            return n
        k += 1
    return -1


@helper
def _gather_returns(
    surface: U8,
    range_m: F32,
    xyz_m: F32,
    horizontal_m: F32,
    row: int,
    n: int,
    ground_m: float,
    beam: I32,
    code: U8,
    thresholds: DividerThresholds,
) -> tuple[int, int]:
    """List the returns of a row up to the first one that is neither H nor V, or too high.

    Returns the number of returns, and the index of the first vertical one after a horizontal one.
    With ``from_start`` the first return of the row may be it too.
    """
    size = ZERO
    first = NONE
    code_before = _VERTICAL
    van = ZERO
    limit_m = ground_m + thresholds.height_m
    for k in range(n):
        if range_m[row, k] != range_m[row, k]:
            continue
        code_here = surface[row, k]
        if code_here != _HORIZONTAL and code_here != _VERTICAL:
            break
        if xyz_m[row, k, 2] > limit_m and k >= van:
            if size > 0 and code_before == _VERTICAL:
                van = _top_of_van(
                    surface,
                    horizontal_m,
                    xyz_m,
                    row,
                    k,
                    n,
                    ground_m + thresholds.tall_m,
                )
            if k >= van:
                break
        starts = thresholds.from_start and size == 0
        if first < 0 and code_here == _VERTICAL and (starts or code_before == _HORIZONTAL):
            first = size
        code_before = code_here
        beam[size] = k
        code[size] = code_here
        size += 1
    return size, first if first >= 0 else size


@helper
def _change_angle(
    xyz_m: F32,
    row: int,
    beam: I32,
    size: int,
    j: int,
    chord_m: float,
    reach: int,
) -> float:
    """Return the signed angle of the chord from a point [deg]; NaN = no point is far enough."""
    k = beam[j]
    x = np.float64(xyz_m[row, k, 0])
    y = np.float64(xyz_m[row, k, 1])
    z = np.float64(xyz_m[row, k, 2])
    for after in range(j + 1, min(j + reach, size - 1) + 1):
        k = beam[after]
        dx = np.float64(xyz_m[row, k, 0]) - x
        dy = np.float64(xyz_m[row, k, 1]) - y
        dz = np.float64(xyz_m[row, k, 2]) - z
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if length >= chord_m and length > 0.0:
            angle = math.degrees(math.acos(max(-1.0, min(1.0, dz / length))))
            for before in range(j - 1, max(j - reach, 0) - 1, -1):
                k = beam[before]
                bx = x - np.float64(xyz_m[row, k, 0])
                by = y - np.float64(xyz_m[row, k, 1])
                bz = z - np.float64(xyz_m[row, k, 2])
                back = math.sqrt(bx * bx + by * by + bz * bz)
                if back >= chord_m and back > 0.0:
                    return angle if dx * bx + dy * by + dz * bz >= 0.0 else -angle
            return angle
    return math.nan


@helper
def _starts_interval(
    range_m: F32,
    xyz_m: F32,
    signed_deg: F32,
    row: int,
    beam: I32,
    size: int,
    j: int,
    thresholds: DividerThresholds,
) -> bool:
    """Whether a change from H to V starts an interval: gradual, or sudden with a gap under it."""
    angle = math.nan
    if thresholds.change_chord_m > 0.0:
        angle = _change_angle(
            xyz_m, row, beam, size, j, thresholds.change_chord_m, thresholds.change_reach
        )
    if angle != angle:
        angle = signed_deg[row, beam[j]]
    gradual = angle < thresholds.sudden_from_deg or angle > thresholds.sudden_to_deg
    if gradual:
        return True
    # the paper's TestUnder: one of the points before is farther away
    range_here = np.float64(range_m[row, beam[j]])
    farthest = range_here
    for before in range(max(0, j - thresholds.under_points), j):
        farthest = max(farthest, np.float64(range_m[row, beam[before]]))
    return bool(farthest - range_here > thresholds.under_m)


@helper
def _is_flat(
    sums: F64,
    first: int,
    last: int,
    residual_m: float,
    slope: float,
) -> bool:
    """Whether the straight line through the heights of points fits them and is not steep.

    ``sums`` (points + 1, 5): running sums of h, z, h², hz and z² of the points before each.
    """
    n = last + 1 - first
    mean_h = (sums[last + 1, 0] - sums[first, 0]) / n
    mean_z = (sums[last + 1, 1] - sums[first, 1]) / n
    hh = (sums[last + 1, 2] - sums[first, 2]) / n - mean_h * mean_h
    hz = (sums[last + 1, 3] - sums[first, 3]) / n - mean_h * mean_z
    zz = (sums[last + 1, 4] - sums[first, 4]) / n - mean_z * mean_z
    return bool(abs(hz) <= slope * hh and zz - hz * hz / hh <= residual_m * residual_m)


@helper
def _flat_stretch(
    points: F64,
    first: int,
    last: int,
    thresholds: DividerThresholds,
    sums: F64,
    farthest: F64,
) -> tuple[int, int]:
    """Find the first long flat stretch of a horizontal run; (-1, -1) = none.

    The points from K to the first one that is ``flat_length_m`` farther must be flat; then the
    stretch grows point by point as long as it stays flat. The search for that first point starts
    where it was for the K before.
    """
    length_m = thresholds.flat_length_m
    residual_m = thresholds.flat_residual_m
    slope = thresholds.flat_slope
    size = last + 1 - first
    farthest[size] = -np.inf
    longest = -np.inf
    for i in range(size - 1, -1, -1):
        farthest[i] = max(farthest[i + 1], points[first + i, _DISTANCE])
        longest = max(longest, farthest[i] - points[first + i, _DISTANCE])
    if longest < length_m:
        return -1, -1
    sums[0, :] = 0.0
    for i in range(size):  # from the first point on, so that little is lost to rounding
        h = points[first + i, _DISTANCE] - points[first, _DISTANCE]
        z = points[first + i, _Z] - points[first, _Z]
        sums[i + 1, 0] = sums[i, 0] + h
        sums[i + 1, 1] = sums[i, 1] + z
        sums[i + 1, 2] = sums[i, 2] + h * h
        sums[i + 1, 3] = sums[i, 3] + h * z
        sums[i + 1, 4] = sums[i, 4] + z * z
    end = 0
    for begin in range(size):
        end = max(end, begin)
        if farthest[end] - points[first + begin, _DISTANCE] < length_m:
            continue
        while points[first + end, _DISTANCE] - points[first + begin, _DISTANCE] < length_m:
            end += 1
        if not _is_flat(sums, begin, end, residual_m, slope):
            continue
        while end + 1 < size and _is_flat(sums, begin, end + 1, residual_m, slope):
            end += 1
        return first + begin, first + end
    return -1, -1


@helper
def _first_flat(
    code: U8,
    points: F64,
    begin: int,
    end: int,
    thresholds: DividerThresholds,
    sums: F64,
    farthest: F64,
) -> tuple[int, int]:
    """Find the first long flat stretch of an interval in one horizontal run; (-1, -1) = none."""
    i = begin
    while i <= end:
        first = i
        while i <= end and code[i] == _HORIZONTAL:
            i += 1
            if i <= end and abs(points[i, _Z] - points[i - 1, _Z]) > thresholds.flat_step_m:
                break
        if i > first:
            stretch = _flat_stretch(points, first, i - 1, thresholds, sums, farthest)
            if stretch[0] >= 0:
                return stretch
        if i == first or code[i - 1] != _HORIZONTAL or i > end or code[i] != _HORIZONTAL:
            i += 1
    return -1, -1


@helper
def _comes_back(
    points: F64,
    size: int,
    j: int,
    reach: int,
) -> bool:
    """Whether a point after a jump is near the point before it, as above the window of a car."""
    for after in range(j + 2, min(j + 1 + reach, size - 1) + 1):
        near = points[after, _DISTANCE] - points[j, _DISTANCE] <= _BACK_M
        if near and points[after, _Z] - points[j, _Z] <= _WINDOW_M:
            return True
    return False


@helper
def _next_jump(
    points: F64,
    size: int,
    j: int,
    separation_m: float,
    reach: int,
) -> int:
    """Return the first point from ``j`` on before a jump away from the scanner, or the last one."""
    while j < size - 1:
        dx = points[j + 1, 0] - points[j, 0]
        dy = points[j + 1, 1] - points[j, 1]
        dz = points[j + 1, 2] - points[j, 2]
        ahead = dx * points[j, 0] + dy * points[j, 1] > 0.0
        far = ahead and math.sqrt(dx * dx + dy * dy + dz * dz) > separation_m
        if far and not _comes_back(points, size, j, reach):
            break
        j += 1
    return j


@helper
def _with_room(intervals: I32, size: int) -> I32:
    """Return the list itself, or a copy of twice its length when it is full."""
    if size < len(intervals):
        return intervals
    larger = np.empty((2 * size, 3), np.int32)
    for i in range(size):
        larger[i, 0] = intervals[i, 0]
        larger[i, 1] = intervals[i, 1]
        larger[i, 2] = intervals[i, 2]
    return larger


@loop("prc_cli.reference.sequential_angle.car")
def car_intervals(
    surface: U8_2,
    range_m: F32_2,
    xyz_m: F32_3,
    horizontal_m: F32_2,
    signed_deg: F32_2,
    n_beams: I32_1,
    triggered: Mask_1,
    ground_m: F32_1,
    thresholds: DividerThresholds,
) -> I32_2:
    """Cut the triggered rows into intervals that may be cars.

    ``surface`` (R, n) uint8; ``range_m, horizontal_m`` (R, n) float32, metres; ``xyz_m`` (R, n, 3)
    float32, metres; ``signed_deg`` (R, n) float32, degrees; ``n_beams`` (R,) int32; ``triggered``
    (R,) bool; ``ground_m`` (R,) float32, metres; returns (K, 3) int32.
    """
    n_rows, n = surface.shape
    beam = np.empty(n, np.int32)
    code = np.empty(n, np.uint8)
    points = np.empty((n, 5), np.float64)
    sums = np.empty((n + 1, 5), np.float64)
    farthest = np.empty(n + 1, np.float64)
    intervals = np.empty((64, 3), np.int32)
    n_intervals = 0
    for row in range(n_rows):
        ground = np.float64(ground_m[row])
        if not triggered[row] or ground != ground:
            continue
        size, j = _gather_returns(
            surface,
            range_m,
            xyz_m,
            horizontal_m,
            row,
            int(np.int64(n_beams[row])),
            ground,
            beam,
            code,
            thresholds,
        )
        if j == size:
            continue
        # points before the first change from H to V are in no interval
        for i in range(j, size):
            k = beam[i]
            points[i, 0] = xyz_m[row, k, 0]
            points[i, 1] = xyz_m[row, k, 1]
            points[i, _Z] = xyz_m[row, k, 2]
            points[i, _RANGE] = range_m[row, k]
            points[i, _DISTANCE] = horizontal_m[row, k]
        jump = NONE
        while j < size:
            if code[j] != _VERTICAL or (j > 0 and code[j - 1] != _HORIZONTAL):
                j += 1
                continue
            if j > 0 and not _starts_interval(
                range_m, xyz_m, signed_deg, row, beam, size, j, thresholds
            ):
                j += 1
                continue
            begin = j
            j = size
            while begin < size:  # interval after interval, as long as only jumps divide them
                if jump < begin:
                    jump = _next_jump(
                        points, size, begin, thresholds.separation_m, thresholds.return_points
                    )
                last = jump
                flat_from, flat_to = _first_flat(
                    code, points, begin, last, thresholds, sums, farthest
                )
                intervals = _with_room(intervals, n_intervals)
                intervals[n_intervals, 0] = row
                intervals[n_intervals, 1] = beam[begin]
                intervals[n_intervals, 2] = beam[last if flat_from < 0 else flat_from]
                n_intervals += 1
                begin = last + 1
                if flat_from >= 0:
                    j = flat_to + 1
                    break
    return intervals[:n_intervals].copy()


@helper
def _is_upright(
    sums: F64,
    n: int,
    residual_m: float,
    slope: float,
    noise_m: float,
) -> bool:
    """Whether the straight line through points fits them and is nearly upright.

    ``sums`` are those of z, h, z², zh and h², counted from the first point.
    """
    mean_z = sums[0] / n
    mean_h = sums[1] / n
    zz = sums[2] / n - mean_z * mean_z
    zh = sums[3] / n - mean_z * mean_h
    hh = sums[4] / n - mean_h * mean_h
    upright = abs(zh) <= (slope + noise_m / math.sqrt(n * zz)) * zz
    return bool(upright and hh - zh * zh / zz <= residual_m * residual_m)


@helper
def _add_to_sums(sums: F64, z: float, h: float) -> None:

    sums[0] += z
    sums[1] += h
    sums[2] += z * z
    sums[3] += z * h
    sums[4] += h * h


@helper
def _is_straight(
    xyz_m: F32,
    horizontal_m: F32,
    row: int,
    first: int,
    after: int,
    residual_m: float,
    slope: float,
    noise_m: float,
) -> bool:
    """Whether the straight line through the returns of a run fits them and is nearly upright."""
    n = ZERO
    z_0 = np.float64(xyz_m[row, first, 2])
    h_0 = np.float64(horizontal_m[row, first])
    sums = np.zeros(5, np.float64)
    for j in range(first, after):
        if horizontal_m[row, j] != horizontal_m[row, j]:
            continue
        _add_to_sums(
            sums, np.float64(xyz_m[row, j, 2]) - z_0, np.float64(horizontal_m[row, j]) - h_0
        )
        n += 1
    return _is_upright(sums, n, residual_m, slope, noise_m)


@helper
def _vertical_run(
    surface: U8,
    xyz_m: F32,
    horizontal_m: F32,
    row: int,
    k: int,
    stop: int,
    n: int,
    ground_m: float,
    thresholds: DividerThresholds,
) -> tuple[int, int, bool]:
    """Follow the vertical run from a beam until it is known whether it is a wall.

    Returns the beam after it, its last return within the interval, and whether it is a wall, which
    is cut out.
    """
    last = k
    is_wall = False
    n_points = ZERO
    lowest = np.inf
    highest = -np.inf
    top_m = ground_m + thresholds.vertical_top_m
    j = k
    while j < n and (j < stop or not is_wall):
        if horizontal_m[row, j] == horizontal_m[row, j]:
            if surface[row, j] != _VERTICAL:
                break
            height = np.float64(xyz_m[row, j, 2])
            n_points += 1
            lowest = min(lowest, height)
            highest = max(highest, height)
            is_wall = highest - lowest >= thresholds.vertical_extent_m and not highest <= top_m
            last = j if j < stop else last
        j += 1
    if not is_wall and highest - lowest >= thresholds.straight_extent_m and highest > lowest:
        # a run above the side of a car need not be straight, nor upright if its points are few
        high = highest - lowest >= thresholds.vertical_extent_m
        residual_m = np.inf if high else thresholds.straight_m
        slope = thresholds.vertical_slope if high else thresholds.straight_slope
        few = n_points < thresholds.straight_points
        noise_m = thresholds.lean_noise_m
        is_wall = (high and few) or _is_straight(
            xyz_m, horizontal_m, row, k, j, residual_m, slope, noise_m
        )
    return j, last, is_wall


@loop("prc_cli.reference.sequential_angle.car")
def cut_verticals(
    surface: U8_2,
    xyz_m: F32_3,
    horizontal_m: F32_2,
    n_beams: I32_1,
    intervals: I32_2,
    ground_m: F32_1,
    thresholds: DividerThresholds,
) -> I32_2:
    """Cut vertical runs out of intervals if they are too high for a car, or straight and upright.

    Points behind an interval count in a run that continues there.

    ``surface`` (R, n) uint8; ``xyz_m`` (R, n, 3) float32, metres; ``horizontal_m`` (R, n) float32,
    metres; ``n_beams`` (R,) int32; ``intervals`` (K, 3) int32; ``ground_m`` (R,) float32, metres;
    returns (L, 3) int32.
    """
    n_most = 0
    for i in range(len(intervals)):
        n_most += (intervals[i, 2] - intervals[i, 1]) // 2 + 1
    pieces = np.empty((n_most, 3), np.int32)
    n_pieces = 0
    is_cut = np.zeros(surface.shape[1], np.bool_)
    for i in range(len(intervals)):
        row = intervals[i, 0]
        first = intervals[i, 1]
        stop = intervals[i, 2] + 1
        n = n_beams[row]
        for k in range(first, stop):
            is_cut[k] = False
        k = first
        while k < stop:
            if horizontal_m[row, k] != horizontal_m[row, k] or surface[row, k] != _VERTICAL:
                k += 1
                continue
            after, last, is_wall = _vertical_run(
                surface, xyz_m, horizontal_m, row, k, stop, n, np.float64(ground_m[row]), thresholds
            )
            if is_wall:
                for j in range(k, last + 1):
                    is_cut[j] = True
            k = after
        # first and last return of the current piece
        begin = -1
        end = -1
        for k in range(first, stop):
            if horizontal_m[row, k] != horizontal_m[row, k]:
                continue
            if not is_cut[k]:
                begin = k if begin < 0 else begin
                end = k
            elif begin >= 0:
                pieces[n_pieces, 0] = row
                pieces[n_pieces, 1] = begin
                pieces[n_pieces, 2] = end
                n_pieces += 1
                begin = -1
        if begin >= 0:
            pieces[n_pieces, 0] = row
            pieces[n_pieces, 1] = begin
            pieces[n_pieces, 2] = end
            n_pieces += 1
    return pieces[:n_pieces].copy()


@loop("prc_cli.reference.sequential_angle.car")
def firm_intervals(surface: U8_2, intervals: I32_2, most: float) -> Mask_1:
    """Mark intervals with a share of vegetation of at most ``most``.

    ``surface`` (R, n) uint8; ``intervals`` (K, 3) int32; returns (K,) bool.
    """
    firm = np.zeros(len(intervals), np.bool_)
    for i in range(len(intervals)):
        codes = surface[intervals[i, 0]]
        n = n_green = 0
        for k in range(intervals[i, 1], intervals[i, 2] + 1):
            n += codes[k] != _MISSING
            n_green += codes[k] == _VEGETATION
        firm[i] = np.float64(n_green) <= most * np.float64(n)
    return firm
