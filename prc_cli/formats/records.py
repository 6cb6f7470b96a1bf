"""Lists of records: the interface of their readers, class codes, and counts of their contents.

A source only decodes; :mod:`prc_cli.streams.grid` finds line, column and range of every record, for
all formats alike.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.classes import NO_CODE
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.types import I64
from prc_cli.formats.options import LayoutField, decode

STANDARD_NAMES = (
    "range",
    "scan_line",
    "column",
    "angle",
    "time",
    "x",
    "y",
    "z",
    "intensity",
    "return_number",
    "number_of_returns",
)
"""Names of dimensions common to all sources; other dimensions keep their own name."""

AXES = ("x", "y", "z")


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

    Units by standard name: ``range``, ``x``, ``y``, ``z`` float64 [m]; ``angle`` float64 [rad];
    ``time`` float64 [s]; ``scan_line``, ``column`` float64 or integers; NaN where the input has no
    value.
    """

    first_record: int
    """Index in the input of the first record."""
    values: dict[str, NDArray[Any]]
    """(n,) arrays by dimension name; exactly the requested names."""
    n: int
    """Number of records."""
    record: I64 | None = None
    """(n,) int64 index in the input of every record.

    None = ``first_record + 0..n-1`` (input order).
    """

    def records(self) -> I64:
        """Return the index in the input of every record, (n,) int64."""
        if self.record is not None:
            return self.record
        return np.arange(self.first_record, self.first_record + self.n, dtype=np.int64)


@dataclass(frozen=True, slots=True)
class Reading:
    """How records are read; a format that has no choice ignores it."""

    multiple_of: int = 1
    """Chunks have a multiple of so many records, so that blocks need not be joined."""
    spares_intensity: bool = False
    """``intensity`` is undefined, unless it chooses between returns: it is slow to decode."""
    checks_layers: bool = False
    """All layers are decoded, so that damage is found: they are copied as bytes."""

    def also(self, other: Reading) -> Reading:
        """Return both requests as one."""
        return Reading(
            max(self.multiple_of, other.multiple_of),
            self.spares_intensity or other.spares_intensity,
            self.checks_layers or other.checks_layers,
        )


class Source(Protocol):
    """The columns of a file, in the order of its records, decoded on demand.

    A format has a class with this interface; filters (:class:`FilteredSource`) change records on
    the way.
    """

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
        """Metadata of the file."""

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode dimensions in order, in bounded memory.

        Raises
        ------
        InputError
            Names the position of damage.
        """

    def with_reading(self, reading: Reading) -> Source:
        """Return the source as it is to be read; itself where the format has no choice."""


def check_names(source: Source, names: tuple[str, ...]) -> None:
    """Refuse names of dimensions that a source does not have."""
    known = source.dimensions
    for name in names:
        if name not in known:
            raise ConfigError(
                source.path,
                f"no dimension {name!r} in the file",
                f"it has: {listed(nearest_first(known, name))}",
            )


def nearest_first(names: Iterable[str], wanted: str) -> list[str]:
    """Return names for a message, the most similar to a wrong name first.

    >>> nearest_first(["x", "range", "intensity"], "intensty")
    ['intensity', 'range', 'x']
    """
    return sorted(names, key=lambda name: -SequenceMatcher(None, wanted, name).ratio())


def listed(names: Collection[str]) -> str:
    """Return names for a message, the first forty, each shortened."""
    shown = ", ".join(shorten(name) for name in list(names)[:40])
    return (shown or "none") + (", ..." if len(names) > 40 else "")


def shorten(text: str) -> str:
    """Return a text shortened for a message."""
    return text if len(text) <= 40 else f"{text[:37]}..."


Stored: TypeAlias = Mapping[str, NDArray[Any]] | NDArray[Any]
"""Stored values by key: a table of columns, or records."""


class Body(Protocol):
    """Stored values of a file."""

    @property
    def n_records(self) -> int | None:
        """Number of records; None if only reading can tell."""

    def stored(self, keys: tuple[str, ...]) -> Iterator[tuple[int, Stored, int]]:
        """Yield index of the first record, stored values by key, and number of records."""


@dataclass(frozen=True, slots=True)
class Column:
    """Storage of the values of a dimension."""

    key: str
    """Name in the body."""
    name: str
    """Name in the file; empty if the file has no names."""
    item: LayoutField
    """Scale, offset, missing value and unit."""


class FieldSource:
    """Base of the sources whose records have named fields."""

    n_records: int | None
    """Number of records; None if only reading can tell."""

    def __init__(
        self,
        path: Path | str,
        form: str,
        columns: Mapping[str, Column],
        body: Body,
    ) -> None:
        self.path = str(path)
        """File name, for messages."""
        self.format = form
        """Reader name, for messages and ``prc info``."""
        self.columns = {name: columns[name] for name in standard_first(columns)}
        """By dimension, standard names first."""
        self.body = body
        self.n_records = body.n_records
        self.facts = SourceFacts()
        """Metadata of the file; a subclass sets them."""

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names that :meth:`chunks` can deliver, standard names first."""
        return tuple(self.columns)

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode the named fields in bounded memory, in the order of the file."""
        check_names(self, names)
        keys = tuple(dict.fromkeys(self.columns[name].key for name in names))
        for first, stored, n in self.body.stored(keys or (next(iter(self.columns.values())).key,)):
            yield self.decoded(first, stored, names, n)

    def with_reading(self, reading: Reading) -> FieldSource:
        """Return the source; one way of reading is all that most formats have."""
        return self

    def decoded(
        self,
        first: int,
        stored: Stored,
        names: tuple[str, ...],
        n: int,
    ) -> RecordChunk:
        """Return stored values as dimensions."""
        keys = [self.columns[name].key for name in names]
        values = {}
        for name, key in zip(names, keys, strict=True):
            # values are decoded in place where no other dimension needs them
            column = stored[key].copy() if keys.count(key) > 1 else stored[key]
            values[name] = decode(column, self.columns[name].item)
        return RecordChunk(first, values, n)


def _first(facts: SourceFacts, *_: SourceFacts) -> SourceFacts:
    return facts


@dataclass(frozen=True)
class FilteredSource:
    """Records that a filter makes of those of other sources; see :func:`filtered`."""

    sources: tuple[Source, ...]
    read: Callable[..., Iterator[RecordChunk]]
    """Yields the chunks: ``(names, *sources)``."""
    path: str
    """File name, for messages."""
    format: str
    """Reader name."""
    n_records: int | None
    """Number of records; None if only reading can tell."""
    dimensions: tuple[str, ...]
    """Names that :meth:`chunks` can deliver, standard names first."""
    facts_of: Callable[..., SourceFacts] = _first
    """Returns the metadata by those of the sources."""

    @property
    def facts(self) -> SourceFacts:
        """Metadata of the records; what a reader learns is there after reading."""
        return self.facts_of(*(source.facts for source in self.sources))

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode dimensions in order, in bounded memory."""
        return self.read(names, *self.sources)

    def with_reading(self, reading: Reading) -> FilteredSource:
        """Return the same records of sources that are read in this way."""
        sources = tuple(source.with_reading(reading) for source in self.sources)
        return replace(self, sources=sources)


def filtered(
    source: Source,
    read: Callable[..., Iterator[RecordChunk]],
    *more: Source,
    dimensions: tuple[str, ...] | None = None,
    facts_of: Callable[..., SourceFacts] = _first,
) -> FilteredSource:
    """Return the records of a source as a filter changes them.

    Parameters
    ----------
    source
        Gives path, format and number of records.
    read
        Yields the chunks: ``(names, source, *more)``.
    more
        Sources that are read beside it.
    dimensions
        None = those of the source.
    facts_of
        Returns the metadata by those of all sources, the ones of the source by default.
    """
    return FilteredSource(
        (source, *more),
        read,
        source.path,
        source.format,
        source.n_records,
        source.dimensions if dimensions is None else dimensions,
        facts_of,
    )


_WHOLE = float(1 << 53)
"""Largest float64 below which every whole number is exact."""


CLASS_CODE = "class code"
"""Dimension of class codes, int64; :data:`NO_CODE` = the record has none.

The blank keeps it apart from dimensions of files.
"""


class CodeSource:
    """Class codes of one file, in record order: a source of :data:`CLASS_CODE`."""

    format = "class codes"
    """Reader name."""
    dimensions: tuple[str, ...] = (CLASS_CODE,)
    """All that it can deliver."""
    facts = SourceFacts()
    """Labels alone tell nothing else."""

    def __init__(
        self,
        path: Path,
        n_records: int | None,
        read: Callable[[], Iterator[NDArray[Any]]],
        *,
        missing: bool = False,
        name: str = "",
    ) -> None:
        self.path = str(path)
        """File name, for messages."""
        self.n_records = n_records
        """Number of records; None if only reading can tell."""
        self.name = name
        """What the file calls the codes; empty where no other reader can read them."""
        self._read = read
        self._missing = missing

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode the codes, or only count them."""
        check_names(self, names)
        first = 0
        for codes in self.codes():
            yield RecordChunk(first, {CLASS_CODE: codes} if names else {}, len(codes))
            first += len(codes)

    def with_reading(self, reading: Reading) -> CodeSource:
        """Return the source, which has one way of reading."""
        return self

    def codes(self) -> Iterator[I64]:
        """Yield the codes, (n,) int64; -1 = the record has none."""
        first = 0
        for values in self._read():
            yield self.to_codes(values, first)
            first += len(values)

    def to_codes(self, values: NDArray[Any], first: int) -> I64:
        """Return stored numbers as codes, (n,) int64; -1 = the record has none."""
        if values.dtype.kind == "f":
            with np.errstate(invalid="ignore"):
                wide = values.astype(np.float64)
                if self._missing:
                    wide[np.isnan(wide)] = NO_CODE
                wrong = ~((np.abs(wide) <= _WHOLE) & (np.floor(wide) == wide))
        else:
            wide = values
            # only unsigned 64-bit integers can be too large
            wrong = (
                values > np.iinfo(np.int64).max
                if values.dtype.kind == "u"
                else np.zeros(len(values), np.bool_)
            )
        if wrong.any():
            first_wrong = int(np.flatnonzero(wrong)[0])
            problem = f"record {first + first_wrong}: found the class code {values[first_wrong]}"
            hint = "name the column that holds class codes"
            raise InputError(self.path, f"{problem}, expected a whole number", hint)
        return wide.astype(np.int64)


CLASS_NAMES = ("classification", "class", "label")
"""Dimensions of class codes; the first one present is counted."""
MOST_KINDS = 256
"""Further different codes, returns or sources are not counted."""
REGISTERED_SPAN_M = 300.0
REGISTERED_FAR_M = 2000.0
"""Coordinates that span more, or are farther from zero, are not relative to one scanner [m]."""


@dataclass(slots=True)
class Contents:
    """Counts of the records of a file; filled by :meth:`see`."""

    bounds_m: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Least and greatest finite coordinate by axis [m]."""
    time_s: tuple[float, float] | None = None
    """Least and greatest time [s]."""
    classes: Counter[int] = field(default_factory=Counter)
    """Records by class code."""
    class_names: dict[int, str] = field(default_factory=dict)
    """Names of the file for its own codes, from 64 on."""
    returns: Counter[str] = field(default_factory=Counter)
    """Records by return, as ``"2 of 3"``."""
    sources: Counter[int] = field(default_factory=Counter)
    """Records by point source id."""

    def see(self, values: dict[str, NDArray[Any]]) -> None:
        """Count the next records, by dimension."""
        for axis in (*AXES, "time"):
            if axis not in values:
                continue
            known = values[axis][np.isfinite(values[axis])]
            if not len(known):
                continue
            bounds = (float(known.min()), float(known.max()))
            earlier = self.time_s if axis == "time" else self.bounds_m.get(axis)
            if earlier is not None:
                bounds = min(earlier[0], bounds[0]), max(earlier[1], bounds[1])
            if axis == "time":
                self.time_s = bounds
            else:
                self.bounds_m[axis] = bounds
        for name in CLASS_NAMES:
            if name in values:
                _count(self.classes, values[name])
                break
        if "point_source_id" in values:
            _count(self.sources, values["point_source_id"])
        if "return_number" in values and "number_of_returns" in values:
            pairs = values["return_number"].astype(np.int64) * 256 + values["number_of_returns"]
            kinds, n = np.unique(pairs, return_counts=True)
            for pair, count in zip(kinds.tolist(), n.tolist(), strict=True):
                if len(self.returns) < MOST_KINDS:
                    self.returns[f"{pair // 256} of {pair % 256}"] += count

    @property
    def is_registered(self) -> bool | None:
        """Whether the coordinates cannot be relative to one scanner; None without coordinates."""
        if "x" not in self.bounds_m or "y" not in self.bounds_m:
            return None
        across = [self.bounds_m[axis] for axis in ("x", "y")]
        return any(
            high - low > REGISTERED_SPAN_M or max(abs(low), abs(high)) > REGISTERED_FAR_M
            for low, high in across
        )

    def as_dict(self) -> dict[str, Any]:
        """Return the counts as plain values for JSON."""
        return {
            "bounds_m": {axis: list(bounds) for axis, bounds in self.bounds_m.items()},
            "registered": self.is_registered,
            "time_s": None if self.time_s is None else list(self.time_s),
            "classes": {str(code): n for code, n in sorted(self.classes.items())},
            "class_names": {str(code): name for code, name in sorted(self.class_names.items())},
            "returns": dict(sorted(self.returns.items())),
            "point_source_ids": {str(code): n for code, n in sorted(self.sources.items())},
        }


def watched_contents(source: Source, contents: Contents) -> Iterator[RecordChunk]:
    """Read a source once and count its records on the way."""
    present = set(source.dimensions)
    classes = next((name for name in CLASS_NAMES if name in present), None)
    counted = (*AXES, "time", "return_number", "number_of_returns", "point_source_id", classes)
    for chunk in source.chunks(tuple(name for name in counted if name in present)):
        contents.see(chunk.values)
        yield chunk


def _count(counter: Counter[int], values: NDArray[Any]) -> None:
    known = values[np.isfinite(values)] if values.dtype.kind == "f" else values
    codes, n = np.unique(known.astype(np.int64, copy=False), return_counts=True)
    for code, count in zip(codes.tolist(), n.tolist(), strict=True):
        if code in counter or len(counter) < MOST_KINDS:
            counter[code] += count
