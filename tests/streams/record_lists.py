"""Lists of records in memory, and a small scene for which every rule must give the same result."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.facts import SourceFacts
from prc_cli.core.stream import ReadTally, ScanBlock, ScanStream
from prc_cli.core.types import F32, I64
from prc_cli.formats.options import InputConfig
from prc_cli.formats.records import Reading, RecordChunk
from prc_cli.streams.grid import open_grid

N_LINES = 23
M = 40
LINE_HZ = 50.0
SHOT_HZ = LINE_HZ * M
START_S = 318_000.25


@dataclass
class MemorySource:
    """Records in memory, delivered in chunks of any size; counts how often it was read."""

    values: dict[str, NDArray[Any]]
    chunk_records: int = 1000
    path: str = "drive.bin"
    format: str = "raw binary"
    record: I64 | None = None
    facts: SourceFacts = field(default_factory=SourceFacts)
    reads: list[tuple[str, ...]] = field(default_factory=list)

    @property
    def n_records(self) -> int | None:
        return len(next(iter(self.values.values())))

    @property
    def dimensions(self) -> tuple[str, ...]:
        return tuple(self.values)

    def with_reading(self, reading: Reading) -> MemorySource:
        return self

    def chunks(self, names: tuple[str, ...]) -> Iterator[RecordChunk]:
        self.reads.append(names)
        n = self.n_records or 0
        for first in range(0, n, self.chunk_records):
            part = slice(first, min(first + self.chunk_records, n))
            record = None if self.record is None else self.record[part]
            yield RecordChunk(
                first, {name: self.values[name][part] for name in names}, part.stop - first, record
            )


def scene(seed: int = 0, *, missing: float = 0.2) -> tuple[F32, dict[str, NDArray[Any]]]:
    """Return the range image and its records.

    Missing shots have no record, line 9 has none at all.
    """
    rng = np.random.default_rng(seed)
    line, column = np.divmod(np.arange(N_LINES * M), M)
    angle = 2 * np.pi * column / M
    range_m = rng.uniform(2.0, 60.0, len(line)).astype(np.float32)
    keep = rng.random(len(line)) >= missing
    keep[line == 9] = False
    keep[[0, M - 1, -1]] = True
    image = np.where(keep, range_m, np.float32(np.nan)).reshape(N_LINES, M)
    # sensor coordinates that give the range exactly enough: float64
    records = {
        "range": range_m,
        "scan_line": line,
        "column": column,
        "angle": angle,
        "time": START_S + line / LINE_HZ + column / SHOT_HZ,
        "x": range_m * np.sin(angle),
        "y": np.zeros(len(line)),
        "z": -range_m * np.cos(angle),
        "intensity": rng.integers(0, 1000, len(line)).astype(np.uint16),
    }
    return image, {name: value[keep] for name, value in records.items()}


def only(records: dict[str, NDArray[Any]], *names: str) -> dict[str, NDArray[Any]]:
    """Return some dimensions of a scene."""
    return {name: records[name] for name in names}


def open_records(
    records: dict[str, NDArray[Any]], chunk_records: int = 1000, **options: Any
) -> ScanStream:
    """Open records with ``[input]`` keys as keyword arguments (``return_`` for ``return``)."""
    keys = {key.rstrip("_"): value for key, value in options.items()}
    return open_grid(MemorySource(records, chunk_records), InputConfig(**keys))


@dataclass(frozen=True)
class Whole:
    """All blocks of a stream in one piece, by scanner where there are several."""

    range_m: F32
    record: I64
    tally: ReadTally
    """What was met; the number of records is checked by :func:`read` and left out."""
    blocks: list[ScanBlock]

    @property
    def extras(self) -> list[tuple[int, int, float, int]]:
        """Line, column, range and record of every further return, sorted."""
        returns = [
            (block.first_line + int(line), int(column), float(range_m), int(record))
            for block in self.blocks
            for line, column, range_m, record in zip(
                block.extra.line,
                block.extra.column,
                block.extra.range_m,
                block.extra.record,
                strict=True,
            )
        ]
        return sorted(returns, key=lambda item: item[3])


def read(stream: ScanStream, scanner: int | None = None) -> Whole:
    """Read a stream whole; check what every block must be."""
    blocks = list(stream.blocks())
    tally = ReadTally()
    for block in blocks:
        tally = tally + block.tally
    # every record is counted, placed or not, whatever the rules and chunks
    assert stream.info.n_records in (None, tally.n_records)
    tally = replace(tally, n_records=0)
    chosen = [block for block in blocks if scanner is None or block.scanner == scanner]
    expected = 0
    for block in chosen:
        assert block.first_line == expected
        assert block.n_lines >= 1
        assert block.range_m.dtype == np.float32
        assert block.range_m.flags.c_contiguous
        assert not np.any(block.range_m <= 0)
        assert not np.any(np.isinf(block.range_m))
        expected += block.n_lines
    return Whole(
        np.concatenate([block.range_m for block in chosen]),
        np.concatenate([block.records() for block in chosen]),
        tally,
        chosen,
    )
