"""Adds the beam direction of every column, for classifiers that need to know where down is.

Sources, in this order: ``input.nadir`` gives the scan angle of straight down; the input gives it (zenith angles, or
registered heights with range and scan angle); coordinates relative to the scanner are directions. Without any of them
straight down is where level ground is, within a degree or two in streets and up to 10 degrees in forests; where there
are no scan angles either, they are measured from the ranges (:mod:`.angle_step`). If that fails the stream is refused,
unless no line has two returns: then placeholder directions do, because nothing can be classified.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from prc_cli.core.brief import Brief
from prc_cli.core.stream import ScanBlock, ScanStream, StreamInfo
from prc_cli.formats.options import InputConfig
from prc_cli.streams.beam_finder import BeamFinder, Found, Sample


def with_beams(stream: ScanStream, config: InputConfig) -> ScanStream:
    """Add the direction of every column's beam to a stream.

    Reads the first lines of the stream where directions come from coordinates or ranges.
    """
    split_by = None if config.scanner == "none" else config.scanner
    finder = BeamFinder(stream.info, config.nadir, split_by, config.angles == "measured")
    known: dict[int, Found] = {}
    waiting: dict[int, Sample] = {}
    for block in stream.blocks():
        if block.scanner not in known:
            sample = waiting.setdefault(block.scanner, finder.sample(block))
            sample.add(block)
            if sample.is_complete or block.is_last:
                known[block.scanner] = finder.find(waiting.pop(block.scanner))
        if not waiting:
            break
    else:
        known |= {scanner: finder.find(sample) for scanner, sample in waiting.items()}
    return BeamStream(stream, finder, known)


@dataclass(frozen=True, slots=True, repr=False)
class BeamStream(Brief):
    """A stream whose blocks have beam directions; see :func:`with_beams`."""

    source: ScanStream
    finder: BeamFinder
    known: dict[int, Found]
    """By scanner, for scanners in the first lines."""
    late: dict[int, Found] = field(default_factory=dict)
    """The same for scanners met while reading."""

    @property
    def info(self) -> StreamInfo:
        """Metadata of the stream, with the directions found so far."""
        info, every = self.source.info, [*self.known.values(), *self.late.values()]
        found = dict.fromkeys(one.assumption for one in every if one.assumption is not None)
        notes = dict.fromkeys(one.note for one in every if one.note)
        facts = replace(info.facts, notes=(*info.facts.notes, *notes))
        off = max((one.angles_off for one in every), default=0.0)
        return replace(info, assumptions=(*info.assumptions, *found), facts=facts, angles_off=off)

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start; see :meth:`prc_cli.core.stream.ScanStream.blocks`."""
        known = dict(self.known)
        waiting: dict[int, Sample] = {}
        for block in self.source.blocks():
            scanner = block.scanner
            if scanner in known:
                yield self.finder.put(known[scanner], block)
                continue
            sample = waiting.setdefault(scanner, self.finder.sample(block))
            sample.add(block)
            sample.held.append(block)
            if sample.is_complete or block.is_last:
                known[scanner] = self._find(waiting.pop(scanner))
                for held in sample.held:
                    yield self.finder.put(known[scanner], held)
        for sample in waiting.values():
            found = self._find(sample)
            for held in sample.held:
                yield self.finder.put(found, held)

    def _find(self, sample: Sample) -> Found:
        found = self.late[sample.scanner] = self.finder.find(sample)
        return found
