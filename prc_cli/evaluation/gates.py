"""Gates: minimum scores of an evaluation, such as ``recall.ground=0.95``, for unattended runs."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from prc_cli.core.errors import ConfigError, GateError
from prc_cli.evaluation.confusion import ConfusionMatrix
from prc_cli.evaluation.mapping import ClassMapping
from prc_cli.evaluation.scores import Scores, gate_value, scores


@dataclass(frozen=True, slots=True)
class Gate:
    """A minimum for a score."""

    name: str
    """``accuracy``, ``recall.ground``, ..."""
    limit: float


@dataclass(frozen=True, slots=True)
class GateResult:
    """A gate and the score found."""

    name: str
    limit: float
    value: float
    """NaN if the score is undefined; the gate then fails."""

    @property
    def passed(self) -> bool:
        """Whether the score reached the limit."""
        return self.value >= self.limit


def parse_gate(text: str, mapping: ClassMapping) -> Gate:
    """Parse a gate; refuse a score that an evaluation with this mapping cannot have.

    >>> mapping = ClassMapping(predicted={"ground": [2]}, reference={"ground": [2]})
    >>> parse_gate("recall.ground=0.95", mapping)
    Gate(name='recall.ground', limit=0.95)
    """
    name, _, value = text.partition("=")
    try:
        limit = float(value)
    except ValueError:
        limit = math.nan
    if not -1 <= limit <= 1:
        problem = f"found {text!r}, expected SCORE.CLASS=VALUE with a value up to 1, such as recall.ground=0.95"
        raise ConfigError("--fail-under", problem)
    gate_value(scores(ConfusionMatrix.empty(mapping)), name.strip())
    return Gate(name.strip(), limit)


def check_gates(found: Scores, gates: Iterable[Gate]) -> tuple[GateResult, ...]:
    """Compare scores with gates."""
    return tuple(GateResult(gate.name, gate.limit, gate_value(found, gate.name)) for gate in gates)


def refuse_failed(results: Iterable[GateResult]) -> None:
    """Raise if any gate failed, naming all failed ones."""
    failed = [item for item in results if not item.passed]
    if failed:
        told = [f"found {_found(item.value)}, demanded at least {item.limit:.4f}" for item in failed]
        more = "; ".join(f"{item.name}: {text}" for item, text in zip(failed[1:], told[1:], strict=True))
        raise GateError(failed[0].name, told[0], more)


def _found(value: float) -> str:
    return "undefined (no such records)" if math.isnan(value) else f"{value:.4f}"
