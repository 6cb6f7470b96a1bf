"""Streams of blocks: a reader, the filters that its blocks pass, and what is learnt on the way."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, TypeAlias, cast

from prc_cli.core.findings import Finding
from prc_cli.core.stream import ScanBlock, ScanStream, StreamInfo
from prc_cli.core.window import Window
from prc_cli.streams.replay import Replay

if TYPE_CHECKING:
    from prc_cli.streams.beams import Directions
    from prc_cli.streams.grid import GridStream
    from prc_cli.streams.registered.drive import Drive
    from prc_cli.streams.registered.spinning_drive import SpinningDrive

Filter: TypeAlias = Callable[[Iterator[ScanBlock]], Iterator[ScanBlock]]
"""Changes, drops or watches the blocks of a stream."""

HEAD_CELLS = 1 << 21
"""Cells of the first blocks that are kept: 10 to 40 bytes each."""


@dataclass(frozen=True, slots=True)
class Blocks:
    """Blocks in memory."""

    info: StreamInfo
    items: Sequence[ScanBlock]

    def blocks(self) -> Iterator[ScanBlock]:
        """Yield the blocks."""
        return iter(self.items)


@dataclass(frozen=True, slots=True)
class Observations:
    """What is learnt about a stream while it is read; its filters fill it."""

    lines: dict[int, range] = field(default_factory=dict)
    """Lines that were taken of every scanner, if the stream has a window."""
    beams: dict[int, Directions] = field(default_factory=dict)
    """Beam directions of the scanners that were not among the first lines."""
    findings: list[Finding] = field(default_factory=list)
    """Results of all checks, if the stream was watched to its end."""


@dataclass(frozen=True, slots=True)
class Stream:
    """A stream of blocks; its first blocks are read once, its complete reading starts with them."""

    source: ScanStream
    """The reader of the input."""
    first: Replay[ScanBlock]
    """The first blocks of the reader."""
    filters: tuple[Filter, ...] = ()
    """What the blocks pass, in this order."""
    window: Window | None = None
    """The lines that are taken."""
    beams: Mapping[int, Directions] | None = None
    """Beam directions of the scanners among the first lines; None = blocks have none."""
    plain: Stream | None = None
    """The stream before directions were added; None where none were."""
    grid: GridStream | None = None
    """How records become blocks; None for images and frames."""
    observed: Observations = field(default_factory=Observations)

    @classmethod
    def of(cls, source: ScanStream) -> Stream:
        """Return a stream, or the stream of a reader."""
        if isinstance(source, Stream):
            return source
        return cls(source, Replay(source.blocks, lambda block: block.range_m.size, HEAD_CELLS))

    @property
    def info(self) -> StreamInfo:
        """Metadata of the stream, with what was learnt so far."""
        info = self.source.info
        if self.window is not None:
            note = _note_of_lines(self.window, self.observed.lines)
            info = replace(_with_notes(info, note), n_lines=None)
        if self.beams is not None:
            every = [*self.beams.values(), *self.observed.beams.values()]
            assumptions = [beams.assumption for beams in every if beams.assumption is not None]
            info = replace(
                _with_notes(info, *(beams.note for beams in every)),
                assumptions=(*info.assumptions, *dict.fromkeys(assumptions)),
                angles_off=max((beams.angles_off for beams in every), default=0.0),
            )
        return info

    def blocks(self) -> Iterator[ScanBlock]:
        """Read from the start; see :meth:`prc_cli.core.stream.ScanStream.blocks`."""
        return self._filtered(self.first.read_all())

    @property
    def drive(self) -> Drive | SpinningDrive | None:
        """The path found in a registered cloud (``range = "points"``)."""
        return cast("Drive | SpinningDrive | None", self.source.info.facts.drive)

    def first_blocks(self) -> Iterator[ScanBlock]:
        """Read from the start, for readers that stop early: the first blocks are kept."""
        return self._filtered(self.first.read_head())

    def _filtered(self, blocks: Iterator[ScanBlock]) -> Iterator[ScanBlock]:
        for change in self.filters:
            blocks = change(blocks)
        return blocks

    def through(self, change: Filter) -> Stream:
        """Return the stream with one more filter."""
        return replace(self, filters=(*self.filters, change))


def _note_of_lines(window: Window, lines: Mapping[int, range]) -> str:
    if not lines:
        return ""
    first = min(part.start for part in lines.values())
    stop = max(part.stop for part in lines.values())
    several = " of each scanner" if len(lines) > 1 else ""
    return (
        f"only lines {first:,} to {stop - 1:,}{several} were taken "
        f"({window.option}), as a drive of its own"
    )


def _with_notes(info: StreamInfo, *notes: str) -> StreamInfo:
    more = dict.fromkeys(note for note in notes if note)
    return replace(info, facts=replace(info.facts, notes=(*info.facts.notes, *more)))
