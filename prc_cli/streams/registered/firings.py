"""The firings of a spinning head, from the times of the points of every ring.

A ring fires at the same place of every firing, so the times of its points are whole firings apart.
The clock of the points and that of the scanner may drift, so the phase of the firings is followed
along the drive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64, I64

MIN_STEPS = 100
"""Fewest steps from point to point of a ring."""
NEIGHBOURS = 1.5
"""Steps up to this multiple of the short ones lead to the next firing."""
SAME = 1e-3
"""Places nearer than this are the same, as a share of a firing."""
MIN_EVENNESS = 0.8
"""Least length of the mean phase of a ring's points, 0 to 1.

Times to a tenth of a firing give 0.94.
"""
BLOCK_S = 0.05
"""The phase is followed from block to block of this length [s]."""


@dataclass(frozen=True, slots=True)
class Firings:
    """Period and delays of the rings."""

    period_s: float
    """Time from firing to firing [s]."""
    origin_s: float
    """Time from which firings are counted [s]."""
    delay_s: F64
    """(k,) float64, time of every ring's shot after the start of its firing [s]."""
    late: I64
    """(k,) int64, firings until every ring sees the direction of the ring that looks ahead most."""
    evenness: float
    """Evenness of the firings, 0 to 1."""
    before: tuple[float, float] = (math.nan, 0.0)
    """Time [s] and drift of the phase [firings] of the last block; time NaN at first."""


def find_firings(
    time_s: F64,
    ring: I64,
    ahead_rad: F64,
    turn_hz: float,
) -> Firings | None:
    """Find the period of the firings and the place of every ring in them.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s]; some seconds, from all over a drive.
    ring
        (n,) int64, -1 = none.
    ahead_rad
        (k,) float64, how far every ring looks ahead of the head [rad].
    turn_hz
        Turns a second of the head [Hz].

    Returns
    -------
    Firings or None
        None if the times of the points of a ring are not whole periods apart.
    """
    known = ring >= 0
    order = np.argsort(ring[known], kind="stable")
    number = ring[known][order]
    fired_s = time_s[known][order]
    step_s = np.diff(fired_s)[np.diff(number) == 0]
    step_s = step_s[step_s > 0]
    if len(step_s) < MIN_STEPS:
        return None
    n_rings = len(ahead_rad)
    period_s = _period(step_s)
    origin_s = float(time_s[0])
    phases = _phases(fired_s, number, origin_s, period_s, n_rings)
    # an even drift is an error of the period
    apart_s = np.diff(phases.block_s)
    is_next = apart_s < 1.5 * BLOCK_S
    if is_next.any():
        steps = phases.of_block[1:] * np.conj(phases.of_block[:-1])
        cycles = np.angle(steps)[is_next] / (2.0 * np.pi)
        period_s *= 1.0 - float(np.median(cycles / apart_s[is_next])) * period_s
        phases = _phases(fired_s, number, origin_s, period_s, n_rings)
    n_points = np.bincount(number, minlength=n_rings)
    lengths = np.abs((phases.table * np.conj(phases.of_ring)).sum(axis=1))
    evenness = float(lengths.sum() / n_points.sum())
    if evenness < MIN_EVENNESS:
        return None

    # a firing begins with the ring after the longest pause
    place = np.remainder(np.angle(phases.of_ring) / (2.0 * np.pi), 1.0)
    ordered = np.sort(place[n_points > 0])
    pause = np.diff(ordered, prepend=ordered[-1] - 1.0)
    first = float(ordered[int(np.argmax(pause))])
    # a ring that fires with the first one fires after it, not a period later
    delay = np.remainder(place - first + SAME, 1.0) - SAME
    n_ahead = np.rint(ahead_rad / (2.0 * np.pi * turn_hz * period_s)).astype(np.int64)
    firings = Firings(
        period_s=period_s,
        origin_s=origin_s + first * period_s,
        delay_s=delay * period_s,
        late=n_ahead.max() - n_ahead,
        evenness=evenness,
    )
    return starting(firings, origin_s)


def firing_numbers(
    time_s: F64,
    ring: I64,
    firings: Firings,
    shot_s: F64 | None = None,
) -> tuple[I64, Firings]:
    """Return the firing of every point, and the firings for the next piece of the drive.

    Parameters
    ----------
    time_s
        (n,) float64, rising [s].
    ring
        (n,) int64, -1 = none.
    firings
        As found, or as returned with the piece before.
    shot_s
        (n,) float64, the times of the shots by their azimuths, if the times themselves are too
        coarse [s].

    Returns
    -------
    (n,) int64, Firings
        Number of the firing, -1 = no ring; the firings with the phase of the last block.
    """
    known = ring >= 0
    if not known.any():
        return np.full(len(time_s), -1, np.int64), firings
    fired_s = time_s if shot_s is None else shot_s
    delay = firings.delay_s[ring] / firings.period_s
    cycles = (fired_s - firings.origin_s) / firings.period_s - delay
    # the mean phase of every block, which the shift of the cycles follows
    block = np.floor((time_s[known] - firings.origin_s) / BLOCK_S).astype(np.int64)
    begin = np.flatnonzero(np.diff(block, prepend=block[0] - 1))
    vectors = np.add.reduceat(np.exp(2j * np.pi * cycles[known]), begin)
    phase = np.angle(vectors) / (2.0 * np.pi)
    middle_s = (block[begin] + 0.5) * BLOCK_S + firings.origin_s
    last_s, last_drift = firings.before
    if not math.isfinite(last_s):
        last_drift = 0.0
    drift = np.unwrap(np.concatenate([[last_drift], phase]), period=1.0)[1:]
    whole_cycles = np.rint(cycles - np.interp(time_s, middle_s, drift)).astype(np.int64)
    number: I64 = np.where(known, whole_cycles, -1)
    return number, replace(firings, before=(float(middle_s[-1]), float(drift[-1])))


def starting(firings: Firings, time_s: float) -> Firings:
    """Return the firings counted from a time: later firings and lines have numbers from 0."""
    n_before = math.floor((time_s - firings.origin_s) / firings.period_s)
    n_periods = n_before - 2 - int(firings.late.max())
    return replace(firings, origin_s=firings.origin_s + n_periods * firings.period_s)


def line_numbers(number: I64, ring: I64, firings: Firings) -> I64:
    """Return the line of every point; shots of a line look one way, -1 = no ring."""
    lines: I64 = np.where(ring >= 0, number - firings.late[ring], -1)
    return lines


def _period(step_s: F64) -> float:
    """Return the longest time of which most steps are multiples."""
    coarsest_s = math.nan
    for share in (50.0, 20.0, 5.0, 1.0):
        short_s = float(np.percentile(step_s, share))
        is_short = (step_s > 0.7 * short_s) & (step_s < 1.4 * short_s)
        period_s = float(np.mean(step_s[is_short]))
        # longer and longer steps give the period more and more exactly
        for most_cycles in (3.5, 10.5, 30.5, 100.5):
            count = np.rint(step_s / period_s)
            use = (count > 0) & (count < most_cycles)
            use &= np.abs(step_s - count * period_s) < 0.2 * period_s
            if use.sum() >= MIN_STEPS // 2:
                squares = (count[use] ** 2).sum()
                period_s = float((step_s[use] * count[use]).sum() / squares)
        cycles = step_s[step_s < 20.0 * period_s]
        if np.abs(np.exp(2j * np.pi * cycles / period_s).mean()) > MIN_EVENNESS:
            return period_s
        if math.isnan(coarsest_s):
            coarsest_s = period_s
    return coarsest_s


class _Phases(NamedTuple):
    """Phases of the points as complex numbers."""

    table: NDArray[Any]
    """(b, k), sums by block of time and ring."""
    block_s: F64
    """(b,) float64, middle of every block [s]."""
    of_block: NDArray[Any]
    of_ring: NDArray[Any]
    """(b,) and (k,), unit phases whose products are nearest to the table."""


def _phases(
    fired_s: F64,
    number: I64,
    origin_s: float,
    period_s: float,
    n_rings: int,
) -> _Phases:
    block = np.floor((fired_s - origin_s) / BLOCK_S).astype(np.int64)
    blocks, row = np.unique(block, return_inverse=True)
    table = np.zeros((len(blocks), n_rings), np.complex128)
    np.add.at(table, (row, number), np.exp(2j * np.pi * (fired_s - origin_s) / period_s))
    block_s = np.asarray((blocks + 0.5) * BLOCK_S + origin_s, np.float64)
    fullest = int(np.argmax(np.abs(table).sum(axis=1)))
    of_ring = np.ones(n_rings, np.complex128)
    of_ring *= np.exp(1j * np.angle(table[fullest]))
    for _ in range(10):
        of_block = np.exp(1j * np.angle((table * np.conj(of_ring)).sum(axis=1)))
        of_ring = np.exp(1j * np.angle((table * np.conj(of_block)[:, None]).sum(axis=0)))
    return _Phases(table, block_s, of_block, of_ring)
