"""Metadata of a file: every format declares it as :class:`SourceFacts`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from prc_cli.core.findings import Finding
from prc_cli.core.types import U8


class ClassContexts(Protocol):
    """LAZ compression contexts of the classes, kept to rewrite a file exactly."""

    @property
    def n_seen(self) -> int:
        """Number of records whose contexts are kept, from the first one."""

    @property
    def n_checked(self) -> int:
        """Number of records of which every layer was decoded, from the first one."""

    def take(self, n: int) -> Iterator[U8]:
        """Yield the contexts kept, ``n`` at a time, fewer at the end."""


@dataclass(frozen=True, slots=True)
class KnownRule:
    """A rule for lines, columns or ranges that follows from the format, for ``auto``."""

    key: str
    """``lines``, ``columns``, ``range``, ``turn`` (``whole``: lines are whole turns with a gap) or
    ``nadir`` (the angle of straight down [deg])."""
    value: str
    """As in ``[input]``."""
    why: str
    """The reason, for ``prc info`` and the run record."""


@dataclass(frozen=True, slots=True)
class SourceFacts:
    """Metadata of a source of records or of images; the defaults mean "not known"."""

    points_per_line: int | None = None
    """M, shots in a scan line, where the file records it."""
    line_hz: float | None = None
    """Scan lines a second [Hz], where the file or its layout records it."""
    crs_wkt: str | None = None
    """Coordinate system of x, y, z: WKT or ``EPSG:CODE``."""
    time_name: str = "time"
    """Name of the times in messages."""
    range_name: str = "range"
    """What the file calls the slant range."""
    has_line_times: bool = False
    """Whether checks use the time of a line's first shot.

    The file has one time per line, which blocks repeat for each shot, or a line's shots are fired
    out of turn."""
    has_returns: bool = False
    """Whether shots of the file may have several returns, known where images are read (bags,
    packets)."""
    has_scans: bool = False
    """Whether the file has several scans in sequence; each is a scanner of the stream."""
    stations: Mapping[int, tuple[float, float, float]] = field(default_factory=dict)
    """Position of every scan [m], by scanner; empty if all are at the origin."""
    scanners: tuple[str, ...] = ()
    """Names of the scanners, by their number, where several send at the same time (bags,
    packets)."""
    rules: tuple[KnownRule, ...] = ()
    """Rules for lines, columns and ranges that the file itself implies."""
    notes: tuple[str, ...] = ()
    """Unusual facts about the file, one sentence each, shown and kept in the run record."""
    refused: str = ""
    """Why the usual library refuses the file, whose damage is copied; empty if it does not."""
    unread: str = ""
    """What follows the records that the header counts; empty = nothing."""
    dropped: str = ""
    """What the run record inside the file says of shots that were left out; empty = nothing."""
    refuses: frozenset[str] = frozenset()
    """Keys of ``[input]`` that the file itself answers; hints do not name them."""
    remedy: str = ""
    """What else can be done with such an input, for hints without any option left."""
    repeated: str = ""
    """What a recording holds twice, of which one was read, known after reading; empty = nothing."""
    laz_contexts: ClassContexts | None = field(default=None, repr=False, compare=False)
    """LAZ of point formats 6-10: filled while the records are read, for rewriting the same file."""
    downs: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    """Scan angle that points straight down [rad] and cosine of the tilt of the scan plane, by
    scanner, where known."""
    has_fitted_lines: bool = False
    """Whether lines and columns come from a fitted path; such lines need not repeat."""
    findings: tuple[Finding, ...] = ()
    """Answers of checks that were done before lines were found."""
    header: Mapping[str, Any] = field(default_factory=dict, repr=False, compare=False)
    """Values of the header, ready for JSON, for ``prc info``."""
    drive: Any = field(default=None, repr=False, compare=False)
    """The path fitted to the points of a registered cloud; None for other inputs."""

    def rule(self, key: str) -> KnownRule | None:
        """Return the rule of a key, None if the file implies none."""
        return next((rule for rule in self.rules if rule.key == key), None)
