"""The scan plane: beam directions, coordinates of the shots, and the scanner's range noise."""

from __future__ import annotations

import math
from collections.abc import Callable
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
EVERY_LINE = 4
"""The noise is measured on every fourth line."""
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

    Parameters
    ----------
    range_m : (lines, M) float32, metres
        NaN = missing.
    plane : ScanPlane

    Returns
    -------
    side_m, height_m : (lines, M) float32, metres
        ``r sin(beam)`` and ``-r cos(beam)``.
    """
    side, height = kernels.plane_points(range_m, plane.sine, plane.cosine)
    return side, height


@dataclass(frozen=True, slots=True)
class Noise:
    """Range noise measured so far."""

    least_m: float = math.inf
    """Smallest measurement [m]."""
    blocks: int = 0
    """Blocks so far."""

    def after(
        self,
        window_m: F32,
        plane: ScanPlane,
        params: SensorParams,
        measure: Callable[[F32], float | None] | None = None,
    ) -> Noise:
        """Add a block, given by its ranges, (lines, M) float32 [m]; ``measure`` takes the place of range_noise.

        Rough surfaces add to the measured noise, so the smallest measurement is the best one: a drive may begin
        beneath trees. The noise is a property of the scanner, so it is measured on every block up to the first
        success (a stream may begin without usable returns), then only on blocks 1, 2, 4, 8 and so on.

        >>> Noise(0.003, 3).after(np.empty((0, 0), np.float32), ScanPlane.of(np.zeros(0)), SensorParams())
        Noise(least_m=0.003, blocks=4)
        """
        is_asked = math.isinf(self.least_m) or (params.again and self.blocks & (self.blocks - 1) == 0)
        if params.range_noise_m != "auto" or not is_asked:
            return Noise(self.least_m, self.blocks + 1)
        if measure is not None:
            measured = measure(window_m)
        else:
            measured = range_noise(*points_of(np.ascontiguousarray(window_m[::EVERY_LINE]), plane))
        return Noise(self.least_m if measured is None else min(self.least_m, measured), self.blocks + 1)

    def noise_m(self, params: SensorParams) -> float:
        """Return the standard deviation of ranges [m]: as set, measured, or the default.

        >>> Noise().noise_m(SensorParams())
        0.005
        """
        if params.range_noise_m != "auto":
            return float(params.range_noise_m)
        return self.least_m if math.isfinite(self.least_m) else params.default_noise_m


@stage("range noise")
def range_noise(side_m: F32, height_m: F32) -> float | None:
    """Return the standard deviation of ranges on smooth surfaces [m]; None with too few shots.

    Computed from the median distance of a shot from the straight line through its two neighbours. On smooth surfaces
    this is noise alone, and most surfaces along a road are smooth.

    Parameters
    ----------
    side_m, height_m : (lines, M) float32, metres
        Points of the scan plane.

    Examples
    --------
    >>> rng = np.random.default_rng(1)
    >>> side = np.tile(np.linspace(1, 9, 80, dtype=np.float32), (200, 1))
    >>> height = rng.normal(-2, 0.01, side.shape).astype(np.float32)
    >>> round(range_noise(side, height), 3)
    0.01
    """
    y, z = side_m, height_m
    with np.errstate(all="ignore"):  # ranges may be anything
        dy, dz = y[:, 2:] - y[:, :-2], z[:, 2:] - z[:, :-2]
        across = dy * (z[:, 1:-1] - z[:, :-2]) - dz * (y[:, 1:-1] - y[:, :-2])
        # squares of any range fit; np.hypot gives the same, one number at a time
        length = np.sqrt(np.square(dy, dtype=np.float64) + np.square(dz, dtype=np.float64)).astype(np.float32)
        off = np.abs(across) / length
    off = off[np.isfinite(off)]
    if len(off) < LEAST_TRIPLES:
        return None
    return _middle(off) / (NORMAL_QUARTILE * math.sqrt(MIDDLE_OF_THREE))


def _middle(values: F32) -> float:
    """Return the median of finite values; reorders them in place; three times as fast as np.median."""
    half = len(values) // 2
    values.partition(half)
    if len(values) % 2:
        return float(values[half])
    return float(np.mean(np.array([values[:half].max(), values[half]])))
