"""Loops that find the ground and the stems of a forest in every scan plane.

Coordinates in the scan plane are those of range and beam: y = r sin b to the side and z = -r cos b
up, with b the angle of the beam from straight down.
"""

from __future__ import annotations

import numpy as np

from prc_cli.core.classes import Label, Reason
from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import F32, F32_2, F64, F64_1, F64_2, I32, I32_2, U8, U8_2, Mask, Mask_2
from prc_cli.core.union_find_loops import find_root
from prc_cli.methods.forest.records import RunPoints, RunStarts
from prc_cli.methods.forest.thresholds import (
    ForestThresholds,
    RunThresholds,
    StemThresholds,
    TerrainThresholds,
)

COUNT, PASSED, LOWEST, HIGHEST = range(4)
"""Columns of the table of runs: shots, returns from behind, lowest and highest end [m]."""
_SHOTS, _PASSED, _RUNS, _LENGTH = range(4)
"""Columns of the sums of a stem: shots, returns from behind, runs, length of these [m]."""

_MISSING = np.uint8(Label.MISSING)
_FAR_BELOW = np.uint8(Reason.FAR_BELOW)
_ALONE = np.uint8(Reason.ALONE)
_SOIL = np.uint8(Reason.SOIL)
_FLAT = np.uint8(Reason.FLAT)
_PLANT = np.uint8(Reason.PLANT)
_ABOVE_TOP = np.uint8(Reason.ABOVE_TOP)
_ON_STEM = np.uint8(Reason.ON_STEM)
_BESIDE_STEM = np.uint8(Reason.BESIDE_STEM)
NO_GROUND = -1e9
"""Height of the ground where none was seen [m]."""
N_LOWEST = 3
"""The ground of a bin is its third-lowest return: one or two may lie below by chance."""
N_OPEN = 3
"""Runs of a line that are followed at the same time: surfaces seen through gaps of the nearest."""
MIN_SHOTS = 3
"""Least shots of a run."""
SPACINGS = 3.0
"""Shots on a wall that are more spacings apart have a gap between them."""
MIN_ASIDE_M = 0.3
"""Least distance from the vertical through the scanner by which spacings are computed."""
LINES_AROUND = 2
"""Lines before and after in which near shots are looked for."""

_MAY_BE_ALONE = 255
_MAY_TOUCH = 254
"""Marks of shots that no rule has labelled yet: they may be alone, or touch a stem."""


@helper
def _low_shots(
    ranges: F32,
    sine: F64,
    cosine: F64,
    n_bins: int,
    thresholds: TerrainThresholds,
    before: F64,
    bins: I32,
    heights: F64,
    shots: I32,
) -> int:
    """List the shots of a line that may be on the ground, return how many; write bins and heights.

    Such a shot is about as far as the return before it.
    """
    half = n_bins // 2
    per_metre = 1.0 / thresholds.bin_m
    step_m = thresholds.near_m
    step_share = thresholds.near_share
    last = np.inf
    for column in range(len(ranges)):
        r = np.float64(ranges[column])
        before[column] = last
        last = r if r == r else last
    for column in range(len(ranges)):
        r = np.float64(ranges[column])
        place = r * sine[column] * per_metre + half
        # false where a range is missing
        counts = (
            (abs(r - before[column]) <= step_m + step_share * r) & (place >= 0.0) & (place < n_bins)
        )
        bins[column] = np.int32(place if counts else -1.0)
        heights[column] = -r * cosine[column]
    n_shots = 0
    for column in range(len(ranges)):
        shots[n_shots] = column
        n_shots += bins[column] >= 0
    return n_shots


@loop()
def ground_profiles(
    range_m: F32_2,
    sine: F64_1,
    cosine: F64_1,
    lines_together: int,
    n_bins: int,
    thresholds: TerrainThresholds,
) -> F64_2:
    """Find the height of the ground to the left and right of the scanner, for a few lines together.

    In every bin to the side the third-lowest return counts that is about as far as the return
    before it in its line. Of these heights those that rise above a neighbour by more than the slope
    allows do not: they are plants.

    ``range_m`` (lines, M) float32, metres; ``sine, cosine`` (M,) float64.
    """
    n_lines, n_columns = range_m.shape
    profiles = np.empty((-(-n_lines // lines_together), n_bins), np.float64)
    lowest = np.empty(n_bins, np.float64)
    second = np.empty(n_bins, np.float64)
    third = np.empty(n_bins, np.float64)
    before = np.empty(n_columns, np.float64)
    heights = np.empty(n_columns, np.float64)
    bins = np.empty(n_columns, np.int32)
    shots = np.empty(n_columns + 1, np.int32)
    for group in range(len(profiles)):
        for b in range(n_bins):
            lowest[b] = second[b] = third[b] = np.inf
        for line in range(group * lines_together, min((group + 1) * lines_together, n_lines)):
            n_shots = _low_shots(
                range_m[line],
                sine,
                cosine,
                n_bins,
                thresholds,
                before,
                bins,
                heights,
                shots,
            )
            for k in range(n_shots):
                shot = np.uint64(shots[k])
                place = np.uint64(bins[shot])
                z = heights[shot]
                if z < third[place]:
                    low = lowest[place]
                    middle = second[place]
                    lowest[place] = min(z, low)
                    second[place] = min(max(z, low), middle)
                    third[place] = max(z, middle)
        profile = profiles[group]
        for b in range(n_bins):
            profile[b] = third[b]
        # no bin is more than this above the next one
        rise = thresholds.slope * thresholds.bin_m
        for b in range(1, len(profile)):
            profile[b] = min(profile[b], profile[b - 1] + rise)
        for b in range(len(profile) - 2, -1, -1):
            profile[b] = min(profile[b], profile[b + 1] + rise)
        # straight lines between the bins that are as low as their own returns, level ends
        last = -1
        for b in range(len(profile)):
            if third[b] == np.inf or third[b] > profile[b]:
                continue
            for k in range(last + 1, b):
                share = 0.0 if last < 0 else (b - k) / (b - last)
                profile[k] = profile[b] + share * (profile[max(last, 0)] - profile[b])
            last = b
        profile[last + 1 :] = profile[last] if last >= 0 else NO_GROUND
    return profiles


@loop()
def ground_heights(
    range_m: F32_2,
    sine: F64_1,
    cosine: F64_1,
    profiles: F64_2,
    lines_together: int,
    bin_m: float,
) -> F32_2:
    """Return how far above the ground of its profile every return is.

    ``range_m`` (lines, M) float32, metres; ``sine, cosine`` (M,) float64; ``profiles`` (groups,
    n_bins) float64, metres; returns (lines, M) float32, metres.
    """
    n_lines, n_columns = range_m.shape
    heights = np.empty((n_lines, n_columns), np.float32)
    bins = np.empty(n_columns, np.int32)
    shares = np.empty(n_columns, np.float64)
    low = np.empty(n_columns, np.float64)
    high = np.empty(n_columns, np.float64)
    n_bins = profiles.shape[1]
    per_metre = 1.0 / bin_m
    half = n_bins // 2
    # step by step: only a loop that reads memory in order uses vector instructions
    for line in range(n_lines):
        ranges = range_m[line]
        profile = profiles[line // lines_together]
        heights_of_line = heights[line]
        # the bin before every shot, and how far beyond its middle the shot is
        for column in range(n_columns):
            r = np.float64(ranges[column])
            place = (r if r == r else 0.0) * sine[column] * per_metre + half - 0.5
            place = min(max(place, 0.0), n_bins - 1.0)
            b = min(np.int32(place), np.int32(n_bins - 2))
            bins[column] = b
            shares[column] = place - np.float64(b)
        for column in range(n_columns):
            bin_before = np.uint64(bins[column])
            low[column] = profile[bin_before]
            high[column] = profile[bin_before + np.uint64(1)]
        for column in range(n_columns):
            r = np.float64(ranges[column])
            ground = low[column] + shares[column] * (high[column] - low[column])
            heights_of_line[column] = np.float32(-r * cosine[column] - ground)
    return heights


@helper
def _high_shots(
    ranges: F32,
    heights: F32,
    sine: F64,
    cosine: F64,
    thresholds: RunThresholds,
    points: RunPoints,
    shots: I32,
) -> int:
    """List the shots of a line that may be on a stem, return how many; write ``points``."""
    side, up, far, tolerances, spacings = points
    low = thresholds.above_m
    base = thresholds.tolerance_m
    share = thresholds.tolerance_share
    angle = SPACINGS * thresholds.step_rad
    for column in range(len(ranges)):
        r = np.float64(ranges[column])
        y = r * sine[column]
        side[column] = y
        up[column] = -r * cosine[column]
        far[column] = r
        tolerances[column] = base + share * r
        spacings[column] = angle * r * r / max(abs(y), MIN_ASIDE_M)
    n_shots = 0
    for column in range(len(ranges)):
        shots[n_shots] = column
        # false where a height is missing
        n_shots += int(np.float64(heights[column]) >= low)
    return n_shots


@inlined
def _is_next(
    apart: float,
    up: float,
    spacing: float,
    tolerance: float,
    steep: float,
    gap: float,
    gap_steep: float,
) -> bool:
    """Whether a return continues a run: ``apart`` to the side and ``up`` from its last one [m].

    False for NaN.
    """
    limit = (
        (tolerance + steep * spacing) + gap_steep * (up - spacing)
        if up > spacing
        else tolerance + steep * up
    )
    return bool((up <= gap) & (apart <= limit))


@helper
def _finish_run(
    run: int,
    n: float,
    passed: float,
    y: float,
    z: float,
    thresholds: RunThresholds,
    firsts: RunStarts,
    ends: F64,
) -> None:
    """Write the row of a run in the table, with 0 shots if it is not kept; none if run < 0."""
    y_first, z_first = firsts
    if run < 0:
        return
    ends[run, COUNT] = 0.0
    up = abs(z - z_first[run])
    is_kept = (n >= MIN_SHOTS) & (2.0 * passed <= n) & (up >= thresholds.short_m)
    if is_kept & (abs(y - y_first[run]) <= thresholds.lean * up):
        ends[run, COUNT] = n
        ends[run, PASSED] = passed
        ends[run, LOWEST] = min(z_first[run], z)
        ends[run, HIGHEST] = max(z_first[run], z)


@inlined
def _finish_run_or_drop(
    run: int,
    n: float,
    passed: float,
    y: float,
    z: float,
    thresholds: RunThresholds,
    firsts: RunStarts,
    ends: F64,
) -> None:
    """Drop a short run, as most are, without the call, which takes longer than the rest."""
    if n >= MIN_SHOTS:
        _finish_run(run, n, passed, y, z, thresholds, firsts, ends)
    elif run >= 0:
        ends[run, COUNT] = 0.0


@helper
def _line_runs(
    shots: I32,
    points: RunPoints,
    thresholds: RunThresholds,
    run_of_shot: I32,
    firsts: RunStarts,
    ends: F64,
) -> int:
    """Write the run of every shot of a list and the table of runs; return how many runs there are.

    Runs 0, 1 and 2 are open, the latest first. Variables with these numbers contain the last shot
    of a run (y, z, range r), its number of shots n, the returns from behind that passed it, and
    those since its last shot (waiting). They are no array, so that they stay in registers.
    """
    side, up, far, tolerances, spacings = points
    steep = thresholds.steep
    gap = thresholds.gap_m
    gap_steep = thresholds.gap_steep
    behind = thresholds.behind_m
    y_first, z_first = firsts
    nothing = np.float64(np.nan)
    run0 = -1
    y0 = nothing
    z0 = nothing
    r0 = nothing
    n0 = 0.0
    passed0 = 0.0
    waiting0 = 0.0
    run1 = -1
    y1 = nothing
    z1 = nothing
    r1 = nothing
    n1 = 0.0
    passed1 = 0.0
    waiting1 = 0.0
    run2 = -1
    y2 = nothing
    z2 = nothing
    r2 = nothing
    n2 = 0.0
    passed2 = 0.0
    waiting2 = 0.0
    n_runs = 0
    for k in range(len(shots)):
        column = np.uint64(shots[k])
        y = side[column]
        z = up[column]
        r = far[column]
        tolerance = tolerances[column]
        spacing = spacings[column]
        if not _is_next(abs(y - y0), abs(z - z0), spacing, tolerance, steep, gap, gap_steep):
            run = run1
            n = n1
            passed = passed1 + waiting1
            if not _is_next(abs(y - y1), abs(z - z1), spacing, tolerance, steep, gap, gap_steep):
                run = run2
                n = n2
                passed = passed2 + waiting2
                if not _is_next(
                    abs(y - y2), abs(z - z2), spacing, tolerance, steep, gap, gap_steep
                ):
                    _finish_run_or_drop(run2, n2, passed2, y2, z2, thresholds, firsts, ends)
                    run = n_runs
                    n = 0.0
                    passed = 0.0
                    y_first[n_runs] = y
                    z_first[n_runs] = z
                    n_runs += 1
                run2 = run1
                y2 = y1
                z2 = z1
                r2 = r1
                n2 = n1
                passed2 = passed1
                waiting2 = waiting1
            run1 = run0
            y1 = y0
            z1 = z0
            r1 = r0
            n1 = n0
            passed1 = passed0
            waiting1 = waiting0
            run0 = run
            n0 = n
            passed0 = passed
            waiting0 = 0.0
        y0 = y
        z0 = z
        r0 = r
        n0 += 1.0
        passed0 += waiting0
        waiting0 = 0.0
        waiting1 += 1.0 if r > r1 + behind else 0.0
        waiting2 += 1.0 if r > r2 + behind else 0.0
        run_of_shot[k] = run0
    _finish_run(run0, n0, passed0, y0, z0, thresholds, firsts, ends)
    _finish_run(run1, n1, passed1, y1, z1, thresholds, firsts, ends)
    _finish_run(run2, n2, passed2, y2, z2, thresholds, firsts, ends)
    return n_runs


@loop()
def upright_runs(
    range_m: F32_2,
    height_m: F32_2,
    sine: F64_1,
    cosine: F64_1,
    thresholds: RunThresholds,
) -> tuple[I32_2, F64_2]:
    """Find runs of returns of a line that go straight up or down in the scan plane.

    A return continues the first of the last three runs that it follows steeply. Returns in between
    may be nearer, of things in front of a stem; returns from behind are counted, because nothing is
    seen through a stem. A run is dropped if more than half as many returns pass it as it has shots.

    ``range_m`` (lines, M) float32, metres; ``height_m`` (lines, M) float32, metres; ``sine,
    cosine`` (M,) float64; returns ``runs`` (lines, M) int32, ``table`` (n_runs + 1, 4) float64.
    """
    n_lines, n_columns = range_m.shape
    runs = np.empty((n_lines, n_columns), np.int32)
    table = np.empty((n_lines * (n_columns // MIN_SHOTS) + 1, 4), np.float64)
    for i in range(4):
        table[0, i] = 0.0
    n_kept = 1
    side = np.empty(n_columns, np.float64)
    up = np.empty(n_columns, np.float64)
    far = np.empty(n_columns, np.float64)
    tolerances = np.empty(n_columns, np.float64)
    spacings = np.empty(n_columns, np.float64)
    points = RunPoints(side, up, far, tolerances, spacings)
    firsts = RunStarts(np.empty(n_columns, np.float64), np.empty(n_columns, np.float64))
    ends = np.empty((n_columns, 4))
    shots = np.empty(n_columns + 1, np.int32)
    run_of_shot = np.empty(n_columns, np.int32)
    number = np.empty(n_columns, np.int32)
    for line in range(n_lines):
        n_shots = _high_shots(
            range_m[line], height_m[line], sine, cosine, thresholds, points, shots
        )
        n_runs = _line_runs(shots[:n_shots], points, thresholds, run_of_shot, firsts, ends)
        for i in range(n_runs):
            number[i] = 0
            if ends[i, COUNT] > 0.0:
                number[i] = n_kept
                for column in range(4):
                    table[n_kept, column] = ends[i, column]
                n_kept += 1
        row = runs[line]
        for column in range(n_columns):
            row[column] = 0
        for k in range(n_shots):
            row[shots[k]] = number[run_of_shot[k]]
    kept = np.empty((n_kept, 4), np.float64)
    for i in range(n_kept):
        for column in range(4):
            kept[i, column] = table[i, column]
    return runs, kept


@helper
def _join_lines(
    earlier_m: F32,
    later_m: F32,
    runs_before: I32,
    runs: I32,
    thresholds: StemThresholds,
    linked: I32,
    parent: I32,
) -> None:
    """Join the runs of two successive lines that have near shots in the same column."""
    near = thresholds.near_m
    share = thresholds.near_share
    n_linked = 0
    for column in range(len(runs)):
        linked[n_linked] = column
        n_linked += (runs[column] != 0) & (runs_before[column] != 0)
    last_run = last_before = 0
    for k in range(n_linked):
        place = np.uint64(linked[k])
        r = np.float64(later_m[place])
        run = runs[place]
        run_before = runs_before[place]
        # most shots join the same runs as the one before
        if (run == last_run) & (run_before == last_before):
            continue
        if abs(r - np.float64(earlier_m[place])) < near + share * r:
            root = find_root(parent, run)
            root_before = find_root(parent, run_before)
            parent[max(root, root_before)] = min(root, root_before)
            last_run = run
            last_before = run_before


@loop()
def stem_shots(
    range_m: F32_2,
    runs: I32_2,
    table: F64_2,
    thresholds: StemThresholds,
) -> Mask_2:
    """Mark the shots on stems: runs that go on from line to line, and are high, long and opaque.

    ``range_m`` (lines, M) float32, metres; ``runs`` (lines, M) int32; ``table`` (n_runs + 1, 4)
    float64; returns (lines, M) bool.
    """
    n_lines, n_columns = range_m.shape
    n_runs = len(table)
    parent = np.empty(n_runs, np.int32)
    sums = np.empty((n_runs, 4), np.float64)
    low = np.empty(n_runs, np.float64)
    high = np.empty(n_runs, np.float64)
    for run in range(n_runs):
        parent[run] = run
        low[run] = np.inf
        high[run] = -np.inf
        for column in range(4):
            sums[run, column] = 0.0
    linked = np.empty(n_columns + 1, np.int32)
    for line in range(1, n_lines):
        _join_lines(
            range_m[line - 1],
            range_m[line],
            runs[line - 1],
            runs[line],
            thresholds,
            linked,
            parent,
        )
    for run in range(1, n_runs):
        root = find_root(parent, run)
        sums[root, _SHOTS] += table[run, COUNT]
        sums[root, _PASSED] += table[run, PASSED]
        sums[root, _RUNS] += 1.0
        sums[root, _LENGTH] += table[run, HIGHEST] - table[run, LOWEST]
        low[root] = min(low[root], table[run, LOWEST])
        high[root] = max(high[root], table[run, HIGHEST])
    is_stem = np.empty(n_runs, np.bool_)
    is_stem[0] = False
    for run in range(1, n_runs):
        root = find_root(parent, run)
        is_stem[run] = (
            sums[root, _SHOTS] >= thresholds.shots
            and sums[root, _RUNS] >= thresholds.runs
            and high[root] - low[root] >= thresholds.extent_m
            and sums[root, _LENGTH] >= thresholds.total_m
            and sums[root, _LENGTH] >= thresholds.mean_m * sums[root, _RUNS]
            and sums[root, _PASSED] <= thresholds.through_share * sums[root, _SHOTS]
        )
    stems = np.empty((n_lines, n_columns), np.bool_)
    for line in range(n_lines):
        runs_of_line = runs[line]
        row = stems[line]
        for column in range(n_columns):
            row[column] = is_stem[np.uint64(runs_of_line[column])]
    return stems


@helper
def _mark_beside(
    stems: Mask,
    line: int,
    across: U8,
    beside: U8,
) -> None:
    """Mark the shots of a line that are on a stem, or have one of the eight around on a stem."""
    n_lines, n = stems.shape
    before = stems[max(line - 1, 0)]
    middle = stems[line]
    after = stems[min(line + 1, n_lines - 1)]
    for i in range(n):
        across[i] = np.uint8(before[i] | middle[i] | after[i])
        beside[i] = across[i]
    inner = beside[: n - 1]
    outer = across[1:]
    for i in range(n - 1):
        inner[i] |= outer[i]
    inner = beside[1:]
    outer = across[: n - 1]
    for i in range(n - 1):
        inner[i] |= outer[i]


@helper
def _label_clear_shots(
    heights: F32,
    stems: Mask,
    flat: U8,
    beside: U8,
    adjacent: U8,
    thresholds: ForestThresholds,
    labels: U8,
) -> None:
    """Label the shots of a line by the first rule that applies; mark those that need other shots.

    No branches but the choice of a rule, so that the compiler can use vector instructions.
    """
    for i in range(len(heights)):
        height = np.float64(heights[i])
        is_below_top = height <= thresholds.top_m
        is_stem = stems[i]
        is_flat = (height <= thresholds.cover_m) & (flat[i] != 0)
        may_touch = is_below_top & (beside[i] != 0)
        has_neighbour = adjacent[i] != 0
        if height != height:
            rule = _MISSING
        elif height < -thresholds.below_m:
            rule = _FAR_BELOW
        elif is_stem & is_below_top:
            rule = _ON_STEM
        elif is_stem:
            rule = _ABOVE_TOP
        elif height <= thresholds.soil_m:
            rule = _SOIL
        elif is_flat:
            rule = _FLAT
        elif may_touch:
            rule = np.uint8(_MAY_TOUCH)
        elif has_neighbour:
            rule = _PLANT
        else:
            rule = np.uint8(_MAY_BE_ALONE)
        labels[i] = rule


@helper
def _touches_stem(
    range_m: F32,
    stems: Mask,
    line: int,
    column: int,
    limit: float,
) -> bool:
    """Whether one of the eight shots around is on a stem and about as far."""
    n_lines, n_columns = range_m.shape
    r = np.float64(range_m[line, column])
    for i in range(max(line - 1, 0), min(line + 2, n_lines)):
        for k in range(max(column - 1, 0), min(column + 2, n_columns)):
            if stems[i, k] and abs(np.float64(range_m[i, k]) - r) <= limit:
                return True
    return False


@helper
def _has_near_shot(
    range_m: F32,
    line: int,
    column: int,
    columns_around: int,
    limit: float,
) -> bool:
    """Whether another shot of the window around is about as far."""
    n_lines, n_columns = range_m.shape
    r = np.float64(range_m[line, column])
    first = max(column - columns_around, 0)
    last = min(column + columns_around + 1, n_columns)
    # the line of the shot first, because most near shots are in it
    for k in range(first, last):
        if k != column and abs(np.float64(range_m[line, k]) - r) <= limit:
            return True
    for i in range(max(line - LINES_AROUND, 0), min(line + LINES_AROUND + 1, n_lines)):
        if i != line:
            for k in range(first, last):
                if abs(np.float64(range_m[i, k]) - r) <= limit:
                    return True
    return False


@loop()
def forest_labels(
    range_m: F32_2,
    height_m: F32_2,
    stems: Mask_2,
    columns_around: int,
    thresholds: ForestThresholds,
) -> U8_2:
    """Give every shot the rule that decides it (:class:`~prc_cli.core.classes.Reason`).

    ``range_m`` (lines, M) float32, metres; ``height_m`` (lines, M) float32, metres; ``stems``
    (lines, M) bool; returns (lines, M) uint8.
    """
    n_lines, n_columns = range_m.shape
    labels = np.empty((n_lines, n_columns), np.uint8)
    flat = np.empty(n_columns, np.uint8)
    across = np.empty(n_columns, np.uint8)
    beside = np.empty(n_columns, np.uint8)
    links = np.empty(n_columns, np.uint8)
    adjacent = np.empty(n_columns, np.uint8)
    shots = np.empty(n_columns + 1, np.int32)
    limit = thresholds.near_m
    for line in range(n_lines):
        row = labels[line]
        ranges = range_m[line]
        heights = height_m[line]
        # shots whose neighbours on both sides are about as high
        flat[0] = flat[n_columns - 1] = np.uint8(0)
        before = heights[: n_columns - 2]
        middle = heights[1 : n_columns - 1]
        after = heights[2:]
        marks = flat[1 : n_columns - 1]
        for i in range(n_columns - 2):
            height = np.float64(middle[i])
            marks[i] = np.uint8(
                (abs(height - np.float64(before[i])) < thresholds.flat_m)
                & (abs(height - np.float64(after[i])) < thresholds.flat_m)
            )
        _mark_beside(stems, line, across, beside)
        # shots with an adjacent shot about as far; if the limit is negative no shot is alone
        most_apart = limit if limit >= 0.0 else np.inf
        for i in range(n_columns - 1):
            step_m = np.float64(ranges[i + 1]) - np.float64(ranges[i])
            links[i] = np.uint8(abs(step_m) <= most_apart)
        links[n_columns - 1] = adjacent[0] = np.uint8(0)
        for i in range(n_columns - 1):
            adjacent[i + 1] = links[i]
        for i in range(n_columns):
            adjacent[i] |= links[i]
        _label_clear_shots(heights, stems[line], flat, beside, adjacent, thresholds, row)
        n_shots = 0
        for column in range(n_columns):
            shots[n_shots] = column
            n_shots += row[column] >= _MAY_TOUCH
        for k in range(n_shots):
            column = shots[k]
            if row[column] == _MAY_TOUCH and _touches_stem(
                range_m, stems, line, column, thresholds.beside_m
            ):
                row[column] = _BESIDE_STEM
            elif (
                limit < 0.0
                or adjacent[column]
                or _has_near_shot(range_m, line, column, columns_around, limit)
            ):
                row[column] = _PLANT
            else:
                row[column] = _ALONE
    return labels
