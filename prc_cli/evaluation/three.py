"""Three labellings of the same shots: predicted and third against the reference, and against each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from prc_cli.core.brief import Brief
from prc_cli.core.types import I64, U8
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.evaluation.scores import figure, scores

STATES = ("both right", "only predicted right", "only third right", "both wrong, alike", "both wrong, differently")
"""What two labellings of a shot can be beside the reference."""
NO_STATE = len(STATES)
NOISE, LOST = "noise", -2
"""Code of a shot that the third labelling lacks, where that makes it noise."""
TABLE_SCORES = ("recall", "precision", "f1")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ThreeWay(Brief):
    """Counts of shots by the class that each of three labellings gives them."""

    third: str
    """File or folder of the third labelling."""
    reference_names: tuple[str, ...]
    predicted_names: tuple[str, ...]
    third_names: tuple[str, ...]
    counts: I64
    """(reference, predicted, third) int64, shots that all three classify."""

    @property
    def predicted(self) -> ConfusionMatrix:
        """Predicted against reference, over the shots that all three classify."""
        return ConfusionMatrix(self.reference_names, self.predicted_names, self.counts.sum(axis=2))

    @property
    def other(self) -> ConfusionMatrix:
        """Third against reference."""
        return ConfusionMatrix(self.reference_names, self.third_names, self.counts.sum(axis=1))

    @property
    def between(self) -> ConfusionMatrix:
        """Predicted against third, as if this were the reference."""
        return ConfusionMatrix(self.third_names, self.predicted_names, self.counts.sum(axis=0).T)

    def states(self) -> dict[str, int]:
        """Return the number of shots in every one of :data:`STATES`."""
        table = state_table(self.reference_names, self.predicted_names, self.third_names)
        n = np.bincount(table.ravel(), self.counts.ravel(), NO_STATE + 1)
        return {name: int(n[k]) for k, name in enumerate(STATES)}

    def sentences(self) -> tuple[str, ...]:
        """Return how often either is right, and where both agree and are wrong."""
        n, states = max(int(self.counts.sum()), 1), self.states()
        shares = ", ".join(f"{name} {count:,} ({count / n:.1%})" for name, count in states.items())
        errors = [f"{count:,} of {name} called {other}" for count, name, other in self.largest_errors()]
        more = (f"Where both agree and are wrong: {'; '.join(errors)}.",) if errors else ()
        return (f"Third labelling {self.third}, {n:,} shots that all three classify: {shares}.", *more)

    def largest_errors(self, most: int = 6) -> list[tuple[int, str, str]]:
        """Return where both agree and are wrong: shots, reference class, the class that both give."""
        found = [
            (int(self.counts[i, j, self.third_names.index(name)]), reference, name)
            for i, reference in enumerate(self.reference_names)
            for j, name in enumerate(self.predicted_names)
            if name in self.third_names and name != reference
        ]
        return sorted((item for item in found if item[0]), reverse=True)[:most]

    def table(self) -> tuple[list[str], list[list[str]]]:
        """Return header and a row a class: scores of predicted and of third against the reference, and of both."""
        matrices = {"predicted": self.predicted, "third": self.other}
        by_name = {title: {item.name: item for item in scores(matrix).classes} for title, matrix in matrices.items()}
        agreement = {item.name: item.f1 for item in scores(self.between).classes}
        header = ["class", "shots", *(f"{title} {name}" for title in matrices for name in TABLE_SCORES)]
        rows: list[list[str]] = []
        for name, n in zip(self.reference_names, self.counts.sum(axis=(1, 2)).tolist(), strict=True):
            items = [found[name] for found in by_name.values()]
            values = [getattr(item, score) for item in items for score in TABLE_SCORES]
            if n or any(item.n_predicted for item in items):
                rows.append([name, f"{n:,}", *map(figure, [*values, agreement.get(name, np.nan)])])
        return [*header, "predicted and third f1"], rows


def state_table(reference: tuple[str, ...], predicted: tuple[str, ...], third: tuple[str, ...]) -> U8:
    """Return the index in :data:`STATES` of every triple of classes, (reference, predicted, third)."""
    p = np.array([[name == other for other in predicted] for name in reference])[:, :, None]
    t = np.array([[name == other for other in third] for name in reference])[:, None, :]
    alike = np.array([[name == other for other in third] for name in predicted])[None]
    return np.select([p & t, p & ~t, ~p & t, alike], [0, 1, 2, 3], 4).astype(np.uint8)


class ThreeCounts:
    """Counts of a :class:`ThreeWay`, filled chunk by chunk; the third is read with the codes of a reference."""

    def __init__(self, mapping: ClassMapping, third: ClassMapping) -> None:
        self._mapping, self._third = mapping, third
        self._names = mapping.names("reference"), mapping.names("predicted"), third.names("reference")
        self._counts = np.zeros([len(names) for names in self._names], np.int64)
        self._states = state_table(*self._names)

    def add(self, predicted: I64, rows: I64, third: I64) -> U8:
        """Count shots by predicted code, reference class and third code; return their states."""
        columns = self._mapping.class_indices(predicted, "predicted")
        depths = np.full(len(third), -1)
        depths[third >= 0] = self._third.class_indices(third[third >= 0], "reference")
        if NOISE in self._names[2]:
            depths[third == LOST] = self._names[2].index(NOISE)
        known = (rows >= 0) & (columns >= 0) & (depths >= 0)
        index = rows[known], columns[known], depths[known]
        cells = np.ravel_multi_index(index, self._counts.shape)
        self._counts += np.bincount(cells, minlength=self._counts.size).reshape(self._counts.shape)
        states = np.full(len(rows), NO_STATE, np.uint8)
        states[known] = self._states[index]
        return states

    def fold(self, into: Mapping[str, str]) -> None:
        """Add predicted classes to others, by name."""
        names = self._names[1]
        for name, to in into.items():
            self._counts[:, names.index(to)] += self._counts[:, names.index(name)]
            self._counts[:, names.index(name)] = 0

    def result(self, third: str) -> ThreeWay:
        """Return the counts."""
        return ThreeWay(third, *self._names, self._counts)
