"""The random sample of a check by hand: shots by predicted class and confidence."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import F64, I64, U8
from prc_cli.evaluation.answers import SampleStratum
from prc_cli.evaluation.stratified import allocate
from prc_cli.formats.records import Source
from prc_cli.imaging.check_page import Cell
from prc_cli.jobs.render.colours import RecordClasses, Vocabulary

SURE = 90
"""Confidence that divides a class into two strata [%]: most errors are below."""
_OWN = 0x636865636B
"""Part of the seed: the numbers are none that a simulated drive has its noise from."""
_KEPT = 4
"""Candidates are reduced when there are this many times as many as needed."""


@dataclass(frozen=True, slots=True)
class Drawn:
    """A stratified random sample."""

    strata: tuple[SampleStratum, ...]
    places: tuple[Cell, ...]
    """In an order in which every beginning is a sample too."""


@dataclass(slots=True)
class _Candidates:
    """The shots of one stratum with the smallest random numbers so far."""

    most: int
    n_shots: int = 0
    limit: float = np.inf
    """Greater random numbers are out."""
    rows: list[F64] = field(default_factory=list)
    """Random number, scanner, line, column, record, (n, 5) float64 each."""

    def add(self, rows: F64) -> None:
        self.rows.append(rows)
        if sum(map(len, self.rows)) > _KEPT * self.most:
            self.rows = [self.smallest(self.most)]
            self.limit = float(self.rows[0][-1, 0])

    def smallest(self, n: int) -> F64:
        """Return the rows with the smallest random numbers, in their order."""
        rows = np.concatenate(self.rows)
        return rows[np.argsort(rows[:, 0], kind="stable")][:n]


def draw(
    blocks: Iterator[ScanBlock],
    words: Vocabulary,
    classes: RecordClasses,
    confidence: U8 | None,
    n: int,
    seed: int,
    see: Callable[[ScanBlock], None],
) -> Drawn:
    """Draw shots at random from every stratum; only candidates stay in memory.

    Every shot gets a random number, and the smallest ones of a stratum are drawn. So a larger
    sample with the same seed contains the smaller one.

    Parameters
    ----------
    blocks : iterator of ScanBlock
    words : Vocabulary
        Names of the classes.
    classes : RecordClasses
        Predicted class of every record.
    confidence : (records,) uint8, optional
        Confidence of every record [%], 0 = unknown.
    n : int
        Shots to draw.
    seed : int
    see : callable
        Called with every block that was read.
    """
    random = np.random.default_rng((_OWN, seed))
    candidates: dict[int, _Candidates] = {}
    for block in blocks:
        number = random.random(block.range_m.shape)
        record = block.records()
        seen = ~np.isnan(block.range_m)
        places = words.mark_unscored(np.where(seen, classes.look_up(record), np.uint8(0)), seen)
        stratum = 2 * places.astype(np.int64)
        if confidence is not None:
            stratum += (record >= 0) & (confidence[np.maximum(record, 0)] >= SURE)
        for key in np.unique(stratum[seen]).tolist():
            kept = candidates.setdefault(key, _Candidates(n))
            inside = seen & (stratum == key)
            kept.n_shots += int(np.count_nonzero(inside))
            line, column = np.nonzero(inside & (number < kept.limit))
            scanner = np.full(len(line), block.scanner)
            rows = (number[line, column], scanner, line + block.first_line, column)
            kept.add(np.column_stack([*rows, record[line, column]]))
        see(block)
    return _chosen(candidates, words, n, random, divided=confidence is not None)


def _chosen(
    candidates: dict[int, _Candidates],
    words: Vocabulary,
    n: int,
    random: np.random.Generator,
    *,
    divided: bool,
) -> Drawn:
    keys = sorted(candidates)
    counts = allocate([candidates[key].n_shots for key in keys], n) if keys else []
    strata = []
    places = []
    turns = []
    for stratum, (key, n_drawn) in enumerate(zip(keys, counts, strict=True)):
        is_sure = bool(key % 2)
        strata.append(
            SampleStratum(
                predicted=words.table.names[key // 2],
                low=(SURE if is_sure else 0) if divided else None,
                high=(100 if is_sure else SURE - 1) if divided else None,
                n_shots=candidates[key].n_shots,
                n_drawn=n_drawn,
            )
        )
        rows = candidates[key].smallest(n_drawn)[:, 1:].astype(np.int64).tolist()
        places += [Cell._make((*row, stratum)) for row in rows]
        # strata alternate, so that a person may stop at any place
        turns.append((np.arange(n_drawn) + random.random(n_drawn)) / max(n_drawn, 1))
    order = np.argsort(np.concatenate(turns), kind="stable") if turns else ()
    return Drawn(tuple(strata), tuple(places[int(k)] for k in order))


def read_confidence(records: Source | None, folder: Path) -> U8 | None:
    """Read the confidence of every record into a file of one byte each; None if there is none."""
    name = "confidence"
    if records is None or name not in records.dimensions:
        return None
    target = folder / "confidence"
    n = 0
    with target.open("wb") as handle:
        for chunk in records.chunks((name,)):
            values = np.clip(np.nan_to_num(chunk.values[name]), 0, 100).astype(np.uint8)
            record = chunk.records()
            handle.seek(int(record.min(initial=n)))
            values[np.argsort(record, kind="stable")].tofile(handle)
            n += chunk.n
    return np.memmap(target, np.uint8, "r", shape=(n,)) if n else None


def order_lines(places: tuple[Cell, ...], scanner: int) -> tuple[I64, I64]:
    """Return the lines of a scanner's places in order, and their numbers among all places."""
    numbers = np.array([k for k, place in enumerate(places) if place.scanner == scanner], np.int64)
    lines = np.array([places[int(k)].line for k in numbers], np.int64)
    order = np.argsort(lines, kind="stable")
    return lines[order], numbers[order]
