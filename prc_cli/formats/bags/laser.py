"""``sensor_msgs/LaserScan`` and ``MultiEchoLaserScan``: a message is a scan line."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ExtraReturns, ReadTally, ScanBlock
from prc_cli.core.types import F32, F64, I64, Mask
from prc_cli.formats.bags.messages import Cursor, expect
from prc_cli.formats.options import InputConfig
from prc_cli.formats.organised.scans import MAX_POINTS_PER_LINE, lines_per_block
from prc_cli.formats.ranges import choose_returns, clean_ranges

LASER, ECHOES = "sensor_msgs/LaserScan", "sensor_msgs/MultiEchoLaserScan"
MAX_ECHOES = 64
"""Most echoes of a beam."""
_NEAR, _SAME = 0.25, 1e-3
"""Tolerances for the first angle and the step of later messages, in steps."""


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
        return len(self.range_m) if self.n_echoes is None else int(np.maximum(self.n_echoes, 1).sum())


def parse_laser(data: bytes, *, is_cdr: bool, is_multi: bool) -> LaserScan:
    """Decode a message."""
    cursor = Cursor(data, is_cdr=is_cdr)
    stamp_s, frame = cursor.header()
    first, _, step, shot_s, _, low, high = cursor.numbers("f", 7)
    found = f"angle_min {first:g}, angle_increment {step:g}, time_increment {shot_s:g}"
    expect(math.isfinite(first + step + shot_s) and step != 0, f"{found}, expected finite numbers")
    if not is_multi:
        ranges, n_echoes = cursor.array("f4"), None
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
    ranges, intensity = ranges.astype(np.float32), intensity.astype(np.float32)
    with np.errstate(invalid="ignore"):
        # a scanner says by inf, or by its own reach, that nothing came back
        is_beyond = np.isfinite(ranges) & ((ranges < low) | (ranges >= high))
    ranges[is_beyond | np.isinf(ranges)] = np.nan
    n_beyond = int(np.count_nonzero(is_beyond))
    return LaserScan(stamp_s, frame, first, step, shot_s, ranges, intensity, n_echoes, n_beyond)


def read_echoes(cursor: Cursor, likely: I64 | None = None) -> tuple[F32, I64]:
    """Read a list of lists, of lengths that are likely; return their values in a row, and their lengths."""
    n = cursor.number("I")
    expect(n <= len(cursor.data) // 4, f"says it holds {n} beams, which it is too short for")
    words = cursor.rest("u4")[: n * (1 + MAX_ECHOES)]
    starts = np.empty(0, np.int64) if likely is None else np.cumsum(likely + 1) - (likely + 1)
    if len(starts) != n or not n or starts[-1] >= len(words) or (words[starts] != likely).any():
        starts = _starts(words, n)
    counts = words[starts[starts < len(words)]].astype(np.int64)
    found, most = f"holds {counts.max(initial=0)} echoes of a beam", f"at most {MAX_ECHOES}, and no more than there are"
    is_whole = len(counts) == n and (not n or starts[-1] + counts[-1] < len(words))
    expect(is_whole and counts.max(initial=0) <= MAX_ECHOES, f"{found}, expected {most}")
    is_value: Mask = np.ones(n + int(counts.sum()), np.bool_)
    is_value[starts] = False
    cursor.at += 4 * len(is_value)
    values: F32 = words.view(words.dtype.str.replace("u", "f"))[: len(is_value)][is_value].astype(np.float32)
    return values, counts


def _starts(words: NDArray[np.uint32], n: int) -> I64:
    """Return where lists begin that follow each other, each behind its length; the number of words beyond the end.

    Words that are as small as a length are lengths, where the lists then follow each other. Else, as for values of
    zero, the way to the next list is followed for all words at once, then twice as far, and so on.

    >>> _starts(np.array([2, 7, 8, 0, 1, 9], np.uint32), 3).tolist()
    [0, 3, 4]
    """
    likely = np.flatnonzero(words <= MAX_ECHOES)[:n]
    if len(likely) == n and n and likely[0] == 0 and (np.diff(likely) == words[likely[:-1]] + np.uint32(1)).all():
        return likely
    end = len(words)
    after = np.arange(1, end + 1) + np.minimum(words, MAX_ECHOES + 1)
    after = np.append(np.minimum(after, end), end)
    starts: I64 = np.zeros(min(n, 1), np.int64)
    while len(starts) < n:
        starts = np.append(starts, after[starts])
        after = after[after]
    return starts[:n]


class LaserLines:
    """Gathers messages of one scanner into blocks."""

    def __init__(self, where: str, scanner: int, first: LaserScan, config: InputConfig) -> None:
        self._where, self._scanner, self._config = where, scanner, config
        self.points_per_line = first.points_per_line
        self.has_returns = first.n_echoes is not None
        self._first = (first.angle_min_rad, first.angle_step_rad)
        column = np.arange(self.points_per_line, dtype=np.float64)
        self.angle_rad: F64 = first.angle_min_rad + first.angle_step_rad * column
        self._waiting: list[tuple[LaserScan, int]] = []
        self._n_lines = 0
        self._enough = lines_per_block(self.points_per_line)

    def add(self, scan: LaserScan, first_record: int) -> Iterator[ScanBlock]:
        """Take a message whose first record is given; yield a block when there is enough for one."""
        m, (start, step) = self.points_per_line, self._first
        near = abs(scan.angle_min_rad - start) <= _NEAR * abs(step)
        near &= abs(scan.angle_step_rad - step) <= _SAME * abs(step)
        if scan.points_per_line != m or not near:
            found, wanted = f"{scan.points_per_line} ranges", str(m)
            if scan.points_per_line == m:
                found = f"angle_min {scan.angle_min_rad:g} and angle_increment {scan.angle_step_rad:g}"
                wanted = f"{start:g} and {step:g}"
            where = f"{self._where}: message {self._n_lines + len(self._waiting)}"
            problem = f"found {found}, expected {wanted} as in the first message"
            raise InputError(where, problem, "record every set-up in a bag of its own")
        self._waiting.append((scan, first_record))
        if len(self._waiting) == self._enough:
            yield from self.finish()

    def finish(self) -> Iterator[ScanBlock]:
        """Yield what waits."""
        if self._waiting:
            yield self._block()
            self._n_lines += len(self._waiting)
            self._waiting = []

    def lost(self) -> str:
        """Return what is lacking: nothing, a scan that was not recorded leaves no gap."""
        return ""

    def _block(self) -> ScanBlock:
        scans = [scan for scan, _ in self._waiting]
        m = self.points_per_line
        first = np.array([record for _, record in self._waiting], np.int64)
        ranges, intensity, record, extra = (self._echoes if self.has_returns else self._single)(scans, first)
        cleaned, tally = clean_ranges(ranges, self._config.min_range, self._config.max_range)
        if intensity is not None:
            intensity[np.isnan(cleaned)] = np.nan
        stamps, steps = (np.array([getattr(scan, name) for scan in scans])[:, None] for name in ("stamp_s", "shot_s"))
        counted = ReadTally(
            n_records=sum(scan.n_records for scan in scans),
            n_beyond=sum(scan.n_beyond for scan in scans),
            n_extra_returns=len(extra),
        )
        return ScanBlock(
            first_line=self._n_lines,
            range_m=cleaned,
            record=record,
            scanner=self._scanner,
            time_s=stamps + steps * np.arange(m),
            intensity=intensity,
            angle_rad=self.angle_rad,
            extra=extra,
            tally=tally + counted,
        )

    def _single(self, scans: list[LaserScan], first: I64) -> tuple[F32, F32 | None, I64, ExtraReturns]:
        """Return range, intensity and record of every cell, and no further echoes."""
        lit = np.stack([scan.intensity for scan in scans]) if all(len(scan.intensity) for scan in scans) else None
        ranges = np.stack([scan.range_m for scan in scans])
        return ranges, lit, first[:, None] + np.arange(self.points_per_line), ExtraReturns.none()

    def _echoes(self, scans: list[LaserScan], first: I64) -> tuple[F32, F32 | None, I64, ExtraReturns]:
        """Return range, intensity and record of every cell, and the further echoes."""
        n, m = len(scans), self.points_per_line
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
        stands = choose_returns(begins, flat, lit, None, self._config.return_)
        n_of = np.array([scan.n_records for scan in scans])
        record = np.arange(len(flat)) + np.repeat(first - (np.cumsum(n_of) - n_of), n_of)
        others = np.flatnonzero(~stands & ~np.isnan(flat))
        cell = (np.cumsum(begins) - 1)[others]
        extra = ExtraReturns((cell // m).astype(np.int32), (cell % m).astype(np.int32), flat[others], record[others])
        own = np.flatnonzero(stands)
        intensity = None if lit is None else lit[own].reshape(n, m)
        return flat[own].reshape(n, m), intensity, record[own].reshape(n, m), extra
