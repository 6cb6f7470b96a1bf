"""The order of records in time: it is checked, and weeks of GPS time are unwrapped.

PRC compares neighbours in time (Lehtola et al. 2019, section II): for files cut into tiles or
sorted by coordinate its labels are meaningless. So the default is to refuse them, with figures.
:mod:`prc_cli.formats.sorting` sorts them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import OrderError
from prc_cli.core.stream import MAX_RINGS, ReadTally, ScanBlock
from prc_cli.core.types import F64, I64, Mask
from prc_cli.formats.records import RecordChunk, Source, filtered

Policy: TypeAlias = Literal["require", "trust", "sort-time"]
"""Policy for records out of order (``input.order``)."""

MAX_SHARE_BACK = 1e-4
"""Largest share of steps back: files written by several threads contain swapped pairs."""
MAX_SHOTS_BACK = 5000
"""Largest step back, in mean steps of the input: about two lines.

Steps of writers' threads are shorter; where a block
of lines is out of place, a single step back is longer, however small its share."""
MAX_SPAN_BACK = 0.1
"""The same for short inputs, as a share of the whole time."""
MAX_RUNS = 64
"""Runs of rising times that are kept."""
CHECK_RECORDS = 1 << 20
"""The share is checked after this many records each, independent of chunks, and at the end."""
WEEK_S = 604_800.0
_PLAIN_S = 1e15
"""Larger times are shown in exponent notation."""


@dataclass(frozen=True, slots=True)
class StepBack:
    """A step where values decrease."""

    record: int
    """Index in the input of the record that is lower than the one before it."""
    value: float
    """Its value [s]."""
    before: float
    """The value before it [s]."""


@dataclass(frozen=True, slots=True)
class OrderEvidence:
    """Statistics of the times of an input."""

    what: str
    """Name of the dimension."""
    n_steps: int
    """Steps from one record to the next (values that are not finite are ignored)."""
    n_back: int
    """Steps that go back."""
    n_equal: int
    """Steps of zero: further returns of a shot, or time stamps coarser than the shots."""
    n_not_finite: int
    """Records whose value is NaN or infinite."""
    first: StepBack | None
    """First step back, None if there is none."""
    largest: StepBack | None
    """Largest step back, None if there is none."""
    span: float = 0.0
    """Latest time less the earliest [s]."""
    begins_anew: int | None = None
    """First record whose times run a second time over those before; None if there is none."""
    unset: float | None = None
    """The time to which every step back goes, before all others.

    It is the time of records without a time; None if there is none.
    """

    @property
    def share_back(self) -> float:
        """Share of steps that go back, 0 to 1."""
        return self.n_back / self.n_steps if self.n_steps else 0.0

    @property
    def largest_back(self) -> float:
        """Largest step back [s], 0 if there is none."""
        return self.largest.before - self.largest.value if self.largest else 0.0

    @property
    def most_back(self) -> float:
        """Largest step back that is accepted [s]."""
        mean = self.span / self.n_steps if self.n_steps else 0.0
        return min(MAX_SHOTS_BACK * mean, MAX_SPAN_BACK * self.span)

    @property
    def is_chronological(self) -> bool:
        """Whether the order is accepted under ``require``."""
        return self.share_back <= MAX_SHARE_BACK and self.largest_back <= self.most_back

    def sentence(self) -> str:
        """Return the evidence as one line, without a verdict.

        >>> watch = OrderWatch("drive.las", "trust")
        >>> watch.see(np.array([1.0, 2.0, 1.5, 3.0]), None)
        >>> watch.evidence().sentence()
        'gps_time decreases in 33.3 % of 3 steps, first at record 2: 1.50 s after 2.00 s'
        """
        unknown = f"; {self.n_not_finite:,} records have none" if self.n_not_finite else ""
        if self.first is None or self.largest is None:
            return f"{self.what} never decreases in {self.n_steps:,} steps{unknown}"
        if self.share_back >= 1e-3:
            share = f"{100 * self.share_back:.1f} %"
            place = "first"
            step = self.first
        else:
            share = f"{self.n_back:,}"
            place = "largest"
            step = self.largest
        return (
            f"{self.what} decreases in {share} of {self.n_steps:,} steps, "
            f"{place} at record {step.record}: {_shown(step.value, step)} s after "
            f"{_shown(step.before, step)} s{unknown}"
        )


def _shown(time_s: float, step: StepBack) -> str:
    if abs(time_s) > _PLAIN_S:
        return f"{time_s:g}"
    # the step may overflow, but then one of its ends is in exponent notation anyway
    size = min(step.before - step.value, _PLAIN_S)
    digits = min(max(2, 1 - math.floor(math.log10(float(f"{size:.1g}")))), 9)
    return f"{time_s:.{digits}f}"


class OrderWatch:
    """Checks, chunk by chunk, a dimension that must not decrease."""

    def __init__(
        self,
        path: str,
        policy: Policy,
        what: str = "gps_time",
        *,
        can_sort: bool = True,
    ) -> None:
        self._path = path
        self._can_sort = can_sort
        self._policy = policy
        self._what = what
        self._n_records = 0
        self._n_finite = 0
        self._n_back = 0
        self._n_equal = 0
        self._last: float | None = None
        self._first: StepBack | None = None
        self._largest: StepBack | None = None
        self._low = math.inf
        self._high = -math.inf
        self._starts: list[tuple[int, float]] = []
        """First record and first time of every run of rising times."""
        self._tops: list[float] = []
        """Last time of every run that has ended."""

    @classmethod
    def of(cls, source: Source, policy: Policy) -> OrderWatch:
        """Return an order check for the times of a source."""
        return cls(source.path, policy, source.facts.time_name)

    def count(self, values: NDArray[Any], record: I64 | None) -> ReadTally:
        """Take the next records; return the number of steps back."""
        before = self._n_back
        self.see(np.asarray(values, np.float64), record)
        return ReadTally(n_time_steps_back=self._n_back - before)

    def see(self, values: F64, record: I64 | None) -> None:
        """Take the next records."""
        if record is None:
            record = np.arange(self._n_records, self._n_records + len(values), dtype=np.int64)
        while len(values):
            # up to the next check, so that the verdict does not depend on chunks
            n = CHECK_RECORDS - self._n_records % CHECK_RECORDS
            self._count(values[:n], record[:n])
            values = values[n:]
            record = record[n:]
            if self._policy == "require" and self._n_records % CHECK_RECORDS == 0:
                self._judge()

    def _count(self, values: F64, record: I64) -> None:
        self._n_records += len(values)
        finite = np.isfinite(values)
        if not finite.all():
            values = values[finite]
            record = record[finite]
        if not len(values):
            return
        if self._last is None:
            self._starts.append((int(record[0]), float(values[0])))
        else:
            self._compare(np.array([self._last]), values[:1], record[:1])
        self._compare(values[:-1], values[1:], record[1:])
        self._last = float(values[-1])
        self._low, self._high = (
            min(self._low, float(values.min())),
            max(self._high, float(values.max())),
        )
        self._n_finite += len(values)

    def _compare(self, before: F64, after: F64, record: I64) -> None:
        """Count steps; ``record`` is where each ends."""
        self._n_equal += int(np.count_nonzero(after == before))
        back = np.flatnonzero(after < before)
        if len(back):
            self._n_back += len(back)
            self._keep(before, after, record, back)

    def _keep(
        self,
        before: F64,
        after: F64,
        record: I64,
        back: I64,
    ) -> None:
        # the step between finite times may overflow
        with np.errstate(over="ignore"):
            steps = [int(back[0]), int(back[np.argmax(before[back] - after[back])])]
        for i in back[: MAX_RUNS - len(self._tops)].tolist():
            self._starts.append((int(record[i]), float(after[i])))
            self._tops.append(float(before[i]))
        first, largest = (
            StepBack(int(record[i]), float(after[i]), float(before[i])) for i in steps
        )
        if self._first is None:
            self._first = first
        if (
            self._largest is None
            or largest.before - largest.value > self._largest.before - self._largest.value
        ):
            self._largest = largest

    def finish(self) -> None:
        """Check all steps so far."""
        if self._policy == "require":
            self._judge()

    def _unset(self) -> float | None:
        """Return the time of records without one.

        Every step back goes to it, and the first record has a later one.
        """
        if not 2 <= self._n_back == len(self._tops):
            return None
        (_, first), *others = self._starts
        is_one = all(time == self._low for _, time in others)
        return self._low if is_one and self._low < first else None

    def evidence(self) -> OrderEvidence:
        """Return the figures so far."""
        evidence = OrderEvidence(
            what=self._what,
            n_steps=max(self._n_finite - 1, 0),
            n_back=self._n_back,
            n_equal=self._n_equal,
            n_not_finite=self._n_records - self._n_finite,
            unset=self._unset(),
            first=self._first,
            largest=self._largest,
            span=self._high - self._low if self._n_finite else 0.0,
        )
        return replace(evidence, begins_anew=self._begins_anew(evidence.most_back))

    def _begins_anew(self, most: float) -> int | None:
        """Return the first record of a run that repeats some seconds of an earlier run."""
        if self._last is None or len(self._tops) >= MAX_RUNS:
            return None
        first = self._starts[0][1]
        # with several steps back, runs may have gaps that others fill
        if len(self._tops) > 1 and any(abs(start - first) > most for _, start in self._starts):
            return None
        runs = [
            (start, top)
            for (_, start), top in zip(self._starts, [*self._tops, self._last], strict=True)
        ]
        for i, (start, top) in enumerate(runs):
            if any(min(top, before) - max(start, begin) > most for begin, before in runs[:i]):
                return self._starts[i][0]
        return None

    def _judge(self) -> None:
        evidence = self.evidence()
        if evidence.is_chronological:
            return
        problem = f"{evidence.sentence()}; expected shots in the order they were fired"
        raise OrderError(
            self._path, problem, order_hint(evidence, self._path, can_sort=self._can_sort)
        )


def fire_in_turns(time_s: F64, column: NDArray[Any]) -> bool:
    """Return whether times fall from shot to shot, but rise in each of a few columns.

    The rings of a spinning scanner do so: they fire in another order than they lie, and see a line
    at other times.

    >>> fire_in_turns(np.array([0.0, 2.0, 1.0, 3.0, 5.0, 4.0]), np.array([0, 1, 2, 0, 1, 2]))
    True
    """
    known = np.isfinite(time_s) & (column >= 0)
    time_s = time_s[known]
    column = column[known]
    if not len(time_s) or column.max() >= MAX_RINGS or not (np.diff(time_s) < 0).any():
        return False
    order = np.argsort(column, kind="stable")
    falls = (np.diff(time_s[order]) < 0) & (np.diff(column[order]) == 0)
    return not falls.any()


class RingOrderWatch:
    """Checks the times of every ring by itself; a ring has a column."""

    def __init__(self, source: Source, policy: Policy) -> None:
        self._source = source
        self._policy = policy
        self._rings: dict[int, OrderWatch] = {}

    def count(self, values: NDArray[Any], record: I64 | None, column: NDArray[Any]) -> ReadTally:
        """Take the next records; return the number of steps back."""
        value = np.asarray(column, np.float64)
        # records without a ring are judged together
        column = np.where(np.isfinite(value), value, -1.0)
        order = np.argsort(column, kind="stable")
        present, first = np.unique(column[order], return_index=True)
        tally = ReadTally()
        for ring, rows in zip(present.tolist(), np.split(order, first[1:]), strict=True):
            watch = self._rings.setdefault(int(ring), OrderWatch.of(self._source, self._policy))
            tally += watch.count(values[rows], None if record is None else record[rows])
        return tally

    def finish(self) -> None:
        """Check all steps so far."""
        for watch in self._rings.values():
            watch.finish()

    def evidence(self) -> OrderEvidence:
        """Return the figures of the ring that is least in order."""
        return max(
            (watch.evidence() for watch in self._rings.values()),
            key=lambda evidence: (evidence.n_back, evidence.n_steps),
        )


def order_hint(evidence: OrderEvidence, path: str = "", *, can_sort: bool) -> str:
    """Return what to do with an input whose times are out of order."""
    if evidence.n_back == 1 and abs(evidence.largest_back - WEEK_S) < WEEK_S / 100:
        return (
            "the GPS week changes in this file; "
            "if the records are in the order of the shots: --trust-order"
        )
    if evidence.unset is not None:
        of_records = (
            f"{evidence.n_back} records have the time {evidence.unset:g}, which may mean no time"
        )
        return f"{of_records}; to leave them without a class: --trust-order, or remove them"
    if path.lower().endswith(".copc.laz"):
        # every node of the octree starts again
        return "COPC files are in the order of their octree: sort with --sort-by-time"
    if evidence.begins_anew is not None:
        again = f"the times start again at record {evidence.begins_anew}"
        return f"{again}: split the file there, or remove the copies; to accept it: --trust-order"
    if not can_sort:
        return "write the lines in the order of the scan; to accept this order: --trust-order"
    return "if no record is missing: --sort-by-time; to accept this order: --trust-order"


def take_turns(block: ScanBlock) -> bool:
    """Return whether the rings of a spinning scanner fire in another order than they lie.

    The times of each ring rise.
    """
    if block.time_s is None or block.xyz_m is None or block.points_per_line > MAX_RINGS:
        return False
    falls_in_line = (np.diff(block.time_s, axis=1) < 0).any()
    return bool(falls_in_line and not (np.diff(block.time_s, axis=0) < 0).any())


TOLERANCE = 0.01
"""Tolerance of the step back as a share of a week, for pauses and clock errors."""
ADDED = "week added"
STEPS = "week steps"
"""Additional columns of chunks: where a week was added (n,), and the number of week ends (1,)."""


@dataclass(frozen=True, slots=True)
class WeekState:
    """State of the times across chunks."""

    last_s: float = math.nan
    """Last known time, as stored [s]."""
    end_s: float | None = None
    """Time as stored at which the week ended [s]; None = not yet."""


def unwrap_week(time_s: F64, state: WeekState) -> tuple[F64, Mask, WeekState]:
    """Add a week to the times after the first step back of about one.

    Later steps back are near the end of the week.
    """
    position = np.flatnonzero(np.isfinite(time_s))
    added: Mask = np.zeros(len(time_s), np.bool_)
    if not len(position):
        return time_s, added, state
    seen = time_s[position]
    begin = 0
    if state.end_s is None:
        before = np.concatenate(([state.last_s], seen[:-1]))
        with np.errstate(over="ignore"):
            ends = np.abs(before - seen - WEEK_S) <= TOLERANCE * WEEK_S
        if not ends.any():
            return time_s, added, replace(state, last_s=float(seen[-1]))
        begin = int(np.argmax(ends))
        state = replace(state, end_s=float(before[begin]))
    end_s = math.inf if state.end_s is None else state.end_s
    added[position[begin:]] = seen[begin:] < end_s - WEEK_S / 2
    return np.where(added, time_s + WEEK_S, time_s), added, replace(state, last_s=float(seen[-1]))


def over_weeks(source: Source) -> Source:
    """Return a source with unwrapped GPS times; see :func:`unwrap_week`.

    Chunks from the end of the week on also have :data:`ADDED` and :data:`STEPS`.
    """
    return filtered(source, _over_weeks)


def _over_weeks(names: tuple[str, ...], source: Source) -> Iterator[RecordChunk]:
    state = WeekState()
    for chunk in source.chunks(names):
        if "time" not in names:
            yield chunk
            continue
        had_ended = state.end_s is not None
        time_s, added, state = unwrap_week(np.asarray(chunk.values["time"], np.float64), state)
        if state.end_s is None:
            yield chunk
            continue
        values = {
            **chunk.values,
            "time": time_s,
            ADDED: added,
            STEPS: np.array([0 if had_ended else 1]),
        }
        yield replace(chunk, values=values)


def times_of_trajectory(chunk: RecordChunk, first_s: float) -> F64:
    """Return the times to look up in a trajectory, (n,) [s]."""
    time_s = np.asarray(chunk.values["time"], np.float64)
    added = chunk.values.get(ADDED)
    if added is None:
        return time_s
    stored = np.where(added, time_s - WEEK_S, time_s)
    return np.where(stored >= first_s, stored, time_s)


def week_steps(chunk: RecordChunk) -> int:
    """Return the number of steps back by a week removed from a chunk."""
    return int(chunk.values[STEPS][0]) if STEPS in chunk.values else 0


def judge_first_records(source: Source) -> None:
    """Refuse a source whose first chunk is not chronological."""
    if "time" not in source.dimensions:
        return
    watch = OrderWatch.of(source, "require")
    for chunk in source.chunks(("time",)):
        watch.count(chunk.values["time"], chunk.records())
        break
    watch.finish()
