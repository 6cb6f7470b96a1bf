"""``sensor_msgs/PointCloud2`` with ring and time: the firing columns of a spinning scanner, found from the times.

Drivers leave empty cells out, and write points ring after ring or column after column. The times bring the columns
back: the lasers of a scanner fire in turn, each with the same period. Lasers that look to other azimuths than the first
are staggered; how far is found from the first message.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F32, F64, I64, Mask
from prc_cli.formats.bags.cursor import Cursor, ShortMessageError
from prc_cli.formats.options import InputConfig
from prc_cli.formats.packets.columns import MAX_EMPTY, SPARE_CELLS, ColumnLines, Columns, choose_of_two

CLOUD = "sensor_msgs/PointCloud2"
RINGS = ("ring", "channel", "laser_id")
TIMES = ("time", "t", "timestamp", "time_stamp", "offset_time", "time_offset")
LIGHTS = ("intensity", "reflectivity", "signal", "i")
MAX_RINGS = 256
_WIDTHS = (4, 8, 16, 32, 40, 64, 80, 128, MAX_RINGS)
"""Rings of scanners: a ring that does not return in the first message has its place."""
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_MAX_FIELDS = 100
_ABSOLUTE_S = 1e6
"""Times beyond are not counted from the stamp of the message [s]."""
_LEAST_PERIOD_S = 1e-6
_TURN = 2 * math.pi
_NEAR_COLUMNS = 8
"""Azimuths are compared over fewer columns than this."""
_MOST_SHIFT = 512
_MOST_WAITING = 1 << 20
"""Most points that wait for others to tell their columns."""
_MOST_COLUMNS = 1e9
"""Most columns of a message."""


@dataclass(frozen=True, slots=True)
class Cloud:
    """A message, decoded; points in its order, those without coordinates included."""

    frame: str
    ring: I64
    """(n,) int64."""
    time_s: F64
    """(n,) float64 [s]."""
    xyz_m: F32
    """(n, 3) float32 [m]; NaN = no return."""
    intensity: F32
    """(n,) float32, NaN where there is none."""

    @property
    def n_records(self) -> int:
        """Points, with and without coordinates."""
        return len(self.ring)


def parse_cloud(data: bytes, *, is_cdr: bool) -> Cloud:
    """Decode a message."""
    cursor = Cursor(data, is_cdr=is_cdr)
    stamp_s, frame = cursor.header()
    height, width, n_fields = (cursor.number("I") for _ in range(3))
    if n_fields > _MAX_FIELDS:
        message = f"says that a point has {n_fields} fields, expected at most {_MAX_FIELDS}"
        raise ShortMessageError(message)
    fields: dict[str, tuple[int, int]] = {}
    for _ in range(n_fields):
        name = cursor.text()
        offset, kind, _ = cursor.number("I"), cursor.number("B"), cursor.number("I")
        fields[name] = (offset, kind)
    is_big = bool(cursor.number("B"))
    step, row_step = cursor.number("I"), cursor.number("I")
    raw = cursor.array("u1")
    if height > 1 and row_step < width * step:
        message = f"says that {width} points of {step} bytes are a row of {row_step}"
        raise ShortMessageError(message)
    row_step = max(row_step, width * step)
    if height and row_step * (height - 1) + width * step > len(raw):
        message = f"says it holds {height} x {width} points of {step} bytes, found {len(raw)} bytes"
        raise ShortMessageError(message)
    names = _find_fields(fields, step)
    kinds = {name: (">" if is_big else "<") + _TYPES[fields[name][1]] for name in names if name}
    offsets = [fields[name][0] for name in kinds]
    if any(at + np.dtype(kind).itemsize > step for at, kind in zip(offsets, kinds.values(), strict=True)):
        message = f"has fields beyond the {step} bytes of a point"
        raise ShortMessageError(message)
    point = np.dtype({"names": list(kinds), "formats": list(kinds.values()), "offsets": offsets, "itemsize": step})
    shape = (height, width * step) if width else (0, step)
    # rows may be longer than their points; their bounds are checked above
    rows = np.lib.stride_tricks.as_strided(raw, shape, (row_step, 1), writeable=False)
    table = np.frombuffer(rows.tobytes(), point)
    return _cloud(frame, stamp_s, table, names)


def _find_fields(fields: dict[str, tuple[int, int]], step: int) -> tuple[str, str, str, str, str, str]:
    """Return the names of x, y, z, ring, time and intensity (empty: none)."""
    ring = next((name for name in RINGS if name in fields), "")
    time = next((name for name in TIMES if name in fields), "")
    light = next((name for name in LIGHTS if name in fields), "")
    lacking = [name for name in "xyz" if name not in fields]
    lacking += [what for what, name in (("ring", ring), ("time", time)) if not name]
    if lacking or not step:
        message = f"has points without {', '.join(lacking) or 'bytes'} (fields: {', '.join(fields)[:200]})"
        raise ShortMessageError(message)
    if any(fields[name][1] not in _TYPES for name in ("x", "y", "z", ring, time, light) if name):
        message = "has fields of a type that is not there"
        raise ShortMessageError(message)
    return "x", "y", "z", ring, time, light


def _cloud(frame: str, stamp_s: float, table: NDArray[np.void], names: tuple[str, str, str, str, str, str]) -> Cloud:
    x, y, z, ring, time, light = names
    with np.errstate(all="ignore"):
        xyz: F32 = np.stack([table[name].astype(np.float32) for name in (x, y, z)], axis=1)
        xyz[~np.isfinite(xyz).all(axis=1) | ~xyz.any(axis=1)] = np.nan
        times = table[time].astype(np.float64)
        if table.dtype[time].kind in "iu":
            times *= 1e-9
        is_absolute = bool(np.nanmax(np.abs(times), initial=0.0) > _ABSOLUTE_S)
        times = times if is_absolute else times + stamp_s
        stored = table[ring].astype(np.float64)
        rings: I64 = np.where(np.isfinite(stored), stored, -1).clip(-1, 1 << 20).astype(np.int64)
        lit = table[light].astype(np.float32) if light else np.full(len(table), np.nan, np.float32)
    return Cloud(frame, rings, times, xyz, lit)


@dataclass(frozen=True, slots=True)
class Timing:
    """Columns of points."""

    period_s: float
    start_s: float
    """Time of column 0 [s]."""
    column: I64
    """(n,) int64, column of every point, from 0."""
    late_s: F64
    """(rings,) float64, by ring: how long after the first of a column its laser fires [s]."""


def find_columns(ring: I64, time_s: F64) -> Timing | None:
    """Find the firing column of every point from its time.

    Lasers that fire together have few times: every one is a column, and the period may vary with the motor. Lasers that
    fire in turn follow a clock: a ring's times are a multiple of the period apart.

    >>> time_s = np.array([0.0, 0.1, 0.3, 0.02, 0.12, 0.22])
    >>> find_columns(np.array([0, 0, 0, 1, 1, 1]), time_s).column.tolist()
    [0, 1, 3, 0, 1, 2]
    """
    order = np.lexsort((time_s, ring))
    own, at = ring[order], time_s[order]
    steps = np.diff(at)
    steps = steps[(np.diff(own) == 0) & (steps > _LEAST_PERIOD_S)]
    if not len(steps):
        return None
    low = float(np.percentile(steps, 10))
    period = float(np.median(steps[steps < 1.5 * low]))
    if not float(time_s.max() - time_s.min()) < _MOST_COLUMNS * period:
        return None
    every, which = np.unique(np.rint((time_s - at.min()) / _LEAST_PERIOD_S), return_inverse=True)
    if len(every) <= 2 * int(np.bincount(ring).max()):
        number = np.cumsum(np.rint(np.diff(every, prepend=0.0) * (_LEAST_PERIOD_S / period))).astype(np.int64)
        return Timing(period, float(at.min()), number[which.ravel()], np.zeros(int(ring.max()) + 1))
    period = _refined(own, at, period)
    start = float(at.min())
    present, first = np.unique(own, return_index=True)
    turned = np.exp(1j * _TURN * ((at - start) / period))
    of_ring = np.angle(np.add.reduceat(turned, first)) / _TURN % 1.0
    # the lasers begin to fire after the longest pause
    ordered = np.sort(of_ring)
    gaps = np.diff(np.append(ordered, ordered[0] + 1.0))
    begin = float(ordered[(int(gaps.argmax()) + 1) % len(ordered)])
    late: F64 = np.zeros(int(ring.max()) + 1)
    late[present] = (of_ring - begin + 1e-9) % 1.0 - 1e-9
    column = np.rint((time_s - start) / period - begin - late[ring]).astype(np.int64)
    least = int(column.min())
    return Timing(period, start + (begin + least) * period, column - least, late * period)


def _refined(ring: I64, at: F64, period: float) -> float:
    """Return the period from the first to the last shots of the ring with the most points."""
    _, first, counts = np.unique(ring, return_index=True, return_counts=True)
    best = int(counts.argmax())
    own = at[first[best] : first[best] + counts[best]]
    n = int(np.rint(np.diff(own) / period).sum())
    return float(own[-1] - own[0]) / n if n else period


class _Points(NamedTuple):
    """Points of one or more messages."""

    ring: I64
    time_s: F64
    xyz_m: F32
    intensity: F32
    record: I64

    @classmethod
    def none(cls) -> _Points:
        """No points."""
        whole = np.zeros(0, np.int64)
        return cls(whole, np.zeros(0), np.zeros((0, 3), np.float32), np.zeros(0, np.float32), whole)

    def part(self, where: NDArray[Any]) -> _Points:
        """Return some of the points."""
        return _Points(*(values[where] for values in self))

    def and_then(self, other: _Points) -> _Points:
        """Return these points and others behind them."""
        return _Points(
            np.concatenate([self.ring, other.ring]),
            np.concatenate([self.time_s, other.time_s]),
            np.concatenate([self.xyz_m, other.xyz_m]),
            np.concatenate([self.intensity, other.intensity]),
            np.concatenate([self.record, other.record]),
        )


class CloudLines:
    """Gathers messages of one scanner into blocks."""

    def __init__(self, where: str, scanner: int, first: Cloud, config: InputConfig) -> None:
        self._where, self._config = where, config
        has = np.isfinite(first.xyz_m[:, 0]) & (first.ring >= 0) & np.isfinite(first.time_s)
        if not has.any() or first.ring[has].max() >= MAX_RINGS:
            found = "no point" if not has.any() else f"ring {int(first.ring[has].max())}"
            problem = f"found {found} in the first message, expected points of rings 0 to {MAX_RINGS - 1}"
            raise InputError(where, problem, "record the scanner's own topic")
        n_rings = int(first.ring[has].max()) + 1
        self.points_per_line = next(width for width in _WIDTHS if width >= n_rings)
        timing = find_columns(first.ring[has], first.time_s[has])
        if timing is None:
            problem = "the points of a ring have one time, expected a time a point"
            raise InputError(where, problem, "let the driver write the times of the points")
        self._place, shift = _geometry(first.ring[has], timing, first.xyz_m[has], self.points_per_line)
        self.lines = ColumnLines(where, scanner, shift, config)
        self._rest = _Points.none()
        """Points of the last column: the next message may have more of it."""
        self._rest_line = 0
        self._late_s: F64 = np.zeros(MAX_RINGS)

    def add(self, cloud: Cloud, first_record: int) -> Iterator[ScanBlock]:
        """Take a message whose first record is given; yield the lines that are complete."""
        m = self.points_per_line
        use = np.flatnonzero((cloud.ring >= 0) & np.isfinite(cloud.time_s))
        if len(use) and cloud.ring[use].max() >= m:
            problem = f"found ring {int(cloud.ring[use].max())}, expected {m} rings as in the first message"
            raise InputError(self._where, problem, "record every set-up in a bag of its own")
        self.lines.count_not_fired(cloud.n_records - len(use))
        new = _Points(cloud.ring[use], cloud.time_s[use], cloud.xyz_m[use], cloud.intensity[use], use + first_record)
        points = self._rest.and_then(new)
        timing = find_columns(points.ring, points.time_s) if len(points.ring) else None
        if timing is None:
            self._rest = points
            if len(points.ring) > _MOST_WAITING:
                problem = f"the times of {len(points.ring)} points tell no columns, expected a time a firing"
                raise InputError(self._where, problem, "let the driver write the times of the points")
            return
        n, n_rest = int(timing.column.max()) + 1, len(self._rest.ring)
        if n * m > MAX_EMPTY * len(points.ring) + SPARE_CELLS:
            problem = f"{len(use)} points lie in {n} columns of {timing.period_s:.3g} s, expected many to a column"
            raise InputError(self._where, problem, "look at the times of the points")
        base = self._rest_line - (int(np.median(timing.column[:n_rest])) if n_rest else 0)
        self._late_s[: len(timing.late_s)] = timing.late_s
        last = timing.column == n - 1
        self._rest, self._rest_line = points.part(last), base + n - 1
        if n > 1:
            yield from self.lines.add(self._columns(points.part(~last), timing, timing.column[~last], base))

    def finish(self) -> Iterator[ScanBlock]:
        """Yield what waits."""
        rest = self._rest
        if len(rest.ring):
            start_s = float((rest.time_s - self._late_s[rest.ring]).min())
            timing = Timing(0.0, start_s, np.zeros(len(rest.ring), np.int64), self._late_s)
            yield from self.lines.add(self._columns(rest, timing, timing.column, self._rest_line))
            self._rest = _Points.none()
        yield from self.lines.finish()

    def _columns(self, points: _Points, timing: Timing, column: I64, base: int) -> Columns:
        """Put points into cells; the second of a cell is its further return."""
        m, n = self.points_per_line, int(column.max()) + 1
        cell = column * m + self._place[points.ring]
        order = np.argsort(cell, kind="stable")
        points, cell = points.part(order), cell[order]
        again: Mask = np.append(False, cell[1:] == cell[:-1])
        second = again & ~np.append(False, again[:-1])
        self.lines.count_not_fired(int(np.count_nonzero(again & ~second)))
        one, two = np.full((2, n * m), -1, np.intp)
        one[cell[~again]] = np.flatnonzero(~again)
        two[cell[second]] = np.flatnonzero(second)
        length = np.sqrt((points.xyz_m.astype(np.float64) ** 2).sum(axis=1)).astype(np.float32)

        def pick(values: NDArray[Any], point: NDArray[np.intp], fill: float) -> NDArray[Any]:
            found = values[point]
            found[point < 0] = fill
            return found.reshape(n, m, *values.shape[1:])

        ranges = [pick(length, point, np.nan) for point in (one, two)]
        lights = [pick(points.intensity, point, np.nan) for point in (one, two)]
        swap = choose_of_two(ranges[0], ranges[1], (lights[0], lights[1]), self._config.return_).ravel()
        own, other = np.where(swap, two, one), np.where(swap, one, two)
        late: F64 = np.zeros(m)
        late[self._place[: len(timing.late_s)]] = timing.late_s[:m]
        fired = timing.start_s + np.arange(n)[:, None] * timing.period_s + late
        time_s = pick(points.time_s, own, np.nan)
        return Columns(
            line=base + np.arange(n),
            range_m=pick(length, own, np.nan),
            record=pick(points.record, own, -1),
            time_s=np.where(np.isnan(time_s), fired, time_s),
            xyz_m=pick(points.xyz_m, own, np.nan),
            intensity=pick(points.intensity, own, np.nan),
            further_m=pick(length, other, np.nan),
            further_record=pick(points.record, other, -1),
        )


def _geometry(ring: I64, timing: Timing, xyz_m: F32, m: int) -> tuple[I64, I64]:
    """Return the place of every ring in a line, from low to high, and the shift of every place in columns."""
    x, y, z = xyz_m.astype(np.float64).T
    elevation = np.arctan2(z, np.hypot(x, y))
    present = np.unique(ring)
    middle = np.array([np.median(elevation[ring == one]) for one in present])
    every = np.interp(np.arange(m), present, middle)
    # rings beyond those seen go on the way the others go
    way = 1.0 if len(present) < 2 or middle[-1] >= middle[0] else -1.0
    every += way * 1e-6 * np.arange(m)
    order = np.argsort(every, kind="stable")
    place: I64 = np.empty(m, np.int64)
    place[order] = np.arange(m)
    return place, _stagger(ring, timing, np.arctan2(y, x), place)


def _stagger(ring: I64, timing: Timing, azimuth: F64, place: I64) -> I64:
    """Return the shift of every place in columns: how far a ring looks ahead of the fullest one."""
    column = timing.column
    fullest = int(np.bincount(ring).argmax())
    own = np.flatnonzero(ring == fullest)
    own = own[np.argsort(column[own], kind="stable")]
    steps, turned = np.diff(column[own]), _wrap(np.diff(azimuth[own]))
    near = (steps > 0) & (steps < _NEAR_COLUMNS)
    shift: I64 = np.zeros(len(place), np.int64)
    slope = float(np.median(turned[near] / steps[near])) if near.any() else 0.0
    if not slope:
        return shift
    # the nearest shot of that ring before every point
    before = own[(np.searchsorted(column[own], column, side="right") - 1).clip(0)]
    away = column - column[before]
    ahead = _wrap(azimuth - azimuth[before] - slope * away) / slope
    for one in np.unique(ring):
        use = (ring == one) & (np.abs(away) < _NEAR_COLUMNS)
        if use.any():
            # what a laser fires later, it looks ahead: that is no staggering
            late = (timing.late_s[one] - timing.late_s[fullest]) / timing.period_s
            shift[place[one]] = round(float(np.median(ahead[use])) - late)
    return shift.clip(-_MOST_SHIFT, _MOST_SHIFT)


def _wrap(angle: F64) -> F64:
    wrapped: F64 = (angle + math.pi) % _TURN - math.pi
    return wrapped
