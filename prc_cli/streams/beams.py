"""The direction of every column's beam, for classifiers that must know where down is.

Three ways, in this order: the scan angle that points straight down is given (``input.nadir``), the input tells it
(zenith angles, registered heights beside range and scan angle), or coordinates relative to the scanner are
directions themselves. Where a degree or two are good enough, level ground tells as well. What none of them tells is
refused, unless there is nothing to classify either: where no line has two returns, any directions do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

from prc_cli.core.stream import ScanBlock, ScanStream, StreamInfo
from prc_cli.formats.options import InputConfig
from prc_cli.streams.beam_finder import BeamFinder, Found, Sample


def with_beams(stream: ScanStream, config: InputConfig, *, from_ground: bool = False) -> ScanStream:
    """Add the direction of every column's beam to a stream.

    Reads the first lines of the stream where only coordinates tell.

    Parameters
    ----------
    stream : ScanStream
        Any stream.
    config : InputConfig
        ``nadir``, and how the stream was opened.
    from_ground : bool
        Where nothing tells and there are scan angles, look where the lines see level ground; within a degree or two.

    Returns
    -------
    ScanStream
        The same blocks with ``beam_rad``; its info has an assumption for what was found. Coordinates that turn out not
        to be relative to the scanner are left out of the blocks.

    Raises
    ------
    InputError
        When nothing tells where down is, the lines do not rise, the origin of coordinates is not the scanner, or the
        directions do not turn with the column.
    ConfigError
        When ``nadir`` is given and the stream has no scan angles.
    """
    split_by = None if config.scanner == "none" else config.scanner
    finder = BeamFinder(stream.info, config.nadir, split_by, from_ground)
    known: dict[int, Found] = {}
    waiting: dict[int, Sample] = {}
    for block in stream.blocks():
        if block.scanner not in known:
            sample = waiting.setdefault(block.scanner, Sample())
            sample.add(block)
            if sample.is_complete or block.is_last:
                known[block.scanner] = finder.find(waiting.pop(block.scanner))
        if not waiting:
            break
    else:
        known |= {scanner: finder.find(sample) for scanner, sample in waiting.items()}
    return BeamStream(stream, finder, known)


@dataclass(frozen=True, slots=True)
class BeamStream:
    """A stream whose blocks say where their beams point; see :func:`with_beams`."""

    source: ScanStream
    finder: BeamFinder
    known: dict[int, Found]
    """By scanner, of those that were met in the first lines."""
    late: dict[int, Found] = field(default_factory=dict)
    """The same of those that were met while reading."""

    @property
    def info(self) -> StreamInfo:
        """What is known of the stream, with what was found so far of its scanners."""
        info, every = self.source.info, [*self.known.values(), *self.late.values()]
        found = dict.fromkeys(one.assumption for one in every if one.assumption is not None)
        notes = dict.fromkeys(one.note for one in every if one.note)
        facts = replace(info.facts, notes=(*info.facts.notes, *notes))
        return replace(info, assumptions=(*info.assumptions, *found), facts=facts)

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start; see :meth:`prc_cli.core.stream.ScanStream.blocks`.

        Raises
        ------
        InputError
            Also when a scanner met late is one that :func:`with_beams` refuses.
        """
        known = dict(self.known)
        waiting: dict[int, Sample] = {}
        for block in self.source.blocks():
            scanner = block.scanner
            if scanner in known:
                yield self.finder.put(known[scanner], block)
                continue
            sample = waiting.setdefault(scanner, Sample())
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
