"""Records of an input by a key (time, record index, any integer dimension), with their class: one side of a match."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.errors import InputError
from prc_cli.core.facts import SourceFacts
from prc_cli.core.types import F64, I64, U8
from prc_cli.formats.labels import NO_CODE, CodeSource
from prc_cli.formats.records import DerivedSource, RecordChunk
from prc_cli.matching.join import CODE, KEY, SAME
from prc_cli.matching.key_rule import KeyRule, exact_keys
from prc_cli.matching.streams import RECORD, columns_of, in_step

MISSING = 0
"""Code of a shot without return in label files."""
MAX_SAME = 3
"""Numbers of 16 bits that are packed into the one that must be equal."""
_FOUND = "found code"
_LIMIT_16 = 1 << 16


@dataclass(frozen=True)
class KeyedSource(DerivedSource):
    """The records of a source that have a class, each with key, ``same`` and code.

    Chunks hold any of :data:`KEY` (float64), :data:`SAME` (int64), :data:`CODE` (uint8) and the dimensions of the
    source. Records without a class (an empty cell; code 0 in label files, a shot without return) are left out.
    """

    rule: KeyRule
    codes: CodeSource | None = None
    """Class codes from a file of their own, in record order; None = a dimension of the source."""
    code_dimension: str = "classification"

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names that :meth:`chunks` can deliver."""
        return (KEY, SAME, CODE, *self.source.dimensions)

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Decode; every chunk carries ``record``."""
        carried = tuple(name for name in names if name not in (KEY, SAME, CODE))
        own = () if self.codes is not None else (self.code_dimension,)
        wanted = tuple(dict.fromkeys((*self.rule.names, *own, *carried)))
        streams = [columns_of(self.source, wanted, sort=False)]
        if self.codes is not None:
            streams.append({_FOUND: codes} for codes in self.codes.chunks())
        n_kept = 0
        for values, *beside in in_step(streams, self._check_lengths):
            found = beside[0][_FOUND] if beside else np.asarray(values[self.code_dimension])
            if beside and not (keep := (found != MISSING) & (found != NO_CODE)).all():
                found, values = found[keep], {name: column[keep] for name, column in values.items()}
            record = values[RECORD]
            out = {name: values[name] for name in carried}
            out[CODE] = self._to_codes(found, record)
            out[KEY] = self._keys(values, record, n_kept)
            out[SAME] = self._same(values, record)
            yield RecordChunk(n_kept, {name: out[name] for name in names}, len(record), record)
            n_kept += len(record)

    def _check_lengths(self, n: Sequence[int]) -> None:
        """Refuse codes that are not as many as the records."""
        if self.codes is None or n[0] == n[1]:
            return
        problem = f"found {n[1]} class codes, expected "
        if n[1] < n[0]:
            problem += f"one for every record of {self.source.path}, which has more"
        else:
            problem += f"{n[0]} as {self.source.path} has records"
        raise InputError(self.codes.path, problem, "name the input that was classified")

    def _to_codes(self, codes: NDArray[Any], record: I64) -> U8:
        with np.errstate(invalid="ignore"):
            wrong = ~((codes >= 0) & (codes <= 255) & (np.floor(codes) == codes))
        if wrong.any():
            at = int(np.argmax(wrong))
            where = self.path if self.codes is None else self.codes.path
            problem = f"record {record[at]}: found the class code {codes[at]}, expected 0 to 255 as LAS holds them"
            raise InputError(where, problem, "name the dimension with LAS class codes: --dimension NAME")
        return codes.astype(np.uint8)

    def _keys(self, values: dict[str, NDArray[Any]], record: I64, n_before: int) -> F64:
        rule = self.rule
        if rule.kind == "record":
            return record.astype(np.float64)
        if rule.kind == "rank":
            return np.arange(n_before, n_before + len(record), dtype=np.float64)
        stored = values[rule.dimension]
        key, right = exact_keys(stored)
        expected = "a whole number below 2^53"
        if rule.kind == "time":
            right, expected = np.isfinite(key), "a finite time"
        if not right.all():
            at = int(np.argmin(right))
            problem = f"record {record[at]}: found {rule.dimension} {stored[at]}, expected {expected} for every point"
            raise InputError(self.path, problem, "leave such points out, or match by something else with --match")
        return key + rule.offset if rule.offset else key

    def _same(self, values: dict[str, NDArray[Any]], record: I64) -> I64:
        packed = np.zeros(len(record), np.int64)
        for name in self.rule.same:
            stored = values[name]
            with np.errstate(invalid="ignore"):
                wrong = ~((stored >= 0) & (stored < _LIMIT_16) & (np.floor(stored) == stored))
            if wrong.any():
                at = int(np.argmax(wrong))
                problem = f"record {record[at]}: found {name} {stored[at]}, expected a whole number from 0 to 65535"
                hint = "--ignore-return" if name == "return_number" else f"leave out --same {name}"
                raise InputError(self.path, problem, hint)
            packed = (packed << 16) | stored.astype(np.int64)
        return packed


@dataclass(frozen=True)
class CodesAlone:
    """Labels without records as a source: their number and order is all that is known."""

    codes: CodeSource
    format: str = "labels"
    dimensions: tuple[str, ...] = ()
    facts: SourceFacts = field(default_factory=SourceFacts)

    @property
    def path(self) -> str:
        """File name, for messages."""
        return self.codes.path

    @property
    def n_records(self) -> int | None:
        """Number of records; None if it is not known before reading."""
        return self.codes.n

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        """Count the codes."""
        first = 0
        for codes in self.codes.chunks():
            yield RecordChunk(first, {}, len(codes))
            first += len(codes)


@dataclass(frozen=True, slots=True)
class Survey:
    """Number, bounds and order of the keys of a source."""

    n_records: int
    """Records with a class."""
    n_read: int
    """Records of the input, up to the last one with a class."""
    low: float
    high: float
    """Bounds of the key; NaN without records."""
    in_order: bool
    """Whether the keys never go back."""

    @property
    def all_equal(self) -> bool:
        """Whether there is one key for several records."""
        return self.n_records > 1 and self.low == self.high


def survey(source: KeyedSource) -> Survey:
    """Read all keys and codes once."""
    n = n_read = 0
    low, high, last, in_order = np.inf, -np.inf, -np.inf, True
    for chunk in source.chunks((KEY, SAME, CODE)):
        key = chunk.values[KEY]
        if not len(key):
            continue
        assert chunk.record is not None
        n += len(key)
        n_read = max(n_read, int(chunk.record[-1]) + 1)
        in_order = in_order and bool(key[0] >= last) and bool(np.all(key[1:] >= key[:-1]))
        last = float(key[-1])
        low, high = min(low, float(key.min())), max(high, float(key.max()))
    return Survey(n, n_read, low if n else np.nan, high if n else np.nan, in_order)
