"""Clouds of named properties (PLY, PCD): which property is what, returns of a shot, and decoding in chunks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.facts import KnownRule, SourceFacts
from prc_cli.core.files import open_to_read
from prc_cli.core.types import I64, Mask
from prc_cli.formats.names import NAMES, angle_rules, usual_names
from prc_cli.formats.options import Layout, LayoutField, check_fields, decode
from prc_cli.formats.records import STANDARD_NAMES, RecordChunk, standard_first

CHUNK_RECORDS = 1 << 18
"""Records decoded at a time."""
CHUNK_BYTES = 16 << 20
"""Most bytes decoded at a time: long records make shorter chunks."""
MAX_RUN = 255
"""Most rows of a shot: longer runs of equal times and angles are no returns."""
XYZ = ("x", "y", "z")
NO_CELL = 0xFFFFFFFF
"""Line and column of a point without a cell, in files of this program."""
OWN_COMMENT = "prc points_per_line "
"""Comment of files of this program, with M behind it."""

Columns = dict[str, NDArray[Any]]


class Body(Protocol):
    """The records of a cloud, wherever they lie in the file."""

    @property
    def n_records(self) -> int:
        """Number of records, checked against the size of the file where it is binary."""

    def chunks(self, names: tuple[str, ...]) -> Iterator[tuple[int, Columns, int]]:
        """Yield index of the first record, stored values by property, and number of records."""


@dataclass(frozen=True, slots=True)
class BinaryBody:
    """Records of fixed size, one after the other."""

    path: Path
    dtype: np.dtype[np.void]
    start: int
    """First byte."""
    n_records: int

    def chunks(self, names: tuple[str, ...]) -> Iterator[tuple[int, Columns, int]]:
        """Yield index of the first record, stored values by property, and number of records."""
        each = max(1, min(CHUNK_RECORDS, CHUNK_BYTES // self.dtype.itemsize))
        with open_to_read(self.path) as handle:
            handle.seek(self.start)
            for first in range(0, self.n_records, each):
                found = self._read(handle, first, min(each, self.n_records - first))
                # contiguous and in native order: faster from here on, and the records can be freed
                yield (
                    first,
                    {name: np.ascontiguousarray(found[name], found.dtype[name].newbyteorder("=")) for name in names},
                    len(found),
                )

    @classmethod
    def within(cls, path: Path, dtype: np.dtype[np.void], start: int, n: int, hint: str) -> BinaryBody:
        """Return the body after a look at the size of the file."""
        there = max(path.stat().st_size - start, 0)
        if n * dtype.itemsize > there:
            problem = f"the file ends in point {there // dtype.itemsize}, the header says {n} of {dtype.itemsize} bytes"
            raise InputError(str(path), problem, hint)
        return cls(path, dtype, start, n)

    def _read(self, handle: IO[bytes], first: int, wanted: int) -> NDArray[Any]:
        try:
            found = np.fromfile(handle, self.dtype, wanted)
        except OSError as error:
            problem = f"record {first} and on cannot be read ({error.strerror or error})"
            raise InputError(str(self.path), problem, "check the disk or copy the file again") from error
        if len(found) < wanted:
            problem = f"the file ends after {first + len(found)} points, expected {self.n_records} as when opened"
            raise InputError(str(self.path), problem, "it was cut while being read; wait until its writer is done")
        return found


@dataclass(frozen=True, slots=True)
class CloudHead:
    """What the header of a cloud says."""

    path: Path
    format: str
    names: tuple[str, ...]
    """Properties of a point, in order."""
    types: Mapping[str, np.dtype[Any]]
    """Stored type by property; empty for text."""
    offsets_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """To be added to x, y, z, where a comment says so."""
    rules: tuple[KnownRule, ...] = ()
    points_per_line: int | None = None
    notes: tuple[str, ...] = ()
    comments: tuple[str, ...] = ()
    described: Mapping[str, Any] | None = None


class CloudSource:
    """A cloud as a :class:`prc_cli.formats.records.RecordSource`."""

    def __init__(self, head: CloudHead, body: Body, layout: Layout | None = None) -> None:
        self.path = str(head.path)
        """File name, for messages."""
        self.format = head.format
        """Reader name."""
        self.n_records: int = body.n_records
        """Number of records, from the header."""
        self._body = body
        self.head = head
        """What the header says."""
        given = layout is not None and bool(layout.fields)
        found = _given_fields(head, layout) if given and layout is not None else _known_fields(head.names)
        notes, rules = list(head.notes), list(head.rules)
        own_m = _own_points_per_line(head.comments)
        looked_at = ("time", "angle", "range", *XYZ, "return_number", "number_of_returns")
        first = _first_rows(body, tuple(dict.fromkeys(found[name][0] for name in looked_at if name in found)))
        if not given:
            found = _with_units(found, head, first, notes)
        if own_m is not None:
            for name in ("scan_line", "column"):
                if name in found:
                    own, item = found[name]
                    found[name] = (own, item.model_copy(update={"missing": float(NO_CELL)}))
        self._own: dict[str, tuple[str, LayoutField]] = found
        self._has_pulses = {"return_number", "number_of_returns"} <= set(found) and "time" in found
        if self._has_pulses and len(first[found["time"][0]]):
            runs = self._runs(first)
            n_copies = int(np.count_nonzero(runs.is_copy))
            n_rows = len(runs.is_copy)
            if n_copies:
                notes.append(
                    f"{n_copies} of the first {n_rows} rows repeat a return of their shot that stands before: they are "
                    "taken as further returns, not as shots"
                )
            # other programs list every return once
            self._has_pulses = n_copies > 0 or found["return_number"][0].lower() == "num_echo"
        renamed = [f"{own} as {name}" for name, (own, _) in found.items() if own != name and name in NAMES]
        if renamed and not given:
            notes.append(f"properties taken under another name: {', '.join(renamed)}")
        has_own_lines = "scan_line" in found and own_m is None
        if "ring" in found and set(XYZ) <= set(found) and not has_own_lines and "angle" not in found:
            rings = (
                KnownRule("lines", "rings", "the points have a ring, and x, y, z from the scanner"),
                KnownRule("range", "sensor-xyz", "rings turn around the origin of x, y, z"),
            )
            rules += [rule for rule in rings if rule.key not in {one.key for one in head.rules}]
        rules += angle_rules(found["angle"][0] if "angle" in found else None)
        self.facts = SourceFacts(
            points_per_line=own_m if "column" in found and own_m is not None else head.points_per_line,
            rules=tuple(rules),
            notes=tuple(notes),
            describe=lambda: dict(head.described or {}),
        )
        """Metadata of the file."""

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names that :meth:`chunks` can deliver, standard names first."""
        return standard_first(self._own)

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode the named properties in bounded memory, in the order of the file."""
        unknown = [name for name in names if name not in self._own]
        if unknown:
            raise ConfigError(self.path, f"no dimension {unknown[0]!r} in the file", f"it has: {_shown(self._own)}")
        wanted = {name: self._own[name] for name in names}
        grouped = self._has_pulses and bool({"return_number", "number_of_returns"} & set(names))
        keys = self._key_names if grouped else ()
        stored = tuple(dict.fromkeys((*(own for own, _ in wanted.values()), *keys)))
        chunks = self._body.chunks(stored or self.head.names[:1])
        if not grouped:
            for first, columns, n in chunks:
                yield RecordChunk(first, {name: decode(columns[own], item) for name, (own, item) in wanted.items()}, n)
            return
        for first, columns, runs in self._whole_runs(chunks):
            made = {"return_number": runs.ordinal, "number_of_returns": runs.n_rows}
            values = {
                name: made[name] if name in made else decode(columns[own], item) for name, (own, item) in wanted.items()
            }
            yield RecordChunk(first, values, len(runs.ordinal))

    @property
    def own_names(self) -> tuple[tuple[str, str, str], ...]:
        """Standard name, property, and unit and offset as TOML, of the properties that are known."""
        found = []
        for name, (own, item) in self._own.items():
            if name in (*STANDARD_NAMES, "ring"):
                unit = f', unit = "{item.unit}"' if item.unit else ""
                offset = f", offset = {item.offset!r}" if item.offset else ""
                found.append((name, own, unit + offset))
        return tuple(found)

    def stored(self, names: tuple[str, ...]) -> Iterator[tuple[int, Columns, int]]:
        """Yield index of the first record, stored values by property, and number of records."""
        return self._body.chunks(names or self.head.names[:1])

    @property
    def _key_names(self) -> tuple[str, ...]:
        """Properties that tell shots apart."""
        keys = [self._own[name][0] for name in ("time", "angle", "range", *XYZ) if name in self._own]
        return (*keys, self._own["return_number"][0], self._own["number_of_returns"][0])

    def _runs(self, columns: Columns) -> _Runs:
        same = [columns[self._own[name][0]] for name in ("time", "angle") if name in self._own]
        place = [columns[self._own[name][0]] for name in ("range", *XYZ) if name in self._own][:1]
        number = columns[self._own["return_number"][0]]
        return find_runs(same, place, number, columns[self._own["number_of_returns"][0]])

    def _whole_runs(self, chunks: Iterator[tuple[int, Columns, int]]) -> Iterator[tuple[int, Columns, _Runs]]:
        """Yield the chunks with the rows of a shot never apart."""
        held: tuple[int, Columns] | None = None
        for first, columns, n in chunks:
            if held is not None:
                columns = {name: np.concatenate([held[1][name], column]) for name, column in columns.items()}
                first, n = held[0], n + first - held[0]
            runs = self._runs(columns)
            # the last shot may go on in the next chunk
            cut = n - int(runs.ordinal[-1])
            if cut:
                yield first, {name: column[:cut] for name, column in columns.items()}, runs.until(cut)
            held = (first + cut, {name: column[cut:].copy() for name, column in columns.items()})
        if held is not None:
            yield held[0], held[1], self._runs(held[1])


@dataclass(frozen=True, slots=True)
class _Runs:
    """Rows that are returns of one shot."""

    ordinal: I64
    """(n,) int64, from 1 in every shot."""
    n_rows: I64
    """(n,) int64, rows of the shot."""
    is_copy: Mask
    """(n,) bool, rows that repeat another return of the shot."""

    def until(self, stop: int) -> _Runs:
        """Return the first rows."""
        return _Runs(self.ordinal[:stop], self.n_rows[:stop], self.is_copy[:stop])


def find_runs(same: list[NDArray[Any]], place: list[NDArray[Any]], number: NDArray[Any], count: NDArray[Any]) -> _Runs:
    """Find the rows of every shot; a shot may be listed again with every return that was added.

    One shot listed with one return, then with two; then a shot of its own:

    >>> found = find_runs([np.array([1., 1., 1., 2.])], [np.array([5., 5., 9., 5.])], np.array([1, 1, 2, 1]),
    ...                   np.array([1, 2, 2, 1]))
    >>> found.ordinal, found.n_rows, found.is_copy
    (array([1, 2, 3, 1]), array([3, 3, 3, 1]), array([ True, False, False, False]))
    """
    n = len(number)
    head: Mask = np.ones(n, np.bool_)
    if n > 1:
        apart = np.zeros(n - 1, np.bool_)
        for key in same:
            apart |= key[1:] != key[:-1]
        head[1:] = apart
    lists = head | (number <= 1)
    first = np.flatnonzero(lists)
    # a list is a new one of the same shot where it is longer and begins with the same return
    longer = count[first[1:]] > count[first[:-1]]
    for key in place:
        longer = longer & (key[first[1:]] == key[first[:-1]])
    starts = lists.copy()
    starts[first[1:]] = head[first[1:]] | ~longer
    position = np.arange(n, dtype=np.int64)
    ordinal = position - np.maximum.accumulate(np.where(starts, position, 0))
    # runs without end are no returns
    starts |= (ordinal > 0) & (ordinal % MAX_RUN == 0)
    begin = np.maximum.accumulate(np.where(starts, position, 0))
    at = np.flatnonzero(starts)
    size = np.diff(np.append(at, n))
    of_shot = np.cumsum(starts) - 1
    of_list = np.cumsum(lists) - 1
    last_list = of_list[np.append(at[1:], n) - 1] if n else of_list
    is_copy = of_list != last_list[of_shot] if n else np.zeros(0, np.bool_)
    return _Runs(position - begin + 1, size[of_shot].astype(np.int64), is_copy)


def _known_fields(names: tuple[str, ...]) -> dict[str, tuple[str, LayoutField]]:
    """Map standard names to properties by their usual names; all other properties keep theirs."""
    found: dict[str, tuple[str, LayoutField]] = {
        standard: (one.name, LayoutField.model_validate({"name": standard, "unit": one.unit}))
        for standard, one in usual_names(names).items()
    }
    taken = {own for own, _ in found.values()}
    for own in names:
        # properties keep their own name beside the standard one
        if own not in found and own not in taken:
            found[own] = (own, LayoutField(name=own))
    return found


def _given_fields(head: CloudHead, layout: Layout) -> dict[str, tuple[str, LayoutField]]:
    """Map the fields of a layout to properties; all other properties keep their name."""
    check_fields(layout)
    plain = {name.lower().removeprefix("scalar_"): name for name in reversed(head.names)}
    found: dict[str, tuple[str, LayoutField]] = {}
    for item in layout.fields:
        source = item.source
        if isinstance(source, int):
            own = head.names[source] if 0 <= source < len(head.names) else None
        else:
            usual = usual_names(head.names).get(item.name) if source is None else None
            name = item.name if source is None else source
            own = name if name in head.names else plain.get(name.lower(), None if usual is None else usual.name)
        if own is None:
            problem = f"no property {item.source if item.source is not None else item.name!r} for field {item.name!r}"
            raise InputError(str(head.path), problem, f"it has: {_shown(dict.fromkeys(head.names))}")
        found[item.name] = (own, item)
    taken = {own for own, _ in found.values()}
    found.update({own: (own, LayoutField(name=own)) for own in head.names if own not in found and own not in taken})
    return found


def _first_rows(body: Body, names: tuple[str, ...]) -> Columns:
    """Return the first rows as stored."""
    with closing(body.chunks(names)) as chunks:  # type: ignore[type-var]
        return next(chunks, (0, {name: np.empty(0) for name in names}, 0))[1] if names else {}


def _with_units(
    found: dict[str, tuple[str, LayoutField]], head: CloudHead, first: Columns, notes: list[str]
) -> dict[str, tuple[str, LayoutField]]:
    """Find the units of ranges and times that are stored as whole numbers; add the offsets of coordinates."""
    found = dict(found)
    for axis, offset in zip(XYZ, head.offsets_m, strict=True):
        for name in (axis, f"{axis}_origin"):
            if offset and name in found:
                own, item = found[name]
                found[name] = (own, item.model_copy(update={"offset": offset}))
    if any(head.offsets_m):
        notes.append("a comment gives an offset of the coordinates: added to x, y, z")
    if "time" in found and first[found["time"][0]].dtype.kind in "iu" and found["time"][0].lower() == "t":
        own, item = found["time"]
        found["time"] = (own, item.model_copy(update={"unit": "ns"}))
        notes.append(f"{own} holds whole numbers: taken as nanoseconds")
    if "range" in found and first[found["range"][0]].dtype.kind in "iu" and set(XYZ) <= set(found):
        own, item = found["range"]
        with np.errstate(over="ignore", invalid="ignore"):  # a NaN that signals warns when it is cast
            xyz = np.stack([np.asarray(first[found[axis][0]], np.float64) for axis in XYZ], axis=1)
            stored = np.asarray(first[own], np.float64)
            length = np.sqrt((xyz * xyz).sum(axis=1))
            use = np.isfinite(length) & (length > 0) & (stored > 0)
            scale = float(np.median(length[use] / stored[use])) if use.any() else 1.0
        for unit, factor in (("mm", 1e-3), ("cm", 1e-2)):
            if abs(scale / factor - 1) < 0.02:
                found["range"] = (own, item.model_copy(update={"unit": unit}))
                notes.append(f"{own} holds whole numbers, {round(1 / factor)} to a metre of x, y, z: taken as {unit}")
    return found


def _own_points_per_line(comments: tuple[str, ...]) -> int | None:
    """Return M as this program wrote it; None in other files."""
    told = [text.removeprefix(OWN_COMMENT) for text in comments if text.startswith(OWN_COMMENT)]
    m = told[-1].strip() if told else ""
    return int(m) if m.isascii() and m.isdecimal() and 0 < len(m) <= 8 and int(m) else None


def _shown(names: Mapping[str, Any]) -> str:
    listed = list(names)
    return ", ".join(listed[:40]) + (", ..." if len(listed) > 40 else "")
