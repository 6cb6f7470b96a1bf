"""The first records of a source, decoded once: rules and setups of all scanners follow from them.

A reader of the head stops early. The blocks are read from the source itself, from the start.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np

from prc_cli.core.errors import InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.types import F32
from prc_cli.formats.options import InputConfig
from prc_cli.formats.ranges import continues_run, mark_shots
from prc_cli.formats.records import STANDARD_NAMES, Reading, RecordChunk, Source
from prc_cli.streams.columns import (
    Table,
    check_scanners,
    join,
    n_rows,
    split_scanners,
    table_of,
    take,
)
from prc_cli.streams.evidence.periods import MAX_SHOTS
from prc_cli.streams.replay import Replay

HEAD_RECORDS = 1 << 18
"""Number of first records that are kept, and used for estimates."""
HEAD_RECORDS_EACH = 1 << 16
"""Number of first records per scanner used for estimates where several share the input."""
_RETURNS = ("return_number", "number_of_returns")


@dataclass(frozen=True)
class Head:
    """A source whose first records are kept, for many readers one after the other."""

    source: Source
    expected: set[str] = field(default_factory=set)
    """Dimensions that are decoded with the first ones asked for: other readers will need them."""
    _readings: dict[frozenset[str], Replay[RecordChunk]] = field(default_factory=dict)
    """By the dimensions that are decoded together."""

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
        """Metadata of the file."""
        return self.source.facts

    def with_reading(self, reading: Reading) -> Head:
        """Return the head of a source that is read in this way; the kept records stay."""
        return replace(self, source=self.source.with_reading(reading))

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode dimensions from the start, or return those that were decoded before."""
        decoded = self._decoded_with(names)
        position = 0
        try:
            for chunk in self._readings[decoded].read_head():
                yield _select(chunk, names)
                position += 1
        except InputError:
            self._readings.pop(decoded, None)
            if decoded == frozenset(names):
                raise
            # a dimension that nobody has asked for may be damaged
            self.expected.clear()
            exact = self._readings[self._decoded_with(names)]
            for chunk in islice(exact.read_head(), position, None):
                yield _select(chunk, names)

    def _decoded_with(self, names: tuple[str, ...]) -> frozenset[str]:
        """Return the dimensions of a reading that has all ``names``."""
        for decoded in self._readings:
            if decoded.issuperset(names):
                return decoded
        beside = (name for name in self.dimensions if name in self.expected)
        every = tuple(dict.fromkeys((*names, *beside)))
        decoded = frozenset(every)
        self._readings[decoded] = Replay(
            lambda: self.source.chunks(every), lambda chunk: chunk.n, HEAD_RECORDS
        )
        return decoded

    def forget(self) -> None:
        """Free the kept records, and end their readings."""
        while self._readings:
            _, reading = self._readings.popitem()
            reading.forget()


def _select(chunk: RecordChunk, names: tuple[str, ...]) -> RecordChunk:
    # a table of its own: readers add columns
    return replace(chunk, values={name: chunk.values[name] for name in names})


def head_of(source: Source, config: InputConfig, *, geometry: bool) -> Head:
    """Return the head of a source; with scan angles and ``geometry`` all usual dimensions count."""
    if not geometry or "angle" not in source.dimensions:
        return Head(source)
    usual = {*STANDARD_NAMES, config.scanner} - {"intensity"}
    return Head(source, usual & set(source.dimensions))


def first_shots(source: Source, scanner: str | None, *beside: str) -> Table:
    """Return times, angles, line numbers and more of the first shots of the first scanner."""
    has = source.dimensions
    keys = tuple(name for name in ("time", "angle", "scan_line") if name in has)
    several = "number_of_returns" in has
    returns = tuple(name for name in _RETURNS if name in has) if several else ()
    scanners = () if scanner is None else (scanner,)
    wanted = tuple(dict.fromkeys((*keys, *beside, *returns, *scanners)))
    first = next(iter(source.chunks(wanted)), None)
    values: Table = {name: np.empty(0) for name in wanted} if first is None else first.values
    if scanner is not None:
        values = take(values, values[scanner] == values[scanner][:1])
    if several:
        continues = continues_run(tuple(values[key] for key in keys), values["number_of_returns"])
        values = take(values, mark_shots(continues, values.get("return_number")))
    return values


def shots_in_time(source: Source, names: tuple[str, ...], most: int) -> Iterator[Table]:
    """Yield times and other dimensions of the first shots, about ``most``.

    Of returns with one time only the first is kept.
    """
    several = set(_RETURNS) <= set(source.dimensions)
    wanted = dict.fromkeys((*names, "time", *(_RETURNS if several else ())))
    n = 0
    for chunk in source.chunks(tuple(wanted)):
        values = chunk.values
        if several:
            continues = continues_run((values["time"],), values["number_of_returns"])
            values = take(values, mark_shots(continues, values["return_number"]))
        yield values
        n += len(values["time"])
        if n >= most:
            return


def first_records(
    source: Source,
    scanner: str | None,
    names: tuple[str, ...],
    limit: int,
    *,
    to_end: bool,
) -> dict[int, Table]:
    """Return the first ``limit`` records of every scanner; or of the input, unless ``to_end``."""
    parts: dict[int, list[Table]] = {}
    n_kept: dict[int, int] = {}
    n_seen = 0
    for chunk in source.chunks(names):
        table = table_of(chunk, names)
        if not to_end:
            table = take(table, slice(0, limit - n_seen))
        n_seen += n_rows(table)
        for number, records in split_scanners(table, scanner, source.path):
            left = limit - n_kept.setdefault(number, 0)
            if left > 0:
                more = take(records, slice(0, left))
                parts.setdefault(number, []).append(more)
                n_kept[number] += n_rows(more)
        check_scanners(len(parts), source.path, scanner)
        if not to_end and n_seen >= limit:
            break
    return {number: join(tables) for number, tables in sorted(parts.items())}


def first_ranges(source: Source) -> F32:
    """Return the first ranges of a source, (n,) float32 [its unit]; NaN = missing."""
    parts: list[F32] = []
    n_kept = 0
    for chunk in source.chunks(("range",)):
        parts.append(np.asarray(chunk.values["range"], np.float32)[: MAX_SHOTS - n_kept])
        n_kept += parts[-1].size
        if n_kept >= MAX_SHOTS:
            break
    flat = np.concatenate(parts)
    return np.where(np.isfinite(flat) & (flat > 0), flat, np.float32(np.nan))
