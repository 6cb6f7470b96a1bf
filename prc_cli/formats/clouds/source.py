"""Clouds of named properties (PLY, PCD).

Lines of headers, which property is what, returns of a shot.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.facts import KnownRule, SourceFacts
from prc_cli.core.files import open_to_read
from prc_cli.core.types import I64, Mask
from prc_cli.formats.names import NAMES, angle_rules, find_columns, ring_rules
from prc_cli.formats.options import Layout
from prc_cli.formats.records import (
    AXES,
    Body,
    FieldSource,
    RecordChunk,
    Stored,
    check_names,
    shorten,
)
from prc_cli.formats.text.dialect import BLANKS, TextFormat
from prc_cli.formats.text.read import TextBody

MAX_HEADER_BYTES = 1 << 20
"""Longest header."""
MAX_PROPERTIES = 10_000
"""Most numbers of a point."""
MAX_RUN = 255
"""Most rows of a shot: longer runs of equal times and angles are no returns."""
NO_CELL = 0xFFFFFFFF
"""Line and column of a point without a cell, in files of this program."""
OWN_COMMENT = "prc points_per_line "
"""Comment of files of this program, with M behind it."""
_RETURN = "return_number"
_RETURNS = "number_of_returns"

Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True, slots=True, kw_only=True)
class CloudHead:
    """What the header of a cloud says."""

    path: Path
    format: str
    types: Mapping[str, np.dtype[Any]]
    """Stored type by property, in order."""
    keys: tuple[str, ...] = ()
    """Names of the properties in the body; empty = as in the header."""
    offsets_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Offset of x, y, z from a comment [m]."""
    rules: tuple[KnownRule, ...] = ()
    points_per_line: int | None = None
    viewpoint: tuple[float, ...] = ()
    """Position and direction of the sensor in the header; empty = none."""
    others: tuple[str, ...] = ()
    """Other contents of the file, such as elements beside the points."""
    vectors: tuple[str, ...] = ()
    """Fields of several numbers."""
    notes: tuple[str, ...] = ()
    comments: tuple[str, ...] = ()
    described: Mapping[str, Any] = field(default_factory=dict)


def header_lines(path: Path, last: str, hint: str) -> Iterator[tuple[int, str, int]]:
    """Yield number, text and end of every header line, up to the one with the word ``last``."""
    with open_to_read(path) as handle:
        head = handle.read(MAX_HEADER_BYTES)
    position = number = 0
    line = ""
    while line.split()[:1] != [last]:
        end = head.find(b"\n", position)
        number = number + 1
        if end < 0:
            raise InputError(
                f"{path}: line {number}", f"no line {last} in the first {len(head)} bytes", hint
            )
        line = head[position:end].decode("utf-8", errors="replace").strip()
        position = end + 1
        yield number, line, position


def whole_number(where: str, cell: str, most: int = sys.maxsize) -> int:
    """Return the number in a cell of a header."""
    if not (cell.isascii() and cell.isdecimal()) or len(cell) > 16 or int(cell) > most:
        raise InputError(
            where, f"found {shorten(cell)!r}, expected a whole number", "export it again"
        )
    return int(cell)


def text_body(
    path: Path,
    names: tuple[str, ...],
    first_line: int,
    n: int,
) -> TextBody:
    """Return rows of numbers behind a header."""
    return TextBody(
        path, TextFormat(BLANKS, b"", first_line - 1, first_line, names, False), n_records=n
    )


class CloudSource(FieldSource):
    """A cloud as a :class:`prc_cli.formats.records.Source`."""

    def __init__(self, head: CloudHead, body: Body, layout: Layout | None = None) -> None:
        names = tuple(head.types)
        super().__init__(
            head.path, head.format, find_columns(str(head.path), names, layout, head.keys), body
        )
        self.head = head
        """The header of the file."""
        has_layout = layout is not None and bool(layout.fields)
        own_m = _own_points_per_line(head.comments)
        notes = list(head.notes)
        columns = self.columns
        looked_at = ("time", "angle", "range", *AXES, _RETURN, _RETURNS)
        first = self._first_rows([columns[name].key for name in looked_at if name in columns])
        if not has_layout:
            self._find_units(first, notes)
        if own_m is not None:
            self._change(("scan_line", "column"), missing=float(NO_CELL))
        self._has_pulses = {_RETURN, _RETURNS, "time"} <= set(columns)
        if self._has_pulses and len(first[columns["time"].key]):
            is_copy = self._runs(first).is_copy
            n_copies = int(np.count_nonzero(is_copy))
            if n_copies:
                notes.append(
                    f"{n_copies} of the first {len(is_copy)} rows repeat an earlier return "
                    "of their "
                    "shot: they are further returns, not shots"
                )
            # other programs list every return once
            self._has_pulses = n_copies > 0 or columns[_RETURN].name.lower() == "num_echo"
        renamed = [
            f"{column.name} as {name}"
            for name, column in columns.items()
            if column.name != name and name in NAMES
        ]
        if renamed and not has_layout:
            notes.append(f"properties taken under another name: {', '.join(renamed)}")
        has_own_lines = "scan_line" in columns and own_m is None
        rules = list(head.rules)
        if {"ring", *AXES} <= set(columns) and not has_own_lines and "angle" not in columns:
            rules += [
                rule
                for rule in ring_rules()
                if rule.key not in {column.key for column in head.rules}
            ]
        rules += angle_rules(columns["angle"].name if "angle" in columns else None)
        self.facts = SourceFacts(
            range_name=columns["range"].name if "range" in columns else "range",
            points_per_line=own_m
            if "column" in columns and own_m is not None
            else head.points_per_line,
            rules=tuple(rules),
            notes=tuple(notes),
            header=dict(head.described),
        )

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode the named properties in bounded memory, in the order of the file."""
        if not (self._has_pulses and {_RETURN, _RETURNS} & set(names)):
            yield from super().chunks(names)
            return
        check_names(self, names)
        keys = [
            self.columns[name].key
            for name in ("time", "angle", "range", *AXES, *names)
            if name in self.columns
        ]
        keys += [self.columns[_RETURN].key, self.columns[_RETURNS].key]
        stored_names = tuple(name for name in names if name not in (_RETURN, _RETURNS))
        for first, stored, runs in self._whole_runs(self.body.stored(tuple(dict.fromkeys(keys)))):
            chunk = self.decoded(first, stored, stored_names, len(runs.ordinal))
            made = {_RETURN: runs.ordinal, _RETURNS: runs.n_rows}
            yield replace(
                chunk,
                values={name: made[name] if name in made else chunk.values[name] for name in names},
            )

    def stored(self, names: tuple[str, ...]) -> Iterator[tuple[int, Columns, int]]:
        """Yield index of the first record, stored values by property, and number of records."""
        keys = dict(zip(self.head.types, self.head.keys or self.head.types, strict=True))
        wanted = tuple(keys[name] for name in names or tuple(keys)[:1])
        for first, stored, n in self.body.stored(wanted):
            yield first, {name: stored[keys[name]] for name in names}, n

    def _first_rows(self, keys: list[str]) -> Columns:
        with closing(self.body.stored(tuple(keys))) as chunks:  # type: ignore[type-var]
            stored = next(chunks, (0, {key: np.empty(0) for key in keys}, 0))[1] if keys else {}
        return {key: stored[key] for key in keys}

    def _change(self, names: tuple[str, ...], **values: Any) -> None:
        for name in names:
            if name in self.columns:
                column = self.columns[name]
                self.columns[name] = replace(column, item=column.item.model_copy(update=values))

    def _find_units(self, first: Columns, notes: list[str]) -> None:
        """Find the units of ranges and times in integers; add the offsets of coordinates."""
        columns = self.columns
        for axis, offset in zip(AXES, self.head.offsets_m, strict=True):
            if offset:
                self._change((axis, f"{axis}_origin"), offset=offset)
        if any(self.head.offsets_m):
            notes.append("a comment gives an offset of the coordinates: added to x, y, z")
        time = columns.get("time")
        range_ = columns.get("range")
        if time is not None and first[time.key].dtype.kind in "iu" and time.name.lower() == "t":
            self._change(("time",), unit="ns")
            notes.append(f"{time.name} holds whole numbers: taken as nanoseconds")
        if (
            range_ is not None
            and first[range_.key].dtype.kind in "iu"
            and set(AXES) <= set(columns)
        ):
            with np.errstate(
                over="ignore", invalid="ignore"
            ):  # a NaN that signals warns when it is cast
                xyz = np.stack(
                    [np.asarray(first[columns[axis].key], np.float64) for axis in AXES], axis=1
                )
                stored = np.asarray(first[range_.key], np.float64)
                length = np.sqrt((xyz * xyz).sum(axis=1))
                use = np.isfinite(length) & (length > 0) & (stored > 0)
                scale = float(np.median(length[use] / stored[use])) if use.any() else 1.0
            for unit, factor in (("mm", 1e-3), ("cm", 1e-2)):
                if abs(scale / factor - 1) < 0.02:
                    self._change(("range",), unit=unit)
                    ratio = f"{round(1 / factor)} to a metre of x, y, z: taken as {unit}"
                    notes.append(f"{range_.name} holds whole numbers, {ratio}")

    def _runs(self, stored: Stored) -> _Runs:
        columns = self.columns
        same = [stored[columns[name].key] for name in ("time", "angle") if name in columns]
        place = [stored[columns[name].key] for name in ("range", *AXES) if name in columns][:1]
        return find_runs(same, place, stored[columns[_RETURN].key], stored[columns[_RETURNS].key])

    def _whole_runs(
        self, chunks: Iterator[tuple[int, Stored, int]]
    ) -> Iterator[tuple[int, Stored, _Runs]]:
        """Yield chunks in which no shot is split."""
        held: tuple[int, Stored] | None = None
        for first, stored, n in chunks:
            if held is not None:
                stored = _each(lambda old, new: np.concatenate([old, new]), held[1], stored)
                first, n = held[0], n + first - held[0]
            runs = self._runs(stored)
            # the last shot may continue in the next chunk
            cut = n - int(runs.ordinal[-1])
            if cut:
                yield first, _each(lambda column, cut=cut: column[:cut], stored), runs.until(cut)
            held = (first + cut, _each(lambda column, cut=cut: column[cut:].copy(), stored))
        if held is not None:
            yield held[0], held[1], self._runs(held[1])


def _each(change: Any, *stored: Stored) -> Stored:
    if isinstance(stored[0], np.ndarray):
        return change(*stored)  # type: ignore[no-any-return]
    return {name: change(*(table[name] for table in stored)) for name in stored[0]}


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
        return _Runs(self.ordinal[:stop], self.n_rows[:stop], self.is_copy[:stop])


def find_runs(
    same: list[NDArray[Any]],
    place: list[NDArray[Any]],
    number: NDArray[Any],
    count: NDArray[Any],
) -> _Runs:
    """Find the rows of every shot, which may be listed again with every added return.

    One shot listed with one return, then with two; then a shot of its own:

    >>> time, range_m = np.array([1.0, 1.0, 1.0, 2.0]), np.array([5.0, 5.0, 9.0, 5.0])
    >>> runs = find_runs([time], [range_m], np.array([1, 1, 2, 1]), np.array([1, 2, 2, 1]))
    >>> runs.ordinal, runs.n_rows, runs.is_copy
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
    # a list that is longer and begins with the same return is of the same shot
    longer = count[first[1:]] > count[first[:-1]]
    for key in place:
        longer = longer & (key[first[1:]] == key[first[:-1]])
    starts = lists.copy()
    starts[first[1:]] = head[first[1:]] | ~longer
    position = np.arange(n, dtype=np.int64)
    ordinal = position - np.maximum.accumulate(np.where(starts, position, 0))
    # endless runs are not returns
    starts |= (ordinal > 0) & (ordinal % MAX_RUN == 0)
    begin = np.maximum.accumulate(np.where(starts, position, 0))
    first_rows = np.flatnonzero(starts)
    size = np.diff(np.append(first_rows, n))
    of_shot = np.cumsum(starts) - 1
    of_list = np.cumsum(lists) - 1
    last_list = of_list[np.append(first_rows[1:], n) - 1] if n else of_list
    is_copy = of_list != last_list[of_shot] if n else np.zeros(0, np.bool_)
    return _Runs(position - begin + 1, size[of_shot].astype(np.int64), is_copy)


def _own_points_per_line(comments: tuple[str, ...]) -> int | None:
    """Return M from a comment of prc; None in other files."""
    numbers = [text.removeprefix(OWN_COMMENT) for text in comments if text.startswith(OWN_COMMENT)]
    m = numbers[-1].strip() if numbers else ""
    return int(m) if m.isascii() and m.isdecimal() and 0 < len(m) <= 8 and int(m) else None
