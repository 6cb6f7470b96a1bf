"""Slow and obvious twins of the ground kernels, written from the paper (Stamos et al. 2012, sec. 5).

Every density is computed anew from all samples, every set of points is a list. Tests compare; nothing else uses this.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import groupby

import numpy as np

from prc_cli.core.types import F32, F64, I32, I64, U8, Mask

EIGHTHS = 8
HORIZONTAL, MISSING = 2, 0


def weight(bins_away: int) -> int:
    """Return the Gaussian kernel, a bin being an eighth of a bandwidth, as a whole number; zero beyond 43 bins."""
    away = abs(bins_away) / EIGHTHS
    return round(2**20 * math.exp(-away * away / 2)) if abs(bins_away) <= 43 else 0


WEIGHTS = np.array([weight(away) for away in range(-43, 44)])


def grid_modes(samples: list[int]) -> list[tuple[float, int]]:
    """Return place (in bins) and number of samples of every mode of binned samples, rising."""
    if not samples:
        return []
    lowest = min(samples)
    histogram = np.bincount(np.array(samples) - lowest)
    density = np.convolve(histogram, WEIGHTS)[43:-43].tolist()
    # stretches of equal density, and those of them that are higher, or lower, than what is beside them
    stretches: list[tuple[int, int, int]] = []
    for value, group in groupby(enumerate(density), key=lambda pair: pair[1]):
        places = [place for place, _ in group]
        stretches.append((places[0] + lowest, places[-1] + lowest, value))
    values = [-1, *(value for _, _, value in stretches), -1]
    highs = [s for i, s in enumerate(stretches, 1) if values[i - 1] < values[i] > values[i + 1]]
    floors = [s for i, s in enumerate(stretches, 1) if values[i - 1] > values[i] < values[i + 1]]
    parts = [min(samples) - 1, *(last for _, last, _ in floors), max(samples)]
    modes: list[list[tuple[float, int, int]]] = []
    for (first, last, value), after, up_to in zip(highs, parts[:-1], parts[1:], strict=True):
        mode = ((first + last) / 2, value, sum(after < sample <= up_to for sample in samples))
        if modes and mode[0] - modes[-1][-1][0] < EIGHTHS / 2:
            modes[-1].append(mode)
        else:
            modes.append([mode])
    return [
        (max(group, key=lambda mode: (mode[1], -mode[0]))[0], sum(count for _, _, count in group)) for group in modes
    ]


def main_mode(modes: list[tuple[float, int]]) -> tuple[float, int]:
    """Return the mode with most samples, of equals the lowest."""
    return max(modes, key=lambda mode: (mode[1], -mode[0]))


def find_modes(values: F64, bandwidth: float) -> tuple[F64, I64]:
    """Find modes; see :func:`prc_cli.kernels.ground.find_modes`."""
    width = bandwidth / EIGHTHS
    modes = [mode for mode in grid_modes(np.floor(values / width).astype(int).tolist()) if mode[1] > 0]
    return (
        np.array([(place + 0.5) * width for place, _ in modes], dtype=np.float64),
        np.array([count for _, count in modes], dtype=np.int64),
    )


def main_height(histogram: I64, share: float) -> tuple[int, float]:
    """Find the main mode of heights; see :func:`prc_cli.kernels.ground.main_height`."""
    heights = np.repeat(np.arange(len(histogram)), histogram).tolist()
    if not heights:
        return 0, math.nan
    median = sorted(heights)[(len(heights) - 1) // 2]
    width = max(1, math.ceil(share * abs(median + 0.5 - 60_000) / EIGHTHS))
    place, count = main_mode(grid_modes([height // width for height in heights]))
    centre = math.floor((place + 0.5) * width)
    for _ in range(20):
        moment = mass = 0
        for height in heights:
            bins, rest = divmod(abs(height - centre), width)
            between = (weight(bins) * (width - rest) + weight(bins + 1) * rest) // width
            moment += between * (height - centre)
            mass += between
        shift = moment / mass if mass else 0.0
        step = math.floor(shift + 0.5)
        if step == 0:
            return count, (centre + 0.5 + shift) / 1000 - 60
        centre += step
    return count, (centre + 0.5) / 1000 - 60


class Row:
    """One row, and the rules for potential ground."""

    def __init__(
        self,
        surface: U8,
        xyz: F32,
        phihat: F32,
        ahead: I32,
        n: int,
        rules: tuple[int, int, int, float, float, float],
        horizontal: F32,
        n_fit: int,
        jump: float,
    ) -> None:
        self.surface = surface[:n].tolist()
        self.xyz = xyz.astype(np.float64)
        self.phihat = phihat.astype(np.float64)
        self.ahead = ahead
        self.horizontal, self.n_fit, self.jump = horizontal.astype(np.float64), n_fit, jump
        self.first_run, self.lowest, self.least, self.smallest, self.sigmas, self.noise = rules

    def bandwidth(self, beam: int) -> float:
        """Return the bandwidth for line angles at a beam [deg]."""
        here = self.xyz[beam]
        chord = self.xyz[self.ahead[beam]] - here
        sine_by_ranges = np.sqrt(np.sum(np.cross(here, chord) ** 2))
        with np.errstate(all="ignore"):
            sigma = (
                57.29577951308232 * 1.4142135623730951 * self.noise * sine_by_ranges
                / (np.sum(chord**2) * np.sqrt(np.sum(here**2)))
            )  # fmt: skip
        b = float(np.fmax(self.smallest, self.sigmas * sigma))
        return min(b, 180.0)

    def bins(self, beams: list[int], b: float) -> list[int]:
        """Bin line angles."""
        last = math.ceil(360.0 * EIGHTHS / self.smallest)
        angles = [self.phihat[beam] for beam in beams if not np.isnan(self.phihat[beam])]
        return [min(max(math.floor(angle / (b / EIGHTHS)), 0), last) for angle in angles]

    def sampled(self, beams: list[int]) -> list[int]:
        """Return the beams that have a line angle."""
        return [beam for beam in beams if not np.isnan(self.phihat[beam])]

    def runs(self, start: int) -> Iterator[list[int]]:
        """List the runs of horizontal points from a beam on, missing shots left out."""
        valid = [(beam, s) for beam, s in enumerate(self.surface) if beam >= start and s != MISSING]
        for horizontal, group in groupby(valid, key=lambda pair: pair[1] == HORIZONTAL):
            if horizontal:
                yield [beam for beam, _ in group]

    def jumps(self, before: list[int], beam: int) -> bool:
        """Tell whether a point lies at another height than the points before it."""
        rise = abs(self.xyz[beam, 2] - self.xyz[before[-1], 2])
        return bool(rise > self.jump) and not self.fits(before, beam, self.horizontal, self.n_fit, self.jump)

    def potential(self, start: int) -> tuple[list[int], float]:
        """Return the first potential ground from a beam on and the bandwidth at its end (part a)."""
        for run in self.runs(start):
            first, end = 0, 1
            while True:
                while end - first < self.first_run and end < len(run):
                    first = end if self.jumps(run[first:end], run[end]) else first
                    end += 1
                if end - first < self.first_run:
                    break
                found, b = self.one_line(run[first:])
                if found:
                    return found, b
                first += 1
        return [], math.nan

    def one_line(self, points: list[int]) -> tuple[list[int], float]:
        """Return the points at the beginning of a run whose line angles have one mode."""
        n = self.first_run - 1
        size = 0
        b = math.nan
        while True:
            sampled = self.sampled(points[:n])
            one = len(sampled) >= self.least
            if one:
                if size == 0 or len(sampled) >= size + size // 2 + 1:
                    size = len(sampled)
                    b = self.bandwidth(sampled[size // 2])
                modes = grid_modes(self.bins(sampled, b))
                one = sum(count >= self.least for _, count in modes) == 1
            if not one and n == self.first_run - 1:
                return [], b
            if not one or n + 1 == len(points) or self.jumps(points[: n + 1], points[n + 1]):
                return points[: n - 1], b
            n += 1

    def height(self, beams: list[int]) -> float:
        """Return the mean of the lowest points."""
        heights = sorted(float(self.xyz[beam, 2]) for beam in beams)[: self.lowest]
        return float(np.cumsum(heights)[-1] / len(heights))

    def mode(self, beams: list[int], b: float) -> float:
        """Return the main mode of line angles [deg]."""
        place, _ = main_mode(grid_modes(self.bins(beams, b)))
        return (place + 0.5) * (b / EIGHTHS)

    def fits(self, beams: list[int], beam: int, horizontal: F64, n_fit: int, guard: float) -> bool:
        """Tell whether a point lies on the local line."""
        last = beams[-n_fit:]
        x, z = horizontal[last], self.xyz[last, 2]
        mean_x, mean_z = np.cumsum(x)[-1] / len(x), np.cumsum(z)[-1] / len(z)
        sxx = np.cumsum((x - mean_x) ** 2)[-1]
        slope = np.cumsum((x - mean_x) * (z - mean_z))[-1] / (sxx + len(x) * guard * guard)
        return bool(abs(self.xyz[beam, 2] - (mean_z + slope * (horizontal[beam] - mean_x))) <= guard)

    def grown(
        self, beams: list[int], found: list[int], b: float, horizontal: F64, n_fit: int, guard: float
    ) -> list[int]:
        """Add potential ground to the ground so far, and grow it over the horizontal points that follow."""
        mode = self.mode(found, b)
        grown = beams + found
        for beam in range(grown[-1] + 1, len(self.surface)):
            if self.surface[beam] == MISSING:
                continue
            collinear = np.isnan(self.phihat[beam]) or abs(self.phihat[beam] - mode) <= b
            on_line = self.fits(grown, beam, horizontal, n_fit, guard)
            if self.surface[beam] != HORIZONTAL or not collinear or not on_line:
                break
            grown.append(beam)
        return grown


def is_near(z: float, z_g: float, tolerance: float) -> bool:
    """Tell whether a height agrees with that of the ground."""
    with np.errstate(all="ignore"):
        return bool(np.abs(np.float64(z) - z_g) / np.abs(np.float64(z_g)) < tolerance)


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
) -> tuple[I32, F64]:
    """Find potential ground; see :func:`prc_cli.kernels.ground.potential_heights`."""
    rules = (first_run, lowest, least, smallest, sigmas, noise)
    n_points = np.zeros(len(surface), dtype=np.int32)
    height = np.full(len(surface), np.nan)
    for i in range(len(surface)):
        row = Row(surface[i], xyz[i], phihat[i], ahead[i], n_beams[i], rules, horizontal[i], n_fit, jump)
        beams, _ = row.potential(0)
        n_points[i] = len(beams)
        if beams:
            height[i] = row.height(beams)
    return n_points, height


def ground_rows(
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
    histogram: I64,
    z_g: float,
    n_counted: int,
    n_start: int,
    share: float,
    count_all: bool,
    tolerance: float,
    guard: float,
    resume: bool,
) -> tuple[Mask, F32, I64, float]:
    """Verify and grow ground; see :func:`prc_cli.kernels.ground.ground_rows`."""
    rules = (first_run, lowest, least, smallest, sigmas, noise)
    ground = np.zeros(surface.shape, dtype=bool)
    z_rows = np.full(len(surface), np.nan, dtype=np.float32)
    heights = histogram.copy()
    for i in range(len(surface)):
        row = Row(surface[i], xyz[i], phihat[i], ahead[i], n_beams[i], rules, horizontal[i], n_fit, jump)
        to_count = i >= n_counted
        z_i = math.nan
        accepted = False
        beams, b = row.potential(0)
        while beams:
            z_i = row.height(beams)
            if to_count and heights.sum() < n_start:
                heights[to_bin(z_i)] += 1
                to_count = False
                z_g = main_height(heights, share)[1]
            accepted = is_near(z_i, z_g, tolerance)
            if accepted:
                x = horizontal[i].astype(np.float64)
                points = row.grown([], beams, b, x, n_fit, guard)
                rest = [
                    k for k in range(points[-1] + 1, len(row.surface)) if row.surface[k] not in (MISSING, HORIZONTAL)
                ]
                row.surface = row.surface[: rest[0]] if rest else row.surface
                more, b = row.potential(points[-1] + 1) if resume else ([], b)
                while more:
                    start = more[-1] + 1
                    if is_near(row.height(more), z_g, tolerance) and row.fits(points, more[0], x, n_fit, guard):
                        points = row.grown(points, more, b, x, n_fit, guard)
                        start = points[-1] + 1
                    more, b = row.potential(start)
                ground[i, points] = True
                break
            beams, b = row.potential(beams[-1] + 1)
        if to_count and not math.isnan(z_i) and (accepted or count_all):
            heights[to_bin(z_i)] += 1
            if accepted:
                z_g = main_height(heights, share)[1]
        z_rows[i] = z_g
    return ground, z_rows, heights, z_g


def to_bin(z: float) -> int:
    """Return the millimetre that a height counts in."""
    return int(np.clip(np.floor((z + 60.0) * 1000.0), 0, 119_999))
