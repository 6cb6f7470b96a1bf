"""Confusion matrix of predicted against reference classes, filled chunk by chunk."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.brief import Brief
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.types import F64, I64
from prc_cli.evaluation.mapping import OTHER, ClassMapping, scored_names


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ConfusionMatrix(Brief):
    """Counts by reference class (rows) and predicted class (columns).

    A class of one side only never agrees with another class.
    """

    reference_names: tuple[str, ...]
    """Class names of the rows."""
    predicted_names: tuple[str, ...]
    """Class names of the columns."""
    counts: I64
    """(rows, columns) int64, scored records."""
    n_ignored: int = 0
    """Records compared but not scored."""

    @classmethod
    def empty(cls, mapping: ClassMapping) -> ConfusionMatrix:
        """Return the matrix of a mapping before the first record."""
        rows = mapping.names("reference")
        columns = mapping.names("predicted")
        return cls(rows, columns, np.zeros((len(rows), len(columns)), dtype=np.int64))

    @property
    def scored_names(self) -> tuple[str, ...]:
        """Classes of both sides, in the order of the rows."""
        return scored_names(self.reference_names, self.predicted_names)

    @property
    def n_scored(self) -> int:
        """Number of records in the matrix."""
        return int(self.counts.sum())

    @property
    def n_right(self) -> int:
        """Number of records whose classes have one name on both sides."""
        columns = {name: column for column, name in enumerate(self.predicted_names)}
        n_right = 0
        for row, name in enumerate(self.reference_names):
            if name in columns:
                n_right += int(self.counts[row, columns[name]])
        return n_right

    def __add__(self, matrix: ConfusionMatrix) -> ConfusionMatrix:
        """Add the counts of two matrices of the same classes."""
        names = (self.reference_names, self.predicted_names)
        names_of_matrix = (matrix.reference_names, matrix.predicted_names)
        if names != names_of_matrix:
            problem = f"found the classes {names_of_matrix}, expected {names}"
            where = "confusion matrix"
            raise InputError(where, problem, "use one class mapping for all parts")
        counts = self.counts + matrix.counts
        return ConfusionMatrix(*names, counts, self.n_ignored + matrix.n_ignored)

    def row_shares(self) -> F64:
        """Divide every row by its sum: shares of a reference class, with recall on the diagonal."""
        return shares(self.counts, self.counts.sum(axis=1, keepdims=True))

    def column_shares(self) -> F64:
        """Divide every column by its sum: shares of a predicted class (diagonal: precision)."""
        return shares(self.counts, self.counts.sum(axis=0, keepdims=True))

    def trimmed(self) -> ConfusionMatrix:
        """Leave out the classes without scored records on both sides; for display."""
        rows = dict(zip(self.reference_names, self.counts.sum(axis=1), strict=True))
        columns = dict(zip(self.predicted_names, self.counts.sum(axis=0), strict=True))
        # a class used by either side keeps its row and its column: an empty one is informative
        kept_rows = [
            place
            for place, (name, count) in enumerate(rows.items())
            if count or (name != OTHER and columns.get(name, 0))
        ]
        kept_columns = [
            place
            for place, (name, count) in enumerate(columns.items())
            if count or (name != OTHER and rows.get(name, 0))
        ]
        return ConfusionMatrix(
            reference_names=tuple(self.reference_names[place] for place in kept_rows),
            predicted_names=tuple(self.predicted_names[place] for place in kept_columns),
            counts=self.counts[np.ix_(kept_rows, kept_columns)],
            n_ignored=self.n_ignored,
        )


def accumulate(
    state: ConfusionMatrix,
    predicted_codes: NDArray[np.integer],
    reference_codes: NDArray[np.integer],
    mapping: ClassMapping,
) -> ConfusionMatrix:
    """Return the matrix with one more chunk of records."""
    predicted = np.ravel(predicted_codes)
    reference = np.ravel(reference_codes)
    refuse_poor_match(predicted.size, reference.size)
    rows = mapping.class_indices(reference, "reference")
    n_cells = state.counts.size
    cell_counts = np.bincount(cells_of(mapping, predicted, rows), minlength=n_cells + 1)
    chunk = ConfusionMatrix(
        reference_names=mapping.names("reference"),
        predicted_names=mapping.names("predicted"),
        counts=cell_counts[:n_cells].reshape(state.counts.shape).astype(np.int64),
        n_ignored=int(cell_counts[n_cells]),
    )
    return state + chunk


def refuse_poor_match(
    n_predicted: int,
    n_reference: int,
    predicted_name: str = "predicted",
    reference_name: str = "reference",
    hint: str = "",
) -> None:
    """Refuse two inputs that cannot be matched by order."""
    if n_predicted == n_reference:
        return
    problem = (
        f"{n_predicted} records, but {reference_name} holds {n_reference}; "
        "matched by order needs equal counts"
    )
    usual_hint = (
        "give two label files of the same stream (LAS has no missing shots); "
        "for a part of it: --match time or --only"
    )
    raise InputError(predicted_name, problem, hint or usual_hint)


def shares(counts: I64, sums: I64) -> F64:
    """Divide counts by sums; NaN, not 0, where the sum is 0.

    >>> shares(np.array([1, 0]), np.array([4, 0]))
    array([0.25,  nan])
    """
    result = np.full(np.broadcast_shapes(counts.shape, sums.shape), np.nan)
    np.divide(counts, sums, out=result, where=np.broadcast_to(sums != 0, result.shape))
    return result


UNKNOWN = -1
"""Group of pairs whose range, line or scanner is unknown."""
MAX_BYTES = 64 << 20
"""Most counts in all groups together."""
_MAX_FILES = 1 << 20
_MAX_INDEX = 1 << 40


class GroupedCounts:
    """Confusion counts by group, filled chunk by chunk."""

    def __init__(self, mapping: ClassMapping, what: str) -> None:
        self._row_names = mapping.names("reference")
        self._column_names = mapping.names("predicted")
        self._what = what
        """What the groups are, for messages."""
        self._place: dict[int, int] = {}
        """Row of the counts by group."""
        n_cells = len(self._row_names) * len(self._column_names)
        self._counts = np.zeros((4, n_cells + 1), np.int64)
        """The last column counts the pairs that are not scored."""

    @property
    def groups(self) -> tuple[int, ...]:
        """Groups with at least one pair, ascending."""
        return tuple(sorted(self._place))

    def add(self, groups: I64, cells: I64) -> None:
        """Count pairs, each in a cell of the confusion matrix of its group, (n,) both."""
        if not len(groups):
            return
        n_cells = self._counts.shape[1]
        low = int(groups.min())
        n_groups = int(groups.max()) - low + 1
        if n_groups * n_cells <= 4 * len(groups) + (1 << 16):
            # groups near each other are counted together, and the empty ones dropped
            cells_by_group = (groups - low) * n_cells + cells
            counts = np.bincount(cells_by_group, minlength=n_groups * n_cells)
            counts = counts.reshape(n_groups, n_cells)
            present = np.flatnonzero(counts.any(axis=1))
            self._add(present + low, counts[present])
            return
        names, index = np.unique(groups, return_inverse=True)
        self._check(len(names))
        counts = np.bincount(index * n_cells + cells, minlength=len(names) * n_cells)
        self._add(names, counts.reshape(len(names), n_cells))

    def _add(self, groups: I64, counts: I64) -> None:
        places = [self._place.setdefault(group, len(self._place)) for group in groups.tolist()]
        n_groups = len(self._place)
        self._check(n_groups)
        if n_groups > len(self._counts):
            larger = np.zeros((2 * n_groups, self._counts.shape[1]), np.int64)
            larger[: len(self._counts)] = self._counts
            self._counts = larger
        self._counts[places] += counts

    def merge(self, grouped: GroupedCounts) -> None:
        """Add the counts of another one for the same mapping."""
        if grouped._place:
            places = list(grouped._place.values())
            self._add(np.fromiter(grouped._place, np.int64), grouped._counts[places])

    def fold(self, into: Mapping[str, str]) -> None:
        """Add predicted classes to others, by name."""
        matrices = self._matrices(self._counts)
        for name, target in into.items():
            column = self._column_names.index(name)
            matrices[:, :, self._column_names.index(target)] += matrices[:, :, column]
            matrices[:, :, column] = 0

    def _matrices(self, counts: I64) -> I64:
        """Return a view of counts (n, cells + 1) as (n, rows, columns)."""
        return counts[:, :-1].reshape(-1, len(self._row_names), len(self._column_names))

    def _check(self, n_groups: int) -> None:
        most = MAX_BYTES // (8 * self._counts.shape[1])
        if n_groups > most:
            problem = f"more than {most} groups of pairs"
            raise ConfigError(self._what, problem, "make the groups larger")

    def matrix(self, group: int) -> ConfusionMatrix:
        """Return the matrix of one group, empty if it has no pairs."""
        counts = np.zeros((1, self._counts.shape[1]), np.int64)
        if group in self._place:
            counts = self._counts[self._place[group], None]
        return ConfusionMatrix(
            reference_names=self._row_names,
            predicted_names=self._column_names,
            counts=self._matrices(counts)[0].copy(),
            n_ignored=int(counts[0, -1]),
        )

    def scored(self) -> I64:
        """Return the counts of all groups with scored pairs.

        (groups, rows, columns) int64, by ascending group.
        """
        places = [self._place[group] for group in self.groups]
        counts = self._counts[places]
        has_scored = counts[:, :-1].any(axis=1)
        return self._matrices(counts[has_scored])


def cells_of(mapping: ClassMapping, predicted: NDArray[np.integer], rows: I64) -> I64:
    """Return the cell of the confusion matrix of every pair, (n,) int64.

    ``predicted`` (n,) codes; ``rows`` (n,) int64, reference classes. The last cell counts the pairs
    that are not scored.
    """
    columns = mapping.class_indices(predicted, "predicted")
    n_rows = len(mapping.names("reference"))
    n_columns = len(mapping.names("predicted"))
    is_scored = (rows >= 0) & (columns >= 0)
    return np.where(is_scored, rows * n_columns + columns, n_rows * n_columns)


def check_edges(edges: Sequence[float]) -> F64:
    """Return the edges of range bins."""
    edges_m = np.asarray(edges, np.float64)
    is_rising = (np.diff(edges_m) > 0).all()
    if not np.isfinite(edges_m).all() or (edges_m < 0).any() or not is_rising:
        shown = ", ".join(f"{edge:g}" for edge in edges)
        problem = f"found the edges {shown}, expected ascending ranges of 0 m and above"
        where = "split by range"
        raise ConfigError(where, problem)
    return edges_m


def range_groups(range_m: F64, edges: F64) -> I64:
    """Return the range bin of every pair.

    0 = below the first edge; :data:`UNKNOWN` where the range is NaN.

    >>> range_groups(np.array([5.0, 10.0, 99.0, np.nan]), np.array([10.0, 20.0]))
    array([ 0,  1,  2, -1])
    """
    return np.where(np.isnan(range_m), UNKNOWN, np.digitize(range_m, edges))


def range_bounds(group: int, edges: F64) -> tuple[str, float, float]:
    """Return the name of a range bin and where it begins and ends [m].

    >>> range_bounds(1, np.array([10.0, 20.0])), range_bounds(2, np.array([10.0, 20.0]))
    (('10-20 m', 10.0, 20.0), ('from 20 m', 20.0, inf))
    """
    low = 0.0 if group == 0 else float(edges[group - 1])
    if group >= len(edges):
        return f"from {low:g} m", low, math.inf
    high = float(edges[group])
    return f"{low:g}-{high:g} m", low, high


def block_groups(file: I64, index: I64, per_block: int) -> I64:
    """Return one number for file and block; :data:`UNKNOWN` where the index is."""
    block = np.minimum(index // per_block, _MAX_INDEX - 1)
    number = np.minimum(file, _MAX_FILES - 1) * _MAX_INDEX + block
    return np.where(index < 0, UNKNOWN, number)


def file_and_block(group: int) -> tuple[int, int]:
    """Return file and block of a number from :func:`block_groups`.

    >>> file_and_block(int(block_groups(np.array([2]), np.array([250]), 100)[0]))
    (2, 2)
    """
    return divmod(group, _MAX_INDEX)
