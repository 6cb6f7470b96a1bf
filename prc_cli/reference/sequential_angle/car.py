"""Intervals of lines that may be cars, and their spectrum (Stamos et al. 2012, 7.3 and 7.5)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import ndimage

from prc_cli.core.classes import Surface
from prc_cli.core.types import F32, F64, I32, U8, Mask
from prc_cli.methods.sequential_angle.thresholds import DividerThresholds, FourierThresholds


def high_frequencies(angles: F64, band: float, ratio: float) -> list[int]:
    """Return S: the frequencies of the band that exceed a share of the largest one.

    Those equal within rounding do not exceed it.
    """
    spectrum = np.abs(np.fft.rfft(angles))
    least = ratio * (1 + 1e-9) * spectrum.max()
    first = band * len(angles)
    return [k for k in range(len(spectrum)) if k >= first and spectrum[k] > least]


def stable_intervals(signed_deg: F32, intervals: I32, thresholds: FourierThresholds) -> Mask:
    """Mark intervals with an empty S; see :func:`car_loops.stable_intervals`."""
    decisions = []
    for row, first, last in intervals:
        angles = signed_deg[row, first : last + 1].astype(np.float64)
        angles = angles[~np.isnan(angles)]
        n = len(angles)
        if n == 0:
            decisions.append(False)
            continue
        if 0 < thresholds.longest < n:
            decisions.append(True)
            continue
        n_windows = -(-n // thresholds.window)
        edges = [window * n // n_windows for window in range(n_windows + 1)]
        n_empty = 0
        for begin, end in pairwise(edges):
            if not high_frequencies(angles[begin:end], thresholds.band, thresholds.ratio):
                n_empty += 1
        decisions.append(n_empty >= n_windows / 2)
    return np.array(decisions, dtype=np.bool_)


H = int(Surface.HORIZONTAL)
V = int(Surface.VERTICAL)
"""Surface codes."""


def change_angle(
    points: F64,
    j: int,
    chord_m: float,
    reach: int,
) -> float:
    """Return the signed angle at point j of (n, 3) points with the vertical [deg].

    NaN = no chord.
    """
    distances = np.sqrt(((points - points[j]) ** 2).sum(axis=1))
    far = np.flatnonzero((distances >= chord_m) & (distances > 0)).tolist()
    after = [i for i in far if j < i <= j + reach]
    before = [i for i in far if j - reach <= i < j]
    if not after:
        return np.nan
    end = min(after)
    chord = points[end] - points[j]
    angle = float(np.degrees(np.arccos(np.clip(chord[2] / distances[end], -1, 1))))
    if not before:
        return angle
    chord_before = points[j] - points[max(before)]
    turns_back = float(np.sum(chord * chord_before)) < 0
    return -angle if turns_back else angle


def is_something_under(
    ranges: F64,
    j: int,
    n_before: int,
    threshold_m: float,
) -> bool:
    """Tell whether something under point j lies behind it (TestUnder of the paper)."""
    farthest_m = max(ranges[max(0, j - n_before) : j + 1])
    return bool(farthest_m - ranges[j] > threshold_m)


def is_jump(
    points: F64,
    distance: F64,
    j: int,
    thresholds: DividerThresholds,
) -> bool:
    """Whether the line jumps away from the scanner here, and does not come back."""
    step = points[j + 1] - points[j]
    is_outward = np.sum(step[:2] * points[j, :2]) > 0
    if not is_outward or not np.sqrt(np.sum(step**2)) > thresholds.separation_m:
        return False
    after = slice(j + 2, j + 2 + thresholds.return_points)
    is_near = distance[after] - distance[j] <= 1.0
    is_low = points[after, 2] - points[j, 2] <= 0.8
    return not bool((is_near & is_low).any())


def is_flat(
    distance: F64,
    height: F64,
    residual_m: float,
    slope: float,
) -> bool:
    """Tell whether a straight line through the heights fits and is not steep."""
    along = distance - distance[0]
    gradient, offset = np.polyfit(along, height - height[0], 1)
    residual = height - height[0] - gradient * along - offset
    return bool(abs(gradient) <= slope and np.sqrt(np.mean(residual**2)) <= residual_m)


def flat_stretch(
    distance: F64,
    height: F64,
    length_m: float,
    residual_m: float,
    slope: float,
) -> tuple[int, int] | None:
    """Find points K to L of a horizontal run that are long and flat; None = there are none."""
    last = 0
    for first in range(len(distance)):
        far = [
            i
            for i in range(max(first, last), len(distance))
            if distance[i] - distance[first] >= length_m
        ]
        if not far:
            continue
        last = far[0]
        stop = last + 1
        if is_flat(distance[first:stop], height[first:stop], residual_m, slope):
            while stop < len(distance) and is_flat(
                distance[first : stop + 1], height[first : stop + 1], residual_m, slope
            ):
                stop += 1
            return first, stop - 1
    return None


def runs(codes: list[int], wanted: int) -> list[tuple[int, int]]:
    """Return first and last position of the runs of a code."""
    numbered, _ = ndimage.label(np.equal(codes, wanted))
    return [(place.start, place.stop - 1) for (place,) in ndimage.find_objects(numbered)]


def car_intervals(
    surface: U8,
    range_m: F32,
    xyz_m: F32,
    horizontal_m: F32,
    signed_deg: F32,
    n_beams: I32,
    triggered: Mask,
    ground_m: F32,
    thresholds: DividerThresholds,
) -> I32:
    """Cut triggered rows into intervals; see :func:`car_loops.car_intervals`."""
    intervals: list[tuple[int, int, int]] = []
    for row in range(len(n_beams)):
        if not triggered[row] or np.isnan(ground_m[row]):
            continue
        line = Line(
            surface[row, : n_beams[row]],
            horizontal_m[row].astype(np.float64),
            xyz_m[row, :, 2].astype(np.float64),
            float(ground_m[row]),
        )
        beams = line.searched(thresholds)
        codes = [int(surface[row, k]) for k in beams]
        points = xyz_m[row, beams].astype(np.float64).reshape(-1, 3)
        ranges = range_m[row, beams].astype(np.float64)
        distance = horizontal_m[row, beams].astype(np.float64)
        signed = signed_deg[row, beams].astype(np.float64)
        first_dividers = changes_to_cars(codes, points, ranges, signed, thresholds)
        last_dividers = [
            j
            for j in range(len(beams))
            if j + 1 == len(beams) or is_jump(points, distance, j, thresholds)
        ]
        start = 0
        while dividers := [j for j in first_dividers if j >= start]:
            t1 = dividers[0]
            start = len(beams)
            while t1 < len(beams):
                t2 = min(j for j in last_dividers if j >= t1)
                ground = first_ground(codes, distance, points[:, 2], t1, t2, thresholds)
                if ground:
                    intervals.append((row, beams[t1], beams[ground[0]]))
                    start = ground[1] + 1
                    break
                intervals.append((row, beams[t1], beams[t2]))
                t1 = t2 + 1
    return np.array(intervals, np.int32).reshape(-1, 3)


def changes_to_cars(
    codes: list[int],
    points: F64,
    ranges: F64,
    signed: F64,
    thresholds: DividerThresholds,
) -> list[int]:
    """Return the changes from H to V that may be the begin of a car, and a V at the start."""
    dividers = [0] if thresholds.from_start and codes[:1] == [V] else []
    for j in range(1, len(codes)):
        if codes[j - 1 : j + 1] != [H, V]:
            continue
        angle = np.nan
        if thresholds.change_chord_m > 0:
            angle = change_angle(points, j, thresholds.change_chord_m, thresholds.change_reach)
        if np.isnan(angle):
            angle = float(signed[j])
        is_sudden = angle < thresholds.sudden_from_deg or angle > thresholds.sudden_to_deg
        if is_sudden or is_something_under(ranges, j, thresholds.under_points, thresholds.under_m):
            dividers.append(j)
    return dividers


@dataclass
class Line:
    """A row, and which of its beams are searched for cars."""

    surface: U8
    distance: F64
    height: F64
    ground_m: float

    def searched(self, thresholds: DividerThresholds) -> list[int]:
        """Return the returns up to the first one that is too high, or neither H nor V."""
        returns = [k for k in range(len(self.surface)) if not np.isnan(self.distance[k])]
        beams: list[int] = []
        while returns:
            k = returns[0]
            if self.surface[k] not in (H, V):
                break
            more = [k]
            if self.height[k] > self.ground_m + thresholds.height_m:
                more = self.side_of_van(returns, beams[-1:], thresholds)
                if not more:
                    break
            beams += more
            returns = returns[len(more) :]
        return beams

    def side_of_van(
        self, returns: list[int], last: list[int], thresholds: DividerThresholds
    ) -> list[int]:
        """Return those of the returns, the first too high, that go on with the side of a van.

        Empty = it is none.
        """
        if not last or self.surface[last[0]] != V:
            return []
        n_side = 0
        while n_side < len(returns) and self.surface[returns[n_side]] == V:
            n_side += 1
        side = returns[:n_side]
        goes_on = n_side == len(returns) and returns[-1] == len(self.surface) - 1
        is_too_high = any(self.height[k] > self.ground_m + thresholds.tall_m for k in side)
        return [] if goes_on or is_too_high else side


def first_ground(
    codes: list[int],
    distance: F64,
    height: F64,
    t1: int,
    t2: int,
    thresholds: DividerThresholds,
) -> tuple[int, int] | None:
    """Find the first long flat stretch, within one horizontal run, between two dividers.

    None = there is none.
    """
    steps = np.abs(np.diff(height[t1 : t2 + 1]))
    cuts = (t1 + 1 + np.flatnonzero(steps > thresholds.flat_step_m)).tolist()
    for begin, end in pairwise([t1, *cuts, t2 + 1]):
        for first, last in runs(codes[begin:end], H):
            run = slice(begin + first, begin + last + 1)
            stretch = flat_stretch(
                distance[run],
                height[run],
                thresholds.flat_length_m,
                thresholds.flat_residual_m,
                thresholds.flat_slope,
            )
            if stretch is None:
                continue
            return run.start + stretch[0], run.start + stretch[1]
    return None


def is_too_high(heights: F64, ground_m: float, thresholds: DividerThresholds) -> bool:
    """Tell whether a vertical run is one that no car has, by its height and that of its top."""
    return bool(
        np.ptp(heights) >= thresholds.vertical_extent_m
        and not heights.max() <= ground_m + thresholds.vertical_top_m
    )


def is_straight(distance: F64, heights: F64, thresholds: DividerThresholds) -> bool:
    """Tell whether a vertical run is straight and upright, as no car is."""
    extent_m = np.ptp(heights)
    if extent_m < thresholds.straight_extent_m or extent_m == 0:
        return False
    if extent_m < thresholds.vertical_extent_m:
        return is_upright(
            distance, heights, thresholds.straight_m, thresholds.straight_slope, thresholds
        )
    if len(heights) < thresholds.straight_points:
        return True
    return is_upright(distance, heights, np.inf, thresholds.vertical_slope, thresholds)


def is_upright(
    distance: F64,
    heights: F64,
    residual_m: float,
    slope: float,
    thresholds: DividerThresholds,
) -> bool:
    """Tell whether points are near a straight line that is nearly upright."""
    up = heights - heights[0]
    lean, offset = np.polyfit(up, distance - distance[0], 1)
    residual = distance - distance[0] - lean * up - offset
    is_near = np.sqrt(np.mean(residual**2)) <= residual_m
    most_lean = slope + thresholds.lean_noise_m / np.sqrt(len(heights) * np.var(heights))
    return bool(is_near and abs(lean) <= most_lean)


def cut_verticals(
    surface: U8,
    xyz_m: F32,
    horizontal_m: F32,
    n_beams: I32,
    intervals: I32,
    ground_m: F32,
    thresholds: DividerThresholds,
) -> I32:
    """Take vertical runs out; see :func:`car_loops.cut_verticals`."""
    pieces: list[tuple[int, int, int]] = []
    for row, first, last in intervals.tolist():
        beams = [k for k in range(first, n_beams[row]) if not np.isnan(horizontal_m[row, k])]
        codes = [int(surface[row, k]) for k in beams]
        distance = horizontal_m[row, beams].astype(np.float64)
        height = xyz_m[row, beams, 2].astype(np.float64)
        is_kept = np.array([k <= last for k in beams], np.bool_)

        for begin, end in runs(codes, V):
            run = slice(begin, end + 1)
            if is_too_high(height[run], float(ground_m[row]), thresholds) or is_straight(
                distance[run], height[run], thresholds
            ):
                is_kept[run] = False
        for begin, end in runs(is_kept.astype(int).tolist(), 1):
            pieces.append((row, beams[begin], beams[end]))
    return np.array(pieces, np.int32).reshape(-1, 3)


def firm_intervals(surface: U8, intervals: I32, most: float) -> Mask:
    """Mark intervals without much foliage; see :func:`car_loops.firm_intervals`."""
    firm = []
    for row, first, last in intervals.tolist():
        codes = surface[row, first : last + 1]
        green = np.count_nonzero(codes == Surface.VEGETATION)
        n = np.count_nonzero(codes != Surface.MISSING)
        firm.append(green <= most * n)
    return np.array(firm, np.bool_)
