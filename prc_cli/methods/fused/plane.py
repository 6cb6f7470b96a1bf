"""The scan plane: beam directions, coordinates of the shots, and the scanner's range noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, F64, I32

AROUND_LINES = 5
"""Lines before and after a block that its labels depend on."""
INNER_LINES = 2
"""Outermost of these lines, whose neighbours are unknown."""
WIDE_LINES = 2
"""Lines before and after a line whose strips and smoothness are combined with its own."""
VOTE_LINES = 1
"""Lines before and after a block whose labels take part in the vote."""
NORMAL_QUARTILE = 0.6745
"""Half of a normal distribution lies within this many standard deviations."""
MIDDLE_OF_THREE = 1.5
"""Variance of a range's deviation from the mean of its two neighbours, in variances of one range."""
PART_LINES = 32
"""Lines by which the noise at the begin of a stream is measured; not more than are known after a block."""
PIECE_PARTS, FIRST_PARTS = 4, 12
"""Parts of so many lines by which it is measured later, and after how many it is measured ever more seldom."""
EVERY_LINE, MANY_COLUMNS = 4, 256
"""With so many columns and more, every fourth line is enough."""
LEAST_TRIPLES = 100
"""Fewest shots to measure the noise from."""
_TURN = 2 * np.pi


class SensorParams(Params):
    """How precisely the scanner measures (``[fused.sensor]``)."""

    range_noise_m: Annotated[float, Field(ge=0, le=1)] | Literal["auto"] = Field(
        "auto", description='standard deviation of ranges on smooth surfaces [m]; "auto" = measured'
    )
    default_noise_m: float = Field(0.005, gt=0, le=1, description="range noise used until it could be measured [m]")
    again: bool = Field(True, description="whether to measure it again in later blocks and use the smallest value")


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """Beam directions within the scan plane."""

    sine: F64
    """(M,) float64, metres to the side per metre of range."""
    cosine: F64
    """(M,) float64, metres down per metre of range."""
    step_rad: float
    """Angle between neighbouring columns, in the middle [rad]."""

    @classmethod
    def of(cls, beam_rad: F64) -> Plane:
        """Return the plane of beams, (M,) float64, given by their angles from straight down [rad].

        >>> Plane.of(np.deg2rad([179.0, -179.0, -177.0])).step_rad.__round__(4)
        0.0349
        """
        step = np.abs(np.diff(beam_rad))
        step = np.minimum(step, np.abs(_TURN - step))
        return cls(np.sin(beam_rad), np.cos(beam_rad), float(np.median(step)) if len(step) else 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class ScanPlane:
    """Beam directions in float32, for the loops."""

    sine: F32
    """(M,) float32, metres to the side per metre of range; the sign is the side."""
    cosine: F32
    """(M,) float32, metres down per metre of range."""
    step_rad: np.float32
    """Angle between neighbouring columns, in the middle [rad]."""
    left: I32
    """(n,) int32, columns of the positive side, from straight down to straight up."""
    right: I32
    """(n,) int32, columns of the negative side."""

    @property
    def beams(self) -> tuple[F32, F32]:
        """Return sine and cosine."""
        return self.sine, self.cosine

    @classmethod
    def of(cls, beam_rad: F64) -> ScanPlane:
        """Return the plane of beams, (M,) float64, given by their angles from straight down in (-pi, pi] [rad].

        >>> ScanPlane.of(np.deg2rad([-10.0, 0.0, 10.0, 20.0])).left.tolist()
        [1, 2, 3]
        """
        plane = Plane.of(beam_rad)
        outwards = np.argsort(np.abs(beam_rad), kind="stable").astype(np.int32)
        positive = beam_rad[outwards] >= 0
        return cls(
            plane.sine.astype(np.float32),
            plane.cosine.astype(np.float32),
            np.float32(max(plane.step_rad, 1e-6)),
            np.ascontiguousarray(outwards[positive]),
            np.ascontiguousarray(outwards[~positive]),
        )


@stage("scan plane")
def points_of(range_m: F32, plane: ScanPlane) -> tuple[F32, F32]:
    """Return the coordinates of shots in the scan plane: to the side, and above the scanner.

    ``range_m`` (lines, M) float32, metres; returns side_m, height_m : (lines, M) float32, metres.
    """
    side, height = kernels.plane_points(range_m, plane.sine, plane.cosine)
    return side, height


@dataclass(frozen=True, slots=True)
class Noise:
    """Range noise measured so far, of one piece of the stream after the other.

    Rough surfaces add to the measured noise, so the smallest measurement is the best one: a drive may begin beneath
    trees. The noise is a property of the scanner, so it is measured on every piece up to the first success (a stream
    may begin without usable returns), then only on pieces 1, 2, 4, 8 and so on.
    """

    least_m: float = math.inf
    """Smallest measurement [m]."""
    pieces: int = 0
    """Pieces so far."""

    def is_asked(self, params: SensorParams) -> bool:
        """Return whether the next piece is to be measured."""
        is_new = math.isinf(self.least_m) or (params.again and self.pieces & (self.pieces - 1) == 0)
        return params.range_noise_m == "auto" and is_new

    def after(self, measured_m: float | None) -> Noise:
        """Add a piece, given by what was measured on it [m]; None = nothing.

        >>> Noise(0.003, 3).after(0.004)
        Noise(least_m=0.003, pieces=4)
        """
        return Noise(self.least_m if measured_m is None else min(self.least_m, measured_m), self.pieces + 1)

    def noise_m(self, params: SensorParams) -> float:
        """Return the standard deviation of ranges [m]: as set, measured, or the default.

        >>> Noise().noise_m(SensorParams())
        0.005
        """
        if params.range_noise_m != "auto":
            return float(params.range_noise_m)
        return self.least_m if math.isfinite(self.least_m) else params.default_noise_m


@dataclass(frozen=True, slots=True, eq=False)
class NoiseAlong:
    """Range noise along a stream, measured at the same lines however the stream is cut.

    The smallest measurement counts, as with :class:`Noise`; the first piece tells something before it is whole.
    """

    parts: int = 0
    """Parts of the stream so far, of :data:`PART_LINES` lines each."""
    off_m: tuple[F32, ...] = ()
    """Distances from straight lines in the last parts, as far as they are still needed [m]."""
    steps: tuple[tuple[int, float], ...] = ()
    """Parts so far whenever the noise changed, and the noise from there on [m]."""

    def after(self, following_m: F32, first_line: int, plane: ScanPlane, params: SensorParams) -> NoiseAlong:
        """Add the parts of the stream that end in some lines and were not added before.

        ``following_m`` (lines, M) float32, metres.
        """
        known = self
        while (known.parts + 1) * PART_LINES <= first_line + len(following_m):
            first = known.parts * PART_LINES - first_line
            known = known._with_part(following_m[first : first + PART_LINES], plane, params)
        return known

    def _with_part(self, part_m: F32, plane: ScanPlane, params: SensorParams) -> NoiseAlong:
        """Add a part; where it is asked, measure the piece that ends with it."""
        parts = self.parts + 1
        if not any(self._is_asked(parts + k, params) for k in range(PIECE_PARTS)):
            return NoiseAlong(parts, (), self.steps)
        every = EVERY_LINE if part_m.shape[1] >= MANY_COLUMNS else 1
        off = (*self.off_m, off_lines(*points_of(np.ascontiguousarray(part_m[::every]), plane)))[-PIECE_PARTS:]
        measured = range_noise(np.concatenate(off)) if self._is_asked(parts, params) else None
        least = self.steps[-1][1] if self.steps and parts > PIECE_PARTS else math.inf
        if measured is None or measured >= least:
            return NoiseAlong(parts, off, self.steps)
        return NoiseAlong(parts, off, (*self.steps, (parts, measured)))

    def _is_asked(self, parts: int, params: SensorParams) -> bool:
        """Return whether the piece that ends after so many parts is measured: all at first, then ever fewer."""
        if params.range_noise_m != "auto" or (self.steps and not params.again and parts > PIECE_PARTS):
            return False
        piece, rest = divmod(parts, PIECE_PARTS)
        is_seldom = rest == 0 and (piece - 1) & (piece - 2) == 0
        return not self.steps or parts <= FIRST_PARTS or is_seldom

    def of_lines(self, first_line: int, n_lines: int, params: SensorParams) -> F64:
        """Return what is known of the noise at every line: from the parts before its own, and the first one.

        Lines after a block, and blocks after it, know the same then.

        Returns (n_lines,) float64.
        """
        if params.range_noise_m != "auto":
            return np.full(n_lines, float(params.range_noise_m))
        found = np.full(n_lines, params.default_noise_m)
        parts = np.arange(first_line, first_line + n_lines) // PART_LINES
        for after, noise_m in self.steps:
            found[(parts >= after) | (after == 1)] = noise_m
        return found


@stage("range noise")
def off_lines(side_m: F32, height_m: F32) -> F32:
    """Return the distances of shots from the straight lines through their two neighbours, (n,) float32 [m].

    ``side_m, height_m`` (lines, M) float32, metres.
    """
    y, z = side_m, height_m
    with np.errstate(all="ignore"):  # ranges may be anything
        dy, dz = y[:, 2:] - y[:, :-2], z[:, 2:] - z[:, :-2]
        across = dy * (z[:, 1:-1] - z[:, :-2]) - dz * (y[:, 1:-1] - y[:, :-2])
        # squares of any range fit; np.hypot gives the same, one number at a time
        length = np.sqrt(np.square(dy, dtype=np.float64) + np.square(dz, dtype=np.float64)).astype(np.float32)
        off: F32 = np.abs(across) / length
    return off[np.isfinite(off)]


def range_noise(off_m: F32) -> float | None:
    """Return the standard deviation of ranges on smooth surfaces [m]; None with too few shots.

    Computed from the median distance of a shot from the straight line through its two neighbours. On smooth surfaces
    this is noise alone, and most surfaces along a road are smooth.

    ``off_m`` (n,) float32, metres.

    >>> rng = np.random.default_rng(1)
    >>> side = np.tile(np.linspace(1, 9, 80, dtype=np.float32), (200, 1))
    >>> height = rng.normal(-2, 0.01, side.shape).astype(np.float32)
    >>> round(range_noise(off_lines(side, height)), 3)
    0.01
    """
    if len(off_m) < LEAST_TRIPLES:
        return None
    return _middle(off_m.copy()) / (NORMAL_QUARTILE * math.sqrt(MIDDLE_OF_THREE))


def _middle(values: F32) -> float:
    """Return the median of finite values; reorders them in place; three times as fast as np.median."""
    half = len(values) // 2
    values.partition(half)
    if len(values) % 2:
        return float(values[half])
    return float(np.mean(np.array([values[:half].max(), values[half]])))
