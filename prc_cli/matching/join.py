"""A merge join: which record of one side belongs to which of the other, both sorted by their keys.

Every *point* gets the *label* record with the nearest key within a tolerance that is equal in ``same`` (return number,
scanner). Both sides are streams; what is held are their current chunks and what the tolerance spans.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.types import F64, I64, Mask
from prc_cli.formats.records import RecordChunk
from prc_cli.matching.keyed_source import CODE, KEY, SAME

HELD_RECORDS = 1 << 22
"""Most records of a side that are held; more share a key, or lie within the tolerance, than can be told apart."""
DECADES = np.arange(-9, 7)
"""Exponents of ten by which the distances of points without partner are counted."""


@dataclass(slots=True)
class JoinTally:
    """What a join met; counts are of points (the registered side) unless they say labels."""

    n_points: int = 0
    n_matched: int = 0
    n_labels_matched: int = 0
    """Label records with at least one partner."""
    n_repeated: int = 0
    """Matched points whose key another point has too (tiles that overlap)."""
    n_shared: int = 0
    """Matched points whose key several label records have (coarse time stamps)."""
    n_in_order: int = 0
    """Of these, points that were paired in record order, being as many as the labels, where the labels differ."""
    n_by_majority: int = 0
    """Of these, points that got the most frequent label, where the labels differ."""
    n_other_return: int = 0
    """Points without partner whose key has a label of another return or scanner."""
    n_changed: int = 0
    """Points whose class became another one."""
    largest: float = 0.0
    """Largest distance of a matched point to its label."""
    distances: I64 = field(default_factory=lambda: np.zeros(len(DECADES) + 1, np.int64))
    """(17,) int64, points without partner by the distance to the nearest label: up to 10^-9, 10^-8, ... and beyond."""

    def near(self, share: float = 0.5) -> float | None:
        """Return the power of ten within which ``share`` of the points without partner have a label; None if none."""
        total = int(self.distances.sum())
        reached = np.flatnonzero(np.cumsum(self.distances[:-1]) >= share * total)
        return float(10.0 ** DECADES[reached[0]]) if total and len(reached) else None


@dataclass(frozen=True, slots=True)
class Joined:
    """Points and what they get."""

    record: I64
    """(n,) record index of the points."""
    matched: Mask
    """(n,) whether the point has a partner."""
    codes: NDArray[np.uint8]
    """(n,) class of the partner, or the point's own."""
    values: dict[str, NDArray[Any]]
    """(k,) arrays of the carried dimensions, of the points with a partner."""


class _Window:
    """The part of a sorted stream that is held."""

    def __init__(self, chunks: Iterator[RecordChunk], names: tuple[str, ...], path: str) -> None:
        self._chunks = chunks
        self._path = path
        self.ended = False
        self.values: dict[str, NDArray[Any]] = {name: np.empty(0) for name in names}
        self.record: I64 = np.empty(0, np.int64)
        self.used: Mask = np.empty(0, np.bool_)

    def __len__(self) -> int:
        return len(self.record)

    @property
    def key(self) -> F64:
        return self.values[KEY]

    def fetch(self) -> None:
        """Add a chunk, or learn that there is none."""
        if len(self) > HELD_RECORDS:
            problem = f"more than {HELD_RECORDS:,} records from {self.key[0]} to {self.key[-1]} cannot be told apart"
            raise InputError(self._path, problem, "give a smaller --tolerance, or match by something else with --by")
        chunk = next((item for item in self._chunks if item.n), None)
        if chunk is None:
            self.ended = True
            return
        assert chunk.record is not None
        if len(self):
            self.values = {name: np.concatenate([held, chunk.values[name]]) for name, held in self.values.items()}
            self.record = np.concatenate([self.record, chunk.record])
            self.used = np.concatenate([self.used, np.zeros(chunk.n, np.bool_)])
        else:
            self.values = {name: chunk.values[name] for name in self.values}
            self.record, self.used = chunk.record, np.zeros(chunk.n, np.bool_)

    def drop(self, n: int) -> int:
        """Forget the first ``n`` records; return how many of them were used."""
        used = int(np.count_nonzero(self.used[:n]))
        self.values = {name: held[n:] for name, held in self.values.items()}
        self.record, self.used = self.record[n:], self.used[n:]
        return used


def join(
    labels: Iterator[RecordChunk],
    points: Iterator[RecordChunk],
    tally: JoinTally,
    *,
    tolerance: float = 0.0,
    carried: tuple[str, ...] = (),
    paths: tuple[str, str] = ("labels", "points"),
) -> Iterator[Joined]:
    """Match two streams that are sorted by key.

    Of labels at the same distance the one with the smaller key is taken. Where several labels share the key: points of
    that key pair with them in record order if they are as many, else they all get the most frequent code of them (of
    equally frequent ones the first in record order). The result does not depend on how the streams are chunked.

    Parameters
    ----------
    labels, points : iterator of RecordChunk
        From :func:`prc_cli.matching.keyed_source.in_key_order`; ``labels`` with the dimensions ``carried``.
    tally : JoinTally
        Filled on the way; complete when the iterator has ended.
    tolerance : float
        Largest difference of keys, in their unit.
    paths : (str, str)
        File names, for messages.

    Yields
    ------
    Joined
        Every point once, by ascending key.

    Raises
    ------
    InputError
        When so many records share a key, or lie within the tolerance, that they would not fit into memory.
    """
    left = _Window(labels, (KEY, SAME, CODE, *carried), paths[0])
    right = _Window(points, (KEY, SAME, CODE), paths[1])
    while True:
        if not len(right):
            right.fetch()
            if right.ended:
                break
        if not len(left) and not left.ended:
            left.fetch()
        # a point is decided when all labels within reach are here, and all points of its key
        known = np.inf if left.ended else float(left.key[-1]) - 2 * tolerance
        whole = np.inf if right.ended else float(right.key[-1])
        n = int(np.searchsorted(right.key, min(known, whole), side="left"))
        if n:
            yield _match(left, right, n, tolerance, tally, carried)
            right.drop(n)
        if len(right):
            # one label before stays: it may be the nearest
            reach = int(np.searchsorted(left.key, right.key[0] - 2 * tolerance, side="left"))
            tally.n_labels_matched += left.drop(max(reach - 1, 0))
            if n == 0:
                (left if known <= whole else right).fetch()
    tally.n_labels_matched += left.drop(len(left))


def _match(
    left: _Window, right: _Window, n: int, tolerance: float, tally: JoinTally, carried: tuple[str, ...]
) -> Joined:
    """Decide the first ``n`` points."""
    key, same, codes = right.key[:n], right.values[SAME][:n], right.values[CODE][:n].copy()
    partner = np.full(n, -1, np.int64)
    distance = np.full(n, np.inf)
    # mostly everything is a first return
    sames = np.unique(same) if len(same) and same.min() != same.max() else same[:1]
    for value in sames.tolist():
        mine = np.flatnonzero(same == value)
        theirs = np.flatnonzero(left.values[SAME] == value)
        if len(theirs):
            partner[mine], distance[mine] = _nearest(left, theirs, key[mine], tolerance, tally)
    matched = partner >= 0
    chosen = partner[matched]
    codes[matched] = left.values[CODE][chosen]
    tally.n_points += n
    tally.n_matched += len(chosen)
    if len(chosen):
        tally.largest = max(tally.largest, float(distance[matched].max()))
    tally.n_changed += int(np.count_nonzero(codes != right.values[CODE][:n]))
    if len(chosen) < n:
        _count_unmatched(left, key[~matched], distance[~matched], tolerance, tally)
    values = {name: left.values[name][chosen] for name in carried}
    return Joined(right.record[:n], matched, codes, values)


def _nearest(left: _Window, theirs: I64, key: F64, tolerance: float, tally: JoinTally) -> tuple[I64, F64]:
    """Return the label (index in the window, -1 = none) and the distance of points of one ``same``, sorted by key."""
    there = left.key[theirs]
    above = np.searchsorted(there, key, side="left")
    after, before = np.minimum(above, len(there) - 1), np.maximum(above - 1, 0)
    to_after, to_before = np.abs(there[after] - key), np.abs(there[before] - key)
    near = np.where(to_before <= to_after, before, after)
    distance = np.minimum(to_before, to_after)
    found = np.flatnonzero(distance <= tolerance)
    partner = np.full(len(key), -1, np.int64)
    if not len(found):
        return partner, distance
    first, last = (bound[near[found]] for bound in _runs(there))
    marks = np.bincount(first, minlength=len(there) + 1) - np.bincount(last, minlength=len(there) + 1)
    left.used[theirs[np.cumsum(marks[:-1]) > 0]] = True
    start, stop = (bound[found] for bound in _runs(key))
    size, ordinal = stop - start, found - start
    tally.n_repeated += int(np.count_nonzero(size > 1))
    choice = first.copy()
    shared = last - first > 1
    if shared.any():
        tally.n_shared += int(np.count_nonzero(shared))
        at = np.flatnonzero(shared)
        winner, differ = _majority(left.values[CODE][theirs], first[at], last[at])
        pairs = (last - first == size)[at]
        choice[at] = np.where(pairs, first[at] + ordinal[at], winner)
        tally.n_in_order += int(np.count_nonzero(pairs & differ))
        tally.n_by_majority += int(np.count_nonzero(~pairs & differ))
    partner[found] = theirs[choice]
    return partner, distance


def _runs(key: F64) -> tuple[I64, I64]:
    """Return, for every element of sorted keys, where the run of its equals begins and where it ends."""
    start = np.flatnonzero(np.concatenate(([True], key[1:] != key[:-1])))
    stop = np.append(start[1:], len(key))
    sizes = stop - start
    return np.repeat(start, sizes), np.repeat(stop, sizes)


def _majority(codes: NDArray[np.uint8], first: I64, last: I64) -> tuple[I64, Mask]:
    """Return, for runs of labels, the first one with the most frequent code, and whether codes differ."""
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


def _count_unmatched(left: _Window, key: F64, distance: F64, tolerance: float, tally: JoinTally) -> None:
    """Count what points without partner would have needed."""
    finite = distance[np.isfinite(distance)]
    with np.errstate(divide="ignore"):
        decade = np.searchsorted(10.0**DECADES, finite, side="left")
    tally.distances += np.bincount(decade, minlength=len(tally.distances))
    tally.distances[-1] += len(distance) - len(finite)
    if len(left):
        above = np.searchsorted(left.key, key, side="left")
        after, before = np.minimum(above, len(left) - 1), np.maximum(above - 1, 0)
        nearest = np.minimum(np.abs(left.key[after] - key), np.abs(left.key[before] - key))
        tally.n_other_return += int(np.count_nonzero(nearest <= tolerance))
