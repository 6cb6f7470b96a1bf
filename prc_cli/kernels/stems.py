"""Loops that find ground and stems of a forest in the plane of every scan line.

Coordinates in the scan plane are those of range and beam: y = r sin b to the side and z = -r cos b up, with b the
angle of the beam from straight down. Figures come as one array, so that signatures stay short.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F32, F64, I32, U8, Mask
from prc_cli.kernels.cache import helper, kernel

BIN, SLOPE, STEP, STEP_SHARE = range(4)
"""Places in the figures of :func:`ground_profiles`."""
ANGLE, LOW, TOLERANCE, TOLERANCE_SHARE, STEEP, GAP, GAP_STEEP, BEHIND, LEAN, SHORT = range(10)
"""Places in the figures of :func:`upright_runs`."""
NEAR, NEAR_SHARE, SHOTS, RUNS, EXTENT, TOTAL, MEAN, THROUGH = range(8)
"""Places in the figures of :func:`stem_shots`."""
BELOW, SOIL, COVER, FLAT, TOP, BESIDE, COMPANY = range(7)
"""Places in the figures of :func:`forest_labels`."""
COUNT, PASSED, LOWEST, HIGHEST = range(4)
"""Columns of the table of runs: shots, shots from behind, and places in the plane [m]."""

LABEL_MISSING, LABEL_NOISE, LABEL_GROUND, LABEL_VEGETATION, LABEL_STEM = 0, 2, 3, 5, 6
"""As in :class:`prc_cli.core.classes.Label`; the compiler takes no enumerations."""
NO_GROUND = -1e9
"""Height of a ground that was not seen [m]."""
N_LOWEST = 3
"""The ground of a bin is its so many-th lowest return: one or two may lie below, by chance."""
N_OPEN = 3
"""Runs of a line that a return may belong to: surfaces seen in turn through gaps of the nearest."""
MIN_SHOTS = 3
"""Shots of a run."""
SPACINGS = 3.0
"""Shots on a wall are so many spacings apart before there is a gap between them."""
MIN_ASIDE_M = 0.3
"""Nearer to the vertical through the scanner, spacings are as at this distance."""
LINES_AROUND = 2
"""Lines before and after in which company is looked for."""

_N, _PASSED, _WAITING, _Y_FIRST, _Z_FIRST, _Y_LAST, _Z_LAST, _R_LAST, _N_WORK = range(9)
"""Columns of what is worked out for the runs of a line; waiting are shots from behind that may be between two of it."""


@helper
def _lower_towards_neighbours(profile: F64, rise: float) -> None:
    """Let no bin be more than a rise above the next one."""
    for b in range(1, len(profile)):
        profile[b] = min(profile[b], profile[b - 1] + rise)
    for b in range(len(profile) - 2, -1, -1):
        profile[b] = min(profile[b], profile[b + 1] + rise)


@helper
def _bridge(profile: F64, seen: F64) -> None:
    """Put straight lines between the bins that are as low as their own returns; level ends."""
    last = -1
    for b in range(len(profile)):
        if seen[b] == np.inf or seen[b] > profile[b]:
            continue
        for k in range(last + 1, b):
            share = 0.0 if last < 0 else (b - k) / (b - last)
            profile[k] = profile[b] + share * (profile[max(last, 0)] - profile[b])
        last = b
    profile[last + 1 :] = profile[last] if last >= 0 else NO_GROUND


@kernel("float64[:, ::1](float32[:, ::1], float64[::1], float64[::1], int64, int64, float64[::1])")
def ground_profiles(range_m: F32, sine: F64, cosine: F64, lines_together: int, n_bins: int, figures: F64) -> F64:
    """Find the height of the ground to the left and right of the scanner, for a few lines together.

    In every bin to the side the third-lowest return counts that is about as far as the return before it in its line.
    Of these heights those that rise above a neighbour by more than the slope allows do not: they are plants.

    Parameters
    ----------
    range_m : (lines, M) float32, metres
        NaN = missing.
    sine, cosine : (M,) float64
        Of the angle of every column's beam from straight down.
    lines_together : int
        Lines of a profile.
    n_bins : int
        Even; half of them on either side.
    figures : (4,) float64
        Width of a bin [m], greatest slope, and how much farther or nearer the return before may be [m, share of r].

    Returns
    -------
    (ceil(lines / lines_together), n_bins) float64, metres
        Height in the plane over the scanner at the middle of every bin; :data:`NO_GROUND` where none was seen.
    """
    n_lines, n_columns = range_m.shape
    half = n_bins // 2
    per_metre = 1.0 / figures[BIN]
    step_m, step_share = figures[STEP], figures[STEP_SHARE]
    profiles = np.empty((-(-n_lines // lines_together), n_bins), np.float64)
    lowest = np.empty((n_bins, N_LOWEST), np.float64)
    for group in range(len(profiles)):
        lowest[:] = np.inf
        for line in range(group * lines_together, min((group + 1) * lines_together, n_lines)):
            before = np.inf
            for column in range(n_columns):
                r = np.float64(range_m[line, column])
                if r != r:
                    continue
                apart = abs(r - before)
                before = r
                if apart > step_m + step_share * r:
                    continue
                place = r * sine[column] * per_metre + half
                if place < 0.0 or place >= n_bins:
                    continue
                low = lowest[int(place)]
                z = -r * cosine[column]
                if z < low[2]:
                    if z < low[1]:
                        low[2] = low[1]
                        if z < low[0]:
                            low[1] = low[0]
                            low[0] = z
                        else:
                            low[1] = z
                    else:
                        low[2] = z
        profile = profiles[group]
        profile[:] = lowest[:, N_LOWEST - 1]
        _lower_towards_neighbours(profile, figures[SLOPE] * figures[BIN])
        _bridge(profile, lowest[:, N_LOWEST - 1])
    return profiles


@kernel("float32[:, ::1](float32[:, ::1], float64[::1], float64[::1], float64[:, ::1], int64, float64)")
def ground_heights(range_m: F32, sine: F64, cosine: F64, profiles: F64, lines_together: int, bin_m: float) -> F32:
    """Return how far above the ground of its profile every return is.

    Parameters
    ----------
    range_m : (lines, M) float32, metres
        NaN = missing.
    sine, cosine : (M,) float64
        Of the angle of every column's beam from straight down.
    profiles : (groups, n_bins) float64, metres
        From :func:`ground_profiles`.
    lines_together : int
        Lines of a profile.
    bin_m : float, metres
        Width of a bin.

    Returns
    -------
    (lines, M) float32, metres
        In the scan plane, between the middles of bins along straight lines; NaN = missing.
    """
    n_lines, n_columns = range_m.shape
    n_bins = profiles.shape[1]
    half = n_bins // 2
    per_metre = 1.0 / bin_m
    heights = np.empty((n_lines, n_columns), np.float32)
    for line in range(n_lines):
        profile = profiles[line // lines_together]
        for column in range(n_columns):
            r = np.float64(range_m[line, column])
            if r != r:
                heights[line, column] = np.nan
                continue
            place = min(max(r * sine[column] * per_metre + half - 0.5, 0.0), n_bins - 1.0)
            b = min(int(place), n_bins - 2)
            ground = profile[b] + (place - b) * (profile[b + 1] - profile[b])
            heights[line, column] = -r * cosine[column] - ground
    return heights


@helper
def _goes_on(apart: float, up: float, spacing: float, tolerance: float, figures: F64) -> bool:
    """Tell whether a return follows another one steeply, so far beside and up from it."""
    if up > figures[GAP]:
        return False
    if up > spacing:
        return bool(apart <= tolerance + figures[STEEP] * spacing + figures[GAP_STEEP] * (up - spacing))
    return bool(apart <= tolerance + figures[STEEP] * up)


@helper
def _line_runs(ranges: F32, heights: F32, sine: F64, cosine: F64, figures: F64, mine: I32, found: F64) -> int:
    """Write the run of every shot of a line, counted from 0, -1 = none; return how many runs there are."""
    n_runs = 0
    recent = np.full(N_OPEN, -1, np.int64)
    for column in range(len(ranges)):
        mine[column] = -1
        r = np.float64(ranges[column])
        # missing heights are not above anything either
        if not heights[column] >= figures[LOW]:
            continue
        y, z = r * sine[column], -r * cosine[column]
        tolerance = figures[TOLERANCE] + figures[TOLERANCE_SHARE] * r
        spacing = SPACINGS * figures[ANGLE] * r * r / max(abs(y), MIN_ASIDE_M)
        k = 0
        while k < N_OPEN:
            run = recent[k]
            if run >= 0 and _goes_on(
                abs(y - found[run, _Y_LAST]), abs(z - found[run, _Z_LAST]), spacing, tolerance, figures
            ):
                break
            k += 1
        if k < N_OPEN:
            run = recent[k]
            found[run, _N] += 1.0
            found[run, _PASSED] += found[run, _WAITING]
        else:
            run = n_runs
            n_runs += 1
            k = N_OPEN - 1
            found[run, _N] = 1.0
            found[run, _PASSED] = 0.0
            found[run, _Y_FIRST] = y
            found[run, _Z_FIRST] = z
        found[run, _WAITING] = 0.0
        found[run, _Y_LAST] = y
        found[run, _Z_LAST] = z
        found[run, _R_LAST] = r
        mine[column] = run
        for i in range(k, 0, -1):
            recent[i] = recent[i - 1]
        recent[0] = run
        for i in range(1, N_OPEN):
            other = recent[i]
            if other >= 0 and r > found[other, _R_LAST] + figures[BEHIND]:
                found[other, _WAITING] += 1.0
    return n_runs


@helper
def _is_upright(run: F64, figures: F64) -> bool:
    up = abs(run[_Z_LAST] - run[_Z_FIRST])
    if run[_N] < MIN_SHOTS or 2.0 * run[_PASSED] > run[_N]:
        return False
    return bool(up >= figures[SHORT] and abs(run[_Y_LAST] - run[_Y_FIRST]) <= figures[LEAN] * up)


@kernel(
    "Tuple((int32[:, ::1], float64[:, ::1]))"
    "(float32[:, ::1], float32[:, ::1], float64[::1], float64[::1], float64[::1])"
)
def upright_runs(range_m: F32, height_m: F32, sine: F64, cosine: F64, figures: F64) -> tuple[I32, F64]:
    """Find runs of returns of a line that go straight up or down in the scan plane.

    A return goes on with the first run, of the last three, that it follows steeply. Returns in between may be nearer,
    those of what stands before a stem; returns from behind it are counted, because nothing is seen through a stem.
    A run that more returns pass than half its own shots is none.

    Parameters
    ----------
    range_m : (lines, M) float32, metres
        NaN = missing.
    height_m : (lines, M) float32, metres
        From :func:`ground_heights`.
    sine, cosine : (M,) float64
        Of the angle of every column's beam from straight down.
    figures : (10,) float64
        Angle between columns [rad]; height from which on there are runs [m]; how far beside the run a return may be
        [m, share of r] and for every metre up; longest gap [m] and, within gaps, how far beside for every metre up;
        how much farther a return is that is behind [m]; how far a run may lean for every metre up; its least length
        up [m].

    Returns
    -------
    runs : (lines, M) int32
        Number of the run, from 1 in the order of the stream; 0 = none.
    table : (n_runs + 1, 4) float64
        Shots, shots from behind, lowest and highest end in the plane [m]; row 0 is nothing.
    """
    n_lines, n_columns = range_m.shape
    runs = np.zeros((n_lines, n_columns), np.int32)
    table = np.empty((n_lines * (n_columns // MIN_SHOTS) + 1, 4), np.float64)
    table[0] = 0.0
    n_kept = 1
    mine = np.empty(n_columns, np.int32)
    found = np.empty((n_columns, _N_WORK), np.float64)
    number = np.empty(n_columns, np.int32)
    for line in range(n_lines):
        n_runs = _line_runs(range_m[line], height_m[line], sine, cosine, figures, mine, found)
        for i in range(n_runs):
            run = found[i]
            number[i] = 0
            if _is_upright(run, figures):
                number[i] = n_kept
                table[n_kept, COUNT] = run[_N]
                table[n_kept, PASSED] = run[_PASSED]
                table[n_kept, LOWEST] = min(run[_Z_FIRST], run[_Z_LAST])
                table[n_kept, HIGHEST] = max(run[_Z_FIRST], run[_Z_LAST])
                n_kept += 1
        row = runs[line]
        for column in range(n_columns):
            if mine[column] >= 0:
                row[column] = number[mine[column]]
    return runs, table[:n_kept].copy()


@helper
def _root(parent: I32, run: int) -> int:
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@kernel("boolean[:, ::1](float32[:, ::1], int32[:, ::1], float64[:, ::1], float64[::1])")
def stem_shots(range_m: F32, runs: I32, table: F64, figures: F64) -> Mask:
    """Mark the runs that are stems: those that go on from line to line and are high, long and opaque together.

    Parameters
    ----------
    range_m : (lines, M) float32, metres
        NaN = missing.
    runs : (lines, M) int32
        From :func:`upright_runs`.
    table : (n_runs + 1, 4) float64
        Likewise.
    figures : (8,) float64
        Runs of successive lines belong together where shots of a column are this near [m, share of r]. Together they
        have at least so many shots, so many runs, so much from the lowest to the highest end [m], so many metres of
        runs in all and on average, and at most this share of shots from behind.

    Returns
    -------
    (lines, M) bool
    """
    n_lines, n_columns = range_m.shape
    parent = np.arange(len(table)).astype(np.int32)
    for line in range(1, n_lines):
        for column in range(n_columns):
            run, before = runs[line, column], runs[line - 1, column]
            if run == 0 or before == 0:
                continue
            r = np.float64(range_m[line, column])
            if abs(r - np.float64(range_m[line - 1, column])) < figures[NEAR] + figures[NEAR_SHARE] * r:
                one, other = _root(parent, run), _root(parent, before)
                parent[max(one, other)] = min(one, other)
    sums = np.zeros((len(table), 4), np.float64)
    low = np.full(len(table), np.inf)
    high = np.full(len(table), -np.inf)
    for run in range(1, len(table)):
        root = _root(parent, run)
        sums[root, 0] += table[run, COUNT]
        sums[root, 1] += table[run, PASSED]
        sums[root, 2] += 1.0
        sums[root, 3] += table[run, HIGHEST] - table[run, LOWEST]
        low[root] = min(low[root], table[run, LOWEST])
        high[root] = max(high[root], table[run, HIGHEST])
    is_stem = np.zeros(len(table), np.bool_)
    for run in range(1, len(table)):
        root = _root(parent, run)
        is_stem[run] = (
            sums[root, 0] >= figures[SHOTS]
            and sums[root, 2] >= figures[RUNS]
            and high[root] - low[root] >= figures[EXTENT]
            and sums[root, 3] >= figures[TOTAL]
            and sums[root, 3] >= figures[MEAN] * sums[root, 2]
            and sums[root, 1] <= figures[THROUGH] * sums[root, 0]
        )
    stems = np.empty((n_lines, n_columns), np.bool_)
    for line in range(n_lines):
        for column in range(n_columns):
            stems[line, column] = is_stem[runs[line, column]]
    return stems


@helper
def _is_flat(heights: F32, column: int, limit: float) -> bool:
    """Tell whether the shots on both sides are about as high."""
    if column == 0 or column == len(heights) - 1:
        return False
    height = np.float64(heights[column])
    before, after = np.float64(heights[column - 1]), np.float64(heights[column + 1])
    return bool(abs(height - before) < limit and abs(height - after) < limit)


@helper
def _touches_stem(range_m: F32, stems: Mask, line: int, column: int, limit: float) -> bool:
    """Tell whether one of the eight shots around is a stem's and about as far."""
    n_lines, n_columns = range_m.shape
    r = np.float64(range_m[line, column])
    for i in range(max(line - 1, 0), min(line + 2, n_lines)):
        for k in range(max(column - 1, 0), min(column + 2, n_columns)):
            if stems[i, k] and abs(np.float64(range_m[i, k]) - r) <= limit:
                return True
    return False


@helper
def _has_company(range_m: F32, line: int, column: int, columns_around: int, limit: float) -> bool:
    """Tell whether another shot nearby is about as far."""
    n_lines, n_columns = range_m.shape
    r = np.float64(range_m[line, column])
    first, last = max(column - columns_around, 0), min(column + columns_around + 1, n_columns)
    # its own line first, where it is found most often
    for k in range(first, last):
        if k != column and abs(np.float64(range_m[line, k]) - r) <= limit:
            return True
    for i in range(max(line - LINES_AROUND, 0), min(line + LINES_AROUND + 1, n_lines)):
        if i != line:
            for k in range(first, last):
                if abs(np.float64(range_m[i, k]) - r) <= limit:
                    return True
    return False


@kernel("uint8[:, ::1](float32[:, ::1], float32[:, ::1], boolean[:, ::1], int64, float64[::1])")
def forest_labels(range_m: F32, height_m: F32, stems: Mask, columns_around: int, figures: F64) -> U8:
    """Label a block of forest.

    Parameters
    ----------
    range_m : (lines, M) float32, metres
        NaN = missing.
    height_m : (lines, M) float32, metres
        From :func:`ground_heights`.
    stems : (lines, M) bool
        From :func:`stem_shots`.
    columns_around : int
        Columns on either side in which company is looked for.
    figures : (7,) float64
        How far below the ground a return may be [m]; up to which height all is ground, up to which it is where it is
        flat, and what is flat [m from shot to shot]; the height up to which stems are stems [m]; how far from a stem's
        shot, in range, what touches it may be, and how far from each other shots in company may be [m], below 0 for
        whatever company.

    Returns
    -------
    (lines, M) uint8
        In this order: NOISE below the ground; STEM; GROUND; STEM where it touches one; VEGETATION in company; NOISE.
    """
    n_lines, n_columns = range_m.shape
    labels = np.empty((n_lines, n_columns), np.uint8)
    for line in range(n_lines):
        heights = height_m[line]
        for column in range(n_columns):
            height = np.float64(heights[column])
            label = LABEL_MISSING
            if height < -figures[BELOW]:
                label = LABEL_NOISE
            elif stems[line, column]:
                label = LABEL_STEM if height <= figures[TOP] else LABEL_VEGETATION
            elif height <= figures[SOIL] or (height <= figures[COVER] and _is_flat(heights, column, figures[FLAT])):
                label = LABEL_GROUND
            elif height <= figures[TOP] and _touches_stem(range_m, stems, line, column, figures[BESIDE]):
                label = LABEL_STEM
            elif height == height:
                company = figures[COMPANY]
                plant = company < 0.0 or _has_company(range_m, line, column, columns_around, company)
                label = LABEL_VEGETATION if plant else LABEL_NOISE
            labels[line, column] = label
    return labels
