"""Confusion counts of an evaluation: of all pairs, of parts, of blocks, and a map of errors."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from prc_cli.core.types import F64, I64, U8, Mask
from prc_cli.evaluation.confusion import (
    UNKNOWN,
    ConfusionMatrix,
    GroupedCounts,
    block_groups,
    cells_of,
    check_edges,
    file_and_block,
    range_bounds,
    range_groups,
)
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.evaluation.places import Place, best_first
from prc_cli.evaluation.scores import (
    FEW_BLOCKS,
    LEVEL,
    NO_STATE,
    Interval,
    SplitPart,
    ThreeCounts,
    block_intervals,
)
from prc_cli.jobs.evaluate.cuts import ScoredWindow
from prc_cli.jobs.evaluate.options import EvaluateOptions
from prc_cli.jobs.evaluate.places import PairFile, PlaceCollector
from prc_cli.matching.join import CODE, Columns
from prc_cli.matching.nearest import cell_keys, cell_places
from prc_cli.matching.sides import CONFIDENCE, FILE, LINE, RANGE, ROW, SCANNER

MOST_CONFIDENCE = 100
TOP_SHARE = 0.9
"""The notes report on this share of the pairs, the pairs with the highest confidence."""
RECORDS_PER_LINE = 1000
"""Records that count as one scan line in the blocks of an input without known lines."""
SPLITS = {RANGE: "range", LINE: "lines", SCANNER: "scanner", CONFIDENCE: "confidence"}
"""Names of the splits by column."""

EDGE_M = 0.5
"""Side of a square of the map [m]."""
_MOST_PIXELS = 1600
_WHITE = (255, 255, 255)
STATE_COLOURS = ((222, 222, 222), (0, 114, 178), (230, 159, 0), (180, 20, 40), (204, 121, 167))
"""Colours of :data:`~prc_cli.evaluation.scores.STATES` (by Okabe and Ito, for the colour-blind)."""


class StatePlan:
    """Map of the shots by state: counts of every square."""

    def __init__(self) -> None:
        self._keys = np.empty(0, np.int64)
        self._counts = np.empty((0, NO_STATE + 1), np.int64)

    def add(self, x: F64, y: F64, states: U8) -> None:
        """Count shots, by their coordinates [m] and states, all (n,)."""
        keys, index = np.unique(cell_keys(x, y, EDGE_M), return_inverse=True)
        n = np.bincount(index * (NO_STATE + 1) + states, minlength=len(keys) * (NO_STATE + 1))
        all_keys = np.concatenate([self._keys, keys])
        self._keys, index_of_key = np.unique(all_keys, return_inverse=True)
        counts = np.zeros((len(self._keys), NO_STATE + 1), np.int64)
        np.add.at(counts, index_of_key, np.concatenate([self._counts, n.reshape(-1, NO_STATE + 1)]))
        self._counts = counts

    def picture(self) -> bytes | None:
        """Draw the most frequent error of every square, or grey; None without coordinates."""
        from PIL import Image

        column, row = cell_places(self._keys)
        if not len(column):
            return None
        column = column - column.min()
        row = row.max() - row
        step = -(-max(int(column.max()), int(row.max()), 1) // _MOST_PIXELS)
        shape = int(row.max()) // step + 1, int(column.max()) // step + 1
        totals = np.zeros((shape[0] * shape[1], NO_STATE), np.int64)
        np.add.at(totals, row // step * shape[1] + column // step, self._counts[:, :NO_STATE])
        image = Image.fromarray(_worst(totals).reshape(shape))
        image.putpalette([value for colour in (_WHITE, *STATE_COLOURS) for value in colour])
        zoom = max(1, 800 // max(shape))
        target = io.BytesIO()
        image.resize((shape[1] * zoom, shape[0] * zoom), Image.Resampling.NEAREST).save(
            target, "PNG", optimize=True
        )
        return target.getvalue()


def _worst(counts: I64) -> U8:
    # colour of a square: 0 = no shots, 1 = mostly right, else 1 + the most frequent other state
    n = counts.sum(axis=1)
    wrong = counts[:, 1:]
    colour = np.where(2 * wrong.sum(axis=1) > n, 2 + np.argmax(wrong, axis=1), 1)
    return np.where(n > 0, colour, 0).astype(np.uint8)


@dataclass(frozen=True, slots=True)
class Plan:
    """Columns to read beside the codes, of either side."""

    predicted: tuple[str, ...]
    reference: tuple[str, ...]
    keys: tuple[str, ...]
    """Columns of both sides that the match needs."""
    noted: tuple[str, ...] = ()
    """Columns of the reference that a note names."""
    in_space: bool = False
    """Whether places are groups in space, not of lines and columns."""


@dataclass(frozen=True, slots=True)
class Compared:
    """Predicted records and their partners."""

    predicted: Columns
    """Columns of the predicted side."""
    reference: Columns
    """Columns of the partners, as in the plan."""
    rows: I64
    """(n,) reference class, as an index of its names; negative = not scored."""
    third: I64 | None = None
    """(n,) codes of the third labelling, -1 = none; None = no third labelling."""

    def kept(self, keep: Mask) -> Compared:
        """Return the records of a mask."""
        return Compared(
            {name: values[keep] for name, values in self.predicted.items()},
            {name: values[keep] for name, values in self.reference.items()},
            self.rows[keep],
            None if self.third is None else self.third[keep],
        )


@dataclass(slots=True)
class Counts:
    """All counts, summed over all pairs of files."""

    mapping: ClassMapping
    parts: dict[str, GroupedCounts]
    """Grouped counts by split; ``all`` has one group, ``blocks`` the blocks of the intervals."""
    n_predicted: int = 0
    n_reference: int = 0
    n_matched: int = 0
    n_reference_matched: int = 0
    third: ThreeCounts | None = None
    plan: StatePlan = field(default_factory=StatePlan)
    tolerances: set[float] = field(default_factory=set)
    """Largest distances of pairs, if they were chosen from the data."""
    places: list[Place] = field(default_factory=list)
    n_differ: int = 0
    pair_file: PairFile | None = None
    folded: dict[str, str] = field(default_factory=dict)
    """Predicted classes that are counted as others."""
    notes: dict[str, int] = field(default_factory=dict)
    """Sentences, and the numbers for their ``{n}``; 0 for sentences without a number."""

    def note(self, sentence: str, n: int = 0) -> None:
        """Add a sentence; numbers of equal sentences are added."""
        if n or "{n}" not in sentence:
            self.notes[sentence] = self.notes.get(sentence, 0) + n

    def restart_pairs(self) -> None:
        """Forget the pairs of a match that starts again."""
        if self.pair_file is not None:
            self.pair_file.restart()

    def fold(self) -> None:
        """Count predicted classes that the reference never has as coarser ones of the mapping."""
        matrix = self.parts["all"].matrix(0)
        n_reference = dict(zip(matrix.reference_names, matrix.counts.sum(axis=1), strict=True))
        n_predicted = dict(zip(matrix.predicted_names, matrix.counts.sum(axis=0), strict=True))
        folded = {
            name: coarser
            for name, coarser in self.mapping.coarser.items()
            if not n_reference.get(name) and n_predicted[name]
        }
        if folded:
            pairs = ", ".join(f"{name} as {coarser}" for name, coarser in folded.items())
            self.note(f"the reference has no {', '.join(folded)}: counted {pairs}")
        self.folded = folded
        for part in self.parts.values():
            part.fold(folded)
        if self.third is not None:
            self.third.fold(folded)


def asked_parts(options: EvaluateOptions) -> tuple[str, ...]:
    """Return the requested splits, and ``blocks`` if intervals are requested."""
    asked = {
        RANGE: bool(options.split_range_m),
        LINE: options.split_lines is not None,
        SCANNER: options.split_scanner,
        CONFIDENCE: bool(options.split_confidence),
        "blocks": options.intervals,
    }
    return tuple(name for name, is_asked in asked.items() if is_asked)


class Counting:
    """Counts of one pool of files; ``finish`` adds them to the others if the match succeeded."""

    def __init__(
        self,
        counts: Counts,
        options: EvaluateOptions,
        plan: Plan,
        first_file: int,
        *,
        by_lines: bool,
    ) -> None:
        self._counts = counts
        self._options = options
        self._plan = plan
        self._first_file = first_file
        self._by_lines = by_lines
        self._parts = {name: GroupedCounts(counts.mapping, name) for name in counts.parts}
        self._window = None if options.window is None else ScoredWindow(options.window)
        self._places: PlaceCollector | None = None
        if options.places:
            self._places = PlaceCollector(counts.mapping, counts.pair_file, in_space=plan.in_space)

    def add(self, pairs: Compared) -> None:
        """Count pairs that are within the window."""
        columns = pairs.reference | {name: pairs.predicted[name] for name in self._plan.predicted}
        keep = np.ones(len(pairs.rows), np.bool_)
        if self._window is not None:
            keep = self._window.keep(columns)
        if not keep.all():
            pairs = pairs.kept(keep)
            columns = {name: values[keep] for name, values in columns.items()}
        if FILE in columns:
            columns[FILE] = columns[FILE] + self._first_file
        codes = pairs.predicted[CODE]
        self._count(columns, cells_of(self._counts.mapping, codes, pairs.rows))
        if self._places is not None:
            self._places.add(columns, codes, pairs.rows)
        if self._counts.third is not None and pairs.third is not None:
            states = self._counts.third.add(codes, pairs.rows, pairs.third)
            if "x" in pairs.predicted:
                self._counts.plan.add(pairs.predicted["x"], pairs.predicted["y"], states)

    def _count(self, columns: Columns, cells: I64) -> None:
        # cells: indices of a confusion matrix
        parts = self._parts
        options = self._options
        parts["all"].add(np.zeros(len(cells), np.int64), cells)
        if RANGE in parts:
            edges = check_edges(options.split_range_m)
            parts[RANGE].add(range_groups(columns[RANGE], edges), cells)
        if LINE in parts and options.split_lines is not None:
            parts[LINE].add(block_groups(columns[FILE], columns[LINE], options.split_lines), cells)
        if SCANNER in parts:
            parts[SCANNER].add(columns[SCANNER], cells)
        if CONFIDENCE in parts:
            parts[CONFIDENCE].add(np.minimum(columns[CONFIDENCE], MOST_CONFIDENCE), cells)
        if "blocks" in parts:
            index = columns[LINE if self._by_lines else ROW]
            per_block = options.interval_lines * (1 if self._by_lines else RECORDS_PER_LINE)
            parts["blocks"].add(block_groups(columns[FILE], index, per_block), cells)

    def finish(self, path: str) -> None:
        """Add the counts to the other pools, and note the pairs that were left out."""
        for name, part in self._parts.items():
            self._counts.parts[name].merge(part)
        if self._places is not None:
            places, n_differ = self._places.places()
            if self._counts.pair_file is not None:
                self._counts.pair_file.keep()
            # the best of all pools, so that memory stays bounded
            self._counts.places = best_first([*self._counts.places, *places])
            self._counts.n_differ += n_differ
        if self._window is not None:
            self._counts.note(*self._window.outside(path))


def scored_parts(
    counts: Counts,
    name: str,
    files: Sequence[str],
    options: EvaluateOptions,
) -> tuple[SplitPart, ...]:
    """Return the parts of a split with scored records; note the ignored records of the others."""
    parts = _parts(counts.parts[name], name, files, options)
    empty = [part for part in parts if not part.matrix.n_scored]
    if empty:
        n_ignored = sum(part.matrix.n_ignored for part in empty)
        parts_are = f"{len(empty)} parts without scored records are"
        if len(empty) == 1:
            parts_are = "1 part without scored records is"
        counts.note(f"by {SPLITS[name]}: {parts_are} left out, with {n_ignored} ignored records")
    return tuple(part for part in parts if part.matrix.n_scored)


def _parts(
    counts: GroupedCounts,
    name: str,
    files: Sequence[str],
    options: EvaluateOptions,
) -> tuple[SplitPart, ...]:
    # in order, the unknown part last
    if name == CONFIDENCE:
        return confidence_parts(counts, options.split_confidence)
    parts = []
    edges = check_edges(options.split_range_m)
    groups = [group for group in counts.groups if group != UNKNOWN]
    if name == RANGE:
        below = [] if edges[0] == 0 else [0]
        groups = [*below, *range(1, len(edges) + 1)]
    for group in groups:
        if name == RANGE:
            title, low, high = range_bounds(group, edges)
        elif name == LINE and options.split_lines is not None:
            file, block = file_and_block(group)
            first = block * options.split_lines
            low = float(first)
            high = float(first + options.split_lines)
            prefix = f"{Path(files[file]).name} " if len(files) > 1 else ""
            title = f"{prefix}lines {first}-{first + options.split_lines - 1}"
        else:
            title = f"scanner {group}"
            low = float(group)
            high = float(group + 1)
        parts.append(SplitPart(title, low, high, counts.matrix(group)))
    if UNKNOWN in counts.groups:
        parts.append(SplitPart("unknown", math.nan, math.nan, counts.matrix(UNKNOWN)))
    return tuple(parts)


def confidence_parts(counts: GroupedCounts, edges: Sequence[int]) -> tuple[SplitPart, ...]:
    """Return the pairs of every span of confidence, from counts by its value [per cent].

    The last span includes 100.
    """
    parts = []
    bounds = sorted({0, *edges, MOST_CONFIDENCE + 1})
    for low, end in pairwise(bounds):
        matrix = counts.matrix(low)
        for group in range(low + 1, end):
            matrix = matrix + counts.matrix(group)
        title = f"{low} %" if end == low + 1 else f"{low}-{end - 1} %"
        parts.append(SplitPart(title, float(low), float(end), matrix))
    if UNKNOWN in counts.groups:
        parts.append(SplitPart("unknown", math.nan, math.nan, counts.matrix(UNKNOWN)))
    return tuple(parts)


def reliability_notes(counts: GroupedCounts) -> tuple[str, ...]:
    """Return sentences on how well the confidence agrees with the share of right pairs.

    A pair is right if both sides have one class name.
    """
    n = np.zeros(MOST_CONFIDENCE + 1)
    right = np.zeros(MOST_CONFIDENCE + 1)
    for group in counts.groups:
        if group != UNKNOWN:
            matrix = counts.matrix(group)
            n[group] = matrix.n_scored
            right[group] = matrix.n_right
    if not n.sum():
        return ()
    expected = np.arange(MOST_CONFIDENCE + 1) * n / 100.0
    error = np.abs(right - expected).sum() / n.sum()
    # highest confidence first; pairs of the last value count in part
    n_down = n[::-1]
    taken = np.clip(TOP_SHARE * n.sum() - (np.cumsum(n_down) - n_down), 0.0, n_down)
    share = np.divide(right[::-1], n_down, out=np.zeros_like(n), where=n_down > 0)
    top = (share * taken).sum() / taken.sum()
    return (
        f"confidence: {100 * expected.sum() / n.sum():.2f} % on the mean, "
        f"{100 * right.sum() / n.sum():.2f} % are right; "
        f"expected calibration error {100 * error:.2f} %",
        f"confidence: of the {100 * TOP_SHARE:g} % with the most, {100 * top:.2f} % are right",
    )


def intervals_of(
    counts: Counts,
    matrix: ConfusionMatrix,
    options: EvaluateOptions,
    *,
    by_lines: bool,
) -> tuple[dict[str, Interval], str]:
    """Return intervals of all scores, and how they were computed."""
    if not options.intervals:
        return {}, ""
    blocks = counts.parts["blocks"].scored()
    names = matrix.reference_names, matrix.predicted_names
    intervals = block_intervals(blocks, *names)
    unit = "scan lines" if by_lines else "records"
    size = options.interval_lines * (1 if by_lines else RECORDS_PER_LINE)
    method = f"block jackknife, {len(blocks)} blocks of {size} {unit}, {100 * LEVEL:g} %"
    if len(blocks) < FEW_BLOCKS:
        method += "; few blocks, take them as rough"
    return intervals, method
