"""Slow and simple twin of :mod:`prc_cli.methods.fused.votes_loops`."""

from __future__ import annotations

import numpy as np

from prc_cli.core.types import F32, U8
from prc_cli.methods.fused.records import Beams

MISSING, OTHER, NOISE, GROUND, BUILDING, VEGETATION = range(6)
CAR = 7
POLE = 11


def _points(range_m: F32, beams: Beams) -> tuple[F32, F32]:
    """Turn ranges into points of the scan plane."""
    return range_m * beams[0], -(range_m * beams[1])


def vote_labels(
    labels: U8,
    range_m: F32,
    beams: Beams,
    step: np.float32,
    half_m: np.float32,
    near_m: np.float32,
) -> U8:
    """Let the shots around vote; see :func:`prc_cli.methods.fused.votes_loops.vote_labels`."""
    voted = labels[1:-1].copy()
    m = labels.shape[1]
    for row, i in zip(*np.nonzero(~np.isin(voted, (MISSING, OTHER, NOISE, GROUND))), strict=True):
        line = row + 1
        centre = labels[row + 1, i]
        asked = (line - 1, i), (line + 1, i), (line, max(i - 4, 0)), (line, min(i + 4, m - 1))
        if all(labels[place] in (centre, MISSING, NOISE) for place in asked):
            continue
        columns = min(max(int(half_m / (range_m[line, i] * step)), 2), 60)
        place = (
            slice(line - 1, line + 2),
            slice(max(i - columns, 0), i + columns + 1, max(columns // 4, 1)),
        )
        close = np.ones(labels[place].shape, bool)
        for image in _points(range_m, beams):
            close &= np.abs(image[place] - image[line, i]) < near_m
        votes = {
            label: int((labels[place][close] == label).sum())
            for label in (OTHER, CAR, POLE, BUILDING, VEGETATION)
        }
        if votes[centre] < max(votes.values()):
            voted[row, i] = max(votes, key=lambda label: votes[label])
    return voted
