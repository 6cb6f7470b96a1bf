"""The merge join: one sweep over two streams that are sorted by the same key.

The key is a time, an id or a coordinate. A window moves along it. It holds, of both sides, every
record that can influence the pairs of the records that are decided next. A matcher pairs the
records of a window in memory (:mod:`prc_cli.matching.keys`). The pairs therefore do not depend on
how the streams are chunked, and memory does not grow with the streams.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.types import F64, I64, Mask
from prc_cli.formats.records import Source
from prc_cli.formats.sorting import sorted_by_time

RECORD = "record"
"""Column of :func:`columns_of` with the index of the record in its source, int64."""
SORT_RECORDS = 1 << 18
"""Records of a side sorted in memory at a time; twice as many are held while merging."""


def columns_of(
    source: Source,
    names: tuple[str, ...],
    *,
    sort: bool,
    with_record: bool = True,
) -> Iterator[Columns]:
    """Yield dimensions of a source, by ascending ``time`` if ``sort``, else as stored.

    With :data:`RECORD` if ``with_record``.
    """
    if sort:
        source = sorted_by_time(source, run_records=SORT_RECORDS, merge_records=2 * SORT_RECORDS)
    for chunk in source.chunks(names):
        values = {name: chunk.values[name] for name in names}
        yield {**values, RECORD: chunk.records()} if with_record else values


def in_step(
    streams: Sequence[Iterator[Columns]], check_lengths: Callable[[Sequence[int]], None]
) -> Iterator[tuple[Columns, ...]]:
    """Walk streams of the same records in equal steps."""
    pending: list[Columns] = [{} for _ in streams]
    n_read = [0] * len(streams)
    while True:
        for k, stream in enumerate(streams):
            while not _length(pending[k]):
                chunk = next(stream, None)
                if chunk is None:
                    break
                pending[k] = chunk
                n_read[k] += _length(chunk)
        n = min(_length(columns) for columns in pending)
        if not n:
            break
        yield tuple({name: values[:n] for name, values in columns.items()} for columns in pending)
        pending = [{name: values[n:] for name, values in columns.items()} for columns in pending]
    for k, stream in enumerate(streams):
        n_read[k] += sum(_length(chunk) for chunk in stream)
    check_lengths(n_read)


def _length(columns: Columns) -> int:
    return len(next(iter(columns.values()))) if columns else 0


Columns: TypeAlias = dict[str, NDArray[Any]]
"""(n,) arrays of the same records by name."""

KEY = "time"
"""Column that the streams are sorted by, float64, finite.

An id or a coordinate is called ``time`` too, because
:func:`prc_cli.formats.sorting.sorted_by_time` sorts by that name."""
SAME = "same"
"""Column that must be equal in a pair beside the key, int64, 0 or more: return number, scanner."""
CODE = "code"
"""Class code, an integer."""
MAX_HELD = 1 << 23
"""Most records of one side within a window."""
STEP_RECORDS = 1 << 17
"""Records taken from a stream at a time: search trees of more do not fit the processor's caches."""
DECADES = np.arange(-9, 7)
"""Exponents of ten by which the distances of records without partner are counted."""
_USED = "used"


class UnsortedError(Exception):
    """A stream is not sorted by its key; the caller sorts it and starts again."""

    def __init__(self, side: int) -> None:
        super().__init__(side)
        self.side = side


@dataclass(slots=True)
class JoinTally:
    """Counts of a join; of left records unless stated otherwise."""

    n_left: int = 0
    n_pairs: int = 0
    n_right: int = 0
    """Right records with a partner."""
    n_ambiguous: int = 0
    """Records left out: their key or place has different numbers of left and right records."""
    n_in_order: int = 0
    """Pairs of records that share their key or place, paired in record order.

    Labels count only if their classes differ.
    """
    n_by_majority: int = 0
    """Records that got the most frequent of several differing labels."""
    n_repeated: int = 0
    """Records in pairs whose key another record of their side has (tiles that overlap)."""
    n_shared: int = 0
    """Records in pairs whose key several right records have (coarse time stamps)."""
    n_other_same: int = 0
    """Records without partner whose key has a right record of another return (:data:`SAME`)."""
    largest: float = 0.0
    """Largest distance of a pair; 0 where the matcher gives no distances."""
    distances: I64 = field(default_factory=lambda: np.zeros(len(DECADES) + 1, np.int64))
    """(17,) int64, records without partner by the distance to the nearest right record.

    Bins end at 10^-9, 10^-8, ..., 10^6; the last one has no end.
    """

    def near(self, share: float = 0.5) -> float | None:
        """Return the power of ten within which ``share`` of the unpaired records have a right one.

        None if there is no such power.
        """
        total = int(self.distances.sum())
        n_within = np.cumsum(self.distances[:-1])
        reached = np.flatnonzero(n_within >= share * total)
        if not total or not len(reached):
            return None
        return float(10.0 ** DECADES[reached[0]])

    def add_distances(self, distance: F64, paired: Mask) -> None:
        """Count distances (n,) of records to their nearest right one; infinite = there is none."""
        self.largest = max(self.largest, float(distance[paired].max(initial=0.0)))
        alone = distance[~paired]
        # beyond the last decade, and infinite, fall into the last place
        decade = np.searchsorted(10.0**DECADES, alone, side="left")
        self.distances += np.bincount(decade, minlength=len(self.distances))


@dataclass(frozen=True, slots=True)
class Match:
    """Pairs of a window, as indices into its two sides."""

    left: I64
    """(pairs,) index of the left record."""
    right: I64
    """(pairs,) index of the right record."""
    counts: dict[str, I64] = field(default_factory=dict)
    """Indices of left records by the field of :class:`JoinTally` that counts them."""
    used: I64 | None = None
    """Right records that count as partners of the decided records; None = those of the pairs."""
    distance: F64 | None = None
    """(n_decided,) distance of the decided left records to the nearest right one.

    None = not known.
    """


Matcher: TypeAlias = Callable[[Columns, Columns, slice], Match]
"""Pairs the records of a window: left columns, right columns, the left records decided now.

Both sides are sorted by key. Pairs of other left records are ignored, because their partners may
not all be in the window.
"""


@dataclass(frozen=True, slots=True)
class Joined:
    """Left records that were just decided, with their partners."""

    left: Columns
    """Every left record comes once, by ascending key."""
    right: Columns
    """Right records of the window."""
    left_index: I64
    """(pairs,) index in ``left``."""
    right_index: I64
    """(pairs,) index in ``right``."""

    def pairs(self) -> tuple[Columns, Columns]:
        """Return the columns of both sides in pairs.

        Row k of the left belongs to row k of the right.
        """
        left = {name: values[self.left_index] for name, values in self.left.items()}
        right = {name: values[self.right_index] for name, values in self.right.items()}
        return left, right


def merge_join(
    left: Iterator[Columns],
    right: Iterator[Columns],
    match: Matcher,
    tolerance: float,
    tally: JoinTally,
    left_name: str = "left",
    right_name: str = "right",
    *,
    spare: int = 0,
) -> Iterator[Joined]:
    """Match two sorted streams.

    Parameters
    ----------
    left, right : iterators of columns
        Sorted by :data:`KEY`.
    match : Matcher
    tolerance : float
        Largest difference of the keys of a pair, in their unit.
    tally : JoinTally
        The counts are added to it.
    left_name, right_name : str
        Names of the two streams, for messages.
    spare : int
        Right records beyond the tolerance that the matcher sees as well, at both ends.

    Raises
    ------
    UnsortedError
        A stream is not sorted.
    """
    # a record is decided by candidates within the tolerance, and a candidate by the records within
    # the tolerance of it
    reach = 2.0 * tolerance * (1 + 1e-9)
    left_window = _Window(_in_steps(left, 0), left_name)
    right_window = _Window(_in_steps(right, 1), right_name)
    low = -math.inf
    while True:
        open_windows = [side for side in (left_window, right_window) if side.is_open]
        if open_windows:
            behind = min(open_windows, key=lambda side: side.last)
            behind.read()
        open_windows = [side for side in open_windows if side.is_open]
        limit = min((side.last for side in open_windows), default=math.inf)
        is_end = math.isinf(limit)
        high = limit
        if reach and not is_end:
            high = float(np.nextafter(limit - reach, -math.inf))
        if high <= low:
            continue
        if not is_end:
            # a window that decides less than half of its records would match most many times
            n_decided = left_window.count(low, high) + right_window.count(low, high)
            if 2 * n_decided < left_window.n_held + right_window.n_held:
                continue
        left_columns = left_window.between(low - reach, limit)
        right_columns = right_window.between(low - reach, limit, spare)
        first, stop = np.searchsorted(left_columns[KEY], (low, high)).tolist()
        if first < stop:
            yield _decide(left_columns, right_columns, slice(first, stop), match, tally)
        if is_end:
            return
        left_window.drop(high - reach)
        right_window.drop(high - reach, spare)
        low = high


def _decide(
    left: Columns,
    right: Columns,
    decided: slice,
    match: Matcher,
    tally: JoinTally,
) -> Joined:
    """Match the records of a window and count those that are decided."""
    first = decided.start
    stop = decided.stop
    matches = match(left, right, decided)
    is_decided = (matches.left >= first) & (matches.left < stop)
    left_index = matches.left[is_decided] - first
    right_index = matches.right[is_decided]
    for name, indices in matches.counts.items():
        n_decided = int(np.count_nonzero((indices >= first) & (indices < stop)))
        setattr(tally, name, getattr(tally, name) + n_decided)
    if matches.distance is not None:
        paired = np.zeros(stop - first, np.bool_)
        paired[left_index] = True
        tally.add_distances(matches.distance, paired)
    tally.n_left += stop - first
    tally.n_pairs += len(left_index)
    del left[_USED]
    used = right.pop(_USED)
    n_used_before = int(np.count_nonzero(used))
    # a view of the window's own column: the mark stays for the next windows
    used[right_index if matches.used is None else matches.used] = True
    tally.n_right += int(np.count_nonzero(used)) - n_used_before
    decided_left = {name: values[decided] for name, values in left.items()}
    return Joined(decided_left, right, left_index, right_index)


def _in_steps(chunks: Iterator[Columns], side: int) -> Iterator[Columns]:
    """Yield a stream in small steps; raise :class:`UnsortedError` if its keys go back."""
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


class _Window:
    """The part of a sorted stream that is held."""

    def __init__(self, chunks: Iterator[Columns], name: str) -> None:
        self._chunks = chunks
        self._name = name
        self._held: Columns = {KEY: np.empty(0), _USED: np.empty(0, np.bool_)}
        self.is_open = True
        self.last = -math.inf

    def read(self) -> None:
        """Hold a further chunk, or close the window at the end of the stream."""
        chunk = next(self._chunks, None)
        if chunk is None:
            self.is_open = False
            return
        self.last = float(chunk[KEY][-1])
        columns = {**chunk, _USED: np.zeros(len(chunk[KEY]), np.bool_)}
        if len(self._held[KEY]):
            for name, values in columns.items():
                columns[name] = np.concatenate([self._held[name], values])
        self._held = columns
        if self.n_held > MAX_HELD:
            problem = (
                f"more than {MAX_HELD} records within the tolerance of key {columns[KEY][0]:.9g}"
            )
            hint = "give a smaller tolerance, or match by something else"
            raise InputError(self._name, problem, hint)

    @property
    def n_held(self) -> int:
        return len(self._held[KEY])

    def count(self, low: float, high: float) -> int:
        """Return the number of records with ``low <= key < high``."""
        first, stop = np.searchsorted(self._held[KEY], [low, high])
        return int(stop - first)

    def between(self, low: float, high: float, spare: int = 0) -> Columns:
        """Return views of the records with ``low <= key < high``, and ``spare`` at both ends."""
        first, stop = np.searchsorted(self._held[KEY], [low, high])
        part = slice(max(first - spare, 0), stop + spare)
        return {name: values[part] for name, values in self._held.items()}

    def drop(self, low: float, spare: int = 0) -> None:
        """Drop the records with ``key < low`` except the last ``spare`` of them."""
        first = int(np.searchsorted(self._held[KEY], low)) - spare
        if first > 0:
            self._held = {name: values[first:] for name, values in self._held.items()}
