"""What a file says of itself beside its records: declared by every format, asked for by nobody in another way."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

from prc_cli.core.types import U8


class ClassContexts(Protocol):
    """What the classes of an input's records are coded by, kept while it is read, for writing it again."""

    @property
    def n_seen(self) -> int:
        """Records whose contexts are kept, from the first on."""

    def take(self, n: int) -> Iterator[U8]:
        """Yield the contexts kept, ``n`` at a time, fewer at the end."""


def _align_nothing(n_records: int) -> None:
    """Leave the chunks as they are."""


def _skip_nothing() -> None:
    """Decode all that is asked for."""


@dataclass(frozen=True, slots=True)
class SourceFacts:
    """Facts of a source of records or of images; a format that does not know one leaves its default."""

    points_per_line: int | None = None
    """M, shots in a scan line, where the file records it."""
    crs_wkt: str | None = None
    """Coordinate system of x, y, z: WKT or ``EPSG:CODE``."""
    time_name: str = "time"
    """Name of the times in messages."""
    has_line_times: bool = False
    """Whether the file holds one time a line, which blocks repeat for each of its shots."""
    has_scans: bool = False
    """Whether scans follow one another, each a scanner of the stream with directions of its own."""
    notes: tuple[str, ...] = ()
    """What is unusual about the file, a plain sentence each: always shown, and kept in the run record."""
    laz_contexts: ClassContexts | None = field(default=None, repr=False, compare=False)
    """LAZ of point formats 6-10: filled while the records are read, for writing the same file again."""
    describe: Callable[[], dict[str, Any]] = field(default=dict, repr=False, compare=False)
    """Returns what the header says, ready for JSON, for ``prc info``."""
    align_chunks: Callable[[int], None] = field(default=_align_nothing, repr=False, compare=False)
    """Makes chunks end at multiples of so many records, so that blocks need not be joined; no value depends on it."""
    skip_intensity: Callable[[], None] = field(default=_skip_nothing, repr=False, compare=False)
    """Lets ``intensity`` be anything where it decides between no returns: it is slow to decode."""
