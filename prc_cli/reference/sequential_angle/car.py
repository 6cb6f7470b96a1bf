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
    n = len(angles)
    spectrum = np.abs(np.fft.rfft(angles))
    largest = spectrum.max()
    return [
        k
        for k in range(len(spectrum))
        if k >= band * n and spectrum[k] > ratio * (1 + 1e-9) * largest
    ]


def stable_intervals(signed_deg: F32, intervals: I32, thresholds: FourierThresholds) -> Mask:
    """Mark intervals with an empty S; see :func:`car_loops.stable_intervals`."""
    decisions = []
    for row, first, last in intervals:
        angles = signed_deg[row, first : last + 1].astype(np.float64)
        angles = angles[~np.isnan(angles)]
        n = len(angles)
        if n < max(thresholds.min_points, 1):
            decisions.append(False)
            continue
        if 0 < thresholds.longest < n:
            decisions.append(True)
            continue
        n_windows = -(-n // thresholds.window)
        edges = [window * n // n_windows for window in range(n_windows + 1)]
        empty = [
            not high_frequencies(angles[a:b], thresholds.band, thresholds.ratio)
            for a, b in pairwise(edges)
        ]
        decisions.append(sum(empty) >= n_windows / 2)
    return np.array(decisions, dtype=np.bool_)


H = int(Surface.HORIZONTAL)
V = int(Surface.VERTICAL)
T = int(Surface.VEGETATION)
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
    far = [i for i in range(len(points)) if distances[i] >= chord_m and distances[i] > 0]
    after = [i for i in far if j < i <= j + reach]
    before = [i for i in far if j - reach <= i < j]
    if not after:
        return np.nan
    chord = points[min(after)] - points[j]
    angle = float(np.degrees(np.arccos(np.clip(chord[2] / distances[min(after)], -1, 1))))
    turns_back = bool(before) and float(np.sum(chord * (points[j] - points[max(before)]))) < 0
    return -angle if turns_back else angle


def is_something_under(
    ranges: F64,
    j: int,
    n_before: int,
    threshold_m: float,
) -> bool:
    """Tell whether something under point j lies behind it (TestUnder of the paper)."""
    return bool(max(ranges[max(0, j - n_before) : j + 1]) - ranges[j] > threshold_m)


def is_jump(
    points: F64,
    distance: F64,
    j: int,
    thresholds: DividerThresholds,
) -> bool:
    """Whether the line jumps away from the scanner here, and does not come back."""
    step = points[j + 1] - points[j]
    far = (
        np.sum(step[:2] * points[j, :2]) > 0 and np.sqrt(np.sum(step**2)) > thresholds.separation_m
    )
    after = slice(j + 2, j + 2 + thresholds.return_points)
    comes_back = (distance[after] - distance[j] <= 1.0) & (points[after, 2] - points[j, 2] <= 0.8)
    return bool(far and not comes_back.any())


def is_flat(
    distance: F64,
    height: F64,
    residual_m: float,
    slope: float,
) -> bool:
    """Tell whether a straight line through the heights fits and is not steep."""
    gradient, offset = np.polyfit(distance - distance[0], height - height[0], 1)
    residual = height - height[0] - gradient * (distance - distance[0]) - offset
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

        changes = [j for j in range(1, len(beams)) if codes[j - 1 : j + 1] == [H, V]]
        chord_m = thresholds.change_chord_m
        reach = thresholds.change_reach
        angles = {
            j: change_angle(points, j, chord_m, reach) if chord_m > 0 else np.nan for j in changes
        }
        angles = {
            j: float(signed_deg[row, beams[j]]) if np.isnan(angle) else angle
            for j, angle in angles.items()
        }
        first_dividers = [
            j
            for j in changes
            if angles[j] < thresholds.sudden_from_deg
            or angles[j] > thresholds.sudden_to_deg
            or is_something_under(ranges, j, thresholds.under_points, thresholds.under_m)
        ]
        last_dividers = [
            j
            for j in range(len(beams))
            if j + 1 == len(beams) or is_jump(points, distance, j, thresholds)
        ]
        if thresholds.from_start and codes[:1] == [V]:
            first_dividers.insert(0, 0)

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


@dataclass
class Line:
    """A row, and which of its beams are searched for cars."""

    surface: U8
    distance: F64
    height: F64
    ground_m: float

    def searched(self, thresholds: DividerThresholds) -> list[int]:
        """Return the returns up to the first one that is too high, or neither H nor V.

        T' in windows is left out.
        """
        returns = [k for k in range(len(self.surface)) if not np.isnan(self.distance[k])]
        beams: list[int] = []
        while returns:
            k = returns[0]
            if self.surface[k] == T and thresholds.glass_m > 0 and self.is_begun(beams, thresholds):
                returns = self.behind_glass(returns, beams[-1], thresholds)
                continue
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

    def is_begun(self, beams: list[int], thresholds: DividerThresholds) -> bool:
        """Whether there was a change from H to V, or a V at the start."""
        codes = self.surface[beams].tolist()
        return (H, V) in pairwise(codes) or (thresholds.from_start and codes[:1] == [V])

    def behind_glass(
        self, returns: list[int], last: int, thresholds: DividerThresholds
    ) -> list[int]:
        """Return those of the returns, T' first, that follow the window of a car.

        Empty = it is none.
        """
        behind = next((i for i, k in enumerate(returns) if self.surface[k] != T), len(returns))
        window = returns[:behind]
        following = returns[behind:]
        if not following or self.surface[following[0]] not in (H, V):
            return []
        near = self.distance[following[0]] <= self.distance[last] + thresholds.glass_m
        low = all(
            not self.height[k] > self.ground_m + thresholds.height_m
            for k in [*window, following[0]]
        )
        return following if near and low and self.height[last] >= self.ground_m + 0.6 else []

    def side_of_van(
        self, returns: list[int], last: list[int], thresholds: DividerThresholds
    ) -> list[int]:
        """Return those of the returns, the first too high, that go on with the side of a van.

        Empty = it is none.
        """
        if not last or self.surface[last[0]] != V:
            return []
        steps = [
            i
            for i, (a, b) in enumerate(pairwise([*last, *returns]))
            if self.surface[b] != V
            or abs(self.distance[b] - self.distance[a]) > thresholds.vertical_break_m
        ]
        run = returns[: steps[0]] if steps else returns
        is_open = not steps and returns[-1] == len(self.surface) - 1
        too_high = any(self.height[k] > self.ground_m + thresholds.tall_m for k in run)
        return [] if is_open or too_high else run


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
    limits = (thresholds.flat_length_m, thresholds.flat_residual_m, thresholds.flat_slope)
    steps = [
        k for k in range(t1 + 1, t2 + 1) if abs(height[k] - height[k - 1]) > thresholds.flat_step_m
    ]
    cuts = [t1, *steps, t2 + 1]
    level = [(a - t1 + f, a - t1 + z) for a, b in pairwise(cuts) for f, z in runs(codes[a:b], H)]
    for first, last in level:
        part = slice(t1 + first, t1 + last + 1)
        stretch = flat_stretch(distance[part], height[part], *limits)
        before = height[t1 : t1 + first + stretch[0]] if stretch else height[:0]
        if (
            stretch
            and not height[t1 + first + stretch[0]] - min(before, default=np.inf)
            > thresholds.flat_above_m
        ):
            return t1 + first + stretch[0], t1 + first + stretch[1]
    return None


def is_too_high(heights: F64, ground_m: float, thresholds: DividerThresholds) -> bool:
    """Tell whether a vertical run is one that no car has, by its height and that of its top."""
    return bool(
        np.ptp(heights) >= thresholds.vertical_extent_m
        and not heights.max() <= ground_m + thresholds.vertical_top_m
    )


def is_open(
    beams: list[int],
    heights: F64,
    n: int,
    thresholds: DividerThresholds,
) -> bool:
    """Tell whether a high vertical run goes on to the last beam."""
    return bool(
        thresholds.vertical_open
        and beams[-1] == n - 1
        and np.ptp(heights) >= thresholds.vertical_extent_m
    )


def is_straight(distance: F64, heights: F64, thresholds: DividerThresholds) -> bool:
    """Tell whether a vertical run is straight and upright, as no car is."""
    if np.ptp(heights) < thresholds.straight_extent_m or np.ptp(heights) == 0:
        return False
    high = bool(np.ptp(heights) >= thresholds.vertical_extent_m)
    if high and len(heights) < thresholds.straight_points:
        return True
    residual_m, slope = (
        (np.inf, thresholds.vertical_slope)
        if high
        else (thresholds.straight_m, thresholds.straight_slope)
    )
    return is_upright(distance, heights, residual_m, slope, thresholds)


def is_upright(
    distance: F64,
    heights: F64,
    residual_m: float,
    slope: float,
    thresholds: DividerThresholds,
) -> bool:
    """Tell whether points are near a straight line that is nearly upright."""
    lean, offset = np.polyfit(heights - heights[0], distance - distance[0], 1)
    residual = distance - distance[0] - lean * (heights - heights[0]) - offset
    near = np.sqrt(np.mean(residual**2)) <= residual_m
    return bool(
        near
        and abs(lean) <= slope + thresholds.lean_noise_m / np.sqrt(len(heights) * np.var(heights))
    )


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
        # beams have the same number up to the next break
        part = np.cumsum(
            [0] + [abs(b - a) > thresholds.vertical_break_m for a, b in pairwise(distance)]
        )
        keep = [k <= last for k in beams]
        vertical = []
        for number in set(part.tolist()):
            of_part = [code if k == number else -1 for code, k in zip(codes, part, strict=True)]
            vertical += runs(of_part, V)
        for begin, end in vertical:
            heights = xyz_m[row, beams[begin : end + 1], 2].astype(np.float64)
            too_high = is_too_high(heights, float(ground_m[row]), thresholds)
            too_high = too_high or is_open(
                beams[begin : end + 1], heights, n_beams[row], thresholds
            )
            if too_high or is_straight(distance[begin : end + 1], heights, thresholds):
                keep[begin : end + 1] = [False] * (end + 1 - begin)
        height = xyz_m[row, beams, 2].astype(np.float64)
        for begin, end in reliefs(codes, distance, height, beams.index(last), thresholds):
            keep[begin : end + 1] = [False] * (end + 1 - begin)
        for begin, end in runs([int(is_kept) for is_kept in keep], 1):
            pieces.append((row, beams[begin], beams[end]))
    return np.array(pieces, np.int32).reshape(-1, 3)


def reliefs(
    codes: list[int],
    distance: F64,
    height: F64,
    last: int,
    thresholds: DividerThresholds,
) -> list[tuple[int, int]]:
    """Return first and last position of rough walls: H and V, high, upright, nearly straight."""
    walls: list[tuple[int, int]] = []
    begin = 0
    while begin <= last and thresholds.relief_m > 0:
        run = [begin] if codes[begin] in (H, V) else []
        while run:
            ahead = range(run[-1] + 1, min(run[-1] + 2 + thresholds.return_points, len(codes)))
            near = [
                k
                for k in ahead
                if codes[k] in (H, V) and abs(distance[k] - distance[run[-1]]) <= 0.1
            ]
            if not near:
                break
            run.append(near[0])
        heights = height[run]
        if (
            len(run) >= thresholds.straight_points
            and np.ptp(heights) >= thresholds.vertical_extent_m
        ):
            limits = thresholds.relief_m, thresholds.straight_slope, thresholds
            if np.ptp(heights) > 0 and is_upright(distance[run], heights, *limits):
                walls.append((begin, run[-1]))
        begin = max([begin, *run]) + 1
    return walls


def firm_intervals(
    surface: U8,
    intervals: I32,
    most: float,
    least: int,
) -> Mask:
    """Mark intervals without much foliage; see :func:`car_loops.firm_intervals`."""
    firm = []
    for row, first, last in intervals.tolist():
        codes = surface[row, first : last + 1]
        green = np.count_nonzero(codes == Surface.VEGETATION)
        n = np.count_nonzero(codes != Surface.MISSING)
        firm.append(n >= least and green <= most * n)
    return np.array(firm, np.bool_)
