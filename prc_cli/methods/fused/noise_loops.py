"""Loop of the fused classifier that asks again, in a wider window, which shots are noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import Label
from prc_cli.core.types import F32, I32, U8
from prc_cli.kernels.cache import UniTuple, float32, helper, inlined, kernel, record, uint8
from prc_cli.methods.fused.thresholds import AgainThresholds, NearThresholds

Words = NDArray[np.uint64]

LINES, COLUMNS = 3, 8
"""Greatest distance of the shots that are asked about, in lines and columns."""
BESIDE_LINES = 1
"""The same of the shots whose label is asked for, in lines."""
SMOOTH = 2
"""Smooth pairs of a shot that is on a surface."""
MOST_FELLOWS = 1
"""Most shots on a surface as far as a mirror image: what is mirrored is seen by few."""
GROUND_SHOTS = 2
"""Fewest shots of the ground around that an isolated low shot is ground by."""
MISSING_PART = 6
"""With more than a sixth of the window missing, that nothing is near in range says little."""
_MISSING, _NOISE, _GROUND, _BUILDING = int(Label.MISSING), int(Label.NOISE), int(Label.GROUND), int(Label.BUILDING)
_SPARSE, _SPIKE, _ALONE, _MIRRORED = np.uint8(1), np.uint8(2), np.uint8(4), np.uint8(8)
"""Bits of what is asked of a shot: whether it is no noise after all, in two ways; whether it is, in two ways."""
_FAR = np.float32(1e9)


@helper
def _mark(labels: U8, counts: tuple[U8, U8], texture: F32, above: F32, thresholds: AgainThresholds, marks: U8) -> None:
    """Mark the shots of a line that are asked about; without branches, as most are not."""
    near, smooth = counts
    least, sparse, low = thresholds.least_near, thresholds.sparse_texture, thresholds.low_m
    rough, foot, nothing = thresholds.alone_texture, thresholds.foot_m, np.uint8(0)
    for i in range(len(labels)):
        may_be_kept = (texture[i] < sparse) & ((near[i] > 0) | (abs(above[i]) < low))
        mark = _SPIKE if smooth[i] == 0 else nothing
        mark = (_SPARSE if may_be_kept else nothing) if np.float32(near[i]) < least else mark
        is_open = (smooth[i] == 0) & (texture[i] > rough) & (above[i] > foot) & (labels[i] != _MISSING)
        marks[i] = mark if labels[i] == _NOISE else (_ALONE if is_open else nothing)


@helper
def _mark_amid_cars(labels: U8, smooth: U8, car: np.uint8, marks: U8) -> None:
    """Mark the rough shots of a line with a car on both sides: one of the two shots there is part of it."""
    m, cars = len(labels), 0
    for i in range(m):
        cars += labels[i] == car
    if cars == 0 or m < 5:
        return
    a, b, c, d = labels[: m - 4], labels[1 : m - 3], labels[3 : m - 1], labels[4:]
    own, pairs, inner = labels[2 : m - 2], smooth[2 : m - 2], marks[2 : m - 2]
    for i in range(m - 4):
        is_amid = ((a[i] == car) | (b[i] == car)) & ((c[i] == car) | (d[i] == car))
        is_open = (own[i] != _NOISE) & (own[i] != _MISSING) & (pairs[i] < SMOOTH)
        inner[i] |= _MIRRORED if is_amid & is_open else np.uint8(0)


@helper
def _list(words: Words, marks: U8, shots: I32) -> int:
    """List the marked shots of a line, return how many there are; eight marks are one word."""
    n = 0
    for w in range(len(words)):
        if words[w] == np.uint64(0):
            continue
        for i in range(8 * w, 8 * w + 8):
            shots[n] = i
            n += marks[i] != 0
    return n


@inlined
def _is_on_surface(range_m: F32, line: int, i: int, beams: tuple[F32, F32], off_m: np.float32) -> bool:
    """Return whether the surface through most pairs of opposite shots meets the beam near a shot."""
    sine, cosine = beams
    own = range_m[line, i]
    if i < 2 or i >= range_m.shape[1] - 2:
        return False
    pairs = agreeing = np.int32(0)
    for away in (1, 2):
        a, b = np.uint64(i - away), np.uint64(i + away)
        ay, az = range_m[line, a] * sine[a], -(range_m[line, a] * cosine[a])
        by, bz = range_m[line, b] * sine[b], -(range_m[line, b] * cosine[b])
        across = sine[i] * (bz - az) + cosine[i] * (by - ay)
        pairs += np.int32(across == across)
        agreeing += np.int32(abs(ay * bz - az * by - own * across) < off_m * abs(across))
    for away in (-1, 0, 1):
        there = np.float32(0.5) * (range_m[line - 1, np.uint64(i + away)] + range_m[line + 1, np.uint64(i - away)])
        pairs += np.int32(there == there)
        agreeing += np.int32(abs(there - own) < off_m)
    return bool((agreeing > 0) & (2 * agreeing >= pairs))


@helper
def _is_amid_ground(labels: U8, line: int, i: int) -> bool:
    """Return whether shots around are ground."""
    ground = 0
    for k in range(line - BESIDE_LINES, line + BESIDE_LINES + 1):
        for label in labels[k, max(i - COLUMNS, 0) : min(i + COLUMNS + 1, labels.shape[1])]:
            ground += label == _GROUND
    return ground >= GROUND_SHOTS


@inlined
def _is_sparse(
    range_m: F32,
    smooth: U8,
    at: tuple[int, int],
    beams: tuple[F32, F32],
    step: np.float32,
    limits: NearThresholds,
    thresholds: AgainThresholds,
) -> bool:
    """Return whether more shots of the same thing are in the window, and it is not seen through a surface."""
    sine, cosine = beams
    line, i = at
    own = range_m[line, i]
    y, z = own * sine[i], -(own * cosine[i])
    apart = own * step
    near = max(limits.near_m, limits.near_steps * apart)
    along = max(max(limits.along_m, limits.along_steps * apart), near)
    present = close = before = np.int32(0)
    first, last = max(i - COLUMNS, 0), min(i + COLUMNS + 1, range_m.shape[1])
    for k in range(line - LINES, line + LINES + 1):
        for j in range(first, last):
            place = np.uint64(j)
            there, pairs = range_m[k, place], smooth[k, place]
            a, b = abs(there * sine[place] - y), abs(-(there * cosine[place]) - z)
            is_close = max(a, b) < (along if min(a, b) < limits.thin_m else near)
            present += np.int32(there == there)
            close += np.int32(is_close)
            before += np.int32((not is_close) & (there < own) & (pairs >= SMOOTH))
    # the shot is near to itself
    is_one = np.float32(close - 1) >= thresholds.sparse_shots
    return bool(is_one & (np.float32(before) < thresholds.through_share * np.float32(present - 1)))


@inlined
def _is_mirrored(
    range_m: F32, smooth: U8, labels: U8, at: tuple[int, int], before: int, thresholds: AgainThresholds
) -> bool:
    """Return whether a shot is seen amid a car, farther than its panes and body, and no surface is there.

    ``labels`` begins ``before`` lines after the others.
    """
    line, i = at
    m, own, gap, car = range_m.shape[1], range_m[line, i], thresholds.mirror_m, np.uint8(thresholds.car_label)
    row, end = range_m[line], own - gap
    if not ((row[i - 1] < end) | (row[i - 2] < end)) & ((row[i + 1] < end) | (row[i + 2] < end)):
        return False
    first, last = max(i - COLUMNS, 0), min(i + COLUMNS + 1, m)
    left = right = fellows = np.int32(0)
    for k in range(line - BESIDE_LINES, line + BESIDE_LINES + 1):
        for j in range(first, last):
            place = np.uint64(j)
            off = range_m[k, place] - own
            is_before = (off < -gap) & (labels[k - before, place] == car)
            left += np.int32(is_before & (j < i))
            right += np.int32(is_before & (j > i))
            fellows += np.int32((abs(off) <= gap) & (smooth[k, place] >= SMOOTH))
    least = thresholds.mirror_share * np.float32((2 * BESIDE_LINES + 1) * COLUMNS)
    return bool((np.float32(min(left, right)) >= least) & (fellows <= MOST_FELLOWS))


@inlined
def _is_as_far(range_m: F32, line: int, i: int, same: np.float32) -> bool:
    """Return whether another shot of the window is about as far as one."""
    own, found = range_m[line, i], np.int32(-1)  # the shot is as far as itself
    first, last = max(i - COLUMNS, 0), min(i + COLUMNS + 1, range_m.shape[1])
    for n in range(2 * LINES + 1):
        # from its own line outwards
        k = line + (n + 1) // 2 * (1 if n % 2 else -1)
        for j in range(first, last):
            found += np.int32(abs(range_m[k, np.uint64(j)] - own) < same)
        if found > 0:
            return True
    return False


@helper
def _is_alone(range_m: F32, line: int, i: int, thresholds: AgainThresholds) -> bool:
    """Return whether nothing in the window is about as far, and nothing for long on one side of that."""
    if thresholds.alone_m > 0 and _is_as_far(range_m, line, i, thresholds.alone_m):
        return False
    own = range_m[line, i]
    before = after = _FAR
    missing = cells = 0
    for k in range(line - LINES, line + LINES + 1):
        for j in range(max(i - COLUMNS, 0), min(i + COLUMNS + 1, range_m.shape[1])):
            off = range_m[k, j] - own
            cells += 1
            missing += off != off
            before = min(before, -off if off < 0 else _FAR)
            after = min(after, off if off > 0 else _FAR)
    return bool((missing * MISSING_PART < cells) & (max(before, after) > thresholds.alone_gap_m))


@helper
def _label_around(range_m: F32, labels: U8, line: int, i: int, before: int) -> int:
    """Return the label of the shot around that is nearest in range and no noise; ``labels`` begins later."""
    least, found = _FAR, _BUILDING
    for k in range(line - BESIDE_LINES, line + BESIDE_LINES + 1):
        for j in range(max(i - COLUMNS, 0), min(i + COLUMNS + 1, range_m.shape[1])):
            label, off = labels[k - before, j], abs(range_m[k, j] - range_m[line, i])
            if off < least and label != _NOISE and label != _MISSING:
                least, found = off, int(label)
    return found


@kernel(
    uint8[:, ::1](
        uint8[:, ::1],
        uint8[:, ::1],
        float32[:, ::1],
        UniTuple(uint8[:, ::1], 2),
        float32[:, ::1],
        float32[:, ::1],
        UniTuple(float32[::1], 2),
        float32,
        record(NearThresholds),
        record(AgainThresholds),
    )
)
def noise_again(
    labels: U8,
    voted: U8,
    range_m: F32,
    counts: tuple[U8, U8],
    above_m: F32,
    texture: F32,
    beams: tuple[F32, F32],
    step: np.float32,
    limits: NearThresholds,
    thresholds: AgainThresholds,
) -> U8:
    """Label noise that is seen in a wider window alone, and take back noise that is none.

    ``labels`` (lines + 2, M) uint8; ``voted`` (lines, M) uint8; ``range_m`` (lines + 6, M) float32, metres; ``counts``
    tuple of (lines + 6, M) uint8; ``above_m`` (lines, M) float32, metres; ``texture`` (lines, M) float32; ``beams``
    tuple of (M,) float32; returns (lines, M) uint8.
    """
    n_lines, m = voted.shape
    near, smooth = counts
    found = voted.copy()
    room = (m + 7) // 8 * 8
    marks, shots = np.zeros(room, np.uint8), np.empty(room + 1, np.int32)
    words, car = marks.view(np.uint64), np.uint8(thresholds.car_label)
    # the first line of the labels is this many lines after that of the ranges
    before = LINES - BESIDE_LINES
    for line in range(n_lines):
        k, row = line + LINES, found[line]
        _mark(voted[line], (near[k], smooth[k]), texture[line], above_m[line], thresholds, marks[:m])
        _mark_amid_cars(labels[line + BESIDE_LINES], smooth[k], car, marks[:m])
        for n in range(_list(words, marks, shots)):
            i = int(shots[n])
            mark, is_kept, is_noise = marks[i], False, False
            if mark == _SPIKE:
                is_kept = _is_on_surface(range_m, k, i, beams, thresholds.spike_m)
            elif mark == _SPARSE:
                if abs(above_m[line, i]) < thresholds.low_m and _is_amid_ground(labels, line + BESIDE_LINES, i):
                    row[i] = np.uint8(_GROUND)
                elif near[k, i] > 0:
                    is_kept = _is_sparse(range_m, smooth, (k, i), beams, step, limits, thresholds)
            elif mark & _ALONE:
                is_noise = _is_alone(range_m, k, i, thresholds)
            if mark & _MIRRORED and not is_noise:
                is_noise = _is_mirrored(range_m, smooth, labels, (k, i), before, thresholds)
            if is_kept:
                row[i] = np.uint8(_label_around(range_m, labels, k, i, before))
            elif is_noise:
                row[i] = np.uint8(_NOISE)
    return found
