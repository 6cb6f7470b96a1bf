"""Pairs among records that share a key or a place."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.types import F64, I64, Mask
from prc_cli.matching.join import Match

Both: TypeAlias = tuple[NDArray[Any], NDArray[Any]]
"""The same column of the left and of the right records."""


def runs(key: F64) -> tuple[I64, I64]:
    """Return where the runs of equal sorted keys begin, and the number of the run that every key lies in.

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

    If one side has more members, it is unknown which of them the other side lacks. They are left out, unless all
    members of the larger side have one class: then the choice makes no difference.
    """
    group_of_right = np.full(int(right_group.max(initial=-1)) + 1, -1, np.int64)
    paired = np.flatnonzero(partner >= 0)
    group_of_right[partner[paired]] = paired
    left_code = np.where(partner >= 0, np.arange(len(partner)), -1)[left_group] if len(partner) else left_group
    right_code = group_of_right[right_group] if len(right_group) else right_group
    left_at, right_at = np.flatnonzero(left_code >= 0), np.flatnonzero(right_code >= 0)
    left_code, right_code = left_code[left_at], right_code[right_at]
    if same is not None:
        width = 1 + max(int(column.max(initial=0)) for column in same)
        left_code = left_code * width + same[0][left_at]
        right_code = right_code * width + same[1][right_at]
    order = np.argsort(left_code, kind="stable")
    left_at, left_code = left_at[order], left_code[order]
    order = np.argsort(right_code, kind="stable")
    right_at, right_code = right_at[order], right_code[order]
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
    return Match(left_pair, right_pair, {"n_ambiguous": left_at[unclear], "n_in_order": left_pair[in_order]})


def most_frequent(codes: NDArray[Any], first: I64, last: I64) -> tuple[I64, Mask]:
    """Return, for runs of records, the first one with the most frequent code, and whether codes differ."""
    starts, group = np.unique(first, return_inverse=True)
    lengths = np.zeros(len(starts), np.int64)
    lengths[group] = last - first
    run = np.repeat(np.arange(len(starts)), lengths)
    position = np.repeat(starts - np.concatenate(([0], np.cumsum(lengths)[:-1])), lengths) + np.arange(len(run))
    # one row a run and code: its first position and how often it is there
    order = np.lexsort((position, codes[position], run))
    run, position = run[order], position[order]
    code = codes[position]
    new = np.flatnonzero(np.concatenate(([True], (run[1:] != run[:-1]) | (code[1:] != code[:-1]))))
    count = np.diff(new, append=len(run))
    run, position = run[new], position[new]
    best = np.lexsort((position, -count, run))
    top = best[np.concatenate(([True], run[best][1:] != run[best][:-1]))]
    return position[top][group], (np.bincount(run, minlength=len(starts)) > 1)[group]


def _alike(classes: NDArray[Any], first: I64, count: I64) -> Mask:
    """Return for every run of records whether it is of one class."""
    changes = np.zeros(len(classes) + 1, np.int64)
    if len(classes) > 1:
        np.cumsum(classes[1:] != classes[:-1], out=changes[1:-1])
    alike: Mask = changes[np.maximum(first + count - 1, 0)] == changes[np.minimum(first, max(len(classes) - 1, 0))]
    return alike
