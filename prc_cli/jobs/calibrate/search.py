"""Search for the parameters that agree best with a reference; scores on held-out lines.

Training and held-out lines are contiguous groups, so that neighbouring shots are not split between
the two.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from prc_cli.config import RunConfig
from prc_cli.core.classes import Label
from prc_cli.core.config import build, merge
from prc_cli.core.errors import ConfigError, InputError
from prc_cli.core.stream import ScanBlock
from prc_cli.core.types import I64
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.evaluation.scores import CLASS_SCORES, OVERALL_SCORES, Scores, gate_value, scores
from prc_cli.jobs.classify import label_blocks

MEAN_F1 = "mean_f1"
"""Objective: mean F1 over the classes that the reference holds."""
LEAST_GAIN = 1e-4
"""Least gain for a new best set of parameters: less is chance, and would depend on rounding."""
REFINEMENTS = 2
"""How often the grid steps are halved once the coarse ones gain nothing."""

Tried = Callable[[int, float], None]
"""Called after every trial with the number of trials and the best objective so far."""


@dataclass(frozen=True, slots=True)
class Axis:
    """One searched parameter."""

    key: str
    grid: tuple[float, ...]
    """Coarse values, ascending."""
    bounds: tuple[float, float]
    """Bounds of the refinement."""
    is_integer: bool = False
    """Whole numbers only."""


ZETA_BOUNDS = (0.01, 10.0)
"""Bounds between which the method is stable in the paper (IV-A).

a reference without noise would widen thresholds
without limit."""

ZETA_S = "prc.support.zeta_s"
ZETA_P = "prc.support.zeta_p"
PRC_AXES = (
    Axis("prc.background.d_c", (0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6), (0.005, 10.0)),
    Axis("prc.surfaces.area", (4.0, 8.0, 12.0, 20.0, 30.0, 60.0, 120.0, 240.0), (1.0, 5000.0)),
    Axis(ZETA_P, (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0), ZETA_BOUNDS),
    Axis(ZETA_S, (0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0), ZETA_BOUNDS),
    Axis("prc.surfaces.gamma", (0.0, 1.0, 2.0, 3.0, 4.0), (0.0, 20.0), is_integer=True),
)
ANGLE_AXES = (
    Axis("sequential_angle.angles.range_noise_m", (0.002, 0.005, 0.01, 0.02, 0.05), (0.0005, 0.5)),
)


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """Contiguous lines of one scanner with the reference class of every shot."""

    block: ScanBlock
    reference: I64
    """Class index of every shot, flat, -1 = not scored."""


@dataclass(frozen=True, slots=True)
class Judged:
    """Figures of one set of parameters on training and held-out lines, undefined ones as None."""

    name: str
    training: dict[str, float | None]
    held_out: dict[str, float | None]


@dataclass(frozen=True, slots=True)
class SearchResult:
    """Result of the search."""

    objective: str
    values: dict[str, float | int]
    """Best value of every searched key."""
    n_trials: int
    n_training_shots: int
    n_held_out_shots: int
    n_training_groups: int
    n_held_out_groups: int
    judged: tuple[Judged, ...]
    """As configured, as implied by the sensor, as found."""


@dataclass(slots=True)
class Searcher:
    """Tries parameters on training lines."""

    config: RunConfig
    mapping: ClassMapping
    training: tuple[Group, ...]
    objective: str
    budget: int
    axes: tuple[Axis, ...]
    tried: Tried | None = None
    _known: dict[tuple[float, ...], float] = field(default_factory=dict)
    _best: float = -math.inf

    def run(self, starts: tuple[dict[str, float], ...]) -> dict[str, float | int]:
        """Search all pairs of d_c and A, then one parameter after the other in finer steps."""
        axes = self.axes
        best = max((self._advisable(values, ZETA_P) for values in starts), key=self._try)
        if axes[:2] == PRC_AXES[:2]:
            first, second = axes[:2]
            for first_value in first.grid[::2]:
                for second_value in second.grid[::2]:
                    best = self._better(
                        best, {**best, first.key: first_value, second.key: second_value}
                    )
        for level in range(REFINEMENTS + 1):
            best = self._descend(best, level)
        return {
            axis.key: int(best[axis.key]) if axis.is_integer else best[axis.key] for axis in axes
        }

    def _descend(self, best: dict[str, float], level: int) -> dict[str, float]:
        """Change one parameter at a time, until a round gains nothing."""
        while True:
            before = best
            for axis in self.axes:
                finer = _neighbours(axis, best[axis.key], 2.0 ** (1.0 / 2**level))
                for value in finer if level else axis.grid:
                    best = self._better(best, self._advisable({**best, axis.key: value}, axis.key))
            if best == before or len(self._known) >= self.budget:
                return best

    def _advisable(self, values: dict[str, float], key: str) -> dict[str, float]:
        """Let zeta_s and zeta_p keep the order of the paper (II-B).

        The other follows, or stops a lone one.
        """
        support = self.config.prc.support
        zeta_s = values.get(ZETA_S, support.zeta_s)
        zeta_p = values.get(ZETA_P, support.zeta_p)
        if zeta_s >= zeta_p or not {ZETA_S, ZETA_P} & values.keys():
            return values
        if ZETA_S not in values or (key == ZETA_S and ZETA_P in values):
            return {**values, ZETA_P: zeta_s}
        return {**values, ZETA_S: zeta_p}

    def _better(self, best: dict[str, float], values: dict[str, float]) -> dict[str, float]:
        return values if self._try(values) > self._try(best) + LEAST_GAIN else best

    def _try(self, values: dict[str, float]) -> float:
        point = tuple(values[axis.key] for axis in self.axes)
        if point in self._known:
            return self._known[point]
        if len(self._known) >= self.budget:
            return -math.inf
        matrix = confusion(self.training, with_values(self.config, values), self.mapping)
        value = objective_value(scores(matrix), self.objective)
        # an undefined objective is worse than any
        self._known[point] = -math.inf if math.isnan(value) else value
        self._best = max(self._best, self._known[point])
        if self.tried is not None:
            self.tried(len(self._known), self._best)
        return self._known[point]

    @property
    def n_trials(self) -> int:
        """Sets of parameters that were tried."""
        return len(self._known)


def axes_of(config: RunConfig, keep: tuple[str, ...] = ()) -> tuple[Axis, ...]:
    """Return the parameters to search for the configured classifier, without the keys to keep.

    >>> [axis.key for axis in axes_of(RunConfig(), ("prc.surfaces.gamma", "prc.surfaces.area"))]
    ['prc.background.d_c', 'prc.support.zeta_p', 'prc.support.zeta_s']
    """
    axes = ANGLE_AXES if config.method == "sequential-angle" else PRC_AXES
    known = [axis.key for axis in axes]
    where = "--keep"
    for key in keep:
        if key not in known:
            raise ConfigError(where, f"found {key!r}, expected one of: {', '.join(known)}")
    left = tuple(axis for axis in axes if axis.key not in keep)
    if not left:
        raise ConfigError(
            where, "all keys are kept, expected one or more to search", "leave out --reference"
        )
    return left


def with_values(config: RunConfig, values: dict[str, Any]) -> RunConfig:
    """Return a configuration with dotted keys replaced."""
    table = config.to_table()
    for key, value in values.items():
        nested: Any = int(value) if isinstance(value, float) and key.endswith("gamma") else value
        for part in reversed(key.split(".")):
            nested = {part: nested}
        table = merge(table, nested)
    return build(RunConfig, table, "calibration")


def confusion(
    groups: tuple[Group, ...], config: RunConfig, mapping: ClassMapping
) -> ConfusionMatrix:
    """Classify groups of lines, each as a stream, and compare them with their reference.

    First returns alone.
    """
    names = mapping.names("reference"), mapping.names("predicted")
    n_classes = len(names[0])
    counts = np.zeros((len(Label), n_classes + 1), dtype=np.int64)
    for group in groups:
        labels = [
            item.labels.ravel() for item in label_blocks(iter([group.block]), config.classifier)
        ]
        cells = np.concatenate(labels).astype(np.int64) * (n_classes + 1) + group.reference + 1
        counts += np.bincount(cells, minlength=counts.size).reshape(counts.shape)
    codes = config.classes.lookup()
    matrix = np.zeros((n_classes, len(names[1])), dtype=np.int64)
    ignored = int(counts[:, 0].sum())
    for label in Label:
        if not counts[label, 1:].any():
            continue
        column = int(mapping.class_indices(codes[label : label + 1], "predicted")[0])
        if column < 0:
            ignored += int(counts[label, 1:].sum())
        else:
            matrix[:, column] += counts[label, 1:]
    return ConfusionMatrix(*names, matrix, ignored)


def objective_value(side_scores: Scores, objective: str) -> float:
    """Return the figure that is maximised."""
    if objective == MEAN_F1:
        values = [
            item.f1
            for item in side_scores.classes
            if item.n_reference and item.name in _scored(side_scores)
        ]
        return sum(values) / len(values) if values else math.nan
    return gate_value(side_scores, objective)


def check_objective(objective: str, mapping: ClassMapping) -> None:
    """Refuse an objective that an evaluation with this mapping cannot have."""
    if objective == MEAN_F1:
        return
    try:
        gate_value(scores(ConfusionMatrix.empty(mapping)), objective)
    except ConfigError:
        score = objective.partition(".")[0]
        if score in CLASS_SCORES:
            names = [f"{score}.{name}" for name in mapping.scored_names]
        else:
            names = [MEAN_F1, *OVERALL_SCORES, *(f"{name}.CLASS" for name in CLASS_SCORES)]
        expected = ", ".join(names)
        raise ConfigError(
            "--objective", f"found score {objective!r}, expected one of: {expected}"
        ) from None


def figure(figures: dict[str, float | None], name: str) -> float:
    """Return one of the figures, NaN where it is undefined."""
    value = figures[name]
    return math.nan if value is None else value


def figures(side_scores: Scores, objective: str) -> dict[str, float | None]:
    """Return the objective, the overall figures and F1 by class that the reference holds."""
    values = {
        objective: objective_value(side_scores, objective),
        MEAN_F1: objective_value(side_scores, MEAN_F1),
        "balanced_accuracy": side_scores.balanced_accuracy,
        "kappa": side_scores.kappa,
        **{
            f"f1.{item.name}": item.f1
            for item in side_scores.classes
            if item.n_reference and item.name in _scored(side_scores)
        },
    }
    return {name: None if math.isnan(value) else value for name, value in values.items()}


def _scored(side_scores: Scores) -> set[str]:
    # classes on one side only have no F1
    return {item.name for item in side_scores.classes if not math.isnan(item.f1)}


def _neighbours(axis: Axis, value: float, factor: float) -> tuple[float, ...]:
    """Return the values next to one, on whole numbers or by a factor."""
    low, high = axis.bounds
    near = (
        (value - 1, value + 1)
        if axis.is_integer
        else (_round(value / factor), _round(value * factor))
    )
    return tuple(candidate for candidate in near if low <= candidate <= high)


def _round(value: float) -> float:
    return float(f"{value:.3g}")


def split_groups(n_groups: int, share: float, seed: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Draw which groups of lines are for training, at least one of either kind.

    >>> training, held_out = split_groups(10, 0.5, seed=0)
    >>> len(training), len(held_out), set(training) & set(held_out)
    (5, 5, set())
    """
    if n_groups < 2:
        where = "calibration"
        problem = (
            "the stream is too short to hold lines back: "
            "found one group of lines, expected two or more"
        )
        raise InputError(where, problem, "lower prc.lines_per_block, or leave out --reference")
    order = np.random.default_rng(seed).permutation(n_groups)
    n = min(n_groups - 1, max(1, round(share * n_groups)))
    return tuple(sorted(order[:n].tolist())), tuple(sorted(order[n:].tolist()))
