"""Cars: suspicious lines, their intervals, and the tests that reject intervals.

Stamos et al. (2012), sec. 7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.classes import CarTest, TriggerSide
from prc_cli.core.types import F32, F64, I32, I64, U8, U16, Mask
from prc_cli.methods.sequential_angle.car_loops import (
    car_intervals,
    cut_verticals,
    firm_intervals,
    stable_intervals,
)
from prc_cli.methods.sequential_angle.labels_loops import (
    first_high_verticals,
    first_triggers,
    mark_cars,
)
from prc_cli.methods.sequential_angle.lines import VerticalLines
from prc_cli.methods.sequential_angle.thresholds import (
    CarThresholds,
    DividerThresholds,
    FourierThresholds,
    HighVerticalThresholds,
    SuspiciousThresholds,
)


def high_verticals(
    lines: VerticalLines,
    surface: U8,
    z_g: F32,
    thresholds: HighVerticalThresholds,
) -> F32:
    """Find the horizontal distance beyond which there is no car.

    This is the distance of the last point of the first sequence of vertical points that ends higher
    above the ground than the limit. A missing shot ends a sequence, so that a tower seen over a
    wall does not extend the wall.

    ``surface`` (R, n) uint8; ``z_g`` (R,) float32, metres; returns (R,) float32.
    """
    beam = first_high_verticals(surface, lines.xyz_m, lines.n_beams, z_g, thresholds.height_m)
    distance = np.full(len(beam), np.inf, np.float32)
    rows = np.flatnonzero(beam >= 0)
    distance[rows] = lines.horizontal_m[rows, beam[rows]]
    return distance


def suspicious(car_surface: U8, n_beams: I32, thresholds: SuspiciousThresholds) -> I32:
    """Find the beam at which every line becomes suspicious.

    ``S <- max(0, S + ln(H1/H0))`` over the transitions from the first return on; the first state
    adds nothing. Points of T', and points of lines without an angle, end it. With the published
    numbers every change from V to H or M and any two successive missing shots trigger at once;
    ground alone, one missing shot in the ground, or a wall up to the end of the line do not. On a
    regular surface there is a trigger every 18 beams, and every line that ends in the sky has one:
    this is a pre-selection, not a decision.

    ``car_surface`` (R, n) uint8; ``n_beams`` (R,) int32; returns (R,) int32.

    Ground with one missing shot, then ground with two:

    >>> lines = np.array([[2, 2, 0, 2, 2], [2, 2, 0, 0, 2]], dtype=np.uint8)
    >>> suspicious(lines, np.array([5, 5], dtype=np.int32), SuspiciousThresholds())
    array([-1,  3], dtype=int32)
    """
    return first_triggers(car_surface, n_beams, increments(thresholds), thresholds.threshold)


def increments(thresholds: SuspiciousThresholds) -> F64:
    """Return ln(H1/H0) of every transition [nat].

    Returns (3, 3) float64.
    """
    ratios: F64 = np.array(thresholds.h1) / np.array(thresholds.h0)
    return np.log(ratios)


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """Parts of lines that may be cars: row, first beam, last beam (both are returns), in order."""

    divided: I32
    """(K, 3) int32, t1 and t2 of every interval."""
    pieces: I32
    """(L, 3) int32, v1 and v2 of the remaining pieces without long vertical runs."""


def dividers(
    lines: VerticalLines,
    car_surface: U8,
    signed_deg: F32,
    trigger: I32,
    z_g: F32,
    thresholds: DividerThresholds,
) -> Intervals:
    """Cut suspicious lines into intervals that may be cars.

    The search covers the whole line, not only the part from the trigger on, because the trigger
    often comes late on the car. It ends before the first point of T' (or without an angle),
    before the first point that is too high and not on the side of a van, or at the end of the line.

    1. An interval starts at the first change from H to V that is gradual (a tyre), or sudden with
       something farther away under it (bumper, side; not a wall, curb or pole on the ground).
    2. A jump of more than ``separation_m`` away from the scanner ends it. The next interval starts
       behind the jump.
    3. If an interval contains a long flat stretch within one run of H, it ends at the first point
       of the stretch instead, and the search continues as in 1. after its last point. A stretch is
       flat if a straight line fits its heights (so sloping ground counts) and the line is not steep
       (so a roof and the ground behind it are not one stretch). It may be part of a run, since only
       a jump separates such a roof from such ground.
    4. Runs of V with a height of ``vertical_extent_m`` or more are cut out. The height includes the
       part above the end of the search, as the interval contains only the part of a wall between
       the car's roof and ``height_m``. Lower runs that are straight and upright are cut out too.

    ``car_surface`` (R, n) uint8; ``signed_deg`` (R, n) float32, degrees; ``trigger`` (R,) int32;
    ``z_g`` (R,) float32, metres.
    """
    intervals = car_intervals(
        car_surface,
        lines.range_m,
        lines.xyz_m,
        lines.horizontal_m,
        signed_deg,
        lines.n_beams,
        trigger >= 0,
        z_g,
        thresholds,
    )
    pieces: I32 = cut_verticals(
        car_surface, lines.xyz_m, lines.horizontal_m, lines.n_beams, intervals, z_g, thresholds
    )
    return Intervals(intervals, pieces)


def fourier(signed_deg: F32, intervals: I32, thresholds: FourierThresholds) -> Mask:
    """Classify intervals as car or vegetation.

    The N angles of an interval, missing ones left out, are transformed: F_k, 0 <= k <= N/2, the
    mean included. An interval is a car if no magnitude of F_k with k >= N/8 is above half of the
    largest one.

    ``signed_deg`` (R, n) float32, degrees; ``intervals`` (K, 3) int32; returns (K,) bool.

    Notes
    -----
    In dense vegetation two of three signs are negative, so the mean is not zero: F_0 grows with N,
    the other frequencies only with its square root. The whole spectrum therefore recognises foliage
    in .92 of intervals of 32 angles, .65 of 128, .20 of 256, and none of 512; windows of 64 angles
    miss only .16 of 256 and .03 of 512. Some cars are lost either way: along a vertical side the
    mean is hardly above the noise. Hence ``longest``.

    The cost of a spectrum grows with the square of the number of angles, which a window limits.
    Magnitudes that differ by less than 1e-9 of their size are taken as equal: no transform is more
    exact.

    A car's side and roof, then foliage:

    >>> car = np.repeat([2.0, 88.0], 16)
    >>> tree = np.tile([40.0, -70.0, 80.0, -20.0], 8)
    >>> angles = np.array([car, tree], dtype=np.float32)
    >>> intervals = np.array([[0, 0, 31], [1, 0, 31]], dtype=np.int32)
    >>> fourier(angles, intervals, FourierThresholds(longest=32))
    array([ True, False])
    """
    stable: Mask = stable_intervals(signed_deg, intervals, thresholds)
    return stable


@dataclass(frozen=True, slots=True, eq=False)
class Cars:
    """Cars of R rows of n beams, with the results of the steps before."""

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
    thresholds: CarThresholds,
) -> Cars:
    """Mark the points of cars.

    ``surface`` (R, n) uint8; ``car_surface`` (R, n) uint8; ``signed_deg`` (R, n) float32, degrees;
    ``z_g`` (R,) float32, metres.

    Notes
    -----
    Intervals may include road or sidewalk behind a car: all of a short stretch, and the first point
    of a long flat one. Therefore horizontal points next to the ground are removed. ``python -m
    benchmarks.sequential_angle readings`` prints the effect.
    """
    trigger = suspicious(car_surface, lines.n_beams, thresholds.suspicious)
    intervals = dividers(lines, car_surface, signed_deg, trigger, z_g, thresholds.dividers)
    stable = fourier(signed_deg, intervals.pieces, thresholds.fourier)
    stable &= firm_intervals(surface, intervals.pieces, thresholds.most_foliage)
    limit = high_verticals(lines, surface, z_g, thresholds.high_verticals)
    low_m = z_g + np.float32(
        thresholds.ground_layer_m if thresholds.ground_layer_m > 0 else -np.inf
    )
    accepted = intervals.pieces[stable]
    marked: Mask = mark_cars(accepted, lines.horizontal_m, lines.xyz_m, car_surface, limit, low_m)
    return Cars(marked, trigger, intervals, stable, limit)


@dataclass(frozen=True, slots=True, eq=False)
class CarSearch:
    """Triggers, intervals and tests of R rows of n beams; n = 0 if not requested."""

    trigger: U8
    """(R, n) uint8, :class:`~prc_cli.core.classes.TriggerSide`."""
    interval: U16
    """(R, n) uint16, number of the interval in its row, from 1; 0 = none."""
    test: U8
    """(R, n) uint8, :class:`~prc_cli.core.classes.CarTest`, before curbs are decided.

    OUTSIDE where missing.
    """

    @classmethod
    def none(cls, n_rows: int) -> CarSearch:
        """Return an empty search."""
        nothing = np.empty((n_rows, 0), np.uint8)
        return cls(nothing, nothing.astype(np.uint16), nothing)


def car_search(cars_found: Cars, lines: VerticalLines) -> CarSearch:
    """Spread the results of the search over the beams.

    >>> spread(np.array([[0, 1, 2], [0, 4, 4]], np.int32), np.array([1, 2]), (1, 6))
    array([[0, 1, 1, 0, 2, 0]])
    """
    shape = lines.range_m.shape
    beam = np.arange(shape[1], dtype=np.int32)
    trigger_beam = cars_found.trigger[:, None]
    trigger = np.where(
        beam < trigger_beam,
        TriggerSide.BEFORE,
        np.where(beam > trigger_beam, TriggerSide.AFTER, TriggerSide.AT),
    )
    trigger[(trigger_beam < 0)[:, 0]] = TriggerSide.NONE
    trigger[beam >= lines.n_beams[:, None]] = TriggerSide.NONE
    divided = cars_found.intervals.divided
    pieces = cars_found.intervals.pieces
    # rows are in order, so that the first interval of a row is found by bisection
    number = np.arange(len(divided)) - np.searchsorted(divided[:, 0], divided[:, 0]) + 1
    interval = spread(divided, number, shape)
    missing = np.isnan(lines.range_m)
    kept = spread(pieces, 1 + cars_found.stable.astype(np.int64), shape)
    test = np.full(shape, CarTest.OUTSIDE, np.uint8)
    test[interval > 0] = CarTest.VERTICAL
    test[kept == 1] = CarTest.VEGETATION
    test[kept == 2] = CarTest.ON_GROUND
    beyond: Mask = lines.horizontal_m > cars_found.limit_m[:, None]
    test[(kept == 2) & beyond] = CarTest.BEHIND_WALL
    test[cars_found.car] = CarTest.CAR
    test[missing] = CarTest.OUTSIDE
    return CarSearch(trigger.astype(np.uint8), interval.astype(np.uint16), test)


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
