"""Turns clouds of spinning scanners, message by message, into firing columns and these into lines.

Drivers omit empty cells, and write points ring after ring or column after column. The times give
the columns back (:mod:`prc_cli.formats.bags.timing`). Lasers that look to other azimuths than the
first are staggered. The first message shows how far.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.stream import MAX_RINGS, ScanBlock
from prc_cli.core.types import F32, F64, I64, Mask
from prc_cli.formats.bags.cloud import Cloud
from prc_cli.formats.bags.numbers import RingNumbers
from prc_cli.formats.bags.sweep import SLACK, Sweep, azimuths, share_times
from prc_cli.formats.bags.times import (
    LONG_S,
    UNITS_S,
    counts_turns,
    find_crowd,
    find_turning,
    find_unit,
    turn_times,
    unit_note,
)
from prc_cli.formats.bags.timing import FITS, MOST_WAITING, Timing, find_columns
from prc_cli.formats.firings import (
    MAX_EMPTY,
    MAX_SHIFT,
    SPARE_CELLS,
    ColumnLines,
    Columns,
    choose,
)
from prc_cli.formats.options import InputConfig
from prc_cli.formats.sensor_frame import find_frame

_NEAR_COLUMNS = 8
"""Azimuths are compared over fewer columns than this."""
_LONG_COLUMNS = 4096
"""More columns than this between two messages are a pause."""


class _Points(NamedTuple):
    """Points of one or more messages."""

    ring: I64
    time_s: F64
    xyz_m: F32
    range_m: F32
    intensity: F32
    record: I64

    def part(self, where: NDArray[Any]) -> _Points:
        return _Points(*(values[where] for values in self))

    def joined(self, after: _Points) -> _Points:
        return _Points(*(np.concatenate([a, b]) for a, b in zip(self, after, strict=True)))


class CloudLines:
    """Gathers messages of one scanner into blocks."""

    def __init__(
        self,
        where: str,
        scanner: int,
        first: Cloud,
        between_s: Callable[[], float],
        config: InputConfig,
    ) -> None:
        self._where = where
        self._config = config
        self._has_times = first.has_times
        self._between_s = 0.0 if self._has_times else between_s()
        """Time from message to message, if their points have no times [s]."""
        has = (
            np.isfinite(first.range_m)
            & (first.ring >= 0)
            & (np.isfinite(first.time) | (not self._has_times))
        )
        numbers = RingNumbers.of(first.ring[has]) if has.any() else None
        if numbers is None:
            ring_text = "no point" if not has.any() else f"ring {int(first.ring[has].max())}"
            problem = (
                f"found {ring_text} in the first message, expected points of at most "
                f"{MAX_RINGS} rings"
            )
            raise InputError(where, problem, "record the scanner's own topic")
        self.points_per_line = numbers.n_rings
        self._numbers = numbers
        self.has_returns = False
        self._usual_unit_s = first.usual_unit_s if self._has_times else 1.0
        self._unit_s = _unit(first, has, between_s, config) if self._has_times else 1.0
        of_points_s = self._times(first)
        crowd = find_crowd(of_points_s[has])
        has &= (of_points_s >= crowd.begin_s) & (of_points_s <= crowd.end_s)
        ring = numbers.of_points(first.ring[has])
        time_s = of_points_s[has]
        xyz_m = first.xyz_m[has]
        # on its own axes, so that rings and azimuths are those of the scanner
        self._frame = find_frame(xyz_m, ring)
        xyz_m = xyz_m if self._frame is None else self._frame.own(xyz_m)
        self._sweep: Sweep | None = None
        """Turning of the scanner if times do not give columns."""
        azimuth_rad = azimuths(xyz_m)
        is_coarse = not self._has_times or share_times(ring, time_s, azimuth_rad)
        if is_coarse:
            self._sweep = Sweep.of(ring, time_s, azimuth_rad, self.points_per_line)
        timing = None if is_coarse else find_columns(ring, time_s)
        if self._sweep is not None:
            place = _place(ring, xyz_m, self.points_per_line)
            shift = np.zeros_like(self._sweep.shift)
            shift[place] = self._sweep.shift
        elif timing is not None:
            place = _place(ring, xyz_m, self.points_per_line)
            lines = None if first.scan_line is None else first.scan_line[has]
            by_line = None if lines is None else _stagger_of_lines(ring, timing, lines, place)
            shift = _stagger(ring, timing, azimuth_rad, place) if by_line is None else by_line
        else:
            raise self._no_columns(ring, time_s, is_coarse=is_coarse)
        self._place = place
        self._lines = ColumnLines(where, scanner, shift, config)
        self._waiting: _Points | None = None
        """Points of the last columns: the next message may add points to them."""
        self._waiting_line = 0
        self._last_column_s: float | None = None
        """Time of the last column [s]."""
        self._early: _Points | None = None
        """Points whose times are those of a later message."""
        self._timing = timing

    def _no_columns(self, ring: I64, time_s: F64, *, is_coarse: bool) -> InputError:
        if not is_coarse or len(np.unique(time_s)) < 3:
            problem = "the points of a ring have one time, expected a time a point"
            return InputError(self._where, problem, "let the driver write the times of the points")
        most = int(np.bincount(ring).max())
        n_times = len(np.unique(time_s))
        problem = f"{most} points of a ring share {n_times} times, each with azimuths all around"
        hint = "record every scanner with a topic or a frame of its own"
        return InputError(self._where, problem, hint)

    def add(self, cloud: Cloud, first_record: int) -> Iterator[ScanBlock]:
        """Take a message whose first record is given; yield the lines that are complete."""
        points = self._usable(cloud, first_record)
        if not len(points.ring):
            return
        crowd = find_crowd(points.time_s)
        if self._early is not None:
            points = points.joined(self._early)
            self._early = None
        is_later = points.time_s > crowd.end_s
        if is_later.any():
            self._early = points.part(is_later)
            points = points.part(~is_later)
        yield from self._take(points)

    def _times(self, cloud: Cloud) -> F64:
        if self._has_times:
            return cloud.times(self._unit_s)
        return cloud.stamp_s + turn_times(cloud.ring, azimuths(cloud.xyz_m), self._between_s)

    def _usable(self, cloud: Cloud, first_record: int) -> _Points:
        """Return the points with a ring and a time near that of the message; count the others."""
        if cloud.n_records and cloud.ring.max() >= len(self._numbers.index):
            problem = (
                f"found ring {int(cloud.ring.max())}, "
                f"expected {self.points_per_line} rings as in the first message"
            )
            raise InputError(self._where, problem, "record every set-up in a bag of its own")
        time_s = self._times(cloud)
        ring = self._numbers.of_points(cloud.ring)
        record = np.arange(first_record, first_record + cloud.n_records)
        points = _Points(ring, time_s, cloud.xyz_m, cloud.range_m, cloud.intensity, record)
        returned = np.isfinite(cloud.range_m)
        use = (ring >= 0) & np.isfinite(time_s)
        known_s = time_s[use & returned]
        if len(known_s):
            crowd = find_crowd(known_s)
            use &= (time_s >= crowd.begin_s) & (returned | (time_s <= crowd.end_s + LONG_S))
        if not use.all():
            n_strange = int(np.count_nonzero((cloud.ring >= 0) & ~use & returned))
            self._lines.count_unplaced(n_strange)
            self._lines.count_not_fired(cloud.n_records - int(np.count_nonzero(use)) - n_strange)
            points = points.part(use)
        return points

    def skip(self, cloud: Cloud) -> None:
        """Count the points of a message that is a copy of an earlier one."""
        self._lines.count_not_fired(cloud.n_records)

    def _take(self, points: _Points, *, more: bool = True) -> Iterator[ScanBlock]:
        """Take the next points, ``more`` if others follow; yield complete lines."""
        waiting = self._waiting
        n_waiting = 0
        if waiting is not None and len(waiting.ring) and self._is_pause(waiting, points):
            yield from self._give_waiting()
        elif waiting is not None:
            points = waiting.joined(points)
            n_waiting = len(waiting.ring)
        if self._sweep is not None:
            yield from self._add_by_azimuth(points, self._sweep)
            return
        following = None
        if self._timing is not None:
            following = self._timing.follow(
                points.ring, points.time_s, n_waiting, FITS if more else 1.0
            )
        timing = following or find_columns(points.ring, points.time_s)
        if timing is None:
            self._waiting = points
            if len(points.ring) > MOST_WAITING:
                problem = f"the times of {len(points.ring)} points show no firing columns"
                hint = "let the driver write the times of the points"
                raise InputError(self._where, problem, hint)
            return
        n = timing.n_columns
        self._check_size(n, timing, len(points.ring))
        before = (
            -int(np.median(timing.column[:n_waiting])) if n_waiting else self._columns_since(timing)
        )
        base = self._waiting_line + before
        is_last = timing.column == n - 1
        self._waiting = points.part(is_last)
        self._waiting_line = base + n - 1
        self._timing = timing
        self._last_column_s = float(timing.starts_s(n)[-1])
        if n > 1:
            yield from self._lines.add(self._columns(points, ~is_last, n - 1, base))

    def _is_pause(self, waiting: _Points, points: _Points) -> bool:
        period_s = self._timing.period_s if self._timing is not None else 0.0
        if self._sweep is not None:
            period_s = self._sweep.step_rad / abs(self._sweep.rate_rad_s)
        return float(points.time_s.min() - waiting.time_s.max()) > max(
            _LONG_COLUMNS * period_s, LONG_S
        )

    def _columns_since(self, timing: Timing) -> int:
        """Return the number of columns from the last yielded one to the first of a timing."""
        if self._last_column_s is None:
            return 0
        return max(1, round((timing.start_s - self._last_column_s) / timing.period_s))

    def _add_by_azimuth(self, points: _Points, sweep: Sweep) -> Iterator[ScanBlock]:
        placed = sweep.place(points.ring, points.time_s, self._azimuths(points))
        late_s = np.zeros(self.points_per_line)
        timing = Timing(0.0, 0.0, placed.column, late_s, fired_s=placed.time_s)
        n = timing.n_columns
        self._check_size(n, timing, len(points.ring))
        waits = placed.column >= n - SLACK
        self._waiting = points.part(waits)
        self._waiting_line = placed.base + max(n - SLACK, 0)
        self._timing = timing
        if n > SLACK:
            yield from self._lines.add(self._columns(points, ~waits, n - SLACK, placed.base))

    def _azimuths(self, points: _Points) -> F64:
        return azimuths(points.xyz_m if self._frame is None else self._frame.own(points.xyz_m))

    def _check_size(self, n: int, timing: Timing, n_points: int) -> None:
        if n * self.points_per_line > MAX_EMPTY * n_points + SPARE_CELLS:
            problem = f"{n_points} points lie in {n} columns, one every {timing.period_s:.3g} s"
            raise InputError(self._where, problem, "look at the times of the points")

    def _give_waiting(self) -> Iterator[ScanBlock]:
        waiting = self._waiting
        self._waiting = None
        if waiting is None or not len(waiting.ring):
            return
        n = 1
        base = self._waiting_line
        if self._sweep is not None:
            placed = self._sweep.place(waiting.ring, waiting.time_s, self._azimuths(waiting))
            late_s = np.zeros(self.points_per_line)
            self._timing = Timing(0.0, 0.0, placed.column, late_s, fired_s=placed.time_s)
            n = self._timing.n_columns
            base = placed.base
        elif self._timing is not None:
            late_s = self._timing.late_s
            start_s = float((waiting.time_s - late_s[waiting.ring.clip(max=len(late_s) - 1)]).min())
            column = np.zeros(len(waiting.ring), np.int64)
            self._timing = replace(self._timing, start_s=start_s, column=column, fired_s=None)
        yield from self._lines.add(
            self._columns(waiting, np.ones(len(waiting.ring), np.bool_), n, base)
        )

    def finish(self) -> Iterator[ScanBlock]:
        """Yield what waits."""
        while self._early is not None:
            early = self._early
            self._early = None
            is_later = early.time_s > find_crowd(early.time_s).end_s
            if is_later.any():
                self._early = early.part(is_later)
            yield from self._take(early.part(~is_later), more=False)
        yield from self._give_waiting()
        yield from self._lines.finish()

    def lost(self) -> str:
        """Return a sentence on what is unusual about rings, times and columns.

        Empty if nothing is.
        """
        of_times = unit_note(self._unit_s, self._usual_unit_s)
        if self._sweep is not None:
            step_deg = math.degrees(self._sweep.step_rad)
            of_times = (
                "points of several columns share a time"
                if self._has_times
                else "the points have no times"
            )
            of_times += f": columns are azimuths, {step_deg:.3g} deg apart"
        return "; ".join(
            note for note in (self._numbers.note, of_times, self._lines.lost()) if note
        )

    def _columns(
        self,
        points: _Points,
        use: Mask,
        n: int,
        base: int,
    ) -> Columns:
        """Put points into the cells of ``n`` columns.

        The second of a cell is its further return.
        """
        m = self.points_per_line
        timing = self._timing
        assert timing is not None
        point = np.flatnonzero(use)
        cell = (timing.column * m + self._place[points.ring])[point]
        # of several points of a cell, the first one is written last
        first, second = np.full((2, n * m), -1, np.intp)
        first[cell[::-1]] = point[::-1]
        is_further = first[cell] != point
        second[cell[is_further][::-1]] = point[is_further][::-1]
        # a cell holds two returns
        self._lines.count_collisions(
            int(np.count_nonzero(is_further)) - int(np.count_nonzero(second >= 0))
        )
        returns = [first, second] if is_further.any() else [first]
        cells = np.stack(returns, axis=-1).reshape(n, m, -1)

        def pick(values: NDArray[Any], which: NDArray[np.intp], fill: float) -> NDArray[Any]:
            picked: NDArray[Any] = values[which]
            picked[which < 0] = fill
            return picked

        ranges = pick(points.range_m, cells, np.nan)
        intensities = pick(points.intensity, cells, np.nan)
        shots = choose(ranges, intensities, cells, self._config.return_)
        main_point = shots.record
        further_point = shots.further_record
        late: F64 = np.zeros(m)
        late[self._place[: len(timing.late_s)]] = timing.late_s[:m]
        time_s = pick(points.time_s, main_point, np.nan)
        starts_s = timing.starts_s(n)
        if timing.is_together:
            # empty cells have exactly the time of their column
            column_s = np.fmin.reduce(time_s, axis=1)
            starts_s = np.where(np.isnan(column_s), starts_s, column_s)
        fired = starts_s[:, None] + late
        is_made_up = np.isnan(time_s) | (self._sweep is not None)
        return Columns(
            base + np.arange(n),
            shots.range_m,
            pick(points.record, main_point, -1),
            np.where(is_made_up, fired, time_s),
            pick(points.xyz_m, main_point, np.nan),
            shots.intensity,
            shots.further_m,
            None if further_point is None else pick(points.record, further_point, -1),
        )


def _unit(
    first: Cloud,
    has: Mask,
    between_s: Callable[[], float],
    config: InputConfig,
) -> float:
    """Return the unit of the stored times [s]: as configured, or the one with a usual turn rate."""
    if config.time_unit == "turn":
        return between_s()
    if config.time_unit != "auto":
        return UNITS_S[config.time_unit]
    turning = find_turning(first.ring[has], first.time[has], azimuths(first.xyz_m[has]))
    if turning is None:
        return first.usual_unit_s
    if counts_turns(first.time[has], turning):
        return between_s()
    return find_unit(first.usual_unit_s, turning)


def _place(ring: I64, xyz_m: F32, m: int) -> I64:
    """Return the place of every ring in a line, from low to high, (m,) int64."""
    x, y, z = xyz_m.astype(np.float64).T
    elevation = np.arctan2(z, np.hypot(x, y))
    present = np.unique(ring)
    middle = np.array([np.median(elevation[ring == number]) for number in present])
    every = np.interp(np.arange(m), present, middle)
    # rings without points continue the order of the others
    way = 1.0 if len(present) < 2 or middle[-1] >= middle[0] else -1.0
    every += way * 1e-6 * np.arange(m)
    order = np.argsort(every, kind="stable")
    place: I64 = np.empty(m, np.int64)
    place[order] = np.arange(m)
    return place


def _stagger(
    ring: I64,
    timing: Timing,
    azimuth: F64,
    place: I64,
) -> I64:
    """Return by place the columns, (m,) int64, that a ring looks ahead of the fullest ring."""
    column = timing.column
    fullest = int(np.bincount(ring).argmax())
    of_fullest = np.flatnonzero(ring == fullest)
    of_fullest = of_fullest[np.argsort(column[of_fullest], kind="stable")]
    steps = np.diff(column[of_fullest])
    turned = _wrap(np.diff(azimuth[of_fullest]))
    near = (steps > 0) & (steps < _NEAR_COLUMNS)
    shift: I64 = np.zeros(len(place), np.int64)
    slope = float(np.median(turned[near] / steps[near])) if near.any() else 0.0
    if not slope:
        return shift
    # the nearest shot of that ring before every point
    before = of_fullest[(np.searchsorted(column[of_fullest], column, side="right") - 1).clip(0)]
    away = column - column[before]
    ahead = _wrap(azimuth - azimuth[before] - slope * away) / slope
    for number in np.unique(ring):
        use = (ring == number) & (np.abs(away) < _NEAR_COLUMNS)
        if use.any():
            # a laser that fires later looks ahead by as much: that is no staggering
            late = (timing.late_s[number] - timing.late_s[fullest]) / timing.period_s
            shift[place[number]] = round(float(np.median(ahead[use])) - late)
    return shift.clip(-MAX_SHIFT, MAX_SHIFT)


def _stagger_of_lines(
    ring: I64,
    timing: Timing,
    scan_line: I64,
    place: I64,
) -> I64 | None:
    """Return by place the columns, (m,) int64, that a ring looks ahead, from its scan lines.

    None if the points of a ring are not all equally far from their columns.
    """
    behind = scan_line - timing.column
    nearest = int(behind.max())
    shift: I64 = np.zeros(len(place), np.int64)
    for number in np.unique(ring):
        of_ring = behind[ring == number] - nearest
        if of_ring.min() != of_ring.max():
            return None
        shift[place[number]] = of_ring[0]
    return shift if shift.min() >= -MAX_SHIFT else None


def _wrap(angle: F64) -> F64:
    wrapped: F64 = (angle + math.pi) % math.tau - math.pi
    return wrapped
