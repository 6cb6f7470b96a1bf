"""Range noise of the scanner, measured along the stream."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from prc_cli.core.config import Params
from prc_cli.core.profile import stage
from prc_cli.core.types import F32, F64
from prc_cli.methods.fused.plane import ScanPlane, points_of

NORMAL_QUARTILE = 0.6745
"""Half of a normal distribution lies within this many standard deviations."""
MIDDLE_OF_THREE = 1.5
"""Variance of a range minus the mean of its neighbours, in variances of one range."""
PART_LINES = 32
"""Lines of a part, by which the noise at the start of a stream is measured.

Not more than are known after a block.
"""
PIECE_PARTS = 4
"""Parts of a later measurement."""
FIRST_PARTS = 12
"""Parts after which measurements become ever rarer."""
EVERY_LINE = 4
MANY_COLUMNS = 256
"""With so many columns and more, every fourth line is enough."""
LEAST_TRIPLES = 100
"""Fewest shots to measure the noise from."""
DEFAULT_NOISE_M = 0.005
"""Range noise used until it could be measured [m]."""


class SensorParams(Params):
    """How precisely the scanner measures (``[fused.sensor]``)."""

    range_noise_m: Annotated[float, Field(ge=0, le=1)] | Literal["auto"] = Field(
        "auto", description='standard deviation of ranges on smooth surfaces [m]; "auto" = measured'
    )


@dataclass(frozen=True, slots=True)
class Noise:
    """Range noise measured so far, of one piece of the stream after the other.

    Rough surfaces add to the measured noise, so the smallest measurement is the best one: a drive
    may begin beneath trees. The noise is a property of the scanner, so it is measured on every
    piece up to the first success (a stream may begin without usable returns), then only on pieces
    1, 2, 4, 8 and so on.
    """

    least_m: float = math.inf
    """Smallest measurement [m]."""
    pieces: int = 0
    """Pieces so far."""

    def is_asked(self, params: SensorParams) -> bool:
        """Return whether the next piece is to be measured."""
        is_new = math.isinf(self.least_m) or self.pieces & (self.pieces - 1) == 0
        return params.range_noise_m == "auto" and is_new

    def after(self, measured_m: float | None) -> Noise:
        """Add a piece, given by what was measured on it [m]; None = nothing.

        >>> Noise(0.003, 3).after(0.004)
        Noise(least_m=0.003, pieces=4)
        """
        return Noise(
            self.least_m if measured_m is None else min(self.least_m, measured_m), self.pieces + 1
        )

    def noise_m(self, params: SensorParams) -> float:
        """Return the standard deviation of ranges [m]: as set, measured, or the default.

        >>> Noise().noise_m(SensorParams())
        0.005
        """
        if params.range_noise_m != "auto":
            return float(params.range_noise_m)
        return self.least_m if math.isfinite(self.least_m) else DEFAULT_NOISE_M


@dataclass(frozen=True, slots=True, eq=False)
class NoiseAlong:
    """Range noise along a stream, measured at the same lines however the stream is cut.

    A piece is :data:`PIECE_PARTS` parts; a measurement is made of the piece that ends with a part.
    The smallest measurement counts, as with :class:`Noise`, but the first ones, of less than a
    piece, are replaced.
    """

    parts: int = 0
    """Parts of the stream so far, of :data:`PART_LINES` lines each."""
    off_m: tuple[F32, ...] = ()
    """Distances from straight lines in the last parts, as far as they are still needed [m]."""
    steps: tuple[tuple[int, float], ...] = ()
    """Parts so far whenever the noise changed, and the noise from there on [m]."""

    def after(
        self,
        following_m: F32,
        first_line: int,
        plane: ScanPlane,
        params: SensorParams,
    ) -> NoiseAlong:
        """Add the parts that end within some lines of the stream, from ``first_line`` on.

        ``following_m`` (lines, M) float32, metres.
        """
        known = self
        while (known.parts + 1) * PART_LINES <= first_line + len(following_m):
            first = known.parts * PART_LINES - first_line
            known = known._with_part(following_m[first : first + PART_LINES], plane, params)
        return known

    def _with_part(self, part_m: F32, plane: ScanPlane, params: SensorParams) -> NoiseAlong:
        """Add a part, and measure the piece that ends with it if it is time for that."""
        parts = self.parts + 1
        if not any(self._is_measured(parts + k, params) for k in range(PIECE_PARTS)):
            return NoiseAlong(parts, (), self.steps)
        every = EVERY_LINE if part_m.shape[1] >= MANY_COLUMNS else 1
        side_m, height_m = points_of(np.ascontiguousarray(part_m[::every]), plane)
        off_m = (*self.off_m, off_lines(side_m, height_m))[-PIECE_PARTS:]
        if not self._is_measured(parts, params):
            return NoiseAlong(parts, off_m, self.steps)
        noise_m = range_noise(np.concatenate(off_m))
        least_m = self.steps[-1][1] if self.steps and parts > PIECE_PARTS else math.inf
        if noise_m is None or noise_m >= least_m:
            return NoiseAlong(parts, off_m, self.steps)
        return NoiseAlong(parts, off_m, (*self.steps, (parts, noise_m)))

    def _is_measured(self, parts: int, params: SensorParams) -> bool:
        """Whether the noise is measured after so many parts: at first always, then ever rarer."""
        if params.range_noise_m != "auto":
            return False
        piece, rest = divmod(parts, PIECE_PARTS)
        is_seldom = rest == 0 and (piece - 1) & (piece - 2) == 0
        return not self.steps or parts <= FIRST_PARTS or is_seldom

    def of_lines(self, first_line: int, n_lines: int, params: SensorParams) -> F64:
        """Return the range noise at every line, as the parts before the line's part show it.

        In the first part, as that part shows it. So the noise at a line is the same whether it is
        in a block or after one.

        Returns (n_lines,) float64, metres.
        """
        if params.range_noise_m != "auto":
            return np.full(n_lines, float(params.range_noise_m))
        noise_of_lines_m = np.full(n_lines, DEFAULT_NOISE_M)
        parts = np.arange(first_line, first_line + n_lines) // PART_LINES
        for after, noise_m in self.steps:
            noise_of_lines_m[(parts >= after) | (after == 1)] = noise_m
        return noise_of_lines_m


@stage("range noise")
def off_lines(side_m: F32, height_m: F32) -> F32:
    """Return distances of shots from the line through both neighbours, (n,) float32 [m].

    ``side_m, height_m`` (lines, M) float32, metres.
    """
    y = side_m
    z = height_m
    with np.errstate(all="ignore"):  # ranges may be anything
        dy = y[:, 2:] - y[:, :-2]
        dz = z[:, 2:] - z[:, :-2]
        across = dy * (z[:, 1:-1] - z[:, :-2]) - dz * (y[:, 1:-1] - y[:, :-2])
        # squares of any range fit; np.hypot gives the same, one number at a time
        length = np.sqrt(np.square(dy, dtype=np.float64) + np.square(dz, dtype=np.float64)).astype(
            np.float32
        )
        off: F32 = np.abs(across) / length
    return off[np.isfinite(off)]


def range_noise(off_m: F32) -> float | None:
    """Return the standard deviation of ranges on smooth surfaces [m]; None with too few shots.

    Computed from the median distance of a shot from the straight line through its two neighbours.
    On smooth surfaces this is noise alone, and most surfaces along a road are smooth.

    ``off_m`` (n,) float32, metres.

    >>> rng = np.random.default_rng(1)
    >>> side = np.tile(np.linspace(1, 9, 80, dtype=np.float32), (200, 1))
    >>> height = rng.normal(-2, 0.01, side.shape).astype(np.float32)
    >>> round(range_noise(off_lines(side, height)), 3)
    0.01
    """
    if len(off_m) < LEAST_TRIPLES:
        return None
    # three times as fast as np.median
    half = len(off_m) // 2
    halves = np.partition(off_m, half)
    median_m = float(halves[half])
    if len(halves) % 2 == 0:
        median_m = float(np.mean(np.array([halves[:half].max(), halves[half]])))
    return median_m / (NORMAL_QUARTILE * math.sqrt(MIDDLE_OF_THREE))
