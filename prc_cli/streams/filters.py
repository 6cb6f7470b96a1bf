"""Filters of a stream: the order of the times of images, and the lines in a window.

Directions of beams are added in :mod:`prc_cli.streams.beams`, and the checks of the input are made
in :mod:`prc_cli.streams.evidence.watch`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.stream import ScanBlock, StreamInfo, cut
from prc_cli.core.threads import closing_items
from prc_cli.core.types import F64
from prc_cli.core.window import Window
from prc_cli.formats.options import InputConfig
from prc_cli.streams.order import OrderWatch, Policy, take_turns
from prc_cli.streams.stream import Stream


def ordered(stream: Stream, policy: Policy) -> Stream:
    """Check the order of the times of images, which cannot be sorted."""

    def checked(blocks: Iterator[ScanBlock]) -> Iterator[ScanBlock]:
        info = stream.info
        watches: dict[int, OrderWatch] = {}
        for block in blocks:
            if block.time_s is None:
                yield block
                continue
            # scanners of one file have clocks of their own
            watch = watches.setdefault(
                block.scanner, OrderWatch(info.path, policy, info.facts.time_name, can_sort=False)
            )
            if info.facts.has_line_times or take_turns(block):
                stop = block.first_line + block.n_lines
                lines = np.arange(block.first_line, stop, dtype=np.int64)
                tally = watch.count(block.time_s[:, 0], lines * block.points_per_line)
            else:
                tally = watch.count(block.time_s.ravel(), None)
            yield replace(block, tally=block.tally + tally)
        for watch in watches.values():
            watch.finish()

    return stream.through(checked)


def windowed(stream: Stream, config: InputConfig) -> Stream:
    """Take the lines in the configured window; they keep their numbers.

    A line belongs to the window by its number, or by the time of its first shot that has one. The
    lines are consecutive: from the first one that has begun to the last before the end. Where all
    scanners have passed the end, the rest of the input is not read, except where a later scanner
    may start again (several scans in a row, or scanners split by a field with a window of lines).
    """
    window = config.window
    if window is None:
        return stream
    is_split = config.scanner != "none" and window.in_lines
    others_follow = is_split or stream.info.facts.has_scans

    def inside(blocks: Iterator[ScanBlock]) -> Iterator[ScanBlock]:
        reading = _WindowReading(window, stream.info)
        lines = stream.observed.lines
        lines.clear()
        # closed at once, not when the collector comes by: readers have threads
        with closing_items(blocks):
            for block in blocks:
                part = reading.cut(block)
                if part is not None:
                    first = lines.get(part.scanner, range(part.first_line, 0)).start
                    lines[part.scanner] = range(first, part.first_line + part.n_lines)
                    yield part
                if reading.has_ended and not others_follow:
                    break
        if not lines:
            raise reading.nothing()

    return replace(stream.through(inside), window=window)


@dataclass(slots=True)
class _Scanner:
    """How far the lines of one scanner were read."""

    last_time_s: float = -math.inf
    """Time of the last line before, unknown times left out."""
    has_begun: bool = False
    has_ended: bool = False


@dataclass(slots=True)
class _WindowReading:
    """One reading of the lines in a window."""

    window: Window
    info: StreamInfo
    origin_s: float | None = None
    low: float = math.inf
    high: float = -math.inf
    """Lines or times of all lines that were read."""
    scanners: dict[int, _Scanner] = field(default_factory=dict)

    @property
    def has_ended(self) -> bool:
        """Whether all scanners have passed the end of the window."""
        return all(scanner.has_ended for scanner in self.scanners.values())

    def cut(self, block: ScanBlock) -> ScanBlock | None:
        """Return the lines of the next block that are in the window; None without any."""
        window = self.window
        scanner = self.scanners.setdefault(block.scanner, _Scanner())
        if scanner.has_ended:
            return None
        place = self._places(block, scanner)
        known = place[np.isfinite(place)]
        if len(known):
            self.low = min(self.low, float(known.min()))
            self.high = max(self.high, float(known.max()))
        low, high = window.bounds(0.0 if window.in_lines else self.origin_s or 0.0)
        start = 0 if scanner.has_begun else _first_where(place >= low, block.n_lines)
        if start == block.n_lines:
            scanner.has_ended = bool(len(known)) and float(known[-1]) >= high
            return None
        stop = start + _first_where(place[start:] >= high, block.n_lines - start)
        scanner.has_begun = True
        scanner.has_ended = stop < block.n_lines
        if window.in_lines and block.first_line + stop >= high:
            scanner.has_ended = True
        if start == stop:
            return None
        inside = block if (start, stop) == (0, block.n_lines) else cut(block, start, stop)
        # a block's count is of what had been read with it: records of other lines too
        n_records = int(np.count_nonzero(inside.records() >= 0)) + len(inside.extra)
        tally = replace(block.tally, n_records=n_records)
        return replace(inside, is_last=block.is_last or scanner.has_ended, tally=tally)

    def _places(self, block: ScanBlock, scanner: _Scanner) -> F64:
        """Return the number or the time of every line, (lines,).

        A line without time has the time of the line before.
        """
        lines = np.arange(block.first_line, block.first_line + block.n_lines, dtype=np.float64)
        if self.window.in_lines:
            return lines
        if block.time_s is None:
            if self.info.line_hz is None:
                raise no_times(self.info.path, self.window)
            self.origin_s = 0.0
            return lines / self.info.line_hz
        known = np.isfinite(block.time_s)
        first = np.argmax(known, axis=1)
        line = np.arange(block.n_lines)
        time_s = np.where(known.any(axis=1), block.time_s[line, first], -np.inf)
        if self.origin_s is None and np.isfinite(time_s).any():
            self.origin_s = float(time_s[np.isfinite(time_s)][0])
        # the last known one before; a single step back does not lead out of the window
        filled = np.where(np.isfinite(time_s), line, -1)
        last = np.maximum.accumulate(filled)
        time_s = np.where(last >= 0, time_s[np.maximum(last, 0)], scanner.last_time_s)
        scanner.last_time_s = float(time_s[-1])
        return time_s

    def nothing(self) -> InputError:
        """Return the error of a window without lines."""
        path = self.info.path
        if not math.isfinite(self.low):
            if not self.window.in_lines and self.scanners:
                return no_times(path, self.window)
            return InputError(path, "no scan lines, expected at least one", "see prc info")
        if self.window.in_lines:
            shown = f"scan lines from {self.low:.0f} to {self.high:.0f}"
            hint = "choose lines that it has"
        else:
            shown = f"times from {self.low!r} to {self.high!r}"
            hint = "choose times that it has, or +A:+B from the first"
        problem = f"found {shown}, expected some in {self.window.option}"
        return InputError(path, problem, hint)


def _first_where(is_there: np.ndarray, default: int) -> int:
    """Return the first index where it is true, else the default."""
    return int(np.argmax(is_there)) if is_there.any() else default


def no_times(path: str, window: Window) -> InputError:
    """Return the error of an input whose times are not known."""
    problem = (
        f"found neither times of the shots nor a line frequency, expected them for {window.option}"
    )
    hint = "give lines instead, --only 500lines or --only 200:300, or [layout] line_frequency"
    return InputError(path, problem, hint)
