"""Loops of the fused classifier that let the shots around vote on every label."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import Label
from prc_cli.core.types import F32, F32_2, I32, U8, U8_2
from prc_cli.kernels.cache import helper, inlined, kernel
from prc_cli.methods.fused.records import Beams, VotingLine

Pairs = NDArray[np.uint32]

MOST_COLUMNS = 60
LEAST_COLUMNS = 2
"""Limits of the half width of a place, in columns."""
VOTERS = 4
"""Votes in a line on either side of a shot; fewer where the place has fewer columns."""
_MISSING = int(Label.MISSING)
_NOISE = int(Label.NOISE)
_GROUND = int(Label.GROUND)
_BUILDING = int(Label.BUILDING)
_VEGETATION = int(Label.VEGETATION)
_OTHER = int(Label.UNCLASSIFIED)
_CAR = int(Label.CAR)
_POLE = int(Label.POLE)
_CAR_BIT = 6
_POLE_BIT = 12
_BUILDING_BIT = 18
_VEGETATION_BIT = 24
"""First bit of the votes for a label in a word; votes for no class begin at bit 0.

A place has at most 15 shots in each of three lines, so that six bits hold their votes."""


@helper
def _lay_out(
    ranges: F32,
    beams: Beams,
    side: F32,
    height: F32,
) -> None:
    """Write the points of a line in the scan plane."""
    sine, cosine = beams
    for i in range(len(ranges)):
        side[i] = ranges[i] * sine[i]
    for i in range(len(ranges)):
        height[i] = -(ranges[i] * cosine[i])


@inlined
def _differs(label: np.uint8, label_of_shot: np.uint8) -> bool:
    """Return whether a label differs; missing and noise do not count as labels."""
    return bool((label != label_of_shot) & (label != _MISSING) & (label != _NOISE))


@helper
def _mark_unsettled(
    before: U8,
    labels: U8,
    after: U8,
    unsettled: U8,
) -> None:
    """Mark shots with another label than a shot a few columns away, or of an adjacent line."""
    m = len(labels)
    for i in range(m):
        unsettled[i] = _differs(before[i], labels[i]) | _differs(after[i], labels[i])
    # compare with the shot VOTERS columns on, to both sides; beyond the ends with the outermost
    # shot
    n = min(VOTERS, m)
    for way in range(2):
        shots = labels[: m - n] if way == 0 else labels[n:]
        beside = labels[n:] if way == 0 else labels[: m - n]
        marks = unsettled[: m - n] if way == 0 else unsettled[n:]
        for i in range(m - n):
            marks[i] |= _differs(beside[i], shots[i])
        end = labels[m - 1] if way == 0 else labels[0]
        for k in range(n):
            i = m - n + k if way == 0 else k
            unsettled[i] |= _differs(end, labels[i])
    for i in range(m):
        label = labels[i]
        unsettled[i] &= (
            (label != _MISSING) & (label != _NOISE) & (label != _GROUND) & (label != _OTHER)
        )


@helper
def _weigh(labels: U8, weights: Pairs) -> None:
    """Write the vote of every shot: each of the five labels has its own part of the word."""
    for i in range(len(labels)):
        label = labels[i]
        building = np.uint32(1 << _BUILDING_BIT) if label == _BUILDING else np.uint32(0)
        vegetation = np.uint32(1 << _VEGETATION_BIT) if label == _VEGETATION else np.uint32(0)
        car = np.uint32(1 << _CAR_BIT) if label == _CAR else np.uint32(0)
        pole = np.uint32(1 << _POLE_BIT) if label == _POLE else np.uint32(0)
        weights[i] = building | vegetation | car | pole | np.uint32(label == _OTHER)


@inlined
def _vote(votes: np.uint32, label: np.uint8) -> np.uint8:
    """Return the label with most votes; of several, the shot's own if it is among them."""
    part = np.uint32((1 << _CAR_BIT) - 1)
    unclassified = votes & part
    car = (votes >> np.uint32(_CAR_BIT)) & part
    pole = (votes >> np.uint32(_POLE_BIT)) & part
    building = (votes >> np.uint32(_BUILDING_BIT)) & part
    vegetation = votes >> np.uint32(_VEGETATION_BIT)
    most = max(max(max(unclassified, car), max(pole, building)), vegetation)
    same = unclassified
    same = building if label == _BUILDING else same
    same = vegetation if label == _VEGETATION else same
    same = car if label == _CAR else same
    same = pole if label == _POLE else same
    if same == most:
        return label
    if unclassified == most:
        return np.uint8(_OTHER)
    if car == most:
        return np.uint8(_CAR)
    if pole == most:
        return np.uint8(_POLE)
    return np.uint8(_BUILDING) if building == most else np.uint8(_VEGETATION)


@helper
def _vote_line(
    labels: U8,
    ranges: F32,
    before: VotingLine,
    line: VotingLine,
    after: VotingLine,
    unsettled: U8,
    asking: I32,
    step: np.float32,
    half_m: np.float32,
    near_m: np.float32,
    voted: U8,
) -> None:
    """Count the votes around the unsettled shots of a line; shots vote that are near in space."""
    m = len(ranges)
    y0, z0, w0 = before
    y1, z1, w1 = line
    y2, z2, w2 = after
    n = 0
    for i in range(m):
        asking[n] = i
        n += unsettled[i]
    for k in range(n):
        i = asking[k]
        y = y1[i]
        z = z1[i]
        columns = int(
            min(
                max(half_m / (ranges[i] * step), np.float32(LEAST_COLUMNS)),
                np.float32(MOST_COLUMNS),
            )
        )
        votes = np.uint32(0)
        nothing = np.uint32(0)
        place = np.int64(max(i - columns, 0))
        last = min(i + columns + 1, m)
        stride = max(columns // VOTERS, 1)
        while place < last:
            # every vote is read, near or not, to avoid a branch
            j = np.uint64(place)
            votes_before = w0[j]
            votes_beside = w1[j]
            votes_after = w2[j]
            votes += votes_before if max(abs(y0[j] - y), abs(z0[j] - z)) < near_m else nothing
            votes += votes_beside if max(abs(y1[j] - y), abs(z1[j] - z)) < near_m else nothing
            votes += votes_after if max(abs(y2[j] - y), abs(z2[j] - z)) < near_m else nothing
            place += stride
        voted[i] = _vote(votes, labels[i])


@kernel()
def vote_labels(
    labels: U8_2,
    range_m: F32_2,
    beams: Beams,
    step: np.float32,
    half_m: np.float32,
    near_m: np.float32,
) -> U8_2:
    """Give every shot but ground and noise the label of most shots around it.

    A small thing keeps its label, and so does a shot where those four columns to both sides and in
    the adjacent lines have the same one. Noise does not vote.

    ``labels`` (lines + 2, M) uint8; ``range_m`` (lines + 2, M) float32, metres; ``beams`` (M,)
    float32; returns (lines, M) uint8.
    """
    n_lines = labels.shape[0] - 2
    m = labels.shape[1]
    voted = np.empty((n_lines, m), np.uint8)
    unsettled = np.empty(m, np.uint8)
    asking = np.empty(m + 1, np.int32)
    # ring buffers of lines
    weights = np.empty((3, m), np.uint32)
    side = np.empty((3, m), np.float32)
    height = np.empty((3, m), np.float32)
    for line in range(n_lines + 2):
        c = line % 3
        _weigh(labels[line], weights[c])
        _lay_out(range_m[line], beams, side[c], height[c])
        if line < 2:
            continue
        middle = labels[line - 1]
        row = voted[line - 2]
        row[:] = middle
        _mark_unsettled(labels[line - 2], middle, labels[line], unsettled)
        a = (line - 2) % 3
        b = (line - 1) % 3
        _vote_line(
            middle,
            range_m[line - 1],
            VotingLine(side[a], height[a], weights[a]),
            VotingLine(side[b], height[b], weights[b]),
            VotingLine(side[c], height[c], weights[c]),
            unsettled,
            asking,
            step,
            half_m,
            near_m,
            row,
        )
    return voted
