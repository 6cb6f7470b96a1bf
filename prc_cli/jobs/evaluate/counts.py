"""Confusion counts of an evaluation.

All pairs, parts of its splits, blocks of its intervals, and a plan of states.
"""

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
from prc_cli.matching.join import CODE, Columns
from prc_cli.matching.nearest import cell_keys, cell_places
from prc_cli.matching.sides import CONFIDENCE, FILE, LINE, RANGE, ROW, SCANNER

MOST_CONFIDENCE = 100
TOP_SHARE = 0.9
"""The share of the pairs, those with the most confidence, that is reported on."""
RECORDS_PER_LINE = 1000
"""Records that count as one scan line in the blocks of an input without known lines."""
SPLITS = {RANGE: "range", LINE: "lines", SCANNER: "scanner", CONFIDENCE: "confidence"}


EDGE_M = 0.5
_MOST_PIXELS = 1600
_WHITE = (255, 255, 255)
STATE_COLOURS = ((222, 222, 222), (0, 114, 178), (230, 159, 0), (180, 20, 40), (204, 121, 167))
"""Colours of :data:`~prc_cli.evaluation.scores.STATES` (Okabe and Ito's, safe for the colour-blind)."""


class StatePlan:
    """Shots by square of the plan and state."""

    def __init__(self) -> None:
        self._keys = np.empty(0, np.int64)
        self._counts = np.empty((0, NO_STATE + 1), np.int64)

    def add(self, x: F64, y: F64, states: U8) -> None:
        """Count shots."""
        keys, index = np.unique(cell_keys(x, y, EDGE_M), return_inverse=True)
        n = np.bincount(index * (NO_STATE + 1) + states, minlength=len(keys) * (NO_STATE + 1))
        both = np.concatenate([self._keys, keys])
        self._keys, place = np.unique(both, return_inverse=True)
        counts = np.zeros((len(self._keys), NO_STATE + 1), np.int64)
        np.add.at(counts, place, np.concatenate([self._counts, n.reshape(-1, NO_STATE + 1)]))
        self._counts = counts

    def picture(self) -> bytes | None:
        """Draw the most frequent error of every square, grey where none is.

        None without coordinates.
        """
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
    """Return 0 for squares without shots, 1 for those mostly right, else 1 + the most frequent other state."""
    n = counts.sum(axis=1)
    wrong = counts[:, 1:]
    place = np.where(2 * wrong.sum(axis=1) > n, 2 + np.argmax(wrong, axis=1), 1)
    return np.where(n > 0, place, 0).astype(np.uint8)


@dataclass(frozen=True, slots=True)
class Plan:
    """Columns beside the codes, by the side they are read from."""

    predicted: tuple[str, ...]
    reference: tuple[str, ...]
    keys: tuple[str, ...]
    """Columns of both sides that the match itself needs."""


@dataclass(frozen=True, slots=True)
class Compared:
    """Predicted records and what they are compared with."""

    one: Columns
    """Columns of the predicted side."""
    other: Columns
    """Those of the partners that the plan asks for."""
    rows: I64
    """(n,) reference class, as an index of its names; negative = not scored."""
    third: I64 | None = None
    """(n,) codes of the third labelling, -1 = none; None = there is none."""

    def kept(self, keep: Mask) -> Compared:
        """Return some of the records."""
        one, other = (
            {name: values[keep] for name, values in side.items()} for side in (self.one, self.other)
        )
        return Compared(
            one, other, self.rows[keep], None if self.third is None else self.third[keep]
        )


@dataclass(slots=True)
class Counts:
    """All counts, summed over all pairs of files."""

    mapping: ClassMapping
    parts: dict[str, GroupedCounts]
    """Grouped counts by split; ``all`` holds one group of all pairs, ``blocks`` those of the intervals."""
    n_predicted: int = 0
    n_reference: int = 0
    n_matched: int = 0
    n_reference_matched: int = 0
    third: ThreeCounts | None = None
    plan: StatePlan = field(default_factory=StatePlan)
    tolerances: set[float] = field(default_factory=set)
    """Largest distances of pairs, where they were chosen from the data."""
    notes: dict[str, int] = field(default_factory=dict)
    """Sentences with ``{n}``, and the number of records of each; 0 for those without a number."""

    def note(self, sentence: str, n: int = 0) -> None:
        """Add a sentence; numbers of equal sentences are added."""
        if n or "{n}" not in sentence:
            self.notes[sentence] = self.notes.get(sentence, 0) + n

    def fold(self) -> None:
        """Count predicted classes as coarser ones where the reference never has them, as the mapping says."""
        matrix = self.parts["all"].matrix(0)
        held = {
            name
            for name, n in zip(matrix.reference_names, matrix.counts.sum(axis=1), strict=True)
            if n
        }
        into = {name: to for name, to in self.mapping.coarser.items() if name not in held}
        moved = {
            name: to
            for name, to in into.items()
            if matrix.counts[:, matrix.predicted_names.index(name)].any()
        }
        if moved:
            told = ", ".join(f"{name} as {to}" for name, to in moved.items())
            self.note(f"the reference has no {', '.join(moved)}: counted {told}")
        for part in self.parts.values():
            part.fold(moved)
        if self.third is not None:
            self.third.fold(moved)


def asked_parts(options: EvaluateOptions) -> tuple[str, ...]:
    """Return the requested splits, and ``blocks`` if intervals are requested."""
    asked = {
        RANGE: bool(options.split_range_m),
        LINE: options.split_lines is not None,
        SCANNER: options.split_scanner,
        CONFIDENCE: bool(options.split_confidence),
        "blocks": options.intervals,
    }
    return tuple(name for name, wanted in asked.items() if wanted)


class Counting:
    """Counts of one pool of files, until its match has succeeded."""

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
        self._n_unsure = 0

    def add(self, item: Compared) -> None:
        """Count pairs that are within the window and sure enough."""
        beside = item.other | {name: item.one[name] for name in self._plan.predicted}
        keep = np.ones(len(item.rows), np.bool_)
        if self._window is not None:
            keep = self._window.keep(beside)
        if self._options.min_confidence is not None:
            sure = beside[CONFIDENCE] >= self._options.min_confidence
            self._n_unsure += int(np.count_nonzero(keep & ~sure))
            keep &= sure
        if not keep.all():
            item = item.kept(keep)
            beside = {name: values[keep] for name, values in beside.items()}
        if FILE in beside:
            beside[FILE] = beside[FILE] + self._first_file
        self._count(beside, cells_of(self._counts.mapping, item.one[CODE], item.rows))
        if self._counts.third is not None and item.third is not None:
            states = self._counts.third.add(item.one[CODE], item.rows, item.third)
            if "x" in item.one:
                self._counts.plan.add(item.one["x"], item.one["y"], states)

    def _count(self, beside: Columns, cells: I64) -> None:
        """Add pairs to the whole and to every part."""
        found = self._parts
        options = self._options
        found["all"].add(np.zeros(len(cells), np.int64), cells)
        if RANGE in found:
            found[RANGE].add(range_groups(beside[RANGE], check_edges(options.split_range_m)), cells)
        if LINE in found and options.split_lines is not None:
            found[LINE].add(block_groups(beside[FILE], beside[LINE], options.split_lines), cells)
        if SCANNER in found:
            found[SCANNER].add(beside[SCANNER], cells)
        if CONFIDENCE in found:
            found[CONFIDENCE].add(np.minimum(beside[CONFIDENCE], MOST_CONFIDENCE), cells)
        if "blocks" in found:
            index = beside[LINE if self._by_lines else ROW]
            per_block = options.interval_lines * (1 if self._by_lines else RECORDS_PER_LINE)
            found["blocks"].add(block_groups(beside[FILE], index, per_block), cells)

    def finish(self, path: str) -> None:
        """Add the counts to those of the other pools, and note what was left out."""
        for name, part in self._parts.items():
            self._counts.parts[name].merge(part)
        if self._window is not None:
            self._counts.note(*self._window.outside(path))
        least = self._options.min_confidence
        self._counts.note(
            f"{{n}} pairs have a confidence below {least} %: left out", self._n_unsure
        )


def scored_parts(
    counts: Counts,
    name: str,
    files: Sequence[str],
    options: EvaluateOptions,
) -> tuple[SplitPart, ...]:
    """Return the parts of a split that have scored records, and note the number of ignored records in the others."""
    parts = _parts(counts.parts[name], name, files, options)
    empty = [part for part in parts if not part.matrix.n_scored]
    if empty:
        n_ignored = sum(part.matrix.n_ignored for part in empty)
        many = (
            "1 part without scored records is"
            if len(empty) == 1
            else f"{len(empty)} parts without scored records are"
        )
        counts.note(f"by {SPLITS[name]}: {many} left out, with {n_ignored} ignored records")
    return tuple(part for part in parts if part.matrix.n_scored)


def _parts(
    counts: GroupedCounts,
    name: str,
    files: Sequence[str],
    options: EvaluateOptions,
) -> tuple[SplitPart, ...]:
    """Return the parts of a split in order, unknown ones last."""
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
            shown, low, high = range_bounds(group, edges)
        elif name == LINE and options.split_lines is not None:
            file, block = file_and_block(group)
            first = block * options.split_lines
            low = float(first)
            high = float(first + options.split_lines)
            prefix = f"{Path(files[file]).name} " if len(files) > 1 else ""
            shown = f"{prefix}lines {first}-{first + options.split_lines - 1}"
        else:
            shown = f"scanner {group}"
            low = float(group)
            high = float(group + 1)
        parts.append(SplitPart(shown, low, high, counts.matrix(group)))
    if UNKNOWN in counts.groups:
        parts.append(SplitPart("unknown", math.nan, math.nan, counts.matrix(UNKNOWN)))
    return tuple(parts)


def confidence_parts(counts: GroupedCounts, edges: Sequence[int]) -> tuple[SplitPart, ...]:
    """Return the pairs of every span of confidence, from counts by its value.

    The last one includes 100.
    """
    parts = []
    bounds = sorted({0, *edges, MOST_CONFIDENCE + 1})
    for low, end in pairwise(bounds):
        whole = counts.matrix(low)
        for group in range(low + 1, end):
            whole = whole + counts.matrix(group)
        shown = f"{low} %" if end == low + 1 else f"{low}-{end - 1} %"
        parts.append(SplitPart(shown, float(low), float(end), whole))
    if UNKNOWN in counts.groups:
        parts.append(SplitPart("unknown", math.nan, math.nan, counts.matrix(UNKNOWN)))
    return tuple(parts)


def reliability_notes(counts: GroupedCounts) -> tuple[str, ...]:
    """Tell how well confidence meets the share of right pairs, those of one class name.

    Means, difference.
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
    said = f"confidence: {100 * expected.sum() / n.sum():.2f} % on the mean, {100 * right.sum() / n.sum():.2f} % are right"
    # of equals, each counts in part
    taken = np.clip(TOP_SHARE * n.sum() - (np.cumsum(n[::-1]) - n[::-1]), 0.0, n[::-1])
    top = (
        np.divide(right[::-1], n[::-1], out=np.zeros_like(n), where=n[::-1] > 0) * taken
    ).sum() / taken.sum()
    return (
        f"{said}; expected calibration error {100 * error:.2f} %",
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
    found = block_intervals(blocks, names)
    unit = "scan lines" if by_lines else "records"
    size = options.interval_lines * (1 if by_lines else RECORDS_PER_LINE)
    few = "; few blocks, take them as rough" if len(blocks) < FEW_BLOCKS else ""
    method = f"block jackknife, {len(blocks)} blocks of {size} {unit}, {100 * LEVEL:g} %{few}"
    return found, method
