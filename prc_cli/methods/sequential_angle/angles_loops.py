"""Loops over the shots of vertical lines.

Signed angles, their differences, line angles (Stamos et al. 2012).

Valid shots of a row are gathered first, so that missing ones cost nothing in the searches.
"""

from __future__ import annotations

import math

import numpy as np

from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import F32_2, F32_3, F64, F64_2, I32_1, I32_2, U8_2
from prc_cli.methods.sequential_angle.thresholds import ChordThresholds

_HORIZONTAL = 2
"""H as :class:`prc_cli.core.classes.Surface` numbers it."""


_ARC_SINE = np.array(
    (
        1.0,
        0.16666666666666796,
        0.07499999999966611,
        0.04464285717686322,
        0.030381942642327187,
        0.022372216106072148,
        0.017351600625343435,
        0.01398088299217101,
        0.011398850408440755,
        0.010778675120995992,
        0.0037180577483250537,
        0.02166805886905636,
        -0.02093065831518245,
        0.03257934796692842,
    )
)
"""Polynomial for arcsin(s) / s in powers of s squared, equal to it at Chebyshev's nodes of s up to
1/2: what it differs by, 1.1e-18, is below the last bit."""
_TERMS = len(_ARC_SINE)


@helper
def _to_degrees(cosine: F64, length: F64, m: int) -> None:
    """Turn heights of chords, with the squares of their lengths, into angles from 0 to 180 [deg].

    Many at a time: the library's arc cosine takes one by one. arccos(c) = 2 arcsin(sqrt((1 - c) /
    2)) where the cosine is above 1/2, and alike below -1/2; between them 90 deg less arcsin(c).
    """
    for i in range(m):
        cosine[i] = min(max(cosine[i] / math.sqrt(length[i]), -1.0), 1.0)
        size = abs(cosine[i])
        outer = size > 0.5
        square = 0.5 * (1.0 - size) if outer else size * size
        series = _ARC_SINE[_TERMS - 1]
        for term in range(_TERMS - 2, -1, -1):
            series = series * square + _ARC_SINE[term]
        sine = math.sqrt(square) if outer else cosine[i]
        part = sine * series
        angle = (
            (2.0 * part if cosine[i] > 0.0 else math.pi - 2.0 * part)
            if outer
            else 0.5 * math.pi - part
        )
        cosine[i] = math.degrees(angle)


_ARC_TANGENT = np.array(
    (
        1.0,
        -0.3333333333333312,
        0.19999999999940837,
        -0.14285714279244968,
        0.11111110744657099,
        -0.09090896801472813,
        0.07692045194561481,
        -0.06662950246036792,
        0.05846866752275139,
        -0.05035049795312439,
        0.03796390316111083,
        -0.017803896394812564,
    )
)
"""Polynomial for arctan(t) / t in powers of t squared, likewise, for t up to tan(pi / 8).

It differs by 1.3e-18.
"""
_ARC_TERMS = len(_ARC_TANGENT)
_EIGHTH = math.tan(math.pi / 8.0)


@helper
def _directions(up: F64, along: F64, m: int) -> None:
    """Turn vectors with y >= 0 into their directions [rad], left in ``up``: atan2, many at a time.

    The direction is twice that of (x + length, y), which for t = tan above tan(pi / 8) is pi / 4
    and that of (t - 1) / (t + 1) more.
    """
    for i in range(m):
        y = up[i]
        x = along[i]
        base = math.sqrt(x * x + y * y) + abs(x)
        tangent = y / base if base > 0.0 else 0.0
        steep = tangent > _EIGHTH
        t = (tangent - 1.0) / (tangent + 1.0) if steep else tangent
        square = t * t
        series = _ARC_TANGENT[_ARC_TERMS - 1]
        for term in range(_ARC_TERMS - 2, -1, -1):
            series = series * square + _ARC_TANGENT[term]
        angle = 2.0 * (t * series) + (0.5 * math.pi if steep else 0.0)
        up[i] = math.pi - angle if x < 0.0 else angle


@inlined
def _first_far(
    x: F64,
    y: F64,
    z: F64,
    i: int,
    begin: int,
    end: int,
    step: int,
    least: float,
) -> int:
    """Return the first shot from ``begin`` on that makes a chord with shot i, -1 = none.

    ``least`` is the square of the least length of a chord [m2].
    """
    for j in range(begin, end, step):
        dx = x[j] - x[i]
        dy = y[j] - y[i]
        dz = z[j] - z[i]
        square = dx * dx + dy * dy + dz * dz
        if square > 0.0 and square >= least:
            return j
    return -1


@loop("prc_cli.reference.sequential_angle.angles")
def signed_angles(
    range_m: F32_2,
    xyz_m: F32_3,
    n_beams: I32_1,
    thresholds: ChordThresholds,
) -> tuple[F32_2, I32_2]:
    """Measure the signed angle of every chord with the vertical, sV.

    ``range_m`` (R, n) float32, metres; ``xyz_m`` (R, n, 3) float32, metres; ``n_beams`` (R,) int32;
    returns ``signed_deg`` (R, n) float32, degrees, ``ahead`` (R, n) int32.
    """
    n_rows, n = range_m.shape
    signed_deg = np.full((n_rows, n), np.nan, np.float32)
    ahead = np.full((n_rows, n), -1, np.int32)
    least = thresholds.least_chord_m * thresholds.least_chord_m
    reach = thresholds.max_shots
    x = np.empty(n, np.float64)
    y = np.empty(n, np.float64)
    z = np.empty(n, np.float64)
    beam = np.empty(n, np.int32)
    angle = np.empty(n, np.float64)
    length = np.empty(n, np.float64)
    sign = np.empty(n, np.float64)
    begin = np.empty(n, np.int32)
    for row in range(n_rows):
        m = n_chords = int(np.int64(0))
        for k in range(min(np.int64(n_beams[row]), n)):
            x[m] = xyz_m[row, k, 0]
            y[m] = xyz_m[row, k, 1]
            z[m] = xyz_m[row, k, 2]
            beam[m] = k
            m += not math.isnan(range_m[row, k])
        end = int(np.int64(-1))
        for i in range(m):
            follows = end == i
            end = _first_far(x, y, z, i, i + 1, min(i + 1 + reach, m), 1, least)
            if end < 0:
                continue
            # the chord before is the one from the last shot where that ends here
            back = (
                i - 1
                if follows
                else _first_far(x, y, z, i, i - 1, max(i - 1 - reach, -1), -1, least)
            )
            dx = x[end] - x[i]
            dy = y[end] - y[i]
            dz = z[end] - z[i]
            turn = 0.0
            if back >= 0:
                turn = dx * (x[i] - x[back]) + dy * (y[i] - y[back]) + dz * (z[i] - z[back])
            sign[n_chords] = -1.0 if turn < 0.0 else 1.0
            angle[n_chords] = dz
            length[n_chords] = dx * dx + dy * dy + dz * dz
            begin[n_chords] = beam[i]
            n_chords += 1
            ahead[row, beam[i]] = beam[end]
        _to_degrees(angle, length, n_chords)
        for i in range(n_chords):
            signed_deg[row, begin[i]] = sign[i] * angle[i]
    return signed_deg, ahead


@loop("prc_cli.reference.sequential_angle.angles")
def angle_differences(signed_deg: F32_2) -> F32_2:
    """Subtract from every signed angle the one before it, sD.

    ``signed_deg`` (R, n) float32, degrees; returns (R, n) float32, degrees.
    """
    n_rows, n = signed_deg.shape
    differences = np.empty((n_rows, n), np.float32)
    for row in range(n_rows):
        before = np.float32(np.nan)
        for k in range(n):
            angle = signed_deg[row, k]
            if math.isnan(angle):
                differences[row, k] = np.nan
                continue
            differences[row, k] = np.float32(0.0) if math.isnan(before) else angle - before
            before = angle
    return differences


@loop("prc_cli.reference.sequential_angle.angles")
def line_angles(
    range_m: F32_2,
    ahead: I32_2,
    surface: U8_2,
    beam_rad: F64_2,
) -> F32_2:
    """Measure the line angle of every horizontal shot that begins a chord (eq. 2).

    ``range_m`` (R, n) float32, metres; ``ahead`` (R, n) int32; ``surface`` (R, n) uint8;
    ``beam_rad`` (n_sides, n) float64; returns (R, n) float32, degrees.
    """
    n_rows, n = range_m.shape
    n_sides = len(beam_rad)
    angles = np.full((n_rows, n), np.nan, np.float32)
    # most chords go to the same beam as in the row before: sine and cosine of the angle between
    # them are kept
    known = np.full((n_sides, n), -1, np.int32)
    sine = np.empty((n_sides, n), np.float64)
    cosine = np.empty((n_sides, n), np.float64)
    here = np.empty(n, np.float64)
    there = np.empty(n, np.float64)
    up = np.empty(n, np.float64)
    along = np.empty(n, np.float64)
    beam = np.empty(n, np.int32)
    for row in range(n_rows):
        side = row % n_sides
        m = int(np.int64(0))
        for k in range(n):
            far = ahead[row, k]
            if surface[row, k] != _HORIZONTAL or far < 0:
                continue
            if known[side, k] != far:
                step = beam_rad[side, far] - beam_rad[side, k]
                known[side, k] = far
                sine[side, k] = math.sin(step)
                cosine[side, k] = math.cos(step)
            here[m] = range_m[row, k]
            there[m] = range_m[row, far]
            up[m] = sine[side, k]
            along[m] = cosine[side, k]
            beam[m] = k
            m += 1
        # angle of the chord with the beam to its beginning, 0 to pi (eq. 2 with atan2)
        for i in range(m):
            along[i] -= here[i] / there[i]
        _directions(up, along, m)
        for i in range(m):
            angles[row, beam[i]] = math.degrees(up[i] + beam_rad[side, beam[i]])
    return angles
