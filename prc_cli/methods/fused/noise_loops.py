"""Check again, in a wider window, which shots are noise and which are leaves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import Label, Reason
from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import F32, F32_2, U8, U8_2
from prc_cli.methods.fused.thresholds import AgainThresholds

Words = NDArray[np.uint64]

LINES = 3
COLUMNS = 8
"""Greatest distance of the shots around whose range is looked at, in lines and columns."""
BESIDE_LINES = 1
"""Greatest distance of those whose label is looked at, in lines."""
SMOOTH = 2
"""Smooth pairs of a shot that is on a surface."""
MOST_FELLOWS = 1
"""Most shots on a surface as far as a mirror image: what is mirrored is seen by few."""
MISSING_PART = 6
"""With more than a sixth of the window missing, that nothing is near in range says little."""
_MISSING = int(Label.MISSING)
_NOISE = int(Label.NOISE)
_CAR = int(Label.CAR)
_LEAVES = int(Label.VEGETATION)
_ALONE = np.uint8(1)
_MIRRORED = np.uint8(2)
_LOST = np.uint8(4)
"""Bits of the questions about a shot: whether its range is alone, whether it is a mirror image,
and, if it is noise, whether it is a leaf."""
_RANGE_ALONE = np.uint8(Reason.RANGE_ALONE)
_MIRROR_IMAGE = np.uint8(Reason.MIRRORED)
_LEAF = np.uint8(Reason.LEAF)
_FAR = np.float32(1e9)


@helper
def _mark_questions(
    labels: U8,
    smooth: U8,
    texture: F32,
    above: F32,
    thresholds: AgainThresholds,
    marks: U8,
) -> None:
    """Mark the rough shots of a line that may be alone, and noise that may be a leaf."""
    rough = thresholds.alone_texture
    foot = thresholds.foot_m
    for i in range(len(labels)):
        is_open = (labels[i] != _MISSING) & (labels[i] != _NOISE)
        is_rough = (smooth[i] == 0) & (texture[i] > rough) & (above[i] > foot)
        is_lost = (labels[i] == _NOISE) & (above[i] > foot)
        marks[i] = _ALONE if is_open & is_rough else (_LOST if is_lost else np.uint8(0))


@helper
def _mark_amid_cars(labels: U8, smooth: U8, marks: U8) -> None:
    """Mark the rough shots of a line that have a car among the two shots on either side."""
    m = len(labels)
    cars = 0
    car = np.uint8(_CAR)
    for i in range(m):
        cars += labels[i] == car
    if cars == 0 or m < 5:
        return
    a = labels[: m - 4]
    b = labels[1 : m - 3]
    c = labels[3 : m - 1]
    d = labels[4:]
    middle = labels[2 : m - 2]
    pairs = smooth[2 : m - 2]
    inner = marks[2 : m - 2]
    for i in range(m - 4):
        is_amid = ((a[i] == car) | (b[i] == car)) & ((c[i] == car) | (d[i] == car))
        is_open = (middle[i] != _NOISE) & (middle[i] != _MISSING) & (pairs[i] < SMOOTH)
        inner[i] |= _MIRRORED if is_amid & is_open else np.uint8(0)


@inlined
def _is_mirrored(
    range_m: F32,
    smooth: U8,
    labels: U8,
    line: int,
    i: int,
    before: int,
    thresholds: AgainThresholds,
) -> bool:
    """Whether a shot lies behind the panes and body of a car, and on no surface.

    ``labels`` starts ``before`` lines after the other arrays.
    """
    m = range_m.shape[1]
    shot_m = range_m[line, i]
    gap = thresholds.mirror_m
    car = np.uint8(_CAR)
    row = range_m[line]
    end = shot_m - gap
    if not ((row[i - 1] < end) | (row[i - 2] < end)) & ((row[i + 1] < end) | (row[i + 2] < end)):
        return False
    first = max(i - COLUMNS, 0)
    last = min(i + COLUMNS + 1, m)
    left = right = fellows = np.int32(0)
    for k in range(line - BESIDE_LINES, line + BESIDE_LINES + 1):
        for j in range(first, last):
            place = np.uint64(j)
            off = range_m[k, place] - shot_m
            is_before = (off < -gap) & (labels[k - before, place] == car)
            left += np.int32(is_before & (j < i))
            right += np.int32(is_before & (j > i))
            fellows += np.int32((abs(off) <= gap) & (smooth[k, place] >= SMOOTH))
    least = thresholds.mirror_share * np.float32((2 * BESIDE_LINES + 1) * COLUMNS)
    return bool((np.float32(min(left, right)) >= least) & (fellows <= MOST_FELLOWS))


@helper
def _is_alone(
    range_m: F32,
    line: int,
    i: int,
    thresholds: AgainThresholds,
) -> bool:
    """Whether no shot of the window is about as far, and one side has a long gap."""
    # the shot is as far as itself
    shot_m = range_m[line, i]
    as_far = np.int32(-1)
    before = after = _FAR
    missing = cells = 0
    for n in range(2 * LINES + 1):
        # from its own line outwards
        k = line + (n + 1) // 2 * (1 if n % 2 else -1)
        for j in range(max(i - COLUMNS, 0), min(i + COLUMNS + 1, range_m.shape[1])):
            off = range_m[k, np.uint64(j)] - shot_m
            as_far += np.int32(abs(off) < thresholds.alone_m)
            cells += 1
            missing += off != off
            before = min(before, -off if off < 0 else _FAR)
            after = min(after, off if off > 0 else _FAR)
        if as_far > 0:
            return False
    return bool((missing * MISSING_PART < cells) & (max(before, after) > thresholds.alone_gap_m))


@helper
def _is_leaf(
    range_m: F32,
    labels: U8,
    line: int,
    i: int,
    before: int,
    thresholds: AgainThresholds,
) -> bool:
    """Whether enough leaves around a shot are about as far; ``labels`` starts ``before`` later."""
    leaves = np.int32(0)
    for k in range(line - BESIDE_LINES, line + BESIDE_LINES + 1):
        for j in range(max(i - COLUMNS, 0), min(i + COLUMNS + 1, range_m.shape[1])):
            is_near = abs(range_m[k, np.uint64(j)] - range_m[line, i]) < thresholds.leaf_m
            leaves += np.int32(is_near & (labels[k - before, np.uint64(j)] == np.uint8(_LEAVES)))
    return bool(np.float32(leaves) >= thresholds.leaves)


@loop()
def noise_again(
    labels: U8_2,
    voted: U8_2,
    range_m: F32_2,
    smooth: U8_2,
    above_m: F32_2,
    texture: F32_2,
    thresholds: AgainThresholds,
) -> U8_2:
    """Find noise and leaves that only a wider window shows.

    These are mirror images in cars, ranges that no shot around has, and leaves among the noise.

    ``labels`` (lines + 2, M) uint8; ``voted`` (lines, M) uint8; ``range_m`` (lines + 6, M) float32,
    metres; ``smooth`` (lines + 6, M) uint8; ``above_m`` (lines, M) float32, metres; ``texture``
    (lines, M) float32; returns (lines, M) uint8, the label, or the reason where it is one of these.
    """
    n_lines, m = voted.shape
    labels_or_reasons = voted.copy()
    room = (m + 7) // 8 * 8
    marks = np.zeros(room, np.uint8)
    shots = np.empty(room + 1, np.int32)
    words = marks.view(np.uint64)
    # the first line of the labels is this many lines after that of the ranges
    before = LINES - BESIDE_LINES
    for line in range(n_lines):
        k = line + LINES
        _mark_questions(voted[line], smooth[k], texture[line], above_m[line], thresholds, marks[:m])
        _mark_amid_cars(labels[line + BESIDE_LINES], smooth[k], marks[:m])
        # eight marks are one word
        n_shots = 0
        for w in range(len(words)):
            if words[w] == np.uint64(0):
                continue
            for i in range(8 * w, 8 * w + 8):
                shots[n_shots] = i
                n_shots += marks[i] != 0
        for n in range(n_shots):
            i = int(shots[n])
            if marks[i] & _ALONE and _is_alone(range_m, k, i, thresholds):
                labels_or_reasons[line, i] = _RANGE_ALONE
            elif marks[i] & _MIRRORED and _is_mirrored(
                range_m, smooth, labels, k, i, before, thresholds
            ):
                labels_or_reasons[line, i] = _MIRROR_IMAGE
            elif marks[i] & _LOST and _is_leaf(range_m, labels, k, i, before, thresholds):
                labels_or_reasons[line, i] = _LEAF
    return labels_or_reasons
