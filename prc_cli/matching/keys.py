"""Matchers by key: which records of a window have the nearest key.

:class:`MutualKeys` pairs records one to one, as an evaluation needs it: two records are a pair if each is the nearest
of the other. A record whose own partner was filtered away stays alone and does not take its neighbour's.
:class:`NearestLabel` gives every point the nearest label, as a transfer of labels needs it: points may share a label.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from prc_cli.core.types import F64, I64
from prc_cli.matching.join import CODE, KEY, SAME, Columns, Match
from prc_cli.matching.ties import Both, most_frequent, pair_in_order, runs

SPARE_LABELS = 64
"""``spare`` of the join for :class:`NearestLabel`: how far it sees the next label with the same :data:`SAME`."""


def both(left: Columns, right: Columns, name: str) -> Both | None:
    """Return a column of both sides, None where one lacks it."""
    return (left[name], right[name]) if name in left and name in right else None


@dataclass(frozen=True, slots=True)
class MutualKeys:
    """Pairs of records that are nearest to each other.

    The nearest is found by the key alone; of two as near, the lower. Records of one key are paired as
    :func:`prc_cli.matching.ties.pair_in_order` says, those with equal :data:`SAME` where both sides have it.

    >>> left, right = {KEY: np.array([1.0, 2.0, 3.0])}, {KEY: np.array([0.9, 2.8])}
    >>> found = MutualKeys(0.5)(left, right, slice(0, 3))
    >>> found.left, found.right
    (array([0, 2]), array([0, 1]))
    """

    tolerance: float
    """Largest difference of the keys, in their unit."""

    def __call__(self, left: Columns, right: Columns, decided: slice) -> Match:
        """Pair the records of a window."""
        (left_first, left_group), (right_first, right_group) = runs(left[KEY]), runs(right[KEY])
        left_value, right_value = left[KEY][left_first], right[KEY][right_first]
        partner = np.full(len(left_value), -1, np.int64)
        if len(left_value) and len(right_value):
            to_right, to_left = _nearest(left_value, right_value), _nearest(right_value, left_value)
            near = np.abs(right_value[to_right] - left_value) <= self.tolerance
            partner = np.where(near & (to_left[to_right] == np.arange(len(left_value))), to_right, -1)
        return pair_in_order(left_group, right_group, partner, both(left, right, SAME), both(left, right, CODE))


@dataclass(frozen=True, slots=True)
class NearestLabel:
    """The label (right) of every point (left): the one with the nearest key of those with equal :data:`SAME`.

    Of labels as near, the one with the smaller key is taken. If several labels share the key, the points of that key
    pair with them in record order where they are as many; else they all get the label with the most frequent code, of
    equally frequent ones the first in record order.
    """

    tolerance: float
    """Largest difference of the keys, in their unit."""

    def __call__(self, left: Columns, right: Columns, decided: slice) -> Match:
        """Choose the labels of the decided points."""
        key, same = left[KEY][decided], left[SAME][decided]
        partner, distance = np.full(len(key), -1, np.int64), np.full(len(key), np.inf)
        counts: dict[str, list[I64]] = {}
        used: list[I64] = []
        # mostly all records are first returns
        sames = np.unique(same) if same.min() != same.max() else same[:1]
        for value in sames.tolist():
            points, labels = np.flatnonzero(same == value), np.flatnonzero(right[SAME] == value)
            if not len(labels):
                continue
            distance[points], found = self._choose(key[points], right[KEY][labels], right[CODE][labels])
            partner[points[found.left]] = labels[found.right]
            for name, members in found.counts.items():
                counts.setdefault(name, []).append(points[members])
            if found.used is not None:
                used.append(labels[found.used])
        alone = np.flatnonzero(partner < 0)
        if len(alone) and len(right[KEY]):
            apart = np.abs(right[KEY][_nearest(key[alone], right[KEY])] - key[alone])
            counts["n_other_same"] = [alone[apart <= self.tolerance]]
        at = np.flatnonzero(partner >= 0)
        shifted = {name: np.concatenate(members) + decided.start for name, members in counts.items()}
        partners = np.concatenate(used) if used else np.empty(0, np.int64)
        return Match(at + decided.start, partner[at], shifted, partners, distance)

    def _choose(self, key: F64, there: F64, codes: I64) -> tuple[F64, Match]:
        """Return the distance to the nearest label, and the match, of points and labels with one ``SAME``."""
        near = _nearest(key, there)
        distance = np.abs(there[near] - key)
        found = np.flatnonzero(distance <= self.tolerance)
        start, stop = (bound[found] for bound in _bounds(key))
        first, last = (bound[near[found]] for bound in _bounds(there))
        size, ordinal = stop - start, found - start
        choice = first.copy()
        shared = np.flatnonzero(last - first > 1)
        counts = {"n_repeated": found[size > 1], "n_shared": found[shared]}
        if len(shared):
            winner, differ = most_frequent(codes, first[shared], last[shared])
            pairs = (last - first == size)[shared]
            choice[shared] = np.where(pairs, first[shared] + ordinal[shared], winner)
            counts["n_in_order"] = found[shared[pairs & differ]]
            counts["n_by_majority"] = found[shared[~pairs & differ]]
        # every label of a key that a point found counts as used
        marks = np.bincount(first, minlength=len(there) + 1) - np.bincount(last, minlength=len(there) + 1)
        return distance, Match(found, choice, counts, np.flatnonzero(np.cumsum(marks[:-1]) > 0))


def _bounds(key: F64) -> tuple[I64, I64]:
    """Return, for every one of sorted keys, where the run of its equals begins and where it ends."""
    first, group = runs(key)
    return first[group], np.append(first[1:], len(key))[group]


def _nearest(values: F64, among: F64) -> I64:
    """Return the index of the nearest of sorted numbers, at least one; of two as near, the lower."""
    above = np.clip(np.searchsorted(among, values), 0, len(among) - 1)
    below = np.maximum(above - 1, 0)
    return np.where(np.abs(values - among[below]) <= np.abs(among[above] - values), below, above).astype(np.int64)
