"""Modes by mean shift, the ground of a row and its height across rows (Stamos et al. 2012, sec. 5).

Every density is computed from all samples, every set of points is a list.
"""

from __future__ import annotations

import math
from itertools import groupby
from operator import attrgetter, itemgetter
from typing import NamedTuple

import numpy as np

from prc_cli.core.classes import Surface
from prc_cli.core.types import F32, F64, I32, U8, Mask
from prc_cli.methods.sequential_angle.thresholds import (
    GroundState,
    GroundThresholds,
    PotentialGround,
)

EIGHTHS = 8
"""Bins in a bandwidth."""
LOWEST_M = -310
PER_METRE = 500
N_HEIGHTS = 185_000
"""Height where the histogram of heights begins, its bins in a metre, and how many they are."""
HORIZONTAL = int(Surface.HORIZONTAL)
MISSING = int(Surface.MISSING)


def weight(bins_away: int) -> int:
    """Return the Gaussian kernel, a bin being an eighth of a bandwidth, as a whole number.

    Zero beyond 43 bins.
    """
    away = abs(bins_away) / EIGHTHS
    return round(2**20 * math.exp(-away * away / 2)) if abs(bins_away) <= 43 else 0


WEIGHTS = np.array([weight(away) for away in range(-43, 44)])


def grid_modes(samples: list[int]) -> list[Mode]:
    """Return the modes of binned samples, rising."""
    if not samples:
        return []
    lowest = min(samples)
    histogram = np.bincount(np.array(samples) - lowest)
    density = np.convolve(histogram, WEIGHTS)[43:-43].tolist()

    # stretches of equal density, and those of them that are higher, or lower, than what is beside
    # them
    stretches: list[_Stretch] = []
    for value, group in groupby(enumerate(density), key=itemgetter(1)):
        places = [place for place, _ in group]
        stretches.append(_Stretch(places[0] + lowest, places[-1] + lowest, value))
    values = [-1, *(stretch.density for stretch in stretches), -1]
    highs: list[_Stretch] = []
    lows: list[_Stretch] = []
    for i, stretch in enumerate(stretches, start=1):
        if values[i - 1] < values[i] > values[i + 1]:
            highs.append(stretch)
        elif values[i - 1] > values[i] < values[i + 1]:
            lows.append(stretch)

    # a mode has the samples up to the next low; modes nearer than half a bandwidth are one
    borders = [lowest - 1, *(low.last for low in lows), max(samples)]
    groups: list[list[tuple[_Stretch, int]]] = []
    for high, after, up_to in zip(highs, borders[:-1], borders[1:], strict=True):
        n_samples = sum(after < sample <= up_to for sample in samples)
        if groups and high.middle - groups[-1][-1][0].middle < EIGHTHS / 2:
            groups[-1].append((high, n_samples))
        else:
            groups.append([(high, n_samples)])
    modes = []
    for mode_group in groups:
        highest = max((high for high, _ in mode_group), key=attrgetter("density"))
        modes.append(Mode(highest.middle, sum(n_samples for _, n_samples in mode_group)))
    return modes


class _Stretch(NamedTuple):
    """Bins of equal density."""

    first: int
    last: int
    density: int

    @property
    def middle(self) -> float:
        return (self.first + self.last) / 2


class Mode(NamedTuple):
    """A mode of a density."""

    place: float
    """In bins."""
    n_samples: int


def main_mode(modes: list[Mode]) -> Mode:
    """Return the mode with most samples, of equals the lowest, which is the first."""
    return max(modes, key=attrgetter("n_samples"))


class Row:
    """One row, and the rules for potential ground."""

    def __init__(
        self,
        surface: U8,
        xyz: F32,
        horizontal: F32,
        phihat: F32,
        ahead: I32,
        n: int,
        thresholds: GroundThresholds,
    ) -> None:
        self.surface: list[int] = surface[:n].tolist()
        self.xyz = xyz.astype(np.float64)
        self.horizontal = horizontal.astype(np.float64)
        self.phihat = phihat.astype(np.float64)
        self.ahead = ahead
        self.thresholds = thresholds

    def bandwidth(self, beam: int) -> float:
        """Return the bandwidth for line angles at a beam [deg]."""
        here = self.xyz[beam]
        chord = self.xyz[self.ahead[beam]] - here
        sine_by_ranges = np.sqrt(np.sum(np.cross(here, chord) ** 2))
        chord_squared = np.sum(chord**2)
        range_m = np.sqrt(np.sum(here**2))
        noise_deg = 57.29577951308232 * 1.4142135623730951 * self.thresholds.range_noise_m
        with np.errstate(all="ignore"):
            sigma_deg = noise_deg * sine_by_ranges / (chord_squared * range_m)
        by_noise = self.thresholds.bandwidth_sigmas * sigma_deg
        return min(float(np.fmax(self.thresholds.bandwidth_deg, by_noise)), 180.0)

    def bins(self, beams: list[int], b: float) -> list[int]:
        """Bin line angles in eighths of a bandwidth [deg]."""
        last = math.ceil(360.0 * EIGHTHS / self.thresholds.bandwidth_deg)
        bins = [math.floor(self.phihat[beam] / (b / EIGHTHS)) for beam in self.sampled(beams)]
        return [min(max(place, 0), last) for place in bins]

    def sampled(self, beams: list[int]) -> list[int]:
        """Return the beams that have a line angle."""
        return [beam for beam in beams if not np.isnan(self.phihat[beam])]

    def valid(self, after: int) -> list[int]:
        """Return the beams behind one that are not missing."""
        return [beam for beam, s in enumerate(self.surface) if beam > after and s != MISSING]

    def behind(self, points: list[int], after: int) -> int | None:
        """Return the next beam of a surface, None where it ends.

        A few points that are not horizontal are passed over, if two behind them are on its line.
        """
        valid = self.valid(after)
        n_passed = 0
        while n_passed < len(valid) and self.surface[valid[n_passed]] != HORIZONTAL:
            n_passed += 1
        if n_passed == 0:
            return valid[0] if valid else None
        next_two = valid[n_passed : n_passed + 2]
        if n_passed > self.thresholds.bridge or len(next_two) < 2:
            return None
        for beam in next_two:
            is_horizontal = self.surface[beam] == HORIZONTAL
            if not is_horizontal or not self.fits(points, beam, self.thresholds.bridge_height_m):
                return None
        return next_two[0]

    def jumps(self, before: list[int], beam: int) -> bool:
        """Tell whether a point lies at another height than the points before it."""
        jump_m = self.thresholds.jump_m
        rise_m = abs(self.xyz[beam, 2] - self.xyz[before[-1], 2])
        return bool(rise_m > jump_m) and not self.fits(before, beam, jump_m)

    def potential(self, start: int) -> tuple[list[int], float]:
        """Return the first potential ground from a beam on, and the bandwidth at its end."""
        points: list[int] = []
        last = start - 1
        while True:
            beam = self.behind(points, last) if points else None
            if beam is None:  # a new run
                later = [k for k in self.valid(last) if self.surface[k] == HORIZONTAL]
                if not later:
                    return [], math.nan
                points = []
                beam = later[0]
            points = [beam] if points and self.jumps(points, beam) else [*points, beam]
            last = beam
            if len(points) == self.thresholds.first_run:
                collinear, b = self.one_line(points)
                if collinear:
                    return collinear, b
                points = points[1:]

    def one_line(self, points: list[int]) -> tuple[list[int], float]:
        """Return the points whose line angles have one mode, beginning with the given ones."""
        first = True
        size = 0
        b = math.nan
        while True:
            sampled = self.sampled(points[:-1])
            has_one_mode = len(sampled) >= self.thresholds.mode_samples
            if has_one_mode:
                if size == 0 or len(sampled) >= size + size // 2 + 1:
                    size = len(sampled)
                    b = self.bandwidth(sampled[size // 2])
                modes = grid_modes(self.bins(sampled, b))
                n_large = sum(mode.n_samples >= self.thresholds.mode_samples for mode in modes)
                has_one_mode = n_large == 1
            if first and not has_one_mode:
                return [], b
            first = False
            beam = self.behind(points, points[-1])
            if not has_one_mode or beam is None or self.jumps(points, beam):
                return points[:-2], b
            points = [*points, beam]

    def height(self, beams: list[int]) -> float:
        """Return the mean of the lowest points."""
        near = beams[: self.thresholds.height_points or None]
        heights = sorted(float(self.xyz[beam, 2]) for beam in near)[: self.thresholds.lowest_points]
        return float(np.cumsum(heights)[-1] / len(heights))

    def mode(self, beams: list[int], b: float) -> float:
        """Return the main mode of line angles [deg]."""
        mode = main_mode(grid_modes(self.bins(beams, b)))
        return (mode.place + 0.5) * (b / EIGHTHS)

    def fits(self, beams: list[int], beam: int, guard: float) -> bool:
        """Whether a point is on the local line."""
        last = beams[-self.thresholds.growth_points :]
        x = self.horizontal[last]
        z = self.xyz[last, 2]
        mean_x = np.cumsum(x)[-1] / len(x)
        mean_z = np.cumsum(z)[-1] / len(z)
        sum_xx = np.cumsum((x - mean_x) ** 2)[-1]
        sum_xz = np.cumsum((x - mean_x) * (z - mean_z))[-1]
        slope = sum_xz / (sum_xx + len(x) * guard * guard)
        line_z = mean_z + slope * (self.horizontal[beam] - mean_x)
        return bool(abs(self.xyz[beam, 2] - line_z) <= guard)

    def grown(self, beams: list[int], new_beams: list[int], b: float) -> list[int]:
        """Add potential ground to the ground, and grow it over the next horizontal points."""
        mode = self.mode(new_beams, b)
        grown = beams + new_beams
        while (beam := self.behind(grown, grown[-1])) is not None:
            collinear = np.isnan(self.phihat[beam]) or abs(self.phihat[beam] - mode) <= b
            if not collinear or not self.fits(grown, beam, self.thresholds.growth_height_m):
                break
            grown.append(beam)
        return grown

    def labels_of_run(self, after: int) -> list[int]:
        """Return the labels up to too many successive points that are not horizontal."""
        behind = self.valid(after)
        for horizontal, group in groupby(behind, key=lambda beam: self.surface[beam] == HORIZONTAL):
            beams = list(group)
            if not horizontal and len(beams) > self.thresholds.bridge:
                return self.surface[: beams[0]]
        return self.surface


def potential_heights(
    surface: U8,
    xyz: F32,
    horizontal: F32,
    phihat: F32,
    ahead: I32,
    n_beams: I32,
    thresholds: GroundThresholds,
) -> PotentialGround:
    """Find potential ground (part a); see :func:`ground_loops.potential_heights`."""
    first, last = np.full((2, len(surface)), -1, dtype=np.int32)
    bandwidth, height = np.full((2, len(surface)), np.nan)
    for i in range(len(surface)):
        row = Row(surface[i], xyz[i], horizontal[i], phihat[i], ahead[i], n_beams[i], thresholds)
        beams, b = row.potential(0)
        if beams:
            first[i] = beams[0]
            last[i] = beams[-1]
            bandwidth[i] = b
            height[i] = row.height(beams)
    return PotentialGround(first, last, bandwidth, height)


def to_bin(z: float) -> int:
    """Return the bin of 2 mm that a height counts in."""
    return int(np.clip(np.floor((z - LOWEST_M) * PER_METRE), 0, N_HEIGHTS - 1))


def main_height(
    heights: F64,
    share: float,
    roof_m: float,
    roof_share: float,
) -> tuple[int, float, I32, I32]:
    """Find the main mode of heights; see :func:`ground_loops.main_height`."""
    bins = [to_bin(height) for height in heights]
    n_heights, place_m = main_bin(bins, share, roof_m, roof_share)
    return n_heights, place_m, np.array(bins, dtype=np.int32), histogram_of(bins)


def floor_m(bins: float, width: int) -> float:
    """Return a number of half or whole bins as a length, rounded down to bins of heights [m]."""
    return math.floor(bins * width) / PER_METRE


def histogram_of(bins: list[int]) -> I32:
    """Count bins."""
    return np.bincount(np.array(bins, dtype=np.int64), minlength=N_HEIGHTS).astype(np.int32)


def main_bin(
    heights: list[int],
    share: float,
    roof_m: float,
    roof_share: float,
) -> tuple[int, float]:
    """Return the number of binned heights in their main mode, and its place [m]."""
    if not heights:
        return 0, math.nan
    median = sorted(heights)[(len(heights) - 1) // 2]
    width = max(1, math.ceil(share * abs(median + 0.5 + LOWEST_M * PER_METRE) / EIGHTHS))
    modes = grid_modes([height // width for height in heights])
    main = main_mode(modes)
    # a lower mode with enough heights is the ground, and the main one a roof over it
    for mode in modes:
        is_below_roof = floor_m(main.place - mode.place, width) >= roof_m
        if mode.place == main.place or (
            is_below_roof and mode.n_samples >= roof_share * main.n_samples
        ):
            main = mode
            break

    # mean shift, from bin to bin until it stays in one
    centre = math.floor((main.place + 0.5) * width)
    for _ in range(20):
        moment = 0
        mass = 0
        for height in heights:
            bins, remainder = divmod(abs(height - centre), width)
            near = weight(bins) * (width - remainder)
            far = weight(bins + 1) * remainder
            between = (near + far) // width
            moment += between * (height - centre)
            mass += between
        shift = moment / mass if mass else 0.0
        step = math.floor(shift + 0.5)
        if step == 0:
            return main.n_samples, (centre + 0.5 + shift) / PER_METRE + LOWEST_M
        centre += step
    return main.n_samples, (centre + 0.5) / PER_METRE + LOWEST_M


def is_near(z: float, z_g: float, thresholds: GroundThresholds) -> bool:
    """Tell whether a height agrees with that of the ground."""
    off_m = abs(z - z_g)
    within_share = off_m < thresholds.height_tolerance * abs(z_g)
    return within_share or off_m < thresholds.height_tolerance_m


def ground_rows(
    surface: U8,
    xyz: F32,
    horizontal: F32,
    phihat: F32,
    ahead: I32,
    n_beams: I32,
    potential: PotentialGround,
    state: GroundState,
    thresholds: GroundThresholds,
) -> tuple[Mask, F32, GroundState]:
    """Verify and grow ground (part b); see :func:`ground_loops.ground_rows`."""
    memory = thresholds.memory_heights
    ground = np.zeros(surface.shape, dtype=bool)
    z_rows = np.full(len(surface), np.nan, dtype=np.float32)
    if memory:
        heights = state.recent.tolist()
    else:
        heights = np.repeat(np.arange(len(state.histogram)), state.histogram).tolist()
    z_g = state.z_g
    side_m = state.side_m.tolist()

    def ground_height() -> float:
        _, place_m = main_bin(
            heights, thresholds.height_bandwidth, thresholds.roof_m, thresholds.roof_share
        )
        return place_m

    for i in range(len(surface)):
        row = Row(surface[i], xyz[i], horizontal[i], phihat[i], ahead[i], n_beams[i], thresholds)
        to_count = i >= state.n_in_histogram_ahead
        side = i % len(side_m)
        z_row = math.nan
        accepted = False
        first = potential.first[i]
        last = potential.last[i]
        beams = [k for k in np.flatnonzero(surface[i] == HORIZONTAL).tolist() if first <= k <= last]
        b = float(potential.bandwidth_deg[i])
        z_i = float(potential.height_m[i])
        while beams and not accepted:
            if to_count and len(heights) < thresholds.start_heights:
                heights = [*heights, to_bin(z_i)][-memory:]
                to_count = False
                if len(heights) >= thresholds.least_heights or not math.isnan(z_g):
                    z_g = ground_height()
            follows = abs(z_i - side_m[side]) < thresholds.follow_m
            accepted = follows or is_near(z_i, z_g, thresholds)
            if accepted or math.isnan(z_row):
                z_row = z_i
            if accepted:
                side_m[side] = z_i
                ground[i, grown_row(row, beams, b)] = True
            else:
                beams, b = row.potential(beams[-1] + 1)
                z_i = row.height(beams) if beams else math.nan
        if to_count and not math.isnan(z_row):
            heights = [*heights, to_bin(z_row)][-memory:]
            if accepted or thresholds.renew_every:
                z_g = ground_height()
        z_rows[i] = z_g
    new_state = GroundState(
        histogram_of(heights),
        np.array(heights if memory else [], dtype=np.int32),
        z_g,
        max(state.n_in_histogram_ahead - len(surface), 0),
        np.array(side_m),
    )
    return ground, z_rows, new_state


def grown_row(row: Row, beams: list[int], b: float) -> list[int]:
    """Grow potential ground, and look for more of it in the rest of its run."""
    points = row.grown([], beams, b)
    row.surface = row.labels_of_run(points[-1])
    if not row.thresholds.resume:
        return points
    more, b = row.potential(points[-1] + 1)
    while more:
        start = more[-1] + 1
        guard = row.thresholds.growth_height_m
        between = [k for k in row.valid(points[-1]) if k < more[0]]
        is_unbroken = all(row.surface[k] == HORIZONTAL for k in between)
        if not is_unbroken:
            guard = min(guard, row.thresholds.bridge_height_m)
        if row.fits(points, more[0], guard):
            points = row.grown(points, more, b)
            start = points[-1] + 1
        more, b = row.potential(start)
    return points
