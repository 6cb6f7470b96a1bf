"""Matchers: which records of a window have the nearest key."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

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
        keys = stored.astype(np.float64)
        is_exact = (np.abs(keys) < _EXACT) & (np.floor(keys) == keys)
    return keys, is_exact


class Both(NamedTuple):
    """The same column of the left and of the right records."""

    left: NDArray[Any]
    right: NDArray[Any]


def runs(key: F64) -> tuple[I64, I64]:
    """Return the first index of every run of equal sorted keys, and the run of every key.

    >>> runs(np.array([1.0, 1.0, 3.0]))
    (array([0, 2]), array([0, 0, 1]))
    """
    is_first = np.ones(len(key), np.bool_)
    np.not_equal(key[1:], key[:-1], out=is_first[1:])
    return np.flatnonzero(is_first), np.cumsum(is_first) - 1


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

    Parameters
    ----------
    left_group, right_group : (n_left,), (n_right,) int64
        Group of every record.
    partner : (n_left_groups,) int64
        Right group of every left group; -1 = none.
    same : Both, optional
        Only members of equal ``same`` pair.
    classes : Both, optional
        Class codes.
    """
    # two groups that are partners bear the number of the left one
    paired_groups = np.flatnonzero(partner >= 0)
    number_of_left = np.full(len(partner), -1, np.int64)
    number_of_left[paired_groups] = paired_groups
    number_of_right = np.full(int(right_group.max(initial=-1)) + 1, -1, np.int64)
    number_of_right[partner[paired_groups]] = paired_groups
    left_number = number_of_left[left_group]
    right_number = number_of_right[right_group]
    left_index = np.flatnonzero(left_number >= 0)
    right_index = np.flatnonzero(right_number >= 0)
    left_number = left_number[left_index]
    right_number = right_number[right_index]
    if same is not None:
        width = 1 + max(int(same.left.max(initial=0)), int(same.right.max(initial=0)))
        left_number = left_number * width + same.left[left_index]
        right_number = right_number * width + same.right[right_index]

    # sorted by number, the members of a group are adjacent on both sides
    order = np.argsort(left_number, kind="stable")
    left_index = left_index[order]
    left_number = left_number[order]
    order = np.argsort(right_number, kind="stable")
    right_index = right_index[order]
    right_number = right_number[order]
    numbers, left_first, n_left = np.unique(left_number, return_index=True, return_counts=True)
    right_first = np.searchsorted(right_number, numbers, side="left")
    n_right = np.searchsorted(right_number, numbers, side="right") - right_first

    is_equal = n_left == n_right
    n_pairs = np.where(is_equal, n_left, 0)
    if classes is not None and not is_equal.all():
        left_alike = _alike(classes.left[left_index], left_first, n_left)
        right_alike = _alike(classes.right[right_index], right_first, n_right)
        larger_alike = np.where(n_left > n_right, left_alike, right_alike)
        n_pairs = np.where(is_equal | larger_alike, np.minimum(n_left, n_right), 0)
    n_pairs_before = np.cumsum(n_pairs) - n_pairs
    member = np.arange(n_pairs.sum()) - np.repeat(n_pairs_before, n_pairs)
    left_pair = left_index[np.repeat(left_first, n_pairs) + member]
    right_pair = right_index[np.repeat(right_first, n_pairs) + member]
    is_ambiguous = np.repeat((n_pairs == 0) & (n_right > 0), n_left)
    is_in_order = np.repeat(is_equal & (n_left > 1), n_pairs)
    counts = {"n_ambiguous": left_index[is_ambiguous], "n_in_order": left_pair[is_in_order]}
    return Match(left_pair, right_pair, counts)


def most_frequent(codes: NDArray[Any], first: I64, last: I64) -> tuple[I64, Mask]:
    """Return the first record with the most frequent code of runs, and whether codes differ.

    ``first, last`` (n,) int64, bounds of the runs, ``last`` exclusive.
    """
    # the records of every run once, however often it is asked for
    starts, run_of_query = np.unique(first, return_inverse=True)
    lengths = np.zeros(len(starts), np.int64)
    lengths[run_of_query] = last - first
    n_before = np.cumsum(lengths) - lengths
    run = np.repeat(np.arange(len(starts)), lengths)
    position = np.repeat(starts - n_before, lengths) + np.arange(len(run))

    # one row a run and code: its first position and how often it is there
    order = np.lexsort((position, codes[position], run))
    run = run[order]
    position = position[order]
    code = codes[position]
    is_new = (run[1:] != run[:-1]) | (code[1:] != code[:-1])
    rows = np.flatnonzero(np.concatenate(([True], is_new)))
    n_records = np.diff(rows, append=len(run))
    run = run[rows]
    position = position[rows]

    # the first row of every run: most records, then the lowest position
    order = np.lexsort((position, -n_records, run))
    is_new = run[order][1:] != run[order][:-1]
    top = order[np.concatenate(([True], is_new))]
    n_codes = np.bincount(run, minlength=len(starts))
    return position[top][run_of_query], (n_codes > 1)[run_of_query]


def _alike(classes: NDArray[Any], first: I64, count: I64) -> Mask:
    """Return whether all records of a run have one class; empty runs may give anything."""
    n_changes = np.zeros(len(classes) + 1, np.int64)
    if len(classes) > 1:
        np.cumsum(classes[1:] != classes[:-1], out=n_changes[1:-1])
    alike: Mask = n_changes[first + count - 1] == n_changes[first]
    return alike


SPARE_LABELS = 64
"""``spare`` of the join for :class:`NearestLabel`: how far it sees the next label of one SAME."""


def both(left: Columns, right: Columns, name: str) -> Both | None:
    """Return a column of both sides, None where one lacks it."""
    if name in left and name in right:
        return Both(left[name], right[name])
    return None


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
        left_first, left_group = runs(left[KEY])
        right_first, right_group = runs(right[KEY])
        left_keys = left[KEY][left_first]
        right_keys = right[KEY][right_first]
        partner = np.full(len(left_keys), -1, np.int64)
        if len(left_keys) and len(right_keys):
            to_right = _nearest(left_keys, right_keys)
            to_left = _nearest(right_keys, left_keys)
            is_near = np.abs(right_keys[to_right] - left_keys) <= self.tolerance
            is_mutual = to_left[to_right] == np.arange(len(left_keys))
            partner = np.where(is_near & is_mutual, to_right, -1)
        same = both(left, right, SAME)
        classes = both(left, right, CODE)
        return pair_in_order(left_group, right_group, partner, same, classes)


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
            label_keys = right[KEY][labels]
            distance[points], match = self._choose(key[points], label_keys, right[CODE][labels])
            partner[points[match.left]] = labels[match.right]
            for name, members in match.counts.items():
                counts.setdefault(name, []).append(points[members])
            if match.used is not None:
                used.append(labels[match.used])
        alone = np.flatnonzero(partner < 0)
        if len(alone) and len(right[KEY]):
            nearest_key = right[KEY][_nearest(key[alone], right[KEY])]
            is_near = np.abs(nearest_key - key[alone]) <= self.tolerance
            counts["n_other_same"] = [alone[is_near]]
        paired = np.flatnonzero(partner >= 0)
        return Match(
            left=paired + decided.start,
            right=partner[paired],
            counts={name: np.concatenate(parts) + decided.start for name, parts in counts.items()},
            used=np.concatenate(used) if used else np.empty(0, np.int64),
            distance=distance,
        )

    def _choose(self, key: F64, label_key: F64, codes: I64) -> tuple[F64, Match]:
        """Return the distance of every point to the nearest label, and the match.

        Points and labels have one :data:`SAME`.
        """
        nearest = _nearest(key, label_key)
        distance = np.abs(label_key[nearest] - key)
        paired = np.flatnonzero(distance <= self.tolerance)
        # the points of the same key as a point, and the labels of the key nearest to it
        point_bounds = _bounds(key)
        first_point = point_bounds.first[paired]
        n_points = point_bounds.last[paired] - first_point
        label_bounds = _bounds(label_key)
        first_label = label_bounds.first[nearest[paired]]
        last_label = label_bounds.last[nearest[paired]]
        n_labels = last_label - first_label

        choice = first_label.copy()
        shared = np.flatnonzero(n_labels > 1)
        counts = {"n_repeated": paired[n_points > 1], "n_shared": paired[shared]}
        if len(shared):
            frequent, differ = most_frequent(codes, first_label[shared], last_label[shared])
            as_many = (n_labels == n_points)[shared]
            in_order = first_label[shared] + (paired - first_point)[shared]
            choice[shared] = np.where(as_many, in_order, frequent)
            counts["n_in_order"] = paired[shared[as_many & differ]]
            counts["n_by_majority"] = paired[shared[~as_many & differ]]
        # every label of a key that is nearest to a point counts as used
        n_begun = np.bincount(first_label, minlength=len(label_key) + 1)
        n_ended = np.bincount(last_label, minlength=len(label_key) + 1)
        n_users = np.cumsum((n_begun - n_ended)[:-1])
        return distance, Match(paired, choice, counts, used=np.flatnonzero(n_users > 0))


class _Bounds(NamedTuple):
    """Indices of the run of equal keys of every sorted key, (n,) int64."""

    first: I64
    last: I64
    """Exclusive."""


def _bounds(key: F64) -> _Bounds:
    first, run = runs(key)
    last = np.append(first[1:], len(key))
    return _Bounds(first[run], last[run])


def _nearest(values: F64, among: F64) -> I64:
    """Return the index of the nearest of sorted numbers; of two as near, the lower."""
    above = np.clip(np.searchsorted(among, values), 0, len(among) - 1)
    below = np.maximum(above - 1, 0)
    is_below = np.abs(values - among[below]) <= np.abs(among[above] - values)
    return np.where(is_below, below, above).astype(np.int64)
