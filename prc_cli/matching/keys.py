"""Matchers: which records of a window have the nearest key."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64, I64, Mask
from prc_cli.matching.join import CODE, KEY, SAME, Columns, Match

AXES = ("x", "y", "z")
_EXACT = float(1 << 53)
"""Whole numbers below are exact in float64."""


@dataclass(frozen=True, slots=True)
class KeyRule:
    """The key by which a record is matched."""

    kind: str
    """``time``, ``dimension``, ``cell`` (scan line and column), ``record`` (index in the input),
    ``rank`` (index among the records with a class) or ``place`` (coordinates)."""
    dimension: str = "time"
    """Dimension that holds the key; of a place, the axis that records are sorted by."""
    same: tuple[str, ...] = ()
    """Integer dimensions (0 to 65535) that must be equal beside the key, such as ``return_number``.

    At most three.
    """
    offset: float = 0.0
    """Added to the key [s for times]."""

    @property
    def key_names(self) -> tuple[str, ...]:
        """Dimensions that hold the key."""
        if self.kind == "place":
            return AXES
        return (self.dimension,) if self.kind in ("time", "dimension") else ()

    @property
    def names(self) -> tuple[str, ...]:
        """Dimensions that the rule reads."""
        return (*self.key_names, *self.same)


def exact_keys(stored: NDArray[Any]) -> tuple[F64, Mask]:
    """Return ids (n,) as float64, and which of them are whole numbers that it holds exactly.

    >>> exact_keys(np.array([7.0, 0.5, np.nan]))[1]
    array([ True, False, False])
    """
    with np.errstate(invalid="ignore"):
        key = stored.astype(np.float64)
        return key, (np.abs(key) < _EXACT) & (np.floor(key) == key)


Both: TypeAlias = tuple[NDArray[Any], NDArray[Any]]
"""The same column of the left and of the right records."""


def runs(key: F64) -> tuple[I64, I64]:
    """Return the first index of every run of equal sorted keys, and the run of every key.

    >>> runs(np.array([1.0, 1.0, 3.0]))
    (array([0, 2]), array([0, 0, 1]))
    """
    new = np.ones(len(key), np.bool_)
    np.not_equal(key[1:], key[:-1], out=new[1:])
    return np.flatnonzero(new), np.cumsum(new) - 1


def pair_in_order(
    left_group: I64,
    right_group: I64,
    partner: I64,
    same: Both | None = None,
    classes: Both | None = None,
) -> Match:
    """Pair the members of groups that are partners, the k-th of one with the k-th of the other.

    If one side has more members, it is unknown which of them the other side lacks. They are left
    out, unless all members of the larger side have one class: then the choice makes no difference.
    """
    group_of_right = np.full(int(right_group.max(initial=-1)) + 1, -1, np.int64)
    paired = np.flatnonzero(partner >= 0)
    group_of_right[partner[paired]] = paired
    left_code = (
        np.where(partner >= 0, np.arange(len(partner)), -1)[left_group]
        if len(partner)
        else left_group
    )
    right_code = group_of_right[right_group] if len(right_group) else right_group
    left_at = np.flatnonzero(left_code >= 0)
    right_at = np.flatnonzero(right_code >= 0)
    left_code = left_code[left_at]
    right_code = right_code[right_at]
    if same is not None:
        width = 1 + max(int(column.max(initial=0)) for column in same)
        left_code = left_code * width + same[0][left_at]
        right_code = right_code * width + same[1][right_at]
    order = np.argsort(left_code, kind="stable")
    left_at = left_at[order]
    left_code = left_code[order]
    order = np.argsort(right_code, kind="stable")
    right_at = right_at[order]
    right_code = right_code[order]
    codes, left_first, left_count = np.unique(left_code, return_index=True, return_counts=True)
    right_first = np.searchsorted(right_code, codes, side="left")
    right_count = np.searchsorted(right_code, codes, side="right") - right_first
    equal = left_count == right_count
    n_pairs = np.where(equal, left_count, 0)
    if classes is not None and not equal.all():
        left_alike = _alike(classes[0][left_at], left_first, left_count)
        right_alike = _alike(classes[1][right_at], right_first, right_count)
        clear = np.where(left_count > right_count, left_alike, right_alike)
        n_pairs = np.where(equal | clear, np.minimum(left_count, right_count), 0)
    # the members of a group are adjacent on both sides
    member = np.arange(n_pairs.sum()) - np.repeat(np.cumsum(n_pairs) - n_pairs, n_pairs)
    left_pair = left_at[np.repeat(left_first, n_pairs) + member]
    right_pair = right_at[np.repeat(right_first, n_pairs) + member]
    unclear = np.repeat((n_pairs == 0) & (right_count > 0), left_count)
    in_order = np.repeat(equal & (left_count > 1), n_pairs)
    return Match(
        left_pair, right_pair, {"n_ambiguous": left_at[unclear], "n_in_order": left_pair[in_order]}
    )


def most_frequent(codes: NDArray[Any], first: I64, last: I64) -> tuple[I64, Mask]:
    """Return the first record with the most frequent code of runs, and whether codes differ.

    ``first, last`` (n,) int64, bounds of the runs, ``last`` exclusive.
    """
    starts, group = np.unique(first, return_inverse=True)
    lengths = np.zeros(len(starts), np.int64)
    lengths[group] = last - first
    run = np.repeat(np.arange(len(starts)), lengths)
    position = np.repeat(
        starts - np.concatenate(([0], np.cumsum(lengths)[:-1])), lengths
    ) + np.arange(len(run))
    # one row a run and code: its first position and how often it is there
    order = np.lexsort((position, codes[position], run))
    run = run[order]
    position = position[order]
    code = codes[position]
    new = np.flatnonzero(np.concatenate(([True], (run[1:] != run[:-1]) | (code[1:] != code[:-1]))))
    count = np.diff(new, append=len(run))
    run = run[new]
    position = position[new]
    best = np.lexsort((position, -count, run))
    top = best[np.concatenate(([True], run[best][1:] != run[best][:-1]))]
    return position[top][group], (np.bincount(run, minlength=len(starts)) > 1)[group]


def _alike(classes: NDArray[Any], first: I64, count: I64) -> Mask:
    """Whether every run of records is of one class; empty runs may give anything."""
    changes = np.zeros(len(classes) + 1, np.int64)
    if len(classes) > 1:
        np.cumsum(classes[1:] != classes[:-1], out=changes[1:-1])
    alike: Mask = changes[first + count - 1] == changes[first]
    return alike


SPARE_LABELS = 64
"""``spare`` of the join for :class:`NearestLabel`: how far it sees the next label of one SAME."""


def both(left: Columns, right: Columns, name: str) -> Both | None:
    """Return a column of both sides, None where one lacks it."""
    return (left[name], right[name]) if name in left and name in right else None


@dataclass(frozen=True, slots=True)
class MutualKeys:
    """Pairs of records that are nearest to each other.

    Only the key decides which record is nearest; of two as near, the lower one. Records of one key
    are paired by :func:`pair_in_order`, with equal :data:`SAME` if both sides have it.

    >>> left, right = {KEY: np.array([1.0, 2.0, 3.0])}, {KEY: np.array([0.9, 2.8])}
    >>> match = MutualKeys(0.5)(left, right, slice(0, 3))
    >>> match.left, match.right
    (array([0, 2]), array([0, 1]))
    """

    tolerance: float
    """Largest difference of the keys, in their unit."""

    def __call__(self, left: Columns, right: Columns, decided: slice) -> Match:
        """Pair the records of a window."""
        (left_first, left_group) = runs(left[KEY])
        (right_first, right_group) = runs(right[KEY])
        left_value = left[KEY][left_first]
        right_value = right[KEY][right_first]
        partner = np.full(len(left_value), -1, np.int64)
        if len(left_value) and len(right_value):
            to_right = _nearest(left_value, right_value)
            to_left = _nearest(right_value, left_value)
            near = np.abs(right_value[to_right] - left_value) <= self.tolerance
            partner = np.where(
                near & (to_left[to_right] == np.arange(len(left_value))), to_right, -1
            )
        return pair_in_order(
            left_group, right_group, partner, both(left, right, SAME), both(left, right, CODE)
        )


@dataclass(frozen=True, slots=True)
class NearestLabel:
    """The label (right) of every point (left): the nearest key among those with equal :data:`SAME`.

    Of labels as near, the one with the smaller key is used. If several labels share the key and are
    as many as the points of that key, they pair in record order. If not, all points get the label
    with the most frequent code, of equally frequent ones the first in record order.
    """

    tolerance: float
    """Largest difference of the keys, in their unit."""

    def __call__(self, left: Columns, right: Columns, decided: slice) -> Match:
        """Choose the labels of the decided points."""
        key = left[KEY][decided]
        same = left[SAME][decided]
        partner = np.full(len(key), -1, np.int64)
        distance = np.full(len(key), np.inf)
        counts: dict[str, list[I64]] = {}
        used: list[I64] = []
        # mostly all records are first returns
        sames = np.unique(same) if same.min() != same.max() else same[:1]
        for value in sames.tolist():
            points = np.flatnonzero(same == value)
            labels = np.flatnonzero(right[SAME] == value)
            if not len(labels):
                continue
            distance[points], match = self._choose(
                key[points], right[KEY][labels], right[CODE][labels]
            )
            partner[points[match.left]] = labels[match.right]
            for name, members in match.counts.items():
                counts.setdefault(name, []).append(points[members])
            if match.used is not None:
                used.append(labels[match.used])
        alone = np.flatnonzero(partner < 0)
        if len(alone) and len(right[KEY]):
            apart = np.abs(right[KEY][_nearest(key[alone], right[KEY])] - key[alone])
            counts["n_other_same"] = [alone[apart <= self.tolerance]]
        paired = np.flatnonzero(partner >= 0)
        shifted = {
            name: np.concatenate(members) + decided.start for name, members in counts.items()
        }
        partners = np.concatenate(used) if used else np.empty(0, np.int64)
        return Match(paired + decided.start, partner[paired], shifted, partners, distance)

    def _choose(self, key: F64, label_key: F64, codes: I64) -> tuple[F64, Match]:
        """Return the distance of every point to the nearest label, and the match.

        Points and labels have one :data:`SAME`.
        """
        near = _nearest(key, label_key)
        distance = np.abs(label_key[near] - key)
        paired = np.flatnonzero(distance <= self.tolerance)
        start, stop = (bound[paired] for bound in _bounds(key))
        first, last = (bound[near[paired]] for bound in _bounds(label_key))
        size = stop - start
        ordinal = paired - start
        choice = first.copy()
        shared = np.flatnonzero(last - first > 1)
        counts = {"n_repeated": paired[size > 1], "n_shared": paired[shared]}
        if len(shared):
            winner, differ = most_frequent(codes, first[shared], last[shared])
            pairs = (last - first == size)[shared]
            choice[shared] = np.where(pairs, first[shared] + ordinal[shared], winner)
            counts["n_in_order"] = paired[shared[pairs & differ]]
            counts["n_by_majority"] = paired[shared[~pairs & differ]]
        # every label of a key that a point found counts as used
        marks = np.bincount(first, minlength=len(label_key) + 1) - np.bincount(
            last, minlength=len(label_key) + 1
        )
        return distance, Match(paired, choice, counts, np.flatnonzero(np.cumsum(marks[:-1]) > 0))


def _bounds(key: F64) -> tuple[I64, I64]:
    """Return first and last (exclusive) index of the run of equal keys of every sorted key."""
    first, group = runs(key)
    return first[group], np.append(first[1:], len(key))[group]


def _nearest(values: F64, among: F64) -> I64:
    """Return the index of the nearest of sorted numbers; of two as near, the lower."""
    above = np.clip(np.searchsorted(among, values), 0, len(among) - 1)
    below = np.maximum(above - 1, 0)
    return np.where(
        np.abs(values - among[below]) <= np.abs(among[above] - values), below, above
    ).astype(np.int64)
