"""Several files of one drive, in order, as one list of records.

A scan line that is cut by the end of a file goes on in the next one.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.stream import ScanStream
from prc_cli.formats.input import Input
from prc_cli.formats.options import InputConfig, Layout
from prc_cli.formats.records import FilteredSource, RecordChunk, Source

GAP_S = 1.0
"""Longest time between the last record of a file and the first of the next file [s]."""


@dataclass(frozen=True, slots=True)
class Break:
    """A place where files are not one drive."""

    part: int
    """Number of the file with which another drive starts."""
    why: str


@dataclass(frozen=True)
class JoinedFiles:
    """Files of records of one drive, in the order of recording."""

    parts: tuple[Source, ...]

    def source(self) -> Source:
        """Return the records of all files; their numbers go on from file to file."""
        counts = [part.n_records for part in self.parts]
        known = [count for count in counts if count is not None]
        first = self.parts[0]
        return FilteredSource(
            self.parts,
            _one_after_the_other,
            first.path,
            first.format,
            sum(known) if len(known) == len(counts) else None,
            first.dimensions,
            _facts_of_files,
        )

    def notes(self, number: int) -> tuple[str, ...]:
        """Return notes on a file."""
        return self.parts[number].facts.notes

    def upto(self, n: int) -> JoinedFiles:
        """Return the first files."""
        return JoinedFiles(self.parts[:n])

    def firsts(self) -> list[int]:
        """Return the number of the first record of every file, and the number of all records."""
        firsts = [0]
        for part in self.parts:
            n = part.n_records
            if n is None:
                n = sum(chunk.n for chunk in part.chunks(part.dimensions[:1]))
            firsts.append(firsts[-1] + n)
        return firsts


def _one_after_the_other(names: tuple[str, ...], *parts: Source) -> Iterator[RecordChunk]:
    first = 0
    for part in parts:
        n = 0
        for chunk in part.chunks(names):
            record = None if chunk.record is None else chunk.record + first
            yield replace(chunk, first_record=chunk.first_record + first, record=record)
            n += chunk.n
        first += n


def _facts_of_files(*facts_of_parts: SourceFacts) -> SourceFacts:
    """Return the metadata of the first file, with the notes of all files."""
    notes = dict.fromkeys(note for facts in facts_of_parts for note in facts.notes)
    return replace(facts_of_parts[0], notes=tuple(notes), laz_contexts=None)


RECORDINGS = ("bag", "capture")
"""Formats of whole scans whose files may be parts of one recording."""


@dataclass(frozen=True)
class JoinedRecordings:
    """Bags, or captures, of one drive: messages and packets go on from file to file."""

    parts: tuple[Input, ...]
    config: InputConfig

    def firsts(self) -> list[int]:
        """Return the number of the first record of every file, and the number of all records."""
        counts = [
            sum(block.tally.n_records for block in open_recordings((part,), self.config).blocks())
            for part in self.parts
        ]
        return [0, *np.cumsum(counts).tolist()]

    def notes(self, _: int) -> tuple[str, ...]:
        """Return notes on a file: none, as the stream has those of all files."""
        return ()

    def upto(self, n: int) -> JoinedRecordings:
        """Return the first files."""
        return replace(self, parts=self.parts[:n])


@dataclass(frozen=True, slots=True)
class JoinedInput:
    """Files of one drive, in the order of recording, read as one :class:`Input`."""

    parts: tuple[Input, ...]

    def __str__(self) -> str:
        """Return the name of the first file, for messages."""
        return str(self.parts[0])

    @property
    def layout(self) -> Layout | None:
        """Layout of the records."""
        return self.parts[0].layout

    @property
    def are_recordings(self) -> bool:
        """Whether all files are bags, or all are captures."""
        forms = {part.readable_format().name for part in self.parts}
        return len(forms) == 1 and forms <= set(RECORDINGS)

    def records(self) -> Source | None:
        """Open the files as one list of records; None for recordings, see :meth:`files`."""
        return None if self.are_recordings else self.files().source()

    def files(self) -> JoinedFiles:
        """Open files of records.

        Raises
        ------
        InputError
            If a file is a range image or an organised scan.
        """
        sources: list[Source] = []
        for part in self.parts:
            source = part.records()
            if source is None:
                problem = "contains whole scans, expected files of records, or only bags, "
                problem += "or only captures"
                raise InputError(
                    str(part),
                    problem,
                    f"classify it alone: prc classify {shlex.quote(str(part))} OUT",
                )
            sources.append(source)
        return JoinedFiles(tuple(sources))

    def images(self, config: InputConfig, *, lines_at_once: int = 1) -> ScanStream:
        """Open bags, or captures, as one stream; a block is a scan, of as many lines as it has."""
        return open_recordings(self.parts, config)

    def joined(self, config: InputConfig) -> JoinedFiles | JoinedRecordings:
        """Return what is known of each file: its first record and its notes."""
        return JoinedRecordings(self.parts, config) if self.are_recordings else self.files()


def open_recordings(parts: Sequence[Input], config: InputConfig) -> ScanStream:
    """Open bags, or captures, of one drive as one stream."""
    paths = tuple(part.path for part in parts)
    if parts[0].readable_format().name == "bag":
        from prc_cli.formats.bags.read import BagStream

        return BagStream(paths[0], config, parts=paths)
    from prc_cli.formats.packets.read import PacketStream

    return PacketStream(paths[0], config, parts=paths)


def find_break(joined: JoinedFiles, *, in_order: bool = True) -> Break | None:
    """Return the first place where the files are not one drive; None if they are.

    Dimensions, M and times are compared. Tiles of a drive are not in the order of their times
    (``in_order=False``): only their dimensions are compared.
    """
    for number in range(1, len(joined.parts)):
        before = joined.parts[number - 1]
        after = joined.parts[number]
        why = ""
        if (before.format, before.dimensions) != (after.format, after.dimensions):
            why = "it has other dimensions than the file before"
        elif in_order:
            why = _why_apart(before, after)
        if why:
            return Break(number, why)
    return None


def is_continuous(drive: JoinedInput, config: InputConfig) -> bool:
    """Return whether the times, or the numbers of lines, show that the files are one recording."""
    if drive.are_recordings:
        spans = [_span_s(part, config) for part in drive.parts]
        # the scans of several scanners overlap where a recording is cut
        return all(
            first < next_first <= last + GAP_S and last < next_last
            for (first, last), (next_first, next_last) in pairwise(spans)
        )
    joined = drive.files()
    has_order = {"time", "scan_line"} & set(joined.parts[0].dimensions)
    return bool(has_order) and find_break(joined) is None


def _span_s(part: Input, config: InputConfig) -> tuple[float, float]:
    """Return the first and the last time of a bag or a capture; NaN without times."""
    first = math.inf
    last = -math.inf
    for block in open_recordings((part,), config).blocks():
        if block.time_s is not None and np.isfinite(block.time_s).any():
            first = min(first, float(np.nanmin(block.time_s)))
            last = max(last, float(np.nanmax(block.time_s)))
    return (first, last) if first <= last else (math.nan, math.nan)


def _why_apart(before: Source, after: Source) -> str:
    m_before = before.facts.points_per_line
    m_after = after.facts.points_per_line
    if m_before != m_after:
        return f"it has {m_after} shots a line, the file before {m_before}"
    name = next(
        (dimension for dimension in ("time", "scan_line") if dimension in before.dimensions), ""
    )
    if not name:
        return ""
    last = np.nan
    for chunk in before.chunks((name,)):
        last = chunk.values[name][-1] if chunk.n else last
    first = next((chunk.values[name][0] for chunk in after.chunks((name,)) if chunk.n), np.nan)
    step_s = float(first) - float(last)
    if name == "scan_line":
        return f"its lines begin at {first:.0f}, after line {last:.0f}" if step_s < 0.0 else ""
    if step_s < 0.0:
        return f"it begins {-step_s:.3f} s before the end of the file before"
    return f"it begins {step_s:.3f} s after the end of the file before" if step_s > GAP_S else ""
