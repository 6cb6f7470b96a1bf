"""Confusion matrix of predicted against reference classes, filled chunk by chunk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from prc_cli.core.brief import Brief
from prc_cli.core.errors import InputError
from prc_cli.core.types import F64, I64
from prc_cli.evaluation.mapping import OTHER, ClassMapping, scored_names


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ConfusionMatrix(Brief):
    """Counts of records by reference class (rows) and predicted class (columns).

    Rows and columns may differ: classes of one side only are kept, and never agree.
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
        rows, columns = mapping.names("reference"), mapping.names("predicted")
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
        places = {name: column for column, name in enumerate(self.predicted_names)}
        right = (self.counts[row, places[name]] for row, name in enumerate(self.reference_names) if name in places)
        return int(sum(right))

    def __add__(self, other: ConfusionMatrix) -> ConfusionMatrix:
        """Add the counts of two matrices of the same classes."""
        names, others = (self.reference_names, self.predicted_names), (other.reference_names, other.predicted_names)
        if names != others:
            problem = f"found the classes {others}, expected {names}"
            where = "confusion matrix"
            raise InputError(where, problem, "use one class mapping for all parts")
        return ConfusionMatrix(*names, self.counts + other.counts, self.n_ignored + other.n_ignored)

    def row_shares(self) -> F64:
        """Divide every row by its sum: shares of a reference class, with recall on the diagonal."""
        return shares(self.counts, self.counts.sum(axis=1, keepdims=True))

    def column_shares(self) -> F64:
        """Divide every column by its sum: shares of a predicted class, with precision on the diagonal."""
        return shares(self.counts, self.counts.sum(axis=0, keepdims=True))

    def trimmed(self) -> ConfusionMatrix:
        """Leave out the classes without scored records on both sides; for display.

        >>> matrix = ConfusionMatrix(("ground", "stem"), ("ground", "stem"), np.array([[5, 0], [0, 0]]))
        >>> matrix.trimmed().reference_names
        ('ground',)
        """
        rows = dict(zip(self.reference_names, self.counts.sum(axis=1), strict=True))
        columns = dict(zip(self.predicted_names, self.counts.sum(axis=0), strict=True))
        # a class used by either side keeps its row and its column: an empty one is informative
        keep_row = np.array([bool(count) or _used(columns, name) for name, count in rows.items()], dtype=bool)
        keep_column = np.array([bool(count) or _used(rows, name) for name, count in columns.items()], dtype=bool)
        return ConfusionMatrix(
            tuple(np.array(self.reference_names, dtype=object)[keep_row]),
            tuple(np.array(self.predicted_names, dtype=object)[keep_column]),
            self.counts[np.ix_(keep_row, keep_column)],
            self.n_ignored,
        )


def accumulate(
    state: ConfusionMatrix,
    predicted_codes: NDArray[np.integer],
    reference_codes: NDArray[np.integer],
    mapping: ClassMapping,
) -> ConfusionMatrix:
    """Return the matrix with one more chunk of records.

    >>> mapping = ClassMapping(ignore=[0], predicted={"ground": [2]}, reference={"ground": [2], "car": [65]})
    >>> matrix = accumulate(ConfusionMatrix.empty(mapping), np.array([2, 2, 0]), np.array([2, 65, 0]), mapping)
    >>> matrix.counts, matrix.n_ignored
    (array([[1],
           [1]]), 1)
    """
    predicted, reference = np.ravel(predicted_codes), np.ravel(reference_codes)
    refuse_poor_match(predicted.size, reference.size)
    column = mapping.class_indices(predicted, "predicted")
    row = mapping.class_indices(reference, "reference")
    scored = (row >= 0) & (column >= 0)
    n_rows, n_columns = len(state.reference_names), len(state.predicted_names)
    cells = row[scored] * n_columns + column[scored]
    found = np.bincount(cells, minlength=n_rows * n_columns).reshape(n_rows, n_columns)
    n_ignored = predicted.size - cells.size
    names = mapping.names("reference"), mapping.names("predicted")
    return state + ConfusionMatrix(*names, found.astype(np.int64), int(n_ignored))


def refuse_poor_match(
    n_predicted: int, n_reference: int, predicted_name: str = "predicted", reference_name: str = "reference"
) -> None:
    """Refuse two inputs that cannot be matched by order."""
    if n_predicted != n_reference:
        problem = (
            f"{n_predicted} records, but {reference_name} holds {n_reference}; matched by order needs equal counts"
        )
        hint = "give two label files of the same stream (LAS holds no shots without return); labels of a part of it: "
        hint += "--match time, or label the whole and give --only-lines, --only-time or --first here"
        raise InputError(predicted_name, problem, hint)


def shares(counts: I64, sums: I64) -> F64:
    """Divide counts by sums; NaN, not 0, where the sum is 0.

    >>> shares(np.array([1, 0]), np.array([4, 0]))
    array([0.25,  nan])
    """
    result = np.full(np.broadcast_shapes(counts.shape, sums.shape), np.nan)
    np.divide(counts, sums, out=result, where=np.broadcast_to(sums != 0, result.shape))
    return result


def _used(counts: dict[str, I64], name: str) -> bool:
    return name != OTHER and bool(counts.get(name, 0))
