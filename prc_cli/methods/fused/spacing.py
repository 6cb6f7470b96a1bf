"""Distance of scan lines: neighbours in other lines must be so far away that they see other leaves.

If a scanner moves slowly, the next line meets the same leaves again, and a crown looks as smooth as
a wall across the lines. Ranges do not show how far apart lines are, but they show how often a line
n lines back has the same range at a leaf: a shot whose neighbours in the line are near and on no
common surface. Leaves that are apart by more than their size agree only by chance. If even the
farthest line agrees, the platform stands still, and other lines show nothing new.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.profile import stage
from prc_cli.core.types import F32, F64, I64, U8
from prc_cli.methods.fused.neighbours import smooth_pairs
from prc_cli.methods.fused.plane import ScanPlane
from prc_cli.methods.fused.spacing_loops import EVERY_LINE, LAGS, MOST_LAG, leaf_repeats
from prc_cli.methods.fused.thresholds import Smoothness, Spaced, SpacingThresholds

AHEAD_LINES = 16
"""Lines after a line that decide its distance."""
BESIDE_LINES = 3
"""Lines before and after a block whose distance is needed as well."""
COUNTED_LINES = AHEAD_LINES - BESIDE_LINES
"""Lines of a block that were counted with the blocks before."""
PAIR_LINES = 2
"""Pairs reach to the second neighbour among the lines."""
SPACED_LINES = PAIR_LINES * MOST_LAG + BESIDE_LINES
"""Lines before and after a block that its labels depend on."""
STANDS = 0
"""Instead of a number of lines: the platform stands still, and other lines show nothing new."""
IN_LINE_PAIRS = np.array([0, 2, 3, 5, 7, 8, 10], np.uint8)
"""Smooth pairs, of 10, that replace those of the 6 pairs in the line if the platform stands."""


@dataclass(frozen=True, slots=True, eq=False)
class Spacing:
    """Distance of the lines so far, and the leaves that show it."""

    sums: F64
    """(6, 2) float64, leaves compared and leaves seen again, at each of :data:`LAGS` and beside.

    Earlier ones count less."""
    stride: int
    """Lines from neighbour to neighbour, :data:`STANDS` = none."""

    @classmethod
    def none(cls) -> Spacing:
        """Return the state before the first line."""
        return cls(np.zeros((len(LAGS) + 1, 2)), 1)


@stage("spacing")
def count_repeated_leaves(
    window_m: F32,
    first_line: int,
    noise_m: F64,
    thresholds: Callable[[float], SpacingThresholds],
) -> NDArray[np.int32]:
    """Count leaves that are seen again; see :func:`spacing_loops.leaf_repeats`.

    ``window_m`` (lines + 2 SPACED_LINES, M) float32, metres; ``noise_m`` (lines + 2 SPACED_LINES,)
    float64; returns (n, 6, 2) int32.
    """
    begin = _first_uncounted(first_line)
    end = len(window_m) - SPACED_LINES + BESIDE_LINES + AHEAD_LINES
    first = SPACED_LINES + begin
    counts = [
        leaf_repeats(
            window_m[first + a - MOST_LAG : first + b],
            -(first_line + begin + a) % EVERY_LINE,
            thresholds(stretch_noise_m),
        )
        for a, b, stretch_noise_m in stretches(noise_m[first:end])
    ]
    return np.concatenate(counts) if len(counts) > 1 else counts[0]


def stretches(values: F64) -> list[tuple[int, int, float]]:
    """Return the stretches of equal values: first, end, and value; one if there are no values.

    >>> stretches(np.array([2.0, 2.0, 1.0]))
    [(0, 2, 2.0), (2, 3, 1.0)]
    """
    edges = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return [(a, b, float(values[a]) if b > a else math.nan) for a, b in pairwise(edges)]


def strides_of(
    counts: NDArray[np.int32],
    known: Spacing,
    first_line: int,
    n_lines: int,
    limits: Spaced,
    ahead: int = 0,
) -> tuple[I64, Spacing]:
    """Decide how many lines away the neighbours of every line are; also return the state after.

    ``counts`` (n, 6, 2) int32; returns ``strides`` (lines + ahead + 6,) int64.
    """
    sums = known.sums
    stride = known.stride
    strides = np.full(n_lines + ahead + 2 * BESIDE_LINES, stride, np.int64)
    begin = _first_uncounted(first_line)
    state_after: Spacing | None = None
    # the distance changes only at lines that were compared
    for k in range(-(first_line + begin) % EVERY_LINE, len(counts), EVERY_LINE):
        line = begin + k
        if line >= n_lines + COUNTED_LINES and state_after is None:
            state_after = Spacing(sums, stride)
        sums = sums * limits.decay + counts[k]
        stride = _stride(sums, stride, limits)
        strides[max(line - COUNTED_LINES, 0) :] = stride
    return strides, state_after or Spacing(sums, stride)


def _first_uncounted(first_line: int) -> int:
    """Return the first line of a block in which no earlier block counted leaves."""
    return COUNTED_LINES if first_line > 0 else 0


def _stride(sums: F64, now: int, limits: Spaced) -> int:
    """Return the least distance at which few enough leaves are seen again; ``now`` if unclear."""
    counts = sums.tolist()
    if not counts[0][0] >= limits.least:
        return now
    # leaves that are as far by chance: as many as in the line itself
    chance = counts[-1][1] / max(counts[-1][0], 1.0)
    for lag, (n_leaves, n_repeated) in zip(LAGS, counts, strict=False):
        limit = limits.keep_share if now == STANDS or lag < now else limits.share
        if not n_repeated > (chance + limit * (1.0 - chance)) * n_leaves:
            return lag
    return STANDS


@stage("smoothness")
def spaced_pairs(
    window_m: F32,
    strides: I64,
    plane: ScanPlane,
    noise_m: F64,
    limits: Smoothness,
) -> U8:
    """Count smooth pairs with lines of the right distance.

    ``window_m`` (lines + 64, M) float32, metres; ``strides`` (lines,) int64; ``noise_m`` (lines,)
    float64; returns (lines, M) uint8.
    """
    margin = PAIR_LINES * MOST_LAG
    counts = [
        _spaced_pairs(window_m[a : b + 2 * margin], strides[a:b], plane, stretch_noise_m, limits)
        for a, b, stretch_noise_m in stretches(noise_m)
    ]
    return np.concatenate(counts) if len(counts) > 1 else counts[0]


def _spaced_pairs(
    window_m: F32,
    strides: I64,
    plane: ScanPlane,
    noise_m: float,
    limits: Smoothness,
) -> U8:
    """Count smooth pairs as :func:`spaced_pairs` does, in lines with the same range noise [m]."""
    margin = PAIR_LINES * MOST_LAG
    n_lines = len(strides)
    m = window_m.shape[1]
    chosen = np.unique(strides)
    if len(chosen) == 1 and chosen[0] == 1:
        return smooth_pairs(
            window_m[margin - PAIR_LINES : len(window_m) - margin + PAIR_LINES],
            plane,
            noise_m,
            limits,
        )
    smooth = np.empty((n_lines, m), np.uint8)
    for stride in chosen.tolist():
        lines = np.flatnonzero(strides == stride)
        if stride == STANDS:
            alone = np.full((3 * len(lines) + 2, m), np.nan, np.float32)
            alone[2::3] = window_m[lines + margin]
            smooth[lines] = IN_LINE_PAIRS[smooth_pairs(alone, plane, noise_m, limits)[::3]]
            continue
        first = int(lines[0])
        last = int(lines[-1])
        # every stride-th line is a stream of its own
        for phase in range(first, min(first + stride, last + 1)):
            phase_lines = np.arange(phase, last + 1, stride)
            before = margin + phase - PAIR_LINES * stride
            rows = np.ascontiguousarray(
                window_m[before : margin + phase_lines[-1] + PAIR_LINES * stride + 1 : stride]
            )
            counts = smooth_pairs(rows, plane, noise_m, limits)
            has_stride = strides[phase_lines] == stride
            smooth[phase_lines[has_stride]] = counts[has_stride]
    return smooth
