"""Pairs records of two sides by a key or by place, in one sweep over sorted streams.

Both sides come sorted by a number: the time, an id, or the coordinate along which the clouds are longest. A window
moves along it; what lies in it is paired in memory, and it holds on either side everything that has a say. So the
pairs depend neither on how the streams are cut nor on what was paired before.

Two records are a pair if each is the nearest of the other and both lie within the tolerance. A record whose own partner
was filtered away is therefore left alone, and does not take that of its neighbour. Records that cannot be told
apart (one time, one place) are paired in their order where both sides have as many of them. Otherwise, nobody knows
which of them is missing: they are left out, unless those of the side that has more are all of one class. Then it does
not matter; so it is for points that overlapping tiles hold twice.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.types import F64, I64, Mask

Columns: TypeAlias = dict[str, NDArray[Any]]
"""(n,) arrays of the same records by name."""
Pairs: TypeAlias = tuple[Columns, Columns]
"""Left and right records, the k-th of either a pair."""

_Both: TypeAlias = tuple[NDArray[Any], NDArray[Any]]

KEY = "key"
"""Column that the streams are sorted by, float64, finite."""
RETURN = "return"
"""Column that must be equal in a pair where both sides have it, int64."""
CODE = "code"
"""Class code, int64; not needed, but tells whether it matters which of several records is paired."""
AXES = ("x", "y", "z")
MAX_HELD = 1 << 23
"""Records of one side that may have a say at one place of the sweep."""
MAX_RETURN = 255
STEP_RECORDS = 1 << 17
"""Records that a sweep takes from a stream at a time: trees of more do not fit the caches."""
_USED = "used"
_TREE = {"balanced_tree": False, "compact_nodes": False}
"""Medians are slow where many points share a coordinate, as on a grid."""


class UnsortedError(Exception):
    """A stream that is not in the order of its keys; the caller sorts it and starts again.

    Parameters
    ----------
    side : int
        0 = left, 1 = right.
    """

    def __init__(self, side: int) -> None:
        super().__init__(side)
        self.side = side


@dataclass(slots=True)
class JoinTally:
    """What a sweep met, counted on the way."""

    n_pairs: int = 0
    n_right: int = 0
    """Right records in at least one pair."""
    n_ambiguous: int = 0
    """Left records that share their key or place with a different number of left and right records: left out."""
    n_in_order: int = 0
    """Pairs of records that share their key or place with others and were paired in their order."""


@dataclass(frozen=True, slots=True)
class Match:
    """Indices of pairs in a window."""

    left: I64
    right: I64
    ambiguous: I64
    """Left records left out, see :class:`JoinTally`."""
    in_order: Mask
    """(pairs,) whether a pair is one of several that share key or place."""


def in_key_order(chunks: Iterator[Columns], side: int) -> Iterator[Columns]:
    """Hand on a stream in small steps, and raise :class:`UnsortedError` where its keys go back."""
    last = -math.inf
    for chunk in chunks:
        key = chunk[KEY]
        if not len(key):
            continue
        if key[0] < last or (key[1:] < key[:-1]).any():
            raise UnsortedError(side)
        last = float(key[-1])
        for first in range(0, len(key), STEP_RECORDS):
            yield {name: values[first : first + STEP_RECORDS] for name, values in chunk.items()}


def join_by_key(
    left: Iterator[Columns], right: Iterator[Columns], tolerance: float, tally: JoinTally, names: tuple[str, str]
) -> Iterator[Pairs]:
    """Pair two streams by their key.

    Parameters
    ----------
    left, right : iterator of Columns
        With :data:`KEY`, ascending; :data:`RETURN` on both sides or on none.
    tolerance : float
        Largest difference of the keys of a pair, in their unit; 0 = equal keys.
    tally : JoinTally
        Counts; added to.
    names : (str, str)
        Files, for messages.

    Yields
    ------
    (Columns, Columns)
        Pairs, every record in one at most; by ascending left key.

    Raises
    ------
    UnsortedError
        When keys go back.
    InputError
        When too many records have (about) the same key.
    """

    def pair(one: Columns, other: Columns) -> Match:
        return match_keys(one[KEY], other[KEY], tolerance, _both(one, other, RETURN), _both(one, other, CODE))

    yield from _sweep(left, right, tolerance, pair, tally, names)


def join_by_place(
    left: Iterator[Columns],
    right: Iterator[Columns],
    tolerance: float,
    tally: JoinTally,
    names: tuple[str, str],
    *,
    one_to_one: bool = True,
) -> Iterator[Pairs]:
    """Pair two streams by nearest coordinates.

    Parameters
    ----------
    left, right : iterator of Columns
        With ``x``, ``y``, ``z`` and :data:`KEY`, one of the three again, ascending [m].
    tolerance : float
        Largest distance of a pair [m].
    tally : JoinTally
        Counts; added to.
    names : (str, str)
        Files, for messages.
    one_to_one : bool
        Whether a pair must be nearest to each other; else every left record takes its nearest right one.

    Yields
    ------
    (Columns, Columns)
        Pairs, by ascending left key.

    Raises
    ------
    UnsortedError
        When keys go back.
    InputError
        When too many records lie in a slab of four times the tolerance.
    """

    def pair(one: Columns, other: Columns) -> Match:
        classes = _both(one, other, CODE)
        return match_places(_xyz(one), _xyz(other), tolerance, classes, one_to_one=one_to_one)

    yield from _sweep(left, right, tolerance, pair, tally, names)


def match_keys(
    left: F64, right: F64, tolerance: float, returns: _Both | None = None, classes: _Both | None = None
) -> Match:
    """Pair sorted keys in memory.

    Parameters
    ----------
    left, right : (n,) float64
        Keys, ascending.
    tolerance : float
        Largest difference, in their unit.
    returns, classes : (left, right), optional
        Return numbers, which must be equal in a pair, and class codes.

    Examples
    --------
    >>> found = match_keys(np.array([1.0, 2.0, 3.0]), np.array([0.9, 2.8]), 0.5)
    >>> found.left, found.right
    (array([0, 2]), array([0, 1]))
    """
    left_value, left_group = _groups(left)
    right_value, right_group = _groups(right)
    to_right, to_left = _nearest(left_value, right_value), _nearest(right_value, left_value)
    own = np.arange(len(left_value))
    if not len(left_value) or not len(right_value):
        return _pair_groups(left_group, right_group, np.full(len(left_value), -1))
    near = np.abs(right_value[to_right] - left_value) <= tolerance
    partner = np.where(near & (to_left[to_right] == own), to_right, -1)
    return _pair_groups(left_group, right_group, partner, returns, classes)


def match_places(
    left: F64, right: F64, tolerance: float, classes: _Both | None = None, *, one_to_one: bool = True
) -> Match:
    """Pair places in memory.

    Parameters
    ----------
    left, right : (n, 3) float64
        Coordinates [m].
    tolerance : float
        Largest distance [m].
    classes : (left, right), optional
        Class codes.
    one_to_one : bool
        See :func:`join_by_place`.

    Examples
    --------
    Both left points are near the right one, which is nearer to the second:

    >>> left, right = np.array([[0.0, 0, 0], [0.1, 0, 0]]), np.array([[0.11, 0, 0]])
    >>> match_places(left, right, 0.5).left, match_places(left, right, 0.5, one_to_one=False).left
    (array([1]), array([0, 1]))
    """
    from scipy.spatial import cKDTree

    left_value, left_group = _places(left)
    right_value, right_group = _places(right)
    if not len(left_value) or not len(right_value):
        return _pair_groups(left_group, right_group, np.full(len(left_value), -1))
    # coordinates of a projection are millions of metres: the trees work beside the origin
    origin = right_value[0]
    left_value, right_value = left_value - origin, right_value - origin
    # the bound is exclusive
    bound = float(np.nextafter(tolerance, math.inf))
    _, found = cKDTree(right_value, **_TREE).query(left_value, distance_upper_bound=bound, workers=-1)
    near = found < len(right_value)
    partner = np.where(near, found, -1).astype(np.int64)
    if one_to_one:
        asked = np.unique(partner[near])
        if len(asked):
            back = np.full(len(right_value), -1)
            _, back[asked] = cKDTree(left_value, **_TREE).query(right_value[asked], workers=-1)
            own = np.arange(len(left_value))
            partner[near & (back[partner] != own)] = -1
        return _pair_groups(left_group, right_group, partner, classes=classes)
    first = np.full(len(right_value), len(right), np.int64)
    np.minimum.at(first, right_group, np.arange(len(right)))
    chosen = np.flatnonzero(partner[left_group] >= 0)
    none = np.empty(0, np.int64)
    return Match(chosen, first[partner[left_group[chosen]]], none, np.zeros(len(chosen), np.bool_))


def _pair_groups(
    left_group: I64,
    right_group: I64,
    partner: I64,
    returns: _Both | None = None,
    classes: _Both | None = None,
) -> Match:
    """Pair the members of groups that are partners, the k-th with the k-th; see the top of this module."""
    group_of_right = np.full(int(right_group.max(initial=-1)) + 1, -1, np.int64)
    paired = np.flatnonzero(partner >= 0)
    group_of_right[partner[paired]] = paired
    left_code = np.where(partner >= 0, np.arange(len(partner)), -1)[left_group] if len(partner) else left_group
    right_code = group_of_right[right_group] if len(right_group) else right_group
    left_at, right_at = np.flatnonzero(left_code >= 0), np.flatnonzero(right_code >= 0)
    left_code, right_code = left_code[left_at], right_code[right_at]
    if returns is not None:
        left_code = left_code * (MAX_RETURN + 1) + np.clip(returns[0][left_at], 0, MAX_RETURN).astype(np.int64)
        right_code = right_code * (MAX_RETURN + 1) + np.clip(returns[1][right_at], 0, MAX_RETURN).astype(np.int64)
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
    # the members of a group stand together on either side
    member = np.arange(n_pairs.sum()) - np.repeat(np.cumsum(n_pairs) - n_pairs, n_pairs)
    left_pair = left_at[np.repeat(left_first, n_pairs) + member]
    right_pair = right_at[np.repeat(right_first, n_pairs) + member]
    unclear = np.repeat((n_pairs == 0) & (right_count > 0), left_count)
    return Match(left_pair, right_pair, left_at[unclear], np.repeat(equal & (left_count > 1), n_pairs))


def _alike(classes: NDArray[Any], first: I64, count: I64) -> Mask:
    """Return for every run of records whether it is of one class."""
    changes = np.zeros(len(classes) + 1, np.int64)
    if len(classes) > 1:
        np.cumsum(classes[1:] != classes[:-1], out=changes[1:-1])
    alike: Mask = changes[np.maximum(first + count - 1, 0)] == changes[np.minimum(first, max(len(classes) - 1, 0))]
    return alike


def _groups(key: F64) -> tuple[F64, I64]:
    """Return the different values of sorted keys, and which one every key is."""
    new = np.ones(len(key), np.bool_)
    np.not_equal(key[1:], key[:-1], out=new[1:])
    return key[new], np.cumsum(new) - 1


def _places(xyz: F64) -> tuple[F64, I64]:
    """Return the different places, and which one every record is at."""
    order = np.lexsort((xyz[:, 2], xyz[:, 1], xyz[:, 0]))
    placed = xyz[order]
    new = np.ones(len(xyz), np.bool_)
    np.any(placed[1:] != placed[:-1], axis=1, out=new[1:])
    group = np.empty(len(xyz), np.int64)
    group[order] = np.cumsum(new) - 1
    return placed[new], group


def _nearest(values: F64, among: F64) -> I64:
    """Return the index of the nearest of sorted numbers; of two as near, the lower."""
    if not len(among):
        return np.full(len(values), -1, np.int64)
    above = np.clip(np.searchsorted(among, values), 0, len(among) - 1)
    below = np.maximum(above - 1, 0)
    return np.where(np.abs(values - among[below]) <= np.abs(among[above] - values), below, above).astype(np.int64)


def _both(one: Columns, other: Columns, name: str) -> _Both | None:
    return (one[name], other[name]) if name in one and name in other else None


def _xyz(columns: Columns) -> F64:
    return np.stack([np.asarray(columns[axis], np.float64) for axis in AXES], axis=1)


def _sweep(
    left: Iterator[Columns],
    right: Iterator[Columns],
    tolerance: float,
    pair: Callable[[Columns, Columns], Match],
    tally: JoinTally,
    names: tuple[str, str],
) -> Iterator[Pairs]:
    # what decides about a record lies within the tolerance of its candidates, and these within that of the record
    reach = 2.0 * tolerance * (1 + 1e-9)
    sides = (_Side(in_key_order(left, 0), names[0]), _Side(in_key_order(right, 1), names[1]))
    low = -math.inf
    while True:
        behind = min((side for side in sides if side.is_open), key=lambda side: side.last, default=None)
        if behind is not None:
            behind.read()
        limit = min((side.last for side in sides if side.is_open), default=math.inf)
        high = limit if math.isinf(limit) else float(np.nextafter(limit - reach, -math.inf)) if reach else limit
        if high <= low or not (math.isinf(limit) or _is_worth(sides, low, high)):
            continue
        one, other = (side.between(low - reach, limit) for side in sides)
        if len(one[KEY]):
            found = pair(one, other)
            key = one[KEY]
            chosen = (key[found.left] >= low) & (key[found.left] < high)
            unclear = key[found.ambiguous]
            at, to = found.left[chosen], found.right[chosen]
            tally.n_ambiguous += int(np.count_nonzero((unclear >= low) & (unclear < high)))
            tally.n_in_order += int(np.count_nonzero(found.in_order[chosen]))
            tally.n_pairs += len(at)
            used = other[_USED]
            before = int(np.count_nonzero(used))
            used[to] = True  # a view of what the side holds
            tally.n_right += int(np.count_nonzero(used)) - before
            if len(at):
                yield {name: values[at] for name, values in one.items()}, {name: v[to] for name, v in other.items()}
        if math.isinf(limit):
            return
        for side in sides:
            side.drop(high - reach)
        low = high


def _is_worth(sides: tuple[_Side, _Side], low: float, high: float) -> bool:
    """Whether a window decides at least half as many records as it has to look at.

    Where records are dense against the tolerance, small steps would look at the same ones again and again.
    """
    decided = sum(side.count(low, high) for side in sides)
    return 2 * decided >= sum(side.n_held for side in sides)


class _Side:
    """What a sweep holds of one stream."""

    def __init__(self, chunks: Iterator[Columns], name: str) -> None:
        self._chunks = chunks
        self._name = name
        self._held: Columns = {KEY: np.empty(0), _USED: np.empty(0, np.bool_)}
        self.is_open = True
        self.last = -math.inf

    def read(self) -> None:
        """Take one more chunk."""
        chunk = next(self._chunks, None)
        if chunk is None:
            self.is_open = False
            return
        self.last = float(chunk[KEY][-1])
        chunk = {**chunk, _USED: np.zeros(len(chunk[KEY]), np.bool_)}
        if len(self._held[KEY]):
            chunk = {name: np.concatenate([self._held[name], values]) for name, values in chunk.items()}
        self._held = chunk
        if len(chunk[KEY]) > MAX_HELD:
            problem = f"more than {MAX_HELD} records within the tolerance of key {chunk[KEY][0]:.9g}"
            raise InputError(self._name, problem, "give a smaller tolerance, or match by something else")

    @property
    def n_held(self) -> int:
        """Number of records held."""
        return len(self._held[KEY])

    def count(self, low: float, high: float) -> int:
        """Return the number of records with ``low <= key < high``."""
        first, stop = np.searchsorted(self._held[KEY], [low, high])
        return int(stop - first)

    def between(self, low: float, high: float) -> Columns:
        """Return views of the records with ``low <= key < high``."""
        first, stop = np.searchsorted(self._held[KEY], [low, high])
        return {name: values[first:stop] for name, values in self._held.items()}

    def drop(self, low: float) -> None:
        """Forget the records with ``key < low``."""
        first = int(np.searchsorted(self._held[KEY], low))
        if first:
            self._held = {name: values[first:] for name, values in self._held.items()}
