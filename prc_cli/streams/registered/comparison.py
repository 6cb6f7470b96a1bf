"""Compares a trajectory with the path from the points: clock, lever arm, coordinates.

The scanner has a constant place in the frame of the vehicle. So path minus trajectory is constant
on the axes of the scanner once the clocks agree. Changes of speed separate the clock from the lever
arm along the path.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from prc_cli.core.types import F64, Mask
from prc_cli.streams.registered.path import ScannerPath

COARSE_S = 0.2
"""Step of the clock in the search over a whole drive [s]."""
COARSE_SAMPLES = 240
MOST_SAMPLES = 20_000
"""Positions of the path in the search, and in the fit."""
BATCH = 512
"""Clocks of one batch."""
LEAST_OVERLAP = 0.5
"""Share of the path that the trajectory must cover."""
FAR_M = 15.0
"""A trajectory farther away has other coordinates or is another drive: vehicles are shorter [m]."""
FAR_HEIGHT_M = 10.0
"""Larger differences of heights come from another system, not from a lever arm [m]."""
FOOT_M = 0.3048
MUCH_NEARER = 0.1
"""Largest share of the distance that the right unit leaves."""
MOST_CLOCKS = 5
APART_S = 1.0
"""Clocks at which the fit starts, and their least distance [s]: a street may be passed twice."""
ALIKE_FITS = 1.5
"""Fits with less than this multiple of the least spread are alike."""
LEAST_CLOCK_S = 5e-4
CERTAIN = 3.0
"""Clocks agree within this [s], and within this multiple of the standard deviation."""
ROUNDS = 20
FIRST_SCALE_M = 1.0
LEAST_SCALE_M = 0.002
"""Least residual at which weights halve [m]."""
SPEED_STEP_S = 0.02
"""The speed of the trajectory is measured over twice this time, or two of its steps [s]."""
INDEPENDENT_S = 0.1
"""Positions closer in time than this have the same error [s]."""
CLOCK_SIGMA_S = 0.02
"""A clock with a larger standard deviation is unknown [s]."""
STRAIGHT_M = 1.0
"""A path within this of a straight line (standard deviation) has no shape [m]."""
ALIKE_M = 2.0
ALIKE_SHARE = 0.03
"""Shapes are alike within this [m], or this share of their extent: lever arms turn with
vehicles."""
MOST_DEGREES = (180.0, 90.0)
LEAST_METRES = 1000.0
"""Larger coordinates are not degrees [m]."""


@dataclass(frozen=True, slots=True)
class Positions:
    """Positions of a trajectory, with its own clock."""

    time_s: F64
    """(n,) float64, rising [s]."""
    xyz_m: F64
    """(n, 3) float64 [m]."""
    frame: F64 | None = None
    """(n, 3, 3) float64, columns: forward, left, up of the vehicle; None = not known."""

    def xyz_at(self, time_s: F64) -> F64:
        """Return the positions at times of any shape (...), (..., 3) [m]."""
        return np.stack(
            [np.interp(time_s, self.time_s, self.xyz_m[:, axis]) for axis in range(3)], axis=-1
        )

    def covers(self, time_s: F64) -> Mask:
        """Return which times are within the trajectory, bool of the shape of the times."""
        inside: Mask = (time_s >= self.time_s[0]) & (time_s <= self.time_s[-1])
        return inside

    def speed_at(self, time_s: F64) -> F64:
        """Return the velocity at times (n,), (n, 3) [m/s]."""
        half = max(SPEED_STEP_S, float(np.median(np.diff(self.time_s))))
        before = np.maximum(time_s - half, self.time_s[0])
        after = np.minimum(time_s + half, self.time_s[-1])
        speed: F64 = (self.xyz_at(after) - self.xyz_at(before)) / (after - before)[:, None]
        return speed

    def frame_at(self, time_s: F64) -> F64:
        """Return the axes of the vehicle at the position nearest to times (n,), (n, 3, 3)."""
        assert self.frame is not None
        middle = 0.5 * (self.time_s[1:] + self.time_s[:-1])
        return self.frame[np.searchsorted(middle, time_s)]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Fit of a trajectory to the path of one scanner."""

    scanner: int
    distance_m: float
    """Median distance of the path from the given trajectory [m]; NaN = times do not overlap."""
    clock_s: float
    """Offset to add to the times of the trajectory [s]."""
    clock_sigma_s: float
    """Its standard deviation [s]."""
    lever_m: tuple[float, float, float]
    """From the trajectory's point to the scanner [m], on :attr:`axes`."""
    lever_spread_m: tuple[float, float, float]
    """Standard deviation of the lever arm along the path [m]."""
    axes: str
    """``vehicle``: from the trajectory's orientation; ``scanner``: of the path from the points."""
    forward: str
    """The first axis in words; the others are left and up."""
    overlap: float
    """Share of the path that the trajectory covers with that clock."""
    misfit: str = ""
    """Why this is not one drive in one coordinate system; empty if it is."""

    @property
    def lever_length_m(self) -> float:
        """Return the length of the lever arm [m]."""
        return float(np.linalg.norm(self.lever_m))

    @property
    def spread_m(self) -> float:
        """Return the spread of the lever arm on all axes [m]."""
        return float(np.linalg.norm(self.lever_spread_m))

    @property
    def tells_clock(self) -> bool:
        """Whether the clock is known apart from the lever arm."""
        return self.clock_sigma_s < CLOCK_SIGMA_S


def compare(path: ScannerPath, trajectory: Positions) -> Comparison:
    """Fit the clock and the lever arm of a trajectory to the path of a scanner.

    Parameters
    ----------
    path
        The path from the points.
    trajectory
        Positions of a vehicle or of the scanner.
    """
    every = max(len(path.time_s) // MOST_SAMPLES, 1)
    chosen = slice(None, None, every)
    sample = _Sample(path.time_s[chosen], path.xyz_m[chosen], path.frame[chosen])
    distance_given_m = math.nan
    inside = trajectory.covers(sample.time_s)
    if inside.any():
        off = sample.xyz_m[inside] - trajectory.xyz_at(sample.time_s[inside])
        distance_given_m = float(np.median(np.linalg.norm(off, axis=1)))
    clocks = _near_clocks(sample, trajectory)
    if not clocks:
        why = "the trajectory covers less than half of the path, whatever its clock"
        return _unlike(path, distance_given_m, why)
    nearest_m = min(clock.distance_m for clock in clocks)
    if nearest_m > FAR_M:
        return _unlike(path, distance_given_m, _why_far(sample, trajectory, nearest_m))

    # of fits with alike spreads, the nearest
    near = [clock for clock in clocks if clock.distance_m <= FAR_M]
    fits = [_fit(path.scanner, sample, trajectory, clock.clock_s) for clock in near]
    most_m = ALIKE_FITS * min(fit.spread_m for fit in fits) + LEAST_SCALE_M
    alike = [place for place, fit in enumerate(fits) if fit.spread_m <= most_m]
    best = fits[min(alike, key=lambda place: near[place].distance_m)]
    forward = path.forward if trajectory.frame is None else "forward"
    return replace(best, distance_m=distance_given_m, forward=forward)


@dataclass(frozen=True, slots=True)
class _Sample:
    time_s: F64
    xyz_m: F64
    frame: F64

    def thinned(self) -> _Sample:
        every = max(len(self.time_s) // COARSE_SAMPLES, 1)
        return _Sample(self.time_s[::every], self.xyz_m[::every], self.frame[::every])


def _unlike(path: ScannerPath, distance_given_m: float, why: str) -> Comparison:
    unknown = (math.nan, math.nan, math.nan)
    return Comparison(
        scanner=path.scanner,
        distance_m=distance_given_m,
        clock_s=math.nan,
        clock_sigma_s=math.inf,
        lever_m=unknown,
        lever_spread_m=unknown,
        axes="scanner",
        forward="",
        overlap=math.nan,
        misfit=why,
    )


def _clocks(sample: _Sample, trajectory: Positions) -> F64:
    """Return the clocks of the search [s], one of them 0: all with enough of the path covered."""
    first_s, last_s = sample.time_s[[0, -1]]
    low = first_s - trajectory.time_s[-1]
    high = last_s - trajectory.time_s[0]
    step = max(COARSE_S, (high - low) / 1_000_000)
    first = math.floor(low / step)
    last = math.ceil(high / step)
    clocks: F64 = step * np.arange(first, last + 1, dtype=np.float64)
    return clocks


class _Clock(NamedTuple):
    clock_s: float
    """Offset to add to the times of the trajectory [s]."""
    distance_m: float
    """Median distance of the path in plan with this clock [m]."""


def _near_clocks(sample: _Sample, trajectory: Positions) -> list[_Clock]:
    """Return a few clocks with the nearest trajectory, apart from each other."""
    coarse = sample.thinned()
    clocks = _clocks(coarse, trajectory)
    batches = (clocks[first : first + BATCH] for first in range(0, len(clocks), BATCH))
    distance = np.concatenate([_distances(coarse, trajectory, batch) for batch in batches])
    # the given clock comes first: a vehicle that stands is equally near at many
    order = np.lexsort((np.abs(clocks), np.round(distance, 2)))
    chosen: list[_Clock] = []
    for place in order[np.isfinite(distance[order])]:
        if all(abs(clocks[place] - clock.clock_s) > APART_S for clock in chosen):
            chosen.append(_Clock(float(clocks[place]), float(distance[place])))
        if len(chosen) == MOST_CLOCKS:
            break
    finer: list[_Clock] = []
    for clock in chosen:
        for step in (COARSE_S / 8, COARSE_S / 64):
            clocks = clock.clock_s + step * np.arange(-8, 9, dtype=np.float64)
            distance = _distances(coarse, trajectory, clocks)
            place = int(np.argmin(distance))
            if distance[place] < clock.distance_m - 1e-4:
                clock = _Clock(float(clocks[place]), float(distance[place]))
        finer.append(clock)
    return finer


def _distances(sample: _Sample, trajectory: Positions, clocks: F64) -> F64:
    """Return the median distances in plan (c,) [m]; inf = too little of the path is covered."""
    time_s = sample.time_s[None, :] - clocks[:, None]
    inside = trajectory.covers(time_s)
    off = sample.xyz_m[None, :, :2] - trajectory.xyz_at(time_s)[..., :2]
    away = np.linalg.norm(off, axis=2)
    away[~inside] = np.nan
    is_enough = inside.mean(axis=1) >= LEAST_OVERLAP
    distance = np.full(len(clocks), np.inf)
    if is_enough.any():
        distance[is_enough] = np.nanmedian(away[is_enough], axis=1)
    return distance


def _fit(
    scanner: int,
    sample: _Sample,
    trajectory: Positions,
    clock_s: float,
) -> Comparison:
    """Fit clock and lever arm together; the given clock stays unless the drive shows another."""
    time_s = sample.time_s - clock_s
    inside = trajectory.covers(time_s)
    off_z = sample.xyz_m[inside, 2] - trajectory.xyz_at(time_s[inside])[:, 2]
    height_m = float(np.median(off_z))
    misfit = ""
    if abs(height_m) > FAR_HEIGHT_M:
        misfit = f"the heights differ by {height_m:.2f} m throughout"
        trajectory = replace(trajectory, xyz_m=trajectory.xyz_m + np.array([0.0, 0.0, height_m]))
    solved = _solve(sample, trajectory, clock_s, with_clock=True)
    distance_m = _distances(sample.thinned(), trajectory, np.zeros(1))[0]
    is_unknown = solved.clock_sigma_s > CLOCK_SIGMA_S
    is_near = is_unknown and distance_m < FAR_M
    if is_near or abs(solved.clock_s) < max(CERTAIN * solved.clock_sigma_s, LEAST_CLOCK_S):
        with_given_clock = _solve(sample, trajectory, 0.0, with_clock=False)
        solved = replace(with_given_clock, clock_sigma_s=solved.clock_sigma_s)
    spread = 1.4826 * np.median(np.abs(solved.off_m), axis=0)
    inside = trajectory.covers(sample.time_s - solved.clock_s)
    return Comparison(
        scanner=scanner,
        distance_m=math.nan,
        clock_s=solved.clock_s,
        clock_sigma_s=solved.clock_sigma_s,
        lever_m=(float(solved.lever_m[0]), float(solved.lever_m[1]), float(solved.lever_m[2])),
        lever_spread_m=(float(spread[0]), float(spread[1]), float(spread[2])),
        axes="scanner" if trajectory.frame is None else "vehicle",
        forward="",
        overlap=float(inside.mean()),
        misfit=misfit,
    )


@dataclass(frozen=True, slots=True)
class _Solved:
    clock_s: float
    clock_sigma_s: float
    lever_m: F64
    """(3,) float64."""
    off_m: F64
    """(n, 3) float64, residuals of the lever arm [m]."""


def _solve(
    sample: _Sample,
    trajectory: Positions,
    clock_s: float,
    *,
    with_clock: bool,
) -> _Solved:
    lever = np.zeros(3)
    sigma = math.inf
    scale = FIRST_SCALE_M
    off = np.zeros((1, 3))
    for _ in range(ROUNDS):
        time_s = sample.time_s - clock_s
        inside = trajectory.covers(time_s)
        if np.count_nonzero(inside) < 3:
            break
        time_s = time_s[inside]
        frame = sample.frame[inside] if trajectory.frame is None else trajectory.frame_at(time_s)
        to_scanner = sample.xyz_m[inside] - trajectory.xyz_at(time_s)
        arm = np.einsum("nji,nj->ni", frame, to_scanner)
        # a later clock leaves the trajectory behind
        speed = np.einsum("nji,nj->ni", frame, trajectory.speed_at(time_s))
        off = arm - lever
        weight = 1.0 / (1.0 + (off * off).sum(axis=1) / scale**2)
        mean_arm = np.average(arm, axis=0, weights=weight)
        mean_speed = np.average(speed, axis=0, weights=weight)
        change = speed - mean_speed
        weighted_change = weight[:, None] * change
        stiffness = float((weighted_change * change).sum())
        step = 0.0
        if with_clock and stiffness > 0.0:
            gradient = float((weighted_change * (arm - mean_arm)).sum())
            step = float(np.clip(-gradient / stiffness, -COARSE_S, COARSE_S))
        clock_s += step
        lever = mean_arm + mean_speed * step
        off = arm + speed * step - lever
        spread = float(np.median(np.linalg.norm(off, axis=1)))
        scale = max(3.0 * spread, LEAST_SCALE_M)
        if stiffness > 0.0:
            squares = float((weight[:, None] * off * off).sum())
            variance = squares / max(2.0 * float(weight.sum()), 1e-9)
            # neighbouring errors count as one
            n_independent = max(float(np.ptp(time_s)) / INDEPENDENT_S, 1.0)
            n_alike = max(len(time_s) / n_independent, 1.0)
            sigma = math.sqrt(max(variance, 1e-10) * n_alike / stiffness)
        if abs(step) < 1e-7 and scale < FIRST_SCALE_M:
            break
    return _Solved(clock_s, sigma, lever, off)


def _why_far(sample: _Sample, trajectory: Positions, distance_m: float) -> str:
    """Say whether a trajectory has other coordinates or is another drive."""
    far = f"the trajectory lies {distance_m:,.0f} m from the path found, at the best of all clocks"
    largest_xy = np.abs(trajectory.xyz_m[:, :2]).max(axis=0)
    in_degrees = bool(np.all(largest_xy <= MOST_DEGREES))
    if in_degrees and np.abs(sample.xyz_m[:, :2]).max() > LEAST_METRES:
        return f"{far}: its coordinates look like degrees"
    for reason, changed in _OTHER_UNITS.items():
        clocks = _near_clocks(sample, replace(trajectory, xyz_m=changed(trajectory.xyz_m)))
        nearest_m = min((clock.distance_m for clock in clocks), default=math.inf)
        if nearest_m < min(FAR_M, MUCH_NEARER * distance_m):
            return f"{far}: {reason}"
    if moved := _moved_as_given(sample, trajectory):
        return f"{far}, but has the same path: {moved}"
    coarse = sample.thinned()
    centred = coarse.xyz_m[:, :2] - coarse.xyz_m[:, :2].mean(axis=0)
    smallest = float(np.linalg.svd(centred, compute_uv=False)[-1])
    off_line_m = smallest / math.sqrt(len(centred))
    if off_line_m < STRAIGHT_M:
        return f"{far}: other coordinates or another drive, which a straight path does not tell"
    best = _shape(coarse, trajectory)
    if best.off_m > max(ALIKE_M, ALIKE_SHARE * _extent(coarse.xyz_m)):
        shape = f"no part of it has the same shape (best: {best.off_m:.1f} m off)"
        return f"{far}, and {shape}: another drive"
    return f"{far}, but has the same shape: {best.in_words()}"


def _moved_as_given(sample: _Sample, trajectory: Positions) -> str:
    """Return the constant shift of a trajectory with the given clock, in words; empty if none."""
    if not trajectory.covers(sample.time_s).all():
        return ""
    off = sample.xyz_m - trajectory.xyz_at(sample.time_s)
    spread = float(np.linalg.norm(off.std(axis=0)))
    if spread > MUCH_NEARER * min(_extent(sample.xyz_m), FAR_M):
        return ""
    x, y, z = (off.mean(axis=0).round(1) + 0.0).tolist()
    return f"another coordinate system, moved by x {x:,.1f}, y {y:,.1f}, z {z:,.1f} m throughout"


_OTHER_UNITS: dict[str, Callable[[F64], F64]] = {
    "its x and y are swapped": lambda xyz_m: xyz_m[:, [1, 0, 2]],
    "its unit is feet": lambda xyz_m: xyz_m * FOOT_M,
}
"""Other units and axes of a trajectory, with the way back."""


@dataclass(frozen=True, slots=True)
class _Shape:
    """The turn, scale and move that bring a trajectory onto a path."""

    off_m: float
    """Root mean square of the residuals [m]."""
    factor: complex
    """Scale and turn."""
    moved_m: tuple[float, float, float]

    def in_words(self) -> str:
        """Return the change of coordinates in words."""
        scale = abs(self.factor)
        turn = math.degrees(math.atan2(self.factor.imag, self.factor.real))
        if abs(scale - 1.0) > 0.02:
            return f"its unit is another, {scale:.4f} m, and its coordinate system"
        x, y, z = (round(value, 1) + 0.0 for value in self.moved_m)
        turned = f" and turned by {turn:.2f} deg" if abs(turn) > 0.05 else ""
        return f"another coordinate system, moved by x {x:,.1f}, y {y:,.1f}, z {z:,.1f} m{turned}"


def _shape(sample: _Sample, trajectory: Positions) -> _Shape:
    """Return the closest shape over all clocks at which the trajectory covers the path."""
    path = sample.xyz_m[:, 0] + 1j * sample.xyz_m[:, 1]
    centred_path = path - path.mean()
    best = _Shape(math.inf, 0j, (0.0, 0.0, 0.0))
    clocks = _clocks(sample, trajectory)
    for first in range(0, len(clocks), BATCH):
        time_s = sample.time_s[None, :] - clocks[first : first + BATCH, None]
        is_covered = trajectory.covers(time_s).all(axis=1)
        if not is_covered.any():
            continue
        xyz = trajectory.xyz_at(time_s[is_covered])
        part = xyz[..., 0] + 1j * xyz[..., 1]
        centred = part - part.mean(axis=1, keepdims=True)
        # the turn and scale with the least squares, and what they leave
        power = np.maximum((np.abs(centred) ** 2).sum(axis=1), 1e-12)
        factor = (np.conj(centred) @ centred_path) / power
        squares = (np.abs(centred_path) ** 2).sum() - np.abs(factor) ** 2 * power
        off = np.sqrt(np.maximum(squares, 0.0) / len(path))
        place = int(np.argmin(off))
        if off[place] < best.off_m:
            x, y, z = (sample.xyz_m - xyz[place]).mean(axis=0).tolist()
            best = _Shape(float(off[place]), complex(factor[place]), (x, y, z))
    return best


def _extent(xyz_m: F64) -> float:
    return float(np.linalg.norm(np.ptp(xyz_m[:, :2], axis=0)))
