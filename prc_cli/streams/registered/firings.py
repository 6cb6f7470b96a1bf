"""The firings of a spinning head, from the times of the points of every ring.

A ring fires at the same place of every firing, so the times of its points are whole firings apart.
The clock of the points and that of the scanner may drift, so the phase of the firings is followed
along the drive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

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
    fired = time_s[known][order]
    step = np.diff(fired)[np.diff(number) == 0]
    step = step[step > 0]
    if len(step) < MIN_STEPS:
        return None
    period = _period(step)
    origin = float(time_s[0])
    table, block_s = _phases(fired, number, origin, period, len(ahead_rad))
    drift, ring_phase = _separated(table)
    # an even drift is an error of the period
    apart = np.diff(block_s)
    near = apart < 1.5 * BLOCK_S
    if near.any():
        turns = np.angle(drift[1:] * np.conj(drift[:-1]))[near] / (2.0 * np.pi)
        period *= 1.0 - float(np.median(turns / apart[near])) * period
        table, block_s = _phases(fired, number, origin, period, len(ahead_rad))
        drift, ring_phase = _separated(table)
    count = np.bincount(number, minlength=len(ahead_rad))
    evenness = float(np.abs((table * np.conj(ring_phase)).sum(axis=1)).sum() / count.sum())
    if evenness < MIN_EVENNESS:
        return None
    place = np.remainder(np.angle(ring_phase) / (2.0 * np.pi), 1.0)
    first = _first_place(place[count > 0])
    # a ring that fires with the first one fires after it, not a period later
    delay = np.remainder(place - first + SAME, 1.0) - SAME
    firings = Firings(
        period, origin + first * period, delay * period, np.zeros(len(delay), np.int64), evenness
    )
    ahead = np.rint(ahead_rad / (2.0 * np.pi * turn_hz * period)).astype(np.int64)
    return starting(replace(firings, late=ahead.max() - ahead), origin)


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
    cycles = (fired_s - firings.origin_s) / firings.period_s - firings.delay_s[
        ring
    ] / firings.period_s
    block = np.floor((time_s[known] - firings.origin_s) / BLOCK_S).astype(np.int64)
    begin = np.flatnonzero(np.diff(block, prepend=block[0] - 1))
    phase = np.angle(np.add.reduceat(np.exp(2j * np.pi * cycles[known]), begin)) / (2.0 * np.pi)
    middle = (block[begin] + 0.5) * BLOCK_S + firings.origin_s
    last_s, last_drift = firings.before
    if not math.isfinite(last_s):
        last_drift = 0.0
    drift = np.unwrap(np.concatenate([[last_drift], phase]), period=1.0)[1:]
    shift = np.interp(time_s, middle, drift)
    number: I64 = np.where(known, np.rint(cycles - shift).astype(np.int64), -1)
    return number, replace(firings, before=(float(middle[-1]), float(drift[-1])))


def starting(firings: Firings, time_s: float) -> Firings:
    """Return the firings counted from a time: later firings and lines have numbers from 0."""
    periods = (
        math.floor((time_s - firings.origin_s) / firings.period_s) - 2 - int(firings.late.max())
    )
    return replace(firings, origin_s=firings.origin_s + periods * firings.period_s)


def line_numbers(number: I64, ring: I64, firings: Firings) -> I64:
    """Return the line of every point; shots of a line look one way, -1 = no ring."""
    lines: I64 = np.where(ring >= 0, number - firings.late[ring], -1)
    return lines


def _period(step: F64) -> float:
    """Return the longest time of which most steps are multiples."""
    best = math.nan
    for share in (50.0, 20.0, 5.0, 1.0):
        short = float(np.percentile(step, share))
        period = float(np.mean(step[(step > 0.7 * short) & (step < 1.4 * short)]))
        for reach in (3.5, 10.5, 30.5, 100.5):
            count = np.rint(step / period)
            use = (count > 0) & (count < reach) & (np.abs(step - count * period) < 0.2 * period)
            if use.sum() >= MIN_STEPS // 2:
                period = float((step[use] * count[use]).sum() / (count[use] ** 2).sum())
        near = step[step < 20.0 * period]
        if np.abs(np.exp(2j * np.pi * near / period).mean()) > MIN_EVENNESS:
            return period
        if math.isnan(best):
            best = period
    return best


def _phases(
    fired: F64,
    number: I64,
    origin_s: float,
    period_s: float,
    n_rings: int,
) -> tuple[NDArray[Any], F64]:
    """Return the summed phase by block and ring, (b, k) complex, and the times of blocks."""
    block = np.floor((fired - origin_s) / BLOCK_S).astype(np.int64)
    blocks, row = np.unique(block, return_inverse=True)
    table = np.zeros((len(blocks), n_rings), np.complex128)
    np.add.at(table, (row, number), np.exp(2j * np.pi * (fired - origin_s) / period_s))
    middle = np.asarray((blocks + 0.5) * BLOCK_S + origin_s, np.float64)
    return table, middle


def _separated(table: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the unit phases of blocks and of rings whose products are a table."""
    ring = np.ones(table.shape[1], np.complex128)
    ring *= np.exp(1j * np.angle(table[int(np.argmax(np.abs(table).sum(axis=1)))]))
    for _ in range(10):
        block = np.exp(1j * np.angle((table * np.conj(ring)).sum(axis=1)))
        ring = np.exp(1j * np.angle((table * np.conj(block)[:, None]).sum(axis=0)))
    return block, ring


def _first_place(place: F64) -> float:
    """Return the place in a firing after the longest pause."""
    ordered = np.sort(place)
    pause = np.diff(ordered, prepend=ordered[-1] - 1.0)
    return float(ordered[int(np.argmax(pause))])
