"""Cars (Stamos et al. 2012, sec. 7): suspicious lines, their intervals, and the tests that reject intervals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from prc_cli import kernels
from prc_cli.core.config import Params
from prc_cli.core.types import F32, I32, U8, Mask
from prc_cli.methods.sequential_angle.dividers import DividersParams, Intervals, dividers
from prc_cli.methods.sequential_angle.fourier import FourierParams, fourier
from prc_cli.methods.sequential_angle.high_verticals import HighVerticalsParams, high_verticals
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.suspicious import SuspiciousParams, suspicious


class CarParams(Params):
    """The car algorithm (``[sequential_angle.car]``)."""

    suspicious: SuspiciousParams = Field(SuspiciousParams(), description="which lines may hold a car")
    dividers: DividersParams = Field(DividersParams(), description="where on a line a car may be")
    high_verticals: HighVerticalsParams = Field(
        HighVerticalsParams(), description="high vertical surfaces, behind which no cars are accepted"
    )
    fourier: FourierParams = Field(FourierParams(), description="car or vegetation")
    most_foliage: float = Field(
        0.8,
        ge=0,
        le=1,
        description="an interval of which the coarse classification calls more than this share vegetation is no car; "
        "published: 1, such intervals are cars too",
    )
    min_points: int = Field(
        8, ge=1, le=100_000, description="an interval of fewer returns is no car; published: 1 [returns]"
    )
    ground_layer_m: float = Field(
        0.3,
        ge=0,
        le=10,
        description="horizontal points below this height over the ground are no car, even inside an interval; "
        "published: 0, all of an interval is a car [m]",
    )


@dataclass(frozen=True, slots=True, eq=False)
class Cars:
    """Cars of R rows of n beams, and what they were decided by."""

    car: Mask
    """(R, n) bool, C before cars behind curbs are removed."""
    trigger: I32
    """(R,) int32, beam of the trigger (sec. 7.2), -1 = none."""
    intervals: Intervals
    """Intervals between dividers (sec. 7.3)."""
    stable: Mask
    """(L,) bool, pieces of intervals that pass the Fourier test (sec. 7.5)."""
    limit_m: F32
    """(R,) float32, horizontal distance beyond which there is no car (sec. 7.4) [m]."""


def cars(
    lines: VerticalLines,
    surface: U8,
    car_surface: U8,
    signed_deg: F32,
    z_g: F32,
    params: CarParams,
    *,
    range_noise_m: float,
) -> Cars:
    """Mark the points of cars.

    ``surface`` (R, n) uint8; ``car_surface`` (R, n) uint8; ``signed_deg`` (R, n) float32, degrees; ``z_g`` (R,)
    float32, metres.

    Notes
    -----
    Intervals may include road or sidewalk behind a car: all of a short stretch, and the first point of a long flat
    one. Therefore horizontal points next to the ground are removed. ``python -m benchmarks.sequential_angle readings``
    prints the effect.
    """
    trigger = suspicious(car_surface, lines.n_beams, params.suspicious)
    intervals = dividers(lines, car_surface, signed_deg, trigger, z_g, params.dividers, range_noise_m=range_noise_m)
    stable = fourier(signed_deg, intervals.pieces, params.fourier)
    if params.most_foliage < 1.0 or params.min_points > 1:
        stable &= kernels.firm_intervals(surface, intervals.pieces, params.most_foliage, params.min_points)
    limit = high_verticals(lines, surface, z_g, params.high_verticals)
    low_m = z_g + np.float32(params.ground_layer_m if params.ground_layer_m > 0 else -np.inf)
    accepted = intervals.pieces[stable]
    marked: Mask = kernels.mark_cars(accepted, lines.horizontal_m, lines.xyz_m, car_surface, limit, low_m)
    return Cars(marked, trigger, intervals, stable, limit)
