from __future__ import annotations

import pytest

from prc_cli.core.errors import ConfigError, GateError
from prc_cli.evaluation.gates import Gate, check_gates, parse_gate, refuse_failed
from prc_cli.evaluation.mapping import load_mapping
from prc_cli.evaluation.scores import scores
from tests.evaluation.samples import MATRIX


def test_passed_and_failed() -> None:
    results = check_gates(scores(MATRIX), [Gate("recall.ground", 0.9), Gate("accuracy", 1.0), Gate("recall.stem", 0.0)])
    assert [item.passed for item in results] == [True, False, False]  # undefined has reached nothing
    refuse_failed(results[:1])
    with pytest.raises(GateError) as caught:
        refuse_failed(results)
    assert str(caught.value) == (
        "accuracy: found 0.9869, demanded at least 1.0000; recall.stem: found nan, demanded at least 0.0000"
    )
    assert caught.value.exit_code == 3


@pytest.mark.parametrize("text", ["recall.ground", "recall.ground=", "recall.ground=x", "accuracy=1.1", "kappa=nan"])
def test_limits_that_make_no_sense(text: str) -> None:
    with pytest.raises(ConfigError, match="--fail-under: found"):
        parse_gate(text, load_mapping("prc"))


@pytest.mark.parametrize("text", ["recal.ground=0.5", "recall.road=0.5", "=0.5"])
def test_scores_and_classes_that_are_not_there(text: str) -> None:
    with pytest.raises(ConfigError, match="score: found"):
        parse_gate(text, load_mapping("prc"))
