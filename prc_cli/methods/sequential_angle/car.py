"""Cars (Stamos et al. 2012, sec. 7): suspicious lines, their intervals, and the tests that reject intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field

from prc_cli import kernels
from prc_cli.core.classes import CarTest, TriggerSide
from prc_cli.core.config import Params
from prc_cli.core.types import F32, F64, I32, I64, U8, U16, Mask
from prc_cli.methods.sequential_angle.dividers import DividersParams, Intervals, dividers
from prc_cli.methods.sequential_angle.fourier import FourierParams, fourier
from prc_cli.methods.sequential_angle.lines import VerticalLines


class HighVerticalsParams(Params):
    """What is too high for a car (``[sequential_angle.car.high_verticals]``)."""

    enabled: bool = Field(True, description="look for them at all; false = cars may lie behind walls")
    height_m: float = Field(
        2.5,
        gt=0,
        le=1e3,
        description="vertical surfaces that reach this far above the ground hide all cars behind [m] (published)",
    )


def high_verticals(lines: VerticalLines, surface: U8, z_g: F32, params: HighVerticalsParams) -> F32:
    """Find the horizontal distance beyond which there is no car.

    This is the distance of the last point of the first sequence of vertical points that ends higher above the ground
    than the limit. A missing shot ends a sequence, so that a tower seen over a wall does not extend the wall.

    ``surface`` (R, n) uint8; ``z_g`` (R,) float32, metres; returns (R,) float32.
    """
    if not params.enabled:
        return np.full(len(z_g), np.inf, np.float32)
    found, beam = kernels.first_high_verticals(surface, lines.xyz_m, lines.n_beams, z_g, params.height_m)
    distance = np.full(len(beam), np.inf, np.float32)
    distance[found] = lines.horizontal_m[found, beam[found]]
    return distance


Probability = Annotated[float, Field(gt=0, lt=1)]


def _distribution(row: tuple[float, float, float]) -> tuple[float, float, float]:
    """Refuse probabilities that do not add up to one."""
    if not math.isclose(sum(row), 1.0, abs_tol=1e-6):
        msg = f"probabilities that add up to 1, found a sum of {sum(row):g}"
        raise ValueError(msg)
    return row


Row = Annotated[tuple[Probability, Probability, Probability], AfterValidator(_distribution)]
Matrix = tuple[Row, Row, Row]


class SuspiciousParams(Params):
    """Markov chains of H, V and M on a regular surface and on a car (``[sequential_angle.car.suspicious]``)."""

    enabled: bool = Field(False, description="test lines at all; false = every line may hold a car; published: true")
    h0: Matrix = Field(
        ((0.8, 0.1, 0.1), (0.09, 0.9, 0.01), (0.6, 0.3, 0.1)),
        description="regular surface: probabilities from H, V, M (rows) to H, V, M (published; the third column "
        "completes the rows)",
    )
    h1: Matrix = Field(
        ((0.5, 0.25, 0.25), (0.25, 0.5, 0.25), (0.25, 0.25, 0.5)),
        description="car: probabilities from H, V, M (rows) to H, V, M (published; the third column completes "
        "the rows)",
    )
    threshold: float = Field(
        1.0, ge=0, le=1e6, description="log likelihood ratio above which a line is suspicious [nat] (published)"
    )
    closed_gaps_only: bool = Field(
        False,
        description="leave out the missing shots behind the last return of a line, so that sky alone is not suspicious",
    )


def suspicious(car_surface: U8, n_beams: I32, params: SuspiciousParams) -> I32:
    """Find the beam at which every line becomes suspicious.

    ``S <- max(0, S + ln(H1/H0))`` over the transitions from the first return on; the first state adds nothing. Points
    of T', and points of lines without an angle, end it. With the published numbers every change from V to H or M and
    any two successive missing shots trigger at once; ground alone, one missing shot in the ground, or a wall up to the
    end of the line do not. On a regular surface there is a trigger every 18 beams, and every line that ends in the sky
    has one: this is a pre-selection, not a decision.

    ``car_surface`` (R, n) uint8; ``n_beams`` (R,) int32; returns (R,) int32.

    Ground with one missing shot, then ground with two:

    >>> lines = np.array([[2, 2, 0, 2, 2], [2, 2, 0, 0, 2]], dtype=np.uint8)
    >>> suspicious(lines, np.array([5, 5], dtype=np.int32), SuspiciousParams(enabled=True))
    array([-1,  3], dtype=int32)
    """
    if not params.enabled:
        return np.where(n_beams > 0, 0, -1).astype(np.int32)
    beam: I32 = kernels.first_triggers(
        car_surface, n_beams, increments(params), params.threshold, params.closed_gaps_only
    )[1]
    return beam


def increments(params: SuspiciousParams) -> F64:
    """Return ln(H1/H0) of every transition [nat].

    Returns (3, 3) float64.
    """
    ratios: F64 = np.array(params.h1) / np.array(params.h0)
    return np.log(ratios)


@dataclass(frozen=True, slots=True, eq=False)
class CarSearch:
    """Triggers, intervals and tests of R rows of n beams; n = 0 where nobody asked for them."""

    trigger: U8
    """(R, n) uint8, :class:`~prc_cli.core.classes.TriggerSide`."""
    interval: U16
    """(R, n) uint16, number of the interval in its row, from 1; 0 = none."""
    test: U8
    """(R, n) uint8, :class:`~prc_cli.core.classes.CarTest`, before curbs are decided; OUTSIDE where missing."""

    @classmethod
    def none(cls, n_rows: int) -> CarSearch:
        """Return an empty search."""
        nothing = np.empty((n_rows, 0), np.uint8)
        return cls(nothing, nothing.astype(np.uint16), nothing)


def car_search(found: Cars, lines: VerticalLines) -> CarSearch:
    """Spread the results of the search over the beams.

    >>> spread(np.array([[0, 1, 2], [0, 4, 4]], np.int32), np.array([1, 2]), (1, 6))
    array([[0, 1, 1, 0, 2, 0]])
    """
    shape = lines.range_m.shape
    beam, at = np.arange(shape[1], dtype=np.int32), found.trigger[:, None]
    trigger = np.where(beam < at, TriggerSide.BEFORE, np.where(beam > at, TriggerSide.AFTER, TriggerSide.AT))
    trigger[(at < 0)[:, 0]] = TriggerSide.NONE
    trigger[beam >= lines.n_beams[:, None]] = TriggerSide.NONE
    divided, pieces = found.intervals.divided, found.intervals.pieces
    # rows are in order, so that the first interval of a row is found by bisection
    number = np.arange(len(divided)) - np.searchsorted(divided[:, 0], divided[:, 0]) + 1
    interval = spread(divided, number, shape)
    missing = np.isnan(lines.range_m)
    kept = spread(pieces, 1 + found.stable.astype(np.int64), shape)
    test = np.full(shape, CarTest.OUTSIDE, np.uint8)
    test[interval > 0] = CarTest.VERTICAL
    test[kept == 1] = CarTest.VEGETATION
    test[kept == 2] = CarTest.ON_GROUND
    test[(kept == 2) & _beyond(found, lines)] = CarTest.BEHIND_WALL
    test[found.car] = CarTest.CAR
    test[missing] = CarTest.OUTSIDE
    return CarSearch(trigger.astype(np.uint8), interval.astype(np.uint16), test)


def _beyond(found: Cars, lines: VerticalLines) -> Mask:
    beyond: Mask = lines.horizontal_m > found.limit_m[:, None]
    return beyond


def spread(intervals: I32, values: I64, shape: tuple[int, ...]) -> I64:
    """Give every beam the value of its interval, (R, n) int64; 0 = in none.

    ``intervals`` (K, 3) int32; ``values`` (K,) int64.
    """
    n_rows, n = shape
    changes = np.zeros(n_rows * n + 1, np.int64)
    first = intervals[:, 0].astype(np.int64) * n
    changes[first + intervals[:, 1]] += values
    changes[first + intervals[:, 2] + 1] -= values
    spread_out: I64 = np.cumsum(changes[:-1]).reshape(shape)
    return spread_out


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
