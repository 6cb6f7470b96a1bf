"""The interface of readers for lists of records, from which the stream is built.

A source only decodes; :mod:`prc_cli.streams.grid` finds line, column and range of every record, for all formats alike.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from prc_cli.core.facts import SourceFacts
from prc_cli.core.types import I64

STANDARD_NAMES = (
    "range", "scan_line", "column", "angle", "time", "x", "y", "z", "intensity", "return_number",
    "number_of_returns",
)  # fmt: skip
"""Names of dimensions common to all sources; other dimensions keep their own name."""


def standard_first(names: Collection[str]) -> tuple[str, ...]:
    """Return the standard names, in their order, and then the others as they come.

    >>> standard_first(["reflectance", "time", "range"])
    ('range', 'time', 'reflectance')
    """
    standard = [name for name in STANDARD_NAMES if name in names]
    return (*standard, *(name for name in names if name not in standard))


@dataclass(frozen=True, slots=True)
class RecordChunk:
    """Consecutive records of an input, decoded.

    Units by standard name: ``range``, ``x``, ``y``, ``z`` float64 [m]; ``angle`` float64 [rad]; ``time``
    float64 [s]; ``scan_line``, ``column`` float64 or integers; NaN where the input has no value.
    """

    first_record: int
    """Index in the input of the first record."""
    values: dict[str, NDArray[Any]]
    """(n,) arrays by dimension name; exactly the requested names."""
    n: int
    """Number of records."""
    record: I64 | None = None
    """(n,) int64 index in the input of every record; None = ``first_record + 0..n-1`` (input order)."""


class RecordSource(Protocol):
    """A file of records, decoded on demand."""

    @property
    def path(self) -> str:
        """File name, for messages."""

    @property
    def format(self) -> str:
        """Reader name, for messages and ``prc info``."""

    @property
    def n_records(self) -> int | None:
        """Number of records; None if only reading can tell."""

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names that :meth:`chunks` can deliver, standard names first."""

    @property
    def facts(self) -> SourceFacts:
        """What the file says of itself beside its records."""

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode the named dimensions from the start, in bounded memory, in the order of the input.

        A damaged file is an ``InputError`` that names the position, what was found and what was expected.
        """


@dataclass(frozen=True)
class DerivedSource:
    """Base class of sources that change the records of another source in ``chunks``."""

    source: RecordSource

    @property
    def path(self) -> str:
        """File name, for messages."""
        return self.source.path

    @property
    def format(self) -> str:
        """Reader name."""
        return self.source.format

    @property
    def n_records(self) -> int | None:
        """Number of records; None if only reading can tell."""
        return self.source.n_records

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names that the source can deliver, standard names first."""
        return self.source.dimensions

    @property
    def facts(self) -> SourceFacts:
        """What the file says of itself beside its records."""
        return self.source.facts
