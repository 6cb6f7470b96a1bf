"""Read ``sensor_msgs/LaserScan`` and ``MultiEchoLaserScan``.

a message is a scan line or part of one.

Motors turn unevenly: the number of beams, their step and the first angle change from message to
message. Some scanners send a line in parts. All beams lie on one grid of angles, which the first
messages show.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ExtraReturns, ReadTally, ScanBlock
from prc_cli.core.types import F32, F64, I64, Mask
from prc_cli.formats.bags.messages import Cursor, expect
from prc_cli.formats.options import InputConfig
from prc_cli.formats.organised.scans import MAX_POINTS_PER_LINE, lines_per_block
from prc_cli.formats.ranges import choose_returns, clean_ranges

LASER = "sensor_msgs/LaserScan"
ECHOES = "sensor_msgs/MultiEchoLaserScan"
MAX_ECHOES = 64
"""Most echoes of a beam."""
_NEAR = 0.25
_SAME = 1e-3
"""Tolerances for the first angle and the step of messages with the same beams, in steps."""
_OTHER_STEP = 1.2
"""Steps that differ by this factor are those of another set-up."""
_LEAST_INSIDE = 0.5
"""Share of the beams of a message that must have a column."""
_SHARED_BEAMS = 3
"""Parts of a line may share fewer beams."""
_ONE_SET_UP = "record every set-up in a bag of its own"


@dataclass(frozen=True, slots=True)
class LaserScan:
    """A message, decoded."""

    stamp_s: float
    """Time of the first beam [s]."""
    frame: str
    angle_min_rad: float
    angle_step_rad: float
    shot_s: float
    """Time between beams [s]."""
    range_m: F32
    """(echoes,) float32, echoes of the beams one after the other [m]; NaN = none."""
    intensity: F32
    """(echoes,) float32, or empty."""
    n_echoes: I64 | None
    """(M,) int64, echoes of every beam; None = one each."""
    n_beyond: int
    """Echoes out of the scanner's own range."""

    @property
    def points_per_line(self) -> int:
        """M, beams of the message."""
        return len(self.range_m) if self.n_echoes is None else len(self.n_echoes)

    @property
    def n_records(self) -> int:
        """Records of the message: its echoes, and one for every beam without any."""
        return (
            len(self.range_m) if self.n_echoes is None else int(np.maximum(self.n_echoes, 1).sum())
        )


def parse_laser(
    data: bytes,
    *,
    is_cdr: bool,
    is_multi: bool,
    scale: float = 1.0,
) -> LaserScan:
    """Decode a message whose ranges are in a unit [m]."""
    cursor = Cursor(data, is_cdr=is_cdr)
    stamp_s, frame = cursor.header()
    first, _, step, shot_s, _, low, high = cursor.numbers("f", 7)
    angles = f"angle_min {first:g}, angle_increment {step:g}, time_increment {shot_s:g}"
    expect(math.isfinite(first + step + shot_s) and step != 0, f"{angles}, expected finite numbers")
    if not is_multi:
        ranges = cursor.array("f4")
        n_echoes = None
        intensity = cursor.array("f4")
    else:
        ranges, n_echoes = read_echoes(cursor)
        intensity, n_of = read_echoes(cursor, n_echoes)
        if not np.array_equal(n_of, n_echoes):
            intensity = np.empty(0, np.float32)
    m = len(ranges) if n_echoes is None else len(n_echoes)
    expect(1 <= m <= MAX_POINTS_PER_LINE, f"holds {m} ranges, expected 1 to {MAX_POINTS_PER_LINE}")
    if len(intensity) != len(ranges):
        intensity = np.empty(0, np.float32)
    # copies: the message may be much longer than what is kept of it
    ranges = ranges.astype(np.float32)
    intensity = intensity.astype(np.float32)
    with np.errstate(invalid="ignore"):
        # scanners write inf, or a range beyond their reach, for no return
        is_beyond = np.isfinite(ranges) & ((ranges < low) | (ranges >= high))
    ranges[is_beyond | np.isinf(ranges)] = np.nan
    if scale != 1.0:
        ranges *= np.float32(scale)
    n_beyond = int(np.count_nonzero(is_beyond))
    return LaserScan(stamp_s, frame, first, step, shot_s, ranges, intensity, n_echoes, n_beyond)


def read_echoes(cursor: Cursor, likely: I64 | None = None) -> tuple[F32, I64]:
    """Read a list of lists; return their values in a row, and the length of every list.

    ``likely`` are expected lengths, which save the search for the lists.
    """
    n = cursor.number("I")
    expect(n <= len(cursor.data) // 4, f"says it holds {n} beams, which it is too short for")
    words = cursor.rest("u4")[: n * (1 + MAX_ECHOES)]
    starts = np.empty(0, np.int64) if likely is None else np.cumsum(likely + 1) - (likely + 1)
    if len(starts) != n or not n or starts[-1] >= len(words) or (words[starts] != likely).any():
        starts = _starts(words, n)
    counts = words[starts[starts < len(words)]].astype(np.int64)
    most = int(counts.max(initial=0))
    is_whole = len(counts) == n and (not n or starts[-1] + counts[-1] < len(words))
    problem = f"holds {most} echoes of a beam, expected at most {MAX_ECHOES} and no more bytes"
    expect(is_whole and most <= MAX_ECHOES, problem)
    is_value: Mask = np.ones(n + int(counts.sum()), np.bool_)
    is_value[starts] = False
    cursor.position += 4 * len(is_value)
    values: F32 = words.view(words.dtype.str.replace("u", "f"))[: len(is_value)][is_value].astype(
        np.float32
    )
    return values, counts


def _starts(words: NDArray[np.uint32], n: int) -> I64:
    """Return the first words of consecutive lists, each behind its length, (n,) int64.

    A list that begins behind the last word has the number of words. If all small words fit as
    lengths, they are the lengths. Otherwise (values may be zeros) the steps to the next list are
    computed for all words at once, then the steps to the second next, the fourth next and so on.

    >>> _starts(np.array([2, 7, 8, 0, 1, 9], np.uint32), 3).tolist()
    [0, 3, 4]
    """
    likely = np.flatnonzero(words <= MAX_ECHOES)[:n]
    if (
        len(likely) == n
        and n
        and likely[0] == 0
        and (np.diff(likely) == words[likely[:-1]] + np.uint32(1)).all()
    ):
        return likely
    end = len(words)
    after = np.arange(1, end + 1) + np.minimum(words, MAX_ECHOES + 1)
    after = np.append(np.minimum(after, end), end)
    starts: I64 = np.zeros(min(n, 1), np.int64)
    while len(starts) < n:
        starts = np.append(starts, after[starts])
        after = after[after]
    return starts[:n]


@dataclass(frozen=True, slots=True)
class BeamGrid:
    """Angles of the columns, which the first messages of a scanner show."""

    start_rad: float
    step_rad: float
    n: int
    is_plain: bool
    """Whether each message has exactly these beams."""

    @classmethod
    def of(cls, scans: list[LaserScan]) -> BeamGrid:
        """Return the finest grid through the first message's angles that has all beams."""
        steps = np.array([scan.angle_step_rad for scan in scans])
        usual = float(np.median(steps))
        scans = [
            scan for scan in scans if 1 / _OTHER_STEP < scan.angle_step_rad / usual < _OTHER_STEP
        ]
        steps = np.array([scan.angle_step_rad for scan in scans])
        way = math.copysign(1.0, usual)
        step = way * float(np.abs(steps).min())
        first = scans[0]
        begins = np.rint([(scan.angle_min_rad - first.angle_min_rad) / step for scan in scans])
        spans = np.rint([(scan.points_per_line - 1) * scan.angle_step_rad / step for scan in scans])
        begin = int(begins.min())
        n = int((begins + spans).max()) - begin + 1
        start = first.angle_min_rad + begin * step
        grid = cls(start, step, max(n, 1), True)
        return replace(grid, is_plain=all(grid.has_just(scan) for scan in scans))

    def has_just(self, scan: LaserScan) -> bool:
        """Return whether a message has exactly these beams."""
        near = abs(scan.angle_min_rad - self.start_rad) <= _NEAR * abs(self.step_rad)
        return near and self._has_step(scan) and scan.points_per_line == self.n

    def _has_step(self, scan: LaserScan) -> bool:
        return abs(scan.angle_step_rad - self.step_rad) <= _SAME * abs(self.step_rad)

    def columns(self, scan: LaserScan) -> I64:
        """Return the column of every beam of a message, (beams,) int64; -1 = none."""
        begin = (scan.angle_min_rad - self.start_rad) / self.step_rad
        beam = np.arange(scan.points_per_line)
        if self._has_step(scan):
            columns = round(begin) + beam
        else:
            columns = np.rint(begin + beam * (scan.angle_step_rad / self.step_rad)).astype(np.int64)
        is_cell = (columns >= 0) & (columns < self.n)
        is_cell[1:] &= columns[1:] != columns[:-1]
        placed: I64 = np.where(is_cell, columns, -1).astype(np.int64)
        return placed


class _Beams(NamedTuple):
    """Beams of some messages, with their further echoes."""

    range_m: F32
    """(beams,) float32 [m]; NaN = no return."""
    intensity: F32 | None
    """(beams,) float32."""
    record: I64
    """(beams,) int64."""
    further_beam: I64
    """(echoes,) int64, beam of every further echo."""
    further_m: F32
    """(echoes,) float32 [m]."""
    further_record: I64
    """(echoes,) int64."""


@dataclass(slots=True)
class _Part:
    """A message that waits for its block."""

    scan: LaserScan
    first_record: int
    columns: I64
    """(beams,) int64, -1 = none."""
    line: int
    """Number of its line since the first waiting message."""


class LaserLines:
    """Gathers messages of one scanner into blocks: a message is a line, or a part of one."""

    def __init__(
        self,
        where: str,
        scanner: int,
        first_scans: Callable[[], list[LaserScan]],
        config: InputConfig,
    ) -> None:
        self._where = where
        self._scanner = scanner
        self._config = config
        scans = first_scans()
        self.has_returns = scans[0].n_echoes is not None
        self._grid = BeamGrid.of(scans)
        self._usual_step = float(np.median([scan.angle_step_rad for scan in scans]))
        self.is_plain = self._grid.is_plain
        """Whether every message is a line of its own, with all beams."""
        self.points_per_line = self._grid.n
        if self.points_per_line > MAX_POINTS_PER_LINE:
            angles = f"angle_min from {min(scan.angle_min_rad for scan in scans):g} to "
            angles += (
                f"{max(scan.angle_min_rad for scan in scans):g} in steps of {self._grid.step_rad:g}"
            )
            raise InputError(where, f"found {angles}, expected scans of one scanner", _ONE_SET_UP)
        column = np.arange(self.points_per_line, dtype=np.float64)
        self.angle_rad: F64 = self._grid.start_rad + self._grid.step_rad * column
        self._waiting: list[_Part] = []
        self._n_lines = self._n_messages = 0
        self._enough = lines_per_block(self.points_per_line)

    def add(self, scan: LaserScan, first_record: int) -> Iterator[ScanBlock]:
        """Take a message whose first record is given.

        Yield a block when there is enough for one.
        """
        columns = self._grid.columns(scan)
        self._check(scan, columns)
        self._n_messages += 1
        inside = columns[columns >= 0]
        part = _Part(scan, first_record, columns, 0)
        if self._waiting:
            before = self._waiting[-1]
            part.line = before.line + (0 if _continues(before.columns, inside) else 1)
        # the last line may go on
        if part.line >= self._enough:
            yield self._block(self._waiting)
            self._n_lines += part.line
            self._waiting = []
            part.line = 0
        self._waiting.append(part)

    def _check(self, scan: LaserScan, columns: I64) -> None:
        usual = self._usual_step
        beams = ""
        expected = ""
        if not 1 / _OTHER_STEP < scan.angle_step_rad / usual < _OTHER_STEP:
            beams = f"angle_increment {scan.angle_step_rad:g}"
            expected = f"about {usual:g} as usual"
        elif np.count_nonzero(columns >= 0) < _LEAST_INSIDE * len(columns):
            stop = scan.angle_min_rad + scan.angle_step_rad * (len(columns) - 1)
            beams = f"beams from {scan.angle_min_rad:g} to {stop:g}"
            expected = f"{self.angle_rad[0]:g} to {self.angle_rad[-1]:g} as in the first messages"
        if beams:
            where = f"{self._where}: message {self._n_messages}"
            raise InputError(where, f"found {beams}, expected {expected}", _ONE_SET_UP)

    def finish(self) -> Iterator[ScanBlock]:
        """Yield what waits."""
        if self._waiting:
            yield self._block(self._waiting)
            self._n_lines += self._waiting[-1].line + 1
            self._waiting = []

    def lost(self) -> str:
        """Return how messages became lines; empty if each is a line of its own."""
        if self.is_plain or not self._n_messages:
            return ""
        parts = self._n_messages / max(self._n_lines, 1)
        if parts > 1.5:
            return f"{parts:.3g} messages are a line of {self.points_per_line} beams"
        n_angles = self.points_per_line
        return f"the number of beams or the first angle changes: one grid of {n_angles} angles"

    def _block(self, parts: list[_Part]) -> ScanBlock:
        scans = [part.scan for part in parts]
        n = parts[-1].line + 1
        m = self.points_per_line
        first = np.array([part.first_record for part in parts], np.int64)
        beams = self._echoes(scans, first) if self.has_returns else self._single(scans, first)
        line = np.repeat([part.line for part in parts], [len(part.columns) for part in parts])
        column = np.concatenate([part.columns for part in parts])
        stamps = np.concatenate(
            [part.scan.stamp_s + part.scan.shot_s * np.arange(len(part.columns)) for part in parts]
        )
        cell = np.where(column >= 0, line * m + column, -1)
        is_first: Mask = cell >= 0
        if not (np.diff(cell) > 0).all():
            # parts of a line that overlap: the first one has the cell
            _, first_of = np.unique(cell, return_index=True)
            is_first = np.zeros(len(cell), np.bool_)
            is_first[first_of] = True
            is_first &= cell >= 0
        n_unplaced = int(np.count_nonzero(cell < 0))
        n_meet = int(np.count_nonzero(~is_first & (cell >= 0)))
        has_column = cell[beams.further_beam] >= 0
        shared = np.flatnonzero(~is_first & (cell >= 0) & np.isfinite(beams.range_m))
        cells = np.concatenate([cell[beams.further_beam[has_column]], cell[shared]])
        extra = ExtraReturns(
            (cells // m).astype(np.int32),
            (cells % m).astype(np.int32),
            np.concatenate([beams.further_m[has_column], beams.range_m[shared]]),
            np.concatenate([beams.further_record[has_column], beams.record[shared]]),
        )

        def scattered(values: NDArray[Any], fill: float) -> NDArray[Any]:
            grid = np.full(n * m, fill, values.dtype)
            grid[cell[is_first]] = values[is_first]
            return grid.reshape(n, m)

        cleaned, tally = clean_ranges(
            scattered(beams.range_m, np.nan), self._config.min_range, self._config.max_range
        )
        intensity = None if beams.intensity is None else scattered(beams.intensity, np.nan)
        if intensity is not None:
            intensity[np.isnan(cleaned)] = np.nan
        time_s = scattered(stamps, np.nan)
        if np.isnan(time_s).any():
            time_s = _filled_times(time_s, float(np.median([scan.shot_s for scan in scans])))
        counted = ReadTally(
            n_records=sum(scan.n_records for scan in scans),
            n_beyond=sum(scan.n_beyond for scan in scans),
            n_extra_returns=len(extra) - n_meet,
            n_collisions=n_meet,
            n_unplaced=n_unplaced,
        )
        return ScanBlock(
            first_line=self._n_lines,
            range_m=cleaned,
            record=scattered(beams.record, -1),
            scanner=self._scanner,
            time_s=time_s,
            intensity=intensity,
            angle_rad=self.angle_rad,
            extra=extra,
            tally=tally + counted,
        )

    def _single(self, scans: list[LaserScan], first: I64) -> _Beams:
        intensity = None
        if all(len(scan.intensity) for scan in scans):
            intensity = np.concatenate([scan.intensity for scan in scans])
        ranges = np.concatenate([scan.range_m for scan in scans])
        n_of = np.array([scan.n_records for scan in scans])
        record = np.arange(len(ranges)) + np.repeat(first - (np.cumsum(n_of) - n_of), n_of)
        none = np.empty(0, np.int64)
        return _Beams(ranges, intensity, record, none, np.empty(0, np.float32), none)

    def _echoes(self, scans: list[LaserScan], first: I64) -> _Beams:
        counts = np.concatenate([scan.n_echoes for scan in scans if scan.n_echoes is not None])
        held = np.maximum(counts, 1)
        begins: Mask = np.zeros(int(held.sum()), np.bool_)
        begins[np.cumsum(held) - held] = True
        # a beam without an echo holds a place
        is_echo = np.repeat(counts > 0, held)

        def spread(values: list[F32]) -> F32:
            spread: F32 = np.full(len(begins), np.nan, np.float32)
            spread[is_echo] = np.concatenate(values)
            return spread

        flat = spread([scan.range_m for scan in scans])
        flat[flat <= 0] = np.nan
        lit = None
        if all(len(scan.intensity) or not len(scan.range_m) for scan in scans):
            lit = spread([scan.intensity for scan in scans])
        is_main = choose_returns(begins, flat, lit, None, self._config.return_)
        n_of = np.array([scan.n_records for scan in scans])
        record = np.arange(len(flat)) + np.repeat(first - (np.cumsum(n_of) - n_of), n_of)
        others = np.flatnonzero(~is_main & ~np.isnan(flat))
        beam = (np.cumsum(begins) - 1)[others]
        main_echo = np.flatnonzero(is_main)
        return _Beams(
            range_m=flat[main_echo],
            intensity=None if lit is None else lit[main_echo],
            record=record[main_echo],
            further_beam=beam,
            further_m=flat[others],
            further_record=record[others],
        )


def _continues(before: I64, columns: I64) -> bool:
    """Return whether beams continue the line of the message before."""
    known = before[before >= 0]
    if not len(known) or not len(columns):
        return True
    begin = int(known.min())
    stop = int(known.max())
    return int(columns.min()) > max(stop - _SHARED_BEAMS, (begin + stop) / 2)


def _filled_times(time_s: F64, shot_s: float) -> F64:
    """Return times, (lines, M) float64 [s], also of cells without a beam, ``shot_s`` a column."""
    flat = time_s.copy()
    column = np.arange(flat.shape[1])
    known = np.isfinite(flat)
    last = np.maximum.accumulate(np.where(known, column, -1), axis=1)
    first = known.argmax(axis=1)
    source = np.where(last >= 0, last, first[:, None])
    rows = np.arange(len(flat))[:, None]
    filled: F64 = np.where(known, flat, flat[rows, source] + (column - source) * shot_s)
    return filled
