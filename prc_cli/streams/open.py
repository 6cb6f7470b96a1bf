"""Opens an input file, or a window of it, as a stream of blocks, by the kind of its source.

Images have lines and columns and are blocks already. Records become blocks in
:mod:`prc_cli.streams.grid`, frames of rings in :mod:`prc_cli.streams.rings`. A window is some of
the lines, by number or by time, read no farther than to their end.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, cast

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.stream import Assumption, ScanBlock, ScanStream, StreamInfo, cut
from prc_cli.core.types import F64
from prc_cli.core.window import Window
from prc_cli.formats.input import Input
from prc_cli.formats.joined import JoinedInput
from prc_cli.formats.options import InputConfig, Layout
from prc_cli.formats.ranges import refuse_scale
from prc_cli.formats.records import Reading, Source
from prc_cli.formats.systems import in_metres, refuse_degrees

if TYPE_CHECKING:
    from prc_cli.streams.grid import GridStream
    from prc_cli.streams.registered.drive import Drive
    from prc_cli.streams.registered.spinning_drive import SpinningDrive


def open_input(
    scan: Input | JoinedInput,
    config: InputConfig,
    *,
    lines_at_once: int = 1,
    geometry: bool = True,
    only_ranges: bool = False,
    with_intensity: bool = False,
    checks_layers: bool = False,
) -> ScanStream:
    """Open an input, or the files of one drive, as a stream of blocks.

    With ``only_ranges`` blocks of records have no times, and intensities only ``with_intensity``.
    With ``checks_layers`` all layers of LAZ are decoded, so that damage is found.
    """
    source = scan.records()
    layout = scan.layout
    config = with_layout(config, layout)
    # times say where a window is
    only_ranges = only_ranges and (config.window is None or config.window.in_lines)
    # imported here: images do not need it and start faster
    if source is None:
        from prc_cli.streams.order import WatchedStream

        images = scan.images(config, lines_at_once=lines_at_once)
        if images.info.format not in ("array", "bag"):
            refuse_scale(config, str(scan), "its ranges are metres")
        return windowed(WatchedStream(images, config.order), config)
    implied = source.facts.rule("lines")
    if config.lines == "rings" or (
        config.lines == "auto" and implied is not None and implied.value == "rings"
    ):
        from prc_cli.streams.rings import open_rings

        return windowed(open_rings(source, config), config)
    from prc_cli.formats.clock import with_clock
    from prc_cli.streams.grid import open_grid

    source = with_clock(source, config.time_unit)
    # the blocks of joined files go on from file to file
    if config.points_per_line is not None and isinstance(scan, Input):
        multiple_of = config.points_per_line * lines_at_once
        source = source.with_reading(Reading(multiple_of=multiple_of))
    if checks_layers:
        source = source.with_reading(Reading(checks_layers=True))
    of_points = config.range.partition(":")[0] in ("points", "trajectory", "origin", "sensor-xyz")
    if of_points:
        refuse_degrees(source)
    if not of_points or config.range_scale == 1.0:
        source = in_metres(source)
    line_hz = None if layout is None else layout.line_frequency
    source, config, assumptions = _with_lines(source, config)
    grid = open_grid(
        source,
        config,
        line_hz=line_hz,
        geometry=geometry,
        only_ranges=only_ranges,
        with_intensity=with_intensity,
        assumptions=assumptions,
    )
    return windowed(grid, config)


def _with_lines(
    source: Source, config: InputConfig
) -> tuple[Source, InputConfig, tuple[Assumption, ...]]:
    """Add lines and columns found from points; return the source, its rules and assumptions."""
    if config.lines.startswith("elevation:"):
        from prc_cli.streams.rules import with_elevation

        return with_elevation(source, config)
    if config.range == "points":
        from prc_cli.streams.registered.source import with_points

        return with_points(source, config)
    if config.range.startswith(("trajectory:", "origin:")):
        from prc_cli.streams.registered.source import is_tile, with_path
        from prc_cli.streams.rules import with_sweeps

        if is_tile(source, config):
            return with_path(source, config)
        return source, *with_sweeps(source, config)
    return source, config, ()


def with_layout(config: InputConfig, layout: Layout | None) -> InputConfig:
    """Return the configuration with M from the layout, if it has none itself."""
    if layout is None or layout.points_per_line is None or config.points_per_line is not None:
        return config
    return config.model_copy(update={"points_per_line": layout.points_per_line})


def grid_of(stream: ScanStream) -> GridStream | None:
    """Return the stream of records behind a window; None for images and frames."""
    from prc_cli.streams.grid import GridStream

    inner = stream.source if isinstance(stream, WindowedStream) else stream
    return inner if isinstance(inner, GridStream) else None


def drive_of(stream: ScanStream) -> Drive | SpinningDrive | None:
    """Return the path found in a registered cloud behind a stream (``range = "points"``).

    Other inputs give None.
    """
    return cast("Drive | SpinningDrive | None", stream.info.facts.drive)


@dataclass(slots=True)
class _Part:
    """What has been taken of one scanner."""

    last_time_s: float = -math.inf
    """Time of the last line before, unknown times left out."""
    begun: bool = False
    ended: bool = False
    first: int | None = None
    stop: int = 0
    """Lines that were taken."""


@dataclass(slots=True)
class _Seen:
    """One reading of a stream."""

    origin_s: float | None = None
    low: float = math.inf
    high: float = -math.inf
    """Lines or times of all lines that were read."""
    parts: dict[int, _Part] = field(default_factory=dict)


@dataclass(slots=True)
class WindowedStream:
    """The lines of a stream that lie in a window; they keep their numbers.

    A line belongs to the window by its number, or by the time of its first shot that has one. The
    lines are consecutive: from the first one that has begun to the last before the end. Where all
    scanners have passed the end, the rest of the input is not read, except where a later scanner
    may start again (several scans in a row, or scanners split by a field with a window of lines).
    """

    source: ScanStream
    window: Window
    reads_on: bool = False
    """Other scanners may follow."""
    _seen: _Seen = field(default_factory=_Seen, init=False)

    @property
    def info(self) -> StreamInfo:
        """Metadata of the stream; the number of lines is not known before reading."""
        info = self.source.info
        note = self.note()
        facts = replace(info.facts, notes=(*info.facts.notes, *([note] if note else [])))
        return replace(info, n_lines=None, facts=facts)

    def note(self) -> str:
        """Return which lines were taken so far; empty before reading."""
        parts = [part for part in self._seen.parts.values() if part.first is not None]
        if not parts:
            return ""
        first = min(part.first or 0 for part in parts)
        stop = max(part.stop for part in parts)
        several = " of each scanner" if len(parts) > 1 else ""
        return (
            f"only lines {first:,} to {stop - 1:,}{several} were taken "
            f"({self.window.option}), as a drive of its own"
        )

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start; see :meth:`prc_cli.core.stream.ScanStream.blocks`."""
        seen = self._seen = _Seen()
        taken = False
        # closed at once, not when the collector comes by: readers have threads
        with closing(_generator(self.source.blocks())) as blocks:
            for block in blocks:
                part = self._cut(block, seen)
                if part is not None:
                    taken = True
                    yield part
                if not self.reads_on and all(cut_part.ended for cut_part in seen.parts.values()):
                    break
        if not taken:
            raise self._nothing(seen)

    def _cut(self, block: ScanBlock, seen: _Seen) -> ScanBlock | None:
        part = seen.parts.setdefault(block.scanner, _Part())
        if part.ended:
            return None
        place = self._places(block, seen, part)
        known = place[np.isfinite(place)]
        if len(known):
            seen.low, seen.high = (
                min(seen.low, float(known.min())),
                max(seen.high, float(known.max())),
            )
        low, high = self.window.bounds(0.0 if self.window.in_lines else seen.origin_s or 0.0)
        start = 0 if part.begun else _first_where(place >= low, block.n_lines)
        if start == block.n_lines:
            part.ended = bool(len(known)) and float(known[-1]) >= high
            return None
        stop = start + _first_where(place[start:] >= high, block.n_lines - start)
        part.begun = True
        part.ended = stop < block.n_lines
        if self.window.in_lines and block.first_line + stop >= high:
            part.ended = True
        if start == stop:
            return None
        part.first = block.first_line + start if part.first is None else part.first
        part.stop = block.first_line + stop
        inside = block if (start, stop) == (0, block.n_lines) else cut(block, start, stop)
        # a block's count is of what had been read with it: records of other lines too
        n_records = int(np.count_nonzero(inside.records() >= 0)) + len(inside.extra)
        tally = replace(block.tally, n_records=n_records)
        return replace(inside, is_last=block.is_last or part.ended, tally=tally)

    def _places(self, block: ScanBlock, seen: _Seen, part: _Part) -> F64:
        """Return the number or the time of every line, (lines,).

        A line without time has the time of the line before.
        """
        lines = np.arange(block.first_line, block.first_line + block.n_lines, dtype=np.float64)
        if self.window.in_lines:
            return lines
        if block.time_s is None:
            line_hz = self.source.info.line_hz
            if line_hz is None:
                raise no_times(self.source.info.path, self.window)
            seen.origin_s = 0.0
            return lines / line_hz
        known = np.isfinite(block.time_s)
        first = np.argmax(known, axis=1)
        line = np.arange(block.n_lines)
        time_s = np.where(known.any(axis=1), block.time_s[line, first], -np.inf)
        if seen.origin_s is None and np.isfinite(time_s).any():
            seen.origin_s = float(time_s[np.isfinite(time_s)][0])
        # the last known one before; a single step back does not lead out of the window
        filled = np.where(np.isfinite(time_s), line, -1)
        last = np.maximum.accumulate(filled)
        time_s = np.where(last >= 0, time_s[np.maximum(last, 0)], part.last_time_s)
        part.last_time_s = float(time_s[-1])
        return time_s

    def _nothing(self, seen: _Seen) -> InputError:
        what = "scan lines" if self.window.in_lines else "times"
        if not math.isfinite(seen.low):
            if not self.window.in_lines and seen.parts:
                return no_times(self.source.info.path, self.window)
            return InputError(
                self.source.info.path, "no scan lines, expected at least one", "see prc info"
            )
        shown = (
            (f"{seen.low:.0f}", f"{seen.high:.0f}")
            if self.window.in_lines
            else (f"{seen.low!r}", f"{seen.high!r}")
        )
        problem = (
            f"found {what} from {shown[0]} to {shown[1]}, expected some in {self.window.option}"
        )
        hint = (
            "choose lines that it has"
            if self.window.in_lines
            else "choose times that it has, or +A:+B from the first"
        )
        return InputError(self.source.info.path, problem, hint)


def _generator(blocks: Iterator[ScanBlock]) -> Generator[ScanBlock]:
    yield from blocks


def _first_where(is_there: np.ndarray, default: int) -> int:
    """Return the first index where it is true, else the default."""
    return int(np.argmax(is_there)) if is_there.any() else default


def no_times(path: str, window: Window) -> InputError:
    """Return the error of an input whose times are not known."""
    problem = (
        f"found neither times of the shots nor a line frequency, expected them for {window.option}"
    )
    hint = "give lines instead, --first 500lines or --only-lines A:B, or [layout] line_frequency"
    return InputError(path, problem, hint)


def windowed(stream: ScanStream, config: InputConfig) -> ScanStream:
    """Return the configured window of a stream.

    Without a window, return the stream itself.
    """
    window = config.window
    if window is None:
        return stream
    split = config.scanner != "none" and window.in_lines
    return WindowedStream(stream, window, reads_on=split or stream.info.facts.has_scans)
