"""Loops of the fused classifier that let the shots around vote on every label."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import Label
from prc_cli.core.loops import helper, inlined, loop
from prc_cli.core.types import F32, F32_2, I32, U8, U8_2
from prc_cli.methods.fused.lists_loops import list_few
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


@inlined
def _differs(label: np.uint8, label_of_shot: np.uint8) -> bool:
    """Whether a neighbour's label differs from a shot's; missing and noise are no labels."""
    return bool((label != label_of_shot) & (label != _MISSING) & (label != _NOISE))


@helper
def _mark_unsettled(
    before: U8,
    labels: U8,
    after: U8,
    unsettled: U8,
) -> None:
    """Mark the shots of a line that may have to change their label.

    Their label differs from that of a shot a few columns away, or of an adjacent line.
    """
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


@inlined
def _winner(votes: np.uint32, label: np.uint8) -> np.uint8:
    """Return the label with most votes; if several have as many, the shot's label wins."""
    part = np.uint32((1 << _CAR_BIT) - 1)
    unclassified = votes & part
    car = (votes >> np.uint32(_CAR_BIT)) & part
    pole = (votes >> np.uint32(_POLE_BIT)) & part
    building = (votes >> np.uint32(_BUILDING_BIT)) & part
    vegetation = votes >> np.uint32(_VEGETATION_BIT)
    most = max(max(max(unclassified, car), max(pole, building)), vegetation)
    for_label = unclassified
    for_label = building if label == _BUILDING else for_label
    for_label = vegetation if label == _VEGETATION else for_label
    for_label = car if label == _CAR else for_label
    for_label = pole if label == _POLE else for_label
    if for_label == most:
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
    shots: I32,
    step: np.float32,
    half_m: np.float32,
    near_m: np.float32,
    voted: U8,
) -> None:
    """Count the votes of the shots that are near in space to the unsettled shots of a line."""
    m = len(ranges)
    y0, z0, w0 = before
    y1, z1, w1 = line
    y2, z2, w2 = after
    for k in range(list_few(unsettled, shots)):
        i = shots[k]
        y = y1[i]
        z = z1[i]
        half_width = max(half_m / (ranges[i] * step), np.float32(LEAST_COLUMNS))
        columns = int(min(half_width, np.float32(MOST_COLUMNS)))
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
        voted[i] = _winner(votes, labels[i])


@loop()
def vote_labels(
    labels: U8_2,
    range_m: F32_2,
    beams: Beams,
    step: np.float32,
    half_m: np.float32,
    near_m: np.float32,
) -> U8_2:
    """Give every shot the label of most shots around it; noise does not vote.

    Ground, noise and unclassified shots keep their labels, and so do shots with the same label as
    those four columns to both sides and in the adjacent lines.

    ``labels`` (lines + 2, M) uint8; ``range_m`` (lines + 2, M) float32, metres; ``beams`` (M,)
    float32; returns (lines, M) uint8.
    """
    n_lines = labels.shape[0] - 2
    m = labels.shape[1]
    voted = np.empty((n_lines, m), np.uint8)
    unsettled = np.empty(m, np.uint8)
    shots = np.empty(m + 1, np.int32)
    # ring buffers of lines
    votes = np.empty((3, m), np.uint32)
    side = np.empty((3, m), np.float32)
    height = np.empty((3, m), np.float32)
    for line in range(n_lines + 2):
        c = line % 3
        for i in range(m):
            side[c, i] = range_m[line, i] * beams.sine[i]
        for i in range(m):
            height[c, i] = -(range_m[line, i] * beams.cosine[i])
        # each of the five labels has its own part of the word
        for i in range(m):
            label = labels[line, i]
            building = np.uint32(1 << _BUILDING_BIT) if label == _BUILDING else np.uint32(0)
            vegetation = np.uint32(1 << _VEGETATION_BIT) if label == _VEGETATION else np.uint32(0)
            car = np.uint32(1 << _CAR_BIT) if label == _CAR else np.uint32(0)
            pole = np.uint32(1 << _POLE_BIT) if label == _POLE else np.uint32(0)
            votes[c, i] = building | vegetation | car | pole | np.uint32(label == _OTHER)
        if line < 2:
            continue
        middle = labels[line - 1]
        row = voted[line - 2]
        for i in range(m):
            row[i] = middle[i]
        _mark_unsettled(labels[line - 2], middle, labels[line], unsettled)
        a = (line - 2) % 3
        b = (line - 1) % 3
        _vote_line(
            middle,
            range_m[line - 1],
            VotingLine(side[a], height[a], votes[a]),
            VotingLine(side[b], height[b], votes[b]),
            VotingLine(side[c], height[c], votes[c]),
            unsettled,
            shots,
            step,
            half_m,
            near_m,
            row,
        )
    return voted
