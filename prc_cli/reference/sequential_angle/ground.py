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

    def behind(self, after: int) -> int | None:
        """Return the next beam of a surface, None where it ends."""
        valid = self.valid(after)
        return valid[0] if valid and self.surface[valid[0]] == HORIZONTAL else None

    def potential(self, start: int) -> tuple[list[int], float]:
        """Return the first potential ground from a beam on, and the bandwidth at its end."""
        points: list[int] = []
        last = start - 1
        while True:
            beam = self.behind(last) if points else None
            if beam is None:  # a new run
                later = [k for k in self.valid(last) if self.surface[k] == HORIZONTAL]
                if not later:
                    return [], math.nan
                points = []
                beam = later[0]
            points = [*points, beam]
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
            beam = self.behind(points[-1])
            if not has_one_mode or beam is None:
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

    def grown(self, beams: list[int], b: float) -> list[int]:
        """Grow ground over the next horizontal points."""
        mode = self.mode(beams, b)
        grown = list(beams)
        while (beam := self.behind(grown[-1])) is not None:
            collinear = np.isnan(self.phihat[beam]) or abs(self.phihat[beam] - mode) <= b
            if not collinear or not self.fits(grown, beam, self.thresholds.growth_height_m):
                break
            grown.append(beam)
        return grown


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


def main_height(heights: F64, share: float) -> tuple[float, I32]:
    """Find the main mode of heights; see :func:`ground_loops.main_height`."""
    bins = [to_bin(height) for height in heights]
    return main_bin(bins, share), histogram_of(bins)


def histogram_of(bins: list[int]) -> I32:
    """Count bins."""
    return np.bincount(np.array(bins, dtype=np.int64), minlength=N_HEIGHTS).astype(np.int32)


def main_bin(heights: list[int], share: float) -> float:
    """Return the place of the main mode of binned heights [m], NaN = no heights."""
    if not heights:
        return math.nan
    median = sorted(heights)[(len(heights) - 1) // 2]
    width = max(1, math.ceil(share * abs(median + 0.5 + LOWEST_M * PER_METRE) / EIGHTHS))
    main = main_mode(grid_modes([height // width for height in heights]))

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
            return (centre + 0.5 + shift) / PER_METRE + LOWEST_M
        centre += step
    return (centre + 0.5) / PER_METRE + LOWEST_M


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
    ground = np.zeros(surface.shape, dtype=bool)
    z_rows = np.full(len(surface), np.nan, dtype=np.float32)
    heights = np.repeat(np.arange(len(state.histogram)), state.histogram).tolist()
    z_g = state.z_g
    for i in range(len(surface)):
        row = Row(surface[i], xyz[i], horizontal[i], phihat[i], ahead[i], n_beams[i], thresholds)
        to_count = i >= state.n_in_histogram_ahead
        z_row = math.nan
        accepted = False
        first = potential.first[i]
        last = potential.last[i]
        beams = [k for k in np.flatnonzero(surface[i] == HORIZONTAL).tolist() if first <= k <= last]
        b = float(potential.bandwidth_deg[i])
        z_i = float(potential.height_m[i])
        while beams and not accepted:
            if to_count and len(heights) < thresholds.start_heights:
                heights.append(to_bin(z_i))
                to_count = False
                z_g = main_bin(heights, thresholds.height_bandwidth)
            accepted = abs(z_i - z_g) < thresholds.height_tolerance * abs(z_g)
            if accepted or math.isnan(z_row):
                z_row = z_i
            if accepted:
                ground[i, row.grown(beams, b)] = True
            else:
                beams, b = row.potential(beams[-1] + 1)
                z_i = row.height(beams) if beams else math.nan
        if to_count and not math.isnan(z_row):
            heights.append(to_bin(z_row))
            if accepted:
                z_g = main_bin(heights, thresholds.height_bandwidth)
        z_rows[i] = z_g
    n_ahead = max(state.n_in_histogram_ahead - len(surface), 0)
    return ground, z_rows, GroundState(histogram_of(heights), z_g, n_ahead)
